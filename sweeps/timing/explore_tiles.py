"""Time until a view of a chart of 1e8 lanes is seen, and what is read for it; writes results/explore_tiles.md.

    python -m sweeps.timing.explore_tiles [--count 10000] [--folder FOLDER] [--beside TEXT]

The chart is made up: exponents as they look, with digits that do not compress, and periods of some tongues. Every kind
of view is asked for in a process of its own, from the opening of the file to the raster that goes to the browser.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from jaxnh.explorer.recording import open_recording
from jaxnh.explorer.view import View
from jaxnh.storage.chunks import row_chunks
from jaxnh.storage.hdf5 import VERSION, attach, create, set_attributes, variable
from sweeps.checks.measured_at import ROOT, stamp
from sweeps.timing.effects import processor

_PAGE = ROOT / "results" / "explore_tiles.md"
_ROWS = 100  # of the file that are made at once
_WIDTHS = {"a third of both axes": 1 / 3, "a tenth": 0.1, "a hundredth": 0.01}

_TEXT = """\
# How soon a view of a large chart is seen

`python -m sweeps.timing.explore_tiles` makes a chart of {count:,} × {count:,} lanes, exponents with their errors,
periods and verdicts ({size:.2f} GB as a file), opens it as `jaxnh explore` does, and writes this page. {processor},
{cores} cores. {beside}

{measured_at}

Seconds from the opening of the file to the raster that goes to the browser, in a process of its own each, modules
imported; bytes that the process has read meanwhile, and the most memory that it had, that of its modules
({base:.0f} MB) among it. The result lies in blocks of whole rows, of which a narrow view reads more than it shows.

| view | seconds | first picture after | read, MB | most memory, MB |
|---|---|---|---|---|
{rows}

Overviews of the exponents take {overviews:.0f} MB beside the result.
"""


def make_chart(path: Path, count: int) -> None:
    """Write a made-up chart over b and d, by some rows at a time."""
    axis, rng = np.linspace(0.0, 1.0, count), np.random.default_rng(0)
    flags = {"flag_values": np.arange(4, dtype=np.int8), "flag_meanings": "periodic quasiperiodic chaotic undecided"}
    kinds: dict[str, dict[str, tuple[Any, tuple[str, ...], dict[str, Any]]]] = {
        "lyapunov": {
            "exponents": (np.float64, ("b", "d", "exponent"), {"long_name": "Lyapunov exponents", "units": "1"}),
            "exponents_error": (np.float64, ("b", "d", "exponent"), {"long_name": "errors", "units": "1"}),
        },
        "period": {
            "period": (np.int32, ("b", "d"), {"long_name": "least period", "units": "1"}),
            "residual": (np.float64, ("b", "d"), {"long_name": "residual", "units": "1"}),
            "multiplier": (np.float64, ("b", "d"), {"long_name": "multiplier", "units": "1"}),
            "status": (np.int8, ("b", "d"), {"long_name": "status", "units": "1"}),
        },
        "verdict": {
            "kind": (np.int8, ("b", "d"), {"long_name": "kind of motion", **flags}),
            "recurrence_lag": (np.int32, ("b", "d"), {"long_name": "lag", "units": "1"}),
            "phase_volume": (np.int8, ("b", "d"), {"long_name": "phase volume", "units": "1"}),
        },
    }
    with h5py.File(path, "w", track_order=True, libver=VERSION) as file:
        set_attributes(file, {"jaxnh_version": "0", "axes": "b d", "title": "A made-up chart"})
        set_attributes(file, {"solver": "none", "steps_per_period": 1, "error_estimate": 0.0})
        for name, variables in kinds.items():
            group = file.create_group(name, track_order=True)
            for key in ("b", "d"):
                set_attributes(group.create_dataset(key, data=axis), {"long_name": f"parameter {key}", "units": "1"})
            for key, (dtype, dims, attrs) in variables.items():
                shape = (count, count, 1)[: len(dims)]
                chunks = row_chunks(shape, np.dtype(dtype).itemsize)
                set_attributes(create(group, key, shape, dtype, chunks), attrs)
            attach(group, {"b": ("b",), "d": ("d",), **{key: dims for key, (_, dims, _) in variables.items()}})
        for begin in range(0, count, _ROWS):
            rows = slice(begin, min(begin + _ROWS, count))
            exponents, periods = _lanes(axis[rows], axis, rng)
            chaotic = exponents > 0.01
            variable(file, "lyapunov/exponents")[rows] = exponents[..., None]
            variable(file, "lyapunov/exponents_error")[rows] = np.full_like(exponents, 0.01)[..., None]
            variable(file, "period/period")[rows] = np.where(chaotic, 0, periods)
            variable(file, "verdict/kind")[rows] = np.where(chaotic, 2, np.where(exponents > -0.01, 3, 0))


def _lanes(b: np.ndarray, d: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Exponents and periods of some rows: folded waves, finer and finer towards one corner."""
    x, y = np.meshgrid(b, d, indexing="ij")
    waves = np.sin(40 * x * y) + np.sin(25 * (x - 0.3 * y) / (0.05 + x * y)) * 0.6
    return 0.4 * waves + 0.02 * rng.standard_normal(x.shape), 1 << (np.floor(6 * np.abs(waves)).astype(int) % 5)


def views(first: View) -> dict[str, View]:
    """Views of the exponents from the whole to a hundredth of both axes, and those of other quantities."""
    kinds = {"whole, overviews not made yet": first, "whole": first}
    for words, width in _WIDTHS.items():
        kinds[words] = first.zoom(0.55, 0.55 + width, (0.6, 0.6 + width))
    kinds["a strip: all of b, a hundredth of d"] = first.zoom(0.0, 1.0, (0.6, 0.61))
    return kinds


def _time_view(path: Path, name: str) -> dict[str, float]:
    """Look at one view in this process."""
    source = open_recording(path)  # modules are imported now
    base, before, began, firsts = _memory(), _bytes_read(), time.perf_counter(), list[float]()
    source = open_recording(path)
    for _ in source.passes(views(source.first)[name]):
        firsts.append(time.perf_counter() - began)
    read = (_bytes_read() - before) / 1e6
    return {"base": base, "first": firsts[0], "seconds": firsts[-1], "read": read, "memory": _memory()}


def _bytes_read() -> int:
    """Bytes that this process has asked the system for."""
    return int(Path("/proc/self/io").read_text(encoding="utf-8").split("rchar:")[1].split()[0])


def _memory() -> float:
    """The most memory that this process had, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def measured(path: Path, name: str) -> dict[str, float]:
    """Look at one view in a process of its own."""
    command = [sys.executable, "-m", __spec__.name, "--look", name, "--file", str(path)]
    answer = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return json.loads(answer.stdout)


def main() -> None:
    """Make the chart, measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--folder", type=Path, help="where the chart is made, and stays; by default one that goes")
    parser.add_argument("--beside", default="The machine did nothing else.")
    parser.add_argument("--look", help=argparse.SUPPRESS)
    parser.add_argument("--file", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.look:
        print(json.dumps(_time_view(given.file, given.look)))
        return
    with tempfile.TemporaryDirectory() as folder:
        path = (given.folder or Path(folder)) / "chart.h5"
        if not path.is_file():
            make_chart(path, given.count)
        first = open_recording(path).first
        told = {name: measured(path, name) for name in views(first)}
        made = path.with_name(f"{path.name}.overviews") / "lyapunov.h5"
        rows = [
            f"| {name} | {each['seconds']:.2f} | {each['first']:.2f} | {each['read']:.0f} | {each['memory']:.0f} |"
            for name, each in told.items()
        ]
        text = _TEXT.format(
            count=first.columns,
            size=path.stat().st_size / 1e9,
            processor=processor(),
            cores=len(os.sched_getaffinity(0)),
            beside=given.beside,
            measured_at=stamp(),
            base=min(each["base"] for each in told.values()),
            rows="\n".join(rows),
            overviews=made.stat().st_size / 1e6,
        )
    if given.count == parser.get_default("count"):
        _PAGE.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
