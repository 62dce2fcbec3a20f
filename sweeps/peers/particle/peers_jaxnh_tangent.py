"""jaxnh's Lyapunov exponents as a contestant: the averages of the analysis `lyapunov`, orthonormalisation and all.

Beside the whole spectrum: one exponent, the map without any tangent, and all that the analysis does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from jaxnh.analyses.batch import LaneBatch as AnalysisScene
from jaxnh.analyses.exponents import lyapunov
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import derivatives, iterate
from jaxnh.maps.protocol import ReturnMap
from jaxnh.solvers import SPLITTINGS
from sweeps.peers.particle.peers_jaxnh import Splittings
from sweeps.peers.particle.peers_scene import TANGENT_PERIODS, WHOLE, Errors, Setting, TangentScene, best, unit

SPECTRUM, ONE, MAP = "jaxnh", "jaxnh, one exponent", "jaxnh, no exponent"
_EXPONENTS = {SPECTRUM: 3, WHOLE: 3, ONE: 1, MAP: 0}


class Contestant(Splittings[TangentScene]):
    """Tuned by the derivatives of a period.

    How often tangents are orthonormalised is the analysis's own choice, made before the timing; the steps are rounded
    up to whole ones in each of these parts, as the analysis does.
    """

    def tune(self, target: float, hints: Sequence[Setting] = (), only: bool = False) -> list[Setting]:
        settings = super().tune(target, hints)
        if not settings:
            return []
        found = best(settings)
        solver = SPLITTINGS[found.form]
        parts = lyapunov.choose(_options(3), self._analysed(found), self.lanes)["parts"]
        steps = -(-int(found.knob) // parts) * parts
        errors = self.errors(make_return_map(self.system, solver, steps))
        label = f"{steps} steps, {solver.total_kicks(steps)} kicks a period"
        whole = replace(found, knob=float(steps), label=label, errors=errors, parts=parts)
        rows = [replace(whole, peer=peer) for peer in (MAP, ONE)]
        return [replace(whole, peer=SPECTRUM, label=f"{label}, {parts} orthonormalisations a period"), *rows]

    def errors(self, strobe: ReturnMap) -> Errors:
        lanes = self.scene.timed()
        start = self.scene.states[lanes], {"b": self.scene.b[lanes]}
        return self.scene.derivative_errors(self.lanes(derivatives, (strobe, np.int32(1)), start)[1])

    def program(self, setting: Setting) -> Callable[[], float]:
        """The analysis over all values from the start state, or for no exponent as many periods of the map."""
        exponents, count = _EXPONENTS[setting.peer], len(self.scene.values)
        parts, options = setting.parts if exponents > 1 else 1, _options(max(exponents, 1))
        scene = replace(self._analysed(setting), chosen={"lyapunov": {"parts": parts}})

        def run() -> float:
            if setting.peer == WHOLE:
                lyapunov.run(options, scene, self.lanes)
            elif exponents:
                lyapunov.averages(options, scene, self.lanes, parts, to_the_end=True)
            else:
                self.lanes(iterate, (scene.strobe(), np.int32(TANGENT_PERIODS)), scene.lanes)
            return count * TANGENT_PERIODS

        return run

    def _analysed(self, setting: Setting) -> AnalysisScene:
        x, y, n1, n2 = (np.full(len(self.scene.values), number) for number in unit(self.scene.states[:1])[0])
        start = (x, y), (n1, n2)
        solver, steps, error = SPLITTINGS[setting.form], int(setting.knob), setting.errors.max
        return AnalysisScene(self.system, start, {"b": self.scene.values}, solver, steps, False, error)


def _options(exponents: int) -> lyapunov.LyapunovOptions:
    return lyapunov.LyapunovOptions(transient=0, periods=TANGENT_PERIODS, exponents=exponents)
