"""Maps of one lane or of few, compiled once for all maps of a kind, whose grids and parameters are arguments."""

from __future__ import annotations

import jax

from jaxnh.maps.iterate import derivatives, iterate

compiled_iterate = jax.jit(iterate)
"""Pⁿ(z; p), of (strobe, n, z, p)."""


@jax.jit
def state_after(strobe, u, p, n=1):
    """The state n returns after a point (d,) of the section."""
    return iterate(strobe, n, strobe.chart.state(u), p)


states_after = jax.jit(jax.vmap(state_after, (None, 0, None, None)))
"""The states n returns after points (lanes, d), of (strobe, points, p, n)."""


@jax.jit
def image_after(strobe, u, p, n):
    """The image of a point (d,) by n returns that take tangents along."""
    return derivatives(strobe, n, u, p).image
