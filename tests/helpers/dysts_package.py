"""A package like dysts, of three flows and one with a delay: what studies of strangers' flows read of it."""

from __future__ import annotations

import json
import sys
from types import SimpleNamespace

from sweeps.studies import dysts_flows

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


class Burst(Flow):
    @staticmethod
    def _rhs(x, t, k):
        return (k * max(x, 1) ** 2,)
"""
DATA = {
    "Roessler": {
        "delay": False,
        "parameters": {"a": 0.2, "b": 0.2, "c": 5.7},
        "initial_conditions": [1.0, 2.0, 0.0],
        "period": 5.9,
        "maximum_lyapunov_estimated": 0.15,
        "kaplan_yorke_dimension": None,
    },
    "Swing": {
        "delay": False,
        "parameters": {"k": 2},
        "initial_conditions": [0.5, 0.0],
        "period": 4.5,
        "maximum_lyapunov_estimated": 0.0,
        "kaplan_yorke_dimension": 2.0,
    },
    "Burst": {
        "delay": False,
        "parameters": {"k": 1.0},
        "initial_conditions": [1.0],
        "period": 1.0,
        "maximum_lyapunov_estimated": 1.0,
        "kaplan_yorke_dimension": 1.0,
    },
    "MackeyGlass": {"delay": True},
}


def publish(folder, monkeypatch):
    """Write the package into a folder, from where the studies take it; its flows by name."""
    (folder / "data").mkdir()
    (folder / "data" / "chaotic_attractors.json").write_text(json.dumps(DATA))
    (folder / "flows.py").write_text(FLOWS)
    monkeypatch.setitem(sys.modules, "dysts", SimpleNamespace(__file__=str(folder / "__init__.py")))
    return dysts_flows.published_flows()
