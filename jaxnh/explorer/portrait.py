"""The portrait of a lane or an orbit: in the plane of two coordinates, or in the space of three, turned by a drag."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from bokeh.events import Pan, PanStart
from bokeh.models import ColumnDataSource, CustomJS, Range1d
from bokeh.plotting import figure

from jaxnh.explorer.layers import Points, finite_points
from jaxnh.explorer.page_scripts import DRAGGED, TURNED
from jaxnh.explorer.page_style import NARROW
from jaxnh.explorer.source import LaneReport, axis_title
from jaxnh.plotting.descriptions import describe
from jaxnh.plotting.groups import variables_of
from jaxnh.plotting.style import LINE, POINT

_MOST_POINTS = 1 << 14
_HEIGHT, _SPACE = 380, 460  # pixels
_CAMERA = {"azimuth": -60.0, "elevation": 25.0}
_CORNERS = np.array([[-1, -1, -1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], float)  # three edges of the box meet in one
_DIGITS = 4
_FEW = 64  # points that get large marks

Coordinates = Mapping[str, np.ndarray]
"""Numbers by coordinate."""


class Portrait:
    """Trajectory and points of one lane, or points of an orbit.

    Attributes:
        plane: figure of two coordinates.
        space: figure of three.
        camera: source of its angles in degrees.
        names: coordinates that there are, those of the plane first.
    """

    def __init__(self, camera: Mapping[str, float] | None = None) -> None:
        """Nothing is drawn yet.

        Args:
            camera: azimuth and elevation in degrees.
        """
        self._titles: dict[str, str] = {}
        self._filled = 0  # times that there were other points in space
        self._path, self._points = dict[str, np.ndarray](), dict[str, np.ndarray]()
        self.names: tuple[str, ...] = ()
        self.plane = figure(
            tools="pan,wheel_zoom,box_zoom,reset", sizing_mode="stretch_width", height=_HEIGHT, name="portrait"
        )
        self.plane.toolbar.logo = None
        self._plane_path, self._plane_points = (
            ColumnDataSource({"x": [], "y": []}),
            ColumnDataSource({"x": [], "y": []}),
        )
        self.plane.line("x", "y", source=self._plane_path, color=LINE, line_width=1, legend_label="trajectory")
        self._marks = self.plane.scatter(
            "x", "y", source=self._plane_points, color=POINT, size=3, legend_label="points"
        )
        [legend] = self.plane.legend
        legend.update(orientation="horizontal", border_line_alpha=0.0, padding=0)
        self.plane.add_layout(legend, "above")  # off the data
        self._path_entry: Any = legend.items[0]
        self.camera = ColumnDataSource({name: [value] for name, value in (_CAMERA | dict(camera or {})).items()})
        self._make_space()

    def _make_space(self) -> None:
        across, up = (Range1d(start=-2.0, end=2.0) for _ in range(2))
        self.space = figure(
            tools="wheel_zoom,reset",
            active_scroll="wheel_zoom",
            height=_SPACE,
            width=_SPACE,
            name="space",
            x_range=across,
            y_range=up,
            css_classes=["square"],
            stylesheets=[NARROW],
        )
        self.space.toolbar.logo = None
        self.space.axis.visible = False
        self.space.grid.visible = False
        self.space.outline_line_alpha = 0.0
        starts, ends = ("u", "v", "w", "x", "y", "alpha"), ("u1", "v1", "w1", "x1", "y1")
        self._edges = ColumnDataSource({name: [] for name in (*starts, *ends)})
        self._steps = ColumnDataSource({name: [] for name in (*starts, *ends)})
        self._dots = ColumnDataSource({name: [] for name in starts})
        self._names = ColumnDataSource({name: [] for name in (*starts, "text")})
        segment = "x", "y", "x1", "y1"
        self.space.segment(*segment, source=self._edges, line_color="#888888")
        self.space.segment(*segment, source=self._steps, line_color="#4a6a8a", line_alpha="alpha")
        self.space.scatter("x", "y", source=self._dots, color=POINT, size=4, alpha="alpha")
        self.space.text("x", "y", text="text", source=self._names, text_font_size="12px", text_align="center")
        sources = [self._edges, self._steps, self._dots, self._names]
        turned = CustomJS(args={"camera": self.camera, "sources": sources}, code=TURNED)
        self.camera.js_on_change("data", turned)
        self._names.js_on_change("tags", turned)
        dragged = CustomJS(args={"camera": self.camera}, code=DRAGGED)
        for event in (PanStart, Pan):
            self.space.js_on_event(event, dragged)

    def show(self, report: LaneReport) -> None:
        """Draw a report: the trajectory and points of the section, or else the points of the attractors there."""
        groups = {key: describe(key, report.groups[key]) for key in ("portrait", "poincare") if key in report.groups}
        if not groups:
            self.show_orbit(points_of_attractors(report))
            return
        first = next(iter(groups.values()))
        path, points = (_numbers(groups.get(key)) for key in ("portrait", "poincare"))
        titles = {
            name: axis_title(str(first[name].attrs.get("long_name", name)), str(first[name].attrs.get("units", "")))
            for name in _numbers(first)
        }
        self._draw(path, points, titles, [str(variable.name) for variable in variables_of(first)])

    def show_orbit(self, points: Points) -> None:
        """Draw the points of an orbit, if there are any."""
        if not has_points(points):
            return
        self._draw({}, points, {name: name for name in points}, list(points))

    def _draw(self, path: Coordinates, points: Coordinates, titles: dict[str, str], plane: Sequence[str]) -> None:
        self._path, self._points, self._titles = dict(path), dict(points), titles
        self.names = tuple(dict.fromkeys((*plane[:2], *titles)))
        self._path_entry.visible = has_points(path)
        few = max(map(len, points.values()), default=0) <= _FEW
        self._marks.glyph.update(size=7 if few else 3)
        self.choose(self.names)

    def choose(self, names: Sequence[str]) -> None:
        """Show these coordinates: the first two in the plane, the first three in space."""
        across, up, *more = (*names, *names) if len(names) == 1 else tuple(names)
        for numbers, source in ((self._path, self._plane_path), (self._points, self._plane_points)):
            there = across in numbers and up in numbers
            source.data = {"x": numbers[across], "y": numbers[up]} if there else {"x": np.zeros(0), "y": np.zeros(0)}
        self.plane.xaxis.axis_label, self.plane.yaxis.axis_label = self._titles[across], self._titles[up]
        if more:
            self._fill_space((across, up, more[0]))

    def _fill_space(self, names: tuple[str, str, str]) -> None:
        """Points within a box of half width one, with its edges and their ends."""
        known = [numbers for numbers in (self._path, self._points) if all(name in numbers for name in names)]
        if not known:
            return
        every = [np.concatenate([numbers[name] for numbers in known]) for name in names]
        low = np.array([np.nanmin(values) for values in every])
        size = np.array([max(np.nanmax(values) - least, 1e-300) for values, least in zip(every, low, strict=True)])

        def boxed(numbers: Coordinates) -> np.ndarray:
            if not all(name in numbers for name in names):
                return np.zeros((3, 0))
            return np.stack([2 * (numbers[n] - a) / s - 1 for n, a, s in zip(names, low, size, strict=True)])

        path, dots = boxed(self._path), boxed(self._points)
        self._steps.data = _columns(path[:, :-1], path[:, 1:])
        self._dots.data = _columns(dots)
        corner = np.repeat(_CORNERS[:1].T, 3, axis=1)
        self._edges.data = _columns(corner, _CORNERS[1:].T)
        places, words = _edge_words([self._titles[name] for name in names], low, low + size)
        self._names.data = {**_columns(places), "text": words}
        self._filled += 1
        self._names.tags = [self._filled]  # the browser projects them


def has_points(points: Points) -> bool:
    """Return whether there are points, and in every coordinate."""
    return bool(points) and all(len(values) for values in points.values())


def points_of_attractors(report: LaneReport) -> Points:
    """Points of all attractors that there are at the parameters of a lane; none on planes of start states."""
    data = report.groups.get("attractors")
    if data is None or data["fraction"].ndim != 1:
        return {}
    return finite_points(data)


def _edge_words(titles: Sequence[str], low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Places (3, n) and words along the edges of the box: the coordinate with its range."""
    places, words = [], list[str]()
    for k, title in enumerate(titles):
        for share, text in ((0.0, title), (-0.75, f"{low[k]:.{_DIGITS}g}"), (0.95, f"{high[k]:.{_DIGITS}g}")):
            place = np.full(3, -1.12)
            place[k] = share
            places.append(place)
            words.append(text)
    return np.array(places).T, words


def _columns(start: np.ndarray, end: np.ndarray | None = None) -> dict[str, Any]:
    columns = dict(zip("uvw", start, strict=True)) | {name: np.zeros(start.shape[1]) for name in ("x", "y", "alpha")}
    if end is not None:
        columns |= {f"{name}1": values for name, values in zip("uvw", end, strict=True)}
        columns |= {name: np.zeros(start.shape[1]) for name in ("x1", "y1")}
    return columns


def _numbers(data: xr.Dataset | None) -> dict[str, np.ndarray]:
    """Coordinates of the states of a group, those of its plane first."""
    if data is None:
        return {}
    first = variables_of(data)
    dim = first[0].dims[-1]
    more = [item for item in data.data_vars.values() if item.dims == (dim,) and item.dtype.kind == "f"]
    names = dict.fromkeys(str(each.name) for each in (*first, *more) if str(each.name) != "t")
    return {name: data[name].to_numpy().ravel()[:_MOST_POINTS] for name in names}
