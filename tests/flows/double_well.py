"""Duffing's oscillator with two wells, by T and Q, as a file that a user would write."""

from __future__ import annotations

DOUBLE_WELL = """
import jax.numpy as jnp


def system(drive=0.8, damping=0.2, omega=1.0):
    def T(q, v, t):
        return 0.5 * v[0] ** 2

    def Q(q, v, t):
        return (drive * jnp.sin(omega * t) + q[0] - q[0] ** 3 - damping * v[0],)

    return {"T": T, "Q": Q, "coordinates": ("x",), "period": 2 * jnp.pi / omega}
"""
