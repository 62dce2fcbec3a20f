"""The map over a stretch of time by an embedded pair, each lane with steps of its own.

A lane takes the steps that its motion needs, while finished ones wait; the last step ends at the end. Tangents and
volume take the very same steps: how long these are is not differentiated. Along the stages of an explicit pair they go
with the state, by the field's linearisation at each; a Rosenbrock step is linearised as a whole.
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
from jaxnh.maps.general_flow import (
    Moving,
    first_of_stack,
    linearise,
    linearised_in_loop,
    own_parameters,
    rates_along,
    restored,
    stack_leaves,
    stacked_tangents,
    stages_in_loop,
    unstacked_tangents,
)
from jaxnh.maps.jacobians import equations_with_tangents, has_cheap_jacobian
from jaxnh.maps.protocol import Pushforward, ReturnMap, Tangent
from jaxnh.maps.time_tables import time_split
from jaxnh.solvers.adaptive import AdaptiveMethod
from jaxnh.solvers.rosenbrock import Rosenbrock
from jaxnh.solvers.runge_kutta import WrittenOutRungeKutta
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.state import State, error_components, masked
from jaxnh.systems.status import NOT_FINITE, OUT_OF_STEPS
from jaxnh.systems.tracing import traced_once

_MOST_TRIALS = 1 << 17  # steps that are tried in a map: a lane that needs more has run out of them
_EXPLICIT = 8  # times as many explicit ones, which are cheaper, and are short where a motion passes a singularity
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


class _TangentTransport(NamedTuple):
    """Transport of tangents along with a state.

    Attributes:
        p: parameters of the lane.
        own: those that lanes may have of their own.
        by_p: of each tangent its derivative in these, or None; of a stack that of all.
        derivative: `linearise`, or as a stack has it.
        stacked: whether all tangents are in one.
        rolls: whether the stages of a step are a loop.
    """

    p: Parameters
    own: Any
    by_p: Any
    derivative: Callable[..., tuple[Any, Any]]
    stacked: bool
    rolls: bool

    def change(self, function: Callable[[State, Parameters], State], y: Moving) -> Moving:
        """A change of the state, and of its tangents along it."""

        def of_state(z: State, own: Any) -> State:
            return function(z, {**self.p, **own})

        return Moving(*self.derivative(of_state, y.state, self.own, y.tangents, self.by_p), y.log_volume)


_Step = Callable[[Any, Any, Moving], tuple[Moving, State]]
"""A step from a time, of a length: a moving state to the one after it, and the estimate of its error."""


class AdaptiveStrobe(ReturnMap):
    """P over a stretch of time.

    Errors of a step are relative to the largest modulus of each component in the stretch so far. A lane fails, its
    state then not a number, where its motion is not finite or needs shorter steps than time can tell apart
    (`not_finite`), and where it needs more steps than there may be (`out_of_steps`).

    Attributes:
        system: the flow.
        solver: the pair.
        begin: time at the beginning.
        length: of time, negative back in time.
        tolerance: error of a step, relative to the size of the motion.
        longest: longest step.
        backward: whether it goes back in time.
    """

    system: Flow
    solver: AdaptiveMethod = eqx.field(static=True)
    begin: ArrayLike
    length: ArrayLike
    tolerance: ArrayLike
    longest: ArrayLike
    backward: bool = eqx.field(static=True, default=False)

    @property
    def _duration(self) -> Any:
        length: Any = self.length
        return -length if self.backward else length

    def _instant(self, since: Any) -> Any:
        return self.begin - since if self.backward else self.begin + since

    @property
    def trip_counts(self) -> tuple[float, ...]:
        """Steps of a calm motion, a stiff one has more; and those of the loop over stages, where there is one."""
        steps = max(1.0, float(np.mean(_LONGEST * np.asarray(self._duration) / np.asarray(self.longest))))
        rolls = first_of_stack(self, np.ndim(self.length))._rolls(0)
        return (steps, float(self.solver.stages)) if rolls else (steps,)

    def _rolls(self, tangents: int) -> bool:
        explicit = isinstance(self.solver.pair, WrittenOutRungeKutta)
        return explicit and stages_in_loop(self.solver, lambda: equations_with_tangents(self.system, tangents))

    @property
    def _most_trials(self) -> int:
        return _MOST_TRIALS if isinstance(self.solver.pair, Rosenbrock) else _EXPLICIT * _MOST_TRIALS

    def rescaled_time(self, factor: ArrayLike) -> AdaptiveStrobe:
        return replace(self, length=self.length * factor)

    def __call__(self, state: State, p: Parameters) -> State:
        return self.pushforward(state, p, (), volume=False).state

    def pushforward(
        self, state: State, p: Parameters, tangents: tuple[Tangent, ...], volume: bool = True
    ) -> Pushforward:
        system, zero = self.system, jnp.zeros_like(jax.tree.leaves(state)[0])
        along, moved = self._along(p, tangents)
        placed, ended = self._marched(Moving(state, moved, zero if volume else None), along)
        moving = ended.moving
        if not system.reduction.leaves_constraints:
            end = self.begin + self.length
            moving = along.change(lambda z, p: restored(system, end, z, placed, p), moving)
        why = jnp.where(ended.trials < self._most_trials, NOT_FINITE, OUT_OF_STEPS)
        arrived = masked(moving.state, ended.t >= self._duration, why)
        each = unstacked_tangents(moving.tangents, len(tangents)) if along.stacked else moving.tangents
        pushed = tuple(Tangent(dz, t.p) for dz, t in zip(each, tangents, strict=True))
        return Pushforward(arrived, pushed, moving.log_volume if volume else zero)

    def trials(self, state: State, p: Parameters) -> Array:
        """Number of steps that the motion from a state tries, the most there may be where it does not come through."""
        _, ended = self._marched(Moving(state), self._along(p, ())[0])
        return jnp.where(ended.t >= self._duration, ended.trials, self._most_trials)

    def _along(self, p: Parameters, tangents: tuple[Tangent, ...]) -> tuple[_TangentTransport, Any]:
        """Return the transport of tangents, and the tangents."""
        own, rolls = own_parameters(self.system, p), self._rolls(len(tangents))
        by_p: Any = [{**jax.tree.map(jnp.zeros_like, own), **t.p} if t.p else None for t in tangents]
        moved: Any = tuple(t.state for t in tangents)
        in_stack = linearised_in_loop(self.system, len(tangents)) if rolls else None
        if in_stack is not None:
            moved, by_p = stacked_tangents(moved, own, by_p)
        return _TangentTransport(p, own, by_p, in_stack or linearise, in_stack is not None, rolls), moved

    def _marched(self, start: Moving, along: _TangentTransport) -> tuple[State, _Progress]:
        """The state on its constraints at the beginning, and the lane at its end."""
        system, reduction = self.system, self.system.reduction
        pair, how = self.solver.pair, {"along": along, "volume": start.log_volume is not None}
        step = self._implicit(pair, **how) if isinstance(pair, Rosenbrock) else self._explicit(pair, **how)
        duration = self._duration

        def advance(course: _Progress) -> _Progress:
            left = duration - course.t
            last = 1.01 * course.h >= left
            h = lax.stop_gradient(jnp.where(last, left, course.h))
            ahead, error = step(self._instant(course.t), -h if self.backward else h, course.moving)
            after = _components(ahead.state)
            size = [jnp.maximum(s, jnp.abs(x)) for s, x in zip(course.size, after, strict=True)]
            share = self._share_of_tolerance(_components(error), size, after)
            good = share <= 1.0
            return _Progress(
                jax.tree.map(lambda new, old: jnp.where(good, new, old), ahead, course.moving),
                [jnp.where(good, new, old) for new, old in zip(size, course.size, strict=True)],
                jnp.where(good, jnp.where(last, duration, course.t + h), course.t),
                jnp.minimum(h * self._change(share, course), self.longest),
                jnp.where(good, share, course.before),
                ~good,
                course.trials + 1,
            )

        def unfinished(course: _Progress) -> Array:
            going = (course.h > _SHORTEST * duration) & (course.trials < self._most_trials)
            return (course.t < duration) & going

        first = jax.tree.leaves(start.state)[0]
        zero = jnp.zeros_like(first)
        if not reduction.leaves_constraints:
            start = along.change(lambda z, p: system.project(self.begin, z, p), start)
        placed, reduce = start.state, reduction.reduce
        moved = reduce(start.tangents) if along.stacked else tuple(map(reduce, start.tangents))
        start = Moving(reduce(placed), moved, start.log_volume)
        size = [jnp.abs(lax.stop_gradient(x)) for x in _components(start.state)]
        h = self._first_step(size, _components(self._rate(self.begin, start.state, along.own)))
        course = _Progress(start, size, zero, h, zero + 1.0, zero > 1.0, jnp.int32(0))
        return placed, lax.while_loop(unfinished, advance, as_batched(course, first))

    def _rate(self, t: Any, y: State, own: Any) -> State:
        split = time_split(self.system)
        return split.rest(split.table(t, self.system), self.system, (y, own))

    def _explicit(self, pair: WrittenOutRungeKutta, along: _TangentTransport, *, volume: bool) -> _Step:
        """Steps whose tangents go along stage by stage."""
        by_matrix = not (along.rolls or any(along.by_p)) and has_cheap_jacobian(self.system, len(along.by_p))
        derivative = None if by_matrix else along.derivative

        @traced_once
        def rates(system: Flow, t: Any, y: Moving, own: Any, by_p: Any) -> Moving:
            values = time_split(system).table(t, system)
            return rates_along(values, system, own, y, by_p, derivative=derivative, volume=volume)

        def step(t: Any, h: Any, y: Moving) -> tuple[Moving, State]:
            system, c = self.system, jnp.asarray(pair.c, h.dtype)

            def field(stage: Any, y: Moving) -> Moving:
                return rates(system, t + c[stage] * h, y, along.own, along.by_p)

            after, error = (pair.rolled_pair if along.rolls else pair.written_pair)(field, h, y)
            if system.reduction.leaves_constraints:
                after = along.change(lambda z, p: system.project(t + h, z, p), after)
            return after, lax.stop_gradient(error.state)

        return step

    def _implicit(self, pair: Rosenbrock, along: _TangentTransport, *, volume: bool) -> _Step:
        """Steps that are linearised as a whole."""
        system = self.system

        def rates(t: Any, y: State, own: Any) -> list[Any]:
            """Rates of the state's numbers, and of the logarithm of a volume where that is asked for."""
            divergence = [system.reduction.divergence_of(lambda z: self._rate(t, z, own), y)] if volume else []
            return [*jax.tree.leaves(self._rate(t, y, own)), *divergence]

        def of_state(t: Any, h: Any, y: State, p: Parameters) -> tuple[State, State, list[Any]]:
            """The state after a step, its error, and what the volume gains."""
            own, (leaves, structure) = own_parameters(system, p), jax.tree.flatten(y)
            made = pair.pair_step(lambda t, z: rates(t, jax.tree.unflatten(structure, z), own), t, h, leaves)
            after, error = (jax.tree.unflatten(structure, part) for part in (made.y, made.error))
            if system.reduction.leaves_constraints:
                after = system.project(t + h, after, p)
            return after, *lax.stop_gradient((error, made.gained))

        def step(t: Any, h: Any, y: Moving) -> tuple[Moving, State]:
            (after, error, gained), moved = linearise(
                lambda z, own: of_state(t, h, z, {**along.p, **own}), y.state, along.own, y.tangents, along.by_p
            )
            log_volume = y.log_volume + gained[0] if volume else None
            return Moving(after, tuple(dz for dz, _, _ in moved), log_volume), error

        return step

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
        h = jnp.maximum(h, _FIRST * self._duration)
        return lax.stop_gradient(jnp.where(h > 0.0, jnp.minimum(h, self.longest), self.longest))


def adaptive_strobe(
    system: Flow, solver: AdaptiveMethod, steps: int, span: tuple[float, float], *, backward: bool = False
) -> AdaptiveStrobe:
    """The map over a span of time, as fine as so many steps of a calm period."""
    pair, tolerance, longest = _as_steps(system, solver, steps)
    return AdaptiveStrobe(system, pair, span[0], span[1] - span[0], tolerance, longest, backward)


def adaptive_parts(system: Flow, solver: AdaptiveMethod, steps: int, ends: np.ndarray) -> AdaptiveStrobe:
    """The maps from each of some times (parts + 1,) to the next, stacked, as fine as so many steps of a calm period.

    Times that fall are those of maps back in time.
    """
    parts = (len(ends) - 1,)
    pair, tolerance, longest = _as_steps(system, solver, steps)
    shared = np.full(parts, tolerance), np.full(parts, longest)
    return AdaptiveStrobe(
        stack_leaves(system, parts), pair, ends[:-1], np.diff(ends), *shared, bool(ends[-1] < ends[0])
    )


def _as_steps(system: Flow, solver: AdaptiveMethod, steps: int) -> tuple[AdaptiveMethod, float, float]:
    """The pair, which is the same however fine steps are, the error of one, and the longest."""
    longest = system.period * min(_LONGEST / steps, 1.0 / solver.least)
    return solver.with_least(1), solver.tolerance(steps), longest


def count_trials(strobe: AdaptiveStrobe, state: State, p: Parameters) -> Array:
    """`AdaptiveStrobe.trials` of one lane."""
    return strobe.trials(state, p)


def _components(y: State) -> list[Any]:
    return jax.tree.leaves(error_components(y))


def _largest(values: list[Any]) -> Any:
    largest = values[0]
    for value in values[1:]:
        largest = jnp.maximum(largest, value)
    return largest
