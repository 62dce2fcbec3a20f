"""The program `jaxnh COMMAND ...`, also `python -m jaxnh`: its first argument names the command that gets the rest.

Imports as `cli.commands.sweep`.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module

from jaxnh import __version__
from jaxnh.cli.completion import complete

COMMANDS = {
    "sweep": "run the analyses of a config and keep their results in one HDF5 file",
    "plot": "draw every analysis of a result file, or of several together",
    "cost": "show what accuracy costs in time, before a config is run",
    "explore": "zoom into a bifurcation diagram in the browser, computed as one looks",
    "inspect": "show what a result file is, how it was made, and what is in it",
}
"""The commands, each a module of `cli.commands`, and what they do."""

_COMPLETION = ("--install-completion", "--show-completion")  # of the shell that this runs in


def main() -> int:
    """Run the command that is named; returns its exit code."""
    name = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if "_JAXNH_COMPLETE" in os.environ or name in _COMPLETION:
        return complete(list(COMMANDS))
    if name in COMMANDS:
        sys.argv = [f"jaxnh {name}", *sys.argv[2:]]
        return import_module(f"jaxnh.cli.commands.{name}").main()
    if name == "--version":
        print(f"jaxnh {__version__}")
    elif name == "--help":
        print("Usage: jaxnh COMMAND [ARGUMENTS]\n")
        print("\n".join(f"  {command:8} {words}" for command, words in COMMANDS.items()))
        print("\njaxnh COMMAND --help says more; python -m jaxnh.COMMAND is the same.")
        print("jaxnh --install-completion lets the shell complete commands, options, and keys of a config.")
    else:
        print(f"command line: COMMAND: must be one of {', '.join(COMMANDS)}, not {name}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
