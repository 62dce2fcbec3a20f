"""Bokeh figures of the page: a view as an image, and the portrait of a lane."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from bokeh.models import (
    BasicTicker,
    BoxZoomTool,
    ColumnDataSource,
    CustomJSTickFormatter,
    ImageRGBA,
    Range1d,
    Span,
)
from bokeh.plotting import figure

from jaxnh.explorer.raster import ROWS
from jaxnh.explorer.source import LaneReport, Picture, axis_title
from jaxnh.explorer.view import View
from jaxnh.plotting.descriptions import describe
from jaxnh.plotting.groups import variables_of
from jaxnh.plotting.style import LINE, MARK, POINT

_MOST_POINTS = 1 << 14
_PLANE_HEIGHT = 560  # pixels
_NARROWEST = 960  # pixels: with the controls beside it, it is whole in a window of 1280

# Ticks are told apart down to the last bit of a double, whatever the range.
_TICKS = """
const step = ticks.length > 1 ? Math.abs(ticks[1] - ticks[0]) : Math.abs(tick) || 1
const digits = Math.max(0, Math.min(17, Math.ceil(-Math.log10(step) - 1e-9)))
return Math.abs(tick) >= 1e6 ? tick.toExponential(6) : tick.toFixed(digits)
"""


class Drawing:
    """The picture of a view.

    Attributes:
        figure: of Bokeh.
    """

    def __init__(self, view: View, x_label: str, y_label: str) -> None:
        self._cells = ColumnDataSource({"image": [], "x": [], "y": [], "dw": [], "dh": []})
        bottom, top = view.window or (0.0, 1.0)
        self.figure = figure(
            x_range=Range1d(start=view.low, end=view.high),
            y_range=Range1d(start=bottom, end=top),
            tools="pan,wheel_zoom,tap",
            active_scroll="wheel_zoom",
            sizing_mode="stretch_width",
            min_width=_NARROWEST,
            frame_height=_PLANE_HEIGHT if view.second else ROWS,
            output_backend="canvas",
            x_axis_label=x_label,
            y_axis_label=y_label,
            toolbar_location="right",
            name="view",
        )
        box = BoxZoomTool()
        self.figure.add_tools(box)
        self.figure.toolbar.active_drag = box
        self.figure.toolbar.logo = None
        self.figure.add_glyph(self._cells, ImageRGBA(image="image", x="x", y="y", dw="dw", dh="dh"))
        self.figure.grid.grid_line_alpha = 0.0
        look = {"line_color": MARK, "line_dash": "dashed", "visible": False}
        self._chosen = {view.axis: Span(dimension="height", **look), view.second: Span(dimension="width", **look)}
        for line in self._chosen.values():
            self.figure.add_layout(line)
        for axis in (self.figure.xaxis, self.figure.yaxis):
            axis.formatter = CustomJSTickFormatter(code=_TICKS)
            axis.ticker = BasicTicker(desired_num_ticks=6)

    def show(self, view: View, picture: Picture) -> None:
        """Draw a picture over the range of its view."""
        cells, (left, right), (low, high) = picture.raster.cells, picture.raster.across, picture.raster.up
        self.figure.x_range.update(start=view.low, end=view.high)
        bottom, top = view.window or (low, high)
        self.figure.y_range.update(start=bottom, end=top)
        self._cells.data = {"image": [cells], "x": [left], "y": [low], "dw": [right - left], "dh": [high - low]}

    def name(self, y_label: str) -> None:
        """Set the label of the vertical axis."""
        self.figure.yaxis.axis_label = y_label

    def mark(self, where: Mapping[str, float]) -> None:
        """Mark a lane by its values of the axes."""
        for name, value in where.items():
            self._chosen[name].update(visible=True, location=value)


class Portrait:
    """Trajectory and strobe points of one lane.

    Attributes:
        figure: of Bokeh.
    """

    def __init__(self) -> None:
        self._path = ColumnDataSource({"x": [], "y": []})
        self._points = ColumnDataSource({"x": [], "y": []})
        self.figure = figure(
            tools="pan,wheel_zoom,box_zoom,reset", sizing_mode="stretch_width", height=340, name="portrait"
        )
        self.figure.toolbar.logo = None
        self.figure.line("x", "y", source=self._path, color=LINE, line_width=1, legend_label="trajectory")
        self.figure.scatter("x", "y", source=self._points, color=POINT, size=3, legend_label="strobe points")
        [legend] = self.figure.legend
        legend.update(orientation="horizontal", border_line_alpha=0.0, padding=0)
        self.figure.add_layout(legend, "above")  # off the data

    def show(self, report: LaneReport) -> None:
        """Draw a report: points in the plane of the trajectory where there is one, those of a section too."""
        groups = {key: describe(key, report.groups[key]) for key in ("portrait", "poincare") if key in report.groups}
        there = list(groups.values())
        names = [str(variable.name) for variable in variables_of(there[0])] if there else ()
        for name, source in (("portrait", self._path), ("poincare", self._points)):
            data = groups.get(name)
            across, up = _values(data, names) if data is not None else (np.zeros(0), np.zeros(0))
            source.data = {"x": across, "y": up}
        if there:
            self.figure.xaxis.axis_label, self.figure.yaxis.axis_label = (
                axis_title(str(there[0][name].attrs.get("long_name", name)), str(there[0][name].attrs.get("units", "")))
                for name in names
            )


def _values(data: xr.Dataset, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    across, up = (data[name].to_numpy().ravel()[:_MOST_POINTS] for name in names)
    return across, up
