"""Manifolds of dimension two of equilibria near by: graphs over the eigenspace, by polynomials that meet the field.

In coordinates z = z₀ + R V M q + W h(q), with V and W bases of both invariant subspaces of the linearisation and q in
the unit disc, the manifold is a graph h. It is invariant where Dh(q) q' = η', q' and η' the rates of q and of h: solved
for the coefficients of a polynomial by Gauss and Newton at points of the disc. No resonance of the eigenvalues within
the manifold is in the way, as it is of series that make the motion on it linear (Cabré, Fontich and de la Llave,
J. Differ. Equ. 218 (2005) 444). The disc is the largest of radius R whose polynomial is exact enough, and that
all motions leave.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.linalg
from jaxtyping import Float

_DEGREE = 12
_COARSE = 10  # degree of the polynomial that is compared with it
_RADII, _ANGLES = 8, 30  # of the points at which it meets the field
_RING = 64  # points of the boundary that are looked at
_LARGEST, _HALVINGS = 0.5, 9  # sizes: radii that are tried
_STEPS, _AT_REST = 12, 1e-13  # of Newton
_HYPERBOLIC = 1e-6  # of the largest eigenvalue: real parts below it are zero
_SKEW = 20.0  # condition of a basis of eigenvectors: beyond it they are nearly parallel

FieldValues = tuple[Float[np.ndarray, "points d"], Float[np.ndarray, "points d d"]]
Field = Callable[[Float[np.ndarray, "points d"]], FieldValues]
"""Points to rates and their derivatives, in sizes."""


class LocalSurface(NamedTuple):
    """A manifold of dimension two near an equilibrium, in sizes of the coordinates.

    Attributes:
        centre: the equilibrium, (d,).
        eigenvalues: within the manifold, the slower one first, (2,) complex.
        plane: basis of its tangent plane by the radius R of the disc, R V M, (d, 2).
        across: basis of the complement, W, (d, d − 2).
        graph, coarse: coefficients of h, and of that of lower degree, (monomials, d − 2).
    """

    centre: Float[np.ndarray, " d"]
    eigenvalues: np.ndarray
    plane: Float[np.ndarray, "d 2"]
    across: Float[np.ndarray, "d d-2"]
    graph: Float[np.ndarray, "monomials d-2"]
    coarse: Float[np.ndarray, "monomials d-2"]

    def points(self, q: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points d"]:
        """Return the points of the surface at places of the disc."""
        return self.centre + q @ self.plane.T + _monomials(q, _DEGREE)[0] @ self.graph @ self.across.T

    def tangents(self, q: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points d"]:
        """Return tangents along the circles about the equilibrium, of length one."""
        way = np.stack([-q[:, 1], q[:, 0]], axis=1)
        slope = np.einsum("pkm,pk->pm", _monomials(q, _DEGREE)[1], way)
        tangent = way @ self.plane.T + slope @ self.graph @ self.across.T
        return tangent / np.linalg.norm(tangent, axis=1, keepdims=True)

    def errors(self, q: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points d"]:
        """Return how far the polynomial of lower degree is from the points."""
        fine, coarse = _monomials(q, _DEGREE)[0] @ self.graph, _monomials(q, _COARSE)[0] @ self.coarse
        return (coarse - fine) @ self.across.T


def invariant_bases(
    jacobian: Float[np.ndarray, "d d"],
) -> tuple[np.ndarray, Float[np.ndarray, "d 2"], Float[np.ndarray, "d d-2"]] | None:
    """Return the eigenvalues beyond the imaginary axis, a basis of their plane and one of the complement.

    None unless there are two of them, and no others but those on the other side. Motions leave all circles
    about zero in the coordinates of the basis of the plane: of real eigenvalues it has their vectors.
    """
    values = np.linalg.eigvals(jacobian)
    least = _HYPERBOLIC * np.abs(values).max()
    if np.sum(values.real > least) != 2 or np.any(np.abs(values.real) <= least):
        return None
    plane, across = _invariant_basis(jacobian, 1.0)[:, :2], _invariant_basis(jacobian, -1.0)[:, : len(values) - 2]
    inner = plane.T @ jacobian @ plane
    rates, vectors = np.linalg.eig(inner)
    order = np.argsort(np.real(rates), kind="stable")
    rates, vectors = rates[order], vectors[:, order]
    axes = np.real(vectors)
    if abs(np.imag(rates[0])) > 0.0:
        axes = np.stack([axes[:, 0], np.imag(vectors[:, 0])], axis=1)
    if np.linalg.cond(axes) > _SKEW:
        norm = scipy.linalg.solve_continuous_lyapunov(inner.T, np.eye(2))  # of which all motions grow
        axes = np.linalg.inv(np.linalg.cholesky(norm).T)
    axes = axes / np.linalg.norm(axes, axis=0).max()
    return rates, plane @ axes, across


def _invariant_basis(jacobian: Float[np.ndarray, "d d"], sign: float) -> Float[np.ndarray, "d d"]:
    """Return orthonormal vectors, the first of which span the eigenvectors of real parts of a sign."""
    return np.asarray(scipy.linalg.schur(jacobian, output="real", sort=lambda x, y=0.0: sign * x > 0.0)[1])


def fit_local_surface(
    field: Field, centre: Float[np.ndarray, " d"], jacobian: Float[np.ndarray, "d d"], tolerance: float
) -> LocalSurface | None:
    """Return the manifold near an equilibrium; None where it has not two dimensions, or no polynomial meets the field.

    Args:
        field: rates and derivatives in time that runs so that motions leave the equilibrium along the manifold.
        centre: the equilibrium.
        jacobian: of the field there.
        tolerance: largest distance of the polynomials of both degrees, in sizes.
    """
    bases = invariant_bases(jacobian)
    if bases is None:
        return None
    rates, plane, across = bases
    radii = np.cos((2 * np.arange(_RADII) + 1) * np.pi / (4 * _RADII))
    angles = 2 * np.pi * np.arange(_ANGLES) / _ANGLES
    disc = np.concatenate([r * np.stack([np.cos(angles), np.sin(angles)], axis=1) for r in radii])
    turn = 2 * np.pi * np.arange(_RING) / _RING
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    for k in range(_HALVINGS + 1):
        radius = _LARGEST / 2**k
        graphs = [_graph(field, centre, radius * plane, across, disc, degree) for degree in (_DEGREE, _COARSE)]
        if graphs[0] is None or graphs[1] is None:
            continue
        surface = LocalSurface(centre, rates, radius * plane, across, graphs[0], graphs[1])
        rate, _ = field(surface.points(ring))
        outward = np.linalg.solve(np.concatenate([surface.plane, across], axis=1), rate.T)[:2]
        if np.abs(surface.errors(ring)).max() < tolerance and np.all(np.sum(outward.T * ring, axis=1) > 0.0):
            return surface
    return None


def _graph(
    field: Field,
    centre: Float[np.ndarray, " d"],
    plane: Float[np.ndarray, "d 2"],
    across: Float[np.ndarray, "d e"],
    q: Float[np.ndarray, "points 2"],
    degree: int,
) -> Float[np.ndarray, "monomials e"] | None:
    """Return the coefficients of a polynomial that meets the field at points of the disc, None without."""
    powers, slopes = _monomials(q, degree)
    count, e = powers.shape[1], across.shape[1]
    inverse = np.linalg.inv(np.concatenate([plane, across], axis=1))
    own, other = inverse[:2], inverse[2:]
    coefficients = np.zeros((count, e))
    for _ in range(_STEPS):
        rate, jacobian = field(centre + q @ plane.T + powers @ coefficients @ across.T)
        if not (np.isfinite(rate).all() and np.isfinite(jacobian).all()):
            return None
        moved, slope = rate @ own.T, np.einsum("pkm,me->pke", slopes, coefficients)
        residual = np.einsum("pk,pke->pe", moved, slope) - rate @ other.T
        bent = np.einsum("pij,je->pie", jacobian, across)  # what a change of h does to the rates
        of_value = np.einsum("pke,ki,pif->pef", slope, own, bent) - np.einsum("ei,pif->pef", other, bent)
        carried = np.einsum("pk,pkm->pm", moved, slopes)
        matrix = of_value[:, :, None] * powers[:, None, :, None] + carried[:, None, :, None] * np.eye(e)[:, None]
        # Normal equations: their rounding is gone with the residual. Of so few unknowns they take a millisecond, of
        # which threads of a factorisation would make up to 200 on cores that others use too.
        matrix = matrix.reshape(-1, count * e)
        square, right = np.einsum("pi,pj->ij", matrix, matrix), np.einsum("pi,p->i", matrix, residual.ravel())
        try:
            step = np.linalg.solve(square, right).reshape(count, e)
        except np.linalg.LinAlgError:
            return None
        coefficients = coefficients - step
        if not np.isfinite(coefficients).all():
            return None
        if np.abs(step).max() < _AT_REST * (1.0 + np.abs(coefficients).max()):
            return coefficients
    return None


def _monomials(
    q: Float[np.ndarray, "points 2"], degree: int
) -> tuple[Float[np.ndarray, "points monomials"], Float[np.ndarray, "points 2 monomials"]]:
    """Return all monomials of the degrees from two on, and their derivatives."""
    i = np.concatenate([np.arange(n + 1) for n in range(2, degree + 1)])
    j = np.concatenate([n - np.arange(n + 1) for n in range(2, degree + 1)])
    x, y = (q[:, k, None] ** np.arange(degree + 1) for k in (0, 1))
    of_x = x[:, np.maximum(i - 1, 0)] * i * y[:, j]
    of_y = x[:, i] * y[:, np.maximum(j - 1, 0)] * j
    return x[:, i] * y[:, j], np.stack([of_x, of_y], axis=1)
