"""Explicit Runge–Kutta methods with their stages written out over a tuple state.

diffrax keeps the stages of its own Runge–Kutta solvers in one growing array; under vmap on a CPU, moving that array
costs ten times the arithmetic. Here every stage is an expression of its own, and zero coefficients leave no trace.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_batching import custom_vmap

from jaxnh.solvers.explicit_method import ExplicitMethod

_TERMS = 4  # of sums over stages that are written out, where the stages are a loop
_FEW_LANES = 16  # loops over no more are unrolled, and have no vectors: one over all numbers of all lanes has


class WrittenOutRungeKutta(ExplicitMethod):
    """An explicit tableau with its embedded error estimate, stages written out.

    The state may be any pytree. Nothing is carried from step to step (no FSAL).

    Attributes:
        b_error: weights of the error estimate, one a stage.
        rolled: whether maps have the stages of a step in a loop, a program that compiles in a tenth of the time; None:
            where written out they are too many equations.
    """

    b_error: tuple[float, ...] = eqx.field(static=True)
    rolled: bool | None = eqx.field(static=True, default=None)

    @property
    def stages(self) -> int:
        """Evaluations of the vector field that the solution needs, a step."""
        return _used_stages(self.a, self.b)

    def written_stages(self, field: Callable[[int, Any], Any], h: Any, y0: Any) -> Any:
        """The state after a step h under a field of (number of the stage, state), stages written out."""
        return combine(y0, self.b[: self.stages], self._stages(field, h, y0, self.stages, _times))

    def written_pair(self, field: Callable[[int, Any], Any], h: Any, y0: Any) -> tuple[Any, Any]:
        """`written_stages`, and the estimate of its error."""
        stages = self._stages(field, h, y0, len(self.b), _times)
        return combine(y0, self.b, stages), combine(None, self.b_error, stages)

    def _stages(
        self, field: Callable[[int, Any], Any], h: Any, y0: Any, count: int, prod: Callable[[Any, Any], Any]
    ) -> list[Any]:
        """Rates at the first stages, times h."""
        stages: list[Any] = []
        for i in range(count):
            stages.append(prod(field(i, combine(y0, self.a[i], stages)), h))
        return stages

    def rolled_stages(self, field: Callable[[Any, Any], Any], h: Any, y0: Any) -> Any:
        """Compute `written_stages` with the stages in a loop: one field in the program where that has them all.

        It compiles in a seventh to a tenth of the time, and is some two times slower. Lanes are the last axis of what
        the loop carries, wherever `jax.vmap` has them elsewhere, so that sums over the stages before are of all of it
        at once, some terms at a time: a matrix product of so few numbers costs more than its arithmetic.

        Args:
            field: of (number of the stage, state).
            h: the step.
            y0: any pytree of numbers of one lane.
        """
        (after,) = self._rolled(field, h, y0, pair=False)
        return after

    def rolled_pair(self, field: Callable[[Any, Any], Any], h: Any, y0: Any) -> tuple[Any, Any]:
        """`rolled_stages`, and the estimate of its error."""
        after, error = self._rolled(field, h, y0, pair=True)
        return after, error

    def _rolled(self, field: Callable[[Any, Any], Any], h: Any, y0: Any, *, pair: bool) -> list[Any]:
        """The state after a step, and of a pair the estimate of its error."""
        leaves, structure = jax.tree.flatten(y0)

        def rate(i: Any, leaves: list[Any]) -> list[Any]:
            return jax.tree.leaves(field(i, jax.tree.unflatten(structure, leaves)))

        closed, constants = jax.closure_convert(rate, 0, leaves)

        @custom_vmap
        def step(h: Any, leaves: list[Any], constants: list[Any]) -> list[Any]:
            return self._looped(lambda i, leaves: closed(i, leaves, *constants), h, leaves, pair=pair)

        @step.def_vmap
        def _(size: int, batched: Any, h: Any, leaves: list[Any], constants: list[Any]) -> tuple[list[Any], list[bool]]:
            has_lanes = [0 if each else None for each in batched[2]]
            of_lanes = jax.vmap(
                lambda i, leaves, constants: closed(i, leaves, *constants), (None, -1, has_lanes), out_axes=-1
            )
            leaves = [
                jnp.moveaxis(leaf, 0, -1) if moves else jnp.broadcast_to(leaf[..., None], (*leaf.shape, size))
                for leaf, moves in zip(leaves, batched[1], strict=True)
            ]
            ended = self._looped(lambda i, leaves: of_lanes(i, leaves, constants), h, leaves, (size,), pair=pair)
            return [jnp.moveaxis(leaf, -1, 0) for leaf in ended], [True] * len(ended)

        made = step(h, leaves, list(constants))
        return [jax.tree.unflatten(structure, made[i : i + len(leaves)]) for i in range(0, len(made), len(leaves))]

    def carried_stages(self, field: Callable[[Any, Any], Any], h: Any, y0: Any) -> Any:
        """Compute `rolled_stages` by sums and products of the state's own numbers alone, for extended precision.

        The loop carries what every later stage has summed up so far, and each stage adds its share to all of them.
        """
        count = self.stages
        rows = self._tableau(count)
        shares = np.zeros((count, count))
        for i in range(count):
            shares[i, : count - i] = rows[i + 1 :, i]
        weights = jnp.asarray(shares)

        def stage(i: Any, ahead: tuple[Any, ...]) -> tuple[Any, ...]:
            k = _times(field(i, ahead[0]), h)
            added = [jax.tree.map(lambda y, kj, j=j: y + weights[i, j] * kj, ahead[j + 1], k) for j in range(count)]
            return (*added, ahead[-1])

        return lax.fori_loop(0, count, stage, (y0,) * (count + 1))[0]

    def _tableau(self, count: int) -> np.ndarray:
        """Rows of so many stages, the last of the solution, (count + 1, count)."""
        tableau = np.zeros((count + 1, count))
        for i, row in enumerate((*self.a[1:count], self.b), 1):
            tableau[i, : min(len(row), count)] = row[:count]
        return tableau

    def _looped(
        self,
        field: Callable[[Any, list[Any]], list[Any]],
        h: Any,
        leaves: list[Any],
        lanes: tuple[int, ...] = (),
        *,
        pair: bool,
    ) -> list[Any]:
        """Results of `_rolled`, one after the other, numbers and arrays of one lane or of so many as last axis."""
        count = len(self.b) if pair else self.stages

        def joined(leaves: list[Any]) -> Any:
            return jnp.concatenate([leaf.reshape(-1, *lanes) for leaf in leaves])

        initial = joined(leaves)
        ends = np.cumsum([leaf.size // math.prod(lanes) for leaf in leaves]).tolist()
        room = -(-count // _TERMS) * _TERMS
        tableau = np.vstack([self._tableau(count), *([self.b_error] if pair else [])])
        rows = jnp.asarray(np.pad(tableau, ((0, 0), (0, room - count))), initial.dtype)

        def apart(joint: Any) -> list[Any]:
            parts = zip([0, *ends], ends, leaves, strict=False)
            return [joint[start:end].reshape(leaf.shape) for start, end, leaf in parts]

        def total(i: Any, stages: Any, rates: Any) -> Any:
            """Row i of the tableau times the rates of so many stages."""
            known = rates.reshape(room, -1) if math.prod(lanes) <= _FEW_LANES else rates

            def term(j: Any) -> Any:
                return rows[i, j] * known[j]

            def more(block: Any, before: Any) -> Any:
                return sum((term(block * _TERMS + j) for j in range(_TERMS)), before)

            first = sum((term(j) for j in range(1, _TERMS)), term(0))
            return lax.fori_loop(1, (stages + _TERMS - 1) // _TERMS, more, first).reshape(initial.shape)

        def stage(i: Any, rates: Any) -> Any:
            moved = joined(field(i, apart(initial + total(i, i, rates)))) * (h[None] if jnp.ndim(h) else h)
            return lax.dynamic_update_slice_in_dim(rates, moved[None], i, 0)

        rates = lax.fori_loop(0, count, stage, jnp.zeros((room, *initial.shape), initial.dtype))
        after = apart(initial + total(count, count, rates))
        return after + apart(total(count + 1, count, rates)) if pair else after


@cache
def two_half_steps(method: WrittenOutRungeKutta) -> WrittenOutRungeKutta:
    """Return the method whose step is two steps of half the length by another one.

    Where events cut steps shorter than the grid has them, more steps may leave them as they are; this halves them all.
    """
    count = method.stages
    rows = [tuple(0.5 * w for w in row[:count]) for row in method.a[:count]]
    first = tuple(0.5 * w for w in method.b[:count])
    return replace(
        method,
        a=(*rows, *(first + row for row in rows)),
        b=first + first,
        b_error=(0.0,) * (2 * count),
        c=(*(0.5 * x for x in method.c[:count]), *(0.5 + 0.5 * x for x in method.c[:count])),
        name=f"{method.name}, two half steps",
    )


@cache
def _used_stages(a: tuple[tuple[float, ...], ...], b: tuple[float, ...]) -> int:
    """Number of stages that the solution, or a stage that it needs, has a weight of."""
    return sum(1 for i in range(len(b)) if b[i] or any(i < len(row) and row[i] for row in a))


def _times(rate: Any, h: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf * h, rate)


def combine(base: Any, weights: tuple[float, ...], stages: list[Any]) -> Any:
    """Return base + Σ weight · stage over the weights that are not zero."""
    terms = [(w, k) for w, k in zip(weights, stages, strict=False) if w]

    def leaf(*values: Any) -> Any:
        total = sum(w * v for (w, _), v in zip(terms, values[-len(terms) :], strict=True))
        return total if base is None else values[0] + total

    if not terms:
        return base
    trees = [k for _, k in terms]
    return jax.tree.map(leaf, *trees) if base is None else jax.tree.map(leaf, base, *trees)
