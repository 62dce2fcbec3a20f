"""Events that fall on the end of a period or of a unit of time: they have happened when the strobe sees the motion."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh


def ball(g=2.0, r=1.0):
    """A ball that falls to the floor: from a height of one it is there after one unit of time, exactly."""
    return {
        "rhs": lambda y, t: (y[1], -g + 0.0 * y[0]),
        "coordinates": ("x", "v"),
        "jumps": [{"when": lambda y, t: y[0], "direction": "down", "then": lambda y, t: (y[0], -r * y[1])}],
    }


def kicked_rotor(K=3.0):
    """Free turning, and a kick with the end of each period."""

    def kick(y, t):
        return y[0], y[1] + K * jnp.sin(y[0])

    return {
        "rhs": lambda y, t: (y[1], 0.0 * y[0]),
        "coordinates": ("angle", "momentum"),
        "angles": "angle",
        "period": 1.0,
        "jumps": [{"when": lambda y, t: jnp.sin(2.0 * jnp.pi * t), "then": kick}],
    }


def standard_map(K=3.0):
    def image(s):
        angle = s[0] + s[1]
        return angle, s[1] + K * jnp.sin(angle)

    return {"map": image, "coordinates": ("angle", "momentum"), "angles": "angle"}


def stadium(a=1.0):
    """A billiard between two lines and two half circles of radius one."""

    def beside(y):
        return jnp.sign(y[0]) * jnp.maximum(jnp.abs(y[0]) - a, 0.0)

    def reflected(y, t):
        x, z = beside(y), y[1]
        across = 2.0 * (y[2] * x + y[3] * z) / (x * x + z * z)
        return y[0], y[1], y[2] - across * x, y[3] - across * z

    return {
        "rhs": lambda y, t: (y[2], y[3], 0.0 * y[2], 0.0 * y[3]),
        "coordinates": ("x", "y", "u", "v"),
        "jumps": [{"when": lambda y, t: 1.0 - beside(y) ** 2 - y[1] ** 2, "direction": "down", "then": reflected}],
    }


def test_a_ball_that_is_down_with_the_unit_of_time():
    session = jaxnh.Session(ball, start={"x": 1.0}, target=1e-8)
    portrait = session.run(jaxnh.Portrait(transient=0, periods=12, samples=1))
    np.testing.assert_allclose(portrait["x"], np.resize([1.0, 0.0], 12), atol=1e-12)
    np.testing.assert_allclose(portrait["v"], np.resize([0.0, 2.0], 12), atol=1e-12)
    exponents = session.run(jaxnh.Lyapunov(periods=200, exponents=2))
    assert np.all(np.abs(exponents["exponents"]) <= exponents["exponents_error"])
    assert float(exponents["exponents_error"].max()) < 1e-6


@pytest.mark.usefixtures("quick_compiling")
def test_kicks_with_the_end_of_a_period():
    """They make the standard map, motion by motion while it is regular, and its exponents."""
    values, diagram = [0.3, 0.9], jaxnh.Diagram(transient=0, strobes=32)
    start = {"angle": 1.0, "momentum": 0.4}
    session = jaxnh.Session(kicked_rotor, start=start, target=1e-8)
    same = jaxnh.Session(standard_map, start=start)
    np.testing.assert_allclose(
        session.run(diagram, K=values)["momentum"], same.run(diagram, K=values)["momentum"], atol=1e-9
    )
    lyapunov = jaxnh.Lyapunov(periods=500, exponents=2)
    np.testing.assert_allclose(
        session.run(lyapunov, K=values)["exponents"], same.run(lyapunov, K=values)["exponents"], atol=1e-8
    )


@pytest.mark.usefixtures("quick_compiling")
def test_a_billiard_whose_first_wall_is_met_with_the_unit_of_time():
    """From y = 0.2 with the velocity (0.6, 0.8) the line y = 1 is met at t = 1; the ball stays inside and keeps its speed."""
    session = jaxnh.Session(stadium, start={"x": 0.1, "y": 0.2, "u": 0.6, "v": 0.8}, target=1e-8)
    at = session.run(jaxnh.Portrait(transient=0, periods=40, samples=1))
    x, y, u, v = (at[name].to_numpy().ravel() for name in ("x", "y", "u", "v"))
    np.testing.assert_allclose([x[1], y[1], u[1], v[1]], [0.7, 1.0, 0.6, -0.8], atol=1e-12)
    np.testing.assert_allclose(u**2 + v**2, 1.0, atol=1e-10)
    assert np.all(np.maximum(np.abs(x) - 1.0, 0.0) ** 2 + y**2 <= 1.0 + 1e-12)
