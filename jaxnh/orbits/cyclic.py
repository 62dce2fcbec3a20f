"""Linear systems of blocks around a cycle, as orbits by multiple shooting need them. Host code; no product is formed.

Structured orthogonal elimination (Wright, SIAM J. Sci. Stat. Comput. 13 (1992) 742): a point is eliminated by a QR step
of the two equations it stands in, which is stable where multiplying the blocks out is not. Every second point goes at
once, then every second of those left, so that n points take log₂ n rounds. Small LAPACK calls only: results do not
depend on the number of threads.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Round(NamedTuple):
    """The elimination of every second one of k points, the second, the fourth, …, half = k // 2 in all.

    Attributes:
        turns: the orthogonal matrix of each, (half, ..., 2m, 2m).
        upper: the triangle before the point in the equation that is kept for it, (half, ..., m, m).
        rows: what stands before its neighbours there, (half, ..., m, 2m).
    """

    turns: np.ndarray
    upper: np.ndarray
    rows: np.ndarray


class Cyclic(NamedTuple):
    """A_i y_i + B_i y_{i+1} = r_i around a cycle (y_n = y_0), eliminated; several of them side by side (...).

    Attributes:
        rounds: until y_0 alone is left.
        closed: the matrix of what is left for y_0, (..., m, m).
    """

    rounds: list[Round]
    closed: np.ndarray


def eliminate(blocks: Float[np.ndarray, "... n m m"], next_blocks: Float[np.ndarray, "... n m m"]) -> Cyclic:
    """The elimination of all points but the first, of A and B."""
    m, rounds = blocks.shape[-1], []
    blocks, next_blocks = _points_first(blocks), _points_first(next_blocks)
    while len(blocks) > 1:
        (first, of_left), (of_right, last) = _pairs(blocks), _pairs(next_blocks)
        turns, upper = np.linalg.qr(np.concatenate([of_right, of_left], axis=-2), mode="complete")
        rows = np.zeros_like(turns)
        rows[..., :m, :m], rows[..., m:, m:] = first, last
        rows = np.swapaxes(turns, -1, -2) @ rows
        rounds.append(Round(turns, upper[..., :m, :], rows[..., :m, :]))
        odd = 2 * len(turns)
        blocks = np.concatenate([rows[..., m:, :m], blocks[odd:]])
        next_blocks = np.concatenate([rows[..., m:, m:], next_blocks[odd:]])
    return Cyclic(rounds, blocks[0] + next_blocks[0])


def solve(cycle: Cyclic, right: Float[np.ndarray, "... n m"]) -> Float[np.ndarray, "... n m"]:
    """y of r."""
    carried, known = _eliminated_sides(cycle, right[..., None])
    return _substitute_back(cycle, np.linalg.solve(cycle.closed, carried), known)[..., 0]


class Solutions(NamedTuple):
    """All solutions (y, x) of A_i y_i + B_i y_{i+1} + c_i x = r_i, a line: `y` + any number · `way`, and x alike.

    Attributes:
        y, x: one of them, the least in (y_0, x): (..., n, m) and (...).
        way, rate: the direction of the line, (..., n, m) and (...), of length one in (y_0, x).
        square: `closed` with the column c and, as a last row, the direction in (y_0, x), (..., m + 1, m + 1).
        other_way, other_rate: as way and rate, of the direction that is least far from one of a plane of solutions.
    """

    y: Float[np.ndarray, "... n m"]
    x: Float[np.ndarray, ...]
    way: Float[np.ndarray, "... n m"]
    rate: Float[np.ndarray, ...]
    square: Float[np.ndarray, "... m m"]
    other_way: Float[np.ndarray, "... n m"]
    other_rate: Float[np.ndarray, ...]


def underdetermined(
    cycle: Cyclic, right: Float[np.ndarray, "... n m"], column: Float[np.ndarray, "... n m"]
) -> Solutions:
    """The solutions with one unknown more, which all equations know; `closed` itself may be singular, as at a fold."""
    (last, known), (last_column, known_column) = (_eliminated_sides(cycle, r[..., None]) for r in (right, column))
    wide = np.concatenate([cycle.closed, last_column], axis=-1)
    least, null, other, square = underdetermined_square(wide, last[..., 0])

    def whole(first: np.ndarray, known: list[np.ndarray]) -> np.ndarray:
        first = first[..., None]
        x = first[..., -1:, :]
        known = [k - x * kc for k, kc in zip(known, known_column, strict=True)]
        return _substitute_back(cycle, first[..., :-1, :], known)[..., 0]

    none = [np.zeros_like(k) for k in known]
    ways = (whole(null, none), null[..., -1]), (whole(other, none), other[..., -1])
    return Solutions(whole(least, known), least[..., -1], *ways[0], square, *ways[1])


def underdetermined_square(
    wide: Float[np.ndarray, "... m more"], right: Float[np.ndarray, "... m"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The least solution of m equations of one unknown more, the null direction, and the next singular one.

    And the matrix with the null direction as its last row: bordered, and regular where `wide` has full rank.
    """
    left, singular, rows = np.linalg.svd(wide, full_matrices=True)
    shares = (np.swapaxes(left, -1, -2) @ right[..., None])[..., 0]
    shares = np.where(singular > 0.0, shares / np.where(singular > 0.0, singular, 1.0), 0.0)
    least = (np.swapaxes(rows[..., :-1, :], -1, -2) @ shares[..., None])[..., 0]
    null, other = rows[..., -1, :], rows[..., -2, :]
    return least, null, other, np.concatenate([wide, null[..., None, :]], axis=-2)


def solutions(
    cycle: Cyclic, right: Float[np.ndarray, "... n m"], columns: Float[np.ndarray, "... n m k"]
) -> tuple[tuple[np.ndarray, np.ndarray], list[tuple[np.ndarray, np.ndarray]], Cyclic]:
    """All solutions of A_i y_i + B_i y_{i+1} + C_i x = r_i with k unknowns x, which all equations know.

    Returns:
        One of them, y and x, (..., n, m) and (..., k), the least in (y_0, x); k directions to all others; and
        the equations with k more, in which those directions' parts in (y_0, x) are the rows.
    """
    k, m = columns.shape[-1], right.shape[-1]
    last, known = _eliminated_sides(cycle, np.concatenate([right[..., None], columns], axis=-1))
    wide = np.concatenate([cycle.closed, last[..., 1:]], axis=-1)
    left, singular, rows = np.linalg.svd(wide, full_matrices=True)
    least = np.swapaxes(left, -1, -2) @ last[..., :1] / singular[..., None]
    least = np.swapaxes(rows[..., : -k or None, :], -1, -2) @ least
    null = rows[..., : -1 - k : -1, :]
    square = np.concatenate([wide, null], axis=-2)
    first = np.concatenate([least, np.swapaxes(null, -1, -2)], axis=-1)
    x = first[..., m:, :]
    sides = [-known_one[..., 1:] @ x for known_one in known]
    for side, known_one in zip(sides, known, strict=True):
        side[..., 0] += known_one[..., 0]
    y = _substitute_back(cycle, first[..., :m, :], sides)
    ways = [(y[..., 1 + j], x[..., 1 + j]) for j in range(k)]
    return (y[..., 0], x[..., 0]), ways, cycle._replace(closed=square)


def null_vector(cycle: Cyclic) -> Float[np.ndarray, "... n m"]:
    """y of r = 0, of length one at the first point, where there is one; elsewhere that of the nearest `closed`."""
    first = np.linalg.svd(cycle.closed)[2][..., -1, :, None]
    return _substitute_back(cycle, first, [np.zeros(1)] * len(cycle.rounds))[..., 0]


def determinant(cycle: Cyclic) -> Float[np.ndarray, ...]:
    """Determinant of the whole system; with B_i = −1 but for the last, which is +1, that of M_{n−1}…M_0 + 1."""
    eliminated = 0  # rows of all points that were
    sign, logarithm = np.linalg.slogdet(cycle.closed)
    for turns, upper, _ in cycle.rounds:
        diagonal = np.moveaxis(np.diagonal(upper, axis1=-2, axis2=-1), 0, -2)
        signs = np.moveaxis(np.linalg.slogdet(turns)[0], 0, -1) * np.prod(np.sign(diagonal), axis=-1)
        logs = np.log(np.abs(diagonal)).reshape(*diagonal.shape[:-2], math.prod(diagonal.shape[-2:]))
        sign = sign * np.prod(signs, axis=-1)
        logarithm = logarithm + np.cumsum(logs, axis=-1)[..., -1]  # one after the other, however many lie side by side
        eliminated += len(turns) * upper.shape[-1]
    # The equations that are left stand in another order than the points.
    return (-1.0) ** eliminated * sign * np.exp(logarithm)


def _points_first(each: np.ndarray) -> np.ndarray:
    """Return an array in one memory order: the last bits of products depend on it."""
    return np.ascontiguousarray(np.moveaxis(each, -3, 0))


def _pairs(each: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first and the second of all pairs along the first axis; an odd one at the end has none."""
    return each[: len(each) // 2 * 2 : 2], each[1::2]


def _eliminated_sides(cycle: Cyclic, right: Float[np.ndarray, "... n m c"]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return c right-hand sides of the equation left for y_0, and of those of the points that were eliminated."""
    m, known = right.shape[-2], []
    carried = _points_first(right)
    for turns, _, _ in cycle.rounds:
        both = np.swapaxes(turns, -1, -2) @ np.concatenate(_pairs(carried), axis=-2)
        known.append(both[..., :m, :])
        carried = np.concatenate([both[..., m:, :], carried[2 * len(turns) :]])
    return carried[0], known


def _substitute_back(
    cycle: Cyclic, first: Float[np.ndarray, "... m c"], known: list[np.ndarray]
) -> Float[np.ndarray, "... n m c"]:
    """All y, from y_0 and from what stands on the right of the points' equations after their elimination."""
    y = np.ascontiguousarray(first)[None]
    for (_, upper, rows), right in zip(cycle.rounds[::-1], known[::-1], strict=True):
        half = len(rows)
        neighbours = np.concatenate([y[:half], np.roll(y, -1, axis=0)[:half]], axis=-2)
        whole = np.empty((len(y) + half, *y.shape[1:]))
        whole[::2], whole[1::2] = y, np.linalg.solve(upper, right - rows @ neighbours)
        y = whole
    return np.ascontiguousarray(np.moveaxis(y, 0, -3))
