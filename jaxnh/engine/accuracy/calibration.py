"""The solver and the steps a period that meet an accuracy, measured on sample lanes of the sweep itself."""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnh.engine.accuracy.diagnostics import (
    ROUGH,
    explain_long_returns,
    explain_motion,
    explain_slow_convergence,
    fault_of,
)
from jaxnh.engine.axes import SweepPoints
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.exceptions import AccuracyError
from jaxnh.maps.build import make_return_map, scheme_of
from jaxnh.maps.iterate import iterate
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.section import Crossing, Section
from jaxnh.maps.single_precision import in_precision
from jaxnh.solvers import Solver
from jaxnh.solvers.runge_kutta import WrittenOutRungeKutta, in_loop
from jaxnh.systems.flow import Parameters
from jaxnh.systems.state import State, error_components

SAMPLED_LANES = 1024
"""Lanes of a sweep that a calibration looks at, at most."""

_CALLS, _PERIODS = 10, 17  # calls, and periods in each, in which sampled lanes are followed from the start
_AT_REST = 1e-6  # of a lane's fastest crossing
_ALL_LANES_AT = (0, 12, 169)  # periods after the start at which every lane gives a sample
_MOST_SENSITIVE = 512  # of all periods on the way: far more than the share that is left out
_LEFT_OUT = 5e-5  # of the periods looked at, that err most: half of the share that may miss the target
_SAFETY = 2.0  # the error is taken this many times: some lanes of the sweep have larger ones
_REFERENCE_STEPS = 96
_ROUNDING = 1e-12  # references nearer to each other than this are the same
_NEAR = 0.1  # of the target: nearer references are not needed, as the error is taken twice
_STALLED = 2  # refinements in a row that do not halve the distance: what is left is rounding
_SEED_ERROR = 1e-3  # sample states need not be accurate, but of this very system
_MOST_SEED_KICKS = 1 << 16
_ROUNDS = 8
_TABLES = 4  # that the rounding of plain sums is measured on
_PRECISE = {
    "float64": 1e-6,
    "extended": 1e-6,
    "float32": 1e-1,
}  # an error below this that more steps do not halve is rounding
_MOST_KICKS = 1 << 20
_HOPELESS = 1 << 17  # kicks: what does not converge by now may have corners, and is given little more time
_MAPS_KEPT = 64  # of flows, while a number of steps is looked at
_SILENT_SECONDS = 10.0
_PATIENT = 5  # refinements, as corners let the distance fall unevenly


class Plan(NamedTuple):
    """A solver, its steps a period, whether its sums are compensated, and the error estimate of one period's map."""

    solver: Solver
    steps: int
    compensated: bool
    error_estimate: float


class _Samples(NamedTuple):
    """Sample states of lanes, at several times, of one flow or of several.

    Attributes:
        states: components (samples,).
        p: parameters of the lane, each (samples,).
        row: number of the flow, (samples,).
        where: value of every axis, each (samples,).
    """

    states: State
    p: Parameters
    row: Int[np.ndarray, " samples"]
    where: Mapping[str, Float[np.ndarray, " samples"]]

    def take(self, subset: Int[np.ndarray, " subset"]) -> _Samples:
        """Return a subset of the samples."""
        return jax.tree.map(lambda leaf: leaf[subset], self)


class Calibration:
    """Errors of one period's map on sample lanes: up to 1024 across the sweep, over the first 170 periods of each.

    The error of a map in a period is the largest difference of any component of (q, n) from a reference that is
    refined until it changes no more. The estimate is twice that which one in 20,000 of all those periods exceeds, the
    largest one where they are fewer: of the periods of lanes one in 10,000 may err by more
    (tests/hard/test_accuracy_contract.py). Chaotic motion passes ever nearer to states that enlarge every error, at a
    distance δ about 1/δ times, so that samples tell no bound of the largest error; of a share of the periods they do.

    Every period is taken with two numbers of steps first. Samples are those that differ most, and all lanes at a few
    times. The reference is in float64 whatever the `precision` of the map. No error is given that is below what the
    reference itself is known to, and of plain sums none below what their rounding does to the most sensitive samples.

    Attributes:
        floor: how far apart the two finest references are: what rounding leaves, or the steps that there can be.
    """

    def __init__(
        self, rows: Sequence[SweepPoints], lanes: LaneExecutor, precision: str = "float64", target: float | None = None
    ) -> None:
        """Measure the reference.

        Args:
            rows: sample lanes, those of each value of the shared axes together.
            target: the only one that will be asked for: the reference is then refined as far as it needs.

        Raises:
            AccuracyError: no lane has a period that can be computed.
        """
        self._flows = [row.system for row in rows]
        self._lanes, self._precision = lanes, precision
        self._tried = 0  # kicks of the finest map that was looked at
        self._said = time.monotonic()
        self._fall: list[tuple[int, float]] = []  # kicks, and how far apart references of so many and of fewer are
        self._near = max(_ROUNDING, _NEAR * (target or 0.0))
        flow = self._flows[0].flow
        self._way = way = scheme_of(flow)
        # Without a clock every step starts and ends by itself: no processor around many, no sums over them.
        solvers = way.solvers(flow, precision)
        self._candidates = tuple(s for s in solvers if not (flow.autonomous and s.processor[1]))
        self._summations = (False,) if flow.autonomous else way.summations
        self._samples, looked_at = self._take_samples(rows)
        self._left_out = int(_LEFT_OUT * looked_at)
        self._drop_lost()
        self._reference, self._known, self._enough = self._refine()
        self.floor = self._largest(self._known)
        self._rounding = self._rounding_of_sums()

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
        if self.floor > target:
            raise self._refusal(target, self._known)
        nearest = Plan(self._way.reference, _REFERENCE_STEPS, False, math.inf)
        if is_short and isinstance(self._way.reference, WrittenOutRungeKutta):
            reference = self._best(self._way.reference, target, _MOST_KICKS, compensated=False)
            if reference.error_estimate <= target and is_short(reference):
                return reference
        by_order = sorted(self._candidates, key=lambda s: (abs(s.convergence_order - 8), not s.processor[1]))
        for compensated in self._summations:
            best, most = None, _MOST_KICKS
            for solver in by_order:
                if best is None and solver.convergence_order < 6:
                    break  # where no high order meets the target, no low one does
                plan = self._best(solver, target, most, compensated=compensated)
                nearest = min(nearest, plan, key=lambda p: p.error_estimate)
                if plan.error_estimate <= target:
                    best, most = plan, solver.total_kicks(plan.steps) - 1
            if best is not None:
                return best
        raise self._refusal(target, self._errors(*nearest[:3]))

    def _refusal(self, target: float, errors: Float[np.ndarray, " samples"]) -> AccuracyError:
        """Explain why the least errors there are exceed the target."""
        worst = self._largest_at(errors)
        where = _place(self._samples, worst)
        sample = jax.tree.map(lambda leaf: leaf[worst], self._samples)
        system = self._flows[int(sample.row)]
        what, hint, length = "period", "", system.flow.period
        if system is not system.flow:
            lengths = np.abs(self._reference[-1] - self._samples.states.t)
            what, hint = "return", explain_long_returns(lengths, worst)
            length = float(lengths[worst]) if np.isfinite(lengths[worst]) else length
        hint += explain_motion(system, sample.states, sample.p, length) or explain_slow_convergence(self._fall)
        return AccuracyError(
            f"no solver has an error of one {what} of {target:g} over this sweep; with up to {self._tried:,} kicks, "
            f"that at {where} comes down to {errors[worst]:.2g}{hint}"
        )

    def _best(self, solver: Solver, target: float, most_kicks: int, *, compensated: bool) -> Plan:
        """The plan of one solver with the fewest steps that meet the target, or else the one of the least error."""
        plans = list(self._search(solver, target, solver.most_steps(most_kicks), compensated))
        meeting = [plan for plan in plans if plan.error_estimate <= target]
        none = Plan(solver, 1, compensated, math.inf)
        return min(meeting, key=lambda p: p.steps) if meeting else min([*plans, none], key=lambda p: p.error_estimate)

    def _search(self, solver: Solver, target: float, most: int, compensated: bool) -> Iterator[Plan]:
        """Plans of one solver on the way to the fewest steps that meet the target; nothing above `most` steps."""
        if most < 1:
            return
        failed, met = 0, most + 1
        steps = min(most, max(2, solver.most_steps(max(2048, self._enough // 4))))
        previous, order = math.inf, float(solver.convergence_order)
        tried: dict[int, float] = {}
        for _ in range(_ROUNDS):
            error = self.error(solver, steps, compensated=compensated)
            yield Plan(solver, steps, compensated, error)
            if failed and error > target:
                order = _effective_order(failed, tried[failed], steps, error, order)
            tried[steps] = error
            if error <= target:
                met = min(met, steps)
            else:
                failed = max(failed, steps)
                if steps == most or (error > 0.5 * previous and error < _PRECISE[self._precision]):
                    return  # no better than a cheaper solver, or rounding
                previous = error
            factor = (error / (0.9 * target)) ** (1.0 / order) if 0 < error < math.inf else 2.0
            guess = math.ceil(steps * min(max(factor, 0.3), 4.0))
            steps = min(max(guess, failed + 1), met - 1, most)
            if steps <= failed or met - steps <= met // 50:
                return

    def _errors(self, solver: Solver, steps: int, compensated: bool) -> Float[np.ndarray, " samples"]:
        """Error estimate of every sample."""
        maps = self._maps(solver, steps, compensated=compensated)

        def strobe(row: int) -> ReturnMap:
            return in_precision(maps(row), self._precision)

        chance = 0.0 if compensated else self._rounding
        return np.maximum(
            _SAFETY * np.maximum(_gaps(self._image(strobe, self._samples), self._reference), chance), self._known
        )

    def _largest_at(self, errors: Float[np.ndarray, " samples"]) -> int:
        """The sample of the largest error but for the share of all periods that is left out."""
        return int(np.argsort(errors, kind="stable")[-1 - min(self._left_out, len(errors) - 1)])

    def _largest(self, errors: Float[np.ndarray, " samples"]) -> float:
        return float(errors[self._largest_at(errors)])

    def _take_samples(self, rows: Sequence[SweepPoints]) -> tuple[_Samples, int]:
        """States across the sweep from the start towards the attractor, and how many they were chosen from."""
        number = np.concatenate([np.full(len(jax.tree.leaves(row.start)[0]), i) for i, row in enumerate(rows)])
        start, p, where = (
            jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
            for parts in zip(*((row.start, dict(row.p), dict(row.where)) for row in rows), strict=True)
        )
        now = _Samples(start, p, number, where)
        self._roughly = steps = self._seed_steps(now)
        finer, coarser = (self._maps(self._way.reference, n) for n in (steps, max(1, steps // 2)))
        states, gaps = [], []
        for _ in range(_CALLS):
            met = [now.states]
            for _ in range(_PERIODS):
                met.append(
                    self._by_flow(iterate, lambda row: (finer(row), np.int32(1)), now._replace(states=met[-1]), 1)
                )
            before, following = (jax.tree.map(lambda *z: np.stack(z, axis=1), *part) for part in (met[:-1], met[1:]))
            states.append(before)
            gaps.append(self._differing(coarser, now._replace(states=before), following))
            now = now._replace(states=met[-1])
        whole = jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=1), *states)  # (lanes, periods)
        sensitive = np.concatenate(gaps, axis=1)
        sensitive = np.where(np.isfinite(sensitive), sensitive, -1.0)
        sensitive[:, _ALL_LANES_AT] = np.inf
        escaping = _is_escaping(whole)
        if not np.all(escaping):
            sensitive[escaping] = -1.0
        count = min(_MOST_SENSITIVE + len(number) * len(_ALL_LANES_AT), int(np.sum(~escaping)) or sensitive.size)
        chosen = np.sort(np.argsort(-sensitive, axis=None, kind="stable")[:count])
        moving = chosen[~self._at_rest(now._replace(states=whole)).ravel()[chosen]]
        lane, time = np.divmod(moving if len(moving) else chosen, sensitive.shape[1])
        taken = jax.tree.map(lambda leaf: leaf[lane], now)
        return taken._replace(states=jax.tree.map(lambda leaf: leaf[lane, time], whole)), sensitive.size

    def _differing(
        self, maps: Callable[[int], ReturnMap], samples: _Samples, images: State
    ) -> Float[np.ndarray, "lanes periods"]:
        """Return how far maps take states (lanes, periods) from images of theirs."""
        periods = jax.tree.leaves(images)[0].shape[1]
        lane = np.repeat(np.arange(len(samples.row)), periods)
        each = samples.take(lane)._replace(states=jax.tree.map(np.ravel, samples.states))
        theirs = jax.tree.leaves(error_components(jax.tree.map(np.ravel, images)))
        return _gaps(self._image(maps, each), theirs).reshape(-1, periods)

    def _at_rest(self, samples: _Samples) -> Bool[np.ndarray, "samples periods"]:
        """Return where lanes cross their section so slowly that they rest on it: their time is then no number."""
        if self._flows[0] is self._flows[0].flow:
            return np.zeros(jax.tree.leaves(samples.states)[0].shape, bool)
        speed = np.abs(self._by_flow(_crossing_rates, lambda row: (self._flows[row],), samples, 0))
        return speed < _AT_REST * np.max(speed, axis=1, initial=0.0, where=np.isfinite(speed), keepdims=True)

    def _drop_lost(self) -> None:
        """Leave out samples that overflow whatever the steps, as those of an absurd b: their lanes are marked failed.

        Raises:
            AccuracyError: there are no others.
        """
        image = self._image(self._maps(self._way.reference, max(_REFERENCE_STEPS, self._roughly)), self._samples)
        kept = np.flatnonzero(np.all(np.isfinite(image), axis=0))
        if not len(kept):
            first = jax.tree.map(lambda leaf: leaf[0], self._samples)
            why = fault_of(self._flows[int(first.row)], first.states, first.p)
            why = why and f"; at {_place(self._samples, 0)} {why}"
            raise AccuracyError(f"every lane of this sweep has a non-finite state within a period{why}")
        self._samples = self._samples.take(kept)

    def _tell(self, text: str) -> None:
        """Report the progress of a long calibration."""
        if time.monotonic() - self._said > _SILENT_SECONDS:
            self._said = time.monotonic()
            self._lanes.note(f"accuracy: {text}")

    def _seed_steps(self, samples: _Samples) -> int:
        """Steps with which the first period is roughly right."""
        solver, steps = self._way.reference, self._way.rough_steps
        image = self._image(self._maps(solver, steps), samples)
        while 2 * steps * solver.stages <= _MOST_SEED_KICKS:
            self._tell(f"the start states with {2 * steps * solver.stages:,} kicks a period")
            coarser, image = image, self._image(self._maps(solver, 2 * steps), samples)
            gaps = _gaps(coarser, image)
            lost = ~np.isfinite(gaps)  # by so few steps, where so are all, or for ever
            if not np.all(lost) and np.all(lost | (gaps < _SEED_ERROR)):
                break
            steps *= 2
        return steps

    def _refine(self) -> tuple[list[np.ndarray], Float[np.ndarray, " samples"], int]:
        """The finest map worth having, its distance from the one before in each sample, and its kicks a period.

        Each sample is refined until rounding is all that is left, most of them a few times only: until twice in a row
        the distance is not half of the least so far. Once says little, as convergence begins unevenly in fast motion.
        Of one target no more is asked than that all are near enough for it.
        """
        solver, steps = self._way.reference, _REFERENCE_STEPS
        finest = self._image(self._maps(solver, steps, compensated=True), self._samples)
        gaps, least = np.full((2, len(self._samples.row)), np.inf)
        stalled = np.zeros(len(gaps), int)
        while 1.5 * steps * solver.stages <= _MOST_KICKS:
            hopeless = steps * solver.stages > _HOPELESS and not self._way.smooth  # fast smooth motion still converges
            patience = np.where(gaps > ROUGH, _PATIENT if hopeless else np.inf, _STALLED)
            open_ = np.flatnonzero((gaps > _ROUNDING) & (stalled < patience))
            # One small distance may be chance, as where the corner of a field lies in a step: all of them are not.
            if not len(open_) or self._largest(gaps) <= self._near:
                break
            steps = steps * 3 // 2
            finer = self._image(self._maps(solver, steps, compensated=True), self._samples.take(open_))
            gaps[open_] = _gaps([leaf[open_] for leaf in finest], finer)
            stalled[open_] = np.where(gaps[open_] < 0.5 * least[open_], 0, stalled[open_] + 1)
            least = np.minimum(least, gaps)
            for leaf, new in zip(finest, finer, strict=True):
                leaf[open_] = new
            self._fall.append((steps * solver.stages, self._largest(gaps)))
            self._tell(f"with {self._fall[-1][0]:,} kicks a period, references differ by {self._fall[-1][1]:.1e}")
        return finest, gaps, steps * solver.stages

    def _rounding_of_sums(self) -> float:
        """Error that plain sums cost the most sensitive samples, in the worst of a few tables.

        The roundings of one table may happen to be small in it; those of the lanes of the sweep will not all be.
        """
        solver, worst = self._way.reference, 0.0
        for steps in (max(_REFERENCE_STEPS, self._enough // (2 * solver.stages)) + i for i in range(_TABLES)):
            plain, exact = (self._image(self._maps(solver, steps, compensated=c), self._samples) for c in (False, True))
            gaps = _gaps(plain, exact)
            worst = max(worst, self._largest(np.where(np.isfinite(gaps), gaps, 0.0)))
        return worst

    def _maps(self, solver: Solver, steps: int, *, compensated: bool = False) -> Callable[[int], ReturnMap]:
        """The maps of all flows, by their numbers."""
        if isinstance(solver, Solver):  # and none of diffrax, as costs has them beside ours
            self._tried = max(self._tried, solver.total_kicks(steps))

        @functools.lru_cache(_MAPS_KEPT)
        def of(row: int) -> ReturnMap:
            return make_return_map(self._flows[row], in_loop(solver), steps, compensated=compensated)

        return of

    def _by_flow(
        self,
        function: Callable[..., Any],
        maps: Callable[[int], tuple[Any, ...]],
        samples: _Samples,
        periods: int,
        static: tuple[Any, ...] = (),
    ) -> Any:
        """function(*maps, state, p, *static) of every sample, with the maps of its own flow; periods a lane."""
        whole: Any = None
        for k in np.unique(samples.row):
            members = np.flatnonzero(samples.row == k)
            part = samples.take(members)
            values = self._lanes(function, maps(int(k)), (part.states, part.p), periods=periods, static=static)
            if len(members) == len(samples.row):
                return values
            if whole is None:
                whole = jax.tree.map(lambda leaf: np.empty((len(samples.row), *leaf.shape[1:]), leaf.dtype), values)
            for leaf, new in zip(jax.tree.leaves(whole), jax.tree.leaves(values), strict=True):
                leaf[members] = new
        return whole

    def _image(self, strobe: Callable[[int], ReturnMap], samples: _Samples) -> list[np.ndarray]:
        """Images of the samples under a map, component by component, without what flows only report."""
        states = self._by_flow(iterate, lambda row: (strobe(row), np.int32(1)), samples, 1)
        return [np.array(leaf) for leaf in jax.tree.leaves(error_components(states))]


def _effective_order(few: int, before: float, many: int, after: float, order: float) -> float:
    """Return the power of the steps with which errors fall, at least one and at most the method's order."""
    if many <= few or not 0.0 < after < before < math.inf:
        return order
    return min(max(math.log(before / after) / math.log(many / few), 1.0), order)


def _place(samples: _Samples, number: int) -> str:
    """Return where in the sweep a sample lies, in values of its axes."""
    return ", ".join(f"{name} = {values[number]:.9g}" for name, values in samples.where.items())


def _crossing_rates(section: Section, states: Crossing, p: Parameters) -> Float[Array, " points"]:
    """Rate of the height above the section at states of one lane."""
    return jax.vmap(lambda y: section.rate(y, p))(states.state)


def _is_escaping(states: State) -> Bool[np.ndarray, "lanes periods"]:
    """Return where a lane goes to infinity: not finite within two periods, as motion that blows up does ever faster.

    No number of steps gives such a period an error that means anything; the lane is marked as failed where it is run.
    """
    finite = np.all([np.isfinite(leaf) for leaf in jax.tree.leaves(states)], axis=0)
    lost = np.pad(~finite, [(0, 0), (0, 2)])
    return lost[:, :-2] | lost[:, 1:-1] | lost[:, 2:]


def _gaps(one: list[np.ndarray], other: list[np.ndarray]) -> Float[np.ndarray, " samples"]:
    """Largest difference of any component for each lane; infinite where one is not a number."""
    with np.errstate(invalid="ignore", over="ignore"):  # of lanes that escape
        largest = np.max([np.abs(a - b) for a, b in zip(one, other, strict=True)], axis=0)
    return np.where(np.isfinite(largest), largest, np.inf)
