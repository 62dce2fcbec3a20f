"""Correlation dimension of the points of a motion (Grassberger and Procaccia, Phys. Rev. Lett. 50 (1983) 346).

The share of pairs of points that are nearer than r grows as r^D. Coordinates are in units of their range, angles of a
turn, and distances are the largest difference of one. Pairs that follow one another too soon are left out (Theiler,
Phys. Rev. A 34 (1986) 2427): nearer in time than the lag after which no coordinate remembers its value by 1/e.

The scaling region is from the least radius with four pairs a point to a quarter of the range, and D the slope by least
squares over it, every half octave. Its error is the sum of three: of chance, 95 %, from leaving out one of sixteen
parts of the motion at a time; of the scatter of slopes over an octave, as fractals that resemble themselves have it in
turns, their range over the root of the number of octaves; and of slow convergence, by how much a power of the logarithm
of r beside that of r changes the slope, as at singularities of the density (Sprott and Rowlands, Int. J. Bifurcation
Chaos 11 (2001) 1865). This last one is most of it where points are few.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxnh.analyses.intervals import student

_PARTS = 16  # of the motion
_STEPS, _OCTAVE = 40, 2  # radii below the largest, and to an octave
_LARGEST = 0.25  # of the range
_PAIRS = 4  # a point, at the least radius
_SHORTEST = 2 * _OCTAVE  # region
_SAME = 10 * _OCTAVE  # steps without another pair: points that coincide
_STILL = 1e-9  # of its modulus: a coordinate that has no range
_SINGULAR = 4.0 * np.e  # of 1/√(x(1 − x)), the logistic map's at 4, the share of pairs is (4/π²) r ln(4e/r)


class CorrelationDimension(NamedTuple):
    """Correlation dimensions of motions; not numbers where too few points leave no region of two octaves.

    Attributes:
        value, error: (lanes,).
        least, largest: radii that the region is between, in units of the range, (lanes,).
    """

    value: Float[np.ndarray, " lanes"]
    error: Float[np.ndarray, " lanes"]
    least: Float[np.ndarray, " lanes"]
    largest: Float[np.ndarray, " lanes"]


def correlation_dimension(
    points: Float[np.ndarray, "lanes points d"], angles: Bool[np.ndarray, " d"]
) -> CorrelationDimension:
    """Return the correlation dimension of the points of each lane, with its error."""
    rows = [
        _of_points(lane, angles) if np.isfinite(lane).all() else (np.nan, np.nan, np.nan, np.nan) for lane in points
    ]
    return CorrelationDimension(*np.array(rows, float).reshape(-1, 4).T)


def _of_points(
    points: Float[np.ndarray, "points d"], angles: Bool[np.ndarray, " d"]
) -> tuple[float, float, float, float]:
    extent = np.ptp(points, axis=0)
    moving = extent > _STILL * np.abs(points).max(axis=0)
    scaled = points / np.where(angles, 2 * np.pi, np.where(moving, extent, 1.0))
    scaled = np.where(angles, np.mod(scaled, 1.0), np.where(moving, scaled, 0.0))
    radii = _LARGEST * 2.0 ** (np.arange(-_STEPS, 1) / _OCTAVE)
    pairs = _pairs_between_parts(scaled, angles, radii, _window(points, angles))
    own = np.diagonal(pairs).T
    every = pairs.sum(axis=(0, 1))
    without = every - 2.0 * pairs.sum(axis=1) + own  # one part each
    good = np.flatnonzero((every >= 2 * _PAIRS * len(points)) & np.all(without > 0.0, axis=0))
    first = int(good[0]) if len(good) else len(radii)
    if len(radii) - 1 - first < _SHORTEST:
        return np.nan, np.nan, np.nan, np.nan
    least, largest = float(radii[first]), float(radii[-1])
    if not first and every[0] == every[_SAME]:
        return 0.0, 0.0, least, largest
    x, y = np.log(radii[first:]), np.log(every[first:])
    value = float(np.polyfit(x, y, 1)[0])
    of_parts = np.polyfit(x, np.log(without[:, first:]).T, 1)[0]
    local = (y[_OCTAVE:] - y[:-_OCTAVE]) / (x[_OCTAVE:] - x[:-_OCTAVE])
    slow = _slow_convergence(x, y, np.log(without[:, first:]), of_parts - value)
    scatter = np.ptp(local) / np.sqrt((len(x) - 1) / _OCTAVE)
    return value, float(_chance(of_parts) + scatter + slow), least, largest


def _slow_convergence(
    x: Float[np.ndarray, " radii"],
    y: Float[np.ndarray, " radii"],
    of_parts: Float[np.ndarray, "parts radii"],
    slopes: Float[np.ndarray, " parts"],
) -> float:
    """Return how much a power of ln(4e/r), of 1 at most, changes the slope: that of a fit with its own chance."""
    slowly = np.log(np.log(_SINGULAR) - x)
    whole = abs(np.polyfit(x, slowly, 1)[0])
    fits = np.linalg.lstsq(np.column_stack([np.ones_like(x), x, slowly]), np.column_stack([y, of_parts.T]), rcond=None)[
        0
    ][1]
    plain = np.polyfit(x, y, 1)[0]
    return min(whole, abs(fits[0] - plain) + _chance(fits[1:] - plain - slopes))


def _pairs_between_parts(
    points: Float[np.ndarray, "points d"],
    angles: Bool[np.ndarray, " d"],
    radii: Float[np.ndarray, " radii"],
    window: int,
) -> Float[np.ndarray, "parts parts radii"]:
    """Return the number of ordered pairs of points of two parts of a motion within each radius of one another."""
    from scipy.spatial import KDTree  # here, as it takes a tenth of a second to import

    ends = np.linspace(0, len(points), _PARTS + 1).astype(int)
    box = np.where(angles, 1.0, 0.0)
    trees = [KDTree(points[a:b], boxsize=box) for a, b in itertools.pairwise(ends)]
    pairs = np.zeros((_PARTS, _PARTS, len(radii)))
    for i in range(_PARTS):
        for j in range(i + 1):
            pairs[i, j] = pairs[j, i] = trees[i].count_neighbors(trees[j], radii, p=np.inf)
    pairs[range(_PARTS), range(_PARTS)] -= np.diff(ends)[:, None]
    part = np.repeat(np.arange(_PARTS), np.diff(ends))
    for lag in range(1, window):
        apart = np.abs(points[lag:] - points[:-lag])
        apart = np.where(angles, np.minimum(apart, 1.0 - apart), apart).max(axis=1)
        near = np.zeros((_PARTS, _PARTS, len(radii) + 1))
        np.add.at(near, (part[lag:], part[:-lag], np.searchsorted(radii, apart)), 1.0)
        near = np.cumsum(near, axis=2)[..., :-1]
        pairs -= near + np.swapaxes(near, 0, 1)
    return pairs


def _window(points: Float[np.ndarray, "points d"], angles: Bool[np.ndarray, " d"]) -> int:
    """Return the least lag after which all autocorrelations have been below 1/e; at most a sixteenth of the points."""
    turning = points[:, angles]
    series = np.column_stack([points[:, ~angles], np.cos(turning), np.sin(turning)])
    series = series - series.mean(axis=0)
    power = np.abs(np.fft.rfft(series, 2 * len(series), axis=0)) ** 2
    correlation = np.fft.irfft(power, axis=0)[: len(series) // _PARTS]
    below = np.minimum.accumulate(correlation, axis=0) <= correlation[0] / np.e
    return int(np.argmax(below.all(axis=1))) if below.all(axis=1).any() else len(series) // _PARTS


def _chance(values: Float[np.ndarray, " parts"]) -> float:
    """Return the half-width of the 95 % interval of a mean from its values without one part each (jackknife)."""
    share = (len(values) - 1) / len(values)
    return float(student(len(values)) * np.sqrt(share * np.sum((values - values.mean()) ** 2)))
