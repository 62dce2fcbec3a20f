"""Parts of the slow tests: every module is in one of them, and none is much longer than another."""

from __future__ import annotations

import argparse

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.helpers.parts import modules_of_part, part

SECONDS = st.dictionaries(st.text("abc", min_size=1), st.floats(0.1, 100.0), min_size=1, max_size=30)


@given(SECONDS, st.integers(1, 6))
def test_parts_are_all_and_even(seconds, n):
    """Each module once, and the longest part beyond the shortest by less than the longest module."""
    parts = [modules_of_part(list(seconds), seconds, k, n) for k in range(1, n + 1)]
    assert sorted(name for one in parts for name in one) == sorted(seconds)
    lengths = [sum(seconds[name] for name in one) for one in parts]
    assert max(lengths) - min(lengths) <= max(seconds.values()) + 1e-9


def test_modules_that_nobody_has_timed():
    """They take the median of the others, and are in one part."""
    seconds = {"a": 10.0, "b": 10.0}
    parts = [modules_of_part(["a", "b", "new", "newer"], seconds, k, 2) for k in (1, 2)]
    assert [len(one) for one in parts] == [2, 2]


@pytest.mark.parametrize("text", ["0/4", "5/4", "1", "a/b", "1/2/3"])
def test_a_part_that_is_none(text):
    with pytest.raises(argparse.ArgumentTypeError, match="must be k/n"):
        part(text)
    assert part("4/4") == (4, 4)
