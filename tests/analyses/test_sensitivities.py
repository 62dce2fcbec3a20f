"""Derivatives of doublings, periods and multipliers in parameters: closed forms, and differences of two whole runs."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.analyses.windows.tables import table
from jaxnh.engine.experiment import load
from jaxnh.orbits.continuation.kinds import KINDS
from tests.flows import known_maps
from tests.helpers.kept_calibrations import calibrating_by, unless_given
from tests.helpers.kept_programs import session_of
from tests.helpers.paths import ROOT


@pytest.fixture
def user_map(tmp_path):
    """A function of the text of a map and of a config without its system, to its session."""

    def session(text, config):
        (tmp_path / "map.py").write_text(text)
        (tmp_path / "config.yaml").write_text(f"system: {{file: map.py}}\n{config}")
        return session_of(load(tmp_path / "config.yaml"))

    return session


HENON = """\
initial: {x: 0.1, y: 0.1}
sweep: {a: {start: 0.2, stop: 1.0, count: 64}}
analyses:
  doubling: {levels: 2SENSITIVITIES}
"""


def test_doublings_of_henons_map(user_map):
    """a = 3 (1 − b)²/4, then (1 − b)² + (1 + b)²/4: their derivatives in b to rounding, and within their errors."""
    data = user_map(known_maps.HENON, HENON.replace("SENSITIVITIES", ", sensitivities: true")).run("doubling")
    rates, errors = (data[f"a_sensitivity{end}"].sel(parameter="b").to_numpy() for end in ("", "_error"))
    missed = np.abs(rates - [-1.5 * 0.7, -2 * 0.7 + 0.5 * 1.3])
    assert np.all(missed < 1e-11)
    assert np.all(missed <= errors)
    assert np.all(errors < 1e-9)


def test_nothing_more_where_it_is_not_asked_for(user_map):
    """No variables, and the hash of a config that says nothing of it."""
    plain, off = (user_map(known_maps.HENON, HENON.replace("SENSITIVITIES", t)) for t in ("", ", sensitivities: false"))
    assert plain.experiment.sha256 == off.experiment.sha256
    assert not any("sensitivity" in name or name == "parameter" for name in plain.run("doubling").variables)


@pytest.mark.slow  # derivatives in other parameters are quick
def test_no_derivative_where_the_clock_has_none():
    """Two frequencies of no common period: the disturbed speed at another ω has no map."""
    accuracy = "accuracy={solver: blanes_moan6, steps: 60}"
    few = ["analyses={doubling: {levels: 1, sensitivities: true}}", "sweep.b.count=32", accuracy]
    with calibrating_by(unless_given):
        data = session_of(load(ROOT / "configs/table2.yaml", few)).run("doubling")
    assert data["parameter"].to_numpy().tolist() == ["a", "c", "d", "omega"]
    assert np.isnan(data["b_sensitivity"].sel(parameter="omega")).all()
    assert np.isfinite(data["b_sensitivity"].sel(parameter=["a", "c", "d"])).all()
    assert "no derivative in omega: sin(" in data.attrs["warnings"]


TABLES = {"table1": {"a": 0.5, "c": 1.0, "omega": 1.0}, "table2": {"a": 0.5, "c": 1.0, "d": 0.1}}


@pytest.mark.slow
@pytest.mark.parametrize("name", TABLES)
def test_doublings_of_the_tables(name):
    """Six digits of differences of two whole runs on either side, and two more for their fourth order."""
    few = ["sweep.b.count=128"]
    asked = [*few, "analyses.doubling.sensitivities=true"]
    data = session_of(load(ROOT / f"configs/{name}.yaml", asked)).run("doubling")
    for parameter, value in TABLES[name].items():
        step = 1e-4 * value

        def doublings(k, parameter=parameter, value=value, step=step):
            other = [*few, f"system.{parameter}={value + k * step!r}"]
            return session_of(load(ROOT / f"configs/{name}.yaml", other)).run("doubling")["b"].to_numpy()

        near, far = (doublings(k) - doublings(-k) for k in (1, 2))
        exact = (8 * near - far) / (12 * step)
        rates, errors = (data[f"b_sensitivity{end}"].sel(parameter=parameter).to_numpy() for end in ("", "_error"))
        assert np.all(np.isfinite(rates))
        assert np.all(np.abs(rates - exact) < 1e-6 * np.abs(exact)), parameter
        assert np.all(errors < 1e-6 * np.abs(exact)), parameter


HOPF = """\
def system(mu=0.1, omega=2.0):
    def rhs(s, t):
        x, y = s
        growth = mu - x * x - y * y
        return growth * x - omega * y, growth * y + omega * x

    return {"rhs": rhs, "coordinates": ("x", "y")}
"""
"""r′ = (μ − r²) r, θ′ = ω: the cycle takes T = 2π/ω and has the multiplier exp(−2 μ T)."""


def check(data, name, exact, largest):
    """Within their errors, which are small."""
    for parameter, truth in exact.items():
        rates, errors = (data[f"{name}_sensitivity{end}"].sel(parameter=parameter).to_numpy() for end in ("", "_error"))
        assert np.all(np.abs(rates - truth) <= errors), parameter
        assert np.all(errors < largest), parameter


def test_cycle_without_a_clock(user_map):
    """Multiplier and time of the cycle of Hopf's normal form, over μ that lanes have and ω that they share."""
    config = """\
initial: {x: 0.6, y: 0.0}
section: {coordinate: y, value: 0.0, direction: up}
sweep: {mu: {values: [0.3, 0.4]}}
accuracy: {target: 1.0e-9}
analyses:
  period: {transient: 16, sensitivities: true}
"""
    data, mu, turn = user_map(HOPF, config).run("period"), np.array([0.3, 0.4]), np.pi
    multiplier = np.exp(-2 * mu * turn)
    assert np.abs(data["time"] - turn).max() < 1e-9
    check(data, "multiplier", {"mu": -2 * turn * multiplier, "omega": mu * turn * multiplier}, 1e-7)
    check(data, "time", {"mu": 0.0, "omega": -turn / 2}, 1e-7)


def test_multipliers_of_the_logistic_map(user_map):
    """2 − r of the fixed point, 4 + 2r − r² of the cycle of two; where there is no orbit there is no derivative."""
    config = (
        "initial: {x: 0.3}\nsweep: {r: {values: [2.5, 3.2, 3.4, 3.9]}}\nanalyses:\n  period: {sensitivities: true}\n"
    )
    data = user_map(known_maps.LOGISTIC, config).run("period")
    assert data["period"].to_numpy().tolist() == [1, 2, 2, 0]
    check(data.isel(r=slice(3)), "multiplier", {"r": [1.0, 2 - 2 * 3.2, 2 * 3.4 - 2]}, 1e-8)
    assert np.isnan(data["multiplier_sensitivity"][3]).all()


def test_bifurcations_of_henons_map(user_map):
    """The fold at a = −(1 − b)²/4 and the doubling at 3 (1 − b)²/4, on one branch."""
    config = """\
initial: {x: 0.5, y: 0.1}
sweep: {a: {start: -0.2, stop: 0.6, count: 8}}
analyses:
  branches: {max_period: 1, sensitivities: true}
"""
    data = user_map(known_maps.HENON, config).run("bifurcations")
    assert [KINDS[kind] for kind in data["kind"].to_numpy()] == ["fold", "period_doubling"]
    check(data, "a", {"b": [0.5 * 0.7, -1.5 * 0.7]}, 1e-8)


TURN = """\
import jax.numpy as jnp

def system(mu=0.1, q=0.3, turn=1.0):
    def image(s):
        x, y = s[0] - q, s[1]
        growth = 1.0 + mu - q**2 - x**2 - y**2
        c, s = growth * jnp.cos(turn), growth * jnp.sin(turn)
        return q + c * x - s * y, s * x + c * y

    return {"map": image, "coordinates": ("x", "y")}
"""
"""A turn about (q, 0): its multipliers have the modulus 1 + μ − q²."""


@pytest.mark.slow  # bifurcations of Henon's map are quick
def test_neimark_sacker_bifurcation(user_map):
    """At μ = q²: 2 q in q, and nothing in the angle of the turn."""
    config = """\
initial: {x: 0.35, y: 0.0}
sweep: {mu: {start: -0.3, stop: 0.3, count: 8}}
analyses:
  branches: {max_period: 1, sensitivities: true}
"""
    data = user_map(TURN, config).run("bifurcations")
    assert [KINDS[kind] for kind in data["kind"].to_numpy()] == ["neimark_sacker"]
    check(data, "mu", {"q": 0.6, "turn": 0.0}, 1e-8)


MOVED_LOGISTIC = """\
def system(r=3.9, q=0.3):
    def image(s):
        x = s[0] - q
        return q + (r - q**2) * x * (1.0 - x)

    return {"map": image, "coordinates": "y"}
"""
"""The logistic map in y = x + q, of r − q²: all of its bifurcations move by 2 q in q."""


def test_ends_of_a_window(user_map):
    """The window of period 3, from its fold at r − q² = 1 + √8 to its doubling."""
    config = """\
initial: {y: 0.6}
sweep: {r: {start: 3.9, stop: 3.94, count: 42}}
analyses:
  windows: {max_period: 3, levels: 0, crisis: 0, sensitivities: true}
"""
    session = user_map(MOVED_LOGISTIC, config)
    data = session.run("windows")
    [window] = np.flatnonzero(data["period"].to_numpy() == 3)
    assert float(data["begin"][window]) == pytest.approx(1 + 8**0.5 + 0.09, abs=1e-9)
    for name in ("begin", "end"):
        check(data.isel(window=[window]), name, {"q": 0.6}, 1e-7)
    assert table(data, {}, "").heads[-3:] == ("∂begin/∂q", "∂end/∂q", "∂limit/∂q")
