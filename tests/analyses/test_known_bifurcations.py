"""Bifurcations that `branches` finds against heyoka's Taylor integrator with a Newton of its own: parameter and kind."""

from __future__ import annotations

import heyoka as hy
import numpy as np
import pytest

import jaxnh
from jaxnh.orbits.continuation.kinds import KINDS
from jaxnh.systems.particle import constant_speed
from tests.flows.cycles import circuit, peroxidase
from tests.flows.particle import twin
from tests.helpers import taylor
from tests.helpers.heyoka_newton import bifurcation, section_map, strobe_map
from tests.helpers.kept_programs import session_of
from tests.helpers.paths import ROOT


def found_in(config, sweep, options, *more):
    """Bifurcations of a config, as (kind, period, parameter, error, coordinates of the first point)."""
    settings = [f"sweep={{{sweep}}}", f"analyses={{branches: {options}}}", "accuracy.target=1e-10", *more]
    data = session_of(jaxnh.load(ROOT / config, settings)).tree()["bifurcations"]
    name = data.attrs["along"]
    columns = (data[k].values.tolist() for k in ("kind", "period", name, f"{name}_error"))
    return [
        (KINDS[kind], n, value, error, k) for k, (kind, n, value, error) in enumerate(zip(*columns, strict=True))
    ], data


def cosine(x):
    return hy.cos(x) if isinstance(x, hy.expression) else np.cos(x)


def duffing(x, v, gamma, t):
    """configs/flows/duffing.py with two wells and a friction of 0.2, as the config has it."""
    return v, gamma * cosine(t) - taylor.REAL(0.2) * v + x - x * x * x


def deeper_wells(x, v, gamma, t):
    """The same with a friction of 0.25 and a force of the wells of 0.7 (x − x³)."""
    return v, gamma * cosine(t) - v / 4 + taylor.REAL(0.7) * (x - x * x * x)


def van_der_pol(x, v, force, t):
    """configs/flows/van_der_pol.py at mu = 0.5 and omega = 1.3."""
    return v, (1 - x * x) * v / 2 - x + force * cosine(taylor.REAL(1.3) * t)


@pytest.mark.slow
def test_folds_of_duffings_oscillator_in_both_wells():
    """The orbits that the two wells are born with, of one fold each, end at one value of the drive."""
    found, data = found_in(
        "configs/flows/duffing_double_well.yaml",
        "gamma: {start: 0.2, stop: 0.3, count: 9}",
        "{max_period: 1, transient: 256, n_starts: 8, n_values: 2, seed: 1, box: {x: [-1.5, 1.5], v: [-0.5, 0.5]}}",
    )
    folds = [point for point in found if point[:2] == ("fold", 1)]
    assert len(folds) == len({float(np.sign(data["x"][k])) for *_, k in folds}) == 2
    for _, _, value, error, k in folds:
        u = [float(data[name][k]) for name in ("x", "v")]
        exact, multipliers = bifurcation(strobe_map(duffing, 2, taylor.TWO_PI), "fold", value, u)
        assert abs(value - exact) < min(1e-8, error + 1e-12)  # of differences in the reference
        assert np.abs(multipliers - 1).min() < 1e-6


@pytest.mark.slow
def test_cascade_of_duffings_oscillator():
    """The orbit in a well doubles, and doubles again, before chaos is in both wells: the first three of each well."""
    found, data = found_in(
        "configs/flows/duffing_double_well.yaml",
        "gamma: {start: 0.182, stop: 0.206, count: 9}",
        "{max_period: 4, transient: 256}",
        f"system={{file: {ROOT / 'configs/flows/duffing.py'}, alpha: -0.7, beta: 0.7, delta: 0.25}}",
    )
    doublings = [point for point in found if point[0] == "period_doubling" and int(data["criticality"][point[4]]) == 1]
    assert {1, 2, 4} <= {n for _, n, *_ in doublings}
    for _, n, value, error, k in doublings:
        u = [float(data[name][k]) for name in ("x", "v")]
        exact, multipliers = bifurcation(strobe_map(deeper_wells, 2, taylor.TWO_PI, n), "period_doubling", value, u)
        assert abs(value - exact) < min(1e-8, error + 1e-12)  # of differences in the reference
        assert np.abs(multipliers + 1).min() < 1e-6


@pytest.mark.slow
def test_torus_is_born_in_van_der_pols_oscillator():
    """Below a force the oscillation is not entrained: a Neimark–Sacker bifurcation, and nothing else."""
    file = ROOT / "configs/flows/van_der_pol.py"
    found, data = found_in(
        "configs/flows/van_der_pol.yaml",
        "force: {start: 0.8, stop: 1.6, count: 5}",
        "{max_period: 1, transient: 128}",
        f"system={{file: {file}, mu: 0.5, omega: 1.3}}",
    )
    [(kind, n, value, error, _)] = found
    assert (kind, n) == ("neimark_sacker", 1)
    u = [float(data[name][0]) for name in ("x", "v")]
    period = taylor.TWO_PI / taylor.REAL(1.3)
    exact, multipliers = bifurcation(strobe_map(van_der_pol, 2, period), kind, value, u)
    assert abs(value - exact) < min(1e-8, error + 1e-12)
    assert np.abs(np.abs(multipliers) - 1).max() < 1e-9
    assert np.abs(multipliers.imag).min() > 0.5


@pytest.mark.slow
def test_pitchfork_of_the_particle():
    """An orbit of period 4 that is its own mirror image after two periods, (x1, y1, n) → −(x1, y1, n), loses that.

    The map of two periods and the mirror has it as a fixed point, and there a multiplier −1: a doubling.
    """
    found, data = found_in("configs/branches.yaml", "b: {start: 4.15, stop: 4.25, count: 4}", "{max_period: 4}")
    [(_, n, value, error, k)] = [point for point in found if point[0] == "branch_point"]
    assert n == 4
    assert int(data["criticality"][k]) == 1
    x1, y1, x2, y2 = (float(data[name][k]) for name in ("x1", "y1", "x2", "y2"))
    par, mirror = twin(constant_speed()), np.diag([-1, -1, 1]).astype(taylor.REAL)

    def mirrored(b, u):
        whole = np.eye(3, dtype=taylor.REAL)
        for _ in range(2):
            [u], [matrix], _ = taylor.strobe_jacobian(par, b, u)
            whole = matrix @ whole
        return mirror @ u + np.array([0, 0, taylor.TWO_PI / 2]), mirror @ whole

    def wrap(gap):
        return gap - np.array([0, 0, taylor.turns(gap[2])])

    exact, multipliers = bifurcation(mirrored, "period_doubling", value, [x1, y1, np.arctan2(y2, x2)], wrap)
    assert abs(value - exact) < min(1e-8, error + 1e-12)
    assert np.abs(multipliers + 1).min() < 1e-9


@pytest.mark.slow
def test_fold_and_torus_of_the_peroxidase_reaction():
    """Steinmetz and Larter's: the fold and the Neimark–Sacker bifurcation that BifurcationKit's tutorial follows.

    It has ns at k8 ≈ 0.82521357 and bp at 0.84391360, in its documentation of version 0.3.2: 1.1e-5 and 1.2e-8 beside
    heyoka's.
    """
    found, data = found_in(
        "configs/flows/peroxidase.yaml",
        "k8: {start: 0.79, stop: 0.86, count: 8}",
        "{max_period: 1, transient: 64}",
    )
    assert [point[:2] for point in found] == [("neimark_sacker", 1), ("fold", 1)]
    returns = section_map(peroxidase, 4, 0, 5.9, -1)
    for (kind, _, value, error, k), known, near in zip(found, (0.82521357, 0.84391360), (2e-5, 2e-8), strict=True):
        exact, multipliers = bifurcation(returns, kind, value, [float(data[name][k]) for name in ("b", "x", "y")])
        assert abs(value - exact) < min(1e-8, error + 1e-11)  # of differences in the reference, whose states reach 10
        assert abs(exact - known) < near
        critical = np.abs(multipliers - 1) if kind == "fold" else np.abs(np.abs(multipliers) - 1)
        assert np.sort(critical)[: 1 if kind == "fold" else 2].max() < 1e-6


@pytest.mark.slow
def test_cycles_of_the_circuit():
    """MatCont's torBPC: a fold, a Neimark–Sacker bifurcation and a doubling of one cycle, as its test run has them.

    -0.584492842, -0.595750404 and -0.614681654 with 25 intervals of four points (`testtorBPC1`, MatCont 7.6): its
    collocation is good for six digits.
    """
    found, data = found_in(
        "configs/flows/circuit.yaml", "nu: {start: -0.65, stop: -0.58, count: 8}", "{max_period: 1, transient: 256}"
    )
    assert [point[:2] for point in found] == [("period_doubling", 1), ("neimark_sacker", 1), ("fold", 1)]
    returns = section_map(circuit(0.001, 0.32858, 0.93358), 3, 2, 0.02, 1)
    for (kind, _, value, error, k), known in zip(found, (-0.614681654, -0.595750404, -0.584492842), strict=True):
        exact, multipliers = bifurcation(returns, kind, value, [float(data[name][k]) for name in ("x", "y")])
        assert abs(value - exact) < min(1e-8, error + 1e-11)
        assert abs(exact - known) < 1e-6
        critical = {"fold": np.abs(multipliers - 1).min(), "period_doubling": np.abs(multipliers + 1).min()}
        assert critical.get(kind, np.abs(np.abs(multipliers) - 1).max()) < 1e-6


@pytest.mark.slow
def test_symmetric_cycles_of_the_circuit():
    """Without epsilon a cycle that is its own mirror image folds and loses that; both twins have a torus and double.

    The map from a crossing to the next one the other way, mirrored, has the first cycle as a fixed point: where it is
    no more its own image, there is a multiplier −1.
    """
    found, data = found_in(
        "configs/flows/circuit.yaml",
        "nu: {start: -0.63, stop: -0.58, count: 6}",
        "{max_period: 1, transient: 128, n_starts: 32, n_values: 3, seed: 1, "
        "box: {x: [-1.2, 1.2], y: [-0.8, 0.8], z: [-0.1, 0.1]}}",
        f"system={{file: {ROOT / 'configs/flows/circuit.py'}, epsilon: 0.0}}",
        "initial={x: 0.1, y: 0.1, z: 0.0}",
        "section={coordinate: z, value: 0.0, direction: up}",
    )
    whole, half = (section_map(circuit(0.0, 0.32858, 0.93358), 3, 2, 0.0, direction) for direction in (1, -1))

    def mirrored(nu, u):
        image, matrix = half(nu, u)
        return -image, -matrix

    kinds = sorted(kind for kind, *_ in found)
    assert kinds == ["branch_point", "fold", *2 * ["neimark_sacker"], *2 * ["period_doubling"]]
    for kind, _, value, error, k in found:
        u = [float(data[name][k]) for name in ("x", "y")]
        image, which = (mirrored, "period_doubling") if kind == "branch_point" else (whole, kind)
        exact, _ = bifurcation(image, which, value, u)
        assert abs(value - exact) < min(1e-8, error + 1e-11)


ADAPTIVE = """
def system(alpha=0.8, beta=1.0):
    def rhs(state, t):
        x, y, z = state
        return y, z, -alpha * z - beta * y - x + x**2

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}
"""

MORRIS_LECAR = """
import jax.numpy as jnp


def system(y=0.08, z=0.1):
    def rhs(state, t):
        v, w = state
        opened, rest = (1 + jnp.tanh((v + 0.01) / 0.15)) / 2, (1 + jnp.tanh((v - z) / 0.145)) / 2
        calm = y - 0.5 * (v + 0.5) - 2 * w * (v + 0.7)
        return calm - opened * (v - 1), 1.15 * (rest - w) * jnp.cosh((v - 0.1) / 0.29)

    return {"rhs": rhs, "coordinates": ("v", "w")}
"""


def adaptive(x, y, z, alpha, t):
    """As in the file."""
    return y, z, -alpha * z - y - x + x * x


def morris_lecar(v, w, y, t):
    """As in the file, at z = 0.1."""
    real, (tanh, cosh) = taylor.REAL, (hy.tanh, hy.cosh) if isinstance(v, hy.expression) else (np.tanh, np.cosh)
    half = real(0.5)
    opened, rest = half * (1 + tanh((v + real(0.01)) / real(0.15))), half * (1 + tanh((v - real(0.1)) / real(0.145)))
    calm = y - half * (v + half) - 2 * w * (v + real(0.7))
    return calm - opened * (v - 1), real(1.15) * (rest - w) * cosh((v - real(0.1)) / real(0.29))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "config", "rates", "section", "others", "known"),
    [
        (
            ADAPTIVE,
            "initial: {x: 0.2, y: 0.2}\nsection: {coordinate: x, value: 0.1, direction: up}\n"
            "sweep: {alpha: {start: 0.6, stop: 0.9, count: 5}}\n",
            adaptive,
            (3, 0, 0.1, 1),
            ("y", "z"),
            ("period_doubling", 0.6303020),
        ),
        (
            MORRIS_LECAR,
            "initial: {v: -0.1, w: 0.2}\nsection: {coordinate: v, value: 0.0, direction: up}\n"
            "sweep: {y: {start: 0.078, stop: 0.09, count: 5}}\n",
            morris_lecar,
            (2, 0, 0.0, 1),
            ("w",),
            ("fold", 0.08456948),
        ),
    ],
    ids=["adaptx", "MLfast"],
)
def test_cycles_of_matconts_manual(tmp_path, text, config, rates, section, others, known):
    """The doubling of `adaptx` and the fold of `MLfast`, to all digits that MatCont's manual (2019) has.

    By 20 and 30 intervals of four points: 5e-8 and 5e-9 are half a unit of the last digit.
    """
    (tmp_path / "flow.py").write_text(text)
    (tmp_path / "flow.yaml").write_text(
        f"system: {{file: flow.py}}\n{config}accuracy: {{target: 1.0e-10}}\n"
        "analyses: {branches: {max_period: 1, transient: 128}}\n"
    )
    data = session_of(jaxnh.load(tmp_path / "flow.yaml")).tree()["bifurcations"].to_dataset()
    name, (kind, published) = data.attrs["along"], known
    [k] = np.flatnonzero(data["kind"] == KINDS.index(kind))
    value, error = float(data[name][k]), float(data[f"{name}_error"][k])
    exact, _ = bifurcation(section_map(rates, *section), kind, value, [float(data[one][k]) for one in others])
    assert abs(value - exact) < min(1e-8, error + 1e-11)
    assert abs(exact - published) < (5e-8 if kind == "period_doubling" else 5e-9)
