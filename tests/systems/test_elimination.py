"""Small linear systems lane by lane, against LAPACK."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.systems.elimination import eliminate
from tests.helpers.measurement import UNIT

MOMENTS = 200
RNG = np.random.default_rng(21)


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_elimination(n):
    """Solutions of random systems, some of which need an exchange of rows, against LAPACK."""
    matrix, right = RNG.normal(size=(MOMENTS, n, n)), RNG.normal(size=(MOMENTS, n, 2))
    matrix[::3, 0, 0] = 0.0 if n > 1 else 1.0
    components = [[matrix[:, i, j] for j in range(n)] for i in range(n)]
    solutions, singular = eliminate(components, [[right[:, i, s] for i in range(n)] for s in range(2)])
    found = np.stack([np.stack(s, axis=-1) for s in solutions], axis=-1)
    condition = np.linalg.cond(matrix)[:, None, None]
    assert np.all(np.abs(found - np.linalg.solve(matrix, right)) < 100 * UNIT * condition * np.abs(found).max())
    assert not np.any(singular)


def bordered(n, m, ends=0.0):
    """Random [M, Aᵀ; A, −D], M positive definite and D a multiple of one: (MOMENTS, n + m, n + m)."""
    factor, slopes = RNG.normal(size=(MOMENTS, n, n)), RNG.normal(size=(MOMENTS, m, n))
    mass = factor @ factor.swapaxes(1, 2) + 0.1 * np.eye(n)
    corner = np.broadcast_to(-ends * np.eye(m), (MOMENTS, m, m))
    return np.block([[mass, slopes.swapaxes(1, 2)], [slopes, corner]])


@pytest.mark.parametrize(("n", "m", "ends"), [(3, 0, 0.0), (3, 2, 0.0), (5, 3, 0.0), (3, 3, 0.7)])
def test_definite_matrices_need_no_exchange(n, m, ends):
    """Solutions of mass matrices with and without a border, of constraints that hold and that do not, against LAPACK."""
    matrix, right = bordered(n, m, ends), RNG.normal(size=(MOMENTS, n + m))
    components = [[matrix[:, i, j] for j in range(n + m)] for i in range(n + m)]
    (solution,), singular = eliminate(components, [[*right.T]], definite=True)
    exact = np.linalg.solve(matrix, right[..., None])[..., 0]
    limit = 100 * UNIT * np.linalg.cond(matrix)[:, None] * np.abs(exact).max(axis=1, keepdims=True)
    assert np.all(np.abs(np.stack(solution, axis=1) - exact) < limit)
    assert not np.any(singular)


def test_dependent_constraints_are_singular():
    """One of two equal constraints, and one that is zero, leave no pivot but rounding."""
    mass, row = np.diag([1.0, 1.4, 2.0]), [0.3, -0.8, 1.1]
    for second in (row, [0.0, 0.0, 0.0]):
        slopes = np.array([row, second])
        matrix = np.block([[mass, slopes.T], [slopes, np.zeros((2, 2))]])
        _, singular = eliminate([[np.full(2, x) for x in line] for line in matrix], [[np.ones(2)] * 5], definite=True)
        assert np.all(singular)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_a_matrix_of_zeros_is_singular_and_one_that_is_not_a_number_is_not(n):
    """Known while a program is traced or not; where nothing is a number the reason is another one."""
    for entry, singular in ((0.0, True), (np.zeros(3), True), (np.full(3, np.nan), False)):
        _, found = eliminate([[entry] * n for _ in range(n)], [[1.0] * n])
        np.testing.assert_array_equal(found, singular)
