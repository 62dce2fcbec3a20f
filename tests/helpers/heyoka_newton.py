"""Bifurcations of maps of any flow, by heyoka's Taylor integrator in long double with a Newton of its own.

A map is a function of the parameter, or of several, and a point (d,): its image (d,) and the derivatives there, (d, d).
The rates of a flow are a function of all coordinates, of the parameters and of time, of heyoka's expressions as of numbers.
"""

from __future__ import annotations

import functools
import itertools

import heyoka as hy
import numpy as np

from tests.helpers.taylor import REAL

_SHIFT = 1e-6  # of differences: its square, and the unit roundoff of long double over it, are below 1e-11
_LEFT = 1e-3  # of time, after which a motion has left the section that it began on
_LONG = float if REAL is np.float64 else REAL


@functools.cache
def _integrator(rates, d, parameters=1):
    """The integrator with tangents, and its state at time 0."""
    state = hy.make_vars(*(f"y{k}" for k in range(d)))
    motion = list(zip(state, rates(*state, *(hy.par[k] for k in range(parameters)), hy.time), strict=True))
    equations = hy.var_ode_sys(motion, [*state], order=1)
    start, pars = np.zeros(d, REAL), np.zeros(parameters, REAL)
    ta = hy.taylor_adaptive(equations, start, pars=pars, fp_type=_LONG, compact_mode=True)
    return ta, ta.state.copy()


def _reset(ta, at_zero, value, y):
    ta.pars[:], ta.state[:], ta.time = value, at_zero, REAL(0)
    ta.state[: len(y)] = y


def iterated(image, n):
    """Pⁿ of a map."""

    def power(value, u):
        whole = np.eye(len(u), dtype=REAL)
        for _ in range(n):
            u, first = image(value, u)
            whole = first @ whole
        return u, whole

    return power


def strobe_map(rates, d, period, n=1, parameters=1):
    """Pⁿ of a flow with a clock."""

    def image(value, u):
        ta, at_zero = _integrator(rates, d, parameters)
        _reset(ta, at_zero, value, u)
        assert ta.propagate_until(REAL(period))[0] == hy.taylor_outcome.time_limit
        return ta.state[:d].copy(), ta.state[d:].reshape(d, d).copy()

    return iterated(image, n)


def section_map(rates, d, place, level, direction):
    """P of a flow without a clock on the plane where a coordinate passes a level: of the other coordinates, (d − 1,)."""
    others = np.delete(np.arange(d), place)

    def image(value, u):
        ta, at_zero = _integrator(rates, d)
        start = np.insert(np.asarray(u, REAL), place, REAL(level))
        end, rate = _crossing_time(rates, d, place, level, direction, value, start), np.ones(d, REAL)
        _reset(ta, at_zero, value, start)
        for _ in range(2):  # Newton in time, from a time that is all but exact
            assert ta.propagate_until(end)[0] == hy.taylor_outcome.time_limit
            rate = np.array(rates(*ta.state[:d], REAL(value), REAL(0)), REAL)
            end = end - (ta.state[place] - REAL(level)) / rate[place]
        first = ta.state[d:].reshape(d, d)
        onto = first - np.outer(rate, first[place]) / rate[place]  # all stay on the section
        return ta.state[others].copy(), onto[np.ix_(others, others)]

    return image


def _crossing_time(rates, d, place, level, direction, value, start):
    """Return when a motion first passes the level in a direction, +1 or −1, after it has left it."""
    ta, times = _with_events(rates, d, place, level, direction)
    times.clear()
    ta.pars[0], ta.state[:], ta.time = REAL(value), start, REAL(0)
    while not times:
        assert ta.step()[0] in (hy.taylor_outcome.success, hy.taylor_outcome.time_limit)
        times[:] = [t for t in times if t > _LEFT]
    return times[0]


@functools.cache
def _with_events(rates, d, place, level, direction):
    """The integrator without tangents, and the list that it puts the times of crossings into."""
    state, times = hy.make_vars(*(f"y{k}" for k in range(d))), []
    motion = list(zip(state, rates(*state, hy.par[0], hy.time), strict=True))
    way = hy.event_direction.positive if direction > 0 else hy.event_direction.negative
    event = hy.nt_event(state[place] - REAL(level), lambda ta, t, d: times.append(t), direction=way, fp_type=_LONG)
    start = np.zeros(d, REAL)
    ta = hy.taylor_adaptive(motion, start, pars=[REAL(0)], fp_type=_LONG, nt_events=[event], compact_mode=True)
    return ta, times


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
"""Functions that are zero at a bifurcation, by its kind."""


def newton(mismatch, at):
    """Return where a function of some unknowns, of as many components, is zero; slopes by differences.

    Raises:
        ArithmeticError: the steps do not become small.
    """
    at = np.asarray(at, REAL)
    for _ in range(8):
        shifts = _SHIFT * np.eye(len(at), dtype=REAL)
        slopes = np.array([(mismatch(at + h) - mismatch(at - h)) / (2 * _SHIFT) for h in shifts]).T
        step = np.linalg.solve(slopes.astype(float), -mismatch(at).astype(float))
        at = at + step
        if np.abs(step).max() < 1e-12 * max(1.0, float(np.abs(at).max())):
            return at
    raise ArithmeticError("Newton's steps do not become small")


def bifurcation(image, kind, value, u, wrap=lambda gap: gap):
    """The parameter and the multipliers at the fixed point of a map with a bifurcation of this kind, near a guess."""

    def mismatch(at):
        end, matrix = image(at[0], at[1:])
        return np.append(wrap(end - at[1:]), TESTS[kind](matrix))

    at = newton(mismatch, [value, *u])
    return float(at[0]), np.linalg.eigvals(image(at[0], at[1:])[1].astype(float))
