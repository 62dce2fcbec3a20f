"""Start states of a user's mechanical system: put on a level of an integral, and on f = 0, or failed."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxnh.analyses.options.base import rule
from jaxnh.config.messages import join_words
from jaxnh.config.user_system import UserInitial, UserSweep
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.lagrangian import Lagrangian, Motion
from jaxnh.systems.level import off_level
from jaxnh.systems.rows import concatenate, select, spread_indices, write_rows
from jaxnh.systems.state import State
from jaxnh.systems.status import STATUS
from jaxnh.systems.switched_mechanics import SwitchedMechanics
from jaxnh.systems.user_functions import COMPILED_FOR_ONE_CALL

_LARGEST_RESIDUAL = 1e-6  # of f at the start, in units of |A q̇| + 1: what the digits of a config leave
_ON_LEVEL = 1e-12  # of an integral, in units of its level + 1: a few roundings
_IMPROVEMENTS = 64  # steps of Newton: each halves a factor that is far too large
_MOST_CHECKED = 100_000  # lanes at which f is looked at
_TILE = 64  # lanes of a program's call


def check_starts(flow: Flow, initial: UserInitial, sweep: UserSweep, integrals: Sequence[str] = ()) -> None:
    """Check that starts can be put on their level and that the constraints hold there, at some points of a large sweep.

    Where the start is swept it is enough that they hold somewhere: lanes that begin elsewhere fail (`admit_starts`).

    Args:
        flow: the system at the first value of every axis.
        initial: the start state.
        sweep: the axes.
        integrals: names of those that a start can be put on a level of.

    Raises:
        ValueError: they do not hold; the rule names the keys.
    """
    axes = _product({name: grid.grid() for name, grid in sweep.grids.items()})
    lanes = len(next(iter(axes.values())))
    parameters = {name: values for name, values in axes.items() if name not in (*initial.known, *integrals)}
    given = {name: np.full(lanes, value) for name, value in initial.coordinates().items()} | axes
    levels = {name: given[name] for name in integrals if name in given}
    if len(levels) > 1:
        raise rule("velocities are scaled to the level of one integral; leave out the others", "initial.level", "sweep")
    if isinstance(flow, SwitchedMechanics):
        _check_restitutions(flow, axes, parameters)
    # A constraint that comes and goes begins where a start is off it.
    flow = flow.mechanics if isinstance(flow, SwitchedMechanics) else off_level(flow)
    if not isinstance(flow, Lagrangian) or not (flow.constrained or levels):
        if initial.project:
            raise rule("the system has no constraints; leave it out", "initial.project")
        return
    start = flow.start({name: given[name] for name in initial.known})
    if initial.project and flow.constrained:
        start = _nearest_states(flow, start, parameters)
    for name, values in levels.items():
        start, reached = put_on_level(flow, start, parameters, name, values)
        if not np.any(reached):
            at_rest = _integral(flow, start._replace(v=tuple(0.0 * v for v in start.v)), parameters, name)
            message = f"no multiple of the start's velocities has {name} = {values[0]:g}; at rest it is {at_rest[0]:g}"
            raise rule(message, f"sweep.{name}", f"initial.level.{name}")
    if not flow.constrained or initial.project:
        return
    residuals, off = _off_constraint(flow, start, parameters)
    swept = [f"sweep.{name}" for name in axes if name not in parameters]
    if not np.any(off) or (swept and not np.all(off)):
        return
    sizes = np.where(np.isfinite(residuals), np.abs(residuals), np.inf)
    number, lane = np.unravel_index(np.argmax(sizes), sizes.shape)
    where = join_words([f"{name} = {values[lane]:g}" for name, values in axes.items()])
    near = select(_nearest_states(flow, *select((start, parameters), np.array([lane]))), 0)
    message, keys = _describe_residual(flow, int(number), float(residuals[number, lane]), where, near)
    own = [key for key in swept if key.removeprefix("sweep.") in keys]
    raise rule(message, *own, *(f"initial.{key}" for key in (*keys, *flow.names)), *swept, "initial", "system")


def _check_restitutions(
    flow: SwitchedMechanics, axes: Mapping[str, np.ndarray], parameters: Mapping[str, np.ndarray]
) -> None:
    """Check that no coefficient of restitution is negative at any lane: the motion would go on through the wall."""

    def restitutions(p: Parameters) -> dict[str, Array]:
        jumps = enumerate(flow.definition(p)["jumps"] if flow.jumps else ())
        return {f"jumps[{k}]": jnp.asarray(jump["restitution"], float) for k, jump in jumps if "restitution" in jump}

    lanes = len(next(iter(axes.values())))
    every = {"": np.zeros(lanes), **parameters}
    for where, values in jax.vmap(lambda p: restitutions({name: p[name] for name in parameters}))(every).items():
        if np.any(below := np.asarray(values) < 0.0):
            lane = int(np.argmax(below))
            at = join_words([f"{name} = {swept[lane]:g}" for name, swept in axes.items()])
            message = f"{where}.restitution is {float(values[lane]):g} at {at}, and must not be negative"
            unswept = float(restitutions({})[where]) < 0.0
            raise rule(message, *(f"sweep.{name}" for name in parameters if not unswept), "system")


def _describe_residual(
    flow: Lagrangian, number: int, residual: float, where: str, near: Motion
) -> tuple[str, Sequence[str]]:
    """Describe a residual at the start that is not zero, and the nearest state; and what it is of, by name."""
    if number < flow.constraints:
        kind, keys, values = "velocities", flow.velocities, near.v
        message = f"f[{number}] is {residual:.3g} at the start with {where}, and must be 0"
    else:
        group = flow.norms[number - flow.constraints]
        kind, keys, values = "coordinates", [flow.names[i] for i in group], [near.q[i] for i in group]
        squares = f"the sum of the squares of {join_words(keys)} is {residual + 1.0:.9g}"
        message = f"{squares} at the start with {where}, and must be 1"
    if np.all(np.isfinite(np.array(values))):
        nearest = ", ".join(f"{key}: {float(value):.10g}" for key, value in zip(keys, values, strict=True))
        message += f"; the nearest {kind} that make it so are {nearest} (initial.project: true moves starts there)"
    return message, keys


def _off_constraint(flow: Lagrangian, start: Motion, p: Parameters) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of f at start states, (constraints, lanes), and which lanes are off f = 0, (lanes,)."""
    residuals = _in_tiles(_residuals, flow, start, p).T
    limit = _LARGEST_RESIDUAL * (1.0 + np.abs(np.stack([np.asarray(v) for v in start.v])).max(axis=0))
    return residuals, ~np.all(np.abs(residuals) <= limit, axis=0)


@functools.partial(jax.jit, compiler_options=COMPILED_FOR_ONE_CALL)
def _residuals(flow: Lagrangian, start: Motion, p: Parameters) -> Array:
    return jax.vmap(lambda y, p: jnp.stack(flow.residuals(0.0, y, p)))(start, p)


def _nearest_states(flow: Lagrangian, start: Motion, p: Parameters) -> Motion:
    """States (lanes,) on the constraints near start states, by one program: its operations one by one are a hundred."""
    return _in_tiles(_nearest, flow, start, p)


@functools.partial(jax.jit, compiler_options=COMPILED_FOR_ONE_CALL)
def _nearest(flow: Lagrangian, start: Motion, p: Parameters) -> Motion:
    return jax.vmap(lambda y, p: flow.nearest(y, p))(start, p)


def _in_tiles(function: Callable[..., Any], flow: Lagrangian, start: Motion, p: Parameters, *more: np.ndarray) -> Any:
    """A function of lanes, some at a time: one program for any number of lanes, with all parameters that lanes have.

    Starts of a sweep are looked at three times before it runs, of all lanes, of samples and of one; a program for each
    took 7 of 47 s of configs/nonholonomic/rubber_disk.yaml from an empty cache.
    """
    count = len(start.q[0])
    own = {
        name: np.broadcast_to(np.asarray(p.get(name, flow.values[name]), float), count) for name in flow.roles.of_lanes
    }
    lanes = jax.tree.map(lambda leaf: np.asarray(leaf, float), (start, own, *more))
    parts = []
    with jax.enable_x64(True):  # whoever loads a config in a script has not started a session yet
        for first in range(0, count, _TILE):
            last = min(first + _TILE, count)
            part = select(lanes, np.minimum(np.arange(first, first + _TILE), count - 1))
            parts.append(jax.tree.map(lambda leaf, n=last - first: np.asarray(leaf)[:n], function(flow, *part)))
    return concatenate(parts)


def admit_starts(flow: Flow, start: State, p: Parameters, levels: Mapping[str, np.ndarray], *, project: bool) -> State:
    """Start states of a mechanical system (lanes,), put on their level, those off its constraints failed.

    Those off the constraints are moved onto them before, if asked.
    """
    if isinstance(flow, SwitchedMechanics):
        motion = admit_starts(flow.mechanics, flow.as_motion(start), p, levels, project=project)
        return flow.from_motion(motion)
    flow = off_level(flow)
    if not isinstance(flow, Lagrangian) or not (flow.constrained or levels):
        return start
    if project and flow.constrained:
        _, off = _off_constraint(flow, start, p)
        if np.any(off):
            start = _replaced(start, off, _nearest_states(flow, *select((start, dict(p)), off)))
    reached = np.ones(len(start.q[0]), bool)
    for name, values in levels.items():
        start, reached = put_on_level(flow, start, p, name, np.broadcast_to(values, reached.shape))
    off = ~reached
    if flow.constrained and not (project and not levels):
        off = off | _off_constraint(flow, start, p)[1]
    if not np.any(off):
        return start
    drift, reason = select(start.watch, off)
    nowhere = jax.tree.map(lambda leaf: np.full_like(leaf, np.nan), select(start, off))
    return _replaced(start, off, nowhere._replace(watch=(drift, np.full_like(reason, STATUS.index("off_constraint")))))


def put_on_level(
    flow: Lagrangian, start: Motion, p: Parameters, name: str, level: np.ndarray
) -> tuple[Motion, np.ndarray]:
    """Start states (lanes,) with velocities so many times theirs that an integral has a value, and where there are any.

    Newton on the factor, from one; of an integral that is quadratic in the velocities it comes down to the larger root.
    """
    values = np.asarray(level, float)
    factor, left = _in_tiles(functools.partial(_factors, name=name), flow, start, p, values)
    reached = (factor > 0.0) & (np.abs(left) <= _ON_LEVEL * (1.0 + np.abs(values)))
    factor = np.where(reached, factor, 1.0)
    return start._replace(v=tuple(factor * v for v in start.v)), reached


@functools.partial(jax.jit, static_argnames="name")
def _factors(flow: Lagrangian, start: Motion, p: Parameters, level: Array, *, name: str) -> tuple[Array, Array]:
    """Factors of the velocities of lanes, and what is left of the integral less its level with them."""

    def factor_of(y: Motion, p: Parameters, level: Array) -> tuple[Array, Array]:
        def excess(factor: Array) -> Array:
            return flow.integral(name, 0.0, y._replace(v=tuple(factor * v for v in y.v)), p) - level

        def improved(_: Any, factor: Array) -> Array:
            value, slope = jax.jvp(excess, (factor,), (jnp.ones_like(factor),))
            return factor - value / slope

        factor = lax.fori_loop(0, _IMPROVEMENTS, improved, jnp.ones_like(level))
        return factor, excess(factor)

    return jax.vmap(factor_of)(start, p, level)


def _integral(flow: Lagrangian, start: Motion, p: Parameters, name: str) -> np.ndarray:
    return np.asarray(jax.vmap(lambda y, p: flow.integral(name, 0.0, y, p))(start, dict(p)))


def _replaced(states: Motion, lanes: np.ndarray, others: Motion) -> Motion:
    """States with some lanes replaced."""
    states = jax.tree.map(np.array, states)
    write_rows(states, lanes, others)
    return states


def _product(axes: Mapping[str, Float[np.ndarray, " n"]]) -> dict[str, Float[np.ndarray, " lanes"]]:
    """All points of a product of axes; of a large one some, evenly along each axis with both ends."""
    counts = {name: len(values) for name, values in axes.items()}
    while np.prod([float(count) for count in counts.values()]) > _MOST_CHECKED:
        largest = max(counts, key=lambda name: counts[name])
        counts[largest] = -(-counts[largest] // 2)
    picked = [values[spread_indices(len(values), counts[name])] for name, values in axes.items()]
    return dict(zip(axes, (grid.ravel() for grid in np.meshgrid(*picked, indexing="ij")), strict=True))
