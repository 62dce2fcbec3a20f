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
    solutions, smallest = eliminate(components, [[right[:, i, s] for i in range(n)] for s in range(2)])
    found = np.stack([np.stack(s, axis=-1) for s in solutions], axis=-1)
    condition = np.linalg.cond(matrix)[:, None, None]
    assert np.all(np.abs(found - np.linalg.solve(matrix, right)) < 100 * UNIT * condition * np.abs(found).max())
    assert np.all(np.asarray(smallest) > 0)


@pytest.mark.parametrize("n", [1, 2])
def test_a_matrix_of_zeros_is_singular_and_one_that_is_not_a_number_is_not(n):
    """Known while a program is traced or not; where nothing is a number the reason is another one."""
    for entry, smallest in ((0.0, 0.0), (np.zeros(3), 0.0), (np.full(3, np.nan), np.nan)):
        _, found = eliminate([[entry] * n for _ in range(n)], [[1.0] * n])
        np.testing.assert_array_equal(found, smallest)
