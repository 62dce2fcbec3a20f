"""The place of a solver where nothing is integrated: iterates of a map, each exact to rounding."""

from __future__ import annotations

from jaxnh.solvers.explicit_method import ExplicitMethod


class Iteration(ExplicitMethod):
    """One evaluation of a map."""


iteration = Iteration(a=((),), b=(1.0,), c=(0.0,), convergence_order=0, name="iteration", source="the map itself")
"""The method of every map, and of no flow: no config names it."""
