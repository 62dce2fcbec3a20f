"""Long chaos, strong contraction, coexisting attractors and poisoned lanes: what ensembles of lanes have to keep."""

from __future__ import annotations

import math
import signal
from dataclasses import replace

import jax
import numpy as np
import pytest
from matplotlib.figure import Figure

from jaxnh.analyses import chaos01, verdict
from jaxnh.analyses.base import LANE
from jaxnh.analyses.exponents import lyapunov
from jaxnh.analyses.periodic import attractor_survey, period
from jaxnh.analyses.trajectories import diagram
from jaxnh.engine.executor.lanes import TILE, LaneExecutor
from jaxnh.engine.experiment import load
from jaxnh.exceptions import AccuracyError, ConfigError
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import derivatives, iterate
from jaxnh.orbits.shooting import close_orbits
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import CHART, constant_speed, disturbed_speed
from tests.flows.particle import twin
from tests.helpers import taylor
from tests.helpers.batches import batch_of, calibrated
from tests.helpers.battery import worst
from tests.helpers.hard_scenes import show_sum_rule
from tests.helpers.jobs import Job, content, slow_tiles
from tests.helpers.kept_programs import lanes_with_kept_programs

START = ((0.1, 0.1), (0.1, math.sqrt(0.99)))


@pytest.fixture
def lanes(battery):
    """Tiles as commands have them, of thousands of lanes; at small sizes, of some dozens, of 32."""
    return lanes_with_kept_programs(tile=TILE if battery.full else 32)


def scene_at(values, steps=128, solver="blanes_moan6", system=None, start=START):
    """Lanes at values of b, all from one start state, at constant speed unless a system is named."""
    system = constant_speed() if system is None else system
    return batch_of(system, start, values, SPLITTINGS[solver], steps, error=math.nan)


def random_points(count, seed=5, box=1.5):
    return np.random.default_rng(seed).uniform([-box, -box, -math.pi], [box, box, math.pi], (count, 3))


# ---- strong contraction


@pytest.mark.slow  # tests/analyses/test_criteria.py asserts the third exponents of three orbits of either system
@pytest.mark.case("Strong contraction")
def test_strong_contraction(battery, lanes):
    """Stable orbits with a third exponent down to −10 and below: by Taylor's monodromy matrices and the mean divergence."""
    wanted = [(0.2, 4.1), (0.05, 3.1), (0.02, 2.2)] if battery.full else [(0.05, 3.1)]
    for c, b in wanted:
        system = constant_speed(c=c)
        par = twin(system)
        scene = scene_at([b], 600, "kahan_li8", system)
        found = attractor_survey.survey(scene, lanes, np.array([[1.0, 1.0, 0.3]]), 16, "hard", 400)
        n = int(found.period[0])
        assert n > 0
        strobe = scene.strobe()
        orbit = close_orbits(
            lambda u, b, strobe=strobe: lanes(derivatives, (strobe, np.int32(1)), (u, {"b": b}), tile=32),
            walk(lanes, scene, found.u[0], n)[None],
            np.array([b]),
            CHART.wrap,
        )
        options = lyapunov.LyapunovOptions(transient=128, periods=512 if battery.full else 128)
        x, y, theta = found.u[0]
        scene = scene_at([b], 600, "kahan_li8", system, ((x, y), (math.cos(theta), math.sin(theta))))
        ours = lyapunov.run(options, scene, lanes)
        exponents = ours["exponents"].to_numpy()[0]
        exact = taylor.multiplier_logs(par, n, b, orbit.points[0]) / (n * float(par.period))
        battery.row(
            f"c = {c:g}, b = {b:g}, period {n}: λ = {exponents[0]:.4f}, {exponents[1]:.4f}, {exponents[2]:.4f}",
            worst(np.abs(exponents - exact)),
            1e-6,
            "error",
        )
        # The map of a period is right to 1e-10 with these steps, as its multipliers are above.
        show_sum_rule(battery, f"c = {c:g}, b = {b:g}", ours, 1e-10)


def walk(lanes, scene, u, n):
    """The n points of an orbit, (n, 3)."""
    points = [u]
    for _ in range(n - 1):
        end = lanes(
            iterate, (scene.strobe(), np.int32(1)), (CHART.state(points[-1][:, None]), scene.take(slice(1)).p), tile=32
        )
        points.append(np.array(CHART.point(jax.tree.map(lambda leaf: leaf[0], end))))
    return np.array(points)


# ---- long chaos


def means(lanes, strobe, state, p, periods):
    """States `periods` on, and each lane's means of x1, y1, n1, n2 at the strobes until then, (4, lanes)."""
    total, block = np.zeros((4, len(p["b"]))), min(periods, 400)
    for _ in range(periods // block):
        met = lanes.record(strobe, block, (state, p))
        state = jax.tree.map(lambda leaf: leaf[:, -1], met)
        total += [leaf.sum(axis=1) for leaf in jax.tree.leaves(met)]
    return state, total / (periods // block * block)


@pytest.mark.slow
@pytest.mark.case("Long chaos")
def test_long_chaos(battery, lanes):
    """An attractor that is its own mirror image: odd means vanish within their error, over lanes that forgot their start."""
    count, periods = (4096, 100_000) if battery.full else (256, 400)
    plan = calibrated(constant_speed(), START, [5.3], lanes).cheapest(1e-4)
    strobe = make_return_map(constant_speed(), plan.solver, plan.steps, compensated=plan.compensated)
    state = jax.tree.map(np.array, CHART.state(random_points(count).T))
    p = {"b": np.full(count, 5.3)}
    state = lanes(iterate, (strobe, np.int32(200)), (state, p), periods=200)
    end, averages = means(lanes, strobe, state, p, periods)
    score = [abs(m.mean()) / (m.std(ddof=1) / math.sqrt(count)) for m in averages]
    battery.row(
        f"b = 5.3, {count:,} lanes, {periods:,} periods: means of x1, y1, n1, n2",
        worst(score),
        4.0,
        "largest, in standard errors (of " + f"{max(m.std(ddof=1) / math.sqrt(count) for m in averages):.1e})",
    )
    off = np.abs(np.hypot(*end[1]) - 1)
    battery.row("the same lanes at their end", worst(off), 1e-14, "largest ||n| − 1|")
    few, shorter = slice(count // 2 - 37, count // 2 + 26), min(periods, 2000)
    start = jax.tree.map(lambda leaf: leaf[few], (state, p))
    one = LaneExecutor(devices=jax.devices()[:1], tile=lanes.tile)
    alone = one(iterate, (strobe, np.int32(shorter)), start)
    among = lanes(iterate, (strobe, np.int32(shorter)), (state, p))
    differing = sum(
        int(np.sum(x != y[few])) for x, y in zip(jax.tree.leaves(alone), jax.tree.leaves(among), strict=True)
    )
    battery.row(
        f"63 of them for {shorter:,} periods, alone on one device and among all on {len(lanes.devices)}",
        differing,
        0,
        "numbers that differ:",
    )
    scene = scene_at(np.linspace(5.2, 5.8, 300 if battery.full else 20), 110)
    on_one, on_two = (
        everything(scene, LaneExecutor(devices=jax.devices()[:1], tile=lanes.tile)),
        everything(scene, lanes),
    )
    differing = sum(
        int(np.sum(~same(v.values, on_two[name].variables[key].values)))
        for name, group in on_one.items()
        for key, v in group.variables.items()
    )
    battery.row(
        f"five analyses at {scene.count} b on one device and on {len(lanes.devices)}",
        differing,
        0,
        "numbers that differ:",
    )
    for system, b in (
        ((constant_speed(), 5.3), (disturbed_speed(), 5.6)) if battery.full else ((constant_speed(), 5.3),)
    ):
        options = lyapunov.LyapunovOptions(transient=256, periods=4096 if battery.full else 64)
        found = lyapunov.run(options, scene_at(b + 1e-6 * np.arange(32), system=system), lanes)
        # 128 steps of Blanes-Moan 6: an error of one period of 2e-7 at most, by Taylor.
        show_sum_rule(battery, f"d = {system.d:g}, b = {b}, {options.periods:,} periods", found, 2e-7)


@pytest.mark.slow
@pytest.mark.case("Long chaos")
def test_long_chaos_in_tiles(battery, tmp_path):
    """The command on chaotic lanes: undisturbed, and in tiles on disk, stopped by a scheduler's signal and resumed."""
    count, transient = (4096, 20_000) if battery.full else (2048, 500)
    config = (
        "system: {constraint: constant_speed}\n"
        f"sweep: {{b: {{start: 5.25, stop: 5.35, count: {count}}}}}\n"
        "accuracy: {solver: blanes_moan6, steps: 40}\n"
        f"analyses: {{diagram: {{transient: {transient}, strobes: 8, start: random, n_starts: 1}}}}\n"
    )
    jobs = []
    for name, tile in (("whole", None), ("stopped", 256)):
        (tmp_path / name).mkdir()
        jobs.append(Job(tmp_path / name, config, tile))
    whole, stopped = jobs
    assert whole.run()[0] == 0
    process = stopped.start(environment=slow_tiles(stopped))
    stopped.until(process, 1)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=600)
    kept = len(stopped.done())
    assert process.returncode == 75
    assert 0 < kept < count // 256
    assert stopped.run()[0] == 0
    left, right = (content(job.output) for job in jobs)
    assert left.keys() == right.keys()
    battery.row(
        f"{count:,} lanes for {transient:,} periods, whole and in {count // 256} tiles stopped after {kept} and resumed",
        sum(left[name] != right[name] for name in left),
        0,
        "variables that differ:",
    )
    battery.note(
        "Lanes run in vectors of one fixed width, which is part of the program: other widths give other last bits. Numbers "
        "do not depend on how many lanes there are, on how they are cut into tiles on disk, or on the devices."
    )


# ---- coexisting attractors


@pytest.mark.case("Coexisting attractors")
def test_coexisting_attractors(battery, lanes):
    """Random starts: every lane ends on an orbit that Newton finds and that is stable, or is chaotic; shares with errors."""
    count = 4096 if battery.full else 256
    picture = Figure(figsize=(12, 4.4), layout="constrained")
    chosen = (4.0, 5.51, 4.52, 5.475) if battery.full else (4.0,)
    for axes, b in zip(np.atleast_1d(picture.subplots(1, len(chosen))), chosen, strict=True):
        scene = scene_at(np.full(count, b), 240, "kahan_li8")
        starts = random_points(count)
        found = attractor_survey.survey(scene, lanes, starts, 16, "hard", 512)
        again = np.flatnonzero(found.period == 0)
        if len(again):  # slow ones get more time
            later = attractor_survey.survey(scene.take(again), lanes, found.u[again], 16, "hard", 4000)
            for leaf, new in zip(found[1:], later[1:], strict=True):
                leaf[again] = new
        settled, chaotic = np.flatnonzero(found.period > 0), np.flatnonzero(found.period == 0)
        unproven = int(np.sum(~proven_chaotic(lanes, scene, found.u[chaotic]))) if len(chaotic) else 0
        battery.row(f"b = {b}, {count:,} random starts", unproven, 0, "lanes on no verified attractor:")
        residual = worst(found.residual[settled])
        battery.row(f"b = {b}: orbits by Newton, all stable", residual, 1e-9, "largest residual")
        assert np.all(found.multiplier[settled] < 1)
        kinds = attractors(lanes, scene, found, settled)
        shares = [(members, len(members) / count) for members in kinds]
        words = []
        for members, share in shares:
            error = math.sqrt(share * (1 - share) / count)
            n, at = int(found.period[members[0]]), found.u[members[0]]
            words.append(f"period {n} through ({at[0]:.4f}, {at[1]:.4f}): {100 * share:.1f} ± {100 * error:.1f} %")
            axes.plot(starts[members, 0], starts[members, 1], ".", ms=2, label=f"period {n}: {100 * share:.1f} %")
        if len(chaotic):
            share = len(chaotic) / count
            error = math.sqrt(share * (1 - share) / count)
            words.append(f"chaos: {100 * share:.1f} ± {100 * error:.1f} %")
            axes.plot(starts[chaotic, 0], starts[chaotic, 1], ".", ms=2, label=f"chaos: {100 * share:.1f} %")
        axes.set(title=f"b = {b}", xlabel="x1 at the start", ylabel="y1 at the start")
        axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.2), markerscale=4)
        battery.note(f"b = {b}: {'; '.join(words)}.")
        # A symmetric attractor, or a pair of equal shares: starts are drawn evenly, and so is every mirror image.
        for members, share in shares:
            mirrored = mirror_of(found.u[members[0]])
            partner = next(
                (
                    other
                    for m, other in shares
                    if same_orbit(lanes, scene, found.u[m[0]], int(found.period[m[0]]), mirrored)
                ),
                None,
            )
            assert partner is not None
            assert abs(share - partner) <= 5 * math.sqrt(2 * share / count)
    battery.picture(picture, "coexisting", "Starts by the attractor that they reach")


def orbit_of(lanes, scene, u, n):
    return walk(lanes, scene, u, n)


def mirror_of(u):
    """The image under (x1, y1, n) → −(x1, y1, n)."""
    return np.array([-u[0], -u[1], u[2] + math.pi])


def same_orbit(lanes, scene, u, n, other):
    """Whether a point lies on the period-n orbit through u."""
    return bool(np.any(np.abs(CHART.wrap(orbit_of(lanes, scene, u, n) - other)).max(axis=1) < 1e-5))


def proven_chaotic(lanes, scene, u):
    """Which lanes, from section points (lanes, 3), have a largest exponent above twice its error bar."""
    there = replace(scene.take(slice(len(u))), start=jax.tree.map(np.asarray, CHART.state(u.T)))
    found = lyapunov.run(lyapunov.LyapunovOptions(transient=64, periods=2048, exponents=1), there, lanes)
    return found["exponents"].to_numpy()[:, 0] > 2 * found["exponents_error"].to_numpy()[:, 0]


def attractors(lanes, scene, found, left):
    """Those lanes of `left` by the orbit they are on: a list of index arrays, largest first."""
    kinds = []
    while len(left):
        first = left[0]
        points = orbit_of(lanes, scene, found.u[first], int(found.period[first]))
        gap = np.abs(CHART.wrap(found.u[left][:, None, :] - points[None])).max(axis=2).min(axis=1)
        mine = (gap < 1e-5) & (found.period[left] == found.period[first])
        assert mine[0]
        kinds.append(left[mine])
        left = left[~mine]
    return sorted(kinds, key=len, reverse=True)


# ---- a poisoned lane


@pytest.mark.slow
@pytest.mark.case("A poisoned lane")
def test_poisoned_lane(battery, lanes, tmp_path):
    """Not a number, infinite, or so large that the force overflows: that lane is marked failed, the others keep their bits."""
    count = 600 if battery.full else 24  # of a tile of 32
    values = np.linspace(5.2, 5.8, count)
    scene = scene_at(values, 110)
    clean = everything(scene, lanes)
    place = count // 2
    others = np.arange(count) != place
    for poison in (math.nan, math.inf, -1e200):
        bad = values.copy()
        bad[place] = poison
        groups = everything(scene_at(bad, 110), lanes)
        differing = sum(
            int(np.sum(~same(clean[name].variables[v].values[others], found.values[others])))
            for name in groups
            for v, found in groups[name].variables.items()
            if found.dims[:1] == (LANE,)
        )
        battery.row(
            f"b = {poison:g} in lane {place} of {count}: all other lanes of 5 analyses",
            differing,
            0,
            "numbers that differ:",
        )
        assert groups["period"]["status"].to_numpy()[place] == 3
        assert np.count_nonzero(groups["period"]["status"]) == 1
        assert verdict.KINDS[groups["verdict"]["kind"].to_numpy()[place]] == "failed"
        assert math.isnan(groups["diagram"]["x1"].to_numpy()[place, -1])
    # A finite b that no steps can follow is no poison: it is refused by its value before anything runs.
    with pytest.raises(AccuracyError, match="b = 1000000") as refusal:
        calibrated(constant_speed(), START, np.append(values, 1e6), lanes).cheapest(1e-8)
    battery.refused(f"b = 1e6 beside {count} others", str(refusal.value))
    path = tmp_path / "poisoned.yaml"
    for word in (".nan", ".inf"):
        path.write_text(
            f"system: {{constraint: constant_speed}}\nsweep: {{b: {{values: [5.5, {word}]}}}}\nanalyses: {{period: {{}}}}\n"
        )
        with pytest.raises(ConfigError, match="finite number") as refusal:
            load(path)
        battery.refused(f"b = {word} in a config", str(refusal.value).split(": ", 1)[1])


def everything(scene, lanes):
    """Groups of five analyses of a scene."""
    groups = {"period": period.run(period.PeriodOptions(max_period=4, transient=64), scene, lanes)}
    groups["lyapunov"] = lyapunov.run(lyapunov.LyapunovOptions(transient=16, periods=16), scene, lanes)
    groups["chaos01"] = chaos01.run(chaos01.Chaos01Options(transient=16, periods=100), scene, lanes)
    groups["verdict"] = verdict.run(verdict.VerdictOptions(), scene, lanes, groups)
    groups["diagram"] = diagram.run(diagram.DiagramOptions(transient=16, strobes=8), scene, lanes)
    return groups


def same(one, other):
    return (one == other) | (np.isnan(one.astype(float)) & np.isnan(other.astype(float)))
