"""The study of flows: that all contestants integrate the same flow, and the page that it writes."""

from __future__ import annotations

from importlib.util import find_spec

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.maps.build import make_return_map
from jaxnh.solvers import dopri8
from sweeps.peers.flows.peers_flow_cases import CASES
from sweeps.peers.flows.peers_flow_heyoka import Contestant as Heyoka
from sweeps.peers.flows.peers_flow_heyoka import clocks, true_scene
from sweeps.peers.flows.peers_flow_jaxnh import Contestant, placed
from sweeps.peers.flows.peers_flow_pynamicalsys_tangent import MODELS
from sweeps.peers.flows.peers_flows import MAPS, SPECTRA
from sweeps.peers.flows.peers_flows_report import FlowRows, FlowStudy, markdown
from sweeps.peers.particle.peers import CONTESTANTS, TANGENT_CONTESTANTS
from sweeps.peers.particle.peers_heyoka_tangent import tangent_equations
from sweeps.peers.particle.peers_report import AT_OWN_ERROR, Row
from sweeps.peers.particle.peers_scene import Errors, Setting
from sweeps.peers.particle.peers_worker import module


@pytest.mark.parametrize("kind", [*CONTESTANTS, *TANGENT_CONTESTANTS, *MAPS, *SPECTRA])
def test_module_of_a_contestant(kind):
    """A contestant is imported by its kind in a process of its own, which no other test starts."""
    assert find_spec(module(kind)), kind


@pytest.mark.parametrize("name", CASES)
def test_what_users_write_is_the_flow_of_the_others(name):
    """The rates of jaxnh's flow, by T, Q and f where it has them, are those of the equations solved by hand."""
    case, flow = CASES[name], placed(CASES[name])
    rng = np.random.default_rng(1)
    for _ in range(4):
        y = np.array(case.start) + rng.uniform(-0.5, 0.5, len(case.start))
        value, t = rng.uniform(case.low, case.high), rng.uniform(0.0, case.period)
        state = flow.flow.chart.state(flow.embed(jnp.asarray(y)))
        rate = flow.flow.rhs(t, state, {case.parameter: value})
        ours = np.asarray(flow.flow.chart.lower(state, rate))[list(flow.picks)]
        force = {"sin": np.sin, "cos": np.cos}.get(case.forcing, np.zeros_like)(t)
        theirs = np.array(case.field(np, y, force, value))
        assert np.abs(ours - theirs).max() < 1e-13 * (1.0 + np.abs(theirs).max())


def test_errors_of_both_contestants():
    """Of the pendulum: heyoka in long double is what the map is compared with, and both come to it as they refine."""
    case = CASES["pendulum"]
    scene = true_scene(case, np.linspace(case.low, case.high, 4))
    ours, theirs = Contestant(scene), Heyoka(scene)
    errors = [ours.errors(make_return_map(ours.placed.flow, dopri8, steps)).max for steps in (40, 80)]
    assert errors[1] < 2.0**-7 * errors[0] < 1e-5  # order eight, one power left for the terms that follow
    for clock in clocks(case):
        measured = [theirs._measured(clock, 4, (), order).max for order in (10, 18)]
        assert measured[1] < 1e-12 < measured[0] < 1e-5


def test_variational_equations_of_a_flow():
    """Their columns are the derivative of the map: against differences of nearby ends in long double, error h² u'''."""
    case = CASES["lorenz"]
    scene = true_scene(case, np.array([30.0]))
    assert scene.derivatives.shape == (1, 3, 3)
    flow = placed(case).flow
    strobe = make_return_map(flow, dopri8, 160)
    run = jax.jit(lambda z: strobe(z, {"rho": 30.0}))

    def end(y):
        return np.asarray(flow.chart.point(run(flow.chart.state(jnp.asarray(y)))))

    y, h = scene.states[1], 1e-4
    columns = [(end(y + h * e) - end(y - h * e)) / (2 * h) for e in np.eye(3)]
    assert np.abs(np.stack(columns, axis=-1) - scene.derivatives[0].astype(float)).max() < 1e-4


def test_variational_equations_leave_the_clock_alone():
    """Two variables, four of tangents, and the clock's two."""
    import heyoka as hy

    x, v, sine, cosine = hy.make_vars("x", "v", "sine", "cosine")
    motion = [(x, v), (v, cosine - hy.sin(x)), (sine, cosine), (cosine, -sine)]
    assert len(tangent_equations(motion, 2)) == 8


def test_models_of_pynamicalsys_are_the_flows():
    """Its rates, at the parameters that the study gives it, are those of the equations written by hand."""
    models = pytest.importorskip("pynamicalsys.continuous_time.models", reason="the extra `peers` is not installed")
    names = {"duffing": models.duffing, "lorenz": models.lorenz_system, "roessler": models.rossler_system}
    assert set(names) == set(MODELS)
    for name, model in names.items():
        case, t, value = CASES[name], 0.7, 0.5 * (CASES[name].low + CASES[name].high)
        y = np.array(case.start) + 0.3
        force = {"sin": np.sin, "cos": np.cos}.get(case.forcing, np.zeros_like)(t)
        theirs = model(t, y, np.array(MODELS[name][1](value)))
        assert np.abs(theirs - np.array(case.field(np, y, force, value))).max() < 1e-13 * (1.0 + np.abs(theirs).max())


def test_page_of_flows():
    """A line a flow with what is wanted, at heyoka's own error; the flows in words; what was written by hand is kept."""

    def row(name, ratio):
        setting = Setting(name, "dopri8", 30.0, "30 steps", Errors(1e-7, 1e-8))
        return Row(1e-6, name, setting, [1e5] * 3, [1.0] * 3, [ratio] * 3, [ratio] * 3, [])

    rows = [row("jaxnh", 1.0), row("heyoka batch", 9.0), row("diffrax Dopri8", 40.0), row(AT_OWN_ERROR, 7.0)]
    flows = [FlowRows(CASES["duffing"], rows, []), FlowRows(CASES["double_pendulum"], rows, [])]
    study = FlowStudy("python -m sweeps.peers.flows.peers_flows", "Measured at commit 0.", 3, 256, flows, 1.0)
    page = markdown(study, "old\n<!-- Below this line: written by hand, kept by the next run. -->\nby hand\n")
    assert "| duffing | 7.00 ± 0.00× (meets 6) |" in page
    assert "| double_pendulum | 7.00 ± 0.00× |" in page
    assert "| duffing | 40.0 ± 0.0× |" in page
    assert "gamma in [0.2, 0.5]" in page
    assert "Spectra" not in page
    assert page.endswith("-->\nby hand\n")
