"""Escape rates, mean lifetimes, exponents and dimensions of saddles that are known in closed form."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.transients.crisis_scaling import fit_crisis
from jaxnh.analyses.transients.lifetimes import escape_rate
from jaxnh.exceptions import InputError

LEAST = 0.95 - 3 * np.sqrt(0.95 * 0.05 / 100)
"""Of 100 intervals of 95 %, the share that covers at least, but for one case in a thousand."""


def open_tent(left=3.0, right=3.0, repetition=0.0):
    """Of an even measure the share 1/left + 1/right stays in (0, 1)."""
    del repetition

    def image(y):
        return jnp.where(y[0] < 0.5, left * y[0], right * (1.0 - y[0]))

    return {"map": image, "coordinates": "x"}


def repelling_line(rate=0.3, repetition=0.0):
    """ẋ = rate (1 + cos(2πt)/2) x, ẏ = −y: of even starts in |x| < 1 the share exp(−rate n) stays for n periods."""
    del repetition

    def rhs(y, t):
        return rate * (1.0 + 0.5 * jnp.cos(2 * jnp.pi * t)) * y[0], -y[1]

    return {"rhs": rhs, "coordinates": ("x", "y"), "period": 1.0}


def covers(data, name, exact):
    """Share of the lanes whose interval has the exact value."""
    if f"{name}_low" in data:
        return np.mean((data[f"{name}_low"] <= exact) & (exact <= data[f"{name}_high"]))
    return np.mean(np.abs(data[name] - exact) <= data[f"{name}_error"] + 1e-12)


def test_the_open_tent_map():
    """κ = ln(3/2), λ = ln 3, D = ln 2/ln 3: the saddle is Cantor's set."""
    options = jaxnh.Transients(n_starts=2048, box={"x": (0.0, 1.0)})
    session = jaxnh.Session(open_tent, start={"x": 0.3})
    data = session.run(options, repetition=np.arange(100.0))
    assert covers(data, "escape_rate", np.log(1.5)) >= LEAST
    assert covers(data, "mean_lifetime", 3.0) >= LEAST
    assert covers(data, "saddle_exponent", np.log(3.0)) == 1.0
    assert covers(data, "saddle_dimension", np.log(2) / np.log(3)) >= LEAST
    points = data["x_points"].to_numpy()
    for _ in range(2):  # each stays for two periods more at least, and then lies in no gap of that order
        assert not np.any((points > 1 / 3) & (points < 2 / 3))
        points = 3.0 * np.minimum(points, 1.0 - points)
    assert data["escaped"].all()


@pytest.mark.slow
def test_an_open_map_of_two_slopes():
    """κ = −ln(1/a + 1/c); branches are taken with weights 1/a and 1/c, and so λ is a mean that scatters."""
    options = jaxnh.Transients(box={"x": (0.0, 1.0)})
    data = jaxnh.Session(open_tent, start={"x": 0.3}).run(options, left=2.5, right=4.0, repetition=np.arange(1000.0))
    rate, exponent = -np.log(0.65), (0.4 * np.log(2.5) + 0.25 * np.log(4.0)) / 0.65
    least = 0.95 - 3 * np.sqrt(0.95 * 0.05 / 1000)
    assert covers(data, "escape_rate", rate) >= least
    assert covers(data, "saddle_exponent", exponent) >= least
    assert covers(data, "saddle_dimension", 1.0 - rate / exponent) >= least


def test_a_flow_with_a_saddle():
    """κ = λ = rate, so that D = 0; followed for 16 periods, when one motion in 120 is left: its lifetime is censored."""
    options = jaxnh.Transients(
        n_starts=1024, box={"x": (-1.0, 1.0), "y": (-1.0, 1.0)}, region={"x": (-1.0, 1.0)}, max_periods=16, transient=0
    )
    session = jaxnh.Session(repelling_line, start={"x": 0.3, "y": 0.1}, target=1e-7)
    data = session.run(options, repetition=np.arange(100.0))
    assert covers(data, "escape_rate", 0.3) >= LEAST
    assert covers(data, "mean_lifetime", 1.0 / -np.expm1(-0.3)) >= LEAST
    assert covers(data, "saddle_exponent", 0.3) >= LEAST
    assert covers(data, "saddle_dimension", 0.0) >= LEAST
    assert not data["escaped"].all()
    assert np.all(data["lifetime"].to_numpy()[data["escaped"].to_numpy() == 0] == 16)


def test_rates_of_lifetimes_that_are_censored():
    """Motions that leave with the chance 0.2 a period, followed for five: 95 of 100 intervals have it."""
    draws = np.random.default_rng(3)
    life = draws.geometric(0.2, (1000, 200))
    rate = escape_rate(np.minimum(life, 5), life <= 5, 1)
    share = np.mean((rate.rate[1] <= -np.log(0.8)) & (-np.log(0.8) <= rate.rate[2]))
    assert share >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / 1000)
    nothing = escape_rate(np.full((1, 20), 3), np.ones((1, 20), bool), 8)
    assert np.isnan(nothing.rate).all()
    assert nothing.escapes[0] == 0


def open_henon(a=2.0, b=0.3):
    return {"map": lambda s: (1.0 - a * s[0] ** 2 + s[1], b * s[0]), "coordinates": ("x", "y")}


def stays_of_henon(points, most):
    """Iterates that points stay within 3 of the origin, followed for so many at most."""
    life, inside = np.zeros(len(points), int), np.ones(len(points), bool)
    for _ in range(most):
        x, y = np.where(inside[:, None], points, 0.0).T
        points = np.stack([1.0 - 2.0 * x**2 + y, 0.3 * x], axis=1)
        inside &= np.abs(points).max(axis=1) < 3.0
        life += inside
    return life


def stagger_and_step(count, least=30, further=12):
    """Points of a pseudotrajectory on the saddle, and the mean growth of a tangent along it.

    A step is an iterate while the point stays for `least` iterates; else it is moved by distances that are even in
    their logarithms until it stays longer (Sweet, Nusse and Yorke, Phys. Rev. Lett. 86 (2001) 2261).
    """
    draws = np.random.default_rng(0)
    z = draws.uniform(-1.0, 1.0, (20000, 2)) * [1.5, 0.4]
    life = stays_of_henon(z, least + further)
    z, left = z[np.argmax(life)], int(life.max())
    points, tangent, logs = np.empty((count, 2)), np.array([1.0, 0.0]), np.empty(count)
    for k in range(count):
        while left < least:
            way = draws.normal(size=(256, 2))
            near = z + way / np.linalg.norm(way, axis=1)[:, None] * 10.0 ** -draws.uniform(1.0, 15.0, (256, 1))
            life = stays_of_henon(near, least + further)
            if (life > left).any():
                first = np.argmax(life > left)
                z, left = near[first], int(life[first])
        points[k] = z
        tangent = np.array([-4.0 * z[0] * tangent[0] + tangent[1], 0.3 * tangent[0]])
        logs[k] = np.log(np.linalg.norm(tangent))
        tangent /= np.linalg.norm(tangent)
        z, left = np.array([1.0 - 2.0 * z[0] ** 2 + z[1], 0.3 * z[0]]), left - 1
    return points, logs


@pytest.mark.slow
def test_the_saddle_beside_stagger_and_step():
    """Of Henon's map at a = 2 both have the same points and the same exponent, within the bars of both."""
    options = jaxnh.Transients(box={"x": (-1.5, 1.5), "y": (-0.4, 0.4)}, region={"x": (-3.0, 3.0), "y": (-3.0, 3.0)})
    data = jaxnh.Session(open_henon, start={"x": 0.1, "y": 0.1}).run(options, a=2.0 + 1e-9 * np.arange(4))
    points, logs = stagger_and_step(12000)
    blocks = logs.reshape(24, -1).mean(axis=1)
    exponent, bar = blocks.mean(), 2.07 * blocks.std(ddof=1) / np.sqrt(24)
    assert np.all(np.abs(data["saddle_exponent"] - exponent) <= data["saddle_exponent_error"] + bar)
    ours = np.stack([data["x_points"].to_numpy().ravel(), data["y_points"].to_numpy().ravel()], axis=1)
    ours = ours[np.isfinite(ours).all(axis=1)]
    for one, other in ((ours, points), (points, ours)):  # a third of 16 periods before they leave: e^(−5 λ) off
        nearest = [np.linalg.norm(other - point, axis=1).min() for point in one[:500]]
        assert np.quantile(nearest, 0.9) < np.exp(-5 * exponent)


def open_power(a=1.01, order=2):
    """a (1 − |2x − 1|^order): its maximum is 1 at a = 1, and leaves (0, 1) over a width of (a − 1)^(1/order)."""
    return {"map": lambda y: a * (1.0 - jnp.abs(2.0 * y[0] - 1.0) ** order), "coordinates": "x"}


def test_the_crisis_of_maps_of_one_maximum():
    """The rate begins as a power 1/order of a − 1: 1/2 of the logistic map, whose r is 4a; of the tent map it is ln a."""
    session, order = jaxnh.Session(open_power, start={"x": 0.3}), np.array([2.0, 1.0])
    options = jaxnh.Transients(n_starts=1024, box={"x": (0.0, 1.0)}, crisis=True)
    data = session.run(options, a=1.0 + np.geomspace(0.002, 0.1, 16), order=order)
    for name, exact, least in (("crisis", 1.0, 0.01), ("crisis_exponent", 1.0 / order, 0.5)):
        assert data[name].dims == ("order",)
        assert np.all(np.abs(data[name] - exact) <= data[f"{name}_error"])
        assert np.all(data[f"{name}_error"] < least)


@pytest.mark.parametrize(("exponent", "curvature"), [(0.5, 0.0), (1.0, 1.0), (1.5, -1.0)])
def test_intervals_of_power_laws(exponent, curvature):
    """Escapes that are drawn from κ = x^γ exp(−c x^γ), falling towards the crisis from above or from below."""
    draws, x = np.random.default_rng(6), np.linspace(0.02, 0.3, 20)
    rate = np.minimum(x**exponent * np.exp(-curvature * x**exponent), 1.0)
    covered = []
    for side in (1.0, -1.0) * 50:
        escapes = draws.poisson(1000 * np.ones_like(x))
        fitted = fit_crisis(2.0 + side * x, rate * escapes / 1000, escapes)
        errors = abs(fitted.value - 2.0), abs(fitted.exponent - exponent)
        covered.append([errors[0] <= fitted.value_error, errors[1] <= fitted.exponent_error])
    assert np.all(np.mean(covered, axis=0) >= LEAST)


def test_power_laws_of_too_few_values():
    """Values with fewer than sixteen escapes do not count."""
    escapes = np.where(np.arange(12) < 5, 3, 1000)
    assert np.isnan(fit_crisis(np.linspace(1.0, 2.0, 12), np.linspace(0.1, 0.2, 12), escapes)).all()


def test_options_that_do_not_go_together():
    with pytest.raises(InputError, match="must be less than max_periods"):
        jaxnh.Transients(box={"x": (0.0, 1.0)}, max_periods=16, transient=16)
    session = jaxnh.Session(open_tent, start={"x": 0.3})
    with pytest.raises(InputError, match="there is no coordinate y; known are x"):
        session.run(jaxnh.Transients(box={"x": (0.0, 1.0)}, region={"y": (0.0, 1.0)}))
    with pytest.raises(InputError, match="needs a box to draw its starts from"):
        session.run(jaxnh.Transients())
    with pytest.raises(InputError, match="a power law is fitted to 8 values of the first axis or more"):
        session.run(jaxnh.Transients(box={"x": (0.0, 1.0)}, crisis=True), left=[3.0, 3.1])
