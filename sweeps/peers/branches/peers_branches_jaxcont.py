"""JaxCont on a case of `sweeps.peers.branches.peers_branches`, in an interpreter of its own: what it finds, and
seconds, as JSON.

    PYTHON -P peers_branches_jaxcont.py CASE

A cycle that attracts is integrated by scipy, as JaxCont does not, and followed to both ends of the range in double
precision. It has folds, doublings and Neimark-Sacker bifurcations of cycles as events. Nothing of jaxnh is imported.
"""
# pyright: reportMissingImports=false

from __future__ import annotations

import json
import sys
import time

BEGAN = time.perf_counter()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import jaxcont as jc  # noqa: E402
import numpy as np  # noqa: E402
from jaxcont.core.collocation import Collocation  # noqa: E402
from jaxcont.problems.periodic import periodic_orbit_problem  # noqa: E402
from scipy.integrate import solve_ivp  # noqa: E402


def circuit(u, nu):
    x, y, z = u
    bent = 0.93358 * (y - x) ** 3
    first = (-(0.5 + nu) * x + 0.5 * y - 0.32858 * x**3 + bent) / 0.6
    return first, 0.5 * x + 0.1 * y - z - bent, y + 0.001


def peroxidase(u, k8):
    a, b, x, y = u
    one, three, two = 0.1631021 * a * b * x, 0.046875 * a * b * y, 2500 * x**2
    spent = one + three
    return 1.5 - 0.1175 * a - spent, k8 - spent, one - two + 2 * three - 20 * x + 0.001, two - three - 1.104 * y


CASES = {
    "circuit": (circuit, [-0.05, -0.09, -0.11], -0.605, (-0.65, -0.58), 2, 0.02, 1, 25),
    "peroxidase": (peroxidase, [8.0, 12.0, 0.003, 0.005], 0.81, (0.79, 0.86), 0, 5.9, -1, 50),
}
"""Equations, a start, the parameter there and its range, a section: coordinate, level, direction; intervals."""


def cycle(equations, start, p, place, level, way):
    """Times and states of the cycle that attracts a start."""

    def rates(t, u):
        return equations(u, p)

    def passes(t, u):
        return u[place] - level

    passes.direction = way  # pyright: ignore[reportFunctionMemberAccess]
    options = {"method": "LSODA", "rtol": 1e-10, "atol": 1e-12}
    settled = solve_ivp(rates, (0, 2000), start, events=passes, **options)
    period = settled.t_events[0][-1] - settled.t_events[0][-2]
    times = np.linspace(0, period, 2001)
    path = solve_ivp(rates, (0, period), settled.y_events[0][-1], t_eval=times, **options)
    return times, path.y.T, period


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    equations, start, p, ends, place, level, way, intervals = CASES[sys.argv[1]]
    times, path, period = cycle(equations, start, p, place, level, way)

    def field(u, p, args):
        return jnp.array(equations(u, p))

    mesh = Collocation(ntst=intervals, ncol=4)
    problem = periodic_orbit_problem(field, jnp.asarray(path), jnp.asarray(times), period, p, mesh)
    found, points = [], 0
    for end in ends:
        result = jc.continuation(
            problem,
            jc.PseudoArclength(),
            p_span=(p, end),
            settings=jc.ContinuationPar(ds=0.005, ds_min=1e-5, ds_max=0.02, max_steps=300, newton_tol=1e-8),
            events=[
                jc.Fold(),
                jc.NeimarkSacker(raw_f=field, mesh=mesh),
                jc.PeriodDoubling(raw_f=field, mesh=mesh),
            ],
        )
        found += [(hit.kind, float(hit.p)) for hit in result.events]
        points += result.branch.n_valid
    print(json.dumps({"found": found, "points": points, "seconds": time.perf_counter() - BEGAN}))


if __name__ == "__main__":
    main()
