"""Functions written with small arrays, taken apart into numbers, against NumPy's arithmetic and closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.systems.small_arrays import by_numbers

MATRIX = np.array([[0.5, 0.0, -1.5], [2.0, 1.0, 0.25], [0.0, 0.0, 3.0]])
Y = (0.3, -1.2, 0.7)


def ring(xp):
    """Lorenz's ring of 1996 in three coordinates, which rolls an array."""
    return lambda y, t: (xp.roll(y, -1) - xp.roll(y, 2)) * xp.roll(y, 1) - y + 8.0


def product(xp):
    return lambda y, t: xp.asarray(MATRIX) @ xp.sin(y) + t * y


def whole_powers(xp):
    return lambda y, t: xp.sum(y[:, None] ** xp.arange(1, 4), axis=1)


def least(xp):
    return lambda y, t: xp.min(xp.asarray(MATRIX) * y, axis=1) + xp.max(y)


def inner(xp):
    return lambda y, t: xp.dot(y, xp.cos(y)) * y + xp.sum(y) * xp.asarray(MATRIX[0])


def row(xp):
    return lambda y, t: y @ xp.asarray(MATRIX) + (y @ xp.asarray(MATRIX) @ y) * t


def picked(xp):
    return lambda y, t: xp.concatenate([y[1:] * y[0], y[::-1][:1]])


def choice(xp):
    return lambda y, t: xp.where(y > 0.0, y, xp.asarray([1, 2, 3]) * t)


def outer(xp):
    return lambda y, t: xp.transpose(y[:, None] * xp.asarray(MATRIX)).sum(axis=0)


@pytest.fixture(autouse=True)
def users_settings():
    """Of users, who add whole numbers to others and rows to matrices."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


FUNCTIONS = [ring, product, inner, row, whole_powers, least, picked, choice, outer]


def in_jax(function):
    """The function as a user has it: of a tuple of numbers, to one."""
    of_array = function(jnp)
    return lambda y, t: tuple(of_array(jnp.stack(y), t))


def shapes(function, *arguments):
    return {v.aval.shape for e in jax.make_jaxpr(function)(*arguments).jaxpr.eqns for v in e.outvars}


@pytest.mark.parametrize("function", FUNCTIONS)
def test_numbers_are_those_of_numpy(function):
    """Both are sums of a handful of products in double precision."""
    expected = function(np)(np.array(Y), 0.4)
    np.testing.assert_allclose(by_numbers(in_jax(function))(Y, 0.4), expected, rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize("function", FUNCTIONS)
def test_no_array_is_left(function):
    assert shapes(in_jax(function), Y, 0.4) != {()}
    assert shapes(by_numbers(in_jax(function)), Y, 0.4) == {()}


@pytest.mark.parametrize("function", FUNCTIONS)
def test_derivatives_are_those_of_the_arrays(function):
    one, other = (jax.jacfwd(each)(Y, 0.4) for each in (in_jax(function), by_numbers(in_jax(function))))
    np.testing.assert_allclose(np.array(one), np.array(other), rtol=1e-14, atol=1e-14)


def test_zeros_of_a_matrix_leave_no_trace():
    """Of nine products five are left, and no sum in the last row."""
    text = str(jax.make_jaxpr(by_numbers(lambda y, t: tuple(jnp.asarray(MATRIX) @ jnp.stack(y))))(Y, 0.0))
    assert text.count(" mul ") == np.count_nonzero(MATRIX) == 6
    assert text.count(" add ") == 6 - len(MATRIX)


def test_whole_powers_are_products():
    """A power of a negative number by a whole one is finite, and so is its derivative."""
    function = by_numbers(lambda y, t: (jnp.sum(y[0] ** jnp.arange(4)),))
    assert function((-2.0,), 0.0)[0] == 1.0 - 2.0 + 4.0 - 8.0
    assert jax.grad(lambda x: function((x,), 0.0)[0])(-2.0) == 1.0 - 4.0 + 12.0


def test_lanes_and_parameters_of_an_outer_program_pass_through():
    """A field closes over parameters, which are values of the program that is traced."""

    def image(a, x):
        return by_numbers(lambda y, t: tuple(jnp.asarray([a, 2.0]) * jnp.stack(y)))((x, 2 * x), 0.0)

    a, x = np.linspace(1.0, 2.0, 5), np.linspace(-1.0, 1.0, 5)
    first, second = jax.jit(jax.vmap(image))(a, x)
    np.testing.assert_array_equal(first, a * x)
    np.testing.assert_array_equal(second, 4.0 * x)


def many_numbers(y, t):
    return (jnp.sum(jnp.sin(y[0] * jnp.arange(1000.0))),)


@pytest.mark.parametrize(
    "function",
    [
        lambda y, t: tuple(jnp.sort(jnp.stack(y))),
        lambda y, t: (jnp.linalg.det(jnp.diag(jnp.stack(y))),),
        many_numbers,
    ],
)
def test_what_has_no_simple_form_stays_as_it_is(function):
    assert str(jax.make_jaxpr(by_numbers(function))(Y, 0.4)) == str(jax.make_jaxpr(function)(Y, 0.4))


def test_functions_of_numbers_stay_as_they_are():
    def function(y, t):
        return y[0] * y[1], jnp.sin(t) ** 2.0

    assert str(jax.make_jaxpr(by_numbers(function))(Y, 0.4)) == str(jax.make_jaxpr(function)(Y, 0.4))
