"""Windows of stable orbits along a parameter, against maps whose windows are known."""

from __future__ import annotations

import numpy as np

from jaxnh.analyses.window_search import runs_of


def test_runs_of_lanes_are_cascades():
    """Periods 3, 6, 12 are one run and 5, 5 another; a lane alone, or one without a period, is none."""
    period = np.array([7, 0, 0, 3, 3, 6, 12, 5, 5, 0, 4, 0])
    assert runs_of(period) == [(3, 6), (7, 8)]
