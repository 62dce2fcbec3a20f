"""Stretches of motions that Newton for periodic orbits begins with: close returns, and random ones.

A motion that nearly comes back is near all points of a periodic orbit (Auerbach et al., Phys. Rev. Lett. 58 (1987)
2387); one that does not may lead to it all the same, by multiple shooting, and to others.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from jaxnh.systems.chart import Wrap

WINDOW = 16
"""Strobes of a window, in which the nearest return is taken."""


def nearest_returns(
    path: Float[np.ndarray, "lanes points d"],
    n: int,
    windows: int,
    size: Float[np.ndarray, "#lanes d"] | Float[np.ndarray, " d"],
    wrap: Wrap,
) -> Int[np.ndarray, "lanes windows"]:
    """Return of each window of each path the point after which it comes nearest, n points later, to where it was.

    Args:
        path: at least `windows` times `WINDOW` points, and n more.
        n: returns of the orbits that are sought.
        windows: number of windows.
        size: of the motion in each section coordinate, of all paths or of each.
        wrap: of differences of section coordinates.
    """
    count, size = windows * WINDOW, np.broadcast_to(size, (len(path), path.shape[2]))
    with np.errstate(invalid="ignore"):  # of paths that go to infinity
        gap = np.max(np.abs(wrap(path[:, n : n + count] - path[:, :count])) / size[:, None], axis=2)
    gap = np.where(np.isfinite(gap), gap, np.inf).reshape(len(path), windows, WINDOW)
    return np.argmin(gap, axis=2) + WINDOW * np.arange(windows)


def stretches(
    path: Float[np.ndarray, "lanes points d"], n: int, first: Int[np.ndarray, "lanes some"]
) -> tuple[Float[np.ndarray, "starts n d"], Int[np.ndarray, " starts"]]:
    """Return n points of paths from given ones on, and the number of the path of each; those that are finite."""
    lane = np.repeat(np.arange(len(path)), first.shape[1])
    points = path[lane[:, None], first.ravel()[:, None] + np.arange(n)]
    known = np.isfinite(points).all(axis=(1, 2))
    return points[known], lane[known]
