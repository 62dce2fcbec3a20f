"""First homoclinic and heteroclinic orbits: where a manifold of one dimension passes a saddle on its other side.

From saddles with one unstable direction the manifold is followed in time, from those with one stable direction back in
time, at all values of the first axis. Between two values where it leaves the neighbourhood of a saddle on different
sides there is one where it stays: the values are refined, and the path that comes nearest is a guess for Newton.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.continuation.connection_passages import (
    FARTHEST,
    PassageView,
    first_difference,
    leading_directions,
    passages_of_paths,
)
from jaxnh.analyses.section_points import states_at
from jaxnh.exceptions import InputError
from jaxnh.maps.bounds import BoundedMap
from jaxnh.maps.build import make_return_map
from jaxnh.maps.inverse import backward_parts
from jaxnh.maps.protocol import ReturnMap
from jaxnh.orbits.collocation.equations import BoundarySolution, Problem
from jaxnh.orbits.collocation.homoclinic import SaddlePoint, saddles_at
from jaxnh.orbits.collocation.paths import path_through
from jaxnh.solvers import AdaptiveMethod

_SAME = 1e-6  # sizes: equilibria this near are one
_BEGUN = 1e-3  # sizes: where manifolds begin, on the eigenvector
_FINER, _ROUNDS = 16, 12  # parts of an interval, and how often there are parts of parts, at most
_NEAR_ENOUGH = 0.02  # of the largest distance so far: a path this near is a guess
_FOLLOWED = 2.0 * FARTHEST  # sizes, from where paths begin: further out of every saddle than that
_PASSED = (
    0.5,
    0.15,
)  # of the largest distance so far: minima of it below are passages; far from a saddle some are none
_SEGMENTS, _APART = 60, 1e-6  # segments between states, at most, and how long they are, in sizes
_NEAREST = 0.1  # of the largest distance so far, after refinement: others pass no saddle
_LOOKS, _STEPS_A_LOOK = 16, 4  # states a unit of time, at least, and steps between two of them
_INTERVALS = 60
_TILE = 32


@dataclass
class Chain:
    """One saddle over values of the first axis: by the number of the value."""

    saddles: dict[int, SaddlePoint]


class ConnectionSeed(NamedTuple):
    """A guess of a connecting orbit.

    Attributes:
        guess: path, duration and both parameters.
        departure, arrival: states near its saddles.
    """

    guess: BoundarySolution
    departure: Float[np.ndarray, " d"]
    arrival: Float[np.ndarray, " d"]


class Manifold(NamedTuple):
    """One side of a manifold of dimension one.

    Attributes:
        chain: its saddle.
        backward: whether it is the stable one.
        sign: of its direction.
    """

    chain: Chain
    backward: bool
    sign: int


class SideChange(NamedTuple):
    """Two values of the first parameter at which a manifold passes a saddle on different sides.

    Attributes:
        saddles: that of the manifold and the one passed, at the first value.
        direction: of the manifold there.
        ends: the values.
        pulse: number of the passage.
        passed: part of the largest distance so far, below which a passage is one.
    """

    saddles: tuple[SaddlePoint, SaddlePoint]
    direction: Float[np.ndarray, " d"]
    ends: tuple[float, float]
    pulse: int
    passed: float


class Shooting(NamedTuple):
    """The way in which manifolds are followed.

    Attributes:
        batch: lanes along the first axis, without a section.
        lanes: runs lanes.
        problem: the field over both parameters, in sizes of where equilibria are looked for.
        second: value of the second parameter.
        duration: time for which manifolds are followed.
        pulses: passages of a saddle that are looked at.
    """

    batch: LaneBatch
    lanes: LaneRunner
    problem: Problem
    second: float
    duration: float
    pulses: int

    def view(self, backward: bool) -> PassageView:
        """How passages of a manifold are seen, the stable one's or the unstable one's."""
        return PassageView(self.batch.chart.wrap, self.problem.size, backward, self.pulses)

    def saddles(self, state: Float[np.ndarray, " d"], values: Float[np.ndarray, " k"]) -> list[SaddlePoint]:
        """The saddle near a state at values of the first parameter; none where it is none at one of them."""
        try:
            return saddles_at(self.problem, state, np.stack([values, np.full(len(values), self.second)], axis=1))
        except InputError:
            return []


def saddle_chains(
    shooting: Shooting, values: Float[np.ndarray, " k"], equilibria: list[Float[np.ndarray, "some d"]]
) -> list[Chain]:
    """All saddles over the values of the first axis, from equilibria that are known at each."""
    chains = list[Chain]()
    for number, value in enumerate(values[:, None]):
        for chain in chains:
            if number - 1 in chain.saddles:
                for saddle in shooting.saddles(chain.saddles[number - 1].state, value):
                    chain.saddles[number] = saddle
        known = [chain.saddles[number].state for chain in chains if number in chain.saddles]
        for u in equilibria[number]:
            gaps = [shooting.batch.chart.wrap(u - state) / shooting.problem.size for state in known]
            if min((np.abs(gap).max() for gap in gaps), default=np.inf) > _SAME:
                known.append(u)
                chains += [Chain({number: saddle}) for saddle in shooting.saddles(u, value)]
    return chains


def connection_seeds(
    shooting: Shooting, values: Float[np.ndarray, " k"], chains: list[Chain]
) -> Iterator[ConnectionSeed]:
    """Guesses of connecting orbits of all saddles between values of the first axis."""
    for manifold in _manifolds(chains):
        numbers = sorted(manifold.chain.saddles)
        starts = [manifold.chain.saddles[number] for number in numbers]
        directions = _directions(manifold, starts)
        paths = _paths(shooting, manifold, starts, directions, values[numbers])
        for other in chains:
            ends = [other.saddles.get(number) for number in numbers]
            fitting = [
                end if end is not None and _fits(start, end) else None for start, end in zip(starts, ends, strict=True)
            ]
            for passed in _PASSED:
                passages = passages_of_paths(shooting.view(manifold.backward), paths, fitting, passed)
                for k in range(len(numbers) - 1):
                    pulse, end = first_difference(passages[k], passages[k + 1]), ends[k]
                    if pulse is not None and end is not None and numbers[k + 1] == numbers[k] + 1:
                        low, high = values[[numbers[k], numbers[k + 1]]].tolist()
                        bracket = SideChange((starts[k], end), directions[k], (low, high), pulse, passed)
                        seed = _refined(shooting, manifold, bracket)
                        if seed is not None:
                            yield seed


def _manifolds(chains: list[Chain]) -> Iterator[Manifold]:
    for chain in chains:
        first = next(iter(chain.saddles.values()))
        if len(first.unstable) == 1:
            yield from (Manifold(chain, False, sign) for sign in (1, -1))
        elif len(first.stable) == 1:
            yield from (Manifold(chain, True, sign) for sign in (1, -1))


def _fits(start: SaddlePoint, end: SaddlePoint) -> bool:
    """Tell whether orbits from one to the other are there at single values of one parameter alone."""
    return len(start.unstable) == len(end.unstable)


# ---- paths


def _map_and_step(shooting: Shooting, backward: bool) -> tuple[ReturnMap, float]:
    """The map from one state of a path to the next, and the time between them."""
    batch, period = shooting.batch, shooting.batch.flow.period
    parts = max(_LOOKS, batch.steps // _STEPS_A_LOOK)
    if backward:
        stacked = backward_parts(batch.flow, batch.solver, batch.steps, parts, period, compensated=batch.compensated)
        return jax.tree.map(lambda leaf: np.asarray(leaf)[0], stacked), period / parts
    span = (0.0, period / parts)
    ahead = make_return_map(batch.flow, batch.solver, batch.steps, compensated=batch.compensated, span=span)
    return ahead, period / parts


def _paths(
    shooting: Shooting,
    manifold: Manifold,
    starts: list[SaddlePoint],
    directions: list[Float[np.ndarray, " d"]],
    values: Float[np.ndarray, " lanes"],
) -> Float[np.ndarray, "lanes count d"]:
    """States along the manifold from saddles at values of the first parameter; not finite beyond all bounds."""
    first = np.stack([s.state for s in starts]) + _BEGUN * shooting.problem.size * np.stack(directions)
    return _paths_from(shooting, manifold.backward, first, values)


def _paths_from(
    shooting: Shooting, backward: bool, first: Float[np.ndarray, "lanes d"], values: Float[np.ndarray, " lanes"]
) -> Float[np.ndarray, "lanes count d"]:
    """States along the paths through first ones, which are among them."""
    batch, (moved, step) = shooting.batch, _map_and_step(shooting, backward)
    p = dict(batch.at_values(values).p)
    count = max(2, round(shooting.duration / step))
    if isinstance(batch.solver, AdaptiveMethod):  # equal steps are as many wherever a path goes
        reach = _FOLLOWED * shooting.problem.size + np.ptp(first, axis=0)
        moved = BoundedMap(moved.system, moved, first[0], reach)
    record = shooting.lanes.record(moved, count, (states_at(batch, shooting.lanes, first, _TILE), p), tile=_TILE)
    return np.concatenate([first[:, None], batch.chart.host_points(record)], axis=1)


def _directions(
    manifold: Manifold, starts: list[SaddlePoint], first: Float[np.ndarray, " d"] | None = None
) -> list[Float[np.ndarray, " d"]]:
    """The directions in which a manifold begins at saddles one after the other, the first one as another is."""
    directions = leading_directions(starts, manifold.backward, first)
    return directions if first is not None else [manifold.sign * direction for direction in directions]


# ---- refinement


def _refined(shooting: Shooting, manifold: Manifold, bracket: SideChange) -> ConnectionSeed | None:
    """The path that comes nearest to the saddle between two values, None where it does not come near."""
    search = _PathSearch(shooting, manifold, bracket)
    search.between_values()
    if search.best is not None and search.best.distance > _NEAR_ENOUGH:
        search.between_states()
    if search.best is None or search.best.distance > _NEAREST:
        return None
    _, path, value, first, last = search.best
    step = _map_and_step(shooting, manifold.backward)[1]
    turns = path[-1] - last.state - shooting.batch.chart.wrap(path[-1] - last.state)
    near = (first.state, last.state + turns)
    if manifold.backward:
        path, near = path[::-1], near[::-1]
    guess, duration = path_through(step * np.arange(len(path)), path, _INTERVALS)
    parameters = np.array([[value, shooting.second]])
    return ConnectionSeed(BoundarySolution(guess, np.array([duration]), parameters), *near)


class _Nearest(NamedTuple):
    """The path that has come nearest: its part of the largest distance, states, parameter and saddles."""

    distance: float
    path: Float[np.ndarray, "count d"]
    value: float
    departure: SaddlePoint
    arrival: SaddlePoint


class _PathSearch:
    """The search for a path that comes near to a saddle between two that pass it on different sides.

    Attributes:
        best: the nearest path, None before there is one.
    """

    def __init__(self, shooting: Shooting, manifold: Manifold, bracket: SideChange) -> None:
        self._shooting, self._manifold, self._bracket = shooting, manifold, bracket
        self._pair: tuple[_Nearest, _Nearest] | None = None  # next to each other, on different sides
        self.best: _Nearest | None = None

    def between_values(self) -> None:
        """Narrow the interval of the parameter, up to rounding."""
        shooting, (saddles, direction, ends, *_) = self._shooting, self._bracket
        for _ in range(_ROUNDS):
            values = np.linspace(*ends, _FINER + 1)
            starts, arrivals = (shooting.saddles(saddle.state, values) for saddle in saddles)
            if not (starts and arrivals):
                self.best = None
                return
            directions = _directions(self._manifold, starts, direction)
            paths = _paths(shooting, self._manifold, starts, directions, values)
            k = self._look([_Nearest(1.0, *each) for each in zip(paths, values, starts, arrivals, strict=True)])
            if k is None or self._is_near():
                return
            ends = float(values[k]), float(values[k + 1])

    def between_states(self) -> None:
        """Go on at one value of the parameter, on the segment between two paths where they begin to part.

        Of a direction in which paths part by e^(λt) the digits of the parameter tell nothing after a time of 36/λ. On
        the segment there is a state whose path stays, as between two states on both sides of an edge.
        """
        shooting, size, start = self._shooting, self._shooting.problem.size, 0
        for _ in range(_SEGMENTS):
            assert self._pair is not None
            first, second = self._pair
            count = min(len(first.path), len(second.path))
            with np.errstate(invalid="ignore"):
                apart = ~(np.abs((second.path[:count] - first.path[:count]) / size).max(axis=1) <= _APART)
            last = (int(np.argmax(apart)) if apart.any() else count) - 1
            if last <= start:
                return
            shares = np.linspace(0.0, 1.0, _FINER + 1)[:, None]
            states = first.path[last] + shares * (second.path[last] - first.path[last])
            more = _paths_from(shooting, self._manifold.backward, states, np.full(len(states), first.value))
            paths, start = [first._replace(path=np.concatenate([first.path[:last], path])) for path in more], last
            if self._look(paths) is None or self._is_near():
                return

    def _is_near(self) -> bool:
        return self.best is not None and self.best.distance <= _NEAR_ENOUGH

    def _look(self, paths: list[_Nearest]) -> int | None:
        """Number of the path after which sides change, None without; it or the next one may be the nearest."""
        pulse, passed = self._bracket.pulse, self._bracket.passed
        passages = passages_of_paths(
            self._shooting.view(self._manifold.backward),
            [each.path for each in paths],
            [each.arrival for each in paths],
            passed,
        )
        changed = [k for k in range(len(paths) - 1) if first_difference(passages[k], passages[k + 1]) == pulse]
        if not changed:
            return None
        self._pair = paths[changed[0]], paths[changed[0] + 1]
        for path, passage in zip(
            self._pair, (passages[changed[0]][pulse], passages[changed[0] + 1][pulse]), strict=True
        ):
            if self.best is None or passage.distance < self.best.distance:
                self.best = path._replace(distance=passage.distance, path=path.path[: passage.place + 1])
        return changed[0]
