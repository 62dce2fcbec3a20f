"""Doublings of two textbook flows against heyoka's Taylor integrator with a Newton of its own."""

from __future__ import annotations

import heyoka as hy
import numpy as np
import pytest
import taylor
from conftest import ROOT, session_of

import jaxnh


def pendulum():
    """configs/flows/pendulum.py for `taylor`: an angle last, and one variable that stays zero and counts for nothing."""
    rate, still, phi = hy.make_vars("rate", "still", "phi")
    gamma, damping, drive = hy.par[0], hy.par[1], hy.par[4]
    natural = 1.5 * drive
    force = natural * natural * (gamma * hy.cos(drive * hy.time) - hy.sin(phi))
    return (rate, still, phi), gamma, [(rate, force - 2 * damping * natural * rate), (still, -still), (phi, rate)]


class Pendulum(taylor.Parameters):
    equations = staticmethod(pendulum)


@pytest.mark.slow
def test_doublings_of_the_driven_pendulum():
    """Within a unit of the last digit that Taylor gives (Classical Mechanics, 2005, 12.4); three to 1e-9 of heyoka.

    The first is 1.06637, where the book has 1.0663.
    """
    session = session_of(jaxnh.load(ROOT / "configs/flows/pendulum.yaml", ["analyses={doubling: {levels: 4}}"]))
    found = session.run("doubling")
    ours, errors = found["gamma"].to_numpy(), found["gamma_error"].to_numpy()
    assert found["period"].to_numpy().tolist() == [1, 2, 4, 8]
    assert np.abs(ours - [1.0663, 1.0793, 1.0821, 1.0827]).max() < 1e-4
    start = np.array([0.0, 0.0, -np.pi / 2])
    par = Pendulum(a=0.25, omega=2 * np.pi)
    exact = taylor.cascade(par, [1.0663, 1.0793, 1.0821], start, before=1.062)
    gaps = np.abs(ours[:3] - [float(value) for value, _, _ in exact])
    assert gaps.max() < 1e-9
    assert np.all(gaps < errors[:3] + [info.error for _, _, info in exact])


def crossing(c, start, count):
    """Roessler's state and its derivatives in (x, y, z, c) where y passes zero upward for the `count`-th time, (3, 5)."""
    x, y, z = hy.make_vars("x", "y", "z")
    motion = [(x, -y - z), (y, x + 0.2 * y), (z, 0.2 + z * (x - hy.par[0]))]
    equations = hy.var_ode_sys(motion, [x, y, z, hy.par[0]], order=1)
    times = []
    event = hy.nt_event(y, lambda ta, t, d: times.append(t), direction=hy.event_direction.positive, fp_type=taylor.REAL)
    ta = hy.taylor_adaptive(
        equations,
        np.asarray(start, taylor.REAL),
        pars=[taylor.REAL(c)],
        fp_type=taylor.REAL,
        nt_events=[event],
        compact_mode=True,
    )
    begun = ta.state.copy()
    while len([t for t in times if t > 1e-6]) < count:
        ta.step()
    end = [t for t in times if t > 1e-6][count - 1]
    ta = hy.taylor_adaptive(equations, begun[:3], pars=[taylor.REAL(c)], fp_type=taylor.REAL, compact_mode=True)
    ta.propagate_until(end)
    state, first = ta.state[:3], ta.state[3:].reshape(3, 4)
    rate = np.array([-state[1] - state[2], state[0] + 0.2 * state[1], 0.2 + state[2] * (state[0] - taylor.REAL(c))])
    onto = first - np.outer(rate, first[1]) / rate[1]  # all stay on the section
    return state, onto


def doubled(c, u, n):
    """(c, u): Newton on Pⁿ(u) = u with det(∂Pⁿ/∂u + 1) = 0, the derivatives of the determinant by differences."""

    def mismatch(unknowns):
        c, x, z = unknowns
        state, first = crossing(c, [x, 0.0, z], n)
        matrix = first[np.ix_([0, 2], [0, 2])] + np.eye(2)
        return np.array([state[0] - x, state[2] - z, matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]])

    at = np.array([c, *u], dtype=taylor.REAL)
    for _ in range(6):
        here = mismatch(at)
        slopes = np.array([(mismatch(at + h) - mismatch(at - h)) / 2e-6 for h in 1e-6 * np.eye(3)]).T
        step = np.linalg.solve(slopes.astype(float), -here.astype(float))
        at = at + step
        if np.abs(step).max() < 1e-13:
            break
    return float(at[0])


@pytest.mark.slow
def test_doublings_of_roessler_on_a_section():
    """The first two over c, to 1e-9 of heyoka's events and variational equations."""
    settings = [
        "analyses={doubling: {levels: 2}}",
        "sweep={c: {start: 2.6, stop: 4.0, count: 57}}",
        "accuracy.target=1e-10",
    ]
    found = session_of(jaxnh.load(ROOT / "configs/flows/roessler.yaml", settings)).run("doubling")
    ours, errors = found["c"].to_numpy(), found["c_error"].to_numpy()
    assert found["period"].to_numpy().tolist() == [1, 2]
    for value, error, n in zip(ours, errors, (1, 2), strict=True):
        state, _ = crossing(value - 0.02, [1.0, 1.0, 0.0], 200)
        exact = doubled(value, [state[0], state[2]], n)
        assert abs(value - exact) < max(1e-9, error)
        assert abs(value - exact) < error + 1e-11
