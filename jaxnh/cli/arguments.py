"""Arguments that commands share: a config with its overrides, and how the command was called. No JAX."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from jaxnh.config.config import Config, load_config
from jaxnh.exceptions import InputError


def read_config(config: Path | None, overrides: Sequence[str] | None) -> Config:
    """The validated config.

    Raises:
        InputError: none is named, or it says something that it cannot say.
    """
    if config is None:
        raise InputError("command line: CONFIG: name a YAML file")
    return load_config(config, overrides or [])


def command_line(module: str) -> str:
    """The command as it was called, for the history of a result."""
    return shlex.join(["python", "-m", module, *sys.argv[1:]])
