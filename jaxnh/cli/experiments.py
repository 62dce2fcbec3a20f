"""Experiments of configs, tried out while the terminal is told what takes long."""

from __future__ import annotations

from jaxnh.cli.slow_files import report_user_line
from jaxnh.config.config import Config
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.xla_options import configure


def checked_experiment(config: Config) -> Experiment:
    """The experiment of a config.

    Raises:
        InputError: its flow cannot be made, or does not go with the rest of it.
    """
    configure()  # before a user's file is tried out
    with report_user_line(config.label):
        return Experiment.from_config(config)
