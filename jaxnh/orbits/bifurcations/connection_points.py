"""Points of codimension two on curves of homoclinic orbits, and what the eigenvalues of the saddle tell. Host code.

Test functions of the leading eigenvalues, of the directions in which an orbit leaves and comes back, and of those of
the adjoint solution (Champneys and Kuznetsov, Int. J. Bifurcation Chaos 4 (1994) 785). Zeros are located on the curve
by false position.
"""

from __future__ import annotations

import contextlib
import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from jaxnh.orbits.bifurcations.codimension_two import false_position
from jaxnh.orbits.collocation.adjoint import adjoint_solution
from jaxnh.orbits.collocation.connection_meshes import Connection, refined
from jaxnh.orbits.collocation.connections import ConnectionCurve, Stretch
from jaxnh.orbits.collocation.equations import Problem
from jaxnh.orbits.collocation.homoclinic import SaddlePoint

POINTS = (
    "neutral_saddle", "neutral_saddle_focus", "neutral_bi_focus", "double_real_stable", "double_real_unstable",
    "three_leading_stable", "three_leading_unstable", "neutrally_divergent_stable", "neutrally_divergent_unstable",
    "orbit_flip_stable", "orbit_flip_unstable", "inclination_flip_stable", "inclination_flip_unstable",
    "bogdanov_takens",
)  # fmt: skip
"""Points of codimension two by number.

The saddle quantity is zero with real leading eigenvalues, and with complex ones, where Shilnikov's condition changes;
two leading eigenvalues of one side meet, or a pair and a real one have the same real part; the real leading eigenvalue
and the pair of the other side have no sum; the orbit goes along another eigenvector than the leading one; the adjoint
solution does, so that the stable or unstable manifold comes back along itself with another orientation beyond; orbits
vanish in an equilibrium.
"""

BOGDANOV_TAKENS = len(POINTS) - 1

TYPES = ("saddle", "saddle_focus", "bi_focus")
"""Saddles by how many of both leading eigenvalues are complex."""

_SADDLE, _DOUBLE, _DIVERGENCE, _ORBIT, _INCLINATION = range(5)
_TESTS = ((_SADDLE, 0), *((kind, side) for kind in (_DOUBLE, _DIVERGENCE, _ORBIT, _INCLINATION) for side in (0, 1)))
_NOISE = 1e-6  # of test functions of orbits in sizes: 1e-13 at their ends, where they are 1e-5 from the saddle
_DIFFERENCE = 1e-4  # of the way between two points, for slopes
_SECOND_ORDER = 0.1  # of what refinement changes
_ROUNDINGS = 16 * np.finfo(float).eps
_JUMP = 0.2  # of the smaller of both values of a test function: what is no smaller at its zero is a jump


class SpecialConnection(NamedTuple):
    """A point of codimension two.

    Attributes:
        kind: number in `POINTS`.
        values, error: of both parameters, (2,).
        point: the orbit.
    """

    kind: int
    values: Float[np.ndarray, " 2"]
    error: Float[np.ndarray, " 2"]
    point: Connection


class Leading(NamedTuple):
    """Leading eigenvalues of a saddle, nearest to the imaginary axis first, of its stable and its unstable side."""

    stable: Complex[np.ndarray, " s"]
    unstable: Complex[np.ndarray, " u"]

    @property
    def saddle_quantity(self) -> float:
        """Sum of the real parts of the first ones of both sides."""
        return float(self.stable[0].real + self.unstable[0].real)

    @property
    def kind(self) -> int:
        """Number in `TYPES`."""
        return sum(int(side[0].imag != 0.0) for side in self)

    @property
    def shilnikov(self) -> bool:
        """Tell whether infinitely many saddle cycles are near (Shilnikov, Math. USSR Sbornik 10 (1970) 91)."""
        if self.kind != 1:
            return self.kind == 2
        return (self.saddle_quantity > 0.0) == (self.stable[0].imag != 0.0)


def leading(saddle: SaddlePoint) -> Leading:
    """The eigenvalues of a saddle by sides, leading ones first."""
    values = saddle.eigenvalues
    real = np.real(values)
    return Leading(values[real < 0.0], values[real > 0.0][::-1])


class _Orbit(NamedTuple):
    """An orbit, and the shares of its ends and of the adjoint solution's in leading directions, stable side first.

    Attributes:
        point: the orbit.
        eigenvalues: of its saddle.
        left, right: leading left and right eigenvectors, real ones alone, (2, d).
        ends: gaps from the saddle of the side where the orbit goes along its direction, in sizes, (2, d).
        adjoint: the adjoint solution where it goes along the left eigenvector, (2, d).
        normal: its mean product with the field's derivatives in the parameters, across the curve, (2,).
    """

    point: Connection
    eigenvalues: Leading
    left: Float[np.ndarray, "2 d"]
    right: Float[np.ndarray, "2 d"]
    ends: Float[np.ndarray, "2 d"]
    adjoint: Float[np.ndarray, "2 d"]
    normal: Float[np.ndarray, " 2"]


def special_connections(curve: ConnectionCurve) -> list[tuple[int, SpecialConnection]]:
    """Points of codimension two on a curve of homoclinic orbits, each with the number of its stretch."""
    special = list[tuple[int, SpecialConnection]]()
    for number, stretch in enumerate(curve.stretches):
        orbits = [_orbit(stretch.problem, point) for point in stretch.points]
        for k, (first, second) in enumerate(itertools.pairwise(orbits)):
            for test in _TESTS:
                ends = _test(test, first, first), _test(test, second, first)
                least = _NOISE if test[0] in (_ORBIT, _INCLINATION) else 0.0
                if np.isfinite(ends).all() and ends[0] * ends[1] < 0.0 and min(map(abs, ends)) > least:
                    point = _locate(stretch, k, test, ends)
                    if point is not None:
                        special.append((number, point))
    return special


# ---- test functions


def _orbit(problem: Problem, point: Connection) -> _Orbit:
    """An orbit with its directions; the adjoint solution is not a number where no test asks for it."""
    eigenvalues, saddles = leading(point.departure), (point.arrival, point.departure)
    left = np.stack([_eigenvector(saddles[side].jacobian.T, eigenvalues[side][0]) for side in (0, 1)])
    right = np.stack([_eigenvector(saddles[1 - side].jacobian, eigenvalues[side][0]) for side in (0, 1)])
    path = point.solution.path
    ends = np.stack([path.ends[0, end] - saddle.state for end, saddle in zip((-1, 0), saddles, strict=True)])
    adjoint, normal = np.full_like(left, np.nan), np.full(2, np.nan)
    if any(len(side) > 1 and not side[0].imag for side in eigenvalues):
        with contextlib.suppress(np.linalg.LinAlgError):
            psi, normal = adjoint_solution(problem, point.solution, point.departure, point.arrival)
            adjoint = psi[[0, -1]]
    return _Orbit(point, eigenvalues, left, right, ends / problem.size, adjoint, normal)


def _test(test: tuple[int, int], orbit: _Orbit, reference: _Orbit) -> float:
    """A test function at an orbit, with directions as at a reference; not a number where there is none.

    Shares of ends in leading directions fall with the duration by an exponential, which is taken out of them.
    """
    kind, side = test
    own, beyond = orbit.eigenvalues[side], orbit.eigenvalues[1 - side]
    if kind == _SADDLE:
        return orbit.eigenvalues.saddle_quantity
    if kind == _DOUBLE:
        if len(own) < 2:
            return np.nan
        gap = own[0] - own[1]
        return float((gap * gap).real)
    if kind == _DIVERGENCE:
        return float(beyond[0].real + 2.0 * own[0].real) if own[0].imag and not beyond[0].imag else np.nan
    if len(own) < 2 or own[0].imag:
        return np.nan
    growth = _growth(orbit, side)
    if kind == _ORBIT:
        return float(
            np.copysign(growth, orbit.left[side] @ reference.left[side]) * (orbit.left[side] @ orbit.ends[side])
        )
    sign = (orbit.right[side] @ reference.right[side]) * (orbit.normal @ reference.normal)
    return float(np.copysign(growth, sign) * (orbit.right[side] @ orbit.adjoint[side]))


def _growth(orbit: _Orbit, side: int) -> float:
    """The exponential by which shares in the leading direction fall from the middle of the orbit to an end."""
    return float(np.exp(0.5 * abs(orbit.eigenvalues[side][0].real) * orbit.point.solution.duration[0]))


def _eigenvector(matrix: Float[np.ndarray, "d d"], value: complex) -> Float[np.ndarray, " d"]:
    """The eigenvector of an eigenvalue, real part, of length one."""
    values, vectors = np.linalg.eig(matrix)
    vector = np.real(vectors[:, np.argmin(np.abs(values - value))])
    return vector / np.linalg.norm(vector)


def _kind_of(test: tuple[int, int], point: Connection, jumps: bool) -> int:
    kind, side = test
    if kind == _SADDLE:
        return POINTS.index(f"neutral_{TYPES[leading(point.departure).kind]}")
    words = {
        _DOUBLE: "three_leading" if jumps else "double_real",
        _DIVERGENCE: "neutrally_divergent",
        _ORBIT: "orbit_flip",
        _INCLINATION: "inclination_flip",
    }
    return POINTS.index(f"{words[kind]}_{('stable', 'unstable')[side]}")


# ---- location


def _locate(stretch: Stretch, k: int, test: tuple[int, int], ends: tuple[float, float]) -> SpecialConnection | None:
    """The zero of a test function between two points of a stretch, on the mesh and on a finer one."""
    problem = stretch.problem
    reference = _orbit(problem, stretch.points[k])

    def at(share: float) -> tuple[float, Connection | None]:
        point = stretch.between(k, share)
        return (np.nan if point is None else _test(test, _orbit(problem, point), reference)), point

    share = false_position(lambda s: at(s)[0], ends)
    value, point = at(share) if share is not None else (np.nan, None)
    if share is None or point is None or not np.isfinite(value):
        return None
    jumps = abs(value) > _JUMP * min(map(abs, ends))
    if jumps and test[0] != _DOUBLE:
        return None
    finer = refined(problem, point)
    if finer is None:
        return None
    exact, error, longer = finer
    (low, before), (high, after) = (at(share + step) for step in (-_DIFFERENCE, _DIFFERENCE))
    if before is None or after is None:
        return None
    change, slope = (after.values - before.values) / (2.0 * _DIFFERENCE), (high - low) / (2.0 * _DIFFERENCE)
    orbit = _orbit(problem, exact)
    further = 0.0 if jumps or slope == 0.0 else -_test(test, orbit, reference) / slope
    uncertain = abs(further) * _remainder(test, orbit, longer)
    if slope != 0.0 and not jumps:
        uncertain += _rounding(test, orbit) / abs(slope)
    error = error + np.abs(uncertain * change)
    if np.any(error > problem.widths):  # a change of sign that rounding makes, as of an adjoint solution that grows
        return None
    return SpecialConnection(_kind_of(test, point, jumps), exact.values + further * change, error, exact)


def _remainder(test: tuple[int, int], orbit: _Orbit, longer: float) -> float:
    """Error of a test function on the refined orbit, of what refinement has changed.

    Those of eigenvalues are exact at the parameters, and what is left is of second order. Shares in the leading
    direction come to their limits as the next direction and second orders do against it.
    """
    kind, side = test
    if kind not in (_ORBIT, _INCLINATION):
        return _SECOND_ORDER
    first, second = np.abs(np.real(orbit.eigenvalues[side][:2]))
    left = np.exp(-min(second - first, first) * longer)
    return float(left / (1.0 - left)) + _SECOND_ORDER


def _rounding(test: tuple[int, int], orbit: _Orbit) -> float:
    """Rounding of a test function: of eigenvalues, or of states where shares are taken."""
    kind, side = test
    if kind in (_ORBIT, _INCLINATION):
        return _ROUNDINGS * _growth(orbit, side)
    largest = float(np.abs(orbit.point.departure.jacobian).max())
    return _ROUNDINGS * (largest**2 if kind == _DOUBLE else largest)
