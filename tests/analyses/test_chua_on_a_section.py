"""Chua's circuit on a section: its first doubling, exponents and crossings, by exponentials of its linear pieces."""

from __future__ import annotations

import functools

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq, root

import jaxnh

pytestmark = pytest.mark.slow
VALUE = 0.5  # of v, passed upward
FINE = 0.01  # between states at which crossings are looked for


def chua(a=8.4):
    def rhs(y, t):
        x, u, v = y
        corners = jnp.abs(x + 1.0) - jnp.abs(x - 1.0)
        return a * (u - x + 5 / 7 * x + 3 / 14 * corners), x - u + v, -100 / 7 * u

    return {"rhs": rhs, "coordinates": ("x", "u", "v")}


def returned(x, u, a):
    """The next crossing of v = 1/2 upward, its derivative in the state and the time; the field there.

    The field has no jump, so that tangents pass a corner as they are.
    """

    def linear(zone):
        slope = -8 / 7 if zone == 0 else -5 / 7
        whole = np.zeros((4, 4))
        whole[:3, :3] = [[-a * (1 + slope), a, 0.0], [1.0, -1.0, 1.0], [0.0, -100 / 7, 0.0]]
        whole[0, 3] = a * zone * 3 / 7
        return whole

    y, t, zone, tangents = np.array([x, u, VALUE, 1.0]), 0.0, int(np.fix(x)), np.eye(3)
    ends = [(0, -1.0), (0, 1.0), (2, VALUE)]
    while True:
        matrix, begin = linear(zone), 1e-6  # beyond what it is on
        at = lambda s: expm(matrix * s) @ y  # noqa: B023, E731
        path, passed, onwards = [at(begin)], [], expm(matrix * FINE)
        for _ in range(400):
            path.append(onwards @ path[-1])
        path = np.array(path)
        for k, level in ends:
            height = path[:, k] - level
            up, down = (height[:-1] < 0.0) & (height[1:] > 0.0), (height[:-1] > 0.0) & (height[1:] < 0.0)
            passed += [(i, k, level) for i in np.flatnonzero(up if k == 2 else up | down)[:1]]
        i, k, level = min(passed)
        begin += FINE * i
        s = brentq(lambda s: at(s)[k] - level, begin, begin + FINE, xtol=1e-15, rtol=1e-14)  # noqa: B023
        tangents = expm(matrix * s)[:3, :3] @ tangents
        y, t = at(s), t + s
        if k == 2:
            return y[:3], tangents, t, (matrix @ y)[:3]
        zone = int(level) if zone == 0 else 0


def multipliers(a, near):
    """Of the orbit of period 1 on the section, and its period in time."""
    found = root(lambda z: returned(*z, a)[0][:2] - z, near, tol=1e-13)
    _, tangents, t, field = returned(*found.x, a)
    onto = np.eye(3) - np.outer(field, [0.0, 0.0, 1.0]) / field[2]
    return np.sort(np.linalg.eigvals((onto @ tangents)[:2, :2]).real), t


@functools.cache
def session():
    made = jaxnh.Session(chua, start={"x": 0.7, "u": 0.1, "v": -0.2}, target=1e-9)
    return made.on(coordinate="v", value=VALUE, direction="up")


def test_strobes_follow_each_other():
    """Each crossing is the image of the one before, by exponentials, within the error of the plan."""
    data = session().run(jaxnh.Diagram(transient=64, strobes=4), a=[8.25, 8.42, 8.6])
    for lane in range(3):
        x, u = data["x"].to_numpy()[lane], data["u"].to_numpy()[lane]
        for k in range(3):
            y, _, t, _ = returned(x[k], u[k], float(data["a"][lane]))
            assert np.abs(y[:2] - [x[k + 1], u[k + 1]]).max() < 1e-8
            assert t == pytest.approx(
                float(data["t"].to_numpy()[lane][k + 1] - data["t"].to_numpy()[lane][k]), abs=1e-8
            )


def test_doubling_and_exponents():
    """A multiplier of −1 within the error that is said, and exponents before it by the multipliers."""
    orbit = session().run(jaxnh.Diagram(transient=300, strobes=1), a=[8.3])
    near = np.array([orbit["x"].to_numpy()[0, 0], orbit["u"].to_numpy()[0, 0]])
    exact = brentq(lambda a: multipliers(a, near)[0][0] + 1.0, 8.35, 8.45, xtol=1e-12)
    doublings = session().run(jaxnh.Doubling(levels=2), a=np.linspace(8.3, 8.5, 16))
    assert abs(float(doublings["a"][0]) - exact) < float(doublings["a_error"][0]) + 1e-9  # that of the map
    exponents = session().run(jaxnh.Lyapunov(transient=300, periods=100, exponents=3), a=[8.3])
    moduli, t = multipliers(8.3, near)
    known = [0.0, *sorted(np.log(np.abs(moduli)) / t, reverse=True)]
    gap = np.abs(exponents["exponents"].to_numpy()[0] - known)
    assert np.all(gap <= exponents["exponents_error"].to_numpy()[0] + 1e-8)
