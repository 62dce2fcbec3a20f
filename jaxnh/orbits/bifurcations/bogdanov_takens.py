"""Bogdanov–Takens points: their normal form over both parameters, and homoclinic orbits that begin there. Host code.

On the centre manifold u = H(w; β) over the parameters K(β) of the flow, the motion is

    w₀' = w₁,   w₁' = β₁ + β₂ w₁ + a w₀² + b w₀ w₁ + …

(Kuznetsov, Int. J. Bifurcation Chaos 15 (2005) 3535; H and K as in Al-Hdaibat, Govaerts, Kuznetsov and Meijer, SIAM J.
Appl. Dyn. Syst. 15 (2016) 952). With w₀ = ε² x / a, β₁ = −4 ε⁴ / a, β₂ = ε² τ b / a and the time s / ε this is
x'' = x² − 4 + ε (b / a) (τ + x) x', whose orbit is by a time of its own (Lindstedt and Poincaré)

    x = 2 − 6 sech² ξ,   dξ/ds = 1 − k tanh ξ,   k = 6 ε b / 7a,   τ = 10/7,

all up to a share ε². Terms of the normal form that are not here have as small a share.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.orbits.bifurcations.centre_manifold import LinearisedEquilibria, multilinear
from jaxnh.orbits.collocation.equations import BoundarySolution
from jaxnh.orbits.collocation.paths import path_through
from jaxnh.orbits.continuation.equilibrium_curves import FieldPlane

_TAU = 10.0 / 7.0
_BENT = 0.5  # k, at most: rates at both ends of the orbit are then as 1 to 3
_HALF = 5.0  # ξ at the ends: 1e-4 of the orbit's extent from the saddle
_SAMPLES = 400
_INTERVALS = 60
_LEAST = 1e-9  # of what they are sums of: smaller numbers are rounding


class JordanChain(NamedTuple):
    """A q₀ = 0, A q₁ = q₀, p₁ A = 0, p₀ A = p₁, p_i · q_j = δ_ij, in units of the coordinates, (d,) each; |q₀| = 1."""

    q0: Float[np.ndarray, " d"]
    q1: Float[np.ndarray, " d"]
    p0: Float[np.ndarray, " d"]
    p1: Float[np.ndarray, " d"]
    bordered: Float[np.ndarray, "d+1 d+1"]

    def inverse(self, rate: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
        """The x of A x = rate that is orthogonal to q₀, for a rate that p₁ has no share of."""
        return np.linalg.solve(self.bordered, np.append(rate, 0.0))[:-1]


def jordan_chain(matrix: Float[np.ndarray, "d d"]) -> JordanChain:
    """The chain of a linearisation with a double zero eigenvalue (Kuznetsov 2004, 8.4)."""
    left, _, right = np.linalg.svd(matrix)
    q0, p1 = right[-1], left[:, -1]
    bordered = np.block([[matrix, p1[:, None]], [q0[None], np.zeros((1, 1))]])
    q1 = np.linalg.solve(bordered, np.append(q0, 0.0))[:-1]
    p1 = p1 / (p1 @ q1)
    p0 = np.linalg.solve(bordered.T, np.append(p1, 0.0))[:-1]
    return JordanChain(q0, q1, p0 - (p0 @ q1) * p1, p1, bordered)


class Unfolding(NamedTuple):
    """The normal form at a point, and its centre manifold over both parameters.

    Attributes:
        a, b: coefficients; their signs are those of q₀.
        origin: the equilibrium and both parameters, (d + 2,).
        terms: what w₀, w₁, β₁, β₂, w₀²/2, w₀β₂ and β₂²/2 add to both, (7, d + 2).
    """

    a: float
    b: float
    origin: Float[np.ndarray, " d+2"]
    terms: Float[np.ndarray, "7 d+2"]

    def states_and_values(
        self, w0: Float[np.ndarray, " k"], w1: Float[np.ndarray, " k"], beta: tuple[float, float]
    ) -> Float[np.ndarray, "k d+2"]:
        """States on the centre manifold with the parameters, from those of the normal form."""
        one, (first, second) = np.ones_like(w0), beta
        weights = [w0, w1, first * one, second * one, 0.5 * w0**2, second * w0, 0.5 * second**2 * one]
        return self.origin + np.stack(weights, axis=1) @ self.terms


def quadratic_coefficients(plane: FieldPlane, at: LinearisedEquilibria, chain: JordanChain) -> tuple[float, float]:
    """The coefficients a and b of the normal form.

    Args:
        plane: the field.
        at: the equilibrium, one lane.
        chain: of its linearisation.
    """
    of_both, of_first = (_form(plane, at, chain.q0, other) for other in (chain.q1, chain.q0))
    a, b = 0.5 * chain.p1 @ of_first, chain.p0 @ of_first + chain.p1 @ of_both
    return float(a), float(b)


def unfold(plane: FieldPlane, at: LinearisedEquilibria) -> Unfolding | None:
    """The normal form over both parameters, None at a point that they do not unfold or where a or b is zero.

    The homological equation A H + … = H_w w' has a solution at each order where p₁ has no share of the rest: at β₁ and
    β₂² this gives the parameters' shares across the curves of folds and Hopf points, which touch; at w₀β₂ and w₁β₂ the
    one along them and the shift of the equilibrium.

    Args:
        plane: the field.
        at: the equilibrium, one lane.
    """
    chain, d = jordan_chain(at.matrix[0]), at.u.shape[1]
    q0, q1, p0, p1, _ = chain
    a, b = quadratic_coefficients(plane, at, chain)
    by_values = plane.rates(at.u, at.values, np.zeros((1, 1, d)))[1][0][:, d:] * plane.width
    push = p1 @ by_values
    if np.linalg.norm(push) <= _LEAST * np.linalg.norm(p1) * np.linalg.norm(by_values) or not a * b:
        return None
    across, along = push / (push @ push), np.array([-push[1], push[0]]) / np.linalg.norm(push)
    first = np.concatenate([chain.inverse(q1 - by_values @ across), plane.width * across])
    drift = np.concatenate([chain.inverse(-by_values @ along), plane.width * along])
    of_q0, of_q1 = (_form(plane, at, q, drift) for q in (q0, q1))
    conditions = np.array([[p1 @ of_q0, 2.0 * a], [p0 @ of_q0 + p1 @ of_q1, b]])
    determinant = np.linalg.det(conditions)
    if abs(determinant) <= _LEAST * np.prod(np.linalg.norm(conditions, axis=1)):
        return None
    share, shift = np.linalg.solve(conditions, [0.0, 1.0])
    second = share * drift + shift * np.append(q0, [0.0, 0.0])
    rest = _form(plane, at, second, second)
    bent = -(p1 @ rest) * across
    quadratic = [
        (chain.inverse(2.0 * a * q1 - _form(plane, at, q0, q0)), np.zeros(2)),
        (chain.inverse(-_form(plane, at, q0, second)), np.zeros(2)),
        (chain.inverse(-rest - by_values @ bent), plane.width * bent),
    ]
    linear = [np.append(q0, [0.0, 0.0]), np.append(q1, [0.0, 0.0]), first, second]
    terms = np.stack([*linear, *(np.concatenate(parts) for parts in quadratic)])
    return Unfolding(a, b, np.concatenate([at.u[0], at.values[0]]), terms)


def _form(
    plane: FieldPlane, at: LinearisedEquilibria, first: Float[np.ndarray, " n"], second: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " d"]:
    """The second derivative along two directions, which may have parts of both parameters."""
    return np.real(multilinear(plane, at, [first[None], second[None]])[0])


class HomoclinicGuess(NamedTuple):
    """A homoclinic orbit near a point, up to a share ε².

    Attributes:
        path: path, duration and both parameters, one lane.
        saddle: its saddle, (d,).
    """

    path: BoundarySolution
    saddle: Float[np.ndarray, " d"]


def amplitude_of(plane: FieldPlane, unfolding: Unfolding, extent: float) -> float:
    """The ε of an orbit of an extent in sizes; less where the orbit would not be near one of the normal form.

    Args:
        plane: the field.
        unfolding: at the point.
        extent: of the orbit along q₀, in sizes.
    """
    largest = np.abs(unfolding.terms[0, :-2] / plane.size).max()
    return float(
        min(np.sqrt(extent * abs(unfolding.a) / (6.0 * largest)), _BENT * 7.0 * abs(unfolding.a / unfolding.b) / 6.0)
    )


def homoclinic_guess(unfolding: Unfolding, eps: float) -> HomoclinicGuess:
    """The homoclinic orbit of the normal form at an ε."""
    a, b = unfolding.a, unfolding.b
    k, xi = 6.0 * eps * b / (7.0 * a), np.linspace(-_HALF, _HALF, _SAMPLES + 1)
    square, slope = 1.0 / np.cosh(xi) ** 2, np.tanh(xi)
    s = (xi + k * np.log(np.cosh(xi) - k * np.sinh(xi))) / (1.0 - k**2)
    x, speed = 2.0 - 6.0 * square, 12.0 * (1.0 - k * slope) * square * slope
    beta = -4.0 * eps**4 / a, eps**2 * _TAU * b / a
    w0, w1 = eps**2 / a * np.append(x, 2.0), eps**3 / a * np.append(speed, 0.0)
    known = unfolding.states_and_values(w0, w1, beta)
    path, duration = path_through(s / eps, known[:-1, :-2], _INTERVALS)
    return HomoclinicGuess(BoundarySolution(path, np.array([duration]), known[:1, -2:]), known[-1, :-2])
