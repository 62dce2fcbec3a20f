"""Branches of cycles by collocation: all that orbits lead to, with their bifurcations and doubled cycles.

Cycles are boundary-value problems of the flow, not orbits of its return map: errors grow over one interval of a mesh,
not over a return. Results have their points on the section, or at strobes, as those of the map.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager

import numpy as np
from jaxtyping import Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.continuation.cycle_points import FollowedCycles, cycle_points
from jaxnh.analyses.continuation.family_tree import SeedOrbit
from jaxnh.analyses.periodic.flow_cycles import cycle_guess, cycle_size, flow_problem, path_lift
from jaxnh.maps.section import Section
from jaxnh.orbits.collocation.bifurcations import CycleBifurcation, bifurcations, doubled_cycle
from jaxnh.orbits.collocation.cycle_equations import (
    CyclePoint,
    invariants,
    point_at,
    remeshed_point,
    reversed_way,
)
from jaxnh.orbits.collocation.cycles import closure, hold_parameters, solve_cycles
from jaxnh.orbits.collocation.equations import BoundarySolution, Problem, combination, moved
from jaxnh.orbits.collocation.following import CycleBranch, follow_cycles
from jaxnh.orbits.collocation.newton import correct
from jaxnh.orbits.collocation.paths import path_through, values_at
from jaxnh.orbits.continuation.kinds import DOUBLING
from jaxnh.orbits.continuation.paths import COLLAPSED, START, UNBOUNDED, StepControl

_TARGET = 1e-7  # error of the first cycle of a branch, that its mesh is chosen by
_SAME = 1e-4  # of invariants, in sizes and widths: the cycle is on the branch
_NEAR = 0.1  # likewise: it may be
_REPEATS = 1e-5  # sizes, to which a cycle comes back before its last return: it has fewer
_SAMPLED = 64  # places of a path that it may repeat
_STILL = 1e-6  # sizes: a cycle smaller than this is an equilibrium
_MEASURED = 4  # times, at most, that sizes are taken from what branches have grown to


def grow_cycles(
    batch: LaneBatch,
    lanes: LaneRunner,
    waves: Sequence[Sequence[SeedOrbit]],
    unit: Float[np.ndarray, " d"],
    limit: int,
    ends: tuple[float, float],
    steps: StepControl,
    stage: Callable[[str], AbstractContextManager[object]],
    *,
    locate: bool = True,
) -> list[FollowedCycles]:
    """All branches of cycles that orbits lead to.

    Args:
        batch: lanes along the first axis.
        lanes: runs lanes.
        waves: orbits to begin with, at points of the section or at strobes.
        unit: size of motions in each section coordinate.
        limit: largest period, in returns.
        ends: of the range of the parameter, the lower one first.
        steps: how branches are followed.
        stage: shows what is done inside, by its label.
        locate: whether bifurcations are located, and doubled cycles followed; otherwise branches have none.
    """
    followed, size = list[FollowedCycles](), None
    for _ in range(_MEASURED):
        followed, problem = _grow(batch, lanes, waves, size, unit, limit, ends, steps, stage, locate)
        if problem is None or (size := _outgrown_size(problem, followed)) is None:
            break
    return followed


def _grow(
    batch: LaneBatch,
    lanes: LaneRunner,
    waves: Sequence[Sequence[SeedOrbit]],
    size: Float[np.ndarray, " d"] | None,
    unit: Float[np.ndarray, " d"],
    limit: int,
    ends: tuple[float, float],
    steps: StepControl,
    stage: Callable[[str], AbstractContextManager[object]],
    locate: bool,
) -> tuple[list[FollowedCycles], Problem | None]:
    """The branches of `grow_cycles` in sizes, by default those of the first cycle, and the problem they solve."""
    followed, problem = list[FollowedCycles](), None
    for seed in sorted(itertools.chain(*waves), key=lambda seed: len(seed.points)):
        if problem is not None and _passes_seed(problem, followed, seed, batch):
            continue
        with stage("path of an orbit"):
            path = cycle_guess(batch.at_values(np.array([seed.value])), lanes, seed.points)
        if path is None:
            continue
        guess, returns = BoundarySolution(path[0], np.array([path[1]]), np.array([[seed.value]])), len(seed.points)
        if problem is None:
            widths = np.array([ends[1] - ends[0]])
            first = cycle_size(batch.system, guess.path, unit) if size is None else size
            problem = flow_problem(batch, lanes, first, (batch.first_axis.name,), widths)
        with stage(f"cycles of {returns} returns by collocation"):
            _follow_on(problem, followed, guess, returns, limit, ends, steps, batch, locate)
    return followed, problem


def _outgrown_size(problem: Problem, followed: Sequence[FollowedCycles]) -> Float[np.ndarray, " d"] | None:
    """The size that cycles of branches from Hopf points have grown beyond all bounds through; None where none have.

    Such a branch begins with cycles of any size, however small, and bounds in sizes of these say nothing of the flow.
    """
    grown = [known for known in followed if {*known.branch.ends} == {COLLAPSED, UNBOUNDED}]
    if not grown:
        return None
    paths = [point.solution.path for known in grown for point in (known.branch.points[0], known.branch.points[-1])]
    largest = np.max([0.5 * np.ptp(path.ends[0], axis=0) for path in paths], axis=0)
    return np.maximum(problem.size, np.sqrt(problem.size * largest))


def _follow_on(
    problem: Problem,
    followed: list[FollowedCycles],
    guess: BoundarySolution,
    returns: int,
    limit: int,
    ends: tuple[float, float],
    steps: StepControl,
    batch: LaneBatch,
    locate: bool,
) -> None:
    """Follow the branch of a cycle and those of doubled ones, where they are new."""
    lift = path_lift(batch.flow, guess.path)
    start = _first_point(problem, guess, lift)
    if start is None or _is_known(problem, followed, start, returns):
        return
    if part := _repeated_part(problem, start.solution, lift, returns):
        shorter, times = part
        _follow_on(problem, followed, shorter, returns // times, limit, ends, steps, batch, locate)
        return
    open_ = [(start, returns, lift, True)]
    while open_:
        point, n, lift, both_ways = open_.pop(0)
        if _is_known(problem, followed, point, n):
            continue
        sides = []
        for way in (point, reversed_way(point))[: 1 + both_ways]:
            branch = follow_cycles(problem, way, lift, ends, steps)
            sides.append((branch, *(bifurcations(problem, branch, lift) if locate else ([], []))))
        new = _joined(n, lift, *sides)
        followed.append(new)
        for bifurcation in new.bifurcations:
            if bifurcation.kind == DOUBLING and 2 * n <= limit:
                doubled = doubled_cycle(problem, bifurcation.point, lift)
                if doubled is not None:
                    open_.append((doubled, 2 * n, 2.0 * lift, False))


def _first_point(problem: Problem, guess: BoundarySolution, lift: Float[np.ndarray, " d"]) -> CyclePoint | None:
    """The cycle near a path, on a mesh that is fine enough; None where there is none, or it is an equilibrium."""
    cycle = solve_cycles(problem, guess, _TARGET, lift[None])[0]
    extent = np.ptp(cycle.solution.path.ends[0] / problem.size, axis=0).max()
    if not cycle.converged[0] or (extent < _STILL and not problem.clock):
        return None
    solution = cycle.solution._replace(values=guess.values)  # they are held, but for rounding
    point = point_at(problem, solution, lift, None)
    return remeshed_point(problem, point, cycle.solution.path.stages.shape[1] // 2)


def _repeated_part(
    problem: Problem, solution: BoundarySolution, lift: Float[np.ndarray, " d"], returns: int
) -> tuple[BoundarySolution, int] | None:
    """The part of a path that it repeats a prime number of times, and that number; None where it repeats none.

    Orbits that meet walls begin paths of a smooth branch of the field, whose cycle may take fewer returns.
    """
    for times in (q for q in range(2, returns + 1) if returns % q == 0 and all(q % d for d in range(2, q))):
        shares = np.linspace(0.0, 1.0, times * _SAMPLED + 1)
        states = values_at(solution.path, shares[None])[0]
        gaps = (states[_SAMPLED:] - states[:-_SAMPLED] - lift / times) / problem.size
        if np.abs(gaps).max() < _REPEATS:
            part, count = states[: _SAMPLED + 1], solution.path.stages.shape[1]
            path, duration = path_through(solution.duration[0] * shares[: _SAMPLED + 1], part, -(-count // times))
            return BoundarySolution(path, np.array([duration]), solution.values), times
    return None


def _is_known(problem: Problem, followed: Sequence[FollowedCycles], point: CyclePoint, returns: int) -> bool:
    """Return whether a cycle is on a branch that has been followed."""
    wanted = invariants(problem, point.solution)[0]
    for known, nearest, between in _passages(problem, followed, point.value, returns):
        if np.linalg.norm(between - wanted) <= _NEAR:
            there = invariants(problem, _at_value(problem, nearest, point.value, known.lift))[0]
            if np.linalg.norm(there - wanted) < _SAME:
                return True
    return False


def _passes_seed(problem: Problem, followed: Sequence[FollowedCycles], seed: SeedOrbit, batch: LaneBatch) -> bool:
    """Return whether a branch that has been followed passes an orbit of the return map."""
    n, system = len(seed.points), batch.system
    unit = np.delete(problem.size, system.number) if isinstance(system, Section) else problem.size
    for known, nearest, _ in _passages(problem, followed, seed.value, n):
        points = cycle_points(batch, _at_value(problem, nearest, seed.value, known.lift), n)
        gaps = [batch.chart.wrap(np.roll(points, m, 0) - seed.points) / unit for m in range(n)]
        if min(np.abs(gap).max() for gap in gaps) < _SAME:
            return True
    return False


def _passages(
    problem: Problem, followed: Sequence[FollowedCycles], value: float, returns: int
) -> Iterator[tuple[FollowedCycles, CyclePoint, Float[np.ndarray, " k"]]]:
    """Branches where they pass a value of the parameter: the nearest point of each, and invariants in between."""
    for known in (known for known in followed if known.returns == returns):
        for before, after in itertools.pairwise(known.branch.points):
            low, high = sorted((before.value, after.value))
            if low <= value <= high and low < high:
                share = (value - before.value) / (after.value - before.value)
                ends = [invariants(problem, end.solution)[0] for end in (before, after)]
                yield known, before if share <= 0.5 else after, ends[0] + share * (ends[1] - ends[0])


def _at_value(problem: Problem, point: CyclePoint, value: float, lift: Float[np.ndarray, " d"]) -> BoundarySolution:
    """The cycle of a branch at a value of the parameter near a point of it, as far as Newton comes to it."""
    rate = float(point.way.extra[0, 1]) * problem.widths[0]
    step = (value - point.value) / rate if rate else 0.0
    guess = moved(problem, point.solution, combination([(step, point.way)]))
    guess.values[0, 0] = value
    corrected = correct(problem, guess, closure(problem, lift[None]), hold_parameters)
    return corrected.solution if corrected.converged[0] else guess


def _joined(
    returns: int,
    lift: Float[np.ndarray, " d"],
    *sides: tuple[CycleBranch, list[CycleBifurcation], list[tuple[int, int]]],
) -> FollowedCycles:
    """The branch from one end to the other, of both directions from its first point or of one."""
    ahead, located, lost = sides[0]
    if len(sides) == 1:
        return FollowedCycles(returns, lift, ahead._replace(ends=(START, ahead.ends[1])), located, lost)
    back, before, lost_before = sides[1]
    turned = [reversed_way(point) for point in back.points[:0:-1]]
    place = len(back.points) - 1
    whole = CycleBranch([*turned, *ahead.points], (back.ends[1], ahead.ends[1]))
    moved_back = [point._replace(place=place - 1 - point.place) for point in before]
    moved_ahead = [point._replace(place=place + point.place) for point in located]
    signs = [(place - 1 - k, kind) for k, kind in lost_before] + [(place + k, kind) for k, kind in lost]
    return FollowedCycles(returns, lift, whole, [*moved_back, *moved_ahead], signs)
