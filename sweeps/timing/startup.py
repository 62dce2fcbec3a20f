"""Time from command to result, in its parts, with an empty cache and with programs kept; writes results/startup.md.

    make startup, or python -m sweeps.timing.startup [--repeats 5] [--against FOLDER] [--only SCENE]

FOLDER is another checkout: its runs take turns with ours, by its own .venv where it has one. Every run is a process of
its own (`startup_worker`). Runs of some scenes alone are printed, not written. Alone on a quiet machine, please.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from sweeps.checks.measured_at import ROOT, stamp
from sweeps.timing.effects import processor

SMALL = """\
title: A small sweep, 64 lanes and 100 periods
system: {constraint: constant_speed}
sweep: {b: {start: 5.2, stop: 5.5, count: 64}}
accuracy: {target: 1.0e-6}
analyses:
  diagram: {transient: 84, strobes: 16}
"""
LORENZ96 = """\
title: Lorenz's equations of 1996 in ten dimensions
system: {file: lorenz96.py}
initial: {x0: 1.0, x1: 0.5}
sweep: {force: {start: 4.0, stop: 10.0, count: 12}}
accuracy: {target: 1.0e-6}
analyses:
  lyapunov: {transient: 32, periods: 256, exponents: 10}
"""
LORENZ96_FILE = """\
import jax.numpy as jnp


def system(force=8.0):
    def rhs(y, t):
        x = jnp.stack(y)
        return (jnp.roll(x, -1) - jnp.roll(x, 2)) * jnp.roll(x, 1) - x + force

    return {"rhs": rhs, "coordinates": tuple(f"x{k}" for k in range(10))}
"""


class TimedConfig(NamedTuple):
    """A config that is timed.

    Attributes:
        config: its file in a checkout, or its text.
        overrides: of keys of the config.
        file: name and text of the user's file beside a config that is a text.
        asked: seconds that were asked for, of each of `CACHES`.
    """

    config: str
    overrides: tuple[str, ...] = ()
    file: tuple[str, str] | None = None
    asked: tuple[float | None, float | None] = (None, None)


_PAGE_ON_RIGHT_HAND_SIDES = ("sweep.rho.count=64", "analyses.diagram.transient=16", "analyses.lyapunov.transient=16")
SCENES = {
    "table1": TimedConfig("configs/table1.yaml", asked=(10.0, 4.0)),
    "table2": TimedConfig("configs/table2.yaml"),
    "fig04": TimedConfig("configs/fig04.yaml"),
    "governor": TimedConfig("configs/governor.yaml"),
    "small": TimedConfig(SMALL),
    "lorenz": TimedConfig(
        "configs/flows/lorenz.yaml", (*_PAGE_ON_RIGHT_HAND_SIDES, "analyses.lyapunov.periods=64"), asked=(7.0, 2.5)
    ),
    "oscillating_mass": TimedConfig(
        "configs/nonholonomic/oscillating_mass.yaml", ("sweep.amplitude.count=24",), asked=(15.0, None)
    ),
    "lorenz96": TimedConfig(LORENZ96, file=("lorenz96.py", LORENZ96_FILE), asked=(12.0, None)),
    "double_pendulum": TimedConfig("configs/flows/double_pendulum.yaml", ("sweep.ratio.count=12",), asked=(15.0, None)),
    "rolling_disk": TimedConfig("configs/flows/rolling_disk.yaml", asked=(30.0, None)),
    "roller_racer": TimedConfig("configs/nonholonomic/roller_racer.yaml", asked=(30.0, None)),
}
"""Scenes by name; `lorenz` is that of the how-to page on right-hand sides."""

PARTS = ("import", "calibration", "tracing", "compiling", "run", "writing", "rest")
CACHES = ("empty", "kept")

_HEAD = """\
# Time from command to result

`python -m sweeps.timing.startup` runs `jaxnh.sweep` on the scenes below, each run in a process of its own, and writes
this page. {machine}

{measured_at}

Seconds, medians of {repeats} runs{turns}. *Empty*: nothing is kept from an earlier run; *kept*: all programs are, and
what was decided for the sweep. Calibration has its own programs in it, tracing and the others are outside it; where a
program is found, tracing is what it takes to name and load it. Writing is the result file alone: tiles are written
while the next are computed. The rest is the start and end of Python, the config, tiles, and tables on the terminal.
`small` has 64 lanes and 100 periods, `lorenz` is the config of the how-to page on right-hand sides; `oscillating_mass`
has 24 values and `double_pendulum` 12; `lorenz96` has ten coordinates, 12 values and all exponents.
"""


class RunSeconds(NamedTuple):
    """Seconds of one run.

    Attributes:
        whole: from the start of the process to its end.
        parts: by name, `rest` left out.
    """

    whole: float
    parts: Mapping[str, float]

    def of(self, part: str) -> float:
        """Seconds of a part."""
        return self.whole - sum(self.parts.values()) if part == "rest" else self.parts[part]


class Checkout(NamedTuple):
    """A folder with the package in it, and what it is called in the page."""

    folder: Path
    name: str

    @property
    def python(self) -> str:
        own = self.folder / ".venv" / "bin" / "python"
        return str(own if own.exists() else sys.executable)


Timings = Mapping[tuple[str, str, str], Sequence[RunSeconds]]
"""Samples by scene, cache and name of the checkout."""


def run_once(checkout: Checkout, scene: str, cache: Path, folder: Path) -> RunSeconds:
    """One run of a scene into a folder, with its programs in a cache.

    Raises:
        RuntimeError: it failed, or was of another package.
    """
    asked, record = SCENES[scene], folder / "seconds.json"
    path = checkout.folder / asked.config
    if "\n" in asked.config:
        path = folder / f"{scene}.yaml"
        for name, text in ((path.name, asked.config), *([asked.file] if asked.file else [])):
            (folder / name).write_text(text, encoding="utf-8")
    worker = Path(__file__).with_name("startup_worker.py")
    command = [checkout.python, "-P", str(worker), str(record), str(path), *asked.overrides]
    command += ["--output", str(folder / "result.h5"), "--fresh", "--quiet"]
    environment = {**os.environ, "PYTHONPATH": str(checkout.folder), "JAX_COMPILATION_CACHE_DIR": str(cache)}
    began = time.perf_counter()
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    whole = time.perf_counter() - began
    if done.returncode or not record.exists():
        raise RuntimeError(f"{scene} in {checkout.folder} failed: {done.stderr.strip()[-500:]}")
    found = json.loads(record.read_text(encoding="utf-8"))
    if found["code"] or Path(found["package"]).parent.resolve() != checkout.folder.resolve():
        raise RuntimeError(f"{scene} ended with {found['code']}, of {found['package']}: {done.stderr.strip()[-500:]}")
    return RunSeconds(whole, found["seconds"])


def measure(
    scenes: Sequence[str], checkouts: Sequence[Checkout], repeats: int
) -> dict[tuple[str, str, str], list[RunSeconds]]:
    """All samples: of each scene first with empty caches, then with kept ones, checkouts in turn."""
    found: dict[tuple[str, str, str], list[RunSeconds]] = {}
    with tempfile.TemporaryDirectory(prefix="jaxnh_startup_") as name:
        for number, (scene, repeat) in enumerate((scene, repeat) for scene in scenes for repeat in range(repeats)):
            for checkout in checkouts:
                folder = Path(name, f"{number}_{checkouts.index(checkout)}")
                folder.mkdir()
                for cache in CACHES:  # the first run fills what the second finds
                    sample = run_once(checkout, scene, folder / "cache", folder)
                    found.setdefault((scene, cache, checkout.name), []).append(sample)
                    words = f"{scene}, {cache}, {checkout.name}, run {repeat + 1} of {repeats}"
                    print(f"{words}: {sample.whole:.2f} s", file=sys.stderr, flush=True)
    return found


def table(measured: Timings) -> Iterator[str]:
    """Lines of the page: a row a scene, cache and checkout; last what was asked for, and the other checkout's share."""
    yield "| scene | cache | code | whole | " + " | ".join(PARTS) + " | asked for | share |"
    yield "| :-- | :-- | :-- |" + " --: |" * (len(PARTS) + 3)
    last = list(dict.fromkeys(name for _, _, name in measured))[-1]
    for (scene, cache, name), samples in measured.items():
        whole = statistics.median(sample.whole for sample in samples)
        base = statistics.median(sample.whole for sample in measured[scene, cache, last])
        parts = [statistics.median(sample.of(part) for sample in samples) for part in PARTS]
        share = "" if name == last else f"{whole / base:.2f}"
        most = SCENES[scene].asked[CACHES.index(cache)]
        asked = "" if most is None or name != "here" else f"{most:g}"
        yield f"| {scene} | {cache} | {name} | {' | '.join(f'{x:.2f}' for x in (whole, *parts))} | {asked} | {share} |"


def page(measured: Timings, repeats: int) -> str:
    """The page of results."""
    names = list(dict.fromkeys(name for _, _, name in measured))
    turns = f", {' and '.join(names)} in turn" if len(names) > 1 else ""
    machine = f"{processor()}, {os.cpu_count()} cores."
    head = _HEAD.format(machine=machine, measured_at=stamp(), repeats=repeats, turns=turns)
    return head + "\n" + "\n".join(table(measured)) + "\n"


def checkouts_of(against: Path | None) -> list[Checkout]:
    """Ours, and the other one.

    Raises:
        SystemExit: it has no package in it.
    """
    found = [Checkout(ROOT, "here")]
    if against is not None:
        if not (against / "jaxnh" / "sweep.py").is_file():
            raise SystemExit(f"--against {against}: there is no jaxnh in it")
        found.append(Checkout(against.resolve(), stamp(against).commit))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--against", type=Path, help="another checkout")
    parser.add_argument("--only", choices=SCENES, nargs="+", help="these scenes, printed and not written")
    args = parser.parse_args()
    if args.repeats < 1:
        parser.error("--repeats: one at least")
    measured = measure(args.only or list(SCENES), checkouts_of(args.against), args.repeats)
    print("\n".join(table(measured)))
    if not args.only:
        path = ROOT / "results" / "startup.md"
        path.write_text(page(measured, args.repeats), encoding="utf-8")
        print(f"wrote {path}")


if __name__ == "__main__":
    main()
