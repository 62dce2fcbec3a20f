"""Quasi-velocities u of a mechanical system, q̇ = A(q, t) u, and the forces that its equations of motion have from them.

Column j of A is a vector field X_j. With the momenta p = ∂T/∂u the equations of Boltzmann and Hamel (Hamel, Z. Math.
Phys. 50 (1904) 1; Neimark and Fufaev, Dynamics of Nonholonomic Systems, 1972) are

    ṗ_j = X_j T + Σ_i Σ_k u_i c_ij^k p_k + Q_j + Σ_l λ_l ∂f_l/∂u_j,     [X_i, X_j] = Σ_k c_ij^k X_k

The coordinates may be more than the quasi-velocities, as a quaternion is of an angular velocity: they hold on the
manifold that A leaves. Where the c are constants, as of a body's angular velocity in its own frame, q need not even
determine the motion: these are the equations of Poincaré (C. R. Acad. Sci. 132 (1901) 369) on a Lie algebra, with q
what it acts on, as the vertical in a body's frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxnh.systems.elimination import eliminate, is_zero, minus, times
from jaxnh.systems.state import Number, Vector
from jaxnh.systems.tracing import slope

StructureConstants = tuple[tuple[tuple[float, ...], ...], ...]
"""c[i][j][k] of n quasi-velocities."""


class Kinematics(NamedTuple):
    """The rates of coordinates by quasi-velocities.

    Attributes:
        field: (q, u, t) to the rates q̇, linear in u.
        structure: the structure constants; None where the c are no constants.
    """

    field: Callable[[Vector, Vector, Number], Sequence[Number]]
    structure: StructureConstants | None

    def rates(self, q: Vector, u: Vector, t: Number) -> Vector:
        """q̇ at a state."""
        shape = jnp.shape(q[0])
        rates = (jnp.asarray(rate, float) for rate in self.field(q, u, t))
        return tuple(rate if rate.shape == shape else jnp.broadcast_to(rate, shape) for rate in rates)

    def columns(self, at: Vector, k: int) -> list[Vector]:
        """The vector fields X_j at components (q, u, t), k of them coordinates."""
        return [self._column(at, k, j) for j in range(len(at) - k - 1)]

    def _column(self, at: Vector, k: int, j: int) -> Vector:
        return slope(lambda *at: self.rates(at[:k], at[k:-1], at[-1]), at, k + j)

    def directional_slopes(self, function: Callable[..., Number], at: Vector, k: int) -> list[Number]:
        """X_j of a function of the components (q, u, t), for each j."""
        rest = at[k:]
        return [jax.jvp(lambda *q: function(*q, *rest), at[:k], column)[1] for column in self.columns(at, k)]

    def hamel_forces(self, momenta: Sequence[Number], at: Vector, k: int) -> list[Number]:
        """Σ_i Σ_k u_i c_ij^k p_k at components (q, u, t), for each j."""
        if self.structure is None:
            return self._forces_by_brackets(momenta, at, k)
        u, forces = at[k:-1], []
        for j in range(len(u)):
            force: Number = 0.0
            for i, rows in enumerate(self.structure):
                for constant, p in zip(rows[j], momenta, strict=True):
                    if constant:
                        term = u[i] * p
                        term = term if abs(constant) == 1.0 else abs(constant) * term
                        force = minus(force, term) if constant < 0.0 else term if is_zero(force) else force + term
            forces.append(force)
        return forces

    def _forces_by_brackets(self, momenta: Sequence[Number], at: Vector, k: int) -> list[Number]:
        """Hamel's terms by brackets at the state: P [q̇, X_j] with the covector P of the momenta, P A = p."""
        covector = _covector(self.columns(at, k), list(momenta))
        u, t = at[k:-1], at[-1]
        rates = self.rates(at[:k], u, t)

        def along(q: Vector, t: Number, rates: Vector) -> Number:
            return sum(times(each, rate) for each, rate in zip(covector, rates, strict=True))

        forces = []
        for j, column in enumerate(self.columns(at, k)):

            def own(q: Vector, t: Number, j: int = j) -> Number:
                return along(q, t, self._column((*q, *u, t), k, j))

            def whole(q: Vector) -> Number:
                return along(q, t, self.rates(q, u, t))

            moved = jax.jvp(own, (at[:k], t), (rates, jnp.ones_like(t)))[1]
            forces.append(moved - jax.jvp(whole, (at[:k],), (column,))[1])
        return forces


def _covector(columns: list[Vector], momenta: list[Number]) -> list[Number]:
    """The covector P, among those of more coordinates the shortest, whose product with each column is a momentum."""
    n, k = len(columns), len(columns[0])
    if n == k:
        return eliminate([list(column) for column in columns], [momenta])[0][0]
    gram = [[sum(x * y for x, y in zip(first, second, strict=True)) for second in columns] for first in columns]
    (shares,), _ = eliminate(gram, [momenta], definite=True)
    return [sum(share * column[a] for share, column in zip(shares, columns, strict=True)) for a in range(k)]
