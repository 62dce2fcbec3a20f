"""The particle without a constraint against equation (1) written out here; its names and start states."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import iterate
from jaxnh.solvers import dopri8
from jaxnh.systems.free_particle import free_particle
from jaxnh.systems.lagrangian import Motion
from jaxnh.systems.particle_parameters import EFFECTS
from tests.helpers.batches import broadcast_start
from tests.helpers.measurement import UNIT

WITHOUT = [(), *((name,) for name in EFFECTS), EFFECTS]
A, B, OMEGA = 0.4, 1.1, 1.3


@pytest.mark.parametrize("without", WITHOUT)
def test_accelerations_are_those_of_equation_1(without):
    """With whatever is left out of it; a, b and ω in the flow or in the lane. Some ten products, each below two."""
    t, (x, y), (u, v) = 0.7, (0.3, -0.8), (0.2, 0.9)
    g = 1.0 if "forcing" in without else 1 + math.sin(OMEGA * t)
    b, drag = (0.0 if "coupling" in without else B), (0.0 if "damping" in without else A)
    cubic = "cubic_stiffness" not in without
    springs = A * x + (x**3 if cubic else 0.0), y + (A * y**3 if cubic else 0.0)
    expected = b * y - g * springs[0] - drag * u, b * x - g * springs[1] - drag * v
    state = jax.tree.map(jnp.float64, Motion((x, y), (u, v), (0.0, 0.0)))
    flows = [
        (free_particle(A, B, OMEGA, without), {}),
        (free_particle(A, None, OMEGA, without), {"b": B}),
        (free_particle(0.9, 5.0, OMEGA, without), {"a": A, "b": B}),
    ]
    for flow, p in flows:
        found = flow.rhs(jnp.float64(t), state, p)
        assert np.abs(np.array(found.v) - expected).max() < 20 * 2 * UNIT
        assert np.array_equal(found.q, state.v)
        assert abs(float(flow.divergence(jnp.float64(t), state, p)) + 2 * drag) < 4 * UNIT


def test_free_particle_is_equation_1():
    """Its accelerations are those of (1), written out here, with forcing and damping."""
    flow = free_particle(0.4, None, 1.3)
    t, b, (x, y), (u, v) = 0.7, 1.1, (0.3, -0.8), (0.2, 0.9)
    g = 1 + math.sin(1.3 * t)
    state = jax.tree.map(jnp.float64, Motion((x, y), (u, v), (0.0, 0.0)))
    found = flow.rhs(t, state, {"b": b})
    expected = b * y - g * (0.4 * x + x**3) - 0.4 * u, b * x - g * (y + 0.4 * y**3) - 0.4 * v
    np.testing.assert_allclose(found.v, expected, rtol=1e-14)


@pytest.mark.slow  # the matrix has the free particle
def test_free_particle_keeps_its_energy():
    """Without damping and forcing H = v²/2 + V is constant; with damping it falls by a ∫ v² dt, and so at all."""
    b = np.array([0.2, 0.6])
    start = broadcast_start(Motion((0.3, -0.2), (0.5, 0.4), (0.0, 0.0)), 2)

    def energy(z):
        x, y = z.q
        springs = 0.25 * x**2 + 0.25 * x**4 + 0.5 * y**2 + 0.125 * y**4
        return 0.5 * (z.v[0] ** 2 + z.v[1] ** 2) + springs - b * x * y

    for damped in (False, True):
        names = frozenset({"forcing"} | (set() if damped else {"damping"}))
        flow = free_particle(0.5, None, 1.0, names)
        end = LaneExecutor()(iterate, (make_return_map(flow, dopri8, 80), np.int32(3)), (start, {"b": b}))
        lost = energy(start) - energy(end)
        assert np.all(lost > 0.1) if damped else np.abs(lost).max() < 1e-9


def test_names():
    """The paper's; the period is shared, and so is what it depends on."""
    flow = free_particle(A, B, OMEGA)
    assert dict(flow.parameters) == {"a": A, "b": B, "omega": OMEGA}
    assert [name for name in flow.parameters if flow.roles.is_shared(name)] == ["omega"]
    assert flow.coordinates == ("x1", "x2", "y1", "y2")
    assert flow.readout.labels.planes[0] == ("x1", "x2")
    assert flow.readout.labels.long_names["a"] == "stiffness a"
    assert flow.period == 2 * math.pi / OMEGA
    assert [free_particle(A, B, OMEGA, names).autonomous for names in ((), ("forcing",), ("damping",))] == [
        False,
        True,
        False,
    ]
    assert (flow.chart.dimension, flow.exponents) == (4, 4)


def test_start_and_section_points():
    """x1, x2, y1, y2 of lanes side by side, back by section points and outputs."""
    values = dict(zip(("x1", "x2", "y1", "y2"), np.random.default_rng(2).normal(size=(4, 5)), strict=True))
    flow = free_particle(A, None, OMEGA)
    start = flow.start(values)
    points = flow.chart.host_points(start)
    np.testing.assert_array_equal(points, np.stack([values[name] for name in ("x1", "y1", "x2", "y2")], axis=-1))
    np.testing.assert_array_equal(points, jax.vmap(flow.chart.point)(jax.tree.map(jnp.asarray, start)))
    for name, output in flow.readout.coordinates(start, np.zeros(1)).items():
        np.testing.assert_array_equal(output.data, values[name])
