"""Multipliers of orbits from derivatives of single periods, without the product that loses small ones. Host code.

An orthonormal basis is carried around the orbit a few times. Directions that grow differently are then apart, and each
block of the triangle has its own multipliers; those that grow alike stay together in one, whose product is harmless.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import Complex, Float

_TURNS = 4  # directions whose growth differs by more than 10³ a turn are then apart to rounding; others need not be
_APART = 1e-12
_LONG = 16  # blocks, beyond which lanes go one by one: a call of NumPy takes five times as long as LAPACK's of one
_DIGITS = 3.0  # decades of the condition of a product of blocks, at most
_MANY = 1 << 14  # matrices, beyond which all cores take part: 2 µs of one each


def multipliers(blocks: Float[np.ndarray, "... n d d"]) -> Complex[np.ndarray, "... d"]:
    """Eigenvalues of M_{n−1}…M_0 of blocks, largest modulus first; not a number where one of them is not finite."""
    n, d = blocks.shape[-3:-1]
    flat = blocks.reshape(-1, n, d, d)
    finite = np.all(np.isfinite(flat), axis=(1, 2, 3))
    flat = np.where(finite[:, None, None, None], flat, 0.0)
    if n == 1:
        values = np.linalg.eigvals(flat[:, 0]).astype(complex)
    else:
        values = np.array([_block_eigenvalues(*block) for block in zip(*_last_turn(flat), strict=True)]).reshape(-1, d)
    order = np.lexsort((np.imag(values), -np.abs(values)), axis=-1)
    values = np.take_along_axis(values, order, axis=-1)
    return np.where(finite[:, None], values, np.nan).reshape(*blocks.shape[:-3], d)


def eigenvalues(matrices: Float[np.ndarray, "lanes d d"]) -> Complex[np.ndarray, "lanes d"]:
    """Eigenvalues of small matrices, in no order, not a number where one of them is not finite.

    All cores compute those of many, with the same bits.
    """
    finite = np.all(np.isfinite(matrices), axis=(1, 2))
    if not finite.all():
        values = np.full(matrices.shape[:2], np.nan, complex)
        values[finite] = eigenvalues(matrices[finite])
        return values
    if len(matrices) < _MANY:
        return np.linalg.eigvals(matrices)
    parts = np.array_split(matrices, len(matrices) // (_MANY // 4))
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        return np.concatenate(list(threads.map(np.linalg.eigvals, parts)))


def merged(blocks: Float[np.ndarray, "lanes n d d"]) -> Float[np.ndarray, "lanes k d d"]:
    """Return products of neighbouring blocks with the same product of all, as few as lose no more than three digits.

    The condition of a product is at most the product of the conditions.
    """
    n = blocks.shape[1]
    with np.errstate(all="ignore"):
        decades = np.log10(np.linalg.cond(np.where(np.isfinite(blocks), blocks, 0.0))).max(axis=0)
    decades = np.where(np.isfinite(decades), decades, _DIGITS)
    groups: list[int] = []
    spent = np.inf
    for number, each in enumerate(decades.tolist()):
        spent += each
        if spent > _DIGITS:
            groups.append(number)
            spent = each
    ends = np.array([*groups, n])
    products = np.array(blocks[:, ends[:-1]])
    for step in range(1, int(np.diff(ends).max())):
        (going,) = np.nonzero(np.diff(ends) > step)
        products[:, going] = blocks[:, ends[going] + step] @ products[:, going]
    return products


def angle_cosine(values: Complex[np.ndarray, "lanes d"]) -> Float[np.ndarray, " lanes"]:
    """Half the sum of the two multipliers whose product is nearest one: on a Neimark–Sacker curve cos θ of e^(±iθ)."""
    d = values.shape[1]
    i, j = np.triu_indices(d, 1)
    pair = np.argmin(np.abs(values[:, i] * values[:, j] - 1.0), axis=1)
    row = np.arange(len(values))
    return 0.5 * np.real(values[row, i[pair]] + values[row, j[pair]])


def _last_turn(blocks: Float[np.ndarray, "lanes n d d"]) -> tuple[np.ndarray, np.ndarray]:
    """Q_0ᵀQ_n and R_{n−1}…R_0 of the last turn, each (lanes, d, d)."""
    if blocks.shape[1] > _LONG:
        turns = [_last_turn_of_lane(lane) for lane in blocks]
        return tuple(np.array(part).reshape(blocks[:, 0].shape) for part in zip(*turns, strict=True))  # pyright: ignore[reportReturnType]
    basis = np.broadcast_to(np.eye(blocks.shape[-1]), blocks[:, 0].shape)
    start, product = basis, basis
    for _ in range(_TURNS):
        start, product = basis, np.broadcast_to(np.eye(blocks.shape[-1]), blocks[:, 0].shape)
        for i in range(blocks.shape[1]):
            basis, upper = np.linalg.qr(blocks[:, i] @ basis)
            product = upper @ product
    return np.swapaxes(start, -1, -2) @ basis, product


def _last_turn_of_lane(blocks: Float[np.ndarray, "n d d"]) -> tuple[np.ndarray, np.ndarray]:
    """`_last_turn` of one lane, (d, d) each, of matrices that need not be stacked."""
    # Here, as it takes a tenth of a second to import.
    from scipy.linalg.lapack import dgeqrf, dorgqr  # pyright: ignore[reportAttributeAccessIssue]

    identity = np.eye(blocks.shape[-1])
    basis = start = product = identity
    for turn in range(_TURNS):
        start, counts = basis, turn == _TURNS - 1
        for block in blocks:
            factors, scales, *_ = dgeqrf(block @ basis)
            product = np.triu(factors) @ product if counts else product
            basis = dorgqr(factors, scales)[0]
    return start.T @ basis, product


def _block_eigenvalues(turn: Float[np.ndarray, "d d"], upper: Float[np.ndarray, "d d"]) -> Complex[np.ndarray, " d"]:
    """Eigenvalues of turn @ upper, block by block where the turn leaves the first directions among themselves."""
    d = len(turn)
    ends = [k for k in range(1, d) if np.abs(turn[k:, :k]).max() < _APART]
    values = [np.linalg.eigvals(turn[i:j, i:j] @ upper[i:j, i:j]) for i, j in zip([0, *ends], [*ends, d], strict=True)]
    return np.concatenate(values).astype(complex)
