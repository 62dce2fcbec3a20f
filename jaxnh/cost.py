"""The command `python -m jaxnh.cost CONFIG [KEY=VALUE ...] [--effects] [--output FILE] [--repeats R]`: prices.

Of accuracy in time; with --effects of every effect and analysis of the scene, in operations, time and bytes.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich import box
from rich.console import Console
from rich.table import Table

from jaxnh.analyses.base import Group, Scene
from jaxnh.cli import terminal
from jaxnh.cli.command import account, calibrate, experiment_of, provenance, scene_of
from jaxnh.cli.exit_codes import Refused, check_output, run_app
from jaxnh.config.experiment import Experiment
from jaxnh.config.particle import Free
from jaxnh.costs import doubling, effects, exponent, solvers
from jaxnh.engine.lanes import Lanes
from jaxnh.engine.xla_options import configure
from jaxnh.plotting import costs as figures_cost
from jaxnh.storage import hdf5 as store

_DPI = 130
_LOG_WIDTH = 130  # columns where the output goes to a file

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command(help="Show what accuracy costs in time on the very scene of a config, before it is run.")
def cost(
    config: Annotated[Path | None, typer.Argument(help="YAML file of the experiment", show_default=False)] = None,
    overrides: Annotated[
        list[str] | None, typer.Argument(metavar="[KEY=VALUE]...", help="Values to use in place of the file's")
    ] = None,
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
    experiment = experiment_of(config, overrides)
    if not of_effects and (experiment.own or experiment.autonomous or isinstance(experiment.system, Free)):
        raise Refused(
            f"{experiment.source}: system: solvers are priced on the strobe map at a prescribed speed, and this scene "
            "has none; --effects prices what it has"
        )
    path = output or Path("results") / f"{experiment.source.stem}_{'effects' if of_effects else 'cost'}.h5"
    _check_replaceable(path)
    check_output(path)
    (_run_effects if of_effects else _run)(experiment, path, repeats, began)


def _check_replaceable(path: Path) -> None:
    """A file that is there is only replaced if it is of this command, and no name of a figure is taken."""
    if path.suffix.lower() == ".png":
        raise Refused(f"command line: --output: {path} is a name for a figure; those are put beside the result file")
    if not path.is_file():
        return
    try:
        ours = "cost_of" in store.read_attrs(path)
    except store.StoreError:
        ours = False
    if not ours:
        raise Refused(f"command line: --output: {path} is there and is no file of jaxnh.cost; name another")


def _run(experiment: Experiment, path: Path, repeats: int, began: float) -> None:
    console = Console()
    configure()
    lanes = Lanes(terminal.progress(Console(stderr=True)))
    spent: dict[str, float] = {}
    with _part("accuracy", spent), lanes.stage("accuracy: errors of one period on sample lanes", 0):
        calibration = calibrate(experiment, lanes)
        scene = scene_of(experiment, calibration)
    groups: dict[str, Group] = {}
    with _part("solvers", spent):
        work, target = _work(experiment, scene, lanes), experiment.accuracy.target
        groups["solvers"] = solvers.price(scene, calibration, target, work, lanes, repeats)
    console.print(_solvers_table(groups["solvers"]))
    groups |= _derived(experiment, scene, lanes, spent)
    with _part("figures", spent):
        attrs = provenance(experiment, scene, account(lanes, time.perf_counter() - began), "jaxnh.cost")
        attrs["cost_of"] = attrs.pop("config_sha256")
        store.write(path, attrs, groups)
        pictures = [_save(path, suffix, figure) for suffix, figure in figures_cost.figures(path).items()]
    for name, table in (("doubling_cost", _doubling_table), ("lyapunov_cost", _exponent_table)):
        if name in groups:
            console.print(table(groups[name]))
    parts = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in spent.items())
    print(f"{time.perf_counter() - began:.1f} s: {parts}; of these, compile {lanes.compile_seconds:.1f} s")
    print("wrote " + ", ".join(map(str, (path, *pictures))))


def _run_effects(experiment: Experiment, path: Path, repeats: int, began: float) -> None:
    console = Console()
    if not console.is_terminal:
        console = Console(width=_LOG_WIDTH)
    configure()
    lanes = Lanes(terminal.progress(Console(stderr=True)))
    with lanes.stage("accuracy: errors of one period on sample lanes", 0):
        scene = scene_of(experiment, calibrate(experiment, lanes))
    group = effects.price(scene, experiment.requested(), lanes, repeats)
    attrs = provenance(experiment, scene, account(lanes, time.perf_counter() - began), "jaxnh.cost")
    attrs["cost_of"] = attrs.pop("config_sha256")
    store.write(path, attrs, {"effects": group})
    console.print(_effects_table(group))
    print(f"{time.perf_counter() - began:.1f} s; of these, compile {lanes.compile_seconds:.1f} s")
    print(f"wrote {path}")


@contextmanager
def _part(name: str, spent: dict[str, float]) -> Iterator[None]:
    began = time.perf_counter()
    yield
    spent[name] = time.perf_counter() - began


def _work(experiment: Experiment, scene: Scene, lanes: Lanes) -> float:
    """Lane-periods of the whole run; devices always get whole tiles."""
    chunk = lanes.tile * len(lanes.devices)
    padded = chunk * math.ceil(len(scene.values) / chunk)
    return sum(analysis.periods(options, padded) for analysis, options in experiment.requested())


def _derived(experiment: Experiment, scene: Scene, lanes: Lanes, spent: dict[str, float]) -> dict[str, Group]:
    """What the config asks for and has a price of its own."""
    asked = {analysis.name for analysis, _ in experiment.requested()}
    groups: dict[str, Group] = {}
    for name, price, absent in (
        ("doubling", doubling.price, "the sweep has no doubling to find"),
        ("lyapunov", exponent.price, "no value of b in the sweep has a largest exponent clearly above zero"),
    ):
        if name not in asked:
            continue
        with _part(name, spent):
            group = price(scene, lanes)
        if group is None:
            print(f"warning: {name}: {absent}; its cost is left out", file=sys.stderr)
        else:
            groups[f"{name}_cost"] = group
    return groups


def _save(path: Path, suffix: str, figure: figures_cost.Figure) -> Path:
    picture = path.with_name(f"{path.stem}{suffix}.png")
    figure.savefig(picture, dpi=_DPI)
    return picture


def _table(title: str, caption: str, left: tuple[str, ...], right: tuple[str, ...]) -> Table:
    table = Table(
        title=title, caption=caption, box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, collapse_padding=True
    )
    for head in left:
        table.add_column(head, no_wrap=True)
    for head in right:
        table.add_column(head, justify="right", no_wrap=True)
    return table


def _solvers_table(group: Group) -> Table:
    """A row a setting; the one that the engine uses is marked."""
    columns = {name: variable.data for name, variable in group.variables.items()}
    work = group.attrs["projected_lane_periods"]
    table = _table(
        "Error of one period, and its price",
        f"µs a lane-period, of which the run has {work:,.0f}; comp.: compensated sums; ◀ picked",
        ("solver",),
        ("steps", "forces", "error", "µs", "whole run", ""),
    )
    for i, name in enumerate(columns["method"]):
        adaptive, picked = columns["steps"][i] == 0, bool(columns["picked"][i])
        table.add_row(
            f"{name}, comp." if columns["summation"][i] == "compensated" else str(name),
            f"tol {columns['tolerance'][i]:.0e}" if adaptive else str(columns["steps"][i]),
            "–" if adaptive else f"{columns['forces'][i]:.0f}",
            f"{columns['error'][i]:.1e}",
            f"{1e6 * columns['seconds'][i]:.2f}",
            _duration(columns["projected_seconds"][i]),
            "◀" if picked else "",
            style="bold" if picked else None,
        )
    return table


def _doubling_table(group: Group) -> Table:
    columns = {name: variable.data for name, variable in group.variables.items()}
    n, reference = group.attrs["period"], group.attrs["reference"]
    table = _table(
        f"Price of the doubling {n} → {2 * n}",
        f"processor time; b* = {reference:.13f}",
        ("method",),
        ("after", "b", "|b − b*|", "seconds"),
    )
    for i, name in enumerate(columns["method"]):
        effort = f"{columns['effort'][i]:,}"
        row = (f"{columns['b'][i]:.12f}", f"{columns['error'][i]:.1e}", f"{columns['cpu_seconds'][i]:.3f}")
        table.add_row(str(name), effort, *row)
    return table


def _exponent_table(group: Group) -> Table:
    columns = {name: variable.data for name, variable in group.variables.items()}
    table = _table(
        f"Price of λ₁ = {group.attrs['reference']:.4f} at b = {group.attrs['b']:.6g}",
        f"medians of {group.attrs['lanes']} lanes; processor time a b",
        (),
        ("periods averaged", "error", "error bar", "seconds"),
    )
    for i, periods in enumerate(columns["averaged"]):
        error, bar = columns["error"][i, 1], columns["error_bar"][i, 1]
        table.add_row(f"{periods:,}", f"{error:.1e}", f"{bar:.1e}", f"{columns['cpu_seconds'][i]:.4f}")
    return table


def _effects_table(group: Group) -> Table:
    columns = {name: variable.data for name, variable in group.variables.items()}
    table = _table(
        "What each effect and analysis costs",
        f"operations a lane-period by {group.attrs['solver']}; time: of processors, with it over without it",
        ("",),
        ("with it", "without", "time", "bytes a lane"),
    )
    table.add_column("")
    kind = ""
    for i, what in enumerate(columns["what"]):
        if kind and kind != columns["kind"][i]:
            table.add_section()
        kind = columns["kind"][i]
        cells = (columns["operations"][i], columns["operations_without"][i], columns["time_ratio"][i])
        stored = f"{columns['stored'][i]:,.0f}" if kind == "analysis" else ""
        words = [
            "–" if math.isnan(x) else form.format(x)
            for x, form in zip(cells, ("{:,.0f}", "{:,.0f}", "{:.2f}"), strict=True)
        ]
        table.add_row(str(what), *words, stored, str(columns["note"][i]))
    return table


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.1f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def main() -> int:
    """Run the command; returns its exit code."""
    return run_app(app)


if __name__ == "__main__":
    sys.exit(main())
