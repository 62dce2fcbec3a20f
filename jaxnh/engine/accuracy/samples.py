"""Sample states of a sweep: where its motion goes from the start on, and which of its periods err most.

What runs maps on samples is in `sample_maps`, the sizes that errors are compared in are in `sizes`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnh.engine.accuracy.diagnostics import describe_rates, explain_chance_return, fault_of, lost_rank
from jaxnh.engine.accuracy.first_look import LANES_FOLLOWED, first_look, follow
from jaxnh.engine.accuracy.sample_maps import Image, SampleMaps, Samples, differences, gaps_between, image_of
from jaxnh.engine.accuracy.sizes import measure_sizes, rough_sizes
from jaxnh.engine.axes import SweepPoints
from jaxnh.exceptions import AccuracyError, LostLaneError
from jaxnh.maps.iterate import iterate
from jaxnh.maps.section import Crossing, Section, System, flow_of
from jaxnh.solvers import Solver
from jaxnh.systems.flow import Parameters
from jaxnh.systems.piecewise_smooth import PiecewisePoint, PiecewiseSmooth
from jaxnh.systems.rows import concatenate, select, spread_indices
from jaxnh.systems.state import State, is_finite, status_in_nan
from jaxnh.systems.status import CHATTERING, CODIMENSION_TWO, NO_RETURN, OUT_OF_STEPS

_CALLS, _PERIODS = 10, 17  # calls, and periods in each, in which sampled lanes are followed from the start
_AT_ONCE = 16 * _PERIODS  # of a rehearsal in one call; one by one where a lane is lost in them
_AT_REST = 1e-6  # of a lane's fastest crossing
_ALL_LANES_AT = (0, 12, 169)  # periods after the start at which every lane gives a sample
_MOST_SENSITIVE = 512  # of all periods on the way: far more than the share that is left out
_SEED_ERROR = 1e-3  # sample states need not be accurate, but of this very system
_MOST_SEED_KICKS = 1 << 16
_STEPS_A_PART = 64  # of a unit of time: so short that chaos has not yet enlarged everything in it
_GROWS = 5.0  # times that the largest coordinate grows in each quarter of a path: without bound
_FAR_GROWN = 1e3  # times what it was at the start: no size of a motion
_INFINITE = 1e100  # a coordinate beyond it has gone to infinity: products of three overflow, whatever the steps
_FAR = 4.0 * np.pi  # of an angle that has run on
_SAME_RATES = 1e-8  # of their sum, that rounding of an angle of many turns may change them by
_RETURNS_FOLLOWED = 2.0  # of the longest seen, beyond the last that steps have come to
_NO_LANE_RETURNS = 3  # numbers of steps, each twice the one before, with which no lane comes back: then none does
_NOT_LOST_BY_STEPS = (NO_RETURN, CHATTERING, CODIMENSION_TWO)  # why lanes fail whatever the steps


class SamplePaths(NamedTuple):
    """Samples of a sweep that is calibrated.

    Attributes:
        samples: those that errors are measured on.
        periods: number of periods that they were chosen from.
        sizes: size of the motion in each component that errors are compared in.
        start: where lanes begin.
        violent: whether steps that are right in first periods lost lanes in later ones.
    """

    samples: Samples
    periods: int
    sizes: Float[np.ndarray, " components"]
    start: Samples
    violent: bool


def take_samples(
    maps: SampleMaps,
    rows: Sequence[SweepPoints],
    given: Mapping[str, float],
    pay: Callable[[int, Samples], None],
) -> SamplePaths:
    """Return states across a sweep from the start towards the attractor: those whose periods err most, and some of all.

    Args:
        rows: sample lanes, those of each value of the shared axes together.
        given: sizes by coordinate, in place of those measured.
        pay: called with the evaluations of the field a period of the steps that follow the motion, and the start.

    Raises:
        AccuracyError: no lane has a period that can be computed.
        TooDearError: `pay` has raised it.
    """
    number = np.concatenate([np.full(len(jax.tree.leaves(row.start)[0]), i) for i, row in enumerate(rows)])
    start, p, where = concatenate((row.start, dict(row.p), dict(row.where)) for row in rows)
    now = Samples(start, p, number, where)
    first = _seed_steps(maps, now)
    whole, changes, steps = _follow_from_start(maps, now, first, pay)
    escaping = _is_escaping(whole.states) | _grows(whole.states)
    sizes = measure_sizes(maps, whole, changes, escaping, given)
    sensitive = gaps_between(changes, sizes)
    sensitive = np.where(np.isfinite(sensitive), sensitive, -1.0)
    sensitive[:, _ALL_LANES_AT] = np.inf
    if not np.all(escaping):
        sensitive[escaping] = -1.0
    count = min(_MOST_SENSITIVE + len(number) * len(_ALL_LANES_AT), int(np.sum(~escaping)) or sensitive.size)
    chosen = np.sort(np.argsort(-sensitive, axis=None, kind="stable")[:count])
    moving = chosen[~_at_rest(maps, whole).ravel()[chosen]]
    lane, time = np.divmod(moving if len(moving) else chosen, sensitive.shape[1])
    taken = now.take_lanes(lane)._replace(states=select(whole.states, (lane, time)))
    kept = _without_lost(maps, _without_turns(maps, taken), max(maps.scheme.first_steps, steps))
    return SamplePaths(kept, sensitive.size, sizes, now, steps > first)


def are_lost_by(maps: SampleMaps, start: Samples, solver: Solver, steps: int, periods: int) -> bool:
    """Return whether steps lose a lane within so many periods whose motion stays finite."""
    map_of, now = maps.of(solver, steps), start

    def image(now: Samples, count: int) -> State:
        return maps.by_flow(iterate, lambda row: (map_of(row), np.int32(count)), now, count)

    for done in range(0, periods, _AT_ONCE):
        stretches = -(-min(_AT_ONCE, periods - done) // _PERIODS)
        after = image(now, stretches * _PERIODS)
        lost = is_finite(now.states) & ~is_finite(after)
        for _ in range(stretches if np.any(lost) else 0):
            met: list[State] = [now.states]
            for _ in range(_PERIODS):
                met.append(image(now._replace(states=met[-1]), 1))
            states = jax.tree.map(lambda *z: np.stack(z, axis=1), *met[:-1])
            if _lost_on_the_way(maps, now, states, met[-1], first=1) >= 0:
                return True
            now = now._replace(states=met[-1])
        now = now._replace(states=after)
    return False


def _follow_from_start(
    maps: SampleMaps, start: Samples, steps: int, pay: Callable[[int, Samples], None]
) -> tuple[Samples, Float[np.ndarray, "components lanes periods"], int]:
    """Follow lanes over the periods that are looked at, by so many steps or as many more as follow their motions.

    Steps that are right in the first period may lose a lane in a later one, as in a rare and violent turn: what is then
    not finite would be taken for a motion that goes to infinity.

    Returns:
        States (lanes, periods), how far apart each is after a period by half the steps, and the steps.

    Raises:
        LostLaneError: the most steps that are tried lose a lane whose motion stays finite; of a lane's own, all lanes.
    """
    while True:
        pay(steps * maps.scheme.reference.stages, start)
        states, apart, last = _follow_by(maps, start, steps)
        if (stays := _lost_on_the_way(maps, start, states, last)) < 0:
            return start._replace(states=states), apart, steps
        steps *= 2
        if steps * maps.scheme.reference.stages > _MOST_SEED_KICKS:
            some = np.any(is_finite(last))
            before = _last_finite(states, stays)
            why = "" if maps.adaptive and some else lost_rank(*_lane_at(maps, start, stays, before))
            if why or not maps.adaptive:
                raise _not_followed(maps, start, stays, before, why)
            return start._replace(states=states), apart, steps


def _follow_by(
    maps: SampleMaps, now: Samples, steps: int
) -> tuple[State, Float[np.ndarray, "components lanes periods"], State]:
    """States (lanes, periods) of so many steps a period, how far apart those of half the steps are, and the last."""
    finer, coarser = (maps.of(maps.scheme.reference, n) for n in (steps, max(1, steps // 2)))
    states: list[State] = []
    apart: list[Float[np.ndarray, "components lanes periods"]] = []
    for _ in range(_CALLS):
        met: list[State] = [now.states]
        for _ in range(_PERIODS):
            at = now._replace(states=met[-1])
            met.append(maps.by_flow(iterate, lambda row: (finer(row), np.int32(1)), at, 1))
        before, following = (jax.tree.map(lambda *z: np.stack(z, axis=1), *part) for part in (met[:-1], met[1:]))
        states.append(before)
        each = _one_by_one(now._replace(states=states[-1]))
        image = differences(maps.image(coarser, each), image_of(jax.tree.map(np.ravel, following)))
        apart.append(image.reshape(len(image), -1, _PERIODS))
        now = now._replace(states=met[-1])
    whole = concatenate(states, axis=1)
    return whole, np.concatenate(apart, axis=2), now.states


def _lost_on_the_way(maps: SampleMaps, start: Samples, states: State, last: State, first: int = 2) -> int:
    """Return a lane that steps lose in period `first` or later but whose motion stays finite; −1: there is none.

    One that has run out of steps of its own, as on its way to infinity, needs no finer ones while others go on; and one
    that leaves a saddle of a linear flow may be as good as at infinity while all its coordinates are numbers.
    """
    every = jax.tree.map(lambda leaf, end: np.concatenate([leaf, end[:, None]], axis=1), states, last)
    finite = is_finite(every)
    when = np.argmin(finite, axis=1)
    lost = finite[:, 0] & (when >= first)
    lane = np.arange(len(when))
    lost &= _moduli(select(every, (lane, np.maximum(when - 1, 0)))) < _INFINITE
    if maps.adaptive and np.any(finite[:, -1]):
        ended = np.asarray(jax.tree.leaves(every)[0], float)[:, -1]
        lost &= status_in_nan(ended) != OUT_OF_STEPS
    if not np.any(lost):
        return -1
    before, after = (select(every, (lane, at)) for at in (when - 1, when))
    return _stays_finite(maps, start._replace(states=before), after, lost, _longest_return(maps, every))


def _longest_return(maps: SampleMaps, states: State) -> float | None:
    """Return how long a lane is followed to its section, by states (lanes, returns + 1); None where there is none."""
    if not maps.sectioned:
        return None
    with np.errstate(invalid="ignore"):
        returns = np.diff(states.t, axis=1)
    longest = _RETURNS_FOLLOWED * float(np.max(returns, initial=0.0, where=np.isfinite(returns)))
    return max(longest, maps.flow.period)


def _last_finite(states: State, lane: int) -> State:
    """The last of a lane's states (lanes, periods) before it is lost."""
    finite = np.stack([np.isfinite(leaf[lane]) for leaf in jax.tree.leaves(states)]).all(axis=0)
    return select(states, (lane, int(np.argmin(finite)) - 1))


def _lane_at(maps: SampleMaps, start: Samples, lane: int, state: State) -> tuple[System, State, Parameters]:
    """The system of a lane, a state of it, and its parameters."""
    return maps.flows[int(start.row[lane])], state, select(dict(start.p), lane)


def _one_by_one(samples: Samples) -> Samples:
    """Return samples with states (lanes, periods) as samples of one state each."""
    periods = jax.tree.leaves(samples.states)[0].shape[1]
    lane = np.repeat(np.arange(len(samples.row)), periods)
    return samples.take_lanes(lane)._replace(states=jax.tree.map(np.ravel, samples.states))


def _seed_steps(maps: SampleMaps, samples: Samples) -> int:
    """Steps with which the first period is roughly right, whatever its length.

    They are doubled until the image settles; in a unit of time in which chaos enlarges everything, until that of a part
    does, from the start and from a unit later. Where the most that are tried leave no lane finite, a first look with
    steps that follow the motion says how many it needs, or that there are none. Where they leave some, a lane is lost
    for ever if such steps lose it too.

    Raises:
        AccuracyError: no lane comes back to its section, by several numbers of steps.
        LostLaneError: the most that are tried lose a lane whose motion stays finite.
    """
    solver, steps = maps.scheme.reference, maps.scheme.rough_steps
    start, later = image_of(samples.states), samples.states
    image = maps.image(maps.of(solver, steps), samples)
    lost, stays, without_return = np.ones(len(samples.row), bool), -1, 0
    while 2 * steps * solver.stages <= _MOST_SEED_KICKS:
        maps.tell(f"the start states with {2 * steps * solver.stages:,} evaluations of the field a period")
        later = maps.by_flow(iterate, lambda row, n=2 * steps: (maps.of(solver, n)(row), np.int32(1)), samples, 1)
        without_return = without_return + 1 if maps.sectioned and np.all(later.reason == NO_RETURN) else 0
        if without_return == _NO_LANE_RETURNS:
            raise _no_lane(maps, samples)
        coarser, image = image, image_of(later)
        gaps = gaps_between(differences(coarser, image), rough_sizes(maps, start, image))
        lost = ~np.isfinite(gaps)  # by so few steps, where so are all, or for ever
        stays = -1
        if np.any(lost) and not np.all(lost):
            both = jax.tree.map(lambda *z: np.stack(z, axis=1), samples.states, later)
            stays = _stays_finite(maps, samples, later, lost, _longest_return(maps, both))
        if not np.all(lost) and np.all(lost | (gaps < _SEED_ERROR)) and stays < 0:
            return steps
        steps *= 2
        if maps.may_be_cut and not np.any(lost) and steps >= 4 * _STEPS_A_PART:
            part = maps.in_parts(steps // _STEPS_A_PART)
            if all(_settles(part, samples, steps, states) for states in (samples.states, later)):
                return steps
    if stays >= 0 and not maps.adaptive:
        by_chance = maps.sectioned and np.isfinite(later.t[stays])
        why = explain_chance_return(float(later.t[stays])) if by_chance else ""
        raise _not_followed(maps, samples, stays, select(samples.states, stays), why)
    return max(steps, first_look(maps, samples).steps) if np.all(lost) else steps


def _stays_finite(
    maps: SampleMaps, samples: Samples, images: State, lost: Bool[np.ndarray, " lanes"], length: float | None
) -> int:
    """Return a lane whose image is lost but whose motion is not, by steps that follow it; −1: there is none.

    A particle at a prescribed speed is not stiff, and steps do not lose a lane that does not return to its section, nor
    one that comes to rest on a wall.
    """
    if maps.scheme.smooth:
        return -1
    if maps.sectioned or isinstance(images, PiecewisePoint):
        lost = lost & ~np.isin(images.reason, _NOT_LOST_BY_STEPS)  # what only the longer steps have lost is among them
    numbers = np.flatnonzero(lost)
    if not len(numbers):
        return -1
    picked = numbers[spread_indices(len(numbers), LANES_FOLLOWED)]
    arrived = follow(maps, samples.take_lanes(picked), length).arrived >= 1.0
    return int(picked[np.argmax(arrived)]) if np.any(arrived) else -1


def _not_followed(maps: SampleMaps, start: Samples, lane: int, before: State, why: str = "") -> LostLaneError:
    """The error that steps do not follow the motion of a lane, with what is singular there, or else its rates.

    Args:
        before: a state of the lane from which it is lost.
    """
    rates = "" if why else describe_rates(*_lane_at(maps, start, lane, before))
    reason = f"the motion: {why}" if why else f"a motion that stays finite: {rates}"
    return LostLaneError(f"at {start.place(lane)} steps do not follow {reason}")


def _settles(maps: SampleMaps, samples: Samples, steps: int, states: State) -> bool:
    """Return whether images of states of sample lanes are roughly right with so many steps a period."""
    settled = samples._replace(states=states)
    coarser, finer = (maps.image(maps.of(maps.scheme.reference, n), settled) for n in (steps, 2 * steps))
    gaps = gaps_between(differences(coarser, finer), rough_sizes(maps, image_of(states), finer))
    return bool(np.all(gaps < _SEED_ERROR))


def _at_rest(maps: SampleMaps, samples: Samples) -> Bool[np.ndarray, "samples periods"]:
    """Return where lanes cross their section so slowly that they rest on it: their time is then no number."""
    if not maps.sectioned:
        return np.zeros(jax.tree.leaves(samples.states)[0].shape, bool)
    speed = np.abs(maps.by_flow(_crossing_rates, lambda row: (maps.flows[row],), samples, 0))
    return speed < _AT_REST * np.max(speed, axis=1, initial=0.0, where=np.isfinite(speed), keepdims=True)


def _crossing_rates(section: Section, states: Crossing, p: Parameters) -> Float[Array, " points"]:
    """Rate of the height above the section at states of one lane."""
    return jax.vmap(lambda y: section.rate(y, p))(states.state)


def _without_turns(maps: SampleMaps, samples: Samples) -> Samples:
    """Samples whose angles have lost their whole turns, where the field is the same without them.

    An angle that has run on has fewer digits than a target may ask for, and a period no other error for that.
    """
    chart = maps.flows[0].chart
    if not any(chart.angles) or isinstance(maps.flow, PiecewiseSmooth):
        return samples
    if not np.any(np.abs(chart.host_points(samples.states)[:, np.array(chart.angles)]) > _FAR):
        return samples
    states, same = maps.by_flow(_turned_back, lambda row: (maps.flows[row],), samples, 0)
    return samples._replace(states=states) if np.all(same) else samples


def _turned_back(system: System, state: State, p: Parameters) -> tuple[State, Array]:
    """A state of one lane without whole turns of its angles, and whether it has the same rates."""
    back, flow = system.chart.state(system.chart.point(state)), flow_of(system)
    rates = [jax.tree.leaves(flow.rhs(0.0, y.state if isinstance(y, Crossing) else y, p)) for y in (state, back)]
    before, after = (jnp.stack(jnp.broadcast_arrays(*leaves)) for leaves in rates)
    return back, jnp.all(jnp.abs(after - before) <= _SAME_RATES * jnp.sum(jnp.abs(before)))


def _without_lost(maps: SampleMaps, samples: Samples, steps: int) -> Samples:
    """Leave out samples that overflow whatever the steps, as those of an absurd b: their lanes are marked failed.

    Raises:
        AccuracyError: there are no others; `LostLaneError` where no matrix is singular.
    """
    image: Image = maps.image(maps.of(maps.scheme.reference, steps), samples)
    kept = np.flatnonzero(np.all(np.isfinite(image), axis=0))
    if not len(kept):
        raise _no_lane(maps, samples)
    return samples.take_lanes(kept)


def _no_lane(maps: SampleMaps, samples: Samples) -> AccuracyError:
    """The error that no lane has a period, with what is seen of the reason; `LostLaneError` where steps may be it."""
    first = select(samples, 0)
    at = system, *_ = maps.flows[int(first.row)], first.states, first.p
    periods = system.longest if isinstance(system, Section) else 1.0
    why = fault_of(*at, first_look(maps, samples, periods).explanation)
    why = why and f"; at {samples.place(0)} {why}"
    lost = "does not come back to its section" if maps.sectioned else "has a non-finite state within a period"
    message = f"every lane of this sweep {lost}{why}"
    return AccuracyError(message) if lost_rank(*at) else LostLaneError(message)


def _is_escaping(states: State) -> Bool[np.ndarray, "lanes periods"]:
    """Return where a lane goes to infinity: not finite within two periods, as motion that blows up does ever faster.

    No number of steps gives such a period an error that means anything; the lane is marked as failed where it is run.
    """
    finite = np.all([np.isfinite(leaf) for leaf in jax.tree.leaves(states)], axis=0)
    lost = np.pad(~finite, [(0, 0), (0, 2)])
    return lost[:, :-2] | lost[:, 1:-1] | lost[:, 2:]


def _grows(states: State) -> Bool[np.ndarray, "lanes periods"]:
    """Return where a lane has grown far, which grows without bound, as in a resonance of a linear equation.

    What it has grown to is no size of a motion that errors could be relative to.
    """
    moduli = _moduli(states)
    parts = np.array_split(moduli, 4, axis=1)
    quarters = np.stack([part.max(axis=1) for part in parts])
    growing = np.all(quarters[1:] > _GROWS * quarters[:-1], axis=0)
    return growing[:, None] & (moduli > _FAR_GROWN * moduli[:, :1])


def _moduli(states: State) -> Float[np.ndarray, ...]:
    """Largest modulus of any coordinate of each state."""
    return np.max([np.abs(leaf) for leaf in jax.tree.leaves(states)], axis=0)
