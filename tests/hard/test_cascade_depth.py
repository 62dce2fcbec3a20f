"""On the edge of a doubling and deep in the cascade: Newton and multiple shooting where iteration and products fail."""

from __future__ import annotations

import math

import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxnh
from jaxnh.analyses import chaos01, verdict
from jaxnh.analyses.cascade.follow import follow
from jaxnh.analyses.exponents import lyapunov
from jaxnh.analyses.periodic import attractor_survey, newton_on_lanes, period
from jaxnh.maps.iterate import derivatives
from jaxnh.orbits.bifurcations.doubling_points import doubling_point, follow_branch
from jaxnh.orbits.shooting import close_orbits
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import CHART, constant_speed
from tests.helpers import taylor
from tests.helpers.batches import batch_of
from tests.helpers.battery import worst
from tests.helpers.paths import ROOT

START = ((0.1, 0.1), (0.1, math.sqrt(0.99)))
SCENE = batch_of(constant_speed(), START, [5.54], SPLITTINGS["kahan_li8"], 320, True, 1e-11)
FEIGENBAUM, ALPHA = 4.669201609102990, 2.502907875095892  # Briggs, Math. Comp. 57 (1991) 435


def turned(blocks, basis):
    """One turn of a basis (3, 3) through blocks (n, 3, 3), by Gram–Schmidt in long double, and ln of its growth (3,)."""
    logs = np.zeros(3, np.longdouble)
    for block in blocks:
        vectors = (block @ basis).T
        for k in range(3):
            for j in range(k):
                vectors[k] -= (vectors[k] @ vectors[j]) * vectors[j]
            length = np.sqrt(vectors[k] @ vectors[k])
            vectors[k] /= length
            logs[k] += np.log(length)
        basis = vectors.T
    return basis, logs


@pytest.fixture(scope="module")
def one_period(lanes):
    strobe = SCENE.strobe()
    return lambda u, b: lanes(derivatives, (strobe, np.int32(1)), (u, {"b": b}), tile=32)


@pytest.fixture(scope="module")
def first(lanes, one_period):
    """The doubling 1 → 2."""
    start = attractor_survey.survey(SCENE, lanes, constant_speed().chart.host_points(START)[None], 2, "hard", 300)
    return doubling_point(one_period, follow_branch(one_period, start.u, 5.54, 5.515, CHART.wrap), CHART.wrap)


# ---- on the edge of a doubling


@pytest.mark.slow
@pytest.mark.case("On the edge of a doubling")
def test_on_the_edge_of_a_doubling(battery, lanes, first):
    """Newton decides right on both sides, however near, and takes no more steps for it."""
    n_edges = np.arange(2, 13)
    battery.note(
        "Sums are compensated in these two cases: with plain ones the rounding of the map, 1e-13 and times the "
        "curvature 1e-11 in μ, turns verdicts about at \\|1 + μ\\| = 1e-12."
    )
    par = taylor.Parameters()
    exact, _, info = taylor.doubling_point(par, 1, first.value, first.orbit[0])
    battery.row(
        "doubling 1 → 2, by Taylor with Newton", abs(float(first.value - exact)), 1e-11 + info.error, "error of b"
    )
    h = 1e-5
    at = {"b": first.value + np.array([-h, h])}
    near = newton_on_lanes.orbits(lanes, SCENE.strobe(), np.tile(first.orbit, (2, 1)), at, 1)
    low, high = (np.linalg.eigvals(m).real.min() for m in near.monodromy)
    kappa = (high - low) / (2 * h)
    edge = 10.0**-n_edges
    b = np.concatenate([first.value + edge / kappa, first.value - edge / kappa])
    start = np.tile(constant_speed().chart.host_points(START), (len(b), 1))
    scene = SCENE.at_values(b)
    found = attractor_survey.survey(scene, lanes, start, 16, "hard", 512)
    found = attractor_survey.polish_beyond_doublings(lanes, scene.strobe(), dict(scene.p), found)
    wanted = np.repeat([1, 2], len(edge))
    wrong = int(np.sum(found.period != wanted))
    battery.row("|1 + μ| = 1e-2 … 1e-12 on both sides: periods 1 and 2", wrong, 0, "wrong periods:")
    # Beyond it 2n has μ = 1 − 4|1 + μ_n| + …, found with the orbit of period n divided out: no root is threefold, and
    # what is left is rounding, as before it (the note), and the error of b at the doubling that the row above allows.
    expected = np.concatenate([1 - edge, 1 - 4 * edge])
    off = np.abs(found.multiplier - expected) / (10 * edge[None, :].repeat(2, 0).ravel() ** 2 + 1e-11)
    battery.row("largest multiplier: of 1e-11 and the second order in |1 + μ|", worst(off), 1.0, "share")
    before = found.u[: len(edge)]
    blocks = taylor.strobe_jacobian(par, b[: len(edge)], before)[1].astype(float)
    reference = np.array([np.abs(np.linalg.eigvals(m)).max() for m in blocks])
    off = np.abs(reference - found.multiplier[: len(edge)])
    battery.row("multiplier of period 1, by Taylor's monodromy matrix", worst(off), 1e-9, "error")
    steps = [
        newton_on_lanes.orbits(lanes, SCENE.strobe(), np.tile(first.orbit + 0.01, (len(edge), 1)), {"b": side}, 1).steps
        for side in np.split(b, 2)
    ]
    battery.row("Newton steps to the orbit of period 1", int(np.max(steps)), int(np.min(steps)) + 1, "largest number")
    picture = Figure(figsize=(7, 4), layout="constrained")
    axes = picture.subplots()
    for side, label in ((slice(0, len(edge)), "before, period 1"), (slice(len(edge), None), "beyond, period 2")):
        axes.loglog(edge, np.abs(1 - found.multiplier[side]), "o", label=label)
    axes.loglog(edge, edge, "k:", lw=0.8)
    axes.loglog(edge, 4 * edge, "k:", lw=0.8, label="1 and 4 times |1 + μ|")
    axes.set(xlabel="|1 + μ| of the orbit of period 1", ylabel="1 − largest multiplier found")
    axes.legend()
    battery.picture(picture, "edge", "Multipliers on both sides of a doubling")
    if battery.full:
        scene = SCENE.at_values(b)
        done = {"period": period.run(period.PeriodOptions(max_period=16), scene, lanes)}
        done["lyapunov"] = lyapunov.run(lyapunov.LyapunovOptions(transient=512, periods=1024), scene, lanes)
        done["chaos01"] = chaos01.run(chaos01.Chaos01Options(transient=512), scene, lanes)
        kind = verdict.run(verdict.VerdictOptions(), scene, lanes, done)["kind"].to_numpy()
        battery.row("verdict of these 22 b, all of them periodic", int(np.sum(kind != 0)), 0, "other verdicts:")


# ---- deep in the cascade


@pytest.mark.case("Deep in the cascade")
@pytest.mark.slow
def test_deep_in_the_cascade(battery, lanes, one_period):
    """Doubling points up to 1024 → 2048, and stable orbits between them closed and with all their multipliers."""
    deepest = 11 if battery.full else 7
    points = follow(SCENE.at_values(np.linspace(5.5275, 5.4525, 48)), lanes, deepest).points
    assert all(point.error < 1e-12 for point in points)  # rounding
    assert [len(point.orbit) for point in points] == [2**k for k in range(deepest)]
    b = np.array([point.value for point in points])
    par = taylor.Parameters()
    checked = range(1, 5 if battery.full else 2)
    exact = [float(taylor.doubling_point(par, 2**k, b[k], points[k].orbit[0])[0]) for k in checked]
    off = worst(np.abs(np.array(exact) - b[list(checked)]))
    battery.row(
        f"doublings 2 → 4 to {2 ** checked[-1]} → {2 ** (checked[-1] + 1)}, by Taylor", off, 1e-10, "error of b"
    )
    delta = (b[1:-1] - b[:-2]) / (b[2:] - b[1:-1])
    # Each level's δ is nearer to the limit than to the one before, as corrections that at least halve with a level
    # (theory: by δ, and by −8) make it; beside it what errors of b as large as by Taylor make of the distances.
    gaps = np.abs(np.diff(b))
    rounding = 2 * max(off, 1e-12) * delta * (1 / gaps[:-1] + 1 / gaps[1:])
    left = np.abs(delta[1:] - FEIGENBAUM) / (np.abs(np.diff(delta)) + rounding[1:])
    battery.row(
        f"δ of {len(delta)} levels, the last {delta[-1]:.5f}: distance from Feigenbaum's",
        worst(left),
        1.0,
        "over the last step",
    )
    closing = []
    for k in (6, 8, 10) if battery.full else (6,):
        n, last = 2**k, points[k]
        # Midway between two doublings, from the orbit at the second.
        at = 0.5 * (points[k - 1].value + last.value)
        orbit = close_orbits(one_period, last.orbit[None], np.array([at]), CHART.wrap)
        residual, blocks = orbit.residual[0], orbit.blocks[0]
        closing.append(residual)
        battery.row(f"period {n} at b = {at:.12f}: closed", residual, 1e-10, "largest gap")
        half = np.abs(CHART.wrap(orbit.points[0] - np.roll(orbit.points[0], n // 2, 0))).max()
        assert half > 1e-7  # not the orbit of half the period
        volume = lanes(log_volume, (SCENE.strobe(),), (orbit.points[0], {"b": np.full(n, at)}), tile=32).sum()
        ours = iterated(blocks)
        ours[2] = volume - ours[:2].sum()  # rounding loses the third in a single period already
        assert ours[0] < 0  # stable
        blocks = taylor.strobe_jacobian(par, np.full(n, at), orbit.points[0])[1]
        off = np.abs(ours - iterated(blocks)) / np.maximum(np.abs(ours), 1.0)
        battery.row(
            f"period {n}: ln\\|μ\\| = {ours[0]:.4f}, {ours[1]:.2f}, {ours[2]:.2f}, by Taylor",
            worst(off),
            1e-6,
            "error, relative,",
        )


@pytest.mark.slow
@pytest.mark.case("Deep in the cascade")
def test_deep_in_the_cascade_of_the_governor(battery):
    """δ and α of a user's flow in double-double precision, to what extrapolation leaves of corrections of the last level.

    Those are δ⁻ⁿ and α⁻ⁿ of n levels, and extrapolation takes out these at least; see `tests.analyses.test_extended_cascade`.
    """
    levels = 16 if battery.full else 10
    asked = ["sweep.drive.start=0.83", "accuracy.target=1e-3", "accuracy.precision=extended"]
    asked.append(f"analyses={{doubling: {{levels: {levels}}}}}")
    data = jaxnh.Session(jaxnh.load(ROOT / "configs/governor.yaml", asked)).run("doubling")
    assert data["levels_found"] == levels
    for name, limit, exact, rate in (("δ", "delta_limit", FEIGENBAUM, FEIGENBAUM), ("α", "alpha", ALPHA, ALPHA)):
        shown = f"the governor's {levels} levels in double-double precision: {name}"
        off, error = abs(float(data[limit]) - exact), float(data[f"{limit}_error"])
        battery.row(f"{shown}, distance from Feigenbaum's", off / error, 1.0, "over its error")
        battery.row(f"{shown}, its error", error, rate**-levels, "of corrections of the last level:")


@pytest.mark.slow
@pytest.mark.case("Deep in the cascade")
def test_deep_in_the_cascade_of_the_particle(battery):
    """δ and α of the paper's tables in double-double precision, to ten digits from 16 levels, with errors that cover.

    Doublings are known to 1e-28 and the last distance is 1e-12 of the range, so that rounding leaves δ_15 at 1e-14 of
    it. Its correction of δ⁻¹⁶ is 1e-11, and of widths that of α⁻¹⁶ is 4e-7; extrapolation takes out these and more.
    Of fewer levels errors may be larger by as much as these corrections are.
    """
    levels = 16 if battery.full else 10
    asked = ["accuracy.target=1e-6", "accuracy.precision=extended", f"analyses={{doubling: {{levels: {levels}}}}}"]
    for flow in ("table1", "table2") if battery.full else ("table2",):
        data = jaxnh.Session(jaxnh.load(ROOT / f"configs/{flow}.yaml", asked)).run("doubling")
        assert data["levels_found"] == levels
        for name, limit, exact, least, rate in (
            ("δ", "delta_limit", FEIGENBAUM, 1e-10, FEIGENBAUM),
            ("α", "alpha", ALPHA, 1e-6, ALPHA),
        ):
            shown = f"{flow}, {levels} levels in double-double precision: {name}"
            off, error = abs(float(data[limit]) - exact), float(data[f"{limit}_error"])
            battery.row(f"{shown}, distance from Feigenbaum's", off / error, 1.0, "over its error")
            battery.row(f"{shown}, its error", error, least * rate ** (16 - levels), "at most")
        # The other digits are beyond float64, and of δ rounding leaves nothing but what steps do.
        name = data.attrs["along"]
        assert np.all(np.abs(data[f"{name}_low"]) <= np.spacing(data[name]) / 2)


def log_volume(strobe, u, p):
    """ln det ∂P/∂u of one lane, exact where the determinant itself is lost to rounding."""
    return strobe.pushforward(strobe.chart.state(u), p, ()).log_volume


def iterated(blocks):
    """ln|μ| by Gram–Schmidt in long double over blocks (n, 3, 3), the last of ten turns; multipliers are far apart."""
    basis = np.eye(3, dtype=np.longdouble)
    for _ in range(10):
        basis, logs = turned(blocks, basis)
    return np.sort(logs.astype(float))[::-1]
