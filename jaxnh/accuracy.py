"""Which solver and how many steps a period meet an accuracy, measured on sample lanes of the sweep itself."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np

from jaxnh.lanes import Lanes
from jaxnh.solvers import SPLITTINGS, IsokineticSplitting, Solver
from jaxnh.strobe import iterate, make_strobe
from jaxnh.systems import IsokineticParticle, State

_SAMPLED_VALUES = 1024
_SAMPLED_TIMES = (0, 1, 2, 5, 12, 29, 70, 169)  # periods after the start at which sample states are taken
_SAFETY = 2.0  # the sample's largest error is taken this many times: some lane of the sweep has a larger one
_REFERENCE = "sofroniou_spaletta10"
_REFERENCE_STEPS = (96, 144, 216, 324)
_SEED_STEPS = 32
_ROUNDS = 6
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
    changes no more, over all samples, times two. Some sample states lie on the way, most on the attractors.

    Attributes:
        floor: how far apart the two finest references are: what rounding leaves.
    """

    def __init__(self, system: IsokineticParticle, start: State, values: np.ndarray, lanes: Lanes) -> None:
        self._system, self._lanes = system, lanes
        self._states, self._values = self._samples(start, values)
        self._reference, self.floor = self._refine()

    def error(self, solver: Solver, steps: int, *, compensated: bool = False) -> float:
        """Error estimate of one period with so many steps; infinite where a lane leaves the numbers."""
        return _SAFETY * _distance(self._one_period(solver, steps, compensated), self._reference)

    def cheapest(self, target: float) -> Plan:
        """The splitting and steps with the fewest kicks whose error is at most the target.

        Raises:
            TargetError: none meets it; the message names the smallest error measured.
        """
        smallest = math.inf
        by_order = sorted(SPLITTINGS.values(), key=lambda s: (abs(s.convergence_order - 8), not s.processor[1]))
        for compensated in (False, True):
            best, most = None, _MOST_KICKS
            for solver in by_order:
                if best is None and solver.convergence_order < 6:
                    break  # where no high order meets the target, no low one does
                for plan in self._search(solver, target, solver.most_steps(most), compensated):
                    smallest = min(smallest, plan.error_estimate)
                    if plan.error_estimate <= target:
                        best, most = plan, solver.total_kicks(plan.steps) - 1
            if best is not None:
                return best
        raise TargetError(
            f"no solver has an error of one period of {target:g} over this sweep; "
            f"the smallest measured is {smallest:.2g}"
        )

    def _search(self, solver: IsokineticSplitting, target: float, most: int, compensated: bool) -> Iterator[Plan]:
        """Plans of one solver on the way to the fewest steps that meet the target; nothing above `most` steps."""
        if most < 1:
            return
        failed, met = 0, most + 1
        steps = min(most, max(2, solver.most_steps(2048)))
        previous = math.inf
        for _ in range(_ROUNDS):
            error = self.error(solver, steps, compensated=compensated)
            yield Plan(solver, steps, compensated, error)
            if error <= target:
                met = min(met, steps)
            else:
                failed = max(failed, steps)
                if steps == most or (error > 0.5 * previous and error < 1e-6):
                    return  # no better than a cheaper solver, or rounding
                previous = error
            factor = (error / (0.9 * target)) ** (1.0 / solver.convergence_order) if 0 < error < math.inf else 2.0
            guess = math.ceil(steps * min(max(factor, 0.3), 4.0))
            steps = min(max(guess, failed + 1), met - 1, most)
            if steps <= failed or met - steps <= met // 50:
                return

    def _samples(self, start: State, values: np.ndarray) -> tuple[State, np.ndarray]:
        """Sample states and their b: across the sweep, and from the start towards the attractor."""
        picked = values[np.unique(np.linspace(0, len(values) - 1, _SAMPLED_VALUES).round().astype(int))]
        state = jax.tree.map(lambda leaf: np.full(len(picked), leaf, float), start)
        strobe = make_strobe(self._system, SPLITTINGS[_REFERENCE], _SEED_STEPS)
        states, before = [], 0
        for periods in _SAMPLED_TIMES:
            passed = periods - before
            state = self._lanes(iterate, (strobe, np.int32(passed)), (state, picked), periods=passed)
            states.append(state)
            before = periods
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *states), np.tile(picked, len(states))

    def _refine(self) -> tuple[list[np.ndarray], float]:
        """The finest map worth having, and its distance from the one before."""
        solver = SPLITTINGS[_REFERENCE]
        finest, floor = self._one_period(solver, _REFERENCE_STEPS[0], compensated=True), math.inf
        for steps in _REFERENCE_STEPS[1:]:
            coarser, finest = finest, self._one_period(solver, steps, compensated=True)
            before, floor = floor, _distance(coarser, finest)
            if floor > 0.5 * before:
                break
        return finest, floor

    def _one_period(self, solver: Solver, steps: int, compensated: bool) -> list[np.ndarray]:
        strobe = make_strobe(self._system, solver, steps, compensated=compensated)
        return jax.tree.leaves(self._lanes(iterate, (strobe, np.int32(1)), (self._states, self._values), periods=1))


def _distance(one: list[np.ndarray], other: list[np.ndarray]) -> float:
    """Largest difference of any component; infinite where one is not a number."""
    largest = max(float(np.max(np.abs(a - b))) for a, b in zip(one, other, strict=True))
    return largest if math.isfinite(largest) else math.inf
