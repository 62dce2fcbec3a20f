"""Cost of every effect of a system, and of every analysis: operations of the compiled programs with and without it.

An effect is left out of the batch's own system and nothing else is changed: the same solver, the same steps. Times
are of all processors, which other programs on the machine disturb less than that of the clock: of one program after the
other on the same lanes, with the effect and without it in turns.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import singledispatch
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from jaxnh.analyses.base import LANE, Analysis, Entry, variable
from jaxnh.analyses.batch import LaneBatch
from jaxnh.analyses.exponents import lyapunov
from jaxnh.analyses.options.base import Options
from jaxnh.analyses.price import Price, PricedProgram, map_alone
from jaxnh.costs.operations import count
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.maps.build import make_return_map
from jaxnh.solvers import SPLITTINGS, IsokineticSplitting, Solver, dopri8
from jaxnh.systems.flow import Flow
from jaxnh.systems.free_particle import FreeParticle, definition, free_particle
from jaxnh.systems.lagrangian import Motion, lagrangian
from jaxnh.systems.particle import IsokineticParticle
from jaxnh.systems.particle_parameters import EFFECTS

_STAND_IN = "blanes_moan6"  # for a processed solver, which a flow without a clock has no use for
_GENERAL_STEPS = 64
_TIMED_SECONDS = 0.05
_MOST_PERIODS = 64
_FREE_OF_COST = {
    "damping": "free: the multiplier absorbs it, and it is in no equation",
    "disturbance": "free: it is in the table of kicks, which all lanes share",
}

Requested = Sequence[tuple[Analysis, Options]]
"""Analyses with their options, in the order in which they run."""


class EffectRow(NamedTuple):
    """An effect or analysis, its programs with and without it (none: it has none), bytes a lane, and a note."""

    what: str
    kind: str
    with_it: PricedProgram | None
    without_it: PricedProgram | None
    stored: float = 0.0
    note: str = ""


def price(batch: LaneBatch, requested: Requested, lanes: LaneExecutor, repeats: int) -> xr.Dataset:
    """A row for every effect of the paper's particle, then one for every number of tangents and every analysis."""
    batch = batch.take(np.linspace(0, batch.count - 1, lanes.tile * len(lanes.devices)).round().astype(int))
    with lanes.stage("cost: programs of all effects", 0):
        most = _most_tangents(batch.flow, requested)
        rows = [*_effects(batch.flow, batch), *_tangents(batch, most), *_analyses(batch, requested, lanes)]
        operations = np.array([[_operations(p, lanes) for p in (row.with_it, row.without_it)] for row in rows])
    with lanes.stage("cost: times of all effects", 0):
        ratios = np.array([_ratio(row, lanes, repeats) for row in rows])
    notes = [row.note or _saved(*counts) for row, counts in zip(rows, operations, strict=True)]

    def column(data: Any, long_name: str, units: str = "1") -> Entry:
        return variable("row", data, long_name, units)

    variables = {
        "what": column([row.what for row in rows], "effect or analysis"),
        "kind": column([row.kind for row in rows], "effect, tangents or analysis"),
        "operations": column(operations[:, 0], "floating-point operations a lane-period with it"),
        "operations_without": column(operations[:, 1], "floating-point operations a lane-period without it"),
        "time_ratio": column(ratios, "processor time with it over that without it, median of pairs"),
        "stored": column([row.stored for row in rows], "bytes that a lane leaves in the result", "byte"),
        "note": column(notes, "note"),
    }
    solver, steps = _solver(batch)
    return xr.Dataset(variables, attrs={"solver": solver.name, "steps_per_period": steps, "repeats": repeats})


def _solver(batch: LaneBatch) -> tuple[Solver, int]:
    """Solver and steps of all comparisons: the batch's own, or another with as many kicks."""
    if isinstance(batch.solver, IsokineticSplitting) and batch.solver.processed:
        other = SPLITTINGS[_STAND_IN]
        return other, other.most_steps(batch.solver.total_kicks(batch.steps))
    return batch.solver, batch.steps


# ---- rows


@singledispatch
def _effects(flow: Flow, batch: LaneBatch) -> Iterator[EffectRow]:
    """A row an effect of the paper's particle; none for a user's system."""
    return iter(())


@_effects.register
def _(flow: IsokineticParticle, batch: LaneBatch) -> Iterator[EffectRow]:
    base = _map(batch, flow)

    def less(effect: str) -> PricedProgram:
        return _map(batch, replace(flow, without=flow.without | {effect}))

    yield _effect("forcing", flow.without, base, less)
    if flow.disturbed and flow.d:
        yield EffectRow("disturbance", "effect", base, less("disturbance"), note=_FREE_OF_COST["disturbance"])
    else:
        yield EffectRow("disturbance", "effect", None, base, note="is left out")
    for name in ("coupling", "cubic_stiffness"):
        yield _effect(name, flow.without, base, less)
    yield EffectRow("damping", "effect", base, less("damping"), note=_FREE_OF_COST["damping"])
    with_it, without_it = (_general(batch, flow, constrained) for constrained in (True, False))
    note = f"by the general route, {dopri8.name} in {_GENERAL_STEPS} steps"
    yield EffectRow("constraint", "effect", with_it, without_it, note=note)


@_effects.register
def _(flow: FreeParticle, batch: LaneBatch) -> Iterator[EffectRow]:
    base = _map(batch, flow)

    def less(effect: str) -> PricedProgram:
        return _map(batch, free_particle(**_numbers(flow), without=flow.without | {effect}))

    yield _effect("forcing", flow.without, base, less)
    yield EffectRow("disturbance", "effect", None, base, note="is left out")
    for name in ("coupling", "cubic_stiffness", "damping"):
        yield _effect(name, flow.without, base, less)
    yield EffectRow("constraint", "effect", None, base, note="is left out")


def _effect(
    what: str, left_out: frozenset[str], base: PricedProgram, less: Callable[[str], PricedProgram]
) -> EffectRow:
    """An effect, where it is not left out already."""
    if what in left_out:
        return EffectRow(what, "effect", None, base, note="is left out")
    return EffectRow(what, "effect", base, less(what))


def _map(batch: LaneBatch, flow: Flow) -> PricedProgram:
    """A period of a flow in time."""
    solver, steps = _solver(batch)
    return map_alone(batch.without_section(), make_return_map(flow, solver, steps))


def _general(batch: LaneBatch, flow: IsokineticParticle, constrained: bool) -> PricedProgram:
    """A period of the same forces by the general route, with the constraint and without it."""
    made = lagrangian(definition(flow.without & frozenset(EFFECTS), constrained), {"b": 0.0, **_numbers(flow)})
    batch = batch.without_section()
    velocity = tuple(np.asarray(v, float) for v in flow.velocity(np.float64(0.0), batch.start))
    still = np.zeros(batch.count)
    start = Motion(batch.start[0], velocity, (still, still))
    return map_alone(replace(batch, start=start), make_return_map(made, dopri8, _GENERAL_STEPS))


def _numbers(flow: Flow) -> dict[str, float]:
    """Parameters of a flow as plain numbers."""
    return {name: float(np.asarray(value)) for name, value in flow.parameters.items()}


@singledispatch
def _most_tangents(flow: Flow, requested: Requested) -> int:
    """Tangents to price: those of the exponents that are asked for, at least one."""
    asked = [options.exponents for _, options in requested if isinstance(options, lyapunov.LyapunovOptions)]
    return min(flow.exponents - int(flow.autonomous), *(asked or [1]))


@_most_tangents.register
def _(flow: IsokineticParticle, requested: Requested) -> int:
    return flow.exponents - int(flow.autonomous)


def _tangents(batch: LaneBatch, most: int) -> Iterator[EffectRow]:
    """A row a tangent: the program with so many against that with one fewer."""
    programs = [lyapunov.program(batch, k) for k in range(most + 1)]
    for k in range(1, most + 1):
        yield EffectRow(f"tangent {k}", "tangents", programs[k], programs[k - 1])


def _analyses(batch: LaneBatch, requested: Requested, lanes: LaneExecutor) -> Iterator[EffectRow]:
    """A row an analysis: its own program, a period, against the map alone, and what it stores."""
    stored = _stored(batch, requested, lanes)
    not_measured = Price(None, map_alone(batch), "not measured")
    for analysis, options in requested:
        cost = analysis.price(options, batch) if analysis.price else not_measured
        yield EffectRow(analysis.name, "analysis", cost.with_it, cost.without_it, stored[analysis.name], cost.note)


def _stored(batch: LaneBatch, requested: Requested, lanes: LaneExecutor) -> dict[str, float]:
    """Bytes a lane of each analysis, by running it on two lanes for as short as it can be."""
    two = replace(batch.take(slice(2)), chosen={lyapunov.ANALYSIS.name: {"parts": 1}})
    done: dict[str, xr.Dataset] = {}
    sizes: dict[str, float] = {}
    for analysis, options in requested:
        if not analysis.independent(options):
            sizes[analysis.name] = 0.0  # of the sweep, not of a lane
            continue
        needs = analysis.options.needs
        needed: tuple[Mapping[str, xr.Dataset], ...] = ({name: done[name] for name in needs},) if needs else ()
        data = analysis.run(options.model_copy(update=dict(analysis.brief)), two, lanes.without_stages(), *needed)
        done[analysis.name] = data
        sizes[analysis.name] = sum(v.nbytes for v in data.variables.values() if v.dims[:1] == (LANE,)) / 2
    return sizes


# ---- measures


def _operations(program: PricedProgram | None, lanes: LaneExecutor) -> float:
    """Floating-point operations a lane-period of the compiled program."""
    if program is None:
        return float("nan")
    text, tile = lanes.program(program.function, program.shared, program.lanes, program.static, program.tile)
    loops = count(text, tile)
    return loops.whole(program.trip_counts) / program.periods if program.whole else loops.total(program.trip_counts)


def _ratio(row: EffectRow, lanes: LaneExecutor, repeats: int) -> float:
    """Time with over time without, the median of pairs, after one run of each to warm up."""
    if row.with_it is None or row.without_it is None:
        return float("nan")
    pair = row.with_it, row.without_it
    periods = []
    for program in pair:
        _seconds(program, lanes, 1)
        periods.append(int(np.clip(_TIMED_SECONDS / _seconds(program, lanes, 1), 1, _MOST_PERIODS)))
    pairs = [[_seconds(p, lanes, n) for p, n in zip(pair, periods, strict=True)] for _ in range(repeats)]
    return float(np.median([with_it / without_it for with_it, without_it in pairs]))


def _seconds(program: PricedProgram, lanes: LaneExecutor, periods: int) -> float:
    """Processor time a period, of so many in one call where the program takes a number, else in as many calls."""
    shared, calls = program.shared, max(1, periods // program.periods)
    if len(shared) > 1 and isinstance(shared[1], np.integer):
        shared, calls = (shared[0], np.int32(periods), *shared[2:]), 1
    began = time.process_time()
    for _ in range(calls):
        lanes(program.function, shared, program.lanes, static=program.static, tile=program.tile)
    seconds = time.process_time() - began
    return seconds / (calls * program.periods if calls > 1 or shared is program.shared else periods)


def _saved(with_it: float, without_it: float) -> str:
    return f"{100 * (1 - without_it / with_it):.1f} % of the operations" if with_it > without_it else ""
