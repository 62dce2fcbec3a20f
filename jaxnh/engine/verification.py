"""A sample of the lanes of a result file run again, to compare them bit for bit. No file is written."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import xarray as xr

from jaxnh.engine.accuracy.calibration import Plan
from jaxnh.engine.compute import compute
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.levels.levels import COMPUTED, axes_of
from jaxnh.engine.plan import job_of
from jaxnh.engine.xla_options import configure, devices_of
from jaxnh.exceptions import ResultError, RunError
from jaxnh.jobs.cutting import Cutting, Piece, slab, tile_shape
from jaxnh.solvers import NAMED
from jaxnh.solvers.adaptive import in_loop
from jaxnh.storage import hdf5

_LANES = 16


def sample(path: Path) -> dict[str, tuple[int, int]]:
    """Count for every analysis in a file the lanes that were run again, and those of them that differ in any bit.

    Three blocks of neighbouring lanes are taken, from both ends and the middle of all axes; none where an analysis is
    run along the whole first axis. Lanes that a level was filled with are left out, and so are groups of a whole sweep.
    The text of a user's system that is in the file is run: ask before whether it is to be trusted (`jaxnh.inspect
    --trust`).

    Raises:
        ResultError: the file says too little of how it was made.
        ConfigError: its config is no longer valid.
    """
    attrs = hdf5.read_attrs(path)
    if "auto_settings" not in attrs:
        raise ResultError("it does not say all that decided its numbers")
    configure()
    # Of a user's system the text in the result alone, never a file that a config in it may name.
    experiment = Experiment.from_text(attrs["config"], attrs.get("system_file", ""))
    requested = experiment.requested()
    solver = NAMED[attrs["solver"]]
    plan = Plan(
        in_loop(solver) if attrs.get("stages") == "loop" else solver,
        int(attrs["steps_per_period"]),
        attrs["summation"] == "compensated",
        float(attrs["error_estimate"]),
        json.loads(attrs.get("sizes_of_motion", "{}")),
        int(attrs.get("error_estimate_parts", 1)),
        attrs.get("step_classes", ""),
    )
    whole = job_of(experiment, experiment.axes, plan, json.loads(attrs["auto_settings"]), requested, {}, _LANES)
    job = whole.stages()[int(attrs.get("level", 1)) - 1]
    cutting = job.cutting
    axes = axes_of(experiment.axes, cutting)
    compared: dict[str, tuple[int, int]] = {a.name: (0, 0) for a, _ in requested if not a.whole}
    lanes = LaneExecutor(devices=devices_of(experiment))
    for piece in _sample_blocks(cutting) if cutting.independent else ():
        [done] = compute(experiment, axes, requested, job, [piece], lanes, _nothing_gathered)
        for name in filter(compared.__contains__, done.groups):
            data = done.groups[name]
            computed = _computed_lanes(path, name, piece, cutting)
            differs = np.zeros(piece.lanes, bool)
            for ours, theirs in _pairs(path, name, data, piece, cutting):
                differs |= np.any(ours != theirs, axis=1)
            compared[name] = compared[name][0] + int(computed.sum()), compared[name][1] + int(differs[computed].sum())
    return compared


def _nothing_gathered(name: str) -> xr.Dataset:
    raise RunError(f"no tiles of {name} are kept")


def _sample_blocks(cutting: Cutting) -> list[Piece]:
    """Blocks at the beginning, in the middle and at the end of all axes."""
    own = [k for k, (_, _, shared) in enumerate(cutting.axes) if not shared]
    size = np.ones(len(cutting.axes), int)
    size[own] = tile_shape([cutting.shape[k] for k in own], cutting.tile)
    room = np.array(cutting.shape) - size
    begins = dict.fromkeys(tuple((room * k // 2).tolist()) for k in range(3))
    return [Piece(0, cutting.independent, begin, tuple((np.array(begin) + size).tolist())) for begin in begins]


def _computed_lanes(path: Path, name: str, piece: Piece, cutting: Cutting) -> np.ndarray:
    """Return which lanes of a piece were computed, and not filled from a coarser level."""
    if not cutting.level:
        return np.ones(piece.lanes, bool)
    with h5py.File(path, "r") as file:
        item = hdf5.variables(hdf5.groups(file)[name])[COMPUTED]
        return hdf5.read(item, slab(cutting.names, piece, cutting.names)).ravel().astype(bool)


def _pairs(
    path: Path, name: str, data: xr.Dataset, piece: Piece, cutting: Cutting
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The bytes of each lane, (lanes, bytes), as computed now and as stored in the file."""
    with h5py.File(path, "r") as file:
        group = hdf5.groups(file)[name]
        for key, item in data.variables.items():
            dims = tuple(map(str, item.dims))
            if dims[: len(cutting.axes)] != cutting.names:
                continue
            ours, theirs = item.values, hdf5.read(hdf5.variables(group)[str(key)], slab(dims, piece, cutting.names))
            if theirs.dtype != ours.dtype or theirs.shape != ours.shape:
                yield np.zeros((piece.lanes, 1)), np.ones((piece.lanes, 1))
            else:
                yield _bytes(ours, piece.lanes), _bytes(theirs, piece.lanes)


def _bytes(values: np.ndarray, lanes: int) -> np.ndarray:
    return np.frombuffer(values.tobytes(), np.uint8).reshape(lanes, -1)
