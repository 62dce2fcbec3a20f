"""heyoka on any flow: the true results in long double, and its batch integrator as a contestant."""

from __future__ import annotations

from typing import Any

import heyoka as hy
import numpy as np

from sweeps.peers.flows.peers_flow_cases import FlowCase, FlowScene
from sweeps.peers.particle.peers_heyoka import CLOCK, REAL, BatchContestant, taylor_periods, with_clock
from sweeps.peers.particle.peers_heyoka_tangent import true_derivatives
from sweeps.peers.particle.peers_scene import TRANSIENT

OPTIONS: tuple[tuple[str, ...], ...] = ((), ("fast_math",), ("fast_math", "force_avx512"))


def clocks(case: FlowCase) -> tuple[str, ...]:
    """Forms of a flow's clock: heyoka's own time, or sin t and cos t as two more equations."""
    return ("time", CLOCK) if case.forcing else ("no clock",)


def equations(case: FlowCase, clock: str) -> list[tuple[Any, Any]]:
    """Equations of motion as heyoka takes them; parameter 0 is the lane's."""
    state = [hy.expression(f"y{i}") for i in range(len(case.start))]
    sine, cosine = hy.make_vars("sine", "cosine")
    if clock == CLOCK:
        force = sine if case.forcing == "sin" else cosine
    else:
        force = getattr(hy, case.forcing)(hy.time) if case.forcing else None
    motion = list(zip(state, case.field(hy, state, force, hy.par[0]), strict=True))
    return motion + ([(sine, cosine), (cosine, -sine)] if clock == CLOCK else [])


def true_scene(case: FlowCase, values: np.ndarray) -> FlowScene:
    """The scene of a flow at values of its parameter, by Taylor integrations at 1e-18 in long double."""
    clock = clocks(case)[0]
    after = taylor_periods(equations(case, clock), len(case.start), REAL(case.period))
    start = np.array(case.start)
    later = np.array([after(start, value, TRANSIENT) for value in values]).astype(float)
    states, b = np.concatenate([np.tile(start, (len(values), 1)), later]), np.tile(values, 2)
    ends = np.array([after(z, value, 1) for z, value in zip(states, b, strict=True)])
    scene = FlowScene(case.name, b, states, ends, np.empty(0))
    return FlowScene(case.name, b, states, ends, true_derivatives(scene, equations(case, clock)))


class Contestant(BatchContestant):
    """The batch integrator: clock, batch size, and options of the compiler; long propagations."""

    scene: FlowScene
    options = OPTIONS
    periods = 512

    def __init__(self, scene: FlowScene) -> None:
        super().__init__(scene)
        self.forms = tuple((clock,) for clock in clocks(scene.case))

    def equations(self, *form: str) -> list[tuple[Any, Any]]:
        return equations(self.scene.case, form[0])

    def starts(self, form: tuple[str, ...], lanes: np.ndarray) -> np.ndarray:
        start = self.scene.states[lanes]
        return with_clock(start) if form[0] == CLOCK else start

    def compared(self, form: tuple[str, ...], ends: np.ndarray) -> np.ndarray:
        return ends[:, : len(self.scene.case.start)]
