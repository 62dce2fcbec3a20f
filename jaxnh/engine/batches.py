"""Pieces of a sweep that are computed together, and whether they may be of several values of the shared axes."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Sequence

from jaxnh.analyses.base import Analysis
from jaxnh.analyses.batch import Axis
from jaxnh.analyses.options.base import Options
from jaxnh.engine.executor.lanes import TILE, LaneExecutor
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.levels.levels import Level
from jaxnh.jobs.cutting import Cutting, Piece
from jaxnh.jobs.job import Job
from jaxnh.maps.build import scheme_of
from jaxnh.maps.family import GROUPS
from jaxnh.solvers import NAMED

Requested = Sequence[tuple[Analysis, Options]]

_BYTES = 1 << 28  # of results that are computed at once
_LANES = 8192  # that are computed at once: enough to fill the tiles of programs that few of them need
_LANES_ON_CARD, _GROUPS_ON_CARD = 1 << 19, 1024  # in place of these on a graphics card
_MOST_COMPARED = 1 << 14  # values of the shared axes whose periods are compared
_BATCHES = 4  # a device at least, so that none waits long for the last
_BATCHES_ON_CARD = 2  # a thread takes as long for an orbit as all threads: fewer batches have fewer calls of Newton's


def batches(
    experiment: Experiment,
    axes: Sequence[Axis],
    requested: Requested,
    job: Job,
    pieces: Sequence[Piece],
    lanes: LaneExecutor,
    level: Level | None = None,
    *,
    in_turn: bool = False,
) -> list[list[Piece]]:
    """Pieces that are computed together: tiles in a row, enough for all devices.

    They are of the same values of the axes that lanes share, or where it can be of several that have the same period.

    Args:
        in_turn: whether batches are computed one after the other, each on all devices.
    """
    cutting, devices, on_card = job.cutting, len(lanes.devices), lanes.on_card
    numbers = sum(a.numbers(options) for a, options in requested if a.name in cutting.independent)
    runners = 1 if in_turn else (_BATCHES_ON_CARD if on_card else _BATCHES) * devices
    share = sum(lanes_of(piece, level) for piece in pieces) // runners
    most = max(cutting.tile, devices * TILE, min(_LANES_ON_CARD if on_card else _LANES, share))
    held = max(cutting.tile, _BYTES // (8 * max(1, numbers)))
    most_values = 1
    if stackable(experiment, axes, requested, job.plan.solver):
        most_values = _GROUPS_ON_CARD if on_card else max(1, min(GROUPS, len(pieces) // (_BATCHES * devices)))
    alike = _alike(experiment, axes)
    groups: list[list[Piece]] = []
    computed, there, places = 0, 0, set[tuple[int, ...]]()  # lanes and shared places of the last batch
    for piece in pieces:
        last, of_piece = groups[-1] if groups else [], shared_places(piece, cutting)
        follows = bool(last) and piece.number == last[-1].number + 1
        fits = computed + lanes_of(piece, level) <= most and there + piece.lanes <= held
        near = of_piece <= places
        if not near and len(of_piece | places) <= most_values:
            near = alike(of_piece | places)
        if follows and fits and near and piece.names == cutting.independent == last[-1].names:
            last.append(piece)
        else:
            groups.append([piece])
            computed, there, places = 0, 0, set()
        computed, there = computed + lanes_of(piece, level), there + piece.lanes
        places |= of_piece
    return groups


def stackable(experiment: Experiment, axes: Sequence[Axis], requested: Requested, solver: str) -> bool:
    """Return whether lanes at several values of the axes that lanes share can go through one program.

    All that such an axis changes has to be in the tables of maps with a clock.
    """
    shared = {axis.name: float(axis.values[0]) for axis in axes if axis.kind == "shared"}
    if not shared or experiment.precision != "float64":
        return False
    if not all(analysis.stackable for analysis, options in requested if analysis.independent(options)):
        return False
    flow = experiment.flow(shared)
    return not flow.autonomous and scheme_of(flow, NAMED[solver]).stacked


def lanes_of(piece: Piece, level: Level | None) -> int:
    """Return how many lanes of a piece are computed."""
    return piece.lanes if level is None else int(level.wanted_in(piece).sum())


def shared_values_a_tile(
    experiment: Experiment, axes: Sequence[Axis], requested: Requested, solver: str, *, on_card: bool = False
) -> int:
    """Return how many values of the shared axes a tile may have: of all of them, or else 1."""
    shared = [range(len(axis.values)) for axis in axes if axis.kind == "shared"]
    many = math.prod(map(len, shared)) > _MOST_COMPARED
    if many or not stackable(experiment, axes, requested, solver):
        return 1
    most = _GROUPS_ON_CARD if on_card else GROUPS
    return most if _alike(experiment, axes)(set(itertools.product(*shared))) else 1


def _alike(experiment: Experiment, axes: Sequence[Axis]) -> Callable[[set[tuple[int, ...]]], bool]:
    """Return whether flows at some places along the shared axes have the same period."""
    shared = [axis for axis in axes if axis.kind == "shared"]

    @functools.cache
    def period(place: tuple[int, ...]) -> float:
        values = {axis.name: float(axis.values[k]) for axis, k in zip(shared, place, strict=True)}
        return experiment.flow(values).period

    return lambda places: len(set(map(period, places))) <= 1


def shared_places(piece: Piece, cutting: Cutting) -> set[tuple[int, ...]]:
    """Places of a piece along the shared axes."""
    ends = zip(piece.begin, piece.end, cutting.axes, strict=True)
    return set(itertools.product(*(range(begin, end) for begin, end, (_, _, shared) in ends if shared)))
