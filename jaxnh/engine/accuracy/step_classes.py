"""Classes of steps: a lane may take a power of two fewer steps than the lane of a sweep that needs most.

Where few lanes need many steps, the sweep costs the mean and not the worst. The class of a lane follows from its own
motion, of which a map is compared with that of twice the steps; sample lanes are compared for as long as a calibration
looks at them. Maps of all classes run through one program, as the number of steps is one of its arguments.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnh.engine.accuracy.calibration import LEFT_OUT, SAFETY, Plan
from jaxnh.engine.accuracy.sample_maps import differences, gaps_between, image_of
from jaxnh.engine.axes import SweepPoints
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.maps.build import make_return_map
from jaxnh.maps.protocol import ReturnMap, Tangent
from jaxnh.systems.flow import Parameters
from jaxnh.systems.rows import select
from jaxnh.systems.state import State

_COARSEST = 12  # halvings of the steps, at most
_FEWEST = 2  # steps a period
_PERIODS = 32  # from the start, in which every lane is looked at
_CHECKED = 170  # in which sample lanes are, as by a calibration
_MARGIN = 64.0  # times the error: chaotic motion later errs m times as much as in k periods with probability 1/(k m)
_MOST_RUNS = 4096  # of equal classes along the lanes: their text fits into an attribute of a file
_LANES_AT_ONCE = 8192
_CONTRACTED = 1e-4  # length of an image: of a shorter one rounding may be what differs
_BATCH = 512  # lanes that are computed at once, about: with more, classes fill their tiles no worse
_FEWEST_PERIODS = 4  # of a glance at sample lanes


# ---- classes as text


def text_of(classes: Int[np.ndarray, " lanes"]) -> str:
    """Return classes of lanes in C order as runs, "class*lanes class*lanes"; "" where all are 0.

    Where there are more runs than a file has room for, neighbours share the finest class among them.
    """
    size = 1
    while True:
        begins = np.arange(0, len(classes), size)
        merged = np.repeat(np.minimum.reduceat(classes, begins), size)[: len(classes)]
        ends = np.append(np.flatnonzero(np.diff(merged)) + 1, len(merged))
        if len(ends) <= _MOST_RUNS:
            break
        size *= 2
    if not np.any(merged):
        return ""
    return " ".join(f"{merged[end - 1]}*{end - begin}" for begin, end in itertools.pairwise([0, *ends.tolist()]))


@functools.lru_cache(8)
def classes_of(text: str) -> Int[np.ndarray, " lanes"]:
    """Classes of lanes in C order from their text."""
    runs = np.array([run.split("*") for run in text.split()], int)
    return np.repeat(runs[:, 0], runs[:, 1])


def steps_of(most: int, halvings: int) -> int:
    """Steps a period of a class, of so many of class 0."""
    return -(-most // (1 << halvings))


def lanes_by_steps(plan: Plan) -> dict[int, int]:
    """Numbers of lanes by their steps a period, fewest steps first; none where all take common ones."""
    if not plan.step_classes:
        return {}
    halvings, counts = np.unique(classes_of(plan.step_classes), return_counts=True)
    both = zip(halvings.tolist(), counts.tolist(), strict=True)
    return dict(sorted((steps_of(plan.steps, k), count) for k, count in both))


def mean_steps(plan: Plan) -> float:
    """Steps a period in the mean over lanes."""
    lanes = lanes_by_steps(plan) or {plan.steps: 1}
    return sum(steps * count for steps, count in lanes.items()) / sum(lanes.values())


def lanes_together(classes: Int[np.ndarray, " lanes"], halvings: int) -> int:
    """Lanes of a class that are expected in a batch, which its tiles are for: of few lanes few fill up a tile."""
    return max(1, math.ceil(_BATCH * float(np.mean(classes == halvings))))


# ---- classes of lanes


@dataclass(frozen=True)
class ClassSearch:
    """Lanes of one system, with what their maps are computed by.

    Attributes:
        at: the lanes.
        plan: solver and steps of the lane that needs most.
        target: error of one period that is allowed.
        lanes: runs the maps.
    """

    at: SweepPoints
    plan: Plan
    target: float
    lanes: LaneExecutor

    @property
    def count(self) -> int:
        """Number of lanes."""
        return len(jax.tree.leaves(self.at.start)[0])

    @functools.cached_property
    def coarsest(self) -> int:
        """The class of fewest steps."""
        return min(_COARSEST, max(0, (self.plan.steps // _FEWEST).bit_length() - 1))

    def take(self, subset: Int[np.ndarray, " subset"]) -> ClassSearch:
        """Return the search for a subset of the lanes."""
        start, p, where = select((self.at.start, dict(self.at.p), dict(self.at.where)), subset)
        return ClassSearch(self.at._replace(start=start, p=p, where=where), self.plan, self.target, self.lanes)

    def classes(self, periods: int = _PERIODS, *, tangents: bool = True) -> Int[np.ndarray, " lanes"]:
        """The coarsest class of each lane whose error is far below the target in its first periods.

        Args:
            tangents: whether a derivative of the map has to be that near as well, as lanes at rest need it.
        """
        parts = [
            self.take(np.arange(first, min(first + _LANES_AT_ONCE, self.count)))._of_few(periods, tangents=tangents)
            for first in range(0, self.count, _LANES_AT_ONCE)
        ]
        return np.concatenate(parts)

    def _of_few(self, periods: int, *, tangents: bool) -> Int[np.ndarray, " lanes"]:
        classes, left = np.zeros(self.count, int), np.arange(self.count)
        for halvings in range(self.coarsest, 0, -1):
            state, p = select((self.at.start, dict(self.at.p)), left)
            passed = left
            for some in (1, periods - 1):  # most lanes that fail do so in the first period
                gaps, state = self._gaps(halvings, state, p, some)
                good = np.all(_MARGIN * gaps <= self.target, axis=1)
                passed, (state, p) = passed[good], select((state, p), good)
                if not len(passed):
                    break
            if tangents and len(passed):
                passed = passed[self._tangents_agree(halvings, state, p)]
            classes[passed] = halvings
            left = np.setdiff1d(left, passed)
            if not len(left):
                break
        return classes

    def hold(self, classes: Int[np.ndarray, " lanes"]) -> bool:
        """Return whether so many steps meet the target on these lanes, for as long as a calibration follows them.

        As there the error is twice that which one in 20,000 of the periods exceeds.
        """
        gaps: list[np.ndarray] = []
        for halvings in np.unique(classes[classes > 0]).tolist():
            state, p = select((self.at.start, dict(self.at.p)), classes == halvings)
            each, later = self._gaps(halvings, state, p, _CHECKED)
            gaps += [each.ravel(), *(self._apart(halvings, y, p) for y in (state, later))]
        every = np.sort(np.concatenate([np.zeros(1), *gaps]))
        return bool(every[-1 - int(LEFT_OUT * len(every))] <= self.target)

    def _map(self, halvings: int) -> ReturnMap:
        steps = steps_of(self.plan.steps, halvings)
        return make_return_map(self.at.system, self.plan.solver, steps, compensated=self.plan.compensated)

    def _gaps(
        self, halvings: int, state: State, p: Parameters, periods: int
    ) -> tuple[Float[np.ndarray, "lanes periods"], State]:
        """Error of each period, by the map of twice the steps, which lanes follow; and their states at the end."""
        met = self.lanes.record(self._map(halvings - 1), periods, (state, p))
        before = jax.tree.map(
            lambda first, later: np.concatenate([first[:, None], later[:, :-1]], axis=1).ravel(), state, met
        )
        each = select(p, np.repeat(np.arange(len(jax.tree.leaves(state)[0])), periods))
        image = self.lanes.iterate(self._map(halvings), 1, (before, each))
        gaps = self._error(image, jax.tree.map(np.ravel, met)).reshape(-1, periods)
        return gaps, select(met, np.s_[:, -1])

    def _apart(self, halvings: int, state: State, p: Parameters) -> Float[np.ndarray, " lanes"]:
        images = [self.lanes.iterate(self._map(k), 1, (state, p)) for k in (halvings, 0)]
        return self._error(*images)

    def _error(self, image: State, finer: State) -> Float[np.ndarray, " lanes"]:
        apart = differences(image_of(image), image_of(finer))
        sizes = np.array([*self.plan.sizes.values()]) if self.plan.sizes else np.ones(len(apart))
        return SAFETY * gaps_between(apart, sizes)

    def _tangents_agree(self, halvings: int, state: State, p: Parameters) -> np.ndarray:
        """Return where the image of a tangent of length one a coordinate is accurate, relative to its length."""
        coarse, fine = (
            self.lanes(push_tangent, (self._map(k),), (state, p), periods=1) for k in (halvings, halvings - 1)
        )
        with np.errstate(invalid="ignore", over="ignore"):
            apart = np.linalg.norm(coarse - fine, axis=1)
            return apart * SAFETY <= self.target * np.maximum(np.linalg.norm(fine, axis=1), _CONTRACTED)


def push_tangent(strobe: ReturnMap, state: State, p: Parameters) -> Float[Array, " d"]:
    """The image of one tangent of a lane, in section coordinates."""
    chart = strobe.chart
    tangent = Tangent(chart.lift(state, tuple(jnp.ones(chart.dimension))))
    pushed = strobe.pushforward(state, p, (tangent,), volume=False)
    return jnp.stack(chart.lower(pushed.state, pushed.tangents[0].state))


def find_classes(every: ClassSearch, samples: Int[np.ndarray, " samples"]) -> Int[np.ndarray, " lanes"]:
    """Classes of all lanes; all are 0 where steps of their own would save little.

    Args:
        samples: numbers of lanes that stand for all.
    """
    few = every.take(samples)
    none = np.zeros(every.count, int)
    if every.coarsest == 0 or not _saves(few.classes(_FEWEST_PERIODS, tangents=False)):
        return none
    classes = every.classes()
    while np.any(classes) and not few.hold(classes[samples]):
        classes = np.maximum(classes - 1, 0)
    return classes if _saves(classes) else none


def _saves(classes: Sequence[int] | Any) -> bool:
    """Return whether classes halve the steps of all lanes together at least."""
    return bool(np.mean(0.5 ** np.asarray(classes, float)) <= 0.5)
