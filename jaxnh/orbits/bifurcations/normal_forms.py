"""Criticality of bifurcations: the cubic coefficient of the normal form, by differences of derivatives. Host code.

With the critical vector q_i around the orbit, M_i q_i = q_{i+1} and q_n = z q_0, and r_i its left counterpart,
r_{i+1} M_i = r_i and r_n q_n = 1, an amplitude x grows in a turn by the factor z (1 + s |x|²), with

    s = Σ r_{i+1} (½ C(q, q, q̄) + B(q, w) + ½ B(q̄, v)),   w_{i+1} = M_i w_i + B(q, q̄),   v_{i+1} = M_i v_i + B(q, q),

w_n = w_0 and v_n = z² v_0, for a pair of complex z; a third of it for z = ±1 (Kuznetsov, Elements of Applied
Bifurcation Theory, 2004, 5.4). Where the real part of s is negative the bifurcation is supercritical. Of an equilibrium
it is the same with M = 1 + A and z = 1 + iω. B and C are differences of ∂P/∂u at u ± h Re q and u ± h Im q. With h
and with 2h they are wrong by h², both together by h⁴: by less than how far that is from the same of 2h and 4h.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int

from jaxnh.orbits import cyclic
from jaxnh.orbits.bifurcations.location import critical
from jaxnh.orbits.continuation.arclength import CurveOrbits, Family, PathVector, length
from jaxnh.orbits.continuation.kinds import BRANCH_POINT, DOUBLING, FOLD, eigenvalues
from jaxnh.orbits.newton import matvec

CRITICALITIES = ("subcritical", "none", "supercritical")
"""Signs of −s: −1, 0 where it is not known or there is none, 1."""

_SHIFT = 1e-3  # h, in sizes of the motion
_ROUNDINGS = 8.0  # of ∂P/∂u, whose operations are many
_REAL = {DOUBLING: -1.0, BRANCH_POINT: 1.0}  # z
_COVER = 4.0  # the change with twice the h times this covers the error in 96 of 100 where roundings, as normal, are it
_DEFECTIVE = 1e-6  # r_n q_n: a double multiplier with one vector, as of conservative flows, has no such normal form
_CERTAIN = 2.0  # the sign of a coefficient is known where it is so many times its error


class Cubic(NamedTuple):
    """Cubic coefficients.

    Attributes:
        coefficient: real part of s, in sizes of the motion, (some,); of a fold NaN.
        error: of it, by the change with twice the h and by the roundings of derivatives, (some,).
        criticality: −1, 0 or 1, (some,).
        vectors: q of length one, at each point of the orbit, in sizes of the motion, (some, n, d).
    """

    coefficient: Float[np.ndarray, " some"]
    error: Float[np.ndarray, " some"]
    criticality: Int[np.ndarray, " some"]
    vectors: Complex[np.ndarray, "some n d"]


def cubic(family: Family, orbits: CurveOrbits, kind: Int[np.ndarray, " some"]) -> Cubic:
    """The cubic coefficient of bifurcations of these kinds (numbers in `KINDS`)."""
    none = np.full(len(kind), np.nan)
    result = Cubic(none, none.copy(), np.zeros(len(kind), int), np.zeros(orbits.points.shape, complex))
    for each in set(kind.tolist()) - {FOLD}:
        subset, real = np.flatnonzero(kind == each), each in _REAL
        at_points = orbits.take(subset)
        if real:
            z = np.full(len(subset), _REAL[each], complex)
        else:
            z = critical(family, eigenvalues(family, at_points))
            z = 1.0 + 1j * np.imag(z) if family.field else z / np.abs(z)
        known = np.isfinite(z)
        subset, at_points, z = subset[known], at_points.take(known), z[known]
        q = _normal(family, _null(at_points.blocks, z, real))
        result.vectors[subset] = q
        simple = np.abs(_pairing(family, at_points.blocks, q, _left(at_points.blocks, z, real))) > _DEFECTIVE
        subset, at_points, z, q = subset[simple], at_points.take(simple), z[simple], q[simple]
        if not len(subset):
            continue
        parts = (np.real(q),) if real else (np.real(q), np.imag(q))
        moved = _moved_blocks(family, at_points, parts)
        plain = [_coefficient(family, at_points, q, z, real, 2.0**k * _SHIFT, moved[:, k]) for k in range(3)]
        first, two = (near + (near - far) / 3.0 for near, far in itertools.pairwise(plain))
        result.coefficient[subset] = first
        result.error[subset] = _COVER * np.abs(two - first) + _rounding(family, at_points.blocks, q, z, real)
    with np.errstate(invalid="ignore"):
        sure = np.abs(result.coefficient) > _CERTAIN * result.error
    result.criticality[sure] = -np.sign(result.coefficient[sure]).astype(int)
    return result


def _normal(family: Family, q: Complex[np.ndarray, "some n d"]) -> Complex[np.ndarray, "some n d"]:
    """Vectors of length one."""
    none = np.zeros(len(q))
    parts = (length(family, PathVector(part * family.size, none)) for part in (np.real(q), np.imag(q)))
    return q / np.sqrt(sum(part**2 for part in parts))[:, None, None]


def _coefficient(
    family: Family,
    orbits: CurveOrbits,
    q: np.ndarray,
    z: Complex[np.ndarray, " some"],
    real: bool,
    h: float,
    moved: Float[np.ndarray, "parts 2 some n d d"],
) -> Float[np.ndarray, " some"]:
    """Real part of s with differences of derivatives at points moved by ±h along the real and imaginary parts of q."""
    blocks, left = orbits.blocks, _left_vectors(family, orbits.blocks, q, z, real)
    first, second = np.zeros(blocks.shape, complex), np.zeros(blocks.shape)
    for factor, (ahead, behind) in zip((1.0, 1j), moved, strict=False):
        first = first + factor * (ahead - behind) / (2.0 * h)  # B(q, ·)
        second = second + (ahead - 2.0 * blocks + behind) / h**2  # C(q, q̄, ·)
    back = np.conj(first)
    if real:
        v = w = _real_response(blocks, left, np.real(matvec(first, q)), bool(np.all(np.real(z) > 0.0)))
    else:
        w = _response(blocks, matvec(back, q), np.ones_like(z))
        v = _response(blocks, matvec(first, q), 2.0 * z - 1.0 if family.field else z * z)
    g = 0.5 * matvec(second, q) + matvec(first, w) + 0.5 * matvec(back, v)
    return np.real(np.sum(left * g, axis=(1, 2))) * (1 / 3 if real else 1.0)


def _left_vectors(
    family: Family, blocks: np.ndarray, q: np.ndarray, z: Complex[np.ndarray, " some"], real: bool
) -> Complex[np.ndarray, "some n d"]:
    """r_{i+1} at place i, with r_n q_n = 1."""
    left = _left(blocks, z, real)
    ends = _ends(family, blocks, q)
    return left / np.sum(left[:, -1] * ends, axis=1)[:, None, None]


def _pairing(family: Family, blocks: np.ndarray, q: np.ndarray, left: np.ndarray) -> Complex[np.ndarray, " some"]:
    """r_n q_n of vectors of length one: zero where the multiplier is double with one vector."""
    ends = _ends(family, blocks, q)
    return np.sum(left[:, -1] * ends, axis=1) / (np.linalg.norm(left[:, -1], axis=1) * np.linalg.norm(ends, axis=1))


def _ends(family: Family, blocks: np.ndarray, q: np.ndarray) -> Complex[np.ndarray, "some d"]:
    """q_n."""
    return q[:, -1] if family.field else matvec(blocks[:, -1], q[:, -1])


def _rounding(
    family: Family, blocks: np.ndarray, q: np.ndarray, z: Complex[np.ndarray, " some"], real: bool
) -> Float[np.ndarray, " some"]:
    """Error of a coefficient by C from rounding of ∂P/∂u, a difference over h²: four roundings, and 4/3 of that."""
    left, largest = _left_vectors(family, blocks, q, z, real), np.maximum(1.0, np.abs(blocks).max(axis=(2, 3)))
    each = np.abs(left).sum(axis=2) * largest * np.abs(q).sum(axis=2)
    unit = _ROUNDINGS * np.finfo(float).eps / _SHIFT**2
    return 8.0 / 3.0 * unit * each.sum(axis=1) * (1 / 3 if real else 1.0)


def _moved_blocks(
    family: Family, orbits: CurveOrbits, parts: Sequence[np.ndarray]
) -> Float[np.ndarray, "parts 3 2 some n d d"]:
    """∂P/∂u in sizes at points moved along ways given in sizes by h and −h, and by 2h and 4h as well, in one call."""
    shifts = _SHIFT * np.array([[1.0, -1.0], [2.0, -2.0], [4.0, -4.0]])
    ways = np.stack(parts)[:, None, None] * family.size
    points = orbits.points + shifts[..., None, None, None] * ways
    values = np.broadcast_to(orbits.value[:, None], points.shape[:-1])
    _, matrix, _ = family.period(points.reshape(-1, points.shape[-1]), values.ravel())
    return np.asarray(matrix).reshape(*points.shape, -1) * (family.size / family.size[:, None])


# ---- linear equations around the orbit whose last is closed by a number z, in real numbers


def _cycle(blocks: np.ndarray, z: Complex[np.ndarray, " some"], real: bool) -> cyclic.Cyclic:
    """M_i y_i − y_{i+1} with y_n = z y_0, of real and imaginary parts one after the other where z is complex."""
    d = blocks.shape[-1]
    identity = np.eye(d)
    if not real:
        blocks = np.concatenate(
            [np.concatenate([blocks, 0 * blocks], axis=-1), np.concatenate([0 * blocks, blocks], axis=-1)], axis=-2
        )
    there = np.zeros_like(blocks)
    there[:] = -np.eye(blocks.shape[-1])
    x, y = np.real(z)[:, None, None] * identity, np.imag(z)[:, None, None] * identity
    there[:, -1] = -x if real else -np.concatenate([np.concatenate([x, -y], 2), np.concatenate([y, x], 2)], 1)
    return cyclic.eliminate(blocks, there)


def _complex(y: np.ndarray, real: bool) -> np.ndarray:
    d = y.shape[-1] // 2
    return y.astype(complex) if real else y[..., :d] + 1j * y[..., d:]


def _null(blocks: np.ndarray, z: Complex[np.ndarray, " some"], real: bool) -> np.ndarray:
    """q of M_i q_i = q_{i+1} with q_n = z q_0."""
    return _complex(cyclic.null_vector(_cycle(blocks, z, real)), real)


def _left(blocks: np.ndarray, z: Complex[np.ndarray, " some"], real: bool) -> np.ndarray:
    """r_{i+1} of r_{i+1} M_i = r_i with r_0 = z r_n, at place i: the same equations, transposed and turned round."""
    return _null(np.swapaxes(blocks, -1, -2)[:, ::-1], z, real)[:, ::-1]


def _response(blocks: np.ndarray, force: np.ndarray, z: Complex[np.ndarray, " some"]) -> np.ndarray:
    """y of y_{i+1} = M_i y_i + f_i with y_n = z y_0."""
    right = -np.concatenate([np.real(force), np.imag(force)], axis=-1)
    return _complex(cyclic.solve(_cycle(blocks, z, False), right), False)


def _real_response(blocks: np.ndarray, left: np.ndarray, force: np.ndarray, critical: bool) -> np.ndarray:
    """The response with z = 1; where a multiplier is one (`critical`), without the part along its left vector."""
    cycle = _cycle(blocks, np.ones(len(blocks), complex), True)
    if critical:
        return cyclic.underdetermined(cycle, -force, np.real(left)).y
    return cyclic.solve(cycle, -force)
