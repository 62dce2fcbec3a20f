"""pynamicalsys on the flows that it has as models of its own: lane after lane, by its Runge–Kutta method of order four.

Its steps are of one length, and every one of them ends with an orthonormalisation. What a number of steps errs by is
that method's alone, so that it is measured by one of the same coefficients.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sweeps.peers.flows.peers_flow_cases import FlowScene
from sweeps.peers.particle.peers_scene import Errors, Setting, least_effort

MODELS: dict[str, tuple[str, Callable[[float], list[float]]]] = {
    "duffing": ("duffing", lambda gamma: [0.2, 1.0, 1.0, gamma, 1.0]),
    "lorenz": ("lorenz system", lambda rho: [10.0, rho, 8.0 / 3.0]),
    "roessler": ("rossler system", lambda c: [0.2, 0.2, c]),
}
"""Its name of a model, and its parameters, by the flow's name."""
_LANES, _PERIODS, _FIRST_GUESS, _MOST_STEPS = 8, 8, 400.0, 1_000_000.0


class Contestant:
    """A few lanes, spread over all; none where it has no such model."""

    def __init__(self, scene: FlowScene) -> None:
        jax.config.update("jax_enable_x64", True)
        self.scene = scene
        self._derivatives = jax.jit(jax.vmap(self._derivative, in_axes=(0, 0, None)))

    def tune(self, target: float, hints: Sequence[Setting], only: bool = False) -> list[Setting]:
        if self.scene.case.name not in MODELS:
            return []
        found = least_effort(self._errors, target, _FIRST_GUESS, factor=3.0, most=_MOST_STEPS, whole=True)
        if found is None:
            return []
        label = f"{found[0]:.0f} steps, {found[0]:.0f} orthonormalisations"
        return [Setting("pynamicalsys", "RK4", found[0], label, found[1], parts=int(found[0]))]

    def program(self, setting: Setting) -> Callable[[], int]:
        """The spectra of lanes from the timed states on."""
        model, parameters = MODELS[self.scene.case.name]
        system = importlib.import_module("pynamicalsys").ContinuousDynamicalSystem(model=model)
        system.integrator("rk4", time_step=self.scene.period / setting.knob)
        timed = self.scene.timed()
        lanes = timed[np.linspace(0, len(timed) - 1, _LANES).round().astype(int)]

        def run() -> int:
            for lane in lanes:
                values = parameters(float(self.scene.b[lane]))
                system.lyapunov(self.scene.states[lane], _PERIODS * self.scene.period, parameters=values)
            return _LANES * _PERIODS

        return run

    def _derivative(self, y: Any, b: Any, steps: Any) -> Any:
        case = self.scene.case
        force = {"sin": jnp.sin, "cos": jnp.cos}.get(case.forcing)
        h = self.scene.period / steps.astype(float)

        def step(i: Any, y: Any) -> Any:
            def rate(y: Any, share: float) -> Any:
                drive = force((i.astype(float) + share) * h) if force else 0.0
                return jnp.stack([x * jnp.ones(()) for x in case.field(jnp, tuple(y), drive, b)])

            first = rate(y, 0.0)
            second = rate(y + 0.5 * h * first, 0.5)
            third = rate(y + 0.5 * h * second, 0.5)
            return y + h / 6.0 * (first + 2.0 * second + 2.0 * third + rate(y + h * third, 1.0))

        return jax.jacfwd(lambda y: jax.lax.fori_loop(0, steps, step, y))(y)

    def _errors(self, steps: float) -> Errors:
        lanes = self.scene.timed()
        states, b = jnp.asarray(self.scene.states[lanes]), jnp.asarray(self.scene.b[lanes])
        return self.scene.derivative_errors(np.asarray(self._derivatives(states, b, jnp.int64(steps))))
