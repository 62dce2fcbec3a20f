"""Bifurcations against maps and flows where they are known in closed form, and folds of a resonance against scipy."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.analyses.continuation.families import equilibrium_family, orbit_family
from jaxnh.analyses.continuation.family_tree import Bifurcation, SeedOrbit, grow, new_bifurcations
from jaxnh.analyses.periodic.location import refined_maps
from jaxnh.maps.iterate import Derivatives
from jaxnh.orbits.bifurcations.location import brackets
from jaxnh.orbits.continuation.arclength import Family
from jaxnh.orbits.continuation.kinds import KINDS
from jaxnh.orbits.continuation.paths import ENDS, STEPS, StepControl
from jaxnh.orbits.multipliers import merged, multipliers
from jaxnh.solvers import verner9
from jaxnh.systems.first_order import first_order
from tests.flows.duffing_resonance import by_scipy, duffing
from tests.flows.logistic_map import LOGISTIC, logistic, logistic_orbit
from tests.helpers.batches import batch_of
from tests.helpers.cases import some_slow


def named(tree):
    """Kind, period and parameter of all bifurcations, in the order of the parameter."""
    points = sorted(tree.bifurcations, key=lambda point: point.value)
    return [(KINDS[point.kind], len(point.points)) for point in points], points


# ---- a map

DOUBLINGS = [3.0, 1 + np.sqrt(6), 3.5440903595519228536, 3.5644072660954325977, 3.5687594195438264349]


def test_cascade_of_the_logistic_map():
    """From period 1 alone: doubled branches of doubled branches, each with its doubling, up to the limit of periods."""
    orbits = [SeedOrbit(np.array(logistic_orbit(1, 2.8)), 2.8)]
    tree = grow([LOGISTIC] * 3, [orbits], 16, STEPS)
    kinds, points = named(tree)
    assert kinds == [("period_doubling", 2**k) for k in range(5)]
    assert [branch.period for branch in tree.branches] == [2**k for k in range(5)]
    for point, exact in zip(points, DOUBLINGS, strict=True):
        assert abs(point.value - exact) < min(1e-13, point.error + 5e-16)
        assert abs(point.multipliers[0] + 1) < 1e-8
        assert point.criticality == 1  # where the orbit loses its stability, the doubled one takes it over
    # Kuznetsov's c = (C + 3 B (1 − A)⁻¹ B)/6 with A = −1, B = −2p = −6, C = 0; differences of a line are exact.
    assert abs(points[0].coefficient + 9.0) < 1e-9
    assert not tree.lost
    again = grow([LOGISTIC] * 3, [orbits, [SeedOrbit(np.array(logistic_orbit(4, 3.5)), 3.5)]], 16, STEPS)
    assert len(again.branches) == 5  # the orbit of period 4 is on a branch that is known


def test_window_of_period_three():
    """A fold at 1 + √8 and a doubling beyond, from one orbit; a parent is found from its child."""
    tree = grow([LOGISTIC] * 3, [[SeedOrbit(np.array(logistic_orbit(3, 3.835)), 3.835)]], 3, STEPS)
    kinds, points = named(tree)
    assert kinds == [("fold", 3), ("period_doubling", 3)]
    assert abs(points[0].value - (1 + np.sqrt(8))) < 1e-13
    assert points[0].coefficient > 0  # the branch lies above
    ends = [SeedOrbit(tree.branches[0].points[end], 3.9) for end in (0, -1)]  # where it leaves the range, on both sides
    again = grow([LOGISTIC] * 3, [[SeedOrbit(np.array(logistic_orbit(3, 3.835)), 3.835)], ends], 3, STEPS)
    assert len(again.branches) == 1
    tree = grow([LOGISTIC] * 3, [[SeedOrbit(np.array(logistic_orbit(2, 3.3)), 3.3)]], 2, STEPS)
    assert [branch.period for branch in tree.branches] == [2, 1]


@pytest.mark.parametrize("steepness", [20.0, 200.0, 2e5])
def test_multiplier_that_changes_within_a_small_part_of_a_step(steepness):
    """u → (tanh(s(μ − 1/π)) − 1) u + u³: a doubling at μ = 1/π, and no polynomial follows the multiplier over a step."""

    def period(u, mu):
        x, bent = u[:, 0], np.tanh(steepness * (mu - 1 / np.pi))
        slope = (bent - 1.0 + 3.0 * x**2)[:, None, None]
        return Derivatives(((bent - 1.0) * x + x**3)[:, None], slope, (steepness * (1.0 - bent**2) * x)[:, None])

    family = Family(period, lambda gap: gap, np.ones(1), 0.0, 1.0)
    tree = grow([family] * 3, [[SeedOrbit(np.zeros((1, 1)), 0.0)]], 1, StepControl(0.05))
    kinds, points = named(tree)
    assert kinds == [("period_doubling", 1)]
    assert not tree.lost
    assert abs(points[0].value - 1 / np.pi) <= points[0].error < 1e-9


STEEPNESS = 1e4


def turning_within_a_step(off):
    """The map of the next tests, with z = g(x) + off."""

    def bend(x):
        return 0.1 * np.sin(10.0 * x), np.cos(10.0 * x)

    def period(u, mu):
        x, z, _ = u.T
        image, slope = x + STEEPNESS * (mu - x * x), 1.0 - 2.0 * STEEPNESS * x
        (now, rate), (then, after) = bend(x), bend(image)
        now, then = now + off, then + off
        matrix = np.zeros((len(u), 3, 3))
        matrix[:, 0, 0], matrix[:, 1, 0], matrix[:, 1, 1] = slope, after * slope - 0.5 * rate, 0.5
        matrix[:, 2, 0], matrix[:, 2, 1] = -2e6 * (z - now) * rate, 2e6 * (z - now)
        both = np.stack([image, then + 0.5 * (z - now), 1e6 * (z - now) ** 2], axis=1)
        return Derivatives(both, matrix, STEEPNESS * np.stack([np.ones(len(u)), after, np.zeros(len(u))], axis=1))

    return Family(period, lambda gap: gap, np.ones(3), -0.5, 0.5)


@pytest.mark.parametrize("off", [0.0, 3e-4])
def test_a_fold_and_a_doubling_within_a_step(off):
    """x → x + A(μ − x²) beside what comes to z = g(x), y = 0 by halves and at once: a fold at 0, a doubling at 1/A².

    The multiplier of ±√μ is 1 − 2Ax. Newton's first step from a z that is off by δ leaves y wrong by 10⁶ δ², so that
    the second is no shorter where δ is 10⁻⁶, as it is between points of a curve that bends; the third is none. Where z is
    off by 3·10⁻⁴ in finer maps, the first step goes out by more than a chord, and the second comes back.
    """
    families = [turning_within_a_step(each) for each in (0.0, off, 1.01 * off)]
    tree = grow(families, [[SeedOrbit(np.array([[0.5, 0.1 * np.sin(5.0), 0.0]]), 0.25)]], 1, StepControl(0.05))
    kinds, points = named(tree)
    assert kinds == [("fold", 1), ("period_doubling", 1)]
    assert not tree.lost
    for point, exact in zip(points, (0.0, STEEPNESS**-2), strict=True):
        assert abs(point.value - exact) <= point.error < 1e-9


def test_points_that_branches_have_in_common():
    """Those that are kept of several hundred, some of them twice, are those of comparing every two of them."""
    rng = np.random.default_rng(0)
    apart = [
        Bifurcation(int(kind), value, 1e-9, 0, 0, np.array([[x], [1.0 - x]]), np.ones(1, complex), 0.0, 0)
        for kind, value, x in zip(
            rng.integers(0, 3, 150), rng.choice(np.linspace(2.1, 3.8, 40), 150), rng.uniform(size=150), strict=True
        )
    ]
    near = [one._replace(value=one.value + 1e-9, points=one.points[::-1] + 1e-9) for one in apart[::2]]
    points = [[*apart, *near][k] for k in rng.permutation(225)]

    def in_common(one, other):
        close = abs(one.value - other.value) <= 1e-6 * LOGISTIC.width + one.error + other.error
        gaps = [np.linalg.norm(np.roll(one.points, m, 0) - other.points) / np.sqrt(2) for m in range(2)]
        return one.kind == other.kind and close and min(gaps) <= 1e-4

    kept = list[int]()
    for k, point in enumerate(points):
        if not any(in_common(point, points[other]) for other in kept):
            kept.append(k)
    assert len(kept) == 150
    assert new_bifurcations(LOGISTIC, [], points) == kept
    assert new_bifurcations(LOGISTIC, [points[k] for k in kept], points) == []


@pytest.mark.parametrize("step", [0.05, 0.002])
@pytest.mark.parametrize("shift", [1e-4, 1e-2])
def test_bifurcations_that_finer_maps_have_steps_away(shift, step):
    """Maps whose parameter is off by δ, δ/16 and δ/256: doublings at 3 less these, up to five steps of a branch apart."""
    families = [
        LOGISTIC._replace(period=lambda u, p, off=off: logistic(u, p + off)) for off in (shift, shift / 16, shift / 256)
    ]
    tree = grow(families, [[SeedOrbit(np.array([[1 - 1 / 2.95]]), 2.95)]], 1, StepControl(step, 100))
    assert named(tree)[0] == [("period_doubling", 1)]
    assert not tree.lost
    [point] = tree.bifurcations
    assert point.value == pytest.approx(3.0 - shift / 16, abs=1e-9)
    assert abs(point.value - 3.0) <= point.error <= 1.1 * shift


def test_a_change_of_sign_that_finer_maps_do_not_have_is_kept_with_its_bracket():
    """Maps of more steps with p = 2.5 + (p − 2)/8 come to no doubling below the end of the range, 3.9."""
    less = LOGISTIC._replace(period=lambda u, p: logistic(u, 2.5 + 0.125 * (p - 2.0)))
    tree = grow([LOGISTIC, less, less], [[SeedOrbit(np.array([[1 - 1 / 2.9]]), 2.9)]], 1, StepControl(0.05, 20))
    assert not tree.bifurcations
    [change] = tree.lost
    value = tree.branches[change.branch].value[change.place : change.place + 2]
    assert KINDS[change.kind] == "period_doubling"
    assert value.min() < 3.0 < value.max()


def test_a_neutral_saddle_is_no_change_of_sign_that_is_lost():
    """u → (1e5 x, 2e-5 μ y): the product of two real multipliers is one at μ = 1/2, where nothing bifurcates."""

    def period(u, mu):
        matrix = np.zeros((len(u), 2, 2))
        matrix[:, 0, 0], matrix[:, 1, 1] = 1e5, 2e-5 * mu
        return Derivatives((matrix @ u[..., None])[..., 0], matrix, np.stack([0.0 * mu, 2e-5 * u[:, 1]], axis=1))

    family = Family(period, lambda gap: gap, np.ones(2), 0.25, 1.0)
    tree = grow([family] * 3, [[SeedOrbit(np.zeros((1, 2)), 0.25)]], 1, StepControl(0.05))
    assert brackets(family, tree.branches) is None
    assert not tree.bifurcations
    assert not tree.lost


def test_branch_between_two_doublings_is_one():
    """With p = 2 + 1.3 (1 − q²) over q: two doublings of period 1 at p = 3, and the same doubled orbits from both."""

    def bubble(u, q):
        p = 2 + 1.3 * (1 - q**2)
        found = LOGISTIC.period(u, p)
        return found._replace(by_parameter=found.by_parameter * (-2.6 * q)[:, None])

    family = LOGISTIC._replace(period=bubble, low=-1.0, high=1.0)
    tree = grow([family] * 3, [[SeedOrbit(np.array([[0.5]]), -0.95)]], 2, STEPS)
    kinds, points = named(tree)
    assert kinds == [("period_doubling", 1)] * 2
    assert [point.value for point in points] == pytest.approx([-np.sqrt(3 / 13), np.sqrt(3 / 13)], abs=1e-13)
    assert [branch.period for branch in tree.branches] == [1, 2]


def test_doubled_branch_of_a_motion_that_is_small_beside_others():
    """Sizes of thirty: the doubled orbit, whose x leaves as √(p − 3), bends too soon for all but the nearest distances."""
    family = LOGISTIC._replace(size=np.full(1, 30.0))
    tree = grow([family] * 3, [[SeedOrbit(np.array(logistic_orbit(1, 2.8)), 2.8)]], 2, STEPS)
    assert [branch.period for branch in tree.branches] == [1, 2]
    assert tree.branches[1].value.max() == 3.9
    p, gap = tree.branches[1].value, np.diff(tree.branches[1].points[:, :, 0], axis=1).ravel()
    last = 1e-6 * 30.0  # step of Newton in x: its square is left, times half the second derivative 2p of each P, p < 4
    assert np.abs(gap**2 - (1 - 3 / p) * (1 + 1 / p)).max() < 8 * last**2


def test_multipliers_far_apart():
    """Moduli from 10^±20 and a complex pair, from eight matrices; the product alone has none of the small ones."""
    rng = np.random.default_rng(8)
    basis = np.linalg.qr(rng.normal(size=(8, 4, 4)))[0]
    core = np.zeros((4, 4))
    core[0, 0], core[3, 3] = 10**2.5, -(10**-2.5)
    core[1:3, 1:3] = 0.9 * np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    blocks = np.roll(basis, -1, axis=0) @ core @ np.swapaxes(basis, 1, 2)
    pair = 0.9**8 * np.exp(2.4j)
    exact = np.array([1e20, pair.conj(), pair, 1e-20])
    assert np.all(np.abs(multipliers(blocks) - exact) < 1e-11 * np.abs(exact))


def test_products_of_many_blocks_keep_small_multipliers():
    """Blocks S_{i+1} D S_i⁻¹ around a circle of bases have the multipliers D^n, here over 200 decades."""
    rng = np.random.default_rng(3)
    diagonal = np.array([1.01, 0.99, 0.75, 0.55])
    bases = np.linalg.qr(rng.normal(size=(2, 900, 4, 4)))[0] @ (np.eye(4) + 0.1 * np.triu(np.ones((4, 4)), 1))
    blocks = np.roll(bases, -1, axis=1) @ (diagonal[:, None] * np.linalg.inv(bases))
    fewer = merged(blocks)
    assert fewer.shape[1] < blocks.shape[1] / 4
    logarithms = np.log(np.abs(multipliers(fewer)))
    np.testing.assert_allclose(logarithms, np.tile(900 * np.log(diagonal), (2, 1)), rtol=0.0, atol=1e-9)


def test_products_of_blocks_that_are_not_finite():
    blocks = np.broadcast_to(np.eye(2), (2, 10, 2, 2)).copy()
    blocks[0, 4] = np.nan
    values = multipliers(merged(blocks))
    assert np.isnan(values[0]).all()
    np.testing.assert_allclose(values[1], 1.0)


# ---- flows with a clock whose bifurcations are known; one period is a unit of time, and a map is exact to roundings


def definition(rates, names):
    def define(mu=0.0):
        return {"rhs": lambda y, t: rates(*y, mu), "coordinates": names, "period": 1.0}

    return define


def swirl(cubic):
    """z' = (μ + 2i) z + cubic |z|² z, and a little z², which does nothing to the first order in which it matters."""

    def rates(x, y, mu):
        square = x * x + y * y
        return mu * x - 2.0 * y + cubic * square * x, mu * y + 2.0 * x + cubic * square * y

    return rates


NORMAL_FORMS = {
    # rates, coordinates, an orbit at a value, kind, cubic coefficient a unit of time
    "fold": (lambda x, mu: (mu - x * x,), "x", [0.5], 0.25, "fold", None),
    "pitchfork": (lambda x, mu: (mu * x - x**3,), "x", [0.0], -0.3, "branch_point", -1.0),
    "subcritical pitchfork": (lambda x, mu: (mu * x + x**3,), "x", [0.0], -0.3, "branch_point", 1.0),
    # |z|² of the real vector (Re ζq, …) with |q| = 1 is twice |ζ|²
    "torus": (swirl(-1.0), "xy", [0.0, 0.0], -0.3, "neimark_sacker", -2.0),
    "subcritical torus": (swirl(0.5), "xy", [0.0, 0.0], -0.3, "neimark_sacker", 1.0),
}


@pytest.mark.parametrize("name", some_slow({name: name for name in NORMAL_FORMS}, "fold", "pitchfork"))
def test_normal_forms(lanes, name):
    """At μ = 0 each, with the coefficient and criticality of the flow's own equation."""
    rates, names, u, value, kind, coefficient = NORMAL_FORMS[name]
    flow = first_order(definition(rates, tuple(names)), {"mu": 0.0})
    start = flow.start(dict.fromkeys(names, 0.0))
    scene = batch_of(flow, start, [-0.5, 0.71], verner9, 16, name="mu")
    families = [orbit_family(scene, lanes, strobe, np.ones(len(names)), (-0.5, 0.71)) for strobe in refined_maps(scene)]
    tree = grow(families, [[SeedOrbit(np.array([u]), value)]], 2, STEPS)
    [point] = tree.bifurcations
    assert KINDS[point.kind] == kind
    assert abs(point.value) < min(1e-8, 2 * point.error)
    if coefficient is None:
        assert abs(point.coefficient * 1.21 - 2.0) < 1e-3  # μ = x² along x, in widths of the range; a third-degree fit
        return
    # Differences over h = 10⁻³ leave h² of the fifth order.
    assert abs(point.coefficient - coefficient) < 1e-4
    assert point.criticality == (1 if coefficient < 0 else -1)
    if kind != "branch_point":
        return
    [both] = [branch for branch in tree.branches if np.abs(branch.points).max() > 1e-3]
    x = both.points[:, 0, 0]  # ±√(∓μ), through the pitchfork from end to end
    assert np.abs(x**2 - np.abs(both.value)).max() < 1e-10
    assert x[0] == pytest.approx(-x[-1], abs=1e-10)
    assert len(tree.branches) == 2


def test_hopf(lanes):
    """Equilibria of a flow without a clock: z' = (μ + 2i) z − |z|² z beside w' = −w, at μ = 0 with coefficient −2."""

    def define(mu=0.0):
        def rhs(y, t):
            return (*swirl(-1.0)(y[0], y[1], mu), -y[2])

        return {"rhs": rhs, "coordinates": ("x", "y", "w")}

    flow = first_order(define, {"mu": 0.0})
    scene = batch_of(flow, flow.start({"x": 0.0, "y": 0.0, "w": 0.0}), [-0.5, 0.71], verner9, 16, name="mu")
    family = equilibrium_family(scene, lanes, np.ones(3), (-0.5, 0.71))
    tree = grow([family] * 3, [[SeedOrbit(np.zeros((1, 3)), -0.3)]], 1, STEPS)
    [point] = tree.bifurcations
    assert KINDS[point.kind] == "hopf"
    assert abs(point.value) < 1e-13
    assert np.abs(np.sort_complex(point.multipliers) - [-1, -2j, 2j]).max() < 1e-12
    assert abs(point.coefficient + 2.0) < 1e-6
    assert point.criticality == 1


# ---- Duffing's resonance


def fold_by_scipy(omega, u):
    """(ω, u): Newton on P(u) = u and det(∂P/∂u − 1) = 0 by DOP853 and variational equations."""

    def mismatch(at):
        image, matrix = by_scipy(at[0], at[1:])
        return np.append(image - at[1:], np.linalg.det(matrix - np.eye(2)))

    at = np.array([omega, *u])
    # Slopes of the first point do for all: it is known to some eight digits, and each step gains as many less three.
    slopes = np.array([(mismatch(at + h) - mismatch(at - h)) / 2e-5 for h in 1e-5 * np.eye(3)]).T
    for _ in range(3):
        at = at - np.linalg.solve(slopes, mismatch(at))
    return at[0]


@pytest.mark.slow
def test_folds_of_duffings_resonance(lanes):
    """Both ends of the bistable range of frequencies, to 1e-8 of scipy's and within their errors; nothing else is there."""
    flow = first_order(duffing, {"omega": 1.0})
    scene = batch_of(flow, flow.start({"x": 0.0, "v": 0.0}), [0.6, 2.0], verner9, 48, name="omega")
    families = [orbit_family(scene, lanes, strobe, np.ones(2), (0.6, 2.0)) for strobe in refined_maps(scene)]
    tree = grow(families, [[SeedOrbit(np.array([[0.22, 0.01]]), 0.6)]], 1, STEPS)
    kinds, points = named(tree)
    assert kinds == [("fold", 1), ("fold", 1)]
    assert [np.sign(point.coefficient) for point in points] == [1.0, -1.0]
    for point in points:
        exact = fold_by_scipy(point.value, point.points[0])
        # scipy's own error, of tolerances of 1e-13 over some fifty steps, and of its differences
        assert abs(point.value - exact) < min(1e-8, point.error + 1e-11)
        assert abs(point.multipliers[0] - 1) < 1e-5  # it goes through one like a root
    assert {ENDS[end] for end in tree.branches[0].ends} == {"range"}
    assert jnp.isfinite(tree.branches[0].residual).all()
