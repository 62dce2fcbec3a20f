"""Branches of cycles by collocation through the whole package: against shooting, which shares no code, and series."""

from __future__ import annotations

import numpy as np
import pytest

import jaxnh
from jaxnh.exceptions import ConfigError
from jaxnh.orbits.continuation.kinds import KINDS
from jaxnh.orbits.continuation.paths import ENDS
from tests.flows.roessler import doubling_of_roessler
from tests.helpers.kept_programs import session_of

ROESSLER = """
def system(c=2.5):
    def rhs(y, t):
        x, v, z = y
        return -v - z, x + 0.2 * v, 0.2 + z * (x - c)

    return {"rhs": rhs, "coordinates": ("x", "v", "z")}
"""

SLOW_FAST = """
def system(a=0.95):
    def rhs(y, t):
        x, slow = y
        return (slow - x * x * x / 3 + x) / 0.01, a - x

    return {"rhs": rhs, "coordinates": ("x", "slow")}
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


@pytest.mark.slow
def test_branch_that_shooting_loses_is_followed_by_collocation(tmp_path):
    """Canards: returns expand by 10⁷ and more; by `auto` the branch comes to the series' value with all of them."""
    sweep, section = (
        "a: {start: 0.99, stop: 0.9995, count: 4}",
        "section: {coordinate: x, value: 0.99, direction: up}\n",
    )
    options, trees = "{max_period: 1, transient: 64, ds_max: 0.25, max_steps: 300, method: %s}", []
    for method in ("shooting", "auto"):
        trees.append(tree_of(tmp_path, SLOW_FAST, "{x: 0.9, slow: -0.6}", sweep, options % method, section)["branches"])
    lost, passed = trees
    assert "no_convergence" in {ENDS[end] for end in [*lost["begins"].values, *lost["ends"].values]}
    assert passed.attrs["method"] == "collocation"
    assert np.nanmax(np.abs(passed["multipliers"])) > 1e3 * np.nanmax(np.abs(lost["multipliers"]))
    series = 1 - 0.01 / 8 - 3 * 0.01**2 / 32 - 173 * 0.01**3 / 1024
    assert abs(float(np.nanmin(passed["a"])) - series) < 1e-8  # the next term, ε⁴


def test_what_collocation_does_not_follow_is_said(tmp_path):
    (tmp_path / "flow.py").write_text(
        "def system(r=3.0):\n    return {'map': lambda y: (r * y[0] * (1 - y[0]),), 'coordinates': ('x',)}\n"
    )
    (tmp_path / "flow.yaml").write_text(
        "system: {file: flow.py}\ninitial: {x: 0.4}\nsweep: {r: {start: 2.9, stop: 3.1, count: 4}}\n"
        "analyses: {branches: {method: collocation}}\n"
    )
    with pytest.raises(ConfigError, match=r"method: collocation follows cycles of flows.*; take method: shooting"):
        jaxnh.load(tmp_path / "flow.yaml")
