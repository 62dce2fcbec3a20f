"""Verdicts that stay: those of random lanes beside the verdicts of runs ten times as long, and transients of chaos."""

from __future__ import annotations

import math
from dataclasses import replace

import heyoka as hy
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

from jaxnh.analyses import chaos01, verdict
from jaxnh.analyses.exponents import lyapunov
from jaxnh.analyses.periodic import period
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.solvers import SOLVERS, SPLITTINGS
from jaxnh.systems.lagrangian import lagrangian
from jaxnh.systems.particle import constant_speed, disturbed_speed
from tests.helpers.batches import batch_of
from tests.helpers.kept_programs import lanes_with_kept_programs
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.usefixtures("always_few_lanes")

START = ((0.1, 0.1), (0.1, math.sqrt(0.99)))
SYSTEMS = {"constant speed": (constant_speed(), 0.1), "disturbed speed": (disturbed_speed(), 0.01)}
PERIODIC, QUASIPERIODIC, CHAOTIC = (verdict.KINDS.index(name) for name in ("periodic", "quasiperiodic", "chaotic"))
FEW = lanes_with_kept_programs(None, jax.devices()[:1], 8)
TRANSIENTS = [5.22, 5.261818]
"""Values of b at constant speed at which chaos goes on for thousands of periods before the lane finds its orbit."""


def pendulum(damping=0.0, drive=1.0):
    """An angle under a periodic torque; without one the right-hand side knows no time."""
    return {
        "T": lambda q, v, t: 0.5 * v[0] ** 2,
        "Q": lambda q, v, t: (-damping * v[0] - jnp.sin(q[0]) + drive * jnp.cos(2 * t / 3),),
        "coordinates": ("angle",),
        "period": 3 * math.pi,
        "angles": ("angle",),
    }


def van_der_pol(stiffness=1.0):
    """A limit cycle, seen by a strobe that has nothing to do with it."""
    return {
        "T": lambda q, v, t: 0.5 * v[0] ** 2,
        "Q": lambda q, v, t: (stiffness * (1.0 - q[0] ** 2) * v[0] - q[0],),
        "coordinates": ("x",),
        "period": 2.0,
    }


@pytest.fixture
def lanes(battery):
    """Tiles as commands have them; at small sizes, of a dozen lanes, of eight on one core."""
    return LaneExecutor() if battery.full else FEW


def judged(scene, lanes, transient, averaged, times=1):
    """The dataset `verdict` of a scene, its criteria taken over so many times as long."""
    options = {"transient": times * transient}
    done = {"period": period.run(period.PeriodOptions(max_period=16, **options), scene, lanes)}
    spectrum = lyapunov.LyapunovOptions(periods=times * averaged, exponents=2, **options)
    done["lyapunov"] = lyapunov.run(spectrum, scene, lanes)
    done["chaos01"] = chaos01.run(chaos01.Chaos01Options(periods=times * averaged, **options), scene, lanes)
    return verdict.run(verdict.VerdictOptions(), scene, lanes, done)


def particle(name, b):
    """Lanes of the paper's particle from its start state; the map of a period is right to about 1e-7."""
    return batch_of(SYSTEMS[name][0], START, b, SPLITTINGS["blanes_moan6"], 160, error=1e-7)


def turned_over(battery, scenes, lanes, lengths, what):
    """The row of lanes that are called periodic or chaotic, and otherwise in a run ten times as long."""
    kinds = [judged(scene, lanes, *lengths)["kind"].to_numpy() for scene in scenes]
    longer = [judged(scene, lanes, *lengths, times=10)["kind"].to_numpy() for scene in scenes]
    kind, later = np.concatenate(kinds), np.concatenate(longer)
    decided = (kind == PERIODIC) | (kind == CHAOTIC)
    turned = int(np.sum(kind[decided] != later[decided]))
    shown = (
        f"{what}: of {int(decided.sum()):,} lanes, {int(np.sum(kind == CHAOTIC)):,} of them chaotic, in a longer run"
    )
    battery.row(shown, turned, len(kind) // 500, "otherwise:")
    battery.note(f"{what}: {int(np.sum(~decided)):,} of {len(kind):,} lanes are neither periodic nor chaotic.")
    return kind


@pytest.mark.slow
@pytest.mark.case("Verdicts of longer runs")
def test_verdicts_of_random_lanes(battery, lanes):
    """Over the paper's ranges, and again within the gaps between neighbours of which one is chaotic: edges of windows.

    Some 400 lanes of each system: with one in 500 allowed, a rate of one in 170 would be seen 19 times in 20.
    """
    count, lengths = (250, (512, 1024)) if battery.full else (12, (128, 256))
    scenes = []
    for number, (name, (_, low)) in enumerate(SYSTEMS.items()):
        draw = np.random.default_rng([2, number])
        b = np.sort(draw.uniform(low, 6.0, count))
        kind = judged(particle(name, b), lanes, *lengths)["kind"].to_numpy()
        gaps = np.flatnonzero((kind[1:] == CHAOTIC) != (kind[:-1] == CHAOTIC))
        edges = np.concatenate([draw.uniform(b[i], b[i + 1], 4 if battery.full else 1) for i in gaps])
        scenes.append(particle(name, np.concatenate([b, edges])))
    turned_over(battery, scenes, lanes, lengths, " and ".join(SYSTEMS))


@pytest.mark.slow
@pytest.mark.case("Verdicts of longer runs")
def test_verdicts_of_pendula(battery, lanes):
    """With and without damping: swings, whole turns, chaos, and tori, on which nothing is chaotic."""
    count, lengths = (128, (256, 512)) if battery.full else (6, (64, 128))
    draw, scenes = np.random.default_rng(3), []
    for damping, most in ((0.5, 1.6), (0.0, 0.34)):
        flow = lagrangian(pendulum, {"damping": damping, "drive": 1.0})
        start = flow.start({"angle": 0.3, "angle_dot": 0.2})
        drives = draw.uniform(0.9 if damping else 0.02, most, count)
        scenes.append(batch_of(flow, start, drives, SOLVERS["dopri5"], 120, name="drive", error=1e-8))
    kind = turned_over(battery, scenes, lanes, lengths, "pendula")
    # Below a drive of 0.34 those without damping swing on tori: at 0.02 steps of it, λ1 falls there like ln t / t.
    battery.row("tori without damping", int(np.sum(kind[count:] == CHAOTIC)), 0, "called chaotic:")


def growth_of_a_tangent(starts, drive, count):
    """Logarithm of a tangent's growth over so many periods of an undamped pendulum that starts at rest, by Taylor."""
    x, v, dx, dv = hy.make_vars("x", "v", "dx", "dv")
    torque = drive * hy.cos(2 * hy.time / 3)
    ta = hy.taylor_adaptive([(x, v), (v, torque - hy.sin(x)), (dx, dv), (dv, -hy.cos(x) * dx)], [0.0] * 4, tol=1e-15)
    grown = np.zeros(len(starts))
    for lane, start in enumerate(starts):
        ta.state[:] = [start, 0.0, 1.0, 0.3]
        for _ in range(count):
            ta.time = 0.0
            ta.propagate_until(3 * math.pi)
            length = math.hypot(*ta.state[2:])
            grown[lane] += math.log(length)
            ta.state[2:] /= length
            ta.state[0] -= 2 * math.pi * round(ta.state[0] / (2 * math.pi))
    return grown


@pytest.mark.slow
@pytest.mark.case("Verdicts of longer runs")
def test_weak_chaos_beside_tori(battery, lanes):
    """An undamped pendulum, at rest at random angles: tori, the thin layers of chaos between them, and the sea.

    On tori tangents grow in proportion to time; what has grown by N⁴ over N periods, ten times as many as the averages
    are taken over, is chaotic. Some 400 lanes: none wrong, where one in 130 would be seen 19 times in 20.
    """
    count, lengths, periods = (128, (256, 512), 40_000) if battery.full else (8, (64, 128), 8_000)
    wrong, words = 0, []
    for number, drive in enumerate((0.1, 0.3, 0.6)):
        angles = np.sort(np.random.default_rng([7, number]).uniform(0.0, math.pi, count))
        flow = lagrangian(pendulum, {"drive": drive})
        scene = batch_of(
            flow, flow.start({"angle": 0.0, "angle_dot": 0.0}), angles, SOLVERS["dopri5"], 120, name="drive"
        )
        start = jax.tree.map(np.asarray, jax.vmap(flow.chart.state)(np.stack([angles, np.zeros(count)], axis=-1)))
        scene = replace(scene, start=start, p={"drive": np.full(count, drive)}, error_estimate=1e-8)
        kind = judged(scene, lanes, *lengths)["kind"].to_numpy()
        chaos = growth_of_a_tangent(angles, drive, periods) > 4 * math.log(periods)
        wrong += int(np.sum(np.where(chaos, kind == QUASIPERIODIC, kind == CHAOTIC)))
        words.append(kind)
    words = np.concatenate(words)
    battery.row(f"{len(words)} starts of an undamped pendulum, tori or chaos", wrong, 0, "called the other:")
    decided = int(np.sum((words == QUASIPERIODIC) | (words == CHAOTIC)))
    battery.note(f"Undamped pendulum: {decided} of {len(words)} lanes are called quasiperiodic or chaotic.")
    assert decided > len(words) // 4


@pytest.mark.slow
@pytest.mark.case("Verdicts of longer runs")
def test_transients_of_chaos(battery):
    """Chaos over the whole of the average that ends later is not called chaos, and what it ends in is said."""
    b = TRANSIENTS if battery.full else TRANSIENTS[:1]
    found = judged(particle("constant speed", b), FEW, 512, 1024)
    battery.row(f"b = {b}, 512 + 1,024 periods", int(np.sum(found["kind"] == CHAOTIC)), 0, "called chaotic:")


@pytest.mark.slow
@pytest.mark.case("Verdicts of longer runs")
def test_limit_cycle_beside_a_strobe(battery):
    """Where the right-hand side knows no time a limit cycle is no periodic lane; a pendulum without damping is undecided."""
    flow = lagrangian(van_der_pol, {"stiffness": 1.0})
    start = flow.start({"x": 0.5, "x_dot": 0.0})
    cycles = batch_of(flow, start, [0.5, 1.0], SOLVERS["dopri5"], 60, name="stiffness", error=1e-8)
    kind = judged(cycles, FEW, 128, 256)["kind"].to_numpy()
    battery.row("limit cycles of van der Pol", int(np.sum(kind == QUASIPERIODIC)), 0, "called quasiperiodic:")
    assert {verdict.KINDS[i] for i in kind} <= {"limit_cycle", "undecided"}
    free = lagrangian(pendulum, {"damping": 0.0, "drive": 0.0})
    start = free.start({"angle": 0.3, "angle_dot": 0.2})
    swings = batch_of(free, start, [0.0, 0.0], SOLVERS["dopri5"], 60, name="drive", error=1e-8)
    kind = judged(swings, FEW, 128, 256)["kind"].to_numpy()
    battery.row("swings of a free pendulum", int(np.sum(kind == QUASIPERIODIC)), 0, "called quasiperiodic:")
    assert CHAOTIC not in kind


@pytest.mark.slow
@pytest.mark.case("Verdicts of longer runs")
@pytest.mark.parametrize("name", ["range_constant", "range_disturbed"])
def test_whole_range(battery, result, name):
    """All criteria at 4096 values of b over the paper's range, 64 in small: at most 2 % undecided, none failed.

    At every decided b the sign of λ1, beyond its error, is that of the period analysis, and on periodic orbits all
    exponents add up to the divergence.
    """
    count = 4096 if battery.full else 64
    path, _, _ = result(f"{name}_{count}", ROOT / "configs" / f"{name}.yaml", f"sweep.b.count={count}")
    tree = xr.open_datatree(path, engine="h5netcdf").load()
    kind = tree["verdict/kind"].to_numpy()
    assert len(kind) == count
    counts = dict(zip(verdict.KINDS, np.bincount(kind, minlength=len(verdict.KINDS)), strict=True))
    battery.row(f"{name}, {count:,} values of b", counts["failed"] / count, 0.0, "share failed:")
    battery.row(f"{name}, {count:,} values of b", counts["undecided"] / count, 0.02, "share undecided:")
    largest = tree["lyapunov/exponents"].to_numpy()[:, 0]
    error = tree["lyapunov/exponents_error"].to_numpy()[:, 0]
    periodic = tree["period/period"].to_numpy() > 0
    decided = (kind == PERIODIC) | (kind == CHAOTIC)
    assert np.all((largest - error > 0)[decided] == ~periodic[decided])
    assert np.all(largest[decided & periodic] < error[decided & periodic])
