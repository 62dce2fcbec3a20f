"""Sizes that orbits of a whole sweep are measured in, one of each section coordinate.

Motions of lanes have sizes, but not where they have come to rest, in an equilibrium or as a driven pendulum that hangs
still, and that may be all lanes: then the starts say how large orbits may be. Sizes that the config gives as
`accuracy.scale` count before all others.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.periodic.attractor_survey import Survey, extent, least_sizes, radian
from jaxnh.analyses.random_starts import Box, box_corners
from jaxnh.analyses.section_points import at_rest, points_at
from jaxnh.maps.section import begin
from jaxnh.systems.flow import Flow, Parameters

_STILL = 1e-9  # of the extent of starts: what moves less in a radian of the period rests
_PHASES = (0.0, 0.29, 0.61)  # shares of a period, at which no forcing with a symmetry vanishes twice
_ESCAPED = 1e15  # times the extent of starts: larger motions that are no orbits are on their way to infinity
_VANISHES = 1.001  # of the smallest size that a motion is given: what is no larger decays, or rests at zero
_SPREADS = 10.0  # times what a coordinate changes by: its size where that is less than its modulus
_FARTHEST = 30.0  # times less than its modulus, at most, as rounding is that of the modulus
_LEAST = 0.01  # of the extent of starts: smaller motions that are no orbits are on their way to an equilibrium


def sizes_in_motion(batch: LaneBatch, lanes: LaneRunner, survey: Survey) -> Float[np.ndarray, "lanes d"]:
    """Return the sizes of the motions of lanes, NaN of those that have failed or come to rest."""
    settled, u = survey.period > 0, np.where((survey.period > 0)[:, None], survey.u, np.nan)
    sizes = survey.size
    if batch.on_section:
        resting = at_rest(batch, lanes, u)
    elif batch.chart.dimensionless:  # where sizes are one, whatever moves
        resting = np.zeros(batch.count, bool)
    elif batch.flow.continuous:
        rate = np.abs(lanes(_rates_over_period, (batch.system, _times(batch)), (u, dict(batch.p))))
        moved = np.max(rate.reshape(batch.count, len(_PHASES), -1), axis=1) * radian(batch)
        unit = np.max(extent(batch, lanes, batch.start), axis=0)
        resting = np.all(moved <= _STILL * unit, axis=1)
        sizes = _by_spread(batch, sizes, _spread(np.where(settled[:, None], survey.u, np.nan), moved))
    else:
        unit = np.max(np.abs(points_at(batch, lanes, batch.start)), axis=0)
        resting = np.all(np.abs(u) <= _STILL * unit, axis=1)
    return np.where((survey.failed | (settled & resting))[:, None], np.nan, sizes)


def _spread(u: Float[np.ndarray, "lanes d"], moved: Float[np.ndarray, "lanes d"]) -> Float[np.ndarray, " d"]:
    """Return what coordinates change by: in a radian of the period, or from lane to lane; zero of no known lane."""
    known = np.isfinite(u) & np.isfinite(moved)
    low, high = (np.min(u, axis=0, initial=np.inf, where=known), np.max(u, axis=0, initial=-np.inf, where=known))
    return np.maximum(np.max(moved, axis=0, initial=0.0, where=known), np.where(high > low, high - low, 0.0))


def _by_spread(
    batch: LaneBatch, modulus: Float[np.ndarray, "*some d"], spread: Float[np.ndarray, " d"]
) -> Float[np.ndarray, "*some d"]:
    """Return sizes by what coordinates change by, where that is far less than their modulus."""
    smaller = np.minimum(modulus, np.maximum(_SPREADS * spread, modulus / _FARTHEST))
    return np.where((spread > 0.0) & ~np.array(batch.chart.angles), smaller, modulus)


def motion_unit(
    batches: Sequence[LaneBatch],
    lanes: LaneRunner,
    period: Int[np.ndarray, " lanes"],
    sizes: Float[np.ndarray, "lanes d"],
    box: Box,
) -> Float[np.ndarray, " d"]:
    """Return a size of each section coordinate: the median over lanes that move, in which it does not vanish.

    A coordinate may be zero in half of the lanes, as up to a bifurcation that breaks a symmetry: in sizes of these all
    orbits beyond would be too far apart to be followed. Where no lane has settled on an orbit it is the extent of
    starts at least.

    Args:
        batches: of the lanes.
        lanes: runs lanes.
        period: of the orbits that all of them have settled on, 0 of no orbit.
        sizes: of the motions, as of `sizes_in_motion`.
        box: that random starts are drawn from; without it starts are those of the lanes.
    """
    starts = np.max([_extent_of_starts(batch, lanes, box) for batch in batches], axis=0)
    with np.errstate(invalid="ignore"):
        bounded = np.any(sizes > _LEAST * starts, axis=1) & np.all(sizes < _ESCAPED * starts, axis=1)
    moving = ((period > 0) | bounded) & np.isfinite(sizes).all(axis=1)
    unit = np.nanmedian(_without_vanishing(batches, lanes, sizes, moving), axis=0) if moving.any() else starts
    return _given_or(batches[0], unit if np.any(moving & (period > 0)) else np.maximum(unit, starts))


def _without_vanishing(
    batches: Sequence[LaneBatch],
    lanes: LaneRunner,
    sizes: Float[np.ndarray, "lanes d"],
    moving: Bool[np.ndarray, " lanes"],
) -> Float[np.ndarray, "moving d"]:
    """Return the sizes of lanes that move, NaN of a coordinate that vanishes unless it does in all of them."""
    if batches[0].chart.dimensionless:  # sizes are one
        return sizes[moving]
    smallest = np.concatenate([least_sizes(batch, lanes) for batch in batches])
    present = np.where(sizes > _VANISHES * smallest, sizes, np.nan)[moving]
    return np.where(np.isfinite(present).any(axis=0), present, sizes[moving])


def search_unit(
    batch: LaneBatch, lanes: LaneRunner, unit: Float[np.ndarray, " d"], box: Box
) -> Float[np.ndarray, " d"]:
    """Return the sizes that orbits are sought in, from random starts in a box: its extent where motions are smaller."""
    return _given_or(batch, np.maximum(unit, _extent_of_starts(batch, lanes, box)))


def _times(batch: LaneBatch) -> tuple[float, ...]:
    return tuple(phase * batch.flow.period for phase in _PHASES)


def _rates_over_period(
    system: Flow, times: tuple[float, ...], u: Float[Array, " d"], p: Parameters
) -> Float[Array, " rates"]:
    """Rates of all section coordinates at a point held for these times."""
    state = system.chart.state(u)
    return jnp.concatenate([jnp.stack(system.chart.lower(state, system.rhs(u[0] * 0 + t, state, p))) for t in times])


def _extent_of_starts(batch: LaneBatch, lanes: LaneRunner, box: Box) -> Float[np.ndarray, " d"]:
    """Return the largest modulus of each section coordinate among starts, of angles one.

    A coordinate that is zero at all starts has the largest of the others.
    """
    if batch.chart.dimensionless:
        return np.ones(batch.chart.dimension)
    points = np.concatenate([points_at(corner, lanes, corner.start) for corner in box_corners(batch, box)])
    extent = np.where(np.array(batch.chart.angles), 1.0, np.max(np.abs(points), axis=0))
    extent = _by_spread(batch, extent, 0.5 * np.ptp(points, axis=0))
    return np.where(extent > 0.0, extent, extent.max() or 1.0)


def _given_or(batch: LaneBatch, sizes: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
    """Return sizes of section coordinates, those that the config gives in their place."""
    if not batch.given_sizes:
        return sizes
    every = {name: batch.given_sizes.get(name, np.nan) for name in batch.flow.coordinates}
    given = np.abs(batch.chart.host_points(begin(batch.system, batch.flow.start(every))))
    return np.where(np.isfinite(given) & ~np.array(batch.chart.angles), given, sizes)
