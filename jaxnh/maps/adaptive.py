"""The map over a stretch of time by an embedded pair, each lane with steps of its own.

A lane takes the steps that its motion needs, while finished ones wait; the last step ends at the end. Tangents and
volume take the very same steps: how long these are is not differentiated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.maps.batching import as_batched
from jaxnh.maps.general_flow import Moving, linearise, own_parameters, restored, stack_leaves
from jaxnh.maps.protocol import Pushforward, ReturnMap, Tangent
from jaxnh.maps.time_tables import time_split
from jaxnh.solvers.adaptive import AdaptiveMethod
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.state import State, error_components, masked
from jaxnh.systems.status import NOT_FINITE, OUT_OF_STEPS

_MOST_TRIALS = 1 << 17  # steps that are tried in a map: a lane that needs more has run out of them
_SHORTEST = 1e-15  # of the length of time: what needs shorter steps goes to infinity, or its rates do
_FIRST = 1e-12  # of the length of time: the first step is as long at least, and shortened where that is too long
_SMALL = 1e-4  # of the largest coordinate: the size of one that is smaller, which may be the rounding of others
_SAFETY, _SHRINK, _GROW = 0.9, 0.1, 6.0
_LONGEST = 2.0  # times an equal step: at rest a state says nothing of the steps that its tangents need
_PROPORTIONAL, _INTEGRAL = 0.4, 0.7  # Hairer and Wanner II, section IV.2: exponents of a PI controller, times the order


class _Progress(NamedTuple):
    """One lane on its way.

    Attributes:
        moving: state, tangents and volume.
        size: largest modulus of each component so far.
        t: time since the beginning.
        h: length of the next step.
        before: error of the last step that was taken, in units of the tolerance.
        refused: whether the last step that was tried was too long.
        trials: steps tried.
    """

    moving: Moving
    size: list[Array]
    t: Array
    h: Array
    before: Array
    refused: Array
    trials: Array


class AdaptiveStrobe(ReturnMap):
    """P over a stretch of time.

    Errors of a step are relative to the largest modulus of each component in the stretch so far. A lane fails, its
    state then not a number, where its motion is not finite or needs shorter steps than time can tell apart
    (`not_finite`), and where it needs more steps than there may be (`out_of_steps`).

    Attributes:
        system: the flow.
        solver: the pair.
        begin: time at the beginning.
        length: of time.
        tolerance: error of a step, relative to the size of the motion.
        longest: longest step.
    """

    system: Flow
    solver: AdaptiveMethod = eqx.field(static=True)
    begin: ArrayLike
    length: ArrayLike
    tolerance: ArrayLike
    longest: ArrayLike

    @property
    def trip_counts(self) -> tuple[float, ...]:
        """Steps of a calm motion; a stiff one has more."""
        return (max(1.0, float(np.mean(_LONGEST * np.asarray(self.length) / np.asarray(self.longest)))),)

    def rescaled_time(self, factor: ArrayLike) -> AdaptiveStrobe:
        return replace(self, length=self.length * factor)

    def __call__(self, state: State, p: Parameters) -> State:
        return self.pushforward(state, p, (), volume=False).state

    def pushforward(
        self, state: State, p: Parameters, tangents: tuple[Tangent, ...], volume: bool = True
    ) -> Pushforward:
        system, own, first = self.system, own_parameters(self.system, p), jax.tree.leaves(state)[0]
        by_p, placed, ended = self._marched(state, p, tangents, volume)
        moving = ended.moving
        if not system.reduction.leaves_constraints:
            end = self.begin + self.length
            moving = _carried_along(lambda z, own: restored(system, end, z, placed, {**p, **own}), moving, own, by_p)
        why = jnp.where(ended.trials < _MOST_TRIALS, NOT_FINITE, OUT_OF_STEPS)
        arrived = masked(moving.state, ended.t >= self.length, why)
        pushed = tuple(Tangent(dz, t.p) for dz, t in zip(moving.tangents, tangents, strict=True))
        return Pushforward(arrived, pushed, moving.log_volume if volume else jnp.zeros_like(first))

    def trials(self, state: State, p: Parameters) -> Array:
        """Number of steps that the motion from a state tries, the most there may be where it does not come through."""
        _, _, ended = self._marched(state, p, (), volume=False)
        return jnp.where(ended.t >= self.length, ended.trials, _MOST_TRIALS)

    def _marched(
        self, state: State, p: Parameters, tangents: tuple[Tangent, ...], volume: bool
    ) -> tuple[list[Any], State, _Progress]:
        """The parameters' part of tangents, the state on its constraints at the beginning, and the lane at its end."""
        system, reduction, own = self.system, self.system.reduction, own_parameters(self.system, p)
        by_p: Any = [{**jax.tree.map(jnp.zeros_like, own), **t.p} if t.p else None for t in tangents]
        rates = self._rates(volume)

        def advance(course: _Progress) -> _Progress:
            y, left = course.moving, self.length - course.t
            last = 1.01 * course.h >= left
            h = lax.stop_gradient(jnp.where(last, left, course.h))
            t = self.begin + course.t
            (after, error, gained), moved = linearise(
                lambda z, own: self._step(rates, t, h, z, {**p, **own}), y.state, own, y.tangents, by_p
            )
            log_volume = y.log_volume + gained[0] if volume else None
            ahead = Moving(after, tuple(dz for dz, _, _ in moved), log_volume)
            size = [jnp.maximum(s, jnp.abs(x)) for s, x in zip(course.size, _components(after), strict=True)]
            share = self._share_of_tolerance(_components(error), size, _components(after))
            good = share <= 1.0
            return _Progress(
                jax.tree.map(lambda new, old: jnp.where(good, new, old), ahead, y),
                [jnp.where(good, new, old) for new, old in zip(size, course.size, strict=True)],
                jnp.where(good, jnp.where(last, self.length, course.t + h), course.t),
                jnp.minimum(h * self._change(share, course), self.longest),
                jnp.where(good, share, course.before),
                ~good,
                course.trials + 1,
            )

        def unfinished(course: _Progress) -> Array:
            going = (course.h > _SHORTEST * self.length) & (course.trials < _MOST_TRIALS)
            return (course.t < self.length) & going

        first = jax.tree.leaves(state)[0]
        zero = jnp.zeros_like(first)
        start = Moving(state, tuple(t.state for t in tangents), zero if volume else None)
        if not reduction.leaves_constraints:
            start = _carried_along(lambda z, own: system.project(self.begin, z, {**p, **own}), start, own, by_p)
        placed = start.state
        start = Moving(reduction.reduce(placed), tuple(map(reduction.reduce, start.tangents)), start.log_volume)
        size = [jnp.abs(lax.stop_gradient(x)) for x in _components(start.state)]
        rate = jax.tree.unflatten(jax.tree.structure(start.state), rates(self.begin, start.state, own)[: _count(start)])
        h = self._first_step(size, _components(rate))
        course = _Progress(start, size, zero, h, zero + 1.0, zero > 1.0, jnp.int32(0))
        return by_p, placed, lax.while_loop(unfinished, advance, as_batched(course, first))

    def _rates(self, volume: bool) -> Callable[[Any, State, Any], list[Any]]:
        """Rates of the state's numbers, and of the logarithm of a volume where that is asked for."""
        system, split = self.system, time_split(self.system)

        def rates(t: Any, y: State, own: Any) -> list[Any]:
            def rate(z: State) -> State:
                return split.rest(split.table(t, system), system, (z, own))

            return [*jax.tree.leaves(rate(y)), *([system.reduction.divergence_of(rate, y)] if volume else [])]

        return rates

    def _step(
        self, rates: Callable[[Any, State, Any], list[Any]], t: Any, h: Any, y: State, p: Parameters
    ) -> tuple[State, State, list[Any]]:
        """The state after a step, its error, and what the volume gains."""
        system, own, (leaves, structure) = self.system, own_parameters(self.system, p), jax.tree.flatten(y)
        made = self.solver.pair.pair_step(
            lambda t, leaves: rates(t, jax.tree.unflatten(structure, leaves), own), t, h, leaves
        )
        after, error = (jax.tree.unflatten(structure, part) for part in (made.y, made.error))
        if system.reduction.leaves_constraints:
            after = system.project(t + h, after, p)
        return after, *lax.stop_gradient((error, made.gained))

    def _share_of_tolerance(self, error: list[Array], size: list[Array], after: list[Array]) -> Array:
        """Largest error of a component in units of what it may be; infinite where something is not finite."""
        floor = _SMALL * _largest(size)
        shares = [
            jnp.where(e == 0.0, 0.0, jnp.abs(e) / (self.tolerance * jnp.maximum(s, floor)))
            for e, s in zip(error, size, strict=True)
        ]
        finite = jnp.isfinite(sum(jnp.abs(x) for x in after))
        share = lax.stop_gradient(_largest(shares))
        return jnp.where(finite & jnp.isfinite(share), share, jnp.inf)

    def _change(self, share: Array, course: _Progress) -> Array:
        """Length of the next step in units of that of the one just tried."""
        order, error = self.solver.convergence_order, jnp.maximum(share, 1e-10)
        held = jnp.maximum(course.before, 1e-4) ** (_PROPORTIONAL / order)
        longer = jnp.clip(_SAFETY * error ** (-_INTEGRAL / order) * held, 0.2, _GROW)
        longer = jnp.where(course.refused, jnp.minimum(longer, 1.0), longer)
        shorter = jnp.clip(_SAFETY * error ** (-1.0 / order), _SHRINK, _SAFETY)
        return jnp.where(share <= 1.0, longer, shorter)

    def _first_step(self, size: list[Array], rate: list[Array]) -> Array:
        """A step in which no component moves by more than a share of its size that falls as errors do."""
        floor = _SMALL * _largest(size)
        fastest = _largest([jnp.abs(v) / jnp.maximum(s, floor) for s, v in zip(size, rate, strict=True)])
        h = jnp.asarray(self.tolerance) ** (1.0 / self.solver.convergence_order) / fastest
        # Of a velocity that begins at zero the size is not known yet, and what is taken for it may be far too small.
        h = jnp.maximum(h, _FIRST * self.length)
        return lax.stop_gradient(jnp.where(h > 0.0, jnp.minimum(h, self.longest), self.longest))


def adaptive_strobe(system: Flow, solver: AdaptiveMethod, steps: int, span: tuple[float, float]) -> AdaptiveStrobe:
    """The map over a span of time, as fine as so many steps of a calm period."""
    pair, tolerance, longest = _as_steps(system, solver, steps)
    return AdaptiveStrobe(system, pair, span[0], span[1] - span[0], tolerance, longest)


def adaptive_parts(system: Flow, solver: AdaptiveMethod, steps: int, ends: np.ndarray) -> AdaptiveStrobe:
    """The maps from each of some times (parts + 1,) to the next, stacked, as fine as so many steps of a calm period."""
    parts = (len(ends) - 1,)
    pair, tolerance, longest = _as_steps(system, solver, steps)
    shared = np.full(parts, tolerance), np.full(parts, longest)
    return AdaptiveStrobe(stack_leaves(system, parts), pair, ends[:-1], np.diff(ends), *shared)


def _as_steps(system: Flow, solver: AdaptiveMethod, steps: int) -> tuple[AdaptiveMethod, float, float]:
    """The pair, which is the same however fine steps are, the error of one, and the longest."""
    longest = system.period * min(_LONGEST / steps, 1.0 / solver.least)
    return solver.with_least(1), solver.tolerance(steps), longest


def count_trials(strobe: AdaptiveStrobe, state: State, p: Parameters) -> Array:
    """`AdaptiveStrobe.trials` of one lane."""
    return strobe.trials(state, p)


def _carried_along(change: Callable[[State, Any], State], y: Moving, own: Any, by_p: list[Any]) -> Moving:
    """A change of the state, and of its tangents along it."""
    return Moving(*linearise(change, y.state, own, y.tangents, by_p), y.log_volume)


def _components(y: State) -> list[Any]:
    return jax.tree.leaves(error_components(y))


def _count(y: Moving) -> int:
    return len(jax.tree.leaves(y.state))


def _largest(values: list[Any]) -> Any:
    largest = values[0]
    for value in values[1:]:
        largest = jnp.maximum(largest, value)
    return largest
