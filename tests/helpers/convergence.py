"""Errors of maps and their derivatives, falling with the steps, on the calm particle, against the Taylor reference."""

from __future__ import annotations

import functools

import diffrax
import jax
import numpy as np

from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import derivatives, section_map
from jaxnh.solvers import SPLITTINGS, IsokineticSplitting
from jaxnh.systems.particle import CHART
from tests.flows.calm_particle import CALM_B, CALM_STATES, P
from tests.flows.particle import twin
from tests.helpers import taylor
from tests.helpers.diffrax_solvers import RungeKuttaSolver, SplittingSolver, isokinetic_terms
from tests.helpers.measurement import largest_difference

FINEST = max(SPLITTINGS.values(), key=lambda solver: solver.convergence_order)


def check_derivatives(lanes, strobe, system, error):
    """Against the derivatives of the reference, to the error of the map; those of M and of the slope relative to it."""
    u, monodromy, slope = lanes(derivatives, (strobe, np.int32(1)), (CALM_STATES, P), static=("b",))
    exact, exact_monodromy, exact_slope = taylor.strobe_jacobian(twin(system), CALM_B, CALM_STATES)
    assert np.max(largest_difference(u, exact)) < error
    gaps = derivatives_apart((monodromy, slope), (exact_monodromy, exact_slope))
    assert np.max(np.abs(gaps).max(axis=1) / size(exact_monodromy, exact_slope)) < error


def derivatives_apart(one, other):
    """Differences of monodromy matrices and slopes, all numbers of a lane in a row: (lanes, 12)."""
    return np.concatenate([(a - b).astype(float).reshape(len(a), -1) for a, b in zip(one, other, strict=True)], axis=1)


def size(monodromy, slope):
    """Largest derivative of each lane."""
    return np.maximum(np.abs(monodromy).max(axis=(1, 2)), np.abs(slope).max(axis=1))


@functools.cache
def stock(system, solver):
    """One period of lanes under `diffrax.diffeqsolve` with constant steps: (u, b, dt) to section points."""
    if isinstance(solver, IsokineticSplitting):
        terms, steps = isokinetic_terms(system), SplittingSolver(solver)
    else:
        terms, steps = diffrax.ODETerm(system.rhs), RungeKuttaSolver(solver)

    def lane(u, b, dt):
        solution = diffrax.diffeqsolve(
            terms, steps, 0.0, system.period, dt, CHART.state(u), args={"b": b}, max_steps=4096, throw=False
        )
        return CHART.point(jax.tree.map(lambda leaf: leaf[-1], solution.ys))

    return jax.jit(jax.vmap(lane, in_axes=(0, 0, None)))


def order_of(system, solver):
    """Order of convergence of a solver: the slope of log error over log steps, under plain diffrax.

    Of a processed splitting the steps are those of the strobe map, which has the processor at its ends.

    The error of a number of steps is the geometric mean over lanes of one period's error against the Taylor reference.
    The slope is fitted over the finest steps, down to errors of 1e-11, some 100 times what rounding leaves, and from
    there on over up to four digits of error.
    """
    exact = taylor.strobe(twin(system), CALM_B, CALM_STATES)
    steps = np.unique(np.rint(np.geomspace(50, 2000, 22) / solver.stages).astype(int))
    if isinstance(solver, IsokineticSplitting) and solver.processor[1]:
        run = jax.jit(jax.vmap(section_map, in_axes=(None, None, 0, 0)))
        images = (run(make_return_map(system, solver, n), 1, CALM_STATES, {"b": CALM_B}) for n in steps.tolist())
    else:
        images = (stock(system, solver)(CALM_STATES, CALM_B, system.period / n) for n in steps)
    errors = np.array([np.exp(np.log(largest_difference(image, exact)).mean()) for image in images])
    used = errors > 1e-11
    used &= errors < 1e4 * errors[used].min()
    assert used.sum() >= 5
    return -np.polyfit(np.log(steps[used]), np.log(errors[used]), 1)[0]
