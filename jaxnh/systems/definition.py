"""Common parts of systems defined by a function of their parameters: names, time, lanes' own values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxnh.systems.flow import Flow, ParameterRoles, Parameters
from jaxnh.systems.readout import UNSAID, Labels, Readout
from jaxnh.systems.tracing import Program

Definition = Mapping[str, Any]
"""Definition of a system: its equations of motion, `coordinates`, with a clock its `period`, without one if
wanted a `time_unit` that lengths of time are counted in, and where it has some, which of its names are `angles`; what
parameters and coordinates are called in words, `labels`, and their `units`, by name; where it is said, what takes
motions to motions backwards, `reversal` (see the module of this name)."""


class DefinedFlow(Flow):
    """A flow whose equations are those of a definition, made anew of the parameters of each lane.

    Attributes:
        define: parameters by name to the system's definition; called in every lane.
        values: all parameters by name; those that a lane has of its own replace them.
        of_lanes: names of the parameters that lanes may have of their own; None: of all.
        names: names of the coordinates that the definition has.
        angles: for each of them, whether it is an angle, which returns after 2π.
        clock: whether there is one.
    """

    define: Callable[..., Definition] = eqx.field(static=True)
    values: dict[str, ArrayLike]
    of_lanes: tuple[str, ...] | None = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    angles: tuple[bool, ...] = eqx.field(static=True)
    clock: bool = eqx.field(static=True)

    @property
    def parameters(self) -> Parameters:
        """All parameters by name."""
        return self.values

    @property
    def roles(self) -> ParameterRoles:
        """Lanes have those that are said; all of them share what decides the strobe period."""
        of_lanes = tuple(self.values) if self.of_lanes is None else self.of_lanes
        return ParameterRoles(of_lanes, tuple(self.parameters), self._decides_clock)

    def with_parameters(self, values: Parameters) -> DefinedFlow:
        """Return the flow with other values of some of its own parameters."""
        return replace(self, values={**self.values, **values})

    @property
    def period(self) -> float:
        """Strobe period, or the unit of time, from the definition."""
        return unit_of_time(self.define(**self.values))

    @property
    def autonomous(self) -> bool:
        """Return whether there is no clock."""
        return not self.clock

    def _decides_clock(self, name: str) -> bool:
        """Return whether the strobe period depends on a parameter."""
        return name in self.values and _decides_clock(self.define, self.values, name)

    def definition(self, p: Parameters) -> Definition:
        """The definition of a lane."""
        return self.define(**{**self.values, **p})

    def reversal(self, p: Parameters) -> Any:
        """The reversal that the definition of a lane says."""
        return self.definition(p).get("reversal")


@dataclass(frozen=True)
class DefinedReadout(Readout):
    """States of a system that a definition gives."""

    flow: DefinedFlow

    def labelled(self, kinds: Mapping[str, str], planes: tuple[tuple[str, str], ...]) -> Labels:
        """Labels from the definition's own `labels` and `units`; angles are in radians, iterates of a map counted.

        Args:
            kinds: of coordinates, by name: what each is called where the definition says nothing.
        """
        flow = self.flow
        definition = flow.define(**flow.values)
        said, units = definition.get("labels", {}), definition.get("units", {})
        kinds = {**dict.fromkeys(flow.values, "parameter"), **kinds}
        radians = {name: "rad" for name, angle in zip(flow.names, flow.angles, strict=True) if angle}
        counted = {} if flow.continuous else {"t": "1"}
        return Labels(
            {name: f"{said.get(name) or kind} {name}" for name, kind in kinds.items()},
            {name: units.get(name) or radians.get(name, UNSAID) for name in (*kinds, "t")} | counted,
            planes,
        )


def unit_of_time(definition: Mapping[str, Any]) -> float:
    """The period that a definition says; where it has no clock its unit of time, 1 unless it says."""
    return float(definition["period"] if "period" in definition else definition.get("time_unit", 1.0))


def _decides_clock(define: Callable[..., Definition], values: Mapping[str, ArrayLike], name: str) -> bool:
    """Return whether a parameter has a part in the period, or the unit of time, that a definition says.

    The definition is traced. Where it makes its period by functions of plain numbers alone, values near by are
    compared.
    """

    def clock(value: ArrayLike) -> Any:
        definition = define(**{**values, name: value})
        return jnp.asarray(definition.get("period", definition.get("time_unit", 1.0)), float)

    now = float(np.asarray(values[name]))
    try:
        traced = Program(clock, now)
    except Exception:
        near = (now + shift * (abs(now) or 1.0) for shift in (-1e-3, 1e-3))
        return len({unit_of_time(define(**{**values, name: value})) for value in (now, *near)}) > 1
    return traced.output_depends([1])


def marked(definition: Definition, kind: str) -> tuple[bool, ...]:
    """Flag the coordinates of a definition that are named among those of a kind."""
    return tuple(name in definition.get(kind, ()) for name in definition["coordinates"])
