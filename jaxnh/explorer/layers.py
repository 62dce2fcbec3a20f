"""Layers over a picture, each with an entry in the legend: curves, points and bands that are told apart by a click."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Literal, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

Facts = list[tuple[str, str]]
"""Names of facts, each with its value in words."""

Points = Mapping[str, Float[np.ndarray, " points"]]
"""Points of an orbit, by coordinate."""

REACH = 8.0
"""Pixels from a click within which a curve or a point is meant."""

_PIXELS_BEYOND = 400.0  # of the view, within which a curve is drawn, so that a short pan shows it
_TOGETHER = 0.25  # pixels between curves that lie on each other
_FINEST = 0.5  # pixels between points of a curve that are drawn


def _no_orbit(_: int) -> Points:
    return {}


class Item(NamedTuple):
    """A curve, some points, or a band that goes across from its first to its second point.

    Attributes:
        x, y: its points, with NaN where a curve is broken; of a band y is not looked at.
        facts: of the k-th point.
        orbit: points of the orbit of the k-th point; none where the file has none.
    """

    x: Float[np.ndarray, " points"]
    y: Float[np.ndarray, " points"]
    facts: Callable[[int], Facts]
    orbit: Callable[[int], Points] = _no_orbit


class Layer(NamedTuple):
    """Marks that the legend switches on and off together.

    Attributes:
        name: in the legend.
        glyph: how items are drawn.
        colour: of all of it.
        items: those of one kind.
        dash: number of the dash of its lines.
        mark: of its points, as Bokeh calls it; "hollow" before it: white inside.
        label: text beside its points.
    """

    name: str
    glyph: Literal["line", "dots", "band"]
    colour: str
    items: tuple[Item, ...]
    dash: int = 0
    mark: str = "circle"
    label: str = ""


def finite_points(data: xr.Dataset, at: tuple[int, ...] = (), ending: str = "_points") -> Points:
    """Finite points of an orbit that a group has, by coordinate."""
    names = [str(name) for name in data.data_vars if str(name).endswith(ending)]
    every = {name.removesuffix(ending): data[name].to_numpy()[at].ravel() for name in names}
    known = np.all([np.isfinite(values) for values in every.values()], axis=0) if every else np.zeros(0, bool)
    return {name: values[known] for name, values in every.items()}


class Scale(NamedTuple):
    """A view in pixels: its ranges, and its size."""

    across: tuple[float, float]
    up: tuple[float, float]
    width: float
    height: float

    def pixels(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places in pixels from the lower left corner."""
        (left, right), (low, high) = self.across, self.up
        return (x - left) / (right - left) * self.width, (y - low) / (high - low) * self.height


class Hit(NamedTuple):
    """An item that was clicked at, and which of its points is the nearest."""

    item: Item
    point: int


def nearest(layers: Iterable[Layer], x: float, y: float, scale: Scale) -> Hit | None:
    """Return the curve or point that is nearest to a place, within `REACH`; where there is none the band around it.

    Of some that lie on each other it is the one that is drawn last.
    """
    best, hit, band = np.inf, None, None
    at = scale.pixels(np.array(x), np.array(y))
    for layer in layers:
        for item in layer.items:
            if layer.glyph == "band":
                if item.x[0] <= x <= item.x[1]:
                    band = band or Hit(item, int(abs(x - item.x[1]) < abs(x - item.x[0])))
                continue
            far, point = _distance(item, at, scale, joined=layer.glyph == "line")
            if far <= REACH and far < best + _TOGETHER:
                best, hit = min(best, far), Hit(item, point)
    return hit or band


def _distance(item: Item, at: tuple[np.ndarray, np.ndarray], scale: Scale, *, joined: bool) -> tuple[float, int]:
    """Pixels from an item to a place, and the point of it that is nearest."""
    u, v = (own - place for own, place in zip(scale.pixels(item.x, item.y), at, strict=True))
    of_points = np.where(np.isfinite(u) & np.isfinite(v), np.hypot(u, v), np.inf)
    if not len(of_points):
        return np.inf, 0
    least = int(np.argmin(of_points))
    if not joined or len(u) < 2:
        return float(of_points[least]), least
    du, dv = np.diff(u), np.diff(v)
    length = np.maximum(du**2 + dv**2, 1e-300)
    share = np.clip(-(u[:-1] * du + v[:-1] * dv) / length, 0.0, 1.0)
    far = np.hypot(u[:-1] + share * du, v[:-1] + share * dv)
    far = np.where(np.isfinite(far), far, np.inf)
    of_segments = float(far.min())
    if of_segments >= of_points[least]:
        return float(of_points[least]), least
    place = int(np.argmin(far))
    return of_segments, place + int(share[place] > 0.5)


def thin(item: Item, scale: Scale) -> tuple[np.ndarray, np.ndarray]:
    """Points of a curve that are about in view and more than half a pixel apart, with its breaks."""
    u, v = scale.pixels(item.x, item.y)
    with np.errstate(invalid="ignore"):
        inside = (u > -_PIXELS_BEYOND) & (u < scale.width + _PIXELS_BEYOND)
        inside &= (v > -_PIXELS_BEYOND) & (v < scale.height + _PIXELS_BEYOND)
    near = inside.copy()  # with the next point on either side, so that a curve goes on to the edge
    near[1:] |= inside[:-1]
    near[:-1] |= inside[1:]
    x, y = np.where(near, item.x, np.nan), np.where(near, item.y, np.nan)
    cells = np.column_stack([np.floor(np.where(near, each, -1e6) / _FINEST) for each in (u, v)])
    other = np.ones(len(x), bool)
    other[1:] = np.any(cells[1:] != cells[:-1], axis=1)
    other[:-1] |= ~near[1:] & near[:-1]  # the last point before a break
    return x[other], y[other]
