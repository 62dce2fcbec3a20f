"""The command `python -m jaxnh.sweep CONFIG [KEY=VALUE ...]`: a config to a result, in one run or in many.

As every command it reads its arguments first, and imports what it needs in its body: --help starts no JAX.
"""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

from jaxnh.cli.completion import ConfigFile, Overrides
from jaxnh.cli.exit_codes import run_app
from jaxnh.exceptions import ArgumentError

_SCHEMA = Path(__file__).parents[2] / "config" / "schema.json"

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command(help="Run the analyses of a config and keep their results in one HDF5 file.")
def sweep(
    config: ConfigFile = None,
    overrides: Overrides = None,
    output: Annotated[Path | None, typer.Option(help="Result file; by default results/NAME.h5")] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Replace a result that exists")] = False,
    dask: Annotated[
        str | None,
        typer.Option(metavar="WHERE", help="Use Dask workers: local[:N], tcp://HOST:PORT or a scheduler file"),
    ] = None,
    part: Annotated[str | None, typer.Option(metavar="K/N", help="Do only share K of N; --merge joins them")] = None,
    merge_only: Annotated[bool, typer.Option("--merge", help="Join what the parts have done")] = False,
    virtual: Annotated[
        bool, typer.Option("--virtual", help="With --merge, leave data in the files of the tiles, up to 200 of them")
    ] = False,
    tile: Annotated[
        int | None,
        typer.Option(
            min=1, metavar="LANES", help="Lanes a tile; by default some ten seconds of work, no part without tiles"
        ),
    ] = None,
    yes: Annotated[
        bool, typer.Option("--yes", help="Run a sweep of any size: of days, or of more lanes than 10^7")
    ] = False,
    device: Annotated[
        Literal["cpu", "gpu"] | None, typer.Option(help="Kind of device that computes, in place of the config's")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Say nothing but warnings and errors")] = False,
    print_schema: Annotated[bool, typer.Option("--schema", help="Print the JSON Schema of a config")] = False,
) -> None:
    """Body of the command; the words above are what --help shows."""
    if print_schema:
        print(_SCHEMA.read_text(encoding="utf-8"), end="")
        return
    share = _part(part)
    if merge_only and (part or dask):
        raise ArgumentError("merge", "it goes without --part and --dask")
    if virtual and not merge_only:
        raise ArgumentError("virtual", "it goes with --merge")
    from jaxnh.cli.arguments import command_line, read_config

    content = read_config(config, [*(overrides or []), *([f"device={device}"] if device else [])])
    # From here on JAX, which takes more than a second to import.
    from jaxnh.cli.running import run
    from jaxnh.engine.run_records import RunOptions

    how = RunOptions(fresh, share, "virtual" if virtual else merge_only, dask, tile, command_line("jaxnh.sweep"), yes)
    run(content, output, how, quiet=quiet)


def _part(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    match = re.fullmatch(r"(\d+)/(\d+)", text)
    if not match or not 1 <= int(match[1]) <= int(match[2]):
        raise ArgumentError("part", f"it is K/N with K from 1 to N, not {text}")
    return int(match[1]), int(match[2])


main = partial(run_app, app)
"""Run the command; returns its exit code."""
