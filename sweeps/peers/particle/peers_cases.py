"""The scenes that contestants of `sweeps.peers.particle.peers` are measured on: the main one, and others held out. No
integrator.

`processed6` was searched for and chosen on the values of b of the main scene, with d = 0 and d = 0.1
(`sweeps.studies.compositions`). The held-out scenes are of other parameters, ranges of b and start states: the first is
fixed, the others are drawn by a seed, once, before anything was measured on them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

LANES = 256
"""Values of b of a scene."""

HELD_OUT_SEED = 13
_DRAWN = (False, True, False, True)  # whether the speed is disturbed


class Case(NamedTuple):
    """A scene as it is asked for, in the paper's symbols with ω = 1.

    Attributes:
        name: in the tables.
        a, c, d: parameters; d = 0 is constant speed.
        low, high: range of b.
        start: (x1, y1, θ), θ the direction of the velocity.
    """

    name: str
    a: float
    c: float
    d: float
    low: float
    high: float
    start: tuple[float, float, float]

    @property
    def values(self) -> np.ndarray:
        """(LANES,) values of b."""
        return np.linspace(self.low, self.high, LANES)

    @property
    def words(self) -> str:
        """Parameters, range and start in one line."""
        x, y, theta = self.start
        system = f"a = {self.a:g}, c = {self.c:g}" + (f", d = {self.d:g}" if self.d else "")
        return f"{system}, b in [{self.low:g}, {self.high:g}], start ({x:g}, {y:g}, θ = {theta:.4g})"


def paper(d: float = 0.0) -> Case:
    """The scene of the paper's parameters and start state: constant speed, or disturbed by d."""
    return Case("disturbed_speed" if d else "constant_speed", 0.5, 1.0, d, 2.0, 6.0, (0.1, 0.1, math.acos(0.1)))


def held_out(seed: int = HELD_OUT_SEED) -> tuple[Case, ...]:
    """The held-out scenes, the same for a seed."""
    rng = np.random.default_rng(seed)
    cases = [Case("held out 1", 0.8, 1.6, 0.0, 1.1, 5.3, paper().start)]
    for i, disturbed in enumerate(_DRAWN):
        a, c, share = rng.uniform(0.2, 1.2), rng.uniform(0.5, 2.5), rng.uniform(0.05, 0.5)
        low, width = rng.uniform(0.2, 3.0), rng.uniform(1.5, 4.0)
        x, y, theta = rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5), rng.uniform(0.0, 2.0 * math.pi)
        d = share * c if disturbed else 0.0
        a, c, d, low, high, x, y, theta = (round(value, 3) for value in (a, c, d, low, low + width, x, y, theta))
        cases.append(Case(f"held out {i + 2}", a, c, d, low, high, (x, y, theta)))
    return tuple(cases)
