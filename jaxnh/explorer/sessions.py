"""Sessions that compute views, each calibrated once for all views inside its ranges.

A session is calibrated over the whole range of the axes, and of every parameter that has been moved; a narrower range
is computed with its solver and steps, so that pictures of one place are of one map, whatever the range, and no zoom
compiles a program. A view beyond the ranges of a session gets another session, over both.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from jaxnh.analyses.batch import Axis
from jaxnh.config.values import with_values
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.progress import Progress
from jaxnh.engine.session import Session
from jaxnh.exceptions import InputError
from jaxnh.explorer import batch
from jaxnh.explorer.source import LaneReport, Parameter
from jaxnh.explorer.view import View
from jaxnh.solvers import SOLVERS

_CALIBRATED = 1024  # values of an axis that a session is calibrated over
_FEW = 16  # lanes of a tile where one lane is asked for
_FIRST_REPORT = ("portrait", "poincare", "period")
_SECOND_REPORT = ("period", "lyapunov", "chaos01", "verdict")
_SHIFTED = 1e3  # errors of one period: in a narrower range they may move what is seen


class CalibratedSession(NamedTuple):
    """A session and what it is calibrated for.

    Attributes:
        ends: of the axes and of the parameters that have been moved.
        target: as of a view.
        session: for views.
        few: the same for one lane.
    """

    ends: Mapping[str, tuple[float, float]]
    target: float | None
    session: Session
    few: Session

    def holds(self, view: View, moved: Mapping[str, float]) -> bool:
        """Return whether a view lies within."""
        wanted = {name: (value, value) for name, value in moved.items()} | dict(view.ranges)
        inside = set(wanted) <= set(self.ends) and all(
            self.ends[name][0] <= low and high <= self.ends[name][1] for name, (low, high) in wanted.items()
        )
        return inside and self.target == view.target


class Sessions:
    """Sessions of an experiment, made as views ask for them. All that computes is called in one thread.

    Attributes:
        content: the config, over the axes alone.
        own: analyses of the config, with options.
        dims: of the axes in results, by name.
        ends: of the axes.
        coordinates: of the start state.
        integrals: of the system, that starts are put on a level of.
        parameters: those that can be moved.
    """

    def __init__(
        self, experiment: Experiment, axes: Sequence[Axis], analyses: Sequence[str], progress: Progress
    ) -> None:
        """Nothing is computed yet.

        Args:
            axes: of the experiment, that views have; the others stay at their first values.
            analyses: that views may ask for.
            progress: of the sessions.
        """
        self._progress, self._user_file, self._analyses = progress, experiment.user_file, analyses
        self.coordinates = experiment.coordinates
        self.integrals = self._user_file.integrals if self._user_file else ()
        self.dims = {axis.name: axis.dim for axis in axes}
        self.ends = {axis.name: _whole(experiment, axis) for axis in axes}
        grids = {name: batch.even_axis(*ends, _CALIBRATED) for name, ends in self.ends.items()}
        others = {axis.name: float(axis.values[0]) for axis in experiment.axes if axis.name not in self.ends}
        content = batch.content_of(experiment)
        self.own: Mapping[str, Mapping[str, Any] | None] = content["analyses"] or {}
        base = batch.with_sweep(content, grids, self.own)
        self.content = with_values(base, others, self.coordinates, self.integrals)
        self._base = self._experiment(grids, None)
        self.parameters = tuple(self._movable())
        self._calibrated: list[CalibratedSession] = []

    @property
    def compiled(self) -> int:
        """Number of programs of the sessions, compiled or loaded."""
        return sum(known.session.programs + known.few.programs for known in self._calibrated)

    @property
    def error_estimate(self) -> float:
        """Error of one period of the session that was made last; NaN before the first."""
        return self._calibrated[0].session.plan.error_estimate if self._calibrated else np.nan

    def changed_parameters(self, view: View) -> dict[str, float]:
        """Parameters of a view with other values than the config says.

        Raises:
            InputError: there is no such parameter.
        """
        known = {parameter.name: parameter.value for parameter in self.parameters}
        for name in view.fixed:
            if name not in known:
                raise InputError(f"there is no parameter {name} to be moved; there are {', '.join(known)}")
        return {name: value for name, value in view.fixed.items() if value != known[name]}

    def of(self, view: View) -> CalibratedSession:
        """A session that holds for a view, calibrated now if there is none yet.

        Raises:
            InputError: the parameters do not go together.
        """
        moved = self.changed_parameters(view)
        for known in self._calibrated:
            if known.holds(view, moved) and set(known.ends) == {*view.ranges, *moved}:
                return known
        reach = {
            p.name: (min(p.low, moved[p.name]), max(p.high, moved[p.name])) for p in self.parameters if p.name in moved
        }
        seen = view.ranges
        axes = {name: (min(low, seen[name][0]), max(high, seen[name][1])) for name, (low, high) in self.ends.items()}
        try:
            calibrated = self._calibrate(view, axes, reach, moved)
        except InputError:  # the parameters do not go together over the whole of their ranges
            calibrated = self._calibrate(view, axes, {name: (value, value) for name, value in moved.items()}, moved)
        self._calibrated.insert(0, calibrated)
        return calibrated

    def lane(self, view: View, where: Mapping[str, float]) -> Iterator[LaneReport]:
        """Reports of a lane: portrait, strobe points and period, then spectrum and verdict, as far as there are any."""
        at = {**where, **self.changed_parameters(view)}
        few, groups = self.of(view).few, dict[str, xr.Dataset]()
        for names in (_FIRST_REPORT, _SECOND_REPORT):
            asked = {name: self.own.get(name) or {} for name in names if self.can_run(name)}
            groups |= few.groups(asked, **at) if asked else {}
            yield LaneReport(at, dict(groups), names is _SECOND_REPORT)

    def can_run(self, name: str) -> bool:
        """Return whether an analysis goes with the system, as none on a section does where none is given."""
        return goes_with(self._base, name, self.own.get(name))

    def batch_text(self, view: View, analyses: Mapping[str, Any], title: str) -> str:
        """The YAML of a batch job that computes a view again, bit for bit where its sums are plain ones."""
        known = next((old for old in self._calibrated if old.holds(view, self.changed_parameters(view))), None)
        plan = known.session.plan if known else None
        named = plan and plan.solver.name in SOLVERS and not plan.compensated
        solver = (plan.solver.name, plan.steps) if plan and named else None
        return batch.batch_text(self.content, view, analyses, self.coordinates, self.integrals, solver, title)

    def notes(self, view: View, known: CalibratedSession) -> tuple[str, ...]:
        """The accuracy of a picture, in words."""
        plan = known.session.plan
        over = ", ".join(f"{name} in {low:g}..{high:g}" for name, (low, high) in known.ends.items())
        notes = [f"{plan.solver.name}, {plan.steps} steps, error of one period {plan.error_estimate:.1g} over {over}"]
        if plan.solver.name not in SOLVERS:
            notes = [f"iterates of a map, error of one {plan.error_estimate:.1g} over {over}"]
        for name, (low, high) in view.ranges.items():
            if high - low < _SHIFTED * plan.error_estimate:
                notes.append(
                    f"{name} is seen more finely than {_SHIFTED:g} errors of one period: shapes are those of the "
                    "computed map, and their places move with the accuracy"
                )
        if view.deepest:
            notes.append("lanes are neighbouring doubles: there is nothing between them to zoom into")
        return tuple(notes)

    # ---- how

    def _experiment(self, grids: Mapping[str, Any], target: float | None) -> Experiment:
        content = batch.with_sweep(self.content, grids, {name: {} for name in self._analyses})
        if target is not None:
            content["accuracy"] = {**(content.get("accuracy") or {}), "target": target}
            content["accuracy"] = {k: v for k, v in content["accuracy"].items() if k not in ("solver", "steps")}
        return Experiment.from_content(content, self._user_file)

    def _movable(self) -> Iterator[Parameter]:
        """Parameters that a lane may have another value of."""
        flow = self._base.flow()
        for name, value in flow.parameters.items():
            try:
                self._base.variant(dict.fromkeys(self._analyses), {name: float(value)})  # pyright: ignore[reportArgumentType]
            except InputError:
                continue
            if name not in self.ends:
                number = float(value)  # pyright: ignore[reportArgumentType]
                ends = sorted((0.5 * number, 1.5 * number)) if number else (0.0, 1.0)
                yield Parameter(name, flow.readout.labels.long_names[name], number, *ends)

    def _calibrate(
        self,
        view: View,
        axes: Mapping[str, tuple[float, float]],
        reach: Mapping[str, tuple[float, float]],
        moved: Mapping[str, float],
    ) -> CalibratedSession:
        grids = {name: batch.even_axis(*ends, _CALIBRATED) for name, ends in axes.items()}
        grids |= {name: {"values": sorted({low, moved[name], high})} for name, (low, high) in reach.items()}
        session = Session(self._experiment(grids, view.target), progress=self._progress)
        _ = session.plan
        return CalibratedSession({**axes, **reach}, view.target, session, session.for_few_lanes(_FEW))


def goes_with(experiment: Experiment, name: str, options: Mapping[str, Any] | None) -> bool:
    """Return whether an analysis with these options suits an experiment."""
    try:
        experiment.variant({name: options or {}}, {})
    except InputError:
        return False
    return True


def _whole(experiment: Experiment, axis: Axis) -> tuple[float, float]:
    """Ends of an axis; of a saved view those that the page had before it was zoomed."""
    low, high = float(axis.values.min()), float(axis.values.max())
    saved = experiment.explore.whole.get(axis.name, (low, high)) if experiment.explore else (low, high)
    return min(low, *saved), max(high, *saved)
