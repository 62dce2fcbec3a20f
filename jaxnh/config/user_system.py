"""Sections of a config for a user's system: keys are its own parameters, coordinates and velocities."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from pydantic import Field, PrivateAttr, create_model, model_validator

from jaxnh.config.blocks import Grid, Section
from jaxnh.config.messages import rule
from jaxnh.systems.lagrangian import Motion, NonholonomicSystem
from jaxnh.systems.user_file import OwnSystem

_LARGEST_RESIDUAL = 1e-6  # of f at the start, in units of |A q̇| + 1: what the digits of a config leave


class OwnParameters(Section):
    """A user's file, and its parameters."""

    file: str = Field(description="Python file with a function system, beside the config")

    _own: OwnSystem | None = PrivateAttr(default=None)
    _built: NonholonomicSystem | None = PrivateAttr(default=None)

    def prepare(self, own: OwnSystem, swept: str, value: float) -> None:
        """Build the system, once the parameter that is swept is known, at one of its values."""
        parameters = {name: getattr(self, name) for name in own.parameters} | {swept: value}
        self._own, self._built = own, own.system(parameters, swept)

    def build(self) -> NonholonomicSystem:
        """The system with these parameters."""
        assert self._built is not None
        return self._built

    def exponents(self, sweep: Any) -> int:
        """How many Lyapunov exponents there are."""
        return self.build().exponents


class OwnInitial(Section):
    """The start state at t = 0: coordinates and velocities, zero where they are not given."""

    def state(self, system: NonholonomicSystem) -> Motion:
        """(q, q̇) at t = 0."""
        q = tuple(float(getattr(self, name)) for name in system.names)
        v = tuple(float(getattr(self, f"{name}_dot")) for name in system.names)
        return Motion(q, v, (0.0, 0.0))

    def check(self, parameters: OwnParameters, sweep: OwnSweep) -> None:
        """Build the system, and see that its constraints hold at the start at every value of the sweep."""
        name, values = sweep.swept, sweep.grid()
        if name in parameters.model_fields_set:
            raise rule(f"{name} is swept; leave it out here", f"system.{name}", f"sweep.{name}")
        own = sweep.own()
        parameters.prepare(own, name, float(values[0]))
        system = parameters.build()
        if not system.constraints:
            return
        state, zero = self.state(system), jnp.zeros(len(values))
        lanes = Motion(tuple(zero + x for x in state.q), tuple(zero + x for x in state.v), (zero, zero))
        residuals = np.stack([np.asarray(r + zero) for r in system.residuals(zero, lanes, jnp.asarray(values))])
        limit = _LARGEST_RESIDUAL * (1.0 + np.abs(np.asarray(state.v)).max())
        if np.all(np.abs(residuals) <= limit):
            return
        number, lane = np.unravel_index(np.nanargmax(np.abs(residuals)), residuals.shape)
        point = jnp.asarray(system.section_point(state))
        near = system.approach(point, jnp.float64(values[lane]))
        keys = [f"{coordinate}_dot" for coordinate in system.names]
        message = (
            f"f[{number}] is {residuals[number, lane]:.3g} at the start with {name} = {values[lane]:g}, and must be 0"
        )
        if np.all(np.isfinite(np.array(near.v))):
            nearest = ", ".join(f"{key}: {float(v):.10g}" for key, v in zip(keys, near.v, strict=True))
            message += f"; the nearest velocities that make it so are {nearest}"
        raise rule(message, *(f"initial.{key}" for key in (*keys, *system.names)), "initial", "system")


class OwnSweep(Section):
    """The parameter that differs from lane to lane."""

    @model_validator(mode="after")
    def _one(self) -> OwnSweep:
        given = [name for name in type(self).model_fields if getattr(self, name) is not None]
        if len(given) != 1:
            raise rule(f"name one parameter and its values; known are {', '.join(type(self).model_fields)}", *given)
        return self

    @property
    def swept(self) -> str:
        """Name of the parameter."""
        return next(name for name in type(self).model_fields if getattr(self, name) is not None)

    def grid(self) -> np.ndarray:
        """Its values in the order of the config, float64 of shape (lanes,)."""
        return getattr(self, self.swept).grid()

    @classmethod
    def own(cls) -> OwnSystem:
        """The file that it is a sweep of."""
        raise NotImplementedError


def own_sections(own: OwnSystem) -> tuple[type[OwnParameters], type[OwnInitial], type[OwnSweep]]:
    """The sections `system`, `initial` and `sweep` of a user's system."""
    parameters: dict[str, Any] = {
        name: (float, Field(default=default, description=f"Parameter {name} of the system"))
        for name, default in own.parameters.items()
    }
    state: dict[str, Any] = {}
    for name in own.coordinates:
        state[name] = (float, Field(default=0.0, description=f"Coordinate {name}"))
        state[f"{name}_dot"] = (float, Field(default=0.0, description=f"Velocity d{name}/dt"))
    grids: dict[str, Any] = {
        name: (
            Grid | None,  # pyright: ignore[reportOperatorIssue]
            Field(default=None, description=f"Parameter {name}: start, stop and count, or values"),
        )
        for name in own.parameters
    }
    sweep = create_model("OwnSweep", __base__=OwnSweep, **grids)
    sweep.own = classmethod(lambda cls: own)  # pyright: ignore[reportAttributeAccessIssue]
    return (
        create_model("OwnParameters", __base__=OwnParameters, **parameters),
        create_model("OwnInitial", __base__=OwnInitial, **state),
        sweep,
    )


def with_own_systems(schema: dict[str, Any]) -> dict[str, Any]:
    """The JSON Schema of a config, with a place for users' systems: what their parameters are called is not known.

    Args:
        schema: that of the built-in systems.
    """
    properties, kinds = schema["properties"], schema["$defs"]

    def numbers(words: str, each: dict[str, Any], **more: Any) -> dict[str, Any]:
        return {"description": words, "type": "object", "properties": {}, "additionalProperties": each, **more}

    file = {"description": OwnParameters.model_fields["file"].description, "type": "string"}
    parameter = {"description": "A parameter of the system", "type": "number"}
    start = {"description": "A coordinate NAME, or a velocity NAME_dot", "type": "number"}
    values = {
        "description": "Start, stop and count, or values",
        "oneOf": [{"$ref": f"#/$defs/{kind}"} for kind in ("Evenly", "Named")],
    }
    own = {
        "OwnSystem": numbers("A user's file, and its parameters", parameter)
        | {"properties": {"file": file}, "required": ["file"]},
        "OwnInitial": numbers("Start state of a user's system; what is not given is zero", start),
        "OwnSweep": numbers("The parameter that differs from lane to lane", values, minProperties=1, maxProperties=1),
    }
    properties["system"]["oneOf"].append({"$ref": "#/$defs/OwnSystem"})
    places = ("initial", "sweep")
    built_in = {place: {"$ref": properties[place].pop("$ref")} for place in places}
    users = {place: {"$ref": f"#/$defs/Own{place.capitalize()}"} for place in places}
    named = {"required": ["system"], "properties": {"system": {"required": ["file"]}}}
    return schema | {
        "$defs": kinds | own,
        "if": named,
        "then": {"properties": users},
        "else": {"properties": built_in},
    }
