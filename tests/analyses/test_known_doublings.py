"""Doublings of two textbook flows against heyoka's Taylor integrator with a Newton of its own."""

from __future__ import annotations

import heyoka as hy
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxnh
from jaxnh.analyses.cascade.follow import follows
from jaxnh.engine.experiment import Experiment
from tests.flows.roessler import doubling_of_roessler
from tests.helpers import taylor
from tests.helpers.heyoka_newton import bifurcation, strobe_map
from tests.helpers.kept_programs import session_of
from tests.helpers.paths import ROOT

DELTA, ALPHA = 4.669201609102990, 2.502907875095892  # Briggs, Math. Comp. 57 (1991) 435


def pendulum():
    """configs/flows/pendulum.py for `taylor`: an angle last, and one variable that stays zero and counts for nothing."""
    rate, still, phi = hy.make_vars("rate", "still", "phi")
    gamma, damping, drive = hy.par[0], hy.par[1], hy.par[4]
    natural = 1.5 * drive
    force = natural * natural * (gamma * hy.cos(drive * hy.time) - hy.sin(phi))
    return (rate, still, phi), gamma, [(rate, force - 2 * damping * natural * rate), (still, -still), (phi, rate)]


class Pendulum(taylor.Parameters):
    equations = staticmethod(pendulum)


@pytest.mark.slow
def test_doublings_of_the_driven_pendulum():
    """Within a unit of the last digit that Taylor gives (Classical Mechanics, 2005, 12.4); three to 1e-9 of heyoka.

    The first is 1.06637, where the book has 1.0663.
    """
    session = session_of(jaxnh.load(ROOT / "configs/flows/pendulum.yaml", ["analyses={doubling: {levels: 4}}"]))
    found = session.run("doubling")
    ours, errors = found["gamma"].to_numpy(), found["gamma_error"].to_numpy()
    assert found["period"].to_numpy().tolist() == [1, 2, 4, 8]
    assert np.abs(ours - [1.0663, 1.0793, 1.0821, 1.0827]).max() < 1e-4
    start = np.array([0.0, 0.0, -np.pi / 2])
    par = Pendulum(a=0.25, omega=2 * np.pi)
    exact = taylor.cascade(par, [1.0663, 1.0793, 1.0821], start, before=1.062)
    gaps = np.abs(ours[:3] - [float(value) for value, _, _ in exact])
    assert gaps.max() < 1e-9
    assert np.all(gaps < errors[:3] + [info.error for _, _, info in exact])


@pytest.mark.slow
def test_doublings_of_roessler_on_a_section():
    """The first two over c, to 1e-9 of heyoka's events and variational equations."""
    settings = [
        "analyses={doubling: {levels: 2}}",
        "sweep={c: {start: 2.6, stop: 4.0, count: 57}}",
        "accuracy.target=1e-10",
    ]
    found = session_of(jaxnh.load(ROOT / "configs/flows/roessler.yaml", settings)).run("doubling")
    ours, errors = found["c"].to_numpy(), found["c_error"].to_numpy()
    assert found["period"].to_numpy().tolist() == [1, 2]
    for value, error, n in zip(ours, errors, (1, 2), strict=True):
        exact = doubling_of_roessler(value, n)
        assert abs(value - exact) < max(1e-9, error)
        assert abs(value - exact) < error + 1e-11


@pytest.mark.slow
def test_limits_of_the_governors_cascade():
    """Feigenbaum's numbers from a flow by T, Q and f that has nothing to do with a map's formula: ten levels, float64."""
    settings = ["analyses={doubling: {levels: 10}}", "sweep.drive.start=0.83"]
    found = session_of(jaxnh.load(ROOT / "configs/governor.yaml", settings)).run("doubling")
    for name, exact, near in (("delta_limit", DELTA, 1e-6), ("alpha", ALPHA, 1e-4)):
        assert abs(found[name] - exact) < min(near, found[f"{name}_error"])
        assert found[f"{name}_error"] < 1e-5


def duffing(x, v, drive, t):
    """x'' + x'/2 − x + x³ = F cos t."""
    return v, -0.5 * v + x - x**3 + drive * hy.cos(t)


@pytest.mark.slow
def test_errors_of_the_doublings_of_duffings_oscillator(tmp_path):
    """Above the error against heyoka's map, and no more than some twenty times it: a bound of about eight, and rounding."""
    (tmp_path / "flow.py").write_text(
        "import jax.numpy as jnp\n\ndef system(drive=0.3):\n    def rhs(y, t):\n        x, v = y\n"
        "        return v, -0.5 * v + x - x**3 + drive * jnp.cos(t)\n\n"
        '    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi}\n'
    )
    text = f"""\
system: {{file: {tmp_path / "flow.py"}}}
initial: {{x: 0.1, v: 0.0}}
sweep: {{drive: {{start: 0.35, stop: 0.36, count: 64}}}}
accuracy: {{target: 1.0e-8}}
analyses:
  doubling: {{levels: 3}}
"""
    found = session_of(Experiment.from_text(text)).run("doubling")
    assert found["period"].to_numpy().tolist() == [2, 4, 8]
    u = np.array([0.1, 0.0])
    for n, value, error in zip((2, 4, 8), found["drive"].to_numpy(), found["drive_error"].to_numpy(), strict=True):
        image = strobe_map(duffing, 2, 2 * np.pi, n)
        for _ in range(300):
            u, _ = image(value - 1e-4, u)
        exact, multipliers = bifurcation(image, "period_doubling", value, u)
        assert np.abs(multipliers + 1).min() < 1e-6
        assert abs(value - exact) < error < 20 * abs(value - exact)


def cubic_henon(v=2.0, b=0.2, e=0.05):
    def image(y):
        return v * y[0] - y[0] ** 3 + e * y[0] ** 2 + y[1], -b * y[0]

    return {"map": image, "coordinates": ("x", "y")}


@pytest.mark.parametrize(("b", "e"), [(0.2, 0.05), (0.11, -0.1)])
def test_levels_that_no_lane_shows(b, e):
    """Orbits of period 16 and 32 attract over less than the distance between lanes, and one step from the mother's orbit does
    not lead to them: multiple shooting does. Ratios of distances come to Feigenbaum's constant."""
    session = jaxnh.Session(cubic_henon, start={"x": 0.1, "y": 0.05}, parameters={"b": b, "e": e})
    data = session.run(jaxnh.Doubling(levels=6), v=np.linspace(1.2, 2.5, 60))
    assert np.isfinite(data["v"].to_numpy()).all()
    delta = data["delta"].to_numpy()[1:-1]
    assert np.all(np.diff(np.abs(delta - 4.669201609)) < 0.0)
    assert delta[-1] == pytest.approx(4.669201609, rel=2e-3)


def bent_henon(v=1.4, b=0.372, e=-0.0565):
    def image(u):
        return 1.0 - v * u[0] ** 2 - e * u[0] ** 3 + u[1], -b * u[0]

    return {"map": image, "coordinates": ("x", "y")}


def multiplier_of_period_two(v, b=0.372, e=-0.0565):
    """The multiplier nearest −1 of the orbit of period 2, by Newton on its two points; the second coordinate is −b times
    the x before."""

    x = np.array([-0.35, 0.9])
    for _ in range(40):
        left = 1.0 - v * x**2 - e * x**3 - (1.0 + b) * x[::-1]
        x = x - np.linalg.solve(np.diag(-2.0 * v * x - 3.0 * e * x**2) - (1.0 + b) * np.eye(2)[::-1], left)
    assert abs(x[0] - x[1]) > 0.5
    turns = [np.array([[-2.0 * v * t - 3.0 * e * t * t, 1.0], [-b, 0.0]]) for t in x]
    return float(np.min(np.real(np.linalg.eigvals(turns[1] @ turns[0]))))


def test_a_cascade_whose_motions_escape():
    """From this start most lanes beyond the first doubling escape: the orbit is followed without them."""
    data = jaxnh.Session(bent_henon, start={"x": 0.1, "y": 0.05}).run(
        jaxnh.Doubling(levels=2), v=np.linspace(0.9, 1.99, 60)
    )
    exact = brentq(lambda v: multiplier_of_period_two(v) + 1.0, 1.9, 2.2, xtol=1e-14)
    assert data["period"].to_numpy().tolist() == [1, 2]
    assert abs(float(data["v"][1]) - exact) < 1e-12


@pytest.mark.parametrize(
    ("values", "may"),
    [
        ([1.0, 9.0], True),  # of two there is no ratio
        ([0.0, 1.0, 1.2], True),
        ([0.0, 1.0, 1.01], False),
        ([0.0, 1.0, 4.0], False),
        ([0.0, -1.0, -1.2, -1.24], True),
        ([0.0, -1.0, -1.2, -1.35], False),
    ],
)
def test_doublings_of_other_orbits(values, may):
    """The first distance is a tenth to ten times what is expected; of later ones the ratio a third to three times the last."""
    assert follows(values) is may
