"""Links from bifurcations on branches to the curves that go through them: host code."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxnh.orbits.continuation.curves import Curve
from jaxnh.systems.chart import Wrap

NONE = -1
"""Number that stands for no curve."""

_NEAR = 2e-2  # widths: chords of a curve are as near to it, whose steps are as long at most
_SAME = 0.2  # sizes: orbits at both ends of a chord are no further apart, and other ones mostly are


def curve_through(
    curves: Sequence[Curve],
    kind: int,
    period: int,
    points: Float[np.ndarray, "n d"],
    values: Float[np.ndarray, " 2"],
    widths: Float[np.ndarray, " 2"],
    wrap: Wrap,
    size: Float[np.ndarray, " d"],
) -> int:
    """The number of the curve that goes through a bifurcation, `NONE` where none does.

    Of curves of its kind and period that pass its parameters it is the one whose orbit there is nearest, whichever of
    its points comes first.

    Args:
        curves: all that were followed.
        kind: number in `KINDS`.
        period: of the orbit, 0 of equilibria.
        points: the orbit, or the equilibrium.
        values: both parameters.
        widths: of the plane.
        wrap: of differences of points.
        size: of the motion in each coordinate of points.
    """
    best, least = NONE, _SAME
    for number, curve in enumerate(curves):
        if (curve.kind, curve.period) != (kind, period) or len(curve.values) < 2:
            continue
        chain = curve.values / widths
        chords, gaps = np.diff(chain, axis=0), values / widths - chain[:-1]
        lengths = np.maximum(np.sum(chords**2, axis=1), np.finfo(float).tiny)
        share = np.clip(np.sum(gaps * chords, axis=1) / lengths, 0.0, 1.0)
        for k in np.flatnonzero(np.linalg.norm(gaps - share[:, None] * chords, axis=1) <= _NEAR):
            there = curve.points[k] + share[k] * wrap(curve.points[k + 1] - curve.points[k])
            shifted = [wrap(np.roll(there, m, axis=0) - points) / size for m in range(len(points))]
            away = min(float(np.abs(gap).max()) for gap in shifted)
            if away < least:
                best, least = number, away
    return best
