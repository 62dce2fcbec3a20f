"""The command `python -m jaxnh.explore CONFIG|RESULT`: a page of diagrams and planes. Imports as `sweep`."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from jaxnh.cli.exit_codes import run_app
from jaxnh.cli.slow_files import report_user_line
from jaxnh.exceptions import InputError

_NEEDED = ("panel", "bokeh")

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command(
    help="Zoom into a diagram or a plane of two axes in the browser, computed as one looks, or read from a result file."
)
def explore(
    config: Annotated[
        Path | None,
        typer.Argument(
            metavar="CONFIG|RESULT", help="YAML file of the experiment, or a result file", show_default=False
        ),
    ] = None,
    overrides: Annotated[
        list[str] | None, typer.Argument(metavar="[KEY=VALUE]...", help="Values to use in place of the config's")
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page; 0 takes a free one")] = 5006,
    address: Annotated[str, typer.Option(help="Where to listen; files are edited on the loopback alone")] = "127.0.0.1",
    over: Annotated[
        list[Path] | None,
        typer.Option(
            help="Result file whose curves, branches, orbits, windows and manifolds are laid over; repeatable"
        ),
    ] = None,
    columns: Annotated[
        int, typer.Option(min=64, max=4096, help="Values of the axis in a diagram; a fifth of it in a plane")
    ] = 1000,
) -> None:
    """Body of the command; the words above are what --help shows."""
    if config is None:
        raise InputError("command line: CONFIG: name a YAML file or a result file")
    if any(find_spec(name) is None for name in _NEEDED):
        raise InputError("command line: explore needs Panel and Bokeh: pip install 'jaxnh[explore]'")
    if config.suffix == ".h5" and overrides:
        raise InputError("command line: KEY=VALUE: a result file is as it is; leave it out")
    from jaxnh.cli.arguments import read_config

    content = None if config.suffix == ".h5" else read_config(config, overrides)
    # From here on JAX, where there is a config.
    from jaxnh.explorer.opening import PageContent, open_file, open_texts
    from jaxnh.explorer.worker import Watch, Worker

    worker = Worker()
    watch = Watch(worker)
    with report_user_line(str(config)):
        opened = open_file(config, content, overrides or (), over or (), watch, columns)

    def reopen(texts: dict[Path, str]) -> Iterator[PageContent | None]:
        with report_user_line(str(config)):
            yield from open_texts(opened, texts, watch, columns)

    worker.start()
    try:
        if opened.source.computes:  # while a second of modules of the page is imported, and a browser opened
            worker.ask_ahead(opened.source.passes(opened.source.first))
        from jaxnh.explorer.serve import make_server, run

        server, page = make_server(opened, worker, address, port, reopen)
    except BaseException:
        worker.stop()
        raise
    print(f"explore: {page} shows {config}; Control-C stops it", flush=True)
    run(server, worker)


main = partial(run_app, app)
"""Run the command; returns its exit code."""
