"""Poincaré map: the states at successive strobes after a transient, for every b.

Without a clock these are successive crossings of the section, and transients are counted in crossings as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import Field

from jaxnh.analyses.base import Group, LaneRunner, Options, Scene, Variable
from jaxnh.maps.iterate import iterate, record
from jaxnh.maps.protocol import Strobe, System, swept_name
from jaxnh.maps.section import SectionedFlow
from jaxnh.systems.particle import State

TILE = 16
"""Lanes a tile: few values of b are looked at for long, and small tiles take a period sooner."""


class PoincareOptions(Options):
    """Options of `poincare`."""

    transient: int = Field(default=512, ge=0, description="Periods before the first strobe; 0: it is the start state")
    strobes: int = Field(default=1024, ge=1, description="Number of strobes kept, one period apart")


def periods(options: PoincareOptions, lanes: int) -> float:
    """Lane-periods of a run."""
    return float(lanes * (options.transient + options.strobes - 1))


def numbers(options: PoincareOptions) -> int:
    """Numbers that a lane leaves."""
    return 4 * options.strobes


def run(options: PoincareOptions, scene: Scene, lanes: LaneRunner) -> Group:
    """States at `strobes` strobes after the transient, from the start state, dimensions (b, strobe)."""
    count = len(scene.values)
    start = spread(scene.start, count)
    total = periods(options, count)
    with lanes.stage(f"poincare: {options.strobes} strobes at {count:,} values of {swept_name(scene.system)}", total):
        states = lanes(
            strobe_states,
            (scene.strobe(), np.int32(options.transient)),
            (start, scene.values),
            periods=total / count,
            tile=TILE,
            static=(options.strobes,),
        )
    variables = {"b": coupling(scene)}
    if not isinstance(scene.system, SectionedFlow):  # else every crossing has its own
        time = scene.system.period * (options.transient + np.arange(options.strobes))
        variables["t"] = Variable(("strobe",), time, "time since the start")
    variables |= state_variables(scene.system, states, np.zeros(1), ("b", "strobe"), {"coordinates": "t"})
    return Group(variables, section_attrs(scene))


def strobe_states(strobe: Strobe, transient: Any, state: State, b: Any, count: int) -> State:
    """Of one lane: states (count,) after `transient` periods and each one after; `transient` may be traced."""
    first = iterate(strobe, transient, state, b)
    _, following = record(strobe, first, b, count - 1)
    return jax.tree.map(lambda z, later: jnp.concatenate([z[None], later]), first, following)


def spread(start: State, lanes: int) -> State:
    """A start state of floats as lanes, components of shape (lanes,)."""
    return jax.tree.map(lambda component: np.full(lanes, component, float), start)


def coupling(scene: Scene) -> Variable:
    """The swept values as the coordinate b."""
    return Variable(("b",), scene.values, scene.system.sweeps)


def section_attrs(scene: Scene) -> dict[str, str]:
    """Attributes of a group of crossings: what they are crossings of."""
    system = scene.system
    if not isinstance(system, SectionedFlow):
        return {}
    return {"section": system.words, "section_coordinate": system.coordinate}


def state_variables(
    system: System, states: Any, t: np.ndarray, dims: tuple[str, ...], attrs: dict[str, Any] | None = None
) -> dict[str, Variable]:
    """Coordinates and velocities of states, and what the system has to report of each trajectory.

    Args:
        states: components of the shape that the dimensions have.
        t: times of the states within a period, repeated along the last dimension.
        dims: names of the dimensions.
        attrs: attributes of each variable.
    """
    named = {
        name: Variable(dims, data, words, attrs=attrs if attrs and name != "t" else {})
        for name, (data, words) in system.outputs(states, t).items()
    }
    reports = {
        name: Variable(dims[:-1], data, words, attrs=flags)
        for name, (data, words, flags) in system.reports(states).items()
    }
    return named | reports


def count(variables: Mapping[str, Variable]) -> dict[str, int]:
    """How many trajectories there are, and how many have left the numbers: they are not finite from there on."""
    paths = [v.data for v in variables.values() if len(v.dims) > 1 and v.dims[-1] in ("strobe", "time")]
    finite = np.all([np.isfinite(path[..., -1]) for path in paths], axis=0)
    return {"trajectories": finite.size, "not_finite": int(np.count_nonzero(~finite))}
