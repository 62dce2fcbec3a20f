"""Layers over a picture: which groups are over which axes, what a click says of them, and what is drawn."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.explorer.fixed_parameters import fixed_parameters
from jaxnh.explorer.layers import REACH, Item, Layer, Scale, nearest, thin
from jaxnh.explorer.overlays import layers_of
from jaxnh.explorer.recording import described
from tests.helpers.hand_made_results import (
    cascade_branches,
    cascade_marks,
    cat_manifolds,
    cusp_curves,
    cusp_point,
    saddle_surface,
    tree,
    window_rows,
)

SQUARE = Scale((0.0, 1.0), (0.0, 1.0), 1000.0, 500.0)  # a unit across is 1000 pixels, upward 500


def item(x, y, name="one"):
    return Item(np.array(x), np.array(y), lambda k: [(name, str(k))])


def named(layers, name):
    [layer] = [layer for layer in layers if layer.name == name]
    return layer


def test_the_nearest_in_pixels_is_hit():
    """From (0.5, 0.25) the line y = 0.26 is 5 pixels away, and the point 6; beyond the reach there is nothing."""
    line = Layer("line", "line", "black", (item([0.0, 1.0], [0.26, 0.26]),))
    dots = Layer("dots", "dots", "black", (item([0.506], [0.25]),))
    hit = nearest([dots, line], 0.5, 0.25, SQUARE)
    assert hit.item is line.items[0]
    assert nearest([dots, line], 0.505, 0.25, SQUARE).item is dots.items[0]
    assert nearest([line], 0.9, 0.26, SQUARE).point == 1
    assert nearest([line], 0.5, 0.26 + 1.01 * REACH / 500, SQUARE) is None


def test_a_band_is_hit_where_nothing_else_is():
    band = Layer("band", "band", "black", (item([0.2, 0.6], [0.0, 0.0]),))
    line = Layer("line", "line", "black", (item([0.0, 1.0], [0.5, 0.5]),))
    assert nearest([band, line], 0.3, 0.5, SQUARE).item is line.items[0]
    assert nearest([band, line], 0.3, 0.2, SQUARE).item is band.items[0]
    assert nearest([band, line], 0.7, 0.2, SQUARE) is None


def test_a_break_of_a_curve_is_no_part_of_it():
    broken = Layer("line", "line", "black", (item([0.0, 0.4, np.nan, 0.6, 1.0], [0.5] * 5),))
    assert nearest([broken], 0.5, 0.5, SQUARE) is None
    assert nearest([broken], 0.61, 0.5, SQUARE).point == 3


def test_a_thinned_curve_is_within_a_pixel_of_the_whole_one_and_keeps_its_breaks():
    x = np.linspace(-5.0, 5.0, 200_001)
    y = 0.5 + 0.4 * np.sin(3.0 * x)
    y[np.argmin(np.abs(x - 0.5))] = np.nan
    across, up = thin(item(x, y), SQUARE)
    assert len(across) < 10_000
    assert np.isnan(across).sum() + np.isnan(up).sum() > 0
    assert np.nanmin(across) < 0.0 < 1.0 < np.nanmax(across)
    known = np.isfinite(across) & np.isfinite(up)
    inside = (x >= 0.0) & (x <= 1.0) & np.isfinite(y)
    between = np.interp(x[inside], across[known], up[known])
    assert np.max(np.abs(between - y[inside])) * SQUARE.height < 1.0


def test_curves_are_over_both_parameters_either_way_round():
    data = cusp_curves()
    for axes in (("p", "q"), ("q", "p")):
        layers = layers_of({"curves": data, "codimension_two": cusp_point()}, *axes)
        assert [layer.name for layer in layers] == ["fold, period 1", "period doubling, period 2", "cusp"]
        fold = layers[0].items[0]
        p, q = (fold.x, fold.y) if axes == ("p", "q") else (fold.y, fold.x)
        assert np.allclose(27.0 * p**2, 4.0 * q**3)  # the discriminant of p + q x - x³ is zero
    assert layers_of({"curves": data}, "p", "b") == []


def test_a_curve_says_its_kind_and_values_with_errors():
    data = cusp_curves().assign(p_error=cusp_curves()["p"] * 0.0 + 2e-4)
    [fold, *_] = layers_of({"curves": data}, "p", "q")
    facts = dict(fold.items[0].facts(20))
    assert facts["curve"] == "fold, period 1"
    assert facts["p"] == f"{float(data['p'][0, 20]):.5f} ± 0.00020"


def test_branches_are_apart_by_period_and_stability_and_open_their_orbit():
    layers = layers_of({"branches": cascade_branches(), "bifurcations": cascade_marks()}, "b", "x1")
    words = ["period 1, stable", "period 1, unstable", "period 2, stable", "period 2, unstable"]
    assert [layer.name for layer in layers] == [*words, "fold", "period doubling"]
    doubled = named(layers, "period 2, stable").items
    assert len(doubled) == 2  # a line for each point of the orbit
    b, points = doubled[0].x[3], doubled[0].orbit(3)["x1"]
    assert points[::-1] == pytest.approx(b * points * (1 - points))  # the logistic map takes one to the other
    unstable = named(layers, "period 1, unstable").items[0]
    assert np.nanmin(unstable.x) > 3.0
    assert np.nanmax(named(layers, "period 1, stable").items[0].x) == pytest.approx(3.0, abs=0.03)
    doubling = named(layers, "period doubling").items[1]
    assert len(doubling.orbit(0)["x1"]) == 2
    assert layers_of({"branches": cascade_branches()}, "b", "x2") == []


def test_windows_are_bands_over_the_parameter_of_a_diagram():
    [layer] = layers_of({"windows": window_rows()}, "b", "x1")
    assert layer.glyph == "band"
    assert list(layer.items[1].x) == [1 + np.sqrt(8), 3.8568]
    facts = dict(layer.items[1].facts(0))
    assert facts["window"] == "period 3"
    assert facts["begin"] == "3.82843 (fold)"


def test_manifolds_are_over_coordinates_of_the_start():
    layers = layers_of({"manifolds": cat_manifolds()}, "start_x1", "start_y1")
    assert [(layer.name, len(layer.items)) for layer in layers] == [("unstable manifolds", 2), ("stable manifolds", 2)]
    branch = layers[0].items[0]
    assert branch.y == pytest.approx(0.5 * (np.sqrt(5) - 1) * branch.x)
    assert dict(branch.facts(3))["manifold"] == "unstable, of saddle 1"
    assert layers_of({"manifolds": cat_manifolds()}, "start_x1", "start_x2") == []
    assert (
        layers_of({"manifolds": saddle_surface()}, "start_x", "start_y") == []
    )  # seen from outside in its panel alone


def logistic_branches():
    """Branches, bifurcations and windows of a result over b whose config has a at 0.25, and c by the default of a file."""
    made = tree({"branches": cascade_branches(), "bifurcations": cascade_marks(), "windows": window_rows()})
    text = "def system(b=3.0, a=1.0, c=8 / 3 - 1, e=len('no number')):\n    return {}\n"
    config = "system: {file: own.py, a: 0.25}\nsweep: {b: {start: 2.0, stop: 4.0, count: 9}, f: {values: [7.0]}}\n"
    made.attrs |= {"config": config + "analyses: {branches: {}}\n", "system_file": text}
    return made


def test_what_lies_along_one_parameter_is_at_the_value_of_the_other_over_a_plane():
    groups = described(logistic_branches())
    across = layers_of(groups, "b", "a")
    names = ["periodic windows", "period 1, stable", "period 1, unstable", "period 2, stable", "period 2, unstable"]
    assert [layer.name for layer in across] == [*names, "fold", "period doubling"]
    assert all(np.all(item.y == 0.25) for layer in across for item in layer.items)
    assert all(layer.glyph == "line" for layer in across[:5])
    assert list(named(across, "periodic windows").items[1].x) == [1 + np.sqrt(8), 3.8568]
    [doubled] = named(across, "period 2, stable").items
    assert np.nanmax(doubled.x) == pytest.approx(1 + np.sqrt(6), abs=0.05)  # where the orbit of period 2 doubles
    assert dict(doubled.facts(3))["a"] == "0.25"
    assert len(doubled.orbit(3)["x1"]) == 2
    turned = layers_of(groups, "a", "b")
    assert [layer.name for layer in turned] == [layer.name for layer in across]
    for layer, other in zip(across, turned, strict=True):
        for item, exchanged in zip(layer.items, other.items, strict=True):
            assert np.array_equal(item.x, exchanged.y, equal_nan=True)
            assert np.array_equal(item.y, exchanged.x)
    assert layers_of(groups, "a", "c") == []


def test_values_of_the_other_parameters_are_those_of_the_config_and_of_the_file():
    assert fixed_parameters(logistic_branches().attrs) == {"a": 0.25, "c": 8 / 3 - 1, "f": 7.0}
    particle = "system: {constraint: disturbed_speed, d: 0.2}\nsweep: {b: {start: 1, stop: 2, count: 3}}\nanalyses: {branches: {}}\n"
    assert fixed_parameters({"config": particle}) == {"a": 0.5, "c": 1.0, "d": 0.2, "omega": 1.0}
    assert fixed_parameters({"config": "nonsense: 1"}) == fixed_parameters({}) == {}


def test_connecting_orbits_are_curves_without_a_period():
    data = cusp_curves().drop_vars("period")
    layers = layers_of({"homoclinic": data}, "p", "q")
    assert [layer.name for layer in layers] == ["fold", "period doubling"]
    assert dict(layers[0].items[0].facts(3))["curve"] == "fold"
