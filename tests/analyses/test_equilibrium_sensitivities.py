"""Derivatives of folds and Hopf points of equilibria, against closed forms."""

import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.continuation.equilibrium_sensitivities import equilibrium_sensitivities
from jaxnh.analyses.periodic.sensitivities import CriticalOrbit
from jaxnh.orbits.continuation.kinds import BRANCH_POINT, FOLD, HOPF, KINDS
from jaxnh.solvers import tsit5
from tests.helpers.batches import batch_of
from tests.helpers.kept_programs import lanes_with_kept_programs

Q = 0.7


def jerk(alpha=0.8, beta=1.0):
    """x''' + alpha x'' + beta x' + x = x²: at x = 0 a Hopf point at alpha beta = 1 (Routh and Hurwitz)."""

    def rhs(y, t):
        x, v, a = y
        return v, a, -alpha * a - beta * v - x + x**2

    return {"rhs": rhs, "coordinates": ("x", "v", "a")}


def moving(mu=0.0, q=Q):
    """At x = q, v = 0 equilibria have a Hopf point at mu = q², and a fold at mu = −1 − q²/4, where z = −q/2."""

    def rhs(y, t):
        x, v, z = y
        growth = mu - q * x
        return growth * (x - q) - v, growth * v + x - q, 1.0 + mu - q * z - z**2

    return {"rhs": rhs, "coordinates": ("x", "v", "z")}


def test_what_moves_with_a_parameter_and_what_does_not():
    flow = jaxnh.Session(moving, start={"x": 0.0, "v": 0.0, "z": 0.0}).experiment.flow()
    batch = batch_of(flow, flow.start({"x": 0.0, "v": 0.0, "z": 0.0}), [0.0], tsit5, 1, name="mu")
    root = np.sqrt(0.25 * Q**2 + 1.0 + Q**2) - 0.5 * Q
    hopf = CriticalOrbit(HOPF, Q**2, np.array([[Q, 0.0, root]]), np.array([1j, -1j, -Q - 2 * root]))
    fold = CriticalOrbit(FOLD, -1.0 - Q**2 / 4, np.array([[Q, 0.0, -0.5 * Q]]), np.array([0.0, 1j, -1j]))
    none = CriticalOrbit(BRANCH_POINT, fold.value, fold.points, fold.multipliers)
    derived = equilibrium_sensitivities(batch, lanes_with_kept_programs(), [hopf, fold, none])
    assert derived.names == ("q",)
    missed = np.abs(derived.rates[:2, 0] - [2 * Q, -0.5 * Q])
    assert np.all(missed <= derived.errors[:2, 0])
    assert np.all(derived.errors[:2, 0] < 1e-10)
    assert np.isnan(derived.rates[2]).all()


@pytest.mark.slow  # derivatives of given points are quick
def test_hopf_point_of_a_branch(tmp_path):
    box = dict.fromkeys(("x", "v", "a"), (-1.0, 1.0))
    session = jaxnh.Session(jerk, start={"x": 0.2, "v": 0.2, "a": 0.0}, target=1e-8).on("x", 0.1, "up")
    options = jaxnh.Branches(max_period=1, equilibria=8, n_values=2, box=box, sensitivities=True)
    found = session.groups({"branches": options}, alpha=np.linspace(0.6, 1.1, 16))["bifurcations"]
    point = found.isel(bifurcation=found["kind"].to_numpy() == KINDS.index("hopf"))
    rate, error = (point[f"alpha_sensitivity{end}"].sel(parameter="beta").item() for end in ("", "_error"))
    assert abs(rate + 1.0) <= error < 1e-9
