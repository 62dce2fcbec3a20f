"""Parts of the slow tests, of even length: `--part k/n` keeps the modules of the k-th of n parts.

A module stays whole, as its tests share programs and references. Seconds of processor that each takes are kept beside
this file, in `slow_seconds.json`, which `--keep-seconds` writes anew, those of processes that tests start among them and
whatever else the machine does; a module that is not there takes as long as the median of the others.
"""

from __future__ import annotations

import argparse
import heapq
import json
import math
import os
import statistics
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

KEPT = Path(__file__).with_name("slow_seconds.json")


def part(text: str) -> tuple[int, int]:
    """k and n of "k/n"."""
    try:
        k, n = map(int, text.split("/"))
    except ValueError:
        k, n = 0, 0
    if not 1 <= k <= n:
        raise argparse.ArgumentTypeError(f"must be k/n with 1 <= k <= n, as 1/4, not {text}")
    return k, n


def modules_of_part(modules: Sequence[str], seconds: Mapping[str, float], k: int, n: int) -> set[str]:
    """The modules of the k-th of n parts: the longest first, each to the part that is shortest so far."""
    usual = statistics.median(seconds.values()) if seconds else 1.0
    taken = [(0.0, number) for number in range(1, n + 1)]
    found = set[str]()
    for module in sorted(set(modules), key=lambda name: (-seconds.get(name, usual), name)):
        length, number = heapq.heappop(taken)
        if number == k:
            found.add(module)
        heapq.heappush(taken, (length + seconds.get(module, usual), number))
    return found


def pytest_addoption(parser):
    group = parser.getgroup("parts")
    group.addoption("--part", type=part, help="k/n: the modules of the k-th of n parts of even length")
    group.addoption("--keep-seconds", action="store_true", help=f"write what modules take to {KEPT.name}")


def pytest_configure(config):
    if config.getoption("--keep-seconds"):
        config.pluginmanager.register(_Processor(), "seconds of phases")
        if not hasattr(config, "workerinput"):
            config.pluginmanager.register(_Seconds(), "seconds of modules")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    if not (wanted := config.getoption("--part")):
        return
    seconds = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    modules = modules_of_part([_module(item.nodeid) for item in items], seconds, *wanted)
    config.hook.pytest_deselected(items=[item for item in items if _module(item.nodeid) not in modules])
    items[:] = longest_first([item for item in items if _module(item.nodeid) in modules], seconds)


def longest_first(items, seconds: Mapping[str, float]):
    """Tests in the order of the seconds of their modules, those that nobody has timed before all others.

    A long one that begins last would leave the other worker without work.
    """
    return sorted(items, key=lambda item: -seconds.get(_module(item.nodeid), math.inf))


class _Processor:
    """Tells each report the seconds of processor since the one before, of this process and of those that have ended."""

    def __init__(self):
        self._before = sum(os.times()[:4])

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self):
        report = yield
        now = sum(os.times()[:4])
        report.processor, self._before = now - self._before, now
        return report


class _Seconds:
    """Adds up what tests of each module take, on whatever worker."""

    def __init__(self):
        self._seconds = defaultdict(float, json.loads(KEPT.read_text()) if KEPT.exists() else {})
        self._seen = set[str]()

    def pytest_runtest_logreport(self, report):
        module = _module(report.nodeid)
        if module not in self._seen:
            self._seen.add(module)
            self._seconds[module] = 0.0
        self._seconds[module] += report.processor

    def pytest_sessionfinish(self):
        rounded = {name: round(value, 1) for name, value in sorted(self._seconds.items())}
        KEPT.write_text(json.dumps(rounded, indent=1) + "\n")


def _module(nodeid: str) -> str:
    return nodeid.split("::")[0]
