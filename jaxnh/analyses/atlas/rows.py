"""Groups of several rows of a plane as one: datasets of the same variables at several values of the second axis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from jaxnh.analyses.base import variable
from jaxnh.analyses.batch import Axis

_SUMMED = ("not_located",)


def stack_rows(parts: Sequence[xr.Dataset], dim: str, second: Axis, values: Sequence[float]) -> xr.Dataset:
    """The datasets of all rows one after the other along a dimension, with the value of the second axis there.

    Shorter rows are filled up with NaN, or the first of the flags. What has not the dimension is that of the first
    row; numbers of what was not located are summed. Lines of `warnings` say of which row they are.

    Args:
        parts: one dataset a row, with the same variables.
        dim: what is stacked: branches, bifurcations or windows.
        second: the second axis.
        values: of it, one a row.
    """
    counts = [part.sizes[dim] for part in parts]
    stacked = {str(name): _stacked([part[str(name)] for part in parts], dim) for name in parts[0].data_vars}
    words, rows = f"{second.long_name} of the row", np.repeat(np.arange(len(parts), dtype=np.int32), counts)
    stacked["row"] = variable(dim, rows, f"number of the row, a value of {second.long_name}")
    stacked[second.name] = variable(dim, np.repeat(values, counts).astype(float), words, second.units)
    lines = [
        f"{line}, at {second.name} = {value:g}"
        for part, value in zip(parts, values, strict=True)
        for line in filter(None, str(part.attrs.get("warnings", "")).split("\n"))
    ]
    attrs = {key: value for key, value in parts[0].attrs.items() if key != "warnings"} | {"rows": second.name}
    return xr.Dataset(stacked, attrs=attrs | ({"warnings": "\n".join(lines)} if lines else {}))


def _stacked(rows: Sequence[xr.DataArray], dim: str) -> tuple[tuple[str, ...], np.ndarray, dict[str, object]]:
    first, dims = rows[0], tuple(map(str, rows[0].dims))
    attrs = {str(key): value for key, value in first.attrs.items()}
    if dim not in dims:
        data = sum(row.to_numpy() for row in rows) if first.name in _SUMMED else first.to_numpy()
        return dims, np.asarray(data), attrs
    shape = np.max([row.shape for row in rows], axis=0)
    along = dims.index(dim)
    shape[along] = sum(row.shape[along] for row in rows)
    empty = np.nan if first.dtype.kind in "fc" else np.ravel(attrs.get("flag_values", 0))[0]
    whole, start = np.full(shape, empty, first.dtype), 0
    for row in rows:
        place = [slice(size) for size in row.shape]
        place[along] = slice(start, start + row.shape[along])
        whole[tuple(place)] = row.to_numpy()
        start += row.shape[along]
    return dims, whole, attrs
