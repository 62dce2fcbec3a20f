"""Figures of the page, by what they have drawn."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from jaxnh.explorer.source import LaneReport

pytest.importorskip("panel", reason="the extra explore is missing")

from jaxnh.explorer.figures import Portrait


def group(dim, numbers, plane):
    data = {name: (dim, numbers + k, {"long_name": f"coordinate {name}", "units": "m"}) for k, name in enumerate("xyz")}
    return xr.Dataset(data, attrs={"panel_variables": plane})


def test_points_of_a_section_are_in_the_plane_of_the_trajectory():
    """A section y = 0 has its own plane, x and z, which is drawn where there is no trajectory yet."""
    points, path = group("strobe", np.arange(3.0), "x z"), group("time", np.arange(9.0), "x y")
    portrait = Portrait()
    line, dots = (glyph.data_source for glyph in portrait.figure.renderers)
    portrait.show(LaneReport({"c": 5.7}, {"poincare": points}, whole=False))
    assert portrait.figure.yaxis[0].axis_label == "coordinate z (m)"
    assert np.array_equal(dots.data["y"], points["z"])
    portrait.show(LaneReport({"c": 5.7}, {"poincare": points, "portrait": path}, whole=True))
    assert portrait.figure.yaxis[0].axis_label == "coordinate y (m)"
    assert np.array_equal(dots.data["y"], points["y"])
    assert np.array_equal(line.data["y"], path["y"])
