"""Escape rates, mean lifetimes, exponents and dimensions of saddles that are known in closed form."""

from __future__ import annotations

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.transients.crisis_scaling import fit_crisis
from jaxnh.analyses.transients.lifetimes import escape_rate
from jaxnh.analyses.transients.saddle import saddle_dimension
from jaxnh.exceptions import InputError
from tests.flows.lorenz import lorenz

pytestmark = pytest.mark.usefixtures("always_shared_programs")
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
    ours, error = data[name], data[f"{name}_error"]
    if "exponent" in ours.dims:
        ours, error = ours.isel(exponent=0), error.isel(exponent=0)
    return np.mean(np.abs(ours - exact) <= error + 1e-12)


def test_the_open_tent_map():
    """κ = ln(3/2), λ = ln 3, D = ln 2/ln 3: the saddle is Cantor's set."""
    options = jaxnh.Transients(n_starts=2048, box={"x": (0.0, 1.0)})
    session = jaxnh.Session(open_tent, start={"x": 0.3})
    data = session.run(options, repetition=np.arange(100.0))
    assert covers(data, "escape_rate", np.log(1.5)) >= LEAST
    assert covers(data, "mean_lifetime", 3.0) >= LEAST
    assert covers(data, "saddle_exponents", np.log(3.0)) == 1.0
    assert covers(data, "saddle_dimension", np.log(2) / np.log(3)) >= LEAST
    assert gaps_met(data["x_points"].to_numpy(), 2) == 0  # each stays for two periods more at least
    assert data["escaped"].all()


def gaps_met(points, order):
    """Number of points in gaps of Cantor's set up to an order, each of which is left by one iterate more."""
    met = 0
    for _ in range(order):
        met += np.sum((points > 1 / 3) & (points < 2 / 3))
        points = 3.0 * np.minimum(points, 1.0 - points)
    return met


def test_points_by_stagger_and_step():
    """All are in Cantor's set to the order of the lives that are asked for, half of them on either side: it is full.

    Lanes are independent, and points come from so few starts that none stays for long by itself.
    """
    options = jaxnh.Transients(n_starts=64, box={"x": (0.0, 1.0)}, saddle_points=256)
    session = jaxnh.Session(open_tent, start={"x": 0.3})
    data = session.run(options, repetition=np.arange(4.0))
    points = data["x_points"].to_numpy()
    assert points.shape == (4, 256)
    assert np.isfinite(points).all()
    assert gaps_met(points, 2) == 0  # sixteen of 64 starts stay for three iterates: 28 are expected to
    # Letters are free of each other: their mean is known to 1/(2 √1024).
    assert abs(np.mean(points < 0.5) - 0.5) < 4 / (2 * np.sqrt(points.size))
    alone = session.run(options, repetition=[0.0])
    np.testing.assert_array_equal(alone["x_points"].to_numpy()[0], points[0])
    assert session.run(options.model_copy(update={"saddle_points": 0}), repetition=[0.0]).sizes["point"] == 1024


def two_tents(left=3.0, right=5.0, repetition=0.0):
    """In each coordinate a tent map: two directions grow, and a motion has left where either coordinate has."""
    del repetition

    def tent(x, slope):
        return jnp.where(x < 0.5, slope * x, slope * (1.0 - x))

    return {"map": lambda y: (tent(y[0], left), tent(y[1], right)), "coordinates": ("x", "y")}


def gaps_of_tents(points, slope, order):
    """Number of points that a tent map of this slope takes out of (0, 1) within so many iterates more."""
    met = 0
    for _ in range(order):
        met += np.sum((points > 1.0 / slope) & (points < 1.0 - 1.0 / slope))
        points = slope * np.minimum(points, 1.0 - points)
    return met


@pytest.mark.slow  # saddles with one are quick
def test_points_of_a_saddle_with_two_unstable_directions():
    """Of 64 starts none stays for five iterates, and all points stay for eight, of slopes that differ as well."""
    options = jaxnh.Transients(n_starts=64, box={"x": (0.0, 1.0), "y": (0.0, 1.0)}, saddle_points=64)
    data = jaxnh.Session(two_tents, start={"x": 0.3, "y": 0.2}).run(options, repetition=[0.0])
    assert data["lifetime"].max() <= 5
    assert data["x_points"].shape == (1, 64)
    for name, slope in (("x_points", 3.0), ("y_points", 5.0)):
        points = data[name].to_numpy()
        assert np.isfinite(points).all()
        assert gaps_of_tents(points, slope, 7) == 0


@pytest.mark.slow
def test_a_saddle_with_two_unstable_directions():
    """κ = 2 ln 1.1, λ = ln 2.2 twice, D = 2 ln 2/ln 2.2, that of the product of two sets of Cantor's kind."""
    options = jaxnh.Transients(n_starts=2048, box={"x": (0.0, 1.0), "y": (0.0, 1.0)})
    session = jaxnh.Session(two_tents, start={"x": 0.3, "y": 0.2})
    data = session.run(options, left=2.2, right=2.2, repetition=np.arange(100.0))
    assert covers(data, "escape_rate", 2 * np.log(1.1)) >= LEAST
    assert np.all(np.abs(data["saddle_exponents"] - np.log(2.2)) <= data["saddle_exponents_error"] + 1e-12)
    assert covers(data, "saddle_dimension", 2 * np.log(2) / np.log(2.2)) >= LEAST


def four_rectangles(repetition=0.0):
    """Four of 0.45 by 0.4, no two of them side by side, each stretched over the square.

    The saddle is what contractions by 0.45 and 0.4 keep. Its shadow along y is full, as no two words of the shifts 0,
    0.05, 0.5 and 0.55 meet (a polynomial of whole coefficients with the root 9/20 has one that 20 divides; Hochman, Ann.
    Math. 180 (2014) 773), so that D = 1 + (ln 4 + ln 0.45)/ln 2.5 (Ledrappier and Young, Ann. Math. 122 (1985) 540).
    """
    del repetition

    def image(s):
        x, y = s
        upper = y > 0.5
        x = x - jnp.where(upper, 0.05, 0.0)
        return (x - jnp.where(x > 0.475, 0.5, 0.0)) / 0.45, (y - jnp.where(upper, 0.6, 0.0)) / 0.4

    return {"map": image, "coordinates": ("x", "y")}


@pytest.mark.slow
def test_a_saddle_whose_directions_grow_at_two_rates():
    """κ = −ln 0.72, λ = ln 2.5 and −ln 0.45: the slower direction is filled, and the faster one in part."""
    options = jaxnh.Transients(n_starts=2048, box={"x": (0.0, 1.0), "y": (0.0, 1.0)}, saddle_points=64)
    data = jaxnh.Session(four_rectangles, start={"x": 0.3, "y": 0.2}).run(options, repetition=np.arange(100.0))
    assert covers(data, "escape_rate", -np.log(0.72)) >= LEAST
    exact = np.array([np.log(2.5), -np.log(0.45)])
    assert np.all(np.abs(data["saddle_exponents"] - exact) <= data["saddle_exponents_error"] + 1e-12)
    assert covers(data, "saddle_dimension", 1.0 + (np.log(4.0) + np.log(0.45)) / np.log(2.5)) >= LEAST
    x, y = data["x_points"].to_numpy(), data["y_points"].to_numpy()
    for _ in range(8):
        upper = y > 0.5
        x = x - np.where(upper, 0.05, 0.0)
        right = x > 0.475
        x, y = (x - np.where(right, 0.5, 0.0)) / 0.45, (y - np.where(upper, 0.6, 0.0)) / 0.4
        assert np.all((x >= 0.0) & (x <= 1.0) & (y >= 0.0) & (y <= 1.0))


def repelling_cycle(fast=0.05, slow=0.03, repetition=0.0):
    """The unit circle, from which motions part along x and along y, at two rates: 2π times these in a turn."""
    del repetition

    def rhs(s, t):
        u, v, x, y = s
        inward = 1.0 - u**2 - v**2
        return inward * u - v, inward * v + u, fast * x, slow * y

    return {"rhs": rhs, "coordinates": ("u", "v", "x", "y"), "time_unit": 2 * jnp.pi}


@pytest.mark.slow
def test_a_saddle_on_a_section():
    """κ is the sum of both rates, as the share of motions that stay is the product of two; D = 0.

    Of the first crossing, which comes soon, nothing is counted: from it on evenly spread motions take a whole turn.
    """
    box = {"x": (-1.0, 1.0), "y": (-1.0, 1.0)}
    options = jaxnh.Transients(n_starts=4096, box=box, transient=1)
    session = jaxnh.Session(repelling_cycle, start={"u": 1.0, "v": -0.1, "x": 0.3, "y": 0.2}, target=1e-7)
    data = session.on(coordinate="v", value=0.0, direction="up").run(options, repetition=np.arange(2.0))
    turn, least = 2 * np.pi, 1.0
    assert covers(data, "escape_rate", 0.08 * turn) >= least
    exact = turn * np.array([0.05, 0.03, -2.0])
    assert np.all(np.abs(data["saddle_exponents"] - exact) <= data["saddle_exponents_error"] + 1e-12)
    assert covers(data, "saddle_dimension", 0.0) >= least


@pytest.mark.slow
def test_an_open_map_of_two_slopes():
    """κ = −ln(1/a + 1/c); branches are taken with weights 1/a and 1/c, and so λ is a mean that scatters."""
    options = jaxnh.Transients(box={"x": (0.0, 1.0)})
    data = jaxnh.Session(open_tent, start={"x": 0.3}).run(options, left=2.5, right=4.0, repetition=np.arange(1000.0))
    rate, exponent = -np.log(0.65), (0.4 * np.log(2.5) + 0.25 * np.log(4.0)) / 0.65
    least = 0.95 - 3 * np.sqrt(0.95 * 0.05 / 1000)
    assert covers(data, "escape_rate", rate) >= least
    assert covers(data, "saddle_exponents", exponent) >= least
    assert covers(data, "saddle_dimension", 1.0 - rate / exponent) >= least


def open_shift(repetition=0.0):
    """Intervals A = (0, 0.45), taken to all of (0, 1), and B = (0.55, 1), to (−1.05, 0.45): letters without BB."""
    del repetition

    def image(y):
        (x,) = y
        return jnp.where(x < 0.45, x / 0.45, jnp.where(x > 0.55, 0.45 - (x - 0.55) / 0.3, -9.0))

    return {"map": image, "coordinates": "x"}


STAYS = 0.225 + np.sqrt(0.225**2 + 0.45 * 0.3)
"""The root of μ² = 0.45 μ + 0.45 · 0.3, the share of motions of `open_shift` that stays."""

OF_A = 1.0 / (1.0 + 0.45 * 0.3 / STAYS**2)
"""The share of A in its natural measure: after A comes B with the chance 0.45 · 0.3/μ², as what is left is less there."""


@pytest.mark.slow
def test_averages_where_letters_are_not_free():
    """κ = −ln μ, λ from the shares of A and B. Points by stagger and step have too few in A, and averages do not."""
    options = jaxnh.Transients(n_starts=1 << 14, box={"x": (0.0, 1.0)}, saddle_points=512)
    data = jaxnh.Session(open_shift, start={"x": 0.3}).run(options, repetition=np.arange(100.0))
    rate, exponent = -np.log(STAYS), -OF_A * np.log(0.45) - (1.0 - OF_A) * np.log(0.3)
    assert covers(data, "escape_rate", rate) >= LEAST
    assert covers(data, "saddle_exponents", exponent) >= LEAST
    assert covers(data, "saddle_dimension", 1.0 - rate / exponent) >= LEAST
    points = data["x_points"].to_numpy()
    points = points[np.isfinite(points)]
    assert points.size > 50000
    assert np.all((points < 0.45) | (points > 0.55))
    assert np.mean(points < 0.5) < OF_A - 0.01


def moved_baker(repetition=0.0):
    """Three strips of the square, stretched by 3 and put above each other but for the middle one, which leaves it.

    The field moves the square by 0.1 until t = 1/2, when the state jumps, and back afterwards.
    """
    del repetition

    def rhs(y, t):
        speed = 0.1 * jnp.pi * jnp.sin(2 * jnp.pi * t)
        return speed, speed

    def fold(y, t):
        x, z = y[0] - 0.1, y[1] - 0.1
        first = x < 0.5
        return 0.1 + 3.0 * jnp.where(first, x, 1.0 - x), 0.1 + jnp.where(first, 0.25 * z, 1.0 - 0.25 * z)

    def half(y, t):
        return -jnp.sin(2 * jnp.pi * t)

    return {
        "rhs": rhs,
        "coordinates": ("x", "z"),
        "period": 1.0,
        "jumps": [{"when": half, "direction": "up", "then": fold}],
    }


@pytest.mark.slow  # a flow with a saddle and a map with two exponents are quick
def test_a_flow_with_two_exponents():
    """κ = ln(3/2), λ = ln 3 and −ln 4, D = ln 2/ln 3 + ln 2/ln 4, of a square that is folded as it moves."""
    options = jaxnh.Transients(n_starts=2048, box={"x": (0.0, 1.0), "z": (0.0, 1.0)}, saddle_points=64)
    session = jaxnh.Session(moved_baker, start={"x": 0.3, "z": 0.2}, target=1e-6)
    data = session.run(options, repetition=np.arange(4.0))
    assert covers(data, "escape_rate", np.log(1.5)) >= 0.75
    apart = np.abs(data["saddle_exponents"] - np.array([np.log(3.0), -np.log(4.0)]))
    assert np.all(apart <= data["saddle_exponents_error"] + 1e-12)
    assert covers(data, "saddle_dimension", np.log(2) / np.log(3) + 0.5) >= 0.75
    assert gaps_met(data["x_points"].to_numpy(), 3) == 0
    # It was in one of two strips a period before; to half of the eleven periods that points stay, 3⁻⁵ of the square.
    assert np.all(np.abs(data["z_points"] - 0.5) > 0.25 - 3.0**-5)


@pytest.mark.slow
def test_mean_lifetimes_of_a_flow_that_folds():
    """95 of 100 bars have it, and those of the dimension."""
    options = jaxnh.Transients(n_starts=2048, box={"x": (0.0, 1.0), "z": (0.0, 1.0)})
    session = jaxnh.Session(moved_baker, start={"x": 0.3, "z": 0.2}, target=1e-6)
    data = session.run(options, repetition=np.arange(100.0))
    assert covers(data, "mean_lifetime", 3.0) >= LEAST
    assert covers(data, "saddle_dimension", np.log(2) / np.log(3) + 0.5) >= LEAST


@pytest.mark.parametrize(
    ("rate", "exponents", "exact"),
    [
        (np.log(1.5), [np.log(3.0)], np.log(2) / np.log(3)),
        (0.0, [0.9, 0.0, -14.5], 2.0 + 0.9 / 14.5),  # of an attractor that of Kaplan and Yorke
        (0.3, [1.0, 0.2, -2.0], 1.0 + 0.7 / 1.0 + 0.9 / 2.0),  # the slower of two that grow is full
        (1.1, [1.0, 0.2, -2.0], 0.1 / 0.2 + 0.1 / 2.0),
        (0.5, [0.4, -1.0], 0.0),
    ],
)
def test_dimensions_from_exponents(rate, exponents, exact):
    """The formula of Hunt, Ott and Yorke, filled in by hand; without entropy there is a point."""
    assert saddle_dimension(np.array([rate]), np.array([exponents])) == pytest.approx(exact, abs=1e-14)


@pytest.mark.slow  # the matrix has transients of flows
def test_a_flow_with_a_saddle():
    """κ = λ = rate, so that D = 0; followed for 16 periods, when one motion in 120 is left: its lifetime is censored."""
    options = jaxnh.Transients(
        n_starts=1024, box={"x": (-1.0, 1.0), "y": (-1.0, 1.0)}, region={"x": (-1.0, 1.0)}, max_periods=16, transient=0
    )
    session = jaxnh.Session(repelling_line, start={"x": 0.3, "y": 0.1}, target=1e-7)
    data = session.run(options, repetition=np.arange(100.0))
    assert covers(data, "escape_rate", 0.3) >= LEAST
    assert covers(data, "mean_lifetime", 1.0 / -np.expm1(-0.3)) >= LEAST
    assert covers(data, "saddle_exponents", 0.3) >= LEAST
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


@pytest.mark.parametrize("beside", [0.0, 0.2])
def test_rates_where_some_starts_are_beside_the_saddle(beside):
    """So many leave after some forty periods, and the others with the chance 1/1500: 95 of 100 intervals have that.

    Escapes are counted from where their rate is steady: beyond the given transient where some are beside the saddle.
    """
    draws, count, chance = np.random.default_rng(4), 1000, 1 / 1500
    sooner = draws.random((count, 512)) < beside
    life = np.where(sooner, np.rint(draws.normal(40.0, 8.0, sooner.shape)), draws.geometric(chance, sooner.shape))
    rate = escape_rate(np.minimum(life, 4096).astype(int), life <= 4096, 8)
    share = np.mean((rate.mean[1] <= 1.0 / chance) & (1.0 / chance <= rate.mean[2]))
    assert share >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / count)
    assert np.mean(rate.transient == (64 if beside else 8)) > 0.9


@jax.jit
def advanced(y, loops, rho):
    """Lorenz's motions 64 units of time later by Runge and Kutta's steps, and how often each has passed z = 21 downwards."""

    def rates(y):
        x, v, z = y
        return jnp.stack([10.0 * (v - x), rho * x - v - x * z, x * v - 8.0 / 3.0 * z])

    def step(_, now):
        y, loops = now
        h = 0.005
        k1 = rates(y)
        k2 = rates(y + 0.5 * h * k1)
        k3 = rates(y + 0.5 * h * k2)
        k4 = rates(y + h * k3)
        after = y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        passes = (y[2] > 21.0) & (after[2] <= 21.0)
        return after, loops + passes.astype(loops.dtype)

    return jax.lax.fori_loop(0, 12_800, step, (y, loops))


@pytest.mark.slow
def test_the_life_of_lorenz_chaos_below_its_crisis():
    """Mean returns that motions have before them, at rho = 23.5, beside those counted of another integration.

    A fifth of the starts come to rest within a hundred returns, beside the saddle.
    """
    box = {"x": (-20.0, 20.0), "y": (-20.0, 20.0), "z": (5.0, 40.0)}
    session = jaxnh.Session(lorenz, start={"x": 1.0, "y": 1.0, "z": 20.0}, target=1e-6)
    session = session.on(coordinate="z", value=21.0, direction="down")
    data = session.run(jaxnh.Transients(n_starts=512, box=box, max_periods=4096), rho=[23.5]).isel(rho=0)
    draws = np.random.default_rng(1)
    y = jnp.array([draws.uniform(*ends, 1024) for ends in box.values()])
    loops, alive, at_risk, turns = jnp.zeros(1024, int), np.ones(1024, bool), 0, []
    for window in range(64):
        y, after = advanced(y, loops, 23.5)
        turned = np.asarray(after - loops)
        before, alive, loops = alive, alive & (turned > 0), after
        if window == 4:
            first = before.sum()
        if window >= 4:
            at_risk, turns = at_risk + (before.sum() + alive.sum()) / 2, [*turns, turned[alive].mean()]
    escapes = first - alive.sum()
    mean, error = at_risk * np.mean(turns) / escapes, 2.0 * at_risk * np.mean(turns) / escapes**1.5
    assert data["counted_from"] > 9
    assert abs(data["mean_lifetime"] - mean) < np.hypot(
        error, (data["mean_lifetime_high"] - data["mean_lifetime_low"]) / 2
    )


def horseshoe_words(limit):
    """All primitive cyclic words of two signs up to a length."""
    for n in range(1, limit + 1):
        for word in product((1.0, -1.0), repeat=n):
            turned = [word[i:] + word[:i] for i in range(n)]
            if min(turned) == word and len(set(turned)) == n:
                yield np.array(word)


def horseshoe_multiplier(signs, a, b):
    """The modulus of the larger multiplier of the cycle of these signs of x, x² = (1 + b x₋₁ − x₊₁)/a."""
    x = signs / np.sqrt(a)
    for _ in range(200):
        x = signs * np.sqrt((1.0 + b * np.roll(x, 1) - np.roll(x, -1)) / a)
    matrix = np.eye(2)
    for value in x:
        matrix = np.array([[-2.0 * a * value, 1.0], [b, 0.0]]) @ matrix
    return np.abs(np.linalg.eigvals(matrix)).max()


def horseshoe_averages(limit, a=6.0, b=0.4):
    """Escape rate and exponent of Henon's horseshoe by expansion over its cycles, to so many iterates.

    The zero of Π (1 − zⁿ |Λ|^(β − 1)) nearest to 0 is e^(−P(β)), with κ = −P(0) and λ = P′(0).
    """
    cycles = [(len(word), np.log(horseshoe_multiplier(word, a, b))) for word in horseshoe_words(limit)]

    def pressure(beta):
        series = np.eye(1, limit + 1)[0]
        for n, growth in cycles:
            factor = np.zeros(limit + 1)
            factor[0], factor[n] = 1.0, -np.exp((beta - 1.0) * growth)
            series = np.convolve(series, factor)[: limit + 1]
        zeros = np.roots(series[::-1])
        return -np.log(np.min(zeros[(np.abs(zeros.imag) < 1e-9) & (zeros.real > 0.0)].real))

    return -pressure(0.0), (pressure(1e-4) - pressure(-1e-4)) / 2e-4


def test_henons_horseshoe():
    """At a = 6, b = 0.4 it is hyperbolic with all words of two letters (Devaney and Nitecki 1979): by its cycles."""
    a, b = 6.0, 0.4
    rate, exponent = horseshoe_averages(9)
    assert np.abs(np.subtract(horseshoe_averages(8), (rate, exponent))).max() < 1e-4
    options = jaxnh.Transients(n_starts=1 << 17, box={"x": (-0.6, 0.6), "y": (-0.25, 0.25)}, saddle_points=256)
    data = jaxnh.Session(open_henon, start={"x": 0.1, "y": 0.1}).run(options, a=[a], b=[b]).squeeze()
    exponents = np.array([exponent, np.log(b) - exponent])
    entropy = exponent - rate
    exact = entropy / exponent + entropy / -exponents[1]
    assert float(data["escape_rate_low"]) <= rate <= float(data["escape_rate_high"])
    assert np.all(np.abs(data["saddle_exponents"] - exponents) <= data["saddle_exponents_error"])
    assert abs(float(data["saddle_dimension"]) - exact) <= float(data["saddle_dimension_error"]) < 0.2
    # Points of a horseshoe stay on either side of the gap that its turn has left, and were there an iterate before.
    x, before = data["x_points"].to_numpy(), data["y_points"].to_numpy() / b
    outer = (1.0 + b + np.sqrt((1.0 + b) ** 2 + 4.0 * a)) / (2.0 * a)
    inner = np.sqrt((1.0 - (1.0 + b) * outer) / a)
    for side in (np.abs(x), np.abs(before)):
        assert np.all((side > inner - 1e-3) & (side < outer + 1e-3))  # vectors are e^(−7.5) long at most


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
    options = jaxnh.Transients(
        box={"x": (-1.5, 1.5), "y": (-0.4, 0.4)}, region={"x": (-3.0, 3.0), "y": (-3.0, 3.0)}, saddle_points=1024
    )
    data = jaxnh.Session(open_henon, start={"x": 0.1, "y": 0.1}).run(options, a=2.0 + 1e-9 * np.arange(4))
    points, logs = stagger_and_step(12000)
    blocks = logs.reshape(24, -1).mean(axis=1)
    exponent, bar = blocks.mean(), 2.07 * blocks.std(ddof=1) / np.sqrt(24)
    first, error = (data[name].isel(exponent=0) for name in ("saddle_exponents", "saddle_exponents_error"))
    assert np.all(np.abs(first - exponent) <= error + bar)
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
