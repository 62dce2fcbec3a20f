"""Lanes along the first axis on their attractors: their runs of equal periods, and where a cascade may begin in them.

Host code over the results of a survey; nothing is integrated here.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxnh.systems.rows import concatenate, select

_HOLE = 2  # lanes: so many alone or in pairs may lie between two runs of a cascade, however short these are
_SHOWN = 8  # runs in words


class Plateau(NamedTuple):
    """Neighbouring lanes of one period: the numbers of the first and the last, and the period (0: undecided)."""

    first: int
    last: int
    period: int

    @property
    def lanes(self) -> int:
        """Number of lanes."""
        return self.last - self.first + 1


class PeriodScan(NamedTuple):
    """Lanes along the first axis, on their attractors, in the order of a direction.

    Attributes:
        value: of the first axis, (lanes,).
        period: least period of the attractor, 0 where it is none up to the limit, (lanes,).
        u: a point of the orbit in section coordinates, (lanes, d).
    """

    value: Float[np.ndarray, " lanes"]
    period: Int[np.ndarray, " lanes"]
    u: Float[np.ndarray, "lanes d"]

    @property
    def sign(self) -> float:
        """1 where values rise along the line, −1 where they fall."""
        return 1.0 if self.value[-1] >= self.value[0] else -1.0

    def take(self, lanes: Int[np.ndarray, " some"] | slice) -> PeriodScan:
        """The line of some of its lanes, in the order of their numbers as given."""
        return select(self, lanes)

    def joined(self, other: PeriodScan) -> PeriodScan:
        """Both lines as one, in the direction of this one, a lane of this one where both have the value."""
        both = concatenate([self, other])
        order = np.unique(both.value, return_index=True)[1]
        return both.take(order if self.sign > 0 else order[::-1])

    def runs(self) -> list[Plateau]:
        """Its runs, in order."""
        starts = np.flatnonzero(np.diff(self.period, prepend=-1)).tolist()
        return [
            Plateau(first, following - 1, int(self.period[first]))
            for first, following in pairwise([*starts, len(self.value)])
        ]


class Start(NamedTuple):
    """Possible beginning of a cascade.

    Attributes:
        line: in the direction of the cascade.
        runs: the run whose period may double, then those that follow in the cascade as far as it is seen, each with
            twice the period or a higher power of two times it, where the survey has stepped over a level; of each
            from its first lane to its last, whatever few others lie between.
    """

    line: PeriodScan
    runs: tuple[Plateau, ...]

    @property
    def period(self) -> int:
        """The period that may double first."""
        return self.runs[0].period

    @property
    def value(self) -> float:
        """The last value of the first axis at which the orbit of that period was seen."""
        return float(self.line.value[self.runs[0].last])

    def brackets(self, n: int) -> Iterator[PeriodScan]:
        """Lines of two lanes between which the period-n orbit may double: the last that has it, and one beyond.

        That is its neighbour or, as lanes at a doubling converge slowly and stay undecided, the first of the next run.
        """
        for k, run in enumerate(self.runs):
            if run.period == n and run.last + 1 < len(self.line.value):
                following = self.runs[k + 1].first if k + 1 < len(self.runs) else run.last + 1
                for beyond in dict.fromkeys((run.last + 1, following)):
                    yield self.line.take(np.array([run.last, beyond]))


def starts(line: PeriodScan) -> list[Start]:
    """Return all ends of runs, in both directions, at which a cascade may begin, the most promising first.

    First come those with the longest chains of runs n, 2n, 4n, … (or with steps of 4n and more) beyond them, of equal
    ones those in the direction of the line, then in its order; then runs with no such neighbour, the longest first.
    Where the same period goes on beyond a few other lanes a run has no end.
    """
    ends: list[Start] = []
    for ordered in (line, line.take(slice(None, None, -1))):
        runs = ordered.runs()
        for i, run in enumerate(runs):
            chain, j = [run], _next_run(runs, i, run.lanes)
            if not run.period or run.last + 1 == len(ordered.value) or (j is not None and runs[j].period == run.period):
                continue
            while j is not None:
                if runs[j].period == chain[-1].period:
                    chain[-1] = chain[-1]._replace(last=runs[j].last)
                else:
                    chain.append(runs[j])
                j = _next_run(runs, j, chain[-1].lanes)
            ends.append(Start(ordered, tuple(chain)))
    return sorted(ends, key=lambda start: (-len(start.runs), -start.runs[0].lanes if len(start.runs) == 1 else 0))


def _next_run(runs: list[Plateau], i: int, lanes: int) -> int | None:
    """The run beyond the i-th that has the same period, or a power of two times it; None where there is none.

    Undecided lanes and short runs of other periods, of coexisting attractors or of windows, may lie between the two, no
    more in all than the two have lanes themselves: the i-th so many, with runs of its period before it that it goes on.
    """
    n, between = runs[i].period, 0
    for j in range(i + 1, len(runs) if n else 0):
        ratio, rest = divmod(runs[j].period, n)
        related = not rest and ratio > 0 and ratio & (ratio - 1) == 0
        a_hole = runs[j].lanes <= _HOLE and ratio != 1 and j + 1 < len(runs) and runs[j + 1].period == n
        if related and not a_hole and between <= max(lanes + runs[j].lanes, _HOLE):
            return j
        between += runs[j].lanes
        if runs[j].period and runs[j].lanes > max(_HOLE, lanes):
            break
    return None


def describe_periods(line: PeriodScan, name: str, limit: int) -> str:
    """Describe which periods a survey up to a limit gives where along the axis of that name."""
    runs = line.runs()
    decided = [run for run in runs if run.period]
    shown = sorted(sorted(decided, key=lambda run: -run.lanes)[:_SHOWN])
    words = [f"{run.period} at {_place(line, run)}" for run in shown]
    if len(decided) > len(shown):
        words.append(f"{len(decided) - len(shown)} shorter runs")
    undecided = sum(run.lanes for run in runs if not run.period)
    if undecided:
        words.append(f"none up to {limit} at {undecided} of {len(line.value)} values")
    return f"periods seen along {name}: {', '.join(words)}"


def _place(line: PeriodScan, run: Plateau) -> str:
    first, last = (f"{line.value[lane]:.6g}" for lane in (run.first, run.last))
    return first if first == last else f"{first} to {last}"
