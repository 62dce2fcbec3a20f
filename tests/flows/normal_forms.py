"""Experiments whose orbits are known in closed form: x' of a normal form, beside z that a clock drives."""

from __future__ import annotations

from pathlib import Path

from jaxnh.engine.experiment import Experiment

_FILE = """\
import jax.numpy as jnp

def system({parameters}):
    def rhs(y, t):
        x, z = y
        return {of_x}, jnp.cos(2 * jnp.pi * t) - z

    return {{"rhs": rhs, "coordinates": ("x", "z"), "period": 1.0}}
"""

_CONFIG = """\
system: {{file: {file}}}
initial: {initial}
sweep: {{{sweep}}}
accuracy: {{target: 1.0e-10}}
analyses:
  {analysis}
"""


def normal_form(folder: Path, of_x: str, parameters: str, initial: str, sweep: str, analysis: str) -> Experiment:
    """The experiment of x' = `of_x` with an analysis, its file in a folder."""
    file = folder / "normal_form.py"
    file.write_text(_FILE.format(parameters=parameters, of_x=of_x))
    return Experiment.from_text(_CONFIG.format(file=file, initial=initial, sweep=sweep, analysis=analysis))
