"""Numbers that change along motions, by name: coordinates, heights of walls and surfaces, and what a definition says.

A right-hand side says them as `observables`, functions of (y, t) by name.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxnh.systems.definition import Definition
from jaxnh.systems.first_order import FirstOrder
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.piecewise_smooth import PiecewiseSmooth
from jaxnh.systems.state import Number, State

EVENTS = {"jumps": "when", "switches": "on"}
"""Keys of a definition whose values are lists of walls and of surfaces, and the keys of their heights."""


def observable_names(flow: Flow) -> tuple[str, ...]:
    """Names of the observables of a flow that one may ask for; of the particle, whose chart has an angle, none."""
    whole = len(flow.coordinates) == flow.chart.dimension
    return (*(flow.coordinates if whole else ()), *_definition(flow, {}).get("observables", ()))


def surface_names(flow: Flow) -> tuple[str, ...]:
    """Names of the walls and surfaces of a right-hand side, as its definition lists them."""
    definition = _definition(flow, {})
    return tuple(f"{kind}[{k}]" for kind in EVENTS for k in range(len(definition.get(kind, ()))))


def observable(flow: Flow, name: str, t: ArrayLike, y: State, p: Parameters) -> Number:
    """An observable of a state, or the height of a wall or surface."""
    if name in flow.coordinates:
        return flow.chart.components(y)[flow.coordinates.index(name)]
    definition = _definition(flow, p)
    if name in definition.get("observables", {}):
        value = definition["observables"][name](tuple(y.y), t)
    else:
        kind, number = name.removesuffix("]").split("[")
        value = definition[kind][int(number)][EVENTS[kind]](tuple(y.y), t)
    return jnp.asarray(value, jnp.float64)


def time_unit(flow: Flow, p: Parameters) -> ArrayLike:
    """Unit of a flow's time: its period where time is over the period, else one."""
    return _definition(flow, p).get("time_unit_of_rates", 1.0)


def smooth_branch(flow: PiecewiseSmooth, sides: tuple[float, ...]) -> FirstOrder:
    """The flow on one side of its walls and surfaces, and by the same field beyond them.

    Args:
        sides: +1 above, −1 below, of each wall, then of each surface.
    """

    def define(**p: ArrayLike) -> Definition:
        definition = flow.define(**p)
        rhs, of_surfaces = definition["rhs"], sides[len(flow.jumps) :]
        return {**definition, "rhs": (lambda y, t: rhs(y, t, of_surfaces)) if flow.switches else rhs}

    return FirstOrder(define, flow.values, flow.of_lanes, flow.names, flow.angles, flow.clock)


def _definition(flow: Flow, p: Parameters) -> Definition:
    return flow.definition(p) if isinstance(flow, FirstOrder) else {}
