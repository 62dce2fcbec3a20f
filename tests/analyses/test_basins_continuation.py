"""Attractors over parameters: numbers that stay, births and deaths against closed forms and scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

from tests.flows.written_out import experiment, line
from tests.helpers.attractors import changes, kinds
from tests.helpers.cases import some_slow
from tests.helpers.kept_programs import session_of

FOLD = 2 / (3 * np.sqrt(3))


def attractors_of(folder, coordinates, rates, sweep, options=None, rest="", parameters=""):
    tree = session_of(experiment(folder, coordinates, rates, sweep, options, rest, parameters)).tree()
    return tree["attractors"].to_dataset(), tree["basins"].to_dataset()


@pytest.mark.parametrize("starts", [[-2.0, 2.0], [1.0, 2.0]])
def test_folds(tmp_path, starts):
    """x' = μ + x − x³: of two rest points one is born at −2/(3√3), the other dies at 2/(3√3).

    Where no start leads to the lower one it is there all the same, with a share of zero, until it ends.
    """
    mu = [-0.9, -0.6, -0.45, -0.3, -0.2, 0.1, 0.3, 0.36, 0.45, 0.8]
    sweep = {"mu": {"values": mu}, "x": {"values": starts}}
    attractors, basins = attractors_of(tmp_path, ("x",), "mu + x - x**3,", sweep, parameters="mu=0.0")
    roots = [sorted(r.real for r in np.roots([-1, 0, 1, m]) if abs(r.imag) < 1e-9) for m in mu]
    low = np.array([r[0] if m < FOLD else np.nan for m, r in zip(mu, roots, strict=True)])
    high = np.array([r[-1] if m > -FOLD else np.nan for m, r in zip(mu, roots, strict=True)])
    of_low, of_high = (1, 0) if basins["attractor"].values[-1, -1] == 1 else (0, 1)
    np.testing.assert_allclose(attractors["x"].values[:, of_low], low, atol=1e-9)
    np.testing.assert_allclose(attractors["x"].values[:, of_high], high, atol=1e-9)
    np.testing.assert_allclose(attractors["exponent"].values[:, of_low], 1 - 3 * low**2, atol=1e-8)
    shares = [[np.mean(row == k) for k in (1, 2)] for row in basins["attractor"].values]
    np.testing.assert_array_equal(attractors["fraction"].values, shares)
    [(born, first, at, error), (dies, second, end, bar)] = changes(attractors, "mu")
    assert (born, first, dies, second) == ("birth", of_high + 1, "death", of_low + 1)
    assert (at, error) == (pytest.approx(-0.375), pytest.approx(0.075))
    assert (end, bar) == (pytest.approx(0.405), pytest.approx(0.045))
    assert abs(at + FOLD) <= error
    assert abs(end - FOLD) <= bar


def test_rest_points_that_are_there_along_the_whole_axis(tmp_path):
    """The same between the folds, from x = 0: that leads to the lower one below μ = 0, to the upper one above."""
    mu = [-0.3, -0.1, 0.1, 0.3]
    sweep = {"mu": {"values": mu}, "x": {"values": [0.0]}}
    attractors, _ = attractors_of(tmp_path, ("x",), "mu + x - x**3,", sweep, parameters="mu=0.0")
    roots = np.array([sorted(np.roots([-1, 0, 1, m]).real) for m in mu])
    np.testing.assert_allclose(np.sort(attractors["x"].values, axis=1), roots[:, [0, 2]], atol=1e-9)
    assert sorted(attractors["fraction"].values.T.tolist()) == [[0, 0, 1, 1], [1, 1, 0, 0]]
    assert attractors.sizes["change"] == 0


@pytest.mark.parametrize(
    "mu", some_slow({"up": np.linspace(-0.5, 0.5, 6), "mixed": np.array([0.3, -0.5, 0.5, -0.3, -0.1, 0.1])}, "mixed")
)
def test_pitchfork(tmp_path, mu):
    """x' = μ x − x³: the middle one gives way to twins, none of which is it, whichever way the axis goes."""
    sweep = {"mu": {"values": mu.tolist()}, "x": {"values": [-1.0, 0.5, 1.5]}}
    attractors, _ = attractors_of(tmp_path, ("x",), "mu * x - x**3,", sweep, parameters="mu=0.0")
    x = attractors["x"].values
    assert x.shape == (6, 3)
    assert np.array_equal(np.isfinite(x), np.array([mu < 0, mu > 0, mu > 0]).T)
    up = mu > 0
    np.testing.assert_allclose(x[up][:, 1:], np.sqrt(mu[up])[:, None] * [1, -1], atol=1e-8)
    expected = [("birth", 2), ("birth", 3), ("death", 1)]
    assert [one[:2] for one in changes(attractors, "mu")] == expected
    for *_, at, error in changes(attractors, "mu"):
        assert (at, error) == (pytest.approx(0.0, abs=1e-15), pytest.approx(0.1))


@pytest.mark.slow
def test_hopf(tmp_path):
    """x'' = (μ − x²) x' − x: the cycle is what the rest point becomes at μ = 0."""
    sweep = {"mu": {"values": [-0.3, -0.15, 0.15, 0.3]}, "x": {"values": [0.5, 2.0]}, "v": {"values": [0.0]}}
    attractors, _ = attractors_of(tmp_path, ("x", "v"), "v, (mu - x**2) * v - x", sweep, parameters="mu=0.0")
    assert kinds(attractors.isel(attractor=0)) == ["equilibrium"] * 2 + ["limit_cycle"] * 2
    assert attractors.sizes["change"] == 0


@pytest.mark.slow
def test_driven_folds(tmp_path):
    """x'' + 0.2 x' + x + x³ = F cos 1.5 t: a small and a large answer, which ends and begins at folds.

    Folds by scipy: x, v and F at which P(x, v) = (x, v) and det(∂P − 1) = 0, from the folds of one harmonic.
    """
    omega = 1.5
    drives = np.linspace(0.3, 0.75, 10)
    sweep = {"drive": {"values": drives.tolist()}, "x": line(-2.0, 2.0, 4), "v": line(-2.0, 2.0, 4)}
    rates = f"v, drive * jnp.cos({omega} * t) - 0.2 * v - x - x**3"
    attractors, _ = attractors_of(
        tmp_path, ("x", "v"), rates, sweep, rest=f'"period": 2 * jnp.pi / {omega}', parameters="drive=0.5"
    )

    def strobe(y, drive):
        def rate(t, z):
            x, v, *m = z
            m = np.reshape(m, (2, 2))
            turn = np.array([[0.0, 1.0], [-1.0 - 3 * x * x, -0.2]])
            return [v, drive * np.cos(omega * t) - 0.2 * v - x - x**3, *(turn @ m).ravel()]

        found = solve_ivp(rate, (0, 2 * np.pi / omega), [*y, 1.0, 0.0, 0.0, 1.0], "DOP853", rtol=1e-11, atol=1e-12)
        return found.y[:2, -1], found.y[2:, -1].reshape(2, 2)

    def fold(unknown):
        image, matrix = strobe(unknown[:2], unknown[2])
        return [*(image - unknown[:2]), np.linalg.det(matrix - np.eye(2))]

    folds = []
    for square in np.roots([1.6875, -3.75, 1.6525]):
        lag = np.arctan2(0.2 * omega, 1 - omega**2 + 0.75 * square)
        drive = np.hypot(1 - omega**2 + 0.75 * square, 0.2 * omega) * np.sqrt(square)
        guess = [np.sqrt(square) * np.cos(lag), np.sqrt(square) * omega * np.sin(lag), drive]
        folds.append(fsolve(fold, guess, xtol=1e-10)[2])
    low, high = sorted(folds)
    assert 0.3 < low < 0.45 < 0.6 < high < 0.75
    found = changes(attractors, "drive")
    assert [one[0] for one in found] == ["birth", "death"]
    (_, large, at, error), (_, small, end, bar) = found
    assert {large, small} == {1, 2}
    assert abs(at - low) <= error == pytest.approx(0.025)
    assert abs(end - high) <= bar == pytest.approx(0.025)
    for number, there in ((large, drives > low), (small, drives < high)):
        assert np.array_equal(attractors["period"].values[:, number - 1] == 1, there)
        u = np.column_stack([attractors[name].values[there, number - 1] for name in ("x", "v")])
        for point, drive in zip(u[::3], drives[there][::3], strict=True):
            assert np.abs(strobe(point, drive)[0] - point).max() < 1e-7
