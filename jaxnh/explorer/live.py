"""Views that are computed, coarse first, by sessions that are calibrated once for all that one zooms into.

A session is calibrated over the whole range of the axis, and of every parameter that has been moved; a narrower range
is computed with its solver and steps, so that pictures of one place are of one map, whatever the range, and no zoom
compiles a program. What leaves a session's ranges gets another session, over both.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool

from jaxnh.config.experiment import Experiment
from jaxnh.engine.lanes import TILE
from jaxnh.engine.progress import Progress
from jaxnh.engine.session import Session
from jaxnh.exceptions import InputError
from jaxnh.explorer import batch
from jaxnh.explorer.raster import raster, values_of
from jaxnh.explorer.source import LaneReport, Parameter, Picture
from jaxnh.explorer.view import View

_CALIBRATED = 1024  # values of the axis that a session is calibrated over
_COARSE_SECONDS = 0.15  # that a coarse picture may be computed in
_COARSE_STROBES = 32
_COARSE_TRANSIENTS = (16, 128)  # periods at least, and at most
_FEW = 16  # lanes of a tile where one lane is asked for
_FIRST_REPORT = ("portrait", "poincare", "period")
_SECOND_REPORT = ("period", "lyapunov", "chaos01", "verdict")
_SHIFTED = 1e3  # errors of one period: in a narrower range they may move what is seen


class _Calibrated(NamedTuple):
    """A session and what it is calibrated for.

    Attributes:
        ends: of the axis and of the parameters that have been moved.
        target: as of a view.
    """

    ends: Mapping[str, tuple[float, float]]
    target: float | None
    session: Session

    def holds(self, view: View, moved: Mapping[str, float]) -> bool:
        """Whether a view lies within."""
        inside = all(
            name in self.ends and self.ends[name][0] <= value <= self.ends[name][1] for name, value in moved.items()
        )
        low, high = self.ends[view.axis]
        return inside and low <= view.low and view.high <= high and self.target == view.target


class Live:
    """Views of an experiment; as `Source`. All that computes is called in one thread."""

    computes = True

    def __init__(self, experiment: Experiment, progress: Progress, columns: int) -> None:
        """Nothing is computed yet.

        Args:
            experiment: one axis of it has two values or more.
            progress: of its sessions.
            columns: values of the axis in a picture.

        Raises:
            InputError: it has no such axis.
        """
        long = [axis for axis in experiment.axes if len(axis.values) > 1]
        if not long:
            raise InputError(f"{experiment.label}: sweep: explore needs an axis of two values or more")
        axis, flow = long[0], experiment.flow()
        self._progress, self._user_file = progress, experiment.user_file
        self._coordinates = experiment.coordinates
        self._content = batch.content_of(experiment)
        others = {other.name: float(other.values[0]) for other in experiment.axes if other is not axis}
        grid = {axis.name: batch.evenly(float(axis.values.min()), float(axis.values.max()), _CALIBRATED)}
        self._content = batch.fixed_at(
            batch.swept(self._content, grid, self._content["analyses"]), others, self._coordinates
        )
        options: Mapping[str, Any] = (self._content["analyses"] or {}).get("diagram") or {}
        self.title = experiment.title or experiment.label
        self.notes = (
            (f"states are not carried here: every value starts from the same state, not {options['start']} the axis",)
            if options.get("start", "fixed") != "fixed"
            else ()
        )
        self.first = View(
            axis.name,
            float(axis.values.min()),
            float(axis.values.max()),
            flow.plane[0],
            transient=options.get("transient", 512),
            strobes=options.get("strobes", 128),
            columns=columns,
        )
        self.axis_words = {axis.name: axis.long_name}
        self.variables = {name: flow.words(name) for name in flow.coordinates}
        self._base = self._experiment(grid, None)
        self.parameters = tuple(self._movable(axis.name))
        self._calibrated: list[_Calibrated] = []
        self._seconds: dict[int, float] = {}  # a lane-period, by session

    @property
    def compiled(self) -> int:
        """Programs that its sessions have, whatever they were loaded from."""
        return sum(known.session.programs for known in self._calibrated)

    @property
    def error_estimate(self) -> float:
        """Error of one period of the session that was made last; NaN before the first."""
        return self._calibrated[0].session.plan.error_estimate if self._calibrated else np.nan

    # ---- what a page asks for

    def passes(self, view: View) -> Iterator[Picture]:
        """Pictures of a view: a coarse one, then its columns in full, some of them at a time."""
        moved = self._moved(view)
        known = self._session(view, moved)
        values = view.values()
        every = max(1, -(-view.columns // (TILE * known.session.devices)))
        coarse = self._coarse_transient(known.session, view, len(values[::every]))
        strobes = min(_COARSE_STROBES, view.strobes)
        points, failed = np.full((len(values), view.strobes), np.nan), np.zeros(len(values), bool)
        if coarse + strobes < view.transient + view.strobes:
            rough = self._diagram(known.session, view, values[::every], moved, coarse, strobes)
            _, found = values_of(rough, view.axis, view.variable)
            points[:, :strobes] = np.repeat(found, every, axis=0)[: len(values)]
            words = f"coarse: {len(found):,} values, {strobes} strobes after {coarse} periods"
            words += _failures(np.any(~np.isfinite(found), axis=1))
            yield Picture(raster(values, points, view.window), None, words, self._notes(view, known))
        parts = []
        for k in range(every):
            parts.append(self._diagram(known.session, view, values[k::every], moved, view.transient, view.strobes))
            points[k::every] = values_of(parts[-1], view.axis, view.variable)[1]
            failed[k::every] = np.any(~np.isfinite(points[k::every]), axis=1)
            whole = xr.concat(parts, view.axis).sortby(view.axis) if k == every - 1 else None
            share = f"{view.columns:,} values" if whole is not None else f"{k + 1} of {every} parts refined"
            words = f"{share}, {view.strobes} strobes after {view.transient} periods{_failures(failed)}"
            yield Picture(raster(values, points, view.window), whole, words, self._notes(view, known))

    def lane(self, view: View, where: Mapping[str, float]) -> Iterator[LaneReport]:
        """Reports of a lane: portrait, strobe points and period, then spectrum and verdict."""
        moved = self._moved(view)
        few = self._session(view, moved).session.of_few(_FEW)
        own = self._content["analyses"] or {}
        where, groups = {**where, **moved}, dict[str, xr.Dataset]()
        for names in (_FIRST_REPORT, _SECOND_REPORT):
            groups |= few.groups({name: own.get(name) or {} for name in names}, **where)
            yield LaneReport(where, dict(groups), names is _SECOND_REPORT)

    def batch_text(self, view: View) -> str:
        """The YAML of a batch job that computes a view again, bit for bit where its sums are plain ones."""
        known = next((one for one in self._calibrated if one.holds(view, self._moved(view))), None)
        plan = known.session.plan if known else None
        solver = (plan.solver.name, plan.steps) if plan and not plan.compensated else None
        low, high = view.low, view.high
        title = f"{self.title}: {view.axis} from {low!r} to {high!r}"
        return batch.batch_text(self._content, view, self._coordinates, solver, title)

    # ---- how

    def _experiment(self, grids: Mapping[str, Any], target: float | None) -> Experiment:
        content = batch.swept(self._content, grids, {"diagram": {}})
        if target is not None:
            content["accuracy"] = {**(content.get("accuracy") or {}), "target": target}
            content["accuracy"] = {k: v for k, v in content["accuracy"].items() if k not in ("solver", "steps")}
        return batch.experiment_of(content, self._user_file)

    def _movable(self, axis: str) -> Iterator[Parameter]:
        """Parameters that a lane may have another value of."""
        flow = self._base.flow()
        for name, value in flow.parameters.items():
            try:
                self._base.variant({"diagram": None}, {name: float(value)})  # pyright: ignore[reportArgumentType]
            except InputError:
                continue
            if name != axis:
                number = float(value)  # pyright: ignore[reportArgumentType]
                ends = sorted((0.5 * number, 1.5 * number)) if number else (0.0, 1.0)
                yield Parameter(name, flow.words(name), number, *ends)

    def _moved(self, view: View) -> dict[str, float]:
        """Parameters of a view with other values than the config says."""
        known = {parameter.name: parameter.value for parameter in self.parameters}
        for name in view.fixed:
            if name not in known:
                raise InputError(f"there is no parameter {name} to be moved; there are {', '.join(known)}")
        return {name: value for name, value in view.fixed.items() if value != known[name]}

    def _session(self, view: View, moved: Mapping[str, float]) -> _Calibrated:
        """A session that holds for a view, calibrated now if there is none yet."""
        for known in self._calibrated:
            if known.holds(view, moved) and set(known.ends) == {view.axis, *moved}:
                return known
        reach = {
            p.name: (min(p.low, moved[p.name]), max(p.high, moved[p.name])) for p in self.parameters if p.name in moved
        }
        ends = {view.axis: (min(view.low, self.first.low), max(view.high, self.first.high)), **reach}
        try:
            found = self._calibrate(view, ends, moved)
        except InputError:  # the parameters do not go together over the whole of their ranges
            ends = {view.axis: ends[view.axis], **{name: (value, value) for name, value in moved.items()}}
            found = self._calibrate(view, ends, moved)
        self._calibrated.insert(0, found)
        return found

    def _calibrate(
        self, view: View, ends: Mapping[str, tuple[float, float]], moved: Mapping[str, float]
    ) -> _Calibrated:
        grids = {
            name: batch.evenly(low, high, _CALIBRATED)
            if name == view.axis
            else {"values": sorted({low, moved[name], high})}
            for name, (low, high) in ends.items()
        }
        session = Session(self._experiment(grids, view.target), progress=self._progress)
        _ = session.plan
        return _Calibrated(ends, view.target, session)

    def _diagram(
        self, session: Session, view: View, values: np.ndarray, moved: Mapping[str, float], transient: int, strobes: int
    ) -> xr.Dataset:
        began = time.perf_counter()
        data = session.run("diagram", {"transient": transient, "strobes": strobes}, **{view.axis: values, **moved})
        each = (time.perf_counter() - began) / (len(values) * (transient + strobes))
        self._seconds[id(session)] = min(self._seconds.get(id(session), np.inf), each)
        return data

    def _coarse_transient(self, session: Session, view: View, lanes: int) -> int:
        """Periods before the strobes of a coarse picture, as many as there is time for."""
        least, most = _COARSE_TRANSIENTS
        each = self._seconds.get(id(session), np.inf)
        fits = int(_COARSE_SECONDS / (each * lanes)) - _COARSE_STROBES if np.isfinite(each) else most
        return min(view.transient, max(least, min(most, fits)))

    def _notes(self, view: View, known: _Calibrated) -> tuple[str, ...]:
        """What one has to know of the accuracy of a picture."""
        plan = known.session.plan
        over = ", ".join(f"{name} in {low:g}..{high:g}" for name, (low, high) in known.ends.items())
        told = f"{plan.solver.name}, {plan.steps} steps, error of one period {plan.error_estimate:.1g} over {over}"
        found = [*self.notes, told]
        if view.high - view.low < _SHIFTED * plan.error_estimate:
            found.append(
                f"{view.axis} is seen more finely than {_SHIFTED:g} errors of one period: shapes are those of the "
                "computed map, and their places move with the accuracy"
            )
        if view.deepest:
            found.append("columns are neighbouring doubles: there is nothing between them to zoom into")
        return tuple(found)


def _failures(failed: Bool[np.ndarray, " columns"]) -> str:
    """How many values have a state that is not finite, in words; nothing where there are none."""
    return f"; {np.count_nonzero(failed):,} failed, their states are not finite" if failed.any() else ""
