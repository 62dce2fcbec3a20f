"""Right-hand sides in time over the period, τ = t/T: a period that depends on parameters is then one of them.

dy/dτ = T f(y, Tτ) has the period 1 for every T, and the same strobe map, multipliers and bifurcations. Walls and
surfaces are those of y and Tτ.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from jaxnh.systems.definition import Definition

_IN_TIME = {"jumps": ("when", "then"), "switches": ("on",)}
"""Functions of (y, t) of each event."""


def in_periods(define: Callable[..., Definition]) -> Callable[..., Definition]:
    """Return the definition of a right-hand side, `rhs` and `period`, in time over the period."""

    def in_periods_of(**p: Any) -> Mapping[str, Any]:
        definition = define(**p)
        period, rhs = definition["period"], definition["rhs"]

        def scaled(function: Callable[..., Any]) -> Callable[..., Any]:
            """A function of (y, t, …) at times that are shares of a period."""
            return lambda y, share, *rest: function(y, period * share, *rest)

        more: dict[str, Any] = {"time_unit_of_rates": period, "period": 1.0}
        if "observables" in definition:
            more["observables"] = {name: scaled(each) for name, each in definition["observables"].items()}
        for kind, names in _IN_TIME.items():
            if kind in definition:
                events = definition[kind]
                more[kind] = tuple({**event, **{name: scaled(event[name]) for name in names}} for event in events)
        if "heights" in definition:
            more["heights"] = scaled(definition["heights"])
        rates = scaled(rhs)
        return {**definition, **more, "rhs": lambda y, t, *sides: tuple(period * rate for rate in rates(y, t, *sides))}

    return in_periods_of
