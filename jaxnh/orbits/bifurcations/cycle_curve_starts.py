"""First cycles on curves of bifurcations of cycles that leave points of codimension two of equilibria. Host code.

At an amplitude r, w = r e^{iθ} (Kuznetsov, Meijer, Govaerts and Sautois, Physica D 237 (2008) 3061, where parameters
are those of the normal form; here δ is the change of the user's):

    generalised Hopf, folds of cycles:   Re c₁ = −2 c₂ r² on the curve of Hopf points,  Re λ′δ = c₂ r⁴ away from it,
    double Hopf, Neimark–Sacker:         Re λ_j′δ = −p_ji r² of both pairs j, for the cycle of the pair i,
    zero–Hopf, Neimark–Sacker:           Re λ′δ + d z = −c₂ r²,   b₀δ = −c r²,   c′δ + 2bz = −(g + 2c₂) r²,

where in the last c₂ and g are coefficients of w|w|² and z|w|², and z is of order r²: the last line is that the trace of
the motion of z and r is zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.orbits.bifurcations.centre_manifold import LinearisedEquilibria, first_lyapunov, multilinear
from jaxnh.orbits.bifurcations.codimension_two import DOUBLE_HOPF, GENERALISED_HOPF, ZERO_HOPF
from jaxnh.orbits.bifurcations.equilibrium_forms import NormalForm
from jaxnh.orbits.bifurcations.equilibrium_points import EquilibriumPoint
from jaxnh.orbits.bifurcations.hopf_cycles import SectionPlane
from jaxnh.orbits.continuation import core
from jaxnh.orbits.continuation.core import FINE
from jaxnh.orbits.continuation.equilibrium_curves import EigenvectorEquations, FieldPlane
from jaxnh.orbits.continuation.kinds import FOLD, HOPF, NEIMARK_SACKER

_SHIFT = 1e-3  # lengths along a curve: a rate over it is wrong by its square
_SAMPLED = 256  # places of a cycle where the sign of its height is looked at
_HALVINGS = 50


class CycleStart(NamedTuple):
    """A cycle nearly on a curve of bifurcations.

    Attributes:
        kind: of bifurcation.
        points: crossings of the section, (n, d − 1).
        centre: the equilibrium in the coordinates of the section, (d − 1,).
        values: of both parameters, (2,).
    """

    kind: int
    points: Float[np.ndarray, "n d-1"]
    centre: Float[np.ndarray, " d-1"]
    values: Float[np.ndarray, " 2"]


def cycle_starts(
    plane: FieldPlane, point: EquilibriumPoint, form: NormalForm, section: SectionPlane, amplitudes: Sequence[float]
) -> list[list[CycleStart]]:
    """First cycles of each curve that leaves a point, at all amplitudes that cross the section.

    Args:
        plane: the field.
        point: on a curve of Hopf points; a zero–Hopf point on either.
        form: its normal form.
        section: of the flow.
        amplitudes: r, in units of the coordinates.
    """
    if point.point.kind == GENERALISED_HOPF:
        starts = [(FOLD, 0, _bautin(plane, point, form))]
    elif point.point.kind == DOUBLE_HOPF:
        starts = [(NEIMARK_SACKER, pair, _double_hopf(plane, form, pair)) for pair in (0, 2)]
    elif point.point.kind == ZERO_HOPF and form.coefficients[1] * form.coefficients[2] < 0.0:
        starts = [(NEIMARK_SACKER, 1, _zero_hopf(plane, form))]
    else:
        return []
    curves = list[list[CycleStart]]()
    for kind, variable, centre_at in starts:
        cycles = list[CycleStart]()
        for r in amplitudes:
            centre, values = centre_at(r)
            crossings = _crossings(section, form, variable, centre, r)
            if crossings is not None:
                cycles.append(CycleStart(kind, crossings, np.delete(centre, section.number), values))
        curves.append(cycles)
    return curves


_CentreAt = Callable[[float], tuple[np.ndarray, np.ndarray]]
"""The middle of a cycle of an amplitude, and both parameters."""


class _Unfolding(NamedTuple):
    """Rates over both parameters: of the equilibrium (d, 2), with e_k below it (2, 1, d + 2), and b₀ (2,)."""

    drift: np.ndarray
    ways: np.ndarray
    push: np.ndarray


def _unfold(
    plane: FieldPlane, at: LinearisedEquilibria, zero: tuple[np.ndarray, np.ndarray] | None = None
) -> _Unfolding:
    """The motion of the equilibrium over both parameters; with a zero eigenvalue across its eigenvectors."""
    d = at.u.shape[1]
    slopes = plane.rates(at.u, at.values, np.zeros((1, 1, d)))[1][0]
    matrix, by_values, push = slopes[:, :d], slopes[:, d:], np.zeros(2)
    if zero is not None:
        right, left = zero
        push = left @ by_values
        matrix = matrix + np.outer(right, left)
        by_values = by_values - np.outer(right, push)
    drift = -np.linalg.solve(matrix, by_values)
    ways = np.concatenate([drift.T, np.eye(2)], axis=1)[:, None]
    return _Unfolding(drift, ways, push)


def _rates(plane: FieldPlane, form: NormalForm, variable: int, unfolding: _Unfolding) -> Float[np.ndarray, " 2"]:
    """Rates of the real part of an eigenvalue over both parameters."""
    assert form.manifold is not None
    vector, left = form.vectors[variable], form.manifold.left[variable]
    each = [np.sum(left * multilinear(plane, form.at, [vector, way])) for way in unfolding.ways]
    return np.real(np.array(each))


def _bautin(plane: FieldPlane, point: EquilibriumPoint, form: NormalForm) -> _CentreAt:
    equations, solution, second = EigenvectorEquations(plane, HOPF), point.solution, float(form.coefficients[0])

    def at_place(place: float) -> core.Solution:
        return core.correct(equations, solution.z + place * solution.way, solution.way, FINE)

    def cubic(place: float) -> float:
        there = at_place(place)
        at = equations.split(there.z)
        equilibria = LinearisedEquilibria(at.u, at.values, there.blocks)
        return float(first_lyapunov(plane, equilibria, at.vector(plane), at.frequency(plane))[0])

    rate = (cubic(_SHIFT) - cubic(-_SHIFT)) / (2.0 * _SHIFT)
    unfolding = _unfold(plane, form.at)
    growth = _rates(plane, form, 0, unfolding)
    across = plane.width**2 * growth
    across /= growth @ across

    def centre_at(r: float) -> tuple[np.ndarray, np.ndarray]:
        at, change = equations.split(at_place(-2.0 * second * r**2 / rate).z), second * r**4 * across
        return at.u[0] + unfolding.drift @ change, at.values[0] + change

    return centre_at


def _double_hopf(plane: FieldPlane, form: NormalForm, pair: int) -> _CentreAt:
    unfolding, (p11, p12, p21, p22) = _unfold(plane, form.at), form.coefficients
    growth = np.stack([_rates(plane, form, variable, unfolding) for variable in (0, 2)])
    change = np.linalg.solve(growth, -np.array([[p11, p21], [p12, p22]][pair // 2]))

    def centre_at(r: float) -> tuple[np.ndarray, np.ndarray]:
        return form.at.u[0] + r**2 * unfolding.drift @ change, form.at.values[0] + r**2 * change

    return centre_at


def _zero_hopf(plane: FieldPlane, form: NormalForm) -> _CentreAt:
    assert form.manifold is not None
    g, (right, left) = form.manifold.g, (np.real(form.vectors[0][0]), np.real(form.manifold.left[0][0]))
    unfolding, (b, c, d) = _unfold(plane, form.at, (right, left)), form.coefficients[:3]
    cubic, mixed = (float(np.real(g[key][0])) for key in ((1, (0, 2, 1)), (0, (1, 1, 1))))
    matrix = np.zeros((3, 3))
    matrix[0] = [d, *_rates(plane, form, 1, unfolding)]
    matrix[1, 1:] = unfolding.push
    matrix[2] = [2.0 * b, *_rates(plane, form, 0, unfolding)]
    z, *change = np.linalg.solve(matrix, -np.array([0.5 * cubic, c, mixed + cubic]))

    def centre_at(r: float) -> tuple[np.ndarray, np.ndarray]:
        return form.at.u[0] + r**2 * (z * right + unfolding.drift @ change), form.at.values[0] + r**2 * np.array(change)

    return centre_at


def _crossings(
    section: SectionPlane, form: NormalForm, variable: int, centre: Float[np.ndarray, " d"], r: float
) -> Float[np.ndarray, "n d-1"] | None:
    """The crossing of a cycle with a section, in its coordinates; None without one, or with more than small ones have.

    Of a section that is crossed in both directions the upward crossing comes first.
    """
    assert form.manifold is not None
    count = len(form.vectors)
    square, mean = (
        tuple(order if k == variable else other if k == variable + 1 else 0 for k in range(count))
        for order, other in ((2, 0), (1, 1))
    )
    q, h20, h11 = form.vectors[variable][0], form.manifold.h[square][0], np.real(form.manifold.h[mean][0])

    def cycle(phase: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k d"]:
        turn = np.exp(1j * phase)[:, None]
        return centre + 2.0 * r * np.real(q * turn) + r**2 * (h11 + np.real(h20 * turn**2))

    phases = np.linspace(0.0, 2.0 * np.pi, _SAMPLED + 1)
    heights = cycle(phases) @ section.weights - section.level
    above = heights > 0.0
    rising, falling = np.flatnonzero(~above[:-1] & above[1:]), np.flatnonzero(above[:-1] & ~above[1:])
    if len(rising) != 1 or len(falling) != 1:
        return None
    wanted = {"up": [rising], "down": [falling], "both": [rising, falling]}[section.direction]
    points = list[np.ndarray]()
    for [place] in wanted:
        low, high = phases[place], phases[place + 1]
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            same = (cycle(np.array([middle]))[0] @ section.weights > section.level) == above[place]
            low, high = (middle, high) if same else (low, middle)
        points.append(np.delete(cycle(np.array([high]))[0], section.number))
    return np.stack(points)
