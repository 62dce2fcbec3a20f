"""Bifurcations of cycles on branches by collocation, and the branches of doubled cycles that leave there. Host code.

Test functions are of multipliers: products of 1 + μ and of 1 − μ_i μ_j, each factor in units of 1 + |μ|, that none
overflows. Where 1 − μ changes sign and the parameter does not turn, there is a branch point.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.orbits import cyclic
from jaxnh.orbits.collocation.cycles import closure
from jaxnh.orbits.collocation.equations import (
    BoundarySolution,
    Problem,
    Variation,
    combination,
    inner,
    linearise,
    moved,
)
from jaxnh.orbits.collocation.following import CycleBranch, CyclePoint, difference, point_at, remeshed_point, step_along
from jaxnh.orbits.collocation.newton import correct
from jaxnh.orbits.collocation.paths import PiecewisePath, gauss_rule
from jaxnh.orbits.continuation.kinds import BRANCH_POINT, DOUBLING, FOLD, NEIMARK_SACKER

_STEPS = 40
_ROOT = 1e-12  # of a step: change of the place of a zero that is too small to matter
_ZERO = 1e-6  # of its values around: that of a test function at a zero
_AWAY = (2e-2, 4e-3, 1e-3, 2.5e-4)  # from a doubling, in lengths, tried in this order
_STRAIGHT = 0.9  # cosine of the angle between the branch there and the direction it sets out in
_FLOOR = 1e-12  # of the width of the range: what rounding leaves


class CycleBifurcation(NamedTuple):
    """A bifurcation of cycles.

    Attributes:
        kind: number in `continuation.kinds.KINDS`.
        place: of the point of the branch before it.
        point: the cycle.
        error: of the parameter, from a mesh with half the intervals, and from rounding.
    """

    kind: int
    place: int
    point: CyclePoint
    error: float


def fold_test(point: CyclePoint) -> float:
    """The rate of the parameter along the branch."""
    return float(point.way.extra[0, 1])


def unit_test(point: CyclePoint) -> float:
    """∏ (1 − μ)/(1 + |μ|)."""
    return _product([1.0 - mu for mu in point.multipliers], np.abs(point.multipliers))


def doubling_test(point: CyclePoint) -> float:
    """∏ (1 + μ)/(1 + |μ|)."""
    return _product([1.0 + mu for mu in point.multipliers], np.abs(point.multipliers))


def torus_test(point: CyclePoint) -> float:
    """∏ (1 − μ_i μ_j)/(1 + |μ_i μ_j|) over i < j."""
    pairs = [one * other for one, other in itertools.combinations(point.multipliers, 2)]
    return _product([1.0 - mu for mu in pairs], np.abs(pairs))


def bifurcations(
    problem: Problem, branch: CycleBranch, lift: Float[np.ndarray, " d"], ends: tuple[float, float]
) -> tuple[list[CycleBifurcation], int]:
    """The bifurcations on a branch in its order, and how many changes of sign led to none."""
    located, lost = list[CycleBifurcation](), 0
    for place, (now, after) in enumerate(itertools.pairwise(branch.points)):
        turns = _changes(fold_test, now, after)
        crosses = _changes(unit_test, now, after) and not turns
        wanted = (
            (FOLD, fold_test, turns),
            (DOUBLING, doubling_test, _changes(doubling_test, now, after)),
            (NEIMARK_SACKER, torus_test, _changes(torus_test, now, after)),
            (BRANCH_POINT, unit_test, crosses),
        )
        for kind, test, changes in wanted:
            if not changes:
                continue
            if kind != FOLD and not (now.resolved and after.resolved):
                lost += 1
                continue
            point, error = _locate(problem, now, after, lift, ends, test)
            if point is None:
                lost += 1
            elif kind != NEIMARK_SACKER or not _neutral(point):
                located.append(CycleBifurcation(kind, place, point, error))
    return located, lost


def doubled_cycle(problem: Problem, point: CyclePoint, lift: Float[np.ndarray, " d"]) -> CyclePoint | None:
    """A cycle of twice the duration near a doubling, with the direction away from it; None where none is met."""
    solution, n = point.solution, point.solution.path.stages.shape[1]
    boundary = closure(problem, lift[None])(solution, np.zeros(1, int))
    blocks, one = linearise(problem, solution, boundary).blocks, np.eye(len(lift))[None, None]
    there = np.concatenate([np.repeat(-one, n, axis=1), one], axis=1)
    vector = cyclic.null_vector(cyclic.eliminate(np.concatenate([blocks, one], axis=1), there))
    shares = gauss_rule(solution.path.stages.shape[2]).points[:, None]
    stages = vector[:, :-1, None] + shares * np.diff(vector, axis=1)[:, :, None]

    def twice(first: np.ndarray, second: np.ndarray, ends: bool) -> np.ndarray:
        return np.concatenate([first[:, :-1] if ends else first, second], axis=1)

    way = Variation(twice(vector, -vector, True), twice(stages, -stages, False), np.zeros((1, 2)))
    path = solution.path
    whole = PiecewisePath(
        0.5 * twice(path.mesh, 1.0 + path.mesh, True),
        twice(path.ends, path.ends + lift, True),
        twice(path.stages, path.stages + lift, False),
    )
    way = combination([(1.0 / np.sqrt(inner(whole, way, way)), way)])
    begun = BoundarySolution(whole, 2.0 * solution.duration, solution.values)
    for away in _AWAY:
        guess = moved(problem, begun, combination([(away, way)]))
        corrected = correct(problem, guess, closure(problem, 2.0 * lift[None]), lambda line, lanes: [way])
        if corrected.converged[0]:
            gone = difference(problem, corrected.solution, begun)
            cosine = inner(whole, gone, way) / np.sqrt(inner(whole, gone, gone))
            if cosine[0] >= _STRAIGHT:
                return point_at(problem, corrected.solution, 2.0 * lift, way)
    return None


def _locate(
    problem: Problem,
    now: CyclePoint,
    after: CyclePoint,
    lift: Float[np.ndarray, " d"],
    ends: tuple[float, float],
    test: Callable[[CyclePoint], float],
) -> tuple[CyclePoint | None, float]:
    """The point between two of a branch where a test function is zero, on the halves of the mesh; and the error."""
    points = list[CyclePoint]()
    n = after.solution.path.stages.shape[1]
    for intervals in (n, 2 * n):
        point = _zero(problem, remeshed_point(problem, now, intervals), after, lift, ends, test)
        if point is None:
            return None, np.inf
        points.append(point)
    coarse, fine = points
    return fine, abs(fine.value - coarse.value) + _FLOOR * float(problem.widths[0])


def _zero(
    problem: Problem,
    now: CyclePoint,
    after: CyclePoint,
    lift: Float[np.ndarray, " d"],
    ends: tuple[float, float],
    test: Callable[[CyclePoint], float],
) -> CyclePoint | None:
    """The same on one mesh, by false position with the Illinois rule (Dowell and Jarratt, BIT 11 (1971) 168)."""
    low, at_low, high, at_high = 0.0, test(now), after.step, test(after)
    scale, before = abs(at_low) + abs(at_high), np.inf
    for _ in range(_STEPS):
        size = (low * at_high - high * at_low) / (at_high - at_low)
        point, _ = step_along(problem, now, lift, size, ends)
        if point is None:
            return None
        at_size = test(point)
        if at_size == 0.0 or abs(size - before) <= _ROOT * after.step:
            return point if abs(at_size) <= _ZERO * scale else None
        before = size
        if at_size * at_high < 0.0:
            low, at_low = high, at_high
        else:
            at_low *= 0.5
        high, at_high = size, at_size
    return None


def _neutral(point: CyclePoint) -> bool:
    """Return whether the pair of multipliers with product one is real: a neutral saddle."""
    pairs = list(itertools.combinations(point.multipliers, 2))
    nearest = min(pairs, key=lambda pair: abs(pair[0] * pair[1] - 1.0))
    return abs(nearest[0].imag) == 0.0


def _changes(test: Callable[[CyclePoint], float], now: CyclePoint, after: CyclePoint) -> bool:
    return test(now) * test(after) < 0.0


def _product(factors: list[complex], moduli: Float[np.ndarray, " k"]) -> float:
    """The real product of factors in units of one more than moduli."""
    return float(np.real(np.prod([factor / (1.0 + modulus) for factor, modulus in zip(factors, moduli, strict=True)])))
