"""The adjoint variational equation along connecting orbits: ψ' = −Aᵀψ, bounded for all times. Host code."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy import sparse
from scipy.sparse.linalg import splu

from jaxnh.orbits.collocation.connections import Connection
from jaxnh.orbits.collocation.equations import Problem, linearise
from jaxnh.orbits.collocation.homoclinic import projections

_ROUNDS = 2  # of inverse iteration; singular values differ by many powers of ten


def adjoint_solution(problem: Problem, orbit: Connection) -> Float[np.ndarray, "n+1 d"]:
    """The bounded solution of the adjoint equation at the ends of intervals, in reciprocal sizes, its largest component one.

    It is orthogonal to the tangent spaces of both manifolds along the orbit: it begins in the left stable eigenspace of
    the saddle of departure, and ends in the left unstable one of that of arrival. As a left null vector of the
    variational equations it is found by inverse iteration.

    Raises:
        numpy.linalg.LinAlgError: the equations of an interval are singular.
    """
    boundary = projections(problem, orbit.departure, orbit.arrival)(orbit.solution, np.zeros(1, int))
    [blocks] = linearise(problem, orbit.solution, boundary).blocks
    n, d, _ = blocks.shape
    first, last = orbit.departure.stable, orbit.arrival.unstable
    ahead = sparse.eye_array(n * d, (n + 1) * d, k=d) - sparse.hstack(
        [sparse.block_diag(blocks), sparse.coo_array((n * d, d))]
    )
    between = sparse.coo_array((len(first), n * d)), sparse.coo_array((len(last), n * d))
    ends = [sparse.hstack([first, between[0]]), sparse.hstack([between[1], last])]
    solved = splu(sparse.vstack([ahead, *ends]).tocsc())
    left = solved.solve(np.ones((n + 1) * d), trans="T")
    for _ in range(_ROUNDS):
        left = solved.solve(solved.solve(left / np.abs(left).max()), trans="T")
    after = left[: n * d].reshape(n, d)
    psi = np.concatenate([after[:1] @ blocks[0], after])
    return psi / np.abs(psi).max()
