"""Every exception and warning that the package raises on purpose; all of them are `JaxnhError` or `JaxnhWarning`.

The message of an exception is a sentence for the user. How a command ends with it is known to `jaxnh.cli` alone.
"""

from __future__ import annotations

from pathlib import Path


class JaxnhError(Exception):
    """Base of all errors of the package."""


class InputError(JaxnhError):
    """A request that cannot be carried out: an argument, an option, a name or an output. Ask for something else."""


class ArgumentError(InputError):
    """An argument that cannot be used as it is; a command names it as its option.

    Attributes:
        argument: its name, as "output".
        what: what is wrong.
        remedy: what starting afresh would do about it, as "replaces it"; "" where it would not help.
    """

    def __init__(self, argument: str, what: str, remedy: str = "") -> None:
        super().__init__(f"{argument}: {what}{remedy and f'; fresh=True {remedy}'}")
        self.argument, self.what, self.remedy = argument, what, remedy


def take_path(given: object, taker: str, what: str) -> Path:
    """Return a path that a user has given.

    Raises:
        InputError: it is none; `taker` takes that of a `what`.
    """
    if not isinstance(given, str | Path):
        raise InputError(f"{taker} takes the path of a {what}, not {type(given).__name__}")
    return Path(given)


class ConfigError(InputError):
    """A config that cannot be used. str() is the whole message, one line: where, which key, what is wrong."""


class UserFileError(ConfigError):
    """A user's system file that cannot be used: `FILE:LINE: what is wrong`."""


class AccuracyError(InputError):
    """No solver meets the accuracy that is asked for; the message says what can be had."""


class LostLaneError(AccuracyError):
    """Steps that all lanes share lose a lane, and no matrix of it is singular."""


class ResultError(JaxnhError):
    """A result file, or the folder of its tiles, cannot be read or written."""


class DamagedError(ResultError):
    """A file is there and is of no use: it is cut off, damaged, or of another run."""


class BusyError(ResultError):
    """Another process is at work on the same output."""


class RunError(JaxnhError):
    """A run cannot go on; the message says why, and what is kept."""


class Stopped(JaxnhError):
    """A run was stopped on request; the same call goes on where it stopped."""


class JaxnhWarning(UserWarning):
    """Base of all warnings of the package."""


class JaxStartedWarning(JaxnhWarning):
    """JAX had started before the package could set its options: results are right, and come more slowly."""
