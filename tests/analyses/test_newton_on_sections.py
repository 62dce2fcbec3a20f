"""Every analysis that uses Newton on returns to a section, in small, to 1e-9 of heyoka's events and tangents with a Newton of its own.

Doublings of two textbook flows: the cycle of the Rössler system at c = 2.83, and one of the Lorenz system at rho = 148.4
that passes its section four times. Steps are written as loops, as compiling is all that takes time here.
"""

from __future__ import annotations

import functools
from unittest import mock

import numpy as np
import pytest

from jaxnh.engine.experiment import Experiment
from jaxnh.maps import general_flow
from tests.helpers import taylor
from tests.helpers.heyoka_newton import bifurcation, iterated, newton, section_map
from tests.helpers.kept_programs import lanes_with_kept_programs, session_of
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.usefixtures("uncalibrated", "quick_compiling")
NEAR = 1e-9


def roessler(a):
    """configs/flows/roessler.py at b = 0.2, over c."""

    def rates(x, y, z, c, t):
        return -y - z, x + taylor.REAL(a) * y, taylor.REAL(0.2) + z * (x - c)

    return rates


def lorenz(beta):
    """configs/flows/lorenz.py at sigma = 10, over rho."""

    def rates(x, y, z, rho, t):
        return taylor.REAL(10) * (y - x), x * (rho - z) - y, x * y - taylor.REAL(beta) * z

    return rates


FLOWS = {
    "roessler": {
        "rates": roessler,
        "along": "c",
        "sweep": "c: {start: 2.78, stop: 2.88, count: 6}",
        "and": ("a", 0.199, 0.2),
        "plane": ("y", 0.0),
        "steps": 24,
        "start": "x: 1.0, y: 1.0, z: 0.0",
        "period": 1,
        "attracts": -1,
    },
    "lorenz": {
        "rates": lorenz,
        "along": "rho",
        "sweep": "rho: {start: 148.0, stop: 149.0, count: 6}",
        "and": ("beta", 2.66, 8 / 3),
        "plane": ("z", 150.0),
        "steps": 100,
        "start": "x: 1.0, y: 1.0, z: 150.0",
        "period": 4,
        "attracts": +1,
    },
}
FLOW = pytest.mark.parametrize("flow", FLOWS)


@functools.cache
def session(flow, plane=False):
    """A session over one parameter, or over two."""
    known = FLOWS[flow]
    (coordinate, value), (other, low, high) = known["plane"], known["and"]
    text = f"""\
system: {{file: {ROOT / "configs/flows" / flow}.py}}
initial: {{{known["start"]}}}
section: {{coordinate: {coordinate}, value: {value}, direction: up}}
accuracy: {{solver: verner9, steps: {known["steps"]}}}
sweep: {{{known["sweep"]}{f", {other}: {{values: [{low}, {high!r}]}}" if plane else ""}}}
analyses: {{portrait: {{}}}}
"""
    made = session_of(Experiment.from_text(text))
    made._lanes = lanes_with_kept_programs(None, made._lanes.devices[:1], 8)
    return made


LOOK = {"max_period": 4, "transient": 256}


def groups_of(flow, analysis, plane=False, **options):
    """The groups of an analysis."""
    with mock.patch.object(general_flow, "_LARGEST_STEP", 0):
        return session(flow, plane).groups({analysis: options})


def returns(flow, value=None):
    """heyoka's map of as many returns as the orbit has, of the coordinates in the section."""
    known = FLOWS[flow]
    (coordinate, level), other = known["plane"], known["and"][2]
    return iterated(
        section_map(rates_of(flow, other if value is None else value), 3, "xyz".index(coordinate), level, 1),
        known["period"],
    )


@functools.cache
def rates_of(flow, value):
    return FLOWS[flow]["rates"](value)


def near_the_doubling(flow):
    """The value of the parameter and the point in the section on our branch that is nearest to it."""
    branch, along = groups_of(flow, "branches", **LOOK)["branches"], FLOWS[flow]["along"]
    at = int(np.nanargmin(np.abs(branch["multipliers"][0, :, 0, 0].to_numpy() + 1)))
    return float(branch[along][0, at]), [float(branch[name][0, at]) for name in coordinates(flow)]


def coordinates(flow):
    """Those in the section."""
    return [name for name in "xyz" if name != FLOWS[flow]["plane"][0]]


@functools.cache
def doubling_by_heyoka(flow, other=None):
    """The value at which the orbit doubles, by Newton from near our own."""
    exact, multipliers = bifurcation(returns(flow, other), "period_doubling", *near_the_doubling(flow))
    assert np.abs(multipliers + 1).min() < 1e-6
    return exact


@FLOW
def test_period(flow):
    """Periods on both sides of the doubling, and the multiplier of the orbit where it attracts."""
    data, known = groups_of(flow, "period", **LOOK)["period"], FLOWS[flow]
    values, exact = data[known["along"]].to_numpy(), doubling_by_heyoka(flow)
    there = known["attracts"] * (values - exact) > 0
    doubled = 2 * known["period"] if 2 * known["period"] <= 4 else 0
    assert data["period"].to_numpy().tolist() == np.where(there, known["period"], doubled).tolist()
    branch = groups_of(flow, "branches", **LOOK)["branches"]
    lane = int(np.flatnonzero(there)[0])
    at = int(np.nanargmin(np.abs(branch[known["along"]][0].to_numpy() - values[lane])))
    image = returns(flow)
    u = newton(lambda u: image(values[lane], u)[0] - u, [float(branch[name][0, at]) for name in coordinates(flow)])
    largest = np.abs(np.linalg.eigvals(image(values[lane], u)[1].astype(float))).max()
    assert abs(float(data["multiplier"][lane]) - largest) < NEAR


@FLOW
@pytest.mark.parametrize(
    ("analysis", "options"), [("doubling", {"levels": 1}), ("windows", {"levels": 1, "crisis": 0, **LOOK})]
)
def test_doubling(flow, analysis, options):
    data, along = groups_of(flow, analysis, **options)[analysis], FLOWS[flow]["along"]
    name = along if analysis == "doubling" else "doubling"
    assert data["period"].to_numpy().tolist() == [FLOWS[flow]["period"]]
    value, error = float(data[name].to_numpy().item()), float(data[f"{name}_error"].to_numpy().item())
    assert abs(value - doubling_by_heyoka(flow)) < min(NEAR, error + 1e-11)


@FLOW
def test_branches(flow):
    """The doubling, and points on the branch, stable or not."""
    groups, known = groups_of(flow, "branches", **LOOK), FLOWS[flow]
    branch, data = groups["branches"], groups["bifurcations"]
    kinds = data["kind"].attrs["flag_meanings"].split()
    assert [kinds[k] for k in data["kind"].to_numpy()] == ["period_doubling"]
    error = float(data[f"{known['along']}_error"][0])
    assert abs(float(data[known["along"]][0]) - doubling_by_heyoka(flow)) < min(NEAR, error + 1e-11)
    names, image = coordinates(flow), returns(flow)
    points = np.flatnonzero(np.isfinite(branch[known["along"]][0].to_numpy()))
    for k in points[[0, len(points) // 2, -1]]:
        value, u = float(branch[known["along"]][0, k]), np.array([float(branch[name][0, k]) for name in names])
        exact = newton(lambda u, value=value: image(value, u)[0] - u, u)
        assert np.abs(exact - u).max() < NEAR * max(1.0, np.abs(u).max())


@FLOW
def test_curves(flow):
    """The doubling over two parameters, at both ends of the other one."""
    data, known = groups_of(flow, "curves", plane=True, n_values=1, ds=0.1, ds_max=0.25, **LOOK)["curves"], FLOWS[flow]
    other, *ends = known["and"]
    kinds = data["kind"].attrs["flag_meanings"].split()
    assert [kinds[k] for k in data["kind"].to_numpy()] == ["period_doubling"]
    over, along = data[other][0].to_numpy(), data[known["along"]][0].to_numpy()
    for end in ends:
        k = int(np.nanargmin(np.abs(over - end)))
        assert over[k] == pytest.approx(end, abs=1e-12)
        error = float(data[f"{known['along']}_error"][0, k])
        assert abs(along[k] - doubling_by_heyoka(flow, float(over[k]))) < min(NEAR, error + 1e-11)
