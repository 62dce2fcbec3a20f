"""The stroboscopic map P(z; b): a system under a solver over one period, its iterates and its derivatives.

Every lane keeps the same clock, and the clock starts anew each period, so no phase is lost in a long run.
"""

from __future__ import annotations

import math

import jax
import numpy as np

from jaxnh.maps.crossings import EventStrobe, SteppedStrobe
from jaxnh.maps.general_flow import MarchedStrobe, SolveStrobe, marched
from jaxnh.maps.kick_tables import cut_table, kick_table, processed_table
from jaxnh.maps.kicks import KickStrobe
from jaxnh.maps.protocol import Strobe, System
from jaxnh.maps.section import Flow, SectionedFlow
from jaxnh.maps.step_grids import GRID_POINTS, share_of_steps, step_grid
from jaxnh.solvers import IsokineticSplitting, Solver, WrittenOutRungeKutta
from jaxnh.systems.lagrangian import NonholonomicSystem
from jaxnh.systems.particle import IsokineticParticle

_SMALLEST_TABLE = 1024
_SMALLEST_STEP = 64  # kicks of a step: as many as any splitting has, so that all run through one program
_LONGEST_RETURN = 1000.0  # time without a crossing after which a lane has failed


def make_strobe(
    system: System,
    solver: Solver,
    steps: int,
    *,
    compensated: bool = False,
    span: tuple[float, float] | None = None,
) -> Strobe:
    """The strobe map of a system under a solver with so many steps a period; of a flow on a section, its return map.

    Args:
        compensated: lower the rounding floor of a splitting; Runge–Kutta methods and maps without a clock ignore it.
        span: times (t0, t1) of another stretch than the period from 0, for a map over part of a period or a strobe at
            another phase; it gets its share of the steps, at least one.
    """
    if isinstance(system, SectionedFlow):
        most = math.ceil(_LONGEST_RETURN * steps / system.period)
        return EventStrobe(system, _unit_step(system.flow, solver), system.period / steps, np.int32(most))
    t0, t1 = span or (0.0, system.period)
    if system.autonomous:
        steps = max(1, math.ceil(steps * (t1 - t0) / system.period - 1e-6))
        return _equal_steps(system, solver, steps, t1 - t0)
    steps = max(1, math.ceil(steps * share_of_steps(system, (t0, t1)) - 1e-6))
    if isinstance(solver, IsokineticSplitting) and isinstance(system, IsokineticParticle) and solver.processor[1]:
        table = processed_table(system, solver, steps, (t0, t1), smallest=_SMALLEST_TABLE)
        return KickStrobe(system, *table, compensated)
    grid = step_grid(system, steps, (t0, t1))
    if isinstance(solver, IsokineticSplitting) and isinstance(system, IsokineticParticle):
        return KickStrobe(system, *kick_table(system, solver, grid, smallest=_SMALLEST_TABLE), compensated)
    return _solved(system, solver, grid)


def _solved(system: Flow, solver: Solver, grid: np.ndarray) -> Strobe:
    """The map, or stacked maps, of a Runge–Kutta method over a grid (..., steps + 1)."""
    if isinstance(system, NonholonomicSystem):
        return marched(system, solver, grid)
    return SolveStrobe(system, solver, grid)


def _unit_step(flow: Flow, solver: Solver) -> Strobe:
    """One step as long as the unit of time, of a system without a clock."""
    grid = np.array([0.0, 1.0])
    if isinstance(solver, IsokineticSplitting) and isinstance(flow, IsokineticParticle):
        return KickStrobe(flow, *kick_table(flow, solver, grid, smallest=_SMALLEST_STEP))
    if isinstance(flow, NonholonomicSystem) and isinstance(solver, WrittenOutRungeKutta):
        return MarchedStrobe(flow, solver, grid, np.int32(1))
    raise TypeError(f"{solver.name} has no steps of its own for a system without a clock")


def _equal_steps(flow: Flow, solver: Solver, steps: int, length: float, parts: int = 0) -> SteppedStrobe:
    """So many equal steps over a length of time, or the same in every one of so many parts."""
    strobe = SteppedStrobe(flow, _unit_step(flow, solver).stretched(length / steps), np.int32(steps))
    if not parts:
        return strobe
    return jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[None], parts, axis=0), strobe)


def make_parts(system: Flow, solver: Solver, steps: int, parts: int, *, compensated: bool = False) -> Strobe:
    """The maps over so many equal parts of a period, one after the other, as one pytree for `lax.scan`.

    Every leaf has the parts as first axis. No step is longer than those of the whole period's map with `steps` steps.
    """
    if system.autonomous:
        return _equal_steps(system, solver, max(1, math.ceil(steps / parts - 1e-6)), system.period / parts, parts)
    fine = step_grid(system, GRID_POINTS, (0.0, system.period))
    share = np.linspace(0.0, 1.0, GRID_POINTS + 1)
    ends = np.linspace(0.0, system.period, parts + 1)
    shares = np.interp(ends, fine, share)
    each = max(1, math.ceil(steps * np.diff(shares).max() - 1e-6))
    grid = np.interp(np.linspace(shares[:-1], shares[1:], each + 1, axis=-1), share, fine)
    grid[:, 0], grid[:, -1] = ends[:-1], ends[1:]
    many = jax.tree.map(lambda leaf: np.full(parts, leaf, float), system)
    if isinstance(solver, IsokineticSplitting) and isinstance(system, IsokineticParticle) and solver.processor[1]:
        return KickStrobe(many, *processed_table(system, solver, each, (ends[:-1], ends[1:])), compensated)
    if isinstance(solver, IsokineticSplitting) and isinstance(system, IsokineticParticle):
        return KickStrobe(many, *kick_table(system, solver, grid), compensated)
    return _solved(many, solver, grid)


def cut_strobe(system: Flow, solver: Solver, steps: int, parts: int, *, compensated: bool = False) -> Strobe:
    """The strobe map cut into so many maps of equally many steps, stacked as by `make_parts`.

    The parts differ in length, and together have the least multiple of `parts` from `steps` on as steps. A processed
    solver's processor stands at the ends of the first and of the last alone.
    """
    each = -(-steps // parts)
    if system.autonomous:
        return _equal_steps(system, solver, each, system.period / parts, parts)
    many = jax.tree.map(lambda leaf: np.full(parts, leaf, float), system)
    if isinstance(solver, IsokineticSplitting) and isinstance(system, IsokineticParticle) and solver.processor[1]:
        table = processed_table(system, solver, each * parts, (0.0, system.period))
        return KickStrobe(many, *cut_table(table, parts, each * solver.stages), compensated)
    ends = step_grid(system, each * parts, (0.0, system.period))
    grid = ends[np.arange(parts)[:, None] * each + np.arange(each + 1)]
    if isinstance(solver, IsokineticSplitting) and isinstance(system, IsokineticParticle):
        return KickStrobe(many, *kick_table(system, solver, grid), compensated)
    return _solved(many, solver, grid)
