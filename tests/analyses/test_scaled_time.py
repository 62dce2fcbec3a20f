"""Branches and curves over a parameter that decides the period, as the frequency of a drive does."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.integrate
from scipy.optimize import brentq
from scipy.special import mathieu_a, mathieu_b

from jaxnh.engine.experiment import load
from jaxnh.exceptions import ConfigError
from jaxnh.orbits.continuation.kinds import KINDS
from tests.flows.duffing_resonance import DAMPING, FORCE, by_scipy
from tests.helpers.kept_programs import session_of

MATHIEU = """\
import jax.numpy as jnp

def system(w=2.0, h=0.3, damping=0.0):
    def rhs(y, t):
        x, v = y
        return v, -damping * v - (1.0 + h * jnp.cos(w * t)) * x

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / w}
"""

DUFFING = f"""\
import jax.numpy as jnp

def system(w=1.0):
    def rhs(y, t):
        x, v = y
        return v, {FORCE} * jnp.cos(w * t) - {DAMPING} * v - x - x**3

    return {{"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / w}}
"""


@pytest.fixture
def user_flow(tmp_path):
    """A function of the text of a flow and of a config without its system, to its session."""

    def session(text, config):
        (tmp_path / "flow.py").write_text(text)
        (tmp_path / "config.yaml").write_text(f"system: {{file: flow.py}}\n{config}")
        return session_of(load(tmp_path / "config.yaml"))

    return session


def boundary(of, h):
    """The frequency at which x″ + (1 + h cos wt) x = 0 has a solution of twice the period: 4/w² = a₁ or b₁ of 2h/w²."""
    return brentq(lambda w: 4 / w**2 - of(1, 2 * h / w**2), 1.5, 2.5, xtol=1e-14)


@pytest.mark.slow
def test_tongue_of_mathieus_equation(user_flow):
    """Both sides of the first tongue are doublings of the orbit at zero; their slopes over h from neighbouring h."""
    config = """\
initial: {x: 0.0, v: 0.0}
sweep: {w: {start: 1.7, stop: 2.3, count: 9}}
accuracy: {target: 1.0e-9}
analyses:
  branches:
    {max_period: 1, sensitivities: true, n_starts: 2, n_values: 1, box: {x: [-0.1, 0.1], v: [-0.1, 0.1]}}
"""
    data = user_flow(MATHIEU, config).run("bifurcations")
    assert [KINDS[kind] for kind in data["kind"].to_numpy()] == ["period_doubling"] * 2
    exact = [boundary(of, 0.3) for of in (mathieu_a, mathieu_b)]
    assert np.abs(data["w"] - exact).max() < 1e-8
    slopes = [(boundary(of, 0.301) - boundary(of, 0.299)) / 0.002 for of in (mathieu_a, mathieu_b)]
    assert np.abs(data["w_sensitivity"].sel(parameter="h") - slopes).max() < 1e-6  # third derivative times h²/6


@pytest.mark.slow  # the matrix has curves over a shared axis
def test_folds_of_duffings_resonance(user_flow):
    """Where the response jumps: a multiplier one of the orbit that scipy closes, and nothing else between."""
    config = """\
initial: {x: 0.0, v: 0.0}
sweep: {w: {start: 1.0, stop: 1.7, count: 8}}
accuracy: {target: 1.0e-7}
analyses:
  branches: {max_period: 1, transient: 64}
"""
    data = user_flow(DUFFING, config).run("bifurcations")
    assert [KINDS[kind] for kind in data["kind"].to_numpy()] == ["fold", "fold"]
    for k in range(2):
        w, u = float(data["w"][k]), np.array([float(data[name][k]) for name in ("x", "v")])
        image, matrix = by_scipy(w, u)
        assert np.abs(image - u).max() < 1e-9
        assert np.abs(np.linalg.eigvals(matrix) - 1.0).min() < 1e-6  # like the root of the error in w


def test_what_has_a_time_is_refused_as_before(user_flow):
    config = """\
initial: {x: 0.0, v: 0.0}
sweep: {w: {start: 1.0, stop: 1.7, count: 12}}
accuracy: {target: 1.0e-9}
analyses:
  branches: {max_period: 1}
  lyapunov: {}
"""
    with pytest.raises(ConfigError, match="the map has no derivative in w"):
        user_flow(DUFFING, config)


def damped_multiplier(w, h, damping):
    """det(M + 1) of the orbit at zero by DOP853."""

    def rates(t, y):
        x, v = y.reshape(2, 2)
        return np.concatenate([v, -damping * v - (1.0 + h * np.cos(w * t)) * x])

    end = scipy.integrate.solve_ivp(rates, (0, 2 * np.pi / w), np.eye(2).ravel(), "DOP853", rtol=1e-12, atol=1e-13)
    return np.linalg.det(end.y[:, -1].reshape(2, 2) + np.eye(2))


@pytest.mark.slow
def test_tongue_over_frequency_and_amplitude(user_flow):
    """Doublings of a parametric pendulum at rest over both, against determinants of the linear equation by scipy."""
    config = """\
initial: {x: 0.3, v: 0.0}
sweep:
  w: {start: 1.7, stop: 2.3, count: 9}
  h: {start: 0.1, stop: 0.5, count: 5}
accuracy: {target: 1.0e-9}
analyses:
  curves: {max_period: 1, transient: 256}
"""
    pendulum = MATHIEU.replace("damping=0.0", "damping=0.1").replace(") * x\n", ") * jnp.sin(x)\n")
    data = user_flow(pendulum, config).run("curves")
    w, h = (data[name].to_numpy().ravel() for name in ("w", "h"))
    known = np.isfinite(w)
    assert known.sum() > 8
    for value, amplitude in zip(w[known][::4], h[known][::4], strict=True):
        exact = brentq(damped_multiplier, value - 1e-3, value + 1e-3, args=(amplitude, 0.1), xtol=1e-13)
        assert abs(value - exact) < 1e-8


IMPACTS = """\
import jax.numpy as jnp

def system(w=2.4, r=0.8):
    def rhs(y, t):
        x, v = y
        return v, jnp.cos(w * t) - x

    wall = {"when": lambda y, t: y[0], "direction": "down", "then": lambda y, t: (y[0], -r * y[1])}
    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / w, "jumps": [wall]}
"""


def one_impact_a_period(w, r=0.8):
    """State at t = 0 of the motion of x″ + x = cos wt above a wall at x = 0 that meets it once a period, in closed form.

    From an impact at the phase φ on it is x = α cos t + β sin t + k cos(wt + φ), k = 1/(1 − w²), with x = 0 at both ends
    of the period T and the velocity u after the first and −u/r before the second.
    """
    period, k = 2 * np.pi / w, 1 / (1 - w * w)
    slope = (np.cos(period) - 1) / np.sin(period)  # β is this times k cos φ, and α = −k cos φ
    after, before = slope, np.sin(period) + slope * np.cos(period)
    phase = np.arctan((after / r + before) / (w * (1 + 1 / r)))
    phase += np.pi * (k * (slope * np.cos(phase) - w * np.sin(phase)) < 0.0)  # it leaves the wall
    alpha, beta, t = -k * np.cos(phase), slope * k * np.cos(phase), np.mod(-phase, 2 * np.pi) / w
    x = alpha * np.cos(t) + beta * np.sin(t) + k * np.cos(w * t + phase)
    return x, -alpha * np.sin(t) + beta * np.cos(t) - k * w * np.sin(w * t + phase)


def test_impact_oscillator_over_its_drives_frequency(user_flow):
    """The branch of one impact a period in closed form, whose multipliers have the product r²."""
    config = """\
initial: {x: 0.5, v: 0.0}
sweep: {w: {start: 2.35, stop: 2.6, count: 4}}
accuracy: {target: 1.0e-9}
analyses:
  branches: {max_period: 1, transient: 64}
"""
    data = user_flow(IMPACTS, config).run("branches").isel(branch=0)
    known = np.isfinite(data["w"].to_numpy())
    assert known.sum() > 10
    for name, exact in zip(("x", "v"), one_impact_a_period(data["w"].to_numpy()[known]), strict=True):
        assert np.abs(data[name].to_numpy()[known] - exact).max() < 1e-8
    real, imaginary = np.moveaxis(data["multipliers"].to_numpy()[known], -1, 0)
    product = np.prod(real + 1j * imaginary, axis=-1)
    assert np.abs(product - 0.64).max() < 1e-8
