"""First homoclinic orbits from Bogdanov–Takens points, which are looked for along curves of folds and Hopf points.

Orbits of the normal form at several amplitudes are guesses, the largest first: a curve begins with the first that
Newton confirms.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.continuation.equilibrium_curves import equilibrium_curves
from jaxnh.analyses.options.orbits import CurvesOptions, HomoclinicOptions
from jaxnh.analyses.periodic.flow_cycles import flow_problem
from jaxnh.orbits.bifurcations.bogdanov_takens import amplitude_of, homoclinic_guess, unfold
from jaxnh.orbits.bifurcations.codimension_two import BOGDANOV_TAKENS
from jaxnh.orbits.bifurcations.equilibrium_forms import NormalForm
from jaxnh.orbits.bifurcations.equilibrium_points import EquilibriumPoint
from jaxnh.orbits.collocation.connection_meshes import Connection
from jaxnh.orbits.collocation.connections import VanishingPoint, connection_across
from jaxnh.orbits.collocation.equations import Problem
from jaxnh.orbits.continuation.equilibrium_curves import FieldPlane

EXTENTS = (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3)
"""Extents of first orbits, in sizes of equilibria."""

_VALUES = 5  # of the first axis at which equilibria are looked for
_VANISHED = 0.125  # of the first orbit: a curve ends with one that is as small
_SAME = 1e-6  # widths: points on curves of folds and of Hopf points
_APART = 0.5  # of what leads from the point to a guess: Newton does not go further
_EXTENTS = 0.5, 2.0  # of that of a guess


class BogdanovTakensStart(NamedTuple):
    """A point, and the first orbit on its curve.

    Attributes:
        state: the equilibrium, (d,).
        values, error: of both parameters, (2,).
        problem: the field in sizes of the orbit.
        orbit: None where Newton has confirmed none.
        tried: why, in words.
    """

    state: Float[np.ndarray, " d"]
    values: Float[np.ndarray, " 2"]
    error: Float[np.ndarray, " 2"]
    problem: Problem | None
    orbit: Connection | None
    tried: str

    def vanishing(self) -> VanishingPoint:
        """The ending of curves at the point; of one without an orbit, one that no curve comes to."""
        if self.orbit is None:
            return VanishingPoint(self.state, np.zeros_like(self.state))
        return VanishingPoint(self.state, _VANISHED * np.abs(self.orbit.solution.path.ends[0] - self.state).max(axis=0))


def bogdanov_takens_starts(
    batches: Sequence[LaneBatch],
    lanes: LaneRunner,
    options: HomoclinicOptions,
    names: tuple[str, str],
    ends: tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]],
) -> list[BogdanovTakensStart]:
    """All points between the ends of both parameters' ranges, each with the first orbit of its curve.

    Args:
        batches: lanes along the first axis, at values of the second.
        lanes: runs lanes.
        options: of the analysis.
        names: of both parameters.
        ends: of the ranges of both, the lower ones first.
    """
    asked = CurvesOptions(
        max_period=0, equilibria=options.n_starts, seed=options.seed, box=options.box, n_values=_VALUES
    )
    plane, followed = equilibrium_curves(batches, lanes, asked, names, *ends)
    points = [pair for curve in followed for pair in zip(curve.points, curve.forms, strict=True)]

    def problem_of(size: Float[np.ndarray, " d"]) -> Problem:
        return flow_problem(batches[0].without_section(), lanes, size, names, plane.width)

    starts = list[BogdanovTakensStart]()
    with lanes.stage("homoclinic: orbits from Bogdanov–Takens points", 0):
        for located, form in points:
            if located.point.kind == BOGDANOV_TAKENS and not any(_is_same(plane, one, located) for one in starts):
                starts.append(_start(plane, problem_of, located, form))
    return starts


def _is_same(plane: FieldPlane, start: BogdanovTakensStart, located: EquilibriumPoint) -> bool:
    """Tell whether a point is that of a start."""
    point = located.point
    apart = [(start.values - point.values) / plane.width, plane.wrap(start.state - point.points[0]) / plane.size]
    return bool(np.abs(np.concatenate(apart)).max() <= _SAME)


def _start(
    plane: FieldPlane,
    problem_of: Callable[[Float[np.ndarray, " d"]], Problem],
    located: EquilibriumPoint,
    form: NormalForm,
) -> BogdanovTakensStart:
    """The largest orbit at a point that Newton confirms."""
    state, values = form.at.u[0], form.at.values[0]
    none = BogdanovTakensStart(state, values, located.error, None, None, "")
    unfolding = unfold(plane, form.at)
    if unfolding is None:
        return none._replace(tried="a coefficient of its normal form is zero, or the parameters do not unfold it")
    amplitudes = [amplitude_of(plane, unfolding, extent) for extent in EXTENTS]
    for eps in sorted(set(amplitudes), reverse=True):
        guess, saddle = homoclinic_guess(unfolding, eps)
        problem = problem_of(path_size(guess.path.ends[0]))
        orbit = connection_across(problem, guess, saddle, saddle)
        if orbit is None or np.any(orbit.values < plane.low) or np.any(orbit.values > plane.high):
            continue
        extents = np.ptp(orbit.solution.path.ends[0], axis=0) / np.ptp(guess.path.ends[0], axis=0)
        largest = float(extents[np.argmax(np.ptp(guess.path.ends[0] / plane.size, axis=0))])
        moved, away = (orbit.values - guess.values) / plane.width, (guess.values - values) / plane.width
        near = np.linalg.norm(moved) <= _APART * np.linalg.norm(away)
        if near and _EXTENTS[0] <= largest <= _EXTENTS[1]:
            return none._replace(problem=problem, orbit=orbit)
    return none._replace(
        tried=f"Newton confirms no orbit of the normal form of extents {max(EXTENTS):g} to {min(EXTENTS):g} of the "
        "equilibria's"
    )


def path_size(states: Float[np.ndarray, "k d"]) -> Float[np.ndarray, " d"]:
    """Half the extent of a path in each coordinate."""
    size = 0.5 * np.ptp(states, axis=0)
    return np.where(size > 1e-6 * size.max(), size, size.max())
