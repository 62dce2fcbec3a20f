"""Lanes to attractors over a whole sweep: which lanes are alike, which of them are judged, and which are on what.

Host code over what lanes and attractors have left; `point` says everywhere which value of the parameters a lane is at,
as lanes at different ones have nothing to do with each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.analyses.attractors import (
    EQUILIBRIUM,
    NONE,
    PERIODIC,
    Judged,
    filled_up,
    followed,
    judge,
    scene_from,
    stays_near,
)
from jaxnh.analyses.looks import angles
from jaxnh.analyses.scene import LaneRunner, Scene, picked
from jaxnh.analyses.settling import OPEN, RESTLESS, SETTLED, Lot, go_on
from jaxnh.systems.flow import Flow

_MOST_CLUSTERS = 64  # of a value of the parameters, that are judged at once
_SEEDS = 4  # of restless lanes, likewise
_SAME_ORBIT = 1e-6  # of the largest motion of the sweep


class Found(NamedTuple):
    """Attractors of lanes.

    Attributes:
        number: of every lane's attractor in `attractors`, −1 where there is none, (lanes,).
        point: of every attractor, (attractors,).
        attractors: what they are; None where there are none.
    """

    number: Int[np.ndarray, " lanes"]
    point: Int[np.ndarray, " attractors"]
    attractors: Judged | None


def find(
    scene: Scene, lanes: LaneRunner, lot: Lot, point: Int[np.ndarray, " lanes"], limit: int, longest: int
) -> Found:
    """The attractors of lanes that have been run by themselves; those on none yet go on, in place, while they may.

    Args:
        point: numbers of the values of the parameters that lanes are at, (lanes,).
        limit: period looked for, at most.
        longest: periods that a lane may take.
    """
    found = Found(np.full(scene.count, -1), np.zeros(0, int), None)
    while True:
        match(scene, lanes, lot, point, found)
        seeds, cluster = _representatives(lot, point, found.number)
        if len(seeds):
            here = scene_from(scene.take(seeds), lanes, lot.u[seeds])
            judged = judge(here, lanes, picked(lot, seeds), limit)
            largest = np.nanmax(np.abs(lot.size), axis=0, initial=0.0)
            found, place = _added(here, lanes, found, judged, point[seeds], largest)
            mine = np.flatnonzero((cluster >= 0) & (found.number < 0))
            found.number[mine] = place[cluster[mine]]
            match(scene, lanes, lot, point, found)
        left = (found.number < 0) & np.isin(lot.known, (SETTLED, RESTLESS))
        some = np.flatnonzero(left & (2 * lot.time <= longest))
        if not len(some):
            lot.known[left] = OPEN
            return found
        with lanes.stage(f"basins: {len(some):,} lanes longer", float(lot.time[some].sum())):
            go_on(scene, lanes, lot, some, longest)


def match(scene: Scene, lanes: LaneRunner, lot: Lot, point: Int[np.ndarray, " lanes"], found: Found) -> None:
    """Numbers of the attractors of lanes that have none yet, in place, where there is one that fits.

    Lanes that have settled have its means; restless ones stay near its points.
    """
    if found.attractors is None:
        return
    restless = np.flatnonzero((found.number < 0) & (lot.known == RESTLESS))
    paths = followed(scene.take(restless), lanes, lot.u[restless]) if len(restless) else np.empty(0)
    of_point = np.argsort(found.point, kind="stable")
    for k in of_point.tolist():
        one: Judged = jax.tree.map(lambda leaf, k=k: leaf[k], found.attractors)
        settled = np.flatnonzero((found.number < 0) & (point == found.point[k]) & (lot.known == SETTLED))
        fits = np.all(np.abs(lot.means[settled] - one.means) <= lot.unit[settled] + one.unit, axis=1)
        found.number[settled[fits]] = k
        here = np.flatnonzero((found.number[restless] < 0) & (point[restless] == found.point[k]))
        if len(here):
            found.number[restless[here[_near(scene, one, paths[here])]]] = k


def _near(scene: Scene, one: Judged, paths: Float[np.ndarray, "lanes followed d"]) -> Bool[np.ndarray, " lanes"]:
    """Whether paths stay near an attractor."""
    edge = one.near * np.where(one.size > 0.0, one.size, 1.0)
    return stays_near(angles(scene.system), paths, one.points, edge)


def _representatives(
    lot: Lot, point: Int[np.ndarray, " lanes"], number: Int[np.ndarray, " lanes"]
) -> tuple[Int[np.ndarray, " seeds"], Int[np.ndarray, " lanes"]]:
    """Lanes to be judged: the first of each cluster of those that have settled, and some restless ones.

    Returns:
        Their numbers, and for every lane the place among them of the one of its cluster, −1 where it is in none.
    """
    cluster, seeds = np.full(len(point), -1), list[int]()
    open_ = np.flatnonzero((number < 0) & (lot.known == SETTLED))
    for _ in range(_MOST_CLUSTERS):
        if not len(open_):
            break
        points, first = np.unique(point[open_], return_index=True)
        leaders = open_[first]
        of = np.searchsorted(points, point[open_])
        mine = leaders[of]
        alike = np.all(np.abs(lot.means[open_] - lot.means[mine]) <= lot.unit[open_] + lot.unit[mine], axis=1)
        cluster[open_[alike]] = len(seeds) + of[alike]
        seeds += leaders.tolist()
        open_ = open_[~alike]
    restless = np.flatnonzero((number < 0) & (lot.known == RESTLESS))
    for at in np.unique(point[restless]):
        here = restless[point[restless] == at]
        seeds += here[np.unique(np.linspace(0, len(here) - 1, _SEEDS).round().astype(int))].tolist()
    return np.array(seeds, int), cluster


def _added(
    scene: Scene,
    lanes: LaneRunner,
    found: Found,
    judged: Judged,
    point: Int[np.ndarray, " reps"],
    largest: Float[np.ndarray, " d"],
) -> tuple[Found, Int[np.ndarray, " reps"]]:
    """Attractors with those that are new, and for every representative the number of its own, −1 where it is none."""
    place = np.full(len(point), -1)
    new: list[int] = []
    before = 0 if found.attractors is None else len(found.point)
    for k in range(len(point)):
        if judged.kind[k] == NONE:
            continue
        one: Judged = jax.tree.map(lambda leaf, k=k: leaf[k], judged)
        if before:
            assert found.attractors is not None
            same = _same(scene.take(slice(k, k + 1)), lanes, one, found.attractors, largest, found.point == point[k])
            if np.any(same):
                place[k] = int(np.argmax(same))
                continue
        if new:
            others = picked(judged, np.array(new))
            same = _same(scene.take(slice(k, k + 1)), lanes, one, others, largest, point[new] == point[k])
            if np.any(same):
                place[k] = before + int(np.argmax(same))
                continue
        place[k] = before + len(new)
        new.append(k)
    added = picked(judged, np.array(new, int))
    if found.attractors is None:
        return Found(found.number, point[new], added if new else None), place
    both = joined([found.attractors, added])
    return Found(found.number, np.concatenate([found.point, point[new]]), both), place


def joined(parts: Sequence[Judged]) -> Judged:
    """Attractors of several parts, one after the other, with as many points each."""
    most = max(part.points.shape[1] for part in parts)
    even = [part._replace(points=filled_up(part.points, most)) for part in parts]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *even)


def _same(
    scene: Scene,
    lanes: LaneRunner,
    one: Judged,
    others: Judged,
    largest: Float[np.ndarray, " d"],
    here: Bool[np.ndarray, " others"],
) -> Bool[np.ndarray, " others"]:
    """Which of some attractors at the same point another one is: orbits have a point in common, others stay near it."""
    if one.kind in (PERIODIC, EQUILIBRIUM):
        return same_orbits(scene.system, one, others, largest) & here
    alike = (others.kind == one.kind) & here
    for k in np.flatnonzero(alike):
        other: Judged = jax.tree.map(lambda leaf, k=k: leaf[k], others)
        alike[k] = bool(_near(scene, other, followed(scene, lanes, one.u[None]))[0])
    return alike


def same_orbits(
    system: Flow, one: Judged, others: Judged, largest: Float[np.ndarray, " d"]
) -> Bool[np.ndarray, " others"]:
    """Which of some attractors are an equilibrium or an orbit that has these kind, period and point `u`."""
    turns = int(one.period)
    points = others.points[:, :turns] if turns else others.u[:, None]
    apart = np.abs(system.wrap(points - one.u))
    alike = (others.kind == one.kind) & (others.period == one.period)
    return alike & np.any(np.all(apart <= same_within(largest), axis=-1), axis=1)


def same_within(largest: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
    """How far apart points of one orbit are at most, with the largest motion of a sweep."""
    return _SAME_ORBIT * np.where(largest > 0.0, largest, 1.0)
