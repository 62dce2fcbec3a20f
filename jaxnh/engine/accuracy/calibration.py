"""The solver and the steps a period that meet an accuracy, measured on sample lanes of the sweep itself.

Samples are taken in `samples`, sizes that errors are relative to in `sizes`, the reference in `reference`.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.engine.accuracy.diagnostics import explain_long_returns, explain_motion, explain_rounding, order_on_motion
from jaxnh.engine.accuracy.own_steps import SPLIT, TooDearError, agree, check_price, has_own_steps, spread_over_unit
from jaxnh.engine.accuracy.reference import MOST_KICKS, NO_MATTER, refine_reference, roundings_of_sums
from jaxnh.engine.accuracy.sample_maps import SampleMaps, Samples, differences, gaps_between
from jaxnh.engine.accuracy.samples import are_lost_by, take_samples
from jaxnh.engine.accuracy.sizes import sizes_by_name
from jaxnh.engine.accuracy.step_search import search_steps
from jaxnh.engine.accuracy.surface_jumps import field_jumps
from jaxnh.engine.axes import SweepPoints
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.exceptions import AccuracyError, LostLaneError
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.section import flow_of
from jaxnh.maps.single_precision import in_precision
from jaxnh.solvers import AdaptiveMethod, Solver
from jaxnh.solvers.runge_kutta import WrittenOutRungeKutta
from jaxnh.systems.rows import spread_indices

SAMPLED_LANES = 1024
"""Lanes of a sweep that a calibration looks at, at most."""

LEFT_OUT = 5e-5
"""Share of the periods looked at, that err most: half of the share that may miss the target."""

SAFETY = 2.0
"""The error is taken this many times: some lanes of the sweep have larger ones."""

MOST_REHEARSED = 1 << 13
"""Periods in which steps are to lose no lane, at most."""

_DEAR = 1 << 14  # evaluations of the field a period: those of fewer are not worth a look at other steps
_REHEARSING = 32  # lanes of which steps are to lose none
_MOST_PARTS = 1024  # of a unit of time that is too long for its rounding
_PRECISE = {
    "float64": 1e-6,
    "extended": 1e-6,
    "float32": 1e-1,
}  # an error below this that twice the steps do not halve is rounding


class Plan(NamedTuple):
    """A solver, its steps a period, whether its sums are compensated, and the error estimate of one period's map.

    Attributes:
        sizes: of the motion, by coordinate, that errors are relative to; none where they are absolute.
        parts: of a unit of time, of one of which the error is; a period or return is one.
        step_classes: of lanes that take a power of two fewer steps, as text (`step_classes`); "" where none does.
        rehearsed: periods in which its steps lose no sample lane; so many as are ever asked of violent motion where
            none is violent.
    """

    solver: Solver
    steps: int
    compensated: bool
    error_estimate: float
    sizes: Mapping[str, float] = {}
    parts: int = 1
    step_classes: str = ""
    rehearsed: int = MOST_REHEARSED

    def is_rehearsed(self, periods: float) -> bool:
        """Return whether its steps have been tried for runs of so many periods."""
        return self.rehearsed >= min(periods, MOST_REHEARSED)

    @property
    def kicks(self) -> int:
        """Evaluations of the field a period by a Runge–Kutta method; 0 by others, as that of tables."""
        return self.solver.stages * self.steps if isinstance(self.solver, WrittenOutRungeKutta) else 0


class Calibration:
    """Errors of one period's map on sample lanes: up to 1024 across the sweep, over the first 170 periods of each.

    The error of a map in a period is the largest difference of any component from a reference that is refined until it
    changes no more, in units of the size of the motion in that component; of the paper's particle, of (q, n) as they
    are. The estimate is twice that which one in 20,000 of all those periods exceeds, the
    largest one where they are fewer: of the periods of lanes one in 10,000 may err by more
    (tests/hard/test_accuracy_contract.py). Chaotic motion passes ever nearer to states that enlarge every error, at a
    distance δ about 1/δ times, so that samples tell no bound of the largest error; of a share of the periods they do.

    Every period is taken with two numbers of steps first. Samples are those that differ most, and all lanes at a few
    times. The reference is in float64 whatever the `precision` of the map. No error is given that is below what the
    reference itself is known to, and of plain sums none below what their rounding does to the most sensitive samples.

    Attributes:
        floor: how far apart the two finest references are: what rounding leaves, or the steps that there can be.
        sizes: of the motion, by coordinate; none where errors are absolute.
        passes_jumps: whether the solver asked for takes each lane by steps of its own across surfaces where the field
            jumps: errors of such steps are none of a smooth map, and tangents along them miss the jump.
    """

    def __init__(
        self,
        rows: Sequence[SweepPoints],
        lanes: LaneExecutor,
        precision: str = "float64",
        target: float | None = None,
        sizes: Mapping[str, float] | None = None,
        solver: Solver | None = None,
    ) -> None:
        """Measure the reference.

        Args:
            rows: sample lanes, those of each value of the shared axes together.
            target: the only one that will be asked for: the reference is then refined as far as it needs.
            sizes: of the motion, by coordinate, in place of those measured.
            solver: the only one that will be asked for.

        Raises:
            AccuracyError: no lane has a period that can be computed.
        """
        self._precision, self._rows, self._given, self._target = precision, rows, sizes or {}, target or 0.0
        self.passes_jumps = False
        maps = SampleMaps([row.system for row in rows], lanes)
        if isinstance(solver, AdaptiveMethod):
            self._measure(maps.with_own_steps(), (solver,))
            self.passes_jumps = any(field_jumps(maps, self._samples))
            return
        try:
            self._measure(maps)
        except TooDearError as dear:
            ways = [False] if dear.stiff else [True, False]
            own = any(self._take_own_steps(maps, explicit=way, kicks=dear.kicks) for way in ways)
            if not own or self.floor > self._target:
                self._measure_at_any_price(maps)
        except LostLaneError:
            if not self._take_own_steps(maps):
                raise

    def _measure(self, maps: SampleMaps, candidates: Sequence[Solver] = (), *, at_any_price: bool = False) -> None:
        """Take samples and measure the reference by maps of one way to integrate.

        Args:
            candidates: solvers to choose from, by default those of the way.
            at_any_price: whether steps that all lanes share are taken where each lane's own are fewer.
        """
        self._maps, self._at_any_price = maps, at_any_price
        flow, scheme = maps.flow, maps.scheme
        # Without a clock every step starts and ends by itself: no processor around many, no sums over them.
        solvers = candidates or scheme.solvers(flow, self._precision)
        self._candidates = tuple(s for s in solvers if not (flow.autonomous and s.processor[1]))
        self._summations = (False,) if flow.autonomous else scheme.summations
        paths = take_samples(maps, self._rows, self._given, self._pay)
        self._samples, looked_at, self._sizes, self._start, self._violent = paths
        self.sizes = sizes_by_name(maps.flows[0], self._sizes)
        self._left_out = int(LEFT_OUT * looked_at)
        self._measure_reference()
        while self._reference.unresolved and self._split_unit():
            pass

    def _measure_at_any_price(self, maps: SampleMaps) -> None:
        try:
            self._measure(maps, at_any_price=True)
        except LostLaneError:
            if not self._take_own_steps(maps, explicit=True):
                raise

    def _take_own_steps(self, maps: SampleMaps, *, explicit: bool = False, kicks: int = 0) -> bool:
        """Measure everything anew with steps of a lane's own, implicit ones as stiff flows and corners need them.

        Where chaos enlarges rounding beyond the target in a unit of time, parts of it are tried as long as they help.

        Args:
            kicks: evaluations of the field a period with which common steps were too dear, and do well enough to tell
                whether own ones have the same motions.

        Returns:
            Whether it helps: not where that is tried already, or is for no flow of this kind.
        """
        if not has_own_steps(maps, self._precision):
            return False
        maps.tell("each lane takes steps of its own: those that all lanes share do not do, or take longer")
        try:
            self._measure(maps.with_own_steps(explicit=explicit))
            before_it = self._maps, self._reference, self._samples, self._sizes
            tangents_jump = field_jumps(maps, self._samples)[1]
            if tangents_jump or (kicks and not agree(*before_it, maps, kicks, self._target)):
                return False
            before = math.inf
            while 0.0 < self._target < self.floor <= 0.5 * before:
                before = self.floor
                if not self._split_unit():  # an infinite floor is never less than before
                    break
        except AccuracyError:
            return False
        return True

    def _pay(self, kicks: int, samples: Samples, worst: int = -1) -> None:
        """Look whether so many evaluations of the field a period, of steps that all lanes share, are worth it.

        They are in any case where the field jumps on the sample that errs most, whose number may be given.

        Raises:
            TooDearError: each lane's own steps do with far fewer.
        """
        free = self._at_any_price or not self._target or self._maps.parts > 1
        if kicks < _DEAR or free or not has_own_steps(self._maps, self._precision):
            return
        try:
            check_price(self._maps, samples, kicks, self._target)
        except TooDearError:
            if worst < 0 or not self._jumps_at(worst):
                raise

    def _jumps_at(self, sample: int) -> bool:
        """Return whether the field jumps on a sample's motion: the map's tangents know nothing of a jump."""
        if self._maps.adaptive or self._maps.scheme.smooth:
            return False
        return order_on_motion(self._maps, self._samples.take_lanes(np.array([sample])), located=False) <= 1

    def error(self, solver: Solver, steps: int, *, compensated: bool = False) -> float:
        """Error estimate of one period with so many steps; infinite where a state is not finite."""
        return self._largest(self._errors(solver, steps, compensated))

    def cheapest(self, target: float, is_short: Callable[[Plan], bool] | None = None) -> Plan:
        """The solver and steps with the fewest kicks whose error is at most the target.

        Args:
            is_short: whether a plan is done before another could be looked for; then that of the reference, which is a
                Runge–Kutta method and compiled already, is good enough.

        Raises:
            AccuracyError: none meets it; the message names the smallest error measured.
        """
        refusal = ""
        while True:
            plan, errors = self._cheapest(target, is_short)
            if plan is not None:
                each = 1 if self._maps.adaptive else self._maps.parts  # the steps of a lane's own say how fine they are
                steps = -(-plan.steps // each) * each
                return plan._replace(steps=steps, parts=self._maps.parts, sizes=self.sizes)
            why, by_rounding = self._explain(target, errors)
            if by_rounding and self._split_unit():
                continue
            refusal = refusal or why
            if by_rounding or self._jumps_at(self._largest_at(errors)) or not self._take_own_steps(self._maps):
                raise AccuracyError(refusal)

    def rehearse(self, plan: Plan, periods: int) -> Plan:
        """The plan with explicit steps of a lane's own, or as many as lose no sample lane within so many periods.

        Of lanes whose motion stays finite. Samples tell no bound of how violent a motion may become, and lanes once
        lost do not come back. Tried where steps that were right in the first periods lost lanes in later ones, and by a
        handful of lanes.
        """
        if not self._violent or self._maps.adaptive or self._maps.parts > 1:
            return plan
        if not self._maps.sectioned and (own := self._own_plan(plan.solver.total_kicks(plan.steps))):
            return own
        few = self._start.take_lanes(spread_indices(len(self._start.row), _REHEARSING))
        steps, periods = plan.steps, min(periods, MOST_REHEARSED)
        while are_lost_by(self._maps, few, plan.solver, steps, periods):
            if 2 * steps > plan.solver.most_steps(MOST_KICKS):
                self._maps.tell(f"even {steps:,} steps lose a lane in {periods:,} periods; such lanes are marked")
                return plan._replace(rehearsed=periods)
            steps *= 2
        error = plan.error_estimate if steps == plan.steps else self.error(plan.solver, steps)
        return plan._replace(steps=steps, error_estimate=error, rehearsed=periods)

    def _own_plan(self, kicks: int) -> Plan | None:
        """The plan with explicit steps of a lane's own, in place of common ones of so many evaluations of the field."""
        other = copy.copy(self)
        try:
            taken = self._target and other._take_own_steps(self._maps, explicit=True, kicks=kicks)
            return other.cheapest(self._target) if taken else None
        except AccuracyError:
            return None

    def _cheapest(
        self, target: float, is_short: Callable[[Plan], bool] | None
    ) -> tuple[Plan | None, Float[np.ndarray, " samples"]]:
        """The plan with the fewest kicks, or none; and then the least errors that there are."""
        if self.floor > target:
            return None, self._reference.known
        first = self._maps.scheme.reference
        nearest = Plan(first, self._maps.scheme.first_steps, False, math.inf)
        if is_short and isinstance(first, WrittenOutRungeKutta):
            plan = self._best(first, target, MOST_KICKS, compensated=False)
            if plan.error_estimate <= target and is_short(plan):
                return plan, self._reference.known
        by_order = sorted(self._candidates, key=lambda s: (abs(s.convergence_order - 8), not s.processor[1]))
        highest = max(solver.convergence_order for solver in by_order)
        for compensated in self._summations:
            best, most = None, MOST_KICKS
            for solver in by_order:
                if best is None and solver.convergence_order < min(6, highest):
                    break  # where no high order meets the target, no low one does
                plan = self._best(solver, target, most, compensated=compensated)
                nearest = min(nearest, plan, key=lambda p: p.error_estimate)
                if plan.error_estimate <= target:
                    best, most = plan, solver.total_kicks(plan.steps) - 1
            if best is not None:
                return best, self._reference.known
        return None, self._errors(*nearest[:3])

    def _measure_reference(self) -> None:
        """Measure the reference."""
        args = self._maps, self._samples, self._sizes
        self._reference = refine_reference(*args, self._target, self._largest_at, self._pay)
        self.floor = self._largest(self._reference.known)
        self._tables, self._rounding = roundings_of_sums(*args, self._reference.kicks, self._largest), -math.inf

    def _rounding_of_sums(self, error: float) -> float:
        """The rounding of plain sums in the worst of a few tables, of so many as it takes to compare with an error.

        Measured when it is first asked for: not where no map meets the target.
        """
        while not 0.0 <= self._rounding < NO_MATTER * max(error, self._target):
            if (rounding := next(self._tables, None)) is None:
                break
            self._rounding = max(self._rounding, rounding)
        return self._rounding

    def _split_unit(self) -> bool:
        """Take parts of the unit of time in place of it, as its motion enlarges even rounding too much; or no more.

        The unit is the user's, and says nothing of how fast the motion enlarges what is small.
        """
        parts = SPLIT * self._maps.parts
        if not self._maps.may_be_cut or parts > _MOST_PARTS:
            return False
        self._maps = self._maps.in_parts(parts)
        if self._maps.adaptive:
            self._samples = spread_over_unit(self._maps, self._reference, self._samples)
        self._maps.tell(f"rounding grows beyond the target in a unit of time; errors are of 1/{parts} of it")
        self._measure_reference()
        return True

    def _explain(self, target: float, errors: Float[np.ndarray, " samples"]) -> tuple[str, bool]:
        """Explain why the least errors there are exceed the target, and whether by rounding."""
        worst, parts = self._largest_at(errors), self._maps.parts
        error, sample = float(errors[worst]), self._samples.take_lanes(np.array([worst]))
        system = self._maps.flows[int(sample.row[0])]
        flow, what, why = flow_of(system), "one period", ""
        length = flow.period / parts
        if self._maps.sectioned:
            lengths = np.abs(self._reference.image[-1] - self._samples.states.t)
            what, why = "one return", explain_long_returns(system, lengths, worst)
            length = float(lengths[worst]) if np.isfinite(lengths[worst]) else length
        elif flow.autonomous:
            what = "one unit of time" if parts == 1 else f"1/{parts} of a unit of time"
        cause = "" if self._maps.adaptive else explain_motion(self._maps, sample, length)
        rounding = "" if cause else explain_rounding(self._maps, sample, self._sizes, error)
        relative = ", relative to the size of the motion," if self.sizes else ""
        hint = "".join(f"; {words}" for words in (why, cause, rounding) if words)
        return (
            f"no solver has an error of {what} of {target:g} over this sweep; with up to {self._maps.tried:,} "
            f"evaluations of the field, that{relative} at {sample.place(0)} comes down to {error:.2g}{hint}",
            bool(rounding),
        )

    def _best(self, solver: Solver, target: float, most_kicks: int, *, compensated: bool) -> Plan:
        """The plan of one solver with the fewest steps that meet the target, or else the one of the least error."""
        most, first = solver.most_steps(most_kicks), max(2, solver.most_steps(max(2048, self._reference.kicks // 4)))
        tried = search_steps(
            lambda steps: self.error(solver, steps, compensated=compensated),
            target,
            first,
            most,
            float(solver.convergence_order),
            _PRECISE[self._precision],
        )
        plans = [Plan(solver, steps, compensated, error) for steps, error in tried]
        meeting = [plan for plan in plans if plan.error_estimate <= target]
        none = Plan(solver, 1, compensated, math.inf)
        return min(meeting, key=lambda p: p.steps) if meeting else min([*plans, none], key=lambda p: p.error_estimate)

    def _errors(self, solver: Solver, steps: int, compensated: bool) -> Float[np.ndarray, " samples"]:
        """Error estimate of every sample."""
        maps = self._maps.of(solver, steps, compensated=compensated)

        def strobe(row: int) -> ReturnMap:
            return in_precision(maps(row), self._precision)

        apart = differences(self._maps.image(strobe, self._samples), self._reference.image)
        gaps = gaps_between(apart, self._sizes)
        chance = 0.0 if compensated else self._rounding_of_sums(self._largest(gaps))
        return np.maximum(SAFETY * np.maximum(gaps, chance), self._reference.known)

    def _largest_at(self, errors: Float[np.ndarray, " samples"]) -> int:
        """The sample of the largest error but for the share of all periods that is left out."""
        return int(np.argsort(errors, kind="stable")[-1 - min(self._left_out, len(errors) - 1)])

    def _largest(self, errors: Float[np.ndarray, " samples"]) -> float:
        return float(errors[self._largest_at(errors)])
