"""Bifurcations of maps of any flow, by heyoka's Taylor integrator in long double with a Newton of its own.

A map is a function of the parameter and a point (d,): its image (d,) and the derivatives there, (d, d). The rates of a
flow are a function of all coordinates, of the parameter and of time, of heyoka's expressions as of numbers.
"""

from __future__ import annotations

import functools
import itertools

import heyoka as hy
import numpy as np
from taylor import REAL

_SHIFT = 1e-6  # of differences: its square, and the unit roundoff of long double over it, are below 1e-11
_LONG = float if REAL is np.float64 else REAL


@functools.cache
def _integrator(rates, d):
    """The integrator with tangents, and its state at time 0."""
    state = hy.make_vars(*(f"y{k}" for k in range(d)))
    motion = list(zip(state, rates(*state, hy.par[0], hy.time), strict=True))
    equations = hy.var_ode_sys(motion, [*state], order=1)
    start = np.zeros(d, REAL)
    ta = hy.taylor_adaptive(equations, start, pars=[REAL(0)], fp_type=_LONG, compact_mode=True)
    return ta, ta.state.copy()


def _begun(ta, at_zero, value, y):
    ta.pars[0], ta.state[:], ta.time = REAL(value), at_zero, REAL(0)
    ta.state[: len(y)] = y


def strobe_map(rates, d, period, n=1):
    """Pⁿ of a flow with a clock."""

    def image(value, u):
        ta, at_zero = _integrator(rates, d)
        whole = np.eye(d, dtype=REAL)
        for _ in range(n):
            _begun(ta, at_zero, value, u)
            assert ta.propagate_until(REAL(period))[0] == hy.taylor_outcome.time_limit
            u, whole = ta.state[:d].copy(), ta.state[d:].reshape(d, d) @ whole
        return u, whole

    return image


def return_map(rates, d, across, level=0.0, *, rising=True, stride=0.05):
    """The map from the plane where a coordinate has a value to its next crossing, upwards or downwards."""

    def image(value, u):
        ta, at_zero = _integrator(rates, d)
        _begun(ta, at_zero, value, np.insert(np.asarray(u, REAL), across, REAL(level)))

        def to(time):
            assert ta.propagate_until(time)[0] == hy.taylor_outcome.time_limit
            return float(ta.state[across] - REAL(level)) * (1 if rising else -1)

        height = to(ta.time + REAL(stride))  # away from the plane where it begins
        while True:
            before, height = height, to(ta.time + REAL(stride))
            if before < 0 <= height:
                break
        for _ in range(6):
            rate = np.array(rates(*ta.state[:d], REAL(value), ta.time), REAL)
            to(ta.time - (ta.state[across] - REAL(level)) / rate[across])
        rate = np.array(rates(*ta.state[:d], REAL(value), ta.time), REAL)
        whole = ta.state[d:].reshape(d, d)
        whole = whole - np.outer(rate, whole[across]) / rate[across]
        others = [k for k in range(d) if k != across]
        return ta.state[others].copy(), whole[np.ix_(others, others)]

    return image


def determinant(matrix):
    """By minors, in any arithmetic."""
    if len(matrix) == 1:
        return matrix[0, 0]
    rest = range(len(matrix))
    return sum((-1) ** k * matrix[0, k] * determinant(matrix[1:][:, [j for j in rest if j != k]]) for k in rest)


def minors(matrix):
    """All minors of two rows and two columns: eigenvalues are products of two."""
    pairs = list(itertools.combinations(range(len(matrix)), 2))
    return np.array([[determinant(matrix[np.ix_(rows, columns)]) for columns in pairs] for rows in pairs])


def _less(matrix, number):
    return determinant(matrix - number * np.eye(len(matrix), dtype=matrix.dtype))


TESTS = {
    "fold": lambda matrix: _less(matrix, 1),
    "period_doubling": lambda matrix: _less(matrix, -1),
    "neimark_sacker": lambda matrix: _less(minors(matrix), 1),
}
"""What is zero at a bifurcation, by its kind."""


def bifurcation(image, kind, value, u, wrap=lambda gap: gap):
    """The parameter and the multipliers at the fixed point of a map with a bifurcation of this kind, near a guess."""
    at = np.array([value, *u], REAL)

    def mismatch(at):
        end, matrix = image(at[0], at[1:])
        return np.append(wrap(end - at[1:]), TESTS[kind](matrix))

    for _ in range(8):
        shifts = _SHIFT * np.eye(len(at), dtype=REAL)
        slopes = np.array([(mismatch(at + h) - mismatch(at - h)) / (2 * _SHIFT) for h in shifts]).T
        step = np.linalg.solve(slopes.astype(float), -mismatch(at).astype(float))
        at = at + step
        if np.abs(step).max() < 1e-12 * max(1.0, float(np.abs(at).max())):
            return float(at[0]), np.linalg.eigvals(image(at[0], at[1:])[1].astype(float))
    raise ArithmeticError(f"no {kind} near {value}")
