"""Times at which the steps of a period end, shared by all lanes: denser where they all turn faster. No solver here."""

from __future__ import annotations

import numpy as np

from jaxnh.systems.flow import Flow

GRID_POINTS = 1 << 16
_CELLS = 1 << 12
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_NEWTON_STEPS, _SETTLED = 4, 1e-10  # of a period: its square is far below rounding


def step_grid(system: Flow, steps: int, span: tuple[float, float]) -> np.ndarray:
    """Ends of the steps over a span, (steps + 1,)."""
    t = np.linspace(*span, GRID_POINTS + 1)
    rate = system.density(t)
    share = np.concatenate([[0.0], np.cumsum(rate[1:] + rate[:-1])])
    grid = np.interp(np.linspace(0.0, share[-1], steps + 1), share, t)
    grid[-1] = span[1]
    return grid


class SmoothGrid:
    """The grid as a smooth map from fictitious time τ to t, dt/dτ = 1/density, over all times.

    Steps of equal length in τ are steps of one constant length of an autonomous system, which is what a processed
    method needs: one conjugation then serves all of them.
    """

    def __init__(self, system: Flow) -> None:
        self._system = system
        self._width = system.period / _CELLS
        cells = self._integral(np.arange(_CELLS) * self._width, np.full(_CELLS, self._width))
        self._shares = np.concatenate([[0.0], np.cumsum(cells)])

    def share(self, t: np.ndarray) -> np.ndarray:
        """τ at t, any shape: zero at t = 0."""
        turns, rest = np.divmod(t, self._system.period)
        cell = np.minimum((rest / self._width).astype(int), _CELLS - 1)
        within = self._integral(cell * self._width, rest - cell * self._width)
        return turns * self._shares[-1] + self._shares[cell] + within

    def time(self, share: np.ndarray) -> np.ndarray:
        """t at τ, any shape."""
        turns, rest = np.divmod(share, self._shares[-1])
        t = np.interp(rest, self._shares, np.arange(_CELLS + 1) * self._width) + turns * self._system.period
        for _ in range(_NEWTON_STEPS):
            step = (self.share(t) - share) / self._system.density(t)
            t = t - step
            if np.max(np.abs(step), initial=0.0) < _SETTLED * self._system.period:
                break
        return t

    def rate(self, t: np.ndarray) -> np.ndarray:
        """dt/dτ at t, any shape."""
        return 1.0 / self._system.density(t)

    def _integral(self, t: np.ndarray, length: np.ndarray) -> np.ndarray:
        nodes = t[..., None] + 0.5 * length[..., None] * (1.0 + _NODES)
        return 0.5 * length * (self._system.density(nodes) * _WEIGHTS).sum(axis=-1)


def share_of_steps(system: Flow, span: tuple[float, float]) -> float:
    """Share of the steps of a period that lies in a span."""
    if span == (0.0, system.period):
        return 1.0
    first, last, whole = SmoothGrid(system).share(np.array([*span, system.period]))
    return float((last - first) / whole)
