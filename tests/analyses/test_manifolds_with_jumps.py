"""Manifolds of motions with impacts: what has no way back is refused."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.exceptions import InputError

pytestmark = pytest.mark.usefixtures("quickly_uncalibrated", "quick_compiling_once")

TURN = 2 * np.pi


def test_a_restitution_of_zero_has_no_way_back():
    """In one of the lanes, or of all; unstable manifolds go."""

    def struck(r=0.5):
        wall = {"when": lambda q, v, t: 0.2 - q[0], "restitution": r}
        force = lambda q, v, t: (q[0] + 0.3 + 0.05 * jnp.cos(TURN * t),)  # noqa: E731
        return {"T": lambda q, v, t: 0.5 * v[0] ** 2, "Q": force, "coordinates": ("x",), "period": 1.0, "jumps": [wall]}

    session = jaxnh.Session(struck, start={"x": -0.3, "x_dot": 0.0})
    options = {"box": {"x": (-0.5, 0.2), "x_dot": (-0.5, 0.5)}, "length": 0.5, "spacing": 0.2, "n_starts": 4}
    for r in ([0.5, 0.0], [0.0]):
        with pytest.raises(
            InputError, match=r"restitution zero does, and there is no way back; .* take kind: unstable"
        ):
            session.run(jaxnh.Manifolds(**options), r=r)
    ends = session.run(jaxnh.Manifolds(**options, kind="unstable", crossings=0), r=[0.0])["end"]
    assert set(jaxnh.labels(ends).to_numpy().ravel()) == {"length"}
