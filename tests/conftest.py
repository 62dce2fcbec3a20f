"""Strict numerics for all tests, and what they share: lanes, calibrations, commands and results of runs."""

from __future__ import annotations

import atexit
import fcntl
import gc
import importlib.abc
import importlib.util
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any
from unittest import mock

import dask.config
import pytest

# Compiled programs are shared by all workers, which inherit the variable, and by the commands that tests start. They go
# with the run, so that a bare machine and a warm one do the same work; name a folder by the variable to keep them.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    os.environ["JAX_COMPILATION_CACHE_DIR"] = tempfile.mkdtemp(prefix="jaxnh_programs_")
    atexit.register(shutil.rmtree, os.environ["JAX_COMPILATION_CACHE_DIR"], ignore_errors=True)
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.pop("JAX_NUM_CPU_DEVICES", None)  # tests of lanes need two

from jaxnh.engine import xla_options

xla_options.configure(2)

import jax  # noqa: E402
from jax.stages import Lowered  # noqa: E402

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")
gc.set_threshold(
    50_000, 20, 50
)  # traced programs live on: looking through them at each 700th new object is 6 % of all time

pytest.register_assert_rewrite("tests.helpers", "tests.flows")


class WithoutHeyoka(importlib.abc.MetaPathFinder):
    """Where there is no heyoka, as on macOS, modules that import it are skipped."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        if name == "heyoka":
            pytest.skip("heyoka is not installed: no wheel of it for this platform", allow_module_level=True)


if not importlib.util.find_spec("heyoka"):
    sys.meta_path.append(WithoutHeyoka())

from jaxnh.engine.executor.lanes import LaneExecutor  # noqa: E402
from tests.helpers import kept_programs  # noqa: E402
from tests.helpers.commands import Command, run_here, run_process  # noqa: E402
from tests.helpers.kept_calibrations import calibrating_by, once, unless_given  # noqa: E402
from tests.helpers.kept_programs import PaddedToFew, hardly_optimised, lanes_with_kept_programs  # noqa: E402

pytest_plugins = ["pytester", "tests.helpers.battery", "tests.helpers.parts"]


def pytest_configure(config: pytest.Config) -> None:
    """Few lanes are padded to 32 in quick tests."""
    if config.getoption("markexpr") == "not slow":
        kept_programs.executor_of_tests = PaddedToFew


@pytest.fixture(scope="module")
def calibrate_once() -> Iterator[None]:
    """For modules whose tests run equal experiments on equal lanes: these are calibrated once."""
    with calibrating_by(once):
        yield


_compile = Lowered.compile


def compile_quickly(request: pytest.FixtureRequest) -> Iterator[None]:
    """For quick tests that run for less time than XLA optimises their programs for: it does little of that.

    Slow tests have programs as users have them.
    """
    quickly = request.config.getoption("markexpr") == "not slow"
    jax.config.update("jax_disable_most_optimizations", quickly)
    with mock.patch.object(Lowered, "compile", without_emitters) if quickly else nullcontext():
        yield
    jax.config.update("jax_disable_most_optimizations", False)


def without_emitters(lowered: Lowered, options: Mapping[str, Any] | None = None, **others: Any) -> Any:
    """Compile without XLA's emitters of fused loops, which optimise them: in two thirds of the time."""
    return _compile(lowered, {**(options or {}), "xla_cpu_use_fusion_emitters": False}, **others)


def compile_all_quickly() -> Iterator[None]:
    """The same for modules whose slow tests are further cases of quick ones, and run for no longer."""
    with hardly_optimised(), mock.patch.object(Lowered, "compile", without_emitters):
        yield


quick_compiling = pytest.fixture(compile_quickly, scope="module", name="quick_compiling")
quick_compiling_always = pytest.fixture(compile_all_quickly, scope="module", name="quick_compiling_always")
quick_compiling_once = pytest.fixture(compile_quickly, name="quick_compiling_once")  # for one test of a module


@pytest.fixture
def quick_programs() -> Iterator[None]:
    """For one test, slow ones too, that compiles for much longer than it runs: programs are hardly optimised.

    Where what is asserted depends on no bit that optimisation moves: regular motion, words, what is drawn. Few lanes are
    padded to 32, as these programs take longer for more.
    """
    padded = mock.patch.object(kept_programs, "executor_of_tests", PaddedToFew)
    with hardly_optimised(), padded, mock.patch("jaxnh.engine.session.LaneExecutor", PaddedToFew):
        yield


@pytest.fixture(scope="module")
def uncalibrated() -> Iterator[None]:
    """For modules that look at no error of steps that their configs give: none is measured, by runs in this process."""
    with calibrating_by(unless_given):
        yield


@pytest.fixture(scope="module")
def quickly_uncalibrated(request: pytest.FixtureRequest) -> None:
    """The same for modules whose slow tests have processes, or look at errors: quick tests alone measure none."""
    if request.config.getoption("markexpr") == "not slow":
        request.getfixturevalue("uncalibrated")


@pytest.fixture(scope="module")
def shared_programs(request: pytest.FixtureRequest) -> Iterator[None]:
    """For modules whose sessions in quick tests find the programs of earlier ones in this process.

    Slow tests have sessions as users have them, but with `always_shared_programs`.
    """
    quick = request.config.getoption("markexpr") == "not slow"
    with mock.patch("jaxnh.engine.session.LaneExecutor", kept_programs.lanes_of_commands if quick else LaneExecutor):
        yield


@pytest.fixture(scope="module")
def always_shared_programs() -> Iterator[None]:
    """The same for modules whose slow sessions do so as well; tiles are as users have them."""
    with mock.patch("jaxnh.engine.session.LaneExecutor", kept_programs.lanes_of_commands):
        yield


@pytest.fixture(scope="module")
def always_few_lanes(always_shared_programs: None) -> Iterator[None]:
    """For modules whose slow sessions have some dozens of lanes at most: they are padded to 32, and not to 256.

    Last bits are those of the tile's width, so that nothing may hang on them.
    """
    with mock.patch.object(kept_programs, "executor_of_tests", PaddedToFew):
        yield


@pytest.fixture(autouse=True)
def no_scheduler_left() -> Iterator[None]:
    """Dask's settings of a run that was stopped are no other test's."""
    yield
    dask.config.config.pop("scheduler", None)


@pytest.fixture(scope="module")
def lanes() -> LaneExecutor:
    """A runner that shares its programs with those of all modules, traced and compiled once; few lanes are padded to 32."""
    return lanes_with_kept_programs(None, jax.devices()[:1], 32)


@pytest.fixture(scope="session")
def sweep() -> Command:
    """`python -m jaxnh.sweep ARGUMENTS`, run to its end in a folder, within this process."""
    return run_here


@pytest.fixture(scope="session")
def sweep_process() -> Command:
    """The same as a process of its own."""
    return run_process


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
