"""First orbits of the branches that cross another one at a bifurcation: doubled ones, and those of a branch point."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from jaxnh.orbits.continuation.arclength import CurveOrbits, Family, PathVector, correct, inner, length, times
from jaxnh.orbits.continuation.core import FINE
from jaxnh.systems.rows import select, write_rows

# Lengths are in sizes of most lanes' motion: an orbit that is thirty times as small bends so much sooner.
_AWAY = (4e-3, 1e-3, 2.5e-4, 6e-5, 1.5e-5)  # from the bifurcation, in lengths, tried in this order
_STRAIGHT = 0.99  # cosine of the angle between the curve there and the direction it sets out in
_BENT = 0.5  # of that, that Newton may go


def doubled_orbits(family: Family, orbits: CurveOrbits, vectors: Float[np.ndarray, "some n d"]) -> CurveOrbits:
    """Orbits of 2n points at doublings: one side of each, as the other has the same orbits, n points later.

    Args:
        family: the map.
        orbits: at the doublings.
        vectors: that come back reversed, of length one in sizes of the motion.
    """
    way = PathVector(family.size * np.concatenate([vectors, -vectors], axis=1), np.zeros(len(vectors)))
    twice = PathVector(np.concatenate([orbits.points, orbits.points], axis=1), orbits.value)
    return _nearby_orbits(family, twice, way)


def crossing_orbits(family: Family, orbits: CurveOrbits, sign: float) -> CurveOrbits:
    """Orbits on one side of the branch that crosses the one of these orbits at branch points."""
    return _nearby_orbits(
        family, PathVector(orbits.points, orbits.value), times(np.full(len(orbits.value), sign), orbits.other_way)
    )


def _nearby_orbits(family: Family, at: PathVector, way: PathVector) -> CurveOrbits:
    """The nearest orbits that lie along ways from others, where there are some."""
    way = times(1.0 / length(family, way), way)
    nearby, left = _orbits_at_distance(family, at, way, _AWAY[0]), np.arange(len(at.value))
    for away in _AWAY[1:]:
        left = left[~nearby.converged[left]]
        if not len(left):
            break
        origin, direction = select((at, way), left)
        nearer = _orbits_at_distance(family, origin, direction, away)
        write_rows(nearby, left, nearer)
    return nearby


def _orbits_at_distance(family: Family, at: PathVector, way: PathVector, away: float) -> CurveOrbits:
    """The orbits so far along ways, converged where the curve still sets out in their directions."""
    orbits = correct(family, at.points + away * way.points, at.value + away * way.value, way, FINE)
    with np.errstate(invalid="ignore"):
        good = orbits.converged & (orbits.missed <= _BENT * away) & (inner(family, orbits.way, way) >= _STRAIGHT)
    return orbits._replace(converged=good)
