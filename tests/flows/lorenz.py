"""The Lorenz system, over ρ, by heyoka's Taylor series."""

from __future__ import annotations

import heyoka as hy
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from jaxnh.systems.first_order import Point, first_order
from tests.flows.known_flow import KnownFlow
from tests.helpers.batches import broadcast_start

PARAMETERS = {"sigma": 10.0, "rho": 28.0, "beta": 8 / 3}
START = (1.0, 1.0, 20.0)


def lorenz(sigma=10.0, rho=28.0, beta=8 / 3):
    def rhs(y, t):
        x, y_, z = y
        return sigma * (y_ - x), x * (rho - z) - y_, x * y_ - beta * z

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}


def lorenz_from_equilibria(sigma=10.0, rho=28.0, beta=8 / 3):
    """The same with w = z − (ρ − 1): its equilibria are on w = 0 at every ρ."""

    def rhs(y, t):
        x, y_, w = y
        return sigma * (y_ - x), x * (1.0 - w) - y_, x * y_ - beta * (w + rho - 1.0)

    return {"rhs": rhs, "coordinates": ("x", "y", "w")}


def first_tangency():
    """ρ at which the end of the unstable manifolds is first tangent to the stable directions, by DOP853.

    Surfaces of motions that pass the origin leave it along its unstable manifold, tangent to what becomes of the z-axis.
    Where that plane has the direction that contracts most, at the manifold's first way down through z = ρ − 1, the
    stable and unstable foliations of the section are tangent.
    """
    return brentq(_tangency, 30.5, 31.5, xtol=1e-7)


def _jacobian(y, rho):
    return np.array([[-10.0, 10.0, 0.0], [rho - y[2], -1.0, -y[0]], [y[1], y[0], -8 / 3]])


def _rates(y, rho):
    return np.array([10.0 * (y[1] - y[0]), y[0] * (rho - y[2]) - y[1], y[0] * y[1] - 8 / 3 * y[2]])


def _tangency(rho):
    """Sine of the angle of the most contracting direction and that plane, with its sign."""

    def pushed(t, y):
        return np.concatenate([_rates(y[:3], rho), _jacobian(y, rho) @ y[3:]])

    def down(t, y):
        return y[2] - (rho - 1.0)

    down.terminal, down.direction = True, -1
    growth = 0.5 * (-11.0 + np.sqrt(121.0 + 40.0 * (rho - 1.0)))
    begun = 1e-7 * np.array([1.0, 1.0 + growth / 10.0, 0.0])
    there = solve_ivp(
        pushed, (0.0, 20.0), [*begun, 0.0, 0.0, 1.0], "DOP853", rtol=1e-12, atol=1e-14, events=down
    ).y_events[0][0]
    after = solve_ivp(
        lambda t, y: _rates(y, rho), (0.0, 2.5), there[:3], "DOP853", rtol=1e-12, atol=1e-14, dense_output=True
    )

    def backward(t, v):  # the direction that contracts most forward grows most backward
        moved = -_jacobian(after.sol(2.5 - t), rho) @ v
        return moved - (v @ moved) / (v @ v) * v

    stable = solve_ivp(backward, (0.0, 2.5), [1.0, -0.7, 0.3], "DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    normal = np.cross(_rates(there[:3], rho), there[3:])
    return normal @ stable * np.sign(stable[0]) / np.linalg.norm(normal) / np.linalg.norm(stable)


def by_heyoka(rho, state, time):
    """States (lanes, 3) a time later, in double precision."""
    x, y, z = hy.make_vars("x", "y", "z")
    equations = [(x, 10.0 * (y - x)), (y, x * (hy.par[0] - z) - y), (z, x * y - 8 / 3 * z)]
    integrator = hy.taylor_adaptive(equations, [0.0] * 3, pars=[28.0], tol=1e-18)
    found = []
    for value in rho:
        integrator.pars[0], integrator.time, integrator.state[:] = value, 0.0, state
        integrator.propagate_until(time)
        found.append(integrator.state.copy())
    return np.array(found)


def known_flow():
    rho = np.array([20.0, 28.0, 60.0])
    flow = first_order(lorenz, PARAMETERS, ("rho",))
    exact = by_heyoka(rho, START, flow.period)
    return KnownFlow(
        flow,
        broadcast_start(Point(START), 3),
        exact,
        flow.chart.host_points,
        {"rho": rho},
        evaluations=1000,
        rounding=1e-13,
    )
