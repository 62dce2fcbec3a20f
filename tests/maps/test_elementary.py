"""Elementary functions of lane values against the library in long double."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.maps.elementary import cosine, exponential, hyperbolic_tangent, logarithm, sine

FUNCTIONS = {"sin": (sine, np.sin), "cos": (cosine, np.cos)}


def arguments(largest):
    """Evenly drawn, and those nearest to multiples and half multiples of π, where most digits cancel."""
    x = np.random.default_rng(0).uniform(-largest, largest, 50_000)
    return np.concatenate([x, np.round(x / np.pi) * np.pi, (np.round(x / np.pi) + 0.5) * np.pi, [0.0, 1e-300]])


def places(ours, exact, x):
    """Largest error in units in the last place of the value."""
    value = exact(x.astype(np.longdouble))
    gap = np.abs(np.asarray(jax.jit(ours)(x)).astype(np.longdouble) - value)
    return np.max(gap / np.spacing(np.abs(value).astype(np.float64)))


@pytest.mark.parametrize("largest", [1.6, 1e3, 2e8])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_value_to_the_last_places(name, largest):
    """Two roundings of the sum r + r (r² …), one of the last of the four subtractions: three units in the last place."""
    assert places(*FUNCTIONS[name], arguments(largest)) < 3.0


def numbers_near(points, width=1e-3):
    """Evenly drawn numbers near some."""
    return (np.asarray(points)[:, None] * np.random.default_rng(2).uniform(1 - width, 1 + width, 20_000)).ravel()


@pytest.mark.parametrize("largest", [1e-8, 0.3, 1.0, 40.0, 700.0])
def test_exponential(largest):
    """One rounding, of 1 + r + …, and what is left of the small terms: below a unit. Halves of ln 2 are where r jumps."""
    x = np.random.default_rng(0).uniform(-largest, largest, 100_000)
    halves = numbers_near((np.arange(-9, 10) + 0.5) * np.log(2.0))
    assert places(exponential, np.exp, np.concatenate([x, halves])) < 1.0


@pytest.mark.parametrize(("low", "high"), [(-307.6, 308.2), (-3, 3), (-0.01, 0.01), (-0.151, -0.150), (0.15, 0.151)])
def test_logarithm(low, high):
    """The same, in decades of x: all of them, near one where digits cancel, and at √½ and √2 where the exponent jumps."""
    x = 10.0 ** np.random.default_rng(0).uniform(low, high, 200_000)
    assert places(logarithm, np.log, x) < 1.0


@pytest.mark.parametrize("largest", [1e-8, 0.1, 0.35, 1.0, 21.0, 300.0])
def test_hyperbolic_tangent(largest):
    """Of exp(2|x|) − 1, of that plus two, and of their ratio: three roundings."""
    x = np.random.default_rng(0).uniform(-largest, largest, 200_000)
    assert places(hyperbolic_tangent, np.tanh, x) < 3.0


def test_ends_of_the_line():
    """Infinities, zeros and no numbers are those of the library."""
    x = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, -1.0, 710.0, -746.0, 1.7e308, 2.3e-308])
    for ours, exact in ((exponential, np.exp), (logarithm, np.log), (hyperbolic_tangent, np.tanh)):
        with np.errstate(all="ignore"):
            np.testing.assert_allclose(jax.jit(ours)(x), exact(x), rtol=1e-15)


def test_single_precision_is_left_to_the_compiler():
    x = jnp.linspace(0.1, 3.0, 100, dtype=jnp.float32)
    for ours, theirs in ((exponential, jnp.exp), (logarithm, jnp.log), (hyperbolic_tangent, jnp.tanh)):
        np.testing.assert_array_equal(ours(x), theirs(x))


@pytest.mark.parametrize("name", ["exp", "log", "tanh"])
def test_derivatives(name):
    """To rounding those of the library's function."""
    ours = {"exp": exponential, "log": logarithm, "tanh": hyperbolic_tangent}[name]
    x = jnp.asarray(np.random.default_rng(0).uniform(0.1, 5.0, 1000))
    slopes = [jax.jvp(f, (x,), (jnp.ones_like(x),))[1] for f in (ours, getattr(jnp, name))]
    np.testing.assert_allclose(*slopes, rtol=1e-14, atol=1e-15)  # of tanh it is a small difference from one


@pytest.mark.parametrize("name", FUNCTIONS)
def test_beyond_the_range_the_argument_is_off_by_less_than_its_last_place(name):
    ours, exact = FUNCTIONS[name]
    x = np.random.default_rng(1).uniform(1e9, 1e14, 10_000)
    gap = np.abs(np.asarray(jax.jit(ours)(x)).astype(np.longdouble) - exact(x.astype(np.longdouble)))
    assert np.max(gap / np.spacing(x)) < 1.0


@pytest.mark.parametrize("name", FUNCTIONS)
def test_derivative_is_the_other_function(name):
    ours, _ = FUNCTIONS[name]
    x = jnp.asarray(arguments(10.0))
    slope = jax.jvp(ours, (x,), (jnp.ones_like(x),))[1]
    expected = cosine(x) if name == "sin" else -sine(x)
    assert np.array_equal(np.asarray(slope), np.asarray(expected))


def test_what_is_no_number_stays_none():
    assert np.all(np.isnan(sine(jnp.array([np.nan, np.inf]))))
