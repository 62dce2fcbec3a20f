"""Small linear systems lane by lane: a component an array of its own, no batch of matrices, no library."""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxnh.systems.state import Number


class Factors(NamedTuple):
    """A matrix of n rows in factors, as elimination makes them, column by column.

    Attributes:
        exchanges: for each column and each row below whether it changes places with the column's own; None: it cannot.
        inverses: inverses of the pivots.
        below: for each column the entries below its pivot, in the rows as they were exchanged.
        above: for each row the entries to the right of its pivot, in units of it.
        smallest: smallest pivot in units of the matrix's largest entry; zero where all entries are zero.
    """

    exchanges: list[list[Number | None]]
    inverses: list[Number]
    below: list[list[Number]]
    above: list[list[Number]]
    smallest: Number


def eliminate(
    matrix: list[list[Number]], rights: list[list[Number]], *, definite: bool = False
) -> tuple[list[list[Number]], Number]:
    """Solutions of a linear system for several right sides, by Gauss with partial pivoting, components of any shape.

    Rows change places by selection, lane by lane, so that the program has no branch and no indexing. Entries that are
    floats are known to it: what is zero among them costs nothing.

    Args:
        matrix: n rows of n components.
        rights: right sides of n components each.
        definite: whether the matrix is symmetric and positive definite, or [M, Aᵀ; A, −D] with M positive definite and
            D positive semidefinite: pivots are then good as they stand (Vanderbei, SIAM J. Optim. 5 (1995) 100), no
            rows change places, and what is left at each column is symmetric as well, half of which is computed.

    Returns:
        The solutions, and the smallest pivot in units of the matrix's largest entry; zero where all entries are zero.
        At zero the solutions are not finite.
    """
    factors = factorise(matrix, definite=definite)
    return [substitute(factors, right) for right in rights], factors.smallest


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
    return Factors(exchanges, inverses, below, above, smallest / jnp.where(largest == 0.0, 1.0, largest))


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
