"""Pictures of basins: pixels, shares and points are those of the groups, and the legend names them."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex

from jaxnh.exceptions import ResultError
from jaxnh.plotting.panels import PANELS
from jaxnh.plotting.results import figure
from tests.helpers.hand_made_results import basin_shares

X, V = np.linspace(-1.0, 1.0, 6), np.linspace(0.5, -0.5, 5)  # v falls
KINDS = {"flag_values": np.arange(-1, 2, dtype=np.int8), "flag_meanings": "absent periodic chaotic"}


def plane(seed: int = 3) -> xr.Dataset:
    number = np.random.default_rng(seed).integers(-1, 4, (len(X), len(V)))
    words = {"long_name": "attractor that the start state leads to"}
    attrs = {"panel": "basins", "panel_variables": "attractor", "axes": "x v"}
    return xr.Dataset({"attractor": (("x", "v"), number, words)}, {"x": X, "v": V}, attrs)


def attractors(**more: np.ndarray) -> xr.Dataset:
    angle = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    x = np.stack([np.full(100, 0.25), 0.5 * np.cos(angle), np.tile([-0.5, 0.5], 50)])
    v = np.stack([np.full(100, 0.1), 0.3 * np.sin(angle), np.tile([0.2, -0.2], 50)])
    return xr.Dataset(
        {
            "kind": ("attractor", np.array([0, 1, 0], np.int8), KINDS),
            "period": ("attractor", np.array([1, 0, 2])),
            "x_points": (("attractor", "point"), x),
            "v_points": (("attractor", "point"), v),
            "fraction": ("attractor", np.array([0.5, 0.3, 0.2])),
            **more,
        },
        {"attractor": [1, 2, 3]},
        {"panel": "shares", "panel_variables": "fraction"},
    )


def test_pixels_and_legend():
    """Every pixel has the colour of its number; the legend says what it is, and how many of the pixels it has."""
    data = plane()
    ax = PANELS["basins"].chart(data, over=[attractors()])
    ax.figure.draw_without_rendering()
    [image] = [*ax.images, *ax.collections]
    number = data["attractor"].transpose("v", "x").sortby("v").to_numpy()
    np.testing.assert_array_equal(np.ma.getdata(image.get_array()).reshape(number.shape), number)
    colours = {n: to_hex(image.cmap(image.norm(n))) for n in range(-1, 4)}
    assert len(set(colours.values())) == 5
    handles = {text.get_text(): patch for text, patch in zip(*_legend(ax), strict=True)}
    named = {"1, periodic, period 1": 1, "2, chaotic": 2, "3, periodic, period 2": 3, "undecided": 0}
    for words, n in {**named, "failed or escaped": -1}.items():
        patch = handles.pop(f"{words}: {100 * np.mean(number == n):.3g} %")
        assert to_hex(patch.get_facecolor()) == colours[n]
    assert not handles


def test_attractors_are_on_their_plane():
    """Different points of an orbit once each and large, those of a motion that fills a curve small."""
    ax = PANELS["basins"].chart(plane(), over=[attractors()])
    one, two, three = ax.lines
    np.testing.assert_allclose(one.get_xydata(), [[0.25, 0.1]])
    np.testing.assert_allclose(np.sort(three.get_xdata()), [-0.5, 0.5])
    assert len(two.get_xdata()) == 100
    assert two.get_markersize() < one.get_markersize() == three.get_markersize()


def test_angles_are_drawn_wherever_the_axis_goes():
    """An angle of 0.25 is also 0.25 − 2π; on an axis that ends before, it is not drawn."""
    group = attractors()
    group["x_points"].attrs["long_name"] = "angle x of points of the attractor"
    for begin, end, expected in ((-1.0, 1.0, [0.25]), (-7.0, 1.0, [0.25 - 2 * np.pi, 0.25]), (1.0, 5.0, [])):
        ax = PANELS["basins"].chart(plane().assign_coords(x=np.linspace(begin, end, len(X))), over=[group])
        np.testing.assert_allclose(np.sort(ax.lines[0].get_xdata()), expected)


def test_other_planes_have_no_points():
    """Attractors without these coordinates are named, and not drawn."""
    ax = PANELS["basins"].chart(plane(), over=[attractors().drop_vars("v_points")])
    assert not ax.lines
    assert any("chaotic" in text.get_text() for text in _legend(ax)[0])


def test_shares_add_up():
    """Bounds of the areas over the parameter are sums of the fractions; the rest up to one is grey."""
    data = basin_shares([5.4, 5.5, 5.6])
    ax = PANELS["shares"].draw(data)
    areas = {area.get_label(): area for area in ax.collections if not area.get_label().startswith("_")}
    total = np.cumsum(100.0 * data["fraction"].to_numpy(), axis=1)
    for k in range(3):
        vertices = areas[f"attractor {k + 1}"].get_paths()[0].vertices
        for b, low, high in zip(
            data["b"].to_numpy(), total[:, k] - 100.0 * data["fraction"][:, k], total[:, k], strict=True
        ):
            ends = vertices[vertices[:, 0] == b, 1]
            np.testing.assert_allclose([ends.min(), ends.max()], [low, high], atol=1e-12)
    assert "undecided, failed or escaped" in areas
    assert ax.get_ylim() == (0.0, 100.0)


def test_shares_need_a_parameter():
    with pytest.raises(ResultError, match="over a parameter"):
        PANELS["shares"].draw(
            attractors(fraction_low=("attractor", np.zeros(3)), fraction_high=("attractor", np.ones(3)))
        )


def test_a_whole_result():
    """A plane has its attractors drawn on it, which have no panel of their own then; over a parameter they have one."""
    tree = xr.DataTree.from_dict({"basins": plane(), "attractors": attractors()})
    tree.attrs["axes"] = "x v"
    [ax] = figure(tree).axes
    assert len(ax.lines) == 3
    [ax] = figure(xr.DataTree.from_dict({"attractors": basin_shares(np.linspace(5.4, 5.6, 9))})).axes
    assert ax.get_ylim() == (0.0, 100.0)


def _legend(ax):
    legend = ax.get_legend()
    return legend.get_texts(), legend.get_patches()
