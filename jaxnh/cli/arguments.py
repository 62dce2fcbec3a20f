"""Arguments that commands share: a config with its overrides, and how the command was called."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from jaxnh.config.experiment import Experiment, load
from jaxnh.engine.xla_options import configure
from jaxnh.exceptions import InputError


def experiment_of(config: Path | None, overrides: Sequence[str] | None) -> Experiment:
    """The validated config.

    Raises:
        InputError: none is named, or it says something that it cannot say.
    """
    if config is None:
        raise InputError("command line: CONFIG: name a YAML file")
    configure()  # before a user's file is tried out
    return load(config, overrides or [])


def called(module: str) -> str:
    """The command as it was called, for the history of a result."""
    return shlex.join(["python", "-m", module, *sys.argv[1:]])
