"""The same stock diffrax in a process with jaxnh's XLA options: what is left when they are not the difference."""

from __future__ import annotations

from jaxnh.engine.xla_options import configure
from sweeps.peers.particle import peers_diffrax
from sweeps.peers.particle.peers_scene import Scene


class Contestant(peers_diffrax.Contestant):
    """Stock diffrax, jaxnh's XLA options."""

    suffix = ", jaxnh's XLA options"

    def __init__(self, scene: Scene) -> None:
        configure()
        super().__init__(scene)
