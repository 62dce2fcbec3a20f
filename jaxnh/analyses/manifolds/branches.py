"""Branches of one kind, unstable or stable, of the saddles of all lanes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.analyses.base import OptionError
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.manifolds.curves import (
    Curves,
    ManifoldBranch,
    curves_of,
    distance_from,
    error_of_distance,
    grow,
    positions,
)
from jaxnh.analyses.manifolds.saddles import Germs, Saddles, find_germs, find_orbits, take_orbits
from jaxnh.analyses.options.orbits import ManifoldsOptions
from jaxnh.maps.family import Maps, padded_like
from jaxnh.maps.iterate import section_map
from jaxnh.solvers import AdaptiveMethod, WrittenOutRungeKutta
from jaxnh.solvers.runge_kutta import two_half_steps
from jaxnh.systems.backward_motion import check_jumps
from jaxnh.systems.discrete_map import DiscreteMap
from jaxnh.systems.piecewise_smooth import PiecewiseSmooth

_UNDOES = 1e-5  # sizes: how far from it an inverse map may take a point back

SIDES = (1.0, -1.0)
"""Signs of the direction that the two branches of a germ begin in."""


class Side(NamedTuple):
    """The maps of one kind of manifolds.

    Attributes:
        maps: with the steps that the accuracy asks for, and with finer ones: twice as many, which where events cut them
            are of two halves each.
        backward: whether they are inverse maps, those of stable manifolds.
    """

    maps: tuple[Maps, Maps]
    backward: bool


class BranchSet(NamedTuple):
    """Branches of one kind, of all points of the saddles and both sides of each, in this order.

    Attributes:
        curves: as the steps that the accuracy asks for have them, and finer ones.
        branches: None where the manifold has not one dimension.
        deviation: error across them by the largest distance between both, in sizes, (branches,).
    """

    curves: tuple[Curves, Curves]
    branches: list[ManifoldBranch | None]
    deviation: Float[np.ndarray, " branches"]


def sides_of(options: ManifoldsOptions, batch: LaneBatch) -> dict[int, Side]:
    """Return the maps of the kinds that are asked for."""
    finer, sides = _finer(batch), dict[int, Side]()
    if options.kind != "stable":
        sides[0] = _side(batch.strobe(), finer.strobe(2), backward=False)
    if options.kind != "unstable":
        try:
            sides[1] = _side(batch.inverse(), finer.inverse(2), backward=True)
            check_jumps(batch.flow, batch.p)
        except TypeError as error:
            raise OptionError(f"{error}; stable manifolds need that: take kind: unstable", "kind") from None
    return sides


def _side(maps: Maps, fine: Maps, *, backward: bool) -> Side:
    return Side((padded_like(maps, fine), fine), backward)


def _finer(batch: LaneBatch) -> LaneBatch:
    """Return the batch with steps of two halves each where events cut them, maybe into parts that more steps leave."""
    if not (isinstance(batch.flow, PiecewiseSmooth) and isinstance(batch.solver, WrittenOutRungeKutta)):
        return batch
    return replace(batch, solver=two_half_steps(batch.solver))


def find_saddle_orbits(
    options: ManifoldsOptions, batch: LaneBatch, lanes: LaneRunner, sides: Mapping[int, Side]
) -> tuple[Saddles, Int[np.ndarray, " lanes"], Float[np.ndarray, "lanes d"]]:
    """Return the saddle orbits that are kept, how many each lane has, and the sizes of lanes."""
    orbits, size = find_orbits(batch, lanes, options.period, options.n_starts, options.seed, options.box)
    p, scale = batch.parameters_of(orbits.lane), size[orbits.lane]
    kept = np.zeros(len(orbits.lane), bool)
    for side in sides.values():
        germs = find_germs(batch, lanes, side.maps[0], p, orbits.points, scale, side.backward)
        kept |= has_branches(germs, options.period)
    if 1 in sides:
        _check_inverse(batch, lanes, sides[1], orbits, size)
    number = np.bincount(orbits.lane[kept], minlength=batch.count)
    return take_orbits(orbits, kept, options.saddles), number, size


def _check_inverse(
    batch: LaneBatch, lanes: LaneRunner, side: Side, orbits: Saddles, size: Float[np.ndarray, "lanes d"]
) -> None:
    """Check that an inverse that a map says takes points of its orbits back."""
    if not isinstance(batch.system, DiscreteMap) or not len(orbits.lane):
        return
    last = orbits.points[:, -1]
    back = np.asarray(
        lanes(section_map, (side.maps[0], np.int32(1)), (orbits.points[:, 0], batch.parameters_of(orbits.lane)))
    )
    if not np.max(np.abs(batch.chart.wrap(back - last)) / size[orbits.lane]) < _UNDOES:
        raise OptionError("the map gives no inverse of itself: it does not take a point of an orbit back", "kind")


def grow_branches(
    batch: LaneBatch,
    lanes: LaneRunner,
    side: Side,
    saddles: Saddles,
    size: Float[np.ndarray, "lanes d"],
    length: float,
    spacing: float,
    most: int,
) -> BranchSet:
    """Return all branches of saddles, up to an arc length."""
    p, scale, wrap = batch.parameters_of(saddles.lane), size[saddles.lane], batch.chart.wrap
    germs = [find_germs(batch, lanes, maps, p, saddles.points, scale, side.backward) for maps in side.maps]
    turned = np.sum(germs[0].directions * germs[1].directions, axis=1) < 0.0
    germs[1] = germs[1]._replace(directions=np.where(turned[:, None], -1.0, 1.0) * germs[1].directions)
    n = saddles.points.shape[1]
    each = {name: np.repeat(values, 2 * n) for name, values in p.items()}
    curves, fine = (
        curves_of(maps, each, _both(of_map), n, np.repeat(scale, 2 * n, axis=0), again=again)
        for maps, of_map, again in zip(side.maps, germs, (False, True), strict=True)
    )
    branches = grow(lanes, curves, wrap, length, spacing, most)
    deviation, largest = np.full((2, len(branches)), np.nan)
    known = [b for b, branch in enumerate(branches) if branch is not None]
    if known:
        x = [branch.x[1:] for branch in branches if branch is not None]
        which = np.repeat(known, [len(each) for each in x])
        points = positions(lanes, fine, which, np.concatenate(x))
        for b, part in zip(known, np.split(points, np.cumsum([len(each) for each in x])[:-1]), strict=True):
            branch = branches[b]
            assert branch is not None
            deviation[b] = distance_from(branch, part, curves.size[b], wrap)
            largest[b] = np.max(np.abs(branch.points) / curves.size[b])
        deviation = error_of_distance(deviation, largest)
        if isinstance(batch.flow, PiecewiseSmooth) and isinstance(batch.solver, AdaptiveMethod):
            # Where they pass a corner steps of a lane's own err by chance, finer ones no less than those.
            deviation = np.maximum(deviation, batch.error_estimate)
    return BranchSet((curves, fine), branches, deviation)


def has_branches(germs: Germs, n: int) -> Bool[np.ndarray, " orbits"]:
    """Return which orbits of n points have a manifold of one dimension."""
    return np.all(np.isfinite(germs.multiplier).reshape(-1, n), axis=1)


def _both(germs: Germs) -> Germs:
    """Return each germ twice, with both signs of its direction."""
    twice = Germs(*(np.repeat(leaf, 2, axis=0) for leaf in germs))
    return twice._replace(directions=twice.directions * np.tile(SIDES, len(germs.multiplier))[:, None])
