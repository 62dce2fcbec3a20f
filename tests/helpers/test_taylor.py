"""The Taylor reference against what does not share its code: closed forms, identities, the paper's own equations
under DOP853, differences of the map, and a second arithmetic."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipe

from tests.helpers import taylor

EPS = float(np.finfo(taylor.REAL).eps)
B = np.array([0.7, 2.5, 4.1, 5.5, 5.8])
MILD = B / 4  # one direction contracts ever harder as b grows, up to 1e-16 a period: nothing leads back from that
STATES = np.random.default_rng(7).uniform([-1, -1, -3], [1, 1, 3], (5, 3))
SYSTEMS = [
    taylor.Parameters(),
    taylor.Parameters(d=0.1),
    taylor.Parameters(a=0.3, c=1.7, d=0.2, omega=2),
]
ROUNDOFF = 500 * EPS  # of one period before it grows: some 60 Taylor steps, a few units each
GUESSES = [5.519779, 5.495639, 5.489447, 5.488079]  # Table 1 of the paper, good to 3e-4


@pytest.fixture(scope="module")
def doublings():
    return taylor.cascade(SYSTEMS[0], GUESSES)


def forces(par, b, x, y, t):
    g = 1 + np.sin(par.omega * t)
    return -(par.a * g * x + g * x**3 - b * y), -(g * y + par.a * g * y**3 - b * x)


def dop853(par, b, state):
    """State after one period from the flow of position and unit vector, and the logarithm of the volume."""

    def rates(t, z):
        x, y, n1, n2, _ = z
        s = np.sqrt(par.c + par.d * np.sin(t))
        f1, f2 = forces(par, b, x, y, t)
        turn = (n1 * f2 - n2 * f1) / s
        return s * n1, s * n2, -n2 * turn, n1 * turn, -(n1 * f1 + n2 * f2) / s

    start = [state[0], state[1], np.cos(state[2]), np.sin(state[2]), 0]
    end = solve_ivp(rates, (0, float(par.period)), start, method="DOP853", rtol=3e-14, atol=1e-14).y[:, -1]
    return np.array([end[0], end[1], np.arctan2(end[3], end[2])]), end[4]


def largest_difference(left, right):
    """Largest difference of two sets of states (..., 3), angles modulo whole turns."""
    gap = np.asarray(left) - np.asarray(right)
    gap[..., 2] -= taylor.turns(gap[..., 2])
    return np.abs(gap).max()


def growth(par, b, states):
    """Return how much one period enlarges an error of the start (lanes,), and its inverse an error of the end (lanes,)."""
    monodromy = taylor.strobe_jacobian(par, b, states)[1].astype(float)
    return np.linalg.norm(monodromy, 2, axis=(1, 2)), np.linalg.norm(np.linalg.inv(monodromy), 2, axis=(1, 2))


# The map


@pytest.mark.parametrize("par", [*SYSTEMS, taylor.Parameters(a=0.3, c=1.7, d=0.2, omega=1.5)])
def test_one_period_equals_dop853(par):
    end = taylor.strobe(par, B, STATES)
    for k in range(len(B)):
        assert largest_difference(end[k], dop853(par, B[k], STATES[k])[0]) < 1e-10


@pytest.mark.parametrize("par", SYSTEMS[1:])
def test_one_period_solves_the_equations_of_the_paper(par):
    """Equations (22), with damping and the multiplier of (21), its d cos t of the sign that (23) has; b small, where
    they are not yet ill-posed."""
    b, state = 0.7, STATES[0]

    def rates(t, z):
        x, x2, y, y2 = z
        f1, f2 = forces(par, b, x, y, t)
        squared = par.c + par.d * np.sin(t)
        multiplier = par.a / 2 + (-f1 * x2 - f2 * y2 + par.d * np.cos(t) / 2) / (2 * squared)
        return x2, f1 - par.a * x2 + 2 * multiplier * x2, y2, f2 - par.a * y2 + 2 * multiplier * y2

    s = np.sqrt(par.c)
    start = [state[0], s * np.cos(state[2]), state[1], s * np.sin(state[2])]
    x, x2, y, y2 = solve_ivp(rates, (0, float(par.period)), start, method="DOP853", rtol=3e-14, atol=1e-14).y[:, -1]
    assert largest_difference(taylor.strobe(par, b, state)[0], np.array([x, y, np.arctan2(y2, x2)])) < 1e-9


@pytest.mark.parametrize("d", [0.0, 0.3])
def test_straight_line_in_closed_form(d):
    """With a = b = 0 nothing pushes a particle off the x axis: its way is an elliptic integral."""
    c = 1.2
    end = taylor.strobe(taylor.Parameters(a=0, c=c, d=d), 0, [0.25, 0, 0])[0]
    way = 4 * np.sqrt(c + d) * ellipe(2 * d / (c + d))
    assert abs(end[0] - 0.25 - way) < 4 * np.finfo(float).eps * way
    assert end[1] == end[2] == 0


@pytest.mark.parametrize("par", SYSTEMS)
def test_map_is_odd(par):
    """(x, y, n) -> (-x, -y, -n) maps motions to motions."""
    half_turn = np.array([0, 0, taylor.TWO_PI / 2])
    end = taylor.strobe(par, B, STATES)
    mate = taylor.strobe(par, B, -STATES * [1, 1, -1] + half_turn)
    monodromy = taylor.strobe_jacobian(par, B, STATES)[1]
    forward = np.linalg.norm(monodromy.astype(float), 2, axis=(1, 2))
    for k in range(len(B)):
        assert largest_difference(-end[k] * [1, 1, -1] + half_turn, mate[k]) < ROUNDOFF * max(forward[k], 1)


@pytest.mark.parametrize("par", SYSTEMS[:2])
def test_motion_back_in_time(par):
    """Reversing the velocity, with sin t -> -sin t, leads back; errors grow by the inverse of the monodromy matrix."""
    half_turn = np.array([0, 0, taylor.TWO_PI / 2])
    reverse = taylor.Parameters(par.a, par.c, -par.d, -par.omega)
    back = taylor.strobe(reverse, MILD, taylor.strobe(par, MILD, STATES) + half_turn) - half_turn
    _, backward = growth(par, MILD, STATES)
    assert backward.max() < 1e8
    for k in range(len(MILD)):
        assert largest_difference(back[k], STATES[k]) < ROUNDOFF * backward[k]


def test_periods_add_up():
    par = SYSTEMS[1]
    three = taylor.strobe(par, B, STATES, periods=3)
    single = STATES
    for _ in range(3):
        single = taylor.strobe(par, B, single)
    assert largest_difference(three, single) < 1e-12  # chaotic: 1e-19 grown over two periods
    assert largest_difference(taylor.strobe(par, B[3], STATES[3])[0], taylor.strobe(par, B, STATES)[3]) == 0


@pytest.mark.slow
def test_lanes_of_a_vector_are_those_alone():
    """Eleven, which fill no number of vectors; two periods apart by their rounding, times what a period expands."""
    par, states = taylor.Parameters(), np.resize(STATES, (11, 3)).astype(float)
    alone = taylor.strobe(par, MILD[-1], states, 2, real=np.float64)
    assert largest_difference(taylor.strobe_of_many(par, MILD[-1], states, 2), alone) < 1e-12


def test_strobe_period():
    assert taylor.Parameters(omega=2).period == taylor.TWO_PI / 2
    assert taylor.Parameters(d=0.1, omega=2).period == taylor.TWO_PI
    assert taylor.Parameters(d=0.1, omega=2 / 3).period == 3 * taylor.TWO_PI
    with pytest.raises(ValueError, match="no common period"):
        _ = taylor.Parameters(d=0.1, omega=2**0.5).period


# Its derivatives


def differences(function, at, h):
    """Central differences of fourth order: function of (x, y, th, b) -> (...), result (..., 4)."""
    columns = []
    for unit in np.eye(4):
        near, far = (function(at + k * h * unit) - function(at - k * h * unit) for k in (1, 2))
        columns.append((8 * near - far) / (12 * h))
    return np.stack(columns, axis=-1)


def jacobian(par, at):
    _, monodromy, slope = taylor.strobe_jacobian(par, at[3], at[:3])
    return np.column_stack([monodromy[0], slope[0]])


@pytest.mark.parametrize("par", SYSTEMS)
def test_derivatives_equal_differences(par):
    h = taylor.REAL(5e-5)
    for b, state in zip(B[::2], STATES[::2], strict=True):
        at = np.array([*state, b], dtype=taylor.REAL)
        _, first, second = taylor.strobe_hessian(par, b, state)
        assert np.abs(first[0] - jacobian(par, at)).max() < 1e-13 * np.abs(first).max()
        by_state = differences(lambda u: taylor.strobe(par, u[3], u[:3])[0], at, h)
        assert np.abs(first[0] - by_state).max() < 1e-9 * np.abs(second).max()
        by_first = differences(lambda u: jacobian(par, u), at, h)
        assert np.abs(second[0] - by_first).max() < 1e-8 * np.abs(second).max()


@pytest.mark.parametrize("par", SYSTEMS)
def test_volume_shrinks_by_the_divergence(par):
    """Liouville: ln det M is the integral of -n.F/s along the motion."""
    _, monodromy, _ = taylor.strobe_jacobian(par, MILD, STATES)
    forward, backward = growth(par, MILD, STATES)
    for k, m in enumerate(monodromy):
        cancelled = ROUNDOFF * forward[k] * backward[k]
        logarithm = np.log(m[0] @ np.cross(m[1], m[2]))
        by_quadrature = dop853(par, MILD[k], STATES[k])[1]
        assert abs(logarithm - by_quadrature) < 1e-11 + cancelled
        assert abs(taylor.divergence(par, MILD[k], STATES[k : k + 1]) - by_quadrature) < 1e-11


# Doublings


@pytest.mark.slow  # quick tests of doublings use it
def test_orbit_at_a_doubling_has_multiplier_minus_one(doublings):
    """Closure and monodromy matrix of the orbit of period 2, from DOP853 alone."""
    b, _, info = doublings[1]
    product, h = np.eye(3), 1e-3
    for point, following in zip(info.points.astype(float), info.points[::-1], strict=True):
        assert largest_difference(dop853(SYSTEMS[0], float(b), point)[0], following) < 1e-11
        columns = []
        for unit in np.eye(3):
            shifted = [dop853(SYSTEMS[0], float(b), point + k * h * unit)[0] for k in (-2, -1, 1, 2)]
            columns.append(np.array([1, -8, 8, -1]) @ shifted / (12 * h))
        product = np.column_stack(columns) @ product
    assert np.abs(np.linalg.eigvals(product) + 1).min() < 1e-7


def test_logarithms_of_multipliers(doublings):
    """At a doubling the largest is that of 1, the next is that of the product's next eigenvalue, the sum is the volume's."""
    b, _, info = doublings[1]
    points = info.points.astype(float)
    logs = taylor.multiplier_logs(SYSTEMS[0], 2, float(b), points)
    blocks = taylor.strobe_jacobian(SYSTEMS[0], np.full(2, float(b)), points)[1].astype(float)
    second = np.sort(np.abs(np.linalg.eigvals(blocks[1] @ blocks[0])))[1]
    # Points and b are rounded to float64, and an eigenvalue of a product by as much as the largest over it.
    np.testing.assert_allclose(logs[:2], [0.0, np.log(second)], atol=1e-11 + 8 * ROUNDOFF / second)
    by_quadrature = sum(dop853(SYSTEMS[0], float(b), point)[1] for point in points)
    assert abs(logs.sum() - by_quadrature) < 1e-10


def test_cascade_follows_feigenbaum(doublings):
    b = np.array([found[0] for found in doublings])
    delta = (b[1:-1] - b[:-2]) / (b[2:] - b[1:-1])
    gap = np.abs(delta - 4.669201609)
    assert gap[1] < gap[0] / 4
    assert gap[1] < 0.1
    assert np.abs(b - GUESSES).max() < 3e-4
    for _, _, info in doublings:
        assert info.error < 1e-14
        assert np.abs(info.multipliers + 1).min() < 1e-12


def test_claimed_error_covers_the_error(doublings):
    """In float64 every doubling is off by less than it claims, and by less than 1e-12."""
    coarse = taylor.cascade(SYSTEMS[0], GUESSES[:3], real=np.float64)
    for (b, _, info), (exact, _, _) in zip(coarse, doublings, strict=False):
        assert abs(b - exact) < info.error < 2e-12


def test_lost_orbit_is_reported():
    with pytest.raises(ArithmeticError, match="has period 1, not 2"):
        taylor.doubling_point(SYSTEMS[0], 2, 5.56, taylor.attractor(SYSTEMS[0], 5.56, SYSTEMS[0].start(), 300)[0])
