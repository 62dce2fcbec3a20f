"""scipy's solve_ivp with DOP853 as a contestant: one lane after another, a right-hand side in plain Python floats."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.integrate import solve_ivp

from sweeps.peers.particle.peers_scene import Errors, Scene, Setting, least_effort, unit

_PERIODS = 2
_TIMED_LANES = 8  # spread over b; a lane costs the same whatever their number


class Contestant:
    """DOP853 in the angle form, rtol = atol."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    def tune(self, target: float, hints: Sequence[Setting] = (), only: bool = False) -> list[Setting]:
        everybody = range(len(self.scene.b))

        def measure(effort: float) -> Errors:
            return self.scene.errors(unit(self._solve(everybody, 1, 1 / effort)))

        found = least_effort(measure, target, 30 / target, factor=10, most=1e14)
        if found is None:
            return []
        tolerance = 1 / found[0]
        return [
            Setting("scipy DOP853", "angle", tolerance, f"rtol = atol = {tolerance:.1e}", found[1]),
        ]

    def program(self, setting: Setting) -> Callable[[], int]:
        timed = self.scene.timed()
        lanes = timed[np.linspace(0, len(timed) - 1, _TIMED_LANES).round().astype(int)].tolist()

        def run() -> int:
            self._solve(lanes, _PERIODS, setting.knob)
            return len(lanes) * _PERIODS

        return run

    def _solve(self, lanes: Sequence[int], periods: int, tolerance: float) -> np.ndarray:
        """States (lanes, 3) some periods later."""
        a, c, d = self.scene.a, self.scene.c, self.scene.d
        sin, cos, sqrt = math.sin, math.cos, math.sqrt

        def field(t: float, state: np.ndarray, b: float) -> tuple[float, float, float]:
            x, y, theta = state.tolist()
            n1, n2 = cos(theta), sin(theta)
            g = 1.0 + sin(t)
            s = sqrt(c + d * sin(t)) if d else sqrt(c)
            f1 = b * y - g * x * (a + x * x)
            f2 = b * x - g * y * (1.0 + a * y * y)
            return s * n1, s * n2, (n1 * f2 - n2 * f1) / s

        ends = []
        for lane in lanes:
            solution = solve_ivp(
                field,
                (0.0, periods * self.scene.period),
                self.scene.states[lane],
                method="DOP853",
                t_eval=(periods * self.scene.period,),
                args=(float(self.scene.b[lane]),),
                rtol=tolerance,
                atol=tolerance,
            )
            ends.append(solution.y[:, -1])
        return np.array(ends)
