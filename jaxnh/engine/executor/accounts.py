"""The costs of a lane executor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass
class Accounts:
    """Cost of the calls so far.

    Attributes:
        lane_periods: periods integrated, summed over lanes (derivatives count once).
        compile_seconds: spent tracing and compiling.
        run_seconds: spent in compiled programs.
        fastest: seconds a lane for an iteration of the innermost loop of a map, in the fastest call.
    """

    lane_periods: float = 0.0
    compile_seconds: float = 0.0
    run_seconds: float = 0.0
    fastest: float = math.inf

    def add(self, others: Sequence[Accounts]) -> None:
        """Add the accounts of executors that have run side by side: of their seconds the mean."""
        for other in others:
            self.lane_periods += other.lane_periods
            self.compile_seconds += other.compile_seconds / len(others)
            self.run_seconds += other.run_seconds / len(others)
            self.fastest = min(self.fastest, other.fastest)
