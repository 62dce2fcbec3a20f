"""Verdicts on phase volume and on hyperchaos, of maps and flows whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import jaxnh
from jaxnh.analyses import verdict
from jaxnh.engine.experiment import Experiment
from tests.flows import known_maps
from tests.helpers.kept_programs import session_of
from tests.helpers.paths import ROOT

TWO_HENONS = """
def system(a=1.4, b=0.3, coupling=0.0):
    def image(s):
        x, y, z, w = s
        pull = coupling * (z - x)
        return 1.0 - a * x**2 + y + pull, b * x, 1.0 - a * z**2 + w - pull, b * z

    return {"map": image, "coordinates": ("x", "y", "z", "w")}
"""
"""Uncoupled, each exponent of Henon's map is there twice."""

HYPERCHAOS = """
def system(a=0.25, b=3.0, c=0.5, d=0.05):
    def rhs(y, t):
        x, v, z, w = y
        return -v - z, x + a * v + w, b + x * z, -c * z + d * w

    return {"rhs": rhs, "coordinates": ("x", "v", "z", "w")}
"""
"""Roessler, Phys. Lett. A 71 (1979) 155."""


def verdicts(config, text=None):
    """The words of both flags, and the groups."""
    experiment = Experiment.from_text(config, text) if text else Experiment.from_text(config)
    groups = session_of(experiment).groups(dict.fromkeys(experiment.analyses.options()))
    data = groups["verdict"]
    return *(jaxnh.labels(data[name]).to_numpy().ravel().tolist() for name in ("kind", "phase_volume")), groups


@pytest.mark.slow  # the matrix has verdicts of maps
def test_maps_that_keep_area_and_one_that_does_not():
    """The standard map far below its chaos and far in it: a torus and chaos, both of determinant one."""
    config = "system: {file: m.py}\ninitial: {angle: 1.0, momentum: 0.5}\nsweep: {k: {values: [0.2, 10.0]}}\n"
    kinds, volumes, groups = verdicts(config + "analyses: {verdict: {}}", known_maps.STANDARD)
    assert (kinds, volumes) == (["quasiperiodic", "chaotic"], ["conservative", "conservative"])
    assert np.abs(groups["lyapunov"]["exponent_sum"]).max() < 1e-12
    config = "system: {file: m.py}\ninitial: {x: 0.1}\nsweep: {a: {values: [1.0, 1.4]}}\nanalyses: {verdict: {}}"
    kinds, volumes, groups = verdicts(config, known_maps.HENON)
    assert (kinds, volumes) == (["periodic", "chaotic"], ["dissipative", "dissipative"])
    assert np.abs(groups["lyapunov"]["exponent_sum"] - np.log(0.3)).max() < 1e-12


@pytest.mark.slow  # maps that keep area and one that does not are quick
def test_two_maps_side_by_side_are_hyperchaotic():
    """Two of Henon's from different points; with the second at a = 1 on its cycle, one alone, there is one exponent."""
    config = "system: {file: m.py}\ninitial: {x: 0.1, z: 0.2}\nsweep: {a: {values: [1.0, 1.4]}}\n"
    config += "analyses: {verdict: {}, lyapunov: {exponents: 4, periods: 4096}}"
    kinds, volumes, groups = verdicts(config, TWO_HENONS)
    assert (kinds, volumes) == (["periodic", "hyperchaotic"], ["dissipative", "dissipative"])
    ours, error = (groups["lyapunov"][name].to_numpy()[1] for name in ("exponents", "exponents_error"))
    assert np.all(np.abs(ours[:2] - 0.41922) < error[:2] + 1e-5)  # Sprott (2003)


def test_without_all_exponents_nothing_is_said_of_volume():
    config = "system: {file: m.py}\ninitial: {x: 0.1}\nsweep: {a: {values: [1.4]}}\n"
    config += "analyses: {verdict: {}, lyapunov: {exponents: 1}}"
    assert verdicts(config, known_maps.HENON)[:2] == (["chaotic"], ["unknown"])


def test_rule_of_volumes():
    rows = [  # sum, its bar, largest exponent, its bar -> words
        (1e-9, 1e-8, 0.1, 0.01, "conservative"),
        (-1e-3, 1e-8, 0.1, 0.01, "dissipative"),
        (1e-3, 1e-8, 0.1, 0.01, "expanding"),
        (-1e-3, 2e-2, 0.1, 0.01, "unknown"),  # more than a tenth of a dimension may be lost
        (-1e-3, 2e-3, 0.0, 0.01, "conservative"),
        (0.0, 1.0, 0.0, 0.01, "unknown"),
        (-np.inf, 0.0, -np.inf, 0.0, "dissipative"),
        (np.nan, np.nan, np.nan, np.nan, "unknown"),
    ]
    total, bar, largest, error = (np.array(column) for column in list(zip(*rows, strict=True))[:4])
    data = xr.Dataset({"exponent_sum": ("lane", total), "exponent_sum_error": ("lane", bar)})
    judged = verdict.judge_volume(data, largest, error, 1.0)
    assert [verdict.VOLUMES[k] for k in judged] == [row[4] for row in rows]


def test_second_exponent_across_the_flow():
    """The zero along the flow is taken out once, wherever it stands, and only without a clock."""
    exponents = np.array([[0.9, 0.3, 0.0], [0.9, 0.0, -2.0], [0.9, 0.0, 0.0]])
    errors = np.array([[0.1, 0.2, 0.0], [0.1, 0.0, 0.3], [0.1, 0.0, 0.0]])
    second, error = verdict.second_across(exponents, errors, clock=False)
    assert (second.tolist(), error.tolist()) == ([0.3, -2.0, 0.0], [0.2, 0.3, 0.0])
    assert verdict.second_across(exponents, errors, clock=True)[0].tolist() == [0.3, 0.0, 0.0]
    assert verdict.second_across(exponents[:, :1], errors[:, :1], clock=True)[1].tolist() == [np.inf] * 3


@pytest.mark.slow
def test_hyperchaos_of_roessler():
    """Wolf and co-workers (Physica D 16 (1985) 285), table 1: 0.16 and 0.03 bits per unit of time, dimension 3.005."""
    config = """system: {file: m.py}
initial: {x: -20.0, w: 15.0}
sweep: {a: {values: [0.25]}}
section: {coordinate: v, value: 0.0, direction: down}
accuracy: {solver: dopri8, steps: 200}
analyses:
  lyapunov: {exponents: 4, periods: 8192}
  period: {max_period: 8}
  verdict: {confirmation_factor: 1}
"""
    kinds, volumes, groups = verdicts(config, HYPERCHAOS)
    assert (kinds, volumes) == (["hyperchaotic"], ["dissipative"])
    ours, error = (groups["lyapunov"][name].to_numpy()[0, :2] for name in ("exponents", "exponents_error"))
    assert np.all(np.abs(ours - np.array([0.16, 0.03]) * np.log(2.0)) < error + 0.005 * np.log(2.0))
    assert abs(float(groups["lyapunov"]["kaplan_yorke"].item()) - 3.005) < 0.001


@pytest.mark.slow
def test_the_flow_of_henon_and_heiles_is_conservative():
    """At an energy of tori and at one of chaos."""
    config = f"""system: {{file: {ROOT}/configs/flows/henon_heiles.py}}
initial: {{x: 0.0, y: -0.1, y_dot: 0.0}}
sweep: {{x_dot: {{values: [0.3, 0.56]}}}}
section: {{coordinate: x, value: 0.0, direction: up}}
accuracy: {{target: 1.0e-8}}
analyses: {{verdict: {{}}, lyapunov: {{exponents: 4, periods: 4096}}}}
"""
    kinds, volumes, _ = verdicts(config)
    assert (kinds[1], volumes) == ("chaotic", ["conservative", "conservative"])


@pytest.mark.slow
def test_volume_stays_on_the_average():
    """Of Nosé and Hoover's oscillator from the start that is usual for it, in its chaotic sea.

    Its divergence is minus the friction, which is not zero; its mean is, as ln of a density that stays is minus its sum.
    """
    config = f"""system: {{file: {ROOT}/configs/nonholonomic/nose_hoover.py}}
initial: {{p: 5.0}}
sweep: {{temperature: {{values: [1.0]}}}}
section: {{coordinate: q, value: 0.0, direction: up}}
accuracy: {{target: 1.0e-8}}
analyses: {{verdict: {{}}, lyapunov: {{exponents: 3, periods: 32768}}}}
"""
    kinds, volumes, groups = verdicts(config)
    assert (kinds, volumes) == (["chaotic"], ["conservative"])
    ours, error = (groups["lyapunov"][name].to_numpy()[0] for name in ("exponents", "exponents_error"))
    assert np.all(np.abs(ours - [0.014, 0.0, -0.014]) < error + 0.0005)  # Sprott, Phys. Rev. E 50 (1994) R647, case A
    assert error[0] < 0.004
