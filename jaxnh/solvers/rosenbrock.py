"""Rosenbrock–Wanner methods: linearly implicit steps, which follow a stiff motion at the pace of what is slow in it.

A step takes the field's Jacobian once, by forward mode, and solves a linear system with it for every stage. Nothing is
iterated, so that a step has an exact derivative as an explicit one has.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.scipy.linalg import lu_factor, lu_solve
from jaxtyping import Array

from jaxnh.solvers.runge_kutta import combine
from jaxnh.systems.elimination import Factors, factorise, substitute

_WRITTEN_OUT = 8  # coordinates up to which elimination is written out: its equations grow with their cube

Numbers = list[Any]
"""Numbers of one lane, each ()."""


class PairStep(NamedTuple):
    """A step of an embedded pair.

    Attributes:
        y: coordinates after it.
        error: estimates of their errors.
        gained: what is only integrated along, over the step.
    """

    y: Numbers
    error: Numbers
    gained: Numbers


class Rosenbrock(eqx.Module):
    """A tableau in the form without products of the Jacobian and stages (Hairer and Wanner II, (IV.7.25)).

    Attributes:
        a: rows of the tableau below the diagonal, first row empty.
        couplings: rows of the matrix C of stages in right sides, below the diagonal.
        b: weights of the solution, one a stage.
        b_error: weights of the error estimate.
        c: abscissae.
        d: weights of the time derivative.
        gamma: the diagonal.
        convergence_order: order of the solution; that of the embedded one is one less.
        name: name in configs and result files.
        source: where the coefficients come from.
    """

    a: tuple[tuple[float, ...], ...] = eqx.field(static=True)
    couplings: tuple[tuple[float, ...], ...] = eqx.field(static=True)
    b: tuple[float, ...] = eqx.field(static=True)
    b_error: tuple[float, ...] = eqx.field(static=True)
    c: tuple[float, ...] = eqx.field(static=True)
    d: tuple[float, ...] = eqx.field(static=True)
    gamma: float = eqx.field(static=True)
    convergence_order: int = eqx.field(static=True)
    name: str = eqx.field(static=True)
    source: str = eqx.field(static=True)

    @property
    def stages(self) -> int:
        """Evaluations of the field a step."""
        return len(self.b)

    def pair_step(self, field: Callable[[Any, Numbers], Numbers], t: Any, h: Any, y: Numbers) -> PairStep:
        """One step with its error estimate.

        Args:
            field: of time and the d coordinates; their rates, and behind them rates of what is only integrated along.
            t: the time at the beginning.
            h: the step.
            y: coordinates, each ().
        """
        if len(y) > _WRITTEN_OUT:
            return self._dense_step(field, t, h, y)
        n = len(y)
        first, push = jax.linearize(field, t, y)
        columns = _columns(push, t, y)
        by_time = columns.pop()
        jacobian = [[column[i] for column in columns] for i in range(len(first))]
        diagonal = 1.0 / (h * self.gamma)
        matrix = [[diagonal - x if i == j else -x for j, x in enumerate(row)] for i, row in enumerate(jacobian[:n])]
        factors = factorise(jax.tree.map(lax.stop_gradient, matrix))
        stages: list[Numbers] = []
        for i in range(self.stages):
            moved = combine(y, self.a[i], [stage[:n] for stage in stages])
            rates = field(t + self.c[i] * h, moved) if i else first
            coupled = combine(None, self.couplings[i], stages)
            right = [rate + self.d[i] * h * dt for rate, dt in zip(rates, by_time, strict=True)] if self.d[i] else rates
            right = [x + z / h for x, z in zip(right, coupled, strict=True)] if coupled else right
            stage = _solve(matrix, factors, right[:n])
            for row, x in zip(jacobian[n:], right[n:], strict=True):
                along = sum((slope * z for slope, z in zip(row, stage[:n], strict=True)), x)
                stage = [*stage, along * h * self.gamma]
            stages.append(stage)
        gained = combine(None, self.b, [stage[n:] for stage in stages])
        inner = [stage[:n] for stage in stages]
        return PairStep(combine(y, self.b, inner), combine(None, self.b_error, inner), gained)

    def _dense_step(self, field: Callable[[Any, Numbers], Numbers], t: Any, h: Any, y: Numbers) -> PairStep:
        """The same step with arrays of all coordinates: equations of numbers grow with the square of their count."""
        n, start = len(y), jnp.stack(y)

        def rates(t: Any, y: Any) -> Any:
            return jnp.stack(field(t, list(y)))

        first, push = jax.linearize(rates, t, start)
        basis = jnp.eye(n + 1)
        *columns, by_time = jax.vmap(push)(basis[:, n], basis[:, :n])
        jacobian = jnp.stack(columns, axis=1)
        matrix = basis[:n, :n] / (h * self.gamma) - jacobian[:n]
        factors = lu_factor(lax.stop_gradient(matrix))
        stages: list[Any] = []
        for i in range(self.stages):
            right = rates(t + self.c[i] * h, combine(start, self.a[i], [stage[:n] for stage in stages])) if i else first
            right = right + self.d[i] * h * by_time
            coupled = combine(None, self.couplings[i], stages)
            right = right if coupled is None else right + coupled / h
            stage = _solve_dense(matrix, factors, right[:n])
            along = (right[n:] + jacobian[n:] @ stage) * h * self.gamma
            stages.append(jnp.concatenate([stage, along]))
        solution = combine(None, self.b, stages)
        error = combine(None, self.b_error, stages)
        return PairStep(list(start + solution[:n]), list(error[:n]), list(solution[n:]))


def _columns(push: Callable[..., Numbers], t: Any, y: Numbers) -> list[Numbers]:
    """Derivatives of a field in every coordinate and, as the last, in time, each a list of numbers."""
    n = len(y)
    units = [[jnp.full_like(x, float(i == j)) for i, x in enumerate(y)] for j in range(n + 1)]
    return [push(jnp.full_like(t, float(j == n)), unit) for j, unit in enumerate(units)]


@jax.custom_jvp
def _solve(matrix: list[Numbers], factors: Factors, right: Numbers) -> Numbers:
    """Solution of a linear system whose matrix is factorised: its derivative is one more solution."""
    return substitute(factors, right)


@_solve.defjvp
def _(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Numbers, Numbers]:
    matrix, factors, right = primals
    solution = _solve(matrix, factors, right)
    moved = [
        x - sum(slope * z for slope, z in zip(row, solution, strict=True))
        for x, row in zip(tangents[2], tangents[0], strict=True)
    ]
    return solution, _solve(matrix, factors, moved)


@jax.custom_jvp
def _solve_dense(matrix: Array, factors: tuple[Array, Array], right: Array) -> Array:
    """The same of arrays (n, n) and (n,), by LAPACK."""
    return lu_solve(factors, right)


@_solve_dense.defjvp
def _(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Array, Array]:
    matrix, factors, right = primals
    solution = _solve_dense(matrix, factors, right)
    return solution, _solve_dense(matrix, factors, tangents[2] - tangents[0] @ solution)


_ROW = (-7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256, 0.030198172008377946)

# fmt: off
rodas5p = Rosenbrock(
    a=(
        (),
        (3.0,),
        (2.849394379747939, 0.45842242204463923),
        (-6.954028509809101, 2.489845061869568, -10.358996098473584),
        (2.8029986275628964, 0.5072464736228206, -0.3988312541770524, -0.04721187230404641),
        _ROW,
        (*_ROW, 1.0),
        (*_ROW, 1.0, 1.0),
    ),
    couplings=(
        (),
        (-14.155112264123755,),
        (-17.97296035885952, -2.859693295451294),
        (147.12150275711716, -1.41221402718213, 71.68940251302358),
        (165.43517024871676, -0.4592823456491126, 42.90938336958603, -5.961986721573306),
        (24.854864614690072, -3.0009227002832186, 47.4931110020768, 5.5814197821558125, -0.6610691825249471),
        (
            30.91273214028599, -3.1208243349937974, 77.79954646070892, 34.28646028294783, -19.097331116725623,
            -28.087943162872662,
        ),
        (
            37.80277123390563, -3.2571969029072276, 112.26918849496327, 66.9347231244047, -40.06618937091002,
            -54.66780262877968, -9.48861652309627,
        ),
    ),
    b=(*_ROW, 1.0, 1.0, 1.0),
    b_error=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
    c=(0.0, 0.6358126895828704, 0.4095798393397535, 0.9769306725060716, 0.4288403609558664, 1.0, 1.0, 1.0),
    d=(
        0.21193756319429014, -0.42387512638858027, -0.3384627126235924, 1.8046452872882734, 2.325825639765069, 0.0,
        0.0, 0.0,
    ),
    gamma=0.21193756319429014,
    convergence_order=5,
    name="rodas5p",
    source="Steinebach, BIT Numer. Math. 63 (2023) 27",
)
# fmt: on
"""Rodas5P, order 5(4), eight stages, stiffly accurate and L-stable."""
