"""Phase portraits: trajectories after a transient, sampled many times a period, for every b."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from jax import lax
from pydantic import Field

from jaxnh.analyses.base import Group, LaneRunner, Options, Scene, Variable
from jaxnh.analyses.poincare import TILE, coupling, spread, state_variables
from jaxnh.maps.build import make_parts
from jaxnh.maps.iterate import iterate
from jaxnh.maps.protocol import Strobe, swept_name
from jaxnh.maps.single_precision import in_precision
from jaxnh.systems.particle import State


class PortraitOptions(Options):
    """Options of `portrait`."""

    transient: int = Field(default=512, ge=0, description="Periods before the first sample; 0: it is the start state")
    periods: int = Field(default=16, ge=1, description="Length of the trajectory, in periods")
    samples: int = Field(default=256, ge=1, le=65536, description="Samples a period, evenly spaced in time")


def periods(options: PortraitOptions, lanes: int) -> float:
    """Lane-periods of a run."""
    return float(lanes * (options.transient + options.periods))


def numbers(options: PortraitOptions) -> int:
    """Numbers that a lane leaves."""
    return 4 * options.periods * options.samples


def run(options: PortraitOptions, scene: Scene, lanes: LaneRunner) -> Group:
    """Trajectories of `periods` periods after the transient, from the start state, dimensions (b, time)."""
    scene = scene.in_time()
    count = len(scene.values)
    total = periods(options, count)
    parts = in_precision(
        make_parts(scene.flow, scene.solver, scene.steps, options.samples, compensated=scene.compensated),
        scene.precision,
    )
    with lanes.stage(f"portrait: {options.periods} periods at {count:,} values of {swept_name(scene.system)}", total):
        states = lanes(
            trajectory,
            (scene.strobe(), parts, np.int32(options.transient)),
            (spread(scene.start, count), scene.values),
            periods=total / count,
            tile=TILE,
            static=(options.periods,),
        )
    in_period = scene.system.period * np.arange(options.samples) / options.samples
    elapsed = np.arange(options.periods * options.samples) / options.samples
    variables = {
        "b": coupling(scene),
        "t": Variable(("time",), scene.system.period * (options.transient + elapsed), "time since the start"),
        **state_variables(scene.system, states, in_period, ("b", "time"), {"coordinates": "t"}),
    }
    return Group(variables)


def trajectory(strobe: Strobe, parts: Strobe, transient: Any, state: State, b: Any, count: int) -> State:
    """Of one lane: states (count · samples,) over `count` periods after a transient, which may be traced.

    `parts` are the maps over the parts of a period, stacked (`strobe.make_parts`).
    """

    def sample(z: State, part: Strobe) -> tuple[State, State]:
        return part(z, b), z

    def period(z: State, _: None) -> tuple[State, State]:
        return lax.scan(sample, z, parts)

    _, path = lax.scan(period, iterate(strobe, transient, state, b), length=count)
    return jax.tree.map(lambda component: component.reshape(-1), path)
