"""Report of `jaxnh.inspect` on a result file: how it was made, what is in it, whether it is right. No JAX.

Variables are read by h5py in blocks: a result may be larger than memory.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TextIO

import h5py
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from jaxnh.exceptions import InputError, ResultError
from jaxnh.jobs.attributes import error_in_words, steps_in_words
from jaxnh.storage import hdf5 as store

if TYPE_CHECKING:
    import xarray as xr

_WIDTH = 110  # columns where the output goes to a file
_NAMED = 4  # lanes that are named where some have failed
_ROWS = 1 << 16  # rows of a table that are made at once


# ---- what it is


def show(path: Path, file: h5py.File) -> None:
    """Print what a result says of itself: provenance, then every variable with its sizes and range, then notes."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=_WIDTH)
    attrs = store.attributes(file)
    axes = str(attrs.get("axes", "")).split()
    grid = Table.grid(padding=(0, 2))
    for head, words in _facts(path, attrs, _coordinates(file, axes)):
        grid.add_row(head, words)
    console.print(grid, highlight=False, markup=False)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for head in ("variable", "dimensions", "units", "range", ""):
        table.add_column(head, justify="right" if head == "range" else "left")
    notes: list[str] = []
    for name, group in store.groups(file).items():
        table.add_row(f"[bold]{name}")
        for key, item in store.variables(group).items():
            if item.ndim and not (
                item.is_scale and (key in axes or str(item.attrs.get("long_name", "")).startswith("index along"))
            ):
                extent = _range(item)
                table.add_row(
                    f"  {key}",
                    " × ".join(f"{dim} {size:,}" for dim, size in zip(store.dimensions(item), item.shape, strict=True)),
                    str(item.attrs.get("counted_in") or item.attrs.get("units", "")),
                    extent.words,
                    extent.note,
                )
        notes += [f"{name}: {note}" for note in _notes(group, axes)]
    console.print(table)
    for note in notes:
        console.print(note, highlight=False, markup=False)


def _coordinates(file: h5py.File, axes: Sequence[str]) -> dict[str, np.ndarray]:
    """Values of the axes, each from the first group that has them."""
    coordinates: dict[str, np.ndarray] = {}
    for group, axis in itertools.product(store.groups(file).values(), axes):
        if axis not in coordinates and axis in group and store.dimensions(store.variable(group, axis)) == (axis,):
            coordinates[axis] = store.read(store.variable(group, axis))
    return coordinates


def _facts(path: Path, attrs: store.Attributes, axes: dict[str, np.ndarray]) -> Iterator[tuple[str, str]]:
    """Heads and words of what stands above the table."""
    size = path.stat().st_size
    yield "file", f"{path}, {size / 1e6:,.1f} MB" if size > 1e6 else f"{path}, {size / 1e3:,.1f} kB"
    yield "title", str(attrs.get("title", ""))
    yield "made", str(attrs.get("history", "")).splitlines()[0] if attrs.get("history") else ""
    libraries = json.loads(attrs.get("versions", "{}"))
    yield "by", ", ".join([f"jaxnh {attrs['jaxnh_version']}", *(f"{name} {v}" for name, v in libraries.items())])
    digest = attrs.get("config_sha256", attrs.get("cost_of", ""))
    yield "config", f"{len(str(attrs.get('config', '')).splitlines())} lines, SHA-256 {str(digest)[:16]}…"
    if "system_file" in attrs:
        lines = len(str(attrs["system_file"]).splitlines())
        yield "system", f"{attrs['system_file_path']}, {lines} lines, SHA-256 {attrs['system_file_sha256'][:16]}…"
    for k, (name, values) in enumerate(axes.items()):
        if len(values):
            words = f"{len(values):,} values of {name}, from {values[0]:.8g} to {values[-1]:.8g}"
            yield "" if k else "sweep", f"× {words}" if k else words
    if "solver" in attrs:
        yield (
            "accuracy",
            f"{attrs['solver']}, {steps_in_words(attrs)}, {attrs.get('summation', 'plain')} sums, "
            f"{error_in_words(attrs, digits='.1e')}",
        )
    wall, work = float(attrs.get("wall_seconds", math.nan)), float(attrs.get("lane_periods", math.nan))
    compiled = float(attrs.get("compile_seconds", math.nan))
    yield (
        "cost",
        f"{wall:,.1f} s, of these compiling {compiled:,.1f} s; {work:,.0f} lane-periods, {work / wall:,.0f} a second; "
        f"{attrs.get('device', '')}",
    )


class _Range(NamedTuple):
    """Least and largest number of a variable in words, and what there is to note."""

    words: str
    note: str


def _range(item: h5py.Dataset) -> _Range:
    """Range of the finite numbers, block by block; of flags their meanings."""
    if h5py.check_string_dtype(item.dtype) or not item.size:
        return _Range("", "text" if item.size else "empty")
    low, high, lost = math.inf, -math.inf, 0
    meanings = str(item.attrs.get("flag_meanings", "")).split()
    counts = np.zeros(len(meanings), int)
    for block in store.blocks(item):
        finite = np.isfinite(block)
        lost += block.size - np.count_nonzero(finite)
        if finite.any():
            low, high = min(low, block[finite].min()), max(high, block[finite].max())
        for k, flag in enumerate(np.atleast_1d(item.attrs.get("flag_values", []))[: len(meanings)]):
            counts[k] += np.count_nonzero(block == flag)
    notes = [f"{n:,} {word}" for n, word in zip(counts, meanings, strict=True) if n]
    if meanings and "valid_min" not in item.attrs:
        return _Range("", ", ".join(notes))
    words = f"{low:.5g} … {high:.5g}" if low <= high else "–"
    return _Range(words, ", ".join(notes + [f"{lost:,} not finite"] * bool(lost)))


# ---- notes on a group


def _notes(group: h5py.Group, axes: Sequence[str]) -> Iterator[str]:
    """Attributes and numbers of a group, lanes that have failed, and warnings."""
    said = store.attributes(group)
    warnings = str(said.pop("warnings", ""))
    said |= {key: store.read(item)[()] for key, item in store.variables(group).items() if not item.ndim}
    if said:
        words = {key: f"{value:.6g}" if isinstance(value, float) else value for key, value in said.items()}
        yield ", ".join(f"{key} {value}" for key, value in words.items())
    yield from _failed_lanes(group, axes)
    head = f"{str(group.name).strip('/')}: "  # warnings begin with it, as do these lines where they are shown
    yield from (line.removeprefix(head) for line in warnings.split("\n") if line)


def failed_in(path: Path, group: str) -> list[str]:
    """Lanes of a group of a result that have failed, and why, a line a reason."""
    with h5py.File(path, "r") as file:
        return list(_failed_lanes(store.groups(file)[group], str(store.attributes(file).get("axes", "")).split()))


def _failed_lanes(group: h5py.Group, axes: Sequence[str]) -> Iterator[str]:
    """Lanes that have failed, and why, by their status."""
    items = store.variables(group)
    if "status" not in items or not axes or not set(axes) <= set(store.dimensions(items["status"])):
        return
    codes = _worst_codes(items["status"], axes)
    for k, why in enumerate(str(items["status"].attrs["flag_meanings"]).split()):
        if k and (lanes := codes == k).any():
            places = np.argwhere(lanes)[:_NAMED]
            named = ", ".join(_place([items.get(axis) for axis in axes], place) for place in places)
            more = ", …" if np.count_nonzero(lanes) > _NAMED else ""
            head = axes[0] if len(axes) == 1 else f"({', '.join(axes)})"
            yield f"{np.count_nonzero(lanes):,} of {lanes.size:,} lanes failed: {why}, at {head} = {named}{more}"


def _worst_codes(item: h5py.Dataset, axes: Sequence[str]) -> np.ndarray:
    """The largest code of each lane, 0 or more, (*axes) in their order; read block by block."""
    dims = store.dimensions(item)
    own = tuple(k for k, dim in enumerate(dims) if dim not in axes)
    kept = [k for k in range(len(dims)) if k not in own]
    worst = np.zeros([item.shape[k] for k in kept], int)
    for where in item.iter_chunks() if item.chunks else [(slice(None),) * len(dims)]:
        place = tuple(where[k] for k in kept)
        worst[place] = np.maximum(worst[place], store.read(item, where).max(axis=own, initial=0))
    return worst.transpose([[dims[k] for k in kept].index(axis) for axis in axes])


def _place(axes: Sequence[h5py.Dataset | None], place: Sequence[int]) -> str:
    """Return where a lane lies, in values of the axes."""
    words = [f"{k if axis is None else axis[k]:.6g}" for axis, k in zip(axes, place, strict=True)]
    return words[0] if len(words) == 1 else f"({', '.join(words)})"


# ---- as a table


def write_csv(path: Path, group: str, out: TextIO) -> None:
    """A row for every place along the dimensions of the group's largest variables; those with fewer are repeated.

    Numbers are written so that they are read back to the last bit, and flags as the words that they stand for.
    """
    with h5py.File(path, "r") as file:
        dimensions_of = {
            key: store.dimensions(item) for key, item in store.variables(store.groups(file)[group]).items()
        }
    dims = max(dimensions_of.values(), key=len, default=())
    keys = [*dims, *(key for key in dimensions_of if key not in dims and set(dimensions_of[key]) <= set(dims))]
    with store.open_result(path) as tree:
        data = tree[group].to_dataset()[keys]
        if not dims:  # numbers alone: one row
            data, dims = data.expand_dims("row"), ("row",)
        rows = max(1, _ROWS // max(1, math.prod(data.sizes[dim] for dim in dims[1:])))
        for first in range(0, max(data.sizes[dims[0]], 1), rows):
            part = data.isel({dims[0]: slice(first, first + rows)}).map(_to_full_precision)
            frame = part.to_dataframe(dim_order=list(dims)).reset_index()[keys]
            frame.to_csv(out, header=first == 0, index=False, na_rep="nan", lineterminator="\n")


def _to_full_precision(variable: xr.DataArray) -> xr.DataArray:
    """Numbers of single precision as doubles, which have the digits that a reader of doubles needs; flags as words."""
    words = str(variable.attrs.get("flag_meanings", "")).split()
    if words and "valid_min" not in variable.attrs:
        return _flag_words(
            variable, dict(zip(np.atleast_1d(variable.attrs["flag_values"]).tolist(), words, strict=True))
        )
    return variable.astype(np.float64) if variable.dtype == np.float32 else variable


def _flag_words(variable: xr.DataArray, meanings: Mapping[int, str]) -> xr.DataArray:
    """Flags as words; a number that has none is kept."""
    numbers, place = np.unique(variable.to_numpy(), return_inverse=True)
    words = np.array([meanings.get(number, str(number)) for number in numbers.tolist()], dtype=object)
    return variable.copy(data=words[place].reshape(variable.shape))


# ---- is it right


def check_file(path: Path) -> None:
    """Compare a result with its checksums and say so.

    Raises:
        InputError: something does not fit.
    """
    try:
        store.verify(path)
    except ResultError as error:
        raise InputError(f"command line: FILE: {error}") from None
    print("all data, names and attributes fit their checksums")
