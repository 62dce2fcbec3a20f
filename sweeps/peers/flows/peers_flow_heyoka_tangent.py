"""heyoka's tangent flow of any flow, as `peers_heyoka_tangent` drives it."""

from __future__ import annotations

from typing import Any

from sweeps.peers.flows.peers_flow_cases import FlowScene
from sweeps.peers.flows.peers_flow_heyoka import clocks, equations
from sweeps.peers.particle.peers_heyoka_tangent import TangentContestant


class Contestant(TangentContestant):
    """A contestant with as many tangents as the flow has components."""

    scene: FlowScene
    periods = 32

    def __init__(self, scene: FlowScene) -> None:
        self.d, self.clocks = len(scene.case.start), clocks(scene.case)
        super().__init__(scene)

    def motion(self, clock: str) -> list[tuple[Any, Any]]:
        return equations(self.scene.case, clock)
