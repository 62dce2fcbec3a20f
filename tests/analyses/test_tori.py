"""Invariant curves against closed forms: skew products, a torus about a circle, and curves by iteration of the map."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.exceptions import InputError
from tests.flows.tori import GOLDEN, TURN, bent_circle, skew, tube

pytestmark = pytest.mark.usefixtures("quick_compiling", "always_shared_programs")


def kinds(data):
    return jaxnh.labels(data["kind"]).to_numpy().ravel().tolist()


def standard(k=0.5):
    def image(y):
        momentum = y[1] + k * jnp.sin(y[0])
        return y[0] + momentum, momentum

    return {"map": image, "coordinates": ("angle", "momentum"), "angles": ("angle",)}


def test_skew_product():
    """Points, rotation number and both multipliers in closed form, where the curve attracts, repels, and between."""
    session = jaxnh.Session(skew, start={"x": 0.1})
    data = session.run(jaxnh.Tori(points=32), c=np.array([0.3, 0.9, 1.2, 2.0]))
    assert kinds(data) == ["attracting", "attracting", "saddle", "saddle"]
    assert jaxnh.labels(data["motion"]).to_numpy()[-1] == "failed"  # the curve is that of a neighbour, followed
    c = data["c"].to_numpy()
    exact = np.imag(np.exp(1j * data["x"].to_numpy()) / (np.exp(1j * TURN * GOLDEN) - c[:, None]))
    assert np.abs(data["w"] - exact).max() < 1e-12
    assert np.all(np.abs(data["rotation"] - GOLDEN) < data["rotation_error"])
    growth = np.sort(np.log(np.stack([c, 0 * c + 0.3])), axis=0)[::-1].T
    missed = np.abs(data["growth"] - growth)
    assert np.all(missed < data["growth_error"])
    assert data["growth_error"].max() < 1e-9


def test_normal_form():
    """ρ = 0.2345 + β μ and ln(1 − 2 μ) on a circle that a shear bends."""
    data = jaxnh.Session(bent_circle, start={"a": 0.2, "b": 0.1}).run(jaxnh.Tori(), mu=np.linspace(0.02, 0.3, 6))
    mu = data["mu"].to_numpy()
    assert kinds(data) == ["attracting"] * 6
    assert np.all(np.abs(data["rotation"] - (0.2345 + 0.3 * mu)) < data["rotation_error"])
    assert np.all(np.abs(data["growth"][:, 0] - np.log(1.0 - 2.0 * mu)) < data["growth_error"][:, 0])
    a, b = data["a"].to_numpy(), data["b"].to_numpy()
    assert np.abs(a * a + (b - 0.4 * a * a) ** 2 - mu[:, None]).max() < 1e-13


def test_curves_by_iteration():
    """A curve without a formula: its points after 200 iterates are where the rotation number says, and it is neutral."""
    data = jaxnh.Session(standard, start={"angle": 0.0, "momentum": 3.883222}).run(
        jaxnh.Tori(points=66), k=np.array([0.3, 0.6])
    )
    assert kinds(data) == ["neutral", "neutral"]
    for lane, k in enumerate(data["k"].to_numpy()):
        angle, momentum = (data[name].to_numpy()[lane, :-1] for name in ("angle", "momentum"))
        theta = data["theta"].to_numpy()[:-1]
        periodic = np.stack([np.unwrap(angle) - TURN * theta, momentum])
        for _ in range(200):
            momentum = momentum + k * np.sin(angle)
            angle = angle + momentum
        turned = theta + 200 * float(data["rotation"][lane])
        waves = np.exp(2j * np.pi * np.outer(np.fft.fftfreq(65, 1 / 65), turned))
        there = np.real(np.fft.fft(periodic, axis=1) / 65 @ waves)
        gap = (angle - TURN * turned - there[0] + np.pi) % TURN - np.pi
        assert max(np.abs(gap).max(), np.abs(momentum - there[1]).max()) < 1e-8


def test_torus_of_a_flow():
    """On a section: turns and contraction of a tube in closed form."""
    session = jaxnh.Session(tube, start={"x": 2.2}, target=1e-6).on("z", 0.0, "up")
    data = session.run(jaxnh.Tori(transient=64, periods=512), mu=np.array([0.1, 0.2]))
    mu = data["mu"].to_numpy()
    assert kinds(data) == ["attracting", "attracting"]
    assert np.all(np.abs(data["rotation"] - 0.3173) < data["rotation_error"])
    assert np.all(np.abs(data["growth"][:, 0] + 2.0 * TURN * mu) < data["growth_error"][:, 0])
    radius = np.hypot(data["x"] - 2.0, data["h"])
    assert np.abs(radius - np.sqrt(mu)[:, None]).max() < 1e-6


def test_what_has_no_curve():
    """Locked motion has none, nor has chaos; the reason is in `motion`."""
    data = jaxnh.Session(standard, start={"angle": 3.0, "momentum": 0.1}).run(
        jaxnh.Tori(transient=16, periods=256), k=np.array([5.0])
    )
    assert kinds(data) == ["none"]
    assert np.isnan(data["rotation"]).all()
    assert (data["harmonics"] == 0).all()


def test_one_direction_is_refused():
    def circle(omega=0.5):
        return {"map": lambda y: (y[0] + omega,), "coordinates": ("x",), "angles": ("x",)}

    with pytest.raises(InputError, match="nothing normal to it; take rotation"):
        jaxnh.Session(circle, start={"x": 0.1}).run(jaxnh.Tori(), omega=np.array([1.0]))


@pytest.mark.slow
def test_forced_van_der_pol():
    """Against averages over motions: the rotation number of `rotation`, and exponents of `lyapunov`."""

    def forced(mu=0.5, drive=0.2, omega=1.1):
        def rhs(y, t):
            x, v = y
            return v, mu * (1 - x * x) * v - x + drive * jnp.cos(omega * t)

        return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / omega}

    session, drive = jaxnh.Session(forced, start={"x": 1.0}), np.linspace(0.05, 0.4, 8)
    data = session.run(jaxnh.Tori(), drive=drive)
    turns = session.run(jaxnh.Rotation(), drive=drive)
    exponents = session.run(jaxnh.Lyapunov(periods=4000), drive=drive)
    assert kinds(data) == ["attracting"] * 8
    assert np.all(np.abs(data["rotation"] - turns["rotation"]) < data["rotation_error"] + turns["rotation_error"])
    period = TURN / 1.1
    missed = np.abs(data["growth"][:, 0] - period * exponents["exponents"][:, 1])
    assert np.all(missed < data["growth_error"][:, 0] + period * exponents["exponents_error"][:, 1])


@pytest.mark.slow
def test_torus_of_forced_van_der_pol_by_heyoka():
    """Rotation numbers of its curves against those of 6,000 strobes by a Taylor series, within bars below 1e-10.

    Advances of the angle about the origin, which the curve is around, averaged with the weights exp(−1/(s(1 − s))), come
    to a rotation number faster than any power (Das, Sander and co-workers, Nonlinearity 30 (2017) 4111).
    """
    hy = pytest.importorskip("heyoka")

    def forced(mu=0.5, drive=0.2, omega=1.1):
        def rhs(y, t):
            x, v = y
            return v, mu * (1 - x * x) * v - x + drive * jnp.cos(omega * t)

        return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / omega}

    drive, count = np.array([0.1, 0.25, 0.4]), 6000
    data = jaxnh.Session(forced, start={"x": 1.0}).run(jaxnh.Tori(), drive=drive)
    x, v = hy.make_vars("x", "v")
    motion = [(x, v), (v, 0.5 * (1 - x * x) * v - x + hy.par[0] * hy.cos(1.1 * hy.time))]
    for k, value in enumerate(drive):
        ta = hy.taylor_adaptive(motion, [1.0, 0.0], pars=[value], compact_mode=True)
        angles = []
        for _ in range(200 + count + 1):
            angles.append(np.arctan2(ta.state[1], ta.state[0]))
            ta.time = 0.0
            ta.propagate_until(TURN / 1.1)
        share = (np.arange(count) + 0.5) / count
        weights = np.exp(-1.0 / (share * (1.0 - share)))
        turns = np.sum(weights * np.mod(np.diff(angles[200:]) / TURN, 1.0)) / np.sum(weights)
        assert abs(float(data["rotation"][k]) - turns) <= float(data["rotation_error"][k]) + 1e-13
        assert float(data["rotation_error"][k]) < 1e-10
