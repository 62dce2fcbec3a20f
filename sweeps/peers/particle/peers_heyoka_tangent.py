"""heyoka's tangent flow: variational equations in its batch integrator, and how it is driven at the least cost.

The variational equations are written by heyoka's own derivatives, so that the clock equations carry no tangents: two
thirds of the equations that `var_ode_sys` makes of them would stay zero. Every few lanes have an integrator of their
own that keeps their state, so that Python makes one call a batch and orthonormalisation; the Gram–Schmidt itself is a
function compiled by heyoka, over all lanes at once.
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import heyoka as hy
import numpy as np

from sweeps.peers.particle.peers_heyoka import (
    CLOCK,
    MOST_ORDER,
    REAL,
    TOLERANCE,
    Batches,
    equations,
    tried_options,
    with_clock,
)
from sweeps.peers.particle.peers_scene import Errors, Setting, TangentScene, TangentTruth, Truth

_PERIODS = 8
_CLOCKS = ("time", CLOCK)
_FORMS: tuple[tuple[int, tuple[str, ...]], ...] = (
    (1, ()),
    (1, ("fast_math",)),
    (1, ("fast_math", "force_avx512")),
    (2, ("fast_math",)),
    (2, ("fast_math", "compact_mode")),
    (4, ("fast_math", "compact_mode")),
)
"""Batch sizes, in recommended SIMD sizes, and options of the compiler; large ones outside compact mode take minutes."""
_EQUAL_TIMES, _WHOLE_STEPS = "at equal times", "after whole steps"
"""Times of orthonormalisation: a step is cut short there; or every so many steps, and none is."""


def tangent_equations(motion: Sequence[tuple[Any, Any]], d: int) -> list[tuple[Any, Any]]:
    """The first d of some equations of motion, their d² variational equations, and the clock's, which are the rest."""
    states, rates = zip(*motion[:d], strict=True)
    tangents = [[hy.expression(f"d{state}_{i}") for state in states] for i in range(d)]
    variations = [
        (column[i], hy.sum([hy.diff(rate, state) * v for state, v in zip(states, column, strict=True)]))
        for column in tangents
        for i, rate in enumerate(rates)
    ]
    return [*motion[:d], *variations, *motion[d:]]


def true_derivatives(scene: Truth, motion: Sequence[tuple[Any, Any]]) -> np.ndarray:
    """(lanes, d, d) derivatives of one period's map by a Taylor integration at 1e-18 in long double.

    Args:
        motion: equations of motion with heyoka's own time.
    """
    d = len(motion)
    ta = hy.taylor_adaptive(
        tangent_equations(motion, d),
        np.zeros(d + d * d, dtype=REAL),
        pars=np.zeros(1, dtype=REAL),
        tol=REAL(TOLERANCE),
        fp_type=REAL if REAL is not np.float64 else float,
        compact_mode=True,
    )
    found = []
    for lane in scene.timed():
        ta.pars[0] = REAL(scene.b[lane])
        ta.state[:d], ta.state[d:] = scene.states[lane], np.eye(d).ravel()
        ta.time = REAL(0)
        outcome = ta.propagate_until(REAL(scene.period))[0]
        if outcome != hy.taylor_outcome.time_limit:
            raise ArithmeticError(f"the reference stopped at t = {ta.time}, b = {scene.b[lane]}: {outcome}")
        found.append(ta.state[d:].reshape(d, d).T.copy())
    return np.array(found)


def gram_schmidt(d: int) -> Any:
    """Compiled: the d² components of d tangents to those of orthonormal ones and the logarithms of lengths."""
    v = [hy.expression(f"v{i}") for i in range(d * d)]
    basis: list[list[Any]] = []
    logs = []
    for k in range(d):
        vector = v[d * k : d * k + d]
        for base in basis:
            overlap = hy.sum([p * q for p, q in zip(vector, base, strict=True)])
            vector = [p - overlap * q for p, q in zip(vector, base, strict=True)]
        square = hy.sum([p * p for p in vector])
        basis.append([p * square**-0.5 for p in vector])
        logs.append(0.5 * hy.log(square))
    return hy.cfunc([p for vector in basis for p in vector] + logs, v)


class _Batch(NamedTuple):
    """An integrator, a view of the tangents in its state, and the lanes that it has."""

    integrator: Any
    tangents: np.ndarray
    lanes: slice


class TangentContestant:
    """Clock as time or as equations, batch size, options of the compiler, and when tangents are orthonormalised.

    How often they are, a period, is what jaxnh does: the first hint says it.

    Attributes:
        clocks: forms of the clock.
        d: number of components of the state, and of tangents.
        periods: that one call of a timed program integrates over.
    """

    clocks: Sequence[str] = _CLOCKS
    d: int
    periods = _PERIODS

    def __init__(self, scene: TangentTruth) -> None:
        self.scene = scene
        self._batches = Batches(lambda clock: tangent_equations(self.motion(clock), self.d))
        self._gram_schmidt = gram_schmidt(self.d)

    def motion(self, clock: str) -> list[tuple[Any, Any]]:
        """Equations of motion, and after the first d those of the clock; parameter 0 is the lane's."""
        raise NotImplementedError

    def tune(self, target: float, hints: Sequence[Setting], only: bool = False) -> list[Setting]:
        simd, parts = hy.recommended_simd_size(), hints[0].parts
        settings = []
        for clock, (multiple, options) in itertools.product(self.clocks, _FORMS):
            if options not in tried_options([options]):
                continue
            key = (clock, multiple * simd, options)
            order = max(3, math.ceil(1 - 0.5 * math.log(target)) - 1)
            while (errors := self._measured(*key, order)).max > target:
                order += 1
                if order > MOST_ORDER:
                    raise ArithmeticError(f"heyoka reaches no error of {target:g} of the derivatives")
            steps = self._steps_a_period(*key, order)
            every = max(1, round(steps / parts))
            settings += [
                Setting(
                    peer="heyoka batch",
                    form=", ".join(
                        (clock, f"batch of {key[1]}", *options, f"{often:.3g} orthonormalisations a period, {when}")
                    ),
                    knob=order,
                    label=f"order {order} (tol {math.exp(2 - 2 * order):.1e})",
                    errors=errors,
                    key=(*key, limit),
                    parts=parts,
                )
                for when, limit, often in ((_EQUAL_TIMES, 0, parts), (_WHOLE_STEPS, every, steps / every))
            ]
        return settings

    def program(self, setting: Setting, idle: bool = False) -> Callable[[], float]:
        """Return the program, as for every contestant; idle with the same calls and no time to integrate over."""
        *key, every = setting.key
        fleet = self.fleet((*key, int(setting.knob)))

        def run() -> float:
            self.grown(fleet, setting.parts, 0 if idle else every, 0.0 if idle else self.scene.period, self.periods)
            return len(self.scene.timed()) * self.periods if idle or not every else self._times(fleet).sum()

        return run

    def grown(self, fleet: list[_Batch], parts: int, every: int, period: float, periods: int) -> np.ndarray:
        """(d, timed lanes) logarithms of growth from the timed states on.

        Tangents are orthonormalised `parts` times a period: at equal times, or where `every` is not 0, after so many
        steps. A period of 0 makes all calls and integrates over nothing.
        """
        lanes = self.scene.timed()
        states, b, count = self.scene.states[lanes], self.scene.b[lanes], len(lanes)
        d, square = self.d, self.d**2
        tangents, out, logs = np.empty((square, count)), np.empty((square + d, count)), np.zeros((d, count))
        for ta, _, part in fleet:
            self.reset(ta, states[part], b[part])
        limits = {"max_steps": every} if every else {}
        for k in range(1, periods * parts + 1):
            end = 1e9 if every else k * (period / parts)
            for ta, view, part in fleet:
                ta.propagate_until(end, **limits)
                tangents[:, part] = view
            self._gram_schmidt(inputs=tangents, outputs=out)
            np.add(logs, out[square:], out=logs)
            for _, view, part in fleet:
                view[:] = out[:square, part]
        return logs

    def _times(self, fleet: list[_Batch]) -> np.ndarray:
        """(timed lanes,) periods that they have come."""
        return np.concatenate([ta.time for ta, *_ in fleet]) / self.scene.period

    def fleet(self, key: tuple[Any, ...]) -> list[_Batch]:
        """Integrators of all timed lanes."""
        clock, batch, options, order = key
        one, count = self._batches.integrator((clock,), batch, options, order), len(self.scene.timed())
        fleet = []
        for at in range(0, count, batch):
            ta = copy.deepcopy(one)
            fleet.append(_Batch(ta, ta.state[self.d : self.d + self.d**2], slice(at, at + batch)))
        return fleet

    def reset(self, ta: Any, states: np.ndarray, b: np.ndarray) -> None:
        """Lanes at their states at t = 0, their tangents along the axes."""
        ta.set_time(0.0)
        ta.pars[0] = b
        d, end = self.d, self.d + self.d**2
        ta.state[:d], ta.state[d:end] = states.T, np.eye(d).reshape(-1, 1)
        if len(ta.state) > end:
            ta.state[end], ta.state[end + 1] = 0.0, 1.0

    def _steps_a_period(self, *key: Any) -> float:
        """Steps of a period, the mean over batches of the first few."""
        taken = []
        for ta, _, part in self.fleet(key)[:8]:
            lanes = self.scene.timed()[part]
            self.reset(ta, self.scene.states[lanes], self.scene.b[lanes])
            ta.propagate_until(self.scene.period)
            taken += [steps for *_, steps in ta.propagate_res]
        return float(np.mean(taken))

    def _measured(self, *key: Any) -> Errors:
        clock, batch, options, order = key
        lanes = self.scene.timed()
        d = self.d
        start = np.column_stack([self.scene.states[lanes], np.tile(np.eye(d).ravel(), (len(lanes), 1))])
        start = with_clock(start) if clock == CLOCK else start
        times = (0.0, self.scene.period)
        ends = self._batches(start, self.scene.b[lanes], times, (clock,), batch, options, order)
        return self.scene.derivative_errors(np.moveaxis(ends[:, d : d + d * d].reshape(-1, d, d), 1, 2))


class Contestant(TangentContestant):
    """The particle, its velocity as an angle."""

    scene: TangentScene
    d = 3

    def motion(self, clock: str) -> list[tuple[Any, Any]]:
        return equations(self.scene.a, self.scene.c, self.scene.d, "angle", clock)
