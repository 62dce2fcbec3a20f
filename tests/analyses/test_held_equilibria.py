"""Equilibria that motions come to in finite time, resting on a wall or stuck to a surface: exponents, and basins."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from tests.flows.belt import stick_slip
from tests.helpers.cases import some_slow


def ball(r=0.5, c=0.4):
    """A ball that falls on a table, and carries a spring that swings sideways, damped: x'' + c x' + x = 0."""

    def rhs(y, t):
        return y[1], -1.0, y[3], -y[2] - c * y[3]

    def bounce(y, t):
        return y[0], -r * y[1], y[2], y[3]

    return {
        "rhs": rhs,
        "coordinates": ("h", "v", "x", "w"),
        "jumps": ({"when": lambda y, t: y[0], "direction": "down", "then": bounce, "rest": True},),
    }


def caught(mu=1.0):
    """Dry friction brings x to 0, and z follows to 2 + x."""
    return {"rhs": lambda y, t: (-mu * jnp.sign(y[0]) - 0.1 * y[0], 2.0 + y[0] - y[1]), "coordinates": ("x", "z")}


def stuck(mu=0.5):
    """A block on a spring, which dry friction holds anywhere in −μ ≤ x ≤ μ."""
    return {"rhs": lambda y, t: (y[1], -y[0] - mu * jnp.sign(y[1])), "coordinates": ("x", "v")}


BOXES = {
    ball: {"h": (0.5, 1.5), "v": (-1.0, 1.0), "x": (-1.0, 1.0), "w": (-1.0, 1.0)},
    caught: {"x": (-2.0, 2.0), "z": (-1.0, 1.0)},
    stuck: {"x": (-2.0, 2.0), "v": (-1.0, 1.0)},
}


def basins_of(system, **start):
    """The groups of basins, of random starts, and of what they lead to."""
    options = jaxnh.Basins(n_starts=8, box=BOXES[system], max_periods=1024)
    return jaxnh.Session(system, start=start, target=1e-6).groups({"basins": options})


@pytest.mark.slow
@pytest.mark.parametrize(("r", "c"), [(0.5, 0.4), (0.7, 1.0)])
def test_exponents_at_rest(r, c):
    """On the table two have vanished, whatever rounding leaves of the force that keeps it there, and two are −c/2."""
    session = jaxnh.Session(ball, start={"h": 1.0, "x": 0.5}, parameters={"r": r, "c": c}, target=1e-8)
    data = session.run(jaxnh.Lyapunov(transient=64, periods=256, exponents=4))
    exponents, errors = data["exponents"].to_numpy(), data["exponents_error"].to_numpy()
    assert np.all(np.abs(exponents[:2] + c / 2) <= errors[:2])
    assert errors[:2].max() < 0.01
    assert exponents[2:].tolist() == [-np.inf, -np.inf]


@pytest.mark.parametrize(
    ("system", "point", "exponent"),
    some_slow(
        {
            "rest": (ball, {"h": 0.0, "v": 0.0, "x": 0.0, "w": 0.0}, -0.2),
            "stick": (caught, {"x": 0.0, "z": 2.0}, -1.0),
        },
        "stick",
    ),
)
def test_basin_of_a_held_equilibrium(system, point, exponent):
    """All starts come to it."""
    start = {name: low + 0.7 for name, (low, _) in BOXES[system].items()}
    groups = basins_of(system, **start)
    attractors = groups["attractors"]
    assert jaxnh.labels(attractors["kind"]).values.tolist() == ["equilibrium"]
    assert groups["basins"]["attractor"].to_numpy().tolist() == [1] * 8
    assert float(attractors["exponent"][0]) == pytest.approx(exponent, abs=1e-6)
    for name, value in point.items():
        assert float(attractors[name][0]) == pytest.approx(value, abs=1e-8)


@pytest.mark.slow
def test_many_held_equilibria():
    """Where a block sticks anywhere, no place attracts what is near it; and no volume is kept."""
    groups = basins_of(stuck, x=2.2, v=0.0)
    assert jaxnh.labels(groups["basins"]["undecided"]).values.tolist() == ["time"] * 8


@pytest.mark.slow
def test_a_cycle_as_long_as_the_unit_of_time():
    """Stick and slip come back after it to where they were, at which the block may stick: no equilibrium."""

    def timed(mu=1.0, c=0.3, u=0.5, unit=6.0):
        """x'' + x = friction of a belt at speed u."""
        return {
            "rhs": lambda y, t, side: (y[1], -y[0] - mu * side[0] + c * (y[1] - u)),
            "coordinates": ("x", "v"),
            "switches": ({"on": lambda y, t: y[1] - u, "sliding": True},),
            "time_unit": unit,
        }

    slip, stick, _ = stick_slip()
    session = jaxnh.Session(timed, start={"x": 0.5, "v": 0.5}, parameters={"unit": float(slip + stick)}, target=1e-6)
    groups = session.groups(
        {"basins": jaxnh.Basins(n_starts=8, box={"x": (-0.5, 1.5), "v": (0.2, 0.5)}, max_periods=1024)}
    )
    assert set(jaxnh.labels(groups["attractors"]["kind"]).values.tolist()) == {"limit cycle"}
