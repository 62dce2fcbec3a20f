"""Explanations for the user of a system: why no number of steps meets an accuracy, or why a map has no value."""

from __future__ import annotations

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from jaxnh.maps.section import Section, System
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.state import State

ROUGH = 1e-8
"""References further apart than this say nothing: more steps may yet help."""

_LONG = 4.0  # times the median return: errors have grown in it
_STIFF = 200.0  # rates a unit of time that explicit steps of the reference do not follow
_ROUGHLY = 2048  # steps along a motion that is looked at
_NOT_SMOOTH, _ORDER_OF_LAST = 2.5, 5  # order seen in the last refinements below which fields are taken to have corners


def fault_of(system: System, state: State, p: Parameters) -> str:
    """Explain why the map of a state, floats, has no value; "" where no cause is seen."""
    flow = system.flow
    state = state if flow is system else state.state
    if why := flow.fault_at(0.0, state, p) or _explain_loss(flow, state, p, flow.period):
        return why
    if (fastest := _fastest_rate(flow, state, p)) > _STIFF:
        time_unit = ", or give a smaller time_unit" if flow.autonomous else ""
        unit = "unit of time" if flow.autonomous else "period"
        return (
            f"rates of change reach {fastest:.2g} a {unit}, and solvers are explicit: the system is stiff; "
            f"slow down what is fast in it{time_unit}"
        )
    if isinstance(system, Section):
        return f"the section may not be met within {system.longest:g} units of time"
    return ""


def explain_motion(system: System, state: State, p: Parameters, length: float) -> str:
    """Explain the largest error by what the motion of its sample nearly loses in that time; "" where it is nothing."""
    state = state if system.flow is system else state.state
    why = _explain_loss(system.flow, state, p, length)
    return why and f"; {why}"


def explain_long_returns(lengths: Float[np.ndarray, " samples"], worst: int) -> str:
    """Explain the largest error by the long returns of its sample to a section; "" where they are not long."""
    if lengths[worst] > _LONG * np.nanmedian(lengths):
        return f"; it takes {lengths[worst]:.3g} units of time, which a section that is met more often would cut"
    return ""


def explain_slow_convergence(fall: Sequence[tuple[int, float]]) -> str:
    """Explain why references of more and more kicks converge slowly; "" where they do not."""
    if observed_order(fall) < _NOT_SMOOTH:
        return (
            "; more steps lessen it so slowly as where the equations jump or have corners (sign, abs, where): "
            "make these smooth, or ask for less"
        )
    return ""


def observed_order(fall: Sequence[tuple[int, float]]) -> float:
    """Return the power of the kicks by which distances fall in the last refinements; infinite where it is not known."""
    seen = [(kicks, gap) for kicks, gap in fall if gap < math.inf][-_ORDER_OF_LAST:]
    if len(seen) < _ORDER_OF_LAST or min(gap for _, gap in seen) < ROUGH:
        return math.inf
    kicks, gaps = np.log(np.array(seen)).T
    return float(-np.polyfit(kicks, gaps, 1)[0])


def _explain_loss(flow: Flow, y: State, p: Parameters, length: float) -> str:
    """Describe what a motion from a state at t = 0 nearly loses in a time, by the classical method of order 4."""
    h = length / _ROUGHLY
    times = h * np.arange(_ROUGHLY)

    @jax.jit
    def motion(y: State, p: Parameters) -> State:
        def step(y: State, t: Array) -> tuple[State, State]:
            def moved(by: float, rate: State) -> State:
                return jax.tree.map(lambda a, b: a + by * b, y, rate)

            k1 = flow.rhs(t, y, p)
            k2 = flow.rhs(t + 0.5 * h, moved(0.5 * h, k1), p)
            k3 = flow.rhs(t + 0.5 * h, moved(0.5 * h, k2), p)
            k4 = flow.rhs(t + h, moved(h, k3), p)
            rate = jax.tree.map(lambda a, b, c, d: (a + 2.0 * b + 2.0 * c + d) / 6.0, k1, k2, k3, k4)
            return moved(h, rate), y

        return lax.scan(step, y, jnp.asarray(times))[1]

    passed = jax.tree.map(np.asarray, motion(jax.tree.map(jnp.asarray, y), p))
    return flow.near_degeneracy(times, passed, p)


def _fastest_rate(flow: Flow, y: State, p: Parameters) -> float:
    """Largest modulus of the eigenvalues of a flow's linearisation at a state and t = 0, times its unit of time."""
    flat, whole = ravel_pytree(jax.tree.map(jnp.asarray, y))
    jacobian = np.asarray(jax.jacfwd(lambda z: ravel_pytree(flow.rhs(0.0, whole(z), p))[0])(flat))
    return float(np.abs(np.linalg.eigvals(jacobian)).max()) * flow.period if np.isfinite(jacobian).all() else 0.0
