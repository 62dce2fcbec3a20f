"""jaxnh's Lyapunov spectra of any flow as a contestant: the averages of the analysis `lyapunov`, or all of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from jaxnh.analyses.batch import LaneBatch
from jaxnh.analyses.exponents import lyapunov
from jaxnh.maps.iterate import derivatives
from jaxnh.maps.protocol import ReturnMap
from sweeps.peers.flows.peers_flow_jaxnh import FlowMaps
from sweeps.peers.particle.peers_scene import TANGENT_PERIODS, WHOLE, Errors, Setting


class Contestant(FlowMaps):
    """Tuned by the derivatives of a period, in the components of the case.

    How often tangents are orthonormalised is the analysis's own choice, made before the timing.
    """

    def tune(self, target: float, hints: Sequence[Setting] = (), only: bool = False) -> list[Setting]:
        settings = []
        for setting in super().tune(target):
            parts = lyapunov.choose(self._options(), self._scene(setting), self.lanes)["parts"]
            steps = float(-(-int(setting.knob) // parts) * parts)
            errors = self.errors(self.strobe(setting.form, steps))
            label = f"{steps:.0f} steps, {parts} orthonormalisations"
            settings.append(replace(setting, knob=steps, label=label, errors=errors, parts=parts))
        return settings

    def errors(self, strobe: ReturnMap) -> Errors:
        lanes, picks, embed = self.scene.timed(), list(self.placed.picks), self.placed.embed
        states = jnp.asarray(self.scene.states[lanes])
        u, lifts = np.asarray(jax.vmap(embed)(states)), np.asarray(jax.vmap(jax.jacfwd(embed))(states))
        p = {self.scene.case.parameter: self.scene.b[lanes]}
        monodromy = self.lanes(derivatives, (strobe, np.int32(1)), (u, p)).monodromy
        return self.scene.derivative_errors((monodromy @ lifts)[:, picks])

    def program(self, setting: Setting) -> Callable[[], int]:
        """The averages from the timed states on, or the whole analysis."""
        scene = replace(self._scene(setting), chosen={"lyapunov": {"parts": setting.parts}})

        def run() -> int:
            if setting.peer == WHOLE:
                lyapunov.run(self._options(), scene, self.lanes)
            else:
                lyapunov.averages(self._options(), scene, self.lanes, setting.parts, to_the_end=True)
            return scene.count * TANGENT_PERIODS

        return run

    def _scene(self, setting: Setting) -> LaneBatch:
        state, p = self.started(self.scene.timed())
        solver = self.solvers[setting.form]
        return LaneBatch(self.placed.flow, state, p, solver, int(setting.knob), False, setting.errors.max)

    def _options(self) -> lyapunov.LyapunovOptions:
        return lyapunov.LyapunovOptions(transient=0, periods=TANGENT_PERIODS, exponents=self.placed.flow.exponents)
