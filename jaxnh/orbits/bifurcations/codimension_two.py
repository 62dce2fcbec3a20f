"""Points of codimension two on curves of bifurcations: cusps, generalised doublings, resonances and others. Host code.

Each has a test function that passes zero along its curve. Where it changes sign between two points, its zero is
located by secants on the curve itself (Illinois). A change of sign through infinity, as cubic coefficients have at
strong resonances, is none (Kuznetsov, Elements of Applied Bifurcation Theory, 2004, 9).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from jaxnh.maps.iterate import Derivatives
from jaxnh.orbits.bifurcations.location import NODES, critical, roots
from jaxnh.orbits.bifurcations.normal_forms import Cubic, cubic
from jaxnh.orbits.continuation.arclength import CurveOrbits, Family, PathVector
from jaxnh.orbits.continuation.core import Solution
from jaxnh.orbits.continuation.curves import (
    Curve,
    ParameterPlane,
    correct,
    join_unknowns,
    split_unknowns,
    test_function,
)
from jaxnh.orbits.continuation.kinds import DOUBLING, FOLD, NEIMARK_SACKER
from jaxnh.orbits.continuation.tracks import across_chord
from jaxnh.orbits.multipliers import angle_cosine, multipliers
from jaxnh.systems.rows import write_rows

POINTS = (
    "cusp",
    "generalised_doubling",
    "chenciner",
    "fold_flip",
    "resonance_1_1",
    "resonance_1_2",
    "resonance_1_3",
    "resonance_1_4",
    "bogdanov_takens",
    "generalised_hopf",
    "zero_hopf",
    "double_hopf",
)
"""Points of codimension two by number; the last four are of equilibria, and cusps of both."""

CUSP, GENERALISED_DOUBLING, CHENCINER, FOLD_FLIP, ONE_ONE, ONE_TWO, ONE_THREE, ONE_FOUR, *_ = range(len(POINTS))
BOGDANOV_TAKENS, GENERALISED_HOPF, ZERO_HOPF, DOUBLE_HOPF = range(ONE_FOUR + 1, len(POINTS))

_SECANTS = 60
_KNOWN = 1e-13  # of the chord, or of the larger of both values: a zero is known to rounding
_BESIDE = (1e-3, 1e-2, 1e-1)  # of a chord, half of what nodes about a zero reach
_POLE = 0.2  # of the smaller of both values of a test function: what is no smaller at its zero is a pole
_NEIGHBOURS = 2  # points of a curve further apart, between which a test function is not known, show no zero of it
_OF_CUBICS = CHENCINER, GENERALISED_DOUBLING
_COSINES = {ONE_ONE: 1.0, ONE_TWO: -1.0, ONE_THREE: -0.5, ONE_FOUR: 0.0}


class Special(NamedTuple):
    """A point of codimension two.

    Attributes:
        kind: number in `POINTS`.
        values: of both parameters, (2,).
        place: of the point of the curve before it.
        points: the orbit, (n, d).
        multipliers: of it, (d,).
    """

    kind: int
    values: Float[np.ndarray, " 2"]
    place: int
    points: Float[np.ndarray, "n d"]
    multipliers: Complex[np.ndarray, " d"]


def special_points(plane: ParameterPlane, curve: Curve) -> list[Special]:
    """All that a curve passes through, in its order."""
    points = list[Special]()
    for kind, test in _tests(plane, curve.kind).items():
        values = _known_signs(plane, curve) if kind in _OF_CUBICS else test(curve.track)
        known = np.flatnonzero(np.isfinite(values))
        changes = (np.diff(np.signbit(values[known])) != 0) & (np.diff(known) <= _NEIGHBOURS)
        for place, after in zip(known[:-1][changes].tolist(), known[1:][changes].tolist(), strict=True):
            if at := _locate(plane, curve, test, place, (float(values[place]), float(values[after])), after):
                points.append(_special(plane, kind, place, at))
    if curve.kind == NEIMARK_SACKER and len(plane.size) == 2:
        # What turns nothing is symmetric: ±1 where e^(±iθ) are on the circle, and any such matrix of a neutral saddle.
        with np.errstate(invalid="ignore"):
            turns = np.where(np.abs(angle_cosine(curve.multipliers)) <= 1.0, _turning(curve.track), np.nan)
        for place in np.flatnonzero(turns[1:] * turns[:-1] < 0.0).tolist():
            if at := _locate(plane, curve, _turning, place, (float(turns[place]), float(turns[place + 1]))):
                half = angle_cosine(multipliers(at.blocks))[0] < 0.0
                points.append(_special(plane, ONE_TWO if half else ONE_ONE, place, at))
    if curve.kind == FOLD:
        ways = curve.track.way[:, -2:]
        for place in np.flatnonzero(np.sum(ways[1:] * ways[:-1], axis=1) < 0.0).tolist():
            ends = float(ways[place] @ ways[place]), float(ways[place + 1] @ ways[place])
            if at := _locate(plane, curve, _forward(curve, place), place, ends):
                points.append(_special(plane, CUSP, place, at))
    return sorted(points, key=lambda point: point.place)


def _known_signs(plane: ParameterPlane, curve: Curve) -> Float[np.ndarray, " points"]:
    """The cubic coefficients of a curve; NaN where the sign of one is no more than its error."""
    cubics = _cubic(plane, curve.kind, curve.track)
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(cubics.coefficient) > cubics.error, cubics.coefficient, np.nan)


def location_errors(plane: ParameterPlane, curve: Curve, point: Special) -> Float[np.ndarray, " 2"]:
    """Errors of both parameters by where the test function of a point is zero on its curve; NaN where it is not known.

    The function is taken at nodes beside the point: a polynomial through them shows rounding, and how fast it passes
    zero what an error of it is worth. Cubic coefficients, which are differences, say their own.
    """
    track = curve.track.take(slice(point.place, point.place + 2))
    chord = track.z[1] - track.z[0]
    z, across = join_unknowns(plane, point.points[None], point.values[None]), np.tile(chord, (len(NODES), 1))
    across /= np.linalg.norm(chord)
    best = np.full(2, np.inf)
    for width in _BESIDE:
        nodes = correct(plane, curve.kind, z + width * NODES[:, None] * chord, across)
        if not nodes.converged.all():
            continue
        values = split_unknowns(plane, nodes.z)[1]
        for test in _tests_of(plane, curve, point):
            with np.errstate(all="ignore"):
                tests = test(nodes)
                _, _, value, error, _ = roots(np.repeat(tests[None], 2, axis=0), np.ascontiguousarray(values.T))
                slope = np.abs((values[-1] - values[0]) / (tests[-1] - tests[0]))
                total = error + np.abs(value - point.values) + slope * _test_error(plane, curve.kind, point.kind, nodes)
            best = np.fmin(best, total)
    return np.where(np.isfinite(best), best, np.nan)


def _tests_of(
    plane: ParameterPlane, curve: Curve, point: Special
) -> list[Callable[[Solution], Float[np.ndarray, " lanes"]]]:
    """Test functions of which one is zero at a point of codimension two."""
    if point.kind == CUSP:
        return [_forward(curve, point.place)]
    turns = curve.kind == NEIMARK_SACKER and len(plane.size) == 2 and point.kind in (ONE_ONE, ONE_TWO)
    return [_tests(plane, curve.kind)[point.kind], *([_turning] if turns else [])]


def _test_error(plane: ParameterPlane, kind: int, special: int, nodes: Solution) -> float:
    """Return the error of a test function that is a cubic coefficient; zero of others."""
    if special not in _OF_CUBICS:
        return 0.0
    return float(np.max(_cubic(plane, kind, nodes).error))


def _forward(curve: Curve, place: int) -> Callable[[Solution], Float[np.ndarray, " lanes"]]:
    """The share of a curve's direction, in the parameters, along the one at a place: zero at a cusp."""
    first = curve.track.way[place, -2:]
    return lambda track: track.way[:, -2:] @ first


def _special(plane: ParameterPlane, kind: int, place: int, at: Solution) -> Special:
    points, values = split_unknowns(plane, at.z)
    return Special(kind, values[0], place, points[0], multipliers(at.blocks)[0])


def _tests(plane: ParameterPlane, kind: int) -> dict[int, Callable[[Solution], Float[np.ndarray, " lanes"]]]:
    """Test functions by what they show, on curves of a kind."""
    if kind == NEIMARK_SACKER:

        def to_cosine(cosine: float) -> Callable[[Solution], np.ndarray]:
            return lambda track: angle_cosine(multipliers(track.blocks)) - cosine

        tests = {point: to_cosine(cosine) for point, cosine in _COSINES.items()}
        return {CHENCINER: lambda track: _cubic(plane, kind, track).coefficient, **tests}
    critical = 1.0 if kind == FOLD else -1.0
    other, resonance = (DOUBLING, ONE_ONE) if kind == FOLD else (FOLD, ONE_TWO)
    tests: dict[int, Callable[[Solution], np.ndarray]] = {
        FOLD_FLIP: lambda track: test_function(other, track.blocks),
        resonance: lambda track: _product_of_others(multipliers(track.blocks), critical),
    }
    if kind == DOUBLING:
        tests[GENERALISED_DOUBLING] = lambda track: _cubic(plane, kind, track).coefficient
    return tests


def _product_of_others(values: Complex[np.ndarray, "lanes d"], critical: float) -> Float[np.ndarray, " lanes"]:
    """∏(μ − μ_c) over all multipliers but the critical one: it is zero where this one is double."""
    nearest = np.argmin(np.abs(values - critical), axis=1)
    apart = values - critical
    apart[np.arange(len(values)), nearest] = 1.0
    return np.real(np.prod(apart, axis=1))


def _turning(track: Solution) -> Float[np.ndarray, " lanes"]:
    """Sense in which M turns, in two dimensions: zero where M is ±1, which a symmetry can bring about on a curve.

    There e^(±iθ) pass −1 or 1 and stay on the circle: cos θ has an extremum, and goes through nothing.
    """
    whole = track.blocks[:, 0]
    for i in range(1, track.blocks.shape[1]):
        whole = track.blocks[:, i] @ whole
    return whole[:, 1, 0] - whole[:, 0, 1]


def _cubic(plane: ParameterPlane, kind: int, track: Solution) -> Cubic:
    """The cubic coefficient of the normal form of each point, over its own number in place of a parameter."""
    points, values = split_unknowns(plane, track.z)
    lanes, n, d = points.shape

    def period(u: np.ndarray, number: np.ndarray) -> Derivatives:
        return plane.period(u, values[number.astype(int)])

    none, way = np.zeros(lanes), PathVector(np.zeros((lanes, n, d)), np.zeros(lanes))
    orbits = CurveOrbits(
        points, np.arange(lanes, dtype=float), way, track.blocks, none, none, none, track.converged, way
    )
    family = Family(period, plane.wrap, plane.size, 0.0, float(max(lanes, 1)))
    subset = np.arange(lanes)
    if kind == NEIMARK_SACKER:  # beyond strong resonances there are no complex multipliers
        subset = np.flatnonzero(np.isfinite(critical(family, multipliers(track.blocks))))
    with np.errstate(divide="ignore", invalid="ignore"):  # at strong resonances it is infinite
        form = cubic(family, orbits.take(subset), np.full(len(subset), kind))
    missing = np.full(lanes, np.nan)
    whole = Cubic(missing, missing.copy(), np.zeros(lanes, int), np.zeros(points.shape, complex))
    write_rows(whole, subset, form)
    return whole


def _locate(
    plane: ParameterPlane,
    curve: Curve,
    test: Callable[[Solution], np.ndarray],
    place: int,
    ends: tuple[float, float],
    after: int | None = None,
) -> Solution | None:
    """The point of a curve between two of its own where a test function is zero; None where it is infinite.

    Args:
        place, after: numbers of both points, which are neighbours unless said.
        ends: values of the test function there.
    """
    track = curve.track.take(np.array([place, place + 1 if after is None else after]))

    def at(share: float) -> tuple[Solution, float]:
        solution = correct(plane, curve.kind, *across_chord(track.z, track.way, np.array([share])))
        return solution, float(test(solution)[0]) if solution.converged[0] else np.nan

    share = false_position(lambda share: at(share)[1], ends)
    if share is None:
        return None
    solution, value = at(share)
    return solution if abs(value) <= _POLE * min(map(abs, ends)) else None


def false_position(value: Callable[[float], float], ends: tuple[float, float]) -> float | None:
    """The share between 0 and 1 where a function is zero, with the Illinois rule; None where it has no value."""
    (low, high), (below, above) = (0.0, 1.0), ends
    for _ in range(_SECANTS):
        share = (low * above - high * below) / (above - below)
        test = value(share)
        if not np.isfinite(test):
            return None
        if abs(share - high) <= _KNOWN or abs(test) <= _KNOWN * max(map(abs, ends)):
            return share
        if test * above < 0.0:
            low, below = high, above
        else:
            below *= 0.5
        high, above = share, test
    return high
