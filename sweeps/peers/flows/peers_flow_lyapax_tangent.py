"""lyapax on any flow: its sweep of Lyapunov spectra, by its Runge–Kutta method of order six; nothing of jaxnh."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sweeps.peers.flows.peers_flow_cases import FlowScene
from sweeps.peers.particle.peers_scene import Errors, Setting, least_effort

_PERIODS, _FIRST_GUESS, _MOST_STEPS = 16, 100.0, 20_000.0


class Contestant:
    """Time is one more component of a flow with a clock, as lyapax has autonomous steps alone, and gets a tangent."""

    def __init__(self, scene: FlowScene) -> None:
        jax.config.update("jax_enable_x64", True)
        self.scene = scene
        self.d = len(scene.case.start)
        self._combine = importlib.import_module("lyapax.integrators").rk6_combine
        self._sweep = importlib.import_module("lyapax.sweep").sweep_lyapunov_spectrum
        self._derivatives = jax.jit(jax.vmap(self._derivative, in_axes=(0, 0, None)))

    def tune(self, target: float, hints: Sequence[Setting], only: bool = False) -> list[Setting]:
        parts = hints[0].parts
        found = least_effort(self._errors, target, _FIRST_GUESS, factor=2.0, most=_MOST_STEPS, whole=True)
        if found is None:
            return []
        steps = -(-int(found[0]) // parts) * parts
        label = f"{steps} steps, {parts} orthonormalisations"
        return [Setting("lyapax", "RK6", steps, label, self._errors(steps), parts=parts)]

    def program(self, setting: Setting) -> Callable[[], int]:
        """The sweep from the timed states on, compiled as a whole."""
        steps, lanes = int(setting.knob), self.scene.timed()
        start, b = self._started(lanes), jnp.asarray(self.scene.b[lanes])
        dt = self.scene.period / steps

        def spectra(start: Any, b: Any) -> Any:
            found = self._sweep(
                lambda y, p: self._step(y, p["b"], dt),
                start[0],
                {"b": b},
                dt,
                _PERIODS * steps,
                renorm_every=steps // setting.parts,
                state0_batch=start,
            )
            return found.exponents

        compiled = jax.jit(spectra)

        def run() -> int:
            jax.block_until_ready(compiled(start, b))
            return len(lanes) * _PERIODS

        return run

    def _step(self, y: Any, b: Any, dt: Any) -> Any:
        case, d = self.scene.case, self.d
        force = {"sin": jnp.sin, "cos": jnp.cos}.get(case.forcing)

        def rate(y: Any, _: float) -> Any:
            moved = case.field(jnp, tuple(y[:d]), force(y[d]) if force else 0.0, b)
            return jnp.stack([x * jnp.ones(()) for x in moved] + ([jnp.ones(())] if force else []))

        return self._combine(rate, y, dt)

    def _started(self, lanes: np.ndarray) -> Any:
        states = jnp.asarray(self.scene.states[lanes])
        return jnp.pad(states, [(0, 0), (0, 1)]) if self.scene.case.forcing else states

    def _derivative(self, y: Any, b: Any, steps: Any) -> Any:
        def end(y: Any) -> Any:
            dt = self.scene.period / steps.astype(float)
            return jax.lax.fori_loop(0, steps, lambda _, y: self._step(y, b, dt), y)

        return jax.jacfwd(end)(y)[: self.d, : self.d]

    def _errors(self, steps: float) -> Errors:
        lanes = self.scene.timed()
        found = self._derivatives(self._started(lanes), jnp.asarray(self.scene.b[lanes]), jnp.int64(steps))
        return self.scene.derivative_errors(np.asarray(found))
