"""Strict numerics for all tests, and the command as users run it, run once for all workers."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# Compiled programs are kept from run to run, and shared with the commands that tests start.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".jax_cache"))
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.pop("JAX_NUM_CPU_DEVICES", None)  # tests of lanes need two

from jaxnh.engine import xla_options  # noqa: E402

xla_options.configure(2)

import jax  # noqa: E402

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

pytest_plugins = ["battery"]

Command = Callable[..., subprocess.CompletedProcess]


@pytest.fixture(scope="session")
def sweep() -> Command:
    """`python -m jaxnh.sweep ARGUMENTS`, run to its end in a folder."""

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
