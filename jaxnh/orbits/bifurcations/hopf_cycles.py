"""Small cycles at Hopf points of equilibria, by the normal form: where they cross a section; and small tori. Host code.

With the critical vector q (A q = iω q, of length one in sizes), the cubic coefficient s (`normal_forms`) and the rate
α′ of the eigenvalues' real part over the parameter λ, the cycles of amplitude r are

    u = u₀(λ) + 2 r Re(q e^{iθ}) + O(r²),    λ = λ₀ − (s/α′) r² + O(r⁴)

(Kuznetsov, Elements of Applied Bifurcation Theory, 2004, 3.5): where the equilibrium is unstable if s is negative, and
where it is stable if s is positive. At a Neimark–Sacker point of a map the invariant curves are the same, with the
logarithm of the multipliers' modulus in place of the real part (4.7), and θ advances by the argument of the multiplier.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from jaxnh.orbits.bifurcations.location import critical
from jaxnh.orbits.bifurcations.normal_forms import cubic
from jaxnh.orbits.continuation.arclength import Family, PathVector, along_parameter, correct
from jaxnh.orbits.continuation.core import FINE
from jaxnh.orbits.continuation.kinds import HOPF, NEIMARK_SACKER, eigenvalues

_SHIFT = 1e-4  # widths of the range: rates over the parameter are wrong by its square
_INSIDE = 0.9  # of a cycle's extent, that the section is within


class HopfPoint(NamedTuple):
    """A Hopf point and the cycles that it begins; or a Neimark–Sacker point and its invariant curves.

    Attributes:
        value: λ₀.
        u: the equilibrium, or the first point of the orbit, (d,).
        drift: du₀/dλ, (d,).
        vector: q, (d,).
        bend: −s/α′, of the parameter in the square of the amplitude.
        turn: of a multiplier, its argument, in turns.
    """

    value: float
    u: Float[np.ndarray, " d"]
    drift: Float[np.ndarray, " d"]
    vector: Complex[np.ndarray, " d"]
    bend: float
    turn: float


class SectionPlane(NamedTuple):
    """A section of a flow: where weights · u = level, in a direction, given by all coordinates but one.

    Attributes:
        weights: (d,).
        level: of the section.
        direction: "up", "down" or "both".
        number: of the coordinate that the section gives.
    """

    weights: Float[np.ndarray, " d"]
    level: float
    direction: str
    number: int


def hopf_points(
    family: Family, points: Float[np.ndarray, "some n d"], value: Float[np.ndarray, " some"]
) -> list[HopfPoint]:
    """The normal forms at Hopf points of equilibria, or Neimark–Sacker points of orbits of a map.

    Those where it is not known are left out.
    """
    some, n, _ = points.shape
    shift = _SHIFT * family.width
    across = along_parameter(family, some, n)
    at, before, after = (correct(family, points, value + s, across, FINE) for s in (0.0, -shift, shift))
    with np.errstate(invalid="ignore", divide="ignore"):
        nearest = [critical(family, eigenvalues(family, orbits)) for orbits in (before, at, after)]
        grown = [np.real(each) if family.field else np.log(np.abs(each)) for each in nearest]
        rate = (grown[2] - grown[0]) / (2.0 * shift)
        drift = (after.points - before.points)[:, 0] / (2.0 * shift)
        normal = cubic(family, at, np.full(some, HOPF if family.field else NEIMARK_SACKER))
        bend = -normal.coefficient / rate
    vectors, turn = normal.vectors[:, 0] * family.size, np.angle(nearest[1]) / (2.0 * np.pi)
    known = at.converged & before.converged & after.converged & np.isfinite(bend) & (np.abs(vectors).max(axis=1) > 0.0)
    return [
        HopfPoint(float(value[k]), at.points[k, 0], drift[k], vectors[k], float(bend[k]), float(turn[k]))
        for k in np.flatnonzero(known)
    ]


def cycle_at(point: HopfPoint, plane: SectionPlane, amplitude: float) -> PathVector | None:
    """The crossings of the cycle of an amplitude with a section, (1, n, d − 1), and its parameter; None without any.

    Of a section that is crossed in both directions the upward crossing comes first.
    """
    change = point.bend * amplitude**2
    centre, turning = point.u + change * point.drift, 2.0 * amplitude * point.vector
    height, extent = plane.level - plane.weights @ centre, plane.weights @ turning
    if not np.abs(height) < _INSIDE * np.abs(extent):
        return None
    phase = np.arccos(height / np.abs(extent))  # before the highest place upward, beyond it downward
    phases = {"up": (-phase,), "down": (phase,), "both": (-phase, phase)}[plane.direction]
    whole = [centre + np.real(turning * np.exp(1j * p) * np.abs(extent) / extent) for p in phases]
    return PathVector(np.delete(np.array(whole), plane.number, axis=1)[None], np.array([point.value + change]))


def first_cycles(
    family: Family, points: Sequence[HopfPoint], plane: SectionPlane, amplitudes: Sequence[float]
) -> list[PathVector]:
    """The smallest of the cycles that Newton confirms at each Hopf point, as crossings (1, n, d − 1) and parameter.

    Args:
        family: cycles of the section's map.
        points: Hopf points.
        plane: the section.
        amplitudes: that are tried, in this order.
    """
    cycles = list[PathVector]()
    for point in points:
        guesses = [(cycle_at(point, plane, r), cycle_at(point, plane, (1.0 + _SHIFT) * r)) for r in amplitudes]
        pairs = [(near, far) for near, far in guesses if near is not None and far is not None]
        if not pairs:
            continue
        at, far = (PathVector(*map(np.concatenate, zip(*side, strict=True))) for side in zip(*pairs, strict=True))
        across = PathVector(far.points - at.points, far.value - at.value)
        orbits = correct(family, at.points, at.value, across, FINE)
        inside = orbits.converged & (orbits.value >= family.low) & (orbits.value <= family.high)
        for k in np.flatnonzero(inside)[:1]:
            cycles.append(PathVector(orbits.points[k : k + 1], orbits.value[k : k + 1]))
    return cycles
