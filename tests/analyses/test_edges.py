"""Edge states and least shocks: closed forms of maps, cycles by heyoka, stable manifolds by DOP853."""

from __future__ import annotations

import warnings

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

import jaxnh
from jaxnh.analyses.edges.tables import status_of
from jaxnh.exceptions import InputError
from jaxnh.systems.status import STATUS
from tests.flows.known_maps import henon
from tests.helpers import heyoka_newton

pytestmark = pytest.mark.usefixtures("always_shared_programs")

BOX = {"x": (-1.5, 1.5), "v": (-3.0, 3.0)}


def two_wells(a=0.4):
    def image(y):
        return ((1.0 + a) * y[0] - y[0] ** 3,)

    return {"map": image, "coordinates": ("x",)}


def driven_wells(drive=0.1):
    """Two wells, moved by a chaotic map or by a turn: the boundary between them is moved as well."""

    def image(s):
        y, x = s
        return 3.9 * y * (1.0 - y), 1.4 * x - x**3 + drive * (y - 0.5)

    return {"map": image, "coordinates": ("y", "x")}


def turned_wells(drive=0.1):
    def image(s):
        angle, x = s
        return angle + jnp.pi * (jnp.sqrt(5.0) - 1.0), 1.4 * x - x**3 + drive * jnp.cos(angle)

    return {"map": image, "coordinates": ("angle", "x"), "angles": ("angle",)}


def duffing(F=0.0, d=0.2, w=1.0):
    def rhs(y, t):
        x, v = y
        return v, x - x**3 - d * v + F * jnp.cos(w * t)

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / w}


def double_well(d=0.2):
    def rhs(y, t):
        x, v = y
        return v, x - x**3 - d * v

    return {"rhs": rhs, "coordinates": ("x", "v")}


def rings(rate=0.2):
    """Cycles r = 1 and 3 attract and r = 2 repels, by exp(4π rate) in a turn, which takes 2π."""

    def rhs(s, t):
        x, y = s
        r = jnp.sqrt(x**2 + y**2)
        growth = -rate * (r - 1.0) * (r - 2.0) * (r - 3.0)
        return growth * x - y, growth * y + x

    return {"rhs": rhs, "coordinates": ("x", "y"), "time_unit": 2 * jnp.pi}


def words(data, name):
    variable = data[name]
    meanings = dict(zip(variable.attrs["flag_values"].tolist(), variable.attrs["flag_meanings"].split(), strict=True))
    return {meanings[k] for k in np.unique(variable.to_numpy()).tolist()}


def is_within_error(data, name, exact):
    """Whether numbers are as exact as their errors say."""
    off = np.abs(data[name].to_numpy() - exact)
    return bool(np.all(off <= data[f"{name}_error"].to_numpy()))


def test_two_wells_of_a_map():
    """The boundary is 0, of multiplier 1 + a, and beyond ±√(1 + a) the wells change places."""
    a = np.array([0.2, 0.3, 0.4])
    data = jaxnh.Session(two_wells, start={"x": 0.3}).run(jaxnh.Edges(box={"x": (-1.0, 1.0)}, n_starts=16), a=a)
    assert words(data, "status") == {"ok"}
    assert words(data, "kind") == {"saddle_orbit"}
    assert np.all(data["attractors"] == 2)
    assert np.all(data["edge_state"] == 1)
    assert is_within_error(data, "x_edge", 0.0)
    assert is_within_error(data, "multiplier", 1.0 + a[:, None])
    assert data["multiplier_error"].max() < 1e-12
    shock = np.minimum(np.sqrt(a), np.sqrt(1.0 + a) - np.sqrt(a))[:, None]
    both = data.isel(attractor=[0, 1])
    assert is_within_error(both, "shock", shock)
    assert both["shock_error"].max() < 1e-10
    assert np.abs(np.abs(both["x_shock"]) - shock).max() < 1e-10
    assert both["shock_to"].values.tolist() == [[2, 1]] * 3
    assert np.all(both["x_attractor"][:, 0] < both["x_attractor"][:, 1])
    assert np.all(both["shocks_tried"] == 2)


TURN = 0.3
"""Radians, by which the boundary of `oblique_wells` is turned: no direction that is tried is the least shock's."""


def oblique_wells(a=1.0):
    """s' = a s - s^3 along one axis, and along the other a decay with a clock: wells at s = ±√a, a boundary at s = 0."""
    c, sine = np.cos(TURN), np.sin(TURN)

    def rhs(y, t):
        s, r = c * y[0] + sine * y[1], c * y[1] - sine * y[0]
        s_rate, r_rate = a * s - s**3, -r * (1.0 + 0.5 * jnp.cos(2.0 * jnp.pi * t))
        return c * s_rate - sine * r_rate, sine * s_rate + c * r_rate

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 1.0}


@pytest.mark.slow  # `test_two_wells_of_a_map` and `test_the_bars_of_one_flow` are quick
def test_two_wells_of_a_flow():
    """The least shock is √a across the boundary, in halves of the box."""
    a = np.array([0.8, 1.0])
    box = {"x": (-1.5, 1.5), "v": (-1.5, 1.5)}
    options = jaxnh.Edges(box=box, n_starts=8, pairs=1, directions=8, shock_points=1, transient=32, max_periods=64)
    data = (
        jaxnh.Session(oblique_wells, start={"x": 0.3, "v": 0.1}, target=1e-8).run(options, a=a).isel(attractor=[0, 1])
    )
    assert np.all(data["attractors"] == 2)
    assert words(data, "kind") == {"saddle_orbit"}
    assert is_within_error(data, "x_edge", 0.0)
    assert is_within_error(data, "multiplier", np.exp(a)[:, None])
    assert is_within_error(data, "shock", np.sqrt(a)[:, None] / 1.5)
    assert data["shock_error"].max() < 1e-6
    assert np.abs(np.abs(data["x_shock"]) - np.cos(TURN) * np.sqrt(a)[:, None]).max() < 1e-4
    assert data["shock_to"].values.tolist() == [[2, 1]] * 2


@pytest.mark.slow
def test_bars_cover():
    """Of 64 maps with two wells and 40 of Henon's: all numbers that are known in closed form are within their errors."""
    a = np.linspace(0.03, 0.97, 64)
    data = jaxnh.Session(two_wells, start={"x": 0.3}).run(jaxnh.Edges(box={"x": (-1.0, 1.0)}, n_starts=16), a=a)
    assert is_within_error(data, "x_edge", 0.0)
    assert is_within_error(data, "multiplier", 1.0 + a[:, None])
    shock = np.minimum(np.sqrt(a), np.sqrt(1.0 + a) - np.sqrt(a))[:, None]
    assert is_within_error(data.isel(attractor=[0, 1]), "shock", shock)
    a, b = np.linspace(0.8, 1.2, 40), 0.3
    options = jaxnh.Edges(box={"x": (-2.0, 2.0), "y": (-1.0, 1.0)}, pairs=2, n_starts=16, directions=0)
    data = jaxnh.Session(henon, start={"x": 0.1}).run(options, a=a).stack(edge=("a", "pair"))
    # Near a = 1.07 there are two attractors, and between them a saddle of period 6, in no closed form.
    data = data.isel(edge=(data["kind"].to_numpy() == 1) & (data["period"].to_numpy() == 1))
    assert data.sizes["edge"] >= 60
    a = data["a"].to_numpy()
    saddle = (-(1 - b) - np.sqrt((1 - b) ** 2 + 4.0 * a)) / (2.0 * a)
    root = np.sqrt((a * saddle) ** 2 + b)
    assert is_within_error(data, "x_edge", saddle)
    assert is_within_error(data, "y_edge", b * saddle)
    assert is_within_error(data, "multiplier", root - a * saddle)
    assert is_within_error(data, "second_multiplier", np.abs(-root - a * saddle))


def test_lanes_are_independent():
    options = jaxnh.Edges(box={"x": (-1.0, 1.0)}, n_starts=8, pairs=1)
    session = jaxnh.Session(two_wells, start={"x": 0.3})
    whole, alone = session.run(options, a=[0.4, 0.5]), session.run(options, a=[0.4])
    for name in whole.data_vars:
        np.testing.assert_array_equal(whole[name].isel(a=[0]) if "a" in whole[name].dims else whole[name], alone[name])


def escapes(x, y, a, b):
    """Whether Henon's iterates of points go to infinity, which none comes back from."""
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(200):
            x, y = 1.0 - a * x**2 + y, b * x
        return ~(np.abs(x) < 1e6)


def first_escape(base, angle, unit, a, b):
    """Length of the first shock in each direction that escapes, by bisection; 2 where none does."""
    way = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * unit

    def escaping(length):
        return escapes(base[0] + length * way[..., 0], base[1] + length * way[..., 1], a, b)

    lengths = np.linspace(0.0, 2.0, 201)
    found = np.array([escaping(length) for length in lengths])
    high = lengths[np.argmax(found, axis=0)]
    low = high - 0.01
    for _ in range(40):
        middle = 0.5 * (low + high)
        beyond = escaping(middle)
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    return np.where(found.any(axis=0), high, 2.0)


@pytest.mark.slow  # two wells of a map are quick
@pytest.mark.usefixtures("quick_compiling_once")
def test_the_basin_of_henons_attractor():
    """Its boundary is the stable manifold of the other fixed point; where this is out of reach, there is one alone."""
    a, b = np.array([0.3, 1.0]), 0.3
    options = jaxnh.Edges(box={"x": (-2.0, 2.0), "y": (-1.0, 1.0)}, pairs=2, shock_points=1, directions=64)
    data = jaxnh.Session(henon, start={"x": 0.1}).run(options, a=a)
    assert words(data.isel(a=0), "status") == {"one_attractor"}
    assert words(data.isel(a=0), "kind") == {"none"}
    one = data.isel(a=1)
    assert words(one, "kind") == {"saddle_orbit"}
    assert np.all(one["edge_to"] == 0)
    saddle = (-(1 - b) - np.sqrt((1 - b) ** 2 + 4.0)) / 2.0
    root = np.sqrt(saddle**2 + b)
    assert is_within_error(one, "x_edge", saddle)
    assert is_within_error(one, "y_edge", b * saddle)
    assert is_within_error(one, "multiplier", -saddle + root)
    assert is_within_error(one, "second_multiplier", np.abs(-saddle - root))
    direction = np.array([one["x_direction"][0], one["y_direction"][0]])
    matrix = np.array([[-2.0 * saddle, 1.0], [b, 0.0]])
    assert np.abs(matrix @ direction - (-saddle + root) * direction).max() < 1e-9
    first = one.isel(attractor=0)
    base = np.array([float(first["x_attractor"]), float(first["y_attractor"])])
    unit, angle = np.array([2.0, 1.0]), np.arctan2(float(first["y_shock"]), 0.5 * float(first["x_shock"]))
    least = minimize_scalar(
        lambda at: float(first_escape(base, at, unit, 1.0, b)), bounds=(angle - 0.05, angle + 0.05), method="bounded",
        options={"xatol": 1e-7},
    )  # fmt: skip
    assert abs(float(first["shock"]) - least.fun) < 1e-10 + float(first["shock_error"])
    coarse = first_escape(base, np.linspace(0.0, 2 * np.pi, 90), unit, 1.0, b)
    assert float(first["shock"]) <= coarse.min()


@pytest.mark.slow
def test_boundaries_that_are_no_orbits():
    """A chaotic drive makes a chaotic saddle of the boundary; a turn makes a closed curve of it, which is none."""
    options = {"n_starts": 16, "pairs": 2, "directions": 0}
    chaotic = jaxnh.Session(driven_wells, start={"y": 0.3, "x": 0.3}).run(
        jaxnh.Edges(box={"y": (0.1, 0.9), "x": (-1.0, 1.0)}, **options), drive=[0.1]
    )
    curve = jaxnh.Session(turned_wells, start={"angle": 0.3, "x": 0.3}).run(
        jaxnh.Edges(box={"angle": (-3.0, 3.0), "x": (-1.0, 1.0)}, **options), drive=[0.1]
    )
    assert words(chaotic, "kind") == {"chaotic_saddle"}
    assert words(curve, "kind") == {"unsettled"}
    for data in (chaotic, curve):  # a motion that stays between the wells has no larger root than its drive allows
        assert np.abs(data["x_points"]).max() < 0.3


def saddle_cycle(force):
    """The cycle between the wells, and its multipliers, by heyoka's Taylor integrator in long double."""

    def rates(x, v, strength, t):
        import heyoka as hy

        return v, x - x * x * x - 0.2 * v + strength * hy.cos(t)

    image = heyoka_newton.strobe_map(rates, 2, 2 * np.pi)
    u = np.array([-2.0, 0.2], heyoka_newton.REAL) * force / 4.04  # of the linear equation: Newton needs a near start
    for _ in range(8):
        at, matrix = image(force, u)
        step = np.linalg.solve((matrix - np.eye(2)).astype(float), (u - at).astype(float))
        u = u + step
    larger = np.abs(np.linalg.eigvals(matrix.astype(float))).max()
    return u.astype(float), (np.exp(-0.4 * np.pi) / larger, larger)  # areas shrink by exp(−0.2 · 2π)


@pytest.mark.slow  # `test_the_bars_of_one_flow` is quick
def test_the_cycle_between_duffings_wells():
    force = 0.05
    options = jaxnh.Edges(box=BOX, n_starts=8, pairs=1, directions=0)
    data = jaxnh.Session(duffing, start={"x": 0.3, "v": 0.0}, target=1e-9).run(options, F=[force])
    point, (smaller, larger) = saddle_cycle(force)
    assert words(data, "kind") == {"saddle_orbit"}
    for name, value in zip(("x_edge", "v_edge"), point, strict=True):
        assert abs(float(data[name].squeeze()) - value) < 1e-9
    assert is_within_error(data, "x_edge", point[0] + 0.0 * data["x_edge"].to_numpy())
    assert is_within_error(data, "multiplier", larger)
    assert data["multiplier_error"].max() < 1e-6 * larger
    assert is_within_error(data, "second_multiplier", smaller)


def stable_manifold(d):
    """Points (x, v) on the branch of the stable manifold of 0 that begins to x > 0, as a function of time back."""
    rate = -0.5 * d - np.sqrt(0.25 * d**2 + 1.0)
    start = 1e-8 * np.array([1.0, rate])

    def backwards(t, y):
        return -y[1], -(y[0] - y[0] ** 3 - d * y[1])

    motion = solve_ivp(backwards, (0.0, 40.0), start, "DOP853", rtol=1e-13, atol=1e-16, dense_output=True,
                       events=lambda t, y: np.abs(y).max() - 6.0)  # fmt: skip
    end = motion.t_events[0][0] if len(motion.t_events[0]) else 40.0
    return motion.sol, end


def distance_to_manifold(d, unit):
    """Least distance, in units, of (1, 0) from either branch of the stable manifold of 0."""
    branch, end = stable_manifold(d)

    def distance(t, sign):
        return float(np.hypot(*((np.array([1.0, 0.0]) - sign * branch(t)) / unit)))

    best = np.inf
    for sign in (1.0, -1.0):
        times = np.linspace(10.0, end, 4001)
        lengths = [distance(t, sign) for t in times]
        k = int(np.clip(np.argmin(lengths), 1, len(times) - 2))
        near = minimize_scalar(distance, bounds=(times[k - 1], times[k + 1]), args=(sign,), method="bounded",
                               options={"xatol": 1e-10})  # fmt: skip
        best = min(best, near.fun)
    return best


@pytest.mark.slow
def test_the_least_shock_of_a_double_well():
    """An unforced one, in time: the edge is the equilibrium at 0, and a shock ends on its stable manifold."""
    damping = np.array([0.3, 0.6])
    options = jaxnh.Edges(box=BOX, n_starts=8, pairs=1, directions=8)
    data = jaxnh.Session(double_well, start={"x": 0.3, "v": 0.0}, target=1e-9).run(options, d=damping)
    assert words(data, "kind") == {"equilibrium"}
    assert is_within_error(data, "x_edge", 0.0)
    growth = np.exp(-0.5 * damping + np.sqrt(0.25 * damping**2 + 1.0))
    assert is_within_error(data, "multiplier", growth[:, None])
    exact = np.array([distance_to_manifold(d, np.array([1.5, 3.0])) for d in damping])
    shocks = data.isel(attractor=[0, 1])
    assert np.abs(shocks["shock"].to_numpy() - exact[:, None]).max() < 1e-9
    assert shocks["shock_error"].max() < 1e-8


@pytest.mark.slow
def test_a_cycle_between_cycles():
    """On a section: the unstable cycle r = 2, of the multiplier exp(4π rate), and half-widths of the box to it."""
    rate = np.array([0.2, 0.3])
    session = jaxnh.Session(rings, start={"x": 1.5, "y": 0.0}, target=1e-9).on(coordinate="y", direction="up")
    data = session.run(
        jaxnh.Edges(n_starts=8, box={"x": (0.5, 3.5), "y": (-1.5, 1.5)}, pairs=2, directions=8), rate=rate
    )
    assert words(data, "kind") == {"saddle_orbit"}
    assert is_within_error(data, "x_edge", 2.0)
    assert is_within_error(data, "multiplier", np.exp(4 * np.pi * rate)[:, None])
    assert is_within_error(data.isel(attractor=[0, 1]), "shock", 1.0 / 1.5)


def tinkerbell(a=0.9):
    def image(s):
        x, y = s
        return x * x - y * y + a * x - 0.6013 * y, 2.0 * x * y + 2.0 * x + 0.5 * y

    return {"map": image, "coordinates": ("x", "y")}


def test_status_of_lanes_by_where_starts_lead():
    """Attractors 0 and 1, −1 what escapes, and −2 what is not known: all escapes, or none known, is no attractor."""
    words = (*STATUS, "one_attractor", "no_attractor")
    labels = ([-1, -1], [-1, -2], [-2, -2], [0, 0], [0, -2], [0, -1], [0, 1])
    expected = ["not_finite", *["no_attractor"] * 2, *["one_attractor"] * 2, "ok", "ok"]
    assert [words[status_of(np.array(of))] for of in labels] == expected


def test_no_start_has_come_to_an_attractor():
    """Motions come to ±1 by e^(−2a) an iterate, in the second lane by e^(−1.3) in all: no attractor of it is known."""

    def wells(a=0.05):
        return {"map": lambda y: (y[0] + a * (y[0] - y[0] ** 3),), "coordinates": ("x",)}

    options = jaxnh.Edges(box={"x": (-1.0, 1.0)}, n_starts=4, transient=32, max_periods=64)
    data = jaxnh.Session(wells, start={"x": 0.3}).run(options, a=[0.05, 0.01])
    assert jaxnh.labels(data["status"]).to_numpy().tolist() == ["ok", "no attractor"]
    assert data["attractors"].values.tolist() == [2, 0]


@pytest.mark.slow
def test_attractors_that_are_not_known_beside_motions_that_escape():
    """Two of five starts go to infinity at a = 0.6, and the others to a cycle of 30, which is longer than is looked for.

    Motions beside the boundary go to infinity within a few iterates, and so do their distances.
    """
    box = {"x": (-1.3, 0.5), "y": (-1.6, 0.6)}
    options = jaxnh.Edges(box=box, n_starts=16, transient=32, max_periods=512, pairs=2, directions=0)
    session = jaxnh.Session(tinkerbell, start={"x": -0.72, "y": -0.64})
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        data = session.run(options, a=[0.6, 0.9])
    assert jaxnh.labels(data["status"]).to_numpy().tolist() == ["no attractor", "ok"]
    assert data["attractors"].to_numpy().tolist() == [0, 1]


def test_what_cannot_be():
    session = jaxnh.Session(henon, start={"x": 0.1})
    with pytest.raises(InputError, match="needs a box to draw its starts from"):
        session.run(jaxnh.Edges(), a=[1.0])
    with pytest.raises(InputError, match="there is no coordinate z"):
        session.run(jaxnh.Edges(box={"z": (0.0, 1.0)}), a=[1.0])
    with pytest.raises(InputError, match="must be at least the transient, 64"):
        jaxnh.Edges(max_returns=32)
