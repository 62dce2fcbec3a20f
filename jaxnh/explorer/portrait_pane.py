"""The portrait on the page: plane or space, and which coordinates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import panel as pn
from bokeh.models import ColumnDataSource

from jaxnh.explorer.layers import Points
from jaxnh.explorer.page_style import NARROW
from jaxnh.explorer.portrait import Portrait, has_points, points_of_attractors
from jaxnh.explorer.source import LaneReport

_PLANE, _SPACE = "plane", "space"
_AXES = ("across", "up", "third")


class PortraitPane:
    """A portrait with its controls.

    Attributes:
        layout: all of it, not seen before there is something to be seen.
    """

    def __init__(self, camera: Mapping[str, float] | None) -> None:
        """Nothing is drawn yet.

        Args:
            camera: angles of three dimensions; None: the plane is shown.
        """
        self._portrait, self._setting = Portrait(camera), False
        self._in = pn.widgets.RadioButtonGroup(
            options=[_PLANE, _SPACE], value=_SPACE if camera else _PLANE, width=130, align="end"
        )
        self._axes = [pn.widgets.Select(name=name, width=105) for name in _AXES]
        whole: dict[str, Any] = {"css_classes": ["whole"], "stylesheets": [NARROW]}
        plane = pn.pane.Bokeh(self._portrait.plane, sizing_mode="stretch_width")
        self._plane = pn.Column(plane, min_width=460, **whole)
        self._space = pn.Column(pn.pane.Bokeh(self._portrait.space), **whole)
        self._bar = pn.Row(self._in, *self._axes, css_classes=["wrapped"], stylesheets=[NARROW])
        self.layout = pn.Column(
            self._bar, self._plane, self._space, sizing_mode="stretch_width", visible=False, **whole
        )
        self._in.param.watch(self._arrange, "value")
        for select in self._axes:
            select.param.watch(self._chosen, "value")

    @property
    def camera(self) -> ColumnDataSource:
        """Source of the angles of the portrait in space."""
        return self._portrait.camera

    @property
    def angles(self) -> dict[str, float] | None:
        """Angles of the portrait in space, in degrees; None where the plane is shown."""
        if self._in.value == _PLANE:
            return None
        data: Any = self.camera.data
        return {str(name): float(values[0]) for name, values in data.items()}

    def show(self, report: LaneReport) -> None:
        """Draw a report, where it has a trajectory or points, of attractors too."""
        own = "portrait" in report.groups or "poincare" in report.groups
        there = own or has_points(points_of_attractors(report))
        if there:
            self._portrait.show(report)
            self._arrange()
        self.layout.visible = there

    def show_orbit(self, points: Points) -> bool:
        """Draw the points of an orbit; returns whether there are any."""
        if not has_points(points):
            return False
        self._portrait.show_orbit(points)
        self._arrange()
        self.layout.visible = True
        return True

    def hide(self) -> None:
        """Show nothing."""
        self.layout.visible = False

    def _arrange(self, *_: Any) -> None:
        names = list(self._portrait.names)
        space = len(names) > 2
        if space and list(self._axes[0].options) != names:
            self._setting = True
            for select, name in zip(self._axes, names, strict=False):
                select.options = names
                select.value = name
            self._setting = False
        elif space:
            self._chosen()
        self._bar.visible = space
        shown = space and self._in.value == _SPACE
        self._axes[2].visible = shown
        self._plane.visible, self._space.visible = not shown, shown

    def _chosen(self, *_: Any) -> None:
        chosen = [str(select.value) for select in self._axes]
        if not self._setting and len(set(chosen)) == len(chosen):
            self._portrait.choose(chosen)
