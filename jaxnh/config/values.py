"""Values by name in the content of a config: of parameters, of coordinates of the start, and of levels of integrals."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

Content = Mapping[str, Any]
"""A config as mappings, sequences, numbers and text."""


def without_values(content: Content, names: Collection[str]) -> dict[str, Any]:
    """Return a content that says nothing of these names in `system` and `initial`, for what is an axis instead."""
    cut = dict(content)
    for block in ("system", "initial"):
        if block in cut:
            cut[block] = {key: value for key, value in (cut[block] or {}).items() if key not in names}
    if level := cut.get("initial", {}).pop("level", None):
        left = {name: value for name, value in level.items() if name not in names}
        cut["initial"] |= {"level": left} if left else {}
    return cut


def with_values(
    content: Content, values: Mapping[str, float], coordinates: Collection[str], integrals: Collection[str]
) -> dict[str, Any]:
    """Return a content with other values.

    Args:
        content: of a config.
        values: by name.
        coordinates: names of those of the start state.
        integrals: names of those that starts are put on a level of; all other names are parameters.
    """
    changed = dict(content)
    for name, value in values.items():
        block = "initial" if name in (*coordinates, *integrals) else "system"
        given = changed.get(block) or {}
        new = {"level": {**(given.get("level") or {}), name: value}} if name in integrals else {name: value}
        changed[block] = {**given, **new}
    return changed


def grid_of(values: ArrayLike) -> dict[str, Any]:
    """Return values of an axis as a config has them; anything else as it is, for the config to refuse."""
    try:
        given = np.atleast_1d(np.asarray(values, float))
    except (TypeError, ValueError):
        return {"values": values}
    if given.ndim == 1 and len(given) > 2 and np.isfinite(given).all() and given[0] != given[-1]:
        grid = {"start": float(given[0]), "stop": float(given[-1]), "count": len(given)}
        if np.array_equal(given, np.linspace(*grid.values())):
            return grid
    return {"values": given.tolist()}
