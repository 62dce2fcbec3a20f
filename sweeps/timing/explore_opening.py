"""Time from the command to the first picture of the explorer, and to the whole one; writes results/explore_opening.md.

    python -m sweeps.timing.explore_opening [--repeats 3] [--beside TEXT]

What `jaxnh explore` does up to the pictures, in a process of its own each time: the config, its calibration, programs,
and beside these the modules of the page. Then, in the same process, a user's flow, as a page opens it whose file has
been edited.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

from sweeps.checks.measured_at import ROOT, stamp
from sweeps.timing.effects import processor

_PAGE = ROOT / "results" / "explore_opening.md"
_CHART, _FLOW = ROOT / "configs" / "chart_b_a.yaml", ROOT / "configs" / "flows" / "lorenz.yaml"
_COLUMNS = 500  # of which a plane has a fifth: 100 by 75 lanes
_CACHES = ("empty", "kept")
_SCENES = {
    "chart": "chart of b by a, 100 × 75 lanes, from the command",
    "flow": "then Lorenz over 500 values of ρ, in the same process",
}
_ASKED = {"chart": (2.0, 10.0), "flow": (3.0, None)}

_TEXT = """\
# How soon the explorer has a picture

`python -m sweeps.timing.explore_opening` does what `jaxnh explore` does on `configs/chart_b_a.yaml`, in a process of
its own, up to the rasters that go to the browser; then opens `configs/flows/lorenz.yaml` in that process, as a page
does whose file has been edited. It writes this page. {processor}, {cores} cores. {beside}

{measured_at}

Seconds, medians of {repeats}. *Empty*: nothing is kept from an earlier run; *kept*: all programs are, and what was
decided. The first picture is a coarse one, the last has every lane in full. The command computes the first picture
while modules of the page are imported and a browser is opened.

| scene | cache | first picture | last picture | asked for |
|---|---|---|---|---|
{rows}
"""


def opened(began: float) -> Iterator[tuple[str, float]]:
    """Open both scenes in this process, and yield the scene and the seconds of each of their pictures.

    Args:
        began: time of the clock at which the command was given.
    """
    from jaxnh.cli.arguments import read_config
    from jaxnh.engine.progress import NullProgress
    from jaxnh.explorer.opening import open_file

    for scene, path in (("chart", _CHART), ("flow", _FLOW)):
        source = open_file(path, read_config(path, ()), (), (), NullProgress(), _COLUMNS).source
        beside = threading.Thread(target=import_module, args=("jaxnh.explorer.serve",))  # the modules of the page
        beside.start()
        for _ in source.passes(source.first):
            beside.join()
            yield scene, time.time() - began
        began = time.time()


def once(cache: str) -> dict[str, tuple[float, float]]:
    """Run the scenes in a new process; return seconds to their first and last pictures."""
    began = time.time()
    told = subprocess.run(
        [sys.executable, "-m", "sweeps.timing.explore_opening", "--from", repr(began)],
        cwd=ROOT,
        env={**os.environ, "JAX_COMPILATION_CACHE_DIR": cache},
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    times: dict[str, list[float]] = {}
    for scene, seconds in json.loads(told.splitlines()[-1]):
        times.setdefault(scene, []).append(seconds)
    return {scene: (each[0], each[-1]) for scene, each in times.items()}


def rows_of(measured: dict[str, list[dict[str, tuple[float, float]]]]) -> list[str]:
    """Rows of the page, of runs by cache."""
    rows = []
    for scene, words in _SCENES.items():
        asked = ", ".join("–" if limit is None else f"{limit:g}" for limit in _ASKED[scene])
        for cache in _CACHES:
            first, last = (statistics.median(run[scene][k] for run in measured[cache]) for k in range(2))
            rows.append(f"| {words} | {cache} | {first:.2f} | {last:.2f} | {asked} |")
    return rows


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--beside", default="The machine did nothing else.")
    parser.add_argument("--from", dest="began", type=float, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.began is not None:
        print(json.dumps(list(opened(given.began))))
        return
    measured: dict[str, list[dict[str, tuple[float, float]]]] = {cache: [] for cache in _CACHES}
    for _ in range(given.repeats):
        with tempfile.TemporaryDirectory() as folder:
            for cache in _CACHES:
                measured[cache].append(once(str(Path(folder) / "programs")))
    text = _TEXT.format(
        processor=processor(),
        cores=len(os.sched_getaffinity(0)),
        beside=given.beside,
        measured_at=stamp(),
        repeats=given.repeats,
        rows="\n".join(rows_of(measured)),
    )
    _PAGE.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
