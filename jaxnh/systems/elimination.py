"""Small linear systems lane by lane: a component an array of its own, no batch of matrices, no library.

Systems of two and of three are solved in closed form, with one division in place of one a pivot.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxnh.systems.state import Number

_CLOSED = (2, 3)
_SMALLEST_PIVOT = 64 * np.finfo(float).eps  # in units of a matrix's largest entry: below it a pivot is rounding


class Factors(NamedTuple):
    """A matrix of n rows in factors, as elimination makes them, column by column.

    Attributes:
        exchanges: for each column and each row below whether it changes places with the column's own; None: it cannot.
        inverses: inverses of the pivots.
        below: for each column the entries below its pivot, in the rows as they were exchanged.
        above: for each row the entries to the right of its pivot, in units of it.
        singular: whether the smallest pivot is rounding beside the matrix's largest entry.
    """

    exchanges: list[list[Number | None]]
    inverses: list[Number]
    below: list[list[Number]]
    above: list[list[Number]]
    singular: Number


def eliminate(
    matrix: list[list[Number]], rights: list[list[Number]], *, definite: bool = False
) -> tuple[list[list[Number]], Number]:
    """Solutions of a linear system for several right sides, components of any shape.

    Two and three rows are solved by cofactors, more by Gauss with partial pivoting, whose rows change places by
    selection, lane by lane, so that the program has no branch and no indexing. Entries that are floats are known to it:
    what is zero among them costs nothing.

    Args:
        matrix: n rows of n components.
        rights: right sides of n components each.
        definite: whether the matrix is symmetric and positive definite, or [M, Aᵀ; A, −D] with M positive definite and
            D positive semidefinite: pivots are then good as they stand (Vanderbei, SIAM J. Optim. 5 (1995) 100), no
            rows change places, and what is left at each column is symmetric as well, half of which is computed.

    Returns:
        The solutions, and whether the matrix is singular but for rounding: not where it has entries that are no
        numbers.
    """
    if len(matrix) in _CLOSED and not (definite and isinstance(matrix[0][0], float)):  # its first pivot is known
        return _closed_form(matrix, rights)
    factors = factorise(matrix, definite=definite)
    return [substitute(factors, right) for right in rights], factors.singular


def _closed_form(matrix: list[list[Number]], rights: list[list[Number]]) -> tuple[list[list[Number]], Number]:
    """Solutions by cofactors, and whether the pivots of an elimination that exchanges rows would be singular.

    Of a symmetric matrix equal cofactors are equal equations.
    """
    n, first = len(matrix), largest_of([row[0] for row in matrix])
    adjugate = [[_cofactor(matrix, i, j) for i in range(n)] for j in range(n)]
    determinant = functools.reduce(plus, (times(x, row[-1]) for x, row in zip(adjugate[-1], matrix, strict=True)))
    inverse = _inverse(determinant) if isinstance(determinant, float) else 1.0 / jnp.asarray(determinant)
    # The product of an elimination's first pivots is a minor of the first columns.
    minors = [first, *([largest_of(adjugate[-1])] if n > 2 else []), jnp.abs(determinant)]
    rounding = _SMALLEST_PIVOT * largest_of([entry for row in matrix for entry in row])
    small = [minor <= rounding * before for minor, before in zip(minors, [1.0, *minors], strict=False)]
    solutions = [
        [times(functools.reduce(plus, map(times, row, right)), inverse) for row in adjugate] for right in rights
    ]
    return solutions, functools.reduce(jnp.logical_or, small)


def _cofactor(matrix: list[list[Number]], i: int, j: int) -> Number:
    """Cofactor of row i and column j of two or three rows."""
    if len(matrix) == 2:
        entry = matrix[1 - i][1 - j]
        return entry if i == j else minus(0.0, entry)
    (r, s), (c, d) = (((k + 1) % 3, (k + 2) % 3) for k in (i, j))
    x, y = times(matrix[r][c], matrix[s][d]), times(matrix[r][d], matrix[s][c])
    return minus(x, y)


def factorise(matrix: list[list[Number]], *, definite: bool = False) -> Factors:
    """Factors of a matrix for `substitute`, as in `eliminate`."""
    n = len(matrix)
    rows = [[*row] for row in matrix]
    largest = largest_of([entry for row in matrix for entry in row])
    exchanges: list[list[Number | None]] = []
    pivots, inverses, below = [], [], []
    for c in range(n):
        exchanges.append([None] * (n - c - 1))
        for r in () if definite else range(c + 1, n):
            if is_zero(rows[r][c]):
                continue
            swap = jnp.abs(rows[r][c]) > jnp.abs(rows[c][c])
            rows[c][c:], rows[r][c:] = _exchanged(swap, rows[c][c:], rows[r][c:])
            exchanges[c][r - c - 1] = swap
        pivots.append(rows[c][c])
        inverse = 1.0 / jnp.asarray(rows[c][c]) if not isinstance(rows[c][c], float) else _inverse(rows[c][c])
        inverses.append(inverse)
        rows[c][c + 1 :] = [times(entry, inverse) for entry in rows[c][c + 1 :]]
        below.append([rows[r][c] for r in range(c + 1, n)])
        for r in range(c + 1, n):
            for j in range(r if definite else c + 1, n):
                rows[r][j] = minus(rows[r][j], times(rows[r][c], rows[c][j]))
                if definite:
                    rows[j][r] = rows[r][j]
    smallest = jnp.abs(pivots[0])
    for pivot in pivots[1:]:  # what follows a pivot of zero is not a number, and leaves it the smallest
        smallest = jnp.where(jnp.abs(pivot) < smallest, jnp.abs(pivot), smallest)
    above = [row[c + 1 :] for c, row in enumerate(rows)]
    return Factors(exchanges, inverses, below, above, smallest <= _SMALLEST_PIVOT * largest)


def substitute(factors: Factors, right: list[Number]) -> list[Number]:
    """Solution of a linear system for a right side of n components."""
    x, n = [*right], len(right)
    for c in range(n):
        for r, swap in enumerate(factors.exchanges[c], c + 1):
            if swap is not None:
                (x[c],), (x[r],) = _exchanged(swap, [x[c]], [x[r]])
        x[c] = times(x[c], factors.inverses[c])
        for r in range(c + 1, n):
            x[r] = minus(x[r], times(factors.below[c][r - c - 1], x[c]))
    for c in reversed(range(n)):
        for j in range(c + 1, n):
            x[c] = minus(x[c], times(factors.above[c][j - c - 1], x[j]))
    return x


def _exchanged(swap: Number, upper: list[Number], lower: list[Number]) -> tuple[list[Number], list[Number]]:
    """Two rows, in the other order where they change places."""
    pairs = list(zip(upper, lower, strict=True))
    return [jnp.where(swap, y, x) for x, y in pairs], [jnp.where(swap, x, y) for x, y in pairs]


def as_float(x: Number) -> Number:
    """A component as a float where it is known while the program is traced, else as it is."""
    return x if isinstance(x, Tracer) or jnp.ndim(x) else float(x)


def is_zero(x: Number) -> bool:
    """Return whether a component is known to vanish."""
    return isinstance(x, float) and x == 0.0


def _inverse(x: float) -> float:
    return 1.0 / x if x else math.inf


def times(x: Number, y: Number) -> Number:
    """x y, nothing where one of them is known to vanish."""
    return 0.0 if is_zero(x) or is_zero(y) else x * y


def plus(x: Number, y: Number) -> Number:
    """x + y, without what is known to vanish."""
    return y if is_zero(x) else x if is_zero(y) else x + y


def minus(x: Number, y: Number) -> Number:
    """x − y, without what is known to vanish."""
    if is_zero(y):
        return x
    return -y if is_zero(x) else x - y


def is_positive_definite(mass: list[list[Number]]) -> bool:
    """Return whether a mass matrix is known, and positive definite."""
    if not all(isinstance(entry, float) for row in mass for entry in row):
        return False
    return bool(np.linalg.eigvalsh(np.array(mass)).min() > 1e-8 * np.abs(mass).max())


def largest_of(values: list[Number]) -> Number:
    """Largest modulus of some components; what is known of them, or there more than once, costs nothing."""
    known = [abs(value) for value in values if isinstance(value, float)]
    others = list({id(value): value for value in values if not isinstance(value, float)}.values())
    moduli = [*map(jnp.abs, others), *([max(known)] if any(known) or not others else [])]
    return functools.reduce(jnp.maximum, moduli[1:], jnp.asarray(moduli[0], float))
