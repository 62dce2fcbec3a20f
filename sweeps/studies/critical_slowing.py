"""Effect of critical slowing down on a plain detection of the period, beside the published doubling points.

Run `python -m sweeps.studies.critical_slowing` after `make table1 table2`. Each lane starts from the start state, waits
for a transient of N periods and compares strobe points with a threshold ε; multisection on the detected period gives
the b at which n seems to turn into 2n. Beside it stands what the multiplier at the doubling predicts. Reads result
files, writes a page and a figure; integration, orbits and derivatives are the package's.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import jax
import numpy as np
import typer
from rich.console import Console
from rich.markdown import Markdown

import jaxnh
from jaxnh.cli import terminal
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.xla_options import configure
from jaxnh.maps.build import make_return_map
from jaxnh.solvers import SPLITTINGS
from sweeps.checks.measured_at import stamp
from sweeps.studies.critical_slowing_page import figure, page
from sweeps.studies.critical_slowing_study import SOLVER, STEPS, TABLES, Cascade, study_cascade

TRANSIENTS = (100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000)


class Missing(Exception):
    """A result file that is needed is not there, or not as it should be; the message says what to do."""


def read_cascade(path: Path) -> Cascade:
    """The cascade of a result file, and the published one that its config names.

    Raises:
        Missing: there is no such file, it has too few doublings, or its config names no published ones.
    """
    if not path.exists():
        raise Missing(f"{path} is not there: run `make {' '.join(TABLES)}` first")
    try:
        with jaxnh.open_result(path) as tree:
            experiment = jaxnh.Experiment.from_text(tree.attrs["config"])
            doubling = tree["doubling"].to_dataset().load()
    except (jaxnh.ResultError, jaxnh.ConfigError, KeyError) as error:
        raise Missing(f"{path} is no table of doublings: {error}") from None
    compare = (experiment.compare or {}).get("doubling")
    found = np.isfinite(doubling["b"].to_numpy())
    if compare is None or experiment.differences_from(compare) or found.sum() < 3:
        raise Missing(f"{path} has fewer than three doublings, or no published ones to compare with")
    b = doubling["b"].to_numpy()[found]
    gaps = np.diff(b)
    ahead = np.append(gaps, gaps[-1] ** 2 / gaps[-2])
    published = np.append(compare.columns()["b"], np.full(len(b), np.nan))[: len(b)]
    strobe = make_return_map(experiment.dynamics(), SPLITTINGS[SOLVER], STEPS)
    start = jax.tree.map(lambda leaf: float(leaf[0]), experiment.start({}, 1))
    n = doubling["period"].to_numpy()[found].astype(int)
    return Cascade(experiment.title, strobe, start, n, b, ahead, published, compare.source)


def main(
    results: Annotated[Path, typer.Option(help="Folder to read from and to write to")] = Path("results"),
    longest: Annotated[int, typer.Option(help="Longest transient, in forcing periods", min=1000)] = TRANSIENTS[-1],
) -> None:
    """Show what a plain detection of the period makes of the doublings, beside the published values."""
    measured_at = str(stamp())
    configure()
    try:
        cascades = [read_cascade(results / f"{name}.h5") for name in TABLES]
    except Missing as missing:
        print(missing, file=sys.stderr)
        raise typer.Exit(2) from None
    lanes = LaneExecutor(terminal.progress(Console(stderr=True)))
    transients = np.array([n for n in TRANSIENTS if n <= longest], float)
    studies = [study_cascade(cascade, lanes, transients) for cascade in cascades]
    shift = max(float(np.abs(study.law.shift).max()) for study in studies)
    cost = (
        f"{lanes.accounts.lane_periods:,.0f} lane-periods.\n"
        f"{SOLVER} with {STEPS} steps a period moves the doublings by {shift:.0e} at most."
    )
    text = page(studies, transients, cost, measured_at)
    Console().print(Markdown("\n".join(line for line in text.splitlines() if not line.startswith("!["))))
    path = results / "critical_slowing.md"
    path.write_text(text, encoding="utf-8")
    figure(studies, transients).savefig(path.with_suffix(".png"), dpi=90, pil_kwargs={"optimize": True})
    print(f"wrote {path} and {path.with_suffix('.png')}")


if __name__ == "__main__":
    typer.run(main)
