"""Start states of a user's mechanical system: whether f = 0 holds there; the others fail or are moved."""

from __future__ import annotations

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxnh.analyses.options.base import rule
from jaxnh.config.messages import join_words
from jaxnh.config.user_system import UserInitial, UserSweep
from jaxnh.systems.flow import STATUS, Flow, Parameters
from jaxnh.systems.lagrangian import Lagrangian, Motion

_LARGEST_RESIDUAL = 1e-6  # of f at the start, in units of |A q̇| + 1: what the digits of a config leave
_MOST_CHECKED = 100_000  # lanes at which f is looked at


def check_constraints(flow: Flow, initial: UserInitial, sweep: UserSweep) -> None:
    """Check that the constraints hold at the start: at every point of the sweep, or at some points of a large one.

    Where the start is swept it is enough that they hold somewhere: lanes that begin elsewhere fail (`admit_starts`).

    Args:
        flow: the system at the first value of every axis.
        initial: the start state.
        sweep: the axes.

    Raises:
        ValueError: they do not hold; the rule names the keys.
    """
    axes = _product({name: grid.grid() for name, grid in sweep.grids.items()})
    lanes = len(next(iter(axes.values())))
    parameters = {name: values for name, values in axes.items() if name not in initial.known}
    if not isinstance(flow, Lagrangian) or not flow.constrained:
        if initial.project:
            raise rule("the system has no constraints; leave it out", "initial.project")
        return
    coordinates = {name: np.full(lanes, value) for name, value in initial.coordinates().items()}
    start = flow.start(coordinates | {name: values for name, values in axes.items() if name in coordinates})
    residuals, off = _off_constraint(flow, start, parameters)
    swept = [f"sweep.{name}" for name in axes if name in coordinates]
    if not np.any(off) or initial.project or (swept and not np.all(off)):
        return
    sizes = np.where(np.isfinite(residuals), np.abs(residuals), np.inf)
    number, lane = np.unravel_index(np.argmax(sizes), sizes.shape)
    state, p = jax.tree.map(lambda leaf: jnp.asarray(leaf[lane]), (start, parameters))
    near = flow.nearest(state, p)
    where = join_words([f"{name} = {values[lane]:g}" for name, values in axes.items()])
    if number < flow.constraints:
        what, keys, values = "velocities", flow.velocities, near.v
        message = f"f[{number}] is {residuals[number, lane]:.3g} at the start with {where}, and must be 0"
    else:
        group = flow.norms[number - flow.constraints]
        what, keys, values = "coordinates", [flow.names[i] for i in group], [near.q[i] for i in group]
        squares = residuals[number, lane] + 1.0
        message = (
            f"the sum of the squares of {join_words(keys)} is {squares:.9g} at the start with {where}, and must be 1"
        )
    if np.all(np.isfinite(np.array(values))):
        nearest = ", ".join(f"{key}: {float(v):.10g}" for key, v in zip(keys, values, strict=True))
        message += f"; the nearest {what} that make it so are {nearest} (initial.project: true moves starts there)"
    given = [f"initial.{key}" for key in (*keys, *flow.names)]
    raise rule(
        message, *(key for key in swept if key.removeprefix("sweep.") in keys), *given, *swept, "initial", "system"
    )


def _off_constraint(flow: Lagrangian, start: Motion, p: Parameters) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of f at start states, (constraints, lanes), and which lanes are off f = 0, (lanes,)."""
    residuals = np.asarray(jax.vmap(lambda y, p: jnp.stack(flow.residuals(0.0, y, p)), out_axes=1)(start, dict(p)))
    limit = _LARGEST_RESIDUAL * (1.0 + np.abs(np.stack([np.asarray(v) for v in start.v])).max(axis=0))
    return residuals, ~np.all(np.abs(residuals) <= limit, axis=0)


def admit_starts(flow: Flow, start: Motion, p: Parameters, *, project: bool) -> Motion:
    """Start states of a mechanical system (lanes,), those off its constraints failed: or moved onto them, if asked."""
    if not isinstance(flow, Lagrangian) or not flow.constrained:
        return start
    _, off = _off_constraint(flow, start, p)
    if not np.any(off):
        return start
    off_constraint = jax.tree.map(lambda leaf: leaf[off], (start, dict(p)))
    if project:
        moved = jax.vmap(flow.nearest)(*off_constraint)
    else:
        drift, reason = off_constraint[0].watch
        nowhere = jax.tree.map(lambda leaf: np.full_like(leaf, np.nan), off_constraint[0])
        moved = nowhere._replace(watch=(drift, np.full_like(reason, STATUS.index("off_constraint"))))
    states = jax.tree.map(np.array, start)
    for leaf, part in zip(jax.tree.leaves(states), jax.tree.leaves(moved), strict=True):
        leaf[off] = part
    return states


def _product(axes: Mapping[str, Float[np.ndarray, " n"]]) -> dict[str, Float[np.ndarray, " lanes"]]:
    """All points of a product of axes; of a large one some, evenly along each axis with both ends."""
    counts = {name: len(values) for name, values in axes.items()}
    while np.prod([float(count) for count in counts.values()]) > _MOST_CHECKED:
        largest = max(counts, key=lambda name: counts[name])
        counts[largest] = -(-counts[largest] // 2)
    picked = [values[spread_indices(len(values), counts[name])] for name, values in axes.items()]
    return dict(zip(axes, (grid.ravel() for grid in np.meshgrid(*picked, indexing="ij")), strict=True))


def spread_indices(count: int, most: int) -> np.ndarray:
    """At most `most` numbers below a count, evenly spaced, with both ends."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))
