"""Points of codimension two on curves of folds and Hopf points of equilibria, and other curves there. Host code.

Test functions pass zero along a curve (Kuznetsov, Elements of Applied Bifurcation Theory, 2004, 8 and 10.5). Between
two points of the curve each is computed at nodes, a polynomial through them has the root, and narrower rounds follow
until rounding is reached.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from jaxnh.orbits.bifurcations.centre_manifold import LinearisedEquilibria, first_lyapunov
from jaxnh.orbits.bifurcations.codimension_two import (
    BOGDANOV_TAKENS,
    CUSP,
    DOUBLE_HOPF,
    GENERALISED_HOPF,
    ZERO_HOPF,
    Special,
)
from jaxnh.orbits.bifurcations.location import NODES, roots
from jaxnh.orbits.continuation import core
from jaxnh.orbits.continuation.core import FINE, Evaluation, Solution
from jaxnh.orbits.continuation.curves import Curve
from jaxnh.orbits.continuation.equilibrium_curves import (
    CriticalEquilibria,
    EigenvectorEquations,
    FieldPlane,
    critical_equilibria,
    curve_of,
    double_zero,
)
from jaxnh.orbits.continuation.kinds import FOLD, HOPF
from jaxnh.orbits.continuation.tracks import across_chord
from jaxnh.systems.rows import concatenate

_ROUNDS = 16
_NARROWER = 64  # from round to round, where the polynomial has a sharp root
_SHARP = 0.05  # of the width of the nodes
_LEAST = 1e-9  # of a chord, the narrowest width
_FLOOR = 16 * np.finfo(float).eps  # of widths and values: rounding of the unknowns, that all nodes have in common
_ENLARGED = 2.0**16  # rounding of the equations, for what it does to be seen beside itself
_WIDE = 1e-2  # of a chord, the width of nodes then
_BEGUN = 1e-9  # κ in its unit: Hopf points that are Bogdanov–Takens points are below

TestFunction = Callable[[Solution], Float[np.ndarray, " lanes"]]


class _RoundedEquations(EigenvectorEquations):
    """The equations with a residual that is off."""

    def __init__(self, plane: FieldPlane, kind: int, off: Float[np.ndarray, " rows"]) -> None:
        super().__init__(plane, kind)
        self._off = off

    def evaluate(self, z: Float[np.ndarray, "lanes N"], /) -> Evaluation:
        at = super().evaluate(z)
        return at._replace(residual=at.residual + self._off)


class EquilibriumPoint(NamedTuple):
    """A point of codimension two of equilibria.

    Attributes:
        point: its kind, parameters, equilibrium, and eigenvalues in place of multipliers.
        error: of both parameters, from rounding of the equations and interpolation, (2,).
        solution: on the curve, one lane.
    """

    point: Special
    error: Float[np.ndarray, " 2"]
    solution: Solution


def equilibrium_points(plane: FieldPlane, curve: Curve) -> list[EquilibriumPoint]:
    """All that a curve of folds or Hopf points passes through or ends at, in its order."""
    points = list[EquilibriumPoint]()
    for kind, test in _tests(plane, curve.kind).items():
        with np.errstate(all="ignore"):
            values = test(curve.track)
        changes = (np.signbit(values[1:]) != np.signbit(values[:-1])) & np.isfinite(values[1:] + values[:-1])
        for place in np.flatnonzero(changes).tolist():
            point = _locate(plane, curve, kind, test, place)
            if point is not None and not (kind in (ZERO_HOPF, DOUBLE_HOPF) and _is_neutral(plane, curve.kind, point)):
                points.append(point)
    ways = curve.track.way[:, -2:]
    turns = np.flatnonzero(np.sum(ways[1:] * ways[:-1], axis=1) < 0.0) if curve.kind == FOLD else np.zeros(0, int)
    for place in turns.tolist():
        point = _locate(plane, curve, CUSP, lambda track, before=ways[place]: track.way[:, -2:] @ before, place)
        points += [point] if point is not None else []
    return sorted(points, key=lambda point: point.point.place)


def ended_at_points(plane: FieldPlane, curve: Curve, points: Sequence[EquilibriumPoint]) -> Curve:
    """The curve with the Bogdanov–Takens points that it ends at as its ends."""
    ends = [point for point in points if point.point.kind == BOGDANOV_TAKENS]
    if curve.kind != HOPF or not ends:
        return curve
    kept = np.flatnonzero(EigenvectorEquations(plane, HOPF).split(curve.track.z).square > _BEGUN)
    first = [point.solution for point in ends if point.point.place < kept[0]]
    last = [point.solution for point in ends if point.point.place >= kept[0]]
    whole = concatenate([*first[:1], curve.track.take(kept), *last[:1]])
    return curve_of(plane, HOPF, whole, curve.ends)


def other_curves(plane: FieldPlane, kind: int, point: EquilibriumPoint) -> list[tuple[int, CriticalEquilibria]]:
    """Kinds and first points of the other curves of folds or Hopf points through a point of codimension two."""
    at = EigenvectorEquations(plane, kind).split(point.solution.z)
    matrix, other = point.solution.blocks, {FOLD: HOPF, HOPF: FOLD}[kind]
    if point.point.kind == BOGDANOV_TAKENS:
        known = at.u, at.values, matrix
        return [(other, double_zero(plane, *known) if other == HOPF else critical_equilibria(plane, FOLD, *known))]
    if point.point.kind == ZERO_HOPF:
        return [(other, critical_equilibria(plane, other, at.u, at.values, matrix))]
    if point.point.kind == DOUBLE_HOPF:
        return [(HOPF, critical_equilibria(plane, HOPF, at.u, at.values, matrix, at.frequency(plane)))]
    return []


# ---- test functions


def _tests(plane: FieldPlane, kind: int) -> dict[int, TestFunction]:
    """Test functions by what they show on curves of a kind; that of cusps has the direction of the curve before."""
    if kind == FOLD:
        return {
            BOGDANOV_TAKENS: lambda track: _sum_of_minors(track.blocks),
            ZERO_HOPF: lambda track: _sums_of_pairs(_others(plane, FOLD, track)),
        }
    return {
        BOGDANOV_TAKENS: lambda track: EigenvectorEquations(plane, HOPF).split(track.z).square,
        ZERO_HOPF: lambda track: np.real(np.prod(_others(plane, HOPF, track), axis=1)),
        DOUBLE_HOPF: lambda track: _sums_of_pairs(_others(plane, HOPF, track)),
        GENERALISED_HOPF: lambda track: _lyapunov(plane, track),
    }


def _frequency(plane: FieldPlane, track: Solution) -> Float[np.ndarray, " lanes"]:
    return EigenvectorEquations(plane, HOPF).split(track.z).frequency(plane)


def _others(plane: FieldPlane, kind: int, track: Solution) -> Complex[np.ndarray, "lanes fewer"]:
    """Eigenvalues without the critical ones."""
    values = np.linalg.eigvals(track.blocks).astype(complex)
    if kind == FOLD:
        order = np.argsort(np.abs(values), axis=1, kind="stable")
        return np.take_along_axis(values, order, axis=1)[:, 1:]
    turn = 1j * _frequency(plane, track)[:, None]
    order = np.argsort(np.minimum(np.abs(values - turn), np.abs(values + turn)), axis=1, kind="stable")
    return np.take_along_axis(values, order, axis=1)[:, 2:]


def _sums_of_pairs(values: Complex[np.ndarray, "lanes d"]) -> Float[np.ndarray, " lanes"]:
    """∏ (λ_i + λ_j) over i < j."""
    i, j = np.triu_indices(values.shape[1], 1)
    return np.real(np.prod(values[:, i] + values[:, j], axis=1))


def _sum_of_minors(matrices: Float[np.ndarray, "lanes d d"]) -> Float[np.ndarray, " lanes"]:
    """The trace of the adjugate: the product of all eigenvalues but one that is zero, smooth where that is double."""
    left, singular, right = np.linalg.svd(matrices)
    d = matrices.shape[-1]
    others = np.where(np.eye(d, dtype=bool), 1.0, singular[:, None, :]).prod(axis=2)
    shares = np.einsum("lik,lki->lk", left, right)
    return np.linalg.det(left) * np.linalg.det(right) * np.sum(others * shares, axis=1)


def _lyapunov(plane: FieldPlane, track: Solution) -> Float[np.ndarray, " lanes"]:
    """The first Lyapunov coefficient times ω, NaN where the frequency is not positive."""
    at = EigenvectorEquations(plane, HOPF).split(track.z)
    frequency, vector = at.frequency(plane), at.vector(plane)
    some = np.flatnonzero((at.square > _BEGUN) & track.converged)
    coefficient = np.full(len(track.z), np.nan)
    equilibria = LinearisedEquilibria(at.u[some], at.values[some], track.blocks[some])
    if len(some):
        coefficient[some] = first_lyapunov(plane, equilibria, vector[some], frequency[some])
    return coefficient


def _is_neutral(plane: FieldPlane, kind: int, point: EquilibriumPoint) -> bool:
    """Return whether real eigenvalues of sum zero make the zero of `_sums_of_pairs`."""
    if kind == HOPF and point.point.kind == ZERO_HOPF:
        return False
    values = _others(plane, kind, point.solution)[0]
    first, second = min(itertools.combinations(values, 2), key=lambda pair: abs(pair[0] + pair[1]))
    return abs(first.imag) <= abs(first.real) or abs(second.imag) <= abs(second.real)


# ---- their zeros


def _locate(plane: FieldPlane, curve: Curve, kind: int, test: TestFunction, place: int) -> EquilibriumPoint | None:
    """The point of a curve after one of its own where a test function is zero; None where it is infinite."""
    track = curve.track.take(slice(place, place + 2))
    centre, half, best = 0.5, 0.5, None
    for _ in range(_ROUNDS):
        shares = centre + half * NODES
        nodes = _at_shares(plane, curve.kind, track, shares)
        if not nodes.converged.all():
            break
        with np.errstate(all="ignore"):
            tests = test(nodes)
        values = EigenvectorEquations(plane, curve.kind).split(nodes.z).values
        root, blur, value, error, _ = roots(np.repeat(tests[None], 2, axis=0), np.ascontiguousarray(values.T))
        if np.isfinite(root[0]) and blur[0] < _SHARP:
            if best is not None and not np.all(error < 0.5 * best[1]):
                break
            share = centre + half * root[0]
            solution = _at_shares(plane, curve.kind, track, np.array([share]))
            if not solution.converged[0]:
                break
            at = curve_of(plane, curve.kind, solution, curve.ends)
            special = Special(kind, value, place, at.points[0], at.multipliers[0])
            best = EquilibriumPoint(special, error, solution), error, share
            centre, half = share, half / _NARROWER
        else:
            changes = np.flatnonzero(np.signbit(tests[1:]) != np.signbit(tests[:-1]))
            if best is not None or len(changes) != 1:
                break
            pair = shares[changes[0] : changes[0] + 2]
            centre, half = float(pair.mean()), 0.6 * abs(float(np.diff(pair)[0]))
        if half < _LEAST:
            break
    if best is None:
        return None
    point, _, share = best
    return point._replace(error=point.error + _rounding(plane, curve.kind, test, track, point, share))


def _rounding(
    plane: FieldPlane, kind: int, test: TestFunction, track: Solution, point: EquilibriumPoint, share: float
) -> Float[np.ndarray, " 2"]:
    """Return what rounding does to a point at a share of a chord, at most.

    The last digits of the unknowns leave each equation off by what its derivatives make of them: where a coordinate is
    large beside what it changes by, as of a distant origin, that is far more than the last digits of the parameters.
    All nodes have it in common, so that their polynomial does not show it.
    """
    at = EigenvectorEquations(plane, kind).evaluate(point.solution.z)
    off = np.finfo(float).eps * np.abs(at.slopes[0]) @ np.abs(point.solution.z[0])
    shares, known, error = share + _WIDE * NODES, None, np.zeros(2)
    for shifts in [np.zeros_like(off), *np.diag(_ENLARGED * off)]:
        nodes = _at_shares(plane, kind, track, shares, shifts)
        with np.errstate(all="ignore"):
            tests, values = test(nodes), EigenvectorEquations(plane, kind).split(nodes.z).values
        _, _, value, _, _ = roots(np.repeat(tests[None], 2, axis=0), np.ascontiguousarray(values.T))
        known = value if known is None else known
        error += np.abs(value - known) / _ENLARGED
    floor = _FLOOR * (plane.width + np.abs(point.point.values))
    return floor + np.where(np.isfinite(error), error, np.inf)


def _at_shares(
    plane: FieldPlane,
    kind: int,
    track: Solution,
    shares: Float[np.ndarray, " lanes"],
    off: Float[np.ndarray, " rows"] | None = None,
) -> Solution:
    """Points of a curve in the hyperplanes across the chord between two of its own, at shares of it.

    Args:
        off: what each equation is off by; by default nothing.
    """
    equations = EigenvectorEquations(plane, kind) if off is None else _RoundedEquations(plane, kind, off)
    return core.correct(equations, *across_chord(track.z, track.way, shares), FINE)
