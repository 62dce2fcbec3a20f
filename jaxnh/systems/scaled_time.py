"""Right-hand sides in time over the period, τ = t/T: a period that depends on parameters is then one of them.

dy/dτ = T f(y, Tτ) has the period 1 for every T, and the same strobe map, multipliers and bifurcations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from jaxnh.systems.definition import Definition


def in_periods(define: Callable[..., Definition]) -> Callable[..., Definition]:
    """Return the definition of a right-hand side, `rhs` and `period`, in time over the period."""

    def in_periods_of(**p: Any) -> Mapping[str, Any]:
        definition = define(**p)
        period, rhs = definition["period"], definition["rhs"]
        scaled = {name: _in_shares(period, each) for name, each in definition.get("observables", {}).items()}
        more = {"time_unit_of_rates": period, **({"observables": scaled} if scaled else {})}
        rates = _in_shares(period, rhs)
        return {**definition, **more, "period": 1.0, "rhs": lambda y, t: tuple(period * rate for rate in rates(y, t))}

    return in_periods_of


def _in_shares(period: Any, function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of (y, t) at times that are shares of a period."""
    return lambda y, share: function(y, period * share)
