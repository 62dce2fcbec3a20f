"""Tables of the study of flows, on the terminal and in Markdown. Nothing is measured here."""

from __future__ import annotations

import platform
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from importlib.util import find_spec
from typing import NamedTuple

from rich.console import Console

from sweeps.peers.flows.peers_flow_cases import FlowCase
from sweeps.peers.particle.peers_report import (
    AT_OWN_ERROR,
    BY_HAND,
    PACKAGES,
    QUIET,
    Grid,
    Row,
    cells_of,
    print_tables,
    processor,
    table_of,
    verdict,
)
from sweeps.peers.particle.peers_scene import TRANSIENT

OTHERS = ("lyapax", "pynamicalsys")
"""Packages that spectra are held against where they are installed: `pip install 'jaxnh[peers]'`."""

_TARGETS = (1e-6, 1e-8, 1e-10)
_WANTED_MAPS: Mapping[str, Sequence[float]] = {
    "duffing": (6.0, 5.0, 3.0),
    "pendulum": (3.0, 2.5, 2.0),
    "governor": (1.5, 1.2, 1.0),
    "lorenz": (2.0, 1.5, 1.2),
    "roessler": (2.0, 1.5, 1.2),
}
_WANTED_SPECTRA: Mapping[str, Sequence[float]] = {
    "duffing": (2.5, 2.0, 1.5),
    "pendulum": (2.5, 2.0, 1.5),
    "governor": (1.2, 1.2, 1.0),
    "lorenz": (1.2, 1.2, 1.0),
    "roessler": (1.2, 1.2, 1.0),
}
_ROW_COLUMNS = (
    "flow",
    "target",
    "peer",
    "setting",
    "max error",
    "periods or units of time/s",
    "share of core",
    "jaxnh over it",
    "by processor time",
)


class FlowRows(NamedTuple):
    """A flow with its rows at all targets: of its map, and of its spectrum."""

    case: FlowCase
    maps: Sequence[Row]
    spectra: Sequence[Row]


@dataclass(frozen=True)
class FlowStudy:
    """All that was measured.

    Attributes:
        command: that measured it.
        measured_at: the code.
        repeats: rounds of the timing.
        lanes: values of the parameter of each flow.
        flows: rows of every flow.
        seconds: that it took.
    """

    command: str
    measured_at: str
    repeats: int
    lanes: int
    flows: Sequence[FlowRows]
    seconds: float


def show(study: FlowStudy, console: Console) -> None:
    """Print the tables."""
    print_tables(_grids(study), console)
    console.print(f"{study.seconds:.0f} s")


def markdown(study: FlowStudy, before: str = "") -> str:
    """The page; what people wrote by hand at the end of the page before it is kept."""
    names = (*PACKAGES, *(name for name in OTHERS if find_spec(name)))
    packages = ", ".join(f"{name} {version(name)}" for name in names)
    parts = [
        "# jaxnh beside other integrators, on flows that users write",
        f"Written by `{study.command}` on {datetime.now(UTC):%Y-%m-%d %H:%M} UTC, in {study.seconds:.0f} s.",
        f"{processor()}; 1 core; Python {platform.python_version()}; {packages}.",
        study.measured_at,
        f"{study.lanes} values of a parameter of each flow. The error is that of the map over one period, or over a "
        "unit of time of a flow without a clock: the largest component over all lanes, at the start state and at the "
        f"state {TRANSIENT} periods on, against a Taylor integration at 1e-18 in long double; of a spectrum that of "
        "the map's derivative, relative to its norm. heyoka is tuned until its error meets the target, in several "
        "batch sizes and options, and jaxnh then to the error that heyoka has. Each row runs beside a sample of the "
        f"other, in processes of their own on one core, {study.repeats} rounds; medians, ± half the interquartile "
        "range. jaxnh has each flow as its users write it: a right-hand side, or T, Q and f. heyoka and diffrax have "
        "the governor and the double pendulum solved for the accelerations by hand. In spectra both orthonormalise "
        "equally often; heyoka carries a tangent for every component, jaxnh without a clock one fewer and the flow's "
        "own direction; these are averages, and the whole analysis of jaxnh finds orbits and errors besides. Left out "
        "of all timings: compilation, and the search for the settings.",
        "\n".join(
            f"- {f.case.name}: {f.case.words}; {f.case.parameter} in [{f.case.low:g}, {f.case.high:g}]"
            for f in study.flows
        ),
    ]
    shares = [statistics.median(row.shares) for flow in study.flows for row in (*flow.maps, *flow.spectra)]
    if min(shares, default=1.0) < QUIET:
        parts.append(f"Not a quiet run: other work left it down to {min(shares):.0%} of its share of the processor.")
    for grid in _grids(study):
        parts += [f"## {grid.title}", table_of(grid)]
    return "\n\n".join(parts) + f"\n\n{BY_HAND}\n" + before.partition(f"{BY_HAND}\n")[2]


def _grids(study: FlowStudy) -> list[Grid]:
    maps = {flow.case.name: flow.maps for flow in study.flows if flow.maps}
    spectra = {flow.case.name: flow.spectra for flow in study.flows if flow.spectra}
    grids = []
    if maps:
        grids.append(_ratios("Maps over heyoka batch, at the error that it has", maps, AT_OWN_ERROR, _WANTED_MAPS))
        grids.append(_ratios("Maps over stock diffrax, the better of Dopri8 and Tsit5", maps, "diffrax", {}))
    if spectra:
        title = "Spectra over heyoka's variational batch, at the error that it has"
        grids.append(_ratios(title, spectra, AT_OWN_ERROR, _WANTED_SPECTRA))
        grids += [
            _ratios(f"Spectra over {peer}", spectra, peer, {})
            for peer in OTHERS
            if any(row.name == peer for rows in spectra.values() for row in rows)
        ]
    for title, rows in (("Every row of maps", maps), ("Every row of spectra", spectra)):
        if rows:
            cells = [(name, *cells_of(row)) for name, each in rows.items() for row in each]
            grids.append(Grid(title, _ROW_COLUMNS, cells))
    return grids


def _ratios(title: str, flows: Mapping[str, Sequence[Row]], peer: str, wanted: Mapping[str, Sequence[float]]) -> Grid:
    """A line a flow, a column a target: jaxnh's rate over that of the best row of a peer."""
    targets = sorted({row.target for rows in flows.values() for row in rows}, reverse=True)
    cells = []
    for name, rows in flows.items():
        goals = dict(zip(_TARGETS, wanted.get(name, ()), strict=False))
        line = [name]
        for target in targets:
            found = [row for row in rows if row.target == target and row.name.startswith(peer)]
            least = min(found, key=lambda row: statistics.median(row.ratios), default=None)
            line.append(verdict(least, goals.get(target)) if least else "–")
        cells.append(tuple(line))
    return Grid(title, ("flow", *(f"error ≤ {target:.0e}" for target in targets)), cells)
