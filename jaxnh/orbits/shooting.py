"""Periodic orbits by multiple shooting: all their points at once, so that no error grows over more than a period.

Only derivatives of one period are asked for, and no product of monodromy matrices is formed. Lane functions are pure;
the solution of the large systems is host code.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Bool, Float

from jaxnh.maps.iterate import Derivatives
from jaxnh.orbits import cyclic
from jaxnh.systems.chart import Wrap
from jaxnh.systems.rows import write_rows

_NEWTON_STEPS = 12
_NEWTON_TOLERANCE = 1e-9  # step, in sizes of the orbit, after which the points are known to rounding
_ZERO = 1e-280  # coordinates that are zero: what Newton does below may have lost its digits
_CONTRACTION = 0.5  # of successive steps; Newton that contracts less is on its way to somewhere else
_FAR_STEPS = 40
_LARGEST_STEP = 0.25  # sizes of the motion
_NEAR = 1e-3  # step, likewise, after which `close_orbits` goes on


class Period(Protocol):
    """P and ∂P/∂u of lanes: `derivatives` of one period."""

    def __call__(self, u: Float[np.ndarray, "lanes d"], values: Float[np.ndarray, " lanes"], /) -> Derivatives:
        """Evaluate at points and values of the parameter, a lane each."""
        ...


class ShootingOrbits(NamedTuple):
    """Orbits of n points by multiple shooting, one a node of the parameter.

    Attributes:
        points: section coordinates, (nodes, n, d).
        blocks: ∂P/∂u at each of them, (nodes, n, d, d).
        residual: largest component of P(u_i) − u_{i+1}, (nodes,).
        converged: whether Newton has come to rest, (nodes,).
    """

    points: Float[np.ndarray, "nodes n d"]
    blocks: Float[np.ndarray, "nodes n d d"]
    residual: Float[np.ndarray, " nodes"]
    converged: Bool[np.ndarray, " nodes"]


def close_orbits(
    period: Period,
    points: Float[np.ndarray, "nodes n d"],
    values: Float[np.ndarray, " nodes"],
    wrap: Wrap,
) -> ShootingOrbits:
    """Newton on P(u_i; p) = u_{i+1} around the orbits of all nodes at once; nodes that have come to rest drop out.

    Only nodes where each step is at most half of the one before come to rest: their orbit is the one that the starting
    points belong to. Angles go on from those of the starting points.

    Args:
        period: P and ∂P/∂u over lanes.
        points: starting points.
        values: of the parameter.
        wrap: of differences of section coordinates.
    """
    nodes, n, d = points.shape
    orbits = ShootingOrbits(
        np.array(points), np.full((nodes, n, d, d), np.nan), np.full(nodes, np.nan), np.zeros(nodes, np.bool_)
    )
    size, open_ = np.full(nodes, np.inf), np.arange(nodes)
    size_of_orbit = np.maximum(np.abs(orbits.points).max(axis=(1, 2)), _ZERO)  # an orbit at zero has no size of its own
    for step in range(_NEWTON_STEPS + 1):
        points_now = orbits.points[open_]
        at = period(points_now.reshape(-1, d), np.repeat(values[open_], n))
        missing = wrap(np.roll(points_now, -1, 1) - np.asarray(at.image).reshape(points_now.shape))
        blocks = np.asarray(at.monodromy).reshape(*points_now.shape, d)
        orbits.blocks[open_], orbits.residual[open_] = blocks, np.abs(missing).max(axis=(1, 2))
        finite = np.isfinite(blocks).all(axis=(1, 2, 3)) & np.isfinite(orbits.residual[open_])
        at_rest = size[open_] <= _NEWTON_TOLERANCE * np.maximum(
            np.abs(points_now).max(axis=(1, 2)), size_of_orbit[open_]
        )
        orbits.converged[open_] = finite & at_rest
        left = finite & ~at_rest
        if step == _NEWTON_STEPS or not left.any():
            break
        moved = _newton_steps(blocks[left], missing[left])
        length = np.abs(moved).max(axis=(1, 2))
        contracts = length <= _CONTRACTION * size[open_[left]]
        open_ = open_[left][contracts]
        size[open_] = length[contracts]
        if not len(open_):
            break
        orbits.points[open_] += moved[contracts]
    return orbits


def orbits_from_afar(
    period: Period,
    points: Float[np.ndarray, "nodes n d"],
    values: Float[np.ndarray, " nodes"],
    size: Float[np.ndarray, "#nodes d"] | Float[np.ndarray, " d"],
    wrap: Wrap,
) -> ShootingOrbits:
    """`close_orbits` from points that may be far from any orbit: short steps of Newton first, wherever they lead.

    Args:
        period, points, values, wrap: as there.
        size: of the motion in each section coordinate, in which steps are short; of all nodes, or of each.
    """
    (nodes, n, d), points = points.shape, np.array(points)
    size = np.broadcast_to(size, (nodes, d))
    open_, near = np.arange(nodes), np.zeros(nodes, bool)
    for _ in range(_FAR_STEPS):
        active = points[open_]
        at = period(active.reshape(-1, d), np.repeat(values[open_], n))
        missing = wrap(np.roll(active, -1, 1) - np.asarray(at.image).reshape(active.shape))
        blocks = np.asarray(at.monodromy).reshape(*active.shape, d)
        finite = np.isfinite(missing).all(axis=(1, 2)) & np.isfinite(blocks).all(axis=(1, 2, 3))
        open_, missing, blocks = open_[finite], missing[finite], blocks[finite]
        if not len(open_):
            break
        step = _newton_steps(blocks, missing)
        length = np.abs(step / size[open_, None]).max(axis=(1, 2))
        with np.errstate(divide="ignore", invalid="ignore"):
            points[open_] += np.minimum(1.0, _LARGEST_STEP / length)[:, None, None] * step
        near[open_] = length < _NEAR
        open_ = open_[~near[open_] & np.isfinite(length)]
        if not len(open_):
            break
    whole = ShootingOrbits(points, np.full((nodes, n, d, d), np.nan), np.full(nodes, np.nan), np.zeros(nodes, np.bool_))
    if not near.any():
        return whole
    orbits = close_orbits(period, points[near], values[near], wrap)
    write_rows(whole, near, orbits)
    return whole


def _newton_steps(
    blocks: Float[np.ndarray, "nodes n d d"], missing: Float[np.ndarray, "nodes n d"]
) -> Float[np.ndarray, "nodes n d"]:
    """Return Newton's steps; not numbers where a multiplier is exactly one, and the orbit is not isolated."""
    there = np.broadcast_to(-np.eye(blocks.shape[-1]), blocks.shape)
    try:
        return cyclic.solve(cyclic.eliminate(blocks, there), missing)
    except np.linalg.LinAlgError:
        if len(blocks) == 1:
            return np.full_like(missing, np.nan)
        half = len(blocks) // 2
        parts = (slice(None, half), slice(half, None))
        return np.concatenate([_newton_steps(blocks[part], missing[part]) for part in parts])
