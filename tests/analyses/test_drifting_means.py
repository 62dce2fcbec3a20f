"""Bars of sums of exponents on motions that come to their attractor slowly, or not at all: maps with known sums."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh


def turned(x, z, factor, angle):
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    return factor * (cos * x - sin * z), factor * (sin * x + cos * z)


def spiral(rate=1e-5):
    """Comes to r = 1 at the rate 2γ: the normal form of Neimark and Sacker; the sum is ln(1 − 2γ) there."""

    def image(state):
        x, z = state
        square = x * x + z * z
        return turned(x, z, 1 + rate * (1 - square), 2.4 + 0.3 * square)

    return {"map": image, "coordinates": ("x", "z")}


def onset(rate=1e-3):
    """Comes to r = 0 like the inverse root of time; the sum is zero there."""

    def image(state):
        x, z = state
        square = x * x + z * z
        return turned(x, z, 1 - rate * square, 2.4 + 0.3 * square)

    return {"map": image, "coordinates": ("x", "z")}


def henon(a=1.4):
    def image(state):
        x, z = state
        return 1 - a * x * x + z, 0.3 * x

    return {"map": image, "coordinates": ("x", "z")}


def areas_kept(shift=0.24):
    """Henon's map that keeps areas: tori."""

    def image(state):
        x, z = state
        sin, upper = jnp.sqrt(1 - shift * shift), z - x * x
        return x * shift - upper * sin, x * sin + upper * shift

    return {"map": image, "coordinates": ("x", "z")}


STARTS = np.linspace(0.2, 1.6, 128)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("system", "axes", "total"),
    [
        (spiral, {"rate": [1e-7], "x": STARTS}, np.log1p(-2e-7)),
        (spiral, {"rate": [1e-5], "x": STARTS}, np.log1p(-2e-5)),
        (spiral, {"rate": [1e-3], "x": STARTS}, np.log1p(-2e-3)),
        (spiral, {"rate": np.geomspace(1e-6, 0.1, 128)}, np.log1p(-2 * np.geomspace(1e-6, 0.1, 128))),
        (onset, {"rate": np.geomspace(1e-5, 0.5, 128)}, 0.0),
        (henon, {"x": np.linspace(-0.3, 0.3, 128)}, np.log(0.3)),
        (areas_kept, {"x": np.linspace(0.02, 0.3, 128)}, 0.0),
    ],
)
def test_sums_are_covered(system, axes, total):
    """Of 128 lanes at least 95 in 100; where nothing drifts, the median bar is what rounding is allowed."""
    session = jaxnh.Session(system, start={"x": 0.5, "z": 0.1})
    data = session.run(jaxnh.Lyapunov(transient=256, periods=1024, exponents=2), **axes).squeeze()
    error = data["exponent_sum_error"].to_numpy()
    assert np.mean(np.abs(data["exponent_sum"].to_numpy() - total) <= error) >= 0.95
    if system in (henon, areas_kept):
        assert np.median(error) < 2e-10
