"""Blocks of a config as flows and sections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from jaxnh.config.particle import DisturbedSpeed, Free, Particle, PoincareSection
from jaxnh.config.user_system import UserSection
from jaxnh.exceptions import InputError
from jaxnh.maps.section import Section
from jaxnh.systems.flow import Flow
from jaxnh.systems.free_particle import free_particle
from jaxnh.systems.particle import constant_speed, disturbed_speed


def particle_flow(system: Particle, parameters: Mapping[str, float]) -> Flow:
    """The particle in continuous time, with these parameters in place of its own.

    Raises:
        InputError: it has no such parameter.
    """
    for name in parameters:
        if name not in system.axes:
            raise InputError(f"{name} does not go with {system.constraint}")
    p = {**dict(system), **parameters}
    if isinstance(system, Free):
        return free_particle(p["a"], p["b"], p["omega"], system.effects_left_out)
    without = system.effects_left_out - {"damping"}  # the multiplier absorbs it
    if isinstance(system, DisturbedSpeed) and (system.d != 0 or "d" in parameters):
        return disturbed_speed(p["a"], p["c"], p["d"], p["omega"], p["b"], without=without)
    return constant_speed(p["a"], p["c"], p["omega"], p["b"], without=without)


def section_of(section: PoincareSection | UserSection, coordinates: Sequence[str], flow: Flow) -> Section:
    """A section of a flow, by one of its positions or by the normal of a plane of them."""
    if section.coordinate is not None:
        number, normal, title = coordinates.index(section.coordinate), None, ""
    else:
        weights = section.normal or {}
        normal, title = tuple(weights.get(name, 0.0) for name in coordinates), _combination(weights)
        number = int(np.argmax(np.abs(normal)))
    made = Section(flow, coordinates[number], number, section.value, section.direction, normal)
    return replace(made, longest=section.longest, title=title)


def _combination(weights: Mapping[str, float]) -> str:
    """A sum as people write it: "x - y", "2 x + 0.5 z"."""
    terms = [
        f"{'-' if weight < 0 else '+'} {'' if abs(weight) == 1 else f'{abs(weight):g} '}{name}"
        for name, weight in weights.items()
        if weight
    ]
    first, *others = terms
    return " ".join([first.replace("- ", "-").removeprefix("+ "), *others])
