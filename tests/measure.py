"""What several tests share: systems and their twins in the Taylor reference, lanes, and solvers under plain diffrax."""

from __future__ import annotations

import functools

import diffrax
import jax
import numpy as np
import pytest
import taylor

from jaxnh.analyses.batch import Axis, LaneBatch, broadcast_start
from jaxnh.engine.accuracy.calibration import Calibration
from jaxnh.engine.axes import SweepPoints
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import section_map
from jaxnh.solvers import IsokineticSplitting, isokinetic_terms
from jaxnh.systems.particle import CHART, constant_speed, disturbed_speed


def some_slow(cases, *quick):
    """Parameters of a test by their ids, of which those named run in `make test` and the others in `make slow`."""
    assert set(quick) < set(cases)
    return [
        pytest.param(
            *(case if isinstance(case, tuple) else (case,)), id=name, marks=[] if name in quick else pytest.mark.slow
        )
        for name, case in cases.items()
    ]


UNIT = np.finfo(float).eps / 2  # roundoff of one operation
SYSTEMS = {
    "constant": constant_speed(),
    "disturbed": disturbed_speed(),
    "other": disturbed_speed(a=0.3, c=1.7, d=0.2, omega=1.5),
}
LANES = 16
B = np.linspace(0.2, 2.4, LANES)
STATES = np.random.default_rng(3).uniform([-1, -1, -3], [1, 1, 3], (LANES, 3))


def twin(system):
    """The parameters of the same system in the Taylor reference."""
    return taylor.Parameters(system.a, system.c, system.d, system.omega)


def scene_of(system, start, values, solver, steps, compensated=False, error=0.0, *, name="b", **others):
    """A scene of lanes along one axis, all from the same start state of floats."""
    values = np.asarray(values, float)
    axis = Axis(name, values, system.flow.labels.long_names[name])
    return LaneBatch(
        system,
        broadcast_start(start, len(values)),
        {name: values},
        solver,
        steps,
        compensated,
        error,
        axis=axis,
        **others,
    )


def calibrated(system, start, values, lanes, precision="float64", *, name="b"):
    """The calibration of lanes along one axis, all of them samples and all from the same start state of floats."""
    p = {name: np.asarray(values, float)}
    return Calibration([SweepPoints(system, broadcast_start(start, len(values)), p, p)], lanes, precision)


def apart(one, other):
    """Largest difference of section coordinates (..., 3), angles modulo whole turns: shape (...,)."""
    gap = np.asarray(one, taylor.REAL) - np.asarray(other, taylor.REAL)
    gap[..., 2] -= taylor.turns(gap[..., 2])
    return np.abs(gap).max(axis=-1).astype(float)


@functools.cache
def stock(system, solver):
    """One period of lanes under `diffrax.diffeqsolve` with constant steps: (u, b, dt) to section points."""
    terms = isokinetic_terms(system) if isinstance(solver, IsokineticSplitting) else diffrax.ODETerm(system.rhs)

    def lane(u, b, dt):
        solution = diffrax.diffeqsolve(
            terms, solver, 0.0, system.period, dt, CHART.state(u), args={"b": b}, max_steps=4096, throw=False
        )
        return CHART.point(jax.tree.map(lambda leaf: leaf[-1], solution.ys))

    return jax.jit(jax.vmap(lane, in_axes=(0, 0, None)))


CALM = {"constant": constant_speed(c=0.1), "disturbed": disturbed_speed(c=0.1, d=0.03)}
"""Slow particles near the origin, with CALM_B and CALM_STATES: the error of a method of order ten already falls by its
law well above the rounding floor, and the flow of a period hardly enlarges roundings."""
CALM_B = np.linspace(0.1, 0.5, LANES)
CALM_STATES = STATES * [0.2, 0.2, 1]


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
    errors = np.array([np.exp(np.log(apart(image, exact)).mean()) for image in images])
    used = errors > 1e-11
    used &= errors < 1e4 * errors[used].min()
    assert used.sum() >= 5
    return -np.polyfit(np.log(steps[used]), np.log(errors[used]), 1)[0]


def turned(blocks, basis):
    """One turn of a basis (3, 3) through blocks (n, 3, 3), by Gram–Schmidt in long double, and ln of its growth (3,)."""
    logs = np.zeros(3, np.longdouble)
    for block in blocks:
        vectors = (block @ basis).T
        for k in range(3):
            for j in range(k):
                vectors[k] -= (vectors[k] @ vectors[j]) * vectors[j]
            length = np.sqrt(vectors[k] @ vectors[k])
            vectors[k] /= length
            logs[k] += np.log(length)
        basis = vectors.T
    return basis, logs
