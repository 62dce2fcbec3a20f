"""Figures of the page, by what they have drawn."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from jaxnh.explorer.source import LaneReport

pytest.importorskip("panel", reason="the extra explore is missing")

from jaxnh.explorer.portrait import Portrait


def group(dim, numbers, plane):
    places = {name: "xyz".index(name) for name in dict.fromkeys((*plane, *"xyz"))}
    words = {"long_name": "coordinate", "units": "m"}
    return xr.Dataset(
        {name: (dim, numbers + k, {**words, "long_name": f"coordinate {name}"}) for name, k in places.items()}
    )


def test_points_of_a_section_are_in_the_plane_of_the_trajectory():
    """A section y = 0 has its own plane, x and z, which is drawn where there is no trajectory yet."""
    points, path = group("strobe", np.arange(3.0), "xz"), group("time", np.arange(9.0), "xy")
    portrait = Portrait()
    line, dots = (glyph.data_source for glyph in portrait.plane.renderers)
    portrait.show(LaneReport({"c": 5.7}, {"poincare": points}, whole=False))
    assert portrait.plane.yaxis[0].axis_label == "coordinate z (m)"
    assert np.array_equal(dots.data["y"], points["z"])
    assert [item.visible for item in portrait.plane.legend[0].items] == [False, True]
    portrait.show(LaneReport({"c": 5.7}, {"poincare": points, "portrait": path}, whole=True))
    assert portrait.plane.yaxis[0].axis_label == "coordinate y (m)"
    assert np.array_equal(dots.data["y"], points["y"])
    assert np.array_equal(line.data["y"], path["y"])
    assert [item.visible for item in portrait.plane.legend[0].items] == [True, True]
