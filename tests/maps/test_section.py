"""A flow on a section: its coordinates, names, start states and section points."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.maps.section import Crossing, Section, begin, outputs, plot_plane, rates
from jaxnh.systems.first_order import first_order
from jaxnh.systems.free_particle import free_particle
from jaxnh.systems.particle import constant_speed
from tests.helpers.measurement import UNIT

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
    """It says which flow it is of and where; the plane is of the first position that the section does not fix."""
    system = Section(flow, coordinate, number, 0.0, "up")
    assert system.flow is flow
    assert plot_plane(system) == (("y1", "y2") if coordinate == "x1" else ("x1", "x2"))
    assert plot_plane(flow) == ("x1", "x2")
    assert system.chart.dimension == flow.chart.dimension - 1
    assert system.description == f"{coordinate} = 0, up"


def test_a_flow_of_two_coordinates_is_drawn_by_the_one_that_is_left():
    """The other is the same number everywhere on the section."""

    def spring():
        return {"rhs": lambda y, t: (y[1], -y[0]), "coordinates": ("x", "v")}

    flow = first_order(spring, {})
    assert plot_plane(Section(flow, "x", 0, 0.0, "up")) == ("v", "x")
    assert plot_plane(Section(flow, "v", 1, 0.0, "up")) == ("x", "v")


@flows
@sections
def test_points_of_the_section(flow, coordinate, number):
    """A section point and back; of lanes on the host what the chart has of each, whatever the shape."""
    value = 0.25
    system = Section(flow, coordinate, number, value, "up")
    u = np.random.default_rng(4).uniform(-1, 1, (6, system.chart.dimension))
    points = jax.vmap(system.chart.state)(jnp.asarray(u))
    assert np.array_equal(points.state[0][number], np.full(6, value))
    on_host = jax.tree.map(lambda leaf: np.asarray(leaf).reshape(2, 3), points)
    assert system.chart.host_points(on_host).shape == (2, 3, system.chart.dimension)
    assert np.abs(system.chart.host_points(on_host).reshape(6, -1) - u).max() < 8 * UNIT
    assert np.abs(np.asarray(jax.vmap(system.chart.point)(points)) - u).max() < 8 * UNIT


@flows
@sections
def test_start_is_on_its_way(flow, coordinate, number):
    """States of the flow at t = 0, with no reason to have failed; their height is what they lack to the section."""
    system = Section(flow, coordinate, number, 0.25, "down")
    begun = states(flow)
    coordinates = {name: output.data for name, output in outputs(flow, begun, np.zeros(1)).items()}
    crossing = begin(system, flow.start(coordinates))
    assert isinstance(crossing, Crossing)
    assert not np.any(crossing.t)
    assert not np.any(crossing.reason)
    for one, other in zip(jax.tree.leaves(crossing.state), jax.tree.leaves(begun), strict=True):
        assert np.abs(one - other).max() < 4 * UNIT
    np.testing.assert_array_equal(system.height(crossing.state), 0.25 - crossing.state[0][number])
    rate = system.rate(jax.tree.map(jnp.asarray, crossing.state), {})
    velocity = flow.readout.coordinates(begun, np.zeros(1))[flow.coordinates[2 * number + 1]].data
    assert np.abs(np.asarray(rate) + velocity).max() < 4 * UNIT


@flows
def test_rates_at_a_crossing(flow):
    """Those of the flow at its state, with the lane's own parameters, in section coordinates."""
    system = Section(flow, "y1", 1, 0.0, "up")
    state = jax.tree.map(lambda leaf: jnp.asarray(leaf)[0], states(flow))
    p, zero = {"a": 0.8, "b": 1.7}, jnp.zeros(())
    crossing = Crossing(state, zero, zero)
    whole = rates(flow, state, p)
    assert whole == flow.chart.lower(state, flow.rhs(0.0, state, p))
    assert rates(system, crossing, p) == (whole[0], *whole[2:])


PLANES = {"coordinate": ("y1", 1, None), "plane": ("y1", 1, (0.5, -2.0))}


@flows
@pytest.mark.parametrize("plane", PLANES.values(), ids=PLANES)
def test_tangents_of_crossings(flow, plane):
    """A tangent in section coordinates, lifted, is the derivative of `state`; lowered, the same numbers again."""
    coordinate, number, normal = plane
    system = Section(flow, coordinate, number, 0.25, "up", normal)
    rng = np.random.default_rng(5)
    u, tangent = (jnp.asarray(rng.uniform(-1, 1, system.chart.dimension)) for _ in range(2))
    crossing, moved = jax.jvp(system.chart.state, (u,), (tangent,))
    lifted = system.chart.lift(crossing, tuple(tangent))
    for one, other in zip(jax.tree.leaves(lifted), jax.tree.leaves(moved), strict=True):
        assert np.abs(np.asarray(one - other)).max() < 8 * UNIT
    assert np.abs(np.array(system.chart.lower(crossing, lifted)) - np.asarray(tangent)).max() < 8 * UNIT
    point = jax.jvp(system.chart.point, (crossing,), (lifted,))[1]
    assert np.abs(np.asarray(point - tangent)).max() < 8 * UNIT
    assert np.array_equal(
        np.linalg.matrix_rank(np.array(system.chart.directions(system.chart.dimension))), system.chart.dimension
    )
