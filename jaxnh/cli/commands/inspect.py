"""The command `python -m jaxnh.inspect FILE [--verify [--trust]] [--csv GROUP]`: what a file has in it.

Imports as `sweep`.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from jaxnh.cli.exit_codes import run_app
from jaxnh.cli.result_files import check_result
from jaxnh.exceptions import DamagedError, InputError, ResultError

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command(help="Show what a result file is, how it was made, and what is in it.")
def inspect(
    file: Annotated[Path, typer.Argument(help="Result file of jaxnh", show_default=False)],
    verify: Annotated[
        bool, typer.Option("--verify", help="Check all checksums, run some lanes again and compare them bit for bit")
    ] = False,
    trust: Annotated[
        bool, typer.Option("--trust", help="With --verify, run the text of a user's system that the file has in it")
    ] = False,
    table: Annotated[
        str | None, typer.Option("--csv", metavar="GROUP", help="Write a group as a table to standard output")
    ] = None,
) -> None:
    """Body of the command; the words above are what --help shows."""
    check_result(file)
    import h5py

    from jaxnh.cli.inspection import check_file, show, write_csv
    from jaxnh.storage import hdf5 as store
    from jaxnh.storage.damage import READING, fault_of

    try:
        store.read_attrs(file)
        with h5py.File(file, "r") as content:
            for group in store.groups(content).values():
                store.variables(group)  # nothing is said of a file that is laid out as no result is
            if table is None:
                show(file, content)
            elif table not in store.groups(content):
                raise InputError(f"command line: --csv: {file} has the groups {', '.join(content)}, and no {table}")
        if table is not None:
            write_csv(file, table, sys.stdout)
            return
    except ResultError as error:
        raise InputError(f"command line: FILE: {error}") from None
    except BrokenPipeError:
        raise
    except READING as error:
        fault = fault_of(file, error)
        if isinstance(fault, DamagedError):
            raise InputError(f"command line: FILE: {fault}") from error
        raise
    if verify:
        check_file(file)
        from jaxnh.cli.verification import run_again  # JAX, which takes more than a second to import

        run_again(file, trust=trust)


main = partial(run_app, app)
"""Run the command; returns its exit code."""
