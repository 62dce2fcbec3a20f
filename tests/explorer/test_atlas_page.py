"""An atlas in the explorer: its groups over the chart, from curves to orbits, charts made of others, and its limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import jaxnh
from jaxnh.explorer.atlas import limits_of
from jaxnh.explorer.overlays import layers_of
from jaxnh.explorer.recording import source_of
from jaxnh.explorer.report import lines
from tests.helpers.hand_made_results import cascade_branches, cusp_curves, logistic_atlas, tree


@pytest.fixture(scope="module")
def source():
    return source_of(logistic_atlas(), "atlas.h5")


@pytest.fixture(scope="module")
def layers(source):
    return {layer.name: layer for layer in layers_of(source.overlays, "b", "d")}


def test_all_of_an_atlas_lies_over_its_chart(layers):
    along_rows = ["periodic windows", "period 1, stable", "period 1, unstable", "period doubling"]
    assert set(layers) == {*along_rows, "period doubling, period 1", "fold"}
    branches = layers["period 1, stable"].items
    assert [set(item.y) for item in branches] == [{0.0}, {0.4}]
    assert [np.nanmax(item.x) for item in branches] == pytest.approx([3.0, 2.6], abs=0.06)
    assert [(item.x[0], item.y[0]) for item in layers["period doubling"].items] == [(3.0, 0.0), (2.6, 0.4)]
    assert [set(item.y) for item in layers["periodic windows"].items] == [{0.0}]


def test_a_curve_leads_to_its_orbits_and_marks_to_their_curve(layers):
    """Along b + d = 3 the orbit that doubles is at 2/3."""
    [curve] = layers["period doubling, period 1"].items
    assert curve.x + curve.y == pytest.approx(np.full(9, 3.0))
    assert curve.orbit(3)["x1"] == pytest.approx([2 / 3])
    assert dict(curve.facts(3))["number"] == "0"
    mark = layers["period doubling"].items[1]
    facts = dict(mark.facts(0))
    assert (facts["d"], facts["of the branch of number"], facts["on the curve of number"]) == ("0.4", "1", "0")
    assert mark.orbit(0)["x1"] == pytest.approx([2 / 3])
    [special] = layers["fold"].items
    assert special.orbit(0)["x1"] == pytest.approx([2 / 3])
    assert dict(special.facts(0))["on the curve of number"] == "0"
    branch = layers["period 1, unstable"].items[1]
    assert branch.orbit(16)["x1"] == pytest.approx([1 - 1 / 3.7])


def test_an_atlas_over_a_diagram_says_its_rows(source):
    over = {layer.name: layer for layer in layers_of(source.overlays, "b", "x1")}
    assert [dict(item.facts(0))["d"] for item in over["period 1, stable"].items] == ["0.0", "0.4"]


def test_tongues_and_shares_are_charts(source):
    assert list(source.variables) == ["period", "rotation", "tongues", "share_1", "share_2"]
    [tongues] = source.passes(showing(source, "tongues"))
    doubled = np.linspace(2.5, 3.3, 9) + np.linspace(0.0, 0.4, 5)[:, None] > 3.0
    assert np.array_equal(tongues.pixels.plane.values, np.where(doubled, 2, 1))
    [share] = source.passes(showing(source, "share_2"))
    assert np.array_equal(share.pixels.plane.values[:, 0], [0.4, 0.4, 0.0, 0.0, 0.0])
    assert share.pixels.words.startswith("share of the basin of attractor 2")
    jaxnh.figure(share.data)


def showing(source, variable):
    return replace(source.first, variable=variable)


def test_a_lane_says_its_attractors_with_shares_and_its_rotation(source):
    [report] = source.lane(source.first, {"b": 3.3, "d": 0.1})
    facts = dict(lines(report))
    assert facts["attractor 1, periodic, period 1"] == "share 0.6 (0.5 to 0.7)"
    assert facts["attractor 2, periodic, period 1"] == "share 0.4 (0.3 to 0.5)"
    assert facts["rotation"] == "locked to 1/2"
    [report] = source.lane(source.first, {"b": 3.3, "d": 0.4})
    assert not any("attractor 2" in words for words, _ in lines(report))


def test_limits_of_an_atlas_are_said(source):
    [limits] = limits_of(source.overlays)
    assert limits.startswith("atlas: 1 curves, of which 0 go on beyond their last point; 0 bifurcations not located; ")
    assert "complete to orbits of periods up to 1 that lanes settle on after 16 periods, at d = 0, 0.4" in limits
    assert limits_of({"curves": cusp_curves()}) == ()


def test_curves_and_branches_without_a_chart_are_over_white():
    config = "system: {file: own.py}\nsweep: {p: {start: -1, stop: 1, count: 3}, q: {values: [0.0, 2.0]}}\nanalyses: {curves: {}}\n"
    attrs = {"config": config, "system_file": "def system(p=0.0, q=0.0):\n    return {}\n"}
    source = source_of(tree({"curves": cusp_curves()}, axes="p q", **attrs), "curves.h5")
    assert source.first.ranges == {"p": (-1.0, 1.0), "q": (0.0, 2.0)}
    [picture] = source.passes(source.first)
    assert picture.words == "no chart in this file"
    assert layers_of(source.overlays, "p", "q")
    [report] = source.lane(source.first, {"p": 0.5, "q": 1.0})
    assert list(lines(report)) == []
    source = source_of(tree({"branches": cascade_branches()}), "branches.h5")
    assert (source.first.axis, source.first.low, source.first.high, source.first.second) == ("b", 2.5, 3.6, "")
    [picture] = source.passes(source.first)
    assert picture.raster.up == (
        pytest.approx(np.nanmin(cascade_branches()["x1_points"])),
        pytest.approx((4.6 + np.sqrt(0.6 * 4.6)) / 7.2),
    )
    assert layers_of(source.overlays, "b", "x1")


def test_a_figure_of_bokeh_has_the_layers_of_a_result():
    [legend] = jaxnh.bokeh_figure(logistic_atlas(), "share_1").above
    assert {item.label.value for item in legend.items} >= {"period 1, stable", "period doubling, period 1"}
    [legend] = jaxnh.bokeh_figure(tree({"curves": cusp_curves()}, axes="p q")).above
    assert [item.label.value for item in legend.items] == ["fold, period 1", "period doubling, period 2"]
