"""Probes of the surfaces of a field: whether its branches differ there, and whether they push motions towards it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

_NEWTON_STEPS = 40  # to a surface
_BESIDE = 0.01  # so far from it branches are compared
_ALIKE = 1e-9  # of their size: the difference of two branches that are one function


def probe_surfaces(
    heights: Callable[[np.ndarray], tuple[Any, list[Any]]],
    rates: Callable[[tuple[Any, ...], tuple[Any, ...]], list[Any]],
    z: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return which surfaces are reached, have a part there, may be slid along, and push, (surfaces,).

    Args:
        heights: of states and times, above all surfaces, and their slopes.
        rates: of states and times, by sides.
        z: states and times that go to the surfaces, (d + 1, probes, surfaces).
    """
    each = np.arange(z.shape[-1])

    def above(z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Heights (surfaces, probes, surfaces); that above the surface that is gone to, and its slopes."""
        height, slopes = heights(z)
        height, slopes = np.asarray(height), np.stack([np.asarray(slope)[each, :, each].T for slope in slopes])
        return height, height[each, :, each].T, slopes

    for _ in range(_NEWTON_STEPS):
        _, height, slopes = above(z)
        z = z - height * slopes / np.maximum(np.sum(slopes**2, axis=0), 1e-300)
    _, height, slopes = above(z)
    reached = np.abs(height) < _ALIKE
    normal = _BESIDE * slopes / np.sqrt(np.maximum(np.sum(slopes**2, axis=0), 1e-300))

    def branches(z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The side of a surface that is gone to; the field of that side and of the other, (d, probes, surfaces)."""
        own = np.where(above(z)[0] >= 0.0, 1.0, -1.0)
        other = own * np.where(each[:, None] == each, -1.0, 1.0)[:, None, :]
        first, second = (np.stack(np.broadcast_arrays(*rates(tuple(z), tuple(side)))) for side in (own, other))
        return own[each, :, each].T, first, second

    below, on, upon = (branches(z + shift * normal) for shift in (-1.0, 0.0, 1.0))
    differs = _differ(*below[1:]) | _differ(*upon[1:])
    gain = on[0] * np.sum(slopes[:-1] * (on[1] - on[2]), axis=0)  # of the height's rate, from below to above
    size = np.sum(np.abs(slopes[:-1]) * np.maximum(np.abs(on[1]), np.abs(on[2])), axis=0)
    push = np.sum(np.abs(slopes[:-1] * (on[1] - on[2])), axis=0)
    seen = below[0] != upon[0], gain < -_ALIKE * size, push > _ALIKE * size
    return (
        np.any(reached, axis=0),
        np.any(reached & seen[0] & differs, axis=0),
        *(np.any(reached & each, axis=0) for each in seen[1:]),
    )


def _differ(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return whether two fields (components, ...) differ, or none of them is finite."""
    finite = np.isfinite(first) & np.isfinite(second)
    size = np.max(np.where(finite, np.maximum(np.abs(first), np.abs(second)), 0.0), axis=0)
    return np.any(np.where(finite, np.abs(first - second), np.inf) > _ALIKE * size, axis=0)
