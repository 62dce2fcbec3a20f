"""Points of lanes beside a boundary of basins: bisection of the way between two that lead to different attractors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.edges.destinations import TILE, UNDECIDED, Destinations, destinations
from jaxnh.analyses.section_points import on_constraints

WIDTH = 1e-11
"""Distance, in sizes, of two points that a boundary lies between."""

_SHARES = np.array([0.26, 0.51, 0.77])  # not even, as a symmetry may have the boundary halfway
_ROUNDS = 32


class Bracket(NamedTuple):
    """Points of lanes on either side of a boundary.

    Attributes:
        lane: number of the lane of each, (pairs,).
        near, far: section coordinates, (pairs, d).
        near_label, far_label: the attractors that they lead to, (pairs,).
    """

    lane: Int[np.ndarray, " pairs"]
    near: Float[np.ndarray, "pairs d"]
    far: Float[np.ndarray, "pairs d"]
    near_label: Int[np.ndarray, " pairs"]
    far_label: Int[np.ndarray, " pairs"]


class Space(NamedTuple):
    """Section coordinates of lanes, in sizes.

    Attributes:
        batch: of the lanes, with its section.
        size: of each section coordinate, (lanes, d).
    """

    batch: LaneBatch
    size: Float[np.ndarray, "lanes d"]

    def distance(
        self, first: Float[np.ndarray, "n d"], second: Float[np.ndarray, "n d"], lane: Int[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """Return Euclid's distance between points of lanes, in sizes."""
        return np.linalg.norm(self.batch.chart.wrap(first - second) / self.size[lane], axis=1)


def label_points(
    space: Space, targets: Destinations, lanes: LaneRunner, u: Float[np.ndarray, "n d"], lane: Int[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n d"], Int[np.ndarray, " n"]]:
    """Return points as constraints leave them, and the attractors that they lead to."""
    if not len(lane):
        return u, lane
    moved, state = lanes(on_constraints, (space.batch.system,), (u, space.batch.parameters_of(lane)), tile=TILE)
    return np.array(moved), destinations(targets, lanes, state, lane)


def narrow(space: Space, targets: Destinations, lanes: LaneRunner, pairs: Bracket) -> Bracket:
    """Return pairs of points not further apart than `WIDTH`, about the first change of label on the way from `near`.

    Where all that is looked at between two points is undecided, as the basin of an attractor that no start has led to,
    the boundary is that of this, and the label of the far point is `UNDECIDED`.
    """
    lane, near, far, near_label, far_label = (np.array(leaf) for leaf in pairs)
    for _ in range(_ROUNDS):
        active = np.flatnonzero(space.distance(near, far, lane) > WIDTH)
        if not len(active):
            break
        way = space.batch.chart.wrap(far[active] - near[active])
        points = near[active, None] + _SHARES[:, None] * way[:, None]
        flat, labels = label_points(space, targets, lanes, points.reshape(-1, points.shape[2]), lane[active].repeat(3))
        points = np.concatenate([near[active, None], flat.reshape(points.shape), far[active, None]], axis=1)
        labels = np.column_stack([near_label[active], labels.reshape(-1, len(_SHARES)), far_label[active]])
        same = labels == labels[:, :1]
        changed = ~same & (labels != UNDECIDED)
        changed[:, -1] = True  # a far end that is not decided is one that nothing nearer was
        first = np.argmax(changed, axis=1)
        last = np.max(np.where(same & (np.arange(5) < first[:, None]), np.arange(5), 0), axis=1)
        first = np.where((last == 0) & (first == 4), 1, first)  # a basin of an attractor that is not known lies between
        row = np.arange(len(active))
        near[active], far[active], far_label[active] = points[row, last], points[row, first], labels[row, first]
    return Bracket(lane, near, far, near_label, far_label)
