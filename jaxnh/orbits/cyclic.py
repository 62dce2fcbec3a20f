"""Linear systems of blocks around a cycle, as orbits by multiple shooting need them. Host code; no product is formed.

Structured orthogonal elimination (Wright, SIAM J. Sci. Stat. Comput. 13 (1992) 742): points are eliminated one after
the other by a QR step of the two equations they stand in, which is stable where multiplying the blocks out is not.
Small LAPACK calls only: results do not depend on the number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Cyclic(NamedTuple):
    """A_i y_i + B_i y_{i+1} = r_i around a cycle (y_n = y_0), eliminated; several of them side by side (...).

    Attributes:
        turns: the orthogonal matrix of each step, (n − 1) of (..., 2m, 2m).
        upper: the triangle of each step, which stands before the point eliminated, (n − 1) of (..., m, m).
        rows: what stands before y_0 and before the next point in that equation, (n − 1) of (..., m, 2m).
        closed: the matrix of what is left for y_0, (..., m, m).
    """

    turns: list[np.ndarray]
    upper: list[np.ndarray]
    rows: list[np.ndarray]
    closed: np.ndarray


def eliminate(here: Float[np.ndarray, "... n m m"], there: Float[np.ndarray, "... n m m"]) -> Cyclic:
    """The elimination of all points but the first, of A and B."""
    n, m = here.shape[-3], here.shape[-1]
    first, last = here[..., 0, :, :], there[..., 0, :, :]  # first y_0 + last y_i = r
    found = Cyclic([], [], [], np.empty(0))
    for i in range(1, n):
        turn, upper = np.linalg.qr(np.concatenate([last, here[..., i, :, :]], axis=-2), mode="complete")
        rows = np.zeros((*first.shape[:-2], 2 * m, 2 * m))
        rows[..., :m, :m], rows[..., m:, m:] = first, there[..., i, :, :]
        rows = np.swapaxes(turn, -1, -2) @ rows
        found.turns.append(turn)
        found.upper.append(upper[..., :m, :])
        found.rows.append(rows[..., :m, :])
        first, last = rows[..., m:, :m], rows[..., m:, m:]
    return found._replace(closed=first + last)


def solve(cycle: Cyclic, right: Float[np.ndarray, "... n m"]) -> Float[np.ndarray, "... n m"]:
    """y of r."""
    carried, known = _carried(cycle, right)
    return _back(cycle, np.linalg.solve(cycle.closed, carried[..., None])[..., 0], known)


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
    (last, known), (last_column, known_column) = _carried(cycle, right), _carried(cycle, column)
    wide = np.concatenate([cycle.closed, last_column[..., None]], axis=-1)
    left, singular, rows = np.linalg.svd(wide, full_matrices=True)
    shares = (np.swapaxes(left, -1, -2) @ last[..., None])[..., 0]
    shares = np.where(singular > 0.0, shares / np.where(singular > 0.0, singular, 1.0), 0.0)
    least = (np.swapaxes(rows[..., :-1, :], -1, -2) @ shares[..., None])[..., 0]
    null, other = rows[..., -1, :], rows[..., -2, :]

    def whole(first: np.ndarray, known: list[np.ndarray]) -> np.ndarray:
        x = first[..., -1:]
        return _back(cycle, first[..., :-1], [k - x * kc for k, kc in zip(known, known_column, strict=True)])

    none = [np.zeros_like(k) for k in known]
    square = np.concatenate([wide, null[..., None, :]], axis=-2)
    ways = (whole(null, none), null[..., -1]), (whole(other, none), other[..., -1])
    return Solutions(whole(least, known), least[..., -1], *ways[0], square, *ways[1])


def null_vector(cycle: Cyclic) -> Float[np.ndarray, "... n m"]:
    """y of r = 0, of length one at the first point, where there is one; elsewhere that of the nearest `closed`."""
    first = np.linalg.svd(cycle.closed)[2][..., -1, :]
    return _back(cycle, first, [np.zeros_like(first)] * len(cycle.turns))


def determinant(cycle: Cyclic) -> Float[np.ndarray, ...]:
    """Determinant of the whole system; with B_i = −1 but for the last, which is +1, that of M_{n−1}…M_0 + 1."""
    steps = len(cycle.turns)
    m = cycle.upper[0].shape[-1] if steps else cycle.closed.shape[-1]
    sign, logarithm = np.linalg.slogdet(cycle.closed)
    for turn, upper in zip(cycle.turns, cycle.upper, strict=True):
        diagonal = np.diagonal(upper, axis1=-2, axis2=-1)
        sign = sign * np.linalg.slogdet(turn)[0] * np.prod(np.sign(diagonal), axis=-1)
        logarithm = logarithm + np.sum(np.log(np.abs(diagonal)), axis=-1)
    # The equations that are left stand in another order than the points.
    return (-1.0) ** (m * steps) * sign * np.exp(logarithm)


def _carried(cycle: Cyclic, right: Float[np.ndarray, "... n m"]) -> tuple[np.ndarray, list[np.ndarray]]:
    """What stands on the right of the equation left for y_0, and of those of the points eliminated."""
    m = right.shape[-1]
    carried, known = right[..., 0, :], []
    for i, turn in enumerate(cycle.turns, 1):
        both = np.concatenate([carried, right[..., i, :]], axis=-1)
        both = (np.swapaxes(turn, -1, -2) @ both[..., None])[..., 0]
        known.append(both[..., :m])
        carried = both[..., m:]
    return carried, known


def _back(cycle: Cyclic, first: np.ndarray, known: list[np.ndarray]) -> np.ndarray:
    """All y, from y_0 and from what stands on the right of the points' equations after their elimination."""
    m = first.shape[-1]
    y = [first]
    for upper, rows, right in zip(cycle.upper[::-1], cycle.rows[::-1], known[::-1], strict=True):
        both = rows[..., :m] @ first[..., None] + rows[..., m:] @ y[-1][..., None]
        y.append(np.linalg.solve(upper, right[..., None] - both)[..., 0])
    return np.stack([first, *y[:0:-1]], axis=-2)
