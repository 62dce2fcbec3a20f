"""Mechanics in quasi-velocities: against Euler's equations, Newton's in a frame of its own, and a closed form."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.exceptions import InputError
from jaxnh.mechanics import RIGID_MOTION, contact_point, cross, dot, ellipsoid, quaternion_rates, rolling_body
from jaxnh.systems.degeneracy import describe_singularity
from jaxnh.systems.lagrangian import Equations, Motion, accelerations, lagrangian
from jaxnh.systems.status import STATUS
from tests.flows import sleigh

STATES = 50
RNG = np.random.default_rng(8)
EXACT = 1e-12  # of accelerations near ten, from some hundred products
QUATERNION, ANGULAR = ("e0", "e1", "e2", "e3"), ("p", "q", "r")
INERTIA = (1.0, 1.7, 2.3)


def states(k, n, norms=()):
    """Random states, components (STATES,), norms of length one."""
    q = RNG.uniform(-1.2, 1.2, (k, STATES))
    for group in norms:
        q[list(group)] /= np.linalg.norm(q[list(group)], axis=0)
    return tuple(q), tuple(RNG.uniform(-1.5, 1.5, (n, STATES)))


def rates_of(flow, q, u, t=0.0):
    """(q̇, u̇) at many states, one program."""
    zero = np.zeros(STATES)
    moved = jax.jit(jax.vmap(lambda t, y: flow.rhs(t, y, {})))(zero + t, Motion(q, u, (zero, zero)))
    assert not np.isnan(moved.watch[1]).any()
    return np.stack(moved.q), np.stack(moved.v)


# ---- the sleigh: a closed form, with its constraint projected, eliminated, left out


def in_the_frame(mass, inertia, length):
    """Chaplygin's sleigh in its own frame: velocities along and across the blade, and its turning."""

    def T(q, u, t):
        return 0.5 * mass * (u[0] ** 2 + (u[1] + length * u[2]) ** 2) + 0.5 * inertia * u[2] ** 2

    def rates(q, u, t):
        c, s = jnp.cos(q[2]), jnp.sin(q[2])
        return u[0] * c - u[1] * s, u[0] * s + u[1] * c, u[2]

    return {
        "T": T, "Q": lambda q, u, t: (0.0, 0.0, 0.0), "f": lambda q, u, t: (u[1],), "rates": rates,
        "coordinates": ("x", "y", "theta"), "quasi_velocities": ("along", "across", "turn"),
    }  # fmt: skip


def left_out(mass, inertia, length):
    return in_the_frame(mass, inertia, length) | {"dependent": ("across",)}


def in_other_velocities(mass, inertia, length):
    """The same in velocities whose brackets are no constants: across and along mixed by the place, turning by a length."""
    plain = in_the_frame(mass, inertia, length)

    def of(q, u):
        return (1.0 + 0.5 * jnp.sin(q[2]) ** 2) * u[0], u[1] + q[1] * u[0], length * u[2] + 0.3 * q[0] * u[0]

    changed = {
        key: lambda q, u, t, key=key: plain[key](q, of(q, u), t) for key in ("T", "f", "rates")
    }  # fmt: skip
    return plain | changed


def moved_to(q, along, turn, length):
    """Velocities of `in_other_velocities` that these are."""
    u = along / (1.0 + 0.5 * np.sin(q[2]) ** 2)
    return u, -q[1] * u, (turn - 0.3 * q[0] * u) / length


@pytest.mark.parametrize("define", [in_the_frame, left_out, in_other_velocities])
def test_sleigh(define):
    """u̇ = l w², ẇ = −m l u w/(I + m l²) for the blade's velocity u and its turning w (Chaplygin 1911)."""
    mass, inertia, length = sleigh.PARAMETERS.values()
    flow = lagrangian(define, sleigh.PARAMETERS)
    q, (along, turn) = states(3, 2)
    if define is left_out:
        assert flow.coordinates == ("x", "y", "theta", "along", "turn")
        assert (flow.constraints, flow.exponents) == (0, 5)
    exact = np.stack([length * turn**2, -mass * length * along * turn / (inertia + mass * length**2)])
    zero = np.zeros(STATES)
    velocities = {in_the_frame: (along, zero, turn), left_out: (along, turn)}
    u = velocities.get(define) or moved_to(q, along, turn, length)
    q_dot, ours = rates_of(flow, q, u)
    assert np.abs(q_dot - np.stack([along * np.cos(q[2]), along * np.sin(q[2]), turn])).max() < EXACT
    if define is in_other_velocities:
        assert flow.quasi.structure is None
        shape, bend = 1.0 + 0.5 * np.sin(q[2]) ** 2, np.sin(q[2]) * np.cos(q[2]) * q_dot[2]
        ours = np.stack([shape * ours[0] + bend * u[0], length * ours[2] + 0.3 * (q[0] * ours[0] + q_dot[0] * u[0])])
    elif define is in_the_frame:
        assert np.abs(ours[1]).max() < EXACT
        ours = ours[[0, 2]]
    assert np.abs(ours - exact).max() < EXACT


# ---- a body with a fixed point: Euler's equations


def top(weight=0.0):
    """A heavy top by a quaternion, its centre of mass on the third axis."""

    def Q(q, w, t):
        g1, g2, _ = vertical(q)
        return weight * g2, -weight * g1, 0.0

    return {
        "T": lambda q, w, t: 0.5 * sum(moment * each**2 for moment, each in zip(INERTIA, w, strict=True)),
        "Q": Q, "rates": lambda q, w, t: quaternion_rates(q, w),
        "coordinates": QUATERNION, "quasi_velocities": ANGULAR, "norms": [QUATERNION],
    }  # fmt: skip


def bent_top(weight=0.0, bend=0.4, swing=0.2):
    """The same top in velocities that the place and the time bend: ω = B(q, t) u."""
    plain = top(weight)

    def of(q, u, t):
        return u[0] * (1.0 + bend * q[1] * q[2] + swing * jnp.sin(t)), u[1] + bend * q[3] * u[2], u[2]

    def Q(q, u, t):
        columns = [of(q, tuple(float(i == j) for i in range(3)), t) for j in range(3)]
        return tuple(dot(plain["Q"](q, u, t), column) for column in columns)

    changed = {key: lambda q, u, t, key=key: plain[key](q, of(q, u, t), t) for key in ("T", "rates")}
    return plain | changed | {"Q": Q, "period": 2 * np.pi}


def vertical(q):
    """The upward vertical in the body."""
    a, b, c, d = q
    return 2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d


def euler(w, torque):
    """ω̇ = I⁻¹ (N − ω × I ω)."""
    moments = np.array(INERTIA)[:, None]
    return (torque - np.cross(w, moments * w, axis=0)) / moments


def test_heavy_top_is_eulers():
    """Hamel's constants are those of turns, c_ij^k = ε_ijk; the length of the quaternion stays."""
    flow = lagrangian(top, {"weight": 1.3})
    q, w = states(4, 3, [range(4)])
    g1, g2, _ = vertical(q)
    q_dot, w_dot = rates_of(flow, q, w)
    assert np.abs(w_dot - euler(np.stack(w), 1.3 * np.stack([g2, -g1, np.zeros(STATES)]))).max() < EXACT
    turns = np.zeros((3, 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        turns[i, j, k], turns[j, i, k] = 1.0, -1.0
    np.testing.assert_array_equal(flow.quasi.structure, turns)
    assert np.abs(np.einsum("ks,ks->s", q_dot, q)).max() < 1e-15
    assert (flow.chart.dimension, flow.exponents) == (7, 6)


def test_more_coordinates_than_velocities_and_brackets_that_depend_on_place_and_time():
    """Bent velocities of the same top: ω̇ from u̇ by the chain rule, central differences of order h² in its factors."""
    parameters = {"weight": 1.3, "bend": 0.4, "swing": 0.2}
    bent = lagrangian(bent_top, parameters)
    assert bent.quasi.structure is None
    q, u = states(4, 3, [range(4)])
    t = 0.7
    q_dot, u_dot = rates_of(bent, q, u, t)

    def of(q, u, t):
        stretch = 1.0 + 0.4 * q[1] * q[2] + 0.2 * np.sin(t)
        return np.stack([u[0] * stretch, u[1] + 0.4 * q[3] * u[2], u[2]])

    q, u, h = np.stack(q), np.stack(u), 1e-5
    w_dot = (of(q + h * q_dot, u + h * u_dot, t + h) - of(q - h * q_dot, u - h * u_dot, t - h)) / (2 * h)
    g1, g2, _ = vertical(q)
    exact = euler(of(q, u, t), 1.3 * np.stack([g2, -g1, np.zeros(STATES)]))
    assert np.abs(w_dot - exact).max() < 1e-8  # third derivatives of order ten times h²/6, and rounding over h


def test_rotation_matrix_has_the_same_constants():
    """Nine coordinates: the rows of R, each turned by the body's angular velocity."""
    names = tuple(f"r{i}{j}" for i in "123" for j in "123")

    def define():
        return {
            "T": lambda q, u, t: 0.5 * sum(moment * w**2 for moment, w in zip(INERTIA, u, strict=True)),
            "Q": lambda q, u, t: (0.0, 0.0, 0.0),
            "rates": lambda q, u, t: sum((cross(q[3 * i : 3 * i + 3], u) for i in range(3)), ()),
            "coordinates": names, "quasi_velocities": ANGULAR, "norms": [names[:3], names[3:6], names[6:]],
        }  # fmt: skip

    flow = lagrangian(define, {})
    assert flow.quasi.structure == lagrangian(top, {}).quasi.structure
    q, w = states(9, 3)
    assert np.abs(rates_of(flow, q, w)[1] - euler(np.stack(w), 0.0)).max() < EXACT


# ---- nonlinear constraints


@pytest.mark.slow  # the matrix has quasi-velocities
def test_nonlinear_constraint_in_polar_velocities():
    """A particle held at a speed: radial and tangential velocities against Cartesian ones, by the same principle."""

    def polar(speed):
        return {
            "T": lambda q, u, t: 0.5 * (u[0] ** 2 + u[1] ** 2),
            "Q": lambda q, u, t: (-q[0] + 0.3 * jnp.cos(q[1]), -0.3 * jnp.sin(q[1]) - 0.2 * u[1]),
            "f": lambda q, u, t: (u[0] ** 2 + u[1] ** 2 - speed**2,),
            "rates": lambda q, u, t: (u[0], u[1] / q[0]),
            "coordinates": ("radius", "angle"), "quasi_velocities": ("out", "round"), "angles": ("angle",),
        }  # fmt: skip

    flow = lagrangian(polar, {"speed": 0.8})
    assert (flow.constraints, flow.explicit) == (1, None)
    r, phi = RNG.uniform(0.5, 2.0, STATES), RNG.uniform(-3, 3, STATES)
    course = RNG.uniform(-3, 3, STATES)
    out, round_ = 0.8 * np.cos(course), 0.8 * np.sin(course)
    _, ours = rates_of(flow, (r, phi), (out, round_))
    c, s = np.cos(phi), np.sin(phi)
    v = out * c - round_ * s, out * s + round_ * c
    drag = -0.2 * round_
    force = -r * c + 0.3 - drag * s, -r * s + drag * c
    plain = Equations(
        lambda q, v, t: 0.5 * (v[0] ** 2 + v[1] ** 2),
        lambda q, v, t: force,
        lambda q, v, t: (v[0] ** 2 + v[1] ** 2 - 0.64,),
    )
    (ax, ay), _, _ = accelerations(plain, (r * c, r * s), v, np.zeros(STATES))
    exact = np.stack([ax * c + ay * s + round_**2 / r, ay * c - ax * s - out * round_ / r])
    assert np.abs(ours - exact).max() < EXACT


def test_projection_keeps_norms_and_constraints():
    """A quaternion off length one by a thousandth comes back, its drift is kept; one of no length is a failure."""
    flow = lagrangian(top, {"weight": 1.0})
    q = np.array([0.5, -0.5, 0.5, 0.5]) * 1.001
    y = jax.tree.map(jnp.float64, Motion(tuple(q), (0.1, 0.2, 0.3), (0.0, 0.0)))
    near = flow.project(0.0, y, {})
    assert np.abs(np.array(near.q) - q / 1.001).max() < 1e-15
    assert abs(float(near.watch[0]) - (1.001**2 - 1)) < 1e-12
    nothing = flow.project(0.0, y._replace(q=(jnp.zeros(()),) * 4), {})
    assert STATUS[int(nothing.watch[1])] == "not_finite"


# ---- a rolling body: Newton's and Euler's equations with the reaction at the contact


SEMIAXES, CENTER = (1.0, 0.7, 0.5), (0.05, -0.1, 0.2)
TENSOR = ((1.1, 0.15, -0.1), (0.15, 1.6, 0.05), (-0.1, 0.05, 1.9))
MASS, GRAVITY = 1.4, 0.9


def ball(mass=MASS, gravity=GRAVITY):
    return rolling_body(ellipsoid(SEMIAXES, CENTER), mass, TENSOR, gravity)


def newton_euler(vertical, w):
    """ω̇ of one state: V = r × ω, m (V̇ + ω × V) = N − m g γ, J ω̇ + ω × J ω = r × N, r and ṙ of an ellipsoid by hand."""
    squares, inertia = np.array(SEMIAXES) ** 2, np.array(TENSOR)
    size = np.sqrt(squares @ vertical**2)
    r = np.array(CENTER) - squares * vertical / size
    turn = np.cross(vertical, w)
    r_dot = -squares * turn / size + squares * vertical * (squares @ (vertical * turn)) / size**3
    rest = np.cross(r_dot, w) + np.cross(w, np.cross(r, w)) + GRAVITY * vertical  # (V̇ + ω × V + g γ) without ω̇
    skew = np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
    return np.linalg.solve(inertia - MASS * skew @ skew, MASS * np.cross(r, rest) - np.cross(w, inertia @ w))


def test_rolling_body_is_newtons():
    flow = lagrangian(ball, {"mass": MASS, "gravity": GRAVITY})
    assert flow.coordinates == ("g1", "g2", "g3", "w1", "w2", "w3")
    assert (flow.chart.dimension, flow.exponents) == (6, 5)
    q, w = states(3, 3, [range(3)])
    q_dot, w_dot = rates_of(flow, q, w)
    q, w = np.stack(q, axis=1), np.stack(w, axis=1)
    assert np.abs(q_dot.T - np.cross(q, w)).max() < EXACT
    assert np.abs(w_dot.T - [newton_euler(*state) for state in zip(q, w, strict=True)]).max() < EXACT
    carried = flow.reduction.reduce(Motion(tuple(q[0]), tuple(w[0]), (0.0, 0.0)))
    assert len(jax.tree.leaves(carried)) == 6


def test_published_equations():
    """Ṁ = M × ω + m ṙ × (ω × r) + m g r × γ, M = J ω + m r × (ω × r) (Borisov and Mamaev, Phys. Usp. 46 (2003) 393)."""
    flow = lagrangian(ball, {"mass": MASS, "gravity": GRAVITY})

    def momentum(vertical, w):
        r = jnp.stack(contact_point(ellipsoid(SEMIAXES, CENTER), tuple(vertical)))
        return jnp.array(TENSOR) @ w + MASS * jnp.cross(r, jnp.cross(w, r)), r

    @jax.jit
    @jax.vmap
    def gap(vertical, w):
        y = Motion(tuple(vertical), tuple(w), (jnp.zeros(()),) * 2)
        rates = flow.rhs(0.0, y, {})
        moved = jnp.stack(rates.q), jnp.stack(rates.v)
        (m, r), (m_dot, r_dot) = jax.jvp(momentum, (vertical, w), moved)
        right = jnp.cross(m, w) + MASS * (jnp.cross(r_dot, jnp.cross(w, r)) + GRAVITY * jnp.cross(r, vertical))
        return m_dot - right

    q, w = states(3, 3, [range(3)])
    assert np.abs(gap(np.stack(q, axis=1), np.stack(w, axis=1))).max() < EXACT


def test_reaction_carries_the_weight():
    """Of a body at rest on its lowest point the multipliers are the reaction, m g upwards."""
    flow = lagrangian(lambda: rolling_body(ellipsoid(SEMIAXES), MASS, TENSOR, GRAVITY), {})
    y = jax.tree.map(jnp.float64, Motion((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.0, 0.0)))
    assert np.abs(np.array(flow.multipliers(0.0, y, {})) - [0.0, 0.0, MASS * GRAVITY]).max() < EXACT


def test_structure_constants_of_rigid_motion():
    """The structure constants from the place and the three axes of a body, twelve coordinates that determine them."""

    def define():
        return {
            "T": lambda q, u, t: 0.5 * sum(x**2 for x in u),
            "Q": lambda q, u, t: (0.0,) * 6,
            "rates": lambda q, u, t: sum(
                (cross(q[3 * i : 3 * i + 3], u[:3]) for i in range(3)), tuple(dot(q[i : i + 3], u[3:]) for i in (0, 3, 6))
            ),
            "coordinates": tuple(f"x{i}" for i in range(12)), "quasi_velocities": tuple(f"u{i}" for i in range(6)),
        }  # fmt: skip

    def reordered():  # rows first: the rates of the place come last
        plain = define()["rates"]
        return define() | {"rates": lambda q, u, t: (*plain(q, u, t)[3:], *plain(q, u, t)[:3])}

    assert lagrangian(reordered, {}).quasi.structure == RIGID_MOTION


# ---- refusals


def refused(**changed):
    with pytest.raises(InputError) as fault:
        lagrangian(lambda: top() | changed, {})
    return str(fault.value)


def test_rates_that_are_none():
    assert refused(rates=lambda q, u, t: (u[0] ** 2, u[1], u[2], 0.0)) == "rates must be linear in the quasi-velocities"
    assert "do not keep the sum of squares" in refused(rates=lambda q, u, t: (*u, 0.0))
    only = {"coordinates": ("x",), "norms": (), "rates": lambda q, u, t: (u[0],)}
    assert "moves no coordinate" in refused(
        Q=lambda q, u, t: (0.0,) * 3, T=lambda q, u, t: sum(x**2 for x in u), **only
    )
    wrong = np.zeros((3, 3, 3)).tolist()
    assert refused(structure_constants=wrong) == "structure_constants are not those of the rates"


def wheel(ratio=1.0):
    """Two velocities of three are given, but where the first one's coefficient vanishes."""
    return {
        "T": lambda q, u, t: 0.5 * sum(x**2 for x in u),
        "Q": lambda q, u, t: (0.0, 0.0, 0.0),
        "f": lambda q, u, t: (q[2] * u[0] - ratio * u[2], u[1] - u[2]),
        "rates": lambda q, u, t: u,
        "coordinates": ("x", "y", "z"), "quasi_velocities": ("a", "b", "c"), "dependent": ("a", "b"),
    }  # fmt: skip


def test_dependent_velocities_that_are_not_given_are_singular():
    """The same as with constraints that lose rank: the lane at z = 0 fails with its reason, another one goes on."""
    flow = lagrangian(wheel, {"ratio": 1.0})
    zero = np.zeros(2)
    y = Motion((zero, zero, np.array([0.0, 2.0])), (np.array([1.0, 1.0]),), (zero, zero))
    moved = jax.jit(jax.vmap(lambda y: flow.rhs(0.0, y, {})))(y)
    assert np.isnan(moved.watch[1]).tolist() == [True, False]
    # T = (1/z² + 2) ż²/2: (1/z² + 2) z'' = ż²/z³
    assert abs(float(moved.v[0][1]) - (1 / 8) / (1 / 4 + 2)) < 1e-14
    state = jax.tree.map(lambda leaf: jnp.float64(leaf[0]), y)
    assert describe_singularity(flow, state, {}).startswith(
        "the constraints f do not give a, b: their derivatives by these"
    )
