"""The command `python -m jaxnh.plot FILE [--output PNG]`: a result file as a picture. Imports as `jaxnh.sweep`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from jaxnh.cli.exit_codes import run_app
from jaxnh.exceptions import InputError, ResultError

_DPI = 140
_FORMATS = (".png", ".pdf", ".svg")

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command(help="Draw every analysis of a result file.")
def plot(
    file: Annotated[Path, typer.Argument(help="Result file of jaxnh.sweep", show_default=False)],
    output: Annotated[Path | None, typer.Option(help="Picture; by default FILE with .png")] = None,
) -> None:
    """Body of the command; the words above are what --help shows."""
    path = output or file.with_suffix(".png")
    if path.suffix.lower() not in _FORMATS:
        raise InputError(f"command line: --output: {path} must end in one of {', '.join(_FORMATS)}")
    if not file.is_file():
        raise InputError(f"command line: FILE: {file} is {'a folder' if file.is_dir() else 'not there'}")
    from jaxnh.plotting.results import figure
    from jaxnh.storage.atomic import check_writable

    try:
        drawing = figure(file)
    except ResultError as error:
        raise InputError(f"command line: FILE: {' '.join(str(error).split())}") from error
    try:
        check_writable(path)
    except ResultError as error:
        raise InputError(f"command line: --output: {error}") from error
    drawing.savefig(path, dpi=_DPI)
    print(f"wrote {path}")


def main() -> int:
    """Run the command; returns its exit code."""
    return run_app(app)


if __name__ == "__main__":
    sys.exit(main())
