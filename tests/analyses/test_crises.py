"""Crises and slow passages of a flow in three dimensions: the Lorenz system at σ = 10, β = 8/3, where both are known."""

from __future__ import annotations

import numpy as np
import pytest

from tests.flows.written_out import experiment
from tests.helpers.attractors import changes, kinds
from tests.helpers.kept_programs import session_of

RATES = "10.0 * (y_ - x), x * (rho - z) - y_, x * y_ - 8.0 / 3.0 * z"
CRISIS = 24.06
"""Chaos ends where it meets the unstable cycles around the foci (Kaplan, Yorke, Commun. Math. Phys. 67 (1979) 93)."""
HOPF = 470 / 19
"""The foci lose their stability at σ (σ + β + 3)/(σ − β − 1) (Lorenz, J. Atmos. Sci. 20 (1963) 130)."""
INTERMITTENCY = 166.06
"""A limit cycle ends in a fold, and chaos lingers by where it was (Manneville, Pomeau, Phys. Lett. A 75 (1979) 1)."""


def lorenz(folder, rho, longest):
    """Attractors over ρ from four starts each, by steps of 1/40: one program serves all tests."""
    sweep = {"rho": {"values": rho}, "x": {"values": [-12.0, -3.0, 4.0, 11.0]}}
    more = {"initial": {"y_": 1.0, "z": 20.0}, "accuracy": {"solver": "verner9", "steps": 40}}
    asked = experiment(folder, ("x", "y_", "z"), RATES, sweep, {"max_periods": longest}, "", "rho=28.0", **more)
    tree = session_of(asked).tree()
    return tree["attractors"].to_dataset(), tree["basins"].to_dataset()


@pytest.mark.slow
def test_crisis_of_chaos(tmp_path):
    """Below the crisis chaos is a passage to one of the foci, up to the Hopf point they are beside it, then it is alone.

    At 22 lanes change sides for up to 107 units of time, by DOP853. Exponents of the foci are real parts of the roots of
    λ³ + (σ + β + 1) λ² + β (σ + ρ) λ + 2σβ (ρ − 1).
    """
    rho = np.array([20.0, 22.0, 24.4, 25.2])
    attractors, basins = lorenz(tmp_path, rho.tolist(), 4096)
    assert [kinds(attractors.isel(rho=k)) for k in range(4)] == [
        ["equilibrium"] * 2,
        ["equilibrium"] * 2,
        ["chaotic", "equilibrium", "equilibrium"],
        ["chaotic"],
    ]
    assert np.all(basins["attractor"].values > 0)
    beta = 8 / 3
    for k, at in enumerate(rho[:3]):
        real = np.roots([1.0, 11.0 + beta, beta * (10.0 + at), 20.0 * beta * (at - 1)]).real.max()
        np.testing.assert_allclose(attractors["exponent"].values[k, 1:], real, atol=1e-8)
    found = changes(attractors, "rho")
    assert [one[:2] for one in found] == [("crisis", 1), ("death", 2), ("death", 3)]
    for (*_, at, error), truth in zip(found, (CRISIS, HOPF, HOPF), strict=True):
        assert abs(at - truth) <= error <= 1.2


@pytest.mark.slow
@pytest.mark.parametrize("rho", [166.0, 166.062, 166.1])
def test_the_ghost_of_a_cycle_in_chaos(tmp_path, rho):
    """Beyond the fold lanes go around as on the cycle many times, and burst: they are on a chaotic attractor.

    By DOP853 all maxima of z repeat every second time at 166.0, within 1e-8 from t = 50 on; at 166.062 99 in 100 do
    within 1 until 400, with four bursts between them, at 166.1 80 in 100.
    """
    attractors, basins = lorenz(tmp_path, [rho], 4096)
    assert kinds(attractors.isel(rho=0)) == ["limit_cycle" if rho < INTERMITTENCY else "chaotic"]
    assert np.all(basins["attractor"].values == 1)
    assert np.sign(attractors["exponent"].values[0, 0]) == (-1 if rho < INTERMITTENCY else 1)
