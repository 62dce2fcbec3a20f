"""Kinds of panels, by name; `descriptions` has the kind of each group. No analyses are named here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal, NamedTuple

import xarray as xr
from matplotlib.axes import Axes

from jaxnh.plotting.basins import basin_pixels, basins_chart, shares
from jaxnh.plotting.bifurcation_curves import bifurcation_curves, special_points
from jaxnh.plotting.branches import bifurcations, branches
from jaxnh.plotting.cascade import cascade
from jaxnh.plotting.charts import flags_chart, integers_chart, numbers_chart
from jaxnh.plotting.curves import curves, flags, integers
from jaxnh.plotting.density import density
from jaxnh.plotting.descriptions import describe
from jaxnh.plotting.groups import kind_of
from jaxnh.plotting.manifolds import manifolds
from jaxnh.plotting.phase_response import phase_responses
from jaxnh.plotting.pixels import Colourer, Pixels, flag_pixels, integer_pixels, number_pixels
from jaxnh.plotting.planes import points, trajectories
from jaxnh.plotting.surfaces import surfaces
from jaxnh.plotting.torus_branches import torus_branches
from jaxnh.plotting.windows import windows


class Kind(NamedTuple):
    """A kind of panel.

    Attributes:
        draw: `draw(data, ax=None, ...)`, returns the axes.
        height: in inches, on a whole page.
        each: the unit of a panel: a lane; a point of the axes beside the first, if these are few; or the whole group.
        chart: `chart(data, ax=None, over=())` draws it over two axes, a pixel a lane; None: it cannot be.
        over: the kind of groups that are drawn over its chart.
        pixels: the chart as pixels.
    """

    draw: Callable[..., Axes]
    height: float
    each: Literal["lane", "point", "group"]
    chart: Callable[..., Axes] | None = None
    over: str = "cascade"
    pixels: Colourer | None = None


PANELS: Mapping[str, Kind] = {
    "trajectories": Kind(trajectories, 2.9, "lane"),
    "points": Kind(points, 2.9, "lane"),
    "manifolds": Kind(manifolds, 2.9, "lane"),
    "surfaces": Kind(surfaces, 3.6, "lane"),
    "density": Kind(density, 3.2, "point"),
    "cascade": Kind(cascade, 2.1, "group"),
    "curves": Kind(curves, 2.7, "point", numbers_chart, pixels=number_pixels),
    "integers": Kind(integers, 2.0, "group", integers_chart, pixels=integer_pixels),
    "phase_responses": Kind(phase_responses, 2.9, "lane"),
    "basins": Kind(integers, 2.0, "group", basins_chart, "shares", basin_pixels),
    "shares": Kind(shares, 2.4, "group"),
    "branches": Kind(branches, 3.6, "group"),
    "torus_branches": Kind(torus_branches, 2.7, "group"),
    "marks": Kind(bifurcations, 2.8, "group"),
    "bifurcation_curves": Kind(bifurcation_curves, 3.6, "group"),
    "special_points": Kind(special_points, 2.8, "group"),
    "windows": Kind(windows, 2.4, "group"),
    "flags": Kind(flags, 1.1, "group", flags_chart, pixels=flag_pixels),
}
"""Kinds of panels by name."""


def has_pixels(data: xr.Dataset) -> bool:
    """Return whether a group is of a kind that is a plane of pixels where it has two axes."""
    kind = PANELS.get(kind_of(data))
    return kind is not None and kind.pixels is not None


def pixels_of(name: str, groups: Mapping[str, xr.Dataset]) -> Pixels:
    """The pixels of a group that has some; those of basins say what the attractors are, where another group says it.

    Raises:
        ResultError: a variable is missing, or there are not two axes of more than one point.
    """
    groups = {key: describe(key, data) for key, data in groups.items()}
    kind = PANELS[kind_of(groups[name])]
    if kind is PANELS["basins"]:
        return basin_pixels(groups[name], [data for data in groups.values() if kind_of(data) == kind.over])
    assert kind.pixels is not None
    return kind.pixels(groups[name])
