"""Loss of rank by the equations of a mechanical system, in words: "" where there is none, and of other flows."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.jourdain import constraint_slopes, matrices
from jaxnh.systems.lagrangian import Lagrangian
from jaxnh.systems.state import State

_NEARLY_LOST = 0.01  # of the smallest singular value of df/dv on a motion: steps do not follow what turns there


def describe_singularity(flow: Flow, y: State, p: Parameters) -> str:
    """Return which matrix is singular at a state at t = 0, so that it has no rates, and for which velocities."""
    if not isinstance(flow, Lagrangian):
        return ""
    equations = flow.equations(p)
    if not bool(jnp.isnan(flow.rhs(0.0, y, p).watch[1])):
        return ""
    mass = np.array(matrices(equations, (*y.q, *flow.all_velocities(0.0, y, p), 0.0), len(y.q))[0], float)
    names = flow.quasi.everything if flow.quasi else flow.velocities
    if np.linalg.matrix_rank(mass) == len(mass):
        if flow.quasi and flow.quasi.dependent:
            given = ", ".join(names[i] for i in flow.quasi.dependent)
            return f"the constraints f do not give {given}: their derivatives by these are a singular matrix"
        return "the constraints f are not independent: df/dv has not the full rank"
    without = [name for name, row in zip(names, mass, strict=True) if not row.any()]
    missing = f": T has no term with the square of {', '.join(without)}" if without else ""
    return f"the mass matrix, the second derivatives of T by the velocities, is singular{missing}"


def describe_near_singularity(flow: Flow, t: ArrayLike, y: State, p: Parameters) -> str:
    """Describe a near loss of rank of the constraints along a motion, states (points,) at times t.

    That is where the smallest singular value of df/dv comes down to little of its largest on the motion.
    """
    if not isinstance(flow, Lagrangian):
        return ""
    times = np.asarray(t, float)
    slopes = constraint_slopes(flow.equations(p), (*y.q, *flow.all_velocities(times, y, p), times), len(y.q))
    matrix = np.moveaxis(np.array([[np.broadcast_to(entry, times.shape) for entry in row] for row in slopes]), -1, 0)
    if not matrix.size:
        return ""
    finite = np.all(np.isfinite(matrix), axis=(1, 2))
    least = np.linalg.svd(np.where(finite[:, None, None], matrix, 0.0), compute_uv=False)[:, -1]
    least = np.where(finite, least, np.inf)
    at, largest = int(np.argmin(least)), np.max(least, initial=0.0, where=finite)
    if not finite.any() or least[at] > _NEARLY_LOST * largest:
        return ""
    velocities = ", ".join(f"{n} = {v[at]:.2g}" for n, v in zip(flow.velocities, np.asarray(y.v), strict=True))
    return (
        f"the constraints f lose rank on the way: at t = {times[at]:.3g}, {velocities} df/dv comes down to "
        f"{least[at] / largest:.1g} of what it is elsewhere"
    )
