"""The crisis of a window: where its bands meet the unstable orbit that bounds them.

Beyond it a path loses its phase on the bands (`crises.band_phase`) after a mean time τ ~ (b − b_c)^−γ, where γ is 1/2
for maps of one maximum on a line and larger in more dimensions (Grebogi, Ott, Romeiras, Yorke, Phys. Rev. A 36 (1987)
5365). So within a finite time no phase is lost just beyond the crisis, and where the first one is lost is too far. What
is known
is how long each path has kept its phase, also of those that have not lost it: given b_c, γ and a scale these times are
exponential. The posterior of b_c, with γ and the scale integrated out, has this bias in its interval.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxnh.analyses.crises.band_phase import REFERENCE, is_periodic, turns_in_phase

_PATHS = 64  # of a round, at as many values
_FIRST, _LONGER = 256, 4  # turns of paths of the first round; of every later one so many times those before
_BEHIND, _AHEAD = 6, 2  # spacings of a round that the next one reaches to either side of the first path that is lost
_LOWER = 4  # widths of a round that the next one begins lower by, where all of its paths are lost
_BETTER = 0.5  # of the error of the round before: else no more rounds of the longest paths
_NEAR = 64  # spacings of the last round: paths that are further beyond do not tell of the crisis itself
_EXPONENTS = np.linspace(0.5, 1.5, 11)  # γ, each as likely as the others
_DISTANCES = np.geomspace(1e-4, 1e3, 400)  # of the crisis before the first path that is lost, in spacings
_TAIL = 0.005  # of the probability, beyond either end of the interval


class Crisis(NamedTuple):
    """A value of the parameter at which bands meet the orbit that bounds them, and its error."""

    value: float
    error: float


class PhaseStays(NamedTuple):
    """Times for which paths at values of the parameter have kept their phase.

    Attributes:
        turns: around the bands, until the phase is lost or the path ends, (values,).
        lost: whether the phase is, (values,).
        tells: whether the path is chaotic or has lost its phase before: others tell nothing of bands, (values,).
    """

    turns: Float[np.ndarray, " values"]
    lost: Bool[np.ndarray, " values"]
    tells: Bool[np.ndarray, " values"]


Paths = Callable[[Float[np.ndarray, " values"], int], Float[np.ndarray, "values points k"]]
"""Paths on the bands at values of the parameter, of so many iterates, in sizes of the motion (`embed_points`)."""


def measure_stays(paths: Float[np.ndarray, "values points k"], bands: int) -> PhaseStays:
    """Measure how long paths keep their phase."""
    turns = np.array([turns_in_phase(path, bands) for path in paths])
    lost = turns < paths.shape[1] // bands
    tells = np.array([gone or not is_periodic(path, bands) for gone, path in zip(lost.tolist(), paths, strict=True)])
    return PhaseStays(turns.astype(float), lost, tells)


def locate_crisis(paths: Paths, start: float, stop: float, bands: int, most: int) -> Crisis | None:
    """Locate the value beyond which paths lose their phase; None: none does, or some do from the start on.

    Args:
        paths: on the bands.
        start, stop: values of the parameter between which bands are looked at, in either order.
        bands: number of them.
        most: iterates of a path, at most.
    """
    low, high = 0.0, abs(stop - start)
    sign, steps = np.sign(stop - start), min(_FIRST * bands, most)
    rounds, crisis = list[tuple[np.ndarray, PhaseStays]](), Crisis(np.nan, np.inf)
    while True:
        places = np.linspace(low, high, _PATHS)
        rounds.append((places, measure_stays(paths(start + sign * places, steps), bands)))
        lost = np.concatenate([places[stays.lost] for places, stays in rounds])
        if not len(lost) or lost.min() <= 0.0:
            return None
        first, spacing = float(lost.min()), (high - low) / (_PATHS - 1)
        if first == low:
            low, high = max(low - _LOWER * (high - low), 0.0), first
            continue
        if steps >= most:
            value, error = _posterior(first, spacing, np.concatenate([places for places, _ in rounds]), _join(rounds))
            better = error < _BETTER * crisis.error
            crisis = Crisis(start + float(sign) * value, error) if error < crisis.error else crisis
            if not better:
                return crisis if np.isfinite(crisis.error) else None
        low, high = max(first - _BEHIND * spacing, 0.0), first + _AHEAD * spacing
        steps = min(_LONGER * steps, most)


def _join(rounds: list[tuple[np.ndarray, PhaseStays]]) -> PhaseStays:
    """Concatenate the stays of all rounds."""
    return PhaseStays(*(np.concatenate(column) for column in zip(*(stays for _, stays in rounds), strict=True)))


def _posterior(first: float, spacing: float, at: Float[np.ndarray, " paths"], stays: PhaseStays) -> tuple[float, float]:
    """Return mean and error of the value where phases begin to be lost, from how long each path has kept it.

    The rate of losses is λ xᵞ at x beyond the crisis. Its logarithm is as likely to be anything: λ integrates to
    Γ(n)/(Σ xᵞ t)ⁿ times the product of xᵞ over the n paths that are lost. Losses have no memory: times count from the
    end of the reference on, of paths that were not lost by then.
    """
    used = (at < first + _NEAR * spacing) & stays.tells & (stays.turns > REFERENCE)
    at, stayed, out = at[used], stays.turns[used] - REFERENCE, stays.lost[used]
    if not np.any(out):
        return first, np.inf
    before = spacing * _DISTANCES
    x = np.maximum(at - (first - before)[:, None], 0.0) / spacing
    logs = np.log(np.where(out & (x > 0.0), x, 1.0)).sum(axis=1)[:, None] * _EXPONENTS
    waited = np.stack([(np.where(x > 0.0, x**gamma, 0.0) * stayed).sum(axis=1) for gamma in _EXPONENTS], axis=1)
    density = logs - out.sum() * np.log(waited) + np.log(before)[:, None]  # the grid is even in logarithms
    weight = np.exp(density - density.max()).sum(axis=1)
    weight /= weight.sum()
    mean = float(weight @ before)
    ends = np.interp([_TAIL, 1.0 - _TAIL], np.cumsum(weight) - 0.5 * weight, before)
    return first - mean, float(np.abs(ends - mean).max())
