"""jaxnh's Lyapunov exponents as a contestant: the analysis `lyapunov` as it is, orthonormalisation and all.

Beside the whole spectrum: one exponent, and the map without any tangent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from jaxnh.analyses import lyapunov
from jaxnh.analyses.base import Scene as AnalysisScene
from jaxnh.analyses.base import spread
from jaxnh.maps.iterate import derivatives, iterate
from jaxnh.maps.protocol import Strobe
from jaxnh.solvers import SPLITTINGS
from sweeps.peers_jaxnh import Splittings
from sweeps.peers_scene import VALUES, Errors, Setting, TangentScene, best, unit

SPECTRUM, ONE, MAP = "jaxnh", "jaxnh, one exponent", "jaxnh, no exponent"
_EXPONENTS = {SPECTRUM: 3, ONE: 1, MAP: 0}
_PERIODS = 256  # the engine's measurement of how often to orthonormalise is in every run: one part in fifty


class Contestant(Splittings[TangentScene]):
    """Tuned by the derivatives of a period."""

    def tune(self, target: float, hints: Sequence[Setting] = ()) -> list[Setting]:
        settings = super().tune(target, hints)
        return [replace(best(settings), peer=peer) for peer in _EXPONENTS] if settings else []

    def errors(self, strobe: Strobe) -> Errors:
        lanes = self.scene.timed()
        start = self.scene.states[lanes], {"b": self.scene.b[lanes]}
        return self.scene.derivative_errors(self.lanes(derivatives, (strobe, np.int32(1)), start)[1])

    def program(self, setting: Setting) -> Callable[[], int]:
        """The analysis over all values from the paper's start, or for no exponent as many periods of the map."""
        steps, solver = int(setting.knob), SPLITTINGS[setting.form]
        x, y, n1, n2 = unit(self.scene.states[:1])[0].tolist()
        start = spread(((x, y), (n1, n2)), len(VALUES))
        exponents = _EXPONENTS[setting.peer]
        scene = AnalysisScene(self.system, start, {"b": VALUES}, solver, steps, False, setting.errors.max)

        def run() -> int:
            if exponents:
                options = lyapunov.LyapunovOptions(transient=0, periods=_PERIODS, exponents=exponents)
                lyapunov.run(options, scene, self.lanes)
            else:
                self.lanes(iterate, (scene.strobe(), np.int32(_PERIODS)), scene.lanes)
            return len(VALUES) * _PERIODS

        return run
