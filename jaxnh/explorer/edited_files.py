"""A config and the user's file that it names, edited on a page: checked as the command checks them, saved if asked."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from jaxnh.config.config import Config, UserConfig, config_of
from jaxnh.config.yaml_source import from_dict, from_text
from jaxnh.exceptions import InputError, ResultError
from jaxnh.storage.atomic import replace_atomically, target_of

if TYPE_CHECKING:
    from jaxnh.engine.experiment import Experiment

MOST = 1 << 18
"""Characters of a text that is taken."""

_LINE = re.compile(r":(\d+): (.*)", re.DOTALL)


@dataclass(frozen=True)
class EditedFiles:
    """Texts of a config and of the user's file that it names, by file, as they were when they were read.

    Attributes:
        config: path of the config.
        overrides: KEY=VALUE of the command line, that go with it.
        texts: those on disk, the config first.
    """

    config: Path
    overrides: Sequence[str]
    texts: dict[Path, str]

    def experiment(self, texts: dict[Path, str]) -> Experiment:
        """The experiment of edited texts, by the checks of the command; files are not looked at.

        Raises:
            InputError: a text is too long, or as of `engine.experiment.load`.
        """
        # Imports JAX, which the page of a result goes without.
        from jaxnh.engine.experiment import Experiment
        from jaxnh.engine.xla_options import configure

        for path, text in texts.items():
            if len(text) > MOST:
                raise InputError(f"{path}: a text that is edited here has at most {MOST:,} characters")
        source = from_text(texts[self.config], self.config, self.overrides)
        system = source.data.get("system")
        named = system.get("file") if isinstance(system, dict) else None
        file = self.config.parent / named if isinstance(named, str) else None
        config = config_of(source, self.config.parent, texts.get(file) if file else None)
        configure()  # before a user's file is tried out
        return Experiment.from_config(config)

    def save(self, texts: dict[Path, str]) -> EditedFiles:
        """Write those texts that have changed, each file whole or not at all; returns what is on disk then.

        Raises:
            InputError: the text of the config is no YAML.
            ResultError: a file has been changed by somebody else since it was read, or cannot be written.
        """
        texts = self._carrying(texts)
        missing = {path for path in texts if not path.is_file()}
        changed = {path: text for path, text in texts.items() if text != self.texts[path] or path in missing}
        for path in changed.keys() - missing:
            if _read(path) != self.texts[path]:
                raise ResultError(f"{path} has changed on disk since it was read: open the page anew")
        for path, text in changed.items():
            ends = b"\r\n" if path not in missing and b"\r\n" in path.read_bytes() else b"\n"
            with replace_atomically(target_of(path)) as sink:
                sink.write(text.encode().replace(b"\n", ends))
                sink.settle()
        return EditedFiles(self.config, self.overrides, {**self.texts, **texts})

    def _carrying(self, texts: dict[Path, str]) -> dict[Path, str]:
        """The files with this text of the user's file, in the config too where that carries it."""
        data, others = from_text(texts[self.config]).data, [text for path, text in texts.items() if path != self.config]
        explore = data.get("explore")
        if not others or not isinstance(explore, dict) or explore.get("system_file") in (None, others[0]):
            return texts
        data = {**data, "explore": {**explore, "system_file": others[0]}}
        return {**texts, self.config: from_dict(data).text}


def edited_files(config: Config, overrides: Sequence[str]) -> EditedFiles | None:
    """The files of a config; None where it is of no file.

    Raises:
        ResultError: one cannot be read.
    """
    if config.source is None:
        return None
    texts = {config.source: _read(config.source)}
    if isinstance(config, UserConfig):
        file = config.source.parent / config.system.file
        texts[file] = _read(file) if file.is_file() else config.user_text
    return EditedFiles(config.source, tuple(overrides), texts)


def _read(path: Path) -> str:
    """Text of a file with the ends of lines that a page has.

    Raises:
        ResultError: it cannot be read.
    """
    try:
        return path.read_bytes().decode("utf-8-sig").replace("\r\n", "\n")
    except (OSError, UnicodeDecodeError) as error:
        raise ResultError(f"{path}: cannot be read: {error}") from None


def place_of(message: str, files: EditedFiles) -> tuple[Path, int, str]:
    """The file and the line that a message names, or the first of the config, and what is wrong."""
    for path in files.texts:
        if message.startswith(f"{path}:") and (at := _LINE.match(message[len(str(path)) :])):
            return path, int(at.group(1)), at.group(2)
    return files.config, 1, message
