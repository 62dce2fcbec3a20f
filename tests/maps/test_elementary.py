"""sin and cos of lane values against the library in long double."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.maps.elementary import cosine, sine

FUNCTIONS = {"sin": (sine, np.sin), "cos": (cosine, np.cos)}


def arguments(largest):
    """Evenly drawn, and those nearest to multiples and half multiples of π, where most digits cancel."""
    x = np.random.default_rng(0).uniform(-largest, largest, 50_000)
    return np.concatenate([x, np.round(x / np.pi) * np.pi, (np.round(x / np.pi) + 0.5) * np.pi, [0.0, 1e-300]])


@pytest.mark.parametrize("largest", [1.6, 1e3, 2e8])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_value_to_the_last_places(name, largest):
    """Two roundings of the sum r + r (r² …), one of the last of the four subtractions: three units in the last place."""
    ours, exact = FUNCTIONS[name]
    x = arguments(largest)
    value = exact(x.astype(np.longdouble))
    gap = np.abs(np.asarray(jax.jit(ours)(x)).astype(np.longdouble) - value)
    assert np.max(gap / np.spacing(np.abs(value).astype(np.float64))) < 3.0


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
