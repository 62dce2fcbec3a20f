"""Bifurcations that `branches` finds against heyoka's Taylor integrator with a Newton of its own: parameter and kind."""

from __future__ import annotations

import heyoka as hy
import numpy as np
import pytest
import taylor
from conftest import ROOT, session_of
from heyoka_newton import bifurcation, return_map, strobe_map
from measure import twin

import jaxnh
from jaxnh.config.experiment import Experiment
from jaxnh.orbits.kinds import KINDS
from jaxnh.systems.particle import constant_speed


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
        "{limit: 1, transient: 256, starts: 8, values: 2, seed: 1, box: {x: [-1.5, 1.5], v: [-0.5, 0.5]}}",
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
        "{limit: 4, transient: 256}",
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
        "{limit: 1, transient: 128}",
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
    found, data = found_in("configs/branches.yaml", "b: {start: 4.15, stop: 4.25, count: 4}", "{limit: 4}")
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


# ---- cycles of flows without a clock, which other continuation programs are tried on

CIRCUIT = """\
def system(nu=-0.6, beta=0.5, gamma=-0.6, r=0.6, a3=0.32858, b3=0.93358):
    def rhs(state, t):
        x, y, z = state
        over = b3 * (y - x) ** 3
        return (-(beta + nu) * x + beta * y - a3 * x**3 + over) / r, beta * x - (beta + gamma) * y - z - over, y

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}
"""

PEROXIDASE = """\
def system(k8=0.75, k1=0.1631021, k2=1250.0, k3=0.046875, k4=20.0, k5=1.104, k6=0.001, k7=1.5, back=0.1175):
    def rhs(state, t):
        a, b, x, y = state
        one, two, three = k1 * a * b * x, k2 * x * x, k3 * a * b * y
        of_x = one - 2.0 * two + 2.0 * three - k4 * x + k6
        return k7 - one - three - back * a, k8 - one - three, of_x, 2.0 * two - three - k5 * y

    return {"rhs": rhs, "coordinates": ("A", "B", "X", "Y")}
"""


def circuit(x, y, z, nu, t):
    """CIRCUIT in heyoka's numbers and expressions."""
    half, over = taylor.REAL(0.5), taylor.REAL(0.93358) * (y - x) * (y - x) * (y - x)
    of_x = (half * y - (half + nu) * x - taylor.REAL(0.32858) * x * x * x + over) / taylor.REAL(0.6)
    return of_x, half * x - (half + taylor.REAL(-0.6)) * y - z - over, y


def peroxidase(a, b, x, y, k8, t):
    """PEROXIDASE in heyoka's numbers and expressions."""
    one, two, three = taylor.REAL(0.1631021) * a * b * x, taylor.REAL(1250) * x * x, taylor.REAL(0.046875) * a * b * y
    of_x = one - 2 * two + 2 * three - taylor.REAL(20) * x + taylor.REAL(0.001)
    of_y = 2 * two - three - taylor.REAL(1.104) * y
    return taylor.REAL(1.5) - one - three - taylor.REAL(0.1175) * a, k8 - one - three, of_x, of_y


def of_own_file(folder, file, config):
    """Bifurcations of a user's system: (kind, parameter, error, number), and all there is of them."""
    (folder / "own.py").write_text(file)
    data = session_of(Experiment.from_text(f"system: {{file: {folder / 'own.py'}}}\n{config}")).tree()["bifurcations"]
    name = data.attrs["along"]
    columns = (data[k].values.tolist() for k in ("kind", name, f"{name}_error"))
    return [(KINDS[kind], value, error, k) for k, (kind, value, error) in enumerate(zip(*columns, strict=True))], data


@pytest.mark.slow
def test_cycles_of_the_torus_circuit(tmp_path):
    """MatCont's torBPC: a cycle that is its own mirror image folds and loses that, its twins have a torus and double.

    The map from a crossing to the next one the other way, mirrored, has the first cycle as a fixed point: where it is
    no more its own image, there is a multiplier −1.
    """
    found, data = of_own_file(
        tmp_path,
        CIRCUIT,
        """\
initial: {x: 0.1, y: 0.1, z: 0.0}
sweep: {nu: {start: -0.63, stop: -0.58, count: 6}}
section: {coordinate: z, value: 0.0, direction: up}
accuracy: {target: 1.0e-10}
analyses:
  branches:
    {limit: 1, transient: 128, starts: 32, values: 3, seed: 1, box: {x: [-1.2, 1.2], y: [-0.8, 0.8], z: [-0.1, 0.1]}}
""",
    )
    whole, half = return_map(circuit, 3, 2), return_map(circuit, 3, 2, rising=False)

    def mirrored(nu, u):
        image, matrix = half(nu, u)
        return -image, -matrix

    kinds = [kind for kind, *_ in found]
    assert sorted(kinds) == ["branch_point", "fold", "neimark_sacker", "neimark_sacker"] + 2 * ["period_doubling"]
    for kind, value, error, k in found:
        u = [float(data[name][k]) for name in ("x", "y")]
        at_branch_point = kind == "branch_point"
        image, which = (mirrored, "period_doubling") if at_branch_point else (whole, kind)
        exact, _ = bifurcation(image, which, value, u)
        assert abs(value - exact) < min(1e-8, error + 1e-12)  # of differences in the reference


@pytest.mark.slow
def test_cycles_of_the_peroxidase_reaction(tmp_path):
    """The Steinmetz–Larter model, as BifurcationKit's tutorial has it: a torus is born, and then the cycle folds."""
    found, data = of_own_file(
        tmp_path,
        PEROXIDASE,
        """\
initial: {A: 5.6, B: 9.0, X: 0.01, Y: 0.02}
sweep: {k8: {start: 0.8, stop: 0.85, count: 5}}
section: {coordinate: A, value: 5.6, direction: up}
accuracy: {target: 1.0e-9}
analyses:
  branches: {limit: 1, transient: 128}
""",
    )
    assert [kind for kind, *_ in found] == ["neimark_sacker", "fold"]
    for kind, value, error, k in found:
        u = [float(data[name][k]) for name in ("B", "X", "Y")]
        exact, _ = bifurcation(return_map(peroxidase, 4, 0, 5.6), kind, value, u)
        assert abs(value - exact) < min(1e-8, error + 1e-12)  # of differences in the reference
