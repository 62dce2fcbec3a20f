"""Contraction of phase volume along lanes. Where there is none, there is no attractor that a lane could reach."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.section_points import states_at
from jaxnh.analyses.smooth_window import window_weights
from jaxnh.analyses.window_averages import maps
from jaxnh.maps.batching import as_batched
from jaxnh.maps.iterate import derivatives
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.section import flow_of
from jaxnh.systems.flow import Parameters
from jaxnh.systems.state import State

_PERIODS = 128
"""Periods that the mean contraction is taken over."""

_KEEPS = 0.1
"""Change of the logarithm of a volume, over all the time that a lane has, of one that is kept.

A lane that settles on an attractor brings distances of order one down to `settling.SETTLED_TO`, by 9 in the logarithm.
"""


def keeps_volume(
    batch: LaneBatch, lanes: LaneRunner, u: Float[np.ndarray, "lanes d"], longest: int
) -> Bool[np.ndarray, " lanes"]:
    """Return whether the phase volume about lanes from u changes by a negligible amount in `longest` periods.

    The contraction is a mean under a smooth window: on a regular motion it converges as fast as other means do.
    """
    strobe, parts = maps(batch)
    shared, state = (strobe, np.int32(_PERIODS)), states_at(batch, lanes, u)
    mean = lanes(_mean, shared, (state, dict(batch.p)), periods=_PERIODS, static=(parts,))
    with np.errstate(invalid="ignore"):
        return np.abs(mean) * longest * (batch.flow.period if parts else 1.0) < _KEEPS


def _mean(strobe: ReturnMap, periods: ArrayLike, state: State, p: Parameters, parts: int) -> Array:
    """Return the mean change of the logarithm of a volume, for one lane.

    With a clock it is that of a period, by the determinant of the tangent map; without one that of time, by the flow's
    divergence at the points that means are taken over.
    """
    chart = strobe.chart

    def part(state: State, strobe: ReturnMap) -> tuple[State, Array]:
        return strobe(state, p), flow_of(strobe.system).divergence(jnp.zeros_like(state[0][0]), state, p)

    def period(k: Array, carry: tuple[State, Array, Array]) -> tuple[State, Array, Array]:
        state, total, weights = carry
        weight = window_weights((jnp.float64(k) + 0.5) / jnp.float64(periods))
        if parts:
            state, rates = lax.scan(part, state, strobe)
            change = jnp.mean(rates)
        else:
            u, tangent, _ = derivatives(strobe, 1, chart.point(state), p)
            state, change = chart.state(u), jnp.linalg.slogdet(tangent)[1]
        return state, total + weight * change, weights + weight

    zero = as_batched(jnp.zeros(()), jax.tree.leaves(state)[0])
    _, total, weights = lax.fori_loop(0, jnp.asarray(periods), period, (state, zero, zero))
    return total / weights
