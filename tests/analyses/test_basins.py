"""Basins of attraction: against DOP853 with a classification of its own, closed forms, and bits against bits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxnh
from jaxnh.analyses.basins.classification import NONE, classify
from jaxnh.analyses.basins.paths import stays_near
from jaxnh.analyses.basins.settling import SETTLED, settle
from jaxnh.analyses.basins.tables import wilson
from jaxnh.engine.experiment import Experiment
from jaxnh.exceptions import ConfigError
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import constant_speed
from jaxnh.systems.status import STATUS
from tests.flows.written_out import experiment, line, oscillator
from tests.helpers.attractors import grid, kinds, same_partition
from tests.helpers.batches import batch_of
from tests.helpers.comparisons import same_tree
from tests.helpers.kept_programs import session_of

pytestmark = pytest.mark.usefixtures("uncalibrated")
STEPS = {"accuracy": {"solver": "tsit5", "steps": 24}}
"""Of a flow without a clock, some 1e-9 a unit of time where rates are about one: few stages, as compiling takes long."""


# ---- against integrations of their own


def dop853(rhs, starts, times):
    """States (times, dimensions, starts) of all starts as one system: its error bounds hold for the worst of them."""
    shape = starts.shape
    found = solve_ivp(
        lambda t, y: rhs(t, y.reshape(shape)).ravel(),
        (0.0, times[-1]),
        starts.ravel(),
        "DOP853",
        times,
        rtol=1e-9,
        atol=1e-9,
    )
    return found.y.T.reshape(len(times), *shape)


@pytest.mark.slow
def test_driven_pendulum(tmp_path):
    """Rotation and rest of a damped pendulum under a constant torque; exponents −γ and −γ/2 by its divergence.

    Lanes at rest lie around the focus, lanes that rotate turn with about 0.5/0.1 radians a unit of time.
    """
    sweep = {"theta": line(-3.1, 3.1, 12), "rate": line(-10.0, 10.0, 12)}
    rates = "rate, 0.5 - 0.1 * rate - jnp.sin(theta)"
    rest = '"angles": ("theta",)'
    tree = session_of(experiment(tmp_path, ("theta", "rate"), rates, sweep, rest=rest, **STEPS)).tree()
    attractors = tree["attractors"]
    assert kinds(attractors) == ["limit_cycle", "equilibrium"]
    np.testing.assert_allclose(attractors["exponent"].values, [-0.1, -0.05], atol=1e-6)
    assert attractors["theta"].values[1] == pytest.approx(np.arcsin(0.5), abs=1e-9)
    states = dop853(
        lambda t, y: np.stack([y[1], 0.5 - 0.1 * y[1] - np.sin(y[0])]), grid(tree, "theta", "rate"), [0.0, 200.0, 220.0]
    )
    rotates = states[2, 0] - states[1, 0] > 2 * np.pi
    number = tree["basins"]["attractor"].values.ravel()
    assert np.array_equal(number, np.where(rotates, 1, 2))
    assert attractors["fraction"].values.tolist() == [np.mean(number == k) for k in (1, 2)]


@pytest.mark.slow
def test_five_attractors(tmp_path):
    """x'' + 0.08 x' + x³ = 0.2 cos t has orbits of periods 1, 3, 1, 2, 2 in this box, whatever phase lanes come in.

    DOP853 for 100 periods: what is left of the start is exp(−0.04 · 200π) = 1e-11. Its lanes are told apart by their
    last six strobe points as sets, and periods by which of these are the same within 1e-4.
    """
    tree = session_of(oscillator(tmp_path, {"x": line(-1.0, 1.0, 16), "v": line(-0.5, 1.0, 16)})).tree()
    states = dop853(
        lambda t, y: np.stack([y[1], 0.2 * np.cos(t) - 0.08 * y[1] - y[0] ** 3]),
        grid(tree, "x", "v"),
        2 * np.pi * np.arange(95, 101),
    )
    number = tree["basins"]["attractor"].values.ravel()
    means = states.mean(axis=0).round(3)  # of six points, a multiple of all periods: the same in every phase
    theirs = [tuple(mean) for mean in means.T]
    assert same_partition(number.tolist(), theirs)
    gaps = [np.abs(states[n:] - states[:-n]).max(axis=(0, 1)) < 1e-4 for n in (1, 2, 3)]
    period = np.select(gaps, [1, 2, 3], 0)
    attractors = tree["attractors"].to_dataset().isel(drive=0)
    assert sorted(attractors["period"].values) == [1, 1, 2, 2, 3]
    assert np.array_equal(attractors["period"].values[number - 1], period)
    # ln|μ|/(nT) = −0.04, by the divergence −0.08, where multipliers are complex.
    np.testing.assert_allclose(attractors["exponent"].values, -0.04, atol=1e-9)
    last = attractors["x"].values[number - 1]
    assert np.abs(states[:, 0] - last).min(axis=0).max() < 1e-6


# ---- closed forms


def test_twins_and_a_saddle(tmp_path):
    """x'' = x − x³ − x'/5: foci at ±1, exponents −1/10, as many starts each; a start on the saddle is on neither."""
    sweep = {"x": {"values": [-1.5, -0.7, -1e-9, 0.0, 1e-9, 0.7, 1.5]}, "v": {"values": [0.0]}}
    rates = "v, x - x**3 - 0.2 * v"
    tree = session_of(experiment(tmp_path, ("x", "v"), rates, sweep, {"max_periods": 512}, **STEPS)).tree()
    number = tree["basins"]["attractor"].values.ravel()
    assert number[3] == 0
    assert kinds(tree["attractors"]) == ["equilibrium", "equilibrium"]
    assert tree["attractors"]["x"].values.tolist() == pytest.approx([-1.0, 1.0] if number[1] == 1 else [1.0, -1.0])
    np.testing.assert_allclose(tree["attractors"]["exponent"].values, -0.1, atol=1e-9)
    assert tree["attractors"]["fraction"].values.tolist() == [3 / 7, 3 / 7]
    assert (number[:3] != number[:3:-1]).all()


def turning(folder, rate, options):
    """θ' = rate − sin θ."""
    more = {"system": {"file": str(folder / "flow.py"), "rate": rate}, **STEPS}
    sweep, rest = {"theta": line(-3.0, 3.0, 5)}, '"angles": ("theta",)'
    return experiment(folder, ("theta",), "rate - jnp.sin(theta),", sweep, options, rest, "rate=1.0", **more)


def test_a_bottleneck_is_no_attractor(tmp_path):
    """θ' = 1 + ε − sin θ turns once in 2π/√(2ε + ε²): in 4443 units of time it lingers near π/2, where nothing stays."""
    tree = session_of(turning(tmp_path, 1.000001, {"max_periods": 256})).tree()
    assert kinds(tree["attractors"]) == []
    assert np.all(tree["basins"]["attractor"].values == 0)


@pytest.mark.slow
@pytest.mark.parametrize("mu", [-1e-6, -1e-9, 0.04])
def test_the_ghost_of_a_cycle_is_no_attractor(tmp_path, mu):
    """r' = r (μ − (r − 1)²), φ' = 1: below μ = 0 lanes from above linger at r = 1 for π/√−μ or longer, then go to rest.

    There the field has no derivative, and nothing is known of rest. Above, the cycle is at 1 + √μ, with an exponent of
    −2√μ (1 + √μ).
    """
    growth = "(mu - (jnp.sqrt(x**2 + y**2) - 1.0)**2)"
    more = {"system": {"file": str(tmp_path / "flow.py"), "mu": mu}, **STEPS}
    sweep, rates = {"x": {"values": [1.2, 2.0]}, "y": {"values": [0.0]}}, f"x * {growth} - y, y * {growth} + x"
    tree = session_of(experiment(tmp_path, ("x", "y"), rates, sweep, {"max_periods": 256}, "", "mu=0.0", **more)).tree()
    assert np.all(tree["basins"]["attractor"].values == (1 if mu > 0 else 0))
    assert kinds(tree["attractors"]) == ["limit_cycle"] * (mu > 0)
    if mu > 0:
        root = np.sqrt(mu)
        np.testing.assert_allclose(tree["attractors"]["exponent"].values, -2 * root * (1 + root), rtol=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize("mu", [-1e-6, -1e-9])
def test_the_ghost_of_a_cycle_in_space_is_no_attractor(tmp_path, mu):
    """The same about a cycle in three dimensions, tilted by z' = x − z: there a motion whose exponents are near zero may
    be a torus, and this one is none, as it comes back nearer than any torus does in the time that it was looked at."""
    growth = "(mu - (jnp.sqrt(x**2 + y**2) - 1.0)**2)"
    more = {"system": {"file": str(tmp_path / "flow.py"), "mu": mu}, **STEPS}
    sweep, rates = {"x": {"values": [1.2, 2.0]}}, f"x * {growth} - y, y * {growth} + x, x - z"
    asked = experiment(tmp_path, ("x", "y", "z"), rates, sweep, {"max_periods": 512}, "", "mu=0.0", **more)
    tree = session_of(asked).tree()
    assert kinds(tree["attractors"]) == []
    assert np.all(tree["basins"]["attractor"].values == 0)


@pytest.mark.slow
def test_a_torus_without_a_clock(tmp_path):
    """About the circle of radius 2 by angle t, and about that at a distance of 1 by angle t (1 + √5)/2, in 3 dimensions.

    With u = √(x² + y²) − 2: u' = u (1 − u² − z²) − γ z, z' = z (1 − u² − z²) + γ u. Exponents 0, 0, −2.
    """
    u, square = "(jnp.sqrt(x**2 + y**2) - 2.0)", "(1.0 - (jnp.sqrt(x**2 + y**2) - 2.0)**2 - z**2)"
    out = f"({u} * {square} - gamma * z) / jnp.sqrt(x**2 + y**2)"
    rates = f"x * {out} - y, y * {out} + x, z * {square} + gamma * {u}"
    sweep = {"x": {"values": [1.5, 2.2, 3.5]}, "z": {"values": [0.1, -0.8]}}
    golden = f"gamma={(1 + math.sqrt(5)) / 2}"
    tree = session_of(experiment(tmp_path, ("x", "y", "z"), rates, sweep, {}, "", golden, **STEPS)).tree()
    assert kinds(tree["attractors"]) == ["quasiperiodic"]
    assert np.all(tree["basins"]["attractor"].values == 1)
    assert abs(tree["attractors"]["exponent"].item()) < 1e-3


@pytest.mark.slow
def test_a_bottleneck_beside_an_attractor(tmp_path):
    """x'' + 2 x' = x − x³ + c, with c beyond the fold at 2/(3√3) by 10⁻⁶, and a drive so weak that it only keeps time.

    From below the fold x lingers near −1/√3 for 2π/√(10⁻⁶ √3) = 4774 units of time, 760 periods: of these lanes nothing
    is known after 256. From above they come to the one attractor.
    """
    sweep = {"x": {"values": [-1.5, -0.9, 0.5, 1.5]}, "v": {"values": [0.0]}}
    push = 2 / (3 * math.sqrt(3)) + 1e-6
    asked = oscillator(tmp_path, sweep, {"max_periods": 256}, 1e-9, linear=1.0, damping=2.0, push=push)
    tree = session_of(asked).tree()
    assert tree["basins"]["attractor"].values.ravel().tolist() == [0, 0, 1, 1]
    assert kinds(tree["attractors"].to_dataset().isel(drive=0)) == ["periodic"]


def test_beyond_the_bottleneck_there_is_rotation(tmp_path):
    """θ' = 1.01 − sin θ turns in 44.3 units of time: one limit cycle."""
    tree = session_of(turning(tmp_path, 1.01, {})).tree()
    assert kinds(tree["attractors"]) == ["limit_cycle"]
    assert np.all(tree["basins"]["attractor"].values == 1)


def test_escape(tmp_path):
    """x' = x³ − x: within (−1, 1) to rest, exponent −1; beyond, to infinity in finite time."""
    sweep = {"x": {"values": [-1.2, -0.9, 0.3, 0.9, 1.2]}}
    said = '"units": {"x": "m"}'
    tree = session_of(experiment(tmp_path, ("x",), "x**3 - x,", sweep, rest=said, **STEPS)).tree()
    assert tree["basins"]["attractor"].values.tolist() == [-1, 1, 1, 1, -1]
    assert [tree["attractors"][name].attrs["units"] for name in ("x", "x_points", "fraction")] == ["m", "m", "1"]
    reasons = [STATUS[k] for k in tree["basins"]["status"].values]
    assert reasons == ["not_finite", "ok", "ok", "ok", "not_finite"]
    assert tree["attractors"]["exponent"].values.tolist() == pytest.approx([-1.0])
    assert tree["attractors"]["fraction"].values.tolist() == [3 / 5]


@pytest.mark.slow
def test_escape_in_proportion_to_time(tmp_path):
    """y' = 1 never ends in a number that is not finite, and is seen to leave."""
    sweep = {"x": line(0.1, 1.0, 3)}
    rates = "-x, 1.0 + 0.0 * y"
    tree = session_of(experiment(tmp_path, ("x", "y"), rates, sweep, {"max_periods": 512}, **STEPS)).tree()
    assert tree["basins"]["attractor"].values.tolist() == [-1, -1, -1]
    assert {STATUS[k] for k in tree["basins"]["status"].values} == {"escaped"}


def test_what_does_not_stay_is_none(lanes):
    """Lanes whose means are not those of their longer look, none of them: nothing is left to be judged."""
    scene = batch_of(constant_speed(), ((0.1, 0.1), (0.1, math.sqrt(0.99))), [5.4, 5.5], SPLITTINGS["blanes_moan6"], 40)
    records = settle(scene, lanes, 32, 64)
    records.known[:] = SETTLED
    records.means[:] += 1.0
    assert classify(scene, lanes, records, 4, 64).kind.tolist() == [NONE, NONE]


def test_the_interval_of_no_hit_begins_at_zero():
    """To the bit, whatever the number of draws, and that of nothing else ends at one."""
    count = np.arange(1, 2000)
    assert not wilson(np.zeros_like(count), count)[0].any()
    assert np.all(wilson(count, count)[1] == 1.0)


def test_wilson():
    """Of no hit among n the upper bound is z²/(n + z²); of all hits the lower one mirrors it."""
    z2 = 3.841458820694124
    low, high = wilson(np.array([0, 5, 10]), np.array([10, 10, 10]))
    np.testing.assert_allclose(high[0], z2 / (10 + z2), rtol=1e-12)
    np.testing.assert_allclose(low[2], 1 - z2 / (10 + z2), rtol=1e-12)
    assert (low[0], high[2]) == (0.0, 1.0)
    np.testing.assert_allclose(low[1] + high[1], 1.0, rtol=1e-12)


def test_boxes_around_points():
    """By brute force: a point whose box touches one of another point is near, also across the cut of an angle."""
    random = np.random.default_rng(3)
    points = random.uniform([-1.0, -np.pi], [1.0, np.pi], (50, 2))
    paths = random.uniform([-1.3, -np.pi], [1.3, np.pi], (400, 1, 2))
    edge = np.array([0.1, 2 * np.pi / 40])
    turns = np.array([False, True])
    lowest = np.array([points[:, 0].min(), -np.pi])
    own, theirs = (np.floor((x - lowest) / edge) for x in (paths[:, 0], points))
    gap = np.abs(own[:, None] - theirs[None])
    gap[..., 1] = np.minimum(gap[..., 1], 40 - gap[..., 1])
    expected = np.any(np.all(gap <= 1, axis=2), axis=1)
    assert 50 < expected.sum() < 350
    assert np.array_equal(stays_near(turns, paths, points, edge), expected)


# ---- over parameters


@pytest.mark.slow
def test_planes_of_starts_at_each_value(tmp_path):
    """Every value of a parameter has the attractors and shares of a plane of starts by itself, by other numbers."""
    plane = {"x": line(-1.0, 1.0, 8), "v": line(-0.5, 1.0, 8)}
    drives = [0.15, 0.2]
    whole = session_of(oscillator(tmp_path, {"drive": {"values": drives}, **plane}, {})).tree()
    assert whole["attractors"]["fraction"].dims == ("drive", "attractor")
    for place, drive in enumerate(drives):
        alone = session_of(oscillator(tmp_path, {"drive": {"values": [drive]}, **plane}, {})).tree()
        for name in ("time", "status"):
            assert np.array_equal(whole["basins"][name].values[place], alone["basins"][name].values[0])
        number, by_itself = (tree["basins"]["attractor"].values for tree in (whole, alone))
        ours, theirs = number[place].ravel(), by_itself[0].ravel()
        assert same_partition(ours, theirs)
        here, first = np.unique(ours, return_index=True)
        for name in ("kind", "period", "exponent", "fraction", "x"):
            values = whole["attractors"][name].values[place, here - 1]
            assert np.array_equal(values, alone["attractors"][name].values[0, theirs[first] - 1])
        rest = np.delete(whole["attractors"]["fraction"].values[place], here - 1)
        assert np.all(rest == 0.0)


BOX = {"n_starts": 40, "seed": 7, "box": {"x": [-1.0, 1.0], "v": [-0.5, 1.0]}}


@pytest.mark.slow
def test_random_starts(tmp_path):
    """Each start is the lane of its coordinates, in the box; the same for any tiles, others at another value."""
    sweep = {"drive": {"values": [0.15, 0.2]}}
    asked = oscillator(tmp_path, sweep, BOX)
    tree = session_of(asked).tree()
    basins = tree["basins"]
    assert basins["attractor"].dims == ("drive", "start")
    x, v, number = (basins[name].values for name in ("x", "v", "attractor"))
    assert -1.0 <= x.min() < -0.9 < 0.9 < x.max() <= 1.0
    assert -0.5 <= v.min() < -0.4 < 0.9 < v.max() <= 1.0
    assert len(np.unique(x)) == 80
    np.testing.assert_array_equal(
        tree["attractors"]["fraction"].values[1],
        [np.mean(number[1] == k) for k in tree["attractors"]["attractor"].values],
    )
    for start in (0, 17):
        where = {"drive": {"values": [0.2]}, "x": {"values": [x[1, start]]}, "v": {"values": [v[1, start]]}}
        alone = session_of(oscillator(tmp_path, where, {})).tree()["attractors"]
        k = number[1, start] - 1
        for name in ("kind", "period", "multiplier"):
            assert alone[name].values[0, 0] == pytest.approx(tree["attractors"][name].values[1, k], rel=1e-9)
    same_tree(jaxnh.run(asked, tmp_path / "tiles.h5", tile=1), tree)


@pytest.mark.parametrize(
    ("options", "sweep", "message"),
    [
        ({"n_starts": 4}, {}, "needs a box to draw from"),
        ({"box": {"x": [0.0, 1.0]}}, {}, "goes with n_starts, the number of random starts in it"),
        ({"n_starts": 4, "box": {"x": [1.0, 0.0]}}, {}, "the first number must be the lower one, not 1 and 0"),
        ({"n_starts": 4, "box": {"z": [0.0, 1.0]}}, {}, "there is no coordinate z; known are x, v"),
        ({"n_starts": 4, "box": {"x": [0.0, 1.0]}}, {"v": {"values": [0.0]}}, "random starts and the axis v of start"),
        ({"seed": 4}, {}, "goes with n_starts, and there are none"),
        ({"transient": 64, "max_periods": 100}, {}, "must be at least twice the transient, 128"),
    ],
)
def test_what_does_not_go_together(tmp_path, options, sweep, message):
    with pytest.raises(ConfigError, match=message):
        oscillator(tmp_path, {"drive": {"values": [0.15, 0.2]}, **sweep}, options)


def test_a_coordinate_that_the_constraint_decides():
    content = {
        "system": {"constraint": "constant_speed"},
        "sweep": {"b": {"values": [5.3]}},
        "analyses": {"basins": {"n_starts": 4, "box": {"y2": [0.0, 1.0]}}},
    }
    with pytest.raises(ConfigError, match="the constraint decides y2; leave it out"):
        Experiment.from_dict(content)
