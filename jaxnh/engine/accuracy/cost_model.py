"""Cost of compiling beside running: the form of a step and the lanes of a tile that are quickest for a job.

The rates are fixed ones, of one core with AVX-512. A rate that is measured where a job runs would let its plan, and so
the last bits of chaotic lanes, depend on how busy the machine was; and the two forms cost the same within a factor of
two over a decade of lanes, so that another machine's rates would gain little.
"""

from __future__ import annotations

from dataclasses import replace

from jaxnh.maps.time_tables import time_split
from jaxnh.solvers import Solver
from jaxnh.solvers.adaptive import has_loop
from jaxnh.systems.flow import Flow
from jaxnh.systems.piecewise_smooth import PiecewiseSmooth

LOOP_OVER_WRITTEN_OUT = 2.0
"""Time of a step with its stages in a loop over that of one written out, at a full tile."""

VECTOR = 8
"""Lanes of a vector; of a tile of few lanes each vector of padding costs as much as one of lanes.

A lane by itself, whose numbers stay in registers, takes half of the time of a vector.
"""

_COMPILING = 8e-4  # seconds to trace and compile an equation of a step that is written out
_LOOPED = 7e-11  # seconds more for a coordinate at a stage of a lane-step, where the stages are a loop
_RATE = 1e-9  # seconds for a coordinate at a stage of a lane-step in a loop
_WORTH_COMPARING = 0.5  # seconds of a run: solvers differ by a third of it, and each compiles for a fifth of a second
_COMPILING_EVENTS = 0.012  # seconds to trace and compile an equation of a map whose steps end at events, in a loop
_COMPARED = 2  # solvers beside the reference, each of which is compiled to be compared
_GAIN = 1 / 3  # of a run: most that another solver saves
_WORTH_CLASSES = 10.0  # seconds of a run: a look at all lanes takes some, and programs of more tiles a second each
_TILES = ((1, 1), (16, 8), (128, 32), (512, 128))  # lanes of a sweep up to which a tile has so many
_LARGEST_TILE = 256
_UP_TO = 32  # lanes of a tile that holds as few vectors as its lanes need
_MANY_KICKS = 4096  # a period; of one lane, sines of its padding take up to seven eighths of the time


def quickest_form(solver: Solver, flow: Flow, lane_steps: float) -> Solver:
    """The solver with its stages in a loop where a job ends sooner with the loop's short compiling than with its own.

    Written out, a step has every equation of the field and every sum over stages once a stage, with tangents or
    without; in a loop each stage sums over all stages, those of zero weight too.

    Args:
        lane_steps: steps that all lanes of the job take together, those that fill up tiles too.
    """
    if not has_loop(solver) or solver.rolled is not None:
        return solver
    d = flow.chart.dimension
    equations = time_split(flow).size + solver.stages * d / 2.0
    looped = _LOOPED * lane_steps * d < _COMPILING * equations
    return replace(solver, rolled=True) if looped else solver


def is_short(solver: Solver, flow: Flow, lane_steps: float) -> bool:
    """Return whether a job is done before another solver would be compiled and measured, and its gain begin."""
    worth = _WORTH_COMPARING
    if isinstance(flow, PiecewiseSmooth):
        worth = max(worth, _COMPARED * _COMPILING_EVENTS * time_split(flow).size / _GAIN)
    return _RATE * solver.stages * flow.chart.dimension * lane_steps < worth


def is_worth_classes(solver: Solver, flow: Flow, lane_steps: float) -> bool:
    """Return whether a job is so long that lanes are looked at for fewer steps of their own."""
    return _RATE * solver.stages * flow.chart.dimension * lane_steps > _WORTH_CLASSES


def lanes_a_tile(lanes: int, kicks: int = 0) -> int:
    """Lanes of a tile for a sweep of so many: a lane costs what those that fill up its tile cost.

    Args:
        kicks: evaluations of the field a period; where they are many, a few lanes have a tile without padding, for
            which programs of the calibration are compiled anew.
    """
    if lanes < VECTOR and kicks > _MANY_KICKS:
        return lanes
    tile = next((tile for most, tile in _TILES if lanes <= most), _LARGEST_TILE)
    if tile != _UP_TO:
        return tile
    return VECTOR * -(-lanes // (-(-lanes // tile) * VECTOR))
