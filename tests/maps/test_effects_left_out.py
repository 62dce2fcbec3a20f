"""Maps of the particle with effects left out: by another method, over a, and without a forcing in any table."""

from __future__ import annotations

import math

import numpy as np
import pytest

from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import derivatives, iterate
from jaxnh.solvers import dopri8
from jaxnh.systems.free_particle import definition
from jaxnh.systems.lagrangian import Motion, lagrangian
from jaxnh.systems.particle import disturbed_speed
from tests.flows.unforced_particle import ANGLE, SPLITTING, START, P, particle_without, spread


def test_tables_have_no_forcing_that_is_left_out():
    """Without forcing a disturbed speed has a clock and kicks of two numbers; a constant one has neither."""
    still = disturbed_speed(without=("forcing",), omega=math.sqrt(2))
    assert still.period == 2 * math.pi
    assert make_return_map(still, SPLITTING, 40).table.shape[-1] == 2
    free_running = make_return_map(particle_without("forcing"), SPLITTING, 40)
    assert free_running.step_map.table.shape == (64, 2)  # the coefficients of one step, and no more
    assert (free_running.steps, int(free_running.step_map.kicks)) == (40, 17)


@pytest.mark.slow
def test_map_without_forcing_is_diffeqsolve(lanes):
    """A disturbed speed without forcing, against the general route by another method, to the error of either."""
    system = disturbed_speed(without=("forcing",))
    other = lagrangian(
        definition(system.without, constrained=True), {"a": 0.5, "b": 0.0, "c": 1.0, "d": 0.1, "omega": 1.0}
    )
    (x, y), (n1, n2) = lanes(iterate, (make_return_map(system, SPLITTING, 200), np.int32(1)), (spread(START), P))
    motion = Motion(START[0], START[1], (0.0, 0.0))
    there = lanes(iterate, (make_return_map(other, dopri8, 400), np.int32(1)), (spread(motion), P))
    np.testing.assert_allclose([x, y, n1, n2], [*there.q, *there.v], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("names", [(), ("forcing", "cubic_stiffness")])
def test_sweep_over_a(lanes, names):
    """Lanes that differ in a are the lanes of their own a and one b, and so is ∂P/∂a by differences."""
    values = np.array([0.3, 0.5, 0.8])
    swept = make_return_map(particle_without(*names, b=0.7), SPLITTING, 60)
    u = np.tile(ANGLE, (3, 1))
    _, monodromy, slope = lanes(derivatives, (swept, np.int32(1)), (u, {"a": values}), static=("a",))
    (x, y), (n1, n2) = lanes(iterate, (swept, np.int32(1)), (spread(START, 3), {"a": values}))
    for i, a in enumerate(values):
        own = make_return_map(particle_without(*names, a=a), SPLITTING, 60)
        one = lanes(iterate, (own, np.int32(1)), (spread(START, 1), {"b": np.array([0.7])}))
        np.testing.assert_allclose([x[i], y[i], n1[i], n2[i]], np.array([*one[0], *one[1]])[:, 0], atol=1e-12)
    h = 1e-5
    for found, step_u, step_a in ((slope, 0.0, h), (monodromy[..., 0], h * np.eye(3)[0], 0.0)):
        ends = [
            lanes(derivatives, (swept, np.int32(1)), (u + s * step_u, {"a": values + s * step_a})).image
            for s in (1, -1)
        ]
        np.testing.assert_allclose(found, (ends[0] - ends[1]) / (2 * h), atol=1e-6)  # h², and rounding over h
