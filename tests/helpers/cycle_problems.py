"""Fields of flows for collocation, and first paths of cycles by scipy's integrator."""

from __future__ import annotations

import functools

import jax
import numpy as np
from scipy.integrate import solve_ivp

from jaxnh.orbits.collocation.equations import BoundarySolution, FieldValues, Problem
from jaxnh.orbits.collocation.fields import point_rates
from jaxnh.orbits.collocation.paths import path_through


def problem_of(flow, names, size, widths=None, others=None):
    """The problem of a flow over parameters by name, beside others of which lanes have their own."""
    rates = jax.jit(jax.vmap(functools.partial(point_rates, flow, names=names)))

    def field(y, t, values):
        room = 1 << (len(y) - 1).bit_length()

        def padded(x):
            return np.concatenate([x, np.repeat(x[:1], room - len(x), axis=0)])

        p = {name: np.full(room, value) for name, value in (others or {}).items()}
        p |= {name: padded(values[:, k]) for k, name in enumerate(names)}
        return FieldValues(*(np.asarray(leaf)[: len(y)] for leaf in rates(padded(y), padded(t), p)))

    widths = np.ones(len(names)) if widths is None else np.asarray(widths, float)
    return Problem(field, np.asarray(size, float), widths, not flow.autonomous)


def first_cycle(rhs, start, values, n, number=0, level=0.0, transient=100.0, longest=100.0):
    """The attracting cycle of ẏ = rhs(y, t) between passages up of a coordinate, after a transient; no good digits."""

    def passes(t, y):
        return y[number] - level

    passes.direction = 1

    def rates(t, y):
        return np.array(rhs(y, t), float)

    options = {"method": "LSODA", "rtol": 1e-9, "atol": 1e-9}
    begun = solve_ivp(rates, (0.0, transient), start, **options).y[:, -1]
    found = solve_ivp(rates, (0.0, longest), begun, events=passes, **options)
    (first, second), states = found.t_events[0][:2], found.y_events[0]
    inside = (found.t > first) & (found.t < second)
    times = np.concatenate([[first], found.t[inside], [second]])
    path, duration = path_through(times, np.concatenate([states[:1], found.y.T[inside], states[1:2]]), n)
    return BoundarySolution(path, np.array([duration]), np.array([values], float).reshape(1, -1))
