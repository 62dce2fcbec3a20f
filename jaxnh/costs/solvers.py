"""Error and time of one period's map, for every solver over a ladder of steps: work and precision.

Beside the solvers of the package stand those of diffrax as they come, with constant steps and adaptive. All run in the
same tiles on the same devices, so that the difference is theirs alone.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any

import diffrax
import equinox as eqx
import jax
import numpy as np
import xarray as xr
from jaxtyping import Float

from jaxnh.analyses.base import Entry, variable
from jaxnh.analyses.batch import LaneBatch
from jaxnh.engine.accuracy.calibration import Calibration
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.maps.build import make_return_map, scheme_of
from jaxnh.maps.section import flow_of
from jaxnh.solvers import RUNGE_KUTTA, SPLITTINGS, IsokineticSplitting
from jaxnh.solvers.diffrax_solvers import DiffraxSteps, OneTermSolver
from jaxnh.systems.flow import Flow
from jaxnh.systems.piecewise_smooth import PiecewiseSmooth

_COARSEST = 1e-3  # largest error that makes a row
_DECADES = 1.5  # of error between the rows of a splitting; their program is one for all
_FEW_DECADES = 3.0  # of the others, each row of which is compiled
_FIRST_KICKS = 48
_FIRST_STEPS = {8: 60, 5: 125}  # by order
_FIRST_TOLERANCE, _LEAST_TOLERANCE = 1e-7, 1e-14
_HOPELESS, _USEFUL = 30.0, 1e-12  # times the slowest row that is worth its time and has an error of more than that
_MOST_ROWS, _FEW_ROWS, _MOST_TRIED = 14, 3, 14
_GAIN = 0.8  # of the error before, at most, or rounding rules
_MOST_ADAPTIVE_STEPS = 1 << 16
_SETTLED = 100  # periods before the states that are timed
_TIMED_SECONDS = 0.05


class AdaptivePeriod(OneTermSolver):
    """A solver of diffrax with steps by `PIDController`, as one step over the whole period.

    Attributes:
        solver: any adaptive solver.
        tolerance: rtol and atol.
    """

    solver: diffrax.AbstractSolver = eqx.field(static=True)
    tolerance: float = eqx.field(static=True)

    def step(
        self, terms: diffrax.AbstractTerm, t0: Any, t1: Any, y0: Any, args: Any, solver_state: Any, made_jump: Any
    ) -> tuple[Any, None, dict[str, Any], None, diffrax.RESULTS]:
        del solver_state, made_jump
        solution = diffrax.diffeqsolve(
            terms,
            self.solver,
            t0=t0,
            t1=t1,
            dt0=None,
            y0=y0,
            args=args,
            stepsize_controller=diffrax.PIDController(rtol=self.tolerance, atol=self.tolerance),
            adjoint=diffrax.ForwardMode(),
            max_steps=_MOST_ADAPTIVE_STEPS,
            throw=False,
        )
        y1 = jax.tree.map(lambda leaf: leaf[-1], solution.ys)
        return y1, None, {"y0": y0, "y1": y1}, None, solution.result


@dataclass(frozen=True)
class SolverSetting:
    """A solver and its steps.

    Attributes:
        method: name of the solver, with what else sets it apart.
        solver: of the package, or any of diffrax.
        steps: a period; 1 where a controller chooses them inside.
        forces: force evaluations a period, NaN where a controller decides.
        compensated: whether its sums are.
        tolerance: of the controller, NaN for constant steps.
    """

    method: str
    solver: Any
    steps: int
    forces: float
    compensated: bool = False
    tolerance: float = math.nan


@dataclass(frozen=True)
class SolverRow:
    """A setting with its error of one period and a first, rough time per lane-period in seconds."""

    setting: SolverSetting
    error: float
    pilot: float


class SolverBench:
    """Lanes to time: one full round of tiles on every device, on the attractors of the sweep."""

    def __init__(self, batch: LaneBatch, lanes: LaneExecutor) -> None:
        self.system, self._lanes = batch.system, lanes
        self.split = isinstance(scheme_of(batch.system).reference, IsokineticSplitting)
        self.count = lanes.tile * len(lanes.devices)
        start = batch.take(np.linspace(0, batch.count - 1, self.count).round().astype(int)).lanes
        state = lanes.iterate(batch.strobe(), _SETTLED, start)
        self._at = state, start[1]

    def seconds(self, setting: SolverSetting, periods: int = 1) -> float:
        """Wall time of one call a lane-period; a first call compiles."""
        strobe = make_return_map(self.system, setting.solver, setting.steps, compensated=setting.compensated)
        began = time.perf_counter()
        self._lanes.iterate(strobe, periods, self._at)
        return (time.perf_counter() - began) / (self.count * periods)

    def medians(self, rows: Sequence[SolverRow], repeats: int) -> Float[np.ndarray, "3 rows"]:
        """Least, median and largest time per lane-period of every row; the repeats take turns."""
        periods = [max(1, round(_TIMED_SECONDS / (self.count * row.pilot))) for row in rows]
        seconds = [[self.seconds(row.setting, n) for row, n in zip(rows, periods, strict=True)] for _ in range(repeats)]
        return np.quantile(seconds, [0.0, 0.5, 1.0], axis=0)


def price(
    batch: LaneBatch, calibration: Calibration, target: float, work: float, lanes: LaneExecutor, repeats: int
) -> xr.Dataset:
    """Error and time of every setting, with the one marked that the engine uses.

    Args:
        target: the error that was asked for.
        work: lane-periods of the whole run, for its projected time.
        repeats: times that each row is timed.
    """
    bench = SolverBench(batch, lanes)
    with lanes.stage("cost: errors of all solvers", 0):
        rows = _rows(calibration, bench)
        rows, picked = _with_pick(rows, batch, bench)
    with lanes.stage(f"cost: times of {len(rows)} settings", 0):
        least, seconds, largest = bench.medians(rows, repeats)
    settings = [row.setting for row in rows]
    error = np.array([row.error for row in rows])

    def column(data: Any, long_name: str, units: str = "1") -> Entry:
        return variable("setting", data, long_name, units)

    variables = {
        "method": column([s.method for s in settings], "solver"),
        "summation": column(["compensated" if s.compensated else "plain" for s in settings], "how q and n are summed"),
        "steps": column([0 if s.tolerance > 0 else s.steps for s in settings], "steps a period, 0: by a controller"),
        "tolerance": column([s.tolerance for s in settings], "rtol and atol of the controller"),
        "forces": column([s.forces for s in settings], "force evaluations a period"),
        "error": column(error, "error of one period's map over the sweep, as the engine estimates it"),
        "seconds": column(seconds, "time per lane-period, median of the repeats", "s"),
        "seconds_least": column(least, "time per lane-period, least of the repeats", "s"),
        "seconds_largest": column(largest, "time per lane-period, largest of the repeats", "s"),
        "projected_seconds": column(seconds * work, "time of the whole run with this setting", "s"),
        "picked": column(
            (np.arange(len(rows)) == picked).astype(np.int8), "1 at the setting that the engine uses for this config"
        ),
    }
    attrs = {"target": target, "floor": calibration.floor, "projected_lane_periods": work, "repeats": repeats}
    return xr.Dataset(variables, attrs=attrs)


def _rows(calibration: Calibration, bench: SolverBench) -> list[SolverRow]:
    """Settings from coarse to as fine as pays, method by method; those beyond hope are left out."""
    rows: dict[str, list[SolverRow]] = {}
    if not bench.split:
        for ladder in _explicit(flow_of(bench.system)):
            limit = _limit(rows)
            measured = _measure(ladder, calibration, bench, limit, _FEW_ROWS)
            rows |= {measured[0].setting.method: measured} if measured else {}
        return list(chain.from_iterable(rows.values()))
    high = [s for s in SPLITTINGS.values() if s.convergence_order >= 6]
    low = [s for s in SPLITTINGS.values() if s.convergence_order < 6]
    for solver in high:
        rows[solver.name] = _measure(_splitting(solver), calibration, bench)
    for solver in high:
        if rows[solver.name]:  # up to where plain sums meet their rounding, compensation does nothing
            ladder = _splitting(solver, rows[solver.name][-1].setting.steps, compensated=True)
            rows[f"{solver.name} compensated"] = _measure(ladder, calibration, bench)
    limit = _limit(rows)
    for solver in low:
        rows[solver.name] = _measure(_splitting(solver), calibration, bench, limit)
    for ladder in _explicit(flow_of(bench.system)):
        measured = _measure(ladder, calibration, bench, limit, _FEW_ROWS)
        rows |= {measured[0].setting.method: measured} if measured else {}
    order = {name: i for i, name in enumerate(chain.from_iterable((s, f"{s} compensated") for s in SPLITTINGS))}
    return list(chain.from_iterable(rows[name] for name in sorted(rows, key=lambda name: order.get(name, len(order)))))


def _splitting(solver: IsokineticSplitting, first: int = 0, *, compensated: bool = False) -> Iterator[SolverSetting]:
    steps = first or math.ceil(_FIRST_KICKS / solver.stages)
    while True:
        yield SolverSetting(solver.name, solver, steps, float(solver.total_kicks(steps)), compensated)
        steps = math.ceil(steps * 10 ** (_DECADES / solver.convergence_order))


def _limit(rows: dict[str, list[SolverRow]]) -> float:
    """Time per lane-period beyond which a setting is hopeless beside those that are measured."""
    useful = _front(list(chain.from_iterable(rows.values())))
    return _HOPELESS * max((row.pilot for row in useful if row.error > _USEFUL), default=math.inf)


def _explicit(flow: Flow) -> Iterator[Iterator[SolverSetting]]:
    """Methods of explicit steps: the flow's own first, those written out, those of diffrax, also with a controller."""

    def constant(name: str, solver: Any, order: int, stages: int) -> Iterator[SolverSetting]:
        steps = _FIRST_STEPS[8 if order >= 8 else 5]
        while True:
            yield SolverSetting(name, solver, steps, float(steps * stages))
            steps = math.ceil(steps * 10 ** (_FEW_DECADES / order))

    def adaptive(name: str, solver: Any) -> Iterator[SolverSetting]:
        tolerance = _FIRST_TOLERANCE
        while tolerance > _LEAST_TOLERANCE:
            yield SolverSetting(name, DiffraxSteps(AdaptivePeriod(solver, tolerance)), 1, math.nan, tolerance=tolerance)
            tolerance *= 10**-_FEW_DECADES

    own = [solver for solver in scheme_of(flow).solvers(flow) if not isinstance(solver, IsokineticSplitting)]
    for solver in {solver.name: solver for solver in (*own, *RUNGE_KUTTA.values())}.values():
        yield constant(solver.name, solver, solver.convergence_order, solver.stages)
    if isinstance(flow, PiecewiseSmooth):  # whose steps end where those of diffrax do not
        return
    for stock, order in ((diffrax.Tsit5(), 5), (diffrax.Dopri8(), 8)):
        name = f"diffrax {type(stock).__name__}"
        yield constant(name, DiffraxSteps(stock), order, stock.tableau.num_stages - int(stock.tableau.fsal))
        yield adaptive(f"{name} adaptive", stock)


def _measure(
    ladder: Iterator[SolverSetting],
    calibration: Calibration,
    bench: SolverBench,
    limit: float = math.inf,
    most: int = _MOST_ROWS,
) -> list[SolverRow]:
    """Rows of a ladder from the first with an error that counts, until rounding rules or it takes too long."""
    rows: list[SolverRow] = []
    for setting in islice(ladder, _MOST_TRIED):
        bench.seconds(setting)  # compiles
        pilot = bench.seconds(setting)
        if pilot > limit:
            break
        error = calibration.error(setting.solver, setting.steps, compensated=setting.compensated)
        if error > _COARSEST:
            continue
        if rows and error > _GAIN * rows[-1].error:
            break
        rows.append(SolverRow(setting, error, pilot))
        if len(rows) == most:
            break
    return rows


def _front(rows: Sequence[SolverRow]) -> list[SolverRow]:
    """Rows that no other is both faster and more accurate than."""
    return [r for r in rows if not any(o.pilot < r.pilot and o.error < r.error for o in rows)]


def _with_pick(rows: list[SolverRow], batch: LaneBatch, bench: SolverBench) -> tuple[list[SolverRow], int]:
    """The rows with the engine's own among them, and its place."""
    for i, row in enumerate(rows):
        s = row.setting
        if (s.method, s.steps, s.compensated) == (batch.solver.name, batch.steps, batch.compensated):
            return rows, i
    solver, steps = batch.solver, batch.steps
    kicks = solver.total_kicks(steps) if isinstance(solver, IsokineticSplitting) else steps * solver.stages
    setting = SolverSetting(solver.name, solver, steps, float(kicks), batch.compensated)
    bench.seconds(setting)
    pick = SolverRow(setting, batch.error_estimate, bench.seconds(setting))
    same = [
        i
        for i, row in enumerate(rows)
        if (row.setting.method, row.setting.compensated) == (setting.method, setting.compensated)
    ]
    before = [i + 1 for i in same if rows[i].setting.steps < setting.steps]
    place = max(before) if before else min(same, default=len(rows))
    return [*rows[:place], pick, *rows[place:]], place
