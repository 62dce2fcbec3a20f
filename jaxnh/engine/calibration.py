"""Which solver and how many steps a period meet an accuracy, measured on sample lanes of the sweep itself."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxnh.engine.axes import Points
from jaxnh.engine.lanes import TILE, Lanes
from jaxnh.exceptions import AccuracyError
from jaxnh.maps.build import make_strobe, way_of
from jaxnh.maps.iterate import iterate, worst_on_the_way
from jaxnh.maps.protocol import Strobe
from jaxnh.maps.single_precision import in_precision
from jaxnh.solvers import Solver
from jaxnh.systems.flow import Flow, Parameters, State

SAMPLED_LANES = 1024
"""Lanes of a sweep that a calibration looks at, at most."""

_STRETCHES = (0, 1, 2, 5, 12, 29, 70, 120, 169)  # periods after the start; of each stretch one state is a sample
_LONGEST = 5  # times as many periods, at most, where the lanes are few
_SAFETY = 2.0  # the sample's largest error is taken this many times at least: some lane of the sweep has a larger one
_TAIL = 32  # largest errors, which tell how heavy the tail is
_MORE_PERIODS = 4.0  # than were looked at, of which the estimate is to be the largest error
_REFERENCE_STEPS = 96
_ROUNDING = 1e-12  # references nearer to each other than this are the same
_ROUGH = 1e-8  # references further apart than this say nothing: more steps may yet help
_SEED_ERROR = 1e-3  # sample states need not be accurate, but of this very system
_MOST_SEED_KICKS = 1 << 16
_ROUNDS = 6
_TABLES = 4  # that the rounding of plain sums is measured on
_PRECISE = {"float64": 1e-6, "float32": 1e-1}  # an error below this that more steps do not halve is rounding
_MOST_KICKS = 1 << 20


class Plan(NamedTuple):
    """A solver, its steps a period, whether its sums are compensated, and the error measured of one period's map."""

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

    def take(self, some: Int[np.ndarray, " some"]) -> _Samples:
        """Some of them."""
        return jax.tree.map(lambda leaf: leaf[some], self)


class Calibration:
    """Errors of one period's map on sample lanes: up to 1024 lanes across the sweep, at the start and later.

    The error of a map is the largest difference of any component of (q, n) from a reference that is refined until it
    changes no more, over all samples, times two, or more where the tail of the errors is heavy: a bound for the lanes
    of the sweep, kept but for some periods in a million (tests/hard/test_accuracy_contract.py). The reference is in
    float64 whatever the `precision` of the map. Samples are the worst periods on the way and on the attractors. No
    error is given that is below what the reference itself is known to, and of plain sums none below what their rounding
    does to the most sensitive sample.

    Attributes:
        floor: how far apart the two finest references are: what rounding leaves, or the steps that there can be.
    """

    def __init__(self, rows: Sequence[Points], lanes: Lanes, precision: str = "float64") -> None:
        """Measure the reference.

        Args:
            rows: sample lanes, those of each value of the shared axes together.

        Raises:
            AccuracyError: no lane has a period that can be computed.
        """
        self._flows = [row.system for row in rows]
        self._lanes, self._precision = lanes, precision
        flow = self._flows[0]
        self._way = way = way_of(flow)
        section = flow is not flow.flow
        # From crossing to crossing every step starts and ends by itself: no processor around many, no sums over them.
        self._candidates = tuple(s for s in way.solvers if not (section and s.processor[1]))
        self._summations = (False,) if section else way.summations
        self._samples = self._take_samples(rows)
        self._drop_lost()
        self._reference, self._known, self._enough = self._refine()
        self.floor = float(np.max(self._known))
        self._rounding = self._rounding_of_sums()

    def error(self, solver: Solver, steps: int, *, compensated: bool = False) -> float:
        """Error estimate of one period with so many steps; infinite where a state is not finite."""
        return float(np.max(self._errors(solver, steps, compensated)))

    def cheapest(self, target: float) -> Plan:
        """The splitting and steps with the fewest kicks whose error is at most the target.

        Raises:
            AccuracyError: none meets it; the message names the smallest error measured.
        """
        if self.floor > target:
            raise self._refusal(target, self._known)
        nearest = Plan(self._way.reference, _REFERENCE_STEPS, False, math.inf)
        by_order = sorted(self._candidates, key=lambda s: (abs(s.convergence_order - 8), not s.processor[1]))
        for compensated in self._summations:
            best, most = None, _MOST_KICKS
            for solver in by_order:
                if best is None and solver.convergence_order < 6:
                    break  # where no high order meets the target, no low one does
                for plan in self._search(solver, target, solver.most_steps(most), compensated):
                    nearest = min(nearest, plan, key=lambda p: p.error_estimate)
                    if plan.error_estimate <= target:
                        best, most = plan, solver.total_kicks(plan.steps) - 1
            if best is not None:
                return best
        raise self._refusal(target, self._errors(*nearest[:3]))

    def _refusal(self, target: float, errors: Float[np.ndarray, " samples"]) -> AccuracyError:
        """What to say when the least errors there are exceed the target."""
        worst = int(np.argmax(errors))
        where = ", ".join(f"{name} = {values[worst]:.9g}" for name, values in self._samples.where.items())
        return AccuracyError(
            f"no solver has an error of one period of {target:g} over this sweep; with up to {_MOST_KICKS:,} kicks, "
            f"that at {where} comes down to {np.max(errors):.2g}"
        )

    def _search(self, solver: Solver, target: float, most: int, compensated: bool) -> Iterator[Plan]:
        """Plans of one solver on the way to the fewest steps that meet the target; nothing above `most` steps."""
        if most < 1:
            return
        failed, met = 0, most + 1
        steps = min(most, max(2, solver.most_steps(max(2048, self._enough // 4))))
        previous = math.inf
        for _ in range(_ROUNDS):
            error = self.error(solver, steps, compensated=compensated)
            yield Plan(solver, steps, compensated, error)
            if error <= target:
                met = min(met, steps)
            else:
                failed = max(failed, steps)
                if steps == most or (error > 0.5 * previous and error < _PRECISE[self._precision]):
                    return  # no better than a cheaper solver, or rounding
                previous = error
            factor = (error / (0.9 * target)) ** (1.0 / solver.convergence_order) if 0 < error < math.inf else 2.0
            guess = math.ceil(steps * min(max(factor, 0.3), 4.0))
            steps = min(max(guess, failed + 1), met - 1, most)
            if steps <= failed or met - steps <= met // 50:
                return

    def _errors(self, solver: Solver, steps: int, compensated: bool) -> Float[np.ndarray, " samples"]:
        """Error estimate of every sample."""

        def strobe(flow: Flow) -> Strobe:
            return in_precision(make_strobe(flow, solver, steps, compensated=compensated), self._precision)

        chance = 0.0 if compensated else self._rounding
        gaps = _gaps(self._image(strobe, self._samples), self._reference)
        return np.maximum(_safety(gaps) * np.maximum(gaps, chance), self._known)

    def _take_samples(self, rows: Sequence[Points]) -> _Samples:
        """States across the sweep, from the start to the attractor: of a stretch of a lane that whose period errs most.

        Errors of a period have a heavy tail on chaotic motion, where a few states enlarge every error a thousand times:
        samples at fixed times would miss nearly all of these. So every period on the way is taken with half the steps
        as well, and what differs most is kept.
        """
        number = np.concatenate([np.full(len(jax.tree.leaves(row.start)[0]), i) for i, row in enumerate(rows)])
        start, p, where = (
            jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
            for parts in zip(*((row.start, dict(row.p), dict(row.where)) for row in rows), strict=True)
        )
        now = _Samples(start, p, number, where)
        steps = self._seed_steps(now)
        finer, coarser = (self._maps(self._way.reference, n) for n in (steps, max(1, steps // 2)))
        taken = []
        for begin, end in itertools.pairwise(_stretches(len(number))):
            later, hardest = self._by_flow(
                worst_on_the_way, lambda flow: (finer(flow), coarser(flow)), now, end - begin, 2
            )
            now = now._replace(states=later)
            taken.append(hardest)
        repeated = jax.tree.map(lambda leaf: np.tile(leaf, len(taken)), (now.p, now.row, now.where))
        return _Samples(jax.tree.map(lambda *leaves: np.concatenate(leaves), *taken), *repeated)

    def _drop_lost(self) -> None:
        """Leave out samples that overflow whatever the steps, as those of an absurd b: their lanes are marked failed.

        Raises:
            AccuracyError: there are no others.
        """
        image = self._image(self._maps(self._way.reference, _REFERENCE_STEPS), self._samples)
        kept = np.flatnonzero(np.all(np.isfinite(image), axis=0))
        if not len(kept):
            raise AccuracyError("every lane of this sweep has a non-finite state within a period")
        self._samples = self._samples.take(kept)

    def _seed_steps(self, samples: _Samples) -> int:
        """Steps with which the first period is roughly right."""
        solver, steps = self._way.reference, self._way.rough_steps
        image = self._image(self._maps(solver, steps), samples)
        while 2 * steps * solver.stages <= _MOST_SEED_KICKS:
            coarser, image = image, self._image(self._maps(solver, 2 * steps), samples)
            gaps = _gaps(coarser, image)
            if np.all(~np.isfinite(gaps) | (gaps < _SEED_ERROR)):
                break
            steps *= 2
        return steps

    def _refine(self) -> tuple[list[np.ndarray], Float[np.ndarray, " samples"], int]:
        """The finest map worth having, its distance from the one before in each sample, and its kicks a period.

        Each sample is refined until rounding is all that is left, most of them a few times only.
        """
        solver, steps = self._way.reference, _REFERENCE_STEPS
        finest = self._image(self._maps(solver, steps, compensated=True), self._samples)
        gaps, before = np.full((2, len(self._samples.row)), np.inf)
        while 1.5 * steps * solver.stages <= _MOST_KICKS:
            open_ = np.flatnonzero((gaps > _ROUNDING) & ((gaps < 0.5 * before) | (gaps > _ROUGH)))
            if not len(open_):
                break
            steps = steps * 3 // 2
            finer = self._image(self._maps(solver, steps, compensated=True), self._samples.take(open_))
            before[open_], gaps[open_] = gaps[open_], _gaps([leaf[open_] for leaf in finest], finer)
            for leaf, new in zip(finest, finer, strict=True):
                leaf[open_] = new
        return finest, gaps, steps * solver.stages

    def _rounding_of_sums(self) -> float:
        """What plain sums cost the most sensitive sample, in the worst of a few tables.

        The roundings of one table may happen to be small in it; those of the lanes of the sweep will not all be.
        """
        solver, worst = self._way.reference, 0.0
        for steps in (max(_REFERENCE_STEPS, self._enough // (2 * solver.stages)) + i for i in range(_TABLES)):
            plain, exact = (self._image(self._maps(solver, steps, compensated=c), self._samples) for c in (False, True))
            gaps = _gaps(plain, exact)
            worst = max(worst, float(np.max(gaps, where=np.isfinite(gaps), initial=0.0)))
        return worst

    def _maps(self, solver: Solver, steps: int, *, compensated: bool = False) -> Callable[[Flow], Strobe]:
        return lambda flow: make_strobe(flow, solver, steps, compensated=compensated)

    def _later(self, strobe: Callable[[Flow], Strobe], samples: _Samples, periods: int) -> State:
        """States so many periods on, each under the map of its own flow."""
        return self._by_flow(iterate, lambda flow: (strobe(flow),), samples, periods)

    def _by_flow(
        self,
        function: Callable[..., Any],
        maps: Callable[[Flow], tuple[Strobe, ...]],
        samples: _Samples,
        periods: int,
        price: int = 1,
    ) -> Any:
        """function(*maps, periods, state, p) of every sample, with the maps of its own flow; `price` maps a period."""
        whole: Any = None
        for k in np.unique(samples.row):
            here = np.flatnonzero(samples.row == k)
            part = samples.take(here)
            shared = (*maps(self._flows[k]), np.int32(periods))
            found = self._lanes(function, shared, (part.states, part.p), periods=price * periods)
            if len(here) == len(samples.row):
                return found
            whole = whole or jax.tree.map(lambda leaf: np.empty(len(samples.row), leaf.dtype), found)
            for leaf, new in zip(jax.tree.leaves(whole), jax.tree.leaves(found), strict=True):
                leaf[here] = new
        return whole

    def _image(self, strobe: Callable[[Flow], Strobe], samples: _Samples) -> list[np.ndarray]:
        """What a map makes of the samples, component by component, without what flows only report."""
        states = self._later(strobe, samples, 1)
        return [np.array(leaf) for leaf in jax.tree.leaves(self._flows[0].compared(states))]


def _safety(errors: Float[np.ndarray, " samples"]) -> float:
    """How many times the largest error of the samples the estimate is: twice, or more where few are far above the rest.

    Where the largest errors fall off as a power, P(error > e) ∝ e^(−α), the largest of k times as many periods is about
    k^(1/α) times that of the samples. 1/α is that of Hill (Ann. Statist. 3 (1975) 1163): the mean logarithm of the
    largest errors over the next.
    """
    top = np.sort(errors[np.isfinite(errors) & (errors > 0)])[::-1][: _TAIL + 1]
    inverse = float(np.mean(np.log(top[:-1] / top[-1]))) if len(top) > _TAIL else 0.0
    return max(_SAFETY, _MORE_PERIODS**inverse)


def _stretches(lanes: int) -> list[int]:
    """Ends of the stretches of which each lane gives a sample.

    The tail of the errors is as well known as there are periods looked at: fewer lanes are followed for longer. What a
    tile holds at no further cost are samples as well.
    """
    longest = _STRETCHES[-1] * min(_LONGEST, max(1, SAMPLED_LANES // lanes))
    count = max(len(_STRETCHES), min(longest, TILE // lanes))
    more = np.linspace(0, longest, count + 1).round().astype(int).tolist()
    return sorted({*_STRETCHES, *more}) if lanes < SAMPLED_LANES // 2 else list(_STRETCHES)


def _gaps(one: list[np.ndarray], other: list[np.ndarray]) -> Float[np.ndarray, " samples"]:
    """Largest difference of any component, a lane; infinite where one is not a number."""
    largest = np.max([np.abs(a - b) for a, b in zip(one, other, strict=True)], axis=0)
    return np.where(np.isfinite(largest), largest, np.inf)
