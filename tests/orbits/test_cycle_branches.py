"""Branches of cycles by collocation, their bifurcations and homoclinic ends, against series, heyoka and scipy."""

from __future__ import annotations

import functools

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxnh.exceptions import InputError
from jaxnh.orbits.collocation.bifurcations import bifurcations, doubled_cycle
from jaxnh.orbits.collocation.cycle_equations import point_at, reversed_way
from jaxnh.orbits.collocation.cycles import closure
from jaxnh.orbits.collocation.cycles import hold_parameters as hold
from jaxnh.orbits.collocation.equations import BoundarySolution
from jaxnh.orbits.collocation.following import follow_cycles
from jaxnh.orbits.collocation.homoclinic import saddle_at
from jaxnh.orbits.collocation.newton import correct
from jaxnh.orbits.collocation.paths import path_through, values_at
from jaxnh.orbits.continuation.kinds import DOUBLING
from jaxnh.orbits.continuation.paths import COLLAPSED, INFINITE_PERIOD, MOST_POINTS, RANGE, StepControl
from jaxnh.systems.first_order import first_order
from tests.flows.hopf_normal_form import OMEGA, hopf
from tests.flows.lorenz import PARAMETERS, lorenz
from tests.flows.roessler import doubling_of_roessler
from tests.helpers.cases import some_slow
from tests.helpers.cycle_problems import first_cycle, problem_of
from tests.helpers.homoclinic_orbit import homoclinic_orbit

EPSILON = 0.01
CANARD = 1 - EPSILON / 8 - 3 * EPSILON**2 / 32 - 173 * EPSILON**3 / 1024
"""Where van der Pol's canards are: Zvonkin and Shubin, Russian Math. Surveys 39 (1984) 69; the next term is O(ε⁴)."""


def slow_fast(a=0.95):
    def rhs(y, t):
        x, slow = y
        return (slow - x * x * x / 3 + x) / EPSILON, a - x

    return {"rhs": rhs, "coordinates": ("x", "slow")}


def roessler(c=2.5):
    def rhs(y, t):
        x, v, z = y
        return -v - z, x + 0.2 * v, 0.2 + z * (x - c)

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}


def canards(n, points):
    """The branch from a small cycle on through the explosion."""
    problem = problem_of(first_order(slow_fast, {"a": 0.95}, ("a",)), ("a",), (4.0, 1.3), (0.1,))
    guess = first_cycle(slow_fast(0.9992)["rhs"], (0.99, -0.66), 0.9992, n, level=0.9992)
    cycle = correct(problem, guess, closure(problem, np.zeros((1, 2))), hold)
    begun = reversed_way(point_at(problem, cycle.solution, np.zeros(2), None))
    return follow_cycles(problem, begun, np.zeros(2), (0.95, 1.01), StepControl(0.05, points))


def canard_logarithm(parameter, top):
    """The logarithm of a canard's multiplier, the integral of the divergence by DOP853 from its highest state on.

    From (a, top), where the slow coordinate turns, the cycle goes along the attracting slow manifold to where it turns
    again; back in time it goes there along the repelling one, which then attracts. Neither piece keeps its errors.
    """

    def rates(t, y):
        return *slow_fast(parameter)["rhs"](y[:2], t), (1.0 - y[0] ** 2) / EPSILON

    pieces = []
    for side in (1.0, -1.0):

        def turns(t, y, side=side):
            return side if abs(t) < 0.1 else y[0] - parameter

        turns.terminal = True
        start = [parameter, top, 0.0]
        path = solve_ivp(rates, (0.0, 8.0 * side), start, "DOP853", rtol=1e-12, atol=1e-12, events=turns)
        pieces.append(path.y_events[0][0])
    (_, low, ahead), (_, same, back) = pieces
    assert abs(low - same) < 1e-8  # as near as the parameter is to the canard's
    return ahead - back


@pytest.mark.slow  # branches by collocation are quick
def test_canards_grow_at_one_value_of_the_parameter():
    """Up to half of the largest amplitude, at the series' value; all of them attract, by DOP853 in two pieces."""
    branch = canards(120, 80)
    assert branch.ends[1] == MOST_POINTS
    heights = np.array([np.ptp(point.solution.path.ends[0, :, 0]) for point in branch.points])
    middle = (heights > 0.8) & (heights < 3.0)
    assert heights.max() > 2.0
    next_term = 1e-8  # ε⁴
    assert np.abs(branch.value[middle] - CANARD).max() < next_term
    assert all(0.0 < point.multipliers[0].real < 1.0 for point in branch.points)
    for k in np.flatnonzero(middle):
        point = branch.points[k]
        top = values_at(point.solution.path, np.linspace(0.0, 1.0, 20_001)[None])[0, :, 1].max()
        gap = abs(np.log(point.multipliers[0].real) - canard_logarithm(point.value, top))
        assert gap < 1e-3  # 10⁻⁶ of the highest state
        assert point.errors[0] < 1e-3 * point.multipliers[0].real


@pytest.mark.slow
def test_canards_are_passed():
    """To relaxation oscillations, which attract, at the end of the range."""
    branch = canards(120, 400)
    assert branch.ends[1] == RANGE
    last = branch.points[-1]
    assert last.value == 0.95

    def rates(t, y):
        return slow_fast(0.95)["rhs"](y, t)

    def passes(t, y):
        return y[0]

    passes.direction = 1
    path = solve_ivp(rates, (0.0, 8.0), [2.0, 0.0], "DOP853", rtol=1e-13, atol=1e-13, events=passes)
    [duration] = np.diff(path.t_events[0])
    assert abs(last.solution.duration[0] - duration) < 1e-11  # of DOP853, on an orbit that attracts by 1e-20 a turn
    assert abs(last.multipliers[0]) < 1e-20


def test_branch_is_born_in_a_hopf_bifurcation():
    """Radius √μ and duration 2π/ω along the branch of the normal form, down to where the cycle is an equilibrium."""
    problem = problem_of(first_order(hopf, {"mu": 0.1}, ("mu",)), ("mu",), (0.5, 0.5))
    times = np.linspace(0.0, np.pi, 40)
    path, _ = path_through(times, 0.3 * np.stack([np.cos(2 * times), np.sin(2 * times)], axis=1), 10)
    guess = BoundarySolution(path, np.array([np.pi]), np.array([[0.1]]))
    cycle = correct(problem, guess, closure(problem, np.zeros((1, 2))), hold)
    begun = point_at(problem, cycle.solution, np.zeros(2), None)
    for way, end in ((begun, RANGE), (reversed_way(begun), COLLAPSED)):
        branch = follow_cycles(problem, way, np.zeros(2), (-0.5, 0.5), StepControl(0.05, 200))
        assert branch.ends[1] == end
        for point in branch.points:
            radius = np.linalg.norm(point.solution.path.ends[0], axis=1)
            assert np.abs(radius**2 - point.value).max() < 1e-7  # of ten intervals, 10⁻⁸
            assert abs(point.solution.duration[0] - 2 * np.pi / OMEGA) < 1e-7


def undamped(force=0.1):
    def rhs(y, t):
        x, v = y
        return v, force * jnp.cos(2.8 * t) - x - x * x * x

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * np.pi / 2.8}


def test_what_preserves_area_has_no_torus_bifurcation_of_rounding():
    """Where μ_1 μ_2 = 1 all along the branch, the signs of 1 − μ_1 μ_2 are rounding's and tell nothing."""
    problem = problem_of(first_order(undamped, {"force": 0.1}, ("force",)), ("force",), (0.1, 0.3))
    times = np.linspace(0.0, 2 * np.pi / 2.8, 40)
    orbit = 0.1 / (1 - 2.8**2) * np.stack([np.cos(2.8 * times), -2.8 * np.sin(2.8 * times)], axis=1)
    path, duration = path_through(times, orbit, 20)
    guess = BoundarySolution(path, np.array([duration]), np.array([[0.1]]))
    cycle = correct(problem, guess, closure(problem, np.zeros((1, 2))), hold)
    branch = follow_cycles(
        problem, point_at(problem, cycle.solution, np.zeros(2), None), np.zeros(2), (0.0, 1.0), StepControl(0.05, 200)
    )
    assert branch.ends[1] == RANGE
    products = np.array([np.prod(point.multipliers) for point in branch.points])
    assert 0.0 < np.abs(products - 1.0).max() < 1e-12
    assert bifurcations(problem, branch, np.zeros(2)) == ([], [])


def imperfect(break_):
    """A circle of radius one, and z′ = μz − z³ + ε around it: cycles are at μ = z² − ε/z, a curve for either sign of z."""

    def system(mu=0.4):
        def rhs(state, t):
            x, y, z = state
            growth = 1.0 - x * x - y * y
            return growth * x - y, growth * y + x, mu * z - z * z * z + break_

        return {"rhs": rhs, "coordinates": ("x", "y", "z")}

    return system


@pytest.mark.parametrize("break_", some_slow({"1e-4": 1e-4, "1e-6": 1e-6, "1e-8": 1e-8}, "1e-8"))
def test_branch_of_cycles_stays_on_its_side_of_an_imperfect_pitchfork(break_):
    """From μ = 0.4 down, on either side of z = 0: one curve goes on to small z, the other turns, ε^(1/3) apart."""
    problem = problem_of(first_order(imperfect(break_), {"mu": 0.4}, ("mu",)), ("mu",), (1.0, 1.0, 1.0), (1.0,))
    times = np.linspace(0.0, 2 * np.pi, 40)
    for z in (np.sqrt(0.4), -np.sqrt(0.4)):
        states = np.stack([np.cos(times), np.sin(times), np.full(40, z)], axis=1)
        path, duration = path_through(times, states, 10)
        guess = BoundarySolution(path, np.array([duration]), np.array([[0.4]]))
        cycle = correct(problem, guess, closure(problem, np.zeros((1, 3))), hold)
        begun = reversed_way(point_at(problem, cycle.solution, np.zeros(3), None))
        branch = follow_cycles(problem, begun, np.zeros(3), (-0.5, 0.5), StepControl(0.05, 400))
        assert branch.ends[1] == RANGE
        heights = np.array([point.solution.path.ends[0, 0, 2] for point in branch.points])
        assert np.all(np.sign(heights) == np.sign(z))
        assert branch.value[-1] == pytest.approx(-0.5 if z > 0 else 0.5)
        slope = np.abs(2 * heights + break_ / heights**2)
        off = np.abs(branch.value - (heights**2 - break_ / heights))
        assert np.all(off < 1e-10 * (1 + slope))  # the square of Newton's last step, which the slope in z enlarges


@functools.cache
def roessler_branch():
    problem = problem_of(first_order(roessler, {"c": 2.5}, ("c",)), ("c",), (5.0, 5.0, 3.0), (3.0,))
    guess = first_cycle(roessler()["rhs"], (1.0, 1.0, 0.0), 2.5, 40)
    cycle = correct(problem, guess, closure(problem, np.zeros((1, 3))), hold)
    begun = point_at(problem, cycle.solution, np.zeros(3), None)
    return problem, follow_cycles(problem, begun, np.zeros(3), (2.3, 4.0), StepControl(0.05, 300))


def test_predictions_of_high_order_leave_two_evaluations_a_point():
    """By orbits that are not shifted against each other: where they are, extrapolation enlarges the shifts."""
    problem, branch = roessler_branch()
    count = 0

    def field(*at):
        nonlocal count
        count += 1
        return problem.field(*at)

    again = follow_cycles(
        problem._replace(field=field), branch.points[0], np.zeros(3), (2.3, 4.0), StepControl(0.05, 300)
    )
    assert again.ends == branch.ends
    # Two for Newton, one for the multipliers of each point; one more where steps begin, grow, or a mesh is adapted.
    assert count <= 4 * len(again.points)


def test_doublings_of_roessler():
    """Two doublings in turn, the second on the branch of doubled cycles, within their errors of heyoka's."""
    problem, branch = roessler_branch()
    lift, ends = np.zeros(3), (2.3, 4.0)
    for n in (1, 2):
        located, lost = bifurcations(problem, branch, lift)
        assert not lost
        assert [point.kind for point in located] == [DOUBLING]
        point = located[0]
        exact = float(doubling_of_roessler(point.point.value, n))
        assert abs(point.point.value - exact) <= point.error < 1e-8
        doubled = doubled_cycle(problem, point.point, lift)
        assert doubled is not None
        assert abs(doubled.solution.duration[0] / point.point.solution.duration[0] - 2.0) < 1e-2
        branch = follow_cycles(problem, doubled, lift, ends, StepControl(0.05, 300))
        assert branch.ends[1] == RANGE


# ---- homoclinic orbits


def lorenz_branch(points):
    """Cycles of Lorenz's flow from near the Hopf bifurcation down, towards the homoclinic orbit."""
    problem = problem_of(first_order(lorenz, PARAMETERS, ("rho",)), ("rho",), (8.0, 9.0, 9.0), (10.0,))
    rho = 24.0
    away = np.sqrt(8 / 3 * (rho - 1))
    jacobian = np.array([[-10, 10, 0], [1, -1, -away], [away, away, -8 / 3]])
    values, vectors = np.linalg.eig(jacobian)
    turn, vector = values[np.argmax(values.imag)].imag, vectors[:, np.argmax(values.imag)]
    times = np.linspace(0.0, 2 * np.pi / turn, 60)
    states = [away, away, rho - 1] + 3.6 * np.real(np.exp(1j * turn * times)[:, None] * vector / abs(vector[0]))
    path, duration = path_through(times, states, 40)
    guess = BoundarySolution(path, np.array([duration]), np.array([[rho]]))
    cycle = correct(problem, guess, closure(problem, np.zeros((1, 3))), hold)
    begun = reversed_way(point_at(problem, cycle.solution, np.zeros(3), None))
    return problem, follow_cycles(problem, begun, np.zeros(3), (13.0, 25.0), StepControl(0.1, points))


def test_cycles_of_lorenz_end_at_rest_in_the_origin():
    """At an infinite period; on the way the multiplier grows by the saddle's rates, and the product is Liouville's."""
    _, branch = lorenz_branch(200)
    assert branch.ends[1] == INFINITE_PERIOD
    last = [point for point in branch.points if point.solution.duration[0] > 5.0]
    durations = np.array([point.solution.duration[0] for point in last])
    known = np.array([point.multipliers for point in last])
    assert np.all(known[:, 0].real > 0.0)
    saddle = -5.5 + np.sqrt(30.25 + 10 * (branch.value[-1] - 1)) - 8 / 3
    slopes = np.diff(np.log(known[:, 0].real)) / np.diff(durations)
    assert np.abs(slopes[durations[1:] > 7.0] - saddle).max() < 1e-2
    exact = np.exp(-(11 + 8 / 3) * durations) / known[:, 0].real
    errors = np.array([point.errors for point in last])
    assert np.all(np.abs(known[:, 1] - exact) <= errors[:, 1] + errors[:, 0] / known[:, 0].real * exact)


def first_side(rho):
    """Whether the unstable manifold of Lorenz's origin goes to the other side on its first return, by DOP853."""
    rate = 0.5 * (-11 + np.sqrt(121 + 40 * (rho - 1)))
    start = 1e-6 * np.array([10.0, 10.0 + rate, 0.0])

    def field(t, y):
        return [10 * (y[1] - y[0]), y[0] * (rho - y[2]) - y[1], y[0] * y[1] - 8 / 3 * y[2]]

    def crosses(t, y):
        return y[0]

    def turns(t, y):
        return y[0] - y[1] if t > 3.0 else -1.0  # back on the way out again

    crosses.terminal, turns.terminal, turns.direction = True, True, -1
    path = solve_ivp(field, (0.0, 30.0), start, "DOP853", rtol=1e-13, atol=1e-16, events=[crosses, turns])
    return len(path.t_events[0]) > 0


@functools.cache
def homoclinic_of_lorenz():
    low, high = 13.9, 13.95
    for _ in range(34):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if first_side(middle) else (middle, high)
    return 0.5 * (low + high)


@pytest.mark.slow  # `test_connections` has it, and one in closed form is quick
def test_homoclinic_orbit_of_lorenz():
    """The value of rho by bisection of where the unstable manifold goes, with meshes and durations of several sizes."""
    problem, branch = lorenz_branch(56)
    long = branch.points[-1].solution
    assert long.duration[0] > 5.0
    saddle = saddle_at(problem, np.full(3, 0.1), np.array([14.0]))
    assert np.allclose(np.sort(saddle.eigenvalues.real), [-5.5 - np.sqrt(160.25), -8 / 3, -5.5 + np.sqrt(160.25)])
    exact = homoclinic_of_lorenz()
    for n in (40, 60, 120):
        orbit = homoclinic_orbit(problem, long, np.zeros(3), n)
        assert abs(orbit.solution.values[0, 0] - exact) <= orbit.error + 1e-9  # of the start, 10⁻⁶ along a line
    assert orbit.error < 1e-9


def pulse(loss=0.0):
    """x″ = x − x² + λ x′ has the pulse 3/2 sech²(t/2) at λ = 0 alone; it drives a focus that winds into the saddle."""

    def rhs(y, t):
        x, v, u, w = y
        return v, x - x * x + loss * v, -0.5 * u - 2.0 * w + x * v, 2.0 * u - 0.5 * w

    return {"rhs": rhs, "coordinates": ("x", "v", "u", "w")}


def test_homoclinic_orbit_to_a_saddle_focus():
    """The pulse in closed form at λ = 0, within the error, from a path that is the pulse itself and λ beside it."""
    problem = problem_of(first_order(pulse, {"loss": 0.0}, ("loss",)), ("loss",), (1.5, 0.6, 0.3, 0.3), (0.1,))
    times = np.linspace(-9.0, 9.0, 200)
    x = 1.5 / np.cosh(times / 2) ** 2
    states = np.stack([x, -x * np.tanh(times / 2), 0 * x, 0 * x], axis=1)
    path, duration = path_through(times, states, 60)
    orbit = homoclinic_orbit(problem, BoundarySolution(path, np.array([duration]), np.array([[0.01]])), np.zeros(4))
    assert np.allclose(np.sort_complex(orbit.saddle.eigenvalues), [-1.0, -0.5 - 2j, -0.5 + 2j, 1.0])
    assert abs(orbit.solution.values[0, 0]) <= orbit.error < 1e-6
    ends = orbit.solution.path.ends[0]
    energy = ends[:, 1] ** 2 / 2 - ends[:, 0] ** 2 / 2 + ends[:, 0] ** 3 / 3  # zero on the pulse
    assert np.abs(energy).max() < 1e-6


def test_what_is_no_saddle_is_said():
    with pytest.raises(InputError, match=r"no equilibrium near|is no saddle"):
        saddle_at(
            problem_of(first_order(hopf, {"mu": 0.1}, ("mu",)), ("mu",), (0.5, 0.5)), np.zeros(2), np.array([0.1])
        )
