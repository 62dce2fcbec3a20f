"""The 0–1 test for chaos on strobe points (Gottwald and Melbourne, SIAM J. Appl. Dyn. Syst. 8 (2009) 129).

The strobe values of x1, or of a system's first coordinate, drive a walk in the plane with many fixed angles. Regular
motion keeps the walk bounded (K near 0), chaos makes its mean square displacement grow in proportion to time (K near
1). Where that coordinate is an angle, its cosine and its sine drive a walk each, and what grows is the sum of their
mean square displacements, which does not depend on where the angle is counted from: an angle that turns and turns would
drive a walk that whole turns alone make grow.

Chaos in m bands that are visited in turn is a motion of period m with a little noise on it: the large bounded walk of
the first hides for very long that the second spreads (K = 0.2 after 1000 points where λ1 is ten times its error). So
the part that repeats after m points is taken off first, with m ≤ 64 chosen as the lag at which the signal best recurs.
"""

from __future__ import annotations

from functools import reduce
from operator import add

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxnh.analyses.base import LANE, Analysis, as_variable, variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.options.chaos import Chaos01Options
from jaxnh.analyses.price import Price, PricedProgram, map_alone
from jaxnh.analyses.section_points import points_and_end
from jaxnh.maps.iterate import record
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.section import reports
from jaxnh.systems.flow import Parameters
from jaxnh.systems.rows import select
from jaxnh.systems.state import State

_ANGLES = 64
_TILE = 32
_LONGEST_PERIOD = 64  # of the part that is taken off
_NO_MOTION = 1e-9  # a mean square displacement below this, relative to the signal's, is that of a fixed point


Signals = tuple[Float[Array, " points"], ...]
"""Observables of one motion over strobe points."""


def run(options: Chaos01Options, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Compute K of every lane, the median over angles, and half the distance between their quartiles."""
    # Fixed angles, spread evenly over (π/5, 4π/5) by the golden ratio: no resonance is shared by many of them.
    angles = np.pi / 5 + 3 * np.pi / 5 * ((np.arange(_ANGLES) * (np.sqrt(5.0) - 1) / 2) % 1.0)
    cost = options.transient + options.periods
    with lanes.stage(f"chaos01: {batch.count} lanes", batch.count * cost):
        points, end = points_and_end(batch, lanes, batch.start, options.transient, options.periods, _TILE)
    first = np.ascontiguousarray(points[:, :, 0])
    k = lanes(_growth, (angles,), (first,), tile=_TILE, static=(batch.chart.angles[0],))
    ended = reports(batch.flow, select(end, np.s_[:, None]))["status"]
    k[np.asarray(ended.data) > 0] = np.nan
    low, median, high = np.quantile(k, [0.25, 0.5, 0.75], axis=1)
    words = "growth rate K of the 0–1 test, periodic part off: near 0 regular, near 1 chaotic"
    # no bar: as a correlation K stays below 1, by more than angles differ, and beside a resonance all angles are wrong
    spread_words = "half the distance between the quartiles of K over the angles, no error of it"
    variables = {
        "k_median": variable(LANE, median, words, ancillary_variables="k_spread"),
        "k_spread": variable(LANE, 0.5 * (high - low), spread_words),
        "status": as_variable(LANE, ended),
    }
    return xr.Dataset(variables, attrs={"angles": _ANGLES, "transient": options.transient})


def _growth(angles: Float[Array, " angles"], first: Float[Array, " points"], turns: bool) -> Float[Array, " angles"]:
    """Return K of one lane for every angle, from its first coordinate, or its cosine and sine if it is an angle.

    An angle itself is no observable: it may grow for ever, and whole turns of it are no motion.
    """
    signals = (jnp.cos(first), jnp.sin(first)) if turns else (first,)
    return growth_rates(remove_period(signals), angles, mean_square(signals))


def _in_one(
    strobe: ReturnMap, count: ArrayLike, angles: Float[Array, " angles"], state: State, p: Parameters, room: int
) -> Float[Array, " angles"]:
    """Return what a run computes of one lane in two programs, its strobes and its walks, for the price of both."""
    first = jax.vmap(strobe.chart.point)(record(strobe, count, state, p, room))[:, 0]
    return _growth(angles, first, strobe.chart.angles[0])


def mean_square(signals: Signals) -> Array:
    """Return the mean square of signals of one motion, summed over the signals."""
    return reduce(add, [jnp.mean(signal**2) for signal in signals])


def remove_period(signals: Signals) -> Signals:
    """Return signals less their means over points a multiple of m apart, m the lag of best recurrence."""
    count = signals[0].shape[0]
    used = count - _LONGEST_PERIOD
    lags = jnp.arange(1, _LONGEST_PERIOD + 1)

    def part(m: Array) -> Array:
        parted = (lax.dynamic_slice(signal, (m,), (used,)) - signal[:used] for signal in signals)
        return reduce(add, [jnp.mean(distance**2) for distance in parted])

    place = jnp.arange(count) % lags[jnp.argmin(lax.map(part, lags))]
    number = jnp.zeros(_LONGEST_PERIOD).at[place].add(1.0)

    def rest(signal: Array) -> Array:
        total = jnp.zeros(_LONGEST_PERIOD).at[place].add(signal)
        return signal - (total / jnp.maximum(number, 1.0))[place]

    return tuple(rest(signal) for signal in signals)


def growth_rates(signals: Signals, angles: Float[Array, " angles"], scale: ArrayLike) -> Float[Array, " angles"]:
    """Return K_c of signals of N points for every angle c: correlation of the damped displacement D_c(n) with n ≤ N/10.

    Each signal drives a walk of its own; their displacements are added. A displacement that is nothing beside `scale`,
    a mean square, is that of regular motion: K_c = 0.
    """
    count = signals[0].shape[0]
    longest = count // 10
    steps = jnp.arange(1.0, longest + 1)
    means = reduce(add, [jnp.mean(signal) ** 2 for signal in signals])

    def correlate(c: Array) -> Array:
        phase = c * jnp.arange(1.0, count + 1)
        walks = [(jnp.cumsum(s * jnp.cos(phase)), jnp.cumsum(s * jnp.sin(phase))) for s in signals]

        def displacement(n: Array) -> Array:
            used = count - longest

            def shift(walk: Array) -> Array:
                return lax.dynamic_slice(walk, (n.astype(int),), (used,)) - walk[:used]

            return reduce(add, [jnp.mean(shift(p) ** 2 + shift(q) ** 2) for p, q in walks])

        moved = lax.map(displacement, steps) - means * (1 - jnp.cos(steps * c)) / (1 - jnp.cos(c))
        n = steps - jnp.mean(steps)
        d = moved - jnp.mean(moved)
        spread = jnp.sqrt(jnp.mean(d**2))
        correlation = jnp.mean(n * d) / jnp.sqrt(jnp.mean(n**2)) / jnp.where(spread > 0, spread, 1.0)
        return jnp.where(spread > _NO_MOTION * scale, correlation, 0.0)

    return lax.map(correlate, angles)


def price(options: Chaos01Options, batch: LaneBatch) -> Price:
    """Return the price of the whole program, the walks of all angles at the end shared out over its periods."""
    strobe = batch.map()
    angles = np.linspace(np.pi / 5, 4 * np.pi / 5, _ANGLES)  # others than in a run, of the same price
    total = options.transient + options.periods
    shared, trip_counts = (strobe, np.int32(total), angles), (float(total), *strobe.trip_counts)
    program = PricedProgram(_in_one, shared, batch.lanes, trip_counts, (options.periods,), total, _TILE, whole=True)
    note = f"walks of {_ANGLES} angles over {options.periods:,} strobes at the end, shared out over {total:,} periods"
    return Price(program, map_alone(batch, strobe, tile=_TILE), note)


ANALYSIS = Analysis(
    "chaos01",
    Chaos01Options,
    lambda options, lanes: float(lanes * (options.transient + options.periods)),
    run,
    price=price,
    brief={"transient": 1},
)
