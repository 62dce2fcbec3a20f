"""Explicit Runge–Kutta methods with their stages written out over a tuple state.

diffrax keeps the stages of its own Runge–Kutta solvers in one growing array; under vmap on a CPU, moving that array
costs ten times the arithmetic. Here every stage is an expression of its own, and zero coefficients leave no trace.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxnh.solvers.explicit_method import ExplicitMethod


class WrittenOutRungeKutta(ExplicitMethod, diffrax.AbstractAdaptiveSolver):
    """Any explicit diffrax tableau, with its embedded error estimate, stages written out.

    The state may be any pytree. Nothing is carried from step to step (no FSAL); what only the error estimate or the
    interpolation needs is removed by XLA where they are not read.

    Attributes:
        b_error: weights of the error estimate, one a stage.
    """

    b_error: tuple[float, ...] = eqx.field(static=True)

    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar = diffrax.ThirdOrderHermitePolynomialInterpolation

    @property
    def stages(self) -> int:
        """Evaluations of the vector field that the solution needs, a step."""
        return sum(1 for i in range(len(self.b)) if self.b[i] or any(i < len(row) and row[i] for row in self.a))

    def order(self, terms: Any) -> int:
        return self.convergence_order

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> None:
        return None

    def func(self, terms: diffrax.AbstractTerm, t0: Any, y0: Any, args: Any) -> Any:
        return terms.vf(t0, y0, args)

    def step(
        self, terms: diffrax.AbstractTerm, t0: Any, t1: Any, y0: Any, args: Any, solver_state: Any, made_jump: Any
    ) -> tuple[Any, Any, dict[str, Any], None, diffrax.RESULTS]:
        """One step; the third value carries what third-order Hermite interpolation needs."""
        del solver_state, made_jump
        h = terms.contr(t0, t1)
        stages = self._stages(
            lambda i, y: terms.vf(t0 + self.c[i] * (t1 - t0), y, args), h, y0, len(self.b), terms.prod
        )
        y1 = _combine(y0, self.b, stages)
        error = _combine(None, self.b_error, stages)
        end = terms.prod(terms.vf(t1, y1, args), h)
        return y1, error, {"y0": y0, "y1": y1, "k0": stages[0], "k1": end}, None, diffrax.RESULTS.successful

    def written_stages(self, field: Callable[[int, Any], Any], h: Any, y0: Any) -> Any:
        """The state after a step h under a field of (number of the stage, state), stages written out."""
        return _combine(y0, self.b[: self.stages], self._stages(field, h, y0, self.stages, _times))

    def _stages(
        self, field: Callable[[int, Any], Any], h: Any, y0: Any, count: int, prod: Callable[[Any, Any], Any]
    ) -> list[Any]:
        """Rates at the first stages, times h."""
        stages: list[Any] = []
        for i in range(count):
            stages.append(prod(field(i, _combine(y0, self.a[i], stages)), h))
        return stages

    def rolled_step(self, terms: diffrax.AbstractTerm, t0: Any, t1: Any, y0: Any, args: Any) -> Any:
        """The state after one step, its stages in a loop."""
        nodes = jnp.asarray(self.c[: self.stages])
        return self.rolled_stages(lambda i, y: terms.vf(t0 + nodes[i] * (t1 - t0), y, args), terms.contr(t0, t1), y0)

    def rolled_stages(self, field: Callable[[Any, Any], Any], h: Any, y0: Any) -> Any:
        """Compute `written_stages` with the stages in a loop: one field in the program where that has them all.

        Some twice as slow to run and ten times as fast to compile, as large fields and their derivatives need it. The
        loop carries what every later stage has summed up so far, and each stage adds its share to all of them.
        """
        count = self.stages
        rows = np.zeros((count + 1, count))
        for i, row in enumerate((*self.a[1:count], self.b)):
            rows[i + 1, : min(len(row), count)] = row[:count]
        shares = np.zeros((count, count))
        for i in range(count):
            shares[i, : count - i] = rows[i + 1 :, i]
        weights = jnp.asarray(shares)

        def stage(i: Any, ahead: tuple[Any, ...]) -> tuple[Any, ...]:
            k = _times(field(i, ahead[0]), h)
            added = [jax.tree.map(lambda y, kj, j=j: y + weights[i, j] * kj, ahead[j + 1], k) for j in range(count)]
            return (*added, ahead[-1])

        return lax.fori_loop(0, count, stage, (y0,) * (count + 1))[0]


def _times(rate: Any, h: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf * h, rate)


def _combine(base: Any, weights: tuple[float, ...], stages: list[Any]) -> Any:
    """base + Σ weight · stage over the weights that are not zero."""
    terms = [(w, k) for w, k in zip(weights, stages, strict=False) if w]

    def leaf(*values: Any) -> Any:
        total = sum(w * v for (w, _), v in zip(terms, values[-len(terms) :], strict=True))
        return total if base is None else values[0] + total

    if not terms:
        return base
    trees = [k for _, k in terms]
    return jax.tree.map(leaf, *trees) if base is None else jax.tree.map(leaf, base, *trees)
