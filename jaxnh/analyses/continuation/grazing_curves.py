"""Curves over two parameters of orbits with events that graze one more wall or surface, as arcs between events.

They begin with orbits that graze on branches over the first axis (`grazing`). Orbits that meet nothing and touch are
cycles of a smooth field (`condition_curves`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.continuation.condition_curves import GRAZING, ConditionCurve, CycleCondition
from jaxnh.analyses.continuation.families import orbit_family, step_control
from jaxnh.analyses.continuation.family_tree import SeedOrbit, grow
from jaxnh.analyses.continuation.grazing import REFINEMENTS, arc_problem, grazing_orbits, may_graze
from jaxnh.analyses.options.orbits import CurvesOptions
from jaxnh.analyses.periodic.flow_cycles import duration_of
from jaxnh.analyses.periodic.location import refined_maps
from jaxnh.orbits.bifurcations.grazing import ArcProblem, ArcSequence, GrazingEquations, GrazingOrbit
from jaxnh.orbits.continuation import core, paths
from jaxnh.orbits.continuation.core import FINE
from jaxnh.orbits.continuation.paths import STEPS, StepControl, Track
from jaxnh.orbits.continuation.tracks import nearest
from jaxnh.systems.observables import surface_names

_NEAR = 1e-3  # lengths: a chord between two points is nearer to its curve than this


class _GrazingCurve(NamedTuple):
    """A curve: its arcs and its points in units."""

    sequence: ArcSequence
    track: Track


def grazing_curves(
    options: CurvesOptions,
    batches: Sequence[LaneBatch],
    lanes: LaneRunner,
    waves: Sequence[Sequence[Sequence[SeedOrbit]]],
    unit: Float[np.ndarray, " d"],
    names: tuple[str, str],
    ends: tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]],
) -> list[ConditionCurve]:
    """All curves of orbits that meet walls or surfaces and touch, each once; arguments as of `condition_curves`."""
    if not may_graze(batches[0]):
        return []
    longest = max((_longest_return(*each, lanes) for each in zip(batches, waves, strict=True)), default=0.0)
    if not longest:
        return []
    problems = [arc_problem(batches[0], lanes, names, ends, unit, longest, more) for more in REFINEMENTS]
    steps, reach, followed = step_control(options), (float(ends[0][0]), float(ends[1][0])), list[_GrazingCurve]()
    for batch, seeds in zip(batches, waves, strict=True):
        second = float(batch.p[names[1]][0])
        with lanes.stage(f"curves: orbits that graze at {names[1]} = {second:g}", 0):
            families = [orbit_family(batch, lanes, strobe, unit, reach) for strobe in refined_maps(batch)]
            tree = grow(families[:1] * 3, seeds, options.max_period, steps._replace(max_steps=STEPS.max_steps))
            for grazing in grazing_orbits(batch, lanes, families[0], tree, unit):
                if grazing.orbits[0].sequence.events:
                    followed += _new_curve(problems[0], followed, grazing.orbits[0], second, steps)
    surfaces = surface_names(batches[0].flow)
    return [_curve(problems, curve, surfaces[curve.sequence.surface]) for curve in followed]


def _longest_return(batch: LaneBatch, waves: Sequence[Sequence[SeedOrbit]], lanes: LaneRunner) -> float:
    """The longest return, on average, of the orbits to begin with; 0 without any."""
    seeds = [seed for wave in waves for seed in wave]
    times = (duration_of(batch.at_values(np.array([s.value])), lanes, s.points) / len(s.points) for s in seeds)
    return max(times, default=0.0)


def _new_curve(
    problem: ArcProblem, there: Sequence[_GrazingCurve], orbit: GrazingOrbit, second: float, steps: StepControl
) -> list[_GrazingCurve]:
    """The curve through an orbit that touches, where none that is known goes through it."""
    equations = GrazingEquations(problem, orbit.sequence)
    z = equations.unknowns(orbit.start, orbit.length, np.append(orbit.values, second))
    start = core.correct(equations, z[None], tolerance=FINE)
    if not start.converged[0] or any(_passes(problem, curve, orbit, second) for curve in there):
        return []
    return [_GrazingCurve(orbit.sequence, paths.follow_both_ways(equations, start, steps)[0])]


def _passes(problem: ArcProblem, curve: _GrazingCurve, orbit: GrazingOrbit, second: float) -> bool:
    """Return whether a curve goes through an orbit, whichever of its periods comes first."""
    for turned in orbit.turned():
        if turned.sequence.same_as(curve.sequence):
            equations, values = GrazingEquations(problem, turned.sequence), np.append(turned.values, second)
            z = equations.unknowns(turned.start, turned.length, values)
            track = curve.track.points
            if nearest(track.z, track.way, z, difference=equations.difference).distance <= _NEAR:
                return True
    return False


def _curve(problems: Sequence[ArcProblem], curve: _GrazingCurve, surface: str) -> ConditionCurve:
    """Points of the curve by arcs of twice the steps, errors from those of once and four times."""
    points, equations = curve.track.points, [GrazingEquations(problem, curve.sequence) for problem in problems]
    solved = [core.correct(each, points.z, points.way, FINE) for each in equations]
    places = [np.where(each.converged[:, None], each.z, np.nan) for each in solved]
    first, second, third = (each.parts(z)[2] for each, z in zip(equations, places, strict=True))
    multipliers = equations[1].multipliers(solved[1].blocks)
    width = problems[0].high - problems[0].low
    rounding = np.spacing(np.abs(second)) + points.z.shape[1] * np.finfo(float).eps * width
    errors = np.abs(second - first) + np.abs(third - second) + rounding
    n, durations = len(curve.sequence.first), equations[1].parts(places[1])[1].sum(axis=1)
    condition = CycleCondition(GRAZING, surface, 0.0)
    return ConditionCurve(condition, n, second, errors, durations, multipliers, curve.track.ends, places[1])
