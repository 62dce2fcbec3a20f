"""What every effect of a scene costs, and every analysis: operations of the compiled programs with and without it.

An effect is left out of the scene's own system and nothing else is changed: the same solver, the same steps. Times
are of all processors, which other programs on the machine disturb less than that of the clock: of one program after the
other on the same lanes, with the effect and without it in turns.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxnh.analyses import lyapunov, portrait
from jaxnh.analyses.base import Analysis, Group, LaneRunner, Options, Scene, Variable
from jaxnh.analyses.doubling import SEGMENT_TILE
from jaxnh.analyses.period import ORBIT_TILE
from jaxnh.analyses.poincare import TILE
from jaxnh.costs.operations import count
from jaxnh.costs.stage import Inside
from jaxnh.engine.lanes import Lanes
from jaxnh.maps.build import make_parts, make_strobe
from jaxnh.maps.crossings import EventStrobe, SteppedStrobe
from jaxnh.maps.general_flow import MarchedStrobe
from jaxnh.maps.iterate import derivatives, iterate
from jaxnh.maps.kicks import KickStrobe
from jaxnh.maps.protocol import Strobe
from jaxnh.maps.section import Flow
from jaxnh.maps.single_precision import SingleStrobe
from jaxnh.orbits.shooting import segment
from jaxnh.solvers import SPLITTINGS, IsokineticSplitting, dopri8
from jaxnh.systems.free_particle import FreeParticle, definition, free_particle
from jaxnh.systems.lagrangian import Motion, nonholonomic_system
from jaxnh.systems.particle import IsokineticParticle

_STAND_IN = "blanes_moan6"  # for a processed solver, which a flow without a clock has no use for
_GENERAL_STEPS = 64
_PARTS = 4  # orthonormalisations a period
_PATH_PERIODS = 2
_TIMED_SECONDS = 0.05
_MOST_PERIODS = 64
_LEAST = {"transient": 1, "limit": 1}  # options that change no shape of what is stored
_LEAST_AVERAGED = 16
_FREE_OF_COST = {
    "damping": "free: the multiplier absorbs it, and it is in no equation",
    "disturbance": "free: it is in the table of kicks, which all lanes share",
}


class Program(NamedTuple):
    """A function of lanes, how often its loops turn in a period, outermost first, periods a call, and lanes a tile."""

    function: Callable[..., Any]
    shared: tuple[Any, ...]
    lanes: tuple[Any, ...]
    turns: tuple[float, ...]
    static: tuple[Any, ...] = ()
    periods: int = 1
    tile: int | None = None


class Row(NamedTuple):
    """An effect or analysis, its programs with and without it (none: it has none), bytes a lane, and a note."""

    what: str
    kind: str
    with_it: Program | None
    without_it: Program | None
    stored: float = 0.0
    note: str = ""


def price(scene: Scene, requested: list[tuple[Analysis, Options]], lanes: Lanes, repeats: int) -> Group:
    """A row for every effect of the paper's particle, then one for every number of tangents and every analysis."""
    scene = replace(
        scene, values=scene.values[np.linspace(0, len(scene.values) - 1, _bench(lanes)).round().astype(int)]
    )
    with lanes.stage("cost: programs of all effects", 0):
        rows = [*_effects(scene), *_tangents(scene, _wanted(scene, requested)), *_analyses(scene, requested, lanes)]
        operations = np.array([[_operations(p, lanes) for p in (row.with_it, row.without_it)] for row in rows])
    with lanes.stage("cost: times of all effects", 0):
        ratios = np.array([_ratio(row, lanes, repeats) for row in rows])
    notes = [row.note or _saved(*counts) for row, counts in zip(rows, operations, strict=True)]

    def column(data: Any, long_name: str, units: str = "1") -> Variable:
        return Variable(("row",), np.asarray(data), long_name, units)

    variables = {
        "what": column([row.what for row in rows], "effect or analysis"),
        "kind": column([row.kind for row in rows], "effect, tangents or analysis"),
        "operations": column(operations[:, 0], "floating-point operations a lane-period with it"),
        "operations_without": column(operations[:, 1], "floating-point operations a lane-period without it"),
        "time_ratio": column(ratios, "processor time with it over that without it, median of pairs"),
        "stored": column([row.stored for row in rows], "bytes that a lane leaves in the result", "byte"),
        "note": column(notes, "what there is to say"),
    }
    solver, steps = _solver(scene)
    return Group(variables, {"solver": solver.name, "steps_per_period": steps, "repeats": repeats})


def _bench(lanes: Lanes) -> int:
    """Lanes that fill every device once."""
    return lanes.tile * len(lanes.devices)


def _solver(scene: Scene) -> tuple[Any, int]:
    """Solver and steps of all comparisons: the scene's own, or another with as many kicks."""
    if isinstance(scene.solver, IsokineticSplitting) and scene.solver.processed:
        other = SPLITTINGS[_STAND_IN]
        return other, other.most_steps(scene.solver.total_kicks(scene.steps))
    return scene.solver, scene.steps


# ---- rows


def _effects(scene: Scene) -> Iterator[Row]:
    """A row an effect of the paper's particle; none for a user's system."""
    flow = scene.flow
    if not isinstance(flow, (IsokineticParticle, FreeParticle)):
        return
    base = _map(scene, flow)
    yield _effect("forcing", flow, base, lambda: _map(scene, _less(flow, "forcing")))
    if isinstance(flow, IsokineticParticle) and flow.d:
        yield Row("disturbance", "effect", base, _map(scene, replace(flow, d=0.0)), note=_FREE_OF_COST["disturbance"])
    else:
        yield Row("disturbance", "effect", None, base, note="is left out")
    for name in ("coupling", "cubic_stiffness"):
        yield _effect(name, flow, base, lambda name=name: _map(scene, _less(flow, name)))
    if isinstance(flow, FreeParticle):
        yield _effect("damping", flow, base, lambda: _map(scene, _less(flow, "damping")))
        yield Row("constraint", "effect", None, base, note="is left out")
        return
    yield Row("damping", "effect", base, base, note=_FREE_OF_COST["damping"])
    with_it, without_it = (_general(scene, flow, constrained) for constrained in (True, False))
    note = f"by the general route, {dopri8.name} in {_GENERAL_STEPS} steps"
    yield Row("constraint", "effect", with_it, without_it, note=note)


def _effect(what: str, flow: Any, base: Program, without: Callable[[], Program]) -> Row:
    if what in flow.without:
        return Row(what, "effect", None, base, note="is left out")
    return Row(what, "effect", base, without())


def _less(flow: Any, effect: str) -> Flow:
    """The same flow without one more effect."""
    if isinstance(flow, IsokineticParticle):
        return replace(flow, without=flow.without | {effect})
    p = flow.parameters
    return free_particle(p["a"], p["b"], p["omega"], flow.swept, flow.without | {effect})


def _map(scene: Scene, flow: Flow) -> Program:
    """A period of a flow in time."""
    solver, steps = _solver(scene)
    return _iterates(make_strobe(flow, solver, steps), scene.in_time().start, scene.values)


def _iterates(strobe: Strobe, start: Any, values: np.ndarray) -> Program:
    state = jax.tree.map(lambda leaf: np.full(len(values), leaf, float), start)
    return Program(iterate, (strobe, np.int32(1)), (state, values), (1.0, *_turns(strobe)))


def _general(scene: Scene, flow: IsokineticParticle, constrained: bool) -> Program:
    """A period of the same forces by the general route, with the constraint and without it."""
    parameters = {"a": flow.a, "b": 0.0 if flow.b is None else flow.b, "c": flow.c, "d": flow.d, "omega": flow.omega}
    made = nonholonomic_system(definition(flow.without, constrained), parameters, flow.swept)
    start = scene.in_time().start
    velocity = [float(v) for v in flow.velocity(np.float64(0.0), start)]
    strobe = make_strobe(made, dopri8, _GENERAL_STEPS)
    return _iterates(strobe, Motion(start[0], tuple(velocity), (0.0, 0.0)), scene.values)


def _wanted(scene: Scene, requested: list[tuple[Analysis, Options]]) -> int:
    """Tangents to price: all of a particle at a prescribed speed, else those of the exponents that are asked for."""
    most = scene.flow.exponents - int(scene.flow.autonomous)
    if isinstance(scene.flow, IsokineticParticle):
        return most
    asked = [getattr(options, "exponents", 1) for analysis, options in requested if analysis.name == "lyapunov"]
    return min(most, *(asked or [1]))


def _tangents(scene: Scene, most: int) -> Iterator[Row]:
    """A row a tangent: the program with so many against that with one fewer."""
    scene = scene.in_time()
    before = _iterates(scene.strobe(), scene.start, scene.values)
    state = jax.tree.map(jnp.asarray, before.lanes[0])
    parts = lyapunov.parts_of(scene, _PARTS)
    for k in range(1, most + 1):
        begun = jax.vmap(lambda z, k=k: lyapunov.begin(scene.flow, z, k))(state)
        lanes = jax.tree.map(np.asarray, begun), scene.values
        shared = (parts, np.int32(1), np.float64(0.0))
        now = Program(lyapunov.advance, shared, lanes, (1.0, float(_PARTS), *_turns(parts)))
        yield Row(f"tangent {k}", "tangents", now, before)
        before = now


def _analyses(scene: Scene, requested: list[tuple[Analysis, Options]], lanes: LaneRunner) -> Iterator[Row]:
    """A row an analysis: its program of a period against the map alone, and what it stores."""
    stored = _stored(scene, requested, lanes)
    alone = _iterates(scene.strobe(), scene.start, scene.values)
    in_time = _iterates(scene.in_time().strobe(), scene.in_time().start, scene.values)
    for analysis, options in requested:
        program, without, note = alone, alone, "the map alone, in every period"
        u = np.broadcast_to(scene.system.section_point(scene.start), (len(scene.values), scene.system.dimension))
        if analysis.name == "lyapunov":
            k = min(getattr(options, "exponents", 1), scene.flow.exponents - int(scene.flow.autonomous))
            program, without, note = (
                list(_tangents(scene, k))[k - 1].with_it,
                in_time,
                f"{k} tangent{'s' if k > 1 else ''}",
            )
        elif analysis.name == "period":
            shared = (scene.strobe(), np.int32(1))
            program = Program(derivatives, shared, (u, scene.values), (1.0, *_turns(shared[0])), tile=ORBIT_TILE)
            without = alone._replace(tile=ORBIT_TILE)
            note = f"{scene.system.dimension + 1} tangents in every period of Newton, the map alone before it"
        elif analysis.name == "doubling":
            map_ = scene.strobe()
            lanes_of = (u, np.ones_like(u), scene.values)
            program = Program(segment, (map_,), lanes_of, _turns(map_), tile=SEGMENT_TILE)
            without = alone._replace(tile=SEGMENT_TILE)
            note = "second derivatives in every period of Newton at a doubling, the map alone before it"
        elif analysis.name == "portrait":
            program, without = _portrait(scene, options), in_time._replace(tile=TILE)
            note = "every sample ends a step, and is kept"
        elif analysis.name == "verdict":
            program, note = None, "from what the others have found"
        yield Row(analysis.name, "analysis", program, without, stored[analysis.name], note)


def _portrait(scene: Scene, options: Any) -> Program:
    """A period of the trajectory that a portrait keeps."""
    scene = scene.in_time()
    parts = make_parts(scene.flow, scene.solver, scene.steps, options.samples, compensated=scene.compensated)
    state = jax.tree.map(lambda leaf: np.full(len(scene.values), leaf, float), scene.start)
    turns = (1.0, float(options.samples), *_turns(parts))
    shared = (scene.strobe(), parts, np.int32(0))
    lanes = state, scene.values
    return Program(portrait.trajectory, shared, lanes, turns, (_PATH_PERIODS,), _PATH_PERIODS, TILE)


def _stored(scene: Scene, requested: list[tuple[Analysis, Options]], lanes: LaneRunner) -> dict[str, float]:
    """Bytes a lane of each analysis, by running it on two lanes for as short as it can be."""
    two = replace(scene, values=scene.values[:2], chosen={"lyapunov": {"parts": 1}})
    groups: dict[str, Group] = {}
    found: dict[str, float] = {}
    for analysis, options in requested:
        least = {name: value for name, value in _LEAST.items() if name in type(options).model_fields}
        least |= {"periods": _LEAST_AVERAGED} if analysis.name == "lyapunov" else {}
        if not analysis.splits(options):
            found[analysis.name] = 0.0  # of the sweep, not of a lane
            continue
        needed: tuple[Mapping[str, Group], ...] = ({n: groups[n] for n in analysis.needs},) if analysis.needs else ()
        groups[analysis.name] = group = analysis.run(options.model_copy(update=least), two, Inside(lanes), *needed)
        variables = [v.data for name, v in group.variables.items() if v.dims[:1] == ("b",) and name != "b"]
        found[analysis.name] = sum(data.nbytes for data in variables) / 2
    return found


def _turns(strobe: Strobe) -> tuple[float, ...]:
    """How often the loops of a map turn in a period, outermost first; of stacked maps their mean."""
    match strobe:
        case KickStrobe():
            return (float(np.mean(strobe.kicks)),)
        case SteppedStrobe():
            return (float(np.mean(strobe.steps)), *_turns(strobe.one))
        case EventStrobe():
            return (strobe.system.period / float(np.mean(strobe.step)), *_turns(strobe.unit))
        case MarchedStrobe():
            return (float(np.mean(strobe.steps)), float(strobe.solver.stages))
        case SingleStrobe():
            return _turns(strobe.inner)
        case _:
            return (float(np.shape(strobe.grid)[-1] - 1),)  # pyright: ignore[reportAttributeAccessIssue]


# ---- measures


def _operations(program: Program | None, lanes: Lanes) -> float:
    """Floating-point operations a lane-period of the compiled program."""
    if program is None:
        return float("nan")
    text, tile = lanes.program(program.function, program.shared, program.lanes, program.static, program.tile)
    return count(text, tile).total(program.turns)


def _ratio(row: Row, lanes: Lanes, repeats: int) -> float:
    """Time with over time without, the median of pairs, after one run of each to warm up."""
    if row.with_it is None or row.without_it is None:
        return float("nan")
    if row.with_it is row.without_it:
        return 1.0
    pair = row.with_it, row.without_it
    periods = []
    for program in pair:
        _seconds(program, lanes, 1)
        periods.append(int(np.clip(_TIMED_SECONDS / _seconds(program, lanes, 1), 1, _MOST_PERIODS)))
    pairs = [[_seconds(p, lanes, n) for p, n in zip(pair, periods, strict=True)] for _ in range(repeats)]
    return float(np.median([with_it / without_it for with_it, without_it in pairs]))


def _seconds(program: Program, lanes: Lanes, periods: int) -> float:
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
