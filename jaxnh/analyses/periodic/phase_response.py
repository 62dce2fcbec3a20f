"""Phase response curves of the limit cycles that lanes are on: how a small change of a state moves the phase later.

The mathematics is `orbits.collocation.adjoint`; here are the cycles of lanes, and the phases that results have.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.base import LANE, Entry, OptionError, Setting, variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.periodic.attractor_survey import Survey
from jaxnh.analyses.periodic.flow_cycles import (
    cycle_guess,
    cycle_size,
    flow_problem,
    no_collocation,
    passages,
    path_lift,
    section_heights,
    section_normal,
)
from jaxnh.maps.section import Section
from jaxnh.orbits.collocation.adjoint import phase_response
from jaxnh.orbits.collocation.cycles import closure, hold_parameters, solve_cycles
from jaxnh.orbits.collocation.equations import BoundarySolution, Problem
from jaxnh.orbits.collocation.newton import NewtonSolution, correct
from jaxnh.orbits.collocation.paths import halved, on_mesh, rotated

_TARGET = 1e-9  # error of cycles, in sizes, that their meshes are chosen by
_APART = 1e-3  # of a mean interval: ends of intervals nearer to a phase than this are left out
_LEAST = 0.1  # of the size of motions: a coordinate that stays at zero has errors of the map alone
_STILL = 1e-3  # likewise: what is nowhere further from where it began is an equilibrium
_TURNS = 2  # times that a path is begun anew at the section: the second time it is there to rounding
_EPS = np.finfo(float).eps


class PhaseResponses(NamedTuple):
    """Cycles and phase responses of lanes at even phases, with errors; not a number where a lane has no cycle.

    Attributes:
        states, state_errors: (lanes, phases, d).
        responses, response_errors: derivatives of the phase in the coordinates, (lanes, phases, d).
        durations, duration_errors: (lanes,).
    """

    states: Float[np.ndarray, "lanes phases d"]
    state_errors: Float[np.ndarray, "lanes phases d"]
    responses: Float[np.ndarray, "lanes phases d"]
    response_errors: Float[np.ndarray, "lanes phases d"]
    durations: Float[np.ndarray, " lanes"]
    duration_errors: Float[np.ndarray, " lanes"]


def check_phase_response(setting: Setting) -> None:
    """Check that a system has limit cycles whose phase is free, and that its results have other names."""
    if not setting.autonomous:
        what = "a map has no" if not setting.flow.continuous else "the drive gives the phase; with a clock there is no"
        raise OptionError(f"{what} phase response; leave it out", "phase_response")
    if why := no_collocation(setting.flow):
        raise OptionError(f"{why}; leave it out", "phase_response")
    names = [axis.dim for axis in setting.axes] + list(setting.flow.coordinates)
    for name in {"phase", "period", "time", "residual", "multiplier"} & {*names}:
        raise OptionError(f"{name} is what the phase response calls a number of its own; rename it", "phase_response")


def phase_response_variables(batch: LaneBatch, lanes: LaneRunner, attractors: Survey, count: int) -> dict[str, Entry]:
    """Variables over (lane, phase): states of limit cycles, and the derivatives of the phase in each coordinate."""
    with lanes.stage(f"period: phase responses of {np.count_nonzero(attractors.period)} lanes", 0):
        known = _phase_responses(batch, lanes, attractors, count)
    labels, dims = batch.flow.readout.labels, (LANE, "phase")
    units = labels.units["t"]
    variables = {
        "phase": variable("phase", 2 * np.pi * np.arange(count) / count, "phase after the section", "rad"),
        "time": variable(LANE, known.durations, "the time that the orbit takes", units),
        "time_error": variable(LANE, known.duration_errors, "error of the time that the orbit takes", units),
    }
    for k, name in enumerate(batch.flow.coordinates):
        words, unit = labels.long_names[name], labels.units[name]
        over = unit and ("rad" if unit == "1" else f"rad/{unit}" if unit.isalpha() else f"rad/({unit})")
        response = f"derivative of the phase in {name}"
        variables |= {
            name: variable(dims, known.states[..., k], words, unit),
            f"{name}_error": variable(dims, known.state_errors[..., k], f"error of {words}", unit),
            f"{name}_response": variable(dims, known.responses[..., k], response, over),
            f"{name}_response_error": variable(dims, known.response_errors[..., k], f"error of the {response}", over),
        }
    return variables


def _phase_responses(batch: LaneBatch, lanes: LaneRunner, attractors: Survey, count: int) -> PhaseResponses:
    """The phase responses of all lanes, one after the other: their meshes are of different lengths."""
    d = batch.flow.chart.dimension
    tables = [np.full((batch.count, count, d), np.nan) for _ in range(4)]
    known = PhaseResponses(*tables, *np.full((2, batch.count), np.nan))
    for k in np.flatnonzero(attractors.period).tolist():
        points = np.repeat(attractors.u[k : k + 1], attractors.period[k], axis=0)
        response = _of_lane(_single_lane(batch, k), lanes, points, attractors.size[k], count)
        if response is not None:
            for table, row in zip(known, response, strict=True):
                table[k] = row
    return known


def _single_lane(batch: LaneBatch, k: int) -> LaneBatch:
    """The batch of one lane, with the system of its own."""
    lane = batch.take(np.array([k]))
    if lane.family is None:
        return lane
    return lane.with_system(lane.family.at(tuple(float(lane.p[name][0]) for name in lane.family.names)))


def _of_lane(
    batch: LaneBatch, lanes: LaneRunner, points: Float[np.ndarray, "n d"], size: Float[np.ndarray, " d"], count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float, float] | None:
    """Entries of `PhaseResponses` of a batch of one lane with this orbit; None where Newton confirms no cycle."""
    guess, section = cycle_guess(batch, lanes, points), batch.system
    assert isinstance(section, Section)
    if guess is None:
        return None
    path, duration = guess
    sizes = np.maximum(cycle_size(section, path, size), _LEAST * np.insert(size, section.number, 0.0))
    if np.all(np.delete(np.ptp(path.ends[0], axis=0) / sizes, section.number) < _STILL):
        return None
    problem = flow_problem(batch, lanes, sizes, (), np.zeros(0))
    lift = path_lift(batch.flow, path)[None]
    [cycle] = solve_cycles(problem, BoundarySolution(path, np.array([duration]), np.zeros((1, 0))), _TARGET, lift)
    coarse = _from_section(problem, cycle.solution, lift, section, count) if cycle.converged[0] else None
    if coarse is None or not coarse.converged[0]:
        return None
    start = coarse.solution
    fine = correct(
        problem,
        start._replace(path=on_mesh(start.path, halved(start.path.mesh))),
        closure(problem, lift),
        hold_parameters,
    )
    if not fine.converged[0]:
        return None
    place = np.searchsorted(start.path.mesh[0], np.arange(count) / count)
    state, z, _ = _since_section(problem, start, lift, section, place)
    more, finer, relative = _since_section(problem, fine.solution, lift, section, 2 * place)
    floor = _EPS * fine.solution.path.stages.shape[1]  # of each interval one rounding, that the orbit carries on
    rounding = (fine.rounding[0] + floor) * problem.size
    largest = np.max(np.abs(finer) * problem.size) / problem.size  # of all together: rounding of one is in the others
    errors = np.abs(finer - z) + (relative + floor) * largest
    longer = abs(fine.solution.duration[0] - start.duration[0])
    last = (fine.extra_rounding[0, 0] + floor) * start.duration[0]
    states = batch.flow.chart.wrap(more)
    return states, np.abs(more - state) + rounding, finer, errors, fine.solution.duration[0], longer + last


def _from_section(
    problem: Problem, cycle: BoundarySolution, lift: Float[np.ndarray, "1 d"], section: Section, count: int
) -> NewtonSolution | None:
    """The cycle from its passage of the section on, over a mesh that has all phases as ends of intervals."""
    solved = None
    for _ in range(_TURNS):
        places = passages(section, cycle.path)
        if not len(places):
            return None
        share = places[np.argmin(np.abs(places - np.round(places)))] % 1.0
        mesh = _mesh_with_phases((cycle.path.mesh[0] - share) % 1.0, count)
        cycle = cycle._replace(path=rotated(cycle.path, share, mesh))
        solved = correct(problem, cycle, closure(problem, lift), hold_parameters)
        cycle = solved.solution
    return solved


def _since_section(
    problem: Problem,
    cycle: BoundarySolution,
    lift: Float[np.ndarray, "1 d"],
    section: Section,
    place: Int[np.ndarray, " phases"],
) -> tuple[Float[np.ndarray, "phases d"], Float[np.ndarray, "phases d"], float]:
    """States and responses at ends of intervals, as long after the section as these are after the first; their error.

    Newton leaves cycles shifted along themselves by what their polynomials are off, a small part of a step: states go
    on by their rates f, and responses by −Jᵀz.
    """
    known, states = phase_response(problem, cycle, lift), cycle.path.ends[0][place]
    values = np.repeat(cycle.values, len(place), axis=0)
    at = problem.field(states, np.zeros(len(place)), values)
    rate, normal, z = np.asarray(at.rate), section_normal(section), known.z[0][place]
    late = -section_heights(section, states[:1])[0] / (rate[0] @ normal)
    return states + late * rate, z - late * np.einsum("kij,ki->kj", at.jacobian, z), float(known.error[0])


def _mesh_with_phases(places: Float[np.ndarray, " n"], count: int) -> Float[np.ndarray, " k"]:
    """A mesh from 0 to 1 of even phases and those places that are not next to one."""
    phases = np.arange(count + 1) / count
    gaps = np.abs(places * count - np.round(places * count)) / count
    others = places[gaps > _APART / max(len(places), count)]
    return np.unique(np.concatenate([phases, others]))
