"""Inverses of return maps: steps back in time, from a crossing to the one before, or as a map says it."""

from __future__ import annotations

import jax
import numpy as np

from jaxnh.maps.adaptive import adaptive_parts
from jaxnh.maps.build import equal_steps, scheme_of, section_strobe
from jaxnh.maps.iteration import IterationStrobe
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.section import Section
from jaxnh.maps.step_grids import step_grid
from jaxnh.solvers import AdaptiveMethod, Solver
from jaxnh.systems.backward_motion import check_invertible
from jaxnh.systems.discrete_map import DiscreteMap, inverse_map
from jaxnh.systems.flow import Flow


def make_inverse_map(system: Flow | Section, solver: Solver, steps: int, *, compensated: bool = False) -> ReturnMap:
    """The inverse of `make_return_map`: of a flow by as many steps back in time, of a map its own.

    Raises:
        TypeError: there is none: of a map that says none, and where different motions become one.
    """
    if isinstance(system, DiscreteMap):
        if (inverse := inverse_map(system)) is None:
            raise TypeError("the map says no inverse")
        return IterationStrobe(inverse)
    if isinstance(system, Section):
        return section_strobe(system, solver, steps, backward=True)
    parts = backward_parts(system, solver, steps, 1, system.period, compensated=compensated)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[0], parts)


def backward_parts(
    system: Flow, solver: Solver, steps: int, parts: int, begin: float, *, compensated: bool = False
) -> ReturnMap:
    """The maps back in time over a period from `begin`, in so many parts of equally many steps, stacked.

    Raises:
        TypeError: different motions become one (`check_invertible`).
    """
    check_invertible(system)
    each = -(-steps // parts)
    if isinstance(solver, AdaptiveMethod):
        return adaptive_parts(system, solver, steps, step_grid(system, parts, (begin, begin - system.period)))
    if system.autonomous:
        return equal_steps(system, solver, each, -system.period / parts, parts)
    ends = step_grid(system, each * parts, (begin, begin - system.period))
    grid = ends[np.arange(parts)[:, None] * each + np.arange(each + 1)]
    return scheme_of(system, solver).parts(system, solver, each, grid, ends[::each], compensated=compensated)
