"""The Bokeh figure of a view as an image."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bokeh.core.property.descriptors import UnsetValueError
from bokeh.models import (
    BasicTicker,
    BoxZoomTool,
    ColumnDataSource,
    CustomJS,
    CustomJSTickFormatter,
    ImageRGBA,
    PanTool,
    Range1d,
    Span,
)
from bokeh.plotting import figure

from jaxnh.explorer.layers import Scale
from jaxnh.explorer.page_style import NARROW
from jaxnh.explorer.raster import ROWS, Raster
from jaxnh.explorer.source import Picture
from jaxnh.explorer.view import View
from jaxnh.plotting.style import MARK

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
        pan: its tool that moves the view.
    """

    def __init__(self, view: View, x_label: str, y_label: str) -> None:
        self._cells = ColumnDataSource({"image": [], "x": [], "y": [], "dw": [], "dh": []})
        self._sent: Raster | None = None
        bottom, top = view.window or (0.0, 1.0)
        self.figure = figure(
            x_range=Range1d(start=view.low, end=view.high),
            y_range=Range1d(start=bottom, end=top),
            tools="wheel_zoom",
            active_scroll="wheel_zoom",
            sizing_mode="stretch_width",
            min_width=_NARROWEST,
            css_classes=["whole"],
            stylesheets=[NARROW],
            frame_height=_PLANE_HEIGHT if view.second else ROWS,
            output_backend="canvas",
            x_axis_label=x_label,
            y_axis_label=y_label,
            toolbar_location="right",
            name="view",
        )
        box, self.pan = BoxZoomTool(), PanTool()
        self.figure.add_tools(self.pan, box)
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
        if picture.raster is self._sent:  # a picture with other words alone
            return
        self._sent = picture.raster
        self._cells.data = {"image": [cells], "x": [left], "y": [low], "dw": [right - left], "dh": [high - low]}

    def run_with_pictures(self, script: CustomJS) -> None:
        """Run a script in the browser where a picture is shown: a page that replaces another one has no other event."""
        self._cells.js_on_change("data", script)

    def name(self, y_label: str) -> None:
        """Set the label of the vertical axis."""
        self.figure.yaxis.axis_label = y_label

    def mark(self, where: Mapping[str, float]) -> None:
        """Mark a lane by its values of the axes."""
        for name, value in where.items():
            self._chosen[name].update(visible=True, location=value)

    def unmark(self) -> None:
        """Mark no lane."""
        for line in self._chosen.values():
            line.visible = False

    @property
    def scale(self) -> Scale:
        """The ranges that are seen, and their size in pixels: a guess before a browser has drawn them."""
        drawn: Any = self.figure
        try:
            width, height = drawn.inner_width or _NARROWEST, drawn.inner_height or drawn.frame_height
        except UnsetValueError:
            width, height = _NARROWEST, drawn.frame_height
        across, up = ((ends.start, ends.end) for ends in (drawn.x_range, drawn.y_range))
        return Scale(across, up, float(width), float(height))
