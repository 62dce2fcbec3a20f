"""The adjoint variational equation along connecting orbits: ψ' = −Aᵀψ, bounded for all times. Host code."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import sparse
from scipy.sparse.linalg import splu

from jaxnh.orbits.collocation.equations import BoundarySolution, Problem, linearise
from jaxnh.orbits.collocation.homoclinic import SaddlePoint, projections

_ROUNDS = 2  # of inverse iteration; singular values differ by many powers of ten


class AdjointSolution(NamedTuple):
    """The bounded solution along an orbit.

    Attributes:
        psi: at the ends of intervals, in reciprocal sizes, the largest component one, (n + 1, d).
        normal: integral of its product with the field's derivatives in the parameters, in widths, (q,): across the
            curve of orbits, and the rate at which the manifolds part (Melnikov).
    """

    psi: Float[np.ndarray, "n+1 d"]
    normal: Float[np.ndarray, " q"]


def adjoint_solution(
    problem: Problem, orbit: BoundarySolution, departure: SaddlePoint, arrival: SaddlePoint
) -> AdjointSolution:
    """The bounded solution of the adjoint equation along an orbit, one lane.

    It is orthogonal to the tangent spaces of both manifolds along the orbit: it begins in the left stable eigenspace of
    the saddle of departure, and ends in the left unstable one of that of arrival. As a left null vector of the
    variational equations it comes from inverse iteration.

    Raises:
        numpy.linalg.LinAlgError: the equations are singular.
    """
    boundary = projections(problem, departure, arrival)(orbit, np.zeros(1, int))
    [blocks] = linearise(problem, orbit, boundary).blocks
    n, d, _ = blocks.shape
    first, last = departure.stable, arrival.unstable
    before = sparse.hstack([sparse.block_diag(blocks), sparse.coo_array((n * d, d))])
    none = sparse.coo_array((len(first), n * d)), sparse.coo_array((len(last), n * d))
    ends = [sparse.hstack([first, none[0]]), sparse.hstack([none[1], last])]
    matrix = sparse.vstack([sparse.eye_array(n * d, (n + 1) * d, k=d) - before, *ends]).tocsc()
    try:
        solved = splu(matrix)
    except RuntimeError as error:
        raise np.linalg.LinAlgError(str(error)) from None
    left = solved.solve(np.ones((n + 1) * d), trans="T")
    for _ in range(_ROUNDS):
        left = solved.solve(solved.solve(left / np.abs(left).max()), trans="T")
    after = left[: n * d].reshape(n, d)
    psi = np.concatenate([after[:1] @ blocks[0], after])
    psi = psi / np.abs(psi).max()
    states, values = orbit.path.ends[0], np.repeat(orbit.values, n + 1, axis=0)
    slopes = np.asarray(problem.field(states, np.zeros(n + 1), values).by_parameters)
    products = np.einsum("kd,kdq->kq", psi / problem.size, slopes * problem.widths)
    return AdjointSolution(psi, orbit.duration[0] * np.trapezoid(products, orbit.path.mesh[0], axis=0))
