"""Spectra of flows that users write, beside heyoka's variational equations, and what is exactly known of them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.batch import LaneBatch
from jaxnh.analyses.exponents import lyapunov
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.solvers import dopri8
from tests.helpers.kept_programs import session_of
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.slow

COUNT, TRANSIENT, PERIODS, LONGER = 32, 64, 512, 4
STEPS = {"duffing": 48, "pendulum": 40, "governor": 96, "lorenz": 192, "roessler": 16, "double_pendulum": 48}
"""Steps of a period or unit of time whose map is right to about 1e-9 in all lanes (results/peers_flows.md)."""
PARTS = {"duffing": 2, "pendulum": 1, "governor": 2, "lorenz": 4, "roessler": 2, "double_pendulum": 4}


def by_heyoka(name):
    """Exponents of COUNT lanes, (lanes, d), LONGER times as long as ours, and the states that they are taken from."""
    from sweeps.peers.flows.peers_flow_cases import CASES, FlowScene
    from sweeps.peers.flows.peers_flow_heyoka_tangent import Contestant

    case = CASES[name]
    values, start = np.linspace(case.low, case.high, COUNT), np.array(case.start)
    states = np.tile(start, (COUNT, 1))
    for periods in (TRANSIENT, LONGER * PERIODS):
        scene = FlowScene(name, np.tile(values, 2), np.tile(states, (2, 1)), np.empty(0), np.empty(0))
        heyoka = Contestant(scene)
        fleet = heyoka.fleet((heyoka.clocks[0], 4, (), 16))
        logs = heyoka.grown(fleet, PARTS[name], 0, case.period, periods)
        if periods == TRANSIENT:
            states = np.concatenate([one.integrator.state[: len(start)].T for one in fleet])
    return np.sort(logs.T / (periods * case.period), axis=1)[:, ::-1], states


@pytest.mark.parametrize("name", STEPS)
def test_spectra_beside_heyoka(name):
    """Of all bars at most 10 % miss an average that is four times as long, but for what that average has of its own.

    That is half of a bar, and what a finite window keeps of the tangents: a factor of 100 in their lengths, and of its
    length in neutral ones, which grow in proportion to time where the frequencies of a motion depend on its energy.
    """
    from sweeps.peers.flows.peers_flow_cases import CASES
    from sweeps.peers.flows.peers_flow_jaxnh import placed

    case, there = CASES[name], placed(CASES[name])
    reference, states = by_heyoka(name)
    flow, k = there.flow, there.flow.exponents
    assert k == reference.shape[1]
    start = jax.vmap(lambda y: flow.chart.state(there.embed(y)))(jnp.asarray(states))
    p = {case.parameter: np.linspace(case.low, case.high, COUNT)}
    scene = LaneBatch(flow, jax.tree.map(np.asarray, start), p, dopri8, STEPS[name], False, 1e-8)
    options = lyapunov.LyapunovOptions(transient=0, periods=PERIODS, exponents=k)
    found = lyapunov.run(options, scene, LaneExecutor())
    exponents, errors = found["exponents"].to_numpy(), found["exponents_error"].to_numpy()
    window = LONGER * PERIODS * case.period
    allowed = 1.5 * errors + np.log(100.0 * window) / window
    assert np.mean(np.abs(exponents - reference) > allowed) <= 0.1
    assert np.median(errors[:, 0]) < 0.1  # bars that say something


def test_roessler_and_its_exact_sum():
    """0.0714, 0, −5.3943 at a = b = 0.2, c = 5.7 (Sprott 2003); the sum is the mean of a + x − c, by the divergence.

    What is left of the sum is what steps make of a volume that shrinks by e⁻³⁰ a turn: it falls with the target. A lane
    alone is beyond its 95 % bar once in twenty times, whatever it is: of sixteen starts five are so once in 1,200 times.
    """
    settings = [
        "system.c=5.7",
        "initial={y: 1.0, z: 0.0}",
        "sweep={x: {start: 1.0, stop: 9.0, count: 16}}",
        "analyses={lyapunov: {transient: 256, periods: 8192, exponents: 3}}",
        "accuracy.target=1e-10",
    ]
    experiment = jaxnh.load(ROOT / "configs/flows/roessler.yaml", settings)
    found = session_of(experiment).run("lyapunov")
    exponents, errors = (found[key].to_numpy() for key in ("exponents", "exponents_error"))
    assert (np.abs(exponents - [0.0714, 0.0, -5.3943]) > errors + 5e-5).sum(axis=0).max() < 5
    assert errors[:, 0].max() < 0.012
    assert abs(exponents[:, 0].mean() - 0.0714) < errors[:, 0].mean() / 4.0 + 5e-5  # of sixteen together
    assert np.abs(found["sum_rule_residual"].to_numpy()).max() < 1e-6


def test_henon_and_heiles_in_pairs():
    """A Hamiltonian flow: exponents λ, 0, 0, −λ, their sum zero to rounding; chaos at a higher energy, order at a low one."""
    experiment = jaxnh.load(
        ROOT / "configs/flows/henon_heiles.yaml",
        ["sweep.x_dot={values: [0.3, 0.5]}", "analyses={lyapunov: {transient: 64, periods: 4096, exponents: 4}}"],
    )
    found = session_of(experiment).run("lyapunov")
    exponents, errors = (found[key].to_numpy() for key in ("exponents", "exponents_error"))
    assert np.all(np.abs(exponents + exponents[:, ::-1]) <= errors + errors[:, ::-1])
    assert np.abs(found["sum_rule_residual"].to_numpy()).max() < 1e-8
    assert exponents[0, 0] <= errors[0, 0]
    assert exponents[1, 0] > errors[1, 0]
