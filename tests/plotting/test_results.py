"""Whole results as figures: which panels there are, and what is said of those that there are not."""

from __future__ import annotations

import io
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

from jaxnh.exceptions import ResultError
from jaxnh.plotting.results import figure
from tests.helpers.hand_made_results import doublings, exponents, growth_rates, periods, states, tree, verdicts, write

MANY, FEW = np.linspace(5.6, 5.45, 500), np.array([5.8, 2.5, 4.1, 5.3])
MASSES = xr.Variable(("mass",), [1.0, 2.0, 3.0], {"long_name": "parameter mass", "units": "1"})


def over_masses(data, masses=MASSES):
    """The same for every value of a second axis."""
    return xr.concat([data] * len(masses), "mass", data_vars="all").assign_coords(mass=masses)


def marks_of(ax):
    return [line.get_xdata()[0] for line in ax.lines if line.get_linestyle() == "--"]


def caption_lines(drawing):
    return drawing.get_supxlabel().splitlines()


def test_every_kind_in_the_order_of_the_result():
    """Points over their trajectories; doublings marked on densities; the rest a panel each."""
    groups = {
        "flow": states(FEW, 64, "time", "trajectories"),
        "map": states(FEW, 8, panel="points"),
        "values": states(MANY, 50),
        "cascade": doublings(),
        "spectrum": exponents(MANY, 3),
        "recurrence": periods(MANY),
        "walk": growth_rates(MANY),
        "kinds": verdicts(MANY),
    }
    drawing = figure(tree(groups))
    assert isinstance(drawing, Figure)
    assert [len(ax.lines) for ax in drawing.axes[:4]] == [2, 2, 2, 2]
    assert len(drawing.axes) == 4 + 6
    assert marks_of(drawing.axes[4]) == [5.52, 5.495, 5.489]
    assert drawing.get_suptitle() == "A little of everything"
    assert caption_lines(drawing) == ["jaxnh 0.1.0, blanes_moan6, 60 steps a period, error of one period 1e-05"]
    drawing.draw_without_rendering()


def test_the_same_from_a_file_as_from_memory(tmp_path):
    result = tree({"values": states(FEW, 50), "cascade": doublings((5.2, 4.8, 4.7, np.nan)), "kinds": verdicts(FEW)})
    path = write(tmp_path / "result.h5", result)
    drawn = []
    for drawing in (figure(result), figure(path), figure(str(path))):
        assert len(drawing.axes) == 3
        drawing.savefig(picture := io.BytesIO(), format="raw")
        drawn.append(picture.getvalue())
    assert drawn[0] == drawn[1] == drawn[2]


def test_without_a_clock_nothing_is_called_a_period():
    groups = {
        "map": states(FEW, 8, panel="points").assign_attrs(section="y1 = 0, up"),
        "periods": periods(FEW, "crossings"),
    }
    drawing = figure(tree(groups, section="y1 = 0, up"))
    assert caption_lines(drawing) == [
        "jaxnh 0.1.0, blanes_moan6, 60 steps in a time of 6.283, error of one return 1e-05"
    ]
    assert drawing.axes[-1].get_ylabel() == "least period (crossings)"


def test_one_group_and_one_dataset():
    """Without the attributes of a result there is no line below."""
    data = states(FEW, 5)
    for result in (data, tree({"values": data})["values"], xr.DataTree(data)):
        drawing = figure(result)
        assert len(drawing.axes) == 1
        assert drawing.get_supxlabel() == ""


def test_attributes_of_a_result_are_there_or_none_are():
    result = tree({"values": states(FEW, 5)})
    del result.attrs["solver"]
    with pytest.raises(ResultError, match="solver"):
        figure(result)


# ---- points over trajectories


def other_lanes():
    return states(FEW + 0.1, 8, panel="points")


def on_a_section():
    return states(FEW, 8, panel="points").assign_attrs(section="x1 = 0, up")


def in_another_plane():
    return states(FEW, 8, panel="points").assign_attrs(panel_variables="y1 y2")


@pytest.mark.parametrize("points", [other_lanes, on_a_section, in_another_plane])
def test_other_points_have_panels_of_their_own(points):
    drawing = figure(tree({"flow": states(FEW, 64, "time", "trajectories"), "map": points()}))
    assert [len(ax.lines) for ax in drawing.axes] == [1] * 8


@pytest.mark.parametrize("panel", ["trajectories", "points"])
def test_lanes_that_are_too_many_are_named(panel):
    many = np.arange(20.0)
    drawing = figure(tree({"states": states(many, 8, panel=panel)}))
    assert len(drawing.axes) == 12
    assert drawing.axes[0].get_title() == "(a) $b$ = 0"
    assert drawing.axes[-1].get_title() == "(t) $b$ = 19"
    assert caption_lines(drawing)[1:] == ["12 of the 20 values of b are drawn"]


def test_a_lane_taken_out_of_a_group():
    """By its place or as a group of one lane: one panel, of its points and no others."""
    data = states(np.linspace(1.0, 6.0, 30), 9, "time", "trajectories")
    data = data.assign_coords(time=np.arange(9))  # as in a file
    for one in (data.isel(b=3), data.isel(b=[3])):
        (ax,) = figure(one).axes
        [line] = ax.lines
        np.testing.assert_array_equal(line.get_xdata(), data["x1"][3])


def test_lanes_of_two_axes_have_a_panel_each():
    groups = {
        "flow": over_masses(states(FEW, 64, "time", "trajectories")),
        "map": over_masses(states(FEW, 8, panel="points")),
    }
    drawing = figure(tree(groups, "b mass"))
    assert len(drawing.axes) == 12
    assert drawing.axes[1].get_title() == r"(b) $b$ = 5.8, $\mathrm{mass}$ = 2"
    assert all(len(ax.lines) == 2 for ax in drawing.axes)
    more = xr.Variable(("mass",), np.arange(5.0), MASSES.attrs)
    groups = {name: over_masses(data.isel(mass=0, drop=True), more) for name, data in groups.items()}
    assert caption_lines(figure(tree(groups, "b mass")))[1:] == ["12 of the 20 points of b and mass are drawn"]


# ---- two axes


def test_a_few_points_of_a_second_axis_have_a_panel_each():
    """Densities with the doublings found there, and curves; whole numbers and flags as charts, doublings over them."""
    cascades = over_masses(doublings())
    cascades["b"][1] = cascades["b"][1] + 0.01
    groups = {
        "values": over_masses(states(MANY, 50)),
        "cascades": cascades,
        "spectrum": over_masses(exponents(MANY, 2)),
        "recurrence": over_masses(periods(MANY)),
        "kinds": over_masses(verdicts(MANY)),
    }
    drawing = figure(tree(groups, "b mass"))
    titles = [r"$\mathrm{mass}$ = 1", r"$\mathrm{mass}$ = 2", r"$\mathrm{mass}$ = 3"]
    panels = [ax for ax in drawing.axes if ax.get_xlabel()]
    assert [ax.get_title("left") for ax in panels] == [*titles, *titles, "", ""]
    for chart in panels[-2:]:
        assert [len(line.get_xdata()) for line in chart.lines] == [3] * 4
        np.testing.assert_allclose(chart.lines[1].get_xdata(), [5.495, 5.505, 5.495])
        np.testing.assert_array_equal(chart.lines[1].get_ydata(), [1.0, 2.0, 3.0])
    assert marks_of(drawing.axes[0]) == [5.52, 5.495, 5.489]
    np.testing.assert_allclose(marks_of(drawing.axes[1]), [5.53, 5.505, 5.499])
    assert caption_lines(drawing)[1:] == []
    drawing.draw_without_rendering()


@pytest.mark.parametrize("count", [6, 7])
def test_many_points_of_a_second_axis_are_a_chart(count):
    """Of what can be one; of densities a line says that they are not drawn."""
    masses = xr.Variable(("mass",), np.arange(float(count)), MASSES.attrs)
    spectrum = over_masses(exponents(FEW, 2), masses)
    drawing = figure(tree({"spectrum": spectrum, "values": over_masses(states(FEW, 5), masses)}, "b mass"))
    charts = [ax for ax in drawing.axes if ax.images]
    assert len(charts) == (0 if count == 6 else 1)
    assert len([ax for ax in drawing.axes if ax.get_xlabel()]) == (12 if count == 6 else 1)
    said = ["values is not drawn: it has 7 points of mass, of which at most 6 get a panel each"]
    assert caption_lines(drawing)[1:] == ([] if count == 6 else said)


def test_a_third_axis_is_not_drawn():
    """A chart is over two axes."""
    more = xr.Variable(("length",), np.arange(3.0), {"long_name": "parameter length", "units": "1"})
    data = over_masses(verdicts(FEW))
    data = xr.concat([data] * 3, "length", data_vars="all").assign_coords(length=more)
    drawing = figure(tree({"kinds": data, "cascade": doublings()}, "b mass length"))
    assert caption_lines(drawing)[1:] == [
        "kinds is not drawn: it has 9 points of mass and length, of which its panel shows one"
    ]


def test_a_second_axis_of_one_point():
    """Everything is drawn, and titles say where."""
    one = MASSES[1:2]
    groups = {
        "values": states(MANY, 50),
        "cascades": doublings(),
        "spectrum": exponents(MANY, 2),
        "recurrence": periods(MANY),
        "kinds": verdicts(MANY),
    }
    drawing = figure(tree({name: over_masses(data, one) for name, data in groups.items()}, "b mass"))
    assert [ax.get_title("left") for ax in drawing.axes] == [r"$\mathrm{mass}$ = 2"] * 5
    assert marks_of(drawing.axes[0]) == [5.52, 5.495, 5.489]
    assert len(caption_lines(drawing)) == 1


# ---- what cannot be drawn


def test_groups_that_do_not_say_how_are_named():
    plain = states(FEW, 5)
    old, later = plain.rename(strobe="sample").drop_attrs(deep=False), plain.assign_attrs(panel="hologram")
    drawing = figure(tree({"old": old, "older": old, "later": later, "values": plain}))
    assert len(drawing.axes) == 1
    assert caption_lines(drawing)[1:] == [
        "later is not drawn: its panel, hologram, is of no kind known here",
        "there is no picture of old, older",
    ]
    with pytest.raises(ResultError, match=r"^the result has nothing that can be drawn; there is no picture of old"):
        figure(tree({"old": old}))
    with pytest.raises(ResultError, match="nothing that can be drawn"):
        figure(old)
    with pytest.raises(ResultError, match="nothing that can be drawn"):
        figure(tree({}))


@pytest.mark.parametrize("lost", ["x1", "exponents_error", "delta", "period", "level"])
def test_a_missing_variable_is_one_sentence(tmp_path, lost):
    """Of the group that lacks it; an error band or a number of the level is not missed."""
    groups = {"values": states(FEW, 5), "cascade": doublings(), "spectrum": exponents(FEW, 2)}
    groups = {name: data.drop_vars(lost, errors="ignore") for name, data in groups.items()}
    path = write(tmp_path / "result.h5", tree(groups))
    if lost in ("exponents_error", "level"):
        assert len(figure(path).axes) == 3
        return
    with pytest.raises(ResultError) as caught:
        figure(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert lost in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_are_none_of_ours(tmp_path):
    text, other = tmp_path / "text.h5", tmp_path / "other.h5"
    text.write_text("title: not a result\n")
    xr.Dataset({"x": ("n", [1.0])}).to_netcdf(other, engine="h5netcdf")
    for path in (text, other, tmp_path / "none.h5"):
        with pytest.raises(ResultError, match=str(path)):
            figure(path)


def test_no_jax_is_loaded():
    code = "import sys, jaxnh.plot, jaxnh.plotting.results, jaxnh.plotting.costs; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=120).returncode == 0
