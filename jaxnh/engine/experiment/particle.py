"""Experiments of the paper's particle."""

from __future__ import annotations

from collections.abc import Mapping

from jaxnh.config.config import ParticleConfig
from jaxnh.config.particle import PoincareSection
from jaxnh.engine.experiment.base import Experiment
from jaxnh.engine.flows import particle_flow, section_of
from jaxnh.maps.section import Section
from jaxnh.systems.flow import Flow


class ParticleExperiment(ParticleConfig, Experiment, frozen=True):
    """An experiment of the paper's particle."""

    def _flow(self, parameters: Mapping[str, float]) -> Flow:
        return particle_flow(self.system, parameters)

    @property
    def _section(self) -> PoincareSection:
        return self.section or PoincareSection()

    def _on_section(self, flow: Flow) -> Section:
        return section_of(self._section, ("x1", "y1"), flow)

    @property
    def _of_starts(self) -> tuple[str, ...]:
        return tuple(self.initial.coordinates())
