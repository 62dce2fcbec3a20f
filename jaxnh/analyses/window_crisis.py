"""The interior crisis of a window: where its bands meet the unstable orbit that was born in the fold, and grow.

Beyond it a path leaves the bands after a mean time τ ~ (b − b_c)^−γ, where γ is 1/2 for maps of one maximum on a line
and larger in more dimensions (Grebogi, Ott, Romeiras, Yorke, Phys. Rev. A 36 (1987) 5365). So within a finite time none
is seen to leave just beyond the crisis, and where the first one does is too far. What is known is how long each path
has stayed, also of those that have not left: given b_c, γ and a scale these times are exponential. The posterior of
b_c, with γ and the scale integrated out, has this bias in its interval.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from jaxnh.maps.of_lane import of_lane
from jaxnh.maps.protocol import Strobe
from jaxnh.systems.flow import Parameters

_PATHS = 64  # of a round, at as many values
_FIRST, _LONGER = 64, 4  # returns of paths of the first round; of every later one so many times those before
_BEHIND, _AHEAD = 6, 2  # spacings of a round that the next one reaches to either side of the first path that left
_NEAR = 64  # spacings of the last round: paths that are further beyond do not tell of the crisis itself
_WAY = 16  # returns that a path takes from an unstable orbit to the bands' full width, and cannot leave in
_EXPONENTS = np.linspace(0.5, 1.5, 11)  # γ, each as likely as the others
_DISTANCES = np.geomspace(1e-4, 1e3, 400)  # of the crisis before the first path that left, in spacings
_TAIL = 0.005  # of the probability, beyond either end of the interval


class Crisis(NamedTuple):
    """Where bands grow, and the error of that."""

    value: float
    error: float


Stays = Callable[[Float[np.ndarray, " values"], int], Int[np.ndarray, " values"]]
"""Steps of paths until one is out of turn, at values of the parameter; those asked for where none is."""


def locate_crisis(stays: Stays, start: float, stop: float, period: int, most: int) -> Crisis | None:
    """The value between two beyond which paths leave the bands; None: none has left, or some have from the start on.

    Args:
        stays: runs paths from the bands.
        start, stop: values of the parameter between which bands are looked at, in either order.
        period: number of bands.
        most: steps of a path, at most.
    """
    low, high = 0.0, abs(stop - start)
    sign, steps = np.sign(stop - start), min(_FIRST * period, most)
    rounds = list[tuple[np.ndarray, np.ndarray, np.ndarray]]()
    while True:
        at = np.linspace(low, high, _PATHS)
        stayed = stays(start + sign * at, steps)
        rounds.append((at, stayed / period, stayed < steps))
        left = np.concatenate([at[out] for at, _, out in rounds])
        if not len(left) or left.min() <= 0.0:
            return None
        first, spacing = float(left.min()), (high - low) / (_PATHS - 1)
        if steps >= most:
            break
        low, high = max(first - _BEHIND * spacing, 0.0), first + _AHEAD * spacing
        steps = min(_LONGER * steps, most)
    paths = [np.concatenate(column) for column in zip(*rounds, strict=True)]
    value, error = _posterior(first, spacing, *paths)
    return Crisis(start + float(sign) * value, error)


def _posterior(
    first: float,
    spacing: float,
    at: Float[np.ndarray, " paths"],
    stayed: Float[np.ndarray, " paths"],
    out: np.ndarray,
) -> tuple[float, float]:
    """Mean and error of where paths begin to leave, from how long each has stayed.

    The rate of leaving is λ xᵞ at x beyond the crisis. Its logarithm is as likely to be anything: λ integrates to
    Γ(n)/(Σ xᵞ t)ⁿ times the product of xᵞ over the n paths that have left.
    """
    near = at < first + _NEAR * spacing
    at, stayed, out = at[near], np.maximum(stayed[near] - _WAY, 0.5), out[near]
    before = spacing * _DISTANCES
    x = np.maximum(at - (first - before)[:, None], 0.0) / spacing
    logs = np.log(np.where(out & (x > 0.0), x, 1.0)).sum(axis=1)[:, None] * _EXPONENTS
    waited = np.stack([(np.where(x > 0.0, x**gamma, 0.0) * stayed).sum(axis=1) for gamma in _EXPONENTS], axis=1)
    density = logs - out.sum() * np.log(waited) + np.log(before)[:, None]  # the grid is even in logarithms
    weight = np.exp(density - density.max()).sum(axis=1)
    weight /= weight.sum()
    mean = float(weight @ before)
    ends = np.interp([_TAIL, 1.0 - _TAIL], np.cumsum(weight) - 0.5 * weight, before)
    return first - mean, float(np.abs(ends - mean).max())


def steps_in_turn(
    strobe: Strobe,
    count: ArrayLike,
    u: Float[Array, " d"],
    p: Parameters,
    centres: Float[Array, "points d"],
    bands: Int[Array, ""],
    size: Float[Array, " d"],
) -> Array:
    """Steps of one lane until it is nearest to another point of an orbit than the one whose turn it is; else `count`.

    Args:
        centres: points of the orbit in turn, from that next to u; behind them the first again.
        bands: how many there are.
        size: of the motion in each section coordinate.
    """
    system = strobe.system

    def step(n: Array, carry: tuple[object, Array]) -> tuple[object, Array]:
        state, stayed = carry
        state = strobe(state, p)
        gap = system.wrap(system.chart(state)[None] - centres) / size[None]
        nearest = lax.argmin(jnp.sum(gap**2, axis=1), 0, jnp.int32)
        out = nearest != (n + 1) % bands
        return state, jnp.where(out & (stayed == count), n, stayed)

    return lax.fori_loop(0, count, step, of_lane((system.unchart(u), jnp.asarray(count)), u[0]))[1]
