"""The record of a flow with a known answer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import iterate


@dataclass(frozen=True)
class KnownFlow:
    """Lanes of a flow, and where its map takes them by an independent source.

    Attributes:
        system: a flow, or a section of one.
        start: states of the lanes.
        exact: what is known of their image, (lanes, numbers).
        numbers: the same of states.
        parameters: of the lanes, by name.
        evaluations: of the right-hand side over a period, with which errors of every method follow its order.
        rounding: of the numbers, at most.
        wrap: whole turns out of differences.
    """

    system: Any
    start: Any
    exact: np.ndarray
    numbers: Callable[[Any], np.ndarray]
    parameters: Mapping[str, np.ndarray] = field(default_factory=dict)
    evaluations: int = 150
    rounding: float = 1e-14
    wrap: Callable[[Any], Any] = lambda difference: difference

    def errors(self, lanes, solver, steps):
        """Largest error of each lane's numbers after one map in so many steps a period, (lanes,)."""
        strobe = make_return_map(self.system, solver, steps)
        image = lanes(iterate, (strobe, np.int32(1)), (self.start, dict(self.parameters)))
        return np.abs(self.wrap(self.numbers(image) - self.exact)).max(axis=-1).astype(float)
