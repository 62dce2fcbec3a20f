"""Bifurcation diagram: strobe points after a transient over thousands of values of a parameter.

Where the attractor depends on where one comes from, the start decides: the same state in every lane, a state carried
along the first axis upward or downward, or random states. Fixed and random starts are lanes side by side; a carried
state is one lane that meets the values in turn: a period then takes what a core waits for each kick, measured 15 times
as long as side by side on one core, and no other core can help.
"""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Int

from jaxnh.analyses.base import LANE, Analysis, OptionError, Setting, Starts
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.options.trajectories import DiagramOptions
from jaxnh.analyses.periodic.attractor_survey import polish_beyond_doublings, survey
from jaxnh.analyses.price import Price, PricedProgram, map_alone
from jaxnh.analyses.section_points import points_at, states_at
from jaxnh.analyses.trajectories.poincare import recording_program, strobe_states
from jaxnh.analyses.trajectories.states import (
    check_outputs,
    check_transient,
    count,
    output_variables,
    section_attrs,
    settle_lanes,
    state_variables,
    statistics,
)
from jaxnh.maps.build import make_return_map
from jaxnh.maps.family import Maps
from jaxnh.maps.iterate import iterate, record
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.section import begin
from jaxnh.maps.single_precision import in_precision
from jaxnh.systems.flow import Parameters
from jaxnh.systems.rows import concatenate, select
from jaxnh.systems.state import State

_CARRIED_AT_ONCE = 32  # values that a call carries a state along at most: the steps of the progress shown
_CARRIED_PERIODS = 1 << 15  # of such a call: some seconds, that a run that is killed may lose
_PRICED = 4, 17  # values and strobes of the program of a carried state that is priced


def periods(options: DiagramOptions, lanes: int) -> float:
    """Return the lane-periods of a run."""
    each = options.transient + options.strobes - 1 + options.phase
    return lanes * each * (options.n_starts if options.start == "random" else 1)


def check(options: DiagramOptions, setting: Setting) -> None:
    """Check that a phase has a period, a carried state a parameter, and that there is one kind of start states."""
    check_transient(options.transient, setting)
    check_outputs(options.outputs or (), setting)
    if options.phase and (setting.autonomous or not setting.flow.continuous):
        raise OptionError("there is no period to have a phase in; leave it out", "phase")
    first = setting.axes[0]
    if options.carried and first.kind == "start":
        message = f"there is nothing to carry along {first.name}, a coordinate of the start state"
        raise OptionError(message + setting.advice, "start")
    for axis in setting.axes if options.start == "random" else ():
        if axis.kind == "start":
            message = f"random starts and the axis {axis.name} of start states exclude each other; leave one out"
            raise OptionError(message, "start")


def run(options: DiagramOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Return states at `strobes` strobes after the transient, (lane, strobe), or (lane, start, strobe) if random.

    With `statistics` those of the strobes take their place, (lane,) or (lane, start).

    With `start: up` or `down` the last state at a value of the first axis is the start state at the next.
    """
    dims = (LANE, "strobe")
    where = f"at {batch.count:,} values of {batch.first_axis.name}" if options.carried else f"of {batch.count:,} lanes"
    label = f"diagram: {options.strobes} strobes {where}, start {options.start}"
    with lanes.stage(label, periods(options, batch.count)):
        if options.start == "random":
            dims = (LANE, "start", "strobe")
            states = _run_side_by_side(options, batch, lanes, *random_starts(options, batch))
            states = jax.tree.map(lambda leaf: leaf.reshape(batch.count, options.n_starts, -1), states)
        elif options.start == "fixed":
            states = _run_side_by_side(options, batch, lanes, *batch.lanes)
        else:
            states = _carry_in_turn(options, batch, lanes)
    t = np.array([options.phase * batch.flow.period])
    attrs = {"start_states": options.start, "strobe_phase": options.phase, **section_attrs(batch)}
    variables = state_variables(batch.system, states, t, dims)
    variables |= output_variables(options.outputs or (), lanes, batch.system, states, batch.p, t, dims)
    return xr.Dataset(statistics(variables) if options.statistics else variables, attrs=attrs)


def random_starts(options: DiagramOptions, batch: LaneBatch) -> tuple[State, Parameters]:
    """Return random states at t = 0 and parameters, (lanes · starts,), the starts of each lane in turn.

    A lane has its states by its place along the first axis, whatever lanes it is computed with.
    """
    first, place = int(batch.places.min()), batch.places
    bits = np.random.PCG64(options.seed)
    d = batch.flow.chart.dimension
    bits.advance(first * options.n_starts * d)  # a draw of 64 bits a number
    shape = int(place.max()) - first + 1, options.n_starts, d
    draws = np.random.Generator(bits).uniform(-1.0, 1.0, shape)[place - first]
    p = {name: np.repeat(values, options.n_starts) for name, values in batch.p.items()}
    states = batch.flow.chart.state((draws.reshape(-1, d) * batch.flow.chart.scales(options.box)).T)
    states = jax.tree.map(np.asarray, jax.vmap(batch.flow.nearest)(states, p))
    return begin(batch.system, states), p


def starts(options: DiagramOptions) -> Starts | None:
    """Return the function that draws random starts, if there are any."""
    if options.start != "random":
        return None
    return lambda batch: (random_starts(options, batch)[0], np.repeat(np.arange(batch.count), options.n_starts))


def _run_side_by_side(
    options: DiagramOptions, batch: LaneBatch, lanes: LaneRunner, start: State, p: Parameters
) -> State:
    """Run a lane for each start state and its parameters: components (lanes, strobes)."""
    state, strobe = _advance_to_phase(options, batch, lanes, start, p)
    state = settle_lanes(lanes, strobe, options.transient, state, p)
    if options.snap_to_period:
        state = _move_to_orbits(replace(batch, start=state, p=p, place=None, axis=None), lanes, options.snap_to_period)
    return strobe_states(lanes, strobe, state, p, options.strobes)


def _move_to_orbits(batch: LaneBatch, lanes: LaneRunner, limit: int) -> State:
    """Replace start states of lanes near a stable orbit, up to a period, by a point of that orbit."""
    orbits = survey(batch, lanes, points_at(batch, lanes, batch.start), limit, "diagram", 0)
    orbits = polish_beyond_doublings(lanes, batch.strobe(), dict(batch.p), orbits)
    on_orbit, states = orbits.period > 0, states_at(batch, lanes, orbits.u)
    return jax.tree.map(lambda orbit, start: np.where(on_orbit, orbit, start), states, batch.start)


def _carry_in_turn(options: DiagramOptions, batch: LaneBatch, lanes: LaneRunner) -> State:
    """Carry the start state along the first axis in one lane: components (lanes, strobes) in the batch's order."""
    values = batch.first_axis.values
    order = np.argsort(values, kind="stable")
    if options.start == "down":
        order = order[::-1]
    if batch.family is not None:
        return _carry_through_flows(options, batch, lanes, order)
    state, strobe = _advance_to_phase(options, batch, lanes, *batch.take(order[:1]).lanes)
    each = options.transient + options.strobes - 1
    at_once = min(_CARRIED_AT_ONCE, max(1, _CARRIED_PERIODS // max(each, 1)))
    met = []
    for first in range(0, len(order), at_once):
        part = order[first : first + at_once]
        padded = np.append(part, np.full(at_once - len(part), part[-1]))
        p = {name: lane_values[None, padded] for name, lane_values in batch.p.items()}
        state, states = lanes(
            carry,
            (strobe, np.int32(options.transient)),
            (state, p),
            periods=len(part) * each,
            tile=1,
            static=(options.strobes,),
        )
        met.append(states)
    return select(concatenate(met, axis=1), (0, np.argsort(order)))


def _carry_through_flows(
    options: DiagramOptions, batch: LaneBatch, lanes: LaneRunner, order: Int[np.ndarray, " lanes"]
) -> State:
    """Carry a state along a parameter that all lanes share: one call for each value, in that order."""
    assert batch.family is not None
    first, met = batch.take(order[:1]), []
    state = first.start
    for value in batch.first_axis.values[order].tolist():
        at_value = first.with_system(batch.family.at((value,)))
        p = at_value.p
        start, strobe = _advance_to_phase(options, at_value, lanes, state, p)
        state = settle_lanes(lanes, strobe, options.transient, state if met else start, p, tile=1)
        met.append(strobe_states(lanes, strobe, state, p, options.strobes, tile=1))
        state = select(met[-1], np.s_[:, -1])
    return select(concatenate(met), np.argsort(order))


def _advance_to_phase(
    options: DiagramOptions, batch: LaneBatch, lanes: LaneRunner, start: State, p: Parameters
) -> tuple[State, Maps]:
    """Advance states from t = 0 to the phase of the strobes, and return the map of a period from there."""
    if not options.phase:
        return start, batch.strobe()
    t, period = options.phase * batch.flow.period, batch.flow.period
    first, strobe = (
        in_precision(
            make_return_map(batch.system, batch.solver, batch.steps, compensated=batch.compensated, span=span),
            batch.precision,
        )
        for span in ((0.0, t), (t, t + period))
    )
    return lanes(iterate, (first, np.int32(1)), (start, p), periods=options.phase), strobe


def carry(strobe: ReturnMap, transient: ArrayLike, state: State, p: Parameters, count: int) -> tuple[State, State]:
    """Carry a state of one lane along parameters (values,); return it and the states (values, count) at each."""

    def at(z: State, p: Parameters) -> tuple[State, State]:
        z = iterate(strobe, transient, z, p)
        following = record(strobe, count - 1, z, p, max(count - 1, 1))
        states = jax.tree.map(lambda first, later: jnp.concatenate([first[None], later])[:count], z, following)
        return jax.tree.map(lambda component: component[-1], states), states

    return lax.scan(at, state, p)


def price(options: DiagramOptions, batch: LaneBatch) -> Price:
    """Return the price of keeping every strobe; a carried state is one lane, against the map of one lane."""
    if not options.carried:
        return Price(recording_program(batch), map_alone(batch), "every strobe is kept")
    strobe, (values, strobes) = batch.map(), _PRICED
    first = batch.take(slice(1))
    p = {name: np.resize(lane_values, (1, values)) for name, lane_values in batch.p.items()}
    program = PricedProgram(
        carry,
        (strobe, np.zeros((), np.int32)),
        (first.start, p),
        (1.0, 0.0, *strobe.trip_counts),
        (strobes,),
        values * (strobes - 1),
        1,
        whole=True,
    )
    return Price(program, map_alone(first, strobe, tile=1), "one lane after the other; every strobe is kept")


ANALYSIS = Analysis(
    "diagram",
    DiagramOptions,
    periods,
    run,
    independent=lambda options: not options.carried,
    numbers=lambda options: 4 * options.strobes * (options.n_starts if options.start == "random" else 1),
    starts=starts,
    count=count,
    check=check,
    price=price,
    brief={"transient": 1},
)
