"""Newton on the periodic orbit of one lane, and the orbit's least period, as programs.

For a card, whose threads wait for no others and beside which the host is slow: one call in place of two for each of
Newton's steps. On the host lanes of a tile would wait for each other, and `newton` asks for images alone; both take the
same steps.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxnh.maps.batching import as_batched
from jaxnh.maps.iterate import derivatives
from jaxnh.maps.protocol import ReturnMap
from jaxnh.orbits.newton import LARGEST_STEP, LAST_STEP, NEAR, NEWTON_STEPS, NEWTON_TOLERANCE, PATIENCE, Orbit
from jaxnh.systems.elimination import eliminate
from jaxnh.systems.flow import Parameters

MOST_COORDINATES = 8
"""Section coordinates up to which Newton's linear system is written out: of more it is most of a program."""


class _Step(NamedTuple):
    """Newton between two steps.

    Attributes:
        orbit: as far as it is known.
        last: whether this step is the last one.
        open: whether there is one.
    """

    orbit: Orbit
    last: Bool[Array, ""]
    open: Bool[Array, ""]


def find_orbit(
    strobe: ReturnMap, n: Int[Array, ""], u: Float[Array, " d"], size: Float[Array, " d"], p: Parameters
) -> Orbit:
    """The orbit of `newton.find_orbits` of one lane.

    Args:
        n: period.
        u: where to begin, section coordinates.
        size: of the motion in each of them.
    """
    d, wrap = len(u), strobe.chart.wrap

    def take(step: _Step) -> _Step:
        u, _, _, steps = step.orbit
        image, monodromy, _ = derivatives(strobe, n, u, p)
        missing = wrap(u - image)
        finite = jnp.all(jnp.isfinite(missing))  # not all ways in which XLA reduces keep NaN
        residual = jnp.where(finite, jnp.max(jnp.abs(missing / size)), jnp.nan)
        hopeless = (steps >= PATIENCE) & (residual > NEAR)
        matrix = [[monodromy[i, j] - float(i == j) for j in range(d)] for i in range(d)]
        (solution,), _ = eliminate(matrix, [[missing[i] for i in range(d)]])
        way = jnp.stack(solution)
        solved = jnp.all(jnp.isfinite(way))  # with a multiplier of exactly one there is no step, and the point stays
        unfinished = ~step.last & (steps < NEWTON_STEPS) & finite & ~hopeless & solved
        length = jnp.max(jnp.abs(way / size))
        way *= jnp.where(length > LARGEST_STEP, LARGEST_STEP / length, 1.0)
        orbit = Orbit(jnp.where(unfinished, u + way, u), residual, monodromy, steps + unfinished.astype(jnp.int32))
        last = unfinished & (residual < NEWTON_TOLERANCE) & (length < LAST_STEP)
        return _Step(orbit, last, unfinished)

    unknown = Orbit(u, jnp.nan, jnp.full((d, d), jnp.nan), jnp.int32(0))
    return lax.while_loop(
        lambda step: step.open, take, as_batched(_Step(unknown, jnp.array(False), jnp.array(True)), u[0])
    ).orbit


def find_least_period(
    strobe: ReturnMap,
    n: Int[Array, ""],
    u: Float[Array, " d"],
    size: Float[Array, " d"],
    p: Parameters,
    tolerance: float,
) -> Int[Array, ""]:
    """Least divisor of n after which the point u of an orbit comes back, of one lane; n where it does after no other.

    Args:
        n: a period of the orbit.
        u: section coordinates of the point.
        size: of the motion in each of them.
        tolerance: in these sizes, within which a point has come back.
    """
    chart = strobe.chart

    def period(i: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        state, least = carry
        state = strobe(state, p)
        back = jnp.all(jnp.abs(chart.wrap(chart.point(state) - u) / size) < tolerance)
        return state, jnp.where((least == n) & (n % (i + 1) == 0) & back, i + 1, least)

    return lax.fori_loop(0, n // 2, period, as_batched((chart.state(u), n), u[0]))[1]
