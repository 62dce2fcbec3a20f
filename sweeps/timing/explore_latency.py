"""Time until a zoom of the explorer is seen, coarse and refined; writes results/explore.md.

    python -m sweeps.timing.explore_latency [--zooms 24] [--beside TEXT]

Zooms of the paper's diagram to random ranges, 1,000 values at a target of 1e-6, programs compiled: from the request to
the raster that goes to the browser. TEXT says what else the machine did meanwhile, and stands on the page.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import numpy as np

import jaxnh
from jaxnh.engine.progress import NullProgress
from jaxnh.explorer.live import LiveDiagram
from jaxnh.explorer.view import View
from sweeps.checks.measured_at import stamp
from sweeps.timing.effects import processor

_PAGE = Path(__file__).parents[2] / "results" / "explore.md"
_CONFIG = Path(__file__).parents[2] / "configs" / "range_constant.yaml"
_NARROWEST = 1e-9  # range of b: from here on it is of the map, not of its accuracy, what is seen
_LIMITS = {"coarse": 0.3, "refined": 3.0}  # seconds that a median may take

_TEXT = """\
# How soon a zoom is seen

`python -m sweeps.timing.explore_latency` zooms {zooms} times into the paper's diagram (`configs/range_constant.yaml`,
error of one period {error:.1g} at a target of 1e-6), to ranges of {narrowest:g} to {widest:g} of b drawn at random, and
writes this page. {processor}, {cores} cores. {beside}

{measured_at}

Seconds from the request to the raster of 1,000 values that goes to the browser, programs compiled; drawing and the way
to the browser come on top.

| picture | median | fastest | slowest | asked for |
|---|---|---|---|---|
{rows}

Programs compiled by these zooms: {compiled}.
"""


def zooms(first: View, count: int, seed: int = 0) -> list[View]:
    """Views of random ranges, evenly over the logarithm of their widths."""
    random, found = np.random.default_rng(seed), []
    for width in np.geomspace(0.5 * (first.high - first.low), _NARROWEST, count):
        low = random.uniform(first.low, first.high - width)
        found.append(first.zoom(low, low + width, None))
    return found


def seconds(live: LiveDiagram, view: View) -> tuple[float, float]:
    """From the request to the first picture and to the last."""
    began, times = time.perf_counter(), list[float]()
    for _ in live.passes(view):
        times.append(time.perf_counter() - began)
    return times[0], times[-1]


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--zooms", type=int, default=24)
    parser.add_argument("--beside", default="The machine did nothing else.")
    given = parser.parse_args()
    live = LiveDiagram(jaxnh.load(_CONFIG), NullProgress(), 1000)
    views = zooms(live.first, given.zooms)
    for view in (live.first, views[0]):
        seconds(live, view)
    before = live.sessions.compiled
    coarse, refined = np.array([seconds(live, view) for view in views]).T
    rows = [
        f"| {name} | {np.median(times):.2f} | {times.min():.2f} | {times.max():.2f} | {_LIMITS[name]:g} |"
        for name, times in (("coarse", coarse), ("refined", refined))
    ]
    text = _TEXT.format(
        zooms=given.zooms,
        error=live.sessions.error_estimate,
        narrowest=views[-1].high - views[-1].low,
        widest=views[0].high - views[0].low,
        processor=processor(),
        cores=len(os.sched_getaffinity(0)),
        beside=given.beside,
        measured_at=stamp(),
        rows="\n".join(rows),
        compiled=live.sessions.compiled - before,
    )
    _PAGE.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
