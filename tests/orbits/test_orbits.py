"""Periodic orbits and doubling points against the Taylor reference, and their linear systems against dense solutions."""

from __future__ import annotations

import math

import numpy as np
import pytest
import taylor
from hypothesis import given, settings
from hypothesis import strategies as st
from measure import SYSTEMS, UNIT, apart, twin

from jaxnh.maps.build import make_strobe
from jaxnh.orbits.newton import find_orbit, solve3
from jaxnh.orbits.shooting import refine_doubling, segment, solve_cyclic
from jaxnh.solvers import SPLITTINGS

FINEST = max(SPLITTINGS.values(), key=lambda solver: solver.convergence_order)
# Error of one period by 150 steps of order ten near the attractors of b from 5.4 to 5.9, and of its derivatives relative
# to the largest of them: roundings. `test_map_is_fine_enough` has it from the reference.
MAP_ERROR = 3e-12
# Attractors of period 1, 2 and 4, well between the doublings.
ORBITS = {
    "constant": [(5.58, 1), (5.505, 2), (5.491, 4)],
    "disturbed": [(5.85, 1), (5.78, 2), (5.76, 4)],
}
DOUBLINGS = {"constant": [(5.5198, 5.54), (5.4956, 5.505)], "disturbed": [(5.8054, 5.83), (5.768, 5.78)]}


@pytest.fixture(scope="module")
def strobes():
    return {name: make_strobe(SYSTEMS[name], FINEST, 150) for name in ORBITS}


def attractor(name, b, n):
    """The stable orbit of period n at b, by the reference alone: (n, 3)."""
    par = twin(SYSTEMS[name])
    end = taylor.attractor(par, b, par.start(), 300)[0]
    return taylor.periodic_orbit(par, n, b, taylor.orbit(par, n, b, end))


def monodromy_of(name, b, points):
    """∂Pⁿ/∂u at the first of the points, by the reference."""
    product = np.eye(3)
    for matrix in taylor.strobe_jacobian(twin(SYSTEMS[name]), b, points)[1]:
        product = matrix @ product
    return product.astype(float)


@pytest.mark.parametrize(("name", "b", "n"), [(name, *orbit) for name, orbits in ORBITS.items() for orbit in orbits])
def test_find_orbit(lanes, strobes, name, b, n):
    """From a hundredth off: the point and the monodromy matrix of the reference, up to the error of the map."""
    points = attractor(name, b, n)
    starts = points[:1] + 0.01 * np.array([[1, 0, 0], [0, 1, 0], [0, 0, -1], [1, -1, 1]]) / (4 ** (n - 1))
    orbit = lanes(find_orbit, (strobes[name], np.int32(n)), (starts, {"b": np.full(4, b)}), tile=64)
    exact = monodromy_of(name, b, points)
    spread = n * max(1.0, np.linalg.norm(exact, 2)) * np.linalg.norm(np.linalg.inv(exact - np.eye(3)), 2)
    assert spread < 1e3
    assert np.max(apart(orbit.u, points[0])) < MAP_ERROR * spread
    assert np.max(orbit.residual) < 1e-11  # n periods' roundings; Newton's last step is quadratic
    curvature = 100  # of P, the largest second derivative there
    assert np.max(np.abs(orbit.monodromy - exact)) < curvature * MAP_ERROR * spread * max(1.0, np.linalg.norm(exact, 2))


@pytest.mark.parametrize("name", ORBITS)
def test_map_is_fine_enough(lanes, strobes, name):
    """The error of one period on the orbits of these tests, and of its derivatives relative to the largest of them."""
    u = np.concatenate([attractor(name, b, n) for b, n in ORBITS[name]])
    b = np.concatenate([np.full(n, b) for b, n in ORBITS[name]])
    w = np.random.default_rng(2).normal(size=u.shape)
    ours = lanes(segment, (strobes[name],), (u, w, {"b": b}), tile=64, static=("b",))
    end, first, second = taylor.strobe_hessian(twin(SYSTEMS[name]), b, u)
    bent = np.einsum("nijk,nj->nik", second[:, :, :3, :], w.astype(taylor.REAL))
    assert np.max(apart(ours.image, end)) < MAP_ERROR
    for one, exact in (
        (ours.image_slope, first),
        (ours.carried, np.einsum("nij,nj->ni", first[..., :3], w.astype(taylor.REAL))),
        (ours.carried_slope, bent),
    ):
        assert np.abs(one - exact).max() < MAP_ERROR * np.abs(exact).max()


def test_orbit_need_not_be_stable(lanes, strobes):
    """The period-1 orbit beyond its doubling, where the map itself leaves it: a multiplier below −1, as the reference."""
    b, start = 5.5, attractor("constant", 5.58, 1)
    for value in np.linspace(5.58, b, 9):
        start = taylor.periodic_orbit(twin(SYSTEMS["constant"]), 1, value, start)
    orbit = lanes(find_orbit, (strobes["constant"], np.int32(1)), (start + 0.005, {"b": np.array([b])}), tile=64)
    exact = np.linalg.eigvals(monodromy_of("constant", b, start))
    assert apart(orbit.u[0], start[0]) < 1e-9
    assert exact.real.min() < -1
    # The error of the map, times curvature as above and the condition of an eigenvalue.
    assert abs(np.linalg.eigvals(orbit.monodromy[0]).real.min() - exact.real.min()) < 1e-6


def test_lane_that_finds_nothing_says_so(lanes, strobes):
    """Far from any orbit, and not a number: a residual that is not small, and other lanes are found all the same."""
    point = attractor("constant", 5.58, 1)[0]
    starts = np.array([point + 0.01, [50.0, -80.0, 1.0], [math.nan] * 3, point - 0.01])
    orbit = lanes(find_orbit, (strobes["constant"], np.int32(1)), (starts, {"b": np.full(4, 5.58)}), tile=64)
    assert np.all(apart(orbit.u[[0, 3]], point) < 1e-8)
    assert not np.any(orbit.residual[1:3] < 1e-7)


# ---- linear systems


def well_conditioned(rng, *shape):
    """Random matrices whose singular values lie between 1/2 and 2."""
    u, _, v = np.linalg.svd(rng.normal(size=shape))
    return u * rng.uniform(0.5, 2, shape[:-1])[..., None, :] @ v


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_solve3(seed):
    """Cofactors against LAPACK; the condition number is four at most, and the sums have some twenty terms."""
    rng = np.random.default_rng(seed)
    matrix, right = well_conditioned(rng, 3, 3), rng.normal(size=3)
    expected = np.linalg.solve(matrix, right)
    assert np.abs(np.asarray(solve3(matrix, right)) - expected).max() < 20 * 4**2 * 2 * UNIT * np.linalg.norm(expected)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 6))
def test_solve_cyclic(seed, n, m):
    """Against the dense matrix, to its condition number; A, B of order one, and B close to −1 as it is in use."""
    rng = np.random.default_rng(seed)
    here = rng.normal(size=(n, m, m))
    there = -np.eye(m) + 0.1 * rng.normal(size=(n, m, m))
    slope, right, normal, level = rng.normal(size=(n, m)), rng.normal(size=(n, m)), rng.normal(size=m), rng.normal()
    dense = np.zeros((n * m + 1, n * m + 1))
    for i in range(n):
        rows = slice(i * m, (i + 1) * m)
        after = (i + 1) % n
        dense[rows, rows] += here[i]
        dense[rows, after * m : (after + 1) * m] += there[i]
        dense[rows, -1] = slope[i]
    dense[-1, :m] = normal
    y, beta = solve_cyclic(here, there, slope, right, normal, level)
    ours = np.append(y, beta)
    residual = dense @ ours - np.append(right, level)
    # Backward stable: the residual is rounding, whatever the condition; and the solution is that times the condition.
    scale = np.linalg.norm(dense) * np.linalg.norm(ours) + np.linalg.norm(right)
    assert np.abs(residual).max() < 20 * n * m * UNIT * scale
    expected = np.linalg.solve(dense, np.append(right, level))
    condition = np.linalg.cond(dense)
    assert np.linalg.norm(ours - expected) < 40 * n * m * UNIT * condition * np.linalg.norm(expected)


def test_solve_cyclic_does_not_grow():
    """Sixty-four points whose product of matrices spans 10±80: multiplying it out would lose every digit."""
    rng = np.random.default_rng(9)
    n, m = 64, 3
    basis = np.linalg.qr(rng.normal(size=(n, m, m)))[0]
    here = np.roll(basis, -1, axis=0) @ (np.array([20.0, 0.9, 0.05])[:, None] * np.swapaxes(basis, 1, 2))
    there = np.broadcast_to(-np.eye(m), (n, m, m))
    slope, exact, beta = rng.normal(size=(n, m)), rng.normal(size=(n, m)), 0.7
    right = np.einsum("nij,nj->ni", here, exact) - np.roll(exact, -1, axis=0) + slope * beta
    normal = rng.normal(size=m)
    y, found = solve_cyclic(here, there, slope, right, normal, normal @ exact[0])
    assert abs(found - beta) < 1e-12  # condition of some 1e3, a hundred roundings
    assert np.abs(y - exact).max() < 1e-12


# ---- doubling points


@pytest.mark.parametrize("name", DOUBLINGS)
@pytest.mark.parametrize("level", [0, 1])
def test_refine_doubling(lanes, strobes, name, level):
    """b where a period-1 and a period-2 orbit double, and the orbit and its vector there, as the reference has them."""
    n = 2**level
    guess, before = DOUBLINGS[name][level]
    points = attractor(name, before, n)
    for b in np.linspace(before, guess, 5):
        points = taylor.periodic_orbit(twin(SYSTEMS[name]), n, b, points)
    exact, _, info = taylor.doubling_point(twin(SYSTEMS[name]), n, guess, points[0])
    vectors = taylor.eigenvector(taylor.strobe_jacobian(twin(SYSTEMS[name]), guess, points, real=np.float64)[1])[1]

    def segments(u, w, b):
        return lanes(segment, (strobes[name],), (u, w, {"b": b}), tile=64, static=("b",))

    found = refine_doubling(segments, points, vectors.astype(float), guess)
    assert found.converged
    sensitivity = info.error / (64 * np.finfo(taylor.REAL).eps)  # of b to the shooting equations, or a little more
    assert abs(found.value - exact) < MAP_ERROR * sensitivity
    assert np.max(apart(found.orbit, info.points)) < 1e-8
    assert abs(np.linalg.norm(found.vector[0]) - 1) < 1e-12
    along = np.abs((found.vector * info.vectors).sum()) / np.linalg.norm(found.vector) / np.linalg.norm(info.vectors)
    assert abs(along - 1) < 1e-12
    end = monodromy_of(name, found.value, found.orbit) @ found.vector[0]
    assert np.abs(end + found.vector[0]).max() < 1e-7


def test_refine_doubling_that_is_not_there(lanes, strobes):
    """From a point where nothing doubles within Newton's steps: not converged, or b somewhere else; never a false one."""
    points = attractor("constant", 5.58, 1)

    def segments(u, w, b):
        return lanes(segment, (strobes["constant"],), (u, w, {"b": b}), tile=64, static=("b",))

    found = refine_doubling(segments, points + 0.5, np.array([[0.0, 0.0, 1.0]]), 3.0)
    assert not found.converged or has_multiplier_minus_one("constant", found)


def has_multiplier_minus_one(name, found):
    return np.abs(np.linalg.eigvals(monodromy_of(name, found.value, found.orbit)) + 1).min() < 1e-6
