"""Curves of folds and Hopf points of equilibria of a flow without a clock, with all that they pass through.

Bifurcations to begin with are those of the branches of equilibria over the first axis at some values of the second
(`equilibria`). At points of codimension two the other curves through them are followed in turn, none twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.continuation.equilibria import equilibria
from jaxnh.analyses.continuation.families import field_plane, step_control
from jaxnh.analyses.options.orbits import CurvesOptions
from jaxnh.orbits.bifurcations.equilibrium_forms import NormalForm, normal_form
from jaxnh.orbits.bifurcations.equilibrium_points import (
    EquilibriumPoint,
    ended_at_points,
    equilibrium_points,
    other_curves,
)
from jaxnh.orbits.continuation import core
from jaxnh.orbits.continuation.core import FINE
from jaxnh.orbits.continuation.curves import Curve
from jaxnh.orbits.continuation.equilibrium_curves import (
    CriticalEquilibria,
    EigenvectorEquations,
    FieldPlane,
    critical_equilibria,
    follow_curves,
    join_curves,
    passes,
)
from jaxnh.orbits.continuation.kinds import FOLD, HOPF
from jaxnh.orbits.continuation.paths import STEPS, StepControl
from jaxnh.systems.rows import spread_indices

_NEAR = 1e-3  # lengths: a chord between two points is nearer to its curve than this
_SAFETY = 4.0  # rounding of one step of Newton against that of a point
_FLOOR = 16 * np.finfo(float).eps


class EquilibriumCurve(NamedTuple):
    """A curve with its points of codimension two and their normal forms."""

    curve: Curve
    points: list[EquilibriumPoint]
    forms: list[NormalForm]


class EquilibriumCurves(NamedTuple):
    """The field over the plane of parameters, and all curves that were followed there."""

    plane: FieldPlane
    curves: list[EquilibriumCurve]


def equilibrium_curves(
    batches: Sequence[LaneBatch],
    lanes: LaneRunner,
    options: CurvesOptions,
    names: tuple[str, str],
    low: Float[np.ndarray, " 2"],
    high: Float[np.ndarray, " 2"],
) -> EquilibriumCurves:
    """All curves that equilibria by Newton from random starts lead to.

    Args:
        batches: lanes along the first axis, at values of the second.
        lanes: runs lanes.
        options: of `curves`.
        names: of both parameters.
        low, high: ends of their ranges.
    """

    def stage(label: str) -> AbstractContextManager[object]:
        return lanes.stage(f"curves: {label}", 0)

    steps, ends = step_control(options)._replace(max_steps=STEPS.max_steps), (float(low[0]), float(high[0]))
    seeds, size = list[tuple[int, np.ndarray, np.ndarray]](), np.ones(batches[0].flow.chart.dimension)
    for batch in batches:
        sampled = spread_indices(len(batch.first_axis.values), options.n_values)
        sample = batch.take(np.argsort(batch.first_axis.values, kind="stable")[sampled])
        followed = equilibria(sample, lanes, options.equilibria, options.seed, options.box, ends, steps, stage)
        size, second = followed.family.size, float(batch.p[names[1]][0])
        seeds += [
            (point.kind, point.points[0], np.array([point.value, second]))
            for point in followed.tree.bifurcations
            if point.kind in (FOLD, HOPF)
        ]
    plane = field_plane(batches[0], lanes, size, names, low, high)
    if not seeds:
        return EquilibriumCurves(plane, [])
    u, values = np.stack([seed[1] for seed in seeds]), np.stack([seed[2] for seed in seeds])
    blocks = linearisations(plane, u, values)
    plane = plane._replace(frequency=float(np.median(np.abs(np.linalg.eigvals(blocks)).max(axis=1))))
    starts = [
        (kind, critical_equilibria(plane, kind, u[k : k + 1], values[k : k + 1], blocks[k : k + 1]))
        for k, (kind, _, _) in enumerate(seeds)
    ]
    with stage(f"curves of equilibria from {len(starts)} bifurcations"):
        return EquilibriumCurves(plane, follow_all(plane, starts, step_control(options)))


def rounding_errors(plane: FieldPlane, curve: Curve) -> Float[np.ndarray, "k 2"]:
    """Errors of both parameters at all points of a curve, by what one more step of Newton changes."""
    again = core.correct(EigenvectorEquations(plane, curve.kind), curve.track.z, curve.track.way, FINE)
    rounding = _FLOOR * (plane.width + np.abs(curve.values))
    return _SAFETY * np.abs(again.z - curve.track.z)[:, -2:] * plane.width + rounding


def linearisations(
    plane: FieldPlane, u: Float[np.ndarray, "lanes d"], values: Float[np.ndarray, "lanes 2"]
) -> Float[np.ndarray, "lanes d d"]:
    """Derivatives of the field at points, in units of the coordinates."""
    none = np.zeros((len(u), 1, u.shape[1]))
    return plane.rates(u, values, none)[1][:, :, : u.shape[1]]


def follow_all(
    plane: FieldPlane, starts: Sequence[tuple[int, CriticalEquilibria]], steps: StepControl
) -> list[EquilibriumCurve]:
    """The curves through bifurcations and those that leave at their points of codimension two, each once."""
    curves, queue = list[EquilibriumCurve](), list(starts)
    while queue:
        kind, at = queue.pop(0)
        if not np.isfinite(at.first).all() or passes(plane, [known.curve for known in curves], kind, at, _NEAR):
            continue
        [curve] = follow_curves(plane, kind, at, steps)
        if curve is None:
            continue
        apart = list[EquilibriumCurve]()
        for other in curves:
            whole = join_curves(plane, other.curve, curve, _NEAR)  # where it was cut on this one
            curve, more = (curve, [other]) if whole is None else (whole, [])
            apart += more
        points = equilibrium_points(plane, curve)
        curve = ended_at_points(plane, curve, points)
        curves = [*apart, EquilibriumCurve(curve, points, [normal_form(plane, point) for point in points])]
        queue += [other for point in points for other in other_curves(plane, kind, point)]
    return curves
