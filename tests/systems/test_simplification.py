"""Fewer equations for the same numbers: of random expressions beside NumPy, and of those that rules are for, counted."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jaxnh.systems.simplification import SimplifiedProgram
from jaxnh.systems.tracing import Program
from tests.helpers.measurement import UNIT

X = (0.7, -1.3, 2.1)


def operations(program):
    """Names of the operations that results are made of."""
    needed = program.needed(program.outputs)
    return [step.equation.primitive.name for step in program.steps if not needed.isdisjoint(step.makes)]


@pytest.mark.parametrize(
    ("function", "left"),
    [
        (lambda x, y, z: 1.0 * x + 0.0, []),
        (lambda x, y, z: 0.0 * x + 2.0 * 3.0, []),
        (lambda x, y, z: 0.0 - (0.0 - x), []),
        (lambda x, y, z: x - (-y), ["add"]),
        (lambda x, y, z: -x + y, ["sub"]),
        (lambda x, y, z: -(x - y), ["sub"]),
        (lambda x, y, z: (2.0 * x) * (0.5 * y), ["mul"]),
        (lambda x, y, z: 3.0 * (-(2.0 * x)), ["mul"]),
        (lambda x, y, z: (-x) * (-y), ["mul"]),
        (lambda x, y, z: x * y - y * x + z, ["mul", "sub", "add"]),  # one product
        (lambda x, y, z: x / 4.0, ["mul"]),
        (lambda x, y, z: x / z + y / z, ["div", "mul", "mul", "add"]),
        (lambda x, y, z: x**-2, ["div", "integer_pow"]),
        (lambda x, y, z: x / 3.0, ["div"]),  # what would be rounded stays as it is written
        (lambda x, y, z: 0.1 * (3.0 * x), ["mul", "mul"]),
        (lambda x, y, z: jnp.sin(jnp.float64(0.5)) * x, ["sin", "mul"]),
    ],
)
def test_rules(function, left):
    """Each leaves the operations that it should, and the same number."""
    assert sorted(operations(SimplifiedProgram(function, *X))) == sorted(left)
    assert float(SimplifiedProgram(function, *X)(*map(jnp.float64, X))) == pytest.approx(
        float(function(*X)), rel=4 * UNIT
    )


STEPS = [
    lambda x, y: x + y,
    lambda x, y: x - y,
    lambda x, y: x * y,
    lambda x, y: -x,
    lambda x, y: x / (2.0 + y * y),
]


def random_expression(rng, values):
    """A sum of expressions in many operations of some values."""
    pool = [*values, 0.0, 1.0, -1.0, 2.0, 0.3]
    for _ in range(25):
        x, y = (pool[rng.integers(len(pool))] for _ in range(2))
        pool.append(STEPS[rng.integers(len(STEPS))](x, y))
    return sum(pool[-6:])


@pytest.mark.parametrize("seed", range(40))
def test_random_expressions(seed):
    """Values and derivatives within rounding of those as written, in no more operations but for reciprocals."""

    def written(x, y, z):
        return random_expression(np.random.default_rng(seed), (x, y, z))

    at = tuple(map(jnp.float64, X))
    simplified, plain = SimplifiedProgram(written, *X), Program(written, *X)
    np.testing.assert_allclose(simplified(*at), written(*at), rtol=1e-11, atol=1e-12)
    slopes = SimplifiedProgram(jax.grad(written, (0, 1, 2)), *X)(*at)
    np.testing.assert_allclose(slopes, jax.grad(written, (0, 1, 2))(*at), rtol=1e-10, atol=1e-11)
    quotients = sum(step.equation.primitive.name == "div" for step in plain.steps)
    assert simplified.count(simplified.outputs) <= plain.count(plain.outputs) + quotients


def test_what_is_no_single_number_in_double_precision_is_left_as_it_is():
    def function(x, y, z):
        return jnp.stack([x, y]) * 1.0, lax.convert_element_type(x, jnp.float32) * jnp.float32(1.0), x > y

    results = SimplifiedProgram(function, *X)(*map(jnp.float64, X))
    for result, exact in zip(results, function(*map(jnp.float64, X)), strict=True):
        np.testing.assert_array_equal(result, exact)
        assert result.dtype == exact.dtype
