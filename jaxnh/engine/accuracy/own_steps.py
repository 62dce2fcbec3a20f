"""Steps of a lane's own beside those that all lanes share: whether there are any, what they take, and what binds them.

Explicit ones tell spikes, which few of the steps are for, from stiffness, which binds all of them: there implicit steps
of states are longer, and those of tangents are not.
"""

from __future__ import annotations

import jax
import numpy as np
from jaxtyping import Float

from jaxnh.engine.accuracy.reference import Reference
from jaxnh.engine.accuracy.sample_maps import SampleMaps, Samples, differences, gaps_between, image_of
from jaxnh.exceptions import LostLaneError
from jaxnh.maps.adaptive import count_trials
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import iterate
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.section import flow_of
from jaxnh.maps.time_tables import time_split
from jaxnh.solvers import ADAPTIVE, AdaptiveMethod
from jaxnh.solvers.adaptive import in_loop
from jaxnh.systems.piecewise_smooth import PiecewiseSmooth
from jaxnh.systems.rows import select, spread_indices, write_rows

_COUNTED = 16  # samples whose steps are counted
_COMPARED = 32  # samples, of which own steps are least known, whose motions are compared with those of common ones
_FINEST_COUNTED = 1 << 16  # evaluations of the field of a calm period, at most
_MARGIN = 2.0  # times as many evaluations of the field as own steps need are paid for common ones, which are simpler
_NEAR_TARGET = 0.1  # times the target: errors of single steps add up
_CHEAP = 8  # coordinates of which an implicit step is always worth it, where stability binds explicit ones
_BOUND_BY_ACCURACY = 1.5  # times as many steps at least as half as fine ones: those that stability binds are as many
SPLIT = 4
"""Parts that a unit of time, or a part of one, is cut into."""

_FINER = 8  # times as many common steps as were too dear, over a single unit of time
_BEYOND = 10.0  # times what finer steps change: further off is another motion
_RIGHT = 1e-3  # an error of a unit of time with which its motion is roughly right


class TooDearError(LostLaneError):
    """Steps that all lanes share take far more evaluations of the field than those of a lane's own.

    Attributes:
        kicks: evaluations of the field a period that they have come to.
        stiff: whether stability binds explicit steps of a lane's own, and not accuracy.
    """

    def __init__(self, kicks: int, *, stiff: bool) -> None:
        super().__init__()
        self.kicks, self.stiff = kicks, stiff


def has_own_steps(maps: SampleMaps, precision: str) -> bool:
    """Return whether there is a way with steps of a lane's own, and it is another one."""
    flow = maps.flow
    jumps = isinstance(flow, PiecewiseSmooth) and flow.needs_events  # which those steps know nothing of
    return not (maps.adaptive or maps.scheme.smooth or jumps or precision != "float64")


def check_price(maps: SampleMaps, samples: Samples, kicks: int, target: float) -> None:
    """Check that steps with so many evaluations of the field a period are worth it.

    Raises:
        TooDearError: those of a lane's own take far fewer; where stability binds them, implicit ones, which of many
            coordinates are worth many evaluations each.
    """
    explicit, implicit = ADAPTIVE["adaptive_tsit5"], ADAPTIVE["rodas5p"]
    steps = _steps_at(explicit, target)
    needed = _trials(maps, samples, explicit, steps)
    if kicks <= _MARGIN * needed * explicit.stages:
        return
    stiff = needed < _BOUND_BY_ACCURACY * _trials(maps, samples, explicit, max(1, steps // 2))
    if stiff and len(maps.flow.coordinates) > _CHEAP:
        each = _price_of_implicit_step(maps, implicit)
        if kicks <= _MARGIN * each * _trials(maps, samples, implicit, _steps_at(implicit, target)):
            return
    raise TooDearError(kicks, stiff=stiff)


def agree(
    own: SampleMaps,
    reference: Reference,
    samples: Samples,
    sizes: Float[np.ndarray, " components"],
    common: SampleMaps,
    kicks: int,
    target: float,
) -> bool:
    """Return whether both ways have the same motions from samples on, as far as their errors tell.

    Steps of a lane's own are long where the field says nothing of a brief pulse ahead, and may pass it without a stage
    in it.

    Args:
        own: maps by steps of a lane's own.
        reference: their finest.
        common: maps by steps that all lanes share, too dear with so many evaluations of the field a period.
    """
    few = samples.take_lanes(np.argsort(reference.known, kind="stable")[-_COMPARED:])
    images = [
        maps.image(maps.of(maps.scheme.reference, n), few)
        for maps, most in ((own, reference.kicks), (common, _FINER * kicks))
        for n in (most // maps.scheme.reference.stages, 2 * most // (3 * maps.scheme.reference.stages))
    ]
    of_own, of_common, apart = (
        gaps_between(differences(images[a], images[b]), sizes) for a, b in ((0, 1), (2, 3), (0, 2))
    )
    known = np.isfinite(of_common)
    own_error, common_error = (float(np.max(gaps[known], initial=target)) for gaps in (of_own, of_common))
    right = own_error < max(_RIGHT, _BEYOND * common_error)  # chaos enlarges what both leave
    return right and bool(np.all(apart[known] < _BEYOND * max(own_error, common_error)))


def spread_over_unit(maps: SampleMaps, reference: Reference, samples: Samples) -> Samples:
    """Samples moved on by none to three of the parts that a unit of time has been cut into, as many by each.

    What is brief in the field, as a pulse, may always be in the same part of the unit, in which none of them begins.
    """
    map_of = maps.of(maps.scheme.reference, reference.kicks // maps.scheme.reference.stages)
    number = np.arange(len(samples.row)) * SPLIT // maps.parts
    moved = jax.tree.map(np.array, samples.states)
    for ahead in range(1, SPLIT):
        those = np.flatnonzero(number % SPLIT == ahead)
        if not len(those):
            continue
        later = maps.by_flow(iterate, lambda row, n=ahead: (map_of(row), np.int32(n)), samples.take_lanes(those), ahead)
        finite = np.all(np.isfinite(image_of(later)), axis=0)
        write_rows(moved, those[finite], select(later, finite))
    return samples._replace(states=moved)


def _steps_at(solver: AdaptiveMethod, target: float) -> int:
    """Steps of a calm period, each of which errs by less than a target, as errors of single steps add up."""
    steps = solver.most_steps(_FINEST_COUNTED)
    while steps > 1 and solver.tolerance(steps // 2) <= _NEAR_TARGET * target:
        steps //= 2
    return steps


def _price_of_implicit_step(maps: SampleMaps, solver: AdaptiveMethod) -> float:
    """Evaluations of the field that take as long as a step: its stages, a Jacobian, its factors and their use."""
    flow = maps.flow
    n, stages = len(flow.coordinates), solver.stages
    return stages + n + (2 / 3 * n**3 + 2 * stages * n**2) / max(1, time_split(flow).size)


def _trials(maps: SampleMaps, samples: Samples, solver: AdaptiveMethod, steps: int) -> float:
    """Steps of a lane's own in a period, or unit of time, as fine as so many of a calm one.

    Of the slowest lanes, for which the others of their tile wait.
    """
    picked = samples.take_lanes(spread_indices(len(samples.row), _COUNTED))
    if maps.sectioned:
        picked = picked._replace(states=picked.states.state)

    def shared(row: int) -> tuple[ReturnMap]:
        return (make_return_map(flow_of(maps.flows[row]), in_loop(solver), steps),)

    return float(np.max(np.asarray(maps.by_flow(count_trials, shared, picked, 1))))
