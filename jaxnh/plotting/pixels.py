"""Planes over two axes of a sweep as pixels: values, their colours, and the meanings of these. Nothing is drawn here.

Pictures and the pages of the explorer share them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import UInt8
from matplotlib import colormaps
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, Normalize, TwoSlopeNorm

from jaxnh.exceptions import ResultError
from jaxnh.plotting.groups import axes_of, label_of_first, levels_of, long_axes, variables_of
from jaxnh.plotting.labels import with_units, words_of
from jaxnh.plotting.meanings import FAILED, NONE, meanings
from jaxnh.plotting.style import MANY, Colour

_PERIODS = (1, 2, 3, 4, 5, 6, 7, 8, 12, 16)  # with a colour each; the last stands for all from it on
_SPREAD = (0.5, 99.5)  # percentiles that the colours end at: a few pixels may lie far beyond


class Plane(NamedTuple):
    """A variable over two rising axes.

    Attributes:
        x, y: the axes, (n,) and (m,).
        values: (m, n), as an image has them.
        variable: with its words.
    """

    x: xr.DataArray
    y: xr.DataArray
    values: np.ndarray
    variable: xr.DataArray


class Entry(NamedTuple):
    """Meaning of a colour; `edge` is the colour of what is drawn over pixels of this one, where there is any."""

    colour: str
    words: str
    edge: Colour | None = None


class Pixels(NamedTuple):
    """A plane and its colours.

    Attributes:
        plane: its values and axes.
        places: (m, n), numbers that `norm` takes to colours; black where they are masked.
        colours: of the places.
        norm: of the places.
        words: quantity of the colours; of a scale with units.
        entries: meaning of each colour; none for a scale.
    """

    plane: Plane
    places: np.ndarray
    colours: Colormap
    norm: Normalize
    words: str
    entries: Sequence[Entry] = ()

    def rgba(self) -> UInt8[np.ndarray, "m n 4"]:
        """Red, green, blue and opacity of every pixel."""
        return np.asarray(self.colours(self.norm(self.places), bytes=True))


Colourer = Callable[[xr.Dataset], Pixels]
"""Pixels of a group over two axes; raises `ResultError` where it is none."""


def number_pixels(data: xr.Dataset) -> Pixels:
    """A number over two axes, its colours parted at zero; of several at each point, as exponents, the first.

    Where the group has two levels (`groups.levels_of`), colours go from one to the other, where it has none from the
    least to the largest. A pixel without a number is black.

    Raises:
        ResultError: a variable is missing, or there are not two axes of more than one point.
    """
    plane = plane_of(data)
    levels = levels_of(data)
    finite = plane.values[np.isfinite(plane.values)]
    low, high = np.percentile(finite, _SPREAD) if finite.size else (0.0, 1.0)
    if len(levels) != 1:
        least, largest = levels or (float(low), max(float(high), float(low) + 1e-9))
        colours, norm = colormaps["cividis"], Normalize(least, largest)
    else:
        at = levels[0]
        width = max(abs(at), abs(high - low), 1e-9) * 1e-3
        norm = TwoSlopeNorm(at, min(float(low), at - width), max(float(high), at + width))
        colours = colormaps["RdBu_r"]
    return colour_pixels(data, plane, plane.values, colours, norm)


def integer_pixels(data: xr.Dataset) -> Pixels:
    """Whole numbers, as periods are, over two axes: a colour each for small ones, grey where there is none.

    Raises:
        ResultError: a variable is missing, or there are not two axes of more than one point.
    """
    plane = plane_of(data)
    n = np.asarray(plane.values, float)
    place = np.where(n > 0, np.searchsorted(_PERIODS, n, side="right"), 0)
    colours = [NONE, *MANY]
    edges = np.arange(len(_PERIODS) + 2) - 0.5
    entries = tuple(map(Entry, colours, ("none", *_range_names())))
    return colour_pixels(data, plane, place, ListedColormap(colours), BoundaryNorm(edges, len(colours)), entries)


def flag_pixels(data: xr.Dataset) -> Pixels:
    """Flags over two axes, with the share of the points that has each.

    Raises:
        ResultError: a variable is missing, or there are not two axes of more than one point.
    """
    plane = plane_of(data)
    meaning = meanings(plane.variable)
    values = sorted(meaning)
    place = np.ma.masked_where(~np.isin(plane.values, values), np.searchsorted(values, plane.values))
    colours = ListedColormap([colour for _, colour in map(meaning.__getitem__, values)])
    entries = tuple(
        Entry(colour, f"{words}: {100 * np.mean(plane.values == value):.3g} %")
        for value, (words, colour) in meaning.items()
        if np.any(plane.values == value)
    )
    return colour_pixels(data, plane, place, colours, Normalize(-0.5, len(values) - 0.5), entries)


def colour_pixels(
    data: xr.Dataset,
    plane: Plane,
    places: np.ndarray,
    colours: Colormap,
    norm: Normalize,
    entries: Sequence[Entry] = (),
) -> Pixels:
    """Pixels of a plane; those that are not finite, or masked, are black."""
    masked = np.ma.masked_invalid(places) if np.issubdtype(places.dtype, np.floating) else places
    words = label_of_first(data) or words_of(plane.variable)
    words = words if entries else with_units(words, plane.variable)
    return Pixels(plane, masked, colours.with_extremes(bad=FAILED), norm, words, entries)


def plane_of(data: xr.Dataset) -> Plane:
    """The variable that the panel is of, over the two axes that have more than one point.

    Raises:
        ResultError: it is missing, or there are not two such axes.
    """
    variable = variables_of(data)[0]
    long = long_axes(data)
    if len(long) != 2:
        raise ResultError(f"a chart is over two axes, not over {' and '.join(long) or 'none'}")
    single = {name: 0 for name in axes_of(data) if name not in long}
    across, up = (data[name] for name in long)
    order = {name: np.argsort(data[name].to_numpy(), kind="stable") for name in long}
    values = variable.isel(single).isel(order).transpose(up.name, across.name, ...).to_numpy()
    whole = values.reshape(*values.shape[:2], -1)[..., 0]
    return Plane(across.isel({long[0]: order[long[0]]}), up.isel({long[1]: order[long[1]]}), whole, variable)


def _range_names() -> list[str]:
    """Meanings of the colours of whole numbers."""
    names = []
    for first, following in zip(_PERIODS, (*_PERIODS[1:], None), strict=True):
        last = None if following is None else following - 1
        names.append(f"{first}" if last == first else f"≥ {first}" if last is None else f"{first} to {last}")
    return names
