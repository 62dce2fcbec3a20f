"""Branches of cycles by collocation through the whole package: against shooting, which shares no code, and series."""

from __future__ import annotations

from unittest import mock

import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.continuation import branches
from jaxnh.analyses.continuation.family_tree import SeedOrbit, Tree
from jaxnh.exceptions import ConfigError
from jaxnh.orbits.continuation.arclength import PathVector
from jaxnh.orbits.continuation.branches import Branch
from jaxnh.orbits.continuation.kinds import KINDS
from jaxnh.orbits.continuation.paths import CLOSED, NO_CONVERGENCE, NO_RETURN, RANGE, START
from jaxnh.systems.first_order import first_order
from tests.flows.roessler import doubling_of_roessler
from tests.helpers.kept_programs import session_of

pytestmark = pytest.mark.usefixtures("quick_compiling", "calibrate_once")

ROESSLER = """
def system(c=2.5):
    def rhs(y, t):
        x, v, z = y
        return -v - z, x + 0.2 * v, 0.2 + z * (x - c)

    return {"rhs": rhs, "coordinates": ("x", "v", "z")}
"""

DUFFING = """
import jax.numpy as jnp


def system(drive=0.3):
    def rhs(y, t):
        x, v = y
        return v, drive * jnp.cos(1.2 * t) - 0.1 * v - x - x**3

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / 1.2}
"""


def tree_of(folder, text, initial, sweep, options, section=""):
    """The result of branches of a system in a file."""
    (folder / "flow.py").write_text(text)
    (folder / "flow.yaml").write_text(
        f"system: {{file: flow.py}}\ninitial: {initial}\nsweep: {{{sweep}}}\n{section}"
        f"accuracy: {{target: 1.0e-8}}\nanalyses: {{branches: {options}}}\n"
    )
    return session_of(jaxnh.load(folder / "flow.yaml")).tree()


@pytest.mark.slow  # collocation of this branch is quick, and so are its doublings
def test_doubling_of_roessler_by_collocation(tmp_path):
    """Where heyoka has it, within its error; the branch goes from end to end of the sweep."""
    section = "section: {coordinate: v, value: 0.0, direction: up}\n"
    options = "{max_period: 1, transient: 32, ds_max: 0.1, method: collocation}"
    tree = tree_of(
        tmp_path, ROESSLER, "{x: 1.0, v: 0.0, z: 0.0}", "c: {start: 2.6, stop: 3.0, count: 2}", options, section
    )
    marks, branches = tree["bifurcations"], tree["branches"]
    assert [KINDS[kind] for kind in marks["kind"].values] == ["period_doubling"]
    exact = float(doubling_of_roessler(2.8324, 1))
    assert abs(float(marks["c"][0]) - exact) <= float(marks["c_error"][0]) < 1e-7
    assert branches.attrs["method"] == "collocation"
    assert sorted(branches["c"].values[0][[0, -1]]) == [2.6, 3.0]
    assert np.nanmax(branches["residual"]) < 1e-9
    assert 5.7 < float(np.nanmin(branches["duration"])) < float(np.nanmax(branches["duration"])) < 6.0


@pytest.mark.slow
@pytest.mark.parametrize("periods", [1, 2])
def test_collocation_and_shooting_agree(tmp_path, periods):
    """Roessler's doublings, their cycles' durations and multipliers, within errors and to Newton's tolerance."""
    sweep, initial = "c: {start: 2.6, stop: 3.0, count: 2}", "{x: 1.0, v: 0.0, z: 0.0}"
    section = "section: {coordinate: v, value: 0.0, direction: up}\n"
    trees = {
        method: tree_of(
            tmp_path,
            ROESSLER,
            initial,
            sweep,
            f"{{max_period: {periods}, transient: 64, ds_max: 0.1, method: {method}}}",
            section,
        )
        for method in ("collocation", "shooting")
    }
    (one, other), (branch, like) = (
        [trees[method][group] for method in trees] for group in ("bifurcations", "branches")
    )
    assert [KINDS[kind] for kind in one["kind"].values] == ["period_doubling"]
    assert one["period"].values.tolist() == other["period"].values.tolist() == [1]
    apart = abs(float(one["c"][0] - other["c"][0]))
    assert apart <= float(one["c_error"][0] + other["c_error"][0])
    assert float(one["c_error"][0]) < 1e-7
    assert branch.attrs["method"] == "collocation"
    assert like.attrs["method"] == "shooting"
    assert branch["period"].values.tolist() == like["period"].values.tolist()
    for data in (branch, like):  # at both ends of the sweep, which both methods come to exactly
        assert np.sort(data["c"].values[0][[0, int(np.isfinite(data["c"].values[0]).sum()) - 1]]).tolist() == [2.6, 3.0]
    if periods > 1:
        return
    first, second = (np.argmax(data["c"].values[0] == 3.0) for data in (branch, like))
    for name in ("x", "z"):
        assert abs(branch[name].values[0, first] - like[name].values[0, second]) < 1e-6 * 5.0  # of size five
    apart = branch["multipliers"].values[0, first] - like["multipliers"].values[0, second]
    assert np.abs(apart).max() < 1e-4  # that meshes resolve them to
    assert np.all(branch["residual"].values[np.isfinite(branch["residual"].values)] < 1e-9)
    assert 5.7 < float(np.nanmin(branch["duration"])) < float(np.nanmax(branch["duration"])) < 12.0


@pytest.mark.slow
def test_folds_of_a_flow_with_a_clock(tmp_path):
    """Duffing's resonance: both folds as by shooting, and durations of one period."""
    options = "{max_period: 1, transient: 64, method: %s}"
    trees = [
        tree_of(tmp_path, DUFFING, "{x: 0.5}", "drive: {start: 0.05, stop: 0.6, count: 4}", options % method)
        for method in ("collocation", "shooting")
    ]
    one, other = (tree["bifurcations"] for tree in trees)
    assert [KINDS[kind] for kind in one["kind"].values] == [KINDS[kind] for kind in other["kind"].values]
    apart = np.abs(one["drive"].values - other["drive"].values)
    assert np.all(apart <= one["drive_error"].values + other["drive_error"].values)
    timed = trees[0]["branches"]["duration"].values
    assert np.allclose(timed[np.isfinite(timed)], 2 * np.pi / 1.2, rtol=1e-14)


@pytest.mark.parametrize("lost", [True, False])
def test_collocation_where_shooting_loses_a_branch(tmp_path, lost):
    """By `auto` both follow the branch where shooting ends one for want of a solution, and shooting alone elsewhere."""
    section = "section: {coordinate: v, value: 0.0, direction: up}\n"
    options = "{max_period: 1, transient: 32, ds_max: 0.1, method: auto}"
    sweep = "c: {start: 2.6, stop: 2.7, count: 2}"
    with mock.patch.object(branches, "_needs_collocation", return_value=lost):
        tree = tree_of(tmp_path, ROESSLER, "{x: 1.0, v: 0.0, z: 0.0}", sweep, options, section)
    assert tree["branches"].attrs["method"] == ("collocation" if lost else "shooting")
    assert sorted(tree["branches"]["c"].values[0][[0, -1]]) == [2.6, 2.7]


@pytest.mark.parametrize(("steps", "long"), [(100, False), (10000, True)])
def test_returns_of_many_steps_are_left_to_collocation(steps, long):
    """By `auto`, where the derivatives of a return cost more than an evaluation on a mesh; a clock has no such returns."""
    seeds = [[SeedOrbit(np.zeros((2, 2)), 0.0)]]
    cycle = first_order(lambda: {"rhs": lambda y, t: (y[1], -y[0]), "coordinates": ("x", "v")}, {})
    driven = first_order(lambda: {"rhs": lambda y, t: (y[1], -y[0]), "coordinates": ("x", "v"), "period": 1.0}, {})
    for flow, expected in ((cycle, long), (driven, False)):
        batch = mock.Mock(flow=flow, steps=steps)
        with mock.patch.object(branches, "duration_of", return_value=2.0 * flow.period):
            assert branches._has_long_returns(batch, mock.Mock(), seeds) == expected
    assert not branches._has_long_returns(mock.Mock(flow=cycle, steps=steps), mock.Mock(), [[]])


@pytest.mark.parametrize(
    ("ends", "needed"),
    [((RANGE, RANGE), False), ((RANGE, NO_CONVERGENCE), True), ((NO_RETURN, RANGE), True), ((START, CLOSED), False)],
)
def test_ends_that_shooting_loses_a_branch_by(ends, needed):
    """Of a flow without a clock; one with a clock and a map are followed by shooting."""
    orbits = np.zeros((2, 1, 2))
    still = PathVector(np.zeros_like(orbits), np.zeros(2))
    branch = Branch(orbits, np.zeros(2), still, np.zeros((2, 0)), np.zeros((2, 2), complex), np.zeros(2), ends)
    tree = Tree([branch], [], [])
    cycle = first_order(lambda: {"rhs": lambda y, t: (y[1], -y[0]), "coordinates": ("x", "v")}, {})
    driven = first_order(lambda: {"rhs": lambda y, t: (y[1], -y[0]), "coordinates": ("x", "v"), "period": 1.0}, {})
    assert branches._needs_collocation(cycle, tree) == needed
    assert not branches._needs_collocation(driven, tree)


def test_what_collocation_does_not_follow_is_said(tmp_path):
    (tmp_path / "flow.py").write_text(
        "def system(r=3.0):\n    return {'map': lambda y: (r * y[0] * (1 - y[0]),), 'coordinates': ('x',)}\n"
    )
    (tmp_path / "flow.yaml").write_text(
        "system: {file: flow.py}\ninitial: {x: 0.4}\nsweep: {r: {start: 2.9, stop: 3.1, count: 4}}\n"
        "analyses: {branches: {method: collocation}}\n"
    )
    with pytest.raises(ConfigError, match=r"method: collocation is of flows.*; take method: shooting"):
        jaxnh.load(tmp_path / "flow.yaml")
