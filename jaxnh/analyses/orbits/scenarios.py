"""Scenarios by which chaos has come about, of charts of the orbits that carry attractors.

Two are seen in a lane alone, by the orbit of least period in the attractor: a spiral attractor has a saddle-focus from
which motions part along a plane (Shilnikov, Int. J. Bifurcation Chaos 1 (1991) 719), a discrete Lorenz attractor the
saddle that `carriers` describes. Two are roads, and seen along an axis. Feigenbaum's (J. Stat. Phys. 19 (1978) 25): the
orbit of p returns has one multiplier below −1, and on the way back along the axis one of 2p is stable, and further on
one of p. The breakdown of a torus (Afraimovich and Shilnikov 1983): outside of the attractor there is an orbit with a
pair of multipliers beyond the unit circle, at every value on the way back to where this orbit is the attractor.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

SCENARIOS = (
    "undecided", "regular", "none_of_these", "feigenbaum", "torus_breakdown", "spiral", "discrete_lorenz",
)  # fmt: skip
"""Meanings of the flags 0 to 6 of `scenario`."""

_OF_CARRIERS = {
    "none": "undecided",
    "undecided": "undecided",
    "stable": "regular",
    "unstable_focus_saddle": "spiral",
    "discrete_lorenz": "discrete_lorenz",
}


class CarrierChart(NamedTuple):
    """Numbers of lanes that scenarios are told from, (lanes,) each.

    Attributes:
        period: of the orbit of least period in the attractor, or 0.
        kind: its kind, a name of `carriers.CARRIERS`.
        flips: whether it has one multiplier beyond the unit circle, below −1.
        turns: whether its largest multipliers are a complex pair.
        focus: least number of returns of an orbit outside of the attractor whose only multipliers beyond the unit
            circle are a complex pair, or 0.
    """

    period: Int[np.ndarray, " lanes"]
    kind: Sequence[str]
    flips: Bool[np.ndarray, " lanes"]
    turns: Bool[np.ndarray, " lanes"]
    focus: Int[np.ndarray, " lanes"]


def scenarios(chart: CarrierChart, axes: Sequence[Float[np.ndarray, " values"]]) -> Int[np.ndarray, " lanes"]:
    """Return the scenario of every lane, a number in `SCENARIOS`.

    A road that no axis shows is undecided; where neither flips nor a focus outside are there, it is none of these.

    Args:
        axes: values along the axes of the sweep, whose product are the lanes.
    """
    names = [_OF_CARRIERS.get(kind, "none_of_these") for kind in chart.kind]
    for lane in (lane for lane, name in enumerate(names) if name == "none_of_these"):
        if chart.flips[lane] or chart.focus[lane]:
            names[lane] = "undecided"
    shape = tuple(len(values) for values in axes)
    numbers = np.arange(len(names)).reshape(shape)
    for k, values in enumerate(axes):
        lines = np.moveaxis(numbers, k, -1)[..., np.argsort(values, kind="stable")].reshape(-1, len(values))
        for line in (*lines, *lines[:, ::-1]):
            for place in (place for place, lane in enumerate(line) if names[lane] == "undecided"):
                names[line[place]] = _road(chart, line[place], line[place + 1 :])
    return np.array([SCENARIOS.index(name) for name in names], int)


def _road(chart: CarrierChart, lane: int, ahead: Int[np.ndarray, " some"]) -> str:
    """Return the road that leads back from a lane over others in turn, or undecided."""
    period, focus = chart.period[lane], chart.focus[lane]
    if not period or chart.kind[lane] == "undecided":
        return "undecided"
    stable = [int(chart.period[other]) for other in ahead if chart.kind[other] == "stable"]
    if chart.flips[lane] and 2 * period in stable and period in stable[stable.index(2 * period) :]:
        return "feigenbaum"
    if focus:
        end = next((other for other in ahead if chart.focus[other] != focus), None)
        if end is not None and chart.kind[end] == "stable" and chart.turns[end] and chart.period[end] == focus:
            return "torus_breakdown"
    return "undecided"
