"""jaxnh's Lyapunov exponents as a contestant: the analysis `lyapunov` as it is, orthonormalisation and all.

Beside the whole spectrum: one exponent, and the map without any tangent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import jax
import numpy as np

from jaxnh.analyses import lyapunov
from jaxnh.analyses.record import Scene as AnalysisScene
from jaxnh.lanes import Lanes, configure
from jaxnh.solvers import SPLITTINGS
from jaxnh.strobe import derivatives, iterate, make_strobe
from jaxnh.systems import IsokineticParticle
from sweeps.peers_scene import VALUES, Errors, Setting, TangentScene, best, least_effort, unit

SPECTRUM, ONE, MAP = "jaxnh", "jaxnh, one exponent", "jaxnh, no exponent"
_EXPONENTS = {SPECTRUM: 3, ONE: 1, MAP: 0}
_PERIODS = 256  # the engine's measurement of how often to orthonormalise is in every run: one part in fifty
_FIRST_GUESS = 2000  # kicks a period
_MOST_KICKS = 20000
_HOPELESS = 3.0


class Contestant:
    """All splittings on constant steps."""

    def __init__(self, scene: TangentScene) -> None:
        configure()
        self.scene = scene
        self.system = IsokineticParticle(a=scene.a, c=scene.c, d=scene.d, omega=1.0)
        self.lanes = Lanes()

    def tune(self, target: float, hints: Sequence[Setting] = ()) -> list[Setting]:
        settings: list[Setting] = []
        fewest = float(_MOST_KICKS)
        for name, solver in sorted(SPLITTINGS.items(), key=lambda item: -item[1].convergence_order):

            def measure(steps: float, name: str = name) -> Errors:
                lanes = self.scene.timed()
                strobe = make_strobe(self.system, SPLITTINGS[name], int(steps))
                start = self.scene.states[lanes], self.scene.b[lanes]
                return self.scene.derivative_errors(self.lanes(derivatives, (strobe, np.int32(1)), start)[1])

            guess = max(2.0, min(_FIRST_GUESS, fewest) / solver.stages)
            most = max(2.0, min(_MOST_KICKS, _HOPELESS * fewest) / solver.stages)
            found = least_effort(measure, target, guess, factor=1.5, most=most, whole=True)
            if found is None:
                continue
            steps, errors = found
            kicks = int(steps) * solver.stages
            fewest = min(fewest, kicks)
            label = f"{steps:.0f} steps, {kicks} kicks a period"
            settings.append(Setting(SPECTRUM, name, steps, label, errors, (name,), kicks))
        return [replace(best(settings), peer=peer) for peer in _EXPONENTS] if settings else []

    def program(self, setting: Setting) -> Callable[[], int]:
        """The analysis over all values from the paper's start, or for no exponent as many periods of the map."""
        steps, solver = int(setting.knob), SPLITTINGS[setting.form]
        x, y, n1, n2 = unit(self.scene.states[:1])[0].tolist()
        start = (x, y), (n1, n2)
        exponents = _EXPONENTS[setting.peer]
        scene = AnalysisScene(self.system, start, VALUES, solver, steps, False, setting.errors.max)

        def run() -> int:
            if exponents:
                options = lyapunov.LyapunovOptions(transient=0, periods=_PERIODS, exponents=exponents)
                lyapunov.run(options, scene, self.lanes)
            else:
                state = jax.tree.map(lambda leaf: np.full(len(VALUES), leaf), start)
                self.lanes(iterate, (make_strobe(self.system, solver, steps), np.int32(_PERIODS)), (state, VALUES))
            return len(VALUES) * _PERIODS

        return run
