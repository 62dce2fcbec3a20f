"""Errors of curves of bifurcations and of what they pass through, by maps with 2 and 4 times the steps. Host code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from jaxnh.orbits.bifurcations.codimension_two import Special, location_errors, special_points
from jaxnh.orbits.continuation.curves import (
    BifurcationEquations,
    Curve,
    ParameterPlane,
    correct,
    join_unknowns,
    split_unknowns,
)
from jaxnh.orbits.multipliers import multipliers


def refine_curve(plane: ParameterPlane, curve: Curve) -> Curve:
    """The curve of a finer map: of each point the one in the hyperplane across the curve, NaN where there is none."""
    track = correct(plane, curve.kind, curve.track.z, curve.track.way)
    track.z[~track.converged] = np.nan
    points, values = split_unknowns(plane, track.z)
    exponents = np.full_like(curve.multipliers, np.nan)
    exponents[track.converged] = multipliers(track.blocks[track.converged])
    return replace(curve, points=points, values=values, track=track, multipliers=exponents)


def errors_of_points(plane: ParameterPlane, curve: Curve, others: Sequence[Curve]) -> Float[np.ndarray, "k 2"]:
    """Errors of both parameters at all points of a curve, a point of the exact one being as near in both.

    Maps without steps have finer ones that say the same to the last digit: what rounding moves points by is added.

    Args:
        plane, curve: of the map itself.
        others: the same of maps with 2 and 4 times the steps (`refine_curve`).
    """
    return _error(curve.values, *(other.values for other in others)) + rounding(plane, curve.kind, curve.track.z)


def rounding(plane: ParameterPlane, kind: int, z: Float[np.ndarray, "k N"]) -> Float[np.ndarray, "k 2"]:
    """Return what rounding of the map moves both parameters by, across the curve."""
    return split_unknowns(plane, BifurcationEquations(plane, kind, z.shape[1]).rounding(z))[1]


def errors_of_special(
    planes: Sequence[ParameterPlane], curves: Sequence[Curve], point: Special
) -> Float[np.ndarray, " 2"] | None:
    """Errors of both parameters at a point of codimension two.

    They are NaN where finer maps do not follow the curve there; and None where these do and have no such point, which
    is then none: beside where cycles are born coefficients of the third order are differences of nearly nothing.

    Args:
        planes, curves: the map and those with 2 and 4 times the steps, and the same curve of each (`refine_curve`).
        point: on the curve of the map itself.
    """
    near = slice(max(point.place - 1, 0), point.place + 3)
    values = list[np.ndarray]()
    for plane, curve in zip(planes[1:], curves[1:], strict=True):
        part = curve.part(near)
        if not part.track.converged.all():
            return np.full(2, np.nan)
        same = [other.values for other in special_points(plane, part) if other.kind == point.kind]
        if not same:
            return None
        away = [np.abs((value - point.values) / (plane.high - plane.low)).max() for value in same]
        values.append(same[int(np.argmin(away))])
    z = join_unknowns(planes[0], point.points[None], point.values[None])
    across = rounding(planes[0], curves[0].kind, z)[0]
    return _error(point.values, *values) + location_errors(planes[0], curves[0], point) + across


def _error(
    coarse: Float[np.ndarray, " *shape"], fine: Float[np.ndarray, " *shape"], finest: Float[np.ndarray, " *shape"]
) -> Float[np.ndarray, " *shape"]:
    """Error of the first value, with as much in reserve for a reader who takes one parameter as exact; with rounding.

    What is left beyond the finest is less than how far it is from the one before.
    """
    return 2.0 * (np.abs(coarse - fine) + np.abs(fine - finest)) + np.spacing(np.abs(coarse))
