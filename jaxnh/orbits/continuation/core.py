"""Curves of solutions: the equations that continuation knows, and Newton across a direction. Host code.

The core knows equations F(z) = 0 of one unknown more than there are equations, for many curves (lanes) at once, and
nothing of what moves. Newton goes across a direction; the bordered matrix is F's with the direction of the curve as its
last row (Keller, in Applications of Bifurcation Theory, 1977, 359), whose determinant changes sign where another curve
passes through and nowhere else. The steps along curves are in `paths`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnh.orbits.cyclic import underdetermined_square

FINE = 1e-9
"""Step of Newton, in lengths, after which an orbit is known to rounding."""

ROUGH = 1e-6
"""Step of Newton, in lengths, whose square is small enough: between the marked points of a branch."""

_CERTAIN = 1e-11  # step that leaves derivatives which need no further iterate, where rounding is not asked for
_NEWTON_STEPS = 12
_CONTRACTION = 0.5  # of successive steps; Newton that contracts less is on its way to another curve


class Evaluation(NamedTuple):
    """CurveEquations at points.

    Attributes:
        residual: F, (lanes, N − 1), in units.
        blocks: derivatives that points of curves keep, (lanes, ...).
        slopes: further derivatives, that the solution needs, (lanes, ...).
    """

    residual: np.ndarray
    blocks: np.ndarray
    slopes: np.ndarray


class LinearSolution(NamedTuple):
    """Solutions of the linear equations at points: `least` + any number · `null`.

    Attributes:
        least: one of them, (lanes, N).
        null: direction of the curve, (lanes, N).
        other: the direction across it that is least far from a second one, (lanes, N).
        determinant: of the bordered matrix with `null` as its last row, (lanes,).
    """

    least: np.ndarray
    null: np.ndarray
    other: np.ndarray
    determinant: np.ndarray


class CurveEquations(Protocol):
    """F(z) = 0 of N unknowns, the last ones parameters.

    Attributes:
        unit: of each unknown, (N,): a length is the norm of a difference in these units.
        low, high: ends of the ranges of the parameters, (k,).
    """

    unit: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def evaluate(self, z: Float[np.ndarray, "lanes N"], /) -> Evaluation:
        """F and its derivatives; not finite where there are none."""
        ...

    def solve(self, at: Evaluation, /) -> LinearSolution:
        """Newton's step and the direction of the curve."""
        ...

    def difference(self, gap: Float[np.ndarray, "lanes N"], /) -> Float[np.ndarray, "lanes N"]:
        """Differences of unknowns, angles wrapped."""
        ...

    def equivalents(self, z: Float[np.ndarray, "lanes N"], /) -> Iterable[Float[np.ndarray, "lanes N"]]:
        """Unknowns (or directions) that stand for the same, as of the points of an orbit in turn."""
        ...

    def room(self, now: Solution, /) -> Float[np.ndarray, " lanes"]:
        """Largest steps that points allow."""
        ...

    def endings(self, now: Solution, taken: Solution, /) -> tuple[Mapping[int, np.ndarray], Bool[np.ndarray, " lanes"]]:
        """The steps that come to an end, by number in `paths.ENDS`, and those to a point that is not the curve's."""
        ...


class Solution(NamedTuple):
    """Points on curves, a lane each.

    Attributes:
        z: unknowns, (lanes, N).
        way: direction of the curve, of length one, (lanes, N).
        other: direction of another one where two cross, across `way`, of length one, (lanes, N).
        determinant: of the bordered matrix, (lanes,).
        blocks: derivatives that are kept, (lanes, ...).
        residual: largest component of F, (lanes,).
        missed: how far Newton has gone from the guess, or would have, in lengths, (lanes,).
        converged: whether Newton has come to rest, (lanes,).
    """

    z: Float[np.ndarray, "lanes N"]
    way: Float[np.ndarray, "lanes N"]
    other: Float[np.ndarray, "lanes N"]
    determinant: Float[np.ndarray, " lanes"]
    blocks: np.ndarray
    residual: Float[np.ndarray, " lanes"]
    missed: Float[np.ndarray, " lanes"]
    converged: Bool[np.ndarray, " lanes"]

    def take(self, lanes: Int[np.ndarray, " some"] | Bool[np.ndarray, " lanes"] | slice) -> Solution:
        """Return the entries of a subset of lanes."""
        return Solution(*(leaf[lanes] for leaf in self))

    def backward(self) -> Solution:
        """The solution with the opposite direction of the curve."""
        return self._replace(way=-self.way, determinant=-self.determinant)


class DenseEquations:
    """CurveEquations with one matrix of derivatives for each point, where any step is allowed."""

    def solve(self, at: Evaluation, /) -> LinearSolution:
        """Solve by singular values."""
        least, null, other, square = underdetermined_square(at.slopes, -at.residual)
        return LinearSolution(least, null, other, np.linalg.det(square))

    def room(self, now: Solution, /) -> Float[np.ndarray, " lanes"]:
        """Any step."""
        return np.full(len(now.z), np.inf)


class EquationsOfPaths:
    """Equations of paths: solved where they are evaluated, so that slopes are the solutions, and not wrapped."""

    def solve(self, at: Evaluation, /) -> LinearSolution:
        """The step and the direction; where other curves pass is told by other means."""
        least, null = at.slopes[:, 0], at.slopes[:, 1]
        return LinearSolution(least, null, np.zeros_like(null), np.full(len(null), np.nan))

    def difference(self, gap: Float[np.ndarray, "lanes N"], /) -> Float[np.ndarray, "lanes N"]:
        """The gap as it is: paths go on beyond whole turns."""
        return gap

    def room(self, now: Solution, /) -> Float[np.ndarray, " lanes"]:
        """Any step."""
        return np.full(len(now.z), np.inf)


# ---- the corrector


def correct(
    equations: CurveEquations,
    z: Float[np.ndarray, "lanes N"],
    across: Float[np.ndarray, "lanes N"] | None = None,
    tolerance: float = ROUGH,
    reach: Float[np.ndarray, " lanes"] | None = None,
    slack: Float[np.ndarray, " lanes"] | None = None,
) -> Solution:
    """The points of curves nearest to guesses in the hyperplanes across directions, and the curve's direction there.

    Only lanes where each step is at most half of the one before, or is short, come to rest. One evaluation an iterate
    serves all lanes that have not.

    Args:
        equations: F.
        z: guesses.
        across: to which steps of Newton are orthogonal, and along which the curve's direction has a positive share;
            without, steps are orthogonal to the curve.
        tolerance: length of a step after which a point is known; infinite: the guesses are taken as they are.
        reach: lengths of steps beyond which they lead elsewhere, and within which they need not be half of the last;
            by default the first may be of any length.
        slack: without `reach`, lengths of steps that need not be half of the last, by default none.
    """
    lanes, z = len(z), np.array(z)
    last, refused = np.full(lanes, np.inf), np.zeros(lanes)
    first, active, unit, solution = z.copy(), np.arange(lanes), equations.unit, None
    for _ in range(_NEWTON_STEPS + 1):
        at = equations.evaluate(z[active])
        if solution is None:
            solution = _unsolved(z, at.blocks)
        solution.residual[active] = np.abs(at.residual).max(axis=1, initial=0.0)
        solution.blocks[active] = at.blocks
        finite = np.all([np.isfinite(leaf).all(axis=tuple(range(1, leaf.ndim))) for leaf in at], axis=0)
        if not finite.all():
            at, active = Evaluation(*(leaf[finite] for leaf in at)), active[finite]
        if not len(active):
            break
        linear = equations.solve(at)
        step, scale = _orthogonal_steps(unit, linear, None if across is None else across[active])
        size = norm(unit, step)
        known = last[active] <= tolerance
        with np.errstate(invalid="ignore"):
            certain = ~known & (size <= _CERTAIN) & (tolerance > FINE)
            shrinks = (size <= _CONTRACTION * last[active]) if reach is None else size <= reach[active]
            if slack is not None:
                shrinks |= size <= slack[active]
        done = known | certain
        rest = active[done]
        _settle(unit, solution, rest, LinearSolution(*(leaf[done] for leaf in linear)), scale[done])
        going = ~done & shrinks & np.isfinite(size)
        refused[active[~done & ~going]] = size[~done & ~going]
        if np.isfinite(tolerance):
            z[rest] += np.where((size <= tolerance)[:, None], step, 0.0)[done]
        active, step, size = active[going], step[going], size[going]
        last[active] = size
        z[active] += step
        if not len(active):
            break
    assert solution is not None
    return solution._replace(missed=norm(unit, z - first) + refused)


def _unsolved(z: np.ndarray, blocks: np.ndarray) -> Solution:
    """Return points of which nothing else is known yet."""
    lanes = len(z)
    way, other = np.full_like(z, np.nan), np.full_like(z, np.nan)
    determinant, residual, missed = np.full((3, lanes), np.nan)
    kept = np.full((lanes, *blocks.shape[1:]), np.nan)
    return Solution(z, way, other, determinant, kept, residual, missed, np.zeros(lanes, bool))


def _settle(unit: np.ndarray, solution: Solution, lanes: np.ndarray, linear: LinearSolution, scale: np.ndarray) -> None:
    """Set the directions and determinants of lanes that have come to rest."""
    solution.converged[lanes] = True
    way = scale[:, None] * linear.null
    solution.way[lanes], solution.determinant[lanes] = way, np.sign(scale) * linear.determinant
    other = linear.other - inner(unit, linear.other, way)[:, None] * way
    with np.errstate(divide="ignore", invalid="ignore"):
        solution.other[lanes] = other / norm(unit, other)[:, None]


def inner(
    unit: Float[np.ndarray, " N"], first: Float[np.ndarray, "lanes N"], second: Float[np.ndarray, "lanes N"]
) -> Float[np.ndarray, " lanes"]:
    """Inner products in units of the unknowns."""
    return np.sum((first / unit) * (second / unit), axis=1)


def norm(unit: Float[np.ndarray, " N"], vector: Float[np.ndarray, "lanes N"]) -> Float[np.ndarray, " lanes"]:
    """Lengths of differences and directions."""
    return np.sqrt(inner(unit, vector, vector))


def _orthogonal_steps(
    unit: np.ndarray, linear: LinearSolution, across: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Newton's steps orthogonal to directions, or to the curve, and the factor that makes `null` the direction."""
    normal = linear.null if across is None else across
    share = inner(unit, linear.null, normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        back = inner(unit, linear.least, normal) / share
        steps = linear.least - back[:, None] * linear.null
    return steps, np.where(share < 0.0, -1.0, 1.0) / norm(unit, linear.null)
