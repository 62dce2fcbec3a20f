"""Images of periodic orbits under a symmetry of the system that changes the signs of coordinates.

The image of an orbit is an orbit, of the same returns and multipliers: of each pair both are known once one is.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.base import OptionError
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.orbits.search import Search, newton
from jaxnh.analyses.section_points import points_at, states_at
from jaxnh.maps.family import Maps
from jaxnh.maps.section import Crossing
from jaxnh.orbits.recognition import Cycles, equal_cycles, merge_cycles
from jaxnh.systems.flow import Flow
from jaxnh.systems.reversal import component_names, signed_names
from jaxnh.systems.rows import concatenate


def check_signs(flow: Flow, names: Sequence[str]) -> None:
    """Check that signs of such coordinates may be changed; where velocities follow from positions, of these alone."""
    for name in names:
        if name not in signed_names(flow):
            known = ", ".join(signed_names(flow))
            raise OptionError(f"a symmetry changes signs of {known}, and there is no {name}", "symmetry")


def add_images(known: Search, batch: LaneBatch, lanes: LaneRunner, strobe: Maps, names: Sequence[str]) -> Search:
    """Return the orbits with the images of all, and which the image of each is.

    Raises:
        OptionError: the image of an orbit is no orbit, so that the signs are no symmetry of the system and its section.
    """
    cycles, images, wrap = dict(known.cycles), dict[int, Int[np.ndarray, " cycles"]](), batch.chart.wrap
    for n, orbits in known.cycles.items():
        images[n] = np.arange(len(orbits.lane))
        if not len(orbits.lane):
            continue
        turned = _images(orbits.points, batch, lanes, names)
        more = [
            new for new in newton(batch, lanes, strobe, turned, orbits.lane, known.size) if new.points.shape[1] == n
        ]
        if more:
            cycles[n] = merge_cycles(orbits, concatenate(more), known.size, wrap, sample=False)
        count, turned = len(cycles[n].lane), _images(cycles[n].points, batch, lanes, names)
        lane = np.tile(cycles[n].lane, 2)
        label = equal_cycles(lane, np.concatenate([cycles[n].points, turned]), known.size[lane], wrap)[count:]
        if np.any(label >= count):
            raise OptionError(f"signs of {', '.join(names)} are no symmetry: the image of an orbit is none", "symmetry")
        images[n] = label
    return known._replace(cycles=cycles, images=images)


def distinct(cycles: Cycles, image: Int[np.ndarray, " cycles"], lane: int) -> int:
    """Return the number of orbits of a lane of which none is the image of another."""
    own = cycles.lane == lane
    return int(np.count_nonzero(own & (np.arange(len(own)) <= image)))


def _images(
    points: Float[np.ndarray, "cycles n d"], batch: LaneBatch, lanes: LaneRunner, names: Sequence[str]
) -> Float[np.ndarray, "cycles n d"]:
    """Return points with the signs of coordinates changed, and of the velocities that follow from them."""
    state, components = states_at(batch, lanes, points.reshape(-1, points.shape[2])), component_names(batch.flow)
    inner = state.state if isinstance(state, Crossing) else state
    signed = signed_names(batch.flow)
    velocities = components[len(signed) :]  # in the order of their positions, where signs are those of positions alone
    turned = {*names, *(v for v, q in zip(velocities, signed, strict=False) if q in names)}
    signs = [-1.0 if name in turned else 1.0 for name in components]
    leaves, structure = jax.tree.flatten(inner)
    changed = [s * np.asarray(leaf) for s, leaf in zip(signs, leaves, strict=False)]
    inner = jax.tree.unflatten(structure, [*changed, *leaves[len(signs) :]])
    state = state._replace(state=inner) if isinstance(state, Crossing) else inner
    return points_at(batch, lanes, state).reshape(points.shape)
