"""Parts of the slow tests: every module is in one of them, and none is much longer than another."""

from __future__ import annotations

import argparse
import json
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.helpers import parts
from tests.helpers.parts import longest_first, modules_of_part, part

SECONDS = st.dictionaries(st.text("abc", min_size=1), st.floats(0.1, 100.0), min_size=1, max_size=30)


@given(SECONDS, st.integers(1, 6))
def test_parts_are_all_and_even(seconds, n):
    """Each module once, and the longest part beyond the shortest by less than the longest module."""
    all_parts = [modules_of_part(list(seconds), seconds, k, n) for k in range(1, n + 1)]
    assert sorted(name for one in all_parts for name in one) == sorted(seconds)
    lengths = [sum(seconds[name] for name in one) for one in all_parts]
    assert max(lengths) - min(lengths) <= max(seconds.values()) + 1e-9


def test_modules_that_nobody_has_timed():
    """They take the median of the others, and are in one part."""
    seconds = {"a": 10.0, "b": 10.0}
    both = [modules_of_part(["a", "b", "new", "newer"], seconds, k, 2) for k in (1, 2)]
    assert [len(one) for one in both] == [2, 2]


def test_long_modules_come_first():
    """Modules stay whole, and the tests of each in their order; a new one may be long."""
    seconds = {"short": 1.0, "long": 9.0}
    items = [SimpleNamespace(nodeid=name) for name in ("short::a", "long::b", "long::a", "new::a")]
    assert [item.nodeid for item in longest_first(items, seconds)] == ["new::a", "long::b", "long::a", "short::a"]


def test_kept_seconds_are_of_the_processor(pytester, monkeypatch):
    """A test that sleeps takes none; those of a process that it starts count."""
    monkeypatch.setattr("tests.helpers.parts.KEPT", pytester.path / "kept.json")
    pytester.makepyfile(
        test_asleep="import time\ndef test_it(): time.sleep(0.5)",
        test_child="import subprocess, sys\ndef test_it(): subprocess.run([sys.executable, '-c', 'sum(range(10**7))'])",
    )
    pytester.inline_run("--keep-seconds", plugins=[parts])
    kept = json.loads((pytester.path / "kept.json").read_text())
    assert kept["test_asleep.py"] < 0.3
    assert kept["test_child.py"] > kept["test_asleep.py"]


@pytest.mark.parametrize("text", ["0/4", "5/4", "1", "a/b", "1/2/3"])
def test_a_part_that_is_none(text):
    with pytest.raises(argparse.ArgumentTypeError, match="must be k/n"):
        part(text)
    assert part("4/4") == (4, 4)
