"""Error of the first doubling point of a sweep against the time spent on it, by three methods.

Plain detection of the period after growing transients is biased by critical slowing down, whatever the number of lanes.
Multisection on the multiplier of the orbit, which Newton finds stable or not, gains a fixed number of digits a round;
Newton on orbit, b and multiplier −1 together doubles them with each step.
"""

from __future__ import annotations

import math
import time
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array

from jaxnh.analyses import doubling
from jaxnh.analyses.base import Group, LaneRunner, Scene, Variable
from jaxnh.analyses.period import CONVERGED
from jaxnh.costs.stage import Inside
from jaxnh.maps.iterate import iterate, record, section_map
from jaxnh.maps.protocol import Strobe
from jaxnh.orbits.newton import Orbit, find_orbit
from jaxnh.orbits.shooting import refine_doubling, segment
from jaxnh.systems.particle import unchart

DETECTION, MULTISECTION, NEWTON = "period detection", "multisection", "Newton"

_TRANSIENTS = (100, 300, 1000, 3000, 10_000)  # periods before the period is looked at
_THRESHOLD = 1e-5  # strobe points nearer than this are taken for the same
_DETECTED = 5e-7  # width in b at which plain detection ends: six decimals
_CANDIDATES, _TILE = 64, 32
_SETTLED = 512  # periods before the orbit is looked for
_ROUNDS = 12
_BEHIND, _AHEAD = 2.0, 0.5  # ends of the bracket about the doubling, in distances to the next one
_FINEST = 4  # times the steps of the reference


class Cascade(NamedTuple):
    """Where to look: the orbit of period n, stable at the first end of the bracket, doubles before the second."""

    n: int
    bracket: tuple[float, float]


class Estimate(NamedTuple):
    """b after so much work: periods of transient, rounds of a multisection or steps of Newton."""

    method: str
    effort: int
    b: float
    seconds: float
    cpu_seconds: float


class _Watch:
    """Time since it was made: of the clock on the wall, and of all processors."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def read(self) -> tuple[float, float]:
        return time.perf_counter() - self._wall, time.process_time() - self._cpu


def price(scene: Scene, lanes: LaneRunner) -> Group | None:
    """Every estimate with its error and times; None where the sweep has no doubling."""
    with lanes.stage("cost: the first doubling of the sweep", 0):
        cascade = _cascade(scene, Inside(lanes))
    if cascade is None:
        return None
    with lanes.stage(f"cost: doubling of period {cascade.n} by three methods", 0):
        by_detection(scene, lanes, cascade, (1,))  # compile, and read the clock the second time
        by_multiplier(scene, lanes, cascade)
        by_newton(scene, lanes, cascade)
        newton, reference = by_newton(scene, lanes, cascade)
        estimates = [*by_detection(scene, lanes, cascade, _TRANSIENTS), *by_multiplier(scene, lanes, cascade), *newton]
    return _group(estimates, reference, cascade)


def _cascade(scene: Scene, lanes: LaneRunner) -> Cascade | None:
    """The first doubling that the analysis finds, in a bracket of several times the distance to the next one."""
    found = doubling.run(doubling.DoublingOptions(levels=2), scene, lanes).variables
    first, second = found["b"].data
    if math.isnan(first):
        return None
    n = int(found["period"].data[0])
    low, high = scene.values.min(), scene.values.max()
    if math.isnan(second):  # then half of what the sweep has on either side, in the direction in which it doubles
        reach = min(first - low, high - first) / 2
        tried = [Cascade(n, (first - ahead, first + ahead)) for ahead in (reach, -reach)]
        return next((c for c in tried if _narrowed(scene, lanes, n, _settled(scene, lanes, c), c.bracket)), None)
    ends = np.clip(first + np.array([-_BEHIND, _AHEAD]) * (second - first), low, high)
    return Cascade(n, (float(ends[0]), float(ends[1])))


def by_detection(scene: Scene, lanes: LaneRunner, cascade: Cascade, transients: tuple[int, ...]) -> list[Estimate]:
    """Multisection on whether strobe points recur after n periods, an estimate a transient.

    Nothing is given for a transient too short for any lane to have settled.
    """
    estimates = []
    u = scene.system.section_point(scene.start)
    for transient in transients:
        watch, (near, far) = _Watch(), cascade.bracket
        while abs(far - near) > _DETECTED:
            b = np.linspace(near, far, _CANDIDATES)
            gap = lanes(
                _recurrence,
                (scene.strobe(), np.int32(transient)),
                (np.broadcast_to(u, (_CANDIDATES, 3)), b),
                periods=transient + 2 * cascade.n,
                tile=_TILE,
                static=(cascade.n,),
            )
            first = _first(gap > _THRESHOLD)
            if first is None:
                break
            near, far = b[first - 1], b[first]
        else:
            estimates.append(Estimate(DETECTION, transient, 0.5 * (near + far), *watch.read()))
    return estimates


def by_multiplier(scene: Scene, lanes: LaneRunner, cascade: Cascade) -> list[Estimate]:
    """Multisection on whether the orbit's smallest real multiplier is below −1, an estimate a round."""
    watch = _Watch()
    estimates = []
    u, bracket = _settled(scene, lanes, cascade), cascade.bracket
    for round_ in range(_ROUNDS):
        found = _narrowed(scene, lanes, cascade.n, u, bracket)
        if found is None:
            break
        width = abs(bracket[1] - bracket[0])
        orbit, bracket = found
        u = orbit.u
        estimates.append(Estimate(MULTISECTION, round_ + 1, 0.5 * (bracket[0] + bracket[1]), *watch.read()))
        if not 0 < abs(bracket[1] - bracket[0]) < width:
            break
    return estimates


def by_newton(scene: Scene, lanes: LaneRunner, cascade: Cascade) -> tuple[list[Estimate], float]:
    """Newton from the first round of a multisection, with the scene's steps and then twice as many; an estimate a step.

    Returns:
        The estimates, and b with four times the steps, whose time is not counted.
    """
    watch = _Watch()
    estimates: list[Estimate] = []
    found = _narrowed(scene, lanes, cascade.n, _settled(scene, lanes, cascade), cascade.bracket)
    if found is None:
        return [], math.nan
    orbit, (b, _) = found
    points, vectors = _around(scene, lanes, orbit, b, cascade.n)
    steps: list[Estimate] = []
    for refinement in (1, 2, _FINEST):
        estimates, steps = steps, list(steps)
        strobe = scene.strobe(refinement)

        def segments(
            u: np.ndarray, w: np.ndarray, b: np.ndarray, strobe: Strobe = strobe, steps: list[Estimate] = steps
        ) -> Any:
            steps.append(Estimate(NEWTON, len(steps), float(b[0]), *watch.read()))
            return lanes(segment, (strobe,), (u, w, b), tile=_TILE)

        point = refine_doubling(segments, points, vectors, b)
        points, vectors, b = point.orbit, point.vector, point.b
    return estimates, b


def _settled(scene: Scene, lanes: LaneRunner, cascade: Cascade) -> np.ndarray:
    """A point near the orbit at the stable end of the bracket, (3,)."""
    b = np.array(cascade.bracket[:1])
    u = scene.system.section_point(scene.start)[None]
    return lanes(section_map, (scene.strobe(0.5), np.int32(_SETTLED)), (u, b), periods=_SETTLED, tile=_TILE)[0]


def _narrowed(
    scene: Scene, lanes: LaneRunner, n: int, u: np.ndarray, bracket: tuple[float, float]
) -> tuple[Orbit, tuple[float, float]] | None:
    """The orbit at the stable end of the part of a bracket in which its multiplier passes −1, and that part."""
    b = np.linspace(*bracket, _CANDIDATES)
    start = np.broadcast_to(u, (_CANDIDATES, 3))
    orbit = lanes(find_orbit, (scene.strobe(), np.int32(n)), (start, b), tile=_TILE)
    ok = (orbit.residual < CONVERGED) & np.all(np.isfinite(orbit.monodromy), axis=(1, 2))
    first = _first(ok & (_smallest(np.where(ok[:, None, None], orbit.monodromy, 0.0)) < -1.0))
    if first is None:
        return None
    return Orbit(*(leaf[first - 1] for leaf in orbit)), (float(b[first - 1]), float(b[first]))


def _around(scene: Scene, lanes: LaneRunner, orbit: Orbit, b: float, n: int) -> tuple[np.ndarray, np.ndarray]:
    """The n points of an orbit and its eigenvector of −1 at each of them, (n, 3) both."""
    values, directions = np.linalg.eig(orbit.monodromy)
    u, w = orbit.u, np.real(directions[:, np.argmin(np.abs(values + 1.0))])
    points, vectors = [], []
    for _ in range(n):
        points.append(u)
        vectors.append(w)
        moved = lanes(segment, (scene.strobe(),), (u[None], w[None], np.array([b])), tile=_TILE)
        u, w = moved.image[0], moved.carried[0]
    return np.array(points), np.array(vectors)


def _recurrence(strobe: Strobe, transient: Any, u: Array, b: Any, n: int) -> Array:
    """Largest |x1(j + n) − x1(j)| over n strobes after a transient, of one lane."""
    x1 = record(strobe, iterate(strobe, transient, unchart(u), b), b, 2 * n)[1][0][0]
    return abs(x1[n:] - x1[:n]).max()


def _smallest(monodromy: np.ndarray) -> np.ndarray:
    """The smallest real eigenvalue, (lanes,); +∞ where all are complex."""
    values = np.linalg.eigvals(monodromy)
    return np.where(np.abs(values.imag) < 1e-12, values.real, np.inf).min(axis=1)


def _first(beyond: np.ndarray) -> int | None:
    """Place of the first True; None where there is none or nothing before it."""
    first = int(np.argmax(beyond))
    return first if first > 0 else None


def _group(estimates: list[Estimate], reference: float, cascade: Cascade) -> Group:
    def column(data: Any, long_name: str, units: str = "1") -> Variable:
        return Variable(("estimate",), np.array(data), long_name, units)

    method, effort, b, seconds, cpu_seconds = zip(*estimates, strict=True)
    variables = {
        "method": column(method, "method"),
        "effort": column(effort, "periods of transient, rounds of the multisection, or steps of Newton"),
        "b": column(b, "coupling b at the doubling"),
        "error": column(np.abs(np.array(b) - reference), "distance of b from Newton's with four times the steps"),
        "seconds": column(seconds, "time since the method began, compilation apart", "s"),
        "cpu_seconds": column(cpu_seconds, "time of all processors since the method began", "s"),
    }
    attrs = {
        "reference": reference,
        "period": cascade.n,
        "bracket": np.array(cascade.bracket),
        "threshold": _THRESHOLD,
    }
    return Group(variables, attrs)
