"""Orbits in the attractor, and the kind of the one of least period, that carries it.

Distances are in sizes of the motion, angles on their circle. An orbit lies in the attractor where each of its points is
as near to the motion as its own points are to one another: nearer than 99 in 100 of them to the next one. It lies
outside where it is more than four times further than any, and than so many points come near to a saddle inside by its
multipliers. In between the unstable leaves of the motion, which belong to the attractor, decide where they come as near
to it (`unstable_leaves`); else neither is said, as the motion may come so near only after longer. A saddle whose
nearest points of the motion all lie on one side of its stable manifold may be one that the attractor only comes near
to, as before a crisis: it is inside where leaves come much nearer than points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from jaxnh.analyses.base import LANE, Entry, flag, number_variable, variable
from jaxnh.analyses.batch import LaneRunner
from jaxnh.analyses.orbits.scenarios import SCENARIOS, CarrierChart, scenarios
from jaxnh.analyses.orbits.search import map_of_lanes
from jaxnh.analyses.orbits.tables import LaneOrbits, gather, rows_of
from jaxnh.analyses.orbits.unstable_leaves import is_beside, leaf_distances
from jaxnh.analyses.periodic.location import refined_maps
from jaxnh.maps.iterate import section_map
from jaxnh.systems.rows import select

PLACES = ("unknown", "inside", "outside", "undecided")
"""Meanings of the flags 0 to 3 of `place`."""

CARRIERS = (
    "none", "stable", "saddle", "flip_saddle", "stable_focus_saddle", "unstable_focus_saddle", "discrete_lorenz",
    "repelling", "undecided",
)  # fmt: skip
"""Meanings of the flags 0 to 8 of `carrier`."""

_TYPICAL, _FAR = 0.99, 4.0
_NEARER = 0.1  # of the distance from points, that leaves come to where they come to the saddle
_TILE = 16  # lanes: of a piece of a leaf there are few points
_CLOSE = 1e-6  # sizes: an orbit this near is one that the motion has come to


class Places(NamedTuple):
    """The places of orbits of n returns, in the order of `Search.cycles`.

    Attributes:
        distance: largest of the distances of the points of an orbit to the motion, in sizes of the motion, (cycles,).
        place: number in `PLACES`, (cycles,).
        near: whether it is as near to the motion as all of the motion's points are to the next one, (cycles,).
    """

    distance: Float[np.ndarray, " cycles"]
    place: Int[np.ndarray, " cycles"]
    near: Bool[np.ndarray, " cycles"]


def places_of_orbits(
    part: LaneOrbits, lanes: LaneRunner, motion: Float[np.ndarray, "lanes points d"]
) -> dict[int, Places]:
    """Return where the orbits of a batch are, by number of returns, beside motions that have settled."""
    from scipy.spatial import KDTree  # here, as it takes a tenth of a second to import

    batch = part.batch
    angles = np.array(batch.chart.angles)
    trees: dict[int, KDTree] = {}
    typical, largest = (np.full(batch.count, np.nan) for _ in range(2))
    for lane in np.flatnonzero(np.isfinite(motion).all(axis=(1, 2))).tolist():
        cloud = _on_circles(motion[lane], part.search.size[lane], angles)
        trees[lane] = KDTree(cloud)
        spacing = trees[lane].query(cloud, k=2)[0][:, 1]
        typical[lane], largest[lane] = np.quantile(spacing, _TYPICAL), np.max(spacing)
    places: dict[int, Places] = {}
    for n, measured in part.measured.items():
        lane = part.search.cycles[n].lane
        distance = np.full(len(lane), np.nan)
        for i, number in enumerate(lane):
            if number in trees and np.isfinite(measured.points[i]).all():
                points = _on_circles(measured.points[i], part.search.size[number], angles)
                distance[i] = np.max(trees[number].query(points)[0])
        nearest = np.maximum(largest[lane], _nearest_passage(measured.multipliers, motion.shape[1]))
        conditions = [
            ~np.isfinite(distance),
            distance <= np.maximum(typical[lane], _CLOSE),
            distance > np.maximum(_FAR * nearest, _CLOSE),
        ]
        near = distance <= np.maximum(largest[lane], _CLOSE)
        of_points = Places(distance, np.select(conditions, [0, 1, 2], 3), near)
        places[n] = _by_leaves(part, lanes, motion, n, of_points, np.maximum(typical[lane], _CLOSE))
    return places


def _by_leaves(
    part: LaneOrbits,
    lanes: LaneRunner,
    motion: Float[np.ndarray, "lanes points d"],
    n: int,
    places: Places,
    typical: Float[np.ndarray, " cycles"],
) -> Places:
    """Return the places with those of saddles that an unstable leaf of the motion comes to, or should and does not."""
    measured, batch = part.measured[n], part.batch
    modulus, error = np.abs(measured.multipliers), measured.multipliers_error
    single = (modulus[:, 0] > 1.0 + error[:, 0]) & np.all(modulus[:, 1:] < 1.0 - error[:, 1:], axis=1)
    undecided, inside = (places.place == PLACES.index(word) for word in ("undecided", "inside"))
    saddles = np.flatnonzero(single & (undecided | (inside & (places.distance > _CLOSE))))
    if not len(saddles) or batch.chart.dimension == 1:
        return places
    strobe, p = refined_maps(batch)[0], dict(batch.p)
    period, of_orbits = map_of_lanes(batch, lanes, strobe), part.search.cycles[n].lane[saddles]
    of_lanes = motion[of_orbits], measured.points[saddles], of_orbits, part.search.size[of_orbits]
    asked = undecided[saddles] | is_beside(period, batch.chart, *of_lanes)
    open_ = saddles[asked]
    if not len(open_):
        return places
    wanted = np.where(undecided, typical, _NEARER * places.distance)[open_]

    def image(u: Float[np.ndarray, "points d"], lane: Int[np.ndarray, " points"]) -> Float[np.ndarray, "points d"]:
        return np.asarray(lanes(section_map, (strobe, np.int32(1)), (u, select(p, lane)), tile=_TILE))

    moving, points, lane, size = (values[asked] for values in of_lanes)
    of_leaves = leaf_distances(period, image, batch.chart, moving, points, lane, size, wanted)
    distance, place, near = places.distance.copy(), places.place.copy(), places.near.copy()
    distance[open_] = np.minimum(distance[open_], of_leaves)
    place[open_] = np.where(of_leaves <= wanted, PLACES.index("inside"), PLACES.index("undecided"))
    near[open_[of_leaves <= wanted]] = True
    return Places(distance, place, near)


def _nearest_passage(multipliers: Complex[np.ndarray, "cycles d"], count: int) -> Float[np.ndarray, " cycles"]:
    """Return how near to a saddle with one unstable multiplier the nearest of its attractor's points is, in sizes.

    A motion comes within ε where it enters within ε |μ1|^−k of the stable manifold, with |μ2|^k = ε: of `count` points
    the nearest is at count^(−1/D), D = 1 + ln |μ1| / −ln |μ2|. Zero for orbits of another kind.
    """
    modulus = np.abs(multipliers)
    leading, next_ = modulus[:, 0], np.max(modulus[:, 1:], axis=1, initial=0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        dimension = 1.0 - np.log(leading) / np.log(next_)
        return np.where((leading > 1.0) & (next_ < 1.0), count ** (-1.0 / dimension), 0.0)


def _on_circles(
    u: Float[np.ndarray, "points d"], size: Float[np.ndarray, " d"], angles: Bool[np.ndarray, " d"]
) -> Float[np.ndarray, "points k"]:
    """Return points in sizes of the motion, each angle as a point of a circle."""
    turned = u[:, angles]
    return np.concatenate([u[:, ~angles] / size[~angles], np.cos(turned), np.sin(turned)], axis=1)


def place_variables(
    parts: Sequence[LaneOrbits], places: Sequence[Mapping[int, Places]], count: int
) -> dict[str, Entry]:
    """Return distances and places over (lane, orbit)."""
    rows = [(row, of_part[row.n]) for part, of_part in zip(parts, places, strict=True) for row in rows_of(part)]
    every = [row for row, _ in rows]
    distance = gather(every, [carrier.distance for _, carrier in rows], count, np.nan)
    place = gather(every, [carrier.place for _, carrier in rows], count, 0)
    words = "largest distance of a point of the orbit from the motion, in sizes of the motion"
    return {
        "distance": variable((LANE, "orbit"), distance, words),
        "place": flag((LANE, "orbit"), place.astype(int), "whether the orbit lies in the attractor", PLACES),
    }


def carrier_variables(
    parts: Sequence[LaneOrbits],
    places: Sequence[Mapping[int, Places]],
    axes: Sequence[Float[np.ndarray, " values"]],
) -> dict[str, Entry]:
    """Return the period, the unstable multipliers and the kind of the orbit that carries each attractor, and scenarios.

    Args:
        axes: values along the axes of the sweep.
    """
    least = least_orbits(parts, places, int(np.prod([len(values) for values in axes])))
    chart = CarrierChart(
        least.period, [CARRIERS[kind] for kind in least.carrier], least.flips, least.turns, least.focus
    )
    words = "of the orbit of least period in the attractor"
    return {
        "least_period": number_variable(LANE, least.period.astype(np.int32), f"period, in returns, {words}", ("none",)),
        "least_unstable": variable(LANE, least.unstable.astype(np.int32), f"number of unstable multipliers {words}"),
        "carrier": flag(LANE, least.carrier, f"kind {words}", CARRIERS),
        "scenario": flag(LANE, scenarios(chart, axes), "scenario by which chaos has come about", SCENARIOS),
    }


class LeastOrbits(NamedTuple):
    """The orbits of least period in the attractors of lanes.

    Attributes:
        period: in returns; 0 where none is known to lie in it, (lanes,).
        unstable: number of its multipliers beyond the unit circle, (lanes,).
        carrier: number in `CARRIERS`, (lanes,).
        flips, turns, focus: as `CarrierChart` has them, (lanes,).
    """

    period: Int[np.ndarray, " lanes"]
    unstable: Int[np.ndarray, " lanes"]
    carrier: Int[np.ndarray, " lanes"]
    flips: Bool[np.ndarray, " lanes"]
    turns: Bool[np.ndarray, " lanes"]
    focus: Int[np.ndarray, " lanes"]


def least_orbits(parts: Sequence[LaneOrbits], places: Sequence[Mapping[int, Places]], count: int) -> LeastOrbits:
    """Return the orbit of least period inside the attractor of each lane; of several the most unstable one."""
    period, unstable, carrier, focus = (np.zeros(count, int) for _ in range(4))
    flips, turns = np.zeros(count, bool), np.zeros(count, bool)
    for part, by_returns in zip(parts, places, strict=True):
        for n in sorted(by_returns, reverse=True):
            measured, lane = part.measured[n], part.search.cycles[n].lane
            modulus = np.abs(measured.multipliers)
            order = np.argsort(modulus[:, 0], kind="stable")
            for i in order:
                number, place = part.numbers[lane[i]], PLACES[by_returns[n].place[i]]
                if place == "inside":
                    period[number] = n
                    unstable[number] = np.count_nonzero(modulus[i] > 1.0)
                    kind = _kind(measured.multipliers[i], measured.multipliers_error[i])
                    carrier[number] = CARRIERS.index(kind)
                    flips[number], turns[number] = _leading(measured.multipliers[i], measured.multipliers_error[i])
                elif place == "undecided":
                    period[number], unstable[number] = 0, 0
                    carrier[number] = CARRIERS.index("undecided")
                elif place == "outside" and _is_focus(measured.multipliers[i], measured.multipliers_error[i]):
                    focus[number] = n
    return LeastOrbits(period, unstable, carrier, flips, turns, focus)


def _leading(multipliers: Complex[np.ndarray, " d"], error: Float[np.ndarray, " d"]) -> tuple[bool, bool]:
    """Return whether one multiplier alone is beyond the unit circle, below −1, and whether the largest are a pair."""
    largest = int(np.argmax(np.abs(multipliers)))
    alone = np.count_nonzero(np.abs(multipliers) > 1.0) == 1
    turns = bool(np.abs(np.imag(multipliers[largest])) > error[largest])
    return alone and not turns and bool(np.real(multipliers[largest]) < -1.0), turns


def _is_focus(multipliers: Complex[np.ndarray, " d"], error: Float[np.ndarray, " d"]) -> bool:
    """Return whether a complex pair alone is beyond the unit circle."""
    return np.count_nonzero(np.abs(multipliers) > 1.0) == 2 and _leading(multipliers, error)[1]


def _kind(multipliers: Complex[np.ndarray, " d"], error: Float[np.ndarray, " d"]) -> str:
    """Name an orbit by its multipliers; one on the unit circle within its error leaves it undecided.

    Of three, μ1 < −1 < μ3 < 0 < μ2 < 1 with |μ3| < μ2 and |μ1| μ2 > 1 is the saddle of a discrete Lorenz attractor
    (Gonchenko, Ovsyannikov, Simó and Turaev, Int. J. Bifurcation Chaos 15 (2005) 3493). What constraints, norms and
    levels add to them are zeros, and counted out.
    """
    modulus = np.abs(multipliers)
    beyond = modulus > 1.0
    if np.any(np.abs(modulus - 1.0) <= error):
        return "undecided"
    if not beyond.any():
        return "stable"
    if beyond.all():
        return "repelling"
    turns = np.abs(np.imag(multipliers)) > error
    if turns[beyond].any():
        return "unstable_focus_saddle"
    leading = np.real(multipliers[beyond])
    if len(leading) == 1 and leading[0] < 0 and not turns.any():
        inner = np.real(multipliers[~beyond & (modulus > error)])
        if len(inner) == 2 and inner[0] > 0 > inner[1] and -leading[0] * inner[0] > 1.0:
            return "discrete_lorenz"
    if turns.any():
        return "stable_focus_saddle"
    return "flip_saddle" if (leading < 0).any() else "saddle"
