"""Numbers of analyses under `jax.grad`, against closed forms."""

from __future__ import annotations

import jax
import numpy as np
import pytest

import jaxnh
from jaxnh.exceptions import InputError


def henon(a=1.0, b=0.3):
    def image(s):
        x, y = s
        return 1.0 - a * x**2 + y, b * x

    return {"map": image, "coordinates": ("x", "y")}


@pytest.fixture(scope="module")
def session():
    return jaxnh.Session(henon, start={"x": 0.1, "y": 0.1})


@pytest.fixture(scope="module")
def first_doubling(session):
    """a = 3 (1 − b)²/4."""
    return jaxnh.gradient(session, jaxnh.Doubling(levels=1), "a", where={"level": 1}, a=np.linspace(0.2, 0.8, 32))


def test_value_and_derivative(first_doubling):
    value, rate = jax.value_and_grad(lambda b: first_doubling(b=b))(0.3)
    assert float(value) == pytest.approx(0.75 * 0.49, abs=1e-12)
    assert float(rate) == pytest.approx(-1.05, abs=1e-9)


def test_doubling_is_put_at_a_value(first_doubling):
    """Newton on the function and its derivative: where the doubling is at 1/2, b = 1 − √(2/3)."""
    b = 0.3
    for _ in range(5):
        value, rate = jax.value_and_grad(lambda b: first_doubling(b=b))(b)
        b -= float((value - 0.5) / rate)
    assert b == pytest.approx(1 - (2 / 3) ** 0.5, abs=1e-10)


def test_multiplier(session):
    """Of the fixed point at b = 0: −2 a x with a x² + x = 1, so that (1 − μ)² = 1 + 4 a."""
    multiplier = jaxnh.gradient(session, jaxnh.Period(), "multiplier")
    rates = jax.grad(lambda p: multiplier(a=p[0], b=p[1]))(np.array([0.5, 0.0]))
    assert float(rates[0]) == pytest.approx(2 / (1 + 4 * 0.5) ** 0.5, abs=1e-8)


def test_bifurcation_of_a_branch(session):
    """The same doubling, of the group that `branches` brings; of a second bifurcation there is no number."""
    options = jaxnh.Branches(max_period=1)
    first, second = (
        jaxnh.gradient(session, options, "a", where={"bifurcation": k}, a=np.linspace(0.2, 0.8, 8)) for k in (0, 1)
    )
    value, rate = jax.value_and_grad(lambda b: first(b=b))(0.3)
    assert float(value) == pytest.approx(0.75 * 0.49, abs=1e-12)
    assert float(rate) == pytest.approx(-1.05, abs=1e-9)
    assert np.isnan(second(b=0.3))
    with pytest.raises(InputError, match=r"there are a over \(bifurcation\)"):
        jaxnh.gradient(session, options, "a", a=np.linspace(0.2, 0.8, 8))(b=0.3)


def test_what_has_no_derivatives_is_said(session, first_doubling):
    with pytest.raises(InputError, match=r"outside jax\.jit and jax\.vmap"):
        jax.jit(lambda b: first_doubling(b=b))(0.3)
    with pytest.raises(InputError, match="Lyapunov gives no derivatives in parameters"):
        jaxnh.gradient(session, jaxnh.Lyapunov(), "exponents")
    with pytest.raises(InputError, match=r"residual at {} is no single number with derivatives; there are multiplier"):
        jaxnh.gradient(session, jaxnh.Period(), "residual")(a=0.5, b=0.3)
