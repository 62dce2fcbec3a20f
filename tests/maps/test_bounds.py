"""Maps of states in a box: the map as it is there, none beyond, and what a motion on its way to infinity takes."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.maps.bounds import BoundedMap
from jaxnh.maps.build import make_return_map
from jaxnh.maps.general_flow import Moving
from jaxnh.maps.protocol import Tangent
from jaxnh.solvers import SOLVERS
from jaxnh.systems.first_order import first_order
from jaxnh.systems.state import status_in_nan
from jaxnh.systems.status import STATUS
from tests.helpers.one_lane import compiled_iterate

pytestmark = pytest.mark.usefixtures("quick_compiling")


def damped():
    """z′ = z, y′ = −z² y, from z to e z in a unit of time, while y falls by exp(−z² (e² − 1)/2): ever faster decay."""

    def rhs(state, time):
        y, z = state
        return -z * z * y, z

    return {"rhs": rhs, "coordinates": ("y", "z"), "time_unit": 1.0}


def turning():
    """An angle at a speed of one."""
    return {
        "rhs": lambda state, time: (1.0 + 0.0 * state[0],),
        "coordinates": ("y",),
        "angles": ("y",),
        "time_unit": 1.0,
    }


def bounded(reach):
    flow = first_order(damped, {})
    inner = make_return_map(flow, SOLVERS["adaptive_tsit5"], 40)
    return inner, BoundedMap(flow, inner, np.zeros(2), np.full(2, reach))


def state_at(inner, *u):
    return inner.chart.state(jnp.array(u))


def test_the_map_in_the_box():
    """Bit for bit that of the map, with its tangents."""
    inner, within = bounded(2.0)
    state = state_at(inner, 2.0, 1.0)
    image = compiled_iterate(within, 1, state, {})
    assert jax.tree.leaves(image) == jax.tree.leaves(compiled_iterate(inner, 1, state, {}))
    exact = 2.0 * np.exp(-0.5 * (np.exp(2.0) - 1.0)), np.e
    assert np.allclose(jax.tree.leaves(image), exact, rtol=1e-5)  # steps err by 1e-7 of y at its largest
    one = (Tangent(state_at(inner, 1.0, 1.0)),)
    pushed, same = (jax.jit(lambda y, each=each: each.pushforward(y, {}, one))(state) for each in (within, inner))
    assert jax.tree.leaves(pushed) == jax.tree.leaves(same)
    assert within.trip_counts == inner.trip_counts
    assert within.most_lanes == inner.most_lanes


def test_no_image_beyond():
    """Not a number, with the status, at the cost of a few steps where the map takes tens of thousands."""
    inner, within = bounded(2.0)
    far = state_at(inner, 1.0, -300.0)
    image = np.array(jax.tree.leaves(compiled_iterate(within, 1, far, {})))
    assert [STATUS[number] for number in status_in_nan(image)] == ["escaped", "escaped"]
    trials = jax.jit(lambda state: inner._marched(Moving(state), inner._along({}, ())[0])[1].trials)
    assert int(trials(far)) > 10_000
    assert int(trials(within._within(far))) < 100


def test_an_angle_is_in_the_box_wherever_it_is():
    """As many turns as there are."""
    flow = first_order(turning, {})
    inner = make_return_map(flow, SOLVERS["tsit5"], 4)
    within = BoundedMap(flow, inner, np.zeros(1), np.ones(1))
    (image,) = jax.tree.leaves(compiled_iterate(within, 3, state_at(inner, 50.0), {}))
    assert np.isclose(image, 53.0, rtol=1e-12)
