"""Every analysis on every kind of flow, in small: each cell holds a number against one that is known, or a refusal.

What is known comes from closed forms (`tests/flows`), from scipy's DOP853 on equations written anew, and from the Taylor
reference. Steps are few and written as loops, as compiling is all that takes time here; their errors, below 1e-6, are
far below what a fault would do. A new analysis is in the table by itself, and fails until each kind says what it knows.
"""

from __future__ import annotations

import atexit
import functools
import re
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import jaxnh
from jaxnh.analyses.registry import ANALYSES
from jaxnh.config.yaml_source import from_text
from jaxnh.engine.accuracy import cost_model
from jaxnh.engine.executor import programs
from jaxnh.engine.experiment import Experiment
from jaxnh.exceptions import InputError, ResultError
from jaxnh.maps import general_flow
from jaxnh.solvers.adaptive import in_loop
from jaxnh.systems.straight_pieces import equations_within
from jaxnh.systems.user_file import UserFile
from tests.flows import constrained_oscillators, known_maps, moebius, paper_equations
from tests.flows.moebius import TURN
from tests.helpers import contract, taylor
from tests.helpers.kept_programs import QUICKLY_COMPILED, FewLanes, session_of

pytestmark = pytest.mark.usefixtures("uncalibrated")
UNSAID = ("mu", "nu")
FOLDER = Path(tempfile.mkdtemp(prefix="jaxnh_kinds_"))
atexit.register(shutil.rmtree, FOLDER, ignore_errors=True)
CLOSE = 1e-6  # what so few steps leave of a period's map, ten times
LONG_STEPS = {"ds": 0.1, "ds_max": 0.25}  # along curves, which are straight or nearly so
OPTIONS = {
    "portrait": {"transient": 4, "periods": 1, "samples": 4},
    "poincare": {"transient": 4, "strobes": 4},
    "diagram": {"transient": 4, "strobes": 4},
    "period": {"max_period": 2, "transient": 64},
    "lyapunov": {"transient": 32, "periods": 32},
    "chaos01": {"transient": 64, "periods": 100},
    "verdict": {"confirmation_factor": 0},
    "doubling": {"levels": 1},
    "windows": {"max_period": 2, "levels": 1, "crisis": 0, "transient": 64},
    "branches": {"max_period": 2, "transient": 64, **LONG_STEPS},
    "curves": {"max_period": 2, "transient": 64, "n_values": 1, **LONG_STEPS},
    "homoclinic": {"box": {"u": (-1.0, 1.0)}},
    "atlas": {"max_period": 2, "transient": 64, "n_values": 2, "levels": 0, **LONG_STEPS},
    "basins": {"transient": 32, "max_periods": 128, "max_period": 2},
    "reversal": {"transient": 64, "strobes": 64, "periods": 64},
    "orbits": {"max_period": 2, "transient": 64, "rounds": 4, "attractor": 256, "averages": True},
    "covariant": {"transient": 64, "strobes": 256},
    "transients": {
        "n_starts": 16,
        "box": {"u": (-0.5, 0.5)},
        "region": {"u": (-9.0, 9.0)},
        "max_periods": 16,
        "transient": 1,
    },
    "rotation": {"transient": 64, "periods": 128},
    "tori": {"transient": 64, "periods": 128},
    "torus_branches": {"transient": 64, "periods": 128, **LONG_STEPS},
    "transport": {"transient": 128, "periods": 256, "path": ("u",)},
    "manifolds": {
        "box": {"u": (-0.5, 0.5)},
        "n_starts": 4,
        "length": 0.2,
        "spacing": 0.05,
        "max_points": 64,
        "crossings": 0,
    },
    "edges": {
        "box": {"u": (-0.5, 0.5)},
        "n_starts": 4,
        "transient": 32,
        "max_periods": 128,
        "max_period": 2,
        "directions": 2,
        "shock_points": 1,
        "reach": 0.25,
    },
}
BY_LANE = ("edges", "orbits", "phase_response")
"""Analyses, or options, that take lanes one by one, or so many points of each: of the first axis the ends alone."""
UNSTABLE_ALONE = {"manifolds": OPTIONS["manifolds"] | {"kind": "unstable"}}


@pytest.fixture(autouse=True, scope="module")
def lowered_for_cuda_too():
    """Lower operations for CUDA as well, on any machine: in float64, by no call of the host or of a CPU's library.

    Rules of lowering are those of operations on types of numbers, so that each is lowered by itself, once. Of loops,
    branches and calls, whose operations are looked at one by one, one program each is lowered as it is.
    """
    seen = set()

    def lower(traced):
        outer = traced.jaxpr.jaxpr.eqns
        new = {}
        for equation in (inner for each in outer for inner in (each, *equations_within(each))):
            types = [v.aval.dtype for v in (*equation.invars, *equation.outvars)]
            calls = next(equations_within(equation), None) is not None
            new.setdefault((equation.primitive.name, *(() if calls else types)), (calls, equation))
        new = {key: one for key, one in new.items() if key not in seen}
        if new:
            seen.update(new)
            alone = [] if any(calls for calls, _ in new.values()) else [one for _, one in new.values()]
            lowered = jax.jit(evaluate_each(alone)).trace(*map(operands, alone)) if alone else traced
            text = lowered.lower(lowering_platforms=("cuda",)).as_text()
            assert "callback" not in text
            assert {call[:2] for call in re.findall(r"custom_call @(\w+)", text)} <= {"cu"}  # cuSOLVER and the like
            assert not re.search(r"\b(f32|f16|bf16)\b", text)
        return traced.lower()

    with mock.patch.object(programs, "_lower", lower):
        yield


def operands(equation):
    """Shapes and types of what an equation reads."""
    return [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in equation.invars]


def evaluate_each(equations):
    """A function of the operands of equations, each by itself."""

    def evaluate(*given):
        return [each.primitive.bind(*one, **each.params) for each, one in zip(equations, given, strict=True)]

    return evaluate


def starts_between(name, low, high):
    """Options of what draws starts in a box, in a range of another coordinate, and of `transport` along it."""
    return {
        "transients": OPTIONS["transients"] | {"box": {name: (low, high)}, "region": {name: (-9.0, 9.0)}},
        "transport": OPTIONS["transport"] | {"path": (name,)},
        "manifolds": OPTIONS["manifolds"] | {"box": {name: (low, high)}},
        "edges": OPTIONS["edges"] | {"box": {name: (low, high)}},
    }


class Kind(NamedTuple):
    """A kind of scene.

    Attributes:
        config: without its analyses; a system's file stands in it as FILE.
        known: what each analysis is held against: a check of (session, its dataset), or the words of a refusal.
        file: the user's file, if any.
        options: other options than those of all, by analysis.
    """

    config: str
    known: Mapping[str, Callable | str]
    file: str = ""
    options: Mapping[str, Mapping] = {}


def lanes_of(data, *names):
    """Variables over (lane, ...), and the values of the axes by name, each (lanes,)."""
    axes = str(data.attrs["axes"]).split()
    stacked = data.stack(lane=axes).transpose("lane", ...)
    return *(stacked[name].to_numpy() for name in names), {axis: stacked[axis].to_numpy() for axis in axes}


# ---- checks


def follows(rates, names, angle=False, even=False):
    """The last sample or strobe follows from the first by DOP853, over the time between; if even, or its opposite."""

    def check(data, _):
        *columns, values = lanes_of(data, *names)
        if angle:  # (x1, y1, θ) of (x1, y1, x2, y2)
            columns[2:] = [np.arctan2(columns[3], columns[2])]
        states = np.stack(columns, axis=-1)
        for lane in range(0, len(states), 5):
            p = {name: float(leaf[lane]) for name, leaf in values.items() if name in known_parameters(rates)}
            span = times_of(data, lane, TURN / p.get("omega", 1.0), states.shape[1])
            path = solve_ivp(functools.partial(rates, **p), span, states[lane, 0], "DOP853", rtol=1e-11, atol=1e-12)
            gap = path.y[:, -1] - states[lane, -1]
            if angle:
                gap[2] = (gap[2] + np.pi) % TURN - np.pi
            if even:
                gap = min(gap, path.y[:, -1] + states[lane, -1], key=lambda x: np.abs(x).max())
            assert np.abs(gap).max() < 20 * CLOSE, lane

    return check


def clamped_follows(data, _):
    """The last sample or strobe follows from the first, which is one."""
    x, v, values = lanes_of(data, "x", "x_dot")
    for lane in range(0, len(x), 3):
        span = times_of(data, lane, TURN, x.shape[1])
        known = constrained_oscillators.clamped(*span, (x[lane, 0], v[lane, 0]), values["mu"][lane])
        assert np.abs(known - (x[lane, -1], v[lane, -1])).max() < 20 * CLOSE


def clamped_exponents(data, _):
    """One is −∞, exactly, and the other mu/2 where the motion comes to rest; elsewhere it is that of two periods."""
    ours, error, values = lanes_of(data, "exponents", "exponents_error")
    rest = values["mu"] < 0
    assert np.all(np.isneginf(ours[:, 1]) & (error[:, 1] == 0))
    assert np.all(np.abs(ours[rest, 0] - values["mu"][rest] / 2) < error[rest, 0] + CLOSE)
    assert np.all(ours[~rest, 0] < 0)


def iterates_of(image, names):
    """Every strobe follows from the one before by a map written anew, to rounding."""

    def check(data, _):
        *columns, values = lanes_of(data, *names)
        later = image(*(leaf[:, :-1] for leaf in columns), **{key: leaf[:, None] for key, leaf in values.items()})
        for leaf, image_of_it in zip(columns, later, strict=True):
            assert np.abs(leaf[:, 1:] - image_of_it).max() < 1e-15
            assert np.abs(leaf).max() > 0.0

    return check


def known_parameters(rates):
    return rates.func.__code__.co_varnames if isinstance(rates, functools.partial) else rates.__code__.co_varnames


def times_of(data, lane, period, points):
    """Times of the first and the last point: as they say, or whole periods from the beginning of one."""
    if "t" not in data:
        return 0.0, (points - 1) * period
    t = data["t"].to_numpy()
    return (t if t.ndim == 1 else lanes_of(data, "t")[0][lane])[[0, -1]]


def periods(expected):
    def check(data, _):
        period, residual, values = lanes_of(data, "period", "residual")
        assert period.tolist() == np.broadcast_to(expected(values), period.shape).tolist()
        assert residual.max() < 1e-7

    return check


def exponents(expected):
    """All lanes, within their bars and what steps leave."""

    def check(data, _):
        ours, error, values = lanes_of(data, "exponents", "exponents_error")
        exact = -np.sort(-np.stack(np.broadcast_arrays(*expected(values)), axis=-1), axis=-1)
        assert np.all(np.abs(ours[:, -exact.shape[1] :] - exact) < error[:, -exact.shape[1] :] + CLOSE)

    return check


def sums(data, _):
    """The sum of all exponents is the mean divergence, which is integrated by itself."""
    exponents, residual, _ = lanes_of(data, "exponents", "sum_rule_residual")
    assert np.all(np.isfinite(exponents))
    assert np.abs(residual).max() < 100 * CLOSE


def no_chaos(data, _):
    """K of a motion that is periodic is no one; of one that has settled to rounding it is zero."""
    assert lanes_of(data, "k_median")[0].max() < 0.5


def chaos(data, _):
    """K of chaos tends to one."""
    assert lanes_of(data, "k_median")[0].min() > 0.5


def words(*expected):
    """Kinds of motion, of which each lane has one of these."""

    def check(data, _):
        names = data["kind"].attrs["flag_meanings"].split()
        assert {names[k] for k in lanes_of(data, "kind")[0]} <= set(expected)

    return check


def no_torus(data, _):
    """No orbit has a Neimark–Sacker bifurcation, and no motion turns: what was looked at is said."""
    assert data.sizes["torus_branch"] == 0
    assert "there is no torus to follow" in data.attrs["warnings"]


def tori_at_sea(data, _):
    """Where volumes are kept a curve is one of a family, and neutral."""
    names = data["kind"].attrs["flag_meanings"].split()
    assert {names[k] for k in np.unique(data["kind"])} <= {"none", "neutral", "undecided"}


def rotation(expected=None):
    """Locked with the period of the orbit as denominator, about the mean of its points; a single point has no angle."""

    def check(data, _):
        kind, denominator, numerator, value, values = lanes_of(data, "kind", "denominator", "numerator", "rotation")
        period = np.ones(len(kind), int) if expected is None else np.broadcast_to(expected(values), kind.shape)
        names = np.array(data["kind"].attrs["flag_meanings"].split())
        assert names[kind].tolist() == np.where(period > 1, "locked", "no_rotation").tolist(), values
        assert denominator.tolist() == np.where(period > 1, period, 0).tolist()
        assert np.all(np.abs(value - numerator / np.maximum(denominator, 1))[period > 1] < CLOSE)

    return check


def repellers(*expected):
    """Of these kinds, and the exponents backwards in time from the image are those of the attractor, less the sign."""

    def check(data, groups):
        words(*expected)(data, groups)
        ours, error, theirs, error_of_theirs, _ = lanes_of(
            data, "exponents", "exponents_error", "repeller_exponents", "repeller_exponents_error"
        )
        assert np.all(np.abs(ours + theirs) < error + error_of_theirs + CLOSE)

    return check


def orbit_numbers(expected):
    """So many orbits of one return and of two, and these are exact."""

    def check(data, groups):
        number, values = lanes_of(groups["orbit_counts"], "number")
        assert number.tolist() == np.stack(np.broadcast_arrays(*expected(values)), axis=-1).tolist()
        period, residual, _ = lanes_of(data, "period", "residual")
        assert residual[period > 0].max() < 1e-7

    return check


def orbits_beside(expected):
    """No fewer orbits of one return and of two than are known, and these are exact."""

    def check(data, groups):
        number, values = lanes_of(groups["orbit_counts"], "number")
        assert np.all(number >= np.stack(np.broadcast_arrays(*expected(values)), axis=-1))
        period, residual, _ = lanes_of(data, "period", "residual")
        assert residual[period > 0].max(initial=0.0) < 1e-7

    return check


def saddles(expected):
    """One saddle where there is one, with these multipliers along its unstable and its stable manifold."""

    def check(data, groups):
        manifolds_of_saddles(data, groups)
        number, multiplier, values = lanes_of(data, "saddles", "multiplier")
        multiplier = np.abs(multiplier)
        exact = np.stack(np.broadcast_arrays(*expected(values)), axis=-1)
        assert number.tolist() == np.isfinite(exact[:, 0]).astype(int).tolist()
        kinds = lanes_of(data, "branch_kind")[0]
        assert (
            np.abs(multiplier[:, 0] / np.take_along_axis(exact, kinds.astype(int), axis=1) - 1.0)[number > 0].max(
                initial=0.0
            )
            < 100 * CLOSE
        )

    return check


def manifolds_of_saddles(data, _):
    """Unstable branches grow and stable ones shrink; finer steps move them by little, and so does a shorter start."""
    multiplier, deviation, kind, _ = lanes_of(data, "multiplier", "deviation", "branch_kind")
    known, unstable = np.isfinite(multiplier), np.broadcast_to(kind[:, None] == 0, multiplier.shape)
    assert np.all((np.abs(multiplier) > 1.0)[known] == unstable[known])
    assert np.nanmax(deviation, initial=0.0) < 100 * CLOSE


def no_saddle(data, _):
    assert not lanes_of(data, "saddles")[0].any()


def nothing_leaves(data, _):
    """All motions stay around the attractor, and the rate is zero, with an interval that begins there."""
    life, escaped, rate, low, high, _ = lanes_of(
        data, "lifetime", "escaped", "escape_rate", "escape_rate_low", "escape_rate_high"
    )
    assert np.all(life == 16)
    assert not escaped.any()
    assert not rate.any()
    assert not low.any()
    assert np.all(high > 0.0)


def stays(data, _):
    """The path has no drift and no diffusion."""
    names = [name for name in map(str, data) if name.endswith("_drift")]
    drift, error, kind, _ = lanes_of(data, *names, f"{names[0]}_error", "diffusion_kind")
    assert np.all(np.abs(drift) <= error + CLOSE)
    words = np.array(data["diffusion_kind"].attrs["flag_meanings"].split())
    assert set(words[kind]) <= {"bounded"}


def wanders(data, _):
    """A chaotic motion in a potential well may come and go, but does not go away faster than by chance."""
    kind, _ = lanes_of(data, "diffusion_kind")
    words = np.array(data["diffusion_kind"].attrs["flag_meanings"].split())
    assert set(words[kind]) <= {"bounded", "subdiffusive", "normal", "undecided"}


def doubling(name, expected):
    """One doubling at each point of the other axes, within its error and what steps leave."""

    def check(data, _):
        values, errors = data[name].to_numpy().ravel(), data[f"{name}_error"].to_numpy().ravel()
        exact = np.ravel(expected(data))
        assert len(values) == len(exact)
        assert np.all(np.abs(values - exact) < errors + CLOSE)

    return check


def without_an_orbit(data, _):
    """No period up to the limit, and nothing said of an orbit."""
    assert not lanes_of(data, "period")[0].any()
    assert not np.any(np.isfinite(lanes_of(data, "multiplier")[0]))


def no_row(data, _):
    assert data["period"].size == 0


def no_branch(data, _):
    """None is there, and what was looked at is said."""
    assert data["period"].size == 0
    assert "looked at orbits of period" in data.attrs["warnings"]


def nothing_periodic(data, groups):
    """No orbit of a flow that keeps volume attracts. Whether a chaotic sea is called an attractor is left open here."""
    del data
    kind = groups["attractors"]["kind"]
    names = kind.attrs["flag_meanings"].split()
    assert {names[k] for k in kind.to_numpy().ravel() if k >= 0} <= {"chaotic", "quasiperiodic"}


def none_found(data, _):
    """Nothing, and a line that says what was searched."""
    assert not np.any(np.isfinite(data["delta"]))
    assert "no doubling was located between" in data.attrs["warnings"]


def one_window(name, kind, expected):
    """Of period 1 from one end of the range on, to a bifurcation or to the other end."""

    def check(data, _):
        assert data["period"].to_numpy().tolist() == [1]
        ends = [
            data[f"{side}_kind"].attrs["flag_meanings"].split()[int(data[f"{side}_kind"][0])]
            for side in ("begin", "end")
        ]
        assert ends == ["range", kind]
        if kind != "range":
            assert abs(float(data["end"][0]) - expected()) < float(data["end_error"][0]) + CLOSE

    return check


def branches(periods, name, expected=None):
    """Branches of these periods, and the doubling in `bifurcations`, if there is one."""

    def check(data, groups):
        assert sorted(set(data["period"].to_numpy().tolist())) == periods
        located = groups["bifurcations"]
        kinds = located["kind"].attrs["flag_meanings"].split()
        at = [
            float(located[name][i]) for i, k in enumerate(located["kind"].to_numpy()) if kinds[k] == "period_doubling"
        ]
        assert len(at) == (expected is not None)
        if at:
            assert abs(at[0] - expected()) < CLOSE

    return check


def straight_curves(data, groups):
    """The doubling at μ = ν, of any ν, and no point of codimension two; doubled orbits of amplitude 0.3 at μ = ν + 0.09."""
    straight(data, groups, {"period_doubling": (1, 0.0), "maximum": (2, 0.09)})


def straight(data, groups, curves):
    """Curves of such kinds, each of a period and at μ = ν and so much, from one end of ν to the other."""
    kinds = data["kind"].attrs["flag_meanings"].split()
    assert [kinds[k] for k in data["kind"].to_numpy()] == list(curves)
    assert data["period"].to_numpy().tolist() == [period for period, _ in curves.values()]
    for k, (_, above) in enumerate(curves.values()):
        mu, nu = (data[name].to_numpy()[k] for name in ("mu", "nu"))
        there = np.isfinite(mu)
        assert there.sum() > 5
        assert np.abs(mu - nu - above)[there].max() < CLOSE
        assert (nu[there].min(), nu[there].max()) == pytest.approx((-0.02, 0.02), abs=CLOSE)
    assert groups["codimension_two"].sizes["codimension_two"] == 0


def linked_curve(data, groups):
    """The doubling at μ = ν, with that of either row on it, its orbit at the origin, and one window to either side of it."""
    straight(groups["curves"], groups, {"period_doubling": (1, 0.0)})
    assert data["nu"].to_numpy().tolist() == [-0.02, 0.02]
    points = groups["bifurcations"]
    assert np.abs(points["mu"] - points["nu"]).max() < CLOSE
    assert points["curve"].to_numpy().tolist() == [0, 0]
    assert points["nu"].to_numpy().tolist() == [-0.02, 0.02]
    rows = groups["branches"]["nu"].to_numpy()
    assert rows[points["branch"].to_numpy()].tolist() == [-0.02, 0.02]
    assert np.nanmax(np.abs(groups["curve_orbits"]["u_points"])) < CLOSE
    windows = groups["windows"]
    assert windows["nu"].to_numpy().tolist() == [-0.02, 0.02]
    assert np.abs(windows["end"] - windows["nu"]).max() < CLOSE
    assert "periods up to 2" in data.attrs["complete_to"]


def nothing_along_rows(data, groups):
    """Branches of both rows, and no curve."""
    no_curve(groups["curves"], groups)
    assert data["bifurcations"].to_numpy().tolist() == [0, 0]
    assert np.all(data["branches"] > 0)
    assert int(data["curves"]) == int(data["cut"]) == 0


def no_curve(data, groups):
    """None: the period decides no multiplier, so that nothing happens along ω at any μ."""
    assert data.sizes["curve"] == groups["codimension_two"].sizes["codimension_two"] == 0


def one_attractor(data, groups):
    """Every start leads to the only one there is at its values."""
    number = lanes_of(data, "attractor")[0]
    assert np.all(number > 0)
    fraction = groups["attractors"]["fraction"]
    assert np.nanmax(fraction.to_numpy(), axis=fraction.dims.index("attractor")).min() == 1.0


def no_edges_at_sea(data, _):
    """No boundary of a flow that keeps volume; whether a chaotic sea is called an attractor is left open here."""
    kind, edge, _ = lanes_of(data, "attractor_kind", "kind")
    names = data["attractor_kind"].attrs["flag_meanings"].split()
    assert {names[k + 1] for k in np.unique(kind)} <= {"absent", "chaotic", "quasiperiodic"}
    assert not edge.any()


def no_edges(attractors, word):
    """No boundary, of lanes with so many attractors, and the word that says why; no shock that leaves."""

    def check(data, _):
        known, kind, status, shock, error, _ = lanes_of(data, "attractors", "kind", "status", "shock", "shock_error")
        assert np.all(known == attractors)
        assert not kind.any()
        assert {data["status"].attrs["flag_meanings"].split()[k] for k in status} == {word}
        assert np.isnan(shock).all()
        assert np.isnan(error).all()

    return check


# ---- kinds of scenes

WITHOUT_SECTION = "the system has no period, and {} looks at it on a section"
NO_REVERSAL = "no change of signs is a reversal"
JUMPS_HAVE_NONE = "whether a reversal takes jumps to jumps is not looked at"
NO_EQUILIBRIA = "a flow with a clock has no equilibria, which homoclinic orbits connect"
SADDLES_OVER_ONE = "homoclinic orbits are followed over two axes of more than one value, and the sweep has {}"
NOT_ISOLATED = "cycles and equilibria of a flow with constraints are not isolated"
NOT_SMOOTH = "collocation is of smooth motions, without jumps or switches"
ONE_PARAMETER = "curves are followed over two axes of more than one value, and the sweep has {}"
MU = "mu: {start: -0.28, stop: 0.28, count: 8}"
STEPS = "accuracy: {solver: dopri8, steps: 16}"


def excess(values):
    """By how much a lane is beyond the doubling at μ = ν."""
    return values["mu"] - values.get("nu", 0.0)


def moebius_exponents(values):
    beyond_it, rate = excess(values), values.get("omega", 1.0)
    return rate * np.where(beyond_it > 0, -2 * beyond_it, beyond_it), -rate * np.ones_like(beyond_it)


def moebius_periods(values):
    return np.where(excess(values) > 0, 2, 1)


def moebius_phase(data, groups):
    """The least period; and of the angle about the axis, which is the phase, once or twice around, the derivatives."""
    periods(moebius_periods)(data, groups)
    turns, x, y, *of, values = lanes_of(data, "time", "x", "y", "x_response", "y_response", "z_response")
    share = 1.0 / moebius_periods(values)[:, None]
    assert np.abs(turns / (TURN / share[:, 0]) - 1.0).max() < CLOSE
    square = x**2 + y**2
    for response, exact in zip(of, (-y / square, x / square, 0.0 * x), strict=True):
        assert np.abs(response - share * exact).max() < CLOSE


def moebius_saddle(values):
    """Multipliers of the orbit of period 1 beyond its doubling, in modulus."""
    growth = np.exp(TURN * excess(values))
    return np.where(growth > 1.0, growth, np.nan), np.exp(-TURN) * np.ones_like(growth)


def zero(data=None):
    return 0.0


def cubic(u, v, mu):
    return u**3 - (mu + 1) * u, v / 2


def cubic_exponents(values):
    """ln of the moduli of `known_maps.CUBIC`'s multipliers, an iterate."""
    mu = values["mu"]
    return np.log(np.abs(np.where(mu > 0, 1 - 2 * mu, 1 + mu))), np.full_like(mu, np.log(0.5))


MOEBIUS = {
    "portrait": follows(moebius.moebius, ("u", "v")),
    "poincare": follows(moebius.moebius, ("u", "v")),
    "diagram": follows(moebius.moebius, ("u", "v")),
    "period": periods(moebius_periods),
    "lyapunov": exponents(moebius_exponents),
    "chaos01": no_chaos,
    "verdict": words("periodic"),
    "doubling": doubling("mu", zero),
    "windows": one_window("mu", "period_doubling", zero),
    "branches": branches([1, 2], "mu", zero),
    "curves": ONE_PARAMETER.format("mu"),
    "atlas": ONE_PARAMETER.format("mu"),
    "homoclinic": NO_EQUILIBRIA,
    "basins": one_attractor,
    "reversal": NO_REVERSAL,
    "orbits": orbit_numbers(lambda values: (1, excess(values) > 0)),
    "covariant": exponents(moebius_exponents),
    "transients": nothing_leaves,
    "rotation": rotation(moebius_periods),
    "tori": words("none"),
    "torus_branches": no_torus,
    "transport": stays,
    "manifolds": saddles(moebius_saddle),
    "edges": no_edges(1, "one_attractor"),
}
IN_SPACE = {name: follows(moebius.moebius_in_space, ("x", "y", "z")) for name in ("portrait", "poincare", "diagram")}
SPACE = "system: {file: FILE}\ninitial: {x: 1.3, z: 0.1}\nsweep: {" + MU + "}\n" + STEPS
SECTION = "\nsection: {coordinate: y, value: 0.0, direction: up}"
IN_TIME = ("portrait", "lyapunov", "basins", "transport", "edges")


@functools.cache
def first_doubling():
    """Of the particle at d = 0.1, by the Taylor reference."""
    return float(taylor.cascade(taylor.Parameters(d=0.1), [5.8152, 5.79])[0][0])


@functools.cache
def at_rest(b):
    """Multipliers of the free particle at the origin: of the linear equations there, by DOP853."""

    def linear(t, y):
        tangents = y.reshape(4, 4)
        x, vx, z, vz = tangents
        g = 1.0 + np.sin(t)
        return np.stack([vx, -0.5 * g * x + b * z - 0.5 * vx, vz, -g * z + b * x - 0.5 * vz]).ravel()

    end = solve_ivp(linear, (0.0, TURN), np.eye(4).ravel(), "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return np.linalg.eigvals(end.reshape(4, 4))


def doubling_at_rest(data=None):
    """Where one of them is −1."""
    return brentq(lambda b: np.prod(at_rest(b) + 1.0).real, 0.3, 0.36, xtol=1e-12)


def particle(names, rates=paper_equations.at_speed):
    """The paper's disturbed particle about its first doubling, whose name of b is the same whoever integrates it."""
    return {
        **dict.fromkeys(("portrait", "poincare", "diagram"), follows(rates, names, angle=True)),
        "period": periods(lambda values: np.where(values["b"] > first_doubling(), 1, 2)),
        "lyapunov": sums,
        "chaos01": no_chaos,
        "verdict": words("periodic"),
        "doubling": doubling("b", lambda data: first_doubling()),
        "windows": one_window("b", "period_doubling", first_doubling),
        "branches": branches([1, 2], "b", first_doubling),
        "curves": ONE_PARAMETER.format("b"),
        "atlas": ONE_PARAMETER.format("b"),
        "homoclinic": NO_EQUILIBRIA,
        "basins": one_attractor,
        "reversal": repellers("dissipative"),
        "orbits": orbits_beside(lambda values: (1, values["b"] < first_doubling())),
        "covariant": words("regular"),
        "transients": nothing_leaves,
        "rotation": rotation(lambda values: np.where(values["b"] > first_doubling(), 1, 2)),
        "tori": words("none"),
        "torus_branches": no_torus,
        "transport": stays,
        "manifolds": manifolds_of_saddles,
        "edges": no_edges(1, "one_attractor"),
    }


KINDS = {
    "a right-hand side on a section": Kind(
        SPACE + SECTION,
        MOEBIUS
        | IN_SPACE
        | {"verdict": words("limit_cycle"), "basins": one_attractor, "homoclinic": SADDLES_OVER_ONE.format("mu")}
        | {"period": moebius_phase},
        moebius.MOEBIUS_IN_SPACE,
        starts_between("x", 1.2, 1.4) | {"period": OPTIONS["period"] | {"phase_response": 4}},
    ),
    "a right-hand side in time": Kind(
        SPACE,
        {name: WITHOUT_SECTION.format(name) for name in ANALYSES if name not in IN_TIME}
        | {"portrait": IN_SPACE["portrait"], "lyapunov": exponents(moebius_exponents), "basins": one_attractor}
        | {"manifolds": no_saddle}
        | {"transport": stays, "edges": no_edges(1, "one_attractor"), "homoclinic": SADDLES_OVER_ONE.format("mu")},
        moebius.MOEBIUS_IN_SPACE,
        starts_between("x", 1.2, 1.4) | {"manifolds": {"dimension": 2, "box": {"x": (1.2, 1.4)}, "n_starts": 4}},
    ),
    "steps of a lane's own": Kind(
        "system: {file: FILE}\ninitial: {u: 0.3, v: 0.1}\nsweep: {"
        + MU
        + "}\naccuracy: {solver: adaptive_tsit5, steps: 64}",
        MOEBIUS,
        moebius.MOEBIUS,
    ),
    "a right-hand side with a corner": Kind(
        "system: {file: FILE}\ninitial: {u: 0.3, v: 0.1}\nsweep: {" + MU + "}\n" + STEPS,
        MOEBIUS
        | dict.fromkeys(("portrait", "poincare", "diagram"), follows(moebius.moebius_with_a_corner, ("u", "v")))
        | {"homoclinic": NOT_SMOOTH},
        moebius.MOEBIUS_WITH_A_CORNER,
    ),
    "a right-hand side with jumps": Kind(
        "system: {file: FILE}\ninitial: {u: 0.3, v: 0.1}\nsweep: {" + MU + "}\n" + STEPS,
        MOEBIUS
        | dict.fromkeys(
            ("portrait", "poincare", "diagram"), follows(moebius.moebius_in_its_frame, ("u", "v"), even=True)
        )
        | {"homoclinic": NOT_SMOOTH, "reversal": JUMPS_HAVE_NONE},
        moebius.MOEBIUS_WITH_JUMPS,
    ),
    "a right-hand side with jumps on a section": Kind(
        "system: {file: FILE}\ninitial: {u: 0.3, v: 0.1, clock: 0.5}\nsweep: {"
        + MU
        + "}\n"
        + STEPS
        + "\nsection: {coordinate: clock, value: 0.5, direction: up}",
        MOEBIUS
        | dict.fromkeys(
            ("portrait", "poincare", "diagram"), follows(moebius.moebius_in_its_frame, ("u", "v"), even=True)
        )
        | {
            "homoclinic": NOT_SMOOTH,
            "reversal": JUMPS_HAVE_NONE,
            "verdict": words("limit_cycle"),
        },
        moebius.MOEBIUS_WITH_JUMPS_IN_TIME,
    ),
    "T, Q, f with a constraint that is eliminated": Kind(
        "system: {file: FILE}\ninitial: {x: 0.5, x_dot: 0.1, y_dot: -0.045}\n"
        "sweep: {damping: {start: 0.1, stop: 0.5, count: 5}}\n" + STEPS,
        {
            **dict.fromkeys(
                ("portrait", "poincare", "diagram"), follows(constrained_oscillators.slide, ("x", "x_dot", "y"))
            ),
            "period": periods(lambda values: 1),
            "lyapunov": exponents(lambda values: (-values["damping"], -values["damping"])),
            "chaos01": no_chaos,
            "verdict": words("periodic"),
            "doubling": none_found,
            "windows": one_window("damping", "range", None),
            "branches": branches([1], "damping"),
            "curves": ONE_PARAMETER.format("damping"),
            "atlas": ONE_PARAMETER.format("damping"),
            "homoclinic": NOT_ISOLATED,
            "basins": one_attractor,
            "reversal": NO_REVERSAL,
            "orbits": orbit_numbers(lambda values: (1, 0 * next(iter(values.values())))),
            "covariant": exponents(lambda values: (-values["damping"], -values["damping"])),
            "transients": nothing_leaves,
            "rotation": rotation(),
            "tori": words("none"),
            "torus_branches": no_torus,
            "transport": stays,
            "manifolds": no_saddle,
            "edges": no_edges(1, "one_attractor"),
        },
        constrained_oscillators.SLIDE,
        starts_between("x", -0.5, 0.5),
    ),
    "T, Q, f with a constraint that is projected": Kind(
        "system: {file: FILE}\ninitial: {x: 0.1, x_dot: 0.1, y: 0.1, y_dot: 0.99498743710662}\n"
        "sweep: {b: {start: 5.88, stop: 5.8, count: 5}}\naccuracy: {solver: dopri8, steps: 80}",
        particle(("x", "y", "x_dot", "y_dot")) | {"homoclinic": NOT_ISOLATED},
        paper_equations.PARTICLE,
        starts_between("x", 0.0, 0.2),
    ),
    "quasi-velocities, one of them given, and a norm": Kind(
        "system: {file: FILE}\ninitial: {c: 0.8, s: 0.6, w: 0.1}\n"
        "sweep: {damping: {start: 0.1, stop: 0.5, count: 5}}\n" + STEPS,
        {
            **dict.fromkeys(
                ("portrait", "poincare", "diagram"), follows(constrained_oscillators.needle, ("c", "s", "w"))
            ),
            "period": periods(lambda values: 1),
            "lyapunov": exponents(lambda values: (-values["damping"], -values["damping"])),
            "chaos01": no_chaos,
            "verdict": words("periodic"),
            "doubling": none_found,
            "windows": one_window("damping", "range", None),
            "branches": branches([1], "damping"),
            "curves": ONE_PARAMETER.format("damping"),
            "atlas": ONE_PARAMETER.format("damping"),
            "homoclinic": NOT_ISOLATED,
            "basins": one_attractor,
            "reversal": NO_REVERSAL,
            "orbits": orbit_numbers(lambda values: (1, 0 * values["damping"])),
            "covariant": exponents(lambda values: (-values["damping"], -values["damping"])),
            "transients": nothing_leaves,
            "rotation": rotation(),
            "tori": words("none"),
            "torus_branches": no_torus,
            "transport": stays,
            "manifolds": no_saddle,
            "edges": no_edges(1, "one_attractor"),
        },
        constrained_oscillators.NEEDLE,
        starts_between("w", -0.1, 0.1),
    ),
    "T, Q, f with a constraint that comes and goes": Kind(
        "system: {file: FILE}\ninitial: {x: 0.3}\nsweep: {mu: {start: -0.36, stop: 0.36, count: 4}}\n" + STEPS,
        MOEBIUS
        | dict.fromkeys(("portrait", "poincare", "diagram"), clamped_follows)
        | {
            "homoclinic": NOT_SMOOTH,
            "lyapunov": clamped_exponents,
            "covariant": words("regular", "undecided"),
            "reversal": "motions that stick, rest or meet constraints, where several become one, have no way back",
            "manifolds": "several become one, have no way back; stable manifolds need that",
        },
        constrained_oscillators.CLAMPED,
        starts_between("x", -0.5, 0.5),
    ),
    "T, Q, f without a clock": Kind(
        "system: {file: FILE}\ninitial: {x: 0.5, x_dot: 0.1, y_dot: 0.05}\nsweep: {mu: {start: 0.1, stop: 0.3, count: 4}}\n"
        "section: {coordinate: x, value: 0.0, direction: up}\n" + STEPS,
        {
            **dict.fromkeys(
                ("portrait", "poincare", "diagram"), follows(constrained_oscillators.cycle, ("x", "x_dot", "y"))
            ),
            "period": periods(lambda values: 1),
            "lyapunov": exponents(lambda values: (-values["mu"],)),
            "chaos01": no_chaos,
            "verdict": words("limit_cycle"),
            "doubling": none_found,
            "windows": one_window("mu", "range", None),
            "branches": branches([1], "mu"),
            "curves": ONE_PARAMETER.format("mu"),
            "atlas": ONE_PARAMETER.format("mu"),
            "homoclinic": NOT_ISOLATED,
            "basins": one_attractor,
            "reversal": NO_REVERSAL,
            "orbits": orbit_numbers(lambda values: (1, 0 * next(iter(values.values())))),
            "covariant": "angles are between directions of the map, and it has one alone",
            "transients": nothing_leaves,
            "rotation": rotation(),
            "tori": "a curve on a map of one direction has nothing normal to it",
            "torus_branches": "a curve on a map of one direction has nothing normal to it",
            "transport": stays,
            "manifolds": "manifolds are curves among other directions of the map, and it has one alone",
            "edges": no_edges(1, "one_attractor"),
        },
        constrained_oscillators.CYCLE,
        {
            "branches": {
                "max_period": 1,
                "transient": 64,
                **LONG_STEPS,
                "n_starts": 3,
                "n_values": 1,
                "box": {"x_dot": (0.05, 0.4)},
            }
        }
        | starts_between("x_dot", 0.05, 0.4),
    ),
    "the free particle": Kind(
        "system: {constraint: free}\ninitial: {x1: 0.1, x2: 0.1, y1: 0.1, y2: 0.9}\n"
        "sweep: {b: {start: 0.2, stop: 0.28, count: 5}}\naccuracy: {solver: dopri8, steps: 16}",
        {
            **dict.fromkeys(
                ("portrait", "poincare", "diagram"), follows(paper_equations.free, ("x1", "x2", "y1", "y2"))
            ),
            "period": periods(lambda values: 1),
            "lyapunov": exponents(
                lambda values: np.array([np.log(np.sort(np.abs(at_rest(b)))[1:]) / TURN for b in values["b"]]).T
            ),
            "chaos01": no_chaos,
            "verdict": words("periodic"),
            "doubling": doubling("b", doubling_at_rest),
            "windows": one_window("b", "range", None),
            "branches": branches([1], "b"),
            "curves": ONE_PARAMETER.format("b"),
            "atlas": ONE_PARAMETER.format("b"),
            "homoclinic": NO_EQUILIBRIA,
            "basins": one_attractor,
            "reversal": NO_REVERSAL,
            "orbits": orbit_numbers(lambda values: (1, 0 * next(iter(values.values())))),
            "covariant": words("regular"),
            "transients": nothing_leaves,
            "rotation": rotation(),
            "tori": words("none"),
            "torus_branches": no_torus,
            "transport": stays,
            "manifolds": manifolds_of_saddles,
            "edges": no_edges(1, "one_attractor"),
        },
        options=starts_between("x1", -0.2, 0.2)
        | {"transport": OPTIONS["transport"] | {"path": ("x1",), "transient": 1024}},  # it comes to rest slowly
    ),
    "no forcing, on a section": Kind(
        "system: {constraint: constant_speed, without: [forcing]}\ninitial: {x1: 0.1, x2: 0.1, y1: 0.1}\n"
        "sweep: {b: {values: [0.1, 0.2, 0.3]}}\nsection: {coordinate: y1, value: 0.0, direction: up}\n"
        "accuracy: {solver: kahan_li8, steps: 120}",
        {
            **dict.fromkeys(
                ("portrait", "poincare", "diagram"),
                follows(
                    functools.partial(paper_equations.at_speed, d=0.0, forced=False), ("x1", "y1", "x2", "y2"), True
                ),
            ),
            "period": without_an_orbit,
            "lyapunov": sums,
            "chaos01": chaos,
            "verdict": words("undecided", "quasiperiodic", "chaotic"),
            "doubling": none_found,
            "windows": no_row,
            "branches": no_branch,
            "curves": ONE_PARAMETER.format("b"),
            "atlas": ONE_PARAMETER.format("b"),
            "homoclinic": SADDLES_OVER_ONE.format("b"),
            "basins": nothing_periodic,
            "reversal": repellers("conservative", "undecided"),
            "orbits": orbits_beside(lambda values: (0, 0 * values["b"])),
            "covariant": words("hyperbolic", "pseudohyperbolic", "tangent", "undecided"),
            "transients": nothing_leaves,
            "rotation": words("unconverged", "no_rotation", "unlocked"),
            "tori": words("none", "neutral", "undecided"),
            "torus_branches": tori_at_sea,
            "transport": wanders,
            "manifolds": manifolds_of_saddles,
            "edges": no_edges_at_sea,
        },
        options={"doubling": {"levels": 1, "search": False}} | starts_between("x1", 0.0, 0.2),
    ),
    "the particle, disturbed": Kind(
        "system: {constraint: disturbed_speed}\ninitial: {x1: 0.1, x2: 0.1, y1: 0.1}\n"
        "sweep: {b: {start: 5.88, stop: 5.8, count: 5}}\naccuracy: {solver: kahan_li8, steps: 120}",
        particle(("x1", "y1", "x2", "y2")),
        options=starts_between("x1", 0.0, 0.2),
    ),
    "two axes": Kind(
        "system: {file: FILE}\ninitial: {u: 0.3, v: 0.1}\nsweep: {mu: {start: -0.2, stop: 0.2, count: 4}, "
        "nu: {values: [-0.02, 0.02]}}\n" + STEPS,
        MOEBIUS
        | {
            "doubling": doubling("mu", lambda data: data["nu"].to_numpy()),
            "windows": "windows are looked for along one axis; leave out nu",
            **dict.fromkeys(("branches", "torus_branches"), "branches are followed along one axis; leave out nu"),
            "curves": straight_curves,
            "atlas": linked_curve,
        },
        moebius.MOEBIUS,
        {"curves": OPTIONS["curves"] | {"maximum": {"u": 0.3}}},
    ),
    "a shared axis": Kind(
        "system: {file: FILE}\ninitial: {u: 0.3, v: 0.1}\nsweep: {omega: {values: [1.0, 2.0]}, "
        "mu: {values: [-0.2, 0.2]}}\n" + STEPS,
        MOEBIUS
        | {
            "basins": one_attractor,
            "doubling": none_found,
            "windows": "windows are looked for along one axis; leave out mu",
            **dict.fromkeys(("branches", "torus_branches"), "branches are followed along one axis; leave out mu"),
            "curves": no_curve,
            "atlas": nothing_along_rows,
        },
        moebius.MOEBIUS,
    ),
    "a right-hand side with a clock": Kind(
        "system: {file: FILE}\ninitial: {u: 0.3, v: 0.1}\nsweep: {" + MU + "}\n" + STEPS, MOEBIUS, moebius.MOEBIUS
    ),
    "a start axis": Kind(
        "system: {file: FILE, mu: 0.2}\ninitial: {v: 0.1}\nsweep: {u: {values: [-0.3, 0.2, 0.6]}}\n" + STEPS,
        MOEBIUS
        | dict.fromkeys(
            ("portrait", "poincare", "diagram"), follows(functools.partial(moebius.moebius, mu=0.2), ("u", "v"))
        )
        | {
            "basins": one_attractor,
            "period": periods(lambda values: 2),
            "rotation": rotation(lambda values: 2),
            "lyapunov": exponents(lambda values: (-0.4 + 0 * values["start_u"], -1.0)),
            "orbits": orbit_numbers(lambda values: (1, 1 + 0 * values["start_u"])),
            "covariant": exponents(lambda values: (-0.4 + 0 * values["start_u"], -1.0)),
            **dict.fromkeys(
                ("transients", "manifolds", "edges"), "random starts and the axis u of start states exclude each other"
            ),
            "doubling": "u is a coordinate of the start state; put a parameter such as nu first",
            "windows": "u is a coordinate of the start state",
            **dict.fromkeys(("branches", "torus_branches"), "u is a coordinate of the start state"),
            "curves": ONE_PARAMETER.format("u"),
            "atlas": ONE_PARAMETER.format("u"),
            "homoclinic": NO_EQUILIBRIA,
        },
        moebius.MOEBIUS,
    ),
    "a map": Kind(
        "system: {file: FILE}\ninitial: {u: 0.3, v: 0.1}\nsweep: {mu: {start: -0.6, stop: 0.6, count: 4}}",
        MOEBIUS
        | dict.fromkeys(("poincare", "diagram"), iterates_of(cubic, ("u", "v")))
        | {
            "homoclinic": "collocation is of flows, and this is a map",
            "portrait": "a map has nothing between its iterates",
            "reversal": "a map is not followed backwards",
            "lyapunov": exponents(cubic_exponents),
            "covariant": exponents(cubic_exponents),
            "manifolds": saddles(lambda values: (np.where(values["mu"] > 0, 1 + values["mu"], np.nan), np.nan)),
        },
        known_maps.CUBIC,
        UNSTABLE_ALONE,
    ),
}

DRAWN = ("a right-hand side with a clock", "two axes", "a start axis")
"""Kinds whose groups are drawn as well, each in the cell of its own analysis, if there is one."""

DEAR = (
    *("lyapunov", "verdict", "doubling", "windows", "branches", "basins", "orbits", "covariant", "transients"),
    *("manifolds", "edges"),
)
BROTHERS = {
    "steps of a lane's own": ("a right-hand side with a clock",),
    "a right-hand side with jumps on a section": ("a right-hand side with jumps", "a right-hand side on a section"),
    "T, Q, f with a constraint that is projected": ("T, Q, f with a constraint that is eliminated",),
    "T, Q, f with a constraint that comes and goes": (
        "a right-hand side with jumps",
        "T, Q, f with a constraint that is eliminated",
    ),
    "T, Q, f without a clock": ("a right-hand side on a section", "T, Q, f with a constraint that is eliminated"),
    "no forcing, on a section": ("a right-hand side on a section", "the particle, disturbed"),
    "quasi-velocities, one of them given, and a norm": ("T, Q, f with a constraint that is eliminated",),
    "the free particle": ("a right-hand side with a clock", "the particle, disturbed"),
    "a shared axis": ("a right-hand side with a clock", "two axes"),
}
"""Kinds that join what others have, whose cells of `DEAR` analyses take seconds each and are slow."""

SAME_MOTION = {("T, Q, f with a constraint that is projected", "reversal"): "the particle, disturbed"}
"""Other cells that are slow, each with the kind of the very same motion, held against the same numbers, that is quick."""


# ---- cells


@functools.cache
def session(kind):
    """A session of a kind, whose steps are loops over stages and whose tiles are small."""
    file = user_file(KINDS[kind].file) if KINDS[kind].file else None
    config = KINDS[kind].config.replace("FILE", str(file and file.path)) + "\nanalyses: {lyapunov: {}}"
    made = session_of(Experiment.from_content(from_text(config).data, file))
    made._lanes = FewLanes(None, made._lanes.devices[:1], 8, QUICKLY_COMPILED)
    return made


@functools.cache
def user_file(text):
    """A user's file, in a folder that goes with the run; kinds of one file have its flows and programs in common."""
    path = FOLDER / f"{abs(hash(text)):x}.py"
    path.write_text(text)
    return UserFile(path)


def test_a_group_that_breaks_the_contract():
    """Each rule of `contract` on a group that breaks it alone."""
    good = session("two axes").groups({"period": OPTIONS["period"]})["period"]
    contract.check("period", good, UNSAID)
    broken = {
        "no unit": lambda data: data["residual"].attrs.update(units="periods"),
        "has no units": lambda data: data["residual"].attrs.pop("units"),
        "without a word": lambda data: data["status"].values.fill(9),
        "another type": lambda data: data["period"].attrs.update(flag_values=np.zeros(1, np.int8)),
        "special number": lambda data: [
            data["period"].values.fill(0),
            *(data["period"].attrs.pop(key) for key in ("flag_values", "flag_meanings")),
        ],
        "attribute or a variable": lambda data: data.attrs.update(period=1),
        "not among the attributes": lambda data: data.attrs.update(limit=1),
        "attributes of other groups": lambda data: data.update({"strobes": data["residual"]}),
    }
    for words, spoil in broken.items():
        data = good.copy(deep=True)
        spoil(data)
        with pytest.raises(AssertionError, match=words):
            contract.check("period", data, UNSAID)
    with pytest.raises(KeyError, match="status"):
        contract.check("period", good.drop_vars("status"), UNSAID)


def groups_of(kind, analysis):
    """All groups of an analysis of a kind, with those that it needs."""
    asked = {analysis: (OPTIONS | KINDS[kind].options)[analysis]}
    if analysis == "verdict":
        asked |= {name: OPTIONS[name] for name in ANALYSES["verdict"].options.needs}
    axis = session(kind).experiment.axes[0]
    few = {axis.name: axis.values[[0, -1]]} if {analysis, *asked[analysis]} & {*BY_LANE} else {}
    with mock.patch.object(general_flow, "_LARGEST_STEP", 0), mock.patch.object(cost_model, "quickest_form", looped):
        return session(kind).groups(asked, **few)


def looped(solver, *_):
    """The solver with its stages in a loop, however much there is to run: one program serves all analyses."""
    return in_loop(solver)


def panels_of(data):
    """What is on each of the axes of a figure, or why there is none."""
    try:
        return [(ax.get_title(loc="left"), len(ax.lines), len(ax.collections)) for ax in jaxnh.figure(data).axes]
    except ResultError as error:
        return str(error)


def is_drawn_without_attributes(data):
    """A group without attributes is drawn with as many lines and areas, or what it lacks is said in words."""
    whole, bare = panels_of(data), panels_of(data.drop_attrs())
    if isinstance(bare, str) and bare != whole:
        assert "has no flag_meanings, the words of its numbers" in bare
        assert set(data) & {"kind", "criticality", "begin_kind", "scenario"}
    else:
        assert bare == whole


@pytest.mark.parametrize(("kind", "brothers"), BROTHERS.items())
def test_what_is_slow_has_quick_brothers(kind, brothers):
    """What a kind that joins others has of a dear analysis, each of these has too, in every run of the quick tests."""
    for brother in brothers:
        assert brother not in BROTHERS
        for analysis in DEAR:
            refused = [isinstance(KINDS[name].known[analysis], str) for name in (kind, brother)]
            assert not (refused[1] and not refused[0])


@pytest.mark.parametrize(("cell", "brother"), SAME_MOTION.items())
def test_the_same_motion_is_quick(cell, brother):
    kind, analysis = cell
    assert brother not in BROTHERS
    assert analysis not in DEAR
    assert not any(isinstance(KINDS[name].known[analysis], str) for name in (kind, brother))


def cells():
    """Kinds and analyses; slow are the dear analyses, but for those that are refused, of kinds that join others."""
    for kind, scene in KINDS.items():
        for analysis in ANALYSES:
            joined = kind in BROTHERS and analysis in DEAR and not isinstance(scene.known.get(analysis), str)
            slow = joined or (kind, analysis) in SAME_MOTION
            yield pytest.param(kind, analysis, marks=[pytest.mark.slow] * slow, id=f"{kind}-{analysis}")


@pytest.mark.parametrize("kind", ["a map", pytest.param("a start axis", marks=pytest.mark.slow)])
def test_derivatives_keep_the_contract(kind):
    """Of every analysis that has some, over one parameter or a start: a column for each parameter of the system, no other."""
    options = OPTIONS | KINDS[kind].options
    derived = {
        name: options[name] | {"sensitivities": True}
        for name in ANALYSES
        if "sensitivities" in ANALYSES[name].options.model_fields and not isinstance(KINDS[kind].known[name], str)
    }
    assert {"period", "basins"} <= set(derived)
    units = session(kind).experiment.flow().readout.labels.units
    parameters = {*session(kind).experiment.flow().parameters}
    for name, group in session(kind).groups(derived).items():
        contract.check(name, group, [key for key, unit in units.items() if not unit])
        if name != "branches" and name in (*derived, "attractors", "bifurcations"):
            rates = [key for key in group if str(key).endswith("_sensitivity")]
            assert bool(rates) == (name != "basins"), name
            assert not rates or {*group["parameter"].to_numpy().tolist()} <= parameters, name


@pytest.mark.parametrize(("kind", "analysis"), list(cells()))
def test_every_analysis(kind, analysis):
    assert set(KINDS[kind].known) == set(ANALYSES), "a new analysis: say what each kind of scene knows of it"
    known = KINDS[kind].known[analysis]
    if isinstance(known, str):
        with pytest.raises(InputError, match=re.escape(known)):
            groups_of(kind, analysis)
        return
    groups = groups_of(kind, analysis)
    units = session(kind).experiment.flow().readout.labels.units
    for name, group in groups.items():
        contract.check(name, group, [key for key, unit in units.items() if not unit])
    known(groups[analysis], groups)
    for name, group in groups.items() if kind in DRAWN else ():
        other_cell = name in ANALYSES and name != analysis and not isinstance(KINDS[kind].known[name], str)
        if not other_cell:
            is_drawn_without_attributes(group)
