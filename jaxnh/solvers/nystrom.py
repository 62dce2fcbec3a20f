"""Runge–Kutta–Nyström methods: steps of x″ = F(x, t), whose stages are positions alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax

from jaxnh.solvers.explicit_method import ExplicitMethod


class Nystrom(ExplicitMethod):
    """An explicit method for x″ = F(x, t), its stages written out; `a` and `b` are of positions, in units of h².

    Velocities are summed once a step and not once a stage, and as F does not see them, there are fewer conditions of
    order to meet: eight stages for order eight, where methods for any system have twelve.

    Attributes:
        b_rate: weights of the velocity, one a stage, in units of h.
    """

    b_rate: tuple[float, ...] = eqx.field(static=True)

    def written_stages(self, force: Callable[[int, Any], Any], h: Any, x: Any, v: Any) -> tuple[Any, Any]:
        """Position and velocity after a step h under a force of (number of the stage, position): pytrees alike."""
        kicks: list[Any] = []
        for i, (row, c) in enumerate(zip(self.a, self.c, strict=True)):
            rate = _sum((c, v), *zip(row, kicks, strict=True))
            at = x if rate is None else jax.tree.map(lambda x, r: x + h * r, x, rate)
            kicks.append(jax.tree.map(lambda leaf: h * leaf, force(i, at)))
        mean, gained = _sum((1.0, v), *zip(self.b, kicks, strict=True)), _sum(*zip(self.b_rate, kicks, strict=True))
        return jax.tree.map(lambda x, r: x + h * r, x, mean), jax.tree.map(lambda v, g: v + g, v, gained)


def _sum(*terms: tuple[float, Any]) -> Any:
    """Σ weight · tree over the weights that are not zero; None without any."""
    trees = [(weight, tree) for weight, tree in terms if weight]
    if not trees:
        return None
    weights = [weight for weight, _ in trees]
    return jax.tree.map(
        lambda *leaves: sum(w * leaf for w, leaf in zip(weights, leaves, strict=True)), *(tree for _, tree in trees)
    )


nystrom8 = Nystrom(
    a=(
        (),
        (1 / 800,),
        (1 / 600, 1 / 300),
        (9 / 200, -9 / 100, 9 / 100),
        (-66701 / 197352, 28325 / 32892, -2665 / 5482, 2170 / 24669),
        (227015747 / 304251000, -54897451 / 30425100, 12942349 / 10141700, -9499 / 304251, 539 / 9250),
        (-1131891597 / 901789000, 41964921 / 12882700, -6663147 / 3220675, 270954 / 644135, -108 / 5875, 114 / 1645),
        (
            13836959 / 3667458,
            -17731450 / 1833729,
            1063919505 / 156478208,
            -33213845 / 39119552,
            13335 / 28544,
            -705 / 14272,
            1645 / 57088,
        ),
    ),
    b=(223 / 7938, 0.0, 1175 / 8064, 925 / 6048, 41 / 448, 925 / 14112, 1175 / 72576, 0.0),
    b_rate=(223 / 7938, 0.0, 5875 / 36288, 4625 / 21168, 41 / 224, 4625 / 21168, 5875 / 36288, 223 / 7938),
    c=(0.0, 1 / 20, 1 / 10, 3 / 10, 1 / 2, 7 / 10, 9 / 10, 1.0),
    convergence_order=8,
    name="nystrom8",
    source="Dormand, El-Mikkawy and Prince, IMA J. Numer. Anal. 7 (1987) 423, the solution of order eight",
)
"""Dormand, El-Mikkawy and Prince's 8(6), eight stages and one more for the error estimate, which is left out."""

NYSTROM: dict[str, Nystrom] = {nystrom8.name: nystrom8}
"""Methods for x″ = F(x, t) − γ x′ by their name in configs."""
