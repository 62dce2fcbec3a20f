"""Sizes of a motion in each component that errors are compared in, measured on the paths of sample lanes.

The paper's particle has sizes of one, so that its errors are absolute. Of any other system the size of a coordinate is
its largest modulus on the path of a lane, after the first periods: at strobes, and within the last of these. Where a
coordinate runs on, its modulus says nothing of the motion: then its size is what it changes by in a period. Of lanes
in which the coordinate has not come to rest the median counts, as some may be about to escape.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnh.engine.accuracy.first_look import follow
from jaxnh.engine.accuracy.sample_maps import Image, SampleMaps, Samples, image_of
from jaxnh.maps.section import Crossing, Section, System, flow_of
from jaxnh.systems.definition import DefinedFlow
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.rows import select
from jaxnh.systems.state import State, error_components

_FIRST = 17  # periods on the way from the start, in which a motion may be larger than it is later
_SHARE_OF_FIRST = 1e-3  # of the size there: where an attractor is at rest, this is the size that is left
_APART = 2.0  # times what a coordinate changes by in a period: a modulus that may have nothing to do with the motion
_FAR = 10.0  # times that: it has come far where it runs on
_RUNS = 0.5  # of its largest modulus: the way of a coordinate that runs on
_EVENLY = (0.25, 0.75)  # shares of that way of which it has made one at half time
_SAME_RATES = 1e-6  # of what half a turn changes, what a turn of an angle changes in rates
_UNRELATED = 1e-12  # of its size, what rounding leaves between rates
_VANISHES = 1e-13  # of the largest size: below it a coordinate may be nothing but the rounding of others
_NOT_EXACT = 1e-6  # of its size, by which two integrations differ in it where it is
_LESS_EXACT = 100.0  # times what they differ by in others, at least


def coordinate_names(system: System) -> tuple[str, ...]:
    """Names of the components that errors are compared in; on a section the time of the crossing, t, is the last."""
    flow = flow_of(system)
    numbered = image_of(flow.start({name: float(i) for i, name in enumerate(flow.coordinates)}))
    names = tuple(flow.coordinates[int(number)] for number in numbered)
    return (*names, "t") if isinstance(system, Section) else names


def sizes_by_name(system: System, sizes: Float[np.ndarray, " components"]) -> dict[str, float]:
    """Sizes by coordinate; none of a system whose errors are absolute."""
    if flow_of(system).chart.dimensionless:
        return {}
    return dict(zip(coordinate_names(system), sizes.tolist(), strict=True))


def rough_sizes(maps: SampleMaps, start: Image, image: Image) -> Float[np.ndarray, " components"]:
    """Sizes for a first look: moduli at the start and a period later, and of what vanishes a share of the largest."""
    if maps.flow.chart.dimensionless:
        return np.ones(len(start))
    sizes = _median_of_positive(np.maximum(np.abs(np.stack(start)), np.abs(np.stack(image))))
    return _one_for_none(np.maximum(sizes, _VANISHES * np.max(sizes)))


def measure_sizes(
    maps: SampleMaps,
    paths: Samples,
    changes: Float[np.ndarray, "components lanes periods"],
    escaping: Bool[np.ndarray, "lanes periods"],
    given: Mapping[str, float],
) -> Float[np.ndarray, " components"]:
    """Sizes of the motion of sample lanes.

    Args:
        paths: their states (lanes, periods).
        changes: by what twice the steps change the end of each period.
        escaping: periods of lanes that go to infinity, which do not count.
        given: sizes by coordinate, in place of those measured.
    """
    system = maps.flows[0]
    if maps.flow.chart.dimensionless:
        return np.ones(len(changes))
    values = np.where(escaping, np.nan, np.stack(image_of(paths.states)))
    moduli, later = np.abs(values), ~np.all(escaping[:, _FIRST:], axis=1)
    whole = _largest(moduli)
    own = np.where(later, _largest(moduli[..., _FIRST:]), whole)
    moves = own >= _SHARE_OF_FIRST * whole
    sizes = _median_of_positive(np.where(moves | ~moves.any(axis=1, keepdims=True), own, np.nan))
    steps = _median_of_positive(_largest(np.abs(np.diff(values, axis=2))))
    length = float(steps[-1]) if maps.sectioned else None
    last = escaping.shape[1] - 1 - np.argmin(escaping[:, ::-1], axis=1)
    within, ways = _within_periods(maps, paths, escaping, last, length)
    sizes, at_first = np.maximum(sizes, within), _median_of_positive(whole)
    if maps.sectioned and np.any(sizes < _SHARE_OF_FIRST * np.max(sizes)):
        # What a section fixes is nothing but rounding at all crossings: what it was at first is seen between them.
        at_first = np.maximum(at_first, _within_periods(maps, paths, escaping, np.zeros_like(last), length)[0])
    sizes = np.maximum(sizes, _SHARE_OF_FIRST * at_first)
    steps = np.maximum(steps, ways)
    for i in np.flatnonzero((sizes > _APART * steps) & (steps > 0.0)):
        far = sizes[i] > _FAR * steps[i]
        if (far and _runs(values[i])) or (sizes[i] > math.pi and _is_free(maps, paths, escaping, int(i))):
            sizes[i] = steps[i]
    if maps.sectioned:
        sizes[-1] = steps[-1]
    sizes = np.where(_is_rounding(sizes, changes), np.max(sizes), _one_for_none(sizes))
    for component, name in enumerate(coordinate_names(system)):
        sizes[component] = given.get(name, 1.0 if name in _angles(maps.flow) else sizes[component])
    return sizes


def _within_periods(
    maps: SampleMaps,
    paths: Samples,
    escaping: Bool[np.ndarray, "lanes periods"],
    number: Int[np.ndarray, " lanes"],
    length: float | None,
) -> tuple[Float[np.ndarray, " components"], Float[np.ndarray, " components"]]:
    """Largest moduli and ways of the components within one period of each lane; zero of the time of a crossing.

    At strobes alone a coordinate may vanish, or be at rest.
    """
    kept = np.flatnonzero(~np.all(escaping, axis=1))
    picked = paths.take_lanes(kept)
    at = picked._replace(states=select(picked.states, (np.arange(len(kept)), number[kept])))
    if not len(kept):
        return np.zeros(len(coordinate_names(maps.flows[0]))), np.zeros(len(coordinate_names(maps.flows[0])))
    passage = follow(maps, at, length)
    through = passage.arrived >= 1.0
    moduli, ways = (_median_of_positive(part[through].T) for part in (passage.moduli, passage.ways))
    time = np.zeros(int(maps.sectioned))
    return np.concatenate([moduli, time]), np.concatenate([ways, time])


def _largest(of_lanes: Float[np.ndarray, "components lanes periods"]) -> Float[np.ndarray, "components lanes"]:
    """The largest of each lane; zero where there is none that is finite."""
    return np.max(of_lanes, axis=2, initial=0.0, where=np.isfinite(of_lanes))


def _median_of_positive(of_lanes: Float[np.ndarray, "components lanes"]) -> Float[np.ndarray, " components"]:
    """Median over the lanes that have a finite one above zero; zero where none has."""
    kept = [row[np.isfinite(row) & (row > 0.0)] for row in of_lanes]
    return np.array([np.median(row) if len(row) else 0.0 for row in kept])


def _one_for_none(sizes: Float[np.ndarray, " components"]) -> Float[np.ndarray, " components"]:
    return np.where((sizes > 0.0) & np.isfinite(sizes), sizes, 1.0)


def _angles(flow: Flow) -> frozenset[str]:
    """Coordinates that the user has called angles: their errors are in radians."""
    if not isinstance(flow, DefinedFlow):
        return frozenset()
    return frozenset(name for name, angle in zip(flow.names, flow.angles, strict=True) if angle)


def _runs(values: Float[np.ndarray, "lanes periods"]) -> bool:
    """Return whether a coordinate of most lanes goes on and on: as a clock, or the place of what travels."""
    way, halfway = values[:, -1] - values[:, 0], values[:, values.shape[1] // 2] - values[:, 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = halfway / way
        far = np.abs(way) > _RUNS * np.max(np.abs(values), axis=1)
    return bool(2 * np.count_nonzero(far & (share > _EVENLY[0]) & (share < _EVENLY[1])) > len(values))


def _is_free(maps: SampleMaps, paths: Samples, escaping: Bool[np.ndarray, "lanes periods"], component: int) -> bool:
    """Return whether a turn of a coordinate changes no rate: it is an angle, or does not enter at all."""
    leaves, structure = jax.tree.flatten(paths.states)
    if component >= len(coordinate_names(maps.flow)):
        return False
    rates = []
    for turned in (0.0, math.pi, 2 * math.pi):
        moved = [leaf + turned if i == component else leaf for i, leaf in enumerate(leaves)]
        moved_paths = paths._replace(states=jax.tree.unflatten(structure, moved))
        rates.append(np.where(escaping, np.nan, _rates_on(maps, moved_paths)))
    first, half, whole = rates
    by_half, by_turn, own = (
        np.max(_largest(np.abs(difference)), axis=1) for difference in (half - first, whole - first, first)
    )
    return bool(np.all(by_turn <= _SAME_RATES * by_half + _UNRELATED * own))


def _is_rounding(
    sizes: Float[np.ndarray, " components"], changes: Float[np.ndarray, "components lanes periods"]
) -> Bool[np.ndarray, " components"]:
    """Return which coordinates are but the rounding of larger ones: tiny, and of far fewer digits that are right."""
    apart = [np.median(row[np.isfinite(row)]) if np.any(np.isfinite(row)) else 0.0 for row in changes]
    relative = np.array(apart) / _one_for_none(sizes)
    tiny = (sizes > 0.0) & (sizes < _VANISHES * np.max(sizes))
    others = np.max(relative, initial=0.0, where=~tiny)
    return tiny & (relative > max(_NOT_EXACT, _LESS_EXACT * others))


def _rates_on(maps: SampleMaps, paths: Samples) -> Float[np.ndarray, "components lanes periods"]:
    """Rates of the components at states of paths; with a clock these are at t = 0."""
    return np.stack(jax.tree.leaves(maps.by_flow(_rates, lambda row: (maps.flows[row],), paths, 0)))


def _rates(system: System, states: State, p: Parameters) -> State:
    """Rates of the components at states of one lane."""

    def rates(y: State) -> tuple[Array, ...]:
        inner = y.state if isinstance(system, Section) and isinstance(y, Crossing) else y
        rate = error_components(flow_of(system).rhs(jnp.zeros_like(inner[0][0]), inner, p))
        time = (jnp.ones_like(y.t),) if isinstance(y, Crossing) else ()
        return *jax.tree.leaves(rate), *time

    return jax.vmap(rates)(states)
