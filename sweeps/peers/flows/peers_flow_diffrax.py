"""Stock diffrax on any flow, its state a tuple of components; nothing of jaxnh."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from sweeps.peers.flows.peers_flow_cases import FlowScene
from sweeps.peers.particle.peers_diffrax import StockContestant


class Contestant(StockContestant):
    """In one form alone: the equations as they are."""

    scene: FlowScene
    forms = ("components",)

    def field(self, form: str) -> Callable[[Any, Any, Any], Any]:
        case = self.scene.case
        force = {"sin": jnp.sin, "cos": jnp.cos}.get(case.forcing, jnp.zeros_like)
        return lambda t, y, p: tuple(x * jnp.ones(()) for x in case.field(jnp, y, force(t), p))

    def starts(self, form: str, lanes: np.ndarray) -> np.ndarray:
        return self.scene.states[lanes]

    def compared(self, form: str, ends: np.ndarray) -> np.ndarray:
        return ends
