"""A config alone in a folder, the command run on it, and the bits of its result."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import h5py

from jaxnh.storage import hdf5 as store
from tests.helpers.commands import run_here
from tests.helpers.paths import ROOT

# Chaotic, so that a bit that differs grows as large as the attractor; 12 tiles of 256 lanes; about a second's work.
CONFIG = """\
system: {constraint: constant_speed}
sweep: {b: {start: 5.2, stop: 5.45, count: 3000}}
accuracy: {solver: blanes_moan6, steps: 40}
analyses:
  diagram: {transient: 30, strobes: 3, start: random, n_starts: 2, seed: 7}
  chaos01: {transient: 0, periods: 100}
"""
TILES = 12
GO_ON = "run the same command again to go on where it stopped"


class Job:
    """A config alone in a folder, and the command run on it."""

    def __init__(self, folder, config=CONFIG, tile=256):
        self.folder = folder
        self.tile = ["--tile", tile] if tile else []
        (folder / "job.yaml").write_text(config)
        self.output, self.tiles = folder / "job.h5", folder / "job.h5.tiles"

    def start(self, *arguments, head="", environment=()):
        """A process of the command; `head` is Python that runs before it."""
        code = f"import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n{head}\n"
        code += "if __name__ == '__main__':\n    import runpy; runpy.run_module('jaxnh.sweep', run_name='__main__', alter_sys=True)\n"
        script = self.folder / "command.py"  # spawned workers look at the main module
        script.write_text(code)
        command = [sys.executable, script, "job.yaml", "--output", "job.h5", *self.tile, *arguments]
        return subprocess.Popen(
            list(map(str, command)),
            cwd=self.folder,
            env={**os.environ, "PYTHONPATH": str(ROOT), **dict(environment)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, *arguments, **options):
        """A process of it to its end: exit code, lines of output, lines of errors."""
        process = self.start(*arguments, **options)
        out, err = process.communicate(timeout=300)
        assert "Traceback" not in err, err
        return process.returncode, out.splitlines(), err.splitlines()

    def run_here(self, *arguments):
        """The same within this process, where another one would show no more."""
        done = run_here("job.yaml", "--output", "job.h5", *self.tile, *arguments, cwd=self.folder)
        assert "Traceback" not in done.stderr, done.stderr
        return done.returncode, done.stdout.splitlines(), done.stderr.splitlines()

    def done(self):
        """Tiles that are there."""
        return sorted(self.tiles.glob("0*.h5")) if self.tiles.is_dir() else []

    def until(self, process, count):
        """Wait until so many tiles are there."""
        while process.poll() is None and len(self.done()) < count:
            time.sleep(0.005)
        assert process.poll() is None, process.communicate()

    def left(self):
        """Return what is beside the config and the script."""
        return {path.name for path in self.folder.iterdir()} - {"job.yaml", "command.py"}


SLOW_TILES = """\
import itertools, pathlib, time

replace, tiles = pathlib.Path.replace, itertools.count()

def later(self, target):
    if pathlib.Path(target).name.startswith("0") and next(tiles):  # the first is there at once
        time.sleep(SECONDS)
    return replace(self, target)

pathlib.Path.replace = later
"""


def slow_tiles(job, seconds=60.0):
    """The environment of a process in which all tiles but the first take so long, so that it can be stopped among them."""
    folder = job.folder.parent / f"{job.folder.name}-slowly"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(SLOW_TILES.replace("SECONDS", str(seconds)))
    return {"PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)])}


def content(path):
    """All groups and variables of a result: bytes, shapes, dimensions and attributes."""
    found = {}
    with h5py.File(path) as file:
        for group in file.values():
            found[group.name] = {key: str(value) for key, value in group.attrs.items()}
            for item in group.values():
                attrs = {key: str(value) for key, value in store.attributes(item).items()}
                found[item.name] = (item[()].tobytes(), item.shape, str(item.dtype), store.dimensions(item), attrs)
    return found
