"""A plain detection of the period near doublings, and what the multiplier there predicts of its bias."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.analyses.periodic.newton_on_lanes import orbits
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.maps.iterate import iterate, record
from jaxnh.maps.protocol import ReturnMap
from jaxnh.orbits.newton import Orbit
from jaxnh.systems.flow import Parameters
from jaxnh.systems.particle import CHART, State

TABLES = ("table1", "table2")
THRESHOLDS = (1e-4, 1e-5, 1e-6)
SOLVER, STEPS = "blanes_moan6", 128  # moves the doublings by less than 1e-9: the page says by how much

_POINTS = 7  # values of b that a multisection looks at, both ends included
_TILE = 64
_ROUNDS = 40
_FINE, _RELATIVE = 1e-9, 2e-3  # a detected b is known to the sum: in b, and of its move since the last N
_SETTLED = 4000  # periods after which Newton takes over in the search for the orbits of the prediction
_BESIDE, _SPLIT, _CENTRED = 0.05, 0.02, 1e-3  # offsets in b, as fractions of the distance to the next doubling
_CONVERGED = 1e-7
TURNS, PAST = 30, 0.3  # slopes are fitted from so many turns of the orbit up to this fraction of N*
HALF_DIGIT = 5e-7  # the published b have six decimals
FACTOR = 2.0  # within which a bias counts as that of a published row


class Cascade(NamedTuple):
    """A computed cascade, the published one beside it, and what to integrate.

    Attributes:
        title: of the config.
        strobe, start: the map of one forcing period, and the start state of every lane.
        n: period of the orbit that doubles, (levels,).
        b: doubling points, (levels,).
        ahead: signed distance from each doubling to the next one, (levels,).
        published, source: the published b, (levels,), and where they are from.
    """

    title: str
    strobe: ReturnMap
    start: State
    n: np.ndarray
    b: np.ndarray
    ahead: np.ndarray
    published: np.ndarray
    source: str

    def before(self, b: np.ndarray) -> np.ndarray:
        """β, the distance of values (levels, ...) before their doublings; negative beyond them."""
        per_level = (-1,) + (1,) * (b.ndim - 1)
        return np.sign(self.ahead).reshape(per_level) * (self.b.reshape(per_level) - b)


class Law(NamedTuple):
    """Numbers that decide the bias near a doubling; each of shape (levels,).

    One turn (n periods) of the orbit takes the difference D of strobe points a turn apart to μ (1 − γ D² + …) D, with
    μ = −1 + κ β. Started far away, |D| falls below ε after N periods where β = (n / 2 κ N) ln(1 + κ β / (γ ε²)).

    Attributes:
        kappa: |dμ/db| at the doubling.
        gamma: coefficient of the cubic term: beyond the doubling the branches of 2n are √(κ |β| / γ) apart.
        shift: by how much the steps used here move the doubling in b.
    """

    kappa: np.ndarray
    gamma: np.ndarray
    shift: np.ndarray

    def crossing(self, n: np.ndarray, threshold: float) -> np.ndarray:
        """N*, at which the bias changes sign: there D is ε at the doubling itself. (levels,)."""
        return n / (2.0 * self.gamma * threshold**2)

    def bias(self, n: np.ndarray, transients: np.ndarray, threshold: float) -> np.ndarray:
        """Predicted β, (levels, transients): with s = κ β / (γ ε²) it is N / N* = ln(1 + s) / s."""
        s = np.concatenate([-1.0 + np.logspace(-14, -0.01, 4000), np.logspace(-3, 14, 40000)])
        of_ratio = np.interp(-transients / self.crossing(n, threshold)[:, None], -np.log1p(s) / s, s)
        return (self.gamma * threshold**2 / self.kappa)[:, None] * of_ratio


class CascadeStudy(NamedTuple):
    """One cascade: its law, and the b and bias detected, (levels, thresholds, transients), NaN where there is none."""

    cascade: Cascade
    law: Law
    detected: np.ndarray
    bias: np.ndarray
    published_bias: np.ndarray


# ---- the plain detection


def strobe_points(strobe: ReturnMap, transient: ArrayLike, start: State, p: Parameters, count: int) -> Array:
    """x1 at `count` strobes after a transient, of one lane, (count,)."""
    return record(strobe, count, iterate(strobe, transient, start, p), p, count)[0][0]


def detected_period(x1: np.ndarray, threshold: np.ndarray) -> np.ndarray:
    """Least p with |x1(j + p) − x1(j)| below the threshold at p strobes on end; 0 if there is none.

    Args:
        x1: strobe points, (lanes, count); p up to count / 2 are tried.
        threshold: (lanes,).
    """
    period = np.zeros(len(x1), int)
    for p in range(x1.shape[1] // 2, 0, -1):
        period[np.abs(x1[:, p : 2 * p] - x1[:, :p]).max(axis=1) < threshold] = p
    return period


def detect(cascade: Cascade, lanes: LaneExecutor, transients: np.ndarray) -> np.ndarray:
    """The b at which period n is not seen any more, (levels, thresholds, transients); NaN where none is found.

    For the first N it is searched for from the middle of one window of the cascade to the middle of the next; later
    around where b∞ + C/N through the two N before would have it. Either way both ends are looked at as well.
    """
    jobs = len(THRESHOLDS)
    n, b, ahead = (np.repeat(each, jobs) for each in (cascade.n, cascade.b, cascade.ahead))
    behind = np.repeat(np.append(cascade.ahead[:1], np.diff(cascade.b)), jobs)
    window = np.stack([b - 0.5 * behind, b + 0.5 * ahead])
    threshold = np.tile(THRESHOLDS, len(cascade.n))
    count = 2 * int(n[-1])
    found = np.full((len(n), len(transients)), np.nan)
    for k, transient in enumerate(transients):
        shared = (cascade.strobe, np.int32(transient), cascade.start)

        def doubled(b: np.ndarray, job: np.ndarray, shared: Any = shared) -> np.ndarray:
            x1 = lanes(strobe_points, shared, ({"b": b},), periods=shared[1] + count, tile=_TILE, static=(count,))
            period = detected_period(x1, threshold[job])
            return (period == 0) | (period > n[job])

        bracket, move = window.copy(), np.zeros(len(n))
        if k > 1:
            first, second, now = 1.0 / transients[k - 2 : k + 1]
            move = (found[:, k - 1] - found[:, k - 2]) * (second - now) / (first - second)
            reach = np.sign(ahead) * (0.3 * np.abs(move) + 10 * _FINE)
            near = found[:, k - 1] + move + np.array([[-1], [1]]) * reach
            bracket = np.where(np.isfinite(near), near, window)
        found[:, k] = _multisect(doubled, bracket, window, _FINE + _RELATIVE * np.nan_to_num(np.abs(move)))
    return found.reshape(len(cascade.n), jobs, len(transients))


def _multisect(
    doubled: Callable[[np.ndarray, np.ndarray], np.ndarray],
    bracket: np.ndarray,
    window: np.ndarray,
    tolerance: np.ndarray,
) -> np.ndarray:
    """Return where `doubled`, of values and the jobs they belong to, turns true; brackets and windows are (2, jobs).

    A bracket that misses the turn moves on inside its window; NaN where the whole window misses it.
    """
    found = np.full(bracket.shape[1], np.nan)
    for _ in range(_ROUNDS):
        jobs = np.flatnonzero(np.abs(bracket[1] - bracket[0]) > tolerance)
        if not len(jobs):
            break
        values = np.linspace(bracket[0, jobs], bracket[1, jobs], _POINTS)
        seen = doubled(values.ravel(), np.tile(jobs, _POINTS)).reshape(values.shape)
        first = np.where(seen.any(axis=0), seen.argmax(axis=0), _POINTS)
        right = np.clip(first, 1, _POINTS - 1)
        narrowed = np.take_along_axis(values, np.stack([right - 1, right]), axis=0)
        width = values[-1] - values[0]
        aside = np.where(first == 0, values[0] - [[3.0], [0.0]] * width, values[-1] + [[0.0], [3.0]] * width)
        inside = (first > 0) & (first < _POINTS)
        bracket[:, jobs] = np.where(inside, narrowed, np.clip(aside, *np.sort(window[:, jobs], axis=0)))
        found[jobs] = np.where(inside, narrowed.mean(axis=0), np.nan)
    return found


# ---- the prediction


def section(strobe: ReturnMap, transient: ArrayLike, start: State, p: Parameters) -> Array:
    """Section coordinates of one lane after a transient, (3,)."""
    return CHART.point(iterate(strobe, transient, start, p))


def measure_law(cascade: Cascade, lanes: LaneExecutor) -> Law:
    """κ from the multiplier on both sides of each doubling, γ from the orbit of 2n a little beyond it."""
    strobe, ahead = cascade.strobe, cascade.ahead
    beyond = cascade.b + _SPLIT * ahead
    shared = (strobe, np.int32(_SETTLED), cascade.start)
    b = np.concatenate([cascade.b - _BESIDE * ahead, beyond])
    single, double = np.split(lanes(section, shared, ({"b": b},), periods=_SETTLED, tile=_TILE), 2)
    kappa, gamma, shift = (np.empty(len(ahead)) for _ in range(3))
    for k, n in enumerate(cascade.n):
        h = _CENTRED * ahead[k]
        orbit = _orbits(lanes, strobe, single[k], cascade.b[k] + h * np.array([-1, 0, 1]), n)
        mu = np.linalg.eigvals(orbit.monodromy).real.min(axis=1)
        kappa[k] = (mu[0] - mu[2]) / (2 * abs(h))
        shift[k] = (mu[1] + 1.0) / kappa[k]
        at = beyond[k : k + 1]
        start = CHART.state(_orbits(lanes, strobe, double[k], at, 2 * n).u.T)
        x1 = lanes(strobe_points, (strobe, np.int32(0)), (start, {"b": at}), tile=8, static=(2 * int(n),))[0]
        gamma[k] = kappa[k] * _SPLIT * abs(ahead[k]) / np.max(np.abs(x1[n:] - x1[:n])) ** 2
    return Law(kappa, gamma, shift)


def _orbits(lanes: LaneExecutor, strobe: ReturnMap, u: np.ndarray, b: np.ndarray, n: int) -> Orbit:
    """Orbits of period n at values of b, all from one start point."""
    orbit = orbits(lanes, strobe, np.broadcast_to(u, (len(b), 3)), {"b": b}, n)
    if not np.all(orbit.residual < _CONVERGED):
        raise RuntimeError(f"no orbit of period {n} was found near b = {b[0]:.9g}")
    return orbit


# ---- what is read off


def slopes(study: CascadeStudy, transients: np.ndarray) -> np.ndarray:
    """d ln β / d ln N measured and predicted over the same N, (2, levels, thresholds); NaN with fewer than three N."""
    n = study.cascade.n
    fits = np.full((2, len(n), len(THRESHOLDS)), np.nan)
    for k, j in np.ndindex(fits.shape[1:]):
        last = PAST * study.law.crossing(n, THRESHOLDS[j])[k]
        use = (transients >= TURNS * n[k]) & (transients <= last) & (study.bias[k, j] > 0)
        if use.sum() > 2:
            both = study.bias[k, j], study.law.bias(n, transients, THRESHOLDS[j])[k]
            fits[:, k, j] = [np.polyfit(np.log(transients[use]), np.log(beta[use]), 1)[0] for beta in both]
    return fits


def needed_transient(bias: np.ndarray, transients: np.ndarray, target: float) -> float:
    """N at which a measured bias (transients,) first falls to a target; 0 if before those run, ∞ if after them."""
    bias, transients = bias[np.isfinite(bias)], transients[np.isfinite(bias)]
    k = next((k for k, beta in enumerate(bias) if beta <= target), -1)
    if k < 1:
        return np.inf if k < 0 else 0.0
    ends = bias[[k, k - 1]]
    if min(target, ends[0]) > 0:
        target, ends = np.log(target), np.log(ends)
    return float(np.exp(np.interp(target, ends, np.log(transients[[k, k - 1]]))))


class Agreement(NamedTuple):
    """With which transients one threshold agrees with the published rows, those of all cascades together.

    Attributes:
        most: largest number of rows that one N has within a factor `FACTOR`.
        best: least and largest N with as many, or nan.
        half: least and largest N with at least half of the rows, or nan.
        each: least and largest of the N that rows need one by one to have just the published bias.
    """

    most: int
    best: tuple[float, float]
    half: tuple[float, float]
    each: tuple[float, float]


def checked_rows(study: CascadeStudy) -> np.ndarray:
    """Levels whose published bias exceeds the rounding of its last digit, by number."""
    return np.flatnonzero(study.published_bias > 2 * HALF_DIGIT)


def agreement(studies: list[CascadeStudy], transients: np.ndarray, j: int) -> Agreement:
    """Return how threshold number j agrees with the checked rows, biases interpolated between the N that were run."""
    fine = np.geomspace(transients[0], transients[-1], 2000)
    near, needed = [], []
    for study in studies:
        for i in checked_rows(study):
            bias, published = study.bias[i, j], float(study.published_bias[i])
            usable = np.isfinite(bias) & (bias > 0)
            of_n = np.interp(np.log(fine), np.log(transients[usable]), np.log(bias[usable]), left=np.nan, right=np.nan)
            near.append(np.abs(of_n - np.log(published)) < np.log(FACTOR))
            needed.append(needed_transient(bias, transients, published))
    count = np.sum(near, axis=0)

    def span(enough: int) -> tuple[float, float]:
        found = fine[count >= enough] if enough else fine[:0]
        return (float(found[0]), float(found[-1])) if len(found) else (np.nan, np.nan)

    most = int(count.max())
    return Agreement(most, span(most), span(-(-len(near) // 2)), (min(needed), max(needed)))


def nearest_pair(studies: list[CascadeStudy]) -> tuple[int, int]:
    """Index of the threshold and of the N whose biases come nearest to the published ones, all cascades together."""
    misfit = []
    for study in studies:
        rows = checked_rows(study)
        detected = np.maximum(np.nan_to_num(study.bias[rows]), _FINE)
        misfit.append(np.abs(np.log(detected / study.published_bias[rows, None, None])))
    j, k = np.unravel_index(np.concatenate(misfit).mean(axis=0).argmin(), misfit[0].shape[1:])
    return int(j), int(k)


def study_cascade(cascade: Cascade, lanes: LaneExecutor, transients: np.ndarray) -> CascadeStudy:
    """Prediction and plain detection of one cascade."""
    with lanes.stage(f"{cascade.title}: plain detection", 0):
        law = measure_law(cascade, lanes)
        detected = detect(cascade, lanes, transients)
    return CascadeStudy(cascade, law, detected, cascade.before(detected), cascade.before(cascade.published))
