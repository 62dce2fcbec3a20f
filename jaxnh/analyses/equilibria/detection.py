"""Detection of autonomous motions that come to rest, and the exponents there: from its rates and how they change there.

A lane is at rest where over the last quarter of a run no coordinate changes at more than 10⁻⁶ of its largest rate,
nor faster than in the quarter before, and where the rates' linearisation there has no direction that grows: a slow
passage by a saddle has one. All rates vanish where a motion begins on a saddle, or within its stable manifold: it stays
there, whatever would grow. A motion is dying down where all rates shrink from the third quarter to the last.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.maps.batching import as_batched
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.section import rates
from jaxnh.orbits.newton import solve
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.state import State

_SLOW = 1e-6  # of the largest rate of a coordinate
_STILL = 1e-9  # likewise: what is left may be rounding, and need not shrink
_NEVER = 1e-12  # of the largest rate of all coordinates: one that has no rate at all
_GROWS = 10 * _SLOW  # of the linearisation's norm: it is seen through a distance of 10⁻⁶ to where it would be exact
_SHRINKS = 0.99
_VANISHED = 1e-100  # of the largest rate of all coordinates: no rounding has kept any
_ROUNDING = 1e-14  # of the linearisation's norm, in its entries


class Equilibrium(NamedTuple):
    """State of rest of lanes.

    Attributes:
        still: whether a lane is at rest, where nothing grows, (lanes,).
        vanished: whether no rate is left of its motion, on a saddle as well, (lanes,).
        fading: whether its motion is dying down, (lanes,).
        exponents, error: real parts of the linearisation's eigenvalues at the equilibrium, largest first, in units of
            1/time, (lanes, d); NaN of lanes that move, and where Newton finds no equilibrium, as where many lie side by
            side.
    """

    still: Bool[np.ndarray, " lanes"]
    vanished: Bool[np.ndarray, " lanes"]
    fading: Bool[np.ndarray, " lanes"]
    exponents: Float[np.ndarray, "lanes d"]
    error: Float[np.ndarray, "lanes d"]


class _RateRun(NamedTuple):
    """Largest rates of one lane over all units of time and over the last two quarters, and where it ends, all (d,)."""

    largest: Float[Array, " d"]
    third: Float[Array, " d"]
    fourth: Float[Array, " d"]
    end: Float[Array, " d"]


def detect_equilibrium(batch: LaneBatch, lanes: LaneRunner, units: int) -> Equilibrium:
    """Detect which lanes of an autonomous flow are at rest, or come to rest, after so many units of time."""
    batch = batch.without_section()
    run = lanes(_run, (batch.strobe(), batch.flow, np.int32(units)), batch.lanes, periods=units)
    largest, third, fourth, u = run
    vanished = np.all(fourth <= _VANISHED * largest.max(axis=1, keepdims=True), axis=1)
    never = largest <= _NEVER * largest.max(axis=1, keepdims=True)
    slow = (fourth <= _SLOW * largest) & ((fourth <= third) | (fourth <= _STILL * largest))
    still, fading = np.all(slow | never, axis=1), np.all((fourth < _SHRINKS * third) | never, axis=1)
    exponents, error = np.full((2, *u.shape), np.nan)
    near = np.flatnonzero(still)
    if not len(near):  # nothing to linearise, and no program to compile for it
        return Equilibrium(still, vanished, fading, exponents, error)
    # At the end, and after one and two steps of Newton from there to where all rates are zero.
    linear, u, p = [], u[near], batch.parameters_of(near)
    for _ in range(3):
        linear.append(lanes(_linearise, (batch.strobe(),), (u, p)))
        u = u - _shortest_step(linear[-1].change, linear[-1].rate)
    change, closer, exact = (at.change for at in linear)
    still[near] &= _spectrum(change)[0][:, 0] <= _GROWS * np.linalg.norm(change, axis=(1, 2))
    (at_rest, bound), nearly = _spectrum(exact), _spectrum(closer)[0]
    exponents[near], error[near] = at_rest, 2.0 * np.abs(at_rest - nearly) + bound
    return Equilibrium(still, vanished, fading, exponents, error)


def _shortest_step(
    matrices: Float[np.ndarray, "lanes d d"], right: Float[np.ndarray, "lanes d"]
) -> Float[np.ndarray, "lanes d"]:
    """Return steps of Newton, the shortest where a matrix is singular: equilibria may fill a line."""
    steps = solve(matrices, right)
    finite = np.all(np.isfinite(matrices), axis=(1, 2))
    singular = np.flatnonzero(finite)[np.linalg.matrix_rank(matrices[finite]) < right.shape[1]]
    steps[singular] = (np.linalg.pinv(matrices[singular]) @ right[singular, :, None])[..., 0]
    return steps


def _spectrum(
    matrices: Float[np.ndarray, "lanes d d"],
) -> tuple[Float[np.ndarray, "lanes d"], Float[np.ndarray, "lanes d"]]:
    """Return real parts of eigenvalues, largest first, and their error by rounding (Bauer and Fike 1960)."""
    finite = np.all(np.isfinite(matrices), axis=(1, 2))[:, None]
    values, vectors = np.linalg.eig(np.where(finite[:, :, None], matrices, 0.0))
    norm = np.linalg.norm(matrices, axis=(1, 2), keepdims=True)[:, 0]
    bound = _ROUNDING * norm * np.linalg.cond(vectors)[:, None] + np.zeros(values.shape)
    return np.where(finite, -np.sort(-np.real(values), axis=1), np.nan), np.where(finite, bound, np.nan)


def _run(strobe: ReturnMap, flow: Flow, count: ArrayLike, state: State, p: Parameters) -> _RateRun:
    """Run one lane over `count` units of time."""
    count = jnp.asarray(count)
    quarter = count // 4

    def rate(y: State) -> Array:
        return jnp.abs(jnp.stack(rates(flow, y, p)))

    def unit(i: Array, carry: tuple[State, Array, Array, Array]) -> tuple[State, Array, Array, Array]:
        state, largest, third, fourth = carry
        state, last = strobe(state, p), i >= count - quarter
        now = rate(state)
        late = jnp.where(i >= count - 2 * quarter, now, 0.0)
        third = jnp.where(last, third, jnp.maximum(third, late))
        return state, jnp.maximum(largest, now), third, jnp.where(last, jnp.maximum(fourth, late), fourth)

    none = as_batched(jnp.zeros(flow.chart.dimension), state[0][0])
    state, largest, third, fourth = lax.fori_loop(0, count, unit, (state, rate(state), none, none))
    return _RateRun(largest, third, fourth, flow.chart.point(state))


class _Linearisation(NamedTuple):
    """Rates (d,) at a point, and ∂(rate)/∂(coordinate), (d, d)."""

    rate: Float[Array, " d"]
    change: Float[Array, "d d"]


def _linearise(strobe: ReturnMap, u: Float[Array, " d"], p: Parameters) -> _Linearisation:
    """Linearise the rates of one lane."""

    def rate(u: Float[Array, " d"]) -> Array:
        return jnp.stack(rates(strobe.system, strobe.chart.state(u), p))

    return _Linearisation(rate(u), jax.jacfwd(rate)(u))
