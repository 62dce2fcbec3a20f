"""The same flow with lengths, times and its parameter in other units: the same periods and verdicts, scaled doublings."""

from __future__ import annotations

import itertools

import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.analyses import chaos01, verdict
from jaxnh.analyses.batch import Axis, LaneBatch
from jaxnh.analyses.cascade import doubling
from jaxnh.analyses.exponents import lyapunov
from jaxnh.analyses.periodic import period
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.solvers import dopri8
from jaxnh.systems.first_order import Point, first_order
from jaxnh.systems.lagrangian import Motion, lagrangian
from tests.helpers.batches import broadcast_start

K = 2.0**10
# Lengths, times and the parameter are so many times what they were; powers of two, so that chaos is the same as well.
UNITS = [(1.0, 1.0, 1.0), (K, 1.0, 1.0), (1 / K, 1.0, K), (1.0, K, 1 / K), (1 / K, 2.0**-7, 1.0)]
LANES = LaneExecutor(tile=32)


def duffing(drive=0.3, length=1.0, time=1.0, unit=1.0):
    def rhs(y, t):
        x, v = y[0] / length, y[1] * time / length
        force = drive / unit * jnp.cos(t / time) + x - x**3 - 0.2 * v
        return y[1], force * length / time**2

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * np.pi * time}


def governor(drive=0.8, length=1.0, time=1.0, unit=1.0):
    """configs/governor.py; the mass is one, so that forces are in lengths over times squared."""

    def T(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2)

    def Q(q, v, t):
        x, y, vx, vy = q[0] / length, q[1] / length, v[0] * time / length, v[1] * time / length
        first = drive / unit * jnp.sin(t / time) + x - x**3 - 0.2 * vx
        return first * length / time**2, (-y - 0.2 * vy) * length / time**2

    def f(q, v, t):
        return (v[1] - 0.5 * (v[0] ** 2 * time / length - 0.5 * length / time),)

    return {"T": T, "Q": Q, "f": f, "coordinates": ("x", "y"), "period": 2 * np.pi * time}


def particle(b=5.6, length=1.0, time=1.0, unit=1.0):
    """Equation (12): constant speed, by T, Q and f."""

    def T(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2)

    def Q(q, v, t):
        x, y, vx, vy = q[0] / length, q[1] / length, v[0] * time / length, v[1] * time / length
        g = 1.0 + jnp.sin(t / time)
        first = -(0.5 * g * x + g * x**3 - b / unit * y) - 0.5 * vx
        second = -(g * y + 0.5 * g * y**3 - b / unit * x) - 0.5 * vy
        return first * length / time**2, second * length / time**2

    def f(q, v, t):
        return ((v[0] ** 2 + v[1] ** 2) * time / length - length / time,)

    return {"T": T, "Q": Q, "f": f, "coordinates": ("x1", "y1"), "period": 2 * np.pi * time}


def scene(define, start, values, units, steps):
    """Lanes along the parameter, everything in these units; the state starts where the one with units of one does."""
    length, time, unit = units
    name = "b" if define is particle else "drive"
    make = first_order if define is duffing else lagrangian
    system = make(define, {name: unit * values[0], "length": length, "time": time, "unit": unit}, (name,))
    if define is duffing:
        state = Point((start[0] * length, start[1] * length / time))
    else:
        k = len(start) // 2
        speeds = tuple(v * length / time for v in start[k:])
        state = Motion(tuple(x * length for x in start[:k]), speeds, (0.0, 0.0))
    scaled = unit * np.asarray(values)
    axis = Axis(name, scaled, f"parameter {name}")
    return LaneBatch(system, broadcast_start(state, len(values)), {name: scaled}, dopri8, steps, False, 1e-9, axis=axis)


@pytest.mark.slow
def test_periods_of_duffing_in_any_units():
    """Periods 1, 3 and none, too early for slow lanes: those of the first units, and multipliers to rounding.

    Where near meant 0.03 of any unit, four of these lanes had other periods in other units.
    """
    values = [*np.linspace(0.236, 0.248, 13), 0.25, 0.29, 0.32]
    found = []
    for units in UNITS:
        here = scene(duffing, (1.0, 0.0), values, units, 48)
        found.append(period.run(period.PeriodOptions(max_period=16, transient=40), here, LANES))
    first, *others = found
    assert set(first["period"].to_numpy().tolist()) >= {0, 1, 3}
    for other in others:
        assert np.array_equal(other["period"], first["period"])
        stable = first["period"].to_numpy() > 0
        gap = np.abs(other["multiplier"].to_numpy() - first["multiplier"].to_numpy())[stable]
        assert gap.max() < 1e-9


@pytest.mark.slow
def test_verdicts_of_duffing_in_any_units():
    """The same kinds of motion, and exponents in units of one over the time."""
    values, kinds, exponents = np.linspace(0.2, 0.45, 16), [], []
    for units in UNITS:
        here = scene(duffing, (1.0, 0.0), values, units, 48)
        done = {
            "period": period.run(period.PeriodOptions(), here, LANES),
            "lyapunov": lyapunov.run(lyapunov.LyapunovOptions(exponents=2), here, LANES),
            "chaos01": chaos01.run(chaos01.Chaos01Options(), here, LANES),
        }
        kinds.append(verdict.run(verdict.VerdictOptions(confirmation_factor=0), here, LANES, done)["kind"].to_numpy())
        exponents.append(done["lyapunov"]["exponents"].to_numpy()[:, 0] * units[1])
    decided = [set(column) - {3} for column in np.array(kinds).T]  # undecided may be on the edge of a bar
    assert all(len(kind) <= 1 for kind in decided)
    assert {int(kind) for column in decided for kind in column} >= {0, 2}
    settled = [np.ptp(column) for column, kind in zip(np.array(exponents).T, decided, strict=True) if kind == {0}]
    assert max(settled) < 1e-6


CASCADES = {
    "duffing": (duffing, (1.0, 0.0), np.linspace(0.25, 0.29, 41), 64),
    "governor": (governor, (0.5, 0.0, 0.0, -0.25), np.linspace(0.87, 0.785, 24), 136),
    "particle": (particle, (0.1, 0.1, 0.1, np.sqrt(0.99)), np.linspace(5.56, 5.48, 17), 160),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASCADES)
def test_doublings_in_any_units(name):
    """The first two, scaled, within the errors of both.

    Of the particle, whose programs are large, in units of length, time and parameter each once: all five are the others'.
    """
    define, start, values, steps = CASCADES[name]
    found = []
    for units in UNITS[::2] if name == "particle" else UNITS:
        here = scene(define, start, values, units, steps)
        data = doubling.run(doubling.DoublingOptions(levels=2, search=False), here, LANES)
        axis = data.attrs["along"]
        points, errors = data[axis].to_numpy() / units[2], data[f"{axis}_error"].to_numpy() / units[2]
        found.append((data["period"].to_numpy().tolist(), points, errors))
    assert np.isfinite(found[0][1]).all()
    for (periods, points, errors), (others, same, more) in itertools.combinations(found, 2):
        assert periods == others
        assert np.all(np.abs(points - same) <= errors + more)
