"""Floquet multipliers of cycles by collocation against closed forms, on meshes that are too coarse for them as well."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.orbits.collocation.cycles import closure
from jaxnh.orbits.collocation.equations import BoundarySolution, linearise
from jaxnh.orbits.collocation.floquet import cycle_multipliers
from jaxnh.orbits.collocation.paths import DEGREE, PiecewisePath
from jaxnh.systems.first_order import first_order
from tests.helpers.cycle_problems import problem_of


def uncoupled(rates):
    """y_k′ = rate_k (1 + cos 2πt) y_k, mixed by a rotation of the coordinates: rests at 0, with multipliers e^rate."""

    def system(b=0.0):
        turn = np.linalg.qr(np.random.default_rng(5).normal(size=(len(rates), len(rates))))[0]
        matrix = turn @ np.diag(rates) @ turn.T

        def rhs(y, t):
            return tuple((1.0 + jnp.cos(2 * jnp.pi * t)) * (jnp.asarray(matrix) @ jnp.stack(y)) + b)

        return {"rhs": rhs, "coordinates": tuple(f"y{k}" for k in range(len(rates))), "period": 1.0}

    return system


def multipliers_on(rates, n):
    d = len(rates)
    problem = problem_of(first_order(uncoupled(rates), {"b": 0.0}, ("b",)), ("b",), np.ones(d))
    path = PiecewisePath(np.linspace(0.0, 1.0, n + 1)[None], np.zeros((1, n + 1, d)), np.zeros((1, n, DEGREE, d)))
    solution = BoundarySolution(path, np.ones(1), np.zeros((1, 1)))
    line = linearise(problem, solution, closure(problem, np.zeros((1, d)))(solution, np.zeros(1, int)))
    values, errors = cycle_multipliers(problem, solution, line.blocks, line.divergence)
    order = np.argsort(-np.asarray(rates))
    return values[0], errors[0], np.exp(np.asarray(rates)[order])


@pytest.mark.parametrize(
    "rates",
    [(-300.0,), (200.0,), (0.5, -1.0), (50.0, -100.0), (60.0, 55.0), (-0.1, -500.0), (30.0, -0.2, -900.0)],
    ids=str,
)
def test_multipliers_are_within_errors_or_not_told(rates):
    """On 4 intervals to 160; on the finest all are told, but for what is nothing beside one."""
    for n in (4, 10, 40, 160):
        values, errors, exact = multipliers_on(rates, n)
        known = np.isfinite(values)
        assert np.array_equal(known, np.isfinite(errors))
        rounding = 1e-12 * exact * n
        assert np.all(np.abs(values - exact)[known] <= errors[known] + rounding[known]), n
    assert known.all()
    assert np.all((errors <= 1e-4 * exact) | (exact < 1e-12))


def test_what_neither_grows_nor_decays_on_the_mesh_is_not_told():
    """Rates of 50 and −100 on four intervals: the products are of numbers around one, and say nothing."""
    values, errors, _ = multipliers_on((50.0, -100.0), 4)
    assert np.all(np.isnan(values))
    assert np.all(np.isinf(errors))


def test_one_multiplier_is_told_by_the_divergence_alone():
    """Rates that four intervals turn into numbers around one: the integral of the divergence is theirs to rounding."""
    for rate in (-300.0, 200.0):
        values, errors, exact = multipliers_on((rate,), 4)
        assert abs(np.log(values[0].real) - rate) < 1.0
        assert abs(values[0] - exact[0]) <= errors[0]
