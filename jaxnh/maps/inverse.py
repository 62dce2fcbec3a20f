"""Inverses of return maps: steps back in time, from a crossing to the one before, or as a map says it."""

from __future__ import annotations

import math
from dataclasses import replace

import jax
import numpy as np

from jaxnh.maps.build import backward_parts, map_of_one_step
from jaxnh.maps.crossings import EventStrobe
from jaxnh.maps.iteration import IterationStrobe
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.section import Section, flow_of
from jaxnh.solvers import AdaptiveMethod, Solver
from jaxnh.systems.discrete_map import DiscreteMap, inverse_map
from jaxnh.systems.flow import Flow
from jaxnh.systems.piecewise_smooth import PiecewiseSmooth

_OPPOSITE = {"up": "down", "down": "up", "both": "both"}


def make_inverse_map(system: Flow | Section, solver: Solver, steps: int, *, compensated: bool = False) -> ReturnMap:
    """The inverse of `make_return_map`: of a flow by as many steps back in time, of a map its own.

    Raises:
        TypeError: there is none: of a map that says none, of jumps and switches, of steps of a lane's own.
    """
    if isinstance(system, DiscreteMap):
        if (inverse := inverse_map(system)) is None:
            raise TypeError("the map says no inverse")
        return IterationStrobe(inverse)
    if isinstance(flow_of(system), PiecewiseSmooth):
        raise TypeError("motions with jumps or switches are not followed backwards")
    if isinstance(solver, AdaptiveMethod):
        raise TypeError(f"the flow takes steps of a lane's own ({solver.name}), which go forward alone")
    if isinstance(system, Section):
        met = replace(system, direction=_OPPOSITE[system.direction])
        step, most = -system.flow.period / steps, math.ceil(system.longest * steps)
        return EventStrobe(met, map_of_one_step(system.flow, solver), step, np.int32(most), backward=True)
    parts = backward_parts(system, solver, steps, 1, system.period, compensated=compensated)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[0], parts)
