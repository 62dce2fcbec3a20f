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
from scipy.optimize import brentq, root_scalar

from jaxnh.orbits import cyclic
from jaxnh.orbits.collocation.cycle_equations import CollocationEquations, CyclePoint, point_at
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
from jaxnh.orbits.collocation.following import CycleBranch
from jaxnh.orbits.collocation.newton import correct
from jaxnh.orbits.collocation.paths import PiecewisePath, gauss_rule, halved, on_mesh
from jaxnh.orbits.continuation import core
from jaxnh.orbits.continuation.kinds import BRANCH_POINT, DOUBLING, FOLD, NEIMARK_SACKER

_STEPS = 40
_ROOT = 1e-12  # of a chord: change of the place of a zero that is too small to matter
_BESIDE = 1e-5  # of a chord
_ZERO = 1e-6  # of its values around: that of a test function at a zero
_AWAY = (2e-2, 4e-3, 1e-3, 2.5e-4)  # from a doubling, in lengths, tried in this order
_STRAIGHT = 0.9  # cosine of the angle between the branch there and the direction it sets out in
_FLOOR = 1e-12  # of the width of the range: what rounding leaves
_ROUNDING = 1e-10  # of a test function: less tells no sign, as of 1 − μ_1 μ_2 where area is preserved


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
    pairs = [first * second for first, second in itertools.combinations(point.multipliers, 2)]
    return _product([1.0 - mu for mu in pairs], np.abs(pairs))


def bifurcations(
    problem: Problem, branch: CycleBranch, lift: Float[np.ndarray, " d"]
) -> tuple[list[CycleBifurcation], list[tuple[int, int]]]:
    """The bifurcations on a branch in its order, and places and kinds of the changes of sign that led to none."""
    located, lost = list[CycleBifurcation](), list[tuple[int, int]]()
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
                lost.append((place, kind))
                continue
            point, error = _locate(problem, now, after, lift, test)
            if point is None:
                lost.append((place, kind))
            elif kind != NEIMARK_SACKER or not _neutral(point):
                located.append(CycleBifurcation(kind, place, point, error))
    return located, lost


def doubled_cycle(problem: Problem, point: CyclePoint, lift: Float[np.ndarray, " d"]) -> CyclePoint | None:
    """A cycle of twice the duration near a doubling, with the direction away from it; None where none is met."""
    solution, n = point.solution, point.solution.path.stages.shape[1]
    boundary = closure(problem, lift[None])(solution, np.zeros(1, int))
    blocks, identity = linearise(problem, solution, boundary).blocks, np.eye(len(lift))[None, None]
    there = np.concatenate([np.repeat(-identity, n, axis=1), identity], axis=1)
    vector = cyclic.null_vector(cyclic.eliminate(np.concatenate([blocks, identity], axis=1), there))
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
    start = BoundarySolution(whole, 2.0 * solution.duration, solution.values)
    for away in _AWAY:
        guess = moved(problem, start, combination([(away, way)]))
        corrected = correct(problem, guess, closure(problem, 2.0 * lift[None]), lambda line, lanes: [way])
        if corrected.converged[0]:
            nearby = point_at(problem, corrected.solution, 2.0 * lift, way)
            if inner(whole, nearby.way, way)[0] >= _STRAIGHT:
                return nearby
    return None


def _locate(
    problem: Problem,
    now: CyclePoint,
    after: CyclePoint,
    lift: Float[np.ndarray, " d"],
    test: Callable[[CyclePoint], float],
) -> tuple[CyclePoint | None, float]:
    """The point between two of a branch where a test function is zero, on the halves of the mesh; and the error."""
    path, scale = after.solution.path, abs(test(now)) + abs(test(after))
    near = after.solution, after.solution._replace(path=on_mesh(path, halved(path.mesh)))
    coarse, fine = (_Chord(CollocationEquations(problem, mesh, lift), now, after, test) for mesh in near)
    known = {0.0: test(now), 1.0: test(after)}
    try:
        share = float(brentq(lambda s: known.get(s) or coarse.test(s), 0.0, 1.0, xtol=_ROOT))  # pyright: ignore[reportArgumentType]
        root = root_scalar(fine.test, method="secant", x0=share, x1=share + _BESIDE, xtol=_ROOT, maxiter=_STEPS).root
        first, point = coarse.point(share), fine.point(root)
    except _NoPointError:
        return None, np.inf
    if max(abs(test(first)), abs(test(point))) > _ZERO * scale:
        return None, np.inf
    return point, abs(point.value - first.value) + _FLOOR * float(problem.widths[0])


class _NoPointError(Exception):
    """Newton comes to no point of a branch."""


class _Chord:
    """The branch between two of its points, on one mesh, by shares of the chord from one to the other."""

    def __init__(
        self,
        equations: CollocationEquations,
        now: CyclePoint,
        after: CyclePoint,
        test: Callable[[CyclePoint], float],
    ) -> None:
        self._equations, self._test = equations, test
        (self._first, ahead), (last, beyond) = (self._equations.of_point(point) for point in (now, after))
        self._chord = last - self._first
        length = core.norm(self._equations.unit, self._chord)
        self._normal = self._chord / length[:, None]
        self._ways = length * ahead, length * beyond

    def point(self, share: float) -> CyclePoint:
        """The point in the hyperplane across the chord at a share of it, from a cubic; raises `_NoPointError`."""
        s, left, unit = share, 1.0 - share, self._equations.unit
        bent = s * s * (3.0 - 2.0 * s) * self._chord + s * left**2 * self._ways[0] - s * s * left * self._ways[1]
        off = s * core.norm(unit, self._chord) - core.inner(unit, bent, self._normal)
        guess = self._first + bent + off[:, None] * self._normal
        corrected = core.correct(self._equations, guess, self._normal, core.FINE)
        if not corrected.converged[0]:
            raise _NoPointError
        return self._equations.points(corrected)[0]

    def test(self, share: float) -> float:
        """The test function there."""
        return self._test(self.point(share))


def _neutral(point: CyclePoint) -> bool:
    """Return whether the pair of multipliers with product one is real: a neutral saddle."""
    pairs = list(itertools.combinations(point.multipliers, 2))
    nearest = min(pairs, key=lambda pair: abs(pair[0] * pair[1] - 1.0))
    return abs(nearest[0].imag) == 0.0


def _changes(test: Callable[[CyclePoint], float], now: CyclePoint, after: CyclePoint) -> bool:
    before, later = test(now), test(after)
    return before * later < 0.0 and max(abs(before), abs(later)) > _ROUNDING


def _product(factors: list[complex], moduli: Float[np.ndarray, " k"]) -> float:
    """The real product of factors in units of one more than moduli."""
    return float(np.real(np.prod([factor / (1.0 + modulus) for factor, modulus in zip(factors, moduli, strict=True)])))
