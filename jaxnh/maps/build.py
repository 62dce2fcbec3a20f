"""Construction of maps: of a flow under a solver, over a period, a part of one, or from crossing to crossing.

Every lane keeps the same clock, and the clock starts anew each period, so no phase is lost in a long run. The registry
at the end says which flows have a way of their own; all others go by Runge–Kutta steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar, Protocol

import jax
import numpy as np

from jaxnh.maps.adaptive import adaptive_parts, adaptive_strobe
from jaxnh.maps.crossings import EventStrobe, SteppedStrobe
from jaxnh.maps.general_flow import general_strobe, stack_leaves, unit_step
from jaxnh.maps.iteration import IterationStrobe
from jaxnh.maps.jumping import jumping_strobe
from jaxnh.maps.jumping_section import JumpingSection
from jaxnh.maps.kick_tables import cut_table, kick_table, processed_table, whole_period, whole_periods
from jaxnh.maps.kicks import KickStrobe
from jaxnh.maps.nystrom import nystrom_strobe, nystrom_unit_step
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.second_order import second_order
from jaxnh.maps.section import Section, flow_of
from jaxnh.maps.step_grids import GRID_POINTS, share_of_steps, step_grid
from jaxnh.solvers import (
    ADAPTIVE,
    SPLITTINGS,
    AdaptiveMethod,
    IsokineticSplitting,
    Nystrom,
    Solver,
    WrittenOutRungeKutta,
    nystrom8,
    tsit5,
    tsitouras_papakostas8,
    verner9,
)
from jaxnh.systems.backward_motion import backward_motion, check_invertible
from jaxnh.systems.discrete_map import DiscreteMap
from jaxnh.systems.flow import Flow
from jaxnh.systems.particle import IsokineticParticle
from jaxnh.systems.piecewise_smooth import PiecewiseSmooth

_SMALLEST_TABLE = 8192  # rows of all parts: maps of most steps, and refined ones, run through one program
_FEWEST_LOOKS, _STEPS_A_LOOK = 32, 8  # parts of a unit of time after which a crossing is looked for, and steps in them
_OPPOSITE = {"up": "down", "down": "up", "both": "both"}
_SMALLEST_STEP = 64  # kicks of a step: as many as any splitting has, so that all run through one program


# ---- ways to integrate


class Scheme(Protocol):
    """Integration of flows of one kind by solvers of one kind; the registry knows which.

    Attributes:
        reference: the one that errors are measured with.
        summations: whether sums may be plain, compensated, or both.
        rough_steps: of the reference, for a first look at a flow.
        first_steps: of the first reference, which is refined from there on.
        smooth: whether its flows are known to have neither jumps nor corners.
        stacked: whether all that lanes share is in tables, so that maps of several values of it go into one program.
    """

    reference: ClassVar[Solver]
    summations: ClassVar[tuple[bool, ...]]
    rough_steps: ClassVar[int]
    first_steps: ClassVar[int]
    smooth: ClassVar[bool]
    stacked: ClassVar[bool]

    def solvers(self, flow: Any, precision: str = "float64") -> tuple[Solver, ...]:
        """Return the solvers to choose from."""
        ...

    def strobe(self, flow: Any, solver: Any, steps: int, span: tuple[float, float], *, compensated: bool) -> ReturnMap:
        """The map over a span of time in so many steps."""
        ...

    def step(self, flow: Any, solver: Any) -> ReturnMap:
        """One step as long as the unit of time, of a flow without a clock."""
        ...

    def parts(
        self, flow: Any, solver: Any, each: int, grid: np.ndarray, ends: np.ndarray, *, compensated: bool
    ) -> ReturnMap:
        """Maps between ends (parts + 1,) of `each` steps on a grid (parts, each + 1), stacked."""
        ...

    def cut(self, flow: Any, solver: Any, each: int, parts: int, *, compensated: bool) -> ReturnMap:
        """The map of a period cut into so many parts of `each` steps, stacked."""
        ...


class Kicks:
    """Integration by isokinetic splittings: kicks in a table that all lanes share."""

    reference: ClassVar[Solver] = SPLITTINGS["sofroniou_spaletta10"]
    summations: ClassVar[tuple[bool, ...]] = (False, True)
    rough_steps: ClassVar[int] = 32
    first_steps: ClassVar[int] = 96
    smooth: ClassVar[bool] = True
    stacked: ClassVar[bool] = True

    def solvers(self, flow: Any, precision: str = "float64") -> tuple[Solver, ...]:
        return tuple(SPLITTINGS.values())

    def strobe(self, flow: Any, solver: Any, steps: int, span: tuple[float, float], *, compensated: bool) -> ReturnMap:
        if solver.processed and span == (0.0, flow.period):
            table = whole_period(flow, solver, steps, smallest=_SMALLEST_TABLE)
        elif solver.processed:
            table = processed_table(flow, solver, steps, span, smallest=_SMALLEST_TABLE)
        else:
            table = kick_table(flow, solver, step_grid(flow, steps, span), smallest=_SMALLEST_TABLE)
        return KickStrobe(flow.tabulated(), *table, compensated)

    def step(self, flow: Any, solver: Any) -> ReturnMap:
        table = kick_table(flow, solver, np.array([0.0, 1.0]), smallest=_SMALLEST_STEP)
        return KickStrobe(flow.tabulated(), *table)

    def parts(
        self, flow: Any, solver: Any, each: int, grid: np.ndarray, ends: np.ndarray, *, compensated: bool
    ) -> ReturnMap:
        if solver.processed:
            table = processed_table(flow, solver, each, (ends[:-1], ends[1:]), smallest=_SMALLEST_TABLE // len(grid))
        else:
            table = kick_table(flow, solver, grid, smallest=_SMALLEST_TABLE // len(grid))
        return KickStrobe(stack_leaves(flow.tabulated(), (len(grid),)), *table, compensated)

    def cut(self, flow: Any, solver: Any, each: int, parts: int, *, compensated: bool) -> ReturnMap:
        if solver.processed:
            whole = whole_period(flow, solver, each * parts)
            table = cut_table(whole, parts, each * solver.stages, smallest=_SMALLEST_TABLE // parts)
        else:
            table = kick_table(flow, solver, _split_grid(flow, each, parts), smallest=_SMALLEST_TABLE // parts)
        return KickStrobe(stack_leaves(flow.tabulated(), (parts,)), *table, compensated)


class StepScheme:
    """Integration by Runge–Kutta methods, of any flow, and by Nyström methods, of flows of second order."""

    reference: ClassVar[Solver] = verner9
    summations: ClassVar[tuple[bool, ...]] = (False,)
    rough_steps: ClassVar[int] = 16
    first_steps: ClassVar[int] = 96
    smooth: ClassVar[bool] = False
    stacked: ClassVar[bool] = False

    def solvers(self, flow: Flow, precision: str = "float64") -> tuple[Solver, ...]:
        # Where Nyström's method goes it needs half the arithmetic of the others, at every accuracy. It has its stages
        # written out, and so many operations in extended precision would compile for minutes.
        if precision != "extended" and second_order(flow):
            return (nystrom8,)
        return tsitouras_papakostas8, verner9, tsit5

    def strobe(self, flow: Any, solver: Any, steps: int, span: tuple[float, float], *, compensated: bool) -> ReturnMap:
        return _map_on_grid(flow, solver, step_grid(flow, steps, span))

    def step(self, flow: Any, solver: Any) -> ReturnMap:
        if isinstance(solver, Nystrom):
            return nystrom_unit_step(flow, solver)
        return unit_step(flow, _check_solver(solver))

    def parts(
        self, flow: Any, solver: Any, each: int, grid: np.ndarray, ends: np.ndarray, *, compensated: bool
    ) -> ReturnMap:
        return _map_on_grid(flow, solver, grid)

    def cut(self, flow: Any, solver: Any, each: int, parts: int, *, compensated: bool) -> ReturnMap:
        return _map_on_grid(flow, solver, _split_grid(flow, each, parts))


class AdaptiveScheme(StepScheme):
    """Integration by embedded pairs with steps of a lane's own, of any flow: of stiff ones, and across corners."""

    reference: ClassVar[Solver] = ADAPTIVE["rodas5p"]

    def solvers(self, flow: Flow, precision: str = "float64") -> tuple[Solver, ...]:
        return (ADAPTIVE["rodas5p"],)


class ExplicitAdaptiveScheme(StepScheme):
    """Integration by explicit pairs with steps of a lane's own: of spikes, for which few of the steps are."""

    reference: ClassVar[Solver] = ADAPTIVE["adaptive_tsitouras_papakostas8"]
    first_steps: ClassVar[int] = 24  # of 84 that are as fine as rounding

    def solvers(self, flow: Flow, precision: str = "float64") -> tuple[Solver, ...]:
        return (ADAPTIVE["adaptive_tsitouras_papakostas8"],)


class StepsToEvents(StepScheme):
    """Integration by Runge–Kutta methods whose steps end at jumps and switches."""

    def solvers(self, flow: Flow, precision: str = "float64") -> tuple[Solver, ...]:
        return tsitouras_papakostas8, verner9, tsit5


def _split_grid(flow: Flow, each: int, parts: int) -> np.ndarray:
    """The step grid of a period in parts of `each` steps, (parts, each + 1)."""
    ends = step_grid(flow, each * parts, (0.0, flow.period))
    return ends[np.arange(parts)[:, None] * each + np.arange(each + 1)]


def _map_on_grid(flow: Flow, solver: Any, grid: np.ndarray) -> ReturnMap:
    if isinstance(flow, PiecewiseSmooth):
        begin, end = float(grid.flat[0]), float(grid.flat[-1])
        if end < begin:
            return jumping_strobe(backward_motion(flow, begin), _with_events(solver), begin - grid)
        return jumping_strobe(flow, _with_events(solver), grid)
    if isinstance(solver, Nystrom):
        return nystrom_strobe(flow, solver, grid)
    return general_strobe(flow, _check_solver(solver), grid)


def _with_events(solver: Any) -> WrittenOutRungeKutta:
    if not isinstance(solver, WrittenOutRungeKutta):
        raise TypeError(f"{type(solver).__name__} has no steps that end at jumps and switches")
    return solver


def _check_solver(solver: Any) -> Any:
    if isinstance(solver, IsokineticSplitting):
        raise TypeError(f"{solver.name} is a splitting for a particle at a prescribed speed")
    return solver


SCHEMES: dict[type[Flow], tuple[Scheme, Scheme]] = {
    IsokineticParticle: (Kicks(), StepScheme()),
    PiecewiseSmooth: (StepsToEvents(), StepsToEvents()),
    Flow: (StepScheme(), StepScheme()),
}
"""The registry: how flows of a kind are integrated by solvers of that way, and by others."""

ADAPTIVE_SCHEME = AdaptiveScheme()
"""The way to integrate any flow that steps which all lanes share do not follow."""

EXPLICIT_ADAPTIVE_SCHEME = ExplicitAdaptiveScheme()
"""The way to integrate a flow that is not stiff, whose motions need some steps far shorter than others."""


def scheme_of(system: Flow | Section, solver: Any = None) -> Scheme:
    """Return the scheme that integrates a flow, with a solver if one is named."""
    if isinstance(solver, AdaptiveMethod):
        return ADAPTIVE_SCHEME
    own, other = next(SCHEMES[kind] for kind in type(flow_of(system)).__mro__ if kind in SCHEMES)
    return own if solver is None or isinstance(solver, type(own.reference)) else other


# ---- maps


def make_return_map(
    system: Flow | Section,
    solver: Solver,
    steps: int,
    *,
    compensated: bool = False,
    span: tuple[float, float] | None = None,
) -> ReturnMap:
    """The strobe map of a flow under a solver with so many steps a period; of a flow on a section, its return map.

    Of a map it is the map itself, whatever the solver and the steps.

    Args:
        compensated: lower the rounding floor of a splitting; Runge–Kutta methods and maps without a clock ignore it.
        span: times (t0, t1) of another stretch than the period from 0, for a map over part of a period or a strobe at
            another phase; it gets its share of the steps, at least one.

    Raises:
        TypeError: the solver is none for flows of this kind.
    """
    if isinstance(system, DiscreteMap):
        return IterationStrobe(system)
    if isinstance(system, Section):
        return section_strobe(system, solver, steps)
    t0, t1 = span or (0.0, system.period)
    if isinstance(solver, AdaptiveMethod):
        return adaptive_strobe(system, solver, steps, (t0, t1))
    if system.autonomous:
        steps = max(1, math.ceil(steps * (t1 - t0) / system.period - 1e-6))
        return equal_steps(system, solver, steps, t1 - t0)
    steps = max(1, math.ceil(steps * share_of_steps(system, (t0, t1)) - 1e-6))
    return scheme_of(system, solver).strobe(system, solver, steps, (t0, t1), compensated=compensated)


def prepare_tables(systems: Sequence[Flow | Section], solver: Solver, steps: int, parts: int = 1) -> None:
    """Make in one go the tables that `make_return_map`, or `cut_strobe` into parts, needs for each of some systems.

    Those are the tables of kicks of processed splittings; other maps are made one by one.
    """
    flows = [system for system in systems if isinstance(system, IsokineticParticle) and not system.autonomous]
    if flows and isinstance(solver, IsokineticSplitting) and solver.processed:
        whole_periods(flows, solver, -(-steps // parts) * parts)


def make_parts(system: Flow, solver: Solver, steps: int, parts: int, *, compensated: bool = False) -> ReturnMap:
    """The maps over so many equal parts of a period, one after the other, as one pytree for `lax.scan`.

    Every leaf has the parts as first axis. No step is longer than those of the whole period's map with `steps` steps.
    """
    if system.autonomous and not isinstance(solver, AdaptiveMethod):
        return equal_steps(system, solver, max(1, math.ceil(steps / parts - 1e-6)), system.period / parts, parts)
    return maps_between(system, solver, steps, np.linspace(0.0, system.period, parts + 1), compensated=compensated)


def maps_between(system: Flow, solver: Solver, steps: int, ends: np.ndarray, *, compensated: bool = False) -> ReturnMap:
    """The maps from each of some rising times (parts + 1,) within a period to the next, stacked as by `make_parts`."""
    if isinstance(solver, AdaptiveMethod):
        return adaptive_parts(system, solver, steps, ends)
    if system.autonomous:
        lengths = np.diff(ends)
        each = max(1, math.ceil(steps * lengths.max() / system.period - 1e-6))
        maps = [equal_steps(system, solver, each, length) for length in lengths.tolist()]
        return jax.tree.map(lambda *leaves: np.stack(leaves), *maps)
    fine = step_grid(system, GRID_POINTS, (0.0, system.period))
    share = np.linspace(0.0, 1.0, GRID_POINTS + 1)
    shares = np.interp(ends, fine, share)
    each = max(1, math.ceil(steps * np.diff(shares).max() - 1e-6))
    grid = np.interp(np.linspace(shares[:-1], shares[1:], each + 1, axis=-1), share, fine)
    grid[:, 0], grid[:, -1] = ends[:-1], ends[1:]
    return scheme_of(system, solver).parts(system, solver, each, grid, ends, compensated=compensated)


def cut_strobe(system: Flow, solver: Solver, steps: int, parts: int, *, compensated: bool = False) -> ReturnMap:
    """The strobe map cut into so many maps of equally many steps, stacked as by `make_parts`.

    The parts differ in length, and together have the least multiple of `parts` from `steps` on as steps. A processed
    solver's processor stands at the ends of the first and of the last alone. A map has one part.
    """
    if isinstance(system, DiscreteMap):
        return IterationStrobe(system).stacked()
    if isinstance(solver, AdaptiveMethod):
        return adaptive_parts(system, solver, steps, step_grid(system, parts, (0.0, system.period)))
    each = -(-steps // parts)
    if system.autonomous:
        return equal_steps(system, solver, each, system.period / parts, parts)
    return scheme_of(system, solver).cut(system, solver, each, parts, compensated=compensated)


def section_strobe(system: Section, solver: Solver, steps: int, *, backward: bool = False) -> ReturnMap:
    """The map from crossing to crossing, or back to the one before; of so many steps in a unit of time.

    By steps of a lane's own crossings are looked for at the ends of equal parts of the unit.

    Raises:
        TypeError: the solver is none for flows of this kind; or, back in time, as of `backward_parts`.
    """
    flow = system.flow
    looks = max(_FEWEST_LOOKS, steps // _STEPS_A_LOOK) if isinstance(solver, AdaptiveMethod) else steps
    step, most = flow.period / looks, np.int32(math.ceil(system.longest * looks))
    if backward:
        check_invertible(flow)
        system = replace(system, direction=_OPPOSITE[system.direction])
    if isinstance(solver, AdaptiveMethod):
        unit = adaptive_strobe(flow, solver, steps, (0.0, 1.0), backward=backward)
    elif isinstance(flow, PiecewiseSmooth):
        met = replace(system, flow=backward_motion(flow, 0.0)) if backward else system
        return JumpingSection(met, _with_events(solver), step, most, backward)
    else:
        unit = map_of_one_step(flow, solver)
    return EventStrobe(system, unit, -step if backward else step, most, backward)


def map_of_one_step(flow: Flow, solver: Solver) -> ReturnMap:
    """One step as long as the unit of time, of a flow without a clock."""
    if not hasattr(solver, "written_stages") and not isinstance(solver, IsokineticSplitting):
        raise TypeError(f"{solver.name} has no steps of its own for a flow without a clock")
    return scheme_of(flow, solver).step(flow, solver)


def equal_steps(flow: Flow, solver: Solver, steps: int, length: float, parts: int = 0) -> ReturnMap:
    """Return a map of equal steps over a length of time, or `parts` such maps."""
    if isinstance(flow, PiecewiseSmooth):
        strobe = _map_on_grid(flow, solver, np.linspace(0.0, length, steps + 1))
    else:
        strobe = SteppedStrobe(flow, map_of_one_step(flow, solver).rescaled_time(length / steps), np.int32(steps))
    if not parts:
        return strobe
    return jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[None], parts, axis=0), strobe)
