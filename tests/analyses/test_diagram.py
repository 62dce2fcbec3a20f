"""Bifurcation diagrams: strobes against the Taylor reference, carried states against a plain loop, random starts."""

from __future__ import annotations

import subprocess
import sys

import jax
import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.base import LANE
from jaxnh.analyses.trajectories import diagram, portrait
from jaxnh.analyses.trajectories.diagram import DiagramOptions, random_starts, run
from jaxnh.config.yaml_source import ConfigError
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.experiment import load
from jaxnh.exceptions import InputError
from jaxnh.maps.kicks import KickStrobe
from jaxnh.solvers import SPLITTINGS
from tests.flows.particle import SYSTEMS, twin
from tests.helpers import taylor
from tests.helpers.batches import batch_of
from tests.helpers.kept_programs import lanes_with_kept_programs
from tests.helpers.measurement import largest_difference
from tests.helpers.memory import peak_memory
from tests.helpers.paths import ROOT

B = np.array([2.5, 0.4, 3.1, 1.2, 3.1])
# One period of order ten with 4900 forces has an error of 6e-12 (DESIGN, section 3). At these b all orbits attract; an
# error grows no more than a hundredfold on the way to them, and some ten periods add up:
TOLERANCE = 1e-8
NAMES = ("x1", "x2", "y1", "y2")


def scene(system, values=B, solver="sofroniou_spaletta10", steps=140):
    x, y, angle = twin(system).start().astype(float)
    return batch_of(system, ((x, y), (np.cos(angle), np.sin(angle))), values, SPLITTINGS[solver], steps)


def coarse(values=B):
    return scene(SYSTEMS["disturbed"], values, "strang2", 40)


def sections(group):
    """(…, 3) section coordinates of a group at phase 0, where the speed is √c."""
    x1, x2, y1, y2 = (group[name].to_numpy() for name in NAMES)
    return np.stack([x1, y1, np.arctan2(y2, x2)], axis=-1)


def few_lanes():
    """A runner of its own account, with the programs of earlier ones."""
    return lanes_with_kept_programs(None, jax.devices()[:1], 32)


@pytest.mark.parametrize("name", ["constant", "disturbed"])
@pytest.mark.parametrize("transient", [0, 3])
def test_strobes_from_a_fixed_start_are_those_of_the_reference(name, transient):
    """With no transient the first strobe is the start state, the second the state one period on."""
    system, par = SYSTEMS[name], twin(SYSTEMS[name])
    ours = sections(run(DiagramOptions(transient=transient, strobes=3), scene(system), few_lanes()))
    start = np.broadcast_to(par.start(), (len(B), 3))
    for k in range(3):
        periods = transient + k
        exact = taylor.strobe(par, B, start, periods) if periods else start
        assert largest_difference(ours[:, k], exact).max() < (TOLERANCE if periods else 1e-15)


@pytest.mark.parametrize("phase", [0.25, 0.5])
@pytest.mark.parametrize("start", ["fixed", "up"])
def test_phase_of_the_strobes(phase, start):
    """The strobes at a phase are those samples of the trajectory, which has its own test."""
    system = SYSTEMS["disturbed"]
    values = B if start == "fixed" else B[:1]
    options = DiagramOptions(transient=0, strobes=3, phase=phase, start=start)
    ours = run(options, scene(system, values), few_lanes())
    path = portrait.run(portrait.PortraitOptions(transient=0, periods=3, samples=4), scene(system, values), few_lanes())
    for name in NAMES:
        np.testing.assert_allclose(
            ours[name].to_numpy(), path[name].to_numpy()[:, round(4 * phase) :: 4], atol=TOLERANCE
        )


@pytest.mark.parametrize(("start", "order"), [("up", [1, 3, 0, 2, 4]), ("down", [4, 2, 0, 3, 1])])
def test_a_carried_state_is_a_plain_loop_over_b(start, order):
    """Up and down in b whatever the order of the sweep; the last strobe at one b is the start at the next."""
    system, par = SYSTEMS["constant"], twin(SYSTEMS["constant"])
    ours = sections(run(DiagramOptions(transient=2, strobes=3, start=start), scene(system), few_lanes()))
    state = par.start()
    for i in order:
        state = taylor.strobe(par, B[i], state, 2)[0]
        for k in range(3):
            state = taylor.strobe(par, B[i], state)[0] if k else state
            assert largest_difference(ours[i, k], state) < TOLERANCE


def test_a_carried_state_does_not_feel_where_a_call_ends(monkeypatch):
    values = np.linspace(4.0, 5.5, 11)
    options = DiagramOptions(transient=3, strobes=4, start="up")
    whole = sections(run(options, coarse(values), few_lanes()))
    monkeypatch.setattr(diagram, "_CARRIED_AT_ONCE", 4)
    parts = sections(run(options, coarse(values), few_lanes()))
    np.testing.assert_allclose(parts, whole, atol=1e-9)  # another program, so rounding differs, and chaos enlarges it


def test_up_and_down_part_where_two_attractors_live():
    """Near b = 4 an orbit of period 2 coming from below lives beside one of period 4 coming from above."""
    values = np.linspace(3.5, 4.4, 37)
    points = {}
    for start in ("up", "down"):
        options = DiagramOptions(transient=200, strobes=4, start=start)
        points[start] = run(options, scene(SYSTEMS["constant"], values, "blanes_moan6", 80), few_lanes())[
            "x1"
        ].to_numpy()
    distinct = {start: [len(np.unique(row.round(3))) for row in x] for start, x in points.items()}
    at = int(np.argmin(np.abs(values - 4.0)))
    assert distinct["up"][at] == 2
    assert distinct["down"][at] == 4


def test_random_starts_fill_the_box_evenly_and_never_change():
    options = DiagramOptions(start="random", n_starts=64, box=2.5, seed=3)
    ((x, y), (n1, n2)), _ = random_starts(options, coarse(np.zeros(100)))
    count = 64 * 100
    assert np.abs(n1**2 + n2**2 - 1).max() < 1e-15
    for values, half in ((x, 2.5), (y, 2.5), (np.arctan2(n2, n1), np.pi)):
        shares = np.histogram(values, 8, (-half, half))[0] / count
        assert shares.sum() == 1.0
        assert np.abs(shares - 1 / 8).max() < 5 * np.sqrt(1 / 8 * 7 / 8 / count)  # five standard deviations
    (again, _), _ = random_starts(options, coarse(np.zeros(40)))
    assert np.array_equal(again[0], x[: 40 * 64])
    (other, _), _ = random_starts(options.model_copy(update={"seed": 4}), coarse(np.zeros(1)))
    assert not np.array_equal(other[0], x[:64])


def test_random_starts_are_the_same_in_any_tiles():
    options = DiagramOptions(transient=0, strobes=2, start="random", n_starts=6)
    one, other = (run(options, coarse(), LaneExecutor(tile=tile)) for tile in (8, 32))
    assert one["x1"].dims == (LANE, "start", "strobe")
    assert one["x1"].to_numpy().shape == (5, 6, 2)
    for name in NAMES:
        assert np.array_equal(one[name].to_numpy()[..., 0], other[name].to_numpy()[..., 0])
        np.testing.assert_allclose(one[name].to_numpy()[..., 1], other[name].to_numpy()[..., 1], atol=1e-9)


def test_each_b_has_starts_of_its_own():
    x1 = run(DiagramOptions(transient=0, strobes=1, start="random", n_starts=6), coarse(), few_lanes())["x1"].to_numpy()
    assert len(np.unique(x1)) == 5 * 6


@pytest.mark.parametrize("start", ["fixed", "up", "down", "random"])
def test_expected_work_is_the_work_done(start):
    options = DiagramOptions(transient=5, strobes=4, start=start, phase=0.5)
    lanes = few_lanes()
    run(options, coarse(), lanes)
    carried = 0.5 if start in ("up", "down") else 0.5 * len(B)  # a carried state flies to the phase once
    expected = diagram.periods(options, len(B)) - 0.5 * len(B) * (16 if start == "random" else 1)
    assert lanes.accounts.lane_periods == expected + carried * (16 if start == "random" else 1)


def test_nothing_is_differentiated(monkeypatch):
    def refuse(*_):
        raise AssertionError("a tangent was asked for")

    monkeypatch.setenv("JAXNH_KEEP_PROGRAMS", "0")  # a program that is found is not traced
    monkeypatch.setattr(KickStrobe, "pushforward", refuse)
    run(DiagramOptions(transient=1, strobes=2), coarse(), LaneExecutor())


def test_options_of_random_starts_go_with_them_alone(tmp_path):
    config = tmp_path / "config.yaml"
    config.write_text(
        "system: {constraint: constant_speed}\nsweep: {b: {values: [1]}}\n"
        "analyses:\n  diagram: {start: up, n_starts: 3}\n"
    )
    with pytest.raises(ConfigError, match=r":4: analyses\.diagram\.n_starts: n_starts goes with start: random"):
        load(config)


@pytest.mark.slow
def test_memory_of_a_large_diagram(tmp_path):
    """100,000 lanes and 64 strobes kept stay below 2 GB at their peak."""
    config = tmp_path / "large.yaml"
    config.write_text(
        "system: {constraint: constant_speed}\nsweep: {b: {start: 0.1, stop: 6, count: 100000}}\n"
        "accuracy: {solver: strang2, steps: 32}\nanalyses:\n  diagram: {transient: 8, strobes: 64}\n"
    )
    command = [sys.executable, "-m", "jaxnh.sweep", str(config), "--output", str(tmp_path / "large.h5")]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=ROOT)
    assert 1e8 < peak_memory(process) < 2e9
    assert process.returncode == 0


@pytest.mark.parametrize(("b", "n"), [(5.5197, 1), (5.5195, 2)])
def test_lanes_near_a_doubling_are_drawn_on_their_orbit(b, n):
    """Beside the doubling at 5.51962 (Table 1) the map takes thousands of periods to come to the orbit: (μ − 1) is 1e-3.

    Strobes n apart are then 1e-4 apart and more after 64 periods. On the orbit they are the same to rounding, which a
    few periods leave as it is.
    """
    options = {"transient": 64, "strobes": 8}
    here = scene(SYSTEMS["constant"], np.array([b]), steps=60)
    waiting, drawn = (
        sections(run(DiagramOptions(**options, snap_to_period=orbits), here, LaneExecutor()))[0] for orbits in (None, 4)
    )
    assert np.abs(waiting[n:] - waiting[:-n]).max() > 1e-4
    assert np.abs(drawn[n:] - drawn[:-n]).max() < 1e-10
    assert n == 1 or np.abs(drawn[1:] - drawn[:-1]).max() > 1e-2


def test_orbits_go_with_starts_side_by_side():
    for other in ({"start": "up"}, {"phase": 0.5}):
        with pytest.raises(InputError, match="side by side and strobes at phase 0"):
            DiagramOptions(snap_to_period=4, **other)


@pytest.mark.parametrize("start", ["fixed", "random", "down"])
def test_statistics_are_those_of_the_strobes(start):
    """Of every trajectory, to the bit of NumPy's over the strobes that a diagram without them keeps."""
    options = {"transient": 5, "strobes": 9, "start": start, **({"n_starts": 3} if start == "random" else {})}
    lanes = LaneExecutor()
    whole = run(DiagramOptions(**options), coarse(), lanes)
    ours = run(DiagramOptions(**options, statistics=True), coarse(), lanes)
    assert "strobe" not in ours.dims
    reductions = {"max": np.max, "min": np.min, "mean": np.mean, "std": np.std}
    assert {str(name) for name in ours.data_vars} - {"status"} == {
        f"{name}_{kind}" for name in NAMES for kind in reductions
    }
    for name in NAMES:
        for kind, of in reductions.items():
            assert np.array_equal(ours[f"{name}_{kind}"].to_numpy(), of(whole[name].to_numpy(), axis=-1))
    assert diagram.ANALYSIS.count(ours) == diagram.ANALYSIS.count(whole)


def test_statistics_of_an_angle(tmp_path):
    """It has no mean; where a motion is lost, nothing has a number."""
    (tmp_path / "p.py").write_text(
        "def system(push=0.0):\n"
        "    import jax.numpy as jnp\n"
        "    def rhs(y, t):\n"
        "        theta, z = y\n"
        "        return 1.0 + 0.1 * jnp.cos(t), z * z * push - z\n"
        '    return {"rhs": rhs, "coordinates": ("theta", "z"), "angles": ("theta",), "period": 6.283185307179586}\n'
    )
    (tmp_path / "p.yaml").write_text(
        "system: {file: p.py}\ninitial: {z: 1.0}\nsweep: {push: {values: [0.0, 9.0]}}\n"
        "accuracy: {solver: tsit5, steps: 16}\nanalyses: {diagram: {transient: 2, strobes: 4, statistics: true}}\n"
    )
    found = jaxnh.run(load(tmp_path / "p.yaml"))["diagram"].to_dataset()
    assert {str(name) for name in found.data_vars if str(name).startswith("theta")} == {"theta_max", "theta_min"}
    assert np.array_equal(np.isfinite(found["z_std"].to_numpy()), [True, False])
    assert jaxnh.labels(found["status"]).to_numpy().tolist() == ["ok", "not finite"]
