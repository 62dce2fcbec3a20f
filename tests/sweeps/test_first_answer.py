"""sweeps/timing/first_answer.py: a stranger's class as a user's file, and the page of its answers."""

from __future__ import annotations

import json
import sys
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from jaxnh.engine.experiment import load
from sweeps.timing import first_answer
from sweeps.timing.first_answer import Answer

FLOWS = """
class Flow:
    def __init__(self):
        pass


class Roessler(Flow):
    @staticmethod
    def _rhs(x, y, z, t, a, b, c):
        xdot = -y - z
        ydot = x + a * y
        zdot = b + z * x - c * z
        return xdot, ydot, zdot


class Swing(Flow):
    def force(self, x):
        return -self.k * np.sin(x)

    def rhs(self, X, t):
        x, v = X
        return v, self.force(x)
"""
DATA = {
    "Roessler": {
        "delay": False,
        "parameters": {"a": 0.2, "b": 0.2, "c": 5.7},
        "initial_conditions": [1.0, 2.0, 0.0],
        "period": 5.9,
    },
    "Swing": {"delay": False, "parameters": {"k": 2}, "initial_conditions": [0.5, 0.0], "period": 4.5},
    "MackeyGlass": {"delay": True},
}


@pytest.fixture
def flows(tmp_path, monkeypatch):
    """Files of two flows of a package like dysts."""
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "chaotic_attractors.json").write_text(json.dumps(DATA))
    (tmp_path / "flows.py").write_text(FLOWS)
    monkeypatch.setitem(sys.modules, "dysts", SimpleNamespace(__file__=str(tmp_path / "__init__.py")))
    return tmp_path / "cases", first_answer.write_flows(tmp_path / "cases")


def test_flows_are_experiments(flows):
    """Both ways that dysts writes a flow: of components, and a method of a vector with others beside it."""
    folder, sizes = flows
    assert sizes == {"Roessler": 3, "Swing": 2}
    for name, size in sizes.items():
        experiment = load(folder / name / "c.yaml")
        assert len(experiment.flow().coordinates) == size
        assert experiment.sweep.lanes == 1
    swing = load(folder / "Swing" / "c.yaml").flow()
    state = swing.chart.state(np.array([0.5, 0.1]))
    np.testing.assert_allclose(np.ravel(swing.rhs(0.0, state, {"k": 2.0})), [0.1, -2.0 * np.sin(0.5)], rtol=1e-15)


def test_spectra_are_held_against_others(tmp_path):
    path, spectra = tmp_path / "a.h5", {"a": {"mean": [0.5, -1.0], "error": [0.01, 0.01]}}
    with h5py.File(path, "w") as file:
        file["lyapunov/exponents"], file["lyapunov/exponents_error"] = [[0.52, -1.0]], [[0.01, 0.01]]
    assert first_answer.differs("a", path, spectra) == ""
    assert first_answer.differs("b", path, spectra) is None
    spectra["a"]["mean"][0] = 0.6
    assert first_answer.differs("a", path, spectra).startswith("a: ")


def test_page_has_medians_and_refusals(monkeypatch):
    monkeypatch.setattr(first_answer, "version", lambda _: "0.96")
    text = "3.0 s: compile 1.5 s, run 0.5 s, set-up and the rest 1.0 s"
    empty = {"a": Answer(0, 3.0, text), "b": Answer(0, 5.0, text), "c": Answer(2, 1.0, "c.yaml:1: no such key")}
    page = first_answer.page(
        empty, {"a": Answer(0, 2.0, text)}, {"a": "", "b": "b: [1] ± [0], there [2] ± [0]"}, dict.fromkeys("abc", 3)
    )
    assert "| empty | 2 | 4.0 | 4.8 | 5.0 |" in page
    assert "| kept | 1 | 2.0 | 2.0 | 2.0 |" in page
    assert "2 of 3 flows are answered. Of 2 there is an independent integration; 1 agree" in " ".join(page.split())
    assert "- c: c.yaml:1: no such key" in page
    assert "| a | 3 | 3.0 | 1.5 | 0.5 |" in page
