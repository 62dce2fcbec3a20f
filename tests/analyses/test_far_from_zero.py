"""A Duffing oscillator whose coordinate is measured from far away: the same branches, once each, and the same cusp."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxnh
from tests.helpers.cases import some_slow

pytestmark = pytest.mark.usefixtures("quick_compiling", "shared_programs")


def duffing(F=0.3, d=0.3, centre=0.0):
    """x'' + d x' − x + x³ = F cos 1.2 t."""

    def rhs(y, t):
        x = y[0] - centre
        return y[1], -d * y[1] + x - x**3 + F * jnp.cos(1.2 * t)

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / 1.2}


def session_at(centre):
    return jaxnh.Session(duffing, start={"x": centre + 0.5, "v": 0.0}, parameters={"centre": centre}, target=1e-8)


@pytest.mark.parametrize("centre", some_slow({"10": 10.0, "100": 100.0, "1000": 1000.0}, "10"))
def test_no_branch_is_found_twice(centre):
    """Near F = 0.15 the cycle changes by a tenth over a thousandth of F, where a cubic between points of a branch is off
    at one value by more than along it: at 10 and at 100 the branch was followed again from an orbit of itself."""
    data = session_at(centre).run(jaxnh.Branches(max_period=2), F=np.linspace(0.1, 0.3, 9))
    assert data["period"].to_numpy().tolist() == [1, 2]
    ends = np.flatnonzero(np.isfinite(data["F"].to_numpy()[0]))[[0, -1]]
    for F, x, v in np.stack([data[name].to_numpy()[0, ends] for name in "Fxv"], axis=1):
        after = solve_ivp(
            lambda t, y, F=F: (y[1], -0.3 * y[1] + y[0] - y[0] ** 3 + F * np.cos(1.2 * t)),
            (0.0, 2 * np.pi / 1.2), (x - centre, v), "DOP853", rtol=1e-12, atol=1e-14,
        ).y[:, -1]  # fmt: skip
        np.testing.assert_allclose(after, (x - centre, v), atol=1e-7)
    np.testing.assert_allclose(data["F"].to_numpy()[0, ends], [0.1, 0.3])


@pytest.mark.slow
def test_the_same_curves():
    """In units of the largest coordinate steps were a thousand times too long at 1000, and passed the cusp."""
    near, far = (
        session_at(centre).run(
            jaxnh.Curves(max_period=1, n_values=3), F=np.linspace(0.1, 0.3, 9), d=np.linspace(0.2, 0.3, 3)
        )
        for centre in (0.0, 1000.0)
    )
    assert sorted(jaxnh.labels(near["kind"]).values) == sorted(jaxnh.labels(far["kind"]).values)
    for name in "Fd":
        errors = near[f"codimension_two_{name}_error"].to_numpy() + far[f"codimension_two_{name}_error"].to_numpy()
        values = [each[f"codimension_two_{name}"].to_numpy() for each in (near, far)]
        assert values[0].shape == values[1].shape == (1,)
        assert np.all(np.abs(values[0] - values[1]) <= errors)
