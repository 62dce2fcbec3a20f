"""Which solver and how many steps a period meet an accuracy, measured on sample lanes of the sweep itself."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np

from jaxnh.engine.lanes import TILE, Lanes
from jaxnh.maps.build import make_strobe
from jaxnh.maps.iterate import iterate
from jaxnh.maps.protocol import Strobe, System, swept_name
from jaxnh.maps.section import Crossing, SectionedFlow
from jaxnh.maps.single_precision import in_precision
from jaxnh.solvers import SPLITTINGS, Solver, dopri8, tsit5
from jaxnh.systems.particle import IsokineticParticle, State

_SAMPLED_VALUES = 1024
_SAMPLED_TIMES = (0, 1, 2, 5, 12, 29, 70, 169)  # periods after the start at which sample states are taken
_SAFETY = 2.0  # the sample's largest error is taken this many times: some lane of the sweep has a larger one
_REFERENCE = "sofroniou_spaletta10"
_REFERENCE_STEPS = 96
_ROUNDING = 1e-12  # references nearer to each other than this are the same
_ROUGH = 1e-8  # references further apart than this say nothing: more steps may yet help
_SEED_STEPS = 32
_SEED_ERROR = 1e-3  # sample states need not be accurate, but of this very system
_MOST_SEED_KICKS = 1 << 16
_GENERAL = dopri8, tsit5  # what a system of T, Q and f is integrated with
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


class TargetError(Exception):
    """The accuracy asked for cannot be had; the message says what can."""


class Calibration:
    """Errors of one period's map on sample lanes: up to 1024 values of b across the sweep, at the start and later.

    The error of a map is the largest difference of any component of (q, n) from a reference that is refined until it
    changes no more, over all samples, times two. The reference is in float64 whatever the `precision` of the map. Some
    sample states lie on the way, most on the attractors. No error is given that is below what the reference itself is
    known to, and of plain sums none below what their rounding does to the most sensitive sample.

    Attributes:
        floor: how far apart the two finest references are: what rounding leaves, or the steps that there can be.
    """

    def __init__(
        self, system: System, start: State, values: np.ndarray, lanes: Lanes, precision: str = "float64"
    ) -> None:
        self._system, self._lanes, self._precision = system, lanes, precision
        section = isinstance(system, SectionedFlow)
        self._planar = planar = isinstance(system.flow if section else system, IsokineticParticle)
        self._finest: Solver = SPLITTINGS[_REFERENCE] if planar else dopri8
        # From crossing to crossing every step starts and ends by itself: no processor around many, no sums over them.
        splittings = tuple(s for s in SPLITTINGS.values() if not (section and s.processor[1]))
        self._candidates: tuple[Solver, ...] = splittings if planar else _GENERAL
        self._summations = (False, True) if planar and not section else (False,)  # plain, compensated
        self._states, self._values = self._samples(start, values)
        self._drop_lost()
        self._reference, self._known, self._enough = self._refine()
        self.floor = float(np.max(self._known))
        self._rounding = self._rounding_of_sums()

    def error(self, solver: Solver, steps: int, *, compensated: bool = False) -> float:
        """Error estimate of one period with so many steps; infinite where a lane leaves the numbers."""
        return float(np.max(self._errors(solver, steps, compensated)))

    def cheapest(self, target: float) -> Plan:
        """The splitting and steps with the fewest kicks whose error is at most the target.

        Raises:
            TargetError: none meets it; the message names the smallest error measured.
        """
        if self.floor > target:
            raise self._refusal(target, self._known)
        nearest = Plan(self._finest, _REFERENCE_STEPS, False, math.inf)
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

    def _refusal(self, target: float, errors: np.ndarray) -> TargetError:
        """What to say when the least errors there are exceed the target."""
        swept = swept_name(self._system)
        return TargetError(
            f"no solver has an error of one period of {target:g} over this sweep; with up to {_MOST_KICKS:,} kicks, "
            f"that at {swept} = {self._values[np.argmax(errors)]:.9g} comes down to {np.max(errors):.2g}"
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

    def _errors(self, solver: Solver, steps: int, compensated: bool) -> np.ndarray:
        """Error estimate of every sample."""
        strobe = make_strobe(self._system, solver, steps, compensated=compensated)
        image = self._image(in_precision(strobe, self._precision), self._states, self._values)
        chance = 0.0 if compensated else self._rounding
        return np.maximum(_SAFETY * np.maximum(_gaps(image, self._reference), chance), self._known)

    def _samples(self, start: State, values: np.ndarray) -> tuple[State, np.ndarray]:
        """Sample states and their b: across the sweep, and from the start towards the attractor."""
        picked = values[np.unique(np.linspace(0, len(values) - 1, _SAMPLED_VALUES).round().astype(int))]
        state = jax.tree.map(lambda leaf: np.full(len(picked), leaf, float), start)
        strobe = make_strobe(self._system, self._finest, self._seed_steps(state, picked))
        states, before = [], 0
        # A sweep of few values is sampled more often, up to what one tile holds at no further cost.
        often = np.linspace(0, _SAMPLED_TIMES[-1], min(_SAMPLED_TIMES[-1] + 1, TILE // len(picked) + 1)).round()
        for periods in sorted({*_SAMPLED_TIMES, *often.astype(int).tolist()} if len(often) > 8 else _SAMPLED_TIMES):
            passed = periods - before
            state = self._lanes(iterate, (strobe, np.int32(passed)), (state, picked), periods=passed)
            states.append(state)
            before = periods
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *states), np.tile(picked, len(states))

    def _drop_lost(self) -> None:
        """Leave out samples that overflow whatever the steps, as those of an absurd b: their lanes are marked failed.

        Raises:
            TargetError: there are no others.
        """
        image = self._one_period(self._finest, _REFERENCE_STEPS, False, self._states, self._values)
        kept = np.flatnonzero(np.all(np.isfinite(image), axis=0))
        if not len(kept):
            raise TargetError("every lane of this sweep leaves the numbers within a period")
        self._states, self._values = jax.tree.map(lambda leaf: leaf[kept], self._states), self._values[kept]

    def _seed_steps(self, state: State, values: np.ndarray) -> int:
        """Steps with which the first period is roughly right."""
        solver = self._finest
        steps = _SEED_STEPS if self._planar else 4 * _SEED_STEPS
        image = self._one_period(solver, steps, False, state, values)
        while 2 * steps * solver.stages <= _MOST_SEED_KICKS:
            coarser, image = image, self._one_period(solver, 2 * steps, False, state, values)
            gaps = _gaps(coarser, image)
            if np.all(~np.isfinite(gaps) | (gaps < _SEED_ERROR)):
                break
            steps *= 2
        return steps

    def _refine(self) -> tuple[list[np.ndarray], np.ndarray, int]:
        """The finest map worth having, its distance from the one before in each sample, and its kicks a period.

        Each sample is refined until rounding is all that is left, most of them a few times only.
        """
        solver, steps = self._finest, _REFERENCE_STEPS
        finest = self._one_period(solver, steps, True, self._states, self._values)
        gaps, before = np.full((2, len(self._values)), np.inf)
        while 1.5 * steps * solver.stages <= _MOST_KICKS:
            open_ = np.flatnonzero((gaps > _ROUNDING) & ((gaps < 0.5 * before) | (gaps > _ROUGH)))
            if not len(open_):
                break
            steps = steps * 3 // 2
            state = jax.tree.map(lambda leaf, open_=open_: leaf[open_], self._states)
            finer = self._one_period(solver, steps, True, state, self._values[open_])
            before[open_], gaps[open_] = gaps[open_], _gaps([leaf[open_] for leaf in finest], finer)
            for leaf, new in zip(finest, finer, strict=True):
                leaf[open_] = new
        return finest, gaps, steps * solver.stages

    def _rounding_of_sums(self) -> float:
        """What plain sums cost the most sensitive sample, in the worst of a few tables.

        The roundings of one table may happen to be small in it; those of the lanes of the sweep will not all be.
        """
        solver, worst = self._finest, 0.0
        for steps in (max(_REFERENCE_STEPS, self._enough // (2 * solver.stages)) + i for i in range(_TABLES)):
            plain, exact = (self._one_period(solver, steps, c, self._states, self._values) for c in (False, True))
            gaps = _gaps(plain, exact)
            worst = max(worst, float(np.max(gaps, where=np.isfinite(gaps), initial=0.0)))
        return worst

    def _one_period(
        self, solver: Solver, steps: int, compensated: bool, state: State, values: np.ndarray
    ) -> list[np.ndarray]:
        return self._image(make_strobe(self._system, solver, steps, compensated=compensated), state, values)

    def _image(self, strobe: Strobe, state: State, values: np.ndarray) -> list[np.ndarray]:
        image = self._lanes(iterate, (strobe, np.int32(1)), (state, values), periods=1)
        parts = (*image.state[:2], image.t) if isinstance(image, Crossing) else image[:2]
        return [np.array(leaf) for leaf in jax.tree.leaves(parts)]


def _gaps(one: list[np.ndarray], other: list[np.ndarray]) -> np.ndarray:
    """Largest difference of any component, a lane; infinite where one is not a number."""
    largest = np.max([np.abs(a - b) for a, b in zip(one, other, strict=True)], axis=0)
    return np.where(np.isfinite(largest), largest, np.inf)
