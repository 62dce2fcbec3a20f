"""What a user chooses of a picture: several results in one, coordinates, colours, sizes; and the one style of all."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex, to_rgb

from jaxnh.exceptions import ArgumentError, ResultError
from jaxnh.plotting import style
from jaxnh.plotting.results import figure
from tests.helpers.hand_made_results import ATTRS, dataset, doublings, exponents, periods, states, tree, verdicts

UP, DOWN = np.linspace(5.0, 5.5, 30), np.linspace(5.4, 6.0, 20)


def result(b, seed=0):
    groups = {"diagram": states(b, 8, seed=seed), "lyapunov": exponents(b, 1), "period": periods(b)}
    return tree({**groups, "doubling": doublings()})


def test_several_results_in_one_panel():
    """Diagrams and curves have all results in them, each in its colour and named above; other panels are of the first."""
    drawing = figure(result(UP), result(DOWN, seed=1), names=("up", "down"))
    diagram, curves, *_ = drawing.axes
    assert len(drawing.axes) == 4
    for line, b in zip(diagram.lines, (UP, DOWN), strict=True):
        assert np.array_equal(np.unique(line.get_xdata()), np.unique(b))
        assert len(line.get_xdata()) == 8 * len(b)
    assert [to_hex(line.get_color()) for line in diagram.lines] == [c.lower() for c in style.CURVES[:2]]
    for ax in (diagram, curves):
        assert [text.get_text() for text in ax.get_legend().get_texts()] == ["up", "down"]
        low, high = ax.get_xlim()
        assert low < 5.0
        assert high > 6.0
    assert "period is of up alone" in drawing.get_supxlabel()


def test_results_that_do_not_go_together():
    other = dataset({"d": (UP, "disturbance d")}, {"x1": (("d", "strobe"), np.zeros((30, 2)), "position x1", "1")},
                    panel="density", panel_variables="x1")  # fmt: skip
    with pytest.raises(ResultError, match=r"diagram cannot be drawn: .* over the same axis, not over b, d"):
        figure(tree({"diagram": states(UP, 8)}), tree({"diagram": other}, axes="d"))
    with pytest.raises(ResultError, match="2 results need as many names"):
        figure(result(UP), result(DOWN), names=("up",))


def test_other_coordinates():
    """Portraits and maps of any two, diagrams of any one; labels follow."""
    made = tree({"portrait": states(UP[:2], 9, "time", "trajectories"), "poincare": states(UP[:2], 5, panel="points"),
                 "diagram": states(UP, 8)})  # fmt: skip
    drawing = figure(made, coordinates=[("x1", "y1"), ("y2",)])
    assert [ax.get_xlabel() for ax in drawing.axes[:2]] == ["position $x_1$ (dimensionless)"] * 2
    assert [ax.get_ylabel() for ax in drawing.axes[:2]] == ["position $y_1$ (dimensionless)"] * 2
    path, points = drawing.axes[0].lines
    assert np.array_equal(path.get_ydata(), made["portrait"]["y1"][0])
    assert np.array_equal(points.get_ydata(), made["poincare"]["y1"][0])
    assert drawing.axes[2].get_ylabel() == "velocity $y_2$ (dimensionless)"
    assert np.array_equal(np.unique(drawing.axes[2].lines[0].get_ydata()), np.unique(made["diagram"]["y2"]))
    made["diagram"]["status"] = ("b", np.zeros(len(made["diagram"]["b"]), np.int8))
    with pytest.raises(ArgumentError, match=r"no diagram of z can be drawn; there are x1, x2, y1, y2$"):
        figure(made, coordinates=[("z",)])
    with pytest.raises(ArgumentError, match=r"no portrait or map of x1, x2 can be drawn; there is none in period$"):
        figure(tree({"period": periods(UP)}), coordinates=[("x1", "x2")])


def test_portraits_by_their_start():
    """All lanes in one panel, each with its colour and its value of the axis; the points on them in the same."""
    made = tree({"portrait": states(UP[:3], 9, "time", "trajectories"), "poincare": states(UP[:3], 5, panel="points")})
    (ax,) = figure(made, colour="start").axes
    assert [to_hex(line.get_color()) for line in ax.lines] == [c.lower() for c in style.CURVES[:3] for _ in range(2)]
    assert [text.get_text() for text in ax.get_legend().get_texts()] == [f"$b$ = {b:.4g}" for b in UP[:3]]


def test_many_portraits_by_their_start():
    """More lanes than colours with a name each are numbered on a scale."""
    ax, bar = figure(tree({"portrait": states(UP[:12], 9, "time", "trajectories")}), colour="start").axes
    assert len({line.get_color() for line in ax.lines}) == 12
    assert bar.get_ylabel() == "number of the start"


def test_many_lanes_have_a_scale_of_colours():
    """Every lane is a start of its own; more than have a colour each are numbered on a colour bar."""
    ax, bar = figure(tree({"diagram": states(UP, 4)}), colour="start").axes
    assert bar.get_ylabel() == "number of the start"
    assert bar.get_ylim() == (0, len(UP) - 1)
    assert len(np.unique(ax.collections[0].get_facecolors(), axis=0)) == len(UP)


def test_diagrams_by_their_starts_and_by_their_kind():
    """A dimension of starts has a colour each; a flag of another group the colours of its meanings."""
    b, starts = UP, np.random.default_rng(1).normal(size=(30, 3, 4))
    diagram = dataset({"b": (b, "coupling b")}, {"x1": (("b", "start", "strobe"), starts, "position x1", "1")},
                      panel="density", panel_variables="x1")  # fmt: skip
    made = tree({"diagram": diagram, "verdict": verdicts(b)})
    ax = figure(made, colour="start").axes[0]
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["start 0", "start 1", "start 2"]
    for k, line in enumerate(ax.lines):
        assert np.array_equal(np.sort(line.get_ydata()), np.sort(starts[:, k].ravel()))
    ax = figure(made, colour="kind").axes[0]
    kinds = made["verdict"]["kind"].to_numpy()
    for line, value in zip(ax.lines, np.unique(kinds), strict=True):
        assert np.array_equal(np.sort(line.get_ydata()), np.sort(starts[kinds == value].ravel()))
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["periodic", "chaotic", "undecided"]
    with pytest.raises(ArgumentError, match="nothing is called attractor to colour by; there are start, b, kind"):
        figure(made, colour="attractor")


def test_units_that_nobody_has_said_are_not_shown():
    data = states(UP, 8)
    data["x1"].attrs["units"] = "m"
    del data["b"].attrs["units"]
    ax = figure(tree({"diagram": data})).axes[0]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("coupling $b$", "position $x_1$ (m)")


def test_legends_are_off_the_data():
    """With every panel that has one, below and above: no legend covers a point of its axes."""
    drawing = figure(result(UP), size=style.COLUMN)
    drawing.draw_without_rendering()
    with_legend = [ax for ax in drawing.axes if ax.get_legend()]
    assert with_legend
    for ax in with_legend:
        assert not ax.get_window_extent().overlaps(ax.get_legend().get_window_extent().padded(-1.0))


def test_words_below_are_within_a_column():
    """What a result is from takes more lines in a narrow figure; none is cut off at its edges."""
    attrs = {"solver": "tsitouras_papakostas8", "section": "y = 0, up", "jaxnh_version": "0.2.0.dev0"}
    drawing = figure(tree({"period": periods(UP)}, **attrs), size=style.COLUMN)
    with style.package_style():
        drawing.draw_without_rendering()
    [words] = [text for text in drawing.texts if "tsitouras_papakostas8" in text.get_text()]
    assert " ".join(words.get_text().split()).endswith("in a time of 6.283, error of one return 1e-05")
    assert 0.0 < words.get_window_extent().x0 < words.get_window_extent().x1 < drawing.bbox.x1


@pytest.mark.parametrize(
    ("text", "size"), [("column", (86 / 25.4, None)), ("page", (7.0, None)), ("120x80", (120 / 25.4, 80 / 25.4))]
)
def test_sizes(text, size):
    found = style.size_of(text)
    assert tuple(found) == size
    drawing = figure(result(UP), size=found)
    assert drawing.get_size_inches()[0] == pytest.approx(size[0])
    if size[1]:
        assert drawing.get_size_inches()[1] == pytest.approx(size[1])


def test_the_style_is_the_package_s_whatever_a_user_has(monkeypatch):
    """Letters and colours are those of the sheet, and the user's settings are as they were afterwards."""
    before = dict(mpl.rcParams)
    with mpl.rc_context({"font.size": 23, "lines.linewidth": 9}):
        ax = figure(result(UP)).axes[0]
        assert mpl.rcParams["font.size"] == 23
    assert ax.xaxis.label.get_size() == 8
    assert dict(mpl.rcParams) == before
    assert ATTRS["jaxnh_version"] in ax.figure.get_supxlabel()


# How cones of two of three kinds see colours: H. Brettel, F. Vienot, J. D. Mollon (1997), in the linear one-plane form
# of Vienot, Brettel, Mollon, Color Res. Appl. 24 (1999) 243, for linear RGB.
DEUTERANOPE = np.array([[0.29275, 0.70725, 0.0], [0.29275, 0.70725, 0.0], [-0.02234, 0.02234, 1.0]])
PROTANOPE = np.array([[0.11238, 0.88762, 0.0], [0.11238, 0.88762, 0.0], [0.00401, -0.00401, 1.0]])


def lab(linear):
    """CIE L*a*b* of linear sRGB, white D65."""
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ np.clip(
        linear, 0, 1
    )
    f = np.cbrt(xyz / [0.9505, 1.0, 1.089] + 1e-12)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("sees", [np.eye(3), DEUTERANOPE, PROTANOPE], ids=["all", "deuteranope", "protanope"])
def test_colours_that_the_colour_blind_tell_apart(sees):
    """Any two of the first six colours of curves differ by ten of CIE76 at least: 2.3 is what an eye just sees."""
    linear = [
        np.array([((c + 0.055) / 1.055) ** 2.4 if c > 0.04 else c / 12.92 for c in to_rgb(x)]) for x in style.CURVES
    ]
    found = [lab(sees @ colour) for colour in linear[:6]]
    for i in range(6):
        for j in range(i):
            assert np.linalg.norm(found[i] - found[j]) > 10.0, (style.CURVES[i], style.CURVES[j])


def test_a_colour_by_the_attractor():
    """Lanes of a portrait in the colours of the attractors that they lead to, as the group of basins says."""
    starts = xr.DataArray(
        np.array([1, 2, 1], np.int32), dims="b", attrs={"long_name": "number of the attractor", "units": "1"}
    )
    basins = xr.Dataset({"attractor": starts}, {"b": UP[:3]}, {"panel": "basins", "panel_variables": "attractor"})
    ax, below = figure(
        tree({"portrait": states(UP[:3], 9, "time", "trajectories"), "basins": basins}), colour="attractor"
    ).axes
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["attractor 1", "attractor 2"]
    assert "dimensionless" not in below.get_ylabel()  # a number that counts has no units
    colours = [to_hex(line.get_color()) for line in ax.lines]
    assert colours[0] == colours[2] != colours[1]
