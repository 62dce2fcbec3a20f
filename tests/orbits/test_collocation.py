"""Cycles by collocation against closed forms, heyoka's Taylor integrator and published values."""

from __future__ import annotations

import heyoka as hy
import numpy as np
import pytest

from jaxnh.orbits.collocation.cycles import closure, solve_cycles
from jaxnh.orbits.collocation.cycles import hold_parameters as hold
from jaxnh.orbits.collocation.equations import BoundarySolution
from jaxnh.orbits.collocation.newton import correct
from jaxnh.orbits.collocation.paths import adapted_mesh, gauss_rule, on_mesh, path_through
from jaxnh.systems.first_order import first_order
from tests.flows.hopf_normal_form import OMEGA, hopf
from tests.flows.linear_oscillator import DAMPING, motion, oscillator
from tests.flows.linear_oscillator import OMEGA as DRIVE
from tests.flows.lorenz import lorenz
from tests.helpers.cycle_problems import first_cycle, problem_of

pytestmark = pytest.mark.usefixtures("quick_compiling")

LORENZ_SHORTEST = 1.558652210716  # Viswanath, Nonlinearity 16 (2003) 1035, at rho = 28
RELAXATION = {
    100.0: 162.83707109237,
    1000.0: 1614.40112581,
}  # van der Pol's periods, as the literature of stiff solvers has them


def van_der_pol(mu=1.0, sign=1.0):
    def rhs(y, t):
        x, v = y
        return sign * v, sign * (mu * (1 - x * x) * v - x)

    return {"rhs": rhs, "coordinates": ("x", "v")}


def circle(n, radius, duration, values):
    """A path once around zero, turning to the left."""
    times = np.linspace(0.0, duration, 40)
    angle = 2 * np.pi * times / duration
    path, _ = path_through(times, radius * np.stack([np.cos(angle), np.sin(angle)], axis=1), n)
    return BoundarySolution(path, np.array([duration]), np.array([[values]], float))


def joined(*solutions):
    """Solutions side by side."""
    paths = [np.concatenate(leaves) for leaves in zip(*(s.path for s in solutions), strict=True)]
    first = solutions[0]
    return BoundarySolution(
        first.path._replace(mesh=paths[0], ends=paths[1], stages=paths[2]),
        *(np.concatenate(leaves) for leaves in zip(*((s.duration, s.values) for s in solutions), strict=True)),
    )


@pytest.mark.parametrize("m", [2, 3, 4, 5])
def test_rule_is_exact_for_polynomials(m):
    """Quadrature of degree 2m − 1, integrals of degree m − 1, values and derivatives of degree m: identities."""
    rule = gauss_rule(m)
    for power in range(2 * m):
        assert abs(rule.weights @ rule.points**power - 1 / (power + 1)) < 1e-14
    for power in range(m):
        exact = rule.points ** (power + 1) / (power + 1)
        assert np.abs(rule.integrals @ rule.points**power - exact).max() < 1e-14
    nodes = np.concatenate([[0.0], rule.points])
    assert abs(rule.last @ nodes**m - 1.0) < 1e-12
    assert abs(rule.highest @ nodes**m / np.prod(np.arange(1.0, m + 1)) - 1.0) < 1e-11


def test_cycles_of_hopfs_normal_form():
    """Radius √μ, duration 2π/ω, multiplier exp(−4πμ/ω), two lanes with meshes of their own, errors that hold."""
    problem, mu = problem_of(first_order(hopf, {"mu": 0.1}, ("mu",)), ("mu",), (0.5, 0.5)), (0.1, 0.4)
    guess = joined(*(circle(8, 0.5, 3.0, value) for value in mu))
    for tolerance in (1e-3, 1e-6, 1e-11):
        for value, cycle in zip(mu, solve_cycles(problem, guess, tolerance), strict=True):
            assert cycle.converged[0]
            radius = np.linalg.norm(cycle.solution.path.ends[0], axis=1)
            assert np.abs(radius - np.sqrt(value)).max() <= np.sqrt(2) * 0.5 * cycle.error[0] <= tolerance
            assert abs(cycle.solution.duration[0] - 2 * np.pi / OMEGA) <= cycle.duration_error[0]
            exact = np.exp(-4 * np.pi * value / OMEGA)
            assert abs(cycle.multipliers[0, 0] - exact) <= cycle.multiplier_error[0, 0]
            assert cycle.multiplier_error[0, 0] < 100 * tolerance


@pytest.mark.parametrize("rate", [3.0, 30.0, 400.0])
def test_a_multiplier_that_is_nothing_leaves_the_others_theirs(rate):
    """Hopf's normal form with z' = rate (x − z): exp(−4πμ/ω) and exp(−2π rate/ω), down to far below all numbers."""

    def driven(mu=0.1):
        plane = hopf(mu)["rhs"]

        def rhs(y, t):
            return *plane(y[:2], t), rate * (y[0] - y[2])

        return {"rhs": rhs, "coordinates": ("x", "y", "z")}

    problem, mu = problem_of(first_order(driven, {"mu": 0.1}, ("mu",)), ("mu",), (0.5, 0.5, 0.5)), 0.1
    guess = circle(8, 0.3, 3.0, mu)
    path = guess.path
    path = path._replace(ends=path.ends[..., [0, 1, 0]], stages=path.stages[..., [0, 1, 0]])
    [cycle] = solve_cycles(problem, guess._replace(path=path), 1e-9)
    assert cycle.converged[0]
    assert cycle.solution.path.stages.shape[1] <= 128
    exact = np.exp(np.array([-4 * np.pi * mu, -2 * np.pi * rate]) / OMEGA)
    exact = exact[np.argsort(-exact)]
    assert np.all(np.abs(cycle.multipliers[0] - exact) <= cycle.multiplier_error[0])
    assert np.all(cycle.multiplier_error[0] <= 1e-7)


def test_durations_converge_with_order_2m():
    """Of Gauss collocation at the ends of intervals (de Boor and Swartz): eight with four points."""
    problem, errors = problem_of(first_order(hopf, {"mu": 0.1}, ("mu",)), ("mu",), (0.5, 0.5)), []
    for n in (4, 8):
        guess = circle(n, 0.3, 3.0, 0.1)
        cycle = correct(problem, guess, closure(problem, np.zeros((1, 2))), hold)
        assert cycle.converged[0]
        errors.append(abs(cycle.solution.duration[0] - 2 * np.pi / OMEGA))
    assert 2**7.5 < errors[0] / errors[1] < 2**8.5


def test_cycle_of_a_flow_with_a_clock():
    """The forced linear oscillator: its one orbit, and multipliers of modulus exp(−γT)."""
    flow = first_order(oscillator, {"drive": 1.0}, ("drive",))
    problem, period = problem_of(flow, ("drive",), (1.0, 1.0)), flow.period
    cycle = solve_cycles(problem, circle(8, 0.5, period, 0.7), 1e-11)[0]
    assert cycle.solution.duration[0] == period
    orbit = cycle.solution.path
    later = [motion(*orbit.ends[0, 0], 0.7, share * period) for share in orbit.mesh[0]]
    assert np.abs(later - orbit.ends[0]).max() < 2 * cycle.error[0] + 1e-13
    assert np.all(np.abs(np.abs(cycle.multipliers[0]) - np.exp(-DAMPING * period)) <= cycle.multiplier_error[0])
    turn = np.angle(cycle.multipliers[0, 0] / np.exp(1j * np.sqrt(1 - DAMPING**2) * period))
    other = np.angle(cycle.multipliers[0, 1] / np.exp(1j * np.sqrt(1 - DAMPING**2) * period))
    assert min(abs(turn), abs(other)) < 1e-9
    assert DRIVE * period == pytest.approx(2 * np.pi)


def lorenz_guess(n):
    """Nearly Lorenz's shortest orbit at rho = 28, by heyoka from a point of it that is known to ten digits."""
    x, y, z = hy.make_vars("x", "y", "z")
    field = [(x, 10.0 * (y - x)), (y, x * (28.0 - z) - y), (z, x * y - 8.0 / 3.0 * z)]
    ta = hy.taylor_adaptive(field, [-13.763610682134, -19.578751942452, 27.0])
    times = np.linspace(0.0, LORENZ_SHORTEST, 400)
    path, _ = path_through(times, ta.propagate_grid(times)[-1], n)
    return BoundarySolution(path, np.array([1.55]), np.array([[28.0]]))


def lorenz_multipliers(point, duration):
    """Moduli of the multipliers of a closed orbit, in rising order, by heyoka's variational equations around it."""
    x, y, z = hy.make_vars("x", "y", "z")
    field = [(x, 10.0 * (y - x)), (y, x * (28.0 - z) - y), (z, x * y - 8.0 / 3.0 * z)]
    ta = hy.taylor_adaptive(hy.var_ode_sys(field, [x, y, z], order=1), list(point), compact_mode=True)
    ta.propagate_until(duration)
    return np.sort(np.abs(np.linalg.eigvals(ta.state[3:].reshape(3, 3))))


def test_shortest_orbit_of_lorenz():
    """The period as published, and multipliers by heyoka's variational equations around it."""
    flow = first_order(lorenz, {"sigma": 10.0, "rho": 28.0, "beta": 8 / 3}, ("rho",))
    problem = problem_of(flow, ("rho",), (8.0, 9.0, 9.0))
    cycle = solve_cycles(problem, lorenz_guess(30), 1e-12)[0]
    assert cycle.converged[0]
    published = 1e-12  # its last digit
    assert abs(cycle.solution.duration[0] - LORENZ_SHORTEST) <= cycle.duration_error[0] + published < 1e-11
    values = lorenz_multipliers(cycle.solution.path.ends[0, 0], cycle.solution.duration[0])
    assert abs(values[1] - 1.0) < 1e-9
    assert abs(cycle.multipliers[0, 0] - values[2]) < 1e-8
    stable = (
        np.exp(-(10 + 1 + 8 / 3) * LORENZ_SHORTEST) / values[2]
    )  # Liouville's formula, its divergence being constant
    assert abs(cycle.multipliers[0, 1] - stable) < 1e-8 * stable


def test_errors_of_loose_meshes_hold():
    """Periods and the unstable multiplier of Lorenz's orbit on meshes of all sizes, as published and by heyoka."""
    flow = first_order(lorenz, {"sigma": 10.0, "rho": 28.0, "beta": 8 / 3}, ("rho",))
    problem = problem_of(flow, ("rho",), (8.0, 9.0, 9.0))
    fine = solve_cycles(problem, lorenz_guess(30), 1e-12)[0].solution
    multiplier = lorenz_multipliers(fine.path.ends[0, 0], fine.duration[0])[2]
    for n in (10, 14, 18, 24, 30, 40):
        cycle = solve_cycles(problem, lorenz_guess(n), 1.0)[0]
        assert cycle.converged[0]
        assert abs(cycle.solution.duration[0] - LORENZ_SHORTEST) <= cycle.duration_error[0] + 1e-12
        assert abs(cycle.multipliers[0, 0] - multiplier) <= cycle.multiplier_error[0, 0] + 1e-9


@pytest.mark.parametrize("mu", [100.0, pytest.param(1000.0, marks=pytest.mark.slow)])
def test_relaxation_oscillations(mu):
    """The period of van der Pol's oscillator where it is stiff, by a mesh that follows its jumps."""
    size, expected = (2.0, 4 / 3 * mu), RELAXATION[mu]
    problem = problem_of(first_order(van_der_pol, {"mu": mu}, ("mu",)), ("mu",), size, (mu,))
    rhs = van_der_pol(mu)["rhs"]
    guess = first_cycle(rhs, (2.0, 0.0), mu, 400, transient=expected, longest=2.2 * expected)
    cycle = solve_cycles(problem, guess, 1e-9)[0]
    assert cycle.converged[0]
    published = 5e-12 if mu == 100.0 else 5e-9  # half of its last digit
    assert abs(cycle.solution.duration[0] - expected) <= cycle.duration_error[0] + published
    assert cycle.duration_error[0] < 1e-8 * expected  # what is asked of stiff flows
    assert cycle.multipliers[0, 0] < 1e-100


def test_cycle_that_expands_errors_by_far_more_than_double_precision_has():
    """Van der Pol's cycle at mu = 3 backward in time: its multiplier is 1/exp(∫ div) of the cycle forward, by heyoka."""
    problem = problem_of(first_order(van_der_pol, {"mu": 3.0, "sign": -1.0}, ("mu",)), ("mu",), (2.0, 5.0))
    forward = first_cycle(van_der_pol(3.0)["rhs"], (2.0, 0.0), 3.0, 60)
    path = forward.path
    back = type(path)(1.0 - path.mesh[:, ::-1], path.ends[:, ::-1], path.stages[:, ::-1, ::-1])
    cycle = solve_cycles(problem, forward._replace(path=back), 1e-10)[0]
    assert cycle.converged[0]
    x, v, total = hy.make_vars("x", "v", "total")
    growth = 3.0 * (1.0 - x * x)
    ta = hy.taylor_adaptive([(x, v), (v, growth * v - x), (total, growth)], [2.0, 0.0, 0.0])
    ta.propagate_until(100.0)  # where it has long settled
    ta.time, ta.state[2] = 0.0, 0.0
    ta.propagate_until(cycle.solution.duration[0])
    exact = np.exp(-ta.state[2])
    assert exact > 1e10
    assert abs(cycle.multipliers[0, 0] - exact) <= cycle.multiplier_error[0, 0] + 1e-11 * exact
    assert cycle.multiplier_error[0, 0] < 1e-8 * exact


def test_angle_that_turns():
    """A damped pendulum under a torque goes around: by Liouville's formula its multiplier is exp(−γT)."""

    def pendulum(torque=1.5, damping=0.2):
        def rhs(y, t):
            import jax.numpy as jnp

            angle, rate = y
            return rate, torque - damping * rate - jnp.sin(angle)

        return {"rhs": rhs, "coordinates": ("angle", "rate"), "angles": ("angle",)}

    problem = problem_of(first_order(pendulum, {"torque": 1.5}, ("torque",)), ("torque",), (np.pi, 5.0))
    times = np.linspace(0.0, 0.85, 30)
    path, _ = path_through(times, np.stack([2 * np.pi * times / 0.85, 7.4 + 0 * times], axis=1), 10)
    guess, lift = BoundarySolution(path, np.array([0.85]), np.array([[1.5]])), np.array([[2 * np.pi, 0.0]])
    cycle = solve_cycles(problem, guess, 1e-10, lift)[0]
    assert cycle.converged[0]
    exact = np.exp(-0.2 * cycle.solution.duration[0])
    assert abs(cycle.multipliers[0, 0] - exact) <= cycle.multiplier_error[0, 0] < 1e-8
    angle, rate = hy.make_vars("angle", "rate")
    ta = hy.taylor_adaptive(
        [(angle, rate), (rate, 1.5 - 0.2 * rate - hy.sin(angle))], list(cycle.solution.path.ends[0, 0])
    )
    ta.propagate_until(cycle.solution.duration[0])
    assert np.abs(ta.state - cycle.solution.path.ends[0, 0] - lift[0]).max() < 1e-9


def test_adapted_meshes_follow_what_bends():
    """A layer of width w at the middle gets the share of intervals of its logarithm, and the ends of the mesh stay."""
    width, times = 1e-3, np.unique(np.concatenate([np.linspace(0, 1, 400), 0.5 + np.linspace(-0.02, 0.02, 2001)]))
    path, _ = path_through(times, np.tanh((times - 0.5) / width)[:, None], 100)
    for _ in range(3):
        path = on_mesh(path, adapted_mesh(path, np.ones(1), cyclic=False))
    inside = np.sum(np.abs(path.mesh - 0.5) < 10 * width)
    assert inside > 40
    assert path.mesh[0, 0] == 0.0
    assert path.mesh[0, -1] == 1.0


def test_lane_without_a_cycle_leaves_the_others_alone():
    """Where the normal form has no cycle a lane is marked; the other is what it is by itself, to the last bit."""
    problem = problem_of(first_order(hopf, {"mu": 0.1}, ("mu",)), ("mu",), (0.5, 0.5))
    both = solve_cycles(problem, joined(circle(8, 0.5, 3.0, -0.3), circle(8, 0.5, 3.0, 0.1)), 1e-9, most=64)
    alone = solve_cycles(problem, circle(8, 0.5, 3.0, 0.1), 1e-9, most=64)[0]
    assert not both[0].converged[0] or np.ptp(both[0].solution.path.ends) < 1e-6
    assert np.array_equal(both[1].solution.path.ends, alone.solution.path.ends)
    assert both[1].duration_error == alone.duration_error
