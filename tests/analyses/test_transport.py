"""Growth and diffusion against closed forms: powers of time, resonance, lifted maps of known diffusion coefficient."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.transport.statistics import diffusion, growth_exponent
from jaxnh.exceptions import InputError

pytestmark = pytest.mark.usefixtures("shared_programs")
TURN = 2 * math.pi


def kinds(variable):
    return jaxnh.labels(variable).to_numpy().ravel().tolist()


# ---- growth


def power_law(k=3.0):
    """x' = 1 / (k x^(k-1)) from x = 1, so that x = (1 + t)^(1/k)."""
    return {"rhs": lambda y, t: (y[0] ** (1.0 - k) / k, -y[1]), "coordinates": ("x", "y")}


def driven(omega=1.0):
    """x'' + omega^2 x = cos t: x = t sin(t)/2 at resonance, else bounded; a rate of omega from rest."""

    def rhs(y, t):
        x, v = y
        return v, -(omega**2) * x + jnp.cos(t)

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": TURN}


def test_powers_of_time():
    """Exponents 1, 1/2, 1/3 and 1/4 within their bars, which are small."""
    session = jaxnh.Session(power_law, start={"x": 1.0, "y": 0.0}, target=1e-8)
    data = session.run(jaxnh.Transport(growth=("x",), periods=1024), k=np.array([1.0, 2.0, 3.0, 4.0]))
    exact = 1.0 / np.array([1.0, 2.0, 3.0, 4.0])
    assert np.all(np.abs(data["x_growth"] - exact) <= data["x_growth_error"])
    assert float(data["x_growth_error"].max()) < 0.03
    assert kinds(data["x_kind"]) == ["growing"] * 4


def test_resonance():
    """At resonance the velocity grows as t, off it nothing does."""
    session = jaxnh.Session(driven, start={"x": 0.0, "v": 0.0}, target=1e-8)
    data = session.run(jaxnh.Transport(growth=("v",), periods=2048), omega=np.array([1.0, 0.37, 1.4142]))
    assert kinds(data["v_kind"]) == ["growing", "bounded", "bounded"]
    assert abs(float(data["v_growth"][0]) - 1.0) <= float(data["v_growth_error"][0]) < 0.05


def multiplied(rate=1.01):
    return {"map": lambda y: (rate * y[0],), "coordinates": ("x",)}


def test_exponential_growth_is_no_power():
    data = jaxnh.Session(multiplied, start={"x": 1.0}).run(
        jaxnh.Transport(growth=("x",), periods=1024), rate=np.array([1.01, 0.99, 1.0])
    )
    assert kinds(data["x_kind"]) == ["undecided", "undecided", "bounded"]


@pytest.mark.parametrize("motions", [1, 4, 64])
def test_bars_of_the_growth_of_random_walks(motions):
    """The root mean square of a random walk grows as t^(1/2): of one walk, and of several, 95 of 100 bars cover it."""
    steps = np.random.default_rng(motions).standard_normal((400, motions, 1024))
    exponent, error = growth_exponent(np.cumsum(steps, axis=2))
    assert np.mean(np.abs(exponent - 0.5) <= error) >= 0.93  # two deviations of a binomial share of 400


# ---- diffusion


def lifted(a=3.0):
    """The map x -> a x on [0, 1/2), a x + 1 - a on [1/2, 1), lifted to the line: M(x + 1) = M(x) + 1.

    Of odd a the diffusion coefficient is (a^2 - 1)/24 (Klages and Dorfman, Phys. Rev. Lett. 74 (1995) 387).
    """

    def image(y):
        cell = jnp.floor(y[0])
        x = y[0] - cell
        return (cell + jnp.where(x < 0.5, a * x, a * x + 1.0 - a),)

    return {"map": image, "coordinates": ("x",)}


def test_lifted_maps():
    """Diffusion coefficients in closed form, from one long orbit and from many short ones."""
    a = np.array([3.0, 5.0, 7.0, 9.0])  # of even ones all digits are lost in 52 steps
    exact = (a**2 - 1) / 24
    session = jaxnh.Session(lifted, start={"x": 0.1234})
    for options in ({"periods": 65536}, {"periods": 512, "n_starts": 256, "box": {"x": (0.0, 1.0)}}):
        data = session.run(jaxnh.Transport(path=("x",), **options), a=a)
        assert kinds(data["diffusion_kind"]) == ["normal"] * 4
        assert np.all(np.abs(data["diffusion"] - exact) <= data["diffusion_error"])
        assert np.all(data["diffusion_error"] < 0.3 * exact)
        assert np.all(np.abs(data["x_drift"]) <= data["x_drift_error"])
        assert np.all(np.abs(data["diffusion_exponent"] - 1.0) <= data["diffusion_exponent_error"])


def noise(exponent, shape, seed):
    """Increments of fractional Brownian motion whose mean squared displacement is t^exponent, by their spectrum."""
    count = shape[-1]
    lags = np.arange(count + 1.0)
    covariance = 0.5 * (np.abs(lags + 1) ** exponent + np.abs(lags - 1) ** exponent - 2 * lags**exponent)
    spectrum = np.fft.fft(np.concatenate([covariance, covariance[-2:0:-1]])).real
    draws = np.random.default_rng(seed).standard_normal((2, *shape[:-1], 2 * count))
    return np.fft.fft((draws[0] + 1j * draws[1]) * np.sqrt(spectrum / (2 * count))).real[..., :count]


def test_bars_of_walks_that_remember():
    """Steps of ±1 that turn with a probability of 0.01 to 0.1 each: records of 256 are 5 to 50 times as long as a walk
    remembers, and its exponent, one in the end, falls from two. Where it does not fall ever more slowly there is no bound."""
    lanes, motions, strobes = 200, 64, 256
    random = np.random.default_rng(11)
    turning = 10.0 ** random.uniform(-2.0, -1.0, lanes)
    turns = random.random((lanes, motions, strobes)) < turning[:, None, None]
    first = random.integers(0, 2, (lanes, motions, 1))
    steps = 1.0 - 2.0 * ((first + np.cumsum(turns, axis=2)) % 2)
    paths = np.concatenate([np.zeros((lanes, motions, 1)), np.cumsum(steps, axis=2)], axis=2)
    made = diffusion(paths[None])
    assert np.mean(np.abs(made.exponent.value - 1.0) <= made.exponent.error) >= 0.93  # as above
    assert np.mean(np.abs(made.drift.value[0]) <= made.drift.error[0]) >= 0.93
    assert np.mean(np.isfinite(made.exponent.error)) > 0.3  # bars that say something


@pytest.mark.parametrize("motions", [1, 32])
@pytest.mark.parametrize("exponent", [0.6, 1.0, 1.5])
def test_bars_of_diffusion(exponent, motions):
    """Of fractional Brownian motion with a drift: exponent, drift, and of the normal one the coefficient 1/2."""
    lanes, strobes = 200, 4096 if motions == 1 else 256
    steps = noise(exponent, (1, lanes, motions, strobes), seed=7) + 0.3
    made = diffusion(np.concatenate([np.zeros((1, lanes, motions, 1)), np.cumsum(steps, axis=3)], axis=3))
    assert np.mean(np.abs(made.exponent.value - exponent) <= made.exponent.error) >= 0.95
    if exponent == 1.0:
        assert np.mean(np.abs(made.drift.value - 0.3) <= made.drift.error) >= 0.92
        assert np.mean(np.abs(made.coefficient.value - 0.5) <= made.coefficient.error) >= 0.95


def turning(rate=0.1):
    """A point of unit speed whose heading turns at a rate, and a heading that drifts: circles, and a line."""
    return {
        "rhs": lambda y, t: (jnp.cos(y[2]), jnp.sin(y[2]), rate),
        "coordinates": ("x", "y", "heading"),
        "angles": ("heading",),
    }


def test_circles_and_lines():
    """On circles a path is bounded; on a line it drifts at speed one, and is bounded about that; angles keep turns."""
    session = jaxnh.Session(turning, start={"heading": 0.3}, target=1e-8)
    data = session.run(jaxnh.Transport(path=("x", "y"), periods=2048), rate=np.array([0.5, 0.0]))
    assert kinds(data["diffusion_kind"]) == ["bounded", "bounded"]
    assert abs(float(data["x_drift"][1]) - math.cos(0.3)) < 1e-8
    assert abs(float(data["x_drift"][0])) <= float(data["x_drift_error"][0])
    data = session.run(jaxnh.Transport(path=("heading",), periods=256), rate=np.array([0.1, 4.0]))
    assert np.allclose(data["heading_drift"], [0.1, 4.0], atol=1e-9)


def test_ballistic_ensemble():
    """Straight lines of different speeds spread as t^2."""

    def free(k=1.0):
        return {"rhs": lambda y, t: (k * y[1], 0.0), "coordinates": ("x", "v")}

    session = jaxnh.Session(free, start={"x": 0.0, "v": 0.0}, target=1e-8)
    options = jaxnh.Transport(path=("x",), periods=256, n_starts=64, box={"v": (-1.0, 1.0)})
    data = session.run(options, k=np.array([1.0]))
    assert kinds(data["diffusion_kind"]) == ["superdiffusive"]
    assert abs(float(data["diffusion_exponent"][0]) - 2.0) <= float(data["diffusion_exponent_error"][0]) + 1e-9
    assert np.isnan(float(data["diffusion"][0]))


def test_refusals():
    session = jaxnh.Session(lifted, start={"x": 0.1})
    with pytest.raises(InputError, match="asks for nothing: name quantities in growth, or coordinates in path"):
        session.run(jaxnh.Transport(), a=np.array([3.0]))
    with pytest.raises(InputError, match="there is no coordinate z; known are x"):
        session.run(jaxnh.Transport(path=("z",)), a=np.array([3.0]))
    with pytest.raises(InputError, match="there is no output speed"):
        session.run(jaxnh.Transport(growth=("speed",)), a=np.array([3.0]))
