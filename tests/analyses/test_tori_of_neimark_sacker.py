"""Tori that Neimark–Sacker points begin, in closed form, where no lane comes near the orbit or the torus.

All are the normal form r -> r (1 + ...) by theta + b r^2 turns, in coordinates bent by b -> b + shear a^2 or others.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxnh
from tests.flows.tori import TURN, turned
from tests.helpers.torus_branches import branch, ends, follow

pytestmark = pytest.mark.usefixtures("quick_compiling", "always_shared_programs")

TURNS, BETA, SHEAR = 0.2345, 0.3, 0.4
EXACT = 1e-9  # of invariant curves, in sizes of order one: Newton's last step, squared, and rounding over a weak growth


def normal_form(mu=0.1, sign=-1.0, rate=1.0, turns=0.2345, quadratic=0.0):
    """r -> r (1 + rate mu + sign r^2), with a term that makes it resonant about a third of a turn."""

    def image(y):
        a, b = y[0], y[1] - SHEAR * y[0] * y[0]
        square = a * a + b * b
        p, q = turned(a, b, TURN * (turns + BETA * square), 1.0 + rate * mu + sign * square)
        a, b = p + quadratic * (a * a - b * b), q - 2.0 * quadratic * a * b
        return a, b + SHEAR * a * a

    return {"map": image, "coordinates": ("a", "b")}


def narrow_arch(c=0.0, half=0.02, rate=0.2):
    """r -> r (1 + rate (half^2 - c^2 - r^2)): tori for |c| < half alone."""

    def image(y):
        a, b = y[0], y[1] - SHEAR * y[0] * y[0]
        square = a * a + b * b
        a, b = turned(a, b, TURN * (TURNS + 0.1 * square + 0.05 * c), 1.0 + rate * (half * half - c * c - square))
        return a, b + SHEAR * a * a

    return {"map": image, "coordinates": ("a", "b")}


def alternating_arch(c=0.0, half=0.3, shift=0.5, rate=0.5):
    """The same about the orbit of period 2 of s -> -s (1.3 - 0.3 s^2), which rests in the coordinate b."""

    def image(y):
        a, b, s = y[0] - shift * y[2], y[1], y[2]
        square = a * a + b * b
        a, b = turned(a, b, TURN * (0.1234 + 0.2 * square), 1.0 + rate * (half * half - c * c - square))
        s = -s * (1.3 - 0.3 * s * s)
        return a + shift * s, b, s

    return {"map": image, "coordinates": ("a", "b", "s")}


def above_saddle(mu=0.1, grown=1.5):
    """The normal form beside a direction in which all motions go to infinity."""

    def image(y):
        square = y[0] * y[0] + y[1] * y[1]
        a, b = turned(y[0], y[1], TURN * (TURNS + BETA * square), 1.0 + mu - square)
        return a, b, grown * y[2] + 0.1 * y[0] * y[0]

    return {"map": image, "coordinates": ("a", "b", "z")}


def narrow_hopf(c=0.0, half=0.02):
    """Hopf's normal form with the eigenvalues half^2 - c^2 +- 1.3i: cycles for |c| < half alone."""

    def rhs(y, t):
        grown = half * half - c * c - y[0] * y[0] - y[1] * y[1]
        return grown * y[0] - 1.3 * y[1], 1.3 * y[0] + grown * y[1]

    return {"rhs": rhs, "coordinates": ("x", "y")}


def langford(a=0.8, f=0.0):
    """Langford's flow (Hopf bifurcations to tori, 1984), with an axis for f = 0."""

    def rhs(y, t):
        u, v, z = y
        rise = 0.6 + a * z - z**3 / 3 - (u * u + v * v) * (1 + 0.25 * z) + f * z * u**3
        return (z - 0.7) * u - 3.5 * v, 3.5 * u + (z - 0.7) * v, rise

    return {"rhs": rhs, "coordinates": ("u", "v", "z")}


def cycle_about_axis(a):
    """Duration of the cycle of Langford's flow in (r, z) for f = 0, and the mean of the divergence along it, by DOP853."""

    def rhs(t, y):
        r, z, _ = y
        rise = 0.6 + a * z - z**3 / 3 - r * r * (1 + 0.25 * z)
        return (z - 0.7) * r, rise, (z - 0.7) + a - z * z - 0.25 * r * r

    def upward(t, y):
        return y[1] - 0.7

    upward.direction = 1.0  # pyright: ignore[reportFunctionMemberAccess]
    path = solve_ivp(rhs, (0.0, 600.0), (0.8, 0.5, 0.0), "DOP853", events=upward, rtol=1e-12, atol=1e-12)
    (start, end), (first, last) = path.t_events[0][-2:], path.y_events[0][-2:]
    return end - start, (last[2] - first[2]) / (end - start)


def driven(mu=-0.1, omega=0.7311, drive=0.3):
    """w' = (mu + i omega + |w|^2) w about the forced orbit drive (cos t, sin t)."""

    def rhs(y, t):
        u, v = y[0] - drive * jnp.cos(t), y[1] - drive * jnp.sin(t)
        grown = mu + u * u + v * v
        return grown * u - omega * v - drive * jnp.sin(t), omega * u + grown * v + drive * jnp.cos(t)

    return {"rhs": rhs, "coordinates": ("u", "v"), "period": 2 * jnp.pi}


def unbent(tori):
    """Squared radii of curves of the sheared normal form."""
    a, b = tori["a"].to_numpy(), tori["b"].to_numpy()
    return a * a + (b - SHEAR * a * a) ** 2


def assert_numbers(tori, rotation, growth, blur=1e-6):
    """Rotation numbers, and growths normal to the curves, largest first, are as given within bars that are small.

    Of two growths they are averages over 2048 points, and less exact.
    """
    turns = tori["rotation"].to_numpy()
    assert np.all(np.abs(turns - rotation) <= tori["rotation_error"].to_numpy())
    exact = np.sort(np.reshape(growth, (-1, len(turns))), axis=0)[::-1].T
    assert np.all(np.abs(tori["growth"].to_numpy() - exact) <= tori["growth_error"].to_numpy())
    assert tori["rotation_error"].max() < 1e-7
    assert tori["growth_error"].max() < blur


def test_repelling_torus_that_all_lanes_start_beyond():
    """All lanes go to infinity; Newton goes from their start to the orbit, whose bifurcation at 0 begins the torus."""
    session = jaxnh.Session(normal_form, start={"a": 0.9, "b": 0.1})
    data = follow(session, mu=np.linspace(-0.2, 0.05, 6), sign=np.array([1.0]))
    assert data.sizes["torus_branch"] == 1
    assert ends(data) == [["start"], ["range"]]
    assert abs(float(data["birth"][0])) < 1e-12
    tori = branch(data)
    mu = tori["mu"].to_numpy()
    assert (mu.min(), mu.max() > -1e-3) == (-0.2, True)
    assert np.abs(unbent(tori) + mu[:, None]).max() < EXACT
    assert_numbers(tori, TURNS - BETA * mu, np.log(1.0 - 2.0 * mu))
    assert set(jaxnh.labels(tori["kind"]).to_numpy()) == {"repelling"}


@pytest.mark.parametrize("lanes", [7, 61])
def test_bifurcations_within_a_step_of_the_orbit(lanes):
    """Tori on a seventy-fifth of the range, far from lanes: both points are located, and the branch comes once.

    With more lanes, some of which are still on their way to the orbit, nothing of these is taken for a torus.
    """
    session = jaxnh.Session(narrow_arch, start={"a": 0.02, "b": 0.01})
    data = follow(session, c=np.linspace(-1.463, 1.537, lanes))
    assert data.sizes["torus_branch"] == 1
    assert ends(data) == [["start"], ["collapsed"]]
    assert abs(float(data["birth"][0]) + 0.02) < 1e-12
    tori = branch(data)
    c = tori["c"].to_numpy()
    assert max(c[0], -c[-1]) < -0.019
    square = 0.02**2 - c**2
    assert np.abs(unbent(tori) - square[:, None]).max() < EXACT
    assert_numbers(tori, TURNS + 0.1 * square + 0.05 * c, np.log(1.0 - 0.4 * square))


def test_bifurcations_within_a_step_on_branches():
    """`branches` has both points as well."""
    session = jaxnh.Session(narrow_arch, start={"a": 0.02, "b": 0.01})
    groups = session.groups({"branches": {"max_period": 1}}, c=np.linspace(-1.463, 1.537, 7))
    points = groups["bifurcations"]
    assert jaxnh.labels(points["kind"]).to_numpy().tolist() == ["neimark sacker"] * 2
    assert np.abs(np.sort(points["c"].to_numpy()) - (-0.02, 0.02)).max() < 1e-12
    assert jaxnh.labels(points["criticality"]).to_numpy().tolist() == ["supercritical"] * 2


def test_hopf_points_within_a_step():
    """The same of equilibria; with the cycles that they begin."""
    session = jaxnh.Session(narrow_hopf, start={"x": 0.3, "y": 0.1}).on("y", 0.0, "up")
    asked = {"max_period": 1, "equilibria": 4, "box": {"x": [-0.5, 0.5], "y": [-0.5, 0.5]}}
    groups = session.groups({"branches": asked}, c=np.linspace(-1.463, 1.537, 7))
    points = groups["bifurcations"]
    assert jaxnh.labels(points["kind"]).to_numpy().tolist() == ["hopf"] * 2
    assert np.abs(np.sort(points["c"].to_numpy()) - (-0.02, 0.02)).max() < 1e-12
    assert sorted(groups["branches"]["period"].to_numpy().tolist()) == [0, 1]


def test_coordinate_that_the_orbit_rests_in():
    """Sizes of the orbit are none of its tori; in those of the normal form the branch goes from one end to the other.

    So does that about the fixed point between its points, which repels along s by 1.3 an iterate.
    """
    session = jaxnh.Session(alternating_arch, start={"a": 0.6, "b": 0.1, "s": 1.0})
    data = follow(session, max_period=2, c=np.linspace(-1.0, 1.0, 9))
    assert data["period"].to_numpy().tolist() == [1, 2]
    assert ends(data) == [["start"] * 2, ["collapsed"] * 2]
    saddles = branch(data, 0)
    c = saddles["c"].to_numpy()
    square = 0.3**2 - c**2
    assert_numbers(saddles, 0.1234 + 0.2 * square, [0 * c + math.log(1.3), np.log(1.0 - square)], 2e-3)
    tori = branch(data, 1)
    c = tori["c"].to_numpy()
    square = 0.3**2 - c**2
    assert max(c[0] * c[-1], -0.085) == -0.085
    radius = (tori["a"] - 0.5 * tori["s"]) ** 2 + tori["b"] ** 2
    assert np.abs(radius.to_numpy() - square[:, None]).max() < EXACT
    growth = [2.0 * np.log(1.0 - square), 0 * c + 2.0 * math.log(0.4)]
    assert_numbers(tori, 2.0 * (0.1234 + 0.2 * square), growth, 2e-3)


def test_saddle_torus_that_all_lanes_leave():
    """Motions that go to infinity are no sizes of tori."""
    data = follow(jaxnh.Session(above_saddle, start={"a": 0.1, "b": 0.1}), mu=np.linspace(-0.1, 0.2, 4))
    assert data.sizes["torus_branch"] == 1
    assert abs(float(data["birth"][0])) < 1e-12
    tori = branch(data)
    mu = tori["mu"].to_numpy()
    assert (mu.min() < 1e-3, mu.max()) == (True, 0.2)
    assert np.abs(tori["a"] ** 2 + tori["b"] ** 2 - tori["mu"]).max() < EXACT
    assert_numbers(tori, TURNS + BETA * mu, [0 * mu + math.log(1.5), np.log(1.0 - 2.0 * mu)], 2e-3)
    assert set(jaxnh.labels(tori["kind"]).to_numpy()) == {"saddle"}


def test_repelling_torus_of_a_driven_flow():
    """About a forced orbit, which one lane in six leaves to infinity: over a period 4 pi r^2 of growth, omega turns."""
    session = jaxnh.Session(driven, start={"u": 0.5}, target=1e-8)
    data = follow(session, mu=np.linspace(-0.2, 0.05, 6))
    assert data.sizes["torus_branch"] == 1
    assert abs(float(data["birth"][0])) < 1e-7
    tori = branch(data)
    mu = tori["mu"].to_numpy()
    assert (mu.min(), mu.max() > -1e-3) == (-0.2, True)
    square = (tori["u"] - 0.3) ** 2 + tori["v"] ** 2
    assert np.abs(square + tori["mu"]).max() < 1e-6
    turns, error = tori["rotation"].to_numpy(), tori["rotation_error"].to_numpy()
    assert np.all(np.minimum(np.abs(turns - 0.7311), np.abs(turns - 0.2689)) <= error)  # either sense
    assert np.all(np.abs(tori["growth"][:, 0] + 4.0 * math.pi * mu) <= tori["growth_error"][:, 0])


def test_langford():
    """About an axis: the bifurcation in closed form, and the torus, a cycle that turns, by that cycle alone.

    The cycle at the height z = 0.7 with r^2 (1 + 0.175) = 0.6 + 0.7 a - 0.7^3/3 begins it where a = 0.7^2 + r^2/4.
    """
    session = jaxnh.Session(langford, start={"u": 0.8, "z": 0.5}, target=1e-9).on("v", 0.0, "up")
    data = follow(session, a=np.linspace(0.5, 1.0, 6))
    assert data.sizes["torus_branch"] == 1
    birth = (0.49 + 0.25 * (0.6 - 0.343 / 3) / 1.175) / (1.0 - 0.175 / 1.175)
    assert abs(float(data["birth"][0]) - birth) < 1e-8
    last = branch(data).isel(torus_point=-1)
    assert float(last["a"]) == 1.0
    duration, divergence = cycle_about_axis(1.0)
    turn, rotation = TURN / 3.5, float(last["rotation"])
    assert min(abs(rotation - each) for each in (turn / duration, 1.0 - turn / duration)) <= float(
        last["rotation_error"]
    )
    assert abs(float(last["growth"][0]) - divergence * turn) <= float(last["growth_error"][0])
    assert (float(last["rotation_error"]) < 1e-6, float(last["growth_error"][0]) < 1e-4) == (True, True)


def test_torus_beyond_a_tongue():
    """Beyond 5 turns in 8 tori are those of lanes, whose short motions beside a rational number tell few harmonics."""
    session = jaxnh.Session(langford, start={"u": 0.8, "z": 0.5}, target=1e-8).on("v", 0.0, "up")
    data = follow(session, a=np.linspace(0.5, 1.0, 11), f=np.array([0.05]))
    every = [branch(data, k) for k in range(data.sizes["torus_branch"])]
    value, turns = (np.concatenate([each[name].to_numpy() for each in every]) for name in ("a", "rotation"))
    turns = np.minimum(turns, 1.0 - turns)  # either sense
    beyond = np.flatnonzero(turns < 0.375 - 1e-3)
    value, turns = (number[beyond[np.argsort(value[beyond])]] for number in (value, turns))
    assert value[0] < 0.8 < value[-1]
    lane = float(session.run(jaxnh.Rotation(), a=0.8, f=0.05)["rotation"])
    assert abs(np.interp(0.8, value, turns) - min(lane, 1.0 - lane)) < 1e-4  # between two points of the branch


def test_lanes_that_are_slow_to_settle():
    """The orbit that lanes are still about, on its slow way to or from them, has its bifurcation on the branch."""
    session = jaxnh.Session(normal_form, start={"a": 0.2, "b": 0.1})
    data = follow(session, mu=np.array([-0.01, 0.05, 0.1]), rate=np.array([0.05]))
    assert data.sizes["torus_branch"] == 1
    assert abs(float(data["birth"][0])) < 1e-12
    tori = branch(data)
    mu = 0.05 * tori["mu"].to_numpy()
    assert np.abs(unbent(tori) - mu[:, None]).max() < EXACT
    assert_numbers(tori, TURNS + BETA * mu, np.log(1.0 - 2.0 * mu))


def test_strong_resonance():
    """Beside a third of a turn there are saddles of period 3 in place of a torus: none is begun, and it is said why."""
    session = jaxnh.Session(normal_form, start={"a": 0.05, "b": 0.02})
    fixed = {"turns": np.array([1.0 / 3.0]), "quadratic": np.array([0.3])}
    data = follow(session, mu=np.linspace(-0.1, 0.02, 4), **fixed)
    line = data.attrs["warnings"].splitlines()[0]
    assert line.startswith(
        "torus_branches: no torus is begun in the strong resonance 1:3 of the Neimark–Sacker points at mu = "
    )
    assert abs(float(line.rpartition("= ")[2])) < 1e-12
    assert np.isnan(data["birth"]).all()


@pytest.mark.slow
def test_random_normal_forms():
    """Of both signs, with rates, turns and shears at random: radii, and bars of rotation numbers and growths."""
    session, rng, missed, count = jaxnh.Session(normal_form, start={"a": 0.3, "b": 0.1}), np.random.default_rng(7), 0, 0
    for _ in range(24):
        sign, rate, turns = rng.choice([-1.0, 1.0]), np.exp(rng.uniform(-2.5, 0.0)), rng.uniform(0.02, 0.48)
        if min(abs(turns - 1.0 / q) for q in (2, 3, 4)) < 2e-3:
            continue
        fixed = {"sign": np.array([sign]), "rate": np.array([rate]), "turns": np.array([turns])}
        data = follow(session, mu=rng.uniform(0.01, 0.03) + np.linspace(-0.25, 0.2, 5), **fixed)
        assert data.sizes["torus_branch"] == 1, fixed
        assert abs(float(data["birth"][0])) < 1e-11
        tori = branch(data)
        square = -sign * rate * tori["mu"].to_numpy()
        assert np.abs(unbent(tori) - square[:, None]).max() < EXACT
        exact = {"rotation": turns + BETA * square, "growth": np.log(1.0 + 2.0 * sign * square)}
        for name, value in exact.items():
            number, error = (tori[key].to_numpy().reshape(len(square)) for key in (name, f"{name}_error"))
            missed, count = missed + int(np.sum(np.abs(number - value) > error)), count + len(square)
    assert count > 1000
    assert missed <= 0.01 * count
