"""Periodic orbits and doubling points against the Taylor reference, and their linear systems against dense solutions."""

from __future__ import annotations

import math
from unittest import mock

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxnh.analyses.periodic.newton_on_lanes import images, least_period, orbits
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import Derivatives, derivatives
from jaxnh.orbits import cyclic
from jaxnh.orbits.bifurcations.doubling_points import doubling_function, doubling_point, follow_branch, refine_doubling
from jaxnh.orbits.newton import find_doubled, find_orbits
from jaxnh.orbits.shooting import close_orbits
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import CHART
from tests.flows.particle import SYSTEMS, twin
from tests.helpers import taylor
from tests.helpers.kept_programs import lanes_with_kept_programs
from tests.helpers.measurement import UNIT, largest_difference

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
    return {name: make_return_map(SYSTEMS[name], FINEST, 150) for name in ORBITS}


def attractor(name, b, n):
    """The stable orbit of period n at b, by the reference alone: (n, 3)."""
    par = twin(SYSTEMS[name])
    end = taylor.attractor(par, b, par.start(), 300)[0]
    return taylor.periodic_orbit(par, n, b, taylor.orbit(par, n, b, end))


def period_of(lanes, strobe):
    """P and ∂P/∂u at points (lanes, 3) and b (lanes,), as multiple shooting asks for them."""
    return lambda u, b: lanes(derivatives, (strobe, np.int32(1)), (u, {"b": b}), tile=64)


def monodromy_of(name, b, points):
    """∂Pⁿ/∂u at the first of the points, by the reference."""
    product = np.eye(3)
    for matrix in taylor.strobe_jacobian(twin(SYSTEMS[name]), b, points)[1]:
        product = matrix @ product
    return product.astype(float)


@pytest.mark.parametrize(("name", "b", "n"), [(name, *orbit) for name, orbits in ORBITS.items() for orbit in orbits])
def test_find_orbits(lanes, strobes, name, b, n):
    """From a hundredth off: the point and the monodromy matrix of the reference, up to the error of the map."""
    points = attractor(name, b, n)
    starts = points[:1] + 0.01 * np.array([[1, 0, 0], [0, 1, 0], [0, 0, -1], [1, -1, 1]]) / (4 ** (n - 1))
    orbit = orbits(lanes, strobes[name], starts, {"b": np.full(4, b)}, n)
    exact = monodromy_of(name, b, points)
    spread = n * max(1.0, np.linalg.norm(exact, 2)) * np.linalg.norm(np.linalg.inv(exact - np.eye(3)), 2)
    assert spread < 1e3
    assert np.max(largest_difference(orbit.u, points[0])) < MAP_ERROR * spread
    assert np.max(orbit.residual) < 1e-11  # n periods' roundings; Newton's last step is quadratic
    curvature = 100  # of P, the largest second derivative there
    assert np.max(np.abs(orbit.monodromy - exact)) < curvature * MAP_ERROR * spread * max(1.0, np.linalg.norm(exact, 2))


@pytest.mark.parametrize("name", ORBITS)
def test_map_is_fine_enough(lanes, strobes, name):
    """The error of one period on the orbits of these tests, and of its derivatives relative to the largest of them."""
    u = np.concatenate([attractor(name, b, n) for b, n in ORBITS[name]])
    b = np.concatenate([np.full(n, b) for b, n in ORBITS[name]])
    image, monodromy, _ = period_of(lanes, strobes[name])(u, b)
    end, first, _ = taylor.strobe_jacobian(twin(SYSTEMS[name]), b, u)
    assert np.max(largest_difference(image, end)) < MAP_ERROR
    assert np.abs(monodromy - first).max() < MAP_ERROR * np.abs(first).max()


def test_one_program_for_all_refinements(lanes, strobes):
    """A table as large as that of twice the steps: the same program as that map, and bit for bit the same derivatives."""
    one, finer = strobes["constant"], make_return_map(SYSTEMS["constant"], FINEST, 300)
    roomy = one.padded_like(finer)
    assert jax.tree.map(np.shape, roomy) == jax.tree.map(np.shape, finer) != jax.tree.map(np.shape, one)
    u, b = np.random.default_rng(3).uniform(-1, 1, (8, 3)), np.linspace(5.4, 5.6, 8)
    for ours, exact in zip(period_of(lanes, roomy)(u, b)[:2], period_of(lanes, one)(u, b)[:2], strict=True):
        assert ours.tobytes() == exact.tobytes()


def test_orbit_need_not_be_stable(lanes, strobes):
    """The period-1 orbit beyond its doubling, where the map itself leaves it: a multiplier below −1, as the reference."""
    b, start = 5.5, attractor("constant", 5.58, 1)
    for value in np.linspace(5.58, b, 9):
        start = taylor.periodic_orbit(twin(SYSTEMS["constant"]), 1, value, start)
    orbit = orbits(lanes, strobes["constant"], start + 0.005, {"b": np.array([b])}, 1)
    exact = np.linalg.eigvals(monodromy_of("constant", b, start))
    assert largest_difference(orbit.u[0], start[0]) < 1e-9
    assert exact.real.min() < -1
    # The error of the map, times curvature as above and the condition of an eigenvalue.
    assert abs(np.linalg.eigvals(orbit.monodromy[0]).real.min() - exact.real.min()) < 1e-6


def test_lane_that_finds_nothing_says_so(lanes, strobes):
    """Far from any orbit, and not a number: a residual that is not small, and other lanes are found all the same."""
    point = attractor("constant", 5.58, 1)[0]
    starts = np.array([point + 0.01, [50.0, -80.0, 1.0], [math.nan] * 3, point - 0.01])
    orbit = orbits(lanes, strobes["constant"], starts, {"b": np.full(4, 5.58)}, 1)
    assert np.all(largest_difference(orbit.u[[0, 3]], point) < 1e-8)
    assert not np.any(orbit.residual[1:3] < 1e-7)


def test_newton_as_one_program(lanes, strobes):
    """As a card takes all steps at once: the host's orbits and numbers of steps, and least periods, lost lanes too."""
    points = attractor("constant", 5.505, 2)
    starts = np.concatenate([points[:1] + 0.003 * np.arange(4)[:, None], [[50.0, -80.0, 1.0], [math.nan] * 3]])
    p, n, size = {"b": np.full(6, 5.505)}, np.array([2, 4, 1, 6, 2, 2]), np.ones_like(starts)
    host = orbits(lanes, strobes["constant"], starts, p, n)
    periods = least_period(lanes, strobes["constant"], points[[0] * 6], p, 2 * n, size)
    with mock.patch.object(LaneExecutor, "on_card", property(lambda self: True)):
        found = orbits(lanes, strobes["constant"], starts, p, n)
        least = least_period(lanes, strobes["constant"], points[[0] * 6], p, 2 * n, size)
    assert list(host.residual < 1e-9) == list(found.residual < 1e-9) == [True, True, True, True, False, False]
    assert list(host.steps) == list(found.steps)
    assert list(periods) == list(least) == [2, 2, 2, 2, 2, 2]
    there = host.residual < 1e-9
    np.testing.assert_allclose(found.u[there], host.u[there], rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.monodromy[there], host.monodromy[there], rtol=0, atol=1e-8)


@pytest.mark.parametrize("n", [1, 16])
def test_lanes_do_not_wait_and_do_not_feel_each_other(lanes, strobes, n):
    """Looks are as many as the lanes' own steps, and each lane alone comes to the same bits as in company."""
    point, looks = attractor("constant", 5.58, 1)[0], []

    def recording(function, shared, given, **options):
        looks.append(len(given[0]))
        return lanes(function, shared, given, **options)

    recording.on_card = lanes.on_card
    starts = point + np.array([[0.0], [1e-10], [1e-3], [0.02], [0.1], [40.0]])
    values = np.full(len(starts), 5.58)
    found = orbits(recording, strobes["constant"], starts, {"b": values}, n)
    assert looks == [np.count_nonzero(found.steps >= k) for k in range(found.steps.max() + 1)]
    assert len(set(found.steps)) > 2
    for k in range(len(starts)):
        alone = orbits(lanes, strobes["constant"], starts[k : k + 1], {"b": values[:1]}, n)
        for ours, other in zip(alone, found, strict=True):
            np.testing.assert_array_equal(ours[0], other[k])


# ---- linear systems


def well_conditioned(rng, *shape):
    """Random matrices whose singular values lie between 1/2 and 2."""
    u, _, v = np.linalg.svd(rng.normal(size=shape))
    return u * rng.uniform(0.5, 2, shape[:-1])[..., None, :] @ v


def reversed_cycle(blocks):
    """The equations M_i w_i = w_{i+1} with w_n = −w_0: blocks (..., n, m, m)."""
    there = np.zeros_like(blocks)
    there[:] = -np.eye(blocks.shape[-1])
    there[..., -1, :, :] *= -1.0
    return cyclic.eliminate(blocks, there)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 6))
def test_cyclic_solution(seed, n, m):
    """Two systems side by side, each against its dense matrix, to its condition number; B close to −1 as it is in use."""
    rng = np.random.default_rng(seed)
    here = rng.normal(size=(2, n, m, m))
    there = -np.eye(m) + 0.1 * rng.normal(size=(2, n, m, m))
    right = rng.normal(size=(2, n, m))
    ours = cyclic.solve(cyclic.eliminate(here, there), right)
    for k in range(2):
        dense = np.zeros((n * m, n * m))
        for i in range(n):
            rows, after = slice(i * m, (i + 1) * m), (i + 1) % n
            dense[rows, rows] += here[k, i]
            dense[rows, after * m : (after + 1) * m] += there[k, i]
        residual = dense @ ours[k].ravel() - right[k].ravel()
        # Backward stable: the residual is rounding, whatever the condition; the solution is that times the condition.
        scale = np.linalg.norm(dense) * np.linalg.norm(ours[k]) + np.linalg.norm(right[k])
        assert np.abs(residual).max() < 20 * n * m * UNIT * scale
        expected = np.linalg.solve(dense, right[k].ravel())
        condition = np.linalg.cond(dense)
        assert np.linalg.norm(ours[k].ravel() - expected) < 40 * n * m * UNIT * condition * np.linalg.norm(expected)


def contracting_blocks(rng, n):
    """∂P/∂u of n points whose product has multipliers 20ⁿ, 0.9ⁿ, 0.05ⁿ and known directions, and these (n, 3, 3)."""
    basis = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
    along = np.array([20.0, 0.9, 0.05])[:, None]
    return np.roll(basis, -1, axis=0) @ (along * np.swapaxes(basis, 1, 2)), basis


def test_cyclic_solution_does_not_grow():
    """Sixty-four points whose product of matrices spans 10±80: multiplying it out would lose every digit."""
    rng = np.random.default_rng(9)
    here, _ = contracting_blocks(rng, 64)
    exact = rng.normal(size=(64, 3))
    right = np.einsum("nij,nj->ni", here, exact) - np.roll(exact, -1, axis=0)
    y = cyclic.solve(cyclic.eliminate(here, np.broadcast_to(-np.eye(3), here.shape)), right)
    assert np.abs(y - exact).max() < 1e-12  # condition of some 1e3, a hundred roundings


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 6))
def test_cyclic_determinant(seed, n, m):
    """That of the product of well-conditioned matrices and one, sign and all, to its condition."""
    rng = np.random.default_rng(seed)
    blocks = well_conditioned(rng, n, m, m)
    product = np.eye(m)
    for block in blocks:
        product = block @ product
    moduli = np.linalg.svd(product + np.eye(m))[1]
    size = np.prod(np.maximum(moduli, 1e-3)) * (1 + np.linalg.norm(product)) / max(moduli[-1], 1e-3)
    assert abs(cyclic.determinant(reversed_cycle(blocks)) - np.linalg.det(product + np.eye(m))) < 1e4 * n * UNIT * size


def test_multiplier_minus_one_among_large_and_small_ones():
    """A vector that comes back reversed through matrices whose product spans 10±80: found, and the determinant passes 0."""
    here, basis = contracting_blocks(np.random.default_rng(5), 64)
    exact, values = basis[:, :, 1], []
    for factor in (1.0 - 1e-9, 1.0, 1.0 + 1e-9):
        # The middle direction is stretched by 0.9 a point; the last point brings it to −1 in all, or a little off.
        last = np.array([20.0, -factor * 0.9**-63, 0.05])[:, None]
        here[-1] = basis[0] @ (last * basis[-1].T)
        values.append(cyclic.determinant(reversed_cycle(here)))
    assert values[0] * values[2] < 0
    rounding = (
        64 * 20 * 4 * UNIT
    )  # of 64 blocks of size twenty, four roundings each, where the multiplier is of order one
    assert abs(values[1]) < rounding / 1e-9 * abs(values[2])
    here[-1] = basis[0] @ (np.array([20.0, -(0.9**-63), 0.05])[:, None] * basis[-1].T)
    found = cyclic.null_vector(reversed_cycle(here))
    expected = exact * 0.9 ** np.arange(64)[:, None]
    assert min(np.abs(found - expected).max(), np.abs(found + expected).max()) < 1e-11


# ---- doubling points


def test_doubling_function(lanes, strobes):
    """det(M + 1) before and beyond a doubling, as of the reference's monodromy matrix."""
    for n, b, past in ((1, 5.58, False), (2, 5.505, False), (1, 5.505, True)):
        points = attractor("constant", 5.58 if past else b, n)
        for value in np.linspace(5.58 if past else b, b, 9):
            points = taylor.periodic_orbit(twin(SYSTEMS["constant"]), n, value, points)
        found = close_orbits(
            period_of(lanes, strobes["constant"]), points[None].astype(float), np.array([b]), CHART.wrap
        )
        exact = np.linalg.det(monodromy_of("constant", b, points) + np.eye(3))
        assert found.converged[0]
        assert (exact < 0) == past
        assert abs(doubling_function(found)[0] - exact) < 1e-8 * max(1.0, abs(exact))  # as `test_find_orbits` has M


@pytest.mark.parametrize("name", DOUBLINGS)
@pytest.mark.parametrize("level", [0, 1])
def test_doubling_point(lanes, strobes, name, level):
    """b where a period-1 and a period-2 orbit double, and the orbit and its vector there, as the reference has them."""
    n = 2**level
    guess, before = DOUBLINGS[name][level]
    points = attractor(name, before, n).astype(float)
    period = period_of(lanes, strobes[name])
    branch = follow_branch(period, points + 1e-3, before, guess - 0.3 * (before - guess), CHART.wrap)
    found = doubling_point(period, branch, CHART.wrap)
    reference = taylor.orbit(twin(SYSTEMS[name]), n, found.value, found.orbit[0])
    exact, _, info = taylor.doubling_point(twin(SYSTEMS[name]), n, guess, reference[0])
    sensitivity = info.error / (64 * np.finfo(taylor.REAL).eps)  # of b to the shooting equations, or a little more
    assert abs(found.value - exact) < MAP_ERROR * sensitivity
    assert found.error < 1e-11
    assert np.max(largest_difference(found.orbit, info.points)) < 1e-8
    assert abs(np.linalg.norm(found.vector[0]) - 1) < 1e-12
    along = np.abs((found.vector * info.vectors).sum()) / np.linalg.norm(found.vector) / np.linalg.norm(info.vectors)
    assert abs(along - 1) < 1e-12
    end = monodromy_of(name, found.value, found.orbit) @ found.vector[0]
    assert np.abs(end + found.vector[0]).max() < 1e-7


def test_no_doubling_on_the_way(lanes, strobes):
    """The orbit is followed to the end of the range and has not doubled; and from far off no orbit is found at all."""
    points, period = attractor("constant", 5.58, 1).astype(float), period_of(lanes, strobes["constant"])
    assert follow_branch(period, points, 5.58, 5.54, CHART.wrap) is None
    assert follow_branch(period, points + 0.5, 3.0, 2.9, CHART.wrap) is None
    assert follow_branch(period, np.full((1, 3), np.nan), 5.58, 5.4, CHART.wrap) is None


# ---- a map whose doublings are known


def logistic(u, values):
    """x → p x (1 − x) and its derivative, as multiple shooting asks for them."""
    return Derivatives(values[:, None] * u * (1 - u), (values[:, None] * (1 - 2 * u))[..., None], None)


LOGISTIC = [
    3.0,
    1 + math.sqrt(6),
    3.5440903595519228536,
    3.5644072660954325977,
]  # closed forms, and OEIS A086180, A091517


@pytest.mark.parametrize("level", range(4))
def test_doublings_of_the_logistic_map(level):
    """Within the error that is stated, which is rounding; from half way to the doubling before it."""
    n, exact = 2**level, LOGISTIC[level]
    start = exact - 0.4 * (exact - ([2.0, *LOGISTIC])[level])
    x = [0.4]
    for _ in range(4000 + n - 1):
        x.append(start * x[-1] * (1 - x[-1]))
    points = np.array(x[-n:])[:, None]
    branch = follow_branch(logistic, points, start, exact + 0.02 * (exact - start), np.asarray)
    found = doubling_point(logistic, branch, np.asarray)
    assert abs(found.value - exact) <= found.error < 1e-13
    assert follow_branch(logistic, points, start, exact - 0.02 * (exact - start), np.asarray) is None


def test_doubling_of_nearly_the_same_map():
    """The logistic map with its parameter a little larger: its doubling from the known one, to rounding."""
    pair = np.array([[0.85], [0.44]])
    known = doubling_point(logistic, follow_branch(logistic, pair, 3.4, 3.5, np.asarray), np.asarray)
    for more in (1e-12, 1e-7, -1e-4):
        moved = refine_doubling(lambda u, v, more=more: logistic(u, v * (1 + more)), known, np.asarray)
        assert abs(moved.value * (1 + more) - LOGISTIC[1]) <= moved.error < 1e-13
    assert refine_doubling(lambda u, v: logistic(u, 0.0 * v + 2.0), known, np.asarray) is None  # nothing ever doubles


def test_orbit_of_half_the_period_is_not_taken():
    """Newton for two points from near the fixed point comes to rest there; a branch of two points does not go on to it."""
    value, x = 3.2, 1 - 1 / 3.2
    met = close_orbits(logistic, np.array([[[x + 1e-4], [x - 1e-4]]]), np.array([value]), np.asarray)
    assert met.converged[0]
    assert np.ptp(met.points) < 1e-9
    root = math.sqrt((value + 1) * (value - 3))
    pair = np.array([[(value + 1 + root) / (2 * value)], [(value + 1 - root) / (2 * value)]])
    assert follow_branch(logistic, pair, value, 2.9, np.asarray) is None  # back to its birth at 3, and no further


def test_an_orbit_at_zero_to_rounding():
    """u → −u where a processor takes the smallest numbers for zero: Newton's steps then halve them, and come to no end."""

    def flushing(u, _):
        image = np.where(np.abs(u) < np.finfo(float).tiny, 0.0, -u)
        return Derivatives(image, np.full((len(u), 1, 1), -1.0), None)

    met = close_orbits(flushing, np.array([[[3.4e-311]], [[1e-30]]]), np.zeros(2), np.asarray)
    assert met.converged.all()
    assert np.abs(met.points).max() < 1e-40


@pytest.mark.slow
def test_newton_in_sizes_of_the_motion(lanes, strobes):
    """Both Newtons find the same orbit whatever the sizes, in whose units its residual is."""
    points = attractor("constant", 5.505, 2)[:1]
    b, size = {"b": np.array([5.505])}, np.array([[4.0, 0.5, 2.0]])
    near = points + 1e-3

    def at(n):
        return images(lanes, strobes["constant"], b, np.array([n], np.int32))

    sizes = np.ones_like(size), size
    plain, sized = (find_orbits(at(2), near, one, CHART.wrap) for one in sizes)
    assert np.abs(plain.u - sized.u).max() < 1e-11
    plain, sized = (find_doubled(at(1), plain.u, one, CHART.wrap) for one in sizes)
    assert np.isfinite(plain.residual).all() == np.isfinite(sized.residual).all()
    assert np.abs(plain.u - sized.u).max() < 1e-11
    assert np.abs(plain.monodromy - sized.monodromy).max() < 1e-9 * np.abs(plain.monodromy).max()


@pytest.mark.parametrize("tile", [8, 16, 64])
def test_place_in_a_tile_changes_no_bit(tile):
    """Of the derivatives: whatever the compiler makes of what comes after the loop over periods, for the lanes of a tile."""
    runner, rng, count = lanes_with_kept_programs(None, jax.devices()[:1]), np.random.default_rng(0), 8 * tile
    strobe = make_return_map(SYSTEMS["constant"], SPLITTINGS["processed6"], 60)
    n, order = rng.integers(1, 17, count).astype(np.int32), rng.permutation(count)
    u, p = rng.uniform(-1, 1, (count, 3)), {"b": rng.uniform(4, 6, count), "a": rng.uniform(0.4, 0.6, count)}
    here = runner(derivatives, (strobe,), (n, u, p), tile=tile)
    moved = {name: values[order] for name, values in p.items()}
    there = runner(derivatives, (strobe,), (n[order], u[order], moved), tile=tile)
    for one, other in zip(here[:2], there[:2], strict=True):
        assert one[order].tobytes() == other.tobytes()
