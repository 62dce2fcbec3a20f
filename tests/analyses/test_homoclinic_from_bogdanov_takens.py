"""Curves of homoclinic orbits from Bogdanov–Takens points through the whole package."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.orbits.bifurcations.connection_points import POINTS
from jaxnh.orbits.continuation.paths import ENDS
from tests.flows import bogdanov_takens
from tests.helpers.connection_results import points, result_of

WARNED = "no curve begins at the Bogdanov–Takens point at p = 0, q = 0: a coefficient of its normal form is zero"


def curves_with_points(data):
    """Numbers of the curves that begin at Bogdanov–Takens points, which stand among their points of codimension two."""
    vanish = ENDS.index("bogdanov_takens")
    curves = [k for k in range(data.sizes["curve"]) if vanish in (data["begins"].values[k], data["ends"].values[k])]
    kinds = data["codimension_two_kind"].values == POINTS.index("bogdanov_takens")
    assert sorted(data["codimension_two_curve"].values[kinds]) == curves
    return curves


def point_of(data, names):
    [k] = np.flatnonzero(data["codimension_two_kind"].values == POINTS.index("bogdanov_takens"))
    both = [[float(data[f"codimension_two_{name}{rest}"][k]) for name in names] for rest in ("", "_error")]
    return np.array(both)


@pytest.mark.usefixtures("uncalibrated", "quick_compiling_once")
def test_the_normal_form(tmp_path):
    """The point at the origin within its error; along the curve q = τ b ε² with τ = 10/7 + 288/2401 ε² + O(ε⁴), b = −1."""
    options = (
        "{box: {w0: [-1, 1], w1: [-1, 1]}, n_starts: 8, n_values: 1, duration: 5, ds_max: 0.25, max_steps: 12, "
        "bogdanov_takens: true}"
    )
    sweep = "{p: {start: -0.2, stop: 0.1, count: 3}, q: {values: [-0.5, 0.5]}}"
    groups = result_of(tmp_path, bogdanov_takens.normal_form, "{w0: 0.1}", sweep, options)
    data = groups["homoclinic"].to_dataset()
    assert curves_with_points(data) == [0]
    value, error = point_of(data, ("p", "q"))
    assert np.all(np.abs(value) <= error)
    values, errors = points(data, 0, ("p", "q"))
    eps, terms = bogdanov_takens.second_term(values, 1.0, -1.0)
    # An error of p is one of τ by its share, and as much of q.
    blurred = 1.5 / eps**2 * (errors[:, 0] / np.abs(values[:, 0]) + errors[:, 1] / np.abs(values[:, 1]))
    assert np.all(np.abs(terms - 288 / 2401) < 0.02 * eps**2 + blurred)
    assert min(eps) < 0.1
    assert errors[eps > 0.1].max() < 1e-9
    assert "warnings" not in data.attrs


@pytest.mark.slow  # the normal form is quick
@pytest.mark.usefixtures("uncalibrated", "quick_compiling_once")
def test_where_no_curve_begins_is_said(tmp_path):
    """Where b = 0, and in a range without such a point."""
    options = "{box: {w0: [-1, 1], w1: [-1, 1]}, n_starts: 8, n_values: 1, duration: 5, bogdanov_takens: true}"
    sweep = "{p: {start: -0.2, stop: 0.1, count: 3}, q: {values: [-0.5, 0.5]}}"
    data = result_of(tmp_path, bogdanov_takens.without_b, "{w0: 0.1}", sweep, options)["homoclinic"]
    assert WARNED in data.attrs["warnings"]
    sweep = "{p: {start: -0.2, stop: -0.1, count: 3}, q: {values: [-0.5, -0.45]}}"
    data = result_of(tmp_path, bogdanov_takens.normal_form, "{w0: 0.1}", sweep, options)["homoclinic"]
    assert "there is no Bogdanov–Takens point to begin at over p and q; looked along" in data.attrs["warnings"]
    assert "equilibria from 8 starts at 1 value of q" in data.attrs["warnings"]


SLOW = [
    (
        bogdanov_takens.bazykin,
        "{x: 1.0, v: 1.0}",
        "{alpha: {start: 0.1, stop: 0.9, count: 5}, delta: {values: [0.05, 0.3, 0.6]}}",
        "{x: [0.1, 100], v: [0.1, 30]}",
        (0.453624327778, 0.17512759295),
    ),
    (
        bogdanov_takens.lorenz84,
        "{x: 0.1, y: 0.1, z: 0.1, u: 0.1}",
        "{f: {start: 1.2, stop: 3.5, count: 6}, t: {values: [0.0, 0.04, 0.08]}}",
        "{x: [-3, 3], y: [-3, 3], z: [-3, 3], u: [-2, 2]}",
        (1.446716701115, 0.0209401696833),
    ),
]


@pytest.mark.slow  # the normal form is quick
@pytest.mark.usefixtures("uncalibrated", "quick_compiling_once")
@pytest.mark.parametrize(("define", "initial", "sweep", "box", "at"), SLOW, ids=["bazykin", "lorenz84"])
def test_published_flows(tmp_path, define, initial, sweep, box, at):
    """Orbits within their errors of those by DOP853: beyond an error the manifold goes past its saddle on another side."""
    options = (
        f"{{box: {box}, n_starts: 16, n_values: 1, duration: 5, ds_max: 0.1, max_steps: 60, bogdanov_takens: true}}"
    )
    names = tuple(name.split(":")[0].strip(" {") for name in sweep.split("}, "))
    groups = result_of(tmp_path, define, initial, sweep, options)
    data, orbits = groups["homoclinic"].to_dataset(), groups["connecting_orbits"].to_dataset()
    assert curves_with_points(data) == [0]
    value, error = point_of(data, names)
    assert value == pytest.approx(np.array(at), abs=1e-11)
    assert error.max() < 1e-11
    values, errors = points(data, 0, names)
    coordinates = [name.removesuffix("_departure") for name in data if str(name).endswith("_departure")]
    for k in np.linspace(1, len(values) - 2, 4).round().astype(int):
        one = data.isel(curve=0, point=k)
        saddle = np.array([float(one[f"{name}_departure"]) for name in coordinates])
        path = np.stack([orbits[f"{name}_points"].values[0, k] for name in coordinates], axis=1)
        duration = 3.0 * float(orbits["t"][0, k, -1])  # it begins nearer to the saddle
        slope = np.abs(np.divide(*(values[k + 1] - values[k - 1])))
        covered = np.array([errors[k, 0] + slope * errors[k, 1] + 1e-12, 0.0])  # of DOP853
        assert covered[0] < 1e-8
        sides = [
            bogdanov_takens.side(define, names, values[k] + shift, saddle, path, duration)
            for shift in (-covered, covered)
        ]
        assert sides[0] != sides[1]
