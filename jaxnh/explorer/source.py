"""Sources of a page: pictures of views and reports of lanes, computed or read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple, Protocol

import xarray as xr

from jaxnh.explorer.raster import Raster
from jaxnh.explorer.view import View
from jaxnh.plotting.pixels import Pixels


def axis_title(words: str, units: str) -> str:
    """The name of an axis of a drawing: words, and units where the user has given them."""
    return f"{words} ({units})" if units not in ("", "1") else words


class Picture(NamedTuple):
    """A view as far as it is known.

    Attributes:
        raster: its cells.
        data: what it is drawn from, over the axes; None while it is coarse.
        words: its ingredients.
        notes: remarks that are needed to read it.
        pixels: of a plane, with what its colours stand for.
    """

    raster: Raster
    data: xr.Dataset | xr.DataTree | None
    words: str
    notes: tuple[str, ...] = ()
    pixels: Pixels | None = None


class LaneReport(NamedTuple):
    """Facts of one lane, as far as they are known.

    Attributes:
        where: values of the axes and of other parameters, by name.
        groups: datasets of analyses, by name.
        whole: whether nothing more follows.
    """

    where: Mapping[str, float]
    groups: Mapping[str, xr.Dataset]
    whole: bool


class Parameter(NamedTuple):
    """A parameter that can be moved: its value in the config, and the ends of its slider."""

    name: str
    words: str
    value: float
    low: float
    high: float


class PictureSource(Protocol):
    """A source of pictures and reports.

    Attributes:
        title: what is shown, in words.
        first: the view that is shown first.
        variables: what can be drawn, coordinates of states or quantities over a plane, to what they are called.
        axis_words: what the axes are called.
        parameters: those that can be moved.
        computes: whether depth, accuracy and parameters can be chosen.
        overlays: groups that can be laid over the pictures, described, by name.
        system_text: text of the user's file; "": there is none.
    """

    @property
    def title(self) -> str: ...
    @property
    def first(self) -> View: ...
    @property
    def variables(self) -> Mapping[str, str]: ...
    @property
    def axis_words(self) -> Mapping[str, str]: ...
    @property
    def parameters(self) -> tuple[Parameter, ...]: ...
    @property
    def computes(self) -> bool: ...
    @property
    def overlays(self) -> Mapping[str, xr.Dataset]: ...
    @property
    def system_text(self) -> str: ...

    def passes(self, view: View) -> Iterator[Picture]:
        """Pictures of a view, each better than the one before."""
        ...

    def lane(self, view: View, where: Mapping[str, float]) -> Iterator[LaneReport]:
        """Yield what is known of the lane at values of the axes, more with each report."""
        ...

    def batch_text(self, view: View) -> str:
        """The YAML of a batch job that computes a view again; "" where that is not known."""
        ...
