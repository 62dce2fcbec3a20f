"""Measures of the boundary of basins, from the labels of a plane of start states: no lane is run for it.

- basin entropy (Daza, Wagemakers, Georgeot, Guéry-Odelin, Sanjuán, Sci. Rep. 6 (2016) 31416): the mean over boxes of
  5 × 5 starts of −Σ p ln p, p the share of a label in the box; boundary basin entropy: the mean over boxes of more than
  one label. Beyond ln 2 for the latter, with three basins or more, the boundary is fractal.
- uncertainty exponent α (Grebogi, McDonald, Ott, Yorke, Phys. Lett. A 99 (1983) 415; McDonald and co-workers, Physica D
  17 (1985) 125): the share of starts that another one at a distance ε to one side has another label than grows as ε^α,
  and the boundary's box dimension is 2 − α. A smooth boundary has α = 1.

What has failed or gone to infinity is a label of its own; undecided starts are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from jaxnh.analyses.base import OptionError, Setting, variable
from jaxnh.analyses.batch import Axis
from jaxnh.analyses.intervals import normal_quantile, student

BOX = 5
"""Starts along an edge of a box."""

LEAST = 32
"""Starts along an edge of a plane that three distances fit into."""

_UNDECIDED = 0
_FARTHEST = 8  # part of an edge that the largest distance is
_SCALES = 3
_FEWEST = 10  # starts that differ, for a distance to count
_EXPONENTS = np.arange(0.01, 1.5, 0.002)  # that are compared
_EVEN = 1e-6  # of a distance between neighbours: how far these may differ along an axis
_WORDS = {
    "basin_entropy": f"basin entropy, of boxes of {BOX} x {BOX} start states",
    "boundary_entropy": f"boundary basin entropy, of boxes of {BOX} x {BOX} start states",
    "uncertainty_exponent": "uncertainty exponent of the boundary",
}


class BoundaryMeasures(NamedTuple):
    """A quantity and its error at 95 %."""

    value: float
    error: float


class Boundary(NamedTuple):
    """Measures of the boundary in a plane; NaN where there is no boundary, or too little of it."""

    basin_entropy: BoundaryMeasures
    boundary_entropy: BoundaryMeasures
    uncertainty_exponent: BoundaryMeasures


def check_plane(setting: Setting) -> None:
    """Check that exactly two of the axes are start coordinates with enough values at equal distances."""
    plane = [axis for axis in setting.axes if axis.kind == "start"]
    if len(plane) != 2:
        raise OptionError("needs a plane of start states: two axes of coordinates of the start", "boundary")
    for axis in plane:
        steps = np.diff(axis.values)
        if len(axis.values) < LEAST or not np.all(np.abs(steps - steps[0]) <= _EVEN * np.abs(steps[0])):
            raise OptionError(f"needs at least {LEAST} values of {axis.name}, at equal distances", "boundary")


def boundary_variables(number: Int[np.ndarray, " lanes"], axes: Sequence[Axis]) -> xr.Dataset:
    """Return the measures of every plane of start states in a sweep, from the labels of all lanes."""
    plane = [k for k, axis in enumerate(axes) if axis.kind == "start"]
    others = [k for k in range(len(axes)) if k not in plane]
    shape = tuple(len(axis.values) for axis in axes)
    planes = number.reshape(shape).transpose(*others, *plane).reshape(-1, *(shape[k] for k in plane))
    measures = np.array([measure_boundary(labels) for labels in planes])  # (planes, quantities, value and error)
    dims, sizes = tuple(axes[k].name for k in others), tuple(shape[k] for k in others)
    variables = {}
    for k, (name, words) in enumerate(_WORDS.items()):
        value, error = (measures[:, k, i].reshape(sizes) for i in range(2))
        variables[name] = variable(dims, value, words, ancillary_variables=f"{name}_error")
        variables[f"{name}_error"] = variable(dims, error, f"error of the {words.split(',')[0]} at 95 %")
    return xr.Dataset(variables)


def measure_boundary(labels: Int[np.ndarray, "x y"]) -> Boundary:
    """Return the entropies and the exponent of a plane of labels."""
    whole, mixed = entropies(labels)
    return Boundary(whole, mixed, uncertainty_exponent(labels))


def entropies(labels: Int[np.ndarray, "x y"]) -> tuple[BoundaryMeasures, BoundaryMeasures]:
    """Return the basin entropy and the boundary basin entropy.

    Both are means over all places of a box. The error is the spread over the 25 grids of boxes that the plane can be
    cut into, each of which sees it by itself.
    """
    shape = tuple(n - BOX + 1 for n in labels.shape)
    decided = _count_in_boxes(labels != _UNDECIDED, shape)
    entropy, count = np.zeros(shape), np.zeros(shape, int)
    for label in np.unique(labels[labels != _UNDECIDED]):
        share = _count_in_boxes(labels == label, shape) / np.maximum(decided, 1)
        entropy -= np.where(share > 0.0, share * np.log(np.where(share > 0.0, share, 1.0)), 0.0)
        count += share > 0.0
    known, mixed = decided > 0, count > 1
    grids = [(slice(i, None, BOX), slice(j, None, BOX)) for i in range(BOX) for j in range(BOX)]
    measures = []
    for over in (known, mixed):
        if not np.any(over):
            measures.append(BoundaryMeasures(0.0 if over is known else np.nan, np.nan))
            continue
        each = [entropy[grid][over[grid]].mean() for grid in grids if np.any(over[grid])]
        measures.append(BoundaryMeasures(float(entropy[over].mean()), normal_quantile() * float(np.std(each, ddof=1))))
    return measures[0], measures[1]


def _count_in_boxes(hits: Bool[np.ndarray, "x y"], shape: tuple[int, ...]) -> Int[np.ndarray, "places across"]:
    """Return the number of hits in the box that begins at each place."""
    total = np.pad(np.cumsum(np.cumsum(hits, axis=0, dtype=np.int64), axis=1), ((1, 0), (1, 0)))
    (a, b), k = shape, BOX
    return total[k:, k:] - total[:a, k:] - total[k:, :b] + total[:a, :b]


def uncertainty_exponent(labels: Int[np.ndarray, "x y"]) -> BoundaryMeasures:
    """Fit the uncertainty exponent over distances of 1, 2, 4, … starts, up to an eighth of the shorter edge.

    Of the shares that differ A ε^α − B ε is fitted, with least squares of relative differences: of a boundary alike at
    several scales, between gaps each of which has two ends, the share f obeys f(ε) = Σ f(m_i ε)/m_i + O(ε), whose
    regular part is linear. The error has two parts: the scatter about a line through the logarithms, by Student's t,
    but not less than what the number of starts that differ leaves; and the largest of what the fit changes by without
    the smallest, or the largest, of the distances. Of three distances alone it is infinite. It covers the truth where
    the plane resolves two stages of a boundary that is alike at several scales, not of one whose stages are further
    apart than that.
    """
    distances = 2 ** np.arange(int(np.log2(max(min(labels.shape) // _FARTHEST, 1))) + 1)
    counts = [_count_different(labels, int(r), int(distances[-1])) for r in distances]
    differ, pairs = np.array(counts).T
    use = differ >= _FEWEST
    if np.sum(use) < _SCALES:
        return BoundaryMeasures(np.nan, np.nan)
    x, y = np.log(distances[use]), np.log(differ[use] / pairs[use])
    exponent, free = _fit_power(x, y), len(x) - _SCALES
    if not free:
        return BoundaryMeasures(exponent, np.inf)
    away = x - x.mean()
    counting = float(np.sqrt(np.sum(away**2 / differ[use])) / (away @ away))
    chance = max(student(free + 1) * _scatter_of_slope(x, y), normal_quantile() * counting)
    others = (_fit_power(x[part], y[part]) for part in (np.s_[1:], np.s_[:-1]))
    return BoundaryMeasures(exponent, chance + max(abs(other - exponent) for other in others))


def _count_different(labels: Int[np.ndarray, "x y"], distance: int, margin: int) -> tuple[int, int]:
    """Count starts whose label differs from that of a start at a distance along an axis, and all starts compared.

    These are the same for all distances up to the margin: those that are as far from both ends of the axis.
    """
    differ = pairs = 0
    for plane in (labels, labels.T):
        n = len(plane)
        low, centre, high = (plane[margin + k : n - margin + k] for k in (-distance, 0, distance))
        known = (low != _UNDECIDED) & (centre != _UNDECIDED) & (high != _UNDECIDED)
        differ += int(np.sum(known & ((low != centre) | (high != centre))))
        pairs += int(np.sum(known))
    return differ, max(pairs, 1)


def _fit_power(x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> float:
    """Return the exponent α of A ε^α − B ε, with A and B not below zero, through points ln ε and the logarithms."""
    share, distance = np.exp(y), np.exp(x - x[-1])
    power, linear = distance ** _EXPONENTS[:, None] / share, -distance / share
    (pp, pl, p1), (ll, l1) = (np.sum(power * k, axis=1) for k in (power, linear, 1.0)), (linear @ linear, linear.sum())
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = np.stack([p1 * ll - l1 * pl, l1 * pp - p1 * pl]) / (pp * ll - pl**2)
    alone = ~(b >= 0.0)
    a, b = np.where(alone, p1 / pp, a), np.where(alone, 0.0, b)
    return float(_EXPONENTS[np.argmin(np.sum((a[:, None] * power + b[:, None] * linear - 1.0) ** 2, axis=1))])


def _scatter_of_slope(x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> float:
    """Return the standard error of the slope of a line through points, by their scatter."""
    away = x - x.mean()
    rest = y - y.mean() - float(away @ y / (away @ away)) * away
    return float(np.sqrt(rest @ rest / (max(len(x) - 2, 1) * (away @ away))))
