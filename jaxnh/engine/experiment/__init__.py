"""Experiments: a config with its flow, its start states and its axes."""

from jaxnh.engine.experiment.base import Experiment, load
from jaxnh.engine.experiment.particle import ParticleExperiment
from jaxnh.engine.experiment.user import UserExperiment

__all__ = ["Experiment", "ParticleExperiment", "UserExperiment", "load"]
