"""First homoclinic orbits from cycles of large period: branches that come to a saddle, cut open where they are nearest.

Cycles are followed by collocation over the first axis, from what lanes settle on and from Hopf points. Where one ends
in a cycle that comes close to a saddle, an earlier one is the guess: its time from near the saddle until it is back.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager

import numpy as np
from jaxtyping import Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.continuation.connection_seeds import ConnectionSeed
from jaxnh.analyses.continuation.cycles import grow_cycles
from jaxnh.analyses.continuation.equilibria import cycles_at_hopf_points, equilibria
from jaxnh.analyses.continuation.families import orbit_family, step_control
from jaxnh.analyses.continuation.motion_units import motion_unit, sizes_in_motion
from jaxnh.analyses.continuation.seeds import attractor_waves
from jaxnh.analyses.options.orbits import HomoclinicOptions
from jaxnh.analyses.periodic.attractor_survey import periods_in_motion, survey_from_start
from jaxnh.analyses.periodic.flow_cycles import flow_problem
from jaxnh.exceptions import InputError
from jaxnh.maps.section import Section
from jaxnh.orbits.collocation.cycle_equations import CyclePoint
from jaxnh.orbits.collocation.equations import Problem
from jaxnh.orbits.collocation.homoclinic import cut_open, saddle_at
from jaxnh.orbits.continuation.paths import STEPS
from jaxnh.systems.rows import spread_indices

_TRANSIENT = 512  # crossings before lanes are looked at
_VALUES = 5  # of the first axis at which equilibria are looked for
_NEAR = 0.02  # of the farthest point of a cycle from a saddle: one that is as near to it is cut open


def seeds_from_cycles(
    batch: LaneBatch,
    lanes: LaneRunner,
    options: HomoclinicOptions,
    names: tuple[str, str],
    ends: tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]],
    second: float,
) -> list[ConnectionSeed]:
    """Guesses of homoclinic orbits at a value of the second parameter.

    Args:
        batch: lanes along the first axis, on their section.
        lanes: runs lanes.
        options: of the analysis; `cycles` is the largest number of returns.
        names: of both parameters.
        ends: of the ranges of both, the lower ones first.
        second: value of the second parameter.
    """

    def stage(label: str) -> AbstractContextManager[object]:
        return lanes.stage(f"homoclinic: {label}", 0)

    limit, range_, (low, high) = options.cycles or 0, (float(ends[0][0]), float(ends[1][0])), ends
    survey = survey_from_start(batch, lanes, limit, "homoclinic", _TRANSIENT)
    period = periods_in_motion(batch, lanes, survey)
    waves = attractor_waves(batch, lanes, survey.u, period)
    size = motion_unit([batch], lanes, period, sizes_in_motion(batch, lanes, survey), options.box)
    steps = step_control(options)._replace(max_steps=STEPS.max_steps)
    sampled = spread_indices(batch.count, _VALUES)
    still = equilibria(batch.take(sampled), lanes, options.n_starts, options.seed, options.box, range_, steps, stage)
    if isinstance(batch.system, Section):
        waves.append(
            cycles_at_hopf_points(still, orbit_family(batch, lanes, batch.strobe(), size, range_), batch.system)
        )
    followed = grow_cycles(batch, lanes, waves, size, limit, range_, steps, stage, locate=False)

    def problem_of(size: Float[np.ndarray, " d"]) -> Problem:
        return flow_problem(batch.without_section(), lanes, size, names, high - low)

    return [seed for known in followed for seed in _seeds(problem_of, known.branch.points, second)]


def _seeds(
    problem_of: Callable[[Float[np.ndarray, " d"]], Problem], points: Sequence[CyclePoint], second: float
) -> Iterator[ConnectionSeed]:
    """The guesses at both ends of a branch of cycles."""
    for cycles in (points, points[::-1]):
        extent = np.ptp(cycles[-1].solution.path.ends[0], axis=0)
        problem = problem_of(np.where(extent > 0.0, extent, extent.max() or 1.0))
        saddle = _slowest_saddle(problem, cycles[-1], second)
        near = [] if saddle is None else [_nearness(problem, cycle, saddle) <= _NEAR for cycle in cycles]
        if saddle is None or not near[-1]:
            continue
        chosen = cycles[len(near) - near[::-1].index(False) if False in near else 0].solution
        values = np.array([[chosen.values[0, 0], second]])
        guess = cut_open(chosen, saddle, problem.size)._replace(values=values)
        yield ConnectionSeed(guess, saddle, saddle + guess.path.ends[0, -1] - guess.path.ends[0, 0])


def _slowest_saddle(problem: Problem, cycle: CyclePoint, second: float) -> Float[np.ndarray, " d"] | None:
    """The saddle near the slowest state of a cycle, None where there is none."""
    states = cycle.solution.path.ends[0]
    values = np.array([cycle.solution.values[0, 0], second])
    rate = problem.field(states, np.zeros(len(states)), np.tile(values, (len(states), 1))).rate
    slowest = int(np.argmin(np.linalg.norm(np.asarray(rate) / problem.size, axis=1)))
    try:
        return saddle_at(problem, states[slowest], values).state
    except InputError:
        return None


def _nearness(problem: Problem, cycle: CyclePoint, saddle: Float[np.ndarray, " d"]) -> float:
    """The least distance of a cycle from a state, as part of the largest."""
    away = np.linalg.norm((cycle.solution.path.ends[0] - saddle) / problem.size, axis=1)
    return float(away.min() / away.max())
