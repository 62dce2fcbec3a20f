"""Strict numerics for all tests, and the command `jaxnh.sweep`, within this process and as users start it."""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import importlib
import io
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from unittest import mock

import dask.config
import numpy as np
import pytest
import xarray as xr

ROOT = Path(__file__).parents[1]

# Compiled programs are shared by all workers, which inherit the variable, and by the commands that tests start. They go
# with the run, so that a bare machine and a warm one do the same work; name a folder by the variable to keep them.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    os.environ["JAX_COMPILATION_CACHE_DIR"] = tempfile.mkdtemp(prefix="jaxnh_programs_")
    atexit.register(shutil.rmtree, os.environ["JAX_COMPILATION_CACHE_DIR"], ignore_errors=True)
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.pop("JAX_NUM_CPU_DEVICES", None)  # tests of lanes need two

from jaxnh.engine import xla_options  # noqa: E402

xla_options.configure(2)

import jax  # noqa: E402

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

from jaxnh.analyses.batch import Axis  # noqa: E402
from jaxnh.engine import plan, session  # noqa: E402
from jaxnh.engine.accuracy.calibration import Calibration  # noqa: E402
from jaxnh.engine.executor.lanes import TILE, LaneExecutor  # noqa: E402
from jaxnh.engine.executor.programs import Programs  # noqa: E402
from jaxnh.engine.experiment import Experiment  # noqa: E402
from jaxnh.engine.progress import Progress  # noqa: E402
from jaxnh.engine.session import Session  # noqa: E402

pytest_plugins = ["battery", "parts"]

Command = Callable[..., subprocess.CompletedProcess]


_PROGRAMS = Programs()


def lanes_with_kept_programs(
    progress: Progress | None = None, devices: list[Any] | None = None, tile: int = TILE
) -> LaneExecutor:
    """Lanes on all devices that find the programs of earlier runs in this process; their keys say all there is."""
    return LaneExecutor(progress, devices, tile, _PROGRAMS)


_CALIBRATIONS: dict[Any, Calibration] = {}
_calibrate = plan.calibrate
_uncalibrated = False


def calibrate_once(
    experiment: Experiment,
    axes: Sequence[Axis],
    lanes: LaneExecutor,
    target: float | None = None,
    requested: plan.Requested | None = None,
) -> Calibration:
    """`calibrate`, once in this process for equal experiments and lanes, whose errors are equal to the bit."""
    if _uncalibrated and experiment.accuracy.solver:
        return cast(Calibration, SimpleNamespace(error=lambda *_: 1e-6))
    grids = tuple((axis.name, axis.kind, axis.values.tobytes()) for axis in axes)
    drawn = frozenset(plan.start_samplers(requested or ()))
    key = (experiment.sha256, experiment.sectioned, grids, target, drawn, len(lanes.devices), lanes.tile)
    if key not in _CALIBRATIONS:
        _CALIBRATIONS[key] = _calibrate(experiment, axes, lanes, target, requested)
    return _CALIBRATIONS[key]


plan.calibrate = session.calibrate = calibrate_once


def run_by_two_workers(text: str, folder: Path, tile: int) -> Path:
    """A run of a config, in a process of its own, by a local Dask cluster of two workers; its result."""
    code = "import jaxnh\nif __name__ == '__main__':\n"
    code += f"    jaxnh.run(jaxnh.load('job.yaml'), 'job.h5', dask='local:2', tile={tile})\n"
    (folder / "job.yaml").write_text(text)
    (folder / "script.py").write_text(code)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "script.py"]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr
    assert (done.stdout, done.stderr) == ("", "")
    return folder / "job.h5"


def run_here(*arguments: object, cwd: Path = ROOT, command: str = "sweep") -> subprocess.CompletedProcess:
    """`python -m jaxnh.COMMAND ARGUMENTS` in a folder, without a process of its own: JAX has started already."""
    assert threading.current_thread() is threading.main_thread()  # as signals need it
    out, err = io.StringIO(), io.StringIO()
    argv = [f"jaxnh.{command}", *map(str, arguments)]
    main = importlib.import_module(f"jaxnh.{command}").main
    with (
        contextlib.chdir(cwd),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        mock.patch.object(sys, "argv", argv),
        mock.patch("jaxnh.engine.run.LaneExecutor", lanes_with_kept_programs),
        mock.patch("jaxnh.engine.verification.LaneExecutor", lanes_with_kept_programs),
    ):
        code = main()
    return subprocess.CompletedProcess(argv, code, out.getvalue(), err.getvalue())


def session_of(experiment: Experiment) -> Session:
    """A session that finds the programs of earlier ones in this process."""
    found = Session(experiment)
    found._lanes = lanes_with_kept_programs(found._progress)
    return found


def peak_memory(process: subprocess.Popen) -> int:
    """Largest resident memory of a process in bytes, once it has ended.

    It is looked at while the process runs: `ru_maxrss` of a child is not less than that of its parent was.
    """
    peak, status = 0, Path(f"/proc/{process.pid}/status")
    while process.poll() is None:
        lines = status.read_text().splitlines()
        peak = max(peak, *(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM:")), 0)
        time.sleep(0.05)
    return peak


_OF_A_RUN = ("history", "wall_seconds", "compile_seconds", "lane_periods", "device")


def same_tree(tree: xr.DataTree, expected: xr.DataTree) -> None:
    """Equal groups, variables, dimensions, bits and attributes, but for what a file has besides or a run has spent.

    Nor is the error of steps compared where a module says UNCALIBRATED: a process of its own has measured it.
    """
    assert list(tree.children) == list(expected.children)
    for name, group in expected.children.items():
        ours, other = tree[name].to_dataset().load(), group.to_dataset()
        assert list(ours.variables) == list(other.variables), name
        assert set(ours.coords) == set(other.coords), name
        assert set(ours.attrs) | {"axes"} == set(other.attrs) | {"axes"}, name
        same_attrs(ours.attrs, {key: value for key, value in other.attrs.items() if key != "axes"})
        for key, item in other.variables.items():
            assert (ours[key].dims, ours[key].dtype) == (item.dims, item.dtype), (name, key)
            assert ours[key].values.tobytes() == item.values.tobytes(), (name, key)
            assert set(ours[key].attrs) - {"sha256"} == set(item.attrs), (name, key)
            same_attrs(ours[key].attrs, item.attrs)
    assert {*tree.attrs, "content_sha256"} == {*expected.attrs, "content_sha256"}
    others = (*_OF_A_RUN, "error_estimate") if _uncalibrated else _OF_A_RUN
    same_attrs(tree.attrs, {key: value for key, value in expected.attrs.items() if key not in others})


def same_attrs(found: Mapping[Any, Any], expected: Mapping[Any, Any]) -> None:
    for key, value in expected.items():
        np.testing.assert_array_equal(found[key], value, err_msg=str(key))


@pytest.fixture(scope="module", autouse=True)
def errors_of_steps(request: pytest.FixtureRequest) -> Iterator[None]:
    """A module that says UNCALIBRATED looks at no error of steps that its configs give: none is measured in it."""
    with mock.patch(f"{__name__}._uncalibrated", getattr(request.module, "UNCALIBRATED", False)):
        yield


@pytest.fixture(autouse=True)
def no_scheduler_left() -> Iterator[None]:
    """Dask's settings of a run that was stopped are no other test's."""
    yield
    dask.config.config.pop("scheduler", None)


@pytest.fixture(scope="session")
def lanes() -> LaneExecutor:
    """One runner for all tests, so that equal programs are traced and compiled once; few lanes are padded to 64."""
    return lanes_with_kept_programs(None, None, 32)


@pytest.fixture(scope="session")
def sweep() -> Command:
    """`python -m jaxnh.sweep ARGUMENTS`, run to its end in a folder, within this process."""
    return run_here


@pytest.fixture(scope="session")
def sweep_process() -> Command:
    """The same as a process of its own."""

    def run(*arguments: object, cwd: Path = ROOT) -> subprocess.CompletedProcess:
        command = [sys.executable, "-m", "jaxnh.sweep", *map(str, arguments)]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}  # this checkout, from whatever folder
        return subprocess.run(
            command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=900, check=False
        )

    return run


@pytest.fixture(scope="session")
def result(tmp_path_factory, worker_id, sweep) -> Callable[..., tuple[Path, str, str]]:
    """Result file, standard output and standard error of a run that succeeds, made once whoever asks first."""
    base = tmp_path_factory.getbasetemp()
    shared = base if worker_id == "master" else base.parent

    def make(name: str, config: Path, *overrides: str) -> tuple[Path, str, str]:
        folder = shared / name
        folder.mkdir(exist_ok=True)
        path, out, err = folder / "result.h5", folder / "out", folder / "err"
        with (folder / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
                done = sweep(config, *overrides, "--output", path)
                assert done.returncode == 0, done.stderr
                out.write_text(done.stdout)
                err.write_text(done.stderr)
        return path, out.read_text(), err.read_text()

    return make
