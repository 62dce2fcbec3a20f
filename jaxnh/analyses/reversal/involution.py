"""The reversal of a batch's flow: which one it is, in which lanes it holds, and images of states under it."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnh.analyses.base import OptionError
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.maps.section import Crossing, Section, System, flow_of
from jaxnh.systems.flow import Parameters
from jaxnh.systems.reversal import (
    EXACT,
    Reversal,
    declared_reversal,
    describe_reversal,
    describe_violation,
    random_places,
    reverse,
    sign_changes,
    violation,
    violations,
)
from jaxnh.systems.state import State, Vector
from jaxnh.systems.user_functions import COMPILED_FOR_ONE_CALL

NONE, _DECLARED, _FIRST = 0, 1, 2  # numbers of reversals: none, the system's own, and from here on the changes of signs
_ON_SECTION = 16  # random points of a section of which the images are to be on it


def choose_reversal(batch: LaneBatch, suits: Callable[[Reversal], bool] = lambda reversal: True) -> int:
    """Return the number of a reversal that holds in a lane of a batch and keeps its section; `NONE` where none does.

    It is the system's own where it says one, else, or where the section wants another one as well, the change of the
    fewest signs at the earliest instant.

    Args:
        suits: whether a reversal is of the kind that is wanted.

    Raises:
        InputError: what the system says is no reversal.
    """
    flow, declared, changes = batch.flow, declared_reversal(batch.flow), sign_changes(batch.flow)
    for p in _sample_lanes(batch):
        if declared:
            candidates = _as_candidates(declared)
            if violations(flow, candidates, p)[0] > EXACT:
                continue
            if _keep_section(batch.system, candidates, p)[0] and suits(declared):
                return _DECLARED
        if changes:
            holds = (violations(flow, changes, p) <= EXACT) & _keep_section(batch.system, changes, p)
            for place in np.flatnonzero(holds):
                if suits(_candidate(changes, int(place))):
                    return _FIRST + int(place)
    return NONE


def reversal_of(batch: LaneBatch, number: int) -> Reversal:
    """Return the reversal of a batch, from the number that was chosen.

    Raises:
        OptionError: there is none; the message has the place where the nearest one fails, and both values there.
    """
    if number == NONE:
        raise OptionError(_describe_failure(batch))
    declared, candidates = declared_reversal(batch.flow), sign_changes(batch.flow)
    if number == _DECLARED or candidates is None:
        assert declared is not None
        return declared
    return _candidate(candidates, number - _FIRST)


def is_reversible(batch: LaneBatch, lanes: LaneRunner, reversal: Reversal) -> Bool[np.ndarray, " lanes"]:
    """Return in which lanes the field at random states is the opposite of that at their images."""
    shared = batch.flow, reversal, random_places(batch.flow)
    return np.asarray(lanes(violation, shared, (dict(batch.p),))) <= EXACT


def image_points(
    batch: LaneBatch, lanes: LaneRunner, reversal: Reversal, states: State
) -> Float[np.ndarray, "lanes points d"]:
    """Return the section coordinates of the images of states (lanes, points)."""
    return np.array(lanes(_image_points, (batch.system, reversal.signs), (states, dict(batch.p))))


def images(batch: LaneBatch, lanes: LaneRunner, reversal: Reversal, states: State) -> State:
    """Return the images of states (lanes,), as states of the flow also of crossings of a section of it."""
    return lanes(_image_of_lane, (batch.system, reversal.signs), (states, dict(batch.p)))


def _as_candidates(reversal: Reversal) -> Reversal:
    return jax.tree.map(lambda number: np.array([number]), reversal)


def _candidate(candidates: Reversal, place: int) -> Reversal:
    return jax.tree.map(lambda leaf: float(leaf[place]), candidates)


def _sample_lanes(batch: LaneBatch) -> list[dict[str, float]]:
    """Return parameters of the first lane, one in the middle and the last."""
    sampled = sorted({0, batch.count // 2, batch.count - 1})
    return [{name: float(values[lane]) for name, values in batch.p.items()} for lane in sampled]


def _keep_section(system: System, candidates: Reversal, p: Parameters) -> Bool[np.ndarray, " reversals"]:
    """Return which reversals take a section to itself, in the same direction; without one all."""
    if not isinstance(system, Section):
        return np.ones(len(candidates.instant), bool)
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (_ON_SECTION, system.chart.dimension))
    return np.asarray(_keeps_each(system, candidates, points, dict(p)))


def _keeps(system: Section, reversal: Reversal, points: Float[Array, "points d"], p: Parameters) -> Array:
    """Return whether a reversal takes points of a section to it, in the same direction."""

    def at(u: Array) -> tuple[Array, Array]:
        state = system.chart.state(u).state
        image = reverse(system.flow, reversal.signs, state, p)
        same = (system.direction == "both") | (system.rate(state, p) * system.rate(image, p) > 0.0)
        return jnp.abs(system.height(image)), same

    height, same = jax.vmap(at)(points)
    return (jnp.max(height) <= EXACT * (1.0 + abs(system.value))) & jnp.all(same)


_keeps_each = jax.jit(jax.vmap(_keeps, in_axes=(None, 0, None, None)), compiler_options=COMPILED_FOR_ONE_CALL)


def _describe_failure(batch: LaneBatch) -> str:
    """Return in words why there is no reversal."""
    system, flow, p = batch.system, batch.flow, _sample_lanes(batch)[0]
    declared = declared_reversal(flow)
    candidates = _as_candidates(declared) if declared else sign_changes(flow)
    if candidates is None:
        return "of so many coordinates no changes of signs are tried: give the system its reversal"
    gaps = violations(flow, candidates, p)
    nearest = int(np.argmin(gaps))
    words = describe_reversal(flow, _candidate(candidates, nearest))
    if isinstance(system, Section) and gaps.min() <= EXACT:
        return (
            f"the reversal {words} takes the section {system.description} to another one; take a section that it "
            "keeps: where a coordinate that changes its sign is zero, or in both directions"
        )
    where = describe_violation(flow, candidates, nearest, p)
    if declared:
        return f"the system's reversal is none: {where}"
    return (
        f"no change of signs is a reversal; for {words}, {where}; give the system its reversal, if it has another one"
    )


def _image(system: System, signs: Vector | None, state: State, p: Parameters) -> State:
    if isinstance(state, Crossing):
        return state._replace(state=reverse(flow_of(system), signs, state.state, p))
    return reverse(flow_of(system), signs, state, p)


def image_of_point(system: System, signs: Vector | None, u: Float[Array, " d"], p: Parameters) -> Float[Array, " d"]:
    """Return the section coordinates of the image of a point."""
    return system.chart.point(_image(system, signs, system.chart.state(u), p))


def _image_points(system: System, signs: Vector | None, states: State, p: Parameters) -> Array:
    return jax.vmap(lambda state: system.chart.point(_image(system, signs, state, p)))(states)


def _image_of_lane(system: System, signs: Vector | None, state: State, p: Parameters) -> State:
    image = _image(system, signs, state, p)
    return image.state if isinstance(image, Crossing) else image
