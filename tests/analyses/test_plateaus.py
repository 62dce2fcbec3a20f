"""Where cascades may begin among lanes whose periods are given, in words and in order; nothing is integrated."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from jaxnh.analyses.cascade import doubled_orbit
from jaxnh.analyses.cascade.plateaus import PeriodScan, describe_periods, starts


def line(*periods, values=None):
    values = np.arange(len(periods), dtype=float) if values is None else np.asarray(values, float)
    return PeriodScan(values, np.array(periods), values[:, None])


def chains(found):
    """Periods of every chain, with the value its first run ends at and the direction."""
    return [([run.period for run in start.runs], start.value, start.line.sign) for start in starts(found)]


def test_the_longest_chain_is_tried_first_and_its_parts_after_it():
    """Of equal chains the one in the direction of the line, in its order; then runs that nothing follows, long ones first."""
    found = line(3, 3, 3, 7, 7, 1, 1, 1, 1, 2, 2, 2, 4, 4, 5, 5, 5, 10, 10)
    assert chains(found) == [
        ([1, 2, 4], 8.0, 1.0),
        ([2, 4], 11.0, 1.0),
        ([5, 10], 16.0, 1.0),
        ([1], 5.0, -1.0),
        ([3], 2.0, 1.0),
        ([5], 14.0, -1.0),
        ([2], 9.0, -1.0),
        ([7], 4.0, 1.0),
        ([4], 13.0, 1.0),
        ([10], 17.0, -1.0),
        ([4], 12.0, -1.0),
        ([7], 3.0, -1.0),
    ]


def test_a_chain_against_the_direction_of_the_sweep():
    assert chains(line(8, 4, 4, 2, 2, 2, 1, 1, 1, 1))[0] == ([1, 2, 4, 8], 6.0, -1.0)


def test_undecided_lanes_and_coexisting_attractors_between_two_runs():
    """They are stepped over where they are no more than the runs about them; a run that goes on beyond them has no end."""
    assert chains(line(1, 1, 0, 0, 0, 2, 2, 2))[0][0] == [1, 2]
    assert chains(line(1, 1, 1, 32, 1, 1, 2, 2))[0] == ([1, 2], 5.0, 1.0)
    assert ([1], 2.0, 1.0) not in chains(line(1, 1, 1, 32, 1, 1, 2, 2))
    assert [c for c, _, _ in chains(line(1, *[0] * 8, 2))] == [[1], [2]]
    assert [1, 2] not in [c for c, _, _ in chains(line(1, 1, 3, 3, 3, 2, 2, 2))]


def test_a_run_goes_on_beyond_undecided_lanes():
    """Its period is seen at so many lanes as lie between its first and its last, and the next level is beyond those."""
    periods = [*[1] * 42, *[2] * 7, 0, 0, 2, *[0] * 7, 2, 0, *[2] * 4, *[0] * 4, 4, 4, *[0] * 9]
    (first, *_) = starts(line(*periods))
    assert [(run.first, run.last, run.period) for run in first.runs] == [(0, 41, 1), (42, 64, 2), (69, 70, 4)]
    assert [bracket.value.tolist() for bracket in first.brackets(2)] == [[64.0, 65.0], [64.0, 69.0]]


def test_a_level_that_the_survey_steps_over():
    assert chains(line(3, 3, 3, 12, 12))[0] == ([3, 12], 2.0, 1.0)
    assert [3, 9] not in [c for c, _, _ in chains(line(3, 3, 3, 9, 9))]


def test_brackets_are_of_neighbours_and_then_of_runs():
    """Between the last lane of a run and the next one; then the first of the next run of the cascade."""
    (first, *_) = starts(line(1, 1, 1, 0, 0, 2, 2, 4))
    assert [bracket.value.tolist() for bracket in first.brackets(1)] == [[2, 3], [2, 5]]
    assert [bracket.value.tolist() for bracket in first.brackets(2)] == [[6, 7]]
    assert not list(first.brackets(4))  # the end of the line
    assert not list(first.brackets(8))


@given(st.lists(st.sampled_from([0, 1, 2, 3, 4, 8]), min_size=1, max_size=30))
def test_every_end_of_a_run_is_tried(periods):
    """Every change from a period to anything else, in either direction, but where the same or twice it comes again."""
    found = line(*periods)
    tried = {(start.value, start.line.sign) for start in starts(found)} if len(periods) > 1 else set()
    for i, (n, following) in enumerate(pairwise(periods)):
        if n and n != following and n not in periods[i + 1 :]:
            assert (float(i), 1.0) in tried
        if following and n != following and following not in periods[: i + 1]:
            assert (float(i + 1), -1.0) in tried


def test_what_was_seen_in_words():
    found = line(1, 1, 1, 2, 0, 0, values=[6, 5.9, 5.8, 5.7, 5.6, 5.5])
    assert (
        describe_periods(found, "b", 16)
        == "periods seen along b: 1 at 6 to 5.8, 2 at 5.7, none up to 16 at 2 of 6 values"
    )
    many = line(*np.tile([1, 2], 9))
    assert describe_periods(many, "b", 16).endswith("10 shorter runs")


def test_joined_lines_keep_the_direction():
    one, other = line(2, 1, values=[5, 4]), line(9, 8, 1, values=[7, 5, 3])
    both = one.joined(other)
    assert both.value.tolist() == [7, 5, 4, 3]
    assert both.period.tolist() == [9, 2, 1, 1]


# ---- distances at which the next doubling is looked for


@given(st.floats(1e-9, 1e3), st.sampled_from([-1.0, 1.0]), st.floats(1e-9, 1e3))
def test_distances_end_where_the_search_does(expected, sign, end):
    """They have the sign, grow, join from window to window without a gap, and none is beyond the end."""
    windows = [doubled_orbit.window(sign * expected, number, sign * end) for number in range(-2, 4)]
    together = np.concatenate(windows) * sign
    assert np.all(together > 0)
    assert together.max() <= end
    assert np.all(np.diff(together) >= -1e-12 * together[1:])
    assert len(windows[2])
    if end > 2 * expected:
        assert np.abs(windows[2]).min() < expected < np.abs(windows[2]).max()
