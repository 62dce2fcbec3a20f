"""sweeps/timing/scale.py: real merges in small, workers that sleep, and what is reckoned from them."""

from __future__ import annotations

import pytest

from sweeps.timing import scale
from sweeps.timing.scale import Merging, Scheduling


def test_merges_are_of_real_files():
    merging = scale.measured_merging(3, 4096)
    assert merging.lanes == 3 * 4096
    assert merging.size > 16 * merging.lanes  # two float64 of a lane that do not compress
    assert min(merging.written, merging.copied, merging.virtual) > 0


def test_cost_is_that_of_all_lanes_and_times_fall_with_nodes():
    """At one lane a second and core: 1e9 core-seconds; a scheduler of ten pieces a second is the limit of 100 nodes."""
    slow = Scheduling(64, 1.0, 0.0, 10.0)
    page = scale.page([slow], Merging(10**6, 10**7, 0.1, 1.0, 0.5))
    rows = [row.split("|") for row in scale.reckoned([slow], Merging(10**6, 10**7, 0.1, 1.0, 0.5))]
    assert [row[2].strip() for row in rows] == [f"{1e9 / scale.RATE / 3600:.0f} core-hours"] * 3
    assert [row[7].strip() for row in rows] == ["16.7 min"] * 3
    assert [row[8].strip() for row in rows] == ["8.3 min"] * 3
    computing = 1e9 / scale.RATE / (100 * scale.CORES)
    assert rows[2][6].strip() == rows[2][5].strip()  # the queue, not the computing
    assert float(rows[2][4].replace(",", "")) >= computing / 10
    assert "## Measured" in page.split("## Reckoned")[0]
    seconds = 1e9 / scale.CARD_RATE
    assert f"**8 cards: {seconds / 8 / 60:.1f} min**, {seconds / 3600:.1f} card-hours" in page


@pytest.mark.slow
def test_workers_sleep_and_write():
    """A quarter of a minute: two workers; nothing of the package is left replaced."""
    before = scale.dask_workers._piece
    measured = scale.measured_scheduling(2, 0.5, 100)
    assert scale.dask_workers._piece is before
    assert measured.pieces_a_second > 10
    assert 0 < measured.lost < 10
