"""Branches of tori against closed forms: around a fold, of a doubled orbit, of a flow, and from one bifurcation to the next."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.exceptions import InputError
from tests.flows.tori import GOLDEN, TURN, bent_circle, skew, tube, turned
from tests.helpers.torus_branches import STEPS, branch, ends, follow

pytestmark = pytest.mark.usefixtures("quick_compiling", "always_shared_programs")


def folded(mu=-0.1, rate=0.3, beta=0.3, shear=0.4):
    """r -> r (1 + rate (mu + r^2 - r^4)) by 0.2345 + beta r^2 turns, sheared: its curves turn at mu = -1/4."""

    def image(y):
        a, b = y[0], y[1] - shear * y[0] * y[0]
        square = a * a + b * b
        a, b = turned(a, b, TURN * (0.2345 + beta * square), 1.0 + rate * (mu + square - square * square))
        return a, b + shear * a * a

    return {"map": image, "coordinates": ("a", "b")}


def alternating(mu=0.1, shift=0.5):
    """The normal form about the orbit of period 2 of s -> -s (1.3 - 0.3 s^2), which carries it along with it."""

    def image(y):
        a, b, s = y[0] - shift * y[2], y[1], y[2]
        square = a * a + b * b
        a, b = turned(a, b, TURN * (0.1234 + 0.2 * square), 1.0 + mu - square)
        s = -s * (1.3 - 0.3 * s * s)
        return a + shift * s, b, s

    return {"map": image, "coordinates": ("a", "b", "s")}


def arch(c=0.0, rate=0.2):
    """r -> r (1 + rate (1 - c^2 - r^2)): tori from the bifurcation at c = -1 to that at c = 1."""

    def image(y):
        square = y[0] * y[0] + y[1] * y[1]
        return turned(y[0], y[1], TURN * (0.2345 + 0.1 * square + 0.05 * c), 1.0 + rate * (1.0 - c * c - square))

    return {"map": image, "coordinates": ("a", "b")}


def test_around_a_fold():
    """Tori that repel from a subcritical bifurcation at 0 down to -1/4 and, attracting, back: no lane settles on the first.

    r^2 - r^4 = -mu on both sides, 0.2345 + beta r^2 turns, and ln(1 + rate (2 r^2 - 4 r^4)) normal to the curve.
    """
    session = jaxnh.Session(folded, start={"a": 0.2, "b": 0.1})
    data = follow(session, mu=np.linspace(-0.3, 0.05, 8))
    assert data.sizes["torus_branch"] == 1
    assert ends(data) == [["start"], ["range"]]
    assert abs(float(data["birth"][0])) < 1e-12
    tori = branch(data)
    mu, turns = tori["mu"].to_numpy(), tori["rotation"].to_numpy()
    turn = int(np.argmin(mu))
    assert -0.25 <= mu[turn] < -0.249
    outer = (np.arange(len(mu)) > turn) | ((np.arange(len(mu)) == turn) & (turns > 0.2345 + 0.3 * 0.5))
    root = np.sqrt(np.maximum(np.longdouble(1.0) + 4.0 * np.longdouble(mu), 0.0))
    square = (0.5 + np.where(outer, 0.5, -0.5) * root).astype(float)
    away = np.abs(square - 0.5) > 0.02
    assert np.all(np.abs(turns - 0.2345 - 0.3 * square) <= tori["rotation_error"].to_numpy())
    assert tori["rotation_error"].to_numpy()[away].max() < 1e-8
    growth, error = (tori[name].to_numpy()[:, 0] for name in ("growth", "growth_error"))
    exact = np.log(1.0 + 0.3 * (2.0 * square - 4.0 * square**2))
    # Next to the fold, in bars of the map alone, the growth was up to 90 of them off: the curve is off by more there.
    assert np.all(np.abs(growth - exact) <= error)
    assert error[away].max() < 1e-11
    kinds = jaxnh.labels(tori["kind"]).to_numpy()
    assert set(kinds[: turn - 2]) == {"repelling"}
    assert set(kinds[turn + 2 :]) == {"attracting"}
    a, b = tori["a"].to_numpy(), tori["b"].to_numpy()
    radius = a * a + (b - 0.4 * a * a) ** 2
    assert np.abs(mu[:, None] + radius - radius**2).max() < 1e-10


def test_of_a_doubled_orbit():
    """Of an orbit of period 2 the second iterate carries each curve to itself: twice the turns, and 2 ln(1 - 2 mu)."""
    session = jaxnh.Session(alternating, start={"a": 0.6, "b": 0.1, "s": 1.0})
    data = follow(session, max_period=2, mu=np.linspace(-0.1, 0.2, 7))
    [number] = np.flatnonzero(data["period"].to_numpy() == 2).tolist()
    tori = branch(data, number)
    mu = tori["mu"].to_numpy()
    assert abs(float(data["birth"][number])) < 1e-12
    assert ends(data)[1][number] == "range"
    turns = 2.0 * (0.1234 + 0.2 * mu)
    assert np.all(np.abs(tori["rotation"] - turns) <= tori["rotation_error"])
    growth = np.sort(np.stack([2.0 * np.log(1.0 - 2.0 * mu), 0 * mu + 2.0 * math.log(0.4)]), axis=0)[::-1].T
    assert np.all(np.abs(tori["growth"] - growth) <= tori["growth_error"])
    centre = tori["a"].mean("theta") - 0.5 * tori["s"].mean("theta")
    assert np.abs(centre).max() < 0.01


def test_from_one_bifurcation_to_another():
    """The branch comes once, although both of its ends begin one, and reaches its other end."""
    session = jaxnh.Session(arch, start={"a": 0.2, "b": 0.1})
    data = follow(session, c=np.linspace(-1.5, 1.5, 7))
    assert data.sizes["torus_branch"] == 1
    assert ends(data) == [["start"], ["collapsed"]]
    c = branch(data)["c"].to_numpy()
    assert abs(abs(float(data["birth"][0])) - 1.0) < 1e-12
    assert min(c[0] * c[-1], -0.9) == c[0] * c[-1]  # close to both ends, of either sign


def test_of_lanes_without_a_bifurcation():
    """Beside no bifurcation the tori of lanes' own motions begin the branch; curves that wind are followed likewise."""
    session = jaxnh.Session(skew, start={"x": 0.1})
    data = follow(session, c=np.array([0.5, 0.7, 2.0]))
    assert data.sizes["torus_branch"] == 1
    assert np.isnan(data["birth"]).all()
    tori = branch(data)
    c = tori["c"].to_numpy()
    assert (c.min(), c.max()) == (0.5, 2.0)
    exact = np.imag(np.exp(1j * tori["x"].to_numpy()) / (np.exp(1j * TURN * GOLDEN) - c[:, None]))
    assert np.abs(tori["w"] - exact).max() < 1e-9


def test_of_a_flow():
    """On a section: the tube about a circle, from where it is born at mu = 0."""
    session = jaxnh.Session(tube, start={"x": 2.2}, target=1e-6).on("z", 0.0, "up")
    data = follow(session, mu=np.array([-0.1, 0.1, 0.2]))
    assert data.sizes["torus_branch"] == 1
    tori = branch(data)
    assert np.abs(data["birth"]).max() < 1e-6
    assert np.all(np.abs(tori["rotation"] - 0.3173) <= tori["rotation_error"])
    assert np.all(np.abs(tori["growth"][:, 0] + 2.0 * TURN * tori["mu"]) <= tori["growth_error"][:, 0])
    radius = np.hypot(tori["x"] - 2.0, tori["h"])
    assert np.abs(radius - np.sqrt(np.maximum(tori["mu"], 0.0))).max() < 1e-5


def test_over_the_frequency_of_a_drive():
    """Along an axis that decides the period, time is over it: at both ends rotation numbers are those of lanes alone."""

    def forced(mu=0.5, drive=0.2, omega=1.1):
        def rhs(y, t):
            x, v = y
            return v, mu * (1 - x * x) * v - x + drive * jnp.cos(omega * t)

        return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / omega}

    session = jaxnh.Session(forced, start={"x": 1.0}, target=1e-8)
    data = session.run(jaxnh.TorusBranches(**STEPS, points=16), omega=np.array([1.14, 1.2]))
    tori = branch(data)
    assert data.sizes["torus_branch"] == 1
    assert (float(tori["omega"].min()), float(tori["omega"].max())) == (1.14, 1.2)
    for place in (0, -1):
        lane = session.run(jaxnh.Tori(points=16), omega=float(tori["omega"][place]))
        turns = np.array([float(tori["rotation"][place]), 1.0 - float(tori["rotation"][place])])  # either sense
        gap = np.abs(turns - float(lane["rotation"])).min()
        assert gap <= float(tori["rotation_error"][place]) + float(lane["rotation_error"])


def test_what_was_searched():
    """Where there is no torus the group says what was looked at."""

    def damped(c=0.5):
        return {"map": lambda y: (c * y[0], 0.3 * y[1]), "coordinates": ("x", "y")}

    data = follow(jaxnh.Session(damped, start={"x": 0.1}), c=np.array([0.4, 0.5]))
    assert data.sizes["torus_branch"] == 0
    assert data.attrs["warnings"] == (
        "torus_branches: there is no torus to follow along c; looked at branches of orbits of period 1 at most and at "
        "motions of 2 lanes"
    )


def test_one_axis_alone():
    with pytest.raises(InputError, match="branches are followed along one axis; leave out beta"):
        jaxnh.Session(bent_circle).run(jaxnh.TorusBranches(), mu=np.array([0.1, 0.2]), beta=np.array([0.1, 0.2]))
