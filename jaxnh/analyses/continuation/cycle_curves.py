"""First cycles of the curves of bifurcations of cycles that leave points of codimension two of equilibria."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxnh.analyses.continuation.equilibria import AMPLITUDES
from jaxnh.orbits.bifurcations.cycle_curve_starts import CycleStart, cycle_starts
from jaxnh.orbits.bifurcations.equilibrium_forms import NormalForm
from jaxnh.orbits.bifurcations.equilibrium_points import EquilibriumPoint
from jaxnh.orbits.bifurcations.hopf_cycles import SectionPlane
from jaxnh.orbits.continuation.curves import ParameterPlane, correct, join_unknowns, split_unknowns
from jaxnh.orbits.continuation.equilibrium_curves import FieldPlane

_SAME = 1e-6  # widths: a point that is on two curves
_MOVED = 0.5  # of how far a cycle is from its equilibrium, that Newton may go


def cycle_seeds(
    field: FieldPlane,
    plane: ParameterPlane,
    section: SectionPlane,
    points: Sequence[tuple[EquilibriumPoint, NormalForm]],
) -> list[CycleStart]:
    """The smallest cycle that Newton confirms on each curve that leaves a point, where small ones cross the section.

    Args:
        field: of the flow.
        plane: the section's map over the same parameters.
        section: of the flow.
        points: of codimension two with their normal forms; those that two curves have in common count once.
    """
    seeds, done = list[CycleStart](), list[tuple[int, np.ndarray]]()
    amplitudes = [r * float(np.linalg.norm(field.size)) for r in AMPLITUDES]
    for point, form in points:
        kind, place = point.point.kind, point.point.values / field.width
        if any(other == kind and np.abs(place - there).max() < _SAME for other, there in done):
            continue
        done.append((kind, place))
        for starts in cycle_starts(field, point, form, section, amplitudes):
            seeds += _confirmed(plane, starts)[:1]
    return seeds


def _confirmed(plane: ParameterPlane, starts: Sequence[CycleStart]) -> list[CycleStart]:
    """The cycles that Newton comes to without going far, in their order."""
    if not starts:
        return []
    guesses, values = np.stack([start.points for start in starts]), np.stack([start.values for start in starts])
    solution = correct(plane, starts[0].kind, join_unknowns(plane, guesses, values))
    orbits, both = split_unknowns(plane, solution.z)
    extent = np.array([np.linalg.norm((start.points[0] - start.centre) / plane.size) for start in starts])
    good = solution.converged & (solution.missed <= _MOVED * extent)
    good &= np.all((both >= plane.low) & (both <= plane.high), axis=1)
    return [starts[k]._replace(points=orbits[k], values=both[k]) for k in np.flatnonzero(good).tolist()]
