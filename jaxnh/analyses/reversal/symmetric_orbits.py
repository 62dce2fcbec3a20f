"""Symmetric periodic orbits of a reversible return map, by Newton from points that the reversal keeps.

With R P R = P⁻¹ an orbit of n returns is symmetric where a point u of it is kept by R or by R P, and the image half an
orbit later as well (DeVogelaere, Contributions to the Theory of Nonlinear Oscillations IV (1958) 53; Lamb and Roberts,
Physica D 112 (1998) 1). With k = [n/2] that is

    R P^a(u) = u,    R P^(n-k+a)(u) = P^k(u),    a = 0, or of even n also 1.

In d dimensions, with f those of the points that R keeps, u has f unknowns and half an orbit later there are d − f
conditions. Where f is d/2 symmetric orbits are isolated. Where f is (d − 1)/2, as with an angle that R keeps of two
positions and an angle, they exist at isolated values of a parameter, one unknown more. A multiplier is one there: it is
the fold in which two orbits are born that are images of each other. All multipliers come in pairs μ, 1/μ, and the one
that is left of an odd number is a pair with itself.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from jaxnh.analyses.base import LANE, Entry, OptionError, number_variable, variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner, iterate_units
from jaxnh.analyses.coordinates import named_points
from jaxnh.analyses.reversal.involution import NONE, choose_reversal, image_of_point, reversal_of
from jaxnh.analyses.table_arrays import padded, real_and_imaginary
from jaxnh.maps.family import Maps
from jaxnh.maps.iterate import derivatives
from jaxnh.maps.section import System
from jaxnh.orbits.multipliers import multipliers
from jaxnh.systems.flow import Parameters
from jaxnh.systems.reversal import Reversal, describe_reversal
from jaxnh.systems.rows import select
from jaxnh.systems.state import Vector

_STARTS = 256  # of Newton in every lane, for each number of returns
_STEPS = 20
_LARGEST_STEP = 0.25  # sizes of the motion
_CONVERGED = 1e-8  # residual, in these sizes
_NEAR = 1e-5  # in these sizes: points of one orbit, located twice
_BOX = 1.5  # largest moduli of coordinates, within which the starts are
_LAST_DIGITS = 4.0  # of a size: rounding of an image of few steps
_EXACT = 1e-9  # of the distance of a point from its image: it is kept
_SAMPLES = 64  # points from which those that a reversal keeps are looked for

_Conditions = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


class SymmetricOrbit(NamedTuple):
    """A symmetric periodic orbit of n returns.

    Attributes:
        points: section coordinates, from one that the reversal, or it after a return, keeps, (n, d).
        multipliers: largest modulus first, (d,).
        residual: largest component of P(u_i) − u_(i+1) in sizes of the motion.
        pairing: largest modulus of μ μ' − 1 over the multipliers μ, each with the one μ' that makes it least.
        value: of the parameter that is an unknown, not a number where there is none.
        value_error: what twice the steps change it by, twice, the last step of Newton, and rounding.
    """

    points: Float[np.ndarray, "n d"]
    multipliers: Complex[np.ndarray, " d"]
    residual: float
    pairing: float
    value: float
    value_error: float


def symmetric_orbits(
    batch: LaneBatch,
    lanes: LaneRunner,
    symmetry: Symmetry,
    strobes: tuple[Maps, Maps],
    size: Float[np.ndarray, "lanes d"],
    most: int,
) -> list[list[SymmetricOrbit]]:
    """Return the symmetric orbits of every lane that Newton has led to, by number of returns up to `most`.

    Where a parameter is an unknown, those of a lane are at values nearer to its own than to that of another lane.

    Args:
        symmetry: the reversal, and the parameter that is an unknown.
        strobes: P, from an instant that the reversal keeps, and P with twice the steps.
        size: largest modulus of each coordinate, of an angle π.
        most: largest number of returns.
    """
    d, wrap, name = batch.chart.dimension, batch.chart.wrap, symmetry.parameter
    lane = np.repeat(np.arange(batch.count), _STARTS)
    p = batch.parameters_of(lane)
    draws = np.random.default_rng(0).uniform(-1.0, 1.0, (_STARTS, d + 1))
    u = np.tile(draws[:, :d], (batch.count, 1)) * np.where(batch.chart.angles, 1.0, _BOX) * size[lane]
    image, _ = lanes(_with_slope, (batch.system, symmetry.reversal.signs), (u, p), static=(None,))
    x, unit, edges = u + 0.5 * wrap(np.asarray(image) - u), size, np.empty((batch.count, 0))
    if name:
        edges = _cells(batch.first_axis.values)
        widths = np.diff(edges, axis=1)
        widths = np.where(np.isfinite(widths), widths, np.maximum(np.abs(batch.p[name])[:, None], 1.0))
        values = p[name] + 0.5 * np.tile(draws[:, d], batch.count) * widths[lane, 0]
        x, unit = np.column_stack([x, values]), np.hstack([size, widths])
    orbits: list[list[SymmetricOrbit]] = [[] for _ in range(batch.count)]
    for n in range(1, most + 1):
        for a in range(2 - n % 2):
            conditions = [_conditions(batch, lanes, symmetry, strobe, p, n, a) for strobe in strobes]
            roots = _solve(conditions[0], x, unit[lane], wrap, d)
            if name:
                roots = _within_cells(roots, edges[lane], d)
                roots = _with_errors(conditions[1], roots, unit[lane], wrap, d, n * batch.steps)
            for number in range(batch.count):
                mine = select(roots, roots.converged & (lane == number))
                if len(mine.x):
                    own = batch.take(np.array([number]))
                    closed = _orbits_of_lane(own, lanes, strobes[0], name, mine, n, size[number])
                    _add_new(orbits[number], closed, size[number], wrap)
    return orbits


def _cells(values: Float[np.ndarray, " lanes"]) -> Float[np.ndarray, "lanes 2"]:
    """Return between which values each value of an axis is the nearest one; of one alone all are."""
    if len(values) == 1:
        return np.array([[-np.inf, np.inf]])
    order = np.argsort(values)
    middle = 0.5 * (values[order][1:] + values[order][:-1])
    outer = 2.0 * values[order][[0, -1]] - middle[[0, -1]]
    ends, cells = np.concatenate([outer[:1], middle, outer[1:]]), np.empty((len(values), 2))
    cells[order] = np.stack([ends[:-1], ends[1:]], axis=1)
    return cells


def _with_slope(
    system: System, signs: Vector | None, u: Float[Array, " d"], p: Parameters, name: str | None
) -> tuple[Float[Array, " d"], Float[Array, "d unknowns"]]:
    """Return R in section coordinates, and its derivative in them, and in a parameter if one is named."""

    def image(u: Array, value: Array) -> Array:
        return image_of_point(system, signs, u, {**p, name: value} if name else p)

    value = jnp.asarray(p[name] if name else 0.0, float)
    by_point, by_value = jax.jacfwd(image, argnums=(0, 1))(u, value)
    return image(u, value), jnp.column_stack([by_point, by_value]) if name else by_point


class Symmetry(NamedTuple):
    """A reversal with isolated symmetric orbits.

    Attributes:
        reversal: R.
        parameter: the one at whose isolated values they exist; None where they do at any.
    """

    reversal: Reversal
    parameter: str | None


def choose_symmetry(batch: LaneBatch) -> Symmetry:
    """Return the reversal of a batch whose symmetric orbits are isolated, at any parameters rather than at some.

    Raises:
        OptionError: there is none, or the first axis of the sweep is no parameter that lanes may differ in.
    """
    for missing in (0, 1):
        number = choose_reversal(batch, lambda reversal, missing=missing: _missing_unknowns(batch, reversal) == missing)
        if number != NONE and missing and (batch.axis is None or batch.axis.kind != "lane"):
            raise OptionError(
                "symmetric orbits of this reversal exist at isolated values of a parameter; sweep one", "max_period"
            )
        if number != NONE:
            return Symmetry(reversal_of(batch, number), batch.first_axis.name if missing else None)
    reversal = reversal_of(batch, choose_reversal(batch))
    missing = _missing_unknowns(batch, reversal)
    kept = "none" if missing is None else f"those of {(batch.chart.dimension - missing) // 2} dimensions"
    raise OptionError(
        f"symmetric orbits are isolated where a reversal keeps points of half of the {batch.chart.dimension} "
        f"dimensions, or of one half less, and {describe_reversal(batch.flow, reversal)} keeps {kept}",
        "max_period",
    )


def _missing_unknowns(batch: LaneBatch, reversal: Reversal) -> int | None:
    """Return d − 2 f, f the dimension of the points that a reversal keeps; None where it keeps none."""
    d, wrap = batch.chart.dimension, batch.chart.wrap
    p = {name: values[0] for name, values in batch.p.items()}
    slopes = jax.jit(jax.vmap(lambda u: _with_slope(batch.system, reversal.signs, u, p, None)))
    u = np.random.default_rng(0).uniform(-1.0, 1.0, (_SAMPLES, d))
    missing, slope = np.full(u.shape, np.inf), np.zeros((_SAMPLES, d, d))
    for _ in range(_STEPS):
        image, slope = map(np.asarray, slopes(u))
        missing = wrap(image - u)
        u = wrap(u - np.einsum("nij,nj->ni", np.linalg.pinv(slope - np.eye(d), rcond=1e-6), missing))
    kept = np.max(np.abs(missing), axis=1) < _EXACT
    if not kept.any():
        return None
    ranks = np.linalg.matrix_rank(slope[kept] - np.eye(d), tol=1e-6)
    return 2 * int(np.min(ranks)) - d


def _conditions(
    batch: LaneBatch, lanes: LaneRunner, symmetry: Symmetry, strobe: Maps, p: Parameters, n: int, a: int
) -> _Conditions:
    """Return what is to vanish at points of starts with these numbers, (points, 2 d), and its derivative."""
    (reversal, name), d, k = symmetry, batch.chart.dimension, n // 2

    def moved(x: np.ndarray, own: Parameters, count: int) -> tuple[np.ndarray, np.ndarray]:
        if not count:
            return x[:, :d], np.broadcast_to(np.eye(d, x.shape[1]), (len(x), d, x.shape[1]))
        made = lanes(derivatives, (strobe, np.int32(count)), (x[:, :d], own), static=(name,))
        columns = [made.monodromy, np.asarray(made.by_parameter)[..., None]] if name else [made.monodromy]
        return np.asarray(made.image), np.concatenate(columns, axis=-1)

    def reversed_after(x: np.ndarray, own: Parameters, count: int) -> tuple[np.ndarray, np.ndarray]:
        image, slope = moved(x, own, count)
        back, turned = lanes(_with_slope, (batch.system, reversal.signs), (image, own), static=(name,))
        whole = np.asarray(turned)[..., :d] @ slope
        whole[..., d:] += np.asarray(turned)[..., d:]
        return np.asarray(back), whole

    def at(x: np.ndarray, number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        own = select(dict(p), number) | ({name: x[:, d]} if name else {})
        (image, of_image), (half, of_half) = reversed_after(x, own, a), moved(x, own, k)
        other, of_other = reversed_after(x, own, n - k + a)
        missing = np.concatenate([batch.chart.wrap(image - x[:, :d]), batch.chart.wrap(other - half)], axis=1)
        return missing, np.concatenate([of_image - np.eye(d, x.shape[1]), of_other - of_half], axis=1)

    return at


class _Roots(NamedTuple):
    """Points, each with the value of a parameter that is an unknown as its last number.

    Attributes:
        x: the unknowns, (starts, unknowns).
        left: the next step of Newton, (starts, unknowns).
        slope: of the parameter, in the sizes of all conditions together, (starts,).
        error: of the parameter, (starts,).
        converged: (starts,).
    """

    x: Float[np.ndarray, "starts unknowns"]
    left: Float[np.ndarray, "starts unknowns"]
    slope: Float[np.ndarray, " starts"]
    error: Float[np.ndarray, " starts"]
    converged: Bool[np.ndarray, " starts"]


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def _solve(
    conditions: _Conditions,
    x: Float[np.ndarray, "starts unknowns"],
    unit: Float[np.ndarray, "starts unknowns"],
    wrap: Callable,
    d: int,
    active: np.ndarray | None = None,
) -> _Roots:
    """Return points by Newton in the least-squares sense, the conditions being twice as many and of half the rank."""
    x, active = np.array(x), np.arange(len(x)) if active is None else active
    left, residual, moved = np.full(x.shape, np.inf), np.full(len(x), np.inf), np.full(len(x), np.nan)
    for _ in range(_STEPS):
        if not len(active):
            break
        missing, slope = conditions(x[active], active)
        before, size = residual[active], np.concatenate([unit[active, :d]] * 2, axis=1)
        residual[active] = np.max(np.abs(missing / size), axis=1)
        finite = np.isfinite(residual[active]) & np.isfinite(slope).all(axis=(1, 2))
        before, active, missing, slope, size = (each[finite] for each in (before, active, missing, slope, size))
        scaled = slope * unit[active][:, None, :] / size[:, :, None]
        inverse = np.linalg.pinv(scaled, rcond=1e-10)
        step = -np.einsum("nij,nj->ni", inverse, missing / size)
        moved[active] = np.sum(np.abs(inverse[:, -1]), axis=1) * unit[active, -1]
        left[active] = np.abs(step) * unit[active]
        unsolved = before >= _CONVERGED
        active, step = active[unsolved], step[unsolved]
        length = np.max(np.abs(step), axis=1)
        step *= np.where(length > _LARGEST_STEP, _LARGEST_STEP / length, 1.0)[:, None]
        x[active] += step * unit[active]
        x[active, :d] = wrap(x[active, :d])
    return _Roots(x, left, moved, np.full(len(x), np.nan), residual < _CONVERGED)


def _within_cells(roots: _Roots, edges: Float[np.ndarray, "starts 2"], d: int) -> _Roots:
    """Return the roots with those alone converged whose parameter is in the cell of their lane."""
    value = roots.x[:, d]
    return roots._replace(converged=roots.converged & (value >= edges[:, 0]) & (value < edges[:, 1]))


def _with_errors(
    finer: _Conditions, roots: _Roots, unit: Float[np.ndarray, "starts unknowns"], wrap: Callable, d: int, steps: int
) -> _Roots:
    """Return the roots with the errors of their parameter, from conditions with twice the steps.

    Where steps leave no more than rounding both solutions may be equal, and the next step of Newton zero: a rounding of
    each step is half a last digit of a size at most, and those of all steps of an orbit add up as their square root.
    """
    again = _solve(finer, roots.x, unit, wrap, d, np.flatnonzero(roots.converged))
    error = 2.0 * np.abs(again.x[:, d] - roots.x[:, d]) + roots.left[:, d] + again.left[:, d]
    digits = max(_LAST_DIGITS, np.sqrt(steps)) * roots.slope + np.abs(roots.x[:, d])
    error += np.finfo(float).eps * digits
    return roots._replace(error=error, converged=roots.converged & again.converged)


def _orbits_of_lane(
    batch: LaneBatch, lanes: LaneRunner, strobe: Maps, name: str | None, roots: _Roots, n: int, size: np.ndarray
) -> list[SymmetricOrbit]:
    """Return the orbits of n returns of points of a lane, those of fewer returns left out."""
    d, wrap = batch.chart.dimension, batch.chart.wrap
    u, value = roots.x[:, :d], roots.x[:, d] if name else np.full(len(roots.x), np.nan)
    p = {key: np.repeat(values, len(u)) for key, values in batch.p.items()} | ({name: value} if name else {})
    points, blocks = [u], list[np.ndarray]()
    for _ in range(n):
        made = lanes(derivatives, (strobe, np.int32(1)), (points[-1], p))
        points.append(np.asarray(made.image))
        blocks.append(np.asarray(made.monodromy))
    gap = np.array([np.max(np.abs(wrap(each - u) / size), axis=1) for each in points[1:]])
    primitive = (gap[:-1] > _NEAR).all(axis=0) & (gap[-1] < np.sqrt(_CONVERGED))
    values = multipliers(np.stack(blocks, axis=1))
    path = np.stack(points[:-1], axis=1)
    pairs = np.max(np.min(np.abs(values[:, :, None] * values[:, None, :] - 1.0), axis=2), axis=1)
    return [
        SymmetricOrbit(path[i], values[i], float(gap[-1, i]), float(pairs[i]), float(value[i]), float(roots.error[i]))
        for i in np.flatnonzero(primitive)
    ]


def _add_new(known: list[SymmetricOrbit], orbits: list[SymmetricOrbit], size: np.ndarray, wrap: Callable) -> None:
    for orbit in orbits:
        others = [other.points for other in known if len(other.points) == len(orbit.points)]
        if not any(np.max(np.abs(wrap(each - orbit.points[0]) / size), axis=1).min() < _NEAR for each in others):
            known.append(orbit)


def orbit_variables(
    batch: LaneBatch, lanes: LaneRunner, orbits: list[list[SymmetricOrbit]], symmetry: Symmetry
) -> dict[str, Entry]:
    """Return symmetric orbits as variables over (lane, orbit), by number of returns; 0 where a lane has fewer."""
    count, d = max(map(len, orbits), default=0), batch.chart.dimension
    dims = (LANE, "orbit")

    def column(name: str) -> np.ndarray:
        return padded([[getattr(orbit, name) for orbit in of_lane] for of_lane in orbits], (count,))

    period = padded([[len(orbit.points) for orbit in of_lane] for of_lane in orbits], (count,), 0).astype(np.int32)
    values, points = np.full((batch.count, count, d, 2), np.nan), np.full((batch.count, count, d), np.nan)
    for lane, of_lane in enumerate(orbits):
        for number, orbit in enumerate(of_lane):
            values[lane, number], points[lane, number] = real_and_imaginary(orbit.multipliers), orbit.points[0]
    variables = {
        "orbit_period": number_variable(
            dims, period, "period of the symmetric orbit", ("none",), counted_in=iterate_units(batch.system)
        ),
        "orbit_multipliers": variable(
            (*dims, "multiplier", "part"), values, "Floquet multipliers of the orbit, real and imaginary part"
        ),
        "orbit_pairing": variable(dims, column("pairing"), "largest violation of the pairs of multipliers, |μ μ' - 1|"),
        "orbit_residual": variable(dims, column("residual"), "largest component of P^n(u) - u, in sizes of the motion"),
    }
    if name := symmetry.parameter:
        axis = batch.first_axis
        words = f"{axis.long_name} at which the orbit exists"
        variables[f"orbit_{name}"] = variable(dims, column("value"), words, axis.units)
        error = column("value_error")
        variables[f"orbit_{name}_error"] = variable(dims, error, f"error of {axis.long_name} there", axis.units)
    if count:
        words, instant = "of the orbit's first point", 0.5 * float(symmetry.reversal.instant)
        variables |= named_points(batch, lanes, points, dims, "_points", words, instant)
    return variables
