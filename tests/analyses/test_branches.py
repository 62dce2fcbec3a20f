"""Branches through the whole package: a pitchfork in closed form, and doublings of the particle and of Roessler's flow."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp

import jaxnh
from jaxnh.analyses.continuation.branches import ANALYSIS
from jaxnh.exceptions import ConfigError
from jaxnh.orbits.continuation.kinds import KINDS
from jaxnh.orbits.continuation.paths import ENDS
from jaxnh.systems.particle import constant_speed
from tests.flows.normal_forms import normal_form
from tests.flows.particle import twin
from tests.flows.roessler import doubling_of_roessler
from tests.helpers import taylor
from tests.helpers.kept_programs import session_of
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.usefixtures("shared_programs", "quick_compiling")


def pitchfork(folder, sweep="mu: {start: -0.5, stop: 0.7, count: 12}", options="{max_period: 2, transient: 64}"):
    initial = f"{{x: 0.3{'' if 'z:' in sweep else ', z: 0.1'}}}"
    return normal_form(folder, "mu * x - x**3", "mu=0.0", initial, sweep, f"branches: {options}")


def test_table_of_bifurcations():
    """A row each in the order of the file, with the words of the flags and as many digits as the error has."""
    n = np.array
    kinds = [KINDS.index(kind) for kind in ("hopf", "period_doubling", "fold")]
    columns = {"kind": n(kinds), "period": n([0, 2, 1]), "mu": n([0.25, 1.5, 2.123456]),
               "mu_error": n([2e-4, 1e-7, 3.0]), "criticality": n([1, -1, 0])}  # fmt: skip
    data = xr.Dataset({name: ("bifurcation", v) for name, v in columns.items()}, attrs={"along": "mu"})
    found = ANALYSIS.other_tables["bifurcations"](data)
    assert found.heads == ("bifurcation", "period", "mu", "criticality")
    assert found.rows == (
        ("hopf", "equilibrium", "0.2500 ± 0.0002", "supercritical"),
        ("period doubling", "2", "1.5000000 ± 1e-07", "subcritical"),
        ("fold", "1", "2 ± 3", "–"),
    )


@pytest.mark.slow
def test_pitchfork_from_lanes_that_have_settled(tmp_path):
    """Lanes on x = √μ lead to all: x = 0 from end to end, and both sides of the pitchfork at μ = 0."""
    tree = session_of(pitchfork(tmp_path)).tree()
    branches, marks = tree["branches"], tree["bifurcations"]
    assert [KINDS[kind] for kind in marks["kind"].values] == ["branch_point"]
    assert abs(float(marks["mu"][0])) < min(1e-8, float(marks["mu_error"][0]))
    assert int(marks["criticality"][0]) == 1
    names = ("mu", "x", "stable", "multipliers")
    zero, root = 0, []
    for k in range(branches.sizes["branch"]):
        mu, x, stable, multipliers = (branches[name].values[k] for name in names)
        known = np.isfinite(mu)
        assert np.all(stable[~known] == -1)
        mu, x, stable, largest = mu[known], x[known], stable[known], multipliers[known, 0, 0]
        if np.abs(x).max() < 1e-6:
            zero += 1
            assert np.abs(largest - np.exp(np.maximum(mu, -1.0))).max() < 1e-9  # over a unit of time
            assert np.array_equal(stable == 1, largest < 1.0)
            assert (mu.min(), mu.max()) == (-0.5, 0.7)
        else:
            root += [x.min(), x.max()]
            assert np.abs(x**2 - mu).max() < 1e-9
            assert np.all(stable == 1)
    assert zero == 1
    assert min(root) == pytest.approx(-np.sqrt(0.7), abs=1e-9)
    assert max(root) == pytest.approx(np.sqrt(0.7), abs=1e-9)


@pytest.mark.slow  # the matrix has branches on sections
def test_lanes_that_have_come_to_rest_are_on_no_branch(tmp_path):
    """Below the Hopf bifurcation of r′ = μr − r³ lanes come back to a section through the equilibrium, ever nearer to it."""
    (tmp_path / "hopf.py").write_text(
        "def system(mu=0.5):\n    def rhs(state, t):\n        x, y = state\n        growth = mu - x * x - y * y\n"
        "        return growth * x - 2.0 * y, growth * y + 2.0 * x\n\n"
        '    return {"rhs": rhs, "coordinates": ("x", "y")}\n'
    )
    (tmp_path / "hopf.yaml").write_text(
        "system: {file: hopf.py}\ninitial: {x: 0.5}\nsweep: {mu: {start: -0.6, stop: 0.6, count: 6}}\n"
        "section: {coordinate: y, value: 0.0, direction: up}\naccuracy: {target: 1.0e-6}\n"
        "analyses: {branches: {max_period: 1, transient: 64}, windows: {max_period: 1, transient: 64, levels: 0}}\n"
    )
    tree = session_of(jaxnh.load(tmp_path / "hopf.yaml")).tree()
    branches = tree["branches"]
    mu, x = branches["mu"].values, branches["x"].values
    known = np.isfinite(mu)
    assert np.abs(x[known] ** 2 - mu[known]).max() < 1e-5
    assert mu[known].min() > -1e-9
    assert int(branches["not_located"]) == 0
    assert np.all(branches["not_located_kind"].values == -1)
    assert tree["windows"].sizes["window"] == 1


def _cubic(mu=1.5):
    def image(state):
        (x,) = state
        return (x + 0.3 * x * (x * x - mu),)

    return {"map": image, "coordinates": ("x",)}


@pytest.mark.parametrize("n_starts", [4, 16])
def test_random_starts_say_how_thoroughly_they_searched(n_starts):
    """Of x + 0.3x(x² − μ): lanes settle on zero, and only random starts lead to ±√μ, by Newton's own basins."""
    box, values = (-2.0, 2.0), (1.0, 2.0)
    options = jaxnh.Branches(max_period=1, n_starts=n_starts, n_values=2, seed=3, box={"x": box})
    session = jaxnh.Session(_cubic, start={"x": 0.1})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jaxnh.JaxnhWarning)
        branches = session.run(options, mu=np.linspace(*values, 5))
    starts = dict(zip(np.sign(branches["x"].values[:, 0]).astype(int).tolist(), branches["starts"].values, strict=True))
    assert set(starts) == {-1, 0, 1}
    assert (
        max(starts.values()) <= 2 * n_starts
    )  # a start counts once, at whatever place of its motion an orbit was near
    assert sum(starts.values()) >= 2 * n_starts  # each leads to one orbit at least
    alone = [starts[side] for side in (-1, 1)].count(1)
    expected = f"of the 2 that only random starts led to, {alone} by a single one of {2 * n_starts}: " if alone else ""
    assert alone == (1 if n_starts == 4 else 0)
    said = branches.attrs.get("warnings", "")
    assert expected in said
    assert bool(said) == bool(alone)


@pytest.mark.slow
def test_random_starts_find_what_no_lane_settles_on(tmp_path):
    """Far beyond the pitchfork x = 0 repels; Newton finds it all the same, and x = −√μ, where no lane goes."""
    options = "{max_period: 1, transient: 64, n_starts: 16, n_values: 2, seed: 3, box: {x: [-1.5, 1.5], z: [-1, 1]}}"
    sweep = "mu: {start: 0.3, stop: 0.7, count: 3}"
    data = session_of(pitchfork(tmp_path, sweep, options)).tree()["branches"]
    middle = [float(np.nanmedian(row)) for row in data["x"].values]
    assert len(middle) == 3
    assert sorted(np.sign(np.round(middle, 6))) == [-1, 0, 1]
    assert all({ENDS[int(data[end][k])] for end in ("begins", "ends")} == {"range"} for k in range(3))


@pytest.mark.parametrize(
    ("sweep", "options", "message"),
    [
        ("z: {start: 0.1, stop: 0.5, count: 3}", "{}", "z is a coordinate of the start state"),
        ("mu: {start: 0.1, stop: 0.5, count: 3}, z: {values: [0.1, 0.2]}", "{}", "along one axis; leave out z"),
        ("mu: {values: [0.1]}", "{}", "the sweep has one value of it"),
        ("mu: {values: [0.1, 0.2]}", "{n_starts: 4}", "needs a box to draw from"),
        ("mu: {values: [0.1, 0.2]}", "{seed: 4}", "goes with n_starts or equilibria, and there are none"),
        ("mu: {values: [0.1, 0.2]}", "{n_starts: 4, box: {w: [0, 1]}}", "there is no coordinate w"),
    ],
)
def test_what_branches_cannot_do_is_said(tmp_path, sweep, options, message):
    with pytest.raises(ConfigError, match=message):
        pitchfork(tmp_path, sweep, options).requested()


@pytest.mark.slow
def test_doublings_of_the_particle():
    """Three, found from one orbit of period 1, against the Taylor reference: to 1e-8, and within their errors."""
    settings = [
        "sweep={b: {start: 5.45, stop: 5.6, count: 4}}",
        "analyses={branches: {max_period: 4, transient: 256}}",
    ]
    found = session_of(jaxnh.load(ROOT / "configs/branches.yaml", settings)).tree()["bifurcations"]
    kinds = [KINDS[kind] for kind in found["kind"].values.tolist()]
    doublings = {int(n): k for k, n in enumerate(found["period"].values) if kinds[k] == "period_doubling"}
    for n in (1, 2, 4):
        value, error = (float(found[name][doublings[n]]) for name in ("b", "b_error"))
        first = np.array([float(found[name][doublings[n]]) for name in ("x1", "y1", "x2", "y2")])
        u = np.array([first[0], first[1], np.arctan2(first[3], first[2])])
        par = twin(constant_speed())
        exact = float(taylor.doubling_point(par, n, value, taylor.orbit(par, n, value, u)[0])[0])
        assert abs(value - exact) < min(1e-8, error)
        assert int(found["criticality"][doublings[n]]) == 1


@pytest.mark.slow
def test_doublings_of_roessler_on_a_section():
    """The first two over c, to 1e-8 of heyoka's events and variational equations, from lanes on a section."""
    settings = [
        "analyses={branches: {max_period: 2, transient: 256}}",
        "sweep={c: {start: 2.6, stop: 4.0, count: 8}}",
        "accuracy.target=1e-10",
    ]
    found = session_of(jaxnh.load(ROOT / "configs/flows/roessler.yaml", settings)).tree()["bifurcations"]
    kinds = [KINDS[kind] for kind in found["kind"].values.tolist()]
    assert kinds == ["period_doubling"] * 2
    assert found["period"].values.tolist() == [1, 2]
    for k, n in enumerate((1, 2)):
        value, error = float(found["c"][k]), float(found["c_error"][k])
        assert abs(value - doubling_of_roessler(value, n)) < min(1e-8, error + 1e-11)


def coupled_oscillators(square=0.45, coupling=0.3):
    """Potential x²/2 + square y²/2 + coupling x² y²/2, whose plane y = 0 has harmonic motion."""

    def T(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2)

    def V(q):
        return 0.5 * (q[0] ** 2 + square * q[1] ** 2 + coupling * q[0] ** 2 * q[1] ** 2)

    def Q(q, v, t):
        return -q[0] - coupling * q[0] * q[1] ** 2, -square * q[1] - coupling * q[0] ** 2 * q[1]

    integrals = {"energy": lambda q, v, t: T(q, v, t) + V(q)}
    return {"T": T, "Q": Q, "coordinates": ("x", "y"), "integrals": integrals}


@pytest.mark.slow  # levels of mechanics, and branches, are quick apart
def test_a_branch_over_a_level():
    """The orbit x = √(2E) sin t, y = 0 over its energy; the trace of its multipliers is that of Mathieu's equation.

    The equation for y is η̈ + (square + 2E coupling sin² t) η = 0. Its solutions come from DOP853 at 1e-12.
    """
    session = jaxnh.Session(coupled_oscillators, start={"x_dot": 1.0}, target=1e-9).on("x", 0.0, "up")
    box = {"y": (-0.02, 0.02), "y_dot": (-0.02, 0.02)}
    options = jaxnh.Branches(max_period=1, n_starts=2, n_values=1, box=box, method="shooting", transient=1)
    data = session.run(options, energy=np.linspace(0.2, 0.8, 3))
    energies, multipliers = data["energy"].to_numpy()[0], data["multipliers"].to_numpy()[0]
    known = np.isfinite(energies)
    assert energies[known].min() == pytest.approx(0.2)
    assert energies[known].max() == pytest.approx(0.8)
    for energy, of_orbit in zip(energies[known], multipliers[known], strict=True):

        def transverse(t, z, energy=energy):
            square = 0.45 + 0.6 * energy * np.sin(t) ** 2
            return z[2], z[3], -square * z[0], -square * z[1]

        end = solve_ivp(transverse, (0.0, 2.0 * np.pi), (1.0, 0.0, 0.0, 1.0), "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
        assert of_orbit[:, 0].sum() == pytest.approx(end[0] + end[3], abs=1e-6)
