"""Results that have curves over two parameters, or branches over one, and no chart or diagram below them. No JAX."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import xarray as xr

from jaxnh.explorer.file_source import Attrs, FileSource, Groups
from jaxnh.explorer.fixed_parameters import swept_ranges
from jaxnh.explorer.raster import MOST_CELLS, Raster
from jaxnh.explorer.source import LaneReport, Picture
from jaxnh.explorer.view import View
from jaxnh.plotting.groups import parameter_of, variables_of
from jaxnh.plotting.labels import words_of

_WHITE = np.full((1, 1), 0xFFFFFFFF, np.uint32)
_OVER_TWO = ("curves", "homoclinic")


def has_curves(groups: Groups) -> bool:
    """Return whether there are groups that can be shown over nothing."""
    return any(name in groups for name in (*_OVER_TWO, "branches"))


class BlankPicture(FileSource):
    """A white picture over the axes of curves or branches, which are laid over it; as `PictureSource`."""

    def __init__(self, groups: Groups, attrs: Attrs, name: str) -> None:
        """Read the axes.

        Args:
            groups: of the result, `curves`, `homoclinic` or `branches` among them.
            attrs: of its root.
            name: what it is called.
        """
        curves = next((groups[key] for key in _OVER_TWO if key in groups), None)
        data = groups["branches"] if curves is None else curves
        across = parameter_of(data) if curves is None else str(variables_of(data)[0].name)
        heights = (
            [str(key) for key in data.data_vars if str(key).endswith("_points")]
            if curves is None
            else [str(variables_of(data)[1].name)]
        )
        swept = swept_ranges(attrs)
        ends = {key: swept.get(key) or _extent(data[key]) for key in (across, *heights)}
        axes = (across, *(() if curves is None else heights))
        first = xr.Dataset({axis: (axis, list(ends[axis]), data[axis].attrs) for axis in axes})
        super().__init__(groups, first.assign_attrs(axes=" ".join(axes)), axes, attrs, name)
        self._ends = {key.removesuffix("_points"): value for key, value in ends.items()}
        if curves is None:
            self.variables = {key.removesuffix("_points"): words_of(data[key]) for key in heights}
            self.first = View(across, *ends[across], next(iter(self.variables)), columns=MOST_CELLS)
        else:
            up = heights[0]
            self.variables = {"curves": "curves"}
            self.first = View(across, *ends[across], "curves", ends[up], up, columns=MOST_CELLS, rows=MOST_CELLS)

    def passes(self, view: View) -> Iterator[Picture]:
        """The one white picture."""
        up = view.window or self._ends[view.variable]
        shown = xr.DataTree.from_dict({"/": xr.Dataset(attrs=self._attrs), **self.overlays})  # pyright: ignore[reportUnknownMemberType]
        yield Picture(Raster(_WHITE, (view.low, view.high), up), shown, "no chart in this file", (self._note,))

    def lane(self, view: View, where: Mapping[str, float]) -> Iterator[LaneReport]:
        """The place alone: the file has no lanes."""
        yield LaneReport(where, {}, True)


def _extent(variable: xr.DataArray) -> tuple[float, float]:
    """Least and largest number of a variable, apart by something."""
    values = variable.to_numpy()
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    room = 0.0 if high > low else 0.5 * max(abs(low), 1.0)
    return low - room, high + room
