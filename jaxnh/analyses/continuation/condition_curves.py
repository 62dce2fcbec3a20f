"""Curves of cycles over two parameters that keep a condition: a duration, an extremum, an amplitude, or grazing.

Cycles to begin with are those on branches over the first axis, at some values of the second, where the condition is met
between two points. They are solutions of the flow by collocation (`orbits.collocation.conditions`); of a flow with
walls or surfaces those that meet none, which is where they graze.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from jaxnh.analyses.base import OptionError, Setting
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.continuation.cycle_points import FollowedCycles
from jaxnh.analyses.continuation.cycles import grow_cycles
from jaxnh.analyses.continuation.families import step_control
from jaxnh.analyses.continuation.family_tree import SeedOrbit
from jaxnh.analyses.options.orbits import CurvesOptions
from jaxnh.analyses.periodic.flow_cycles import cycle_size, flow_problem, no_collocation
from jaxnh.maps.section import Section, begin
from jaxnh.orbits.collocation.conditions import (
    AmplitudeCondition,
    DurationCondition,
    ExtremumCondition,
    Height,
    HeightValues,
    MeanCondition,
    first_point,
    refined_points,
)
from jaxnh.orbits.collocation.cycle_equations import CyclePoint, invariants, reversed_way
from jaxnh.orbits.collocation.equations import BoundarySolution
from jaxnh.orbits.collocation.fields import height_rates
from jaxnh.orbits.collocation.following import follow_cycles
from jaxnh.orbits.continuation.paths import CLOSED, STEPS, StepControl
from jaxnh.systems.observables import observable, observable_names, smooth_branch, surface_names
from jaxnh.systems.piecewise_smooth import PiecewiseSmooth

CONDITIONS = ("duration", "maximum", "minimum", "grazing", "amplitude", "mean", "exponent_sum")
"""Conditions by number."""

DURATION, MAXIMUM, MINIMUM, GRAZING, AMPLITUDE, MEAN, EXPONENT_SUM = range(len(CONDITIONS))

_TILE = 512
_NEAR = 5e-3  # of invariants, in sizes and widths: chords between points of a curve are nearer to it


class CycleCondition(NamedTuple):
    """A condition that is asked for: its kind, a number in `CONDITIONS`, the observable, and the value."""

    kind: int
    name: str
    value: float

    @property
    def words(self) -> str:
        """The condition in words."""
        if self.kind == GRAZING:
            return f"grazing of {self.name or 'any wall or surface'}"
        return f"{CONDITIONS[self.kind]}{self.name and f' of {self.name}'} = {self.value:g}"

    def asks_for(self, curve: ConditionCurve) -> bool:
        """Return whether a curve is of this condition, or of grazing the one of any surface."""
        return curve.condition == self or curve.condition._replace(name="") == self


class ConditionCurve(NamedTuple):
    """A curve of cycles that keep a condition, point by point.

    Attributes:
        condition: kept by them.
        period: returns of a cycle.
        values, errors: of both parameters, (k, 2).
        durations: (k,).
        multipliers: (k, e).
        ends: why it ends where it begins, and at its end, numbers in `continuation.paths.ENDS`.
        places: numbers that tell its cycles from others, (k, m).
    """

    condition: CycleCondition
    period: int
    values: Float[np.ndarray, "k 2"]
    errors: Float[np.ndarray, "k 2"]
    durations: Float[np.ndarray, " k"]
    multipliers: Complex[np.ndarray, "k e"]
    ends: tuple[int, int]
    places: Float[np.ndarray, "k m"]


def conditions_of(options: CurvesOptions) -> list[CycleCondition]:
    """The conditions that options ask for; of grazing one, whatever surfaces there are."""
    observed = (
        (MAXIMUM, options.maximum), (MINIMUM, options.minimum), (AMPLITUDE, options.amplitude), (MEAN, options.mean)
    )  # fmt: skip
    return [
        *([CycleCondition(DURATION, "", options.duration)] if options.duration else []),
        *(CycleCondition(kind, name, value) for kind, each in observed for name, value in (each or {}).items()),
        *([CycleCondition(GRAZING, "", 0.0)] if options.grazing else []),
        *([] if options.exponent_sum is None else [CycleCondition(EXPONENT_SUM, "", options.exponent_sum)]),
    ]


def check_conditions(options: CurvesOptions, setting: Setting) -> None:
    """Check that cycles of a flow may keep the conditions that are asked for."""
    flow, smooth = setting.flow, not isinstance(setting.flow, PiecewiseSmooth)
    for condition in conditions_of(options):
        key = CONDITIONS[condition.kind]
        if (smooth or condition.kind == DURATION) and (why := no_collocation(flow)):
            raise OptionError(f"{why}; leave {key} out", key)
        if condition.kind == DURATION and not setting.autonomous:
            raise OptionError("with a clock orbits take whole periods of it; leave duration out", key)
        if condition.kind == GRAZING and not surface_names(flow):
            raise OptionError("there is no jump and no switch to graze; leave grazing out", key)
        if condition.name and condition.name not in (known := observable_names(flow)):
            there = f"known are {', '.join(known)}" if known else "this system has none"
            raise OptionError(f"there is no observable {condition.name}; {there}", f"{key}.{condition.name}")


def condition_curves(
    options: CurvesOptions,
    batches: Sequence[LaneBatch],
    lanes: LaneRunner,
    waves: Sequence[Sequence[Sequence[SeedOrbit]]],
    unit: Float[np.ndarray, " d"],
    names: tuple[str, str],
    ends: tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]],
) -> list[ConditionCurve]:
    """All curves of cycles that keep a condition, each once.

    Args:
        options: of `curves`.
        batches: lanes along the first axis, at values of the second.
        lanes: runs lanes.
        waves: orbits of each batch to begin with.
        unit: size of motions in each section coordinate.
        names: of both parameters.
        ends: of their ranges.
    """
    first = next((seed for each in waves for wave in each for seed in wave), None)
    if first is None:
        return []
    steps, sides = step_control(options), _sides(batches[0], first)
    rows = [_on_one_side(batch, sides) for batch in batches]
    reach = (float(ends[0][0]), float(ends[1][0]))
    curves, plane = list[ConditionCurve](), None
    for row, seeds in zip(rows, waves, strict=True):
        second = float(row.p[names[1]][0])

        def stage(label: str, second: float = second) -> AbstractContextManager[None]:
            return lanes.stage(f"curves: {label} at {names[1]} = {second:g}", 0)

        many = steps._replace(max_steps=STEPS.max_steps)
        followed = grow_cycles(row, lanes, seeds, unit, options.max_period, reach, many, stage)
        for known in followed:
            size = cycle_size(row.system, known.branch.points[0].solution.path, unit)
            plane = plane or _CyclePlane(rows[0], lanes, names, ends, size, sides)
            for condition, equations in plane.conditions(conditions_of(options)):
                with stage(f"cycles with {condition.words}"):
                    curves += plane.new_curves(curves, known, second, condition, equations, steps)
    return curves


def _sides(batch: LaneBatch, seed: SeedOrbit) -> tuple[float, ...]:
    """The sides of walls and surfaces, +1 above and −1 below, that an orbit begins on."""
    flow = batch.flow
    p = {name: float(value[0]) for name, value in batch.at_values(np.array([seed.value])).p.items()}
    state = batch.chart.state(jnp.asarray(seed.points[0]))
    state = state.state if isinstance(batch.system, Section) else state
    return tuple(1.0 if observable(flow, name, 0.0, state, p) >= 0.0 else -1.0 for name in surface_names(flow))


def _on_one_side(batch: LaneBatch, sides: tuple[float, ...]) -> LaneBatch:
    """The batch with the field on these sides in place of one that walls and surfaces change; itself without any."""
    if not isinstance(batch.flow, PiecewiseSmooth):
        return batch
    smooth, system = smooth_branch(batch.flow, sides), batch.system
    start = smooth.start(dict(zip(smooth.coordinates, batch.without_section().start.y, strict=True)))
    if isinstance(system, Section):
        return replace(batch, system=replace(system, flow=smooth), start=begin(system, start))
    return replace(batch, system=smooth, start=start)


_Condition = DurationCondition | ExtremumCondition | MeanCondition


class _CyclePlane:
    """Cycles of a flow over the plane of two parameters; with a clock the time when they begin is another one.

    Args:
        batch: whose flow it is.
        lanes: runs lanes.
        names: of both parameters.
        ends: of their ranges.
        size: of cycles in each coordinate.
        sides: of walls and surfaces, on which the flow is.
    """

    def __init__(
        self,
        batch: LaneBatch,
        lanes: LaneRunner,
        names: tuple[str, str],
        ends: tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]],
        size: Float[np.ndarray, " d"],
        sides: tuple[float, ...],
    ) -> None:
        self._batch, self._lanes, self._names, self._ends, self._sides = batch, lanes, names, ends, sides
        widths, self._clock = ends[1] - ends[0], not batch.flow.autonomous
        widths = np.concatenate([[batch.flow.period / (2 * np.pi)] if self._clock else [], widths])
        self._problem = flow_problem(batch, lanes, size, names, widths, timed=self._clock)

    def conditions(self, asked: Sequence[CycleCondition]) -> list[tuple[CycleCondition, _Condition]]:
        """Conditions with their equations, of grazing one for each wall and surface."""
        surfaces = [
            (name, self._height(name), -side)
            for name, side in zip(surface_names(self._batch.flow), self._sides, strict=True)
        ]
        made = list[tuple[CycleCondition, _Condition]]()
        for condition in asked:
            if condition.kind == DURATION:
                made.append((condition, DurationCondition(condition.value)))
            elif condition.kind == GRAZING:
                for name, height, sign in surfaces:
                    guards = [(other, its) for key, other, its in surfaces if key != name]
                    equations = ExtremumCondition(self._problem, height, 0.0, sign, guards)
                    made.append((condition._replace(name=name), equations))
            else:
                guards = [(height, its) for _, height, its in surfaces]
                at = self._problem, self._height(condition.name), condition.value
                if condition.kind in (MEAN, EXPONENT_SUM):
                    made.append((condition, MeanCondition(*at, guards)))
                elif condition.kind == AMPLITUDE:
                    made.append((condition, AmplitudeCondition(*at, guards)))
                else:
                    made.append((condition, ExtremumCondition(*at, 1.0 if condition.kind == MAXIMUM else -1.0, guards)))
        return made

    def new_curves(
        self,
        there: Sequence[ConditionCurve],
        known: FollowedCycles,
        second: float,
        condition: CycleCondition,
        equations: _Condition,
        steps: StepControl,
    ) -> list[ConditionCurve]:
        """Curves that a branch of cycles at a value of the second parameter leads to, and that are not there yet."""
        curves = list[ConditionCurve]()
        for seed in self._seeds(known, second, equations):
            point = first_point(self._problem, equations.rotate_to_start(seed), known.lift, self._ends, equations)
            if point is None or any(
                other.condition == condition and self._passes(other, point, known.returns)
                for other in (*there, *curves)
            ):
                continue
            points, ends = self._both_ways(point, known.lift, equations, steps)
            refined = refined_points(self._problem, points, known.lift, equations)
            places = np.stack([self._place(passed.solution) for passed in points])
            curves.append(ConditionCurve(condition, known.returns, *refined, ends, places))
        return curves

    def _seeds(self, known: FollowedCycles, second: float, equations: _Condition) -> list[BoundarySolution]:
        """Points of a branch next to where a condition is met, with all parameters of the problem."""
        cycles = [self._over_plane(point.solution, second) for point in known.branch.points]
        excess = np.array([equations.excess(cycle) for cycle in cycles])
        with np.errstate(invalid="ignore"):
            changes = np.flatnonzero(excess[:-1] * excess[1:] <= 0.0)
        return [cycles[k + (abs(excess[k + 1]) < abs(excess[k]))] for k in changes.tolist()]

    def _over_plane(self, cycle: BoundarySolution, second: float) -> BoundarySolution:
        time = [0.0] if self._clock else []
        return cycle._replace(values=np.array([[*time, cycle.values[0, 0], second]]))

    def _both_ways(
        self, point: CyclePoint, lift: Float[np.ndarray, " d"], equations: _Condition, steps: StepControl
    ) -> tuple[list[CyclePoint], tuple[int, int]]:
        """Points of the curve from one end to the other, and why it ends."""
        ahead = follow_cycles(self._problem, point, lift, self._ends, steps, conditions=equations)
        if ahead.ends[1] == CLOSED:
            return ahead.points, (CLOSED, CLOSED)
        back = follow_cycles(self._problem, reversed_way(point), lift, self._ends, steps, conditions=equations)
        return [*back.points[:0:-1], *ahead.points], (back.ends[1], ahead.ends[1])

    def _place(self, cycle: BoundarySolution) -> Float[np.ndarray, " k"]:
        """Numbers that tell a cycle from others, wherever it begins."""
        return invariants(self._problem, cycle)[0, int(self._clock) :]

    def _passes(self, curve: ConditionCurve, point: CyclePoint, returns: int) -> bool:
        """Return whether a curve goes through a cycle."""
        if curve.period != returns:
            return False
        gaps = curve.places - self._place(point.solution)
        chords, starts = np.diff(gaps, axis=0), gaps[:-1]
        lengths = np.maximum(np.sum(chords**2, axis=1), np.finfo(float).tiny)
        shares = np.clip(-np.sum(starts * chords, axis=1) / lengths, 0.0, 1.0)
        return bool(np.linalg.norm(starts + shares[:, None] * chords, axis=1).min(initial=np.inf) <= _NEAR)

    def _height(self, name: str) -> Height:
        """An observable, the height of a wall or surface, or by no name the divergence, with derivatives."""
        batch, lanes, names, clock = self._batch, self._lanes, self._names, self._clock

        def height(u: np.ndarray, t: np.ndarray, values: np.ndarray) -> HeightValues:
            p, at = batch.parameters_at(names, values[:, -2:]), t + values[:, 0] if clock else t
            known = lanes(height_rates, (batch.flow,), (u, at, p), tile=_TILE, static=(name, names))
            value, by_state, by_values = map(np.asarray, known)
            return HeightValues(value, by_state, by_values if clock else by_values[..., 1:])

        return height
