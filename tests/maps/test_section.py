"""A flow on a section: its coordinates, names, start states and section points."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from measure import UNIT

from jaxnh.maps.section import Crossing, SectionedFlow
from jaxnh.systems.first_order import first_order
from jaxnh.systems.free_particle import free_particle
from jaxnh.systems.particle import constant_speed

FLOWS = {
    "constant speed": constant_speed(c=1.3, b=0.4, without=("forcing",)),
    "free": free_particle(0.5, 0.4, 1.0, ("forcing",)),
}
STARTS = {"x1": np.array([0.1, 0.4, -0.2]), "x2": np.array([0.3, -0.5, 0.0]), "y1": np.array([0.2, -0.3, 0.6])}
sections = pytest.mark.parametrize(("coordinate", "number"), [("x1", 0), ("y1", 1)])
flows = pytest.mark.parametrize("flow", FLOWS.values(), ids=FLOWS)


def states(flow):
    y2 = {} if "y2" not in STARTS and flow is FLOWS["constant speed"] else {"y2": np.array([0.7, 0.1, -0.4])}
    return flow.start({**STARTS, **y2})


@flows
@sections
def test_names(flow, coordinate, number):
    """Those of the flow; the plane is of the first position that the section does not fix."""
    system = SectionedFlow(flow, coordinate, number, 0.0, "up")
    assert system.flow is flow
    assert system.coordinates == flow.coordinates
    assert system.parameters == flow.parameters
    assert [system.words(name) for name in flow.coordinates] == [flow.words(name) for name in flow.coordinates]
    assert system.shares("omega") == flow.shares("omega")
    assert system.plane == (("y1", "y2") if coordinate == "x1" else ("x1", "x2"))
    assert (system.dimension, system.exponents) == (flow.dimension - 1, flow.exponents)
    assert system.section == f"{coordinate} = 0, up"
    assert system.autonomous


def test_a_flow_of_two_coordinates_is_drawn_by_the_one_that_is_left():
    """The other is the same number everywhere on the section."""

    def spring():
        return {"rhs": lambda y, t: (y[1], -y[0]), "coordinates": ("x", "v")}

    flow = first_order(spring, {})
    assert SectionedFlow(flow, "x", 0, 0.0, "up").plane == ("v", "x")
    assert SectionedFlow(flow, "v", 1, 0.0, "up").plane == ("x", "v")


@flows
@sections
def test_points_of_the_section(flow, coordinate, number):
    """A section point and back; of lanes on the host what the chart has of each, whatever the shape."""
    value = 0.25
    system = SectionedFlow(flow, coordinate, number, value, "up")
    u = np.random.default_rng(4).uniform(-1, 1, (6, system.dimension))
    points = jax.vmap(system.unchart)(jnp.asarray(u))
    assert np.array_equal(points.state[0][number], np.full(6, value))
    on_host = jax.tree.map(lambda leaf: np.asarray(leaf).reshape(2, 3), points)
    assert system.section_point(on_host).shape == (2, 3, system.dimension)
    assert np.abs(system.section_point(on_host).reshape(6, -1) - u).max() < 8 * UNIT
    assert np.abs(np.asarray(jax.vmap(system.chart)(points)) - u).max() < 8 * UNIT


@flows
@sections
def test_start_is_on_its_way(flow, coordinate, number):
    """States of the flow at t = 0, with no reason to have failed; their height is what they lack to the section."""
    system = SectionedFlow(flow, coordinate, number, 0.25, "down")
    begun = states(flow)
    crossing = system.start({name: output.data for name, output in flow.outputs(begun, np.zeros(1)).items()})
    assert isinstance(crossing, Crossing)
    assert not np.any(crossing.t)
    assert not np.any(crossing.reason)
    for one, other in zip(jax.tree.leaves(crossing.state), jax.tree.leaves(begun), strict=True):
        assert np.abs(one - other).max() < 4 * UNIT
    np.testing.assert_array_equal(system.height(crossing.state), 0.25 - crossing.state[0][number])
    rate = system.rate(jax.tree.map(jnp.asarray, crossing.state), {})
    velocity = flow.outputs(begun, np.zeros(1))[flow.coordinates[2 * number + 1]].data
    assert np.abs(np.asarray(rate) + velocity).max() < 4 * UNIT


@flows
def test_rates_at_a_crossing(flow):
    """Those of the flow at its state, with the lane's own parameters; time goes on by itself, the reason stays."""
    system = SectionedFlow(flow, "y1", 1, 0.0, "up")
    state = jax.tree.map(lambda leaf: jnp.asarray(leaf)[0], states(flow))
    p, zero = {"a": 0.8, "b": 1.7}, jnp.zeros(())
    crossing = Crossing(state, zero, zero)
    rate = system.rhs(0.0, crossing, p)
    for one, other in zip(jax.tree.leaves(rate.state), jax.tree.leaves(flow.rhs(0.0, state, p)), strict=True):
        assert one == other
    assert (rate.t, rate.reason) == (1.0, 0.0)
    assert system.divergence(0.0, crossing, p) == flow.divergence(0.0, state, p)


PLANES = {"coordinate": ("y1", 1, None), "plane": ("y1", 1, (0.5, -2.0))}


@flows
@pytest.mark.parametrize("plane", PLANES.values(), ids=PLANES)
def test_tangents_of_crossings(flow, plane):
    """A tangent in section coordinates, lifted, is the derivative of `unchart`; lowered, the same numbers again."""
    coordinate, number, normal = plane
    system = SectionedFlow(flow, coordinate, number, 0.25, "up", normal)
    rng = np.random.default_rng(5)
    u, tangent = (jnp.asarray(rng.uniform(-1, 1, system.dimension)) for _ in range(2))
    crossing, moved = jax.jvp(system.unchart, (u,), (tangent,))
    lifted = system.lift(crossing, tuple(tangent))
    for one, other in zip(jax.tree.leaves(lifted), jax.tree.leaves(moved), strict=True):
        assert np.abs(np.asarray(one - other)).max() < 8 * UNIT
    assert np.abs(np.array(system.lower(crossing, lifted)) - np.asarray(tangent)).max() < 8 * UNIT
    chart = jax.jvp(system.chart, (crossing,), (lifted,))[1]
    assert np.abs(np.asarray(chart - tangent)).max() < 8 * UNIT
    assert np.array_equal(np.linalg.matrix_rank(np.array(system.directions(system.dimension))), system.dimension)
