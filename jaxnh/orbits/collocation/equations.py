"""Collocation of y' = T f(y, Tτ; λ): the linear equations of Newton, condensed interval by interval. Host code.

At the Gauss points of every interval the path has the field's rate (Doedel, Keller and Kernévez, Int. J. Bifurcation
Chaos 1 (1991) 745). The stages of an interval are eliminated in it; what is left for the ends of the intervals is a
block system around a cycle (`orbits.cyclic`), whose last row has the boundary conditions. Its solutions with the
duration and parameters as further unknowns are a line, a plane, …, of which conditions over the whole path take one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from jaxnh.orbits import cyclic
from jaxnh.orbits.collocation.paths import PiecewisePath, gauss_rule, lagrange


class FieldValues(NamedTuple):
    """A field at points, and its derivatives.

    Attributes:
        rate: f, (points, d).
        jacobian: ∂f/∂y, (points, d, d).
        by_parameters: ∂f/∂λ, (points, d, q).
    """

    rate: Float[np.ndarray, "points d"]
    jacobian: Float[np.ndarray, "points d d"]
    by_parameters: Float[np.ndarray, "points d q"]


class Field(Protocol):
    """The field over points, each with a time and parameters of its own."""

    def __call__(
        self,
        y: Float[np.ndarray, "points d"],
        t: Float[np.ndarray, " points"],
        values: Float[np.ndarray, "points q"],
        /,
    ) -> FieldValues: ...


class Problem(NamedTuple):
    """A field, and what is large there.

    Attributes:
        field: the field.
        size: of the motion in each coordinate, (d,).
        widths: of the ranges of the parameters, (q,).
        clock: whether the field depends on time; the duration is then known.
    """

    field: Field
    size: Float[np.ndarray, " d"]
    widths: Float[np.ndarray, " q"]
    clock: bool = False


class BoundarySolution(NamedTuple):
    """Paths with their durations and parameters, a lane each.

    Attributes:
        path: states over the share of the duration that has passed.
        duration: T, (lanes,).
        values: parameters, (lanes, q).
    """

    path: PiecewisePath
    duration: Float[np.ndarray, " lanes"]
    values: Float[np.ndarray, "lanes q"]


class Variation(NamedTuple):
    """Differences or directions of solutions, in units of sizes, of the duration, and of widths.

    Attributes:
        ends: (lanes, n + 1, d).
        stages: (lanes, n, m, d).
        extra: of the logarithm of the duration and of the parameters, (lanes, 1 + q).
    """

    ends: Float[np.ndarray, "lanes n+1 d"]
    stages: Float[np.ndarray, "lanes n m d"]
    extra: Float[np.ndarray, "lanes 1+q"]


class BoundaryConditions(NamedTuple):
    """Boundary conditions of lanes, linearised, in units of sizes and widths.

    Attributes:
        first, last: derivatives in the states at both ends, (lanes, d, d).
        extra: derivatives in the logarithm of the duration and the parameters, (lanes, d, 1 + q).
        missing: what is to be added, (lanes, d).
    """

    first: Float[np.ndarray, "lanes d d"]
    last: Float[np.ndarray, "lanes d d"]
    extra: Float[np.ndarray, "lanes d 1+q"]
    missing: Float[np.ndarray, "lanes d"]


class NewtonSystem(NamedTuple):
    """The equations of Newton at solutions.

    Attributes:
        blocks: derivative of the end of each interval by its beginning, (lanes, n, d, d).
        particular: one solution.
        null: solutions without right-hand sides, 1 + q of them.
        bordered: the equations with what `null` are where the path begins as further rows.
        rate: dy/dτ of the path, in sizes, (lanes, n, m, d).
        divergence: of the field at the Gauss points, times the duration, (lanes, n, m).
        residual: largest component of the equations, in sizes, (lanes,).
    """

    blocks: Float[np.ndarray, "lanes n d d"]
    particular: Variation
    null: Sequence[Variation]
    bordered: cyclic.Cyclic
    rate: Float[np.ndarray, "lanes n m d"]
    divergence: Float[np.ndarray, "lanes n m"]
    residual: Float[np.ndarray, " lanes"]


def inner(path: PiecewisePath, first: Variation, second: Variation) -> Float[np.ndarray, " lanes"]:
    """Inner products: the mean over the path, and those of the duration and parameters."""
    by_path = np.sum(path.measure * np.sum(first.stages * second.stages, axis=3), axis=(1, 2))
    return by_path + np.sum(first.extra * second.extra, axis=1)


def combination(terms: Sequence[tuple[np.ndarray | float, Variation]]) -> Variation:
    """Sums of variations times numbers (lanes,)."""

    def total(leaf: int) -> np.ndarray:
        parts = ((np.asarray(factor), variation[leaf]) for factor, variation in terms)
        return sum(np.reshape(factor, (*factor.shape, *[1] * (x.ndim - 1))) * x for factor, x in parts)  # pyright: ignore[reportReturnType]

    return Variation(*map(total, range(3)))


def moved(problem: Problem, solution: BoundarySolution, step: Variation) -> BoundarySolution:
    """Solutions a variation further; durations stay above zero."""
    path = solution.path
    ends, stages = path.ends + step.ends * problem.size, path.stages + step.stages * problem.size
    duration = solution.duration * np.exp(step.extra[:, 0])
    return BoundarySolution(
        PiecewisePath(path.mesh, ends, stages), duration, solution.values + step.extra[:, 1:] * problem.widths
    )


def rates_on(problem: Problem, solution: BoundarySolution) -> FieldValues:
    """The field at all Gauss points, (lanes, n, m, …), in units of sizes and widths and of the duration."""
    path, size = solution.path, problem.size
    (lanes, n, m, d), each = path.stages.shape, n_points(path)
    times = solution.duration[:, None, None] * path.places
    at = problem.field(path.stages.reshape(-1, d), times.reshape(-1), np.repeat(solution.values, each, axis=0))
    scale = solution.duration[:, None, None, None]
    jacobian = np.asarray(at.jacobian).reshape(lanes, n, m, d, d) * (size / size[:, None])
    by_parameters = np.asarray(at.by_parameters).reshape(lanes, n, m, d, len(problem.widths))
    by_parameters = by_parameters * (problem.widths / size[:, None])
    rate = np.asarray(at.rate).reshape(lanes, n, m, d) / size
    return FieldValues(scale * rate, scale[..., None] * jacobian, scale[..., None] * by_parameters)


def n_points(path: PiecewisePath) -> int:
    """Gauss points of a path."""
    return path.stages.shape[1] * path.stages.shape[2]


def linearise(problem: Problem, solution: BoundarySolution, boundary: BoundaryConditions) -> NewtonSystem:
    """The equations of Newton at solutions; raises `numpy.linalg.LinAlgError` where those of an interval are singular.

    Stages follow from ΔY_j − h Σ a_jk (J_k ΔY_k + f_k ΔlogT + f_λk Δλ) = Δy_i − residual, the next end from the
    polynomial's last value, which loses nothing where the field is stiff.
    """
    path, at = solution.path, rates_on(problem, solution)
    rule, (lanes, n, m, d) = gauss_rule(path.stages.shape[2]), path.stages.shape
    weights = path.steps[..., None, None] * rule.integrals
    system = -(weights[..., None, :, None] * np.swapaxes(at.jacobian, 2, 3)[:, :, None]).reshape(lanes, n, m * d, m * d)
    system[..., np.arange(m * d), np.arange(m * d)] += 1.0
    columns = np.concatenate([at.rate[..., None], at.by_parameters], axis=-1)
    if problem.clock:
        columns[..., 0] = 0.0
    nodes = path.nodes / problem.size
    missing = nodes[:, :, :1] + weights @ at.rate - nodes[:, :, 1:]
    k = columns.shape[-1]
    extra = (weights @ columns.reshape(lanes, n, m, d * k)).reshape(lanes, n, m * d, k)
    identity = np.broadcast_to(np.tile(np.eye(d), (m, 1)), (lanes, n, m * d, d))
    right = np.concatenate([identity, extra, missing.reshape(lanes, n, m * d, 1)], axis=-1)
    stages = np.linalg.solve(system, right).reshape(lanes, n, m, d, d + k + 1)
    ends = np.tensordot(stages, rule.last[1:], axes=(2, 0))
    blocks = ends[..., :d] + rule.last[0] * np.eye(d)
    ahead = path.ends[:, 1:] / problem.size - np.tensordot(nodes, rule.last, axes=(2, 0))
    residual = np.maximum(np.abs(missing).max(axis=(1, 2, 3)), np.abs(ahead).max(axis=(1, 2)))
    residual = np.maximum(residual, np.abs(boundary.missing).max(axis=1))

    def whole(rows: np.ndarray, last: np.ndarray) -> np.ndarray:
        return np.concatenate([rows, last[:, None]], axis=1)

    there = np.broadcast_to(-np.eye(d), blocks.shape)
    cycle = cyclic.eliminate(whole(blocks, boundary.last), whole(there, boundary.first))
    sides = whole(ahead - ends[..., -1], boundary.missing)
    least, null, bordered = cyclic.solutions(cycle, sides, whole(ends[..., d : d + k], boundary.extra))

    def variation(y: np.ndarray, x: np.ndarray, known: float) -> Variation:
        inside = np.concatenate([y[:, :-1], np.broadcast_to(x[:, None], (lanes, n, k))], axis=2)
        inside = np.concatenate([inside, np.full((lanes, n, 1), known)], axis=2)
        return Variation(y, (stages @ inside[:, :, None, :, None])[..., 0], x)

    directions = [variation(*direction, 0.0) for direction in null]
    divergence = np.trace(at.jacobian, axis1=3, axis2=4)
    return NewtonSystem(blocks, variation(*least, 1.0), directions, bordered, at.rate, divergence, residual)


def phase_condition(problem: Problem, line: NewtonSystem) -> Variation:
    """The direction that no step has a share of: the shift along the orbit; with a clock the duration."""
    lanes, n, _, d = line.rate.shape
    ends, extra = np.zeros((lanes, n + 1, d)), np.zeros_like(line.particular.extra)
    extra[:, 0] = float(problem.clock)
    return Variation(ends, 0.0 * line.rate if problem.clock else line.rate, extra)


def fixed(line: NewtonSystem, number: int) -> Variation:
    """The direction in which one parameter alone changes."""
    extra = np.zeros_like(line.particular.extra)
    extra[:, 1 + number] = 1.0
    return Variation(0.0 * line.particular.ends, 0.0 * line.particular.stages, extra)


class PointCondition(NamedTuple):
    """A condition on cycles by states at some of their points, the duration and the parameters, linearised.

    Attributes:
        gradient: derivatives in the states, the logarithm of the duration and the parameters, in sizes and widths.
        missing: what is too much, (lanes,).
    """

    gradient: Variation
    missing: Float[np.ndarray, " lanes"]

    def change(self, way: Variation) -> Float[np.ndarray, " lanes"]:
        """The derivative along a variation."""
        parts = zip(self.gradient, way, strict=True)
        return sum(np.sum(slopes * changes, axis=tuple(range(1, slopes.ndim))) for slopes, changes in parts)  # pyright: ignore[reportReturnType]

    def scaled(self) -> PointCondition:
        """The same condition with a gradient of length one."""
        size = np.sqrt(self.change(self.gradient))
        return PointCondition(combination([(1.0 / size, self.gradient)]), self.missing / size)


def state_gradient(
    path: PiecewisePath,
    place: Float[np.ndarray, " lanes"],
    by_state: Float[np.ndarray, "lanes d"],
    by_extra: Float[np.ndarray, "lanes 1+q"],
) -> Variation:
    """The gradient of a function of the state at a place in [0, 1], the duration and the parameters."""
    ends, stages = np.zeros_like(path.ends), np.zeros_like(path.stages)
    for lane, (mesh, at) in enumerate(zip(path.mesh, place, strict=True)):
        k = min(int(np.searchsorted(mesh, at, side="right")) - 1, stages.shape[1] - 1)
        shares = lagrange(stages.shape[2], (at - mesh[k]) / (mesh[k + 1] - mesh[k]))
        ends[lane, k], stages[lane, k] = shares[0] * by_state[lane], shares[1:, None] * by_state[lane]
    return Variation(ends, stages, by_extra)


Functional = Callable[[Variation], Float[np.ndarray, " lanes"]]
"""A linear function of variations, as the inner product with one."""


def step_of(
    line: NewtonSystem, rows: Sequence[Functional], gone: Float[np.ndarray, "lanes k"] | float = 0.0
) -> Variation:
    """The step of Newton along which as many functionals as there are solutions without right-hand sides take back."""
    right = -np.stack([row(line.particular) for row in rows], axis=1) - gone
    shares = np.linalg.solve(_functional_matrix(line, rows), right[..., None])[..., 0]
    return combination([(1.0, line.particular), *((shares[:, k], direction) for k, direction in enumerate(line.null))])


def bordered_sign(line: NewtonSystem, rows: Sequence[Functional]) -> Float[np.ndarray, " lanes"]:
    """The sign of the determinant of the equations with as many functionals as there are null solutions as more rows.

    Stages are eliminated: their own determinants have no real zero with an even number of Gauss points, as the
    denominators of diagonal Padé approximants (Hairer and Wanner, Solving Ordinary Differential Equations II, IV.3).
    """
    with np.errstate(over="ignore"):
        return np.sign(cyclic.determinant(line.bordered)) * np.sign(np.linalg.det(_functional_matrix(line, rows)))


def _functional_matrix(line: NewtonSystem, rows: Sequence[Functional]) -> Float[np.ndarray, "lanes r k"]:
    return np.moveaxis(np.stack([[row(direction) for direction in line.null] for row in rows]), 2, 0)


def direction_without(path: PiecewisePath, line: NewtonSystem, directions: Sequence[Variation]) -> Variation:
    """The direction of length one of solutions without right-hand sides that is orthogonal to all but one as many."""
    return direction_of(path, line, [partial(inner, path, way) for way in directions])


def direction_of(path: PiecewisePath, line: NewtonSystem, rows: Sequence[Functional]) -> Variation:
    """The direction of length one of solutions without right-hand sides along which functionals do not change."""
    gram = np.moveaxis(np.stack([[inner(path, a, b) for b in line.null] for a in line.null]), 2, 0)
    shares = np.linalg.svd(_functional_matrix(line, rows))[2][:, -1]
    lengths = np.sqrt(np.einsum("li,lij,lj->l", shares, gram, shares))
    return combination([(shares[:, k] / lengths, direction) for k, direction in enumerate(line.null)])


def orthonormal(path: PiecewisePath, line: NewtonSystem) -> NewtonSystem:
    """Newton's system of one lane with orthonormal null solutions.

    Those of `linearise` are of length one where a path begins. Near a saddle they grow from there by as many powers of
    ten as the path is near, and are nearly the shift along the orbit, all of them.
    """
    weights = np.sqrt(np.broadcast_to(path.measure[..., None], line.rate.shape)).ravel()
    columns = [np.concatenate([weights * direction.stages.ravel(), direction.extra.ravel()]) for direction in line.null]
    shares = np.linalg.inv(np.linalg.qr(np.stack(columns, axis=1), mode="r"))
    return line._replace(null=[combination(list(zip(column, line.null, strict=True))) for column in shares.T])
