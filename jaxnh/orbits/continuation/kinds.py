"""Kinds of bifurcations, and their test functions, which pass zero along a curve of orbits. Host code.

A fold is where the parameter turns; a branch point where the determinant of the equations with the direction of the
curve changes sign. A doubling is a zero of det(M + 1), a Neimark–Sacker bifurcation one of det(M ∧ M − 1), whose
factors are μ_i μ_j − 1, i < j; of an equilibrium Hopf's is one of the determinant whose factors are λ_i + λ_j
(Kuznetsov, Elements of Applied Bifurcation Theory, 2004, 10.2). All are determinants of equations around the orbit: no
product is formed. Grazing, where an orbit touches a wall or a surface, has none: maps are not smooth there.
"""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Complex, Float, Int

from jaxnh.orbits import cyclic
from jaxnh.orbits.continuation.arclength import CurveOrbits, Family
from jaxnh.orbits.multipliers import multipliers

KINDS = ("fold", "period_doubling", "neimark_sacker", "branch_point", "hopf", "grazing")
"""Bifurcations by number."""

FOLD, DOUBLING, NEIMARK_SACKER, BRANCH_POINT, HOPF, GRAZING = range(len(KINDS))

STABILITIES = ("no", "yes", "undecided")
"""Stability of orbits, by number."""

_MAPS, _FIELDS = (FOLD, DOUBLING, NEIMARK_SACKER, BRANCH_POINT), (FOLD, HOPF, BRANCH_POINT)


def kinds(family: Family) -> tuple[int, ...]:
    """Kinds of bifurcations that there are test functions for, in their order."""
    return _FIELDS if family.field else _MAPS


def test_functions(family: Family, orbits: CurveOrbits) -> Float[np.ndarray, "lanes kinds"]:
    """The test function of every kind, of each orbit."""
    own = {
        FOLD: lambda: orbits.way.value / family.width,
        DOUBLING: lambda: closed_determinant(orbits.blocks, -1.0),
        NEIMARK_SACKER: lambda: closed_determinant(second_compound(orbits.blocks), 1.0),
        BRANCH_POINT: lambda: orbits.crossing,
        HOPF: lambda: np.linalg.det(additive_compound(orbits.blocks[:, 0] - np.eye(orbits.blocks.shape[-1]))),
    }
    return np.stack([own[kind]() for kind in kinds(family)], axis=1)


def closed_determinant(blocks: Float[np.ndarray, "lanes n d d"], factor: float) -> Float[np.ndarray, " lanes"]:
    """det(M − factor) up to a sign that is the same for all orbits of n points, M = M_{n−1}…M_0, factor ±1."""
    d = blocks.shape[-1]
    if not d:
        return np.ones(len(blocks))
    there = np.zeros_like(blocks)
    there[:] = -np.eye(d)
    there[:, -1] *= factor
    return cyclic.determinant(cyclic.eliminate(blocks, there))


def second_compound(matrices: Float[np.ndarray, "... d d"]) -> Float[np.ndarray, "... e e"]:
    """All 2×2 minors, e = d(d − 1)/2: the compound of a product is the product of the compounds."""
    i, j = _pairs(matrices.shape[-1])
    rows = [matrices[..., i, :][..., :, k] * matrices[..., j, :][..., :, m] for k, m in ((i, j), (j, i))]
    return rows[0] - rows[1]


def additive_compound(matrices: Float[np.ndarray, "... d d"]) -> Float[np.ndarray, "... e e"]:
    """The derivative of `second_compound` at one: its eigenvalues are sums of two of the matrix."""
    identity = np.broadcast_to(np.eye(matrices.shape[-1]), matrices.shape)
    return second_compound(matrices + identity) - second_compound(matrices) - second_compound(identity)


def eigenvalues(family: Family, orbits: CurveOrbits) -> Complex[np.ndarray, "lanes d"]:
    """Multipliers of orbits, largest modulus first; of equilibria the eigenvalues, largest real part first."""
    if not family.field:
        return multipliers(orbits.blocks)
    values = np.linalg.eigvals(orbits.blocks[:, 0] - np.eye(orbits.blocks.shape[-1])).astype(complex)
    return np.take_along_axis(values, np.lexsort((np.imag(values), -np.real(values)), axis=-1), axis=-1)


def stable(family: Family, values: Complex[np.ndarray, "... d"]) -> np.ndarray:
    """Return whether orbits with these multipliers, or equilibria with these eigenvalues, attract."""
    return np.all(np.real(values) < 0.0 if family.field else np.abs(values) < 1.0, axis=-1)


def stability(
    family: Family, values: Complex[np.ndarray, "... d"], errors: Float[np.ndarray, "... d"] | None = None
) -> Int[np.ndarray, ...]:
    """Stability of orbits, numbers in `STABILITIES`, with errors of the multipliers of a map where there are."""
    if errors is None:
        return stable(family, values).astype(int)
    sizes = np.abs(values)
    attracts, repels = np.all(sizes + errors < 1.0, axis=-1), np.any(sizes - errors > 1.0, axis=-1)
    return np.where(attracts, 1, np.where(repels, 0, STABILITIES.index("undecided")))


def _pairs(d: int) -> tuple[list[int], list[int]]:
    both = list(itertools.combinations(range(d), 2))
    return [i for i, _ in both], [j for _, j in both]
