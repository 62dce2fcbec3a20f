"""Symmetric periodic orbits of a reversible return map, by Newton from points that the reversal keeps.

With R P R = P⁻¹ an orbit of n returns is symmetric where a point u of it is kept by R or by R P, and the image half an
orbit later as well (DeVogelaere, Contributions to the Theory of Nonlinear Oscillations IV (1958) 53; Lamb and Roberts,
Physica D 112 (1998) 1). With k = [n/2] that is

    R P^a(u) = u,    R P^(n-k+a)(u) = P^k(u),    a = 0, or of even n also 1.

Where R keeps half of the dimensions these conditions are as many as the unknowns, and symmetric orbits are isolated.
Their multipliers come in pairs μ, 1/μ.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Complex, Float

from jaxnh.analyses.base import LANE, Entry, OptionError, number_variable, variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner, iterate_units, select
from jaxnh.analyses.reversal.involution import image_of_point
from jaxnh.analyses.section_points import states_at
from jaxnh.maps.family import Maps
from jaxnh.maps.iterate import derivatives
from jaxnh.maps.section import System, outputs
from jaxnh.orbits.multipliers import multipliers
from jaxnh.systems.flow import Parameters
from jaxnh.systems.reversal import Reversal
from jaxnh.systems.state import Vector

_STARTS = 256  # of Newton in every lane, for each number of returns
_STEPS = 20
_LARGEST_STEP = 0.25  # sizes of the motion
_CONVERGED = 1e-8  # residual, in these sizes
_NEAR = 1e-5  # in these sizes: points of one orbit, located twice
_BOX = 1.5  # largest moduli of coordinates, within which the starts are

_Conditions = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


class SymmetricOrbit(NamedTuple):
    """A symmetric periodic orbit of n returns.

    Attributes:
        points: section coordinates, from one that the reversal, or it after a return, keeps, (n, d).
        multipliers: largest modulus first, (d,).
        residual: largest component of P(u_i) − u_(i+1) in sizes of the motion.
        pairing: largest modulus of μ μ' − 1 over the pairs of the largest multiplier and the least and so on.
    """

    points: Float[np.ndarray, "n d"]
    multipliers: Complex[np.ndarray, " d"]
    residual: float
    pairing: float


def symmetric_orbits(
    batch: LaneBatch, lanes: LaneRunner, reversal: Reversal, strobe: Maps, size: Float[np.ndarray, "lanes d"], most: int
) -> list[list[SymmetricOrbit]]:
    """Return the symmetric orbits of every lane that Newton has led to, by number of returns up to `most`.

    Args:
        strobe: P, from an instant that the reversal keeps.
        size: largest modulus of each coordinate, of an angle π.
        most: largest number of returns.
    """
    d, wrap = batch.chart.dimension, batch.chart.wrap
    lane = np.repeat(np.arange(batch.count), _STARTS)
    p = select(dict(batch.p), lane)
    draws = np.random.default_rng(0).uniform(-1.0, 1.0, (_STARTS, d))
    u = np.tile(draws, (batch.count, 1)) * np.where(batch.chart.angles, 1.0, _BOX) * size[lane]
    image, _ = lanes(_with_slope, (batch.system, reversal.signs), (u, p))
    u = u + 0.5 * wrap(np.asarray(image) - u)
    orbits: list[list[SymmetricOrbit]] = [[] for _ in range(batch.count)]
    for n in range(1, most + 1):
        for a in range(2 - n % 2):
            conditions = _conditions(batch, lanes, reversal, strobe, p, n, a)
            roots, converged = _solve(conditions, u, size[lane], wrap)
            for number in range(batch.count):
                mine = roots[converged & (lane == number)]
                if len(mine):
                    closed = _orbits_of_lane(batch.take(np.array([number])), lanes, strobe, mine, n, size[number])
                    _add_new(orbits[number], closed, size[number], wrap)
    return orbits


def _with_slope(
    system: System, signs: Vector | None, u: Float[Array, " d"], p: Parameters
) -> tuple[Float[Array, " d"], Float[Array, "d d"]]:
    """Return R in section coordinates, and its derivative."""

    def image(u: Array) -> Array:
        return image_of_point(system, signs, u, p)

    return image(u), jax.jacfwd(image)(u)


def check_dimension(batch: LaneBatch, reversal: Reversal) -> None:
    """Check that a reversal keeps half of the dimensions.

    Raises:
        OptionError: it keeps more, or fewer.
    """
    d = batch.chart.dimension
    u = np.random.default_rng(0).uniform(-1.0, 1.0, (8, d))
    p = {name: values[0] for name, values in batch.p.items()}
    slopes = jax.vmap(lambda u: _with_slope(batch.system, reversal.signs, u, p)[1])(u)
    rank = int(np.median(np.linalg.matrix_rank(np.asarray(slopes) - np.eye(d), tol=1e-6)))
    if 2 * rank != d:
        raise OptionError(
            "symmetric orbits are isolated where the derivative of a reversal keeps half of the dimensions, "
            f"and that of this one keeps {d - rank} of {d}",
            "max_period",
        )


def _conditions(
    batch: LaneBatch, lanes: LaneRunner, reversal: Reversal, strobe: Maps, p: Parameters, n: int, a: int
) -> _Conditions:
    """Return what is to vanish at points of starts with these numbers, (points, 2 d), and its derivative."""
    d, k = batch.chart.dimension, n // 2

    def moved(u: np.ndarray, own: Parameters, count: int) -> tuple[np.ndarray, np.ndarray]:
        if not count:
            return u, np.broadcast_to(np.eye(d), (len(u), d, d))
        made = lanes(derivatives, (strobe, np.int32(count)), (u, own))
        return np.asarray(made.image), np.asarray(made.monodromy)

    def reversed_after(u: np.ndarray, own: Parameters, count: int) -> tuple[np.ndarray, np.ndarray]:
        image, slope = moved(u, own, count)
        back, turned = lanes(_with_slope, (batch.system, reversal.signs), (image, own))
        return np.asarray(back), np.asarray(turned) @ slope

    def at(u: np.ndarray, number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        own = select(p, number)
        (one, of_one), (half, of_half) = reversed_after(u, own, a), moved(u, own, k)
        other, of_other = reversed_after(u, own, n - k + a)
        missing = np.concatenate([batch.chart.wrap(one - u), batch.chart.wrap(other - half)], axis=1)
        return missing, np.concatenate([of_one - np.eye(d), of_other - of_half], axis=1)

    return at


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def _solve(
    conditions: _Conditions, u: Float[np.ndarray, "starts d"], size: Float[np.ndarray, "starts d"], wrap: Callable
) -> tuple[Float[np.ndarray, "starts d"], np.ndarray]:
    """Return points by Newton in the least-squares sense, the conditions being twice as many and of half the rank."""
    u, active, residual = np.array(u), np.arange(len(u)), np.full(len(u), np.inf)
    for _ in range(_STEPS):
        missing, slope = conditions(u[active], active)
        before, unit = residual[active], np.concatenate([size[active]] * 2, axis=1)
        residual[active] = np.max(np.abs(missing / unit), axis=1)
        finite = np.isfinite(residual[active]) & np.isfinite(slope).all(axis=(1, 2))
        settled = (before < _CONVERGED) & finite
        active, missing, slope, unit = (x[finite & ~settled] for x in (active, missing, slope, unit))
        if not len(active):
            break
        scaled = slope * size[active][:, None, :] / unit[:, :, None]
        step = -np.einsum("nij,nj->ni", np.linalg.pinv(scaled, rcond=1e-10), missing / unit)
        length = np.max(np.abs(step), axis=1)
        step *= np.where(length > _LARGEST_STEP, _LARGEST_STEP / length, 1.0)[:, None]
        u[active] = wrap(u[active] + step * size[active])
    return u, residual < _CONVERGED


def _orbits_of_lane(
    batch: LaneBatch, lanes: LaneRunner, strobe: Maps, u: Float[np.ndarray, "starts d"], n: int, size: np.ndarray
) -> list[SymmetricOrbit]:
    """Return the orbits of n returns of points of a lane, those of fewer returns left out."""
    p = {name: np.repeat(values, len(u)) for name, values in batch.p.items()}
    wrap, points, blocks = batch.chart.wrap, [u], list[np.ndarray]()
    for _ in range(n):
        made = lanes(derivatives, (strobe, np.int32(1)), (points[-1], p))
        points.append(np.asarray(made.image))
        blocks.append(np.asarray(made.monodromy))
    gap = np.array([np.max(np.abs(wrap(each - u) / size), axis=1) for each in points[1:]])
    primitive = (gap[:-1] > _NEAR).all(axis=0) & (gap[-1] < np.sqrt(_CONVERGED))
    values = multipliers(np.stack(blocks, axis=1))
    path = np.stack(points[:-1], axis=1)
    pairs = np.max(np.abs(values * values[:, ::-1] - 1.0), axis=1)
    return [SymmetricOrbit(path[i], values[i], float(gap[-1, i]), float(pairs[i])) for i in np.flatnonzero(primitive)]


def _add_new(known: list[SymmetricOrbit], orbits: list[SymmetricOrbit], size: np.ndarray, wrap: Callable) -> None:
    for orbit in orbits:
        others = [other.points for other in known if len(other.points) == len(orbit.points)]
        if not any(np.max(np.abs(wrap(each - orbit.points[0]) / size), axis=1).min() < _NEAR for each in others):
            known.append(orbit)


def orbit_variables(batch: LaneBatch, lanes: LaneRunner, orbits: list[list[SymmetricOrbit]]) -> dict[str, Entry]:
    """Return symmetric orbits as variables over (lane, orbit), by number of returns; 0 where a lane has fewer."""
    count, d = max(map(len, orbits), default=0), batch.chart.dimension
    dims = (LANE, "orbit")
    period = np.zeros((batch.count, count), np.int32)
    values = np.full((batch.count, count, d, 2), np.nan)
    residual, pairing = np.full((2, batch.count, count), np.nan)
    points = np.full((batch.count, count, d), np.nan)
    for lane, of_lane in enumerate(orbits):
        for number, orbit in enumerate(of_lane):
            at = lane, number
            period[at], residual[at], pairing[at] = len(orbit.points), orbit.residual, orbit.pairing
            values[at], points[at] = (
                np.stack([np.real(orbit.multipliers), np.imag(orbit.multipliers)], axis=1),
                orbit.points[0],
            )
    variables = {
        "orbit_period": number_variable(
            dims, period, "period of the symmetric orbit", ("none",), counted_in=iterate_units(batch.system)
        ),
        "orbit_multipliers": variable(
            (*dims, "multiplier", "part"), values, "Floquet multipliers of the orbit, real and imaginary part"
        ),
        "orbit_pairing": variable(dims, pairing, "largest violation of the pairs of multipliers, |μ μ' - 1|"),
        "orbit_residual": variable(dims, residual, "largest component of P^n(u) - u, in sizes of the motion"),
    }
    if count:
        states = states_at(batch, lanes, points.reshape(-1, d))
        named = outputs(batch.flow, jax.tree.map(lambda leaf: np.asarray(leaf)[:, None], states), np.zeros(1))
        for name in (name for name in batch.flow.coordinates if name in named):
            words, data = (
                f"{named[name].long_name} of the orbit's first point",
                np.reshape(named[name].data, period.shape),
            )
            variables[f"{name}_points"] = variable(dims, data, words, **named[name].attrs)
    return variables
