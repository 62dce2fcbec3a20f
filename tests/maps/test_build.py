"""Maps over a part of the period, and of a period cut into parts; and which flows go which way."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import pytest

from jaxnh.maps.build import cut_strobe, make_return_map
from jaxnh.mechanics import ellipsoid, rolling_body
from jaxnh.solvers import SOLVERS, SPLITTINGS, tsit5
from jaxnh.solvers.adaptive import in_loop
from jaxnh.systems.lagrangian import lagrangian
from jaxnh.systems.particle import CHART
from tests.flows.calm_particle import CALM, CALM_B, CALM_STATES, ROUNDOFF, one_lane
from tests.flows.particle import twin
from tests.helpers import taylor
from tests.helpers.measurement import largest_difference


@pytest.mark.parametrize("name", ["blanes_moan6", "processed6"])
def test_map_over_a_part_of_the_period(name):
    """From 0 to t and from t to the end is the whole period, up to the error of the method at either number of steps."""
    system, solver = CALM["disturbed"], SPLITTINGS[name]
    state, p = one_lane()
    exact = taylor.strobe(twin(system), CALM_B[0], CALM_STATES[0])[0]
    errors = []
    for steps in (50, 100):
        first, second = (
            make_return_map(system, solver, steps, span=span) for span in ((0.0, 2.0), (2.0, system.period))
        )
        errors.append(largest_difference(CHART.point(second(first(state, p), p)), exact))
    assert errors[1] < errors[0] * 2.0 ** (1 - solver.convergence_order) < 1e-6


@pytest.mark.parametrize("name", ["blanes_moan6", "processed6", "tsit5"])
def test_map_cut_into_parts(name):
    """Seven parts, one after the other, are the map of the next number of steps that seven divides."""
    system, solver = CALM["disturbed"], SOLVERS[name]
    parts = cut_strobe(system, solver, 93, 7)
    state, p = one_lane()
    end, _ = jax.lax.scan(lambda state, part: (part(state, p), None), state, parts)
    assert largest_difference(CHART.point(end), CHART.point(make_return_map(system, solver, 98)(state, p))) < ROUNDOFF


@pytest.mark.parametrize("solver", [tsit5, in_loop(tsit5)], ids=["written out", "loop"])
def test_loops_of_stacked_maps_of_quasi_velocities(solver):
    """They are those of one of the maps, whose parameters have the parts as an axis in the stack."""

    def ball(radius=1.0, tilt=0.5):
        surface = ellipsoid((radius, radius, radius), center=(0.0, 0.3 * jnp.sin(tilt), 0.3 * jnp.cos(tilt)))
        return rolling_body(surface, 1.0, ((0.22, 0.0, 0.0), (0.0, 0.67, 0.0), (0.0, 0.0, 0.78)), 1.0)

    stack = cut_strobe(lagrangian(ball, {"radius": 1.0, "tilt": 0.5}, ("tilt",)), solver, 40, 4)
    assert stack.trip_counts == ((10.0, float(solver.stages)) if solver.rolled else (10.0,))
