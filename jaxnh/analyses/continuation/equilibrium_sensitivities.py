"""Derivatives of equilibria, their folds and Hopf points in all parameters of a flow: the implicit function theorem.

Equilibria are fixed points of u + f(u), whose multipliers are 1 + λ: what is known of orbits holds for them
(`orbits.bifurcations.sensitivities`), but for the condition of a Hopf point, which is Re λ = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.periodic.newton_on_lanes import ORBIT_TILE
from jaxnh.analyses.periodic.sensitivities import (
    ROUNDING,
    SMALLEST_SHIFT,
    CriticalOrbit,
    Numbers,
    Sensitivities,
    is_own,
    no_sensitivities,
    parameter_names,
    scale_of,
    shifted_batch,
)
from jaxnh.maps.iterate import Derivatives
from jaxnh.orbits.bifurcations.sensitivities import (
    OrbitMotion,
    ShiftedMap,
    fold_rates,
    implicit_rates,
    multiplier_rate,
    orbit_motions,
)
from jaxnh.orbits.collocation.fields import point_rates
from jaxnh.orbits.continuation.kinds import FOLD, HOPF
from jaxnh.systems.flow import Parameters


def equilibrium_sensitivities(batch: LaneBatch, lanes: LaneRunner, points: Sequence[CriticalOrbit]) -> Sensitivities:
    """Derivatives of the first axis at folds and Hopf points in all other parameters; not a number at branch points.

    Args:
        batch: lanes along the first axis, without a section.
        lanes: runs lanes.
        points: an equilibrium each, with its eigenvalues.
    """
    names = parameter_names(batch)
    absent = {name: reason for name in names[1:] if (reason := _why_absent(batch, name))}
    kept = [name for name in names if name not in absent]
    some = [k for k, point in enumerate(points) if point.kind in (FOLD, HOPF)]
    rates, errors = (np.full((len(points), len(names) - 1), np.nan) for _ in range(2))
    if some:
        every = [points[k] for k in some]
        columns = [names.index(name) - 1 for name in kept[1:]]
        rows = np.ix_(some, columns)
        rates[rows], errors[rows] = np.swapaxes(_rates(batch, lanes, every, kept), 0, 1)
        errors += ROUNDING * np.abs(rates)
    return Sensitivities(names[1:], rates, errors, absent)


class LaneEquilibriumSensitivities(NamedTuple):
    """Derivatives of equilibria in all parameters.

    Attributes:
        exponent: of the largest real part of the eigenvalues, (equilibria, parameters).
        points: of each coordinate, (equilibria, d, parameters).
    """

    exponent: Sensitivities
    points: Sensitivities


def lane_equilibrium_sensitivities(
    batch: LaneBatch, lanes: LaneRunner, u: Float[np.ndarray, "equilibria d"]
) -> LaneEquilibriumSensitivities:
    """Derivatives of equilibria, one for each lane of a batch without a section; not a number under constraints.

    Constraints leave eigenvalues at zero, in whose directions nothing says where an equilibrium moves to.
    """
    names, (count, d) = parameter_names(batch), u.shape
    absent = {name: reason for name in names if (reason := _why_absent(batch, name))}
    exponent, points = (no_sensitivities(names, *shape)._replace(absent=absent) for shape in ((count,), (count, d)))
    if not count or batch.flow.chart.dimension > batch.flow.exponents:
        return LaneEquilibriumSensitivities(exponent, points)
    field, orbits = _field_map(batch, lanes, dict(batch.p)), list(u[:, None])
    blocks = list(np.asarray(field(names[0], 0.0, u).monodromy)[:, None])
    leading = [complex(max(np.linalg.eigvals(block[0]), key=np.real)) for block in blocks]
    for k, name in enumerate(names):
        if name in absent:
            continue
        motions = orbit_motions(field, orbits, blocks, name, scale_of(batch, name), batch.chart.wrap)
        rates = [multiplier_rate(*each) for each in zip(blocks, motions, leading, strict=True)]
        exponent.rates[:, k], exponent.errors[:, k] = np.array([(rate.real, error) for rate, error in rates]).T
        points.rates[..., k] = [motion.points[0] for motion in motions]
        points.errors[..., k] = [motion.points_error[0] for motion in motions]
    for table in (exponent, points):
        table.errors[:] += ROUNDING * np.abs(table.rates)
    return LaneEquilibriumSensitivities(exponent, points)


def _rates(
    batch: LaneBatch, lanes: LaneRunner, points: Sequence[CriticalOrbit], names: Sequence[str]
) -> Float[np.ndarray, "points 2 others"]:
    """Derivatives at points in parameters but the first, and their errors."""
    at = _field_map(batch, lanes, batch.at_values(np.array([point.value for point in points])).p)
    orbits, wrap = [point.points for point in points], batch.chart.wrap
    blocks = list(np.asarray(at(names[0], 0.0, np.concatenate(orbits)).monodromy)[:, None])
    isolated = [point.kind == HOPF for point in points]
    motions = [
        orbit_motions(at, orbits, blocks, name, scale_of(batch, name), wrap, isolated=isolated) for name in names
    ]
    each = zip(points, blocks, zip(*motions, strict=True), strict=True)
    return np.array(
        [
            implicit_rates(*(fold_rates(block, moved) if point.kind == FOLD else _real_part_rates(block, moved)))
            for point, block, moved in each
        ]
    )


def _field_map(batch: LaneBatch, lanes: LaneRunner, p: Parameters) -> ShiftedMap:
    """Return u + f(u) at points with these parameters but for one."""

    def at(name: str, shift: float, u: Float[np.ndarray, "points d"]) -> Derivatives:
        own = is_own(batch, name)
        moved = {**p, name: np.asarray(p[name]) + shift} if own else p
        flow = batch.flow if own else shifted_batch(batch, name, shift).flow
        rate: Any = lanes(point_rates, (flow,), (u, np.zeros(len(u)), moved), tile=ORBIT_TILE, static=((),))
        return Derivatives(u + rate.rate, np.eye(u.shape[1]) + rate.jacobian, u)  # pyright: ignore[reportArgumentType]

    return at


def _real_part_rates(block: Float[np.ndarray, "1 d d"], motions: Sequence[OrbitMotion]) -> Numbers:
    """Derivatives of the real part of the pair of eigenvalues nearest to the imaginary axis, and errors."""
    multipliers = np.linalg.eigvals(block[0])
    off = np.where(np.imag(multipliers) > 0.0, np.abs(np.real(multipliers) - 1.0), np.inf)
    pair = complex(multipliers[np.argmin(off)])
    rates = [multiplier_rate(block, motion, pair) for motion in motions]
    return np.array([rate.real for rate, _ in rates]), np.array([error for _, error in rates])


def _why_absent(batch: LaneBatch, name: str) -> str:
    """Return why the flow does not exist near its value of a parameter; "" where it does."""
    try:
        _ = shifted_batch(batch, name, SMALLEST_SHIFT * scale_of(batch, name))
    except ValueError as error:
        return str(error)
    return ""
