"""Panels of basins of attraction: over two coordinates of the start with the attractors on them, and their shares.

Attractors have numbers, and the same number is the same colour in both. The group of a plane says which attractor every
point leads to; that of the shares has one row an attractor, with points of it under NAME_points.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.patches import Patch

from jaxnh.exceptions import ResultError
from jaxnh.plotting.charts import image_of, label_frame
from jaxnh.plotting.frame import legend_above, new_axes, over_axis
from jaxnh.plotting.groups import along_axis, require_variables
from jaxnh.plotting.labels import coordinate_of, is_angle
from jaxnh.plotting.meanings import FAILED, NONE, meanings
from jaxnh.plotting.pixels import Entry, Pixels, colour_pixels, plane_of
from jaxnh.plotting.style import TINTS, Colour, darker

_COLOURS, _POINTS = TINTS, tuple(darker(tint) for tint in TINTS)
_REST = "#ededed"  # attractors beyond the last colour
_FEW = 64  # points of an attractor that get large markers
_UNDECIDED, _FAILED = 0, -1
_SAME = 1e-6  # of the larger coordinate: points of an orbit that are one


class _Attractor(NamedTuple):
    """An attractor as the legend has it: number, colour of its basin and of its points, and its description."""

    number: int
    colour: str
    points: Colour
    words: str


def basins_chart(data: xr.Dataset, ax: Axes | None = None, *, over: Iterable[xr.Dataset] = ()) -> Axes:
    """Draw which attractor every point of a plane leads to; grey where undecided, black where a lane has failed.

    Args:
        data: one variable (axis, axis) of whole numbers: of an attractor from 1 on, 0 undecided, -1 failed.
        over: groups of attractors, whose points in this plane are drawn on it and which the legend names.

    Raises:
        ResultError: a variable is missing, or there are not two axes of more than one point.
    """
    ax, known = new_axes(ax), _common_attractors(over)
    pixels, named = _pixels(data, known)
    image_of(pixels, ax)
    legend_above(ax, [_patch(entry) for entry in pixels.entries], 3)
    label_frame(data, pixels.plane, ax)
    for group in known:
        _attractors(group, (pixels.plane.x, pixels.plane.y), named, ax)
    return ax


def basin_pixels(data: xr.Dataset, over: Iterable[xr.Dataset] = ()) -> Pixels:
    """Draw which attractor every point of a plane leads to, with their shares; as of `basins_chart`.

    Raises:
        ResultError: a variable is missing, or there are not two axes of more than one point.
    """
    return _pixels(data, _common_attractors(over))[0]


def _common_attractors(over: Iterable[xr.Dataset]) -> list[xr.Dataset]:
    """Groups of attractors with one list for the whole plane."""
    return [group for group in over if group.sizes.get("attractor", 0) and "kind" in group and group["kind"].ndim == 1]


def _pixels(data: xr.Dataset, known: Sequence[xr.Dataset]) -> tuple[Pixels, list[_Attractor]]:
    plane = plane_of(data)
    most = int(max(plane.values.max(initial=0), 1))
    named = _name_attractors(known[0] if known else None, most)
    shares = {number: 100 * float(np.mean(plane.values == number)) for number in range(_FAILED, most + 1)}
    entries = [
        Entry(attractor.colour, f"{attractor.words}: {_percent(shares[attractor.number])}", attractor.points)
        for attractor in named[: len(_COLOURS)]
        if shares[attractor.number]
    ]
    if beyond := sum(shares[attractor.number] for attractor in named[len(_COLOURS) :]):
        entries.append(Entry(_REST, f"{len(named) - len(_COLOURS)} others: {_percent(beyond)}"))
    for number, colour, words in ((_UNDECIDED, NONE, "undecided"), (_FAILED, FAILED, "failed or escaped")):
        if shares[number]:
            entries.append(Entry(colour, f"{words}: {_percent(shares[number])}"))
    colours = ListedColormap([FAILED, NONE, *(attractor.colour for attractor in named)])
    return colour_pixels(data, plane, plane.values, colours, Normalize(_FAILED - 0.5, most + 0.5), entries), named


def _patch(entry: Entry) -> Patch:
    return Patch(facecolor=entry.colour, edgecolor=entry.edge or entry.colour, label=entry.words)


def shares(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Shares of the basins over one parameter, one on top of the other, with the intervals of their sums as bands.

    Args:
        data: `fraction`, `fraction_low` and `fraction_high` (axis, attractor); other axes have one point.

    Raises:
        ResultError: a variable is missing, or more than one axis has more than one point.
    """
    ax = new_axes(ax)
    fraction, low, high = require_variables(data, "fraction", "fraction_low", "fraction_high")
    if fraction.ndim < 2:
        raise ResultError("shares are drawn over a parameter, and there is none")
    axis, whole = along_axis(data, fraction)
    order = np.argsort(axis.to_numpy(), kind="stable")
    x, shares = axis.to_numpy()[order], 100.0 * np.nan_to_num(whole.to_numpy().reshape(axis.size, -1)[order])
    bars = [100.0 * along_axis(data, variable)[1].to_numpy().reshape(axis.size, -1)[order] for variable in (low, high)]
    total = np.zeros(len(x))
    for attractor in _name_attractors(None, shares.shape[1]):
        own = shares[:, attractor.number - 1]
        below, total = total, total + own
        if not own.any():
            continue
        ax.fill_between(x, below, total, color=attractor.colour, linewidth=0, label=attractor.words)
        ax.plot(x, np.where(own > 0, total, np.nan), color=attractor.points, linewidth=0.8)
        lower, upper = (below + bar[:, attractor.number - 1] for bar in bars)
        ax.fill_between(x, lower, upper, where=own > 0, color=attractor.points, alpha=0.35, linewidth=0, zorder=3)
    if np.any(total < 100.0 - 1e-9):
        ax.fill_between(x, total, 100.0, color=NONE, linewidth=0, label="undecided, failed or escaped")
    over_axis(data, axis, ax, "share of the start states (%)")
    ax.set_ylim(0.0, 100.0)
    legend_above(ax, ax.get_legend_handles_labels()[0])
    return ax


def _name_attractors(group: xr.Dataset | None, most: int) -> list[_Attractor]:
    """Attractors up to a number, with what a group says that they are."""
    words = attractor_words(group) if group is not None else {}
    attractors = []
    for number in range(1, most + 1):
        own = number <= len(_COLOURS)
        colour, points = (_COLOURS[number - 1], _POINTS[number - 1]) if own else (_REST, NONE)
        attractors.append(_Attractor(number, colour, points, words.get(number, f"attractor {number}")))
    return attractors


def attractor_words(group: xr.Dataset) -> dict[int, str]:
    """Describe each attractor of a group: its number, its kind, and the period of what is periodic."""
    kind, meaning = group["kind"].to_numpy(), meanings(group["kind"])
    periods = group["period"].to_numpy() if "period" in group else np.zeros(len(kind), int)
    descriptions = {}
    for number, kind_number, period in zip(group["attractor"].to_numpy().tolist(), kind.tolist(), periods, strict=True):
        said = meaning.get(kind_number, ("unknown", ""))[0]
        descriptions[number] = f"{number}, {said}" + (f", period {period}" if period > 0 else "")
    return descriptions


def _attractors(group: xr.Dataset, axes: tuple[xr.DataArray, xr.DataArray], named: list[_Attractor], ax: Axes) -> None:
    """Points of attractors in a plane, large where there are few; nothing where a coordinate is not among them."""
    if any(f"{coordinate_of(str(axis.name))}_points" not in group for axis in axes):
        return
    for attractor, points in zip(named, _points(group, axes), strict=False):
        few = len(points) <= _FEW
        drawn = ax.plot(
            *points.T, "o", color=attractor.points, markersize=3.5 if few else 0.9, markeredgewidth=0, zorder=3
        )
        drawn[0].set_path_effects([patheffects.Stroke(linewidth=1.0, foreground="white"), patheffects.Normal()] * few)


def _points(group: xr.Dataset, axes: tuple[xr.DataArray, xr.DataArray]) -> Iterator[np.ndarray]:
    """Different points of every attractor, each (points, 2); an angle as often as the axis goes around."""
    of_axes = [group[f"{coordinate_of(str(axis.name))}_points"] for axis in axes]
    for plane in zip(*(values.to_numpy() for values in of_axes), strict=True):
        points = np.column_stack(plane)
        points = points[np.all(np.isfinite(points), axis=1)]
        unit = _SAME * max(float(np.abs(points).max(initial=0.0)), 1e-300)
        points = points[np.unique((points / unit).round(), axis=0, return_index=True)[1]]
        for k, (axis, name) in enumerate(zip(axes, of_axes, strict=True)):
            if is_angle(name):
                points = _repeat_angle(points, k, float(axis.min()), float(axis.max()))
        yield points


def _repeat_angle(points: np.ndarray, k: int, low: float, high: float) -> np.ndarray:
    """Points whose coordinate k is an angle from -pi to pi, at all its values from low to high."""
    turns = 2 * np.pi * np.arange(np.floor(low / (2 * np.pi) - 0.5), np.ceil(high / (2 * np.pi) + 0.5) + 1)
    copies = np.repeat(points[None], len(turns), axis=0)
    copies[:, :, k] += turns[:, None]
    inside = (copies[:, :, k] >= low) & (copies[:, :, k] <= high)
    return copies[inside]


def _percent(share: float) -> str:
    return f"{share:.3g} %"
