"""Stock diffrax as a contestant: `diffeqsolve` under vmap and jit, with diffrax's own Dopri8 and Tsit5.

Nothing of jaxnh is used here, and its XLA options only where `peers.py` asks for them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from sweeps.peers.particle.peers_scene import Errors, Scene, Setting, Truth, least_effort, unit

_PERIODS = 8
_MOST_STEPS = 1 << 20
_SOLVERS = {"Dopri8": diffrax.Dopri8(), "Tsit5": diffrax.Tsit5()}
_CONTROLLERS = ("PIDController", "constant steps")
# States are tuples of scalars: as one array, as in diffrax's examples, no program was the fastest at any target.
_FORMS = ("unit vector", "angle")


def _field(scene: Scene, form: str) -> Callable[[Any, Any, Any], Any]:
    a, c, d = scene.a, scene.c, scene.d

    def field(t: Any, state: Any, b: Any) -> Any:
        n = (jnp.cos(state[2]), jnp.sin(state[2])) if form == "angle" else (state[2], state[3])
        x, y = state[0], state[1]
        sine = jnp.sin(t)
        s = jnp.sqrt(c + d * sine) if d else math.sqrt(c)
        g = 1.0 + sine
        f1 = b * y - g * x * (a + x * x)
        f2 = b * x - g * y * (1.0 + a * (y * y))
        turn = (n[0] * f2 - n[1] * f1) / s
        return s * n[0], s * n[1], *((turn,) if form == "angle" else (-n[1] * turn, n[0] * turn))

    return field


class StockContestant:
    """Both solvers on a flow, adaptive or with constant steps, in every form of the equations; rtol = atol.

    Attributes:
        forms: of the equations.
        suffix: of the rows' names.
    """

    forms: Sequence[str]
    suffix = ""

    def __init__(self, scene: Truth) -> None:
        jax.config.update("jax_enable_x64", True)
        self.scene = scene
        self._programs: dict[tuple[object, ...], Any] = {}

    def field(self, form: str) -> Callable[[Any, Any, Any], Any]:
        """The equations, a function of (t, state, parameter), states being tuples."""
        raise NotImplementedError

    def starts(self, form: str, lanes: np.ndarray) -> np.ndarray:
        """Start states (lanes, variables) in a form."""
        raise NotImplementedError

    def compared(self, form: str, ends: np.ndarray) -> np.ndarray:
        """Return what is compared of states (lanes, variables): as the scene's `ends`."""
        raise NotImplementedError

    def tune(
        self,
        target: float,
        hints: Sequence[Setting] = (),
        only: bool = False,
        wanted: Callable[[tuple[str, str, str]], bool] = lambda key: True,
    ) -> list[Setting]:
        """Tune as every contestant does; of `wanted` names of a solver, a controller and a form alone."""
        settings = []
        efforts = {hint.key: hint.knob for hint in hints}
        for solver, controller in itertools.product(_SOLVERS, _CONTROLLERS):
            adaptive = controller == "PIDController"
            guess = 30 / target if adaptive else (1e-8 / target) ** (0.125 if solver == "Dopri8" else 0.2) * 400
            for form in self.forms:
                key = (solver, controller, form)
                if not wanted(key) or (only and key not in {hint.key for hint in hints}):
                    continue
                found = least_effort(
                    lambda effort, key=key: self._measured(key, effort),
                    target,
                    efforts.get(key, guess),
                    factor=10 if adaptive else 1.5,
                    most=1e14 if adaptive else _MOST_STEPS,
                    whole=not adaptive,
                )
                if found is None:
                    continue
                effort, errors = found
                settings.append(
                    Setting(
                        peer=f"diffrax {solver}{self.suffix}",
                        form=f"{form}, {controller}",
                        knob=effort,
                        label=f"rtol = atol = {1 / effort:.1e}" if adaptive else f"{effort:.0f} steps a period",
                        errors=errors,
                        key=key,
                    )
                )
        return settings

    def program(self, setting: Setting, count: int | None = None) -> Callable[[], int]:
        """Return the program, as for every contestant; with a number of lanes."""
        lanes = self.scene.timed(count)

        def run() -> int:
            self._solve(setting.key, lanes, _PERIODS, setting.knob)
            return len(lanes) * _PERIODS

        return run

    def _measured(self, key: tuple[Any, ...], effort: float) -> Errors:
        # In two halves, so that one compiled program both measures and runs.
        halves = np.split(np.arange(len(self.scene.b)), 2)
        ends = np.concatenate([self._solve(key, half, 1, effort) for half in halves])
        return self.scene.errors(self.compared(key[2], ends))

    def _solve(self, key: tuple[Any, ...], lanes: np.ndarray, periods: int, effort: float) -> np.ndarray:
        """States (lanes, variables) some periods later."""
        start = self.starts(key[2], lanes)
        ends = self._program(key)(tuple(start.T), self.scene.b[lanes], effort, periods * self.scene.period)
        return np.stack(ends, axis=-1)

    def _program(self, key: tuple[Any, ...]) -> Any:
        if key in self._programs:
            return self._programs[key]
        solver, controller, form = key
        adaptive = controller == "PIDController"
        period = self.scene.period
        term = diffrax.ODETerm(self.field(form))

        def solve(state: Any, b: Any, effort: Any, t1: Any) -> Any:
            solution = diffrax.diffeqsolve(
                term,
                _SOLVERS[solver],
                t0=0.0,
                t1=t1,
                dt0=None if adaptive else period / effort,
                y0=state,
                args=b,
                saveat=diffrax.SaveAt(t1=True),
                stepsize_controller=diffrax.PIDController(rtol=1 / effort, atol=1 / effort)
                if adaptive
                else diffrax.ConstantStepSize(),
                max_steps=_MOST_STEPS,
                throw=False,
            )
            return jax.tree.map(lambda leaf: leaf[0], solution.ys)

        self._programs[key] = jax.jit(jax.vmap(solve, in_axes=(0, 0, None, None)))
        return self._programs[key]


class Contestant(StockContestant):
    """The particle, its velocity as a unit vector or an angle."""

    scene: Scene
    forms = _FORMS

    def field(self, form: str) -> Callable[[Any, Any, Any], Any]:
        return _field(self.scene, form)

    def starts(self, form: str, lanes: np.ndarray) -> np.ndarray:
        return (self.scene.states if form == "angle" else self.scene.unit_states)[lanes]

    def compared(self, form: str, ends: np.ndarray) -> np.ndarray:
        return unit(ends) if form == "angle" else ends
