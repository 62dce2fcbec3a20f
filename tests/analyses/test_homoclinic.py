"""Homoclinic and heteroclinic orbits through the whole package: fronts, pulses, saddle-foci, and what is refused."""

from __future__ import annotations

from unittest import mock

import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.continuation import homoclinic
from jaxnh.analyses.continuation.homoclinic import KINDS
from jaxnh.analyses.registry import ANALYSES
from jaxnh.exceptions import ConfigError
from jaxnh.orbits.bifurcations.connection_points import POINTS, TYPES
from tests.flows import connections
from tests.flows.lorenz import lorenz
from tests.helpers import connection_results
from tests.helpers.connection_results import experiment, points, result_of


def misses_at(values, errors, k, exact):
    """How far the first parameter is from its exact value beyond the errors: the second's counts by the curve's slope."""
    near = slice(max(k - 1, 0), k + 2)
    slope = np.abs(np.ptp(values[near, 0]) / np.ptp(values[near, 1]))
    return abs(values[k, 0] - exact) - errors[k, 0] - slope * errors[k, 1]


@pytest.mark.usefixtures("uncalibrated")
def test_fronts(tmp_path):
    """From saddles that Newton finds in the box and from nothing else: c = (1 − 2a)/√2, a front and the one back."""
    box = "{u: [-0.5, 1.5], v: [-0.2, 0.2]}"
    options = f"{{box: {box}, n_starts: 16, n_values: 1, duration: 40, ds_max: 0.1}}"
    sweep = "{c: {start: 0.1, stop: 0.7, count: 4}, a: {start: 0.1, stop: 0.4, count: 3}}"
    groups = result_of(tmp_path, connections.nagumo, "{u: 0.5, v: 0.1}", sweep, options)
    data = groups["homoclinic"].to_dataset()
    assert [KINDS[kind] for kind in data["kind"].values] == ["heteroclinic"]
    values, errors = points(data, 0, ("c", "a"))
    assert np.all(np.abs(values[:, 0] - (1 - 2 * values[:, 1]) / np.sqrt(2)) <= errors.sum(axis=1))
    assert errors.max() < 1e-8
    assert np.ptp(values[:, 1]) == pytest.approx(0.3)
    orbit = groups["connecting_orbits"].to_dataset().isel(curve=0, point=0)
    assert np.allclose(orbit["v_points"], orbit["u_points"] * (1 - orbit["u_points"]) / np.sqrt(2), atol=1e-6)
    assert data["u_departure"].values[0, 0] == pytest.approx(0.0, abs=1e-12)
    assert data["u_arrival"].values[0, 0] == pytest.approx(1.0)
    table = ANALYSES["homoclinic"].table(data, {}, "")
    assert table.rows[0][0] == "heteroclinic"
    jaxnh.figure(groups)


@pytest.mark.usefixtures("uncalibrated")
@pytest.mark.parametrize("solver", ["tsit5", "adaptive_tsit5"])
def test_a_loop_where_the_trace_vanishes(tmp_path, solver):
    """μ = 0.2 a²: eigenvectors change their signs there; one curve from both ends; paths on their way to infinity."""
    options = "{box: {x: [-0.3, 1.3], y: [-0.8, 0.8]}, n_starts: 16, n_values: 2, duration: 20, ds_max: 0.2}"
    sweep = "{mu: {start: 0.0, stop: 0.3, count: 4}, a: {values: [0.4, 1.2]}}"
    with mock.patch.object(connection_results, "STEPS", f"accuracy: {{solver: {solver}, steps: 20}}\n"):
        data = result_of(tmp_path, connections.level, "{x: 0.5, y: 0.0}", sweep, options)["homoclinic"].to_dataset()
    assert [KINDS[kind] for kind in data["kind"].values] == ["homoclinic"]
    values, errors = points(data, 0, ("mu", "a"))
    assert np.all(np.abs(values[:, 0] - 0.2 * values[:, 1] ** 2) <= errors @ [1.0, 0.5])  # the slope is below a half
    assert errors.max() < 1e-10
    assert sorted(values[[0, -1], 1]) == pytest.approx([0.4, 1.2])


@pytest.mark.slow
@pytest.mark.usefixtures("uncalibrated")
def test_a_saddle_focus(tmp_path):
    """Where Shilnikov's condition changes, b = (1 − 2a³)/a; the flag on both sides; orbits by shooting."""
    options = "{box: {x: [-0.5, 1.5], v: [-1, 1], w: [-1, 1]}, n_starts: 16, n_values: 1, duration: 40, ds_max: 0.1}"
    sweep = "{a: {start: 0.3, stop: 1.4, count: 12}, b: {values: [0.6, 0.7, 0.8]}}"
    data = result_of(tmp_path, connections.arneodo, "{x: 0.1, v: 0.1}", sweep, options)["homoclinic"].to_dataset()
    assert set(data["kind"].values) == {KINDS.index("homoclinic")}
    special = [POINTS[kind] for kind in data["codimension_two_kind"].values]
    assert special
    assert set(special) == {"neutral_saddle_focus"}
    a, b = (data[f"codimension_two_{name}"].values for name in "ab")
    errors = [data[f"codimension_two_{name}_error"].values for name in "ab"]
    assert np.all(np.abs(b - (1 - 2 * a**3) / a) <= errors[1] + 5.0 * errors[0])  # the slope of that line
    for curve in range(data.sizes["curve"]):
        values, errors = points(data, curve, ("a", "b"))
        one = data.isel(curve=curve, point=slice(len(values)))
        assert np.all(one["saddle_type"] == TYPES.index("saddle_focus"))
        index = values[:, 0] - one["eigenvalues"].values[:, 0, 0]  # −2 Re of the pair, less the real one's … the trace
        roots = np.array([np.roots([1, a, b, -1]) for a, b in values])
        largest = np.array([r[np.abs(r.imag) < 1e-12].real.max() for r in roots])
        assert np.allclose(one["eigenvalues"].values[:, 0, 0], largest, rtol=1e-8)
        assert np.array_equal(one["shilnikov"].values == 1, largest > values[:, 0])
        assert np.isfinite(index).all()
        for k in range(0, len(values), 8):
            a, b = values[k].tolist()

            def side(value, b=b):
                rhs = connections.arneodo(value, b)["rhs"]
                return connections.side(rhs, [[0, 1, 0], [0, 0, 1], [1, -b, -value]], 60.0)

            exact = connections.located(side, a - 1e-4, a + 1e-4, 36)
            # An error of b counts by the slope of the curve; the path begins 1e-7 beside the manifold, by its square.
            assert misses_at(values, errors, k, exact) <= 1e-12


FITZHUGH = "{box: {u: [-0.4, 1.1], v: [-0.3, 0.3], w: [-0.05, 0.15]}, n_starts: 8, n_values: 1, duration: 150, STEPS}"


@pytest.mark.slow  # fronts and a loop in the plane are quick
@pytest.mark.usefixtures("uncalibrated")
def test_a_pulse_of_fitzhugh_and_nagumo(tmp_path):
    """The fast pulse, which in its tail parts from its neighbours beyond the digits of c."""
    options = FITZHUGH.replace("STEPS", "ds_max: 0.1, max_steps: 2")
    sweep = "{c: {values: [0.5, 0.55]}, a: {values: [0.1, 0.15]}}"
    data = result_of(tmp_path, connections.fitzhugh, "{u: 0.1}", sweep, options)["homoclinic"].to_dataset()
    values, errors = points(data, 0, ("c", "a"))
    begun = np.argmin(np.abs(values[:, 1] - 0.1))
    slope = np.divide(*(values[-1] - values[begun]))  # of the curve, as an orbit is known across it and not at 0.1
    exact = connections.FITZHUGH + slope * (values[begun, 1] - 0.1)
    assert misses_at(values, errors, begun, exact) <= 1e-12  # of DOP853
    assert errors.max() < 1e-9


@pytest.mark.slow
@pytest.mark.usefixtures("uncalibrated")
def test_pulses_of_fitzhugh_and_nagumo(tmp_path):
    """The slow and the fast one at a = 0.1: the side of the first return changes within the error, by DOP853.

    Eigenvalues are those of a saddle-focus by Shilnikov: there are orbits of two pulses as well, 1e-9 beside, to which a
    bisection from further away may come.
    """
    options = FITZHUGH.replace("STEPS", "ds_max: 0.1, max_steps: 40")
    sweep = "{c: {start: 0.2, stop: 0.8, count: 7}, a: {values: [0.1, 0.15]}}"
    groups = result_of(tmp_path, connections.fitzhugh, "{u: 0.1}", sweep, options)
    data, u = groups["homoclinic"].to_dataset(), groups["connecting_orbits"]["u_points"].values
    assert np.all(data["shilnikov"].values[:, 0] == 1)
    begun = list[float]()
    for curve in range(data.sizes["curve"]):
        values, errors = points(data, curve, ("c", "a"))
        tops = (
            (u[curve, 0, 1:-1] > u[curve, 0, :-2]) & (u[curve, 0, 1:-1] > u[curve, 0, 2:]) & (u[curve, 0, 1:-1] > 0.2)
        )
        if tops.sum() > 1:
            continue
        k = int(np.argmin(np.abs(values[:, 1] - 0.1)))
        c, a = values[k].tolist()

        def side(value, a=a):
            jacobian = [[0, 1, 0], [a, value, 1], [0.005 / value, 0, 0]]
            return connections.side(connections.fitzhugh(value, a)["rhs"], jacobian, 150.0)

        covered = -misses_at(values, errors, k, c) + 1e-12  # of DOP853
        assert covered < 1e-10
        assert side(c - covered) != side(c + covered)
        begun.append(c)
    assert sorted(begun) == pytest.approx([0.29131122, connections.FITZHUGH], abs=1e-8)


def from_cycles_alone(*arguments):
    """The result where no manifold of a saddle is followed."""
    with mock.patch.object(homoclinic, "_seeds", return_value=[]):
        return result_of(*arguments)["homoclinic"].to_dataset()


@pytest.mark.slow  # fronts are quick
@pytest.mark.usefixtures("uncalibrated", "quick_compiling_once")
def test_a_planar_loop_from_its_cycles(tmp_path):
    """mt = 0 at every a, within the errors, from cycles that a Hopf bifurcation begins; the saddle quantity is 2a."""
    options = "{box: {x: [0.3, 1.0], y: [-0.3, 0.3]}, n_starts: 8, n_values: 1, cycles: 1, ds_max: 0.25}"
    sweep = "{mt: {start: -0.01, stop: 0.05, count: 4}, a: {values: [-0.3, -0.25]}}"
    section = "section: {coordinate: x, value: 0.66, direction: up, longest_return: 60}\n"
    data = from_cycles_alone(tmp_path, connections.loop, "{x: 0.6, y: 0.1}", sweep, options, section)
    assert [KINDS[kind] for kind in data["kind"].values] == ["homoclinic"]
    values, errors = points(data, 0, ("mt", "a"))
    assert np.all(np.abs(values[:, 0]) <= errors[:, 0])
    assert errors.max() < 1e-10
    assert sorted(values[[0, -1], 1]) == pytest.approx([-0.3, -0.25])
    assert np.allclose(data["saddle_quantity"].values[0], 2 * values[:, 1], atol=1e-10)


@pytest.mark.slow
@pytest.mark.usefixtures("uncalibrated")
def test_lorenz_from_cycles_of_large_period(tmp_path):
    """ρ = 13.926557407520 at σ = 10 from the cycles that the Hopf bifurcation near 24.7 begins; cut curves are one."""
    options = "{box: {x: [-15, 15], y: [-15, 15], z: [1, 30]}, n_starts: 16, n_values: 2, cycles: 1, STEPS}"
    options = options.replace("STEPS", "ds_max: 0.1, max_steps: 10")
    sweep = "{rho: {start: 13.0, stop: 26.0, count: 4}, sigma: {values: [10.0, 10.3]}}"
    section = "section: {normal: {x: 1.0, y: 1.0}, value: 14.0, direction: up}\n"
    data = from_cycles_alone(tmp_path, lorenz, "{x: 1.0, y: 1.0, z: 20.0}", sweep, options, section)
    assert [KINDS[kind] for kind in data["kind"].values] == ["homoclinic"]
    values, errors = points(data, 0, ("rho", "sigma"))
    assert np.ptp(values[:, 1]) == pytest.approx(0.3)
    k = int(np.argmin(np.abs(values[:, 1] - 10.0)))
    near = values[np.argsort(np.abs(values[:, 1] - 10.0))[:2]]
    slope = np.divide(*(near[1] - near[0]))
    exact = connections.LORENZ + slope * (values[k, 1] - 10.0)
    assert misses_at(values, errors, k, exact) <= 1e-12
    assert errors.max() < 1e-8


@pytest.mark.parametrize(
    ("sweep", "options", "message"),
    [
        (
            "{c: {start: 0.1, stop: 0.7, count: 4}}",
            "{box: {u: [0, 1]}}",
            "over two axes of more than one value, and the sweep has c",
        ),
        (
            "{c: {values: [0.1, 0.2]}, a: {values: [0.1]}}",
            "{box: {u: [0, 1]}}",
            "over two axes of more than one value, and the sweep has c",
        ),
        ("{c: {values: [0.1, 0.2]}, a: {values: [0.1, 0.2]}}", "{}", "needs a box"),
        (
            "{c: {values: [0.1, 0.2]}, a: {values: [0.1, 0.2]}}",
            "{box: {u: [0, 1]}, cycles: 1}",
            "on a section: give one",
        ),
        ("{c: {values: [0.1, 0.2]}, a: {values: [0.1, 0.2]}}", "{box: {q: [0, 1]}}", "no coordinate q"),
        ("{c: {values: [0.1, 0.2]}, a: {values: [0.1, 0.2]}}", "{box: {u: [1, 0]}}", "the lower one"),
    ],
)
def test_what_homoclinic_cannot_do_is_said(tmp_path, sweep, options, message):
    with pytest.raises(ConfigError, match=message):
        experiment(tmp_path, connections.nagumo, "{u: 0.5, v: 0.1}", sweep, options).requested()
