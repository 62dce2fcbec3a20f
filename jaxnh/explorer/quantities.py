"""Quantities that a plane can show, a number a lane, and their analyses: in full, and shortened for a first look."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jaxnh.analyses.options.base import BLOCKS

OF_LANES = ("lyapunov", "period", "verdict", "chaos01")
"""Analyses whose lanes are by themselves, in the order that they are offered in."""

BASINS = "basins"
"""The one whose lanes are numbered by what all of them come to."""

_SHORT: Mapping[str, Mapping[str, Any]] = {
    "lyapunov": {"transient": 16, "periods": BLOCKS, "error": 0.0, "method": "averages"},
    "period": {"transient": 16, "max_period": 8},
    "chaos01": {"transient": 16, "periods": 128},
    "verdict": {"confirmation_factor": 0},
}

Options = Mapping[str, Mapping[str, Any]]
"""Analyses with their options."""


def analyses_of(quantity: str, own: Mapping[str, Mapping[str, Any] | None]) -> Options:
    """Options that compute a quantity in full: the options of a config, of exponents the largest alone.

    Args:
        own: analyses of the config.
    """
    if quantity == "lyapunov":
        return {quantity: {**(own.get(quantity) or {}), "exponents": 1}}
    names = ("period", "lyapunov", "chaos01", quantity) if quantity == "verdict" else (quantity,)
    return {name: own.get(name) or {} for name in names}


def shortened(analyses: Options) -> Options:
    """Options that compute a first look: fewer periods of each analysis."""
    return {name: {**options, **_SHORT[name]} for name, options in analyses.items()}
