"""The smallest angle of directions that grow and shrink on an attractor, by a search beside its motions. Host code.

Tangencies may be in parts of an attractor that motions seldom visit, as near the stable manifold of an equilibrium. The
attractor has the unstable manifolds of its points: a point that is moved along the directions that grow, and followed
for as long as what is across them takes to shrink away, is on it again, at another place of the same leaf. So points of
small angle are moved, some returns before, by lengths even in their logarithm or near the one that has helped last, and
of each the best is kept: an evolution strategy on the leaves (Beyer and Schwefel, Natural Computing 1 (2002) 3). That a
rare event is looked for by small changes long before it is as in importance sampling of chaotic motions (Leitão, Lopes
and Altmann, Phys. Rev. Lett. 110 (2013) 220601).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.covariant.directions import directions_along, settling_returns
from jaxnh.analyses.covariant.vectors import CovariantVectors
from jaxnh.analyses.periodic.newton_on_lanes import ORBIT_TILE
from jaxnh.analyses.section_points import points_at, shear_along_flow, states_at
from jaxnh.maps.iterate import derivative_and_volume
from jaxnh.systems.rows import concatenate, select, write_rows

ISLANDS = 8
"""Points of each lane that are moved, each by itself."""

CHILDREN = 8
"""Ways in which each is moved at once."""

DERIVATIVE = 7.0
"""Periods that one with three tangents takes as long as, for the expected work."""

_LONGEST, _SHORTEST = 0.3, 1e-9  # lengths of moves, in sizes of the motion
_SPREAD = 1.0  # of the logarithm of lengths about the one that has helped last
_AT_ONCE = 1 << 22  # numbers of derivatives in memory
_PATH = 3  # times as many returns as directions settle in: forward, points that count, backward
_MOST_STRETCH = 23.0  # of one return, in logarithms: of positions known to 1e-16 derivatives still are, to 1e-3 or so
_NEARBY = 0.1  # sizes of the motion between points whose directions are compared
_ALIGNED = 0.5  # determinant of the cosines between them


class LeastAngles(NamedTuple):
    """Results of a search by lane, not a number where none was made.

    Attributes:
        angle: the smallest angle, (lanes,), rad.
        before: the smallest one after half of the rounds, (lanes,), rad.
        crossed: whether two points nearby have small angles of different signs, so that between them there is a
            tangency, (lanes,).
    """

    angle: Float[np.ndarray, " lanes"]
    before: Float[np.ndarray, " lanes"]
    crossed: Bool[np.ndarray, " lanes"]


class SearchedMotions(NamedTuple):
    """Motions of lanes, at points where vectors are known.

    Attributes:
        batch: the lanes.
        lanes: what runs them.
        points: section coordinates, (lanes, points, d).
        size: of the motion in each of them, which vectors and derivatives are measured in, (lanes, d).
        vectors: at the points.
        angles: between the first 1, …, k − 1 vectors and the others, (lanes, splits, points), rad.
    """

    batch: LaneBatch
    lanes: LaneRunner
    points: Float[np.ndarray, "lanes points d"]
    size: Float[np.ndarray, "lanes d"]
    vectors: CovariantVectors
    angles: Float[np.ndarray, "lanes splits points"]

    def take(self, which: Int[np.ndarray, " some"]) -> SearchedMotions:
        """Return the motions of some lanes."""
        points, size, vectors, angles = select(self[2:], which)
        return SearchedMotions(self.batch.take(which), self.lanes, points, size, vectors, angles)


class _Scene(NamedTuple):
    """Scene of a search.

    Attributes:
        batch: lanes.
        lanes: what runs them.
        size: of the motion in each coordinate, (lanes, d).
        small: angles below which signs are compared, (lanes,), rad.
        j: number of the first vectors, whose angle with the others is looked for.
        n: returns that directions take to settle.
    """

    batch: LaneBatch
    lanes: LaneRunner
    size: Float[np.ndarray, "lanes d"]
    small: Float[np.ndarray, " lanes"]
    j: int
    n: int

    def take(self, which: Int[np.ndarray, " some"]) -> _Scene:
        """Return the scene of some lanes."""
        return self._replace(batch=self.batch.take(which), size=self.size[which], small=self.small[which])


class _Points(NamedTuple):
    """Points n returns before others, and what is so at those.

    Attributes:
        u: section coordinates, (..., d).
        frames: tangent there, of which the first columns span what grows, (..., d, k).
        angle: n returns later, (...).
        stretch: logarithm of what the last return before has made of volumes that grow, (...).
        target: the point there, (..., d).
        directions: orthonormal ones that grow there, and orthonormal ones across those that shrink, (..., 2, d, j).
    """

    u: Float[np.ndarray, "*points d"]
    frames: Float[np.ndarray, "*points d k"]
    angle: Float[np.ndarray, "*points"]
    stretch: Float[np.ndarray, "*points"]
    target: Float[np.ndarray, "*points d"]
    directions: Float[np.ndarray, "*points 2 d j"]


def searched_returns(n: int) -> int:
    """Return how many returns one round follows in a lane whose directions settle in n."""
    return ISLANDS * CHILDREN * _PATH * n


def least_angles(
    motions: SearchedMotions,
    small: Float[np.ndarray, " lanes"],
    growing: Int[np.ndarray, " lanes"],
    neutral: int,
    rounds: int,
) -> LeastAngles:
    """Return the smallest angles between the first vectors and the others.

    Args:
        small: angles below which signs tell a tangency, (lanes,).
        growing: number of the first vectors, from 1 to k − 1.
        neutral: number of vectors along the flow that are next to them.
        rounds: of moves.
    """
    batch = motions.batch
    none = np.full(batch.count, np.nan)
    least = LeastAngles(none, none.copy(), np.zeros(batch.count, bool))
    returns = settling_returns(np.mean(motions.vectors.growth, axis=1), growing, neutral)
    for j, n in sorted(set(zip(growing.tolist(), returns.tolist(), strict=True))):
        (which,) = np.nonzero((growing == j) & (returns == n))
        if n == 0:
            continue
        islands = _begin(motions.take(which), j, n)
        scene = _Scene(batch.take(which), motions.lanes, motions.size[which], small[which], j, n)
        work = float(len(which) * rounds * searched_returns(n) * (1.0 + DERIVATIVE))
        with motions.lanes.stage(f"covariant: smaller angles in {len(which):,} lanes", work):
            for made, (smallest, crossed) in enumerate(_rounds(scene, islands, rounds), start=1):
                least.angle[which], least.crossed[which] = smallest, crossed
                if 2 * made <= rounds:
                    least.before[which] = smallest
    return least


def _begin(motions: SearchedMotions, j: int, n: int) -> _Points:
    """Return the points of smallest angle, none within n returns of another, as (lanes, islands)."""
    points, frames, angles = motions.points, motions.vectors.frames, motions.angles[:, j - 1]
    left, lane, targets = angles.copy(), np.arange(len(points))[:, None], []
    left[:, :n] = np.inf
    for _ in range(ISLANDS):
        targets.append(np.argmin(left, axis=1))
        left[np.abs(np.arange(left.shape[1]) - targets[-1][:, None]) < n] = np.inf
    target = np.stack(targets, axis=1)
    none = np.full((*target.shape, points.shape[2]), np.nan)
    return _Points(
        points[lane, target - n],
        frames[lane, target - n],
        angles[lane, target],
        np.full(target.shape, -1e9),
        none,
        np.tile(none[..., None, :, None], (2, 1, j)),
    )


def _rounds(
    scene: _Scene, islands: _Points, rounds: int
) -> Iterator[tuple[Float[np.ndarray, " lanes"], Bool[np.ndarray, " lanes"]]]:
    """Move points, the same way in every lane; yield the smallest angle of each lane, and where a tangency is shown.

    The first half of the islands goes where angles are small. The others go where a return stretches most, which is
    where angles may change over ever shorter lengths; the smallest angle that is met there, if it is smaller than all,
    takes the place of the largest one of the first half.
    """
    draws, steep = np.random.default_rng(0), np.arange(ISLANDS) >= ISLANDS // 2
    lengths, crossed = np.full(islands.angle.shape, _LONGEST), np.zeros(len(islands.angle), bool)
    for _ in range(rounds):
        even = np.exp(draws.uniform(np.log(_SHORTEST), np.log(_LONGEST), (ISLANDS, CHILDREN)))
        factors = np.exp(draws.normal(0.0, _SPREAD, (ISLANDS, CHILDREN)))
        ways = draws.normal(size=(ISLANDS, CHILDREN, scene.j))
        ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
        (going,) = np.nonzero(~crossed)
        if len(going):
            parents, some = select(islands, going), scene.take(going)
            near = np.minimum(lengths[going, :, None] * factors, _LONGEST)
            length = np.where(np.arange(CHILDREN) % 2, even, near)
            along = np.einsum("lidj,icj->licd", parents.frames[..., : scene.j], ways) * length[..., None]
            moved = parents.u[:, :, None] + some.size[:, None, None] * along
            by_angle, by_stretch = _children(some, moved, parents.frames)
            crossed[going] = _crossed(some, parents, by_angle)
            for island in range(ISLANDS):
                children = select(by_stretch if steep[island] else by_angle, np.s_[:, island])
                gain = children.stretch - islands.stretch[going, island, None]
                if not steep[island]:
                    gain = islands.angle[going, island, None] - children.angle
                _keep_best(islands, lengths, going, np.full(len(going), island), children, length[:, island], gain)
            among = islands.angle[going, : ISLANDS // 2]
            flat = _Points(*(leaf.reshape(len(going), -1, *leaf.shape[3:]) for leaf in by_angle))
            gain = np.min(among, axis=1, keepdims=True) - flat.angle
            every_length = length.reshape(len(going), -1)
            _keep_best(islands, lengths, going, np.argmax(among, axis=1), flat, every_length, gain)
        yield np.min(islands.angle, axis=1), crossed


def _keep_best(
    islands: _Points,
    lengths: Float[np.ndarray, "lanes islands"],
    going: Int[np.ndarray, " some"],
    island: Int[np.ndarray, " some"],
    children: _Points,
    length: Float[np.ndarray, "some children"],
    gain: Float[np.ndarray, "some children"],
) -> None:
    """Put the child of most gain, and the length of its move, in the place of an island of each lane, if it gains."""
    best, some = np.argmax(gain, axis=1), np.arange(len(going))
    (of,) = np.nonzero(gain[some, best] > 0.0)
    write_rows(islands, (going[of], island[of]), select(children, (of, best[of])))
    lengths[going[of], island[of]] = length[of, best[of]]


def _crossed(scene: _Scene, parents: _Points, children: _Points) -> Bool[np.ndarray, " lanes"]:
    """Return whether a small angle has another sign at a child than at its parent nearby.

    It is that of the volume that directions that grow span with those that shrink, each kind turned as at the parent.
    """

    def volume(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return np.linalg.det(np.nan_to_num(np.swapaxes(first, -1, -2) @ second))  # zero where a parent has none yet

    mine, theirs = parents.directions[:, :, None], children.directions
    kinds = [volume(mine[..., i, :, :], theirs[..., i, :, :]) for i in range(2)]
    signs = [volume(each[..., 0, :, :], each[..., 1, :, :]) for each in (mine, theirs)]
    apart = scene.batch.chart.wrap(parents.target[:, :, None] - children.target) / scene.size[:, None, None]
    small = np.maximum(parents.angle[:, :, None], children.angle) < scene.small[:, None, None]
    aligned = np.minimum(np.abs(kinds[0]), np.abs(kinds[1])) > _ALIGNED
    other = signs[0] * signs[1] * kinds[0] * kinds[1] < 0.0
    return np.any(small & aligned & other & (np.max(np.abs(apart), axis=-1) < _NEARBY), axis=(1, 2))


def _children(
    scene: _Scene, u: Float[np.ndarray, "lanes islands children d"], frames: Float[np.ndarray, "lanes islands d k"]
) -> tuple[_Points, _Points]:
    """Return of motions from points those of least angle, and of most stretch, from n to 2 n returns after."""
    shape, (d, k), n = u.shape[:3], frames.shape[2:], scene.n
    rows = np.repeat(np.arange(len(u)), ISLANDS * CHILDREN)
    frames = np.repeat(frames.reshape(-1, d, k), CHILDREN, axis=0)
    points, at_once, parts = u.reshape(-1, d), max(1, _AT_ONCE // (_PATH * n * d * d)), []
    for first in range(0, len(rows), at_once):
        some = slice(first, first + at_once)
        parts.append(_least_and_steepest(scene.take(rows[some]), points[some], frames[some]))
    return jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]), concatenate(parts))


def _least_and_steepest(
    scene: _Scene, u: Float[np.ndarray, "lanes d"], frames: Float[np.ndarray, "lanes d k"]
) -> tuple[_Points, _Points]:
    (batch, lanes, size, *_), n = scene, scene.n
    path, matrices, sound = _motions_from(scene, u, _PATH * n)
    shear = shear_along_flow(batch, lanes, path, size, ORBIT_TILE) if batch.on_section else None
    angles, stretch, along, directions = directions_along(matrices, frames, scene.j, n, shear)
    known = sound[:, None] & (stretch <= _MOST_STRETCH)
    angles, stretch = np.where(known, angles, np.inf), np.where(known, stretch, -np.inf)
    every, points = np.arange(len(path)), []
    for i in (np.argmin(angles, axis=1), np.argmax(stretch, axis=1)):
        at = (along[i, every], angles[every, i], stretch[every, i], path[every, i + n], directions[i, every])
        points.append(_Points(path[every, i], *at))
    return points[0], points[1]


def _motions_from(
    scene: _Scene, u: Float[np.ndarray, "lanes d"], count: int
) -> tuple[Float[np.ndarray, "lanes count d"], Float[np.ndarray, "lanes count d d"], Bool[np.ndarray, " lanes"]]:
    """Return points, from the given ones on, derivatives of the map there in sizes, and which motions are finite."""
    batch, lanes, size, *_ = scene
    strobe, p, d = batch.strobe(), dict(batch.p), u.shape[1]
    states = lanes.record(strobe, count, (states_at(batch, lanes, u, ORBIT_TILE), p), tile=ORBIT_TILE)
    path = np.concatenate([u[:, None], points_at(batch, lanes, states, ORBIT_TILE)[:, :-1]], axis=1)
    each = {name: np.repeat(values, count) for name, values in p.items()}
    moved = lanes(derivative_and_volume, (strobe,), (path.reshape(-1, d), each), periods=DERIVATIVE, tile=ORBIT_TILE)
    matrices = np.array(jax.tree.leaves(moved)[0]).reshape(len(u), count, d, d)
    matrices = matrices * (size[:, None, None, :] / size[:, None, :, None])
    sound = np.isfinite(matrices).all(axis=(1, 2, 3)) & np.all(np.max(np.abs(matrices), axis=(2, 3)) > 0.0, axis=1)
    return path, np.where(sound[:, None, None, None], matrices, np.eye(d)), sound
