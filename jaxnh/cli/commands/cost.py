"""The command `python -m jaxnh.cost CONFIG [KEY=VALUE ...] [--effects] [--output FILE] [--repeats R]`: prices.

Of accuracy in time; with --effects of every effect and analysis of the scene, in operations, time and bytes.
Imports as `sweep`.
"""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from jaxnh.cli.completion import ConfigFile, Overrides
from jaxnh.cli.exit_codes import run_app

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command(help="Show what accuracy costs in time on the very scene of a config, before it is run.")
def cost(
    config: ConfigFile = None,
    overrides: Overrides = None,
    output: Annotated[
        Path | None, typer.Option(help="Result file; by default results/NAME_cost.h5, with figures beside it")
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Times that each setting is timed")] = 5,
    of_effects: Annotated[
        bool, typer.Option("--effects", help="Instead, what each effect and analysis costs; results/NAME_effects.h5")
    ] = False,
) -> None:
    """Body of the command; the words above are what --help shows."""
    began = time.perf_counter()
    from jaxnh.cli.arguments import read_config

    content = read_config(config, overrides)
    # From here on JAX, which takes more than a second to import.
    from jaxnh.cli.experiments import checked_experiment
    from jaxnh.cli.pricing import price

    price(checked_experiment(content), output, repeats, began, effects=of_effects)


main = partial(run_app, app)
"""Run the command; returns its exit code."""
