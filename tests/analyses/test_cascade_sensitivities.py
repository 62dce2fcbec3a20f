"""Derivatives of the doublings of windows and of where they accumulate: maps that scale, and differences of runs."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.exceptions import InputError

NUMBERS = ("begin", "end", "doubling", "limit")


def quadratic(a=1.5, c=1.0, q=0.0):
    """x → a − c x² moved by q: of y = c x alone it is a c, so that every value of a is one over c, and q is nothing."""

    def image(s):
        x = s[0] - q
        return q + a - c * x * x

    return {"map": image, "coordinates": "x"}


SWEEP = np.linspace(1.74, 1.80, 60)
FIRST = 1.76852915247  # whose orbit of three has a multiplier of −1, of both equations by fsolve
OPTIONS = jaxnh.Windows(max_period=3, levels=6, crisis=0)


@pytest.fixture(scope="module")
def session():
    return jaxnh.Session(quadratic, start={"x": 0.1})


def derivatives(data, name, parameter):
    """Value, derivative and its error."""
    rates, errors = (data[f"{name}_sensitivity{end}"].sel(parameter=parameter).to_numpy() for end in ("", "_error"))
    return data[name].to_numpy(), rates, errors


def test_a_window_scales(session):
    """∂/∂c is minus the value itself at c = 1, and ∂/∂q zero: within bars, of six doublings by 1e-7 of the limit."""
    data = session.run(OPTIONS.model_copy(update={"sensitivities": True}), a=SWEEP)
    assert data["period"].to_numpy().tolist() == [3]
    for name in NUMBERS:
        value, rates, errors = derivatives(data, name, "c")
        assert np.all(np.abs(rates + value) <= errors), name
        assert np.all(errors < (1e-7 if name == "limit" else 1e-10)), name
        _, rates, errors = derivatives(data, name, "q")
        assert np.all(np.abs(rates) <= errors), name
        assert np.all(errors < 1e-10), name
    # Seen through the same weights, the limit of −a_k is minus that of a_k but for rounding, whatever the bar.
    value, rates, _ = derivatives(data, "limit", "c")
    assert np.all(np.abs(rates + value) < 1e-11)


def test_limit_under_grad(session):
    """A crisis is seen by how long paths stay: it solves no equation, and has no derivative."""
    options, sweep = jaxnh.Windows(max_period=3, levels=4, crisis=0), SWEEP[::2]
    limit = jaxnh.gradient(session, options, "limit", where={"window": 0}, a=sweep)
    value, rate = jax.value_and_grad(lambda c: limit(c=c))(1.0)
    assert float(rate) == pytest.approx(-float(value), abs=1e-9)
    first = jaxnh.gradient(session, options, "doubling", where={"window": 0, "level": 1}, a=sweep)
    assert float(first(c=1.0)) == pytest.approx(FIRST, abs=1e-10)
    with pytest.raises(InputError, match=r"crisis at .* no single number with derivatives; there are .* limit over"):
        jaxnh.gradient(session, options, "crisis", where={"window": 0}, a=sweep)(c=1.0)


def test_limit_of_a_cascade(session):
    """Of the main cascade by `doubling`, a number without dimensions; of three doublings there is none."""
    sweep = np.linspace(0.6, 1.45, 96)
    data = session.run(jaxnh.Doubling(levels=6, sensitivities=True), a=sweep)
    assert data["limit_sensitivity"].dims == ("parameter",)
    value, rates, errors = derivatives(data, "limit", "c")
    assert value == pytest.approx(1.401155189092, abs=1e-7)
    assert abs(rates + value) <= errors < 1e-6
    few = session.run(jaxnh.Doubling(levels=3, sensitivities=True), a=sweep)
    assert np.isnan(few["limit_sensitivity"]).all()
    assert np.isfinite(few["a_sensitivity"]).all()


def henon(a=1.2, b=0.3):
    def image(s):
        x, y = s
        return 1.0 - a * x * x + y, b * x

    return {"map": image, "coordinates": ("x", "y")}


SHARE = 2 * np.pi / (9 * 3**0.5 / 8 - 7 * np.pi / 12)


def kicked(a=1.7, s=1.0, w=1.0):
    """The flow of `test_windows` for x → s − a x², but that it turns by w right angles twice in a period."""

    def rhs(y, t):
        x, z = y
        kick, shrink, turn = (
            SHARE * jnp.maximum(jnp.cos(2 * jnp.pi * (t - place)) - 0.5, 0.0) ** 3 for place in (1 / 6, 1 / 2, 5 / 6)
        )
        angle = 0.5 * jnp.pi * w * turn
        return angle * z - 30 * shrink * (x - 1), kick * (s + 1 - a * x * x) - angle * x

    return {"rhs": rhs, "coordinates": ("x", "z"), "period": 1.0}


def window(session, options, sweep, period, **given):
    """The first window of a period."""
    data = session.run(options, a=sweep, **given)
    return data.isel(window=int(np.flatnonzero(data["period"].to_numpy() == period)[0]))


@pytest.mark.slow  # a map that scales is quick
def test_differences_of_runs():
    """Six digits of differences of four whole runs, of fourth order, for all of a window of Hénon's map.

    Its doublings turn sharply over b: shifts of 1e-4 leave four times 1e-7 of their derivatives, the fourth power of it.
    """
    session = jaxnh.Session(henon, start={"x": 0.1, "y": 0.1})
    options, sweep, step = jaxnh.Windows(max_period=7, levels=7, crisis=0), np.linspace(1.21, 1.28, 80), 6e-6
    data = window(session, options.model_copy(update={"sensitivities": True}), sweep, 7)
    sides = {k: window(session, options, sweep, 7, b=0.3 + k * step) for k in (-2, -1, 1, 2)}
    for number in NUMBERS:
        run = {k: side[number].to_numpy() for k, side in sides.items()}
        exact = (8 * (run[1] - run[-1]) - (run[2] - run[-2])) / (12 * step)
        _, rates, errors = derivatives(data, number, "b")
        assert np.all(np.abs(rates - exact) < 1e-6 * np.abs(exact)), number
        assert np.all(errors < 2e-6), number


@pytest.mark.slow  # maps are quick
def test_window_of_a_flow():
    """In s every value is one over s, as of the map; in w as differences of two runs, which leave the square of 1e-5."""
    session = jaxnh.Session(kicked, start={"x": 0.1, "z": -1.0}, target=1e-7)
    options, sweep, step = jaxnh.Windows(max_period=3, levels=4, crisis=0), np.linspace(1.74, 1.78, 30), 1e-5
    data = window(session, options.model_copy(update={"sensitivities": True}), sweep, 3)
    below, above = (window(session, options, sweep, 3, w=1.0 + k * step) for k in (-1, 1))
    for number in NUMBERS:
        value, rates, errors = derivatives(data, number, "s")
        assert np.all(np.abs(rates + value) <= errors), number
        exact = (above[number] - below[number]).to_numpy() / (2 * step)
        _, rates, errors = derivatives(data, number, "w")
        assert np.all(np.abs(rates - exact) <= 1e-6 * np.abs(exact)), (number, rates, exact, errors)
