"""The Lorenz system, over ρ, by heyoka's Taylor series."""

from __future__ import annotations

import heyoka as hy
import numpy as np

from jaxnh.analyses.batch import broadcast_start
from jaxnh.systems.first_order import Point, first_order
from tests.flows.known_flow import KnownFlow

PARAMETERS = {"sigma": 10.0, "rho": 28.0, "beta": 8 / 3}
START = (1.0, 1.0, 20.0)


def lorenz(sigma=10.0, rho=28.0, beta=8 / 3):
    def rhs(y, t):
        x, y_, z = y
        return sigma * (y_ - x), x * (rho - z) - y_, x * y_ - beta * z

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}


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
