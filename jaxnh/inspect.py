"""The command `python -m jaxnh.inspect FILE [--verify] [--csv GROUP]`: what a result file is, from the file alone."""

from __future__ import annotations

import csv
import itertools
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import h5py
import numpy as np
import typer
from rich import box
from rich.console import Console
from rich.table import Table

from jaxnh.cli.exit_codes import Refused, run_app
from jaxnh.config.yaml_source import ConfigError
from jaxnh.storage import hdf5 as store

_WIDTH = 110  # columns where the output goes to a file
_NAMED = 4  # lanes that are named where some have failed
_STATES = ("x1", "x2", "y1", "y2", "exponents", "k")  # variables that every sound lane has in numbers

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command(help="Show what a result file is, how it was made, and what is in it.")
def inspect(
    file: Annotated[Path, typer.Argument(help="Result file of jaxnh", show_default=False)],
    verify: Annotated[
        bool, typer.Option("--verify", help="Check all checksums, run some lanes again and compare them bit for bit")
    ] = False,
    table: Annotated[
        str | None, typer.Option("--csv", metavar="GROUP", help="Write a group as a table to standard output")
    ] = None,
) -> None:
    """Body of the command; the words above are what --help shows."""
    if not file.is_file():
        raise Refused(f"command line: FILE: {file} is {'a folder' if file.is_dir() else 'not there'}")
    try:
        store.read_attrs(file)
        with h5py.File(file, "r") as content:
            if table is not None:
                _write_csv(content, table)
                return
            _show(file, content)
    except store.StoreError as error:
        raise Refused(f"command line: FILE: {error}") from None
    except BrokenPipeError:
        raise
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise Refused(f"command line: FILE: {file} is cut off or damaged: {_line(error)}") from None
    if verify:
        _verify(file)


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200]


# ---- what it is


def _show(path: Path, file: Any) -> None:
    console = Console()
    if not console.is_terminal:
        console = Console(width=_WIDTH)
    attrs = store.attributes(file)
    grid = Table.grid(padding=(0, 2))
    for head, words in _facts(path, attrs, _sweep(file)):
        grid.add_row(head, words)
    console.print(grid, highlight=False, markup=False)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for head in ("variable", "dimensions", "units", "range", ""):
        table.add_column(head, justify="right" if head == "range" else "left")
    notes: list[str] = []
    for name, group in file.items():
        table.add_row(f"[bold]{name}")
        for key, item in group.items():
            if not (item.is_scale and (key == "b" or str(item.attrs.get("long_name", "")).startswith("index along"))):
                found = _range(item)
                table.add_row(f"  {key}", _sizes(item), str(item.attrs.get("units", "")), found.words, found.note)
        notes += [f"{name}: {note}" for note in _notes(group)]
    console.print(table)
    for note in notes:
        console.print(note, highlight=False, markup=False)


def _sweep(file: Any) -> Any | None:
    """The swept values, from any group that has them."""
    found = [group["b"] for group in file.values() if "b" in group and store.dimensions(group["b"]) == ("b",)]
    return found[0] if found else None


def _name(sweep: Any) -> str:
    """Name of the parameter that is swept: the last of the words for it."""
    return str(sweep.attrs.get("long_name", "b")).rsplit(" ", 1)[-1]


def _facts(path: Path, attrs: dict[str, Any], sweep: Any | None) -> Iterator[tuple[str, str]]:
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
    if sweep is not None and len(sweep):
        yield "sweep", f"{len(sweep):,} values of {_name(sweep)}, from {sweep[0]:.8g} to {sweep[-1]:.8g}"
    if "solver" in attrs:
        yield (
            "accuracy",
            f"{attrs['solver']}, {attrs['steps_per_period']} steps a period, {attrs.get('summation', 'plain')} sums, "
            f"error of one {'return' if 'section' in attrs else 'period'} {attrs['error_estimate']:.1e}",
        )
    wall, work = float(attrs.get("wall_seconds", math.nan)), float(attrs.get("lane_periods", math.nan))
    compiled = float(attrs.get("compile_seconds", math.nan))
    yield (
        "cost",
        f"{wall:,.1f} s, of these compiling {compiled:,.1f} s; {work:,.0f} lane-periods, {work / wall:,.0f} a second; "
        f"{attrs.get('device', '')}",
    )


def _notes(group: Any) -> Iterator[str]:
    """Attributes of a group, lanes that have failed, and warnings."""
    attrs = store.attributes(group)
    warnings = attrs.pop("warnings", "")
    if attrs:
        words = {key: f"{value:.6g}" if isinstance(value, float) else value for key, value in attrs.items()}
        yield ", ".join(f"{key} {value}" for key, value in words.items())
    yield from _failed(group)
    yield from filter(None, warnings.split("\n"))


def _sizes(item: Any) -> str:
    return " × ".join(f"{dim} {size:,}" for dim, size in zip(store.dimensions(item), item.shape, strict=True))


class _Range(NamedTuple):
    """Least and largest number of a variable in words, and what there is to note."""

    words: str
    note: str


def _range(item: Any) -> _Range:
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
    if meanings:
        return _Range("", ", ".join(f"{n:,} {word}" for n, word in zip(counts, meanings, strict=True) if n))
    words = f"{low:.5g} … {high:.5g}" if low <= high else "–"
    return _Range(words, f"{lost:,} not finite" if lost else "")


def _failed(group: Any) -> Iterator[str]:
    """Lanes that have failed, and why: a flag that says so, or a state that is no number."""
    if "b" not in group or store.dimensions(group["b"]) != ("b",):
        return
    flags = []
    if "failure" in group:
        codes, about = store.read(group["failure"]), group["failure"].attrs
        codes = codes.reshape(len(codes), -1).max(axis=1)
        flags = [(why, codes == k) for k, why in enumerate(str(about["flag_meanings"]).split()) if k]
    elif "failed" in group:
        flags.append(("left the numbers", store.read(group["failed"]) != 0))
    else:
        for name in _STATES:
            if name in group and store.dimensions(group[name])[:1] == ("b",):
                found = [~np.isfinite(block).reshape(len(block), -1).all(axis=1) for block in store.blocks(group[name])]
                flags.append((f"left the numbers ({name})", np.concatenate(found)))
                break
    for why, lanes in flags:
        if lanes.any():
            values = group["b"][np.flatnonzero(lanes)[:_NAMED]]
            named = ", ".join(f"{b:.6g}" for b in values) + (", …" if lanes.sum() > _NAMED else "")
            yield f"{lanes.sum():,} of {len(lanes):,} lanes failed: {why}, at {_name(group['b'])} = {named}"


# ---- as a table


def _write_csv(file: h5py.File, name: str) -> None:
    """A row for every place along the dimensions of the group's largest variables; those with fewer are repeated."""
    if name not in file:
        raise Refused(f"command line: --csv: {file.filename} has the groups {', '.join(file)}, and no {name}")
    group: Any = file[name]
    dims = max((store.dimensions(item) for item in group.values()), key=len)
    fitting = {key: item for key, item in group.items() if set(store.dimensions(item)) <= set(dims)}
    sizes = {dim: group[dim].shape[0] for dim in dims}
    out = csv.writer(sys.stdout, lineterminator="\n")
    keys = [*dims, *(key for key in fitting if key not in dims)]
    out.writerow(keys)
    fixed = {key: store.read(item) for key, item in fitting.items() if store.dimensions(item)[:1] != dims[:1]}
    for row in range(sizes[dims[0]]):
        at = {key: store.read(item, slice(row, row + 1)) for key, item in fitting.items() if key not in fixed}
        for rest in itertools.product(*(range(sizes[dim]) for dim in dims[1:])):
            place = dict(zip(dims, (0, *rest), strict=True))
            cells = [(at.get(key, fixed.get(key)), store.dimensions(fitting[key])) for key in keys]
            out.writerow([data[tuple(place[dim] for dim in axes)].item() for data, axes in cells if data is not None])


# ---- is it right


def _verify(path: Path) -> None:
    """Checksums first, then a sample of lanes; the outcome in a line each.

    Raises:
        Refused: something does not fit.
    """
    try:
        store.verify(path)
    except store.StoreError as error:
        raise Refused(f"command line: FILE: {error}") from None
    print("all data, names and attributes fit their checksums")
    attrs = store.read_attrs(path)
    if "system_file" in attrs:
        print(_state_of(Path(attrs["system_file_path"]), attrs["system_file"]))
    from jaxnh.engine import verification as again  # the only thing here that needs JAX

    try:
        found = again.sample(path)
    except (store.StoreError, ConfigError) as error:
        raise Refused(f"command line: FILE: {path} cannot be run again: {_line(error)}") from None
    for name, (lanes, differing) in found.items():
        if differing:
            raise Refused(
                f"command line: FILE: {path}: {name}: run again, {differing} of {lanes} lanes differ; "
                f"the file was made on {store.read_attrs(path)['device']}"
            )
        print(
            f"{name}: {lanes} lanes run again are equal bit for bit"
            if lanes
            else f"{name}: runs as a whole, not lane by lane"
        )


def _state_of(path: Path, text: str) -> str:
    """A user's file beside what a result says it was."""
    try:
        if path.read_text(encoding="utf-8") == text:
            return f"{path} is as it was"
        now = "has changed since"
    except (OSError, UnicodeDecodeError):
        now = "is not there"
    return f"{path} {now}; lanes are run again by its text in the result"


def main() -> int:
    """Run the command; returns its exit code."""
    return run_app(app)


if __name__ == "__main__":
    sys.exit(main())
