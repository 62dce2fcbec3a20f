"""An experiment of a system that is given in Python: a function as a user's file has it, or a flow of the package."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxnh.engine.experiment import Experiment
from jaxnh.exceptions import InputError
from jaxnh.systems.definition import DefinedFlow
from jaxnh.systems.flow import Parameters
from jaxnh.systems.free_particle import FreeParticle
from jaxnh.systems.function_source import source_text
from jaxnh.systems.particle import IsokineticParticle
from jaxnh.systems.user_file import UserFile

System = Callable[..., Any] | IsokineticParticle | DefinedFlow
"""A system in Python: a function of parameters, `constant_speed(...)` and the others, or `lagrangian(...)`."""

_FIRST = {"portrait": {}}  # an experiment asks for something
_FIRST_OF_MAPS = {"poincare": {}}


def experiment_of(
    system: System,
    start: Mapping[str, float] | None = None,
    target: float | None = None,
    parameters: Mapping[str, float] | None = None,
) -> Experiment:
    """Return an experiment of a system, of one lane until axes are named.

    Args:
        system: a function whose arguments are the parameters with their defaults, which returns what the function
            `system` of a user's file does; or a flow of this package.
        start: coordinates of the start state by name, zero where not given; of the particle the paper's.
        target: error of one period's map that is allowed, by default that of a config.
        parameters: values in place of the function's defaults.

    Raises:
        InputError: it is no such system.
        ConfigError: the function, a start or a parameter cannot be used.
    """
    for name, given in (("start", start), ("parameters", parameters)):
        if not isinstance(given, Mapping | None):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise InputError(f"{name} are numbers by name, as {name}={{'x': 1.0}}, not {type(given).__name__}")
    content: dict[str, Any] = {"initial": dict(start or {}), "analyses": _FIRST}
    if target is not None:
        content["accuracy"] = {"target": target}
    user_file = None
    if isinstance(system, IsokineticParticle | FreeParticle):
        content["system"] = {**_particle(system), **(parameters or {})}
        lane = "b", float(content["system"].pop("b", 0.0))
    elif isinstance(system, DefinedFlow) or callable(system):
        function = system.define if isinstance(system, DefinedFlow) else system
        given = _plain_numbers(system.values) if isinstance(system, DefinedFlow) else {}
        path = Path(f"{getattr(function, '__name__', 'system')}.py")
        user_file = UserFile(path, source_text(function))
        content["system"] = {"file": str(path), **given, **(parameters or {})}
        content["analyses"] = _FIRST_OF_MAPS if user_file.discrete else _FIRST
        lane = _one_lane(user_file, content)
    else:
        raise InputError(
            f"a system is a function with parameters, or one of jaxnh's flows, not {type(system).__name__}; "
            "a config file is read by jaxnh.load"
        )
    content["sweep"] = {lane[0]: {"values": [lane[1]]}}
    experiment = Experiment.from_content(content, user_file)
    experiment._set_private(_filler=lane[0])
    return experiment


def _one_lane(file: UserFile, content: dict[str, Any]) -> tuple[str, float]:
    """An axis of one value: of the first parameter, or where there is none of the first coordinate."""
    if file.parameters:
        name, default = next(iter(file.parameters.items()))
        return name, float(content["system"].pop(name, default))
    name = file.states[0]
    return name, float(content["initial"].pop(name, 0.0))


def _particle(flow: IsokineticParticle | FreeParticle) -> dict[str, Any]:
    """The block `system` of a config whose flow this is."""
    p = _plain_numbers(flow.parameters)
    names, constraint = ["a", "b", "omega"], "free"
    if isinstance(flow, IsokineticParticle):
        disturbed = "disturbance" not in flow.without
        names += ["c", "d"] if disturbed else ["c"]
        constraint = "disturbed_speed" if disturbed else "constant_speed"
    without = sorted(flow.without - {"disturbance"})
    block: dict[str, Any] = {name: p[name] for name in names if name in p}
    return {"constraint": constraint, **block, **({"without": without} if without else {})}


def _plain_numbers(values: Parameters) -> dict[str, float]:
    numbers = {}
    for name, value in values.items():
        try:
            numbers[name] = float(np.asarray(value))
        except (TypeError, ValueError):
            kind = "the text " if isinstance(value, str) else ""
            raise InputError(f"{name} is a number, not {kind}{value!r}") from None
    return numbers
