"""Flows without a clock: what comes to rest, its exponents, and verdicts, on the Lorenz system where all is known."""

from __future__ import annotations

import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.batch import LaneBatch
from jaxnh.analyses.equilibria.detection import detect_equilibrium
from jaxnh.analyses.verdict import KINDS, largest_across
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.solvers import dopri8
from tests.helpers.batches import broadcast_start
from tests.helpers.kept_programs import session_of
from tests.helpers.paths import ROOT

CONFIG = f"""system: {{file: {ROOT}/configs/flows/lorenz.py}}
initial: {{x: 1.0, y: 1.0, z: 20.0}}
sweep: {{rho: {{values: [10.0, 22.0, 28.0, 160.0]}}}}
section: {{normal: {{x: 1.0, y: -1.0}}, value: 0.0, direction: up}}
accuracy: {{target: 1.0e-6}}
analyses: {{lyapunov: {{transient: 256, periods: 512}}, verdict: {{}}}}
"""


@pytest.fixture(scope="module")
def lorenz(tmp_path_factory):
    path = tmp_path_factory.mktemp("lorenz") / "lorenz.yaml"
    path.write_text(CONFIG)
    return jaxnh.load(path)


def at_rest(flow, start, rho, units):
    scene = LaneBatch(
        flow, broadcast_start(flow.start(start), len(rho)), {"rho": np.array(rho)}, dopri8, 96, False, 1e-9
    )
    return detect_equilibrium(scene, LaneExecutor(), units)


def spectrum(rho):
    """Real parts of the eigenvalues at the equilibrium that is stable: the origin, or one of the two beside it."""
    x = np.sqrt(8 / 3 * max(rho - 1.0, 0.0))
    z = max(rho - 1.0, 0.0)
    change = [[-10.0, 10.0, 0.0], [rho - z, -1.0, -x], [x, x, -8 / 3]]
    return np.sort(np.linalg.eigvals(change).real)[::-1]


def test_equilibria_and_their_exponents(lorenz):
    """The origin below ρ = 1, then the two beside it; chaos at 28. Eigenvalues by the Jacobian written out."""
    rho = [0.5, 10.0, 16.0, 28.0]
    found = at_rest(lorenz.flow(), {"x": 1.0, "y": 1.0, "z": 20.0}, rho, 200)
    assert found.still.tolist() == [True, True, True, False]
    assert not found.fading[3]
    exact = np.array([spectrum(value) for value in rho[:3]])
    assert np.all(np.abs(found.exponents[:3] - exact) <= found.error[:3] + 1e-13)
    assert found.error[:3].max() < 1e-11


def test_a_saddle_is_no_rest(lorenz):
    """On the z-axis every motion ends at the origin exactly, which beyond ρ = 1 is a saddle."""
    found = at_rest(lorenz.flow(), {"x": 0.0, "y": 0.0, "z": 20.0}, [0.5, 28.0], 200)
    assert found.still.tolist() == [True, False]


def test_a_spiral_that_dies_down_is_seen_before_it_rests(lorenz):
    """At ρ = 24 the amplitude about the equilibrium falls as exp(−0.0225 t): far from rest after 200 units of time."""
    side = np.sqrt(8 / 3 * 23)
    found = at_rest(lorenz.flow(), {"x": side + 0.1, "y": side, "z": 23.0}, [24.0], 200)
    assert found.fading.tolist() == [True]
    assert found.still.tolist() == [False]
    assert np.all(np.isnan(found.exponents[0]))  # nothing is linearised of a lane that moves


def test_a_spiral_that_grows_has_the_exponent_along_it():
    """Both exponents of ẋ = sx − y, ẏ = x + sy are s, below zero and above: only of bounded motions one is zero."""

    def spiral(s=0.01):
        return {"rhs": lambda y, t: (s * y[0] - y[1], y[0] + s * y[1]), "coordinates": ("x", "y")}

    s = np.array([-0.02, 0.02, 0.03])
    data = jaxnh.Session(spiral, {"x": 1.0}, 1e-8).run(jaxnh.Lyapunov(periods=512), s=s)
    assert np.all(np.abs(data["exponents"] - s[:, None]) <= data["exponents_error"] + 1e-12)
    assert np.all(data["exponents_error"] < 1e-6)
    assert np.all(np.abs(data["exponents"].sum("exponent") - data["exponent_sum"]) <= data["exponent_sum_error"])


def test_largest_exponent_across_the_flow():
    """Known zeros are taken out once: of a flow that keeps energy, the second stays; one alone says nothing."""
    exponents = np.array([[0.9, 0.0, -14.0], [0.0, 0.0, -1.0], [0.0, -0.3, -1.0], [-0.1, -0.2, -0.3]])
    errors = np.array([[0.1, 0.0, 0.1], [0.0, 0.0, 0.1], [0.0, 0.02, 0.1], [0.001, 0.1, 0.1]])
    largest, error = largest_across(exponents, errors)
    assert largest.tolist() == [0.9, 0.0, -0.3, -0.1]
    assert error.tolist() == [0.1, 0.0, 0.02, 0.001]
    slides = largest_across(np.array([[0.0, -np.inf, -np.inf]]), np.array([[0.0, 0.0, 0.0]]))
    assert [float(value[0]) for value in slides] == [-np.inf, 0.0]
    largest, error = largest_across(np.array([[0.0], [0.5]]), np.array([[0.0], [0.1]]))
    assert (largest.tolist(), error.tolist()) == ([0.0, 0.5], [np.inf, 0.1])


@pytest.mark.slow
def test_verdicts_of_lorenz(lorenz):
    """Equilibria at ρ = 10, where no crossing is left, and 22, whose spiral crosses for ever; chaos; and at 160 a cycle.

    The windows of stable cycles are those of Sparrow (The Lorenz Equations, 1982): 145 < ρ < 166 is one.
    """
    found = session_of(lorenz).tree()
    kinds = [KINDS[kind] for kind in found["verdict/kind"].to_numpy()]
    assert kinds == ["equilibrium", "equilibrium", "chaotic", "limit_cycle"]
    spectra, errors = found["lyapunov/exponents"].to_numpy(), found["lyapunov/exponents_error"].to_numpy()
    for i, rho in enumerate([10.0, 22.0]):
        assert np.all(np.abs(spectra[i] - spectrum(rho)) <= errors[i] + 1e-13)
    assert spectra[2, 0] > errors[2, 0] > 0.0
    assert spectra[3, 0] == 0.0


def pendulum(d=0.1):
    def rhs(y, t):
        x, v = y
        return v, -np.sin(1.0) * x - d * v

    return {"rhs": rhs, "coordinates": ("x", "v")}


@pytest.mark.slow
def test_a_lane_that_begins_at_rest():
    """Its exponents are those of the equilibrium, of which there was no number and the status was not_finite."""
    session = jaxnh.Session(pendulum, start={"x": 0.0, "v": 0.0}, target=1e-6)
    data = session.run(jaxnh.Lyapunov(transient=8, periods=16, exponents=2), d=[0.0, 0.1])
    assert jaxnh.labels(data["exponents_method"]).to_numpy().tolist() == ["equilibrium"] * 2
    np.testing.assert_allclose(data["exponents"], [[0.0, 0.0], [-0.05, -0.05]], atol=1e-13)
    assert not data["status"].any()
