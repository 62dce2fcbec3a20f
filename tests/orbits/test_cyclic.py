"""Linear systems around a cycle against dense ones, and their bits: the same in whatever company and order in memory."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.orbits import cyclic

COUNT, SIZES = 7, [(1, 3), (2, 3), (3, 3), (5, 2), (8, 3)]


def systems(n, m):
    """A, B, a right side and a column of random systems."""
    rng = np.random.default_rng(n)
    return [rng.normal(size=(COUNT, n, *shape)) for shape in ((m, m), (m, m), (m,), (m,))]


def dense(here, there):
    n, m, _ = here.shape
    whole = np.zeros((n, m, n, m))
    for i in range(n):
        whole[i, :, i] += here[i]
        whole[i, :, (i + 1) % n] += there[i]
    return whole.reshape(n * m, n * m)


@pytest.mark.parametrize(("n", "m"), SIZES)
def test_as_dense_systems(n, m):
    """Solutions, determinants with their signs, and those of systems with a column and a row more."""
    here, there, right, column = systems(n, m)
    cycle = cyclic.eliminate(here, there)
    solved, determinants = cyclic.solve(cycle, right), cyclic.determinant(cycle)
    line = cyclic.underdetermined(cycle, right, column)
    bordered = cyclic.determinant(cycle._replace(closed=line.square))
    for k in range(COUNT):
        whole = dense(here[k], there[k])
        wanted = np.linalg.solve(whole, right[k].ravel())
        scale = np.linalg.cond(whole) * np.finfo(float).eps * n * m
        assert np.abs(solved[k].ravel() - wanted).max() < 10 * scale * np.abs(wanted).max()
        assert determinants[k] == pytest.approx(np.linalg.det(whole), rel=1e-11)
        row = np.zeros(n * m + 1)
        row[:m], row[-1] = line.way[k, 0], line.rate[k]
        wide = np.vstack([np.column_stack([whole, column[k].ravel()]), row])
        assert bordered[k] == pytest.approx(np.linalg.det(wide), rel=1e-9)


def everything(here, there, right, column):
    cycle = cyclic.eliminate(here, there)
    line = cyclic.underdetermined(cycle, right, column)
    return [cyclic.solve(cycle, right), cyclic.determinant(cycle), cyclic.null_vector(cycle), *line]


@pytest.mark.parametrize(("n", "m"), SIZES)
@pytest.mark.parametrize("order", [np.ascontiguousarray, np.asfortranarray], ids=["C", "Fortran"])
def test_bits_do_not_depend_on_others_nor_on_order(n, m, order):
    each = systems(n, m)
    together = everything(*(order(one) for one in each))
    for k in range(COUNT):
        alone = everything(*(one[k : k + 1] for one in each))
        assert all(np.array_equal(a[k], b[0]) for a, b in zip(together, alone, strict=True))
