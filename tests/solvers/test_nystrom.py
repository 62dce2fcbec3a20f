"""Nyström's methods against closed forms, and the identities of their tableaus."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.solvers import NYSTROM
from tests.helpers.measurement import UNIT

methods = pytest.mark.parametrize("solver", NYSTROM.values(), ids=NYSTROM)


@methods
def test_tableau(solver):
    """Rows add up to c²/2, and the weights integrate every power of t that the order needs, to their rounding."""
    c, b, b_rate = (np.array(row) for row in (solver.c, solver.b, solver.b_rate))
    for row, abscissa in zip(solver.a, solver.c, strict=True):
        assert abs(sum(row) - abscissa**2 / 2) <= 4 * UNIT * sum(map(abs, row))
    for k in range(solver.convergence_order):
        assert abs(b_rate @ c**k - 1 / (k + 1)) < 8 * UNIT
    for k in range(solver.convergence_order - 1):
        assert abs(b @ c**k - 1 / ((k + 1) * (k + 2))) < 8 * UNIT


@methods
def test_order(solver):
    """Of x″ = 2 x³ + 6 t (x − 1/(1 + t)), solved by 1/(1 + t): half the step leaves 2^−order of the error, and less."""

    def error(steps):
        h, x, v = 1.0 / steps, np.float64(1.0), np.float64(-1.0)
        for i in range(steps):

            def force(s, x, t=i * h):
                t = t + solver.c[s] * h
                return 2.0 * x**3 + 6.0 * t * (x - 1.0 / (1.0 + t))

            x, v = solver.written_stages(force, h, x, v)
        return max(abs(x - 0.5), abs(v + 0.25))

    slope = np.log2(error(4) / error(8))
    assert solver.convergence_order - 0.5 < slope < solver.convergence_order + 1.5
