"""The command `python -m jaxnh.plot FILE ... [--output PICTURE]`: results as a picture. Imports as `sweep`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from jaxnh.cli.exit_codes import run_app
from jaxnh.cli.result_files import check_result
from jaxnh.exceptions import ArgumentError, InputError, ResultError

_FORMATS = (".png", ".pdf", ".svg")

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command(help="Draw every analysis of a result file; of several files, as of a sweep up and one down, together.")
def plot(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="Result files of jaxnh.sweep")],
    output: Annotated[
        Path | None, typer.Option(help="Picture, .png, .pdf or .svg; by default that of the first FILE with .png")
    ] = None,
    coordinates: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME[,NAME]", help="Draw planes of two coordinates, or diagrams of one; may be repeated"),
    ] = None,
    colour: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Colour by start, attractor, kind, or an axis: all lanes in one panel",
            autocompletion=lambda: ["start", "attractor", "kind"],
        ),
    ] = "",
    size: Annotated[
        str,
        typer.Option(
            metavar="SIZE",
            help="column, page, or millimetres: 120 or 120x80",
            autocompletion=lambda: ["column", "page"],
        ),
    ] = "page",
    label: Annotated[
        list[str] | None, typer.Option(metavar="TEXT", help="Name of each FILE in the legend; may be repeated")
    ] = None,
) -> None:
    """Body of the command; the words above are what --help shows."""
    path = output or files[0].with_suffix(".png")
    if path.suffix.lower() not in _FORMATS:
        raise InputError(f"command line: --output: {path} must end in one of {', '.join(_FORMATS)}")
    for file in files:
        check_result(file)
    if label and len(label) != len(files):
        raise ArgumentError("label", f"{len(files)} files need as many labels, and there are {len(label)}")
    chosen = [tuple(name.strip() for name in names.split(",")) for names in coordinates or []]
    for names in chosen:
        if len(names) > 2 or not all(names):
            raise ArgumentError("coordinates", f"it is one name or two, as x,y, not {','.join(names)}")
    from jaxnh.plotting.results import figure
    from jaxnh.plotting.style import save, size_of
    from jaxnh.storage.atomic import check_writable

    extent = size_of(size)
    try:
        drawing = figure(*files, coordinates=chosen, colour=colour, size=extent, names=label or ())
    except ResultError as error:
        raise InputError(f"command line: FILE: {' '.join(str(error).split())}") from error
    try:
        check_writable(path)
    except ResultError as error:
        raise InputError(f"command line: --output: {error}") from error
    save(drawing, path)
    print(f"wrote {path}")


main = partial(run_app, app)
"""Run the command; returns its exit code."""
