"""Commands of the package, run within this process or as users start them."""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from unittest import mock

from tests.helpers import kept_programs
from tests.helpers.paths import ROOT

Command = Callable[..., subprocess.CompletedProcess]


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
        mock.patch("jaxnh.engine.run.LaneExecutor", kept_programs.lanes_of_commands),
        mock.patch("jaxnh.engine.verification.LaneExecutor", kept_programs.lanes_of_commands),
    ):
        code = main()
    return subprocess.CompletedProcess(argv, code, out.getvalue(), err.getvalue())


def run_process(*arguments: object, cwd: Path = ROOT) -> subprocess.CompletedProcess:
    """`python -m jaxnh.sweep ARGUMENTS` in a folder, as a process of its own."""
    command = [sys.executable, "-m", "jaxnh.sweep", *map(str, arguments)]
    return _run(command, cwd, timeout=900)


def run_by_two_workers(text: str, folder: Path, tile: int) -> Path:
    """A run of a config, in a process of its own, by a local Dask cluster of two workers; its result."""
    code = "import jaxnh\nif __name__ == '__main__':\n"
    code += f"    jaxnh.run(jaxnh.load('job.yaml'), 'job.h5', dask='local:2', tile={tile})\n"
    (folder / "job.yaml").write_text(text)
    (folder / "script.py").write_text(code)
    done = _run([sys.executable, "script.py"], folder, timeout=600)
    assert done.returncode == 0, done.stderr
    assert (done.stdout, done.stderr) == ("", "")
    return folder / "job.h5"


def _run(command: list[str], folder: Path, timeout: float) -> subprocess.CompletedProcess:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}  # this checkout, from whatever folder
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=timeout, check=False
    )
