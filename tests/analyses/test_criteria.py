"""Lyapunov spectra, least periods, the 0–1 test and the verdict, against Taylor integration and exact identities."""

from __future__ import annotations

import math

import heyoka as hy
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.analyses import chaos01, verdict
from jaxnh.analyses.batch import LaneBatch
from jaxnh.analyses.exponents import lyapunov
from jaxnh.analyses.exponents.gram_schmidt import gram_schmidt
from jaxnh.analyses.periodic import period
from jaxnh.analyses.periodic.newton_on_lanes import least_period
from jaxnh.analyses.trajectories import diagram
from jaxnh.costs.operations import count
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import section_map
from jaxnh.solvers import SOLVERS, SPLITTINGS
from jaxnh.systems.lagrangian import lagrangian
from jaxnh.systems.particle import constant_speed, disturbed_speed
from tests.helpers import taylor
from tests.helpers.batches import batch_of, broadcast_start
from tests.helpers.cases import some_slow
from tests.helpers.kept_programs import lanes_with_kept_programs

GROWTH_RATES, WITHOUT_PERIOD = jax.jit(chaos01.growth_rates), jax.jit(chaos01.remove_period)
START = ((0.1, 0.1), (0.1, math.sqrt(0.99)))
# (system, its twin in the reference, b of the paper's figures 1 and 6 with their periods, 0: chaotic)
CASES = {
    "constant": (constant_speed(), taylor.Parameters(), {5.8: 1, 2.5: 2, 4.1: 4, 5.3: 0}),
    "disturbed": (disturbed_speed(), taylor.Parameters(d=0.1), {5.9: 1, 2.5: 2, 4.2: 4, 5.6: 0}),
}


@pytest.fixture(scope="module")
def lanes():
    """For the four lanes of a case."""
    return lanes_with_kept_programs(None, jax.devices()[:1], 8)


@pytest.fixture(scope="module", params=some_slow({name: name for name in CASES}, "disturbed"))
def case(request, lanes):
    """A system at the paper's four values: scene, twin, periods, and the groups `period` and `lyapunov`."""
    system, twin, periods = CASES[request.param]
    # The map of one period is right to about 1e-10 with these steps, and so are exponents of periodic orbits.
    scene = batch_of(system, START, list(periods), SPLITTINGS["kahan_li8"], 240, error=1e-10)
    found = period.run(period.PeriodOptions(max_period=16), scene, lanes)
    options = lyapunov.LyapunovOptions(transient=256, periods=512)
    return scene, twin, np.array(list(periods.values())), found, lyapunov.run(options, scene, lanes)


def test_periods_of_the_paper(case):
    """Periods 1, 2, 4 and chaos where the paper's figures 1 and 6 show them."""
    _, _, periods, found, _ = case
    np.testing.assert_array_equal(found["period"].to_numpy(), periods)
    assert np.all(found["residual"].to_numpy()[:3] < 1e-7)


def test_multiple_of_the_period(lanes):
    """A point of the orbits of period 1 at b = 5.8 and 2 at 2.5, met by Newton at a period of 8, is of theirs."""
    strobe = make_return_map(constant_speed(), SPLITTINGS["kahan_li8"], 120)
    b = np.array([5.8, 2.5])
    start, p = constant_speed().chart.host_points(broadcast_start(START, 2)), {"b": b}
    u = lanes(section_map, (strobe, np.int32(400)), (start, p))
    np.testing.assert_array_equal(least_period(lanes, strobe, u, p, 8, np.ones((2, 3))), [1, 2])


def test_exponents_of_periodic_orbits(case):
    """All three exponents are ln|μ|/(nT) of multipliers by an independent Taylor integration, to 1e-6.

    The third multiplier of a period is down to e^−48, below what long double keeps of a monodromy matrix.
    """
    scene, twin, periods, _, group = case
    for i in np.flatnonzero(periods):
        b, n = float(scene.p["b"][i]), int(periods[i])
        points = taylor.orbit(twin, n, b, taylor.attractor(twin, b, twin.start(), 400)[0])
        exact = taylor.multiplier_logs(twin, n, b, points) / (n * float(twin.period))
        np.testing.assert_allclose(group["exponents"].to_numpy()[i], exact, atol=1e-6)


def check_chaotic_spectrum(scene, twin, i, group, lanes, periods):
    """Two finite averages of all three exponents, by Taylor variational equations and by us, agree within their bars.

    The mean of lanes that chaos has parted has as its bar 2.5 standard errors: those of a few lanes are rough.
    """
    starts = twin.start() + 1e-3 * np.arange(lanes)[:, None]
    found = taylor.spectra(twin, np.full(lanes, scene.p["b"][i]), starts, 30, periods)
    bar = 2.5 * found.std(axis=0, ddof=1) / math.sqrt(lanes)
    ours, error = (group[name].to_numpy()[i] for name in ("exponents", "exponents_error"))
    assert np.all(bar[0] < 0.5 * ours[0])  # else the comparison says little
    assert np.all(np.abs(found.mean(axis=0) - ours) < bar + error)


def test_exponents_of_chaos(case):
    """The same at the chaotic values, whose averages are finite."""
    scene, twin, periods, _, group = case
    for i in np.flatnonzero(periods == 0):
        check_chaotic_spectrum(scene, twin, i, group, 16, 60)


@pytest.mark.slow
def test_exponents_of_chaos_over_many_periods(case, lanes):
    """Error bars three times smaller."""
    scene, twin, periods, _, _ = case
    chaotic = scene.take(np.flatnonzero(periods == 0))
    group = lyapunov.run(lyapunov.LyapunovOptions(transient=256, periods=4096), chaotic, lanes)
    check_chaotic_spectrum(chaotic, twin, 0, group, 16, 500)


@pytest.mark.slow
def test_tangents_cost_operations_only_where_asked_for():
    """Operations in the compiled programs, exactly: a diagram has the kicks of the map and no others.

    Each tangent adds to a kick 5 of its drift (a product for δθ · length; a product and a sum for x1 and y1 each) and 5
    of its turn (three products, two sums). What all tangents of a kick share is the product that follows the volume, and
    its slopes: 38 in the program, as equal terms of slopes and kick are computed once. The map's 47 are counted by hand
    in tests/costs/test_effects.py. Gram–Schmidt, once a part of a period, has 12 a vector (5 of its square, root and
    inverse, 3 products, logarithm and half of it) and 11 a pair of them (5 of the overlap, 6 to take it off); to bring
    tangents there and back takes 20 and 16 a tangent (its angle is one of two quotients: four for the tangent, and three for
    all, as n decides which), and how near growth comes to the ends of numbers, and a tangent to the first, another 6 for each:
    for the first too, whose loss to itself XLA does not leave out of a program of one device. Each sum of a period
    has a difference, and a product and a sum in seven smooth averages: 15 for each tangent and for the volume.
    """
    scene = batch_of(constant_speed(), START, [2.0, 3.0], SPLITTINGS["strang2"], 40)
    lanes = LaneExecutor()
    diagram.run(diagram.DiagramOptions(transient=4, strobes=4), scene, lanes)
    kicks = [loop for text in programs(lanes) for loop in innermost(count(text, lanes.tile)) if loop.operations]
    assert len(kicks) == 2  # on the way to the first strobe, and from strobe to strobe
    assert {loop.operations for loop in kicks} == {47.0}
    for k in range(4):
        program = lyapunov.program(scene, k)
        text, tile = lanes.program(program.function, program.shared, program.lanes)
        (period,) = count(text, tile).inner
        if k:
            (part,) = period.inner
            (kick,) = part.inner
            assert kick.operations == 47 + 1 + 38 + 10 * k
            assert part.operations == 20 + 16 * k + 12 * k + 11 * k * (k - 1) / 2 + 6 * k
            assert period.operations == 15 * (k + 1)
        else:
            (kick,) = period.inner
            assert kick.operations == 47


def programs(lanes):
    """The texts of all compiled programs."""
    return lanes.programs.texts()


def innermost(loop):
    """The loops of a program that have none in them."""
    return [deepest for inner in loop.inner for deepest in innermost(inner)] if loop.inner else [loop]


def test_sum_rule(case):
    """The exponents add up to the mean divergence; the map is right to 1e-10, and its growth to a hundred times that."""
    scene, twin, periods, _, group = case
    assert np.abs(group["sum_rule_residual"].to_numpy()).max() < 1e-8
    assert np.abs(group["volume_residual"].to_numpy()).max() < 1e-11  # rounding
    for i in np.flatnonzero(periods):
        b, n = float(scene.p["b"][i]), int(periods[i])
        points = taylor.orbit(twin, n, b, taylor.attractor(twin, b, twin.start(), 400)[0])
        mean = float(taylor.divergence(twin, b, points) / (n * twin.period))
        assert group["transverse"].to_numpy()[i] == pytest.approx(2 * mean, abs=1e-6)


@pytest.mark.slow
def test_sum_rule_sees_integration_errors(lanes):
    """Steps of order 6 that are halved leave some 2⁶ times less; the determinants of the steps see no error at all."""
    b, options = [2.5, 4.1, 5.3], lyapunov.LyapunovOptions(transient=16, periods=32)
    found = {
        steps: lyapunov.run(options, batch_of(constant_speed(), START, b, SPLITTINGS["blanes_moan6"], steps), lanes)
        for steps in (30, 60, 120)
    }
    residual = {steps: np.abs(group["sum_rule_residual"].to_numpy()) for steps, group in found.items()}
    for steps, finer in ((30, 60), (60, 120)):
        # A chaotic lane takes another path with other steps, where errors are others: the regular one shows the order.
        assert residual[steps][0] > 16 * residual[finer][0]
        assert residual[steps].max() > residual[finer].max()
    assert residual[30].max() > 1e-6
    assert all(np.abs(group["volume_residual"].to_numpy()).max() < 1e-11 for group in found.values())


def test_chaos_is_positive_beyond_its_error(case):
    """Where there is no period the largest exponent is positive by more than its error bar; elsewhere negative."""
    _, _, periods, _, group = case
    largest = group["exponents"].to_numpy()[:, 0]
    error = group["exponents_error"].to_numpy()[:, 0]
    assert np.all((largest - error > 0) == (periods == 0))


def test_one_exponent_is_the_largest_of_three(case, lanes):
    """Asked for alone, the largest exponent is the same where it converges to rounding."""
    scene, _, periods, _, group = case
    alone = lyapunov.run(lyapunov.LyapunovOptions(transient=256, periods=512, exponents=1), scene, lanes)
    one = alone["exponents"].to_numpy()[:, 0]
    real = periods > 0
    np.testing.assert_allclose(one[real], group["exponents"].to_numpy()[real, 0], atol=1e-6)
    assert alone["exponents"].to_numpy().shape == (4, 1)


@pytest.mark.parametrize("count", [3, 9], ids=["written out", "in a loop"])
def test_gram_schmidt_is_qr(count):
    """Gram–Schmidt gives numpy's Q up to signs, and the logarithms of |diag R|, of eight lanes each by itself."""
    matrices = np.random.default_rng(5).normal(size=(8, count, count))
    rows = [tuple(jnp.asarray(matrices[:, i, j]) for j in range(count)) for i in range(count)]
    vectors, logs = gram_schmidt(rows)
    for lane, matrix in enumerate(matrices):
        q, r = np.linalg.qr(matrix.T)
        np.testing.assert_allclose(np.array(logs)[:, lane], np.log(np.abs(np.diag(r))), atol=1e-12)
        np.testing.assert_allclose(np.abs(np.array(vectors)[:, :, lane]), np.abs(q.T), atol=1e-12)


def test_programs_that_orthonormalise_many_vectors_are_short():
    """Twelve vectors written out are multiplied by 1,872 equations, which are compiled for seconds."""
    rows = tuple((0.0,) * 12 for _ in range(12))
    assert str(jax.make_jaxpr(gram_schmidt)(rows)).count("= mul ") < 20


def logistic(r, count=1000):
    """Points of the logistic map after as many, of which the first are left out."""
    x = [0.3]
    for _ in range(2 * count):
        x.append(r * x[-1] * (1 - x[-1]))
    return jnp.array(x[count + 1 :])


def growth(signals, scale):
    """Median of K over angles."""
    return np.median(GROWTH_RATES(signals, jnp.linspace(np.pi / 5, 4 * np.pi / 5, 40), scale))


def test_growth_of_the_logistic_map():
    """The 0–1 test on the map of its authors' examples: K near 1 at 3.97, near 0 at 3.55 (period 8)."""
    for r, k in ((3.97, 1.0), (3.55, 0.0)):
        signal = (logistic(r),)
        scale = chaos01.mean_square(signal)
        assert growth(signal, scale) == pytest.approx(k, abs=0.1)
        assert growth(WITHOUT_PERIOD(signal), scale) == pytest.approx(k, abs=0.1)


def test_growth_of_chaos_in_bands():
    """At r = 3.575 the logistic map is chaotic in eight narrow bands: seen once the motion of period 8 is off."""
    signal = (logistic(3.575),)
    scale = chaos01.mean_square(signal)
    assert growth(signal, scale) < 0.2
    assert growth(WITHOUT_PERIOD(signal), scale) > 0.9


def test_verdict_rule():
    """One row a clause of the rule, and disagreement is undecided."""
    nan, t = np.nan, 2 * np.pi
    mu = 0.5
    expected = math.log(mu) / (2 * t)
    rows = [  # period, multiplier, failed, λ1, error, K -> kind
        (2, mu, False, expected, 1e-6, 0.0, "periodic"),
        (2, mu, False, expected + 0.1, 1e-6, 0.0, "undecided"),
        (2, mu, False, expected, 1e-6, 0.9, "undecided"),
        (0, nan, False, 0.1, 0.01, 0.99, "chaotic"),
        (0, nan, False, 0.1, 0.2, 0.99, "undecided"),
        (0, nan, False, 2e-3, 1e-5, 0.99, "undecided"),  # e^{λ1 N T} is below N²: a torus may do that
        (0, nan, False, 0.1, 0.01, 0.1, "undecided"),
        (0, nan, False, 1e-5, 1e-4, 0.0, "quasiperiodic"),
        (0, nan, False, 1e-3, 1e-1, 0.0, "undecided"),
        (1, mu, True, expected, 1e-6, 0.0, "failed"),
        (0, nan, False, nan, nan, 0.0, "failed"),
    ]
    columns = [np.array(column) for column in list(zip(*rows, strict=True))[:6]]
    kinds = verdict.judge(*columns, t, np.full(len(rows), 1000))
    assert [verdict.KINDS[kind] for kind in kinds] == [row[6] for row in rows]


def undamped(drive=0.3):
    """An undamped pendulum under a torque."""
    return {
        "T": lambda q, v, t: 0.5 * v[0] ** 2,
        "Q": lambda q, v, t: (drive * jnp.cos(1.3 * t) - jnp.sin(q[0]),),
        "coordinates": ("angle",),
        "period": 2 * math.pi / 1.3,
        "angles": ("angle",),
    }


def test_averages_tell_weak_chaos_from_tori():
    """Beside what Taylor integration says of a tangent's growth: N on a torus, N⁵ and more in a thin layer of chaos."""
    lanes, angles, n = LaneExecutor(tile=8), np.array([0.3, 1.2, 1.692308, 2.1]), 8000
    x, v, dx, dv = hy.make_vars("x", "v", "dx", "dv")
    torque = 0.3 * hy.cos(1.3 * hy.time)
    ta = hy.taylor_adaptive([(x, v), (v, torque - hy.sin(x)), (dx, dv), (dv, -hy.cos(x) * dx)], [0.0] * 4, tol=1e-15)
    grown = np.zeros(len(angles))
    for lane, angle in enumerate(angles):
        ta.state[:] = [angle, 0.0, 1.0, 0.3]
        for _ in range(n):
            ta.time = 0.0
            ta.propagate_until(2 * math.pi / 1.3)
            length = math.hypot(*ta.state[2:])
            grown[lane] += math.log(length)
            ta.state[2:] /= length
    assert list(grown / math.log(n) < 2.0) == [True, True, False, False]
    assert np.all(grown[2:] > 5 * math.log(n))
    flow = lagrangian(undamped, {"drive": 0.3})
    start = jax.tree.map(np.asarray, jax.vmap(flow.chart.state)(np.stack([angles, 0.0 * angles], axis=-1)))
    scene = LaneBatch(
        flow, start, {"drive": np.full(4, 0.3)}, SOLVERS["dopri5"], 120, compensated=False, error_estimate=1e-8
    )
    found = verdict.unsteadiness(scene, lanes, 512, 4096)
    assert np.all(found[:2] < 1e-6)
    assert np.all(found[2:] > 1e-4)
