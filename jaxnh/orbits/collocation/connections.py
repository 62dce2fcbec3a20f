"""Curves of homoclinic and heteroclinic orbits over two parameters, by the core of continuation. Host code.

The unknowns are the path on a mesh and both parameters; the equations are those of collocation with projection boundary
conditions at the saddles (`homoclinic`), for a duration that is held, and an integral phase condition. A curve is
followed in stretches of a few points: after each the rests at the ends, the mesh and sizes are adapted to the orbit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxnh.exceptions import InputError
from jaxnh.orbits.collocation.connection_meshes import (
    MOST_INTERVALS,
    Connection,
    across_curve,
    adapted,
    with_own_saddles,
)
from jaxnh.orbits.collocation.equations import (
    BoundarySolution,
    NewtonSystem,
    Problem,
    Variation,
    combination,
    direction_without,
    fixed,
    inner,
    linearise,
    orthonormal,
    phase_condition,
)
from jaxnh.orbits.collocation.homoclinic import hold_duration, projections, saddle_at
from jaxnh.orbits.collocation.newton import on_adapted_mesh, remeshed
from jaxnh.orbits.collocation.paths import PiecewisePath
from jaxnh.orbits.continuation import core
from jaxnh.orbits.continuation.core import EquationsOfPaths, Evaluation, Solution
from jaxnh.orbits.continuation.paths import (
    BOGDANOV_TAKENS,
    MOST_POINTS,
    NO_CONVERGENCE,
    NO_RETURN,
    NO_SADDLE,
    Path,
    StepControl,
)

_STRETCH = 12  # points between meshes
_INTERVALS = 60  # of a first mesh
_FIRST = 0.1  # of the largest step
_GROWN = 2.0  # half extents in sizes: of larger orbits sizes are chosen anew


class Stretch(NamedTuple):
    """A part of a curve on one mesh.

    Attributes:
        problem: the field, in sizes of the orbits here.
        points: orbits, in order.
        between: orbits of the curve between two points: (number of the first, share of the way to the next), None
            where Newton comes to none.
    """

    problem: Problem
    points: list[Connection]
    between: Callable[[int, float], Connection | None]


class ConnectionCurve(NamedTuple):
    """A curve in both directions from where it was begun.

    Attributes:
        stretches: from one end to the other; each begins with the orbit that the one before ends with.
        ends: why it ends where it begins, and at its end, numbers in `continuation.paths.ENDS`.
    """

    stretches: list[Stretch]
    ends: tuple[int, int]


class VanishingPoint(NamedTuple):
    """A Bogdanov–Takens point, in which homoclinic orbits vanish.

    Attributes:
        state: the equilibrium.
        radius: in units of the coordinates: curves end with an orbit all of whose states are as near.
    """

    state: Float[np.ndarray, " d"]
    radius: Float[np.ndarray, " d"]


class ConnectionEquations(EquationsOfPaths):
    """Connecting orbits near one, on its mesh and of its duration, as `core.CurveEquations`, in sizes and widths."""

    def __init__(
        self,
        problem: Problem,
        near: Connection,
        low: Float[np.ndarray, " 2"],
        high: Float[np.ndarray, " 2"],
        vanishing: Sequence[VanishingPoint] = (),
    ) -> None:
        path = near.solution.path
        self._problem, self._near, self._vanishing = problem, near, vanishing
        self._boundary = projections(problem, near.departure, near.arrival)
        # Lengths are means over the path; ends of intervals follow from what is inside.
        inside = np.repeat(1.0 / np.sqrt(path.measure.ravel()), path.ends.shape[2])
        self.unit = np.concatenate([np.full(path.ends[0].size, np.inf), inside, np.ones(2)])
        self.low, self.high = low / problem.widths, high / problem.widths
        self._shift = phase_condition(problem, self._linear(near.solution))

    def unknowns(self, solution: BoundarySolution) -> Float[np.ndarray, "1 N"]:
        """Unknowns of an orbit on the same mesh."""
        ends, stages = (
            part.ravel() / np.tile(self._problem.size, part.size // part.shape[-1]) for part in solution.path[1:]
        )
        return np.concatenate([ends, stages, solution.values[0] / self._problem.widths])[None]

    def orbit(self, z: Float[np.ndarray, " N"]) -> BoundarySolution:
        """The path and parameters of unknowns."""
        path, size = self._near.solution.path, self._problem.size
        count = path.ends.size
        ends, stages = z[:count].reshape(path.ends.shape) * size, z[count:-2].reshape(path.stages.shape) * size
        moved = PiecewisePath(path.mesh, ends, stages)
        return BoundarySolution(moved, self._near.solution.duration, z[None, -2:] * self._problem.widths)

    def connection(self, z: Float[np.ndarray, " N"], residual: float) -> Connection:
        """The orbit of unknowns with its saddles; raises `InputError` where there are none."""
        orbit, ends = self.orbit(z), (self._near.departure, self._near.arrival)
        saddles = [saddle_at(self._problem, end.state, orbit.values[0]) for end in ends]
        return Connection(orbit, saddles[0], saddles[1], residual)

    def evaluate(self, z: Float[np.ndarray, "lanes N"], /) -> Evaluation:
        """Residuals, and the step of Newton and the direction of the curve; not finite where there is no saddle."""
        rows = [self._evaluate(unknowns) for unknowns in z]
        residual, slopes = (np.stack(leaves) for leaves in zip(*rows, strict=True))
        return Evaluation(residual, np.zeros((len(z), 0)), slopes)

    def equivalents(self, z: Float[np.ndarray, "lanes N"], /) -> Iterable[Float[np.ndarray, "lanes N"]]:
        """None but the orbit itself."""
        return (z,)

    def endings(self, now: Solution, taken: Solution, /) -> tuple[Mapping[int, np.ndarray], Bool[np.ndarray, " lanes"]]:
        """Orbits that are about to vanish."""
        vanish = np.array([self._vanishes(z) for z in taken.z], bool)
        return {BOGDANOV_TAKENS: vanish}, np.zeros(len(taken.z), bool)

    def _vanishes(self, z: Float[np.ndarray, " N"]) -> bool:
        states = self.orbit(z).path.ends[0]
        with np.errstate(invalid="ignore"):
            return any(bool(np.all(np.abs(states - each.state) <= each.radius)) for each in self._vanishing)

    def _linear(self, orbit: BoundarySolution) -> NewtonSystem:
        line = linearise(self._problem, orbit, self._boundary(orbit, np.zeros(1, int)))
        return orthonormal(orbit.path, line)

    def _evaluate(self, z: Float[np.ndarray, " N"]) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, "2 N"]]:
        orbit, path = self.orbit(z), self._near.solution.path
        try:
            line = self._linear(orbit)
        except (InputError, np.linalg.LinAlgError):
            return np.full(2, np.nan), np.full((2, len(z)), np.nan)
        gap = self.unknowns(orbit) - self.unknowns(self._near.solution)
        passed = float(np.sum(gap[0] / self.unit * (self._flat(self._shift) / self.unit)))
        conditions = [self._shift, fixed(line, -1)]
        matrix = np.stack([[inner(path, way, direction)[0] for direction in line.null] for way in conditions])
        missing = np.stack([inner(path, way, line.particular)[0] for way in conditions])
        missing[0] += passed
        shares = np.linalg.lstsq(matrix, -missing)[0]
        least = combination([(1.0, line.particular), *zip(shares, line.null, strict=True)])
        null = direction_without(path, line, conditions)
        scale = np.sqrt(inner(path, self._shift, self._shift)[0])
        return np.array([line.residual[0], passed / scale]), np.stack([self._flat(least), self._flat(null)])

    def _flat(self, variation: Variation) -> Float[np.ndarray, " N"]:
        return np.concatenate([variation.ends.ravel(), variation.stages.ravel(), variation.extra[0, 1:]])


def connection_near(
    problem: Problem,
    guess: BoundarySolution,
    departure: Float[np.ndarray, " d"],
    arrival: Float[np.ndarray, " d"],
) -> Connection | None:
    """The connecting orbit near a path, at the value of the second parameter; None where there is none.

    Args:
        problem: the field, with two parameters.
        guess: one lane.
        departure, arrival: states near the saddles.
    """
    values = guess.values[0]
    problem_of_one = _of_first_parameter(problem, values)
    try:
        saddles = saddle_at(problem, departure, values), saddle_at(problem, arrival, values)
        if len(saddles[0].unstable) != len(saddles[1].unstable):
            return None
        first = guess._replace(values=values[None, :1])
        solved = on_adapted_mesh(
            problem_of_one, first, projections(problem_of_one, *saddles), hold_duration, _INTERVALS, cyclic=False
        )
        if not solved.converged[0]:
            return None
        both = values.copy()
        both[0] = solved.solution.values[0, 0]
        return adapted(
            problem,
            with_own_saddles(problem, Connection(solved.solution._replace(values=both[None]), *saddles)),
            held=1,
        )
    except (InputError, np.linalg.LinAlgError):
        return None


def connection_across(
    problem: Problem,
    guess: BoundarySolution,
    departure: Float[np.ndarray, " d"],
    arrival: Float[np.ndarray, " d"],
) -> Connection | None:
    """The connecting orbit near a path that is near in both parameters, across the curve; as `connection_near`."""
    try:
        saddles = saddle_at(problem, departure, guess.values[0]), saddle_at(problem, arrival, guess.values[0])
        guess = remeshed(problem, guess, _INTERVALS, cyclic=False)
        point = across_curve(problem, Connection(guess, saddles[0], saddles[1]), guess)
        return None if point is None else adapted(problem, point)
    except (InputError, np.linalg.LinAlgError):
        return None


def follow_connections(
    problem: Problem,
    start: Connection,
    low: Float[np.ndarray, " 2"],
    high: Float[np.ndarray, " 2"],
    steps: StepControl,
    vanishing: Sequence[VanishingPoint] = (),
) -> ConnectionCurve:
    """The curve through an orbit, from one end to the other, between the ends of both parameters' ranges.

    Args:
        problem: the field, with two parameters.
        start: the orbit.
        low, high: ends of the ranges.
        steps: how the curve is followed.
        vanishing: Bogdanov–Takens points, which end it.
    """
    sides = [_follow(problem, start, sign, low, high, steps, vanishing) for sign in (1.0, -1.0)]
    (ahead, last), (back, first) = sides
    return ConnectionCurve([*(reversed_stretch(stretch) for stretch in back[::-1]), *ahead], (first, last))


# ---- stretches


def _follow(
    problem: Problem,
    start: Connection,
    sign: float,
    low: np.ndarray,
    high: np.ndarray,
    steps: StepControl,
    vanishing: Sequence[VanishingPoint],
) -> tuple[list[Stretch], int]:
    """The curve from an orbit in one direction, stretch by stretch, and why it ends."""
    stretches, left, size, now, toward = list[Stretch](), steps.max_steps, steps.ds, start, None
    while left > 0:
        equations = ConnectionEquations(problem, now, low, high, vanishing)
        first = core.correct(equations, equations.unknowns(now.solution), tolerance=core.FINE)
        if not first.converged[0]:
            return stretches, NO_CONVERGENCE
        share = sign * first.way[0, -1] if toward is None else first.way[0, -2:] @ toward
        if (share if toward is not None or share else sign * first.way[0, -2]) < 0.0:
            first = first.backward()
        control = StepControl(steps.ds_max, min(_STRETCH, left), size or _FIRST * steps.ds_max, steps.ds_min)
        track, end = _track(equations, first, control)
        stretch = _stretch(problem, equations, track)
        stretches.append(stretch)
        left -= len(stretch.points) - 1
        if len(stretch.points) < 2:
            intervals = now.solution.path.stages.shape[1]
            if end == NO_CONVERGENCE and 2 * intervals <= MOST_INTERVALS:
                stretches.pop()
                now = adapted(problem, now, 2 * intervals)
                continue
            return stretches, NO_SADDLE if end == NO_RETURN else end
        if end not in (MOST_POINTS, NO_CONVERGENCE):
            return stretches, NO_SADDLE if end == NO_RETURN else end
        gaps = core.norm(equations.unit, np.diff(track.z[-2:], axis=0))
        size, toward = float(np.clip(gaps[0], steps.ds_min, steps.ds_max)), track.way[-1, -2:]
        problem, now = _in_own_sizes(problem, adapted(problem, stretch.points[-1]))
    return stretches, MOST_POINTS


def _in_own_sizes(problem: Problem, point: Connection) -> tuple[Problem, Connection]:
    """An orbit in sizes that suit it, where it has outgrown those of the problem."""
    half = 0.5 * np.ptp(point.solution.path.ends[0], axis=0)
    if not np.any(half > _GROWN * problem.size):
        return problem, point
    problem = problem._replace(size=np.maximum(problem.size, half))
    return problem, with_own_saddles(problem, point)


def _track(equations: ConnectionEquations, first: Solution, control: StepControl) -> tuple[Solution, int]:
    path = Path(equations, first, control)
    path.begin(np.zeros(1, int))
    while len(path.active):
        path.step()
    return path.track(0), int(path.end[0])


def _stretch(problem: Problem, equations: ConnectionEquations, track: Solution) -> Stretch:
    points = list[Connection]()
    for z, residual in zip(track.z, track.residual, strict=True):
        try:
            points.append(equations.connection(z, float(residual)))
        except InputError:
            break

    def between(number: int, share: float) -> Connection | None:
        z, way = (leaf[number] + share * (leaf[number + 1] - leaf[number]) for leaf in (track.z, track.way))
        way /= core.norm(equations.unit, way[None])[0]
        there = core.correct(equations, z[None], way[None], core.FINE)
        if not there.converged[0]:
            return None
        try:
            return equations.connection(there.z[0], float(there.residual[0]))
        except InputError:
            return None

    return Stretch(problem, points, between)


def reversed_stretch(stretch: Stretch) -> Stretch:
    """The stretch from its other end."""
    last = len(stretch.points) - 1

    def between(number: int, share: float) -> Connection | None:
        return stretch.between(last - 1 - number, 1.0 - share)

    return stretch._replace(points=stretch.points[::-1], between=between)


def _of_first_parameter(problem: Problem, values: Float[np.ndarray, " 2"]) -> Problem:
    """The problem with the first of both parameters, the second held."""

    def field(y: np.ndarray, t: np.ndarray, value: np.ndarray):
        both = np.tile(values, (len(y), 1))
        both[:, 0] = value[:, 0]
        at = problem.field(y, t, both)
        return at._replace(by_parameters=np.asarray(at.by_parameters)[..., :1])

    return problem._replace(field=field, widths=problem.widths[:1])
