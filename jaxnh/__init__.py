"""jaxnh: complete identification of chaos in nonlinear nonholonomic systems, and in any flow, on JAX and diffrax.

    import jaxnh

    experiment = jaxnh.load("configs/table1.yaml")
    tree = jaxnh.run(experiment)
    tree["doubling"]["b"]

A system that is a Python function goes to `Session` as it is. What stands in `__all__` is the public face; everything
is loaded when it is first used, so that drawing or looking at a result needs no JAX.
"""

from __future__ import annotations

import gc
import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from jaxnh.exceptions import (
    AccuracyError,
    ArgumentError,
    BusyError,
    ConfigError,
    DamagedError,
    InputError,
    JaxnhError,
    JaxnhWarning,
    JaxStartedWarning,
    LostLaneError,
    ResultError,
    RunError,
    Stopped,
    UserFileError,
)

if TYPE_CHECKING:
    from jaxnh.analyses.options import AtlasOptions as Atlas
    from jaxnh.analyses.options import BasinsOptions as Basins
    from jaxnh.analyses.options import BranchesOptions as Branches
    from jaxnh.analyses.options import Chaos01Options as Chaos01
    from jaxnh.analyses.options import CovariantOptions as Covariant
    from jaxnh.analyses.options import CurvesOptions as Curves
    from jaxnh.analyses.options import DiagramOptions as Diagram
    from jaxnh.analyses.options import DoublingOptions as Doubling
    from jaxnh.analyses.options import EdgesOptions as Edges
    from jaxnh.analyses.options import HomoclinicOptions as Homoclinic
    from jaxnh.analyses.options import LyapunovOptions as Lyapunov
    from jaxnh.analyses.options import ManifoldsOptions as Manifolds
    from jaxnh.analyses.options import OrbitsOptions as Orbits
    from jaxnh.analyses.options import PeriodOptions as Period
    from jaxnh.analyses.options import PoincareOptions as Poincare
    from jaxnh.analyses.options import PortraitOptions as Portrait
    from jaxnh.analyses.options import ReversalOptions as Reversal
    from jaxnh.analyses.options import RotationOptions as Rotation
    from jaxnh.analyses.options import ToriOptions as Tori
    from jaxnh.analyses.options import TorusBranchesOptions as TorusBranches
    from jaxnh.analyses.options import TransientsOptions as Transients
    from jaxnh.analyses.options import TransportOptions as Transport
    from jaxnh.analyses.options import VerdictOptions as Verdict
    from jaxnh.analyses.options import WindowsOptions as Windows
    from jaxnh.analyses.options.orbits import Continuation
    from jaxnh.engine.experiment import Experiment, load
    from jaxnh.engine.gradient import gradient
    from jaxnh.engine.run_experiment import run
    from jaxnh.engine.session import Session
    from jaxnh.explorer.bokeh_figure import bokeh_figure
    from jaxnh.plotting.meanings import labels
    from jaxnh.plotting.results import figure
    from jaxnh.storage.hdf5 import open_result
    from jaxnh.systems.free_particle import FreeParticle, free_particle
    from jaxnh.systems.lagrangian import Lagrangian, lagrangian
    from jaxnh.systems.particle import IsokineticParticle, constant_speed, disturbed_speed

__version__ = "0.2.0.dev0"


def citation() -> str:
    """Return the entry of BibTeX by which this version is cited; CITATION.cff has the same for other formats."""
    return f"""\
@software{{jaxnh,
  author = {{{{jaxnh contributors}}}},
  title = {{jaxnh: complete identification of chaos in nonlinear nonholonomic systems, and in any flow}},
  version = {{{__version__}}},
  license = {{MIT}},
}}
"""


_HOMES = {
    "Continuation": "analyses.options.orbits",
    "Experiment": "engine.experiment",
    "FreeParticle": "systems.free_particle",
    "IsokineticParticle": "systems.particle",
    "Lagrangian": "systems.lagrangian",
    "Session": "engine.session",
    "bokeh_figure": "explorer.bokeh_figure",
    "constant_speed": "systems.particle",
    "disturbed_speed": "systems.particle",
    "figure": "plotting.results",
    "free_particle": "systems.free_particle",
    "gradient": "engine.gradient",
    "labels": "plotting.meanings",
    "lagrangian": "systems.lagrangian",
    "load": "engine.experiment",
    "open_result": "storage.hdf5",
    "run": "engine.run_experiment",
}


def __getattr__(name: str) -> object:
    if name in _HOMES:
        return getattr(_import(f"jaxnh.{_HOMES[name]}"), name)
    if name in __all__:  # options of an analysis, by its name
        return getattr(import_module("jaxnh.analyses.options"), f"{name}Options")
    raise AttributeError(f"module jaxnh has no attribute {name}")


def _import(module: str) -> ModuleType:
    """Import a module, and JAX with it, without looks for garbage at each 700th object, a fifth of the time of both."""
    before = gc.get_threshold()
    gc.set_threshold(100_000)
    try:
        return import_module(module)
    finally:
        gc.set_threshold(*before)


def __dir__() -> list[str]:
    return sorted(__all__)


__all__ = [
    "AccuracyError",
    "ArgumentError",
    "Atlas",
    "Basins",
    "Branches",
    "BusyError",
    "Chaos01",
    "ConfigError",
    "Continuation",
    "Covariant",
    "Curves",
    "DamagedError",
    "Diagram",
    "Doubling",
    "Edges",
    "Experiment",
    "FreeParticle",
    "Homoclinic",
    "InputError",
    "IsokineticParticle",
    "JaxStartedWarning",
    "JaxnhError",
    "JaxnhWarning",
    "Lagrangian",
    "LostLaneError",
    "Lyapunov",
    "Manifolds",
    "Orbits",
    "Period",
    "Poincare",
    "Portrait",
    "ResultError",
    "Reversal",
    "Rotation",
    "RunError",
    "Session",
    "Stopped",
    "Tori",
    "TorusBranches",
    "Transients",
    "Transport",
    "UserFileError",
    "Verdict",
    "Windows",
    "__version__",
    "bokeh_figure",
    "citation",
    "constant_speed",
    "disturbed_speed",
    "figure",
    "free_particle",
    "gradient",
    "labels",
    "lagrangian",
    "load",
    "open_result",
    "run",
]

if "IPython" in sys.modules:
    import_module("jaxnh.plotting.notebook").register()
