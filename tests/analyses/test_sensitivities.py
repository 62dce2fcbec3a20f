"""Derivatives of doublings, periods and multipliers in parameters: closed forms, and differences of two whole runs."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.engine.experiment import load
from tests.flows import known_maps
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


def test_no_derivative_where_the_clock_has_none():
    """Two frequencies of no common period: the disturbed speed at another ω has no map."""
    few = ["analyses={doubling: {levels: 1, sensitivities: true}}", "sweep.b.count=32", "accuracy.target=1e-7"]
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
