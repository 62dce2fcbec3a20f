"""What depends on time alone is found in a field, whatever it is written with, and the rest is the field."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jaxnh.maps.time_tables import TimeSplit

SHARED, LANE = {"c": 0.7}, {"x": 0.3, "v": -1.2}


def plain(t, s, y):
    return y["v"], s["c"] * jnp.cos(t) - y["x"] ** 3


def nested(t, s, y):
    @jax.jit
    def force(t, x):
        return jnp.where(jnp.sin(t) > 0.0, jnp.exp(-t) * x, x)

    return force(t, y["x"]), y["v"] * jnp.tanh(s["c"] * t)


def looped(t, s, y):
    total = lax.fori_loop(0, 4, lambda i, sum_: sum_ + jnp.sin(i * t), 0.0 * t)
    return total * y["x"], lax.cond(y["v"] > 0.0, lambda: t, lambda: -t)


def of_time_alone(t, s, y):
    return jnp.cos(t), s["c"] + t


def no_time(t, s, y):
    return y["v"], -jnp.sin(y["x"]) * s["c"]


def with_its_own_derivative(t, s, y):
    return jax.nn.relu(y["x"]) * jax.nn.relu(t), y["v"]


FIELDS = {  # and how many values their tables have
    plain: 1, nested: 3, looped: 2, of_time_alone: 2, no_time: 0, with_its_own_derivative: 1,
}  # fmt: skip


@pytest.mark.parametrize("field", FIELDS, ids=lambda field: field.__name__)
def test_table_and_rest_are_the_field(field):
    """Of these programs XLA does the same operations on the same numbers: but for the sines of a lane, to three units."""
    split = TimeSplit(field, SHARED, LANE)
    assert split.width == FIELDS[field]
    times = np.array([[0.1, 0.2], [2.0, 4.0]])
    table = split.table(times, SHARED)
    assert all(np.shape(value) == times.shape for value in table)
    for place in np.ndindex(times.shape):
        expected = field(jnp.float64(times[place]), SHARED, jax.tree.map(jnp.float64, LANE))
        found = split.rest([value[place] for value in table], SHARED, jax.tree.map(jnp.float64, LANE))
        np.testing.assert_allclose(found, expected, rtol=4 * np.finfo(float).eps, atol=0)


def test_lanes_have_no_sine_of_time():
    """The compiled rest of a field has no call of a library function of time."""
    split = TimeSplit(plain, SHARED, LANE)
    lanes = {name: np.full(8, value) for name, value in LANE.items()}
    program = jax.jit(lambda value, y: jax.vmap(lambda y: split.rest([value], SHARED, y))(y))
    assert "cosine" in jax.jit(lambda t, y: jax.vmap(lambda y: plain(t, SHARED, y))(y)).lower(1.0, lanes).as_text()
    assert "cosine" not in program.lower(1.0, lanes).as_text()


def test_equations_of_the_lanes_are_counted():
    """x³ and its difference from the force are the lanes'; the force and its product with c are not."""
    assert TimeSplit(plain, SHARED, LANE).size == 2
    assert TimeSplit(of_time_alone, SHARED, LANE).size == 0


def test_sums_over_axes_are_products_with_ones():
    """A loop that adds sines computes them one at a time. Sums of whole numbers, and over no axis, stay as they are."""

    def coupled(t, s, y):
        phases = jnp.stack([y["x"], y["v"], y["x"] + y["v"], 0.3 * y["x"]])
        gaps = jnp.sin(phases[None] - phases[:, None])
        ahead = jnp.sum(gaps > 0.0)
        return jnp.sum(gaps, axis=1) + s["c"] * jnp.mean(gaps, axis=0), jnp.sum(gaps**2), ahead, jnp.sum(y["x"])

    split = TimeSplit(coupled, SHARED, LANE)
    lanes = {"x": np.linspace(-3.0, 3.0, 16), "v": np.linspace(0.0, 7.0, 16)}

    def rest(lane):
        return split.rest((), SHARED, lane)

    program = jax.make_jaxpr(jax.vmap(rest))(lanes)
    names = [equation.primitive.name for equation in program.eqns]
    assert names.count("dot_general") == 3
    assert names.count("reduce_sum") == 2
    for found, exact in zip(
        jax.vmap(rest)(lanes), jax.vmap(lambda lane: coupled(0.0, SHARED, lane))(lanes), strict=True
    ):
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-14)
