"""Outputs of mechanical systems on request: energies and their rates, powers, multipliers, forces of contact.

They are computed of states that there are, and are no part of any motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.jourdain import accelerations, constraint_slopes
from jaxnh.systems.lagrangian import Lagrangian
from jaxnh.systems.state import Number, State
from jaxnh.systems.switched_mechanics import SwitchedMechanics

_RATE = "_rate"
_ENERGY = {"kinetic_energy": "kinetic energy T"}
_POWERS = {"power": "power of the forces Q", "constraint_power": "power of the forces of the constraints"}


def output_names(flow: Flow) -> dict[str, tuple[str, ...]]:
    """Outputs that a flow can be asked for: names of the variables that each stands for; none of other flows."""
    if not isinstance(flow, Lagrangian | SwitchedMechanics):
        return {}
    definition = flow.definition({})
    swept = flow.level if isinstance(flow, Lagrangian) and flow.level in flow.roles.of_lanes else None
    energies = (*_ENERGY, *(name for name in definition.get("integrals", ()) if name != swept))
    names = (*energies, *(f"{name}{_RATE}" for name in energies), "power", *definition.get("outputs", ()))
    outputs: dict[str, tuple[str, ...]] = {name: (name,) for name in names}
    count = _constraint_count(flow)
    if count:
        outputs["constraint_power"] = ("constraint_power",)
        outputs["multipliers"] = tuple(f"lambda_{number + 1}" for number in range(count))
    return outputs


def describe_output(flow: Flow, name: str) -> tuple[str, str]:
    """Words and unit of a variable of an output, "" where nobody says it."""
    assert isinstance(flow, Lagrangian | SwitchedMechanics)
    definition = flow.definition({})
    said, unit = definition.get("labels", {}), definition.get("units", {}).get(name, "")
    if name.startswith("lambda_"):
        return f"multiplier of constraint {name.removeprefix('lambda_')}", unit
    base = name.removesuffix(_RATE)
    kind = "integral" if base in definition.get("integrals", {}) else "output"
    words = said.get(name) or (_ENERGY | _POWERS).get(base) or f"{kind} {base}"
    return (words if base == name else f"rate of the {words}"), unit


def evaluate_outputs(flow: Flow, t: ArrayLike, y: State, p: Parameters, names: Sequence[str]) -> tuple[Number, ...]:
    """Values of variables of outputs at the states of one lane, of any one shape (...,).

    Args:
        t: times, which repeat along the last axis.
        names: of the variables.
    """
    shape = jnp.shape(jax.tree.leaves(y)[0])
    points = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, shape).ravel(), (jnp.asarray(t, float), y))
    values = jax.vmap(lambda t, y: _at_state(flow, t, y, p, names))(*points)
    return tuple(value.reshape(shape) for value in values)


def _at_state(flow: Any, t: Number, y: State, p: Parameters, names: Sequence[str]) -> tuple[Number, ...]:
    equations, q, v, active = flow.motion_at(t, y, p)
    definition, solved = flow.definition(p), accelerations(equations, q, v, t, active)
    rates = equations.rates(q, v, t)
    functions: dict[str, Callable[..., Number]] = {"kinetic_energy": definition["T"], **definition.get("integrals", {})}

    def value(name: str) -> Number:
        if name in definition.get("outputs", {}):
            return definition["outputs"][name](q, v, t, solved.multipliers)
        if name in functions:
            return functions[name](q, v, t)
        if name.startswith("lambda_"):
            return solved.multipliers[int(name.removeprefix("lambda_")) - 1]
        if name == "power":
            return sum(force * rate for force, rate in zip(equations.Q(q, v, t), v, strict=True))
        if name == "constraint_power":
            slopes = constraint_slopes(equations, (*q, *v, t), len(q))
            each = zip(solved.multipliers, slopes, strict=True)
            return sum(x * sum(a * rate for a, rate in zip(row, v, strict=True)) for x, row in each)
        return jax.jvp(functions[name.removesuffix(_RATE)], (q, v, t), (rates, solved.a, jnp.ones_like(t)))[1]

    return tuple(jnp.asarray(value(name), float) for name in names)


def _constraint_count(flow: Lagrangian | SwitchedMechanics) -> int:
    """Number of multipliers."""
    definition = flow.definition({})
    k, n = len(definition["coordinates"]), len(definition.get("quasi_velocities", definition["coordinates"]))
    zeros = ((0.0,) * k, (0.0,) * n, 0.0)
    every = [definition.get("f"), *(each["constraint"] for each in definition.get("constraints", ()))]
    return sum(len(jax.eval_shape(lambda *at, f=f: tuple(f(*at)), *zeros)) for f in every if f is not None)
