"""Edited files tried out in a process of its own, which is stopped where it does not end: a loop, or a slow trace.

    python -m jaxnh.explorer.file_check

takes the texts from its standard input, and answers with what is wrong. The line that it is stopped at is the innermost
one of the user's file that was being run.
"""

from __future__ import annotations

import faulthandler
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from jaxnh.exceptions import InputError, JaxnhError
from jaxnh.explorer.edited_files import EditedFiles

SECONDS = 20.0
"""Longest time of a check of files, imports apart, in seconds."""

_IMPORTING = 60.0  # seconds that its imports may take besides
_POLL = 0.1  # seconds between two looks at it
_FRAME = re.compile(r'File "(.+)", line (\d+) in ')


def check_texts(files: EditedFiles, texts: dict[Path, str], seconds: float = SECONDS) -> Iterator[None]:
    """Check edited texts as the page will open them; yields while that goes on.

    Args:
        files: those that are edited.
        texts: by file.
        seconds: that it may take, imports apart.

    Raises:
        InputError: something is wrong with the texts, or they take too long.
    """
    question = {
        "config": str(files.config),
        "overrides": list(files.overrides),
        "texts": {str(path): text for path, text in texts.items()},
        "seconds": seconds,
    }
    command = [sys.executable, "-m", "jaxnh.explorer.file_check"]
    ends = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    with subprocess.Popen(command, text=True, encoding="utf-8", errors="replace", **ends) as process:
        try:
            told, latest = json.dumps(question), time.monotonic() + seconds + _IMPORTING
            while True:
                try:
                    answer, traces = process.communicate(told, timeout=_POLL)
                    break
                except subprocess.TimeoutExpired:
                    told = None  # it has been given
                if time.monotonic() > latest:
                    raise InputError(f"{files.config}:1: the check of this was stopped after {seconds:g} s")
                yield
        finally:
            process.kill()
    if (message := _fault(answer, traces, process.returncode, files, seconds)) is not None:
        raise InputError(message)


def _fault(answer: str, traces: str, status: int, files: EditedFiles, seconds: float) -> str | None:
    """The fault, by what the process has said and how it has ended; None where nothing is."""
    try:
        return json.loads(answer)["fault"]
    except (ValueError, KeyError):
        pass
    if "Timeout" not in traces:
        return f"{files.config}:1: the check of this ended with status {status} and without an answer"
    known = set(map(str, files.texts))
    path, line = next((at.groups() for at in _FRAME.finditer(traces) if at[1] in known), (files.config, 1))
    return (
        f"{path}:{line}: the check was stopped after {seconds:g} s, which was here: a loop without an end, or "
        "equations that take too long to trace"
    )


def _try_texts(config: Path, overrides: Sequence[str], texts: dict[Path, str]) -> str | None:
    """The fault of texts; None where there is none."""
    from jaxnh.engine.progress import NullProgress
    from jaxnh.explorer.live import live

    try:
        live(EditedFiles(config, overrides, texts).experiment(texts), NullProgress(), 64)
    except JaxnhError as error:
        return str(error)
    return None


def main() -> None:
    """Answer one question."""
    with os.fdopen(0, encoding="utf-8") as source:
        question = json.load(source)
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as sink:
        os.dup2(2, 1)  # whatever a user's file prints is no answer
        import jaxnh.engine.experiment
        import jaxnh.explorer.live  # noqa: F401

        faulthandler.dump_traceback_later(question["seconds"], exit=True)
        texts = {Path(path): text for path, text in question["texts"].items()}
        fault = _try_texts(Path(question["config"]), question["overrides"], texts)
        faulthandler.cancel_dump_traceback_later()
        json.dump({"fault": fault}, sink)


if __name__ == "__main__":
    main()
