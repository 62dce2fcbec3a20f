"""First orbits of the branches that cross another one at a bifurcation: doubled ones, and those of a branch point."""

from __future__ import annotations

import jax
import numpy as np
from jaxtyping import Float

from jaxnh.orbits.arclength import FINE, Family, Orbits, Way, correct, inner, length, times

_AWAY = (4e-3, 1e-3, 2.5e-4)  # from the bifurcation, in lengths, tried in this order
_STRAIGHT = 0.99  # cosine of the angle between the curve there and the direction it sets out in
_BENT = 0.5  # of that, that Newton may go


def doubled(family: Family, orbits: Orbits, vectors: Float[np.ndarray, "some n d"]) -> Orbits:
    """Orbits of 2n points at doublings: one side of each, as the other has the same orbits, n points later.

    Args:
        family: the map.
        orbits: at the doublings.
        vectors: that come back reversed, of length one in sizes of the motion.
    """
    way = Way(family.size * np.concatenate([vectors, -vectors], axis=1), np.zeros(len(vectors)))
    twice = Way(np.concatenate([orbits.points, orbits.points], axis=1), orbits.value)
    return _beside(family, twice, way)


def crossing(family: Family, orbits: Orbits, sign: float) -> Orbits:
    """Orbits on one side of the branch that crosses the one of these orbits at branch points."""
    return _beside(family, Way(orbits.points, orbits.value), times(np.full(len(orbits.value), sign), orbits.other_way))


def _beside(family: Family, at: Way, way: Way) -> Orbits:
    """The nearest orbits that lie along ways from others, where there are some."""
    way = times(1.0 / length(family, way), way)
    found: Orbits | None = None
    for away in _AWAY:
        tried = correct(family, at.points + away * way.points, at.value + away * way.value, way, FINE)
        with np.errstate(invalid="ignore"):
            good = tried.converged & (tried.missed <= _BENT * away) & (inner(family, tried.way, way) >= _STRAIGHT)
        tried = tried._replace(converged=good)
        if found is None:
            found = tried
            continue
        new = good & ~found.converged
        for leaf, other in zip(jax.tree.leaves(found), jax.tree.leaves(tried), strict=True):
            leaf[new] = other[new]
    assert found is not None
    return found
