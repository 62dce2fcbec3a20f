"""Duffing's resonance, in the phase of its forcing: its frequency is a parameter like others."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import scipy.integrate

DAMPING, FORCE = 0.1, 0.15


def duffing(omega=1.0):
    """x″ + δx′ + x + x³ = F cos ωt, over the phase ωt."""

    def rhs(y, t):
        x, v = y
        return v / omega, (FORCE * jnp.cos(t) - DAMPING * v - x - x**3) / omega

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * np.pi}


def by_scipy(omega, u):
    """P and its derivative in (x, v) by DOP853 with variational equations."""

    def rates(t, y):
        x, v = y[:2]
        tangents = y[2:].reshape(2, 2)
        force = FORCE * np.cos(t) - DAMPING * v - x - x**3
        change = [tangents[1], -(1 + 3 * x**2) * tangents[0] - DAMPING * tangents[1]]
        return np.concatenate([[v, force], *change]) / omega

    start = np.concatenate([u, np.eye(2).ravel()])
    end = scipy.integrate.solve_ivp(rates, (0, 2 * np.pi), start, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    return end[:2], end[2:].reshape(2, 2)
