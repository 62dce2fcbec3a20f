"""Solutions of the adjoint variational equation ψ' = −Aᵀψ: bounded ones of connecting orbits, periodic ones of cycles.

Host code.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import sparse
from scipy.sparse.linalg import splu

from jaxnh.orbits import cyclic
from jaxnh.orbits.collocation.cycles import closure
from jaxnh.orbits.collocation.equations import BoundarySolution, Problem, linearise
from jaxnh.orbits.collocation.homoclinic import SaddlePoint, projections
from jaxnh.orbits.multipliers import multipliers

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


class PhaseResponse(NamedTuple):
    """Infinitesimal phase response of cycles, a lane each.

    Attributes:
        z: derivative of the phase in each coordinate where intervals begin, rad over the coordinate's unit,
            (lanes, n, d).
        error: largest deviation of the phase's rate along the motion from its mean, of the mean, and what rounding
            adds across the flow, of the largest response, (lanes,).
    """

    z: Float[np.ndarray, "lanes n d"]
    error: Float[np.ndarray, " lanes"]


def phase_response(problem: Problem, cycles: BoundarySolution, lift: Float[np.ndarray, "lanes d"]) -> PhaseResponse:
    """The periodic solution of the adjoint equation along cycles, z · f = 2π/T (Malkin; Ermentrout, Neural Comput. 8
    (1996) 979).

    It is the left eigenvector of the monodromy for the multiplier one, carried along the cycle by the derivatives over
    intervals, of which no product is formed. Where a multiplier is near one, by 1 − μ, rounding of each interval is
    enlarged by 1/|1 − μ| along its own left eigenvector, which has no part in z · f.

    Args:
        problem: a field without a clock.
        cycles: solutions on meshes that resolve them.
        lift: of the end over the beginning.
    """
    lanes, count, d = cycles.path.stages.shape[0], cycles.path.stages.shape[1], cycles.path.stages.shape[3]
    blocks = linearise(problem, cycles, closure(problem, lift)(cycles, np.arange(lanes))).blocks
    diagonal = np.broadcast_to(-np.eye(d), blocks.shape)
    psi = cyclic.null_vector(cyclic.eliminate(diagonal, np.swapaxes(blocks, -1, -2)))
    states, values = cycles.path.ends[:, :-1].reshape(-1, d), np.repeat(cycles.values, count, axis=0)
    rate = np.asarray(problem.field(states, np.zeros(len(states)), values).rate).reshape(psi.shape) / problem.size
    products = np.sum(psi * rate, axis=2)
    mean = products.mean(axis=1)
    scale = 2 * np.pi / (cycles.duration * mean)
    spread = np.abs(products / mean[:, None] - 1.0).max(axis=1)
    others = np.sort(np.abs(multipliers(blocks) - 1.0), axis=1)[:, 1:]
    rounding = np.finfo(float).eps * count / np.min(others, axis=1, initial=1.0)
    return PhaseResponse(scale[:, None, None] * psi / problem.size, spread + rounding)
