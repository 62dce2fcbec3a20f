"""The 0–1 test on an angle that turns and turns: a driven pendulum, against its exponent."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.analyses import chaos01
from jaxnh.analyses.exponents import lyapunov
from jaxnh.solvers import SOLVERS
from jaxnh.systems.lagrangian import lagrangian
from tests.helpers.batches import batch_of

OMEGA = 2 / 3
# Of θ'' = −θ'/2 − sin θ + drive cos(2t/3) (Baker and Gollub, Chaotic Dynamics, 2nd edition 1996, chapter 3): swings of
# period 1, chaos, chaos that turns over, whole turns of period 1, and chaos again.
DRIVES = [1.0, 1.15, 1.2, 1.35, 1.5]
CHAOTIC = np.array([False, True, True, False, True])


def logistic(r=4.0):
    return {"map": lambda s: r * s[0] * (1.0 - s[0]), "coordinates": "x"}


def driven(drive=1.0):
    return {
        "T": lambda q, v, t: 0.5 * v[0] ** 2,
        "Q": lambda q, v, t: (-0.5 * v[0] - jnp.sin(q[0]) + drive * jnp.cos(OMEGA * t),),
        "coordinates": ("angle",),
        "period": 2 * math.pi / OMEGA,
        "angles": ("angle",),
    }


@pytest.fixture(scope="module")
def scene():
    """The five pendulums. The map of a period is right to some 1e-8."""
    flow = lagrangian(driven, {"drive": 1.0})
    start = flow.start({"angle": 0.3, "angle_dot": 0.2})
    return batch_of(flow, start, DRIVES, SOLVERS["dopri5"], 120, name="drive", error=1e-8)


@pytest.mark.slow
def test_growth_of_a_rotating_pendulum(scene, lanes):
    """K is near 1 where the motion is chaotic, whether the pendulum swings or turns, and near 0 elsewhere."""
    k = chaos01.run(chaos01.Chaos01Options(transient=64, periods=600), scene, lanes)["k_median"].to_numpy()
    assert np.all(k[CHAOTIC] > 0.8)
    assert np.all(k[~CHAOTIC] < 0.2)


@pytest.mark.slow
def test_exponents_of_a_rotating_pendulum(scene, lanes):
    """The largest is positive beyond its error where the motion is chaotic, and there alone."""
    data = lyapunov.run(lyapunov.LyapunovOptions(transient=64, periods=256, exponents=1), scene, lanes)
    largest, error = (data[name].to_numpy()[:, 0] for name in ("exponents", "exponents_error"))
    np.testing.assert_array_equal(largest > error, CHAOTIC)


def test_growth_does_not_depend_on_where_an_angle_is_counted_from():
    """Cosine and sine of φ and of φ + 1: the sum of two displacements is that of one complex walk, times a phase.

    What is subtracted, the square of the mean, is that of a complex mean; only lags of equal recurrence could differ.
    """
    x = [0.3]
    for _ in range(999):
        x.append(3.97 * x[-1] * (1 - x[-1]))
    angle, c = 2 * np.pi * np.array(x), jnp.linspace(np.pi / 5, 4 * np.pi / 5, 8)

    def growth(shift):
        signals = (jnp.cos(angle + shift), jnp.sin(angle + shift))
        return chaos01.growth_rates(chaos01.remove_period(signals), c, chaos01.mean_square(signals))

    np.testing.assert_allclose(growth(0.0), growth(1.0), rtol=0, atol=1e-9)
    assert np.median(growth(0.0)) > 0.8


def test_the_spread_of_k_is_called_no_error():
    """Full chaos of the logistic map has K = 1, which the quartiles of 150 starts cover 27 times in 100."""
    starts = np.linspace(0.11, 0.45, 8)
    data = jaxnh.Session(logistic, start={"x": 0.3}).run(jaxnh.Chaos01(), x=starts)
    assert data["k_median"].to_numpy().min() > 0.99
    assert {"k_median", "k_spread"} <= set(data.data_vars)
    assert not any(str(name).endswith("_error") for name in data.data_vars)
