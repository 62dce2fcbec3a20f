"""Exponents and escape rates by cycle expansion: of maps in closed form, of Lorenz's attractor against `lyapunov`."""

from __future__ import annotations

from itertools import product

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.orbits.cycle_expansion import WeightedCycles, cycle_averages, truncated_averages
from jaxnh.exceptions import InputError
from tests.flows.lorenz import lorenz

pytestmark = pytest.mark.usefixtures("always_shared_programs")
ROUNDING = 1e-10


def skew_tent(a=0.3, stretch=1.0):
    """Of slopes stretch/a and −stretch/(1 − a), which leave an even measure even; of it 1/stretch stays."""

    def image(y):
        return stretch * jnp.where(y[0] < a, y[0] / a, (1.0 - y[0]) / (1.0 - a))

    return {"map": image, "coordinates": "x"}


def logistic(r=4.0):
    return {"map": lambda y: r * y[0] * (1.0 - y[0]), "coordinates": "x"}


def cat(shear=1.0):
    return {
        "map": lambda s: (2.0 * s[0] + shear * s[1], s[0] + s[1]),
        "coordinates": ("x", "y"),
        "angles": ("x", "y"),
    }


def named_like_an_average(half=0.5):
    return {"map": lambda y: half * y[0], "coordinates": "cycle_exponent"}


def words(limit):
    """All primitive words of two letters up to a length, each by its least rotation."""
    for n in range(1, limit + 1):
        for word in product((0, 1), repeat=n):
            turned = [word[i:] + word[:i] for i in range(n)]
            if min(turned) == word and len(set(turned)) == n:
                yield word


def cycles_of(limit, slopes, times=(1.0, 1.0)):
    """The cycles of a full shift of two letters of constant slopes and times."""
    every = list(words(limit))
    growth, time = (np.array([sum(values[letter] for letter in word) for word in every]) for values in (slopes, times))
    return WeightedCycles(np.array([len(word) for word in every]), time, growth, np.ones(len(every)))


def assert_covered(data, name, exact, least=0.0):
    """The value is exact within its error, which is no larger than said."""
    error = data[f"{name}_error"].to_numpy()
    assert np.all(np.abs(data[name].to_numpy() - exact) <= error), (data[name].to_numpy(), exact, error)
    assert np.all(error < least), error


def test_letters_of_constant_slopes_and_times():
    """1/ζ is 1 − Σ e^(−s T_i)/|Λ_i| and no more: exact at any order, s the root of that by bisection."""
    slopes, times = np.log([2.5, 4.0]), np.array([1.0, 1.7])
    low, high = -2.0, 2.0
    for _ in range(100):
        s = 0.5 * (low + high)
        low, high = (s, high) if np.sum(np.exp(-s * times - slopes)) > 1.0 else (low, s)
    weights = np.exp(-s * times - slopes)
    exact = -s, weights @ slopes / (weights @ times), weights @ times
    cycles = cycles_of(6, slopes, times)
    np.testing.assert_allclose(truncated_averages(cycles, range(1, 7)), np.tile(exact, (6, 1)), rtol=1e-12)
    averages = cycle_averages(cycles, 6)
    np.testing.assert_allclose(averages.mean, exact, rtol=1e-12)
    assert np.all(averages.error < 1e-10)


def test_errors_of_orbits_that_are_missing():
    """Without the longest words the error is larger, and has the exact value; of three orders nothing is said."""
    cycles = cycles_of(6, np.log([2.0, 2.0]))
    fewer = WeightedCycles(*(leaf[:-2] for leaf in cycles))
    more = fewer._replace(number=np.where(fewer.returns == 6, 9 / 7, 1.0))
    averages = cycle_averages(fewer, 6, [more])
    assert abs(averages.mean[0]) > 0.01
    assert np.all(np.abs(averages.mean - [0.0, np.log(2), 1.0]) <= averages.error)
    assert np.isnan(cycle_averages(cycles_of(3, np.log([2.0, 2.0])), 3).mean).all()


def test_the_skew_tent_map():
    """Its exponent is −a ln a − (1 − a) ln(1 − a), to rounding; that in time is a mean of independent letters."""
    a = np.array([0.3, 0.45])
    options = jaxnh.Orbits(max_period=5, transient=64, attractor=1024, averages=True)
    counts = jaxnh.Session(skew_tent, start={"x": 0.37}).groups({"orbits": options}, a=a)["orbit_counts"]
    exact = -a * np.log(a) - (1 - a) * np.log(1 - a)
    assert_covered(counts, "cycle_escape_rate", 0.0, ROUNDING)
    assert_covered(counts, "cycle_exponent", exact, ROUNDING)
    assert_covered(counts, "motion_exponent", exact, 0.1)
    assert counts["motion_return_time"].to_numpy().tolist() == [1.0, 1.0]


def test_the_skew_tent_map_when_it_is_open():
    """ln(stretch) is the escape rate, and the exponent is larger by it than that of the closed map."""
    options = jaxnh.Orbits(max_period=4, n_starts=32, box={"x": (0.0, 1.0)}, averages=True)
    counts = jaxnh.Session(skew_tent, start={"x": 0.37}).groups({"orbits": options}, stretch=1.5)["orbit_counts"]
    entropy = -0.3 * np.log(0.3) - 0.7 * np.log(0.7)
    assert_covered(counts, "cycle_escape_rate", np.log(1.5), ROUNDING)
    assert_covered(counts, "cycle_exponent", np.log(1.5) + entropy, ROUNDING)
    assert "motion_exponent" not in counts


def truncated_zero(above, below, limit):
    """The logarithm of the least positive zero of a ratio of polynomials in z, expanded to so many powers."""
    above, series = np.append(above, np.zeros(limit)), np.zeros(limit + 1)
    for k in range(limit + 1):
        series[k] = above[k] - sum(below[j] * series[k - j] for j in range(1, min(k, len(below) - 1) + 1))
    zeros = np.roots(series[::-1])
    return np.log(np.min(zeros[(np.abs(zeros.imag) < 1e-12) & (zeros.real > 0.0)].real))


def test_the_logistic_map():
    """1/ζ = (1 − z)(1 − z/4)/(1 − z/2): the weight of the origin is 1/4, of all else 2⁻ⁿ. The exponent is ln 2."""
    options = jaxnh.Orbits(max_period=7, transient=64, attractor=1024, averages=True)
    counts = jaxnh.Session(logistic, start={"x": 0.3}).groups({"orbits": options})["orbit_counts"]
    exact = truncated_zero(np.polymul([-1.0, 1.0], [-0.25, 1.0])[::-1], np.array([1.0, -0.5]), 7)
    assert abs(float(counts["cycle_escape_rate"]) - exact) < 1e-9
    assert_covered(counts, "cycle_escape_rate", 0.0, 0.1)
    assert_covered(counts, "cycle_exponent", np.log(2), 0.2)
    assert_covered(counts, "motion_exponent", np.log(2), 0.05)


def test_the_cat_map():
    """Of |det(Aⁿ − 1)| = Λⁿ + Λ⁻ⁿ − 2 points each with the weight Λ⁻ⁿ: 1/ζ = (1 − z)(1 − z/Λ²)/(1 − z/Λ)²."""
    options = jaxnh.Orbits(max_period=5, averages=True)
    counts = jaxnh.Session(cat, start={"x": 0.3, "y": 0.1}).groups({"orbits": options})["orbit_counts"]
    large = (3 + np.sqrt(5)) / 2
    above, below = np.polymul([-1.0, 1.0], [-(large**-2), 1.0]), np.polymul([-1 / large, 1.0], [-1 / large, 1.0])
    exact = truncated_zero(above[::-1], below[::-1], 5)
    assert abs(float(counts["cycle_escape_rate"]) - exact) < 1e-9
    assert_covered(counts, "cycle_escape_rate", 0.0, 0.5)
    assert_covered(counts, "cycle_exponent", np.log(large), 0.5)


def test_where_there_are_no_averages():
    """A stable orbit has its multipliers, and no cycle expansion; what is not asked for is not there."""
    session = jaxnh.Session(logistic, start={"x": 0.3})
    stable = session.groups({"orbits": jaxnh.Orbits(max_period=4, averages=True)}, r=3.2)["orbit_counts"]
    assert np.isnan(stable["cycle_exponent"]).all()
    assert "motion_exponent" not in stable
    assert "cycle_exponent" not in session.groups({"orbits": jaxnh.Orbits(max_period=2)}, r=3.9)["orbit_counts"]
    with pytest.raises(InputError, match="cycle_exponent is what orbits calls a number of its own"):
        jaxnh.Session(named_like_an_average, start={"cycle_exponent": 0.3}).run(jaxnh.Orbits())


@pytest.mark.slow
@pytest.mark.parametrize("limit", [6, 8])
def test_errors_of_averages_over_attractors_that_are_not_hyperbolic(limit):
    """Of the logistic map in chaos: the escape rate is zero, and the exponent that of long averages."""
    r = np.random.default_rng(5).uniform(3.6, 4.0, 100)
    session = jaxnh.Session(logistic, start={"x": 0.3})
    options = jaxnh.Orbits(max_period=limit, attractor=4096, averages=True)
    groups = session.groups({"orbits": options, "lyapunov": jaxnh.Lyapunov(periods=65536)}, r=r)
    counts, exact = groups["orbit_counts"], groups["lyapunov"]
    exponent, bar = exact["exponents"].to_numpy()[:, 0], exact["exponents_error"].to_numpy()[:, 0]
    chaotic = (exponent > 5 * bar) & np.isfinite(counts["cycle_exponent"].to_numpy())
    assert chaotic.sum() > 70
    least = 0.95 - 3 * np.sqrt(0.95 * 0.05 / chaotic.sum())
    values = {name: counts[name].to_numpy()[chaotic] for name in counts if counts[name].shape == chaotic.shape}
    exponent, bar = exponent[chaotic], bar[chaotic]
    assert np.mean(np.abs(values["cycle_escape_rate"]) <= values["cycle_escape_rate_error"]) >= least
    assert np.mean(np.abs(values["cycle_exponent"] - exponent) <= values["cycle_exponent_error"] + bar) >= least
    assert np.mean(np.abs(values["motion_exponent"] - exponent) <= values["motion_exponent_error"] + bar) >= least


@pytest.mark.slow
def test_averages_over_lorenzs_attractor():
    """The exponent is that of `lyapunov` in time, the escape rate zero, the time between returns that of the motion."""
    start = {"x": 1.0, "y": 1.0, "z": 20.0}
    section = jaxnh.Session(lorenz, start=start, target=1e-9).on(coordinate="z", value=27.0, direction="down")
    options = jaxnh.Orbits(max_period=8, attractor=4096, averages=True)
    counts = section.groups({"orbits": options})["orbit_counts"]
    spectrum = jaxnh.Session(lorenz, start=start, target=1e-9).run(jaxnh.Lyapunov(periods=20000, exponents=1))
    exponent, bar = float(spectrum["exponents"][0]), float(spectrum["exponents_error"][0])
    assert_covered(counts, "cycle_escape_rate", 0.0, 0.2)
    for name in ("cycle_exponent", "motion_exponent"):
        assert abs(float(counts[name]) - exponent) <= float(counts[f"{name}_error"]) + bar
    apart = float(counts["cycle_return_time"] - counts["motion_return_time"])
    assert abs(apart) <= float(counts["cycle_return_time_error"] + counts["motion_return_time_error"])
