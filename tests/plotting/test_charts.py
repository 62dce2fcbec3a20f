"""Charts: every pixel is the lane's own, in its place, and what its colour means is said beside."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from jaxnh.exceptions import ResultError
from jaxnh.plotting.panels import PANELS
from jaxnh.plotting.results import figure
from tests.helpers.hand_made_results import exponents, growth_rates, periods, verdicts

B = np.array([5.8, 2.5, 4.1, 5.3])  # in no order
D = np.linspace(0.3, 0.1, 9)  # falling


def over_d(make, *arguments):
    """A group over b and d, its numbers other ones at each d."""
    rng = np.random.default_rng(1)
    words = {"long_name": "disturbance d", "units": "1"}
    data = xr.concat([make(B, *arguments)] * len(D), "d", data_vars="all").assign_coords(d=("d", D, words))
    name = data.attrs["panel_variables"]
    values = data[name].to_numpy()
    changed = rng.permuted(values, axis=0) if values.dtype.kind in "iu" else rng.normal(size=values.shape)
    return data.assign({name: data[name].copy(data=changed)}).assign_attrs(axes="b d")


def chart(data, **options):
    return PANELS[data.attrs["panel"]].chart(data, **options)


GROUPS = {
    "exponents": over_d(exponents, 3),
    "growth": over_d(growth_rates),
    "periods": over_d(periods),
    "verdicts": over_d(verdicts),
}


@pytest.mark.parametrize("name", GROUPS)
def test_pixels_are_lanes_in_their_place(name):
    """The image at each (b, d), both in rising order, has the number of that lane."""
    data = GROUPS[name]
    ax = chart(data)
    ax.figure.draw_without_rendering()
    [image] = [*ax.images, *ax.collections]
    shown = np.ma.getdata(image.get_array()).reshape(len(D), len(B))
    values = data[data.attrs["panel_variables"]]
    values = values.isel(exponent=0) if "exponent" in values.dims else values
    ordered = values.transpose("d", "b").sortby("b").sortby("d").to_numpy()
    if name in ("exponents", "growth"):
        np.testing.assert_array_equal(shown, ordered)
    else:  # colours of the same number are the same, and of others are not
        pairs = set(zip(ordered.ravel().tolist(), shown.ravel().tolist(), strict=True))
        assert len({number for number, _ in pairs}) == len({colour for _, colour in pairs}) == len(pairs)


@pytest.mark.parametrize("name", GROUPS)
def test_axes_and_colours_are_named(name):
    ax = chart(GROUPS[name])
    ax.figure.draw_without_rendering()
    assert ax.get_xlabel() == "coupling $b$ (dimensionless)"
    assert ax.get_ylabel() == "disturbance $d$ (dimensionless)"
    assert ax.get_xlim()[0] < 2.5 < 5.8 < ax.get_xlim()[1]
    assert ax.get_ylim()[0] < 0.1 < 0.3 < ax.get_ylim()[1]
    beside = [other.get_ylabel() for other in ax.figure.axes if other is not ax]
    words = {"exponents": "Lyapunov exponents", "growth": "0–1 test", "periods": "least period"}
    if name == "verdicts":
        texts = [text.get_text() for text in ax.get_legend().get_texts()]
        shares = [float(text.split(": ")[1].removesuffix(" %")) for text in texts]
        assert abs(sum(shares) - 100) < 0.5
    else:
        assert len(beside) == 1
        assert beside[0].startswith(words[name])


def test_colours_of_exponents_part_at_zero():
    """Chaos is red, order blue, and zero neither."""
    ax = chart(GROUPS["exponents"])
    [image] = [*ax.images, *ax.collections]
    red, zero, blue = (np.array(image.to_rgba(np.array([x]))[0]) for x in (2.0, 0.0, -2.0))
    assert red[0] > red[2]
    assert blue[2] > blue[0]
    assert abs(zero[0] - zero[2]) < 0.02


def test_colours_of_exponents_where_all_are_on_one_side():
    data = GROUPS["exponents"]
    for sign in (1.0, -1.0):
        ax = chart(data.assign(exponents=sign * abs(data["exponents"])))
        ax.figure.draw_without_rendering()


def test_what_is_no_number_is_black():
    data = GROUPS["exponents"].copy(deep=True)
    data["exponents"][1, 2] = np.nan
    ax = chart(data)
    [image] = [*ax.images, *ax.collections]
    colours = image.to_rgba(image.get_array()).reshape(-1, 4)
    assert np.sum(np.all(colours[:, :3] == 0.0, axis=1)) == 1


def test_a_chart_has_two_axes():
    with pytest.raises(ResultError, match="over two axes, not over b"):
        chart(periods(B).assign_attrs(axes="b"))


def test_statistics_of_a_diagram_are_charts():
    """The first of those that the group names, in its own words, or one of one's choice; over one axis all of them."""
    b, d = np.linspace(5.2, 5.6, 6), np.linspace(0.0, 0.2, 9)
    said = {
        f"x1_{kind}": f"{words} position x1 at the strobes" for kind, words in (("max", "largest"), ("std", "rough"))
    }
    data = xr.Dataset(
        {
            name: (("b", "d"), np.add.outer(b, d) * (k + 1), {"long_name": words})
            for k, (name, words) in enumerate(said.items())
        },
        {"b": b, "d": d},
        {
            "axes": "b d",
            "panel": "curves",
            "panel_variables": "x1_max x1_std",
            "panel_label": "x1 at the strobes",
            "panel_levels": "none",
        },
    )
    tree = xr.DataTree.from_dict({"/": xr.Dataset(attrs={"axes": "b d"}), "diagram": data})
    for choice, name in (((), "x1_max"), ((("x1_std",),), "x1_std")):
        axes = figure(tree, coordinates=choice).axes
        assert any(said[name] in ax.get_ylabel().replace("\n", " ") for ax in axes)
        [image] = axes[0].get_images()
        assert np.allclose(image.get_array(), data[name].to_numpy().T)
        assert image.norm.vmin >= data[name].min()  # no half of the colours for a sign that nothing has
    over_b = figure(data.isel(d=0))
    assert "x1 at the strobes" in over_b.axes[0].get_ylabel()
    assert len([line for line in over_b.axes[0].get_lines() if len(line.get_xdata()) == len(b)]) == 2
