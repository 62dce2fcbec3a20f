"""Rosenbrock methods: every order condition, order on problems whose motion is known, and stability."""

from __future__ import annotations

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.solvers.rosenbrock import rodas5p
from jaxnh.solvers.runge_kutta import combine
from tests.helpers.measurement import UNIT


def trees(order):
    """Rooted trees of so many vertices, each a sorted tuple of its branches."""
    if order == 1:
        return [()]
    made = set()
    for parts in partitions(order - 1):
        for branches in itertools.product(*(trees(part) for part in parts)):
            made.add(tuple(sorted(branches)))
    return sorted(made)


def partitions(number, largest=None):
    """Falling sums that make a number."""
    if number == 0:
        yield ()
    for first in range(min(number, largest or number), 0, -1):
        for rest in partitions(number - first, first):
            yield first, *rest


def vertices(tree):
    return 1 + sum(map(vertices, tree))


def density(tree):
    """γ of a tree: the product of the vertices of all its subtrees."""
    return vertices(tree) * math.prod(map(density, tree))


def square(rows, n):
    return np.array([[*row, *[0.0] * (n - len(row))] for row in rows])


def original_form(method):
    """α, β = α + Γ, and the weights of both solutions (Hairer and Wanner II, (IV.7.24) turned round)."""
    n = method.stages
    gammas = np.linalg.inv(np.eye(n) / method.gamma - square(method.couplings, n))
    alpha = square(method.a, n) @ gammas
    embedded = np.array(method.b) - np.array(method.b_error)
    return alpha, alpha + gammas, np.array(method.b) @ gammas, embedded @ gammas


def elementary_weights(tree, alpha, beta):
    """Of the stages: a vertex with one branch has β, one with several has α (Hairer and Wanner II, theorem IV.7.4)."""
    matrix = beta if len(tree) == 1 else alpha
    weights = np.ones(len(alpha))
    for branch in tree:
        weights = weights * (matrix @ elementary_weights(branch, alpha, beta))
    return weights


def test_there_are_as_many_trees_as_there_are():
    assert [len(trees(order)) for order in range(1, 6)] == [1, 1, 2, 4, 9]  # Butcher's count


@pytest.mark.parametrize("tree", [tree for order in range(1, 6) for tree in trees(order)], ids=str)
def test_order_conditions(tree):
    """Coefficients have 16 digits, and products of α and β up to 10⁴: what is left is their rounding."""
    alpha, beta, b, embedded = original_form(rodas5p)
    weights = elementary_weights(tree, alpha, beta)
    rounding = 1e4 * UNIT
    assert abs(b @ weights - 1.0 / density(tree)) < rounding
    if vertices(tree) < 5:
        assert abs(embedded @ weights - 1.0 / density(tree)) < rounding


def test_embedded_solution_has_order_four_and_no_more():
    alpha, beta, _, embedded = original_form(rodas5p)
    left = [abs(embedded @ elementary_weights(tree, alpha, beta) - 1.0 / density(tree)) for tree in trees(5)]
    assert max(left) > 1e-4


def test_abscissae_and_weights_of_the_time_derivative():
    """An equation for time itself, t' = 1, must give c and d of the tableau."""
    alpha, beta, _, _ = original_form(rodas5p)
    np.testing.assert_allclose(alpha.sum(axis=1), rodas5p.c, atol=1e3 * UNIT)
    np.testing.assert_allclose((beta - alpha).sum(axis=1), rodas5p.d, atol=1e3 * UNIT)


# ---- the steps themselves


def forced(t, y):
    """y' = −2 (y − cos t) − sin t and its integral ∫ y dt behind it: y = cos t from y = 1."""
    return [-2.0 * (y[0] - jnp.cos(t)) - jnp.sin(t), y[0]]


def pendulum_like(t, y):
    """(x, v)' of x = tanh t: x' = v, v' = −2 x v, whose v = 1 − x²; behind it ∫ v dt."""
    return [y[1], -2.0 * y[0] * y[1], y[1]]


PROBLEMS = {
    "linear, with time": (forced, [1.0], lambda t: [np.cos(t)], np.sin),
    "not linear": (pendulum_like, [0.0, 1.0], lambda t: [np.tanh(t), 1.0 / np.cosh(t) ** 2], np.tanh),
}


def run(field, y, steps, length=1.0, embedded=False):
    """So many equal steps; the last one by the embedded solution if asked for, of which one step has the error."""

    @jax.jit
    def step(t, y):
        return rodas5p.pair_step(field, t, length / steps, y)

    y, gained = [jnp.float64(x) for x in y], 0.0
    for i in range(steps):
        made = step(jnp.float64(i * length / steps), y)
        y = [x - e for x, e in zip(made.y, made.error, strict=True)] if embedded else made.y
        gained = gained + made.gained[0]
    return np.array(y), float(gained)


@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize(("embedded", "order"), [(False, 5), (True, 4)])
def test_order_on_known_motions(name, embedded, order):
    """Errors fall by 2^−order when steps are halved, of states and of what is only integrated along."""
    field, start, exact, integral = PROBLEMS[name]
    coarse, fine = (run(field, start, steps, embedded=embedded) for steps in (16, 32))
    errors = [np.abs(y - exact(1.0)).max() for y, _ in (coarse, fine)]
    assert order - 0.5 < math.log2(errors[0] / errors[1]) < order + 1.5
    if not embedded:
        gaps = [abs(gained - integral(1.0)) for _, gained in (coarse, fine)]
        assert order - 0.5 < math.log2(gaps[0] / gaps[1]) < order + 1.5


@pytest.mark.parametrize("rate", [1e3, 1e6, 1e12])
def test_l_stability(rate):
    """Of y' = −λ y what a step leaves falls with λ h without bound: stiffly accurate, with R(∞) = 0."""
    made = rodas5p.pair_step(lambda t, y: [-rate * y[0]], jnp.float64(0.0), 1.0, [jnp.float64(1.0)])
    assert abs(float(made.y[0])) < 100.0 / rate + 100 * UNIT


@pytest.mark.parametrize("n", [3, 12])
def test_written_out_and_lapack(n):
    """A linear system of n equations: a step is the rational function of its matrix, by numpy's inverses.

    With 3 coordinates elimination is written out, with 12 it is LAPACK's.
    """
    matrix = np.random.default_rng(7).normal(size=(n, n)) - 3.0 * np.eye(n)
    start, h = np.random.default_rng(8).normal(size=n), 0.3

    def field(t, y):
        return [sum(float(matrix[i, j]) * y[j] for j in range(n)) for i in range(n)]

    made = rodas5p.pair_step(field, jnp.float64(0.0), h, [jnp.float64(x) for x in start])
    inverse = np.linalg.inv(np.eye(n) / (h * rodas5p.gamma) - matrix)
    stages = []
    for a, c in zip(rodas5p.a, rodas5p.couplings, strict=True):
        moved = combine(start, a, stages)
        coupled = combine(np.zeros(n), c, stages)
        stages.append(inverse @ (matrix @ moved + coupled / h))
    np.testing.assert_allclose(np.array(made.y), combine(start, rodas5p.b, stages), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("more", [0, 9])
def test_derivative_of_a_step(more):
    """Of a step in its start, by `jax.jvp`, against central differences of it; with 11 coordinates by LAPACK."""

    def field(t, y):
        x, v, *others = y
        rates = pendulum_like(t, (x, v))
        return [*rates[:2], *(v - k * z * x for k, z in enumerate(others)), rates[2]]

    def end(x, v):
        made = rodas5p.pair_step(field, jnp.float64(0.1), 0.3, [x, v, *(0.1 * x for _ in range(more))])
        return jnp.stack([*made.y, *made.gained])

    at, along, small = (0.3, 0.8), (0.6, -0.7), 1e-5
    _, slope = jax.jvp(end, tuple(map(jnp.float64, at)), tuple(map(jnp.float64, along)))
    ahead, behind = (end(*(jnp.float64(x + s * small * d) for x, d in zip(at, along, strict=True))) for s in (1, -1))
    np.testing.assert_allclose(slope, (ahead - behind) / (2 * small), rtol=1e-8, atol=1e-9)
