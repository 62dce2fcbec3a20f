"""Curves of homoclinic and heteroclinic orbits over two parameters, against closed forms and shooting by DOP853."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxnh.orbits.bifurcations.connection_points import POINTS, leading, special_connections
from jaxnh.orbits.collocation.connection_joins import is_on_curve, join_connections
from jaxnh.orbits.collocation.connection_meshes import refined
from jaxnh.orbits.collocation.connections import connection_near, follow_connections
from jaxnh.orbits.collocation.equations import BoundarySolution
from jaxnh.orbits.collocation.newton import remeshed
from jaxnh.orbits.collocation.paths import path_through
from jaxnh.orbits.continuation.paths import RANGE, StepControl
from jaxnh.systems.first_order import first_order
from tests.flows import connections
from tests.flows.lorenz import PARAMETERS, lorenz
from tests.helpers.cycle_problems import problem_of

pytestmark = pytest.mark.usefixtures("quick_compiling")

SHAPE = ("alpha", "beta", "gamma")


def guess_through(times, states, values, n=60):
    path, duration = path_through(times, states, n)
    return BoundarySolution(path, np.array([duration]), np.array([values], float))


def points_of(curve):
    return [point for stretch in curve.stretches for point in stretch.points]


def lorenz_curve():
    """The orbit at σ = 10 from a rough path, and its curve over (ρ, σ)."""
    problem = problem_of(
        first_order(lorenz, PARAMETERS, ("rho", "sigma")), ("rho", "sigma"), (8.0, 9.0, 9.0), (10.0, 5.0)
    )
    rate = 0.5 * (-11 + np.sqrt(121 + 40 * 12.9))
    rhs = lorenz(10.0, 13.9, 8 / 3)["rhs"]
    path = solve_ivp(lambda t, y: rhs(y, t), (0.0, 2.3), 1e-3 * np.array([10, 10 + rate, 0]), rtol=1e-8, atol=1e-10)
    guess = guess_through(path.t, path.y.T, (13.9, 10.0))
    begun = connection_near(problem, guess, np.zeros(3), np.zeros(3))
    low, high = np.array([10.0, 8.0]), np.array([20.0, 12.0])
    return problem, begun, follow_connections(problem, begun, low, high, StepControl(0.1, 100))


def lorenz_by_shooting(sigma, near):
    def side(rho):
        rhs = lorenz(sigma, rho, 8 / 3)["rhs"]
        return connections.side(rhs, [[-sigma, sigma, 0], [rho, -1, 0], [0, 0, -8 / 3]], 12.0)

    return connections.located(side, near - 1e-5, near + 1e-5, 22)


@pytest.mark.slow  # connections in closed form are quick
def test_lorenz_over_two_parameters():
    """ρ = 13.926557407520 at σ = 10, and the ends of the curve by bisection; the saddle's eigenvalues in closed form."""
    problem, begun, curve = lorenz_curve()
    assert begun.values[1] == 10.0
    finer, error, _ = refined(problem, begun)
    assert abs(finer.values[0] - connections.LORENZ) <= error.sum() < 1e-10  # the curve's slope is below one there
    assert curve.ends == (RANGE, RANGE)
    for orbit in (curve.stretches[0].points[0], curve.stretches[-1].points[-1]):
        finer, error, _ = refined(problem, orbit)
        rho, sigma = finer.values
        assert min(abs(sigma - 8.0), abs(sigma - 12.0)) < 1e-9
        assert abs(lorenz_by_shooting(sigma, rho) - rho) <= error[0] + 1e-11  # of the bisection
        root = np.sqrt((sigma - 1) ** 2 + 4 * sigma * rho)
        exact = np.sort([(-sigma - 1 - root) / 2, -8 / 3, (-sigma - 1 + root) / 2])[::-1]
        assert np.allclose(finer.departure.eigenvalues, exact, rtol=1e-9)
    assert not special_connections(curve)
    assert not any(leading(orbit.departure).shilnikov for orbit in points_of(curve))


@pytest.mark.slow  # fronts and flips in closed form are quick
def test_curves_that_were_cut_are_one():
    """Lorenz's curve from its middle and from either end of that; not one that ends in front of the other."""
    problem, begun, whole = lorenz_curve()
    low, high = np.array([10.0, 8.0]), np.array([20.0, 12.0])
    cut = follow_connections(problem, begun, low, high, StepControl(0.1, 4))
    for orbit in (points_of(cut)[0], points_of(cut)[-1]):
        other = follow_connections(problem, orbit, low, high, StepControl(0.1, 4))
        ends = np.sort([point.values[1] for curve in (cut, other) for point in points_of(curve)])[[0, -1]]
        for pair in ((cut, other), (other, cut)):
            joined = join_connections(problem, *pair)
            sigma = np.array([point.values[1] for point in points_of(joined)])
            assert np.array_equal(np.sort(sigma[[0, -1]]), ends)
            # Meshes resolve parameters to 1e-8 of the widths, of which ρ's is ten.
            assert np.all(np.diff(sigma) * np.sign(sigma[-1] - sigma[0]) > -2e-7)
            for stretch in joined.stretches:  # between points the orbits are those of the curve
                middle = stretch.between(0, 0.5)
                first, second = (point.values[1] for point in stretch.points[:2])
                assert min(first, second) - 2e-7 < middle.values[1] < max(first, second) + 2e-7
                assert is_on_curve(problem, whole, middle)
    assert join_connections(problem, cut, whole) is whole
    assert join_connections(problem, whole, cut) is whole
    far = follow_connections(problem, points_of(whole)[0], low, high, StepControl(0.1, 3))
    assert join_connections(problem, cut, far) is None


def test_the_pulse_beside_the_hamiltonian_one():
    """a = −6/7 b at first order, odd in b, and the neutral saddle at (0, 0), where the pulse is in closed form."""
    problem = problem_of(
        first_order(connections.pulse, {"a": 0.0, "b": 0.5}, ("a", "b")), ("a", "b"), (1.5, 0.6), (2.0, 1.0)
    )
    times = np.linspace(-9.0, 9.0, 200)
    begun = connection_near(problem, _pulse(times), np.zeros(2), np.zeros(2))
    curve = follow_connections(problem, begun, np.array([-1.0, -0.5]), np.array([1.0, 0.5]), StepControl(0.1, 100))
    path = begun.solution.path
    cut = path._replace(ends=path.ends[:, path.ends[0, :, 0] > 0.05])  # as one that is cut further from the saddle
    assert cut.ends.shape[1] < path.ends.shape[1]
    assert is_on_curve(problem, curve, begun._replace(solution=begun.solution._replace(path=cut)))
    a, b = np.array([point.values for point in points_of(curve)]).T
    slopes = (a + 6 / 7 * b)[np.abs(b) > 1e-6] / b[np.abs(b) > 1e-6] ** 3
    assert np.ptp(slopes) < 0.1 * np.abs(slopes).max()  # one coefficient of b³, but for the next order
    assert abs(a[0] + a[-1]) < 1e-9
    [(_, special)] = special_connections(curve)
    assert POINTS[special.kind] == "neutral_saddle"
    assert np.all(np.abs(special.values) <= special.error)
    assert special.error.max() < 1e-9
    path = special.point.solution.path
    energy = path.ends[0, :, 1] ** 2 / 2 - path.ends[0, :, 0] ** 2 / 2 + path.ends[0, :, 0] ** 3 / 3
    assert np.abs(energy).max() < 1e-9
    assert path.ends[0, :, 0].max() == pytest.approx(1.5, abs=1e-2)  # of the mesh


def test_an_orbit_on_any_mesh_is_on_its_curve():
    """Next to a point of the curve or in the middle, on meshes that show its top to half a hundredth; not one beside."""
    problem = problem_of(
        first_order(connections.pulse, {"a": 0.0, "b": 0.5}, ("a", "b")), ("a", "b"), (0.75, 0.6), (0.4, 0.2)
    )
    begun = connection_near(problem, _pulse(np.linspace(-9.0, 9.0, 200)), np.zeros(2), np.zeros(2))
    curve = follow_connections(problem, begun, np.array([-1.0, 0.4]), np.array([1.0, 0.6]), StepControl(0.05, 100))
    stretch = max(curve.stretches, key=lambda each: len(each.points))
    for share in (0.01, 0.5, 0.99):
        orbit = stretch.between(len(stretch.points) // 2, share)
        tops = list[float]()
        for n in range(20, 60, 5):
            other = orbit._replace(solution=remeshed(problem, orbit.solution, n, cyclic=False))
            assert is_on_curve(problem, curve, other)
            tops.append(other.solution.path.ends[0, :, 0].max())
        assert np.ptp(tops) > 0.005 * problem.size[0]
        aside = orbit.solution._replace(values=orbit.values[None] + [[0.02 * problem.widths[0], 0.0]])
        assert not is_on_curve(problem, curve, orbit._replace(solution=aside))


def _pulse(times):
    """The Hamiltonian pulse at some times, as a guess."""
    x = 1.5 / np.cosh(times / 2) ** 2
    return guess_through(times, np.stack([x, -x * np.tanh(times / 2)], axis=1), (-0.4, 0.5))


def test_fronts_in_closed_form():
    """Heteroclinic: c = (1 − 2a)/√2 all along the curve, within the errors."""
    problem = problem_of(
        first_order(connections.nagumo, {"c": 0.3, "a": 0.3}, ("c", "a")), ("c", "a"), (0.5, 0.1), (1.0, 0.4)
    )
    times = np.linspace(-14.0, 14.0, 200)
    u = 1 / (1 + np.exp(-times / np.sqrt(2)))
    guess = guess_through(times, np.stack([u, u * (1 - u) / np.sqrt(2)], axis=1), (0.3, 0.3))
    begun = connection_near(problem, guess, np.zeros(2), np.array([1.0, 0.0]))
    curve = follow_connections(problem, begun, np.array([0.0, 0.1]), np.array([1.0, 0.5]), StepControl(0.1, 100))
    assert curve.ends == (RANGE, RANGE)
    for orbit in points_of(curve):
        finer, error, _ = refined(problem, orbit)
        c, a = finer.values
        assert abs(c - (1 - 2 * a) / np.sqrt(2)) <= error.sum()
        assert error.max() < 1e-8


@pytest.mark.parametrize("sign", [1.0, pytest.param(-1.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("name", "drive", "exact"), [("orbit_flip", 1.0, 1.0), ("inclination_flip", 0.0, 2.0)])
def test_flips_in_closed_form(name, drive, exact, sign):
    """The one flip along the line a = 0, within its error; where a share is zero all along there is none."""

    def define(a, q, kappa=0.4):
        return connections.flips(a, q, kappa, drive, 1.0 - drive, sign)

    problem = problem_of(first_order(define, {"a": 0.0, "q": 1.0}, ("a", "q")), ("a", "q"), (1.5, 0.6, 3.0), (1.0, 2.0))
    times = np.linspace(-12.0, 12.0, 200)
    x = 1.5 / np.cosh(times / 2) ** 2
    states = np.stack([x, -sign * x * np.tanh(times / 2), 0 * x], axis=1)
    begun = connection_near(problem, guess_through(times, states, (0.05, 1.5)), np.zeros(3), np.zeros(3))
    curve = follow_connections(problem, begun, np.array([-0.5, 0.5]), np.array([0.5, 3.0]), StepControl(0.1, 40))
    assert curve.ends == (RANGE, RANGE)
    [(_, point)] = special_connections(curve)
    assert POINTS[point.kind] == f"{name}_{'stable' if sign > 0 else 'unstable'}"
    assert np.all(np.abs(point.values - [0.0, exact / (1 - 0.4**2)]) <= point.error)
    assert point.error.max() < 1e-6


@pytest.mark.slow  # fronts and flips in closed form are quick
@pytest.mark.parametrize("count", [1, 12])
def test_errors_cover_closed_forms(count):
    """Of Sandstede's loops at random parameters, and of their neutral saddles; and none is hundreds of times too large."""
    rng, rows, special = np.random.default_rng(5), [], []
    flow = first_order(connections.sandstede, connections.SANDSTEDE)
    for _ in range(count):
        b = rng.uniform(0.6, 1.5)
        own = {"b": b, "c": -b * rng.uniform(0.4, 1.8)} | dict(zip(SHAPE, rng.uniform(-1.0, 1.0, 3), strict=True))
        problem = problem_of(flow, ("mt", "a"), (0.5, 0.4, 0.4), (1.0, b), own)
        times = np.linspace(-12.0 / b, 12.0 / b, 200)
        x = 1.0 / np.cosh(b * times / 2) ** 2
        guess = guess_through(times, np.stack([x, -x * np.tanh(b * times / 2), 0 * x], axis=1), (0.02, 0.1 * b))
        begun = connection_near(problem, guess, np.zeros(3), np.zeros(3))
        low, high = np.array([-0.5, -0.6 * b]), np.array([0.5, 0.6 * b])
        curve = follow_connections(problem, begun, low, high, StepControl(0.2, 40))
        finer = [refined(problem, point) for point in points_of(curve)]
        rows += [(abs(one.orbit.values[0]), one.error[0]) for one in finer]
        [(_, point)] = special_connections(curve)
        assert POINTS[point.kind] == "neutral_saddle"
        exact = 0.0 if own["c"] < -b else -b - own["c"]
        special += [*zip(np.abs(point.values - [0.0, exact]), point.error, strict=True)]
    for misses, errors in (np.array(rows).T, np.array(special).T):
        assert np.mean(misses <= errors) >= 0.95
        assert np.median(errors) < 100.0 * np.quantile(misses, 0.95)


def test_what_is_near_no_orbit():
    """No orbit from a path that is none, and none between saddles of unlike numbers of unstable directions."""
    problem = problem_of(
        first_order(connections.arneodo, {"a": 0.6, "b": 0.7}, ("a", "b")), ("a", "b"), (1.0, 1.0, 1.0)
    )
    times = np.linspace(0.0, 1.0, 20)
    guess = guess_through(times, np.stack([np.sin(times), times, times**2], axis=1), (0.6, 0.7))
    assert connection_near(problem, guess, np.zeros(3), np.array([1.0, 0.0, 0.0])) is None
