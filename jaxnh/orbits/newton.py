"""Periodic orbits of the return map: Newton for many lanes at once, near a doubling too.

Host code: what it asks of a device is Pⁿ and ∂Pⁿ/∂u at points of some lanes. Which lanes take another step is decided
here, and their small linear systems are solved here: written out for a device they would be most of a program.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Protocol

import numpy as np
from jaxtyping import Float, Int

from jaxnh.maps.iterate import Derivatives
from jaxnh.systems.chart import Wrap
from jaxnh.systems.rows import select

NEWTON_STEPS = 12
# Residuals and steps in sizes of the motion.
NEWTON_TOLERANCE = 1e-9  # residual after which one more step reaches the rounding floor
LAST_STEP = (
    1e-8  # length of a step after which the next one does: beside a bifurcation small residuals are no such sign
)
LARGEST_STEP = 0.25
PATIENCE, NEAR = 4, 1e-2  # after so many steps a lane with a residual above this is given up
# Gauss–Lobatto rule of five points on [−1, 1], exact to degree 7.
_NODES = np.array([-1.0, -math.sqrt(3 / 7), 0.0, math.sqrt(3 / 7), 1.0])
_WEIGHTS = np.array([0.1, 49 / 90, 32 / 45, 49 / 90, 0.1])
_DOUBLED_STEPS = 16
_LOST = np.errstate(over="ignore", divide="ignore", invalid="ignore")  # lanes that go to infinity show it by numbers


class Orbit(NamedTuple):
    """Points of periodic orbits, one a lane.

    Attributes:
        u: section coordinates, shape (lanes, d).
        residual: largest component of Pⁿ(u) − u, in the sizes of the motion that Newton was given, (lanes,).
        monodromy: ∂Pⁿ/∂u, shape (lanes, d, d).
        steps: Newton steps taken, (lanes,).
    """

    u: Any
    residual: Any
    monodromy: Any
    steps: Any


class Images(Protocol):
    """Pⁿ and ∂Pⁿ/∂u of lanes, each with an n of its own: `derivatives` over some of them."""

    def __call__(self, u: Float[np.ndarray, "points d"], lane: Int[np.ndarray, " points"], /) -> Derivatives:
        """Evaluate at points of the lanes with these numbers, one or several of a lane."""
        ...


@_LOST
def find_orbits(
    images: Images, u: Float[np.ndarray, "lanes d"], size: Float[np.ndarray, "lanes d"], wrap: Wrap
) -> Orbit:
    """Newton on Pⁿ(u; p) = u for many lanes at once, from their points u; lanes that are done wait for no others.

    A lane that does not converge shows it by its residual (NaN where its state is not finite). Newton does not care
    whether the orbit is stable, nor how slowly the map itself would approach it.

    Args:
        images: Pⁿ and its derivative.
        u: where to begin.
        size: of the motion in each section coordinate: what is near is so in these units.
        wrap: of differences of section coordinates.
    """
    (lanes, d), u = u.shape, np.array(u)
    residual, monodromy, missing = np.full(lanes, np.nan), np.full((lanes, d, d), np.nan), np.zeros((lanes, d))
    steps, last, open_ = np.zeros(lanes, np.int32), np.zeros(lanes, np.bool_), np.arange(lanes)
    while len(open_):
        image, monodromy[open_], _ = images(u[open_], open_)
        missing[open_] = wrap(u[open_] - image)
        residual[open_] = np.max(np.abs(missing[open_] / size[open_]), axis=1)
        hopeless = (steps >= PATIENCE) & (residual > NEAR)
        unfinished = ~last & (steps < NEWTON_STEPS) & np.isfinite(residual) & ~hopeless
        open_ = open_[unfinished[open_]]
        step = solve(monodromy[open_] - np.eye(d), missing[open_])
        solved = np.all(np.isfinite(step), axis=1)  # with a multiplier of exactly one there is no step: the point stays
        open_, step = open_[solved], step[solved]
        length = np.max(np.abs(step / size[open_]), axis=1)
        last[open_] = (residual[open_] < NEWTON_TOLERANCE) & (length < LAST_STEP)
        u[open_] += step * np.where(length > LARGEST_STEP, LARGEST_STEP / length, 1.0)[:, None]
        steps[open_] += 1
    return Orbit(u, residual, monodromy, steps)


class _Branches(NamedTuple):
    """Newton's unknowns of `find_doubled`, lane by lane: two points m ± a v, and a²."""

    m: Float[np.ndarray, "lanes d"]
    v: Float[np.ndarray, "lanes d"]
    square: Float[np.ndarray, " lanes"]


class _Bending(NamedTuple):
    """Second and third derivatives along the first line, by differences, and the direction v is normalised with."""

    bend: Float[np.ndarray, "lanes d d"]
    cubic: Float[np.ndarray, "lanes d"]
    normal: Float[np.ndarray, "lanes d"]


@_LOST
def find_doubled(
    images: Images, u: Float[np.ndarray, "lanes d"], size: Float[np.ndarray, "lanes d"], wrap: Wrap
) -> Orbit:
    """Orbits of period 2n near the doublings that they were born in, from points of them that `find_orbits` gives.

    There P²ⁿ(u) = u has three roots that grow together, the orbits of period 2n and n: a residual of 10⁻⁹ is an error
    of 10⁻³ in u, and rounding alone leaves ε/√(1 − μ) in the multiplier. With Q = Pⁿ and the two points m ± a v of the
    orbit, ℓ·v = 1, the orbit of period n is divided out:

        ½ (Q(m + a v) + Q(m − a v)) = m,    A v = −v,  A = ½ ∫ DQ(m + a t v) dt over [−1, 1],

    since Q(m + a v) − Q(m − a v) = 2a A v. Both depend on a through a² alone, and Newton in (m, v, a²) is regular at
    a = 0, so that a² and with it 1 − μ are right to rounding. The integral is a Gauss–Lobatto sum, wrong by O(a⁸): for
    small a. Of the second and third derivatives, which only the steps need, finite differences over the first a do.

    Args:
        images: Q and its derivative, of half the period.
        u: where to begin.
        size: of the motion in each section coordinate: all is solved in these units.
        wrap: of differences of section coordinates.

    Returns:
        The orbits of period 2n; the residual is infinite where Newton has not settled.
    """

    def on_lines(lane: Int[np.ndarray, " some"], m: np.ndarray, way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Q − m in units of the sizes, and DQ likewise, at the nodes of lines from m − way to m + way: (some, 5, …)."""
        nodes = m[:, None] + _NODES[:, None] * (way * size[lane])[:, None]
        at = images(nodes.reshape(-1, d), np.repeat(lane, len(_NODES)))
        image, matrices = np.asarray(at.image), np.asarray(at.monodromy)
        moved = wrap(image.reshape(nodes.shape) - m[:, None]) / size[lane][:, None]
        units = size[lane][:, None, :] / size[lane][:, :, None]
        return moved, matrices.reshape(*nodes.shape, d) * units[:, None]

    (lanes, d), open_ = u.shape, np.arange(len(u))
    half = 0.5 * wrap(u - images(u, open_).image) / size
    first = np.linalg.norm(half, axis=1, keepdims=True)
    at = _Branches(u - size * half, half / first, first[:, 0] ** 2)
    _, around = on_lines(open_, at.m, half)
    bend = (around[:, -1] - around[:, 0]) / (2.0 * first[..., None])
    known = _Bending(bend, matvec(_mean(around) - around[:, 2], at.v) / first**2, at.v.copy())
    length, settled, steps = np.full(lanes, np.inf), np.zeros(lanes, np.bool_), np.zeros(lanes, np.int32)
    for _ in range(_DOUBLED_STEPS):
        branches, bent = select((at, known), open_)
        step = _doubled_step(branches, bent, *on_lines(open_, branches.m, _amplitude(branches)))
        moved = branches.square + step[:, -1]
        at.m[open_] += size[open_] * step[:, :d]
        at.v[open_] += step[:, d:-1]
        at.square[open_] = np.where(moved > 0.0, moved, branches.square / 16)
        before, length[open_] = length[open_], np.max(np.abs(step), axis=1)
        steps[open_] += 1
        settled[open_] = length[open_] < NEWTON_TOLERANCE
        open_ = open_[~(settled[open_] & (length[open_] >= 0.25 * before)) & ~np.isnan(length[open_])]
        if not len(open_):
            break
    u = at.m + size * _amplitude(at)
    once = images(u, every := np.arange(lanes))
    twice = images(np.asarray(once.image), every)
    residual = np.max(np.abs(wrap(np.asarray(twice.image) - u) / size), axis=1)
    return Orbit(u, np.where(settled, residual, np.inf), twice.monodromy @ once.monodromy, steps)


def _doubled_step(
    at: _Branches, known: _Bending, moved: Float[np.ndarray, "some 5 d"], matrices: Float[np.ndarray, "some 5 d d"]
) -> Float[np.ndarray, "some 2d+1"]:
    """Newton's step in (m, v, a²), from Q − m and DQ at the nodes of the line."""
    (count, d), identity = at.v.shape, np.eye(at.v.shape[1])
    ends, whole = 0.5 * (matrices[:, 0] + matrices[:, -1]), _mean(matrices)
    system, missing = np.zeros((count, 2 * d + 1, 2 * d + 1)), np.zeros((count, 2 * d + 1))
    system[:, :d, :d], missing[:, :d] = ends - identity, 0.5 * (moved[:, 0] + moved[:, -1])
    system[:, :d, d:-1] = at.square[:, None, None] * known.bend
    system[:, :d, -1] = 0.5 * matvec(known.bend, at.v)
    system[:, d:-1, :d], system[:, d:-1, d:-1] = known.bend, whole + identity
    system[:, d:-1, -1], missing[:, d:-1] = known.cubic, matvec(whole, at.v) + at.v
    system[:, -1, d:-1], missing[:, -1] = known.normal, np.sum(known.normal * at.v, axis=1) - 1.0
    return solve(system, -missing)


def _amplitude(at: _Branches) -> Float[np.ndarray, "lanes d"]:
    """Return a v."""
    return np.sqrt(at.square)[:, None] * at.v


def matvec(matrices: Float[np.ndarray, "... d d"], vectors: Float[np.ndarray, "... d"]) -> Float[np.ndarray, "... d"]:
    """Products of matrices and vectors, one each."""
    return (matrices @ vectors[..., None])[..., 0]


def _mean(matrices: Float[np.ndarray, "lanes 5 d d"]) -> Float[np.ndarray, "lanes d d"]:
    """Mean over lines of matrices at their nodes."""
    return 0.5 * np.tensordot(matrices, _WEIGHTS, axes=(1, 0))


def solve(matrices: Float[np.ndarray, "lanes n n"], right: Float[np.ndarray, "lanes n"]) -> np.ndarray:
    """Solutions of small linear systems, one a lane; not numbers where a matrix is singular."""
    try:
        return np.linalg.solve(matrices, right[..., None])[..., 0]
    except np.linalg.LinAlgError:
        if len(matrices) == 1:
            return np.full_like(right, np.nan)
        each = [solve(matrix[None], vector[None]) for matrix, vector in zip(matrices, right, strict=True)]
        return np.concatenate(each)
