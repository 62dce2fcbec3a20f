"""A homoclinic orbit from a cycle of long duration, on meshes and durations of several sizes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.exceptions import InputError
from jaxnh.orbits.collocation.equations import BoundarySolution, Problem
from jaxnh.orbits.collocation.homoclinic import SaddlePoint, cut_open, hold_duration, projections, saddle_at, with_ends
from jaxnh.orbits.collocation.newton import correct, on_adapted_mesh
from jaxnh.orbits.collocation.paths import halved, on_mesh

_LONGER = 1.5  # duration, by which what the ends cut off is told
_FLOOR = 1e-13


class Homoclinic(NamedTuple):
    """A homoclinic orbit.

    Attributes:
        solution: one lane; the first parameter is that of the orbit.
        saddle: the equilibrium.
        error: of the parameter, from the mesh, the duration and rounding.
    """

    solution: BoundarySolution
    saddle: SaddlePoint
    error: float


def homoclinic_orbit(
    problem: Problem, cycle: BoundarySolution, near: Float[np.ndarray, " d"], n: int | None = None
) -> Homoclinic:
    """The homoclinic orbit near a cycle of long duration, and the parameter where it is.

    Args:
        problem: the field, with one parameter.
        cycle: one lane.
        near: a state near the equilibrium.
        n: intervals of the mesh, by default those of the cycle.

    Raises:
        InputError: there is no saddle near the state, or Newton comes to no homoclinic orbit.
    """
    intervals = cycle.path.stages.shape[1] if n is None else n
    saddle = saddle_at(problem, near, cycle.values[0])
    solution = _solve(problem, cut_open(cycle, saddle.state, problem.size), saddle, intervals)
    saddle = saddle_at(problem, saddle.state, solution.values[0])
    more = 0.5 * (_LONGER - 1.0) * solution.duration[0]
    extended = with_ends(problem, solution, saddle, saddle, (more, more))
    longer = _solve(problem, extended, saddle, intervals)
    finer = longer._replace(path=on_mesh(longer.path, halved(longer.path.mesh)))
    corrected = correct(problem, finer, projections(problem, saddle, saddle), hold_duration)
    if not corrected.converged[0]:
        raise InputError("Newton comes to no homoclinic orbit on the halves of the mesh; begin with more intervals")
    value = corrected.solution.values[0, 0]
    error = abs(value - longer.values[0, 0]) + abs(longer.values[0, 0] - solution.values[0, 0])
    rounding = (corrected.extra_rounding[0, 1] + _FLOOR) * problem.widths[0]
    return Homoclinic(
        corrected.solution, saddle_at(problem, saddle.state, corrected.solution.values[0]), error + rounding
    )


def _solve(problem: Problem, guess: BoundarySolution, saddle: SaddlePoint, n: int) -> BoundarySolution:
    corrected = on_adapted_mesh(problem, guess, projections(problem, saddle, saddle), hold_duration, n, cyclic=False)
    if not corrected.converged[0]:
        raise InputError(
            "Newton comes to no homoclinic orbit; begin with a cycle of longer duration, or more intervals"
        )
    return corrected.solution
