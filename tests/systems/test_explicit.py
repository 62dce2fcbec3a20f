"""Velocities that constraints give: which are seen, and motions without them against the bordered equations."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import derivatives, iterate, section_map
from jaxnh.solvers import tsit5
from jaxnh.systems.explicit import all_velocities, free_accelerations
from jaxnh.systems.jourdain import accelerations
from jaxnh.systems.lagrangian import Motion, lagrangian
from jaxnh.systems.motion import ReducedMotion
from tests.helpers.batches import broadcast_start

PERIOD = 2 * np.pi


def governor(drive=0.8, damping=0.2):
    """A slide whose velocity follows the square of the weight's."""

    def Q(q, v, t):
        return drive * jnp.sin(t) + q[0] - q[0] ** 3 - damping * v[0], -q[1] - damping * v[1]

    return {
        "T": lambda q, v, t: 0.5 * (v[0] ** 2 + v[1] ** 2),
        "Q": Q,
        "f": lambda q, v, t: (v[1] - 0.5 * (v[0] ** 2 - 0.5),),
        "coordinates": ("x", "y"),
        "period": PERIOD,
    }


def linked(drive=0.3):
    """Four coordinates, unlike masses, one of two couplings through velocities alone and one that moves with time."""

    def T(q, v, t):
        return 0.5 * (v[0] ** 2 + 2.0 * v[1] ** 2 + v[2] ** 2 + 3.0 * v[3] ** 2) + 0.2 * v[0] * v[2]

    def Q(q, v, t):
        return drive * jnp.cos(t) - jnp.sin(q[0]), -q[1] - 0.3 * v[1], -0.5 * q[2], q[0] - q[3] - 0.1 * v[3]

    def f(q, v, t):
        return 2.0 * v[1] + v[3] - v[0] * jnp.cos(q[2]), v[1] - v[3] - 0.1 * jnp.sin(t) * v[2] ** 2

    return {"T": T, "Q": Q, "f": f, "coordinates": ("a", "b", "c", "d"), "period": PERIOD}


def blade(length=0.3):
    """Chaplygin's sleigh: its constraint has no velocity with a constant coefficient."""
    return {
        "T": lambda q, v, t: 0.5 * (v[0] ** 2 + v[1] ** 2 + v[2] ** 2),
        "Q": lambda q, v, t: (-q[0], -q[1], -length * v[2]),
        "f": lambda q, v, t: (v[1] * jnp.cos(q[2]) - v[0] * jnp.sin(q[2]),),
        "coordinates": ("x", "y", "theta"),
        "period": PERIOD,
    }


def heavier(drive=0.8, mass=2.0):
    """The governor with a mass that is a parameter."""
    return governor(drive) | {"T": lambda q, v, t: 0.5 * mass * (v[0] ** 2 + v[1] ** 2)}


SYSTEMS = {
    "governor": (lagrangian(governor, {"drive": 0.8, "damping": 0.2}, ("drive",)), (0.5, 0.0), (0.7,)),
    "linked": (lagrangian(linked, {"drive": 0.3}, ("drive",)), (0.4, -0.2, 0.9, 0.1), (0.3, 0.8)),
}
BOTH = pytest.mark.parametrize("name", SYSTEMS)
LARGE_SLOW = pytest.mark.parametrize("name", ["governor", pytest.param("linked", marks=pytest.mark.slow)])


def on_constraints(name):
    """A start state of the system, on f = 0 at t = 0."""
    system, q, u = SYSTEMS[name]
    v = all_velocities(system.equations({}), system.explicit, jnp.array(q), jnp.array(u), jnp.float64(0.0))
    return Motion(q, tuple(float(x) for x in v), (0.0, 0.0))


def test_which_velocities_are_given():
    governed, chained = (SYSTEMS[name][0].explicit for name in SYSTEMS)
    assert (governed.given, governed.free) == ((1,), (0,))
    assert (chained.given, chained.free) == ((1, 3), (0, 2))
    np.testing.assert_allclose(chained.inverse, np.linalg.inv([[2.0, 1.0], [1.0, -1.0]]), rtol=0, atol=1e-15)


def test_others_are_carried_whole():
    """No constant coefficient, a mass matrix that parameters change, and no constraint at all."""
    free = {key: value for key, value in governor().items() if key != "f"}
    for define, parameters in ((blade, {"length": 0.3}), (heavier, {"drive": 0.8, "mass": 2.0}), (lambda: free, {})):
        assert lagrangian(define, parameters).explicit is None


@BOTH
def test_accelerations_are_those_of_the_bordered_system(name):
    """Of any state on the constraints, both ways of Jourdain's principle, to the rounding of a few sums."""
    system, q, _ = SYSTEMS[name]
    rng, explicit, equations = np.random.default_rng(3), system.explicit, system.equations({})
    for _ in range(8):
        q, u = (tuple(jnp.asarray(x) for x in rng.normal(size=n)) for n in (len(q), len(explicit.free)))
        t = jnp.float64(rng.uniform(0, PERIOD))
        v = all_velocities(equations, explicit, q, u, t)
        assert max(abs(float(f)) for f in system.residuals(t, Motion(q, v, ()), {})) < 1e-14
        whole = accelerations(equations, q, v, t).a
        ours = free_accelerations(equations, explicit, q, u, t)
        for j, acceleration in zip(explicit.free, ours, strict=True):
            assert abs(float(acceleration - whole[j])) < 1e-13 * (1.0 + abs(float(whole[j])))


@LARGE_SLOW
def test_motions_keep_the_constraints_and_are_those_of_projected_steps(lanes, name):
    """The other way is the package's own too, by steps of the whole state each projected: `ProjectedSolver` in diffrax."""
    system, start = SYSTEMS[name][0], on_constraints(name)
    p = {"drive": np.array([0.3, 0.8])}
    end = lanes(iterate, (make_return_map(system, tsit5, 400), np.int32(2)), (broadcast_start(start, 2), p))
    left = jax.vmap(lambda y, drive: jnp.stack(system.residuals(0.0, y, {"drive": drive})))(end, p["drive"])
    assert np.abs(np.asarray(left)).max() < 1e-14
    assert np.all(end.watch[1] == 0.0)
    whole = lanes(stepped_whole, (system,), (broadcast_start(start, 2), p))
    # h⁴ over two periods of the classical method, h = π/1000, is 1e-9; that of order five, h = π/200, is below it.
    assert np.abs(system.chart.host_points(end) - system.chart.host_points(whole)).max() < 1e-9


def stepped_whole(system, state, p):
    """Two periods in 4,000 steps of the classical method of order four, the whole state projected after each."""
    steps, h = 4000, 2 * PERIOD / 4000

    def step(i, y):
        t = i * h

        def moved(rate, length):
            return jax.tree.map(lambda a, b: a + length * b, y, rate)

        one = system.rhs(t, y, p)
        two = system.rhs(t + h / 2, moved(one, h / 2), p)
        three = system.rhs(t + h / 2, moved(two, h / 2), p)
        four = system.rhs(t + h, moved(three, h), p)
        mean = jax.tree.map(lambda a, b, c, d: (a + 2 * b + 2 * c + d) / 6, one, two, three, four)
        return system.project(t + h, moved(mean, h), p)

    return jax.lax.fori_loop(0, steps, step, state)


@LARGE_SLOW
@pytest.mark.slow
def test_tangents_are_derivatives_of_the_map(lanes, name):
    """In state and parameter, against jacfwd; as many multipliers are zero as there are constraints."""
    system, start = SYSTEMS[name][0], on_constraints(name)
    strobe, p = make_return_map(system, tsit5, 80), {"drive": np.array([0.3, 0.8])}
    u = system.chart.host_points(broadcast_start(start, 2))
    found = lanes(derivatives, (strobe, np.int32(1)), (u, p), static=("drive",))
    by_state, by_p = lanes(jacobians, (strobe,), (u, p))
    scale = np.abs(by_state).max()
    assert np.abs(found.monodromy - by_state).max() < 1e-12 * scale
    assert np.abs(found.by_parameter - by_p["drive"]).max() < 1e-12 * scale
    sizes = np.linalg.svd(found.monodromy, compute_uv=False)
    assert np.all(sizes[:, -system.constraints :] < 1e-11 * sizes[:, :1])
    assert np.all(sizes[:, -system.constraints - 1] > 1e-9)


def jacobians(strobe, u, p):
    return jax.jacfwd(lambda u, p: section_map(strobe, 1, u, p), argnums=(0, 1))(u, p)


@pytest.mark.slow
@BOTH
def test_volume_is_that_of_the_whole_flow(lanes, name):
    """The divergence that steps integrate is that of rhs, integrated by itself along the same motion."""
    system, start = SYSTEMS[name][0], on_constraints(name)
    p = {"drive": np.array([0.3, 0.8])}
    volume = lanes(volume_of, (make_return_map(system, tsit5, 400),), (broadcast_start(start, 2), p))
    integral = lanes(divergence_along, (make_return_map(system, tsit5, 400), system), (broadcast_start(start, 2), p))
    # Simpson's pieces, h = π/100: 2π h⁴/2880 times a fourth derivative of order 100; the states' errors are smaller.
    assert np.abs(np.log(volume) - integral).max() < 1e-6


def volume_of(strobe, state, p):
    return jnp.exp(strobe.pushforward(state, p, ()).log_volume)


def divergence_along(strobe, system, state, p):
    """∫ div rhs dt over a period, by Simpson's rule on 200 pieces, each a classical step apart."""
    pieces, h = 200, PERIOD / 200

    def step(i, carry):
        y, total = carry
        t = i * h

        def moved(y, rate, length):
            return jax.tree.map(lambda a, b: a + length * b, y, rate)

        def rk4(y, t, h):
            one = system.rhs(t, y, p)
            two = system.rhs(t + h / 2, moved(y, one, h / 2), p)
            three = system.rhs(t + h / 2, moved(y, two, h / 2), p)
            four = system.rhs(t + h, moved(y, three, h), p)
            return moved(y, jax.tree.map(lambda a, b, c, d: (a + 2 * b + 2 * c + d) / 6, one, two, three, four), h)

        half = rk4(y, t, h / 2)
        end = rk4(half, t + h / 2, h / 2)
        rates = [system.divergence(at, z, p) for at, z in ((t, y), (t + h / 2, half), (t + h, end))]
        return end, total + h / 6 * (rates[0] + 4 * rates[1] + rates[2])

    return jax.lax.fori_loop(0, pieces, step, (state, jnp.zeros(())))[1]


def test_a_state_off_the_constraint_is_brought_back_or_fails(lanes):
    """The same as with projected steps: a hundredth is projected along M⁻¹ Aᵀ, and what is beyond measure is a failure."""
    system, start = SYSTEMS["governor"][0], on_constraints("governor")
    p = {"drive": np.array([0.8])}
    strobe = make_return_map(system, tsit5, 80)
    for off, reason in ((1e-3, 0.0), (50.0, 2.0)):
        moved = start._replace(v=(start.v[0], start.v[1] + off))
        end = lanes(iterate, (strobe, np.int32(1)), (broadcast_start(moved, 1), p))
        assert end.watch[1][0] == reason
        assert np.isfinite(end.v[0][0]) == (reason == 0.0)
        if reason == 0.0:
            assert abs(end.watch[0][0] - off) < 1e-12


def test_steps_carry_no_velocity_that_is_given():
    """Two coordinates and one velocity of the governor, in place of both velocities and what is watched."""
    system, start = SYSTEMS["governor"][0], on_constraints("governor")
    carried = system.reduction.reduce(start)
    assert isinstance(carried, ReducedMotion)
    assert len(jax.tree.leaves(carried)) == 3
    assert not system.reduction.leaves_constraints
