"""Bifurcations of cycles on branches by collocation, and the branches of doubled cycles that leave there. Host code.

Test functions are of multipliers: products of 1 + μ and of 1 − μ_i μ_j, each factor in units of 1 + |μ|, that none
overflows; they are not numbers where multipliers are not known well enough to tell their signs. Where 1 − μ changes
sign and the parameter does not turn, there is a branch point.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from scipy.optimize import brentq

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
_TOLD = 0.1  # of 1 + |μ|: error of a factor of a test function that leaves its sign
_NEAREST = 3  # points that tell where others of a chord are
_APART = 1e-4  # of a chord, of such points: nearer ones tell rounding
_BEND = 1e-6  # s²(1 − s)², below which a cubic is as good
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
    return _product(1.0 - point.multipliers, np.abs(point.multipliers), point.errors)


def doubling_test(point: CyclePoint) -> float:
    """∏ (1 + μ)/(1 + |μ|)."""
    return _product(1.0 + point.multipliers, np.abs(point.multipliers), point.errors)


def torus_test(point: CyclePoint) -> float:
    """∏ (1 − μ_i μ_j)/(1 + |μ_i μ_j|) over i < j."""
    first, second = np.triu_indices(len(point.multipliers), 1)
    sizes, errors, pairs = np.abs(point.multipliers), point.errors, point.multipliers[first] * point.multipliers[second]
    off = sizes[first] * errors[second] + errors[first] * (sizes[second] + errors[second])
    return _product(1.0 - pairs, np.abs(pairs), off)


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
                if _changes_on_halves(problem, now, after, lift, test):
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
    near, scale = (after.solution, _on_halves(after.solution)), abs(test(now)) + abs(test(after))
    coarse, fine = (_Chord(CollocationEquations(problem, mesh, lift), now, after, test) for mesh in near)
    known = {0.0: test(now), 1.0: test(after)}
    try:
        share = float(brentq(lambda s: known.get(s) or coarse.test(s), 0.0, 1.0, xtol=_ROOT))  # pyright: ignore[reportArgumentType]
        first, point = coarse.point(share), fine.point(_zero_beside(fine.test, share))
    except _NoPointError:
        return None, np.inf
    if max(abs(test(first)), abs(test(point))) > _ZERO * scale:
        return None, np.inf
    return point, abs(point.value - first.value) + _FLOOR * float(problem.widths[0])


def _changes_on_halves(
    problem: Problem,
    now: CyclePoint,
    after: CyclePoint,
    lift: Float[np.ndarray, " d"],
    test: Callable[[CyclePoint], float],
) -> bool:
    """Return whether a change of sign may be one on the halves of the mesh too: otherwise it is the mesh's own.

    Where a parameter hardly moves, as along canards, what a mesh leaves of its error tells the sign of its rate.
    """
    chord = _Chord(CollocationEquations(problem, _on_halves(after.solution), lift), now, after, test)
    try:
        return _differ(chord.test(0.0), chord.test(1.0))
    except _NoPointError:
        return True


def _on_halves(solution: BoundarySolution) -> BoundarySolution:
    """The solution on the halves of its intervals."""
    return solution._replace(path=on_mesh(solution.path, halved(solution.path.mesh)))


def _zero_beside(test: Callable[[float], float], share: float) -> float:
    """The zero of a test function near a share, by the secant method."""
    before, now = share, share + _BESIDE
    values = test(before), test(now)
    for _ in range(_STEPS):
        if values[0] == values[1] or abs(now - before) <= _ROOT:
            break
        before, now = now, now - values[1] * (now - before) / (values[1] - values[0])
        values = values[1], test(now)
    return now


class _NoPointError(Exception):
    """Newton comes to no point of a branch."""


class _Chord:
    """The branch between two of its points, on one mesh, by shares of the chord from one to the other.

    Points that are known once are kept, and tell where others are.
    """

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
        self._known = dict[float, CyclePoint]()
        self._off_cubic = dict[float, np.ndarray]()  # of shares between the ends, over s²(1 − s)²

    def point(self, share: float) -> CyclePoint:
        """The point in the hyperplane across the chord at a share of it; raises `_NoPointError`."""
        if share not in self._known:
            cubic, bend = self._cubic(share), share**2 * (1.0 - share) ** 2
            guess = cubic + bend * self._interpolated(share)
            corrected = core.correct(self._equations, guess, self._normal, core.FINE)
            if not corrected.converged[0]:
                raise _NoPointError
            if bend > _BEND:
                self._off_cubic[share] = (corrected.z - cubic) / bend
            self._known[share] = self._equations.points(corrected)[0]
        return self._known[share]

    def _cubic(self, s: float) -> Float[np.ndarray, "1 N"]:
        """Hermite's cubic from end to end, in the hyperplane of its share."""
        left, unit = 1.0 - s, self._equations.unit
        bent = s * s * (3.0 - 2.0 * s) * self._chord + s * left**2 * self._ways[0] - s * s * left * self._ways[1]
        off = s * core.norm(unit, self._chord) - core.inner(unit, bent, self._normal)
        return self._first + bent + off[:, None] * self._normal

    def _interpolated(self, share: float) -> Float[np.ndarray, "1 N"] | float:
        """Distances of points from the cubic, over s²(1 − s)², by the polynomial through the nearest that are known."""
        nearest = list[float]()
        for other in sorted(self._off_cubic, key=lambda other: abs(other - share)):
            if len(nearest) < _NEAREST and all(abs(other - s) > _APART for s in nearest):
                nearest.append(other)
        return sum(
            (
                self._off_cubic[s] * np.prod([(share - other) / (s - other) for other in nearest if other != s])
                for s in nearest
            ),
            0.0,
        )

    def test(self, share: float) -> float:
        """The test function there; raises `_NoPointError` where it is not known."""
        value = self._test(self.point(share))
        if not np.isfinite(value):
            raise _NoPointError
        return value


def _neutral(point: CyclePoint) -> bool:
    """Return whether the pair of multipliers with product one is real: a neutral saddle."""
    pairs = list(itertools.combinations(point.multipliers, 2))
    nearest = min(pairs, key=lambda pair: abs(pair[0] * pair[1] - 1.0))
    return abs(nearest[0].imag) == 0.0


def _changes(test: Callable[[CyclePoint], float], now: CyclePoint, after: CyclePoint) -> bool:
    return _differ(test(now), test(after))


def _differ(before: float, later: float) -> bool:
    """Return whether two values of a test function have different signs, which are not rounding's."""
    return before * later < 0.0 and max(abs(before), abs(later)) > _ROUNDING


def _product(
    factors: Complex[np.ndarray, " k"], moduli: Float[np.ndarray, " k"], errors: Float[np.ndarray, " k"]
) -> float:
    """The real product of factors in units of one more than moduli; not a number where errors leave no sign."""
    units = 1.0 + moduli
    return float(np.real(np.prod(factors / units))) if np.all(errors <= _TOLD * units) else np.nan
