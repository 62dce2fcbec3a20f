"""Bifurcation diagram: strobe points after a transient over thousands of b.

Where the attractor depends on where one comes from, the start decides: the same state at every b, a state carried along
b upward or downward, or random states. Fixed and random starts are lanes side by side; a carried state is one lane that
meets the values of b in turn: a period then takes what a core waits for each kick, measured 15 times as long as side by
side on one core, and no other core can help.
"""

from __future__ import annotations

from typing import Any, Literal

import jax
import numpy as np
from jax import lax
from pydantic import Field, model_validator

from jaxnh.analyses.base import Group, LaneRunner, Options, Scene
from jaxnh.analyses.poincare import coupling, section_attrs, spread, state_variables, strobe_states
from jaxnh.config.messages import rule
from jaxnh.maps.build import make_strobe
from jaxnh.maps.iterate import iterate
from jaxnh.maps.protocol import Strobe, swept_name
from jaxnh.maps.single_precision import in_precision
from jaxnh.systems.particle import State

_CARRIED_AT_ONCE = 32  # values of b that a call carries a state along: the steps of the progress shown
_FOR_RANDOM = ("starts", "seed", "box")


class DiagramOptions(Options):
    """Options of `diagram`."""

    transient: int = Field(default=512, ge=0, description="Periods before the first strobe; 0: it is the start state")
    strobes: int = Field(default=128, ge=1, description="Number of strobes kept, one period apart")
    start: Literal["fixed", "up", "down", "random"] = Field(
        default="fixed",
        description="Start state: the same at every b, carried along rising or falling b, or random ones at every b",
    )
    phase: float = Field(default=0.0, ge=0.0, lt=1.0, description="When in a period to strobe, as a fraction of it")
    starts: int = Field(default=16, ge=1, description="Number of random start states at every b")
    seed: int = Field(default=0, ge=0, description="Seed of the random start states")
    box: float = Field(
        default=4.0, gt=0, description="Random starts have x1 and y1 in [-box, box] and any direction, evenly"
    )

    @model_validator(mode="after")
    def _check(self) -> DiagramOptions:
        for name in _FOR_RANDOM:
            if self.start != "random" and name in self.model_fields_set:
                raise rule(f"{name} goes with start: random, and start is {self.start}", name, "start")
        return self


def periods(options: DiagramOptions, lanes: int) -> float:
    """Lane-periods of a run."""
    each = options.transient + options.strobes - 1 + options.phase
    return lanes * each * (options.starts if options.start == "random" else 1)


def splits(options: DiagramOptions) -> bool:
    """Whether lanes know nothing of each other: a state carried along b knows where it comes from."""
    return options.start in ("fixed", "random")


def numbers(options: DiagramOptions) -> int:
    """Numbers that a lane leaves."""
    return 4 * options.strobes * (options.starts if options.start == "random" else 1)


def run(options: DiagramOptions, scene: Scene, lanes: LaneRunner) -> Group:
    """States at `strobes` strobes after the transient, dimensions (b, strobe), or (b, start, strobe) if random.

    With `start: up` or `down` the last state at a value of b is the start state at the next.
    """
    count = len(scene.values)
    label = (
        f"diagram: {options.strobes} strobes at {count:,} values of {swept_name(scene.system)}, start {options.start}"
    )
    dims = ("b", "strobe")
    with lanes.stage(label, periods(options, count)):
        if options.start == "random":
            dims = ("b", "start", "strobe")
            b = np.repeat(scene.values, options.starts)
            states = _side_by_side(options, scene, lanes, random_starts(options, scene, b), b)
            states = jax.tree.map(lambda component: component.reshape(count, options.starts, -1), states)
        elif options.start == "fixed":
            states = _side_by_side(options, scene, lanes, spread(scene.start, count), scene.values)
        else:
            states = _in_turn(options, scene, lanes)
    t = np.array([options.phase * scene.system.period])
    variables = {"b": coupling(scene), **state_variables(scene.system, states, t, dims)}
    return Group(variables, {"start": options.start, "phase": options.phase, **section_attrs(scene)})


def random_starts(options: DiagramOptions, scene: Scene, b: np.ndarray) -> Any:
    """Random states at t = 0, components (lanes,), for lanes with these b, so many starts at each value of the scene.

    A value of b has its states by its place in the sweep, however many values are asked for at once.
    """
    bits = np.random.PCG64(options.seed)
    d = scene.flow.dimension
    bits.advance(scene.first * options.starts * d)  # a draw of 64 bits a number
    draws = np.random.Generator(bits).uniform(-1.0, 1.0, (len(b), d))
    return scene.system.random_states(draws, options.box, b)


def _side_by_side(options: DiagramOptions, scene: Scene, lanes: LaneRunner, start: State, b: np.ndarray) -> State:
    """A lane for each start state and b: components (lanes, strobes)."""
    state, strobe = _at_phase(options, scene, lanes, start, b)
    return lanes(
        strobe_states,
        (strobe, np.int32(options.transient)),
        (state, b),
        periods=options.transient + options.strobes - 1,
        static=(options.strobes,),
    )


def _in_turn(options: DiagramOptions, scene: Scene, lanes: LaneRunner) -> State:
    """The start state carried along b, up or down, in one lane: components (b, strobes) in the order of the sweep."""
    order = np.argsort(scene.values, kind="stable")
    if options.start == "down":
        order = order[::-1]
    b = scene.values[order]
    state, strobe = _at_phase(options, scene, lanes, spread(scene.start, 1), b[:1])
    met = []
    for first in range(0, len(b), _CARRIED_AT_ONCE):
        part = b[first : first + _CARRIED_AT_ONCE]
        padded = np.append(part, np.full(_CARRIED_AT_ONCE - len(part), part[-1]))
        state, states = lanes(
            carried,
            (strobe, np.int32(options.transient)),
            (state, padded[None]),
            periods=len(part) * (options.transient + options.strobes - 1),
            tile=1,
            static=(options.strobes,),
        )
        met.append(states)
    back = np.argsort(order)
    return jax.tree.map(lambda *components: np.concatenate(components, axis=1)[0, back], *met)


def _at_phase(
    options: DiagramOptions, scene: Scene, lanes: LaneRunner, start: State, b: np.ndarray
) -> tuple[State, Strobe]:
    """States at t = 0 brought to the phase of the strobes, and the map of a period from there."""
    if not options.phase:
        return start, scene.strobe()
    t, period = options.phase * scene.system.period, scene.system.period
    first, strobe = (
        in_precision(
            make_strobe(scene.system, scene.solver, scene.steps, compensated=scene.compensated, span=span),
            scene.precision,
        )
        for span in ((0.0, t), (t, t + period))
    )
    return lanes(iterate, (first, np.int32(1)), (start, b), periods=options.phase), strobe


def carried(strobe: Strobe, transient: Any, state: State, b: Any, count: int) -> tuple[State, State]:
    """Of one lane: a state carried along b (values,), and the states (values, count) met at each after a transient."""

    def at(z: State, b: Any) -> tuple[State, State]:
        states = strobe_states(strobe, transient, z, b, count)
        return jax.tree.map(lambda component: component[-1], states), states

    return lax.scan(at, state, b)
