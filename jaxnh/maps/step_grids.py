"""Times at which the steps of a period end, shared by all lanes: denser where they all turn faster. No solver here."""

from __future__ import annotations

from typing import Protocol

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


class Clocks(Protocol):
    """Clocks of flows of one period, which times have as first axis: one flow, or several."""

    @property
    def period(self) -> float:
        """Strobe period of all of them."""
        ...

    def density(self, t: np.ndarray, /) -> np.ndarray:
        """Steps a unit of time at t (flows, …), or (1, …) for all of them: (flows, …)."""
        ...


class SmoothGrid:
    """The grid as a smooth map from fictitious time τ to t, dt/dτ = 1/density, over all times.

    Steps of equal length in τ are steps of one constant length of an autonomous system, which is what a processed
    method needs: one conjugation then serves all of them. A flow has the same bits whichever others are beside it.
    """

    def __init__(self, clocks: Clocks) -> None:
        self._clocks = clocks
        self._width = clocks.period / _CELLS
        cells = self._integral(np.arange(_CELLS)[None] * self._width, np.full((1, _CELLS), self._width))
        self._shares = np.pad(np.cumsum(cells, axis=1), [(0, 0), (1, 0)])

    def share(self, t: np.ndarray) -> np.ndarray:
        """τ at t (flows, …), or (1, …) for all flows: zero at t = 0."""
        turns, rest = np.divmod(t, self._clocks.period)
        cell = np.minimum((rest / self._width).astype(int), _CELLS - 1)
        within = self._integral(cell * self._width, rest - cell * self._width)
        before = self._shares[along_first(np.arange(len(self._shares)), t.ndim), cell]
        return turns * along_first(self._shares[:, -1], t.ndim) + before + within

    def time(self, share: np.ndarray) -> np.ndarray:
        """t at τ, both (flows, …)."""
        turns, rest = np.divmod(share, along_first(self._shares[:, -1], share.ndim))
        ends = np.arange(_CELLS + 1) * self._width
        t = np.stack([np.interp(fraction, shares, ends) for fraction, shares in zip(rest, self._shares, strict=True)])
        t += turns * self._clocks.period
        settled = np.zeros(len(t), bool)
        for _ in range(_NEWTON_STEPS):
            step = (self.share(t) - share) / self._clocks.density(t)
            t = np.where(along_first(settled, t.ndim), t, t - step)
            settled |= np.abs(step).reshape(len(t), -1).max(axis=1, initial=0.0) < _SETTLED * self._clocks.period
            if settled.all():
                break
        return t

    def rate(self, t: np.ndarray) -> np.ndarray:
        """dt/dτ at t, as of `share`."""
        return 1.0 / self._clocks.density(t)

    def _integral(self, t: np.ndarray, length: np.ndarray) -> np.ndarray:
        nodes = t[..., None] + 0.5 * length[..., None] * (1.0 + _NODES)
        return 0.5 * length * (self._clocks.density(nodes) * _WEIGHTS).sum(axis=-1)


def along_first(values: np.ndarray, dimensions: int) -> np.ndarray:
    """Values along the first of so many axes."""
    return values.reshape(-1, *[1] * (dimensions - 1))


def share_of_steps(system: Flow, span: tuple[float, float]) -> float:
    """Share of the steps of a period that lies in a span."""
    if span == (0.0, system.period):
        return 1.0
    first, last, whole = SmoothGrid(system).share(np.array([[*span, system.period]]))[0]
    return float((last - first) / whole)
