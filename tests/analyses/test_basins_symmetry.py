"""Attractors that a symmetry relates, which share means of coordinates, and conservative flows, which have none.

Labels of start states against closed forms, and against heyoka's Taylor integrator with a classification of its own.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import NamedTuple

import heyoka as hy
import numpy as np
import pytest

from jaxnh.analyses.basins.point_sets import lie_within, offsets, point_set
from jaxnh.analyses.basins.tables import wilson
from jaxnh.systems.first_order import CoordinateChart
from tests.flows.written_out import experiment, line
from tests.helpers.attractors import grid, kinds, same_partition
from tests.helpers.kept_programs import session_of

pytestmark = pytest.mark.usefixtures("uncalibrated")
STEPS = {"accuracy": {"solver": "tsit5", "steps": 24}}


def labels(tree):
    """Numbers of the attractors of all starts."""
    return tree["basins"]["attractor"].values.ravel()


# ---- closed forms

PHASES = (-2.9, -1.9, -0.9, 0.1, 1.1, 2.1)


@pytest.mark.parametrize(
    ("coupling", "apart"),
    [pytest.param(-0.3, 0.0, marks=pytest.mark.slow), (0.3, math.pi / 2)],  # the other is quick
)
def test_two_phases(tmp_path, coupling, apart):
    """φ' = 1 + k sin 2(φ − ψ), ψ' = 1 + k sin 2(ψ − φ): δ = φ − ψ has δ' = 2k sin 2δ.

    For k < 0 it settles at 0 or π, for k > 0 at ±π/2: (cos φ, cos ψ) turns left or right, with the exponent −4|k|. Phases are uniform, so that
    both cycles have the same mean of every function of one phase.
    """
    sweep = {"phi": {"values": list(PHASES)}, "psi": {"values": list(PHASES)}}
    rates = "1.0 + k * jnp.sin(2 * (phi - psi)), 1.0 + k * jnp.sin(2 * (psi - phi))"
    more = {"system": {"file": str(tmp_path / "flow.py"), "k": coupling}, **STEPS}
    rest = '"angles": ("phi", "psi")'
    tree = session_of(
        experiment(tmp_path, ("phi", "psi"), rates, sweep, {"max_periods": 256}, rest, "k=0.3", **more)
    ).tree()
    phi, psi = grid(tree, "phi", "psi")
    # Starts with φ = ψ stay on that cycle, which for k > 0 repels: they are on neither.
    expected = np.where((phi == psi) & (coupling > 0), 0, np.where(np.cos(phi - psi - apart) > 0, 1, 2))
    assert np.array_equal(labels(tree) == 0, expected == 0)
    assert same_partition(labels(tree).tolist(), expected.tolist())
    assert kinds(tree["attractors"]) == ["limit_cycle"] * 2
    np.testing.assert_allclose(tree["attractors"]["exponent"].values, -1.2, atol=1e-6)
    shares = [np.mean(expected == k) for k in (1, 2)]
    assert sorted(tree["attractors"]["fraction"].values) == sorted(shares)


@pytest.mark.slow  # two phases without a clock are quick, and the matrix has clocks
def test_two_phases_with_a_clock(tmp_path):
    """φ' = 1/2 + k sin(2φ − t) for two phases, k < 0: each goes to t/2 or t/2 + π, from where cos φ > 0 or < 0.

    Of both together there are two orbits of two periods, in phase and in antiphase, with the same means.
    """
    sweep = {"phi": {"values": list(PHASES)}, "psi": {"values": list(PHASES)}}
    rates = "0.5 - 0.3 * jnp.sin(2 * phi - t), 0.5 - 0.3 * jnp.sin(2 * psi - t)"
    rest = '"angles": ("phi", "psi"), "period": 2 * jnp.pi'
    accuracy = {"accuracy": {"solver": "tsit5", "steps": 64}}
    tree = session_of(
        experiment(tmp_path, ("phi", "psi"), rates, sweep, {"max_periods": 256, "max_period": 4}, rest, **accuracy)
    ).tree()
    phi, psi = grid(tree, "phi", "psi")
    assert same_partition(labels(tree).tolist(), (np.cos(phi) * np.cos(psi) > 0).tolist())
    assert tree["attractors"]["period"].values.tolist() == [2, 2]


@pytest.mark.slow
def test_circles_left_and_right(tmp_path):
    """x'' = (1 − |x'|²) x' − x in the plane: the angular momentum L has L' = (1 − |x'|²) L and keeps its sign."""
    sweep = {"x": line(-1.5, 1.5, 6), "v": line(-1.3, 1.2, 6)}
    rates = "u, v, (1.0 - u**2 - v**2) * u - x, (1.0 - u**2 - v**2) * v - z"
    more = {"initial": {"z": 0.4, "u": 0.3}, **STEPS}
    tree = session_of(experiment(tmp_path, ("x", "z", "u", "v"), rates, sweep, {"max_periods": 1024}, **more)).tree()
    x, v = grid(tree, "x", "v")
    assert same_partition(labels(tree).tolist(), (x * v - 0.4 * 0.3 > 0).tolist())
    assert kinds(tree["attractors"]) == ["limit_cycle"] * 2


# ---- no attractor


@pytest.mark.parametrize(
    ("coordinates", "rates", "rest", "reason"),
    [
        pytest.param(  # the last one is quick
            ("theta", "rate"), "rate, -jnp.sin(theta)", '"angles": ("theta",)', 2, marks=pytest.mark.slow
        ),
        pytest.param(("x", "v"), "v, 0.2 * jnp.cos(t) - x**3", '"period": 2 * jnp.pi', 2, marks=pytest.mark.slow),
        (("prey", "hunter"), "prey * (1.0 - jnp.exp(hunter)), hunter * 0.0 + prey - 1.0", "", 1),
    ],
)
def test_no_attractor_of_a_conservative_flow(tmp_path, coordinates, rates, rest, reason):
    """A pendulum, a driven oscillator and Lotka and Volterra's flow: every start is undecided, for the reason said.

    The divergence is zero of the first two, chaos among their motions. That of the third is 1 − e^h, and zero on average.
    """
    first, second = coordinates
    sweep = {first: line(0.1, 1.9, 6), second: line(-0.9, 0.8, 6)}
    accuracy = {"accuracy": {"solver": "tsit5", "steps": 48 if "period" in rest else 24}}
    options = {"max_periods": 512, "max_period": 4}
    tree = session_of(experiment(tmp_path, coordinates, rates, sweep, options, rest, **accuracy)).tree()
    assert np.all(labels(tree) == 0)
    assert kinds(tree["attractors"]) == []
    basins = tree["basins"]
    undecided = basins["undecided"]
    assert undecided.attrs["flag_meanings"].split() == ["no", "time", "volume_preserved", "transient"]
    assert np.all((undecided.values >= reason) & (undecided.values <= 2))
    assert basins["judged"].item() <= 2 * labels(tree).size


# ---- beside heyoka


class Case(NamedTuple):
    """A flow with a symmetry.

    Attributes:
        coordinates, rates, angles: of the flow; rates as text in t, the coordinates and jnp.
        period: of the clock, as text; "" without one.
        sweep, start: coordinates that are swept, each from, to and how many, and those of all starts.
        steps: of Tsitouras' method in a period or unit of time.
        attractors: how many there are at least.
        transient: periods or units of time that heyoka runs before it looks.
    """

    coordinates: tuple[str, ...]
    rates: str
    angles: tuple[str, ...]
    period: str
    sweep: dict[str, tuple[float, float, int]]
    start: dict[str, float]
    steps: int
    attractors: int
    transient: int


MODES = "u, v, -0.2 * u - (1 + 0.6 * jnp.cos(2 * t)) * x - x**3 - 0.5 * x * z**2"
MODES += ", -0.2 * v - (1 + 0.6 * jnp.cos(2 * t)) * z - z**3 - 0.5 * z * x**2"
SQUARE = ("x", "z", "u", "v")
LORENZ = "10 * (y - x), x * ({} - z) - y, x * y - 8 / 3 * z"

CASES = {
    # x = z and x = -z
    "container": Case(
        SQUARE, MODES, (), "jnp.pi", {"x": (-2, 2, 12), "z": (-2, 2, 12)}, {"u": 0.3, "v": 0.1}, 48, 2, 100
    ),
    # van der Pol's oscillators under a coupling that is even in each: in phase, and in antiphase
    "oscillators": Case(
        SQUARE,
        "u, v, (1 - x**2) * u - x - 0.3 * x * z**2, (1 - z**2) * v - z - 0.3 * z * x**2",
        (),
        "",
        {"x": (-2, 2, 8), "z": (-2, 2, 8)},
        {"u": 0.3, "v": 0.1},
        24,
        2,
        300,
    ),
    "double_well": Case(
        ("x", "v"),
        "v, x - x**3 - 0.2 * v + 0.1 * jnp.cos(t)",
        (),
        "2 * jnp.pi",
        {"x": (-1.6, 1.6, 12), "v": (-1, 1, 12)},
        {},
        96,
        2,
        100,
    ),
    # Twins under (angle, t) -> (-angle, t + T/2).
    "pendulum": Case(
        ("angle", "rate"),
        "rate, 1.02 * jnp.cos(2 * t / 3) - 0.5 * rate - jnp.sin(angle)",
        ("angle",),
        "3 * jnp.pi",
        {"angle": (-3, 3, 12), "rate": (-2, 2, 12)},
        {},
        128,
        2,
        100,
    ),
    "rest": Case(
        ("x", "y", "z"), LORENZ.format(15.0), (), "", {"x": (-9, 8, 12), "y": (-9, 8, 12)}, {"z": 10.0}, 96, 2, 100
    ),
    "cycles": Case(
        ("x", "y", "z"), LORENZ.format(151.0), (), "", {"x": (-30, 29, 8), "y": (-30, 29, 8)}, {"z": 150.0}, 400, 2, 100
    ),
}
MANY = 2000  # points of heyoka's, of each start


def by_heyoka(case, starts):
    """Points (times, coordinates, starts) after the transient: at the clock, or without one at times that are no multiple
    of each other's differences."""
    names = hy.make_vars(*case.coordinates)
    known = {"jnp": SimpleNamespace(cos=hy.cos, sin=hy.sin, pi=math.pi), "t": hy.time}
    rates = eval(case.rates, known | dict(zip(case.coordinates, names, strict=True)))
    flow = hy.taylor_adaptive(list(zip(names, rates, strict=True)), [0.0] * len(names), tol=1e-12)
    period = eval(case.period, known) if case.period else 1.0
    times = case.transient + (np.arange(12.0) if case.period else np.arange(MANY) * (math.sqrt(5) - 1) / 8)
    found = []
    for start in starts.T:
        flow.time, flow.state[:] = 0.0, start
        found.append(flow.propagate_grid(np.concatenate([[0.0], period * times]))[-1][1:])
    return np.stack(found, axis=-1)


def classified(case, points):
    """Labels of starts: those are on one attractor whose points have the same mean products of two coordinates.

    Twelve strobes are a multiple of the periods 1, 2, 3, 4, 6; without a clock a smooth window takes the mean. The means
    of one attractor differ by what is left of the transient, and by the window's error.
    """
    columns = [np.ones(points.shape[::2])]
    for name, values in zip(case.coordinates, points.transpose(1, 0, 2), strict=True):
        columns += [np.cos(values), np.sin(values)] if name in case.angles else [values / np.abs(values).max()]
    at = (np.arange(len(points)) + 0.5) / len(points)
    weights = np.ones(len(at)) if case.period else np.exp(-1.0 / (at * (1.0 - at)))
    means = [np.average(a * b, axis=0, weights=weights) for k, a in enumerate(columns) for b in columns[k:]]
    found, leaders = [], list[np.ndarray]()
    for one in np.stack(means, axis=1):
        near = [k for k, other in enumerate(leaders) if np.abs(one - other).max() < 1e-3]
        found.append(near[0] if near else len(leaders))
        leaders += [] if near else [one]
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_shares_beside_heyoka(tmp_path, name):
    """As many attractors, each with a share within its interval, and 19 starts in 20 on the same one.

    Both integrations err by some 1e-8 a period, which decides near a boundary alone.
    """
    case = CASES[name]
    rest = ", ".join(
        [f'"angles": {case.angles}'] * bool(case.angles) + [f'"period": {case.period}'] * bool(case.period)
    )
    sweep = {key: line(*values) for key, values in case.sweep.items()}
    more = {"initial": case.start, "accuracy": {"solver": "tsit5", "steps": case.steps}}
    tree = session_of(experiment(tmp_path, case.coordinates, case.rates, sweep, {}, rest, **more)).tree()
    ours, swept = labels(tree), grid(tree, *case.sweep)
    starts = np.array([np.full(len(ours), case.start.get(key, 0.0)) for key in case.coordinates])
    for key, values in zip(case.sweep, swept, strict=True):
        starts[case.coordinates.index(key)] = values
    theirs = classified(case, by_heyoka(case, starts))
    assert np.all(ours > 0)
    assert len(set(ours)) == len(set(theirs)) >= case.attractors
    moved = np.array([np.bincount(ours[theirs == label]).argmax() for label in np.unique(theirs)])
    assert len(set(moved)) == len(moved)
    for label, own in enumerate(moved):
        low, high = wilson(np.sum(ours == own), np.array(len(ours)))
        assert low <= np.mean(theirs == label) <= high
    assert np.mean(moved[theirs] == ours) > 0.95


# ---- distances


def test_distance_from_points():
    """By brute force, also across the cut of an angle."""
    random, plane = np.random.default_rng(3), CoordinateChart((False, True), 2, dimensionless=False)
    points, lanes = (random.uniform([-2.0, -9.0], [2.0, 9.0], (n, 2)) for n in (50, 400))
    size = np.array([2.0, 1.0])
    away = offsets(point_set(plane, points, np.zeros_like(points), size), lanes)
    every = plane.wrap(lanes[:, None] - points[None])
    expected = np.linalg.norm(every / size, axis=2).min(axis=1)
    np.testing.assert_allclose(np.linalg.norm(away / size, axis=1), expected, atol=1e-12)


def test_distance_from_a_path():
    """From four points of a circle and their velocities: π/2 apart, a cubic errs by (π/2)⁴/384 = 0.016 of the radius."""
    plane = CoordinateChart((False, False), 2, dimensionless=False)
    at, phase = np.arange(5) * np.pi / 2, np.linspace(0.0, 6.0, 97)
    circle = np.stack([np.cos(at), np.sin(at)], axis=1)
    velocity = np.stack([-np.sin(at), np.cos(at)], axis=1) * np.pi / 2
    of = point_set(plane, circle, velocity, np.ones(2))
    for radius in (1.0, 1.1):
        lanes = radius * np.stack([np.cos(phase), np.sin(phase)], axis=1)
        distance = np.linalg.norm(offsets(of, lanes), axis=1)
        np.testing.assert_allclose(distance, radius - 1.0, atol=0.016)
    assert np.array_equal(lie_within(of, circle * 1.1, np.ones(2), 0.09), np.zeros(5, bool))
