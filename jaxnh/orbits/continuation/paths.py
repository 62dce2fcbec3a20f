"""Paths along curves of solutions by pseudo-arclength: one predictor and one step control for all of them. Host code.

Guesses are Hermite's polynomials through the last points and directions, over the distance along the direction at the
last one; of the orders that they allow each lane takes the one that has predicted its last step best. A long step over
a change of the bordered determinant's sign may have gone over to a curve that only comes near, as at an imperfect
bifurcation: it is taken again and shorter, until the curve is seen to pass through another one or to turn away.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.orbits.continuation.core import ROUGH, CurveEquations, Solution, correct, inner, norm
from jaxnh.systems.rows import concatenate

ENDS = (
    "start", "range", "collapsed", "closed", "no_convergence", "most_points", "unbounded", "resonance", "no_return",
    "bogdanov_takens", "no_saddle", "beyond", "grazing", "infinite_period", "unresolved",
)  # fmt: skip
"""Reasons for which a curve ends: it was begun there, as at a bifurcation; a parameter leaves its range; the orbit is
one of a shorter period; the curve is closed; Newton does not converge at the smallest step; as many points are known as
were asked for; it leaves all bounds; multipliers become real at a resonance 1:1 or 1:2, from where on no torus is born;
the map has no value further on, as of orbits that no longer reach their section; the frequency of Hopf points is zero;
an equilibrium that an orbit connects is no hyperbolic saddle further on; another part of an orbit goes beyond the level
that its extremum has, or meets another surface; it touches a wall or a surface, where maps have no derivative; a cycle
comes to rest at an equilibrium, and its period has no bound, as at a homoclinic orbit or a heteroclinic cycle; a torus
needs more harmonics than it may have, as where it breaks down."""

(
    START, RANGE, COLLAPSED, CLOSED, NO_CONVERGENCE, MOST_POINTS, UNBOUNDED, RESONANCE, NO_RETURN, BOGDANOV_TAKENS,
    NO_SADDLE, BEYOND, GRAZES, INFINITE_PERIOD, UNRESOLVED,
) = range(len(ENDS))  # fmt: skip

_BENT = 0.97  # cosine of the angle between directions at the ends of a step, at least
_MISSED = 0.15  # of a step that Newton goes back, at most
NEAR = 0.3
"""Share of a step: steps of Newton below it need not contract."""

_WANTED = 0.04  # what steps are chosen for
_GROWTH = 1.5  # of a step that went well
_SHRINKAGE = 0.1  # of one that did not, at most
_FARTHEST = 1e3  # lengths from where a curve has begun
_WIDE = 2.0  # lengths from there, beyond which steps grow in proportion
_LEAST_LOOP = 8  # points of a closed curve
_CROSSING = 1 / 40  # of the largest step: over a change of the determinant's sign steps are no longer
_LAST = 2e-3  # of the largest step: where the map has no value so far ahead, the curve ends
_SHARE = 0.3  # of older directions along the last one that are predicted from, at least


class StepControl(NamedTuple):
    """Sizes and numbers of steps along curves, in lengths: sizes of the motion and widths of the range.

    Attributes:
        ds_max: largest step.
        max_steps: points of a curve in either direction.
        ds: first step, by default a tenth of the largest.
        ds_min: smallest step.
    """

    ds_max: float = 0.02
    max_steps: int = 2000
    ds: float | None = None
    ds_min: float = 1e-7


STEPS = StepControl()
"""Default steps."""


# ---- the predictor


class _History(NamedTuple):
    """The last three points and directions of lanes, newest first, each (3, lanes, N), NaN before a curve's first."""

    z: np.ndarray
    way: np.ndarray

    def take(self, lanes: np.ndarray) -> _History:
        return _History(*(np.ascontiguousarray(leaf[:, lanes]) for leaf in self))


def _first_history(now: Solution) -> _History:
    unknown = np.full((2, *now.z.shape), np.nan)
    return _History(np.concatenate([now.z[None], unknown]), np.concatenate([now.way[None], unknown]))


class _Polynomials(NamedTuple):
    """Newton's form of Hermite's polynomials: nodes (6, lanes) and coefficients (6, lanes, N)."""

    nodes: np.ndarray
    terms: np.ndarray

    def at(self, step: Float[np.ndarray, " lanes"]) -> Float[np.ndarray, "5 lanes N"]:
        """Guesses of orders one to five; not finite where points are missing."""
        weights = np.cumprod(step - self.nodes[:-1], axis=0)
        with np.errstate(invalid="ignore", over="ignore"):
            return self.terms[0] + np.cumsum(weights[..., None] * self.terms[1:], axis=0)


def _polynomials(unit: np.ndarray, past: _History) -> _Polynomials:
    """Polynomials over the distance along the last direction: guesses lie in the hyperplane they are corrected in."""
    (z, way), last = past, past.way[0] / unit**2
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.sum((z - z[0]) * last, axis=2)
        share = np.sum(way * last, axis=2)
        slope = np.where((share >= _SHARE)[..., None], way / share[..., None], np.nan)
        nodes = np.repeat(place, 2, axis=0)
        column, terms = np.repeat(z, 2, axis=0), [z[0]]
        for j in range(1, len(nodes)):
            gap = (nodes[j:] - nodes[:-j])[..., None]
            column = (column[1:] - column[:-1]) / gap
            if j == 1:
                column[::2] = slope
            terms.append(column[0])
    return _Polynomials(nodes, np.stack(terms))


# ---- the steps


class _Guess(NamedTuple):
    z: np.ndarray
    across: np.ndarray
    step: np.ndarray
    at_end: np.ndarray


class Path:
    """Lanes on their way along curves, each to its end in the direction it has begun with.

    Attributes:
        active: numbers of the lanes that are on their way.
        end: why lanes have ended, numbers in `ENDS`; `START` of those that have not.
    """

    def __init__(self, equations: CurveEquations, start: Solution, control: StepControl) -> None:
        lanes = len(start.z)
        self._equations, self._begun, self._control = equations, start, control
        self.active, self.end = np.arange(0), np.full(lanes, START)
        self._now, self._past = start.take(self.active), _first_history(start.take(self.active))
        self._count, self._order = np.zeros(lanes, int), np.zeros(lanes, int)
        self._size = np.full(lanes, control.ds or 0.1 * control.ds_max)
        self._wall = np.full(lanes, np.inf)  # how far ahead the map has no value, as far as is seen
        self._rows = [list[tuple[Solution, int]]() for _ in range(lanes)]

    def begin(self, lanes: Int[np.ndarray, " some"]) -> None:
        """Set lanes on their way."""
        now = self._begun.take(lanes)
        self._keep(lanes, now)
        self.active = np.concatenate([self.active, lanes])
        self._now = concatenate([self._now, now])
        self._past = _History(
            *(np.concatenate(leaves, axis=1) for leaves in zip(self._past, _first_history(now), strict=True))
        )

    def step(self) -> Int[np.ndarray, " some"]:
        """One step of all lanes on their way; those that have come to their ends by it."""
        equations, control, unit, active, now = (
            self._equations, self._control, self._equations.unit, self.active, self._now,
        )  # fmt: skip
        polynomials = _polynomials(unit, self._past)
        guess = self._guess(polynomials, np.minimum(self._size[active], equations.room(now)))
        step = guess.step
        taken = correct(equations, guess.z, guess.across, ROUGH, np.maximum(NEAR * step, ROUGH))
        lost = ~np.isfinite(taken.residual) & (taken.missed == 0.0)  # at the guess itself
        with np.errstate(invalid="ignore"):
            share = np.where(step > 0.0, taken.missed / np.maximum(step, control.ds_min), 0.0)
            share = np.where(np.isnan(share), np.inf, share)  # as on a branch point itself, where steps are not known
            good = taken.converged & (inner(unit, taken.way, now.way) >= _BENT) & (share <= _MISSED)
            parameters = taken.z[:, -len(equations.low) :]
            good &= np.all((parameters >= equations.low) & (parameters <= equations.high), axis=1)
            crosses = taken.determinant * now.determinant < 0.0
        good &= ~crosses | (step <= _CROSSING * control.ds_max)
        ended, dropped = equations.endings(now, taken)
        start = self._begun.take(active)
        closed = (self._count[active] > _LEAST_LOOP) & _passes(equations, start, now, taken, 2.0 * step)
        kept = good & ~dropped & (step > 0.0)
        self._keep(active[kept], taken.take(kept))
        away = norm(unit, now.z - start.z)
        self._set_sizes(step, share, good, lost, away)
        done = np.zeros(len(active), bool)
        smallest = ~good & (self._size[active] <= control.ds_min)
        for reason, which in {
            MOST_POINTS: self._count[active] >= control.max_steps,
            NO_CONVERGENCE: smallest,
            NO_RETURN: lost & (step <= _LAST * control.ds_max),
            UNBOUNDED: away > _FARTHEST,
            RANGE: good & guess.at_end,
            CLOSED: good & closed,
            **{reason: good & which for reason, which in ended.items()},
        }.items():
            self.end[active[which]] = reason
            done |= which
        self._advance(polynomials, taken, good, step, ~done)
        return active[done]

    def move(self, equations: CurveEquations, now: Solution, carried: Callable[[np.ndarray], np.ndarray]) -> None:
        """Go on with other unknowns for the same curves, as on another mesh; what was come through has been taken.

        Args:
            equations: of the new unknowns.
            now: where the lanes on their way are.
            carried: old unknowns or directions, (lanes, N), as new ones.
        """
        self._past = _History(
            *(
                np.stack([newest, *map(carried, older[1:])])
                for newest, older in zip((now.z, now.way), self._past, strict=True)
            )
        )
        self._begun = self._begun._replace(z=carried(self._begun.z), way=carried(self._begun.way))
        self._equations, self._now = equations, now

    def met(self, lane: int) -> int:
        """Return how many points `track` would."""
        return len(self._rows[lane])

    def track(self, lane: int) -> Solution:
        """Return the points that a lane has come through, and forget them."""
        rows, self._rows[lane] = self._rows[lane], []
        return Solution(*(np.stack([part[k][i] for part, i in rows]) for k in range(len(Solution._fields))))

    def _keep(self, lanes: Int[np.ndarray, " some"], points: Solution) -> None:
        for i, lane in enumerate(lanes.tolist()):
            self._rows[lane].append((points, i))
        self._count[lanes] += 1

    def _guess(self, polynomials: _Polynomials, step: Float[np.ndarray, " lanes"]) -> _Guess:
        """Guesses a step ahead, at the edge of the parameters' ranges where they would leave them."""
        equations, now = self._equations, self._now
        k, lane = len(equations.low), np.arange(len(step))
        z = self._predict(polynomials, step)
        first, gone = now.z[:, -k:], z[:, -k:] - now.z[:, -k:]
        edge = np.where(gone > 0.0, equations.high, equations.low)
        beyond = (z[:, -k:] <= equations.low) | (z[:, -k:] >= equations.high)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            shares = np.where(beyond, np.clip((edge - first) / gone, 0.0, 1.0), np.inf)
        nearest, at_end = np.argmin(shares, axis=1), np.any(beyond, axis=1, keepdims=True)[:, 0]
        step = np.where(at_end, shares[lane, nearest] * step, step)
        across = now.way.copy()
        if at_end.any():
            some, column = lane[at_end], z.shape[1] - k + nearest[at_end]
            z[some] = self._predict(polynomials, step)[some]
            z[some, column] = edge[some, nearest[at_end]]
            across[some] = 0.0
            across[some, column] = np.sign(gone[some, nearest[at_end]]) * equations.unit[column]
        return _Guess(z, across, step, at_end)

    def _predict(self, polynomials: _Polynomials, step: Float[np.ndarray, " lanes"]) -> Float[np.ndarray, "lanes N"]:
        guesses = polynomials.at(step)
        best = guesses[self._order[self.active], np.arange(len(step))]
        return np.where(np.isfinite(best).all(axis=1, keepdims=True), best, guesses[0])

    def _set_sizes(
        self, step: np.ndarray, share: np.ndarray, good: np.ndarray, lost: np.ndarray, away: np.ndarray
    ) -> None:
        """Choose the next steps: half of what is left up to where the map has no value, at last a short one beyond."""
        active, control = self.active, self._control
        wall = np.where(lost, np.minimum(step, self._wall[active]), self._wall[active] - np.where(good, step, 0.0))
        self._wall[active] = wall = np.where(wall > 0.0, wall, np.inf)
        with np.errstate(invalid="ignore"):
            wanted = _WANTED / np.maximum(share, 1e-7)
            factor = np.where(good, np.clip(wanted, 0.5, _GROWTH), np.clip(np.sqrt(wanted), _SHRINKAGE, 0.5))
        size = np.minimum(self._size[active], np.maximum(step, control.ds_min)) * factor
        size = np.minimum(size, control.ds_max * np.maximum(1.0, away / _WIDE))
        self._size[active] = np.minimum(size, np.maximum(0.5 * wall, _LAST * control.ds_max))

    def _advance(
        self, polynomials: _Polynomials, taken: Solution, good: np.ndarray, step: np.ndarray, going: np.ndarray
    ) -> None:
        """Have the lanes that go on at their new points, with the order that has predicted them best."""
        active, past, now = self.active, self._past, self._now
        gap = norm(self._equations.unit, (polynomials.at(step) - taken.z).reshape(-1, taken.z.shape[1]))
        best = np.argmin(np.nan_to_num(gap.reshape(-1, len(active)), nan=np.inf), axis=0)
        self._order[active] = np.where(good, best, np.minimum(self._order[active], 1))
        moved = (good & (step > 0.0))[:, None]
        z, way = (
            np.where(moved, np.concatenate([new[None], old[:-1]]), old)
            for new, old in ((taken.z, past.z), (taken.way, past.way))
        )
        self._past = _History(z, way).take(going)
        self._now = jax.tree.map(lambda new, old: np.where(_like(good, new), new, old), taken, now).take(going)
        self.active = active[going]


def _like(which: np.ndarray, leaf: np.ndarray) -> np.ndarray:
    return which.reshape(-1, *[1] * (leaf.ndim - 1))


def _passes(
    equations: CurveEquations, start: Solution, now: Solution, taken: Solution, near: Float[np.ndarray, " lanes"]
) -> Bool[np.ndarray, " lanes"]:
    """Return whether a step passes the point that its curve has begun with, or one that stands for the same."""
    passes, unit = np.zeros(len(near), bool), equations.unit
    for z, way in zip(equations.equivalents(start.z), equations.equivalents(start.way), strict=True):
        before, after = (equations.difference(point.z - z) for point in (now, taken))
        with np.errstate(invalid="ignore"):
            passed = (inner(unit, before, way) < 0.0) & (inner(unit, after, way) >= 0.0)
            passes |= passed & (norm(unit, after) <= near)
    return passes


class Track(NamedTuple):
    """Points of a curve from one end to the other, and why it ends at both, numbers in `ENDS`."""

    points: Solution
    ends: tuple[int, int]

    def backward(self) -> Track:
        """The curve from its other end."""
        first, last = self.ends
        return Track(self.points.take(slice(None, None, -1)).backward(), (last, first))


def follow_both_ways(
    equations: CurveEquations,
    start: Solution,
    control: StepControl = STEPS,
    wanted: Callable[[Mapping[int, Track], int], bool] | None = None,
    at_once: int | None = None,
) -> dict[int, Track]:
    """The curves through points, from one end to the other, by the points' numbers; of a closed one the loop.

    Lanes are independent. Where one comes to its end the next in turn takes its place, so that few long curves keep
    none waiting.

    Args:
        equations: F.
        start: points, with the directions in which curves are followed first.
        control: steps.
        wanted: asked for each point as its turn comes, with the curves that have come to both of their ends and the
            point's number; by default all are.
        at_once: how many are followed at a time, by default all.
    """
    count = len(start.z)
    path = Path(equations, concatenate([start, start.backward()]), control)
    tracks, turn, followed = dict[int, Track](), 0, 0
    while turn < count or len(path.active):
        more = list[int]()
        while turn < count and (at_once is None or followed < at_once):
            if wanted is None or wanted(tracks, turn):
                more.append(turn)
                followed += 1
            turn += 1
        if more:
            path.begin(np.array([*more, *(count + k for k in more)], int))
        ended = path.step().tolist() if len(path.active) else []
        for k in sorted({lane % count for lane in ended}):
            if path.end[k] != START and path.end[count + k] != START:
                followed -= 1
                tracks[k] = _join(path, k, count + k)
    return {k: tracks[k] for k in sorted(tracks)}


def _join(path: Path, ahead: int, behind: int) -> Track:
    """The curve from the end behind to the one ahead; what was behind is left out of a closed one."""
    track, back, end = path.track(ahead), path.track(behind), int(path.end[ahead])
    if end == CLOSED:
        return Track(track, (CLOSED, CLOSED))
    back = back.take(slice(None, 0, -1)).backward()
    return Track(concatenate([back, track]), (int(path.end[behind]), end))
