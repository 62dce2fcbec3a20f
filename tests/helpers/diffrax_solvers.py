"""The package's methods as solvers of diffrax, whose loop is a second one beside those of `maps`."""

from __future__ import annotations

from typing import Any, ClassVar

import diffrax
import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from jaxnh.solvers.diffrax_solvers import OneTermSolver
from jaxnh.solvers.isokinetic import IsokineticSplitting, kick
from jaxnh.solvers.runge_kutta import WrittenOutRungeKutta, combine
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.particle import IsokineticParticle
from jaxnh.systems.state import Number, State, Vector


class RungeKuttaSolver(OneTermSolver, diffrax.AbstractAdaptiveSolver):
    """A Runge–Kutta method of the package as a diffrax solver, with its embedded error estimate.

    The state may be any pytree. Nothing is carried from step to step (no FSAL); what only the error estimate or the
    interpolation needs is removed by XLA where they are not read.

    Attributes:
        method: the tableau.
    """

    method: WrittenOutRungeKutta = eqx.field(static=True)

    interpolation_cls: ClassVar = diffrax.ThirdOrderHermitePolynomialInterpolation

    def order(self, terms: Any) -> int:
        return self.method.convergence_order

    def step(
        self, terms: diffrax.AbstractTerm, t0: Any, t1: Any, y0: Any, args: Any, solver_state: Any, made_jump: Any
    ) -> tuple[Any, Any, dict[str, Any], None, diffrax.RESULTS]:
        """One step; the third value carries what third-order Hermite interpolation needs."""
        del solver_state, made_jump
        method, h = self.method, terms.contr(t0, t1)
        stages: list[Any] = []
        for row, c in zip(method.a, method.c, strict=True):
            rate = terms.vf(t0 + c * (t1 - t0), combine(y0, row, stages), args)
            stages.append(terms.prod(rate, h))
        y1 = combine(y0, method.b, stages)
        error = combine(None, method.b_error, stages)
        end = terms.prod(terms.vf(t1, y1, args), h)
        return y1, error, {"y0": y0, "y1": y1, "k0": stages[0], "k1": end}, None, diffrax.RESULTS.successful


class ProjectedSolver(OneTermSolver):
    """Steps of a Runge–Kutta method, each followed by `Flow.project`.

    The order stays: a projection moves a step by no more than a multiple of its own error.

    Attributes:
        solver: the solver that steps, of one term.
        system: the system whose `rhs` that term has.
    """

    solver: RungeKuttaSolver
    system: Flow

    def __init__(self, method: WrittenOutRungeKutta, system: Flow) -> None:
        self.solver, self.system = RungeKuttaSolver(method), system

    def order(self, terms: Any) -> int:
        return self.solver.order(terms)

    def step(
        self, terms: Any, t0: Any, t1: Any, y0: State, args: Any, solver_state: Any, made_jump: Any
    ) -> tuple[State, Any, dict[str, State], Any, diffrax.RESULTS]:
        """One step and its projection; `args` are the lane's parameters."""
        y1, _, _, solver_state, result = self.solver.step(terms, t0, t1, y0, args, solver_state, made_jump)
        y1 = self.system.project(t1, y1, args)
        return y1, None, {"y0": y0, "y1": y1}, solver_state, result


class VectorTerm(diffrax.AbstractTerm):
    """A term of tuples of numbers, whose controls are numbers."""

    system: IsokineticParticle

    def prod(self, vf: Vector, control: Number) -> Vector:
        return tuple(control * v for v in vf)


class DriftTerm(VectorTerm):
    """q' = s(t) n as a diffrax term: the vector field is n, the control ∫ s dt."""

    def vf(self, t: Number, y: Vector, args: Parameters) -> Vector:
        return y

    def contr(self, t0: Number, t1: Number, **kwargs: Parameters) -> Array:
        return self.system.path_length(jnp.asarray(t0), jnp.asarray(t1))


class KickTerm(VectorTerm):
    """F/s at a frozen time as a diffrax term; the solver turns n by it. `args` are the lane's parameters."""

    def vf(self, t: Number, y: Vector, args: Parameters) -> Vector:
        weight = 1.0 / self.system.speed(t)
        return self.system.force(y, self.system.forcing(t) * weight, weight, args)

    def contr(self, t0: Number, t1: Number, **kwargs: Parameters) -> Number:
        return t1 - t0


def isokinetic_terms(system: IsokineticParticle) -> tuple[DriftTerm, KickTerm]:
    """The two terms that a `SplittingSolver` integrates."""
    return DriftTerm(system), KickTerm(system)


class SplittingSolver(OneTermSolver):
    """A splitting of the package as a diffrax solver of `isokinetic_terms`, for constant steps.

    Of a processed splitting these are the steps alone, of order two: `maps.build` puts the processor before the first
    step of a map and its inverse after the last.

    Attributes:
        method: the composition.
    """

    method: IsokineticSplitting = eqx.field(static=True)

    term_structure: ClassVar = (diffrax.AbstractTerm, diffrax.AbstractTerm)

    def order(self, terms: tuple[DriftTerm, KickTerm]) -> int:
        return 2 if self.method.processed else self.method.convergence_order

    def func(self, terms: tuple[DriftTerm, KickTerm], t0: Number, y0: State, args: Parameters) -> State:
        drift, kick = terms
        return drift.vf(t0, y0[1], args), kick.vf(t0, y0[0], args)

    def step(
        self,
        terms: tuple[DriftTerm, KickTerm],
        t0: Number,
        t1: Number,
        y0: State,
        args: Parameters,
        solver_state: None,
        made_jump: Number,
    ) -> tuple[State, None, dict[str, State], None, diffrax.RESULTS]:
        """One step of every lane."""
        del solver_state, made_jump
        drift_term, kick_term = terms
        nodes = self.method.nodes(jnp.asarray(t0), jnp.asarray(t1))
        q, n = y0
        for i, fraction in enumerate((*self.method.kicks, None)):
            path = drift_term.vf_prod(nodes[i], n, args, drift_term.contr(nodes[i], nodes[i + 1]))
            q = tuple(qi + pi for qi, pi in zip(q, path, strict=True))
            if fraction is not None:
                control = kick_term.contr(nodes[i + 1], nodes[i + 1] + fraction * (t1 - t0))
                n = kick(n, kick_term.vf_prod(nodes[i + 1], q, args, control))
        y1 = (q, n)
        return y1, None, {"y0": y0, "y1": y1}, None, diffrax.RESULTS.successful
