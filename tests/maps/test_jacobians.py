"""Matrices of fields number by number, beside automatic differentiation of the same fields."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.maps.build import make_return_map
from jaxnh.maps.jacobians import field_jacobian, has_cheap_jacobian, tangent_rate
from jaxnh.maps.protocol import Tangent
from jaxnh.maps.time_tables import time_split
from jaxnh.solvers import tsit5
from jaxnh.systems.first_order import first_order
from jaxnh.systems.lagrangian import lagrangian

pytestmark = pytest.mark.usefixtures("quick_compiling_always")


def driven(rho=28.0, drive=0.3):
    """Lorenz's equations with a drive, a quotient, a root and a tangent in them."""

    def rhs(y, t):
        u, v, w = y
        return 10.0 * (v - u) + drive * jnp.sin(t), u * (rho - w) - v / (1.0 + u * u), u * v - jnp.sqrt(4.0 + w * w)

    return {"rhs": rhs, "coordinates": ("u", "v", "w"), "period": 2.0 * jnp.pi}


def pendulum(ratio=0.8):
    def T(q, v, t):
        return 0.5 * (1 + ratio) * v[0] ** 2 + ratio * v[0] * v[1] * jnp.cos(q[0] - q[1]) + 0.5 * ratio * v[1] ** 2

    def Q(q, v, t):
        return -(1 + ratio) * jnp.sin(q[0]), -ratio * jnp.tanh(q[1])

    return {"T": T, "Q": Q, "coordinates": ("upper", "lower")}


FLOWS = {
    "right-hand side": first_order(driven, {"rho": 28.0, "drive": 0.3}, ("rho",)),
    "T, Q": lagrangian(pendulum, {"ratio": 0.8}, ("ratio",)),
}


@pytest.mark.parametrize("name", FLOWS)
def test_entries(name):
    """Rates and products with tangents are those of `jax.jvp`, and what is known to vanish has no entry."""
    flow = FLOWS[name]
    d, rng = flow.chart.dimension, np.random.default_rng(4)
    state, tangent = (flow.chart.state(jnp.asarray(rng.normal(size=d))) for _ in range(2))
    split, own = time_split(flow), {"rho": 28.0} if name == "right-hand side" else {"ratio": 0.8}
    values = split.table(0.7, flow)
    rates, rows = field_jacobian(flow)(values, flow, state, own)
    exact, moved = jax.jvp(lambda z: split.rest(values, flow, (z, own)), (state,), (tangent,))
    for leaf, other in zip(
        jax.tree.leaves((rates, tangent_rate(rows, tangent))), jax.tree.leaves((exact, moved)), strict=True
    ):
        np.testing.assert_allclose(leaf, other, rtol=1e-13, atol=1e-13)
    if name == "T, Q":
        assert [list(row) for row in rows[:2]] == [[2], [3]]  # the rate of an angle is its velocity
        assert all(row[j] == 1.0 for row, j in zip(rows[:2], (2, 3), strict=True))


@pytest.mark.parametrize("name", FLOWS)
def test_tangents_of_maps(name):
    """Tangents together go by the matrix; those of the map by automatic differentiation go without."""
    flow = FLOWS[name]
    assert has_cheap_jacobian(flow, 3)
    strobe = make_return_map(flow, tsit5, 40)
    d = flow.chart.dimension
    u = np.linspace(0.2, 0.5, d)
    own = {name: jnp.asarray(flow.parameters[name]) for name in flow.roles.of_lanes}
    units = [Tangent(flow.chart.state(jnp.asarray(row))) for row in np.eye(d)]
    state = flow.chart.state(jnp.asarray(u))
    together = jax.jit(lambda z: strobe.pushforward(z, own, tuple(units)).tangents)(state)
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(unit.state for unit in units))
    images = jax.jit(jax.vmap(lambda dz: jax.jvp(lambda z: strobe(z, own), (state,), (dz,))[1]))(stacked)
    for i, pushed in enumerate(together):
        for leaf, exact in zip(jax.tree.leaves(pushed.state), jax.tree.leaves(images), strict=True):
            np.testing.assert_allclose(leaf, exact[i], rtol=1e-11, atol=1e-11)
