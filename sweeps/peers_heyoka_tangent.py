"""heyoka's tangent flow: variational equations in its batch integrator, orthonormalised by NumPy over all lanes.

The variational equations are written by heyoka's own derivatives, so that the clock equations carry no tangents: two
thirds of the equations that `var_ode_sys` makes of them would stay zero.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import heyoka as hy
import numpy as np

from sweeps.peers_heyoka import MOST_ORDER, REAL, TOLERANCE, Batches, equations
from sweeps.peers_scene import Errors, Scene, Setting, TangentScene

_PERIODS = 4
_CLOCKS = ("time", "clock equations")
_BATCHES = (1, 2)  # in recommended SIMD sizes
_OPTIONS: tuple[tuple[str, ...], ...] = ((), ("fast_math",))
_PARTS = (8, 16)  # orthonormalisations a period; with four the third exponent is lost in rounding


def tangent_equations(scene: Scene, clock: str) -> list[tuple[Any, Any]]:
    """Equations of motion, nine variational equations of (x, y, θ), and the clock's."""
    motion = equations(scene.a, scene.c, scene.d, "angle", clock)
    states, rates = zip(*motion[:3], strict=True)
    tangents = [hy.make_vars(*(f"d{state}_{i}" for state in states)) for i in range(3)]
    variations = [
        (column[i], hy.sum([hy.diff(rate, state) * v for state, v in zip(states, column, strict=True)]))
        for column in tangents
        for i, rate in enumerate(rates)
    ]
    return [*motion[:3], *variations, *motion[3:]]


def true_derivatives(scene: Scene) -> np.ndarray:
    """(lanes, 3, 3) derivatives of one period's map by a Taylor integration at 1e-18 in long double."""
    ta = hy.taylor_adaptive(
        tangent_equations(scene, "time"),
        np.zeros(12, dtype=REAL),
        pars=np.zeros(1, dtype=REAL),
        tol=REAL(TOLERANCE),
        fp_type=REAL if REAL is not np.float64 else float,
        compact_mode=True,
    )
    found = []
    for lane in scene.timed():
        ta.pars[0] = REAL(scene.b[lane])
        ta.state[:3], ta.state[3:] = scene.states[lane], np.eye(3).ravel()
        ta.time = REAL(0)
        outcome = ta.propagate_until(8 * np.arctan(REAL(1)))[0]
        if outcome != hy.taylor_outcome.time_limit:
            raise ArithmeticError(f"the reference stopped at t = {ta.time}, b = {scene.b[lane]}: {outcome}")
        found.append(ta.state[3:].reshape(3, 3).T.copy())
    return np.array(found)


class Contestant:
    """Clock as time or as equations, batch size, fast_math, and how often the tangents are orthonormalised."""

    def __init__(self, scene: TangentScene) -> None:
        self.scene = scene
        self._batches = Batches(lambda clock: tangent_equations(scene, clock))

    def tune(self, target: float, hints: Sequence[Setting] = ()) -> list[Setting]:
        simd = hy.recommended_simd_size()
        settings = []
        for clock, multiple, options in itertools.product(_CLOCKS, _BATCHES, _OPTIONS):
            key = (clock, multiple * simd, options)
            order = max(3, math.ceil(1 - 0.5 * math.log(target)) - 1)
            while (errors := self._measured(*key, order)).max > target:
                order += 1
                if order > MOST_ORDER:
                    raise ArithmeticError(f"heyoka reaches no error of {target:g} of the derivatives")
            settings += [
                Setting(
                    peer="heyoka batch",
                    form=", ".join((clock, f"batch of {key[1]}", *options, f"{parts} orthonormalisations a period")),
                    knob=order,
                    label=f"order {order} (tol {math.exp(2 - 2 * order):.1e})",
                    errors=errors,
                    key=(*key, parts),
                )
                for parts in _PARTS
            ]
        return settings

    def program(self, setting: Setting) -> Callable[[], int]:
        lanes = self.scene.timed()
        *key, parts = setting.key
        times = np.linspace(0.0, self.scene.period, int(str(parts)) + 1)

        def run() -> int:
            state, tangents = self.scene.states[lanes], _identity(len(lanes))
            logs = np.zeros((3, len(lanes)))
            for _ in range(_PERIODS):
                for begin, end in itertools.pairwise(times):
                    state, tangents = self._propagate(state, tangents, begin, end, (*key, int(setting.knob)))
                    tangents, grown = _gram_schmidt(tangents)
                    logs += grown
            return len(lanes) * _PERIODS

        return run

    def _measured(self, *key: Any) -> Errors:
        lanes = self.scene.timed()
        start = self.scene.states[lanes], _identity(len(lanes))
        _, tangents = self._propagate(*start, 0.0, self.scene.period, key)
        return self.scene.derivative_errors(np.moveaxis(tangents, 1, 2))

    def _propagate(
        self, state: np.ndarray, tangents: np.ndarray, begin: float, end: float, key: tuple[Any, ...]
    ) -> tuple[np.ndarray, np.ndarray]:
        """States (lanes, 3) and tangents (lanes, tangent, 3) of the timed lanes from one time to another."""
        clock = key[0]
        columns = [state, tangents.reshape(len(state), 9)]
        if clock == "clock equations":
            columns.append(np.tile([math.sin(begin), math.cos(begin)], (len(state), 1)))
        b = self.scene.b[self.scene.timed()]
        ends = self._batches(np.column_stack(columns), b, (begin, end), (clock,), *key[1:])
        return ends[:, :3], ends[:, 3:12].reshape(-1, 3, 3)


def _identity(lanes: int) -> np.ndarray:
    return np.tile(np.eye(3), (lanes, 1, 1))


def _gram_schmidt(tangents: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal tangents (lanes, tangent, 3) and the logarithms (tangent, lanes) of the lengths they had."""
    components = np.ascontiguousarray(np.moveaxis(tangents, 0, 2))
    logs = np.empty((3, len(tangents)))
    for k, vector in enumerate(components):
        for base in components[:k]:
            vector -= (vector * base).sum(axis=0) * base
        length = np.sqrt((vector * vector).sum(axis=0))
        vector /= length
        logs[k] = np.log(length)
    return np.moveaxis(components, 2, 0), logs
