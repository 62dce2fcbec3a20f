"""Common parts of explicit methods with stages, of first order and of second."""

from __future__ import annotations

import equinox as eqx


class ExplicitMethod(eqx.Module):
    """A tableau: rows and abscissae, order, name and source.

    Attributes:
        a: rows of the tableau below the diagonal, first row empty.
        b: weights of the solution, one a stage.
        c: abscissae, one a stage.
        convergence_order: order of the solution.
        name: name in configs and result files.
        source: where the coefficients come from.
    """

    a: tuple[tuple[float, ...], ...] = eqx.field(static=True)
    b: tuple[float, ...] = eqx.field(static=True)
    c: tuple[float, ...] = eqx.field(static=True)
    convergence_order: int = eqx.field(static=True)
    name: str = eqx.field(static=True)
    source: str = eqx.field(static=True)

    @property
    def stages(self) -> int:
        """Evaluations of the field that the solution needs, a step."""
        return len(self.b)

    @property
    def processor(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """None: steps alone have the order of the method."""
        return (0.0,), ()

    def most_steps(self, fields: int) -> int:
        """Steps of a map with so many evaluations of the field at most."""
        return fields // self.stages

    def total_kicks(self, steps: int) -> int:
        """Evaluations of the field of a map of so many steps."""
        return steps * self.stages
