"""Normal forms at points of codimension two of equilibria. Host code.

Coefficients are those of Kuznetsov (Elements of Applied Bifurcation Theory, 2004, 8), with eigenvectors of length one
in units of the coordinates, and signs of real ones such that the first coefficient is not negative.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from jaxnh.orbits.bifurcations.bogdanov_takens import jordan_chain, quadratic_coefficients
from jaxnh.orbits.bifurcations.centre_manifold import (
    PAIR,
    CentreManifold,
    LinearisedEquilibria,
    Order,
    centre_manifold,
)
from jaxnh.orbits.bifurcations.codimension_two import BOGDANOV_TAKENS, CUSP, DOUBLE_HOPF, GENERALISED_HOPF, ZERO_HOPF
from jaxnh.orbits.bifurcations.equilibrium_points import EquilibriumPoint
from jaxnh.orbits.continuation.equilibrium_curves import FieldPlane, critical_equilibria
from jaxnh.orbits.continuation.kinds import FOLD, HOPF

TERMS = {
    CUSP: ("z' = c z³", "c"),
    BOGDANOV_TAKENS: ("z₁' = z₂, z₂' = a z₁² + b z₁ z₂", "a, b"),
    GENERALISED_HOPF: ("w' = iω w + c₁ w|w|² + c₂ w|w|⁴, Re c₁ = 0", "Re c₂"),
    ZERO_HOPF: ("z' = b z² + c |w|², w' = iω w + d z w", "b, c, Re d"),
    DOUBLE_HOPF: ("w_i' = iω_i w_i + Σ_j p_ij w_i |w_j|²", "Re p₁₁, Re p₁₂, Re p₂₁, Re p₂₂"),
}
"""Normal forms of points of codimension two, and what is given of them."""

COUNT = 4
"""Coefficients of a point, at most."""

_FORMS: dict[int, tuple[tuple[tuple[int, ...], ...], list[Order]]] = {
    CUSP: (((0,),), [(3,)]),
    GENERALISED_HOPF: (PAIR, [(3, 2)]),
    ZERO_HOPF: (((0,), *PAIR), [(3, 0, 0), (1, 1, 1), (2, 1, 0), (0, 2, 1)]),
    DOUBLE_HOPF: (
        ((1, 0), (-1, 0), (0, 1), (0, -1)),
        [(2, 1, 0, 0), (1, 0, 1, 1), (1, 1, 1, 0), (0, 0, 2, 1)],
    ),
}


class NormalForm(NamedTuple):
    """The normal form at a point.

    Attributes:
        coefficients: as `TERMS` says, (COUNT,), filled up with NaN.
        at: the equilibrium, one lane.
        vectors: critical eigenvectors, conjugate ones of pairs among them, (1, d) each; none at Bogdanov–Takens points.
        manifold: the centre manifold; none at Bogdanov–Takens points.
    """

    coefficients: Float[np.ndarray, " 4"]
    at: LinearisedEquilibria
    vectors: Sequence[Complex[np.ndarray, "1 d"]]
    manifold: CentreManifold | None


def normal_form(plane: FieldPlane, point: EquilibriumPoint) -> NormalForm:
    """The normal form at a point of codimension two."""
    kind, matrix = point.point.kind, point.solution.blocks
    at = LinearisedEquilibria(point.point.points, point.point.values[None], matrix)
    coefficients = np.full(COUNT, np.nan)
    if kind == BOGDANOV_TAKENS:
        coefficients[:2] = _bogdanov_takens(plane, at)
        return NormalForm(coefficients, at, (), None)
    vectors, eigenvalues = list[np.ndarray](), list[np.ndarray]()
    if kind in (CUSP, ZERO_HOPF):
        real = critical_equilibria(plane, FOLD, at.u, at.values, matrix).vector(plane)
        vectors, eigenvalues = [real], [np.zeros(1, complex)]
    for q, frequency in _pairs(plane, at, {CUSP: 0, DOUBLE_HOPF: 2}.get(kind, 1)):
        vectors += [q, np.conj(q)]
        eigenvalues += [1j * frequency, -1j * frequency]
    manifold = centre_manifold(plane, at, vectors, eigenvalues, *_FORMS[kind])
    if kind == ZERO_HOPF and np.real(manifold.g[0, (2, 0, 0)][0]) < 0.0:
        vectors[0] = -vectors[0]
        manifold = centre_manifold(plane, at, vectors, eigenvalues, *_FORMS[kind])
    known = _coefficients(kind, manifold)
    coefficients[: len(known)] = known
    return NormalForm(coefficients, at, vectors, manifold)


def _pairs(plane: FieldPlane, at: LinearisedEquilibria, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Eigenvectors and frequencies of imaginary pairs, the fastest first."""
    pairs, other = list[tuple[np.ndarray, np.ndarray]](), None
    for _ in range(count):
        pair = critical_equilibria(plane, HOPF, at.u, at.values, at.matrix, other)
        other = pair.frequency(plane)
        pairs.append((pair.vector(plane), other))
    return sorted(pairs, key=lambda pair: -float(pair[1][0]))


def _coefficients(kind: int, manifold: CentreManifold) -> list[float]:
    def real(variable: int, *order: int) -> float:
        return float(np.real(manifold.g[variable, order][0]))

    if kind == CUSP:
        return [real(0, 3) / 6.0]
    if kind == GENERALISED_HOPF:
        return [real(0, 3, 2) / 12.0]
    if kind == ZERO_HOPF:
        return [real(0, 2, 0, 0) / 2.0, real(0, 0, 1, 1), real(1, 1, 1, 0)]
    return [real(0, 2, 1, 0, 0) / 2.0, real(0, 1, 0, 1, 1), real(2, 1, 1, 1, 0), real(2, 0, 0, 2, 1) / 2.0]


def _bogdanov_takens(plane: FieldPlane, at: LinearisedEquilibria) -> tuple[float, float]:
    """a and b (`bogdanov_takens`)."""
    a, b = quadratic_coefficients(plane, at, jordan_chain(at.matrix[0]))
    sign = -1.0 if a < 0.0 else 1.0
    return sign * a, sign * b
