"""Period doublings of the cascade reached from the start state, and the Feigenbaum number.

A survey sends thousands of lanes to their attractors and finds the period of each: candidates come from the strobe
points, the decision from Newton on the orbit and its multipliers, so that slow convergence near a doubling does not
bias it. Between neighbouring lanes, multisection on the multiplier brackets a doubling, and Newton on orbit, b and
multiplier −1 together finishes. Where the survey is too coarse for the next level, a new one looks closer.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pydantic import Field

from jaxnh.analyses.base import Group, LaneRunner, Options, Scene, Variable
from jaxnh.analyses.period import CONVERGED, Survey, orbits, section_points, survey
from jaxnh.maps.iterate import section_map
from jaxnh.maps.protocol import Strobe
from jaxnh.orbits.shooting import DoublingPoint, refine_doubling, segment

_TRANSIENT = 512  # periods before the strobe points are looked at
_SMALLEST_LIMIT = 16  # periods looked for even where few levels are asked for: the cascade may begin at 2 or 3
_CANDIDATES = 64  # lanes of a multisection
_CLOSER = 64  # lanes of a closer survey
_CLOSER_TRIES = 4
SEGMENT_TILE = 32
_REFINEMENTS = (1, 2, 4)


class DoublingOptions(Options):
    """Options of `doubling`."""

    levels: int = Field(default=6, ge=1, le=12, description="Number of period doublings to find")


def periods(options: DoublingOptions, lanes: int) -> float:
    """Lane-periods of a run, Newton's iterations at their price: the survey, and as much again for the orbits."""
    return 2.0 * lanes * (_TRANSIENT + 2 * 2**options.levels)


def splits(options: DoublingOptions) -> bool:
    """Never: a cascade is found by comparing neighbouring lanes."""
    return False


def run(options: DoublingOptions, scene: Scene, lanes: LaneRunner) -> Group:
    """Find up to `levels` doublings n → 2n, each with its b, its error, and δ."""
    limit = max(_SMALLEST_LIMIT, 2**options.levels)
    found = survey(
        scene, lanes, scene.values, section_points(scene), limit, "doubling", _TRANSIENT, only_doublings=True
    )
    found = found.without_holes()
    followed = _follow(found)
    points: list[DoublingPoint] = []
    errors: list[float] = []
    warning = ""
    if followed is None:
        period, warning = 1, "no period doubling in this range of b: no two neighbouring values have periods n and 2n"
    else:
        found, lane = followed
        period = int(found.period[lane])
        end = float(found.b[-1])
        for level in range(options.levels):
            n = period << level
            located = _locate(scene, lanes, found, lane, n)
            if located is None:
                warning = f"the orbit of period {n} does not double before b = {end:g}"
                break
            point, error = located
            points.append(point)
            errors.append(error)
            if level + 1 == options.levels:
                break
            ahead = _next_run(scene, lanes, found, points, 2 * n, max(limit, period << options.levels), end)
            if ahead is None:
                warning = f"no stable orbit of period {2 * n} was found beyond the doubling at b = {point.b:.9g}"
                break
            found, lane = ahead
    if warning:
        warning = f"doubling: {len(points)} of {options.levels} levels found; {warning}"
    return _group(scene.system.sweeps, options.levels, period, points, errors, warning)


def _follow(found: Survey) -> tuple[Survey, int] | None:
    """The survey in the direction in which a cascade goes furthest, and the lane where its first run begins.

    A cascade is a row of neighbouring runs of lanes, each with twice (or a higher power of two times, where the survey
    steps over a level) the period of the one before. A tie goes to the direction of the sweep, and there to the first.
    """
    best: tuple[int, Survey, int] | None = None
    for ordered in (found, Survey(*(leaf[::-1] for leaf in found))):
        starts = np.flatnonzero(np.diff(ordered.period, prepend=-1))
        periods = ordered.period[starts]
        for k in range(len(starts)):
            length = 0
            while k + length + 1 < len(starts) and _doubles(periods[k + length], periods[k + length + 1]):
                length += 1
            if length and (best is None or length > best[0]):
                best = length, ordered, int(starts[k])
    return None if best is None else best[1:]


def _doubles(n: Any, following: Any) -> Any:
    """Whether `following` is n times a power of two above one; integers or arrays of them."""
    ratio = following // np.maximum(n, 1)
    return (n > 0) & (ratio > 1) & (ratio * n == following) & (ratio & (ratio - 1) == 0)


def _locate(scene: Scene, lanes: LaneRunner, found: Survey, lane: int, n: int) -> tuple[DoublingPoint, float] | None:
    """The doubling of the stable period-n orbit that a lane of the survey is on, and the error of its b."""
    last = found.run_end(lane)
    if last + 1 == len(found.b):
        return None
    bracket = np.linspace(found.b[last], found.b[last + 1], _CANDIDATES)
    with lanes.stage(f"doubling: period {n} → {2 * n}, multisection of {_CANDIDATES}", 0):
        start = np.broadcast_to(found.u[last], (_CANDIDATES, found.u.shape[1]))
        orbit = orbits(lanes, scene.strobe(), start, bracket, n)
    ok = (orbit.residual < CONVERGED) & np.all(np.isfinite(orbit.monodromy), axis=(1, 2))
    beyond = np.flatnonzero(ok & (_most_negative(np.where(ok[:, None, None], orbit.monodromy, 0.0)) < -1.0))
    if not len(beyond):
        return None
    seed = max(int(beyond[0]) - 1, 0)
    return _refine(scene, lanes, orbit.u[seed], orbit.monodromy[seed], float(bracket[seed]), n)


def _most_negative(monodromy: np.ndarray) -> np.ndarray:
    """The smallest real eigenvalue, (lanes,); +∞ where all are complex."""
    values = np.linalg.eigvals(monodromy)
    return np.where(np.abs(values.imag) < 1e-12, values.real, np.inf).min(axis=1)


def _refine(
    scene: Scene, lanes: LaneRunner, u: np.ndarray, monodromy: np.ndarray, b: float, n: int
) -> tuple[DoublingPoint, float] | None:
    """The doubling point with twice the steps; the error of b is what three refinements and Newton moved it by."""
    values, vectors = np.linalg.eig(monodromy)
    vector = np.real(vectors[:, np.argmin(np.abs(values + 1.0))])
    orbit = _walk(lanes, scene.strobe(), u, b, n)
    carried = np.empty((n, len(u)))
    for i in range(n):
        carried[i] = vector
        vector = _segments(lanes, scene.strobe(), orbit[i : i + 1], vector[None], np.array([b])).carried[0]
    refined: list[DoublingPoint] = []
    for refinement in _REFINEMENTS:
        strobe = scene.strobe(refinement)
        point = refine_doubling(
            lambda *a, strobe=strobe: _segments(lanes, strobe, *a), orbit, carried, b, scene.system.wrap
        )
        if not point.converged:
            return None
        orbit, carried, b = point.orbit, point.vector, point.b
        refined.append(point)
    coarse, fine, finest = refined
    return fine, abs(fine.b - coarse.b) + abs(finest.b - fine.b) + fine.last_step


def _walk(lanes: LaneRunner, strobe: Strobe, u: np.ndarray, b: float, n: int) -> np.ndarray:
    """The n points of an orbit, (n, d)."""
    points = [u]
    for _ in range(n - 1):
        points.append(
            lanes(section_map, (strobe, np.int32(1)), (points[-1][None], np.array([b])), tile=SEGMENT_TILE)[0]
        )
    return np.array(points)


def _segments(lanes: LaneRunner, strobe: Strobe, u: np.ndarray, w: np.ndarray, b: np.ndarray) -> Any:
    return lanes(segment, (strobe,), (u, w, b), tile=SEGMENT_TILE)


def _next_run(
    scene: Scene, lanes: LaneRunner, found: Survey, points: list[DoublingPoint], n: int, limit: int, end: float
) -> tuple[Survey, int] | None:
    """A survey and the first lane in it that is on the period-n orbit born at the last doubling."""
    born = points[-1]
    sign = np.sign(found.b[-1] - found.b[0])
    ahead = np.flatnonzero(sign * (found.b - born.b) > 0)
    if len(ahead) and found.period[ahead[0]] == n and found.run_end(ahead[0]) > ahead[0]:
        return found, int(ahead[0])
    spacing = abs(found.b[1] - found.b[0])
    reach = 0.5 * abs(born.b - points[-2].b) if len(points) > 1 else 8 * spacing
    for _ in range(_CLOSER_TRIES):
        stop = born.b + sign * min(reach, abs(end - born.b))
        b = np.linspace(born.b, stop, _CLOSER + 1)[1:]
        start = np.broadcast_to(born.orbit[0] + 0.01 * born.vector[0], (_CLOSER, born.orbit.shape[1]))
        label = f"doubling, beyond b = {born.b:.9g}"
        closer = survey(scene, lanes, b, start, limit, label, _TRANSIENT, least=n, only_doublings=True)
        closer = closer.without_holes()
        first = np.flatnonzero(closer.period == n)
        if len(first):
            return closer, int(first[0])
        reach /= 8
    return None


def _group(
    sweeps: str, levels: int, period: int, points: list[DoublingPoint], errors: list[float], warning: str
) -> Group:
    """Points as the variables of the contract, NaN where a level was not found."""
    b = np.full(levels, np.nan)
    b[: len(points)] = [point.b for point in points]
    b_error = np.full(levels, np.nan)
    b_error[: len(points)] = errors
    delta, delta_error = _deltas(b, b_error)
    limit, limit_error = _delta_limit(delta[np.isfinite(delta)], delta_error[np.isfinite(delta)])
    index = np.arange(1, levels + 1)
    variables = {
        "level": Variable(("level",), index, "number of the period doubling"),
        "period": Variable(
            ("level",), period * 2 ** (index - 1), "period n of the orbit that doubles to 2n", "forcing periods"
        ),
        "b": Variable(("level",), b, f"{sweeps} at the doubling"),
        "b_error": Variable(("level",), b_error, "largest error of b, from step refinement and the Newton residual"),
        "delta": Variable(("level",), delta, "ratio δ of successive distances between doublings, equation (14)"),
        "delta_error": Variable(("level",), delta_error, "error of δ that the errors of b cause"),
    }
    attrs = {"delta_limit": limit, "delta_limit_error": limit_error, "levels_found": len(points)}
    return Group(variables, attrs, (warning,) if warning else ())


def _deltas(b: np.ndarray, b_error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """δ_k = (b_k − b_{k−1})/(b_{k+1} − b_k) at the middle level, NaN at both ends, and its propagated error."""
    delta = np.full(len(b), np.nan)
    error = np.full(len(b), np.nan)
    gap = np.diff(b)
    gap_error = b_error[1:] + b_error[:-1]
    delta[1:-1] = gap[:-1] / gap[1:]
    error[1:-1] = np.abs(delta[1:-1]) * (gap_error[:-1] / np.abs(gap[:-1]) + gap_error[1:] / np.abs(gap[1:]))
    return delta, error


def _delta_limit(delta: np.ndarray, error: np.ndarray) -> tuple[float, float]:
    """Limit of δ by Aitken's Δ² from the last three, with the distance from the last as part of its error.

    With two δ the last one stands for the limit, and their distance for its error; with fewer there is none (NaN).
    """
    if len(delta) < 2:
        return math.nan, math.nan
    if len(delta) == 2:
        return float(delta[1]), float(abs(delta[1] - delta[0]) + error[1])
    first, second, third = delta[-3:]
    bend = third - 2.0 * second + first
    limit = third - (third - second) ** 2 / bend if bend else third
    return float(limit), float(abs(limit - third) + error[-3:].max())
