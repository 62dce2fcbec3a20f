"""Tables of the peers study, on the terminal and in Markdown. Nothing is measured here."""

from __future__ import annotations

import platform
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.table import Table

from sweeps.peers.particle.peers_cases import HELD_OUT_SEED, LANES, Case
from sweeps.peers.particle.peers_scene import PERIODS, TANGENT_PERIODS, TRANSIENT, WHOLE, Setting

PACKAGES = ("jaxnh", "jax", "jaxlib", "diffrax", "equinox", "heyoka", "scipy", "numpy")
AT_OWN_ERROR = "jaxnh, at heyoka's own error"
"""Row of jaxnh tuned to the error that heyoka really has, since heyoka's orders are whole numbers."""
WITHOUT = ", without processed6"
"""Added to the name of a row that the searched splitting has no part in."""

BY_HAND = "<!-- Below this line: written by hand, kept by the next run. -->"
_HEYOKA = " heyoka"  # after a ratio that is not over the row it stands in
QUIET = 0.9  # share of a core below which a run was disturbed
_SHOWN_FORMS = 4
_HELD_OUT = "Scenes held out, at heyoka's own error"
_SPECTRA = "Lyapunov spectra, 1 core: error of the derivative of one period's map relative to its norm"
_WANTED_HEYOKA = {1e-6: 1.5, 1e-8: 1.5, 1e-10: 1.2}
_WANTED_SPECTRA = 1.5
_WANTED_DIFFRAX = 30.0
_WANTED_SCIPY = 500.0
_WANTED_CORES = 1.8
_WANTED_FLAT = 0.15


class Scaling(NamedTuple):
    """A program beside the first of its section, round by round.

    rates: lane-periods a second. busy: cores that it kept busy. ratios: of its rate over the first's.
    """

    name: str
    rates: list[float]
    busy: list[float]
    ratios: list[float]


@dataclass(frozen=True)
class Row:
    """A peer at a target: its setting and, round by round, lane-periods a second and jaxnh's ratio over it.

    `shares` are processor over wall time a core: 1 where nothing else ran on the core. `processor_ratios` are the
    ratios by processor time, which other programs on the machine disturb less. `python` is the share of the time that
    the same calls take with nothing to integrate, of a peer that Python drives; else empty.
    """

    target: float
    name: str
    setting: Setting
    rates: list[float]
    shares: list[float]
    ratios: list[float]
    processor_ratios: list[float]
    python: list[float]


class HeldOut(NamedTuple):
    """A scene that nothing was chosen on, and its rows at all targets."""

    case: Case
    rows: list[Row]


@dataclass(frozen=True)
class Study:
    """All that was measured."""

    command: str
    case: Case
    measured_at: str
    cores: int
    repeats: int
    rows: list[Row]
    tried: dict[float, list[Setting]]
    chosen: Setting
    lanes: list[Scaling]
    two_cores: list[Scaling] | None
    lyapunov: list[Row]
    held_out: list[HeldOut]
    seconds: float


class Grid(NamedTuple):
    """A table in both worlds."""

    title: str
    columns: tuple[str, ...]
    cells: list[tuple[str, ...]]


def show(study: Study, console: Console) -> None:
    """Print the tables."""
    print_tables(_grids(study), console)
    console.print(f"{study.seconds:.0f} s")


def show_lyapunov(rows: Sequence[Row], console: Console) -> None:
    """Print the table of Lyapunov spectra."""
    print_tables([_spectra(rows)], console)


def print_tables(grids: Sequence[Grid], console: Console) -> None:
    for grid in grids:
        table = Table(*grid.columns, title=grid.title, title_justify="left")
        for cells in grid.cells:
            table.add_row(*cells)
        console.print(table)


def markdown(study: Study, before: str = "") -> str:
    """The page; what people wrote by hand at the end of the page before it is kept."""
    packages = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    noun = "core" if study.cores == 1 else "cores"
    parts = [
        "# jaxnh beside other integrators",
        f"Written by `{study.command}` on {datetime.now(UTC):%Y-%m-%d %H:%M} UTC, in {study.seconds:.0f} s.",
        f"{processor()}; {study.cores} {noun}; Python {platform.python_version()}; {packages}.",
        study.measured_at,
        f"System `{study.case.name}`: {study.case.words}, {LANES} values of b. The error is that "
        f"of one period's map: the largest of (x1, y1, n1, n2) in a lane, over the start state and the state "
        f"{TRANSIENT} periods on, against a Taylor integration at 1e-18 in long double. Each peer is tuned until its "
        "largest error just meets the target (heyoka's order and jaxnh's steps are whole numbers), in several forms, "
        "and shown in its best; since heyoka's error is then often far below the target, jaxnh is tuned to that error "
        f"as well. Timing: {LANES} lanes a core, {PERIODS} periods a call for jaxnh and heyoka (8 lanes for "
        f"scipy), {study.repeats} rounds in which all rows take turns, each beside a sample of jaxnh that its ratio is "
        "formed with; medians; ± is half the interquartile range. "
        "jaxnh runs with the options its users have; stock diffrax in a process of its own without jaxnh's XLA "
        "options. On two cores every peer has a process a core, jaxnh one process with two devices.",
        "Left out of all timings: compilation, and the search for the settings. A run of jaxnh itself measures its "
        "solver and steps before it begins, and takes more steps than are shown here, since it multiplies the error "
        "that it has measured by a safety factor. What is left of heyoka's time when its calls of Python have nothing "
        "to integrate over is shown as Python's share.",
    ]
    least = min(statistics.median(row.shares) for row in study.rows)
    if least < QUIET:
        parts.append(f"Not a quiet run: other work left the study down to {least:.0%} of its share of the processor.")
    for grid in (*_grids(study), _tried(study)):
        own = grid.title == _SPECTRA
        parts += [spectra(study.lyapunov, study.command, study.measured_at) if own else _section(grid, study)]
    return "\n\n".join(parts) + f"\n\n{BY_HAND}\n" + before.partition(f"{BY_HAND}\n")[2]


def spectra(rows: Sequence[Row], command: str, measured_at: str) -> str:
    """The section of Lyapunov spectra, which may have been measured by itself."""
    now = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    words = (
        f"Written by `{command}` on {now}. {measured_at} A row of jaxnh averages the growth of tangents over "
        f"{TANGENT_PERIODS} periods; the whole analysis also looks for the orbit of every lane that is on one, takes "
        "its exponents from there, and errors from twice the steps. Both orthonormalise three tangents equally often, "
        "as often as jaxnh's analysis has chosen to before the timing; heyoka also after whole steps, nearly as often, "
        "so that no step is cut short. Python's share is that of its calls and of its Gram–Schmidt, which heyoka has "
        "compiled: the ratio without it takes both off."
    )
    return "\n\n".join([f"## {_SPECTRA}", words, table_of(_spectra(rows))])


def with_spectra(page: str, section: str) -> str:
    """A page of the whole study with this section of Lyapunov spectra in place of its own.

    Raises:
        SystemExit: it has none.
    """
    before, heading, after = page.partition(f"## {_SPECTRA}\n")
    if not heading:
        raise SystemExit("there is no page of the whole study that this section could go into; run all of it first")
    return before + section + after[after.index("\n\n## ") :]


def _section(grid: Grid, study: Study) -> str:
    return "\n\n".join([f"## {grid.title}", *_said_before(grid, study), table_of(grid)])


def _said_before(grid: Grid, study: Study) -> list[str]:
    """Return what a table needs to be understood."""
    if grid.title == _HELD_OUT:
        return [
            "`processed6` was searched for, and chosen, on the values of b of the main scene, at d = 0 and d = 0.1. "
            f"These scenes had no part in that: the first is fixed, the others are drawn by the seed {HELD_OUT_SEED} "
            "(`sweeps/peers/particle/peers_cases.py`). jaxnh is tuned to the error that heyoka has, once with all "
            "splittings and once without that one; heyoka and diffrax run in the forms that were fastest on the main "
            "scene, diffrax at the target and with jaxnh's XLA options.",
            "\n".join(f"- {each.case.name}: {each.case.words}" for each in study.held_out),
        ]
    return []


def table_of(grid: Grid) -> str:
    lines = [grid.columns, ("---",) * len(grid.columns), *grid.cells]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def _grids(study: Study) -> list[Grid]:
    noun = "core" if study.cores == 1 else "cores"
    grids = [
        _targets(study, f"jaxnh over each peer, {study.cores} {noun}"),
        Grid(
            "Every row",
            (
                "target",
                "peer",
                "setting",
                "max error",
                "median error",
                "lane-periods/s",
                "share of core",
                "jaxnh over it",
                "by processor time",
            ),
            [cells_of(row, median=True) for row in study.rows],
        ),
        _scaling(
            f"Lanes: {study.cores} {noun}, {study.chosen.form} with {study.chosen.label}",
            "lanes × periods a call",
            study.cores,
            study.lanes,
            f"within {_WANTED_FLAT:.0%} of 1",
            lambda ratio: abs(ratio - 1) <= _WANTED_FLAT,
        ),
    ]
    if study.two_cores:
        grids.append(
            _scaling(
                f"Two cores: {study.chosen.form} with {study.chosen.label}",
                "CPU devices",
                2,
                study.two_cores,
                f"≥ {_WANTED_CORES:g}",
                lambda ratio: ratio >= _WANTED_CORES,
            )
        )
    if study.held_out:
        grids.append(_held_out(study.held_out))
    return [*grids, _spectra(study.lyapunov)]


def _held_out(scenes: Sequence[HeldOut]) -> Grid:
    """A line a scene and target: jaxnh at heyoka's error, with the searched splitting and without it."""
    cells = []
    for case, rows in scenes:
        for target in dict.fromkeys(row.target for row in rows):
            at = {row.name: row for row in rows if row.target == target}
            heyoka = at["heyoka batch"]
            line = [case.name, f"{target:.0e}", f"{heyoka.setting.errors.max:.1e}", spread(heyoka.rates)]
            for name in (AT_OWN_ERROR, AT_OWN_ERROR + WITHOUT):
                row = at.get(name)
                line += [f"{row.setting.form}, {row.setting.kicks:,}", times(row.ratios)] if row else ["–", "–"]
            diffrax = [row for name, row in at.items() if name.startswith("diffrax")]
            cells.append((*line, times(diffrax[0].ratios) if diffrax else "–"))
    columns = ("scene", "target", "heyoka's error", "heyoka, lane-periods/s", "splitting, kicks", "over heyoka")
    return Grid(_HELD_OUT, (*columns, "without processed6, kicks", "over heyoka", "over diffrax"), cells)


def _spectra(rows: Sequence[Row]) -> Grid:
    """Lyapunov spectra: a line a row, with what is wanted of the ratio over heyoka."""
    columns = ("target", "peer", "setting", "max error", "lane-periods/s", "share of core")
    cells = []
    python = {row.target: statistics.median(row.python) for row in rows if row.python}
    for row in rows:
        target, name, setting, worst, rate, share, over, by_processor = cells_of(row)
        if name == AT_OWN_ERROR:
            left = statistics.median(row.ratios) * (1.0 - python[row.target])
            over = f"{verdict(row, _WANTED_SPECTRA)}{_HEYOKA}; {left:.2f}× were Python's share nothing"
        cells.append((target, name, setting, worst, rate, share, over, by_processor))
    return Grid(
        _SPECTRA,
        (*columns, "jaxnh's spectrum over it", "by processor time"),
        cells,
    )


def _targets(study: Study, title: str) -> Grid:
    """The targets of the study: a line a peer, a column an error."""
    targets = list(dict.fromkeys(row.target for row in study.rows))
    lines = [
        ("heyoka batch, at the error that it has", (AT_OWN_ERROR,), _WANTED_HEYOKA),
        ("heyoka batch, its error below the target", ("heyoka batch",), {}),
        ("heyoka batch, default options, its error below the target", ("heyoka batch, default options",), {}),
        ("stock diffrax, the better of both", ("diffrax Dopri8", "diffrax Tsit5"), _WANTED_DIFFRAX),
        (
            "stock diffrax with jaxnh's XLA options, the better",
            ("diffrax Dopri8, jaxnh's XLA options", "diffrax Tsit5, jaxnh's XLA options"),
            {},
        ),
        ("scipy DOP853", ("scipy DOP853",), _WANTED_SCIPY),
    ]
    cells = []
    for label, names, wanted in lines:
        line = [label]
        for target in targets:
            rows = [row for row in study.rows if row.target == target and row.name in names]
            goal = wanted if isinstance(wanted, float) else wanted.get(target)
            line.append(verdict(min(rows, key=lambda row: statistics.median(row.ratios)), goal) if rows else "–")
        cells.append(tuple(line))
    return Grid(title, ("over", *(f"error ≤ {target:.0e}" for target in targets)), cells)


def verdict(row: Row, wanted: float | None) -> str:
    ratio = statistics.median(row.ratios)
    text = times(row.ratios)
    return text if wanted is None else f"{text} ({'meets' if ratio >= wanted else 'below'} {wanted:g})"


def write(output: Path, page: Callable[[str], str], console: Console) -> None:
    """Write a page, made of the text that it had before, or "" where there was none."""
    output.parent.mkdir(parents=True, exist_ok=True)
    before = output.read_text(encoding="utf-8") if output.exists() else ""
    output.write_text(page(before), encoding="utf-8")
    console.print(f"wrote {output}")


def cells_of(row: Row, *, median: bool = False) -> tuple[str, ...]:
    """A row as texts; the median error after the largest where it is asked for."""
    mark = _HEYOKA if row.name in (AT_OWN_ERROR, WHOLE) else ""
    driven = f"; Python's share {statistics.median(row.python):.1%}" if row.python else ""
    itself = row.name == "jaxnh"
    return (
        f"{row.target:.0e}",
        row.name,
        f"{row.setting.form}; {row.setting.label}{driven}",
        f"{row.setting.errors.max:.1e}",
        *([f"{row.setting.errors.median:.1e}"] if median else []),
        spread(row.rates),
        f"{statistics.median(row.shares):.0%}",
        "1" if itself else times(row.ratios) + mark,
        "1" if itself else times(row.processor_ratios) + mark,
    )


def _scaling(
    title: str, first: str, cores: int, scalings: Sequence[Scaling], wanted: str, met: Callable[[float], bool]
) -> Grid:
    """A section that sets programs beside its first. Undecided: the target is missed, but the cores were not free."""
    cells = []
    for i, s in enumerate(scalings):
        busy = statistics.median(s.busy)
        word = "meets" if met(statistics.median(s.ratios)) else "misses" if busy > QUIET * cores else "undecided:"
        cells.append((s.name, spread(s.rates), f"{busy:.2f}", times(s.ratios), f"{word} {wanted}" if i else ""))
    return Grid(title, (first, "lane-periods/s", "cores kept busy", "over the first", "wanted"), cells)


def _tried(study: Study) -> Grid:
    """The fastest forms of each peer, in the order of the rows; of jaxnh all splittings."""
    cells = []
    for target, settings in study.tried.items():
        for peer in dict.fromkeys(s.peer for s in settings):
            forms = sorted((s for s in settings if s.peer == peer), key=lambda s: -s.rate)
            cells += [
                (f"{target:.0e}", peer, s.form, s.label, f"{s.errors.max:.1e}", f"{s.rate:.3g}")
                for s in (forms if peer == "jaxnh" else forms[:_SHOWN_FORMS])
            ]
    columns = ("target", "peer", "form", "setting", "max error", "lane-periods a processor second, short trial")
    return Grid("Forms tried, the fastest of each peer", columns, cells)


def _half_range(values: Sequence[float]) -> float:
    if len(values) < 2:
        return 0.0
    low, _, high = statistics.quantiles(values, n=4, method="inclusive")
    return 0.5 * (high - low)


def times(ratios: Sequence[float]) -> str:
    middle, around = statistics.median(ratios), _half_range(ratios)
    digits = 0 if middle >= 100 else 1 if middle >= 10 else 2
    return f"{middle:,.{digits}f} ± {around:,.{digits}f}×"


def spread(rates: Sequence[float]) -> str:
    middle = statistics.median(rates)
    return f"{float(f'{middle:.3g}'):,.0f} ± {_half_range(rates) / middle:.0%}"


def processor() -> str:
    """The processor's name as Linux has it."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()
