"""Curves of bifurcations through the whole package: a cusp in closed form, doublings of the particle over b and a."""

from __future__ import annotations

import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.continuation import curves
from jaxnh.analyses.options.orbits import CurvesOptions
from jaxnh.exceptions import ConfigError
from jaxnh.maps.iterate import Derivatives
from jaxnh.orbits.bifurcations.codimension_two import POINTS
from jaxnh.orbits.continuation.core import Solution
from jaxnh.orbits.continuation.curves import Curve, ParameterPlane, join_unknowns
from jaxnh.orbits.continuation.kinds import FOLD, KINDS
from jaxnh.orbits.continuation.paths import CLOSED, ENDS, MOST_POINTS
from jaxnh.systems.particle import constant_speed
from tests.flows.normal_forms import normal_form
from tests.flows.particle import twin
from tests.helpers import taylor
from tests.helpers.kept_programs import session_of
from tests.helpers.paths import ROOT


def test_a_curve_with_a_point_twice_passes_where_it_did():
    """From (0, 0) to (1, 1) with the middle twice, as where a curve is continued from its end: points on it are on it."""
    plane = ParameterPlane(None, lambda gap: gap, np.ones(1), np.zeros(2), np.ones(2))
    values = np.repeat([0.0, 0.5, 0.5, 1.0], 2).reshape(4, 2)
    points = np.zeros((4, 1, 1))
    way = np.tile([0.0, np.sqrt(0.5), np.sqrt(0.5)], (4, 1))
    track = Solution(join_unknowns(plane, points, values), way, *([None] * (len(Solution._fields) - 2)))
    curve = Curve(0, points, values, track, np.ones((4, 1)), (0, 0))
    for at, there in ((0.25, True), (0.5, True), (0.9, True), (1.5, False)):
        assert curves._passes(plane, curve, curves.CurveSeed(0, np.zeros((1, 1)), np.array([at, at]))) is there


def test_a_third_parameter_is_fixed_by_a_call():
    """Doublings of x → a − x² + b y + c x, y → x, at c = 0.1, in closed form."""

    def system(a=0.5, b=0.1, c=0.0):
        return {"map": lambda y: (a - y[0] ** 2 + b * y[1] + c * y[0], y[0]), "coordinates": ("x", "y")}

    session = jaxnh.Session(system, {"x": 0.1, "y": 0.0})
    data = session.run(jaxnh.Curves(max_period=1), c=0.1, a=np.linspace(0.0, 1.0, 6), b=np.linspace(0.0, 0.4, 3))
    a, b = (data[name].to_numpy().ravel() for name in "ab")
    x = (1.1 - b) / 2  # a multiplier −1: 1 + (c − 2x) − b = 0
    assert data.sizes["curve"] == 1
    assert np.abs(a - ((0.9 - b) * x + x**2)).max() < 1e-12


def ring(u, values):
    """x → x + x² + p² + q² − 1/4: folds on a circle, at x = 0."""
    x, (p, q) = u[:, 0], values.T
    slopes = np.stack([2 * p, 2 * q], axis=1)[:, None]
    return Derivatives((x + x**2 + p**2 + q**2 - 0.25)[:, None], (1 + 2 * x)[:, None, None], slopes)


@pytest.mark.parametrize(("angles", "ends"), [((0.0, 90.0), MOST_POINTS), ((0.0, 120.0, 240.0), CLOSED)])
def test_a_curve_that_is_cut_is_listed_once(angles, ends):
    """Arcs of one circle that are cut by `max_steps` and overlap are one curve, and all around a closed one."""
    plane = ParameterPlane(ring, lambda gap: gap, np.ones(1), np.full(2, -1.0), np.full(2, 1.0))
    turns = np.deg2rad(angles)
    seeds = [curves.CurveSeed(FOLD, np.zeros((1, 1)), 0.5 * np.array([np.cos(turn), np.sin(turn)])) for turn in turns]
    options = CurvesOptions(ds_max=0.05, max_steps=14)
    apart = [curve for seed in seeds for curve in curves._follow_curves(plane, [], [seed], options)]
    assert {curve.ends for curve in apart} == {(MOST_POINTS, MOST_POINTS)}
    [whole] = curves._follow_curves(plane, [], seeds, options)
    assert curves._follow_curves(plane, [whole], seeds, options) == [whole]
    assert whole.ends == (ends, ends)
    assert np.abs(np.linalg.norm(whole.values, axis=1) - 0.5).max() < 1e-9
    assert np.abs(whole.multipliers - 1.0).max() < 1e-9
    turned = np.unwrap(np.arctan2(whole.values[:, 1], whole.values[:, 0]))
    steps = np.diff(turned) * np.sign(turned[-1] - turned[0])
    assert np.all(steps > 0.0)  # no point twice, and none passed over
    assert steps.max() < 2.5 * 0.05 / 0.25
    assert (np.abs(turned[-1] - turned[0]) >= 2 * np.pi) is np.bool_(ends == CLOSED)


BOTH = "p: {start: -0.6, stop: 0.6, count: 13}, q: {start: -0.5, stop: 1.0, count: 4}"


def cusp(folder, sweep=BOTH, options="{max_period: 1, transient: 64, n_values: 2}"):
    parameters, initial = "p=0.0, q=0.5", "{x: 1.0, z: 0.1}"
    return normal_form(folder, "p + q * x - x**3", parameters, initial, sweep, f"curves: {options}")


def bogdanov(p=-0.1, q=0.05, scale=0.1):
    """Bogdanov's map, Y → Y + p + qY + x² + xY and x → x + Y of the Y before: its determinant is 1 + q + x, and where that
    is one the trace is 2 + 2x."""

    def image(s):
        x, y = s[0], scale * s[1]
        y = y + p + q * y + x * x + x * y
        return x + y, y / scale

    return {"map": image, "coordinates": ("x", "y")}


@pytest.mark.parametrize("scale", [0.1, 1.0])
def test_a_neutral_saddle_is_no_resonance(scale):
    """Folds and Neimark–Sacker points both end in the resonance 1:1 at p = q = 0. The latter go on to neutral saddles, of
    which one has a symmetric matrix, and was listed as another."""
    session = jaxnh.Session(bogdanov, start={"x": -0.3, "y": 0.01}, parameters={"scale": scale})
    options = jaxnh.Curves(max_period=1, transient=64, n_values=3)
    data = session.run(options, p=np.linspace(-0.3, 0.1, 7), q=np.linspace(-0.21, 0.42, 3))
    assert jaxnh.labels(data["codimension_two_kind"]).to_numpy().tolist() == ["resonance 1 1"] * 2
    for name in ("codimension_two_p", "codimension_two_q"):
        assert np.all(np.abs(data[name].to_numpy()) <= data[f"{name}_error"].to_numpy())


@pytest.mark.slow
def test_cusp_over_two_parameters(tmp_path):
    """4q³ = 27p² from one end of the plane to the other, through the cusp at (0, 0): one curve, and nothing else."""
    tree = session_of(cusp(tmp_path)).tree()
    data = tree["curves"]
    assert [KINDS[kind] for kind in data["kind"].values] == ["fold"]
    p, q = (data[name].values[0] for name in ("p", "q"))
    assert np.abs(4 * q**3 - 27 * p**2).max() < 1e-9
    assert q[[0, -1]] == pytest.approx([1.0, 1.0])
    assert p[0] == pytest.approx(-p[-1])
    assert [POINTS[kind] for kind in data["codimension_two_kind"].values] == ["cusp"]
    assert abs(float(data["codimension_two_p"][0])) < 1e-9
    assert abs(float(data["codimension_two_q"][0])) < 1e-9
    jaxnh.figure(tree)


@pytest.mark.parametrize(
    ("sweep", "message"),
    [
        ("p: {start: -0.6, stop: 0.6, count: 13}", "over two axes of more than one value, and the sweep has p"),
        ("p: {values: [0.1, 0.2]}, q: {values: [0.1]}", "over two axes of more than one value, and the sweep has p"),
    ],
)
def test_what_curves_cannot_do_is_said(tmp_path, sweep, message):
    with pytest.raises(ConfigError, match=message):
        cusp(tmp_path, sweep).requested()


@pytest.mark.slow
@pytest.mark.parametrize("target", [1e-10, 1e-5])
def test_doublings_of_the_particle_over_two_parameters(target):
    """Points of the first two curves over b and a, each against the Taylor reference at its own a: to 1e-8.

    Within their errors, of which that of a counts by the slope of the curve there; the reference's own is below 1e-11.
    """
    settings = [
        "sweep={b: {start: 5.4, stop: 5.7, count: 5}, a: {start: 0.48, stop: 0.52, count: 3}}",
        "analyses={curves: {max_period: 2, transient: 256, n_values: 1, ds_max: 0.05}}",
        f"accuracy.target={target}",
    ]
    experiment = jaxnh.load(ROOT / "configs/chart_b_a.yaml", settings)
    data = session_of(experiment).tree()["curves"]
    for n in (1, 2):
        [k] = [
            k
            for k in range(data.sizes["curve"])
            if KINDS[int(data["kind"][k])] == "period_doubling" and int(data["period"][k]) == n
        ]
        b, a = (data[name].values[k] for name in ("b", "a"))
        known = np.flatnonzero(np.isfinite(b))
        for place in known[[0, len(known) // 2, -1]]:
            par = twin(constant_speed(a=float(a[place])))
            start = par.start().astype(float)
            value = float(b[place])
            for _ in range(400):  # above the doubling, where the orbit attracts: that of period 2 has its own at 0.024
                [start] = taylor.strobe(par, np.array([value + 0.005]), np.array([start]))
            exact = float(taylor.doubling_point(par, n, value, taylor.orbit(par, n, value, start)[0])[0])
            assert abs(value - exact) < max(1e-8, 10 * target)
            beside = known[[max(place - 2, 0), min(place + 2, len(known) - 1)]]
            slope = abs(np.diff(b[beside])[0] / np.diff(a[beside])[0])
            errors = [float(data[f"{name}_error"].values[k, place]) for name in ("b", "a")]
            assert abs(value - exact) <= errors[0] + slope * errors[1] + 1e-11


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("{equilibria: 4, box: {x: [-1, 1]}}", "a flow with a clock has no equilibria"),
        ("{equilibria: 4}", "needs a box to draw from"),
        ("{box: {x: [-1, 1]}}", "goes with equilibria, the number of random starts in it"),
        ("{max_period: 0}", "give equilibria"),
    ],
)
def test_equilibria_that_curves_cannot_follow(tmp_path, options, message):
    with pytest.raises(ConfigError, match=message):
        cusp(tmp_path, options=options).requested()


LORENZ84 = """\
system: {file: FILE}
initial: {x: 1.0, y: 0.1, z: 0.3, u: 0.1}
section: {coordinate: y, value: -0.02, direction: up}
sweep: {f: {start: 1.0, stop: 3.2, count: 6}, tau: {start: -0.1, stop: 0.1, count: 5}}
accuracy: {target: 1.0e-8}
analyses:
  curves: {max_period: PERIOD, transient: 16, n_values: 2, equilibria: 8, seed: 1, max_steps: STEPS,
    box: {x: [0, 2], y: [-1, 1], z: [-1, 1], u: [-1, 1]}}
"""

FIELD = """\
def system(f=2.0, tau=0.04):
    def rhs(state, time):
        x, y, z, u = state
        return (
            -y * y - z * z - 0.25 * x + 0.25 * f - 0.987 * u * u,
            x * y - x * z - y + 0.25,
            x * y + x * z - z,
            -1.04 * u + 0.987 * u * x + tau,
        )

    return {"rhs": rhs, "coordinates": ("x", "y", "z", "u")}
"""


def lorenz84(folder, period, steps):
    file = folder / "lorenz84.py"
    file.write_text(FIELD)
    text = LORENZ84.replace("FILE", str(file)).replace("PERIOD", str(period)).replace("STEPS", str(steps))
    return session_of(jaxnh.Experiment.from_text(text)).tree()


@pytest.mark.slow
def test_curves_of_equilibria_of_lorenz84(tmp_path):
    """From random starts to all points of codimension two, with their tables and picture; no cycle is followed."""
    tree = lorenz84(tmp_path, 0, 500)
    data, points = tree["curves"], tree["codimension_two"]
    assert sorted(KINDS[kind] for kind in data["kind"].values) == ["fold", "hopf", "hopf", "hopf"]
    assert set(data["period"].values.tolist()) == {0}
    names = [POINTS[kind] for kind in points["kind"].values]
    assert {"cusp", "bogdanov_takens", "zero_hopf", "generalised_hopf", "double_hopf"} == set(names)
    # T of the double Hopf point in BifurcationKit's tests (test/hopf_codim_2/lorenz84.jl), where it is known to 1e-5.
    at = np.array([name == "double_hopf" for name in names])
    assert np.abs(points["tau"].values[at]) == pytest.approx(0.02627393, rel=1e-5)
    assert np.isfinite(points["coefficients"].values[at]).all()
    assert np.isfinite(points["x"].values).all()
    jaxnh.figure(tree)


@pytest.mark.slow
def test_curves_of_cycles_of_lorenz84(tmp_path):
    """Folds of cycles from the generalised Hopf points and tori from the double Hopf points.

    u -> −u, τ -> −τ is a symmetry: curves of folds at either τ are images of each other, those of tori of themselves.
    """
    tree = lorenz84(tmp_path, 1, 500)
    data, points = tree["curves"], tree["codimension_two"]
    cycles = [KINDS[kind] for kind, n in zip(data["kind"].values, data["period"].values, strict=True) if n]
    assert "fold" in cycles
    tori = np.flatnonzero((data["kind"].values == KINDS.index("neimark_sacker")) & (data["period"].values == 1))
    assert len(tori) == 2  # each from one double Hopf point to its image
    for k in tori:
        tau = data["tau"].values[k][np.isfinite(data["tau"].values[k])]
        assert [abs(tau[0]), abs(tau[-1])] == pytest.approx([0.02627393] * 2, rel=1e-4)
        assert tau[0] * tau[-1] < 0.0
    cusps = points["kind"].values == POINTS.index("cusp")  # where folds of cycles leave the section there is none
    assert set(data["period"].values[points["curve"].values[cusps]].tolist()) == {0}
    for k in np.flatnonzero((data["kind"].values == KINDS.index("fold")) & (data["period"].values == 1)):
        assert sorted(ENDS[int(data[end][k])] for end in ("begins", "ends")) == ["no_convergence", "range"]
    third = np.flatnonzero(points["kind"].values == POINTS.index("resonance_1_3"))
    assert len(third) == 2
    for name, sign in (("f", 1.0), ("tau", -1.0)):
        one, other = points[name].values[third]
        assert abs(one - sign * other) <= points[f"{name}_error"].values[third].sum()
        assert points[f"{name}_error"].values[third].max() < 1e-9
    # Between f = 2.5709 and 2.5764 two of four multipliers are real, −1.0125 and −0.9877 at most: a neutral saddle.
    second = np.sort(points["f"].values[points["kind"].values == POINTS.index("resonance_1_2")])
    assert len(second) == 6
    assert np.all(np.diff(second)[::2] < 1e-6)
    assert second[::2] == pytest.approx([2.57091, 2.57643, 3.12003], abs=1e-5)
    assert np.isfinite(points["f_error"].values).all()  # no Chenciner point beside a double Hopf point
