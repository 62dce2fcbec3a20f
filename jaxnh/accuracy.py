"""How many steps a period a target needs, measured on sample lanes of the sweep itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from jaxnh.lanes import Lanes
from jaxnh.solvers import IsokineticSplitting, WrittenOutRungeKutta
from jaxnh.strobe import iterate, make_strobe
from jaxnh.systems import IsokineticParticle, State

_SAMPLED_VALUES = 64
_SAMPLED_TIMES = (0, 1, 7, 56)  # periods after the start at which sample states are taken
_FEWEST_STEPS = 32
_MOST_STEPS = 65536


class Plan(NamedTuple):
    """Steps a period, and the error of one period's map that they were measured to have."""

    steps: int
    error_estimate: float


class TargetError(Exception):
    """The accuracy asked for cannot be had; the message says what can."""


def calibrate(
    system: IsokineticParticle,
    solver: IsokineticSplitting | WrittenOutRungeKutta,
    target: float,
    start: State,
    values: np.ndarray,
    lanes: Lanes,
) -> Plan:
    """Double the steps until the error of one period, on sample lanes, is at most the target.

    The error with N steps is the largest change of any component of (q, n) that 2N steps make, over up to 64 values of
    b across the sweep, each at the start state and at three states further on.

    Raises:
        TargetError: doubling no longer lowers the error, which is still above the target.
    """
    states, sampled = _samples(system, solver, start, values, lanes)

    def one_period(steps: int) -> list[np.ndarray]:
        moved = lanes(iterate, (make_strobe(system, solver, steps), np.int32(1)), (states, sampled), periods=1)
        return jax.tree.leaves(moved)

    steps, best = _FEWEST_STEPS, np.inf
    coarse = one_period(steps)
    while steps < _MOST_STEPS:
        fine = one_period(2 * steps)
        error = _distance(fine, coarse)
        if error <= target:
            return _fewest(one_period, fine, target, Plan(steps, error))
        if steps > 8 * _FEWEST_STEPS and error > 0.5 * best:
            break
        steps, coarse, best = 2 * steps, fine, min(best, error) if np.isfinite(error) else best
    raise TargetError(
        f"no number of steps of {solver.name} has an error of one period of {target:g} over this sweep; "
        f"the smallest measured is {best:.2g}"
    )


def _fewest(one_period: Callable[[int], list[np.ndarray]], fine: list[np.ndarray], target: float, plan: Plan) -> Plan:
    """The fewest steps, in eighths between half the plan's and all of them, that still meet the target."""
    for eighths in (5, 6, 7):
        steps = plan.steps * eighths // 8
        error = _distance(one_period(steps), fine)
        if error <= target:
            return Plan(steps, error)
    return plan


def _distance(one: list[np.ndarray], other: list[np.ndarray]) -> float:
    return max(float(np.max(np.abs(a - b))) for a, b in zip(one, other, strict=True))


def _samples(
    system: IsokineticParticle,
    solver: IsokineticSplitting | WrittenOutRungeKutta,
    start: State,
    values: np.ndarray,
    lanes: Lanes,
) -> tuple[State, np.ndarray]:
    """Start states of the sample lanes and their b: across the sweep, and from the start towards the attractor."""
    picked = values[np.unique(np.linspace(0, len(values) - 1, _SAMPLED_VALUES).round().astype(int))]
    state = jax.tree.map(lambda leaf: np.full(len(picked), leaf, float), start)
    strobe = make_strobe(system, solver, 4 * _FEWEST_STEPS)
    states, before = [], 0
    for periods in _SAMPLED_TIMES:
        passed = periods - before
        state = lanes(iterate, (strobe, np.int32(passed)), (state, picked), periods=passed)
        states.append(state)
        before = periods
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *states), np.tile(picked, len(states))
