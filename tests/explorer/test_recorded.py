"""Planes of result files: which group is shown, pixels and colours of a part, and what is said of a lane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

import jaxnh
from jaxnh.exceptions import InputError, ResultError
from jaxnh.explorer.key import key_html
from jaxnh.explorer.raster import plane_raster
from jaxnh.explorer.recording import open_recording
from jaxnh.explorer.report import lines
from jaxnh.plotting.pixels import number_pixels
from jaxnh.plotting.style import MANY
from jaxnh.storage.hdf5 import write
from tests.helpers.hand_made_results import states, tree

B, D = np.linspace(0.0, 5.0, 6), np.array([3.0, 1.0, 2.0])  # the second axis is not in order
COORDINATES = {
    "b": ("b", B, {"long_name": "coupling b", "units": "1"}),
    "d": ("d", D, {"long_name": "depth d", "units": "m"}),
}


def number(b, d):
    return 10 * b + d - 25.0


def group(name, values, panel, **attrs):
    dims = ("b", "d", "exponent")[: np.ndim(values)]
    variable = (dims, values, {"long_name": f"words of {name}", "units": "1", **attrs})
    about = {"panel": panel, "panel_variables": name, "panel_label": f"label of {name}"}
    return xr.Dataset({name: variable}, COORDINATES, about)


@pytest.fixture
def file(tmp_path):
    exponents = number(B[:, None], D[None, :])[..., None] + np.array([0.0, -100.0])
    period = np.where(D[None, :] == 2.0, 0, np.arange(6)[:, None] + 1)
    lyapunov = group("exponents", exponents, "curves").assign(exponents_error=(("b", "d", "exponent"), exponents * 0.0))
    status = group("status", period * 0, "")["status"]
    multiplier = group("multiplier", period * 0.1, "")["multiplier"]
    periods = group("period", period, "integers").assign(status=status, multiplier=multiplier)
    doubling = xr.Dataset({"b": (("d", "level"), np.ones((3, 2)))}, attrs={"panel": "cascade", "panel_variables": "b"})
    path = tmp_path / "plane.h5"
    attrs = {"jaxnh_version": "0", "solver": "s", "steps_per_period": 1, "error_estimate": 1e-6, "title": "A plane"}
    groups = {"doubling": doubling, "lyapunov": lyapunov, "period": periods}
    write(path, {"axes": "b d", **attrs}, groups)
    return path


def test_planes_are_the_groups_over_two_axes(file):
    source = open_recording(file)
    assert source.variables == {"lyapunov": "label of exponents", "period": "label of period"}
    assert source.first.ranges == {"b": (0.0, 5.0), "d": (1.0, 3.0)}
    assert source.axis_words == {"b": "coupling b", "d": "depth d (m)"}


def test_a_zoomed_plane_has_the_lanes_and_colours_of_its_range(file):
    source = open_recording(file)
    [whole] = source.passes(source.first)
    assert np.array_equal(whole.pixels.plane.values, number(B[None, :], np.sort(D)[:, None]))
    assert whole.words == "6 × 3 lanes"
    assert (whole.raster.across, whole.raster.up) == ((-0.5, 5.5), (0.5, 3.5))
    [part] = source.passes(source.first.zoom(1.5, 4.5, (1.9, 5.0)))
    assert np.array_equal(part.pixels.plane.values, number(B[None, 2:5], np.array([2.0, 3.0])[:, None]))
    expected = number_pixels(part.data["lyapunov"].to_dataset()).rgba()
    assert np.array_equal(part.raster.cells.view(np.uint8).reshape(2, 3, 4), expected)


def test_a_picture_of_a_part_is_saved_as_any_other(file):
    source = open_recording(file)
    [part] = source.passes(source.first.zoom(1.5, 4.5, (1.9, 5.0)))
    drawn = jaxnh.figure(part.data)
    assert drawn.axes[0].get_xlim() == (1.5, 4.5)
    assert drawn.get_suptitle() == "A plane"


def test_a_range_between_two_lanes_shows_those_about_it(file):
    source = open_recording(file)
    [part] = source.passes(source.first.zoom(2.1, 2.2, (1.1, 1.2)))
    assert np.array_equal(part.pixels.plane.values, number(B[None, 2:4], np.array([1.0, 2.0])[:, None]))


def test_what_is_said_of_a_lane_is_of_the_nearest_one(file):
    source = open_recording(file)
    [report] = source.lane(source.first, {"b": 3.2, "d": 2.9})
    assert report.where == {"b": 3.0, "d": 3.0}
    said = dict(lines(report))
    assert (said["least period"], said["exponent 1 (95 %)"]) == ("4", f"{number(3.0, 3.0):.6g}")


def test_uneven_axes_are_drawn_at_their_places():
    data = group("exponents", number(B[:, None], D[None, :]), "curves").isel(b=[0, 1, 5])
    found = plane_raster(number_pixels(data.assign_attrs(axes="b d")))
    assert found.across == (-0.5, 7.0)  # half a step beyond both ends
    row = found.cells[0]
    ends = np.append(0, np.flatnonzero(np.diff(row)) + 1) / len(row)  # where colours begin
    assert ends == pytest.approx([0.0, 1.0 / 7.5, 3.5 / 7.5], abs=1.0 / len(row))


def test_the_key_says_what_colours_stand_for(file):
    source = open_recording(file)
    exponents, periods = (
        key_html(next(source.passes(view)).pixels) for view in (source.first, replace(source.first, variable="period"))
    )
    assert "label of period" in periods
    assert f"<i style='background:{MANY[0]}'></i>1<" in periods
    assert "<span>0</span>" in exponents  # the level that colours are parted at
    assert exponents.count("linear-gradient") == 1


def test_of_a_file_with_a_diagram_alone_the_diagram_along_the_first_axis_is_shown(tmp_path):
    path, states = tmp_path / "diagram.h5", number(B[:, None], D[None, :])[..., None] + np.arange(4.0)
    dims = {"x": (("b", "d", "strobe"), states)}
    diagram = xr.Dataset(dims, COORDINATES, {"panel": "density", "panel_variables": "x"})
    write(path, {"jaxnh_version": "0", "axes": "b d"}, {"diagram": diagram})
    source = open_recording(path)
    [picture] = source.passes(source.first)
    assert source.first.ranges == {"b": (0.0, 5.0)}
    assert np.array_equal(picture.data["x"], states[:, 0])
    assert "at d = 3, the first of 3" in picture.notes[0]


def test_a_file_without_planes_is_refused(tmp_path):
    path = tmp_path / "none.h5"
    write(path, {"jaxnh_version": "0", "axes": "b d"}, {"other": group("exponents", np.zeros((6, 3)), "")})
    with pytest.raises(InputError, match="has other, and no diagram and no plane of two axes"):
        open_recording(path)


def test_a_diagram_as_a_figure_of_bokeh_by_its_group_or_its_coordinate():
    made = tree({"diagram": states(np.linspace(1.0, 6.0, 5), 8)})
    drawn = [jaxnh.bokeh_figure(made, name).yaxis[0].axis_label for name in (None, "diagram", "x2")]
    assert drawn == ["position x1", "position x1", "velocity x2 = dx1/dt"]


def test_a_figure_of_bokeh_has_the_same_pixels(file):
    tree = jaxnh.open_result(file)
    drawn = jaxnh.bokeh_figure(tree, "period")
    [source] = {glyph.data_source for glyph in drawn.renderers if "image" in glyph.data_source.data}
    source_of_file = open_recording(file)
    *_, picture = source_of_file.passes(replace(source_of_file.first, variable="period"))
    np.testing.assert_array_equal(source.data["image"][0], picture.raster.cells)
    assert (drawn.xaxis[0].axis_label, drawn.yaxis[0].axis_label) == ("coupling b", "depth d (m)")
    with pytest.raises(ResultError, match="no speed to be drawn; there are lyapunov, period"):
        jaxnh.bokeh_figure(tree, "speed")
