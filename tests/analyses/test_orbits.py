"""Periodic orbits of maps whose orbits are known in closed form or counted in the literature, and of Lorenz's section."""

from __future__ import annotations

import heyoka as hy
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.orbits import orbits as all_orbits
from jaxnh.analyses.orbits import search as orbit_search
from jaxnh.analyses.orbits.entropy import topological_entropy
from jaxnh.analyses.orbits.missing import missing_orbits
from jaxnh.analyses.orbits.search import map_of_lanes
from jaxnh.analyses.orbits.unstable_leaves import leaf_distances
from jaxnh.analyses.periodic.location import refined_maps
from jaxnh.exceptions import InputError
from jaxnh.orbits.recognition import equal_cycles, primitive_period
from jaxnh.solvers import tsit5
from jaxnh.systems.discrete_map import discrete_map
from tests.flows.known_maps import henon
from tests.flows.lorenz import lorenz
from tests.helpers.batches import batch_of
from tests.helpers.kept_programs import lanes_with_kept_programs

pytestmark = pytest.mark.usefixtures("always_shared_programs")
TWO_LETTERS = [2, 1, 2, 3, 6, 9, 18, 30, 56]
"""Primitive cyclic words of two letters, of 1, 2, … letters (Moreau's formula)."""

HENON = [2, 1, 0, 1, 0, 2, 4, 7, 6, 10, 14, 19, 32]
"""Cycles of Henon's map at a = 1.4, b = 0.3 by their period: Biham and Wenzel, Phys. Rev. Lett. 63 (1989) 819."""


def logistic(r=4.0):
    def image(y):
        return r * y[0] * (1.0 - y[0])

    return {"map": image, "coordinates": "x"}


def cat(shear=1.0):
    def image(s):
        x, y = s
        return 2.0 * x + shear * y, x + y

    return {"map": image, "coordinates": ("x", "y"), "angles": ("x", "y")}


def complex_multipliers(data):
    """Multipliers as complex numbers, (orbit, d)."""
    values = data["multipliers"].to_numpy()
    return values[..., 0] + 1j * values[..., 1]


def assert_nothing_missing(counts):
    """The interval of the number of missing orbits begins at zero, as does the estimate where all were met often."""
    assert not counts["missing"].to_numpy().any()
    assert not counts["missing_low"].to_numpy().any()


def test_all_orbits_of_the_logistic_map():
    """At r = 4 all of period n are sin² of multiples of π/(2ⁿ ± 1); multipliers are ±2ⁿ, at the origin 4ⁿ; h = ln 2."""
    groups = jaxnh.Session(logistic, start={"x": 0.3}).groups({"orbits": jaxnh.Orbits(max_period=6)})
    data, counts = groups["orbits"], groups["orbit_counts"]
    assert counts["number"].to_numpy().tolist() == TWO_LETTERS[:6]
    assert_nothing_missing(counts)
    assert abs(float(counts["entropy"]) - np.log(2)) <= float(counts["entropy_error"]) + 1e-15
    n = data["period"].to_numpy()
    size = np.abs(complex_multipliers(data)[:, 0])
    exact = np.where(data["x"] < 1e-12, 4.0, 2.0**n)
    assert np.all(np.abs(size - exact) <= data["multipliers_error"].to_numpy()[:, 0])
    assert np.all(data["multipliers_error"].to_numpy()[:, 0] < 1e-9 * exact)
    for orbit in range(len(n)):
        turns = np.arcsin(np.sqrt(np.clip(data["x_points"].to_numpy()[orbit, : n[orbit]], 0.0, 1.0))) / np.pi
        apart = [np.abs(turns * m - np.round(turns * m)).max() for m in (2 ** n[orbit] - 1, 2 ** n[orbit] + 1)]
        assert min(apart) < 1e-6  # the square root takes half the digits at the ends


def test_cycles_of_the_henon_map():
    """One fixed point is off the attractor, and random starts find it; h = 0.4651 (D'Alessandro et al. 1990)."""
    options = jaxnh.Orbits(max_period=8, n_starts=8, box={"x": (-2.0, 2.0), "y": (-0.6, 0.6)})
    groups = jaxnh.Session(henon, start={"x": 0.3, "y": 0.1}).groups({"orbits": options})
    data, counts = groups["orbits"], groups["orbit_counts"]
    assert counts["number"].to_numpy().tolist() == HENON[:8]
    assert_nothing_missing(counts)
    assert abs(float(counts["entropy"]) - 0.4651) < float(counts["entropy_error"])
    fixed = np.sort(data["x"].to_numpy()[:2])
    np.testing.assert_allclose(fixed, np.sort(np.roots([1.4, 0.7, -1.0])), rtol=1e-13)
    product = np.prod(complex_multipliers(data), axis=1).real
    np.testing.assert_allclose(product, (-0.3) ** data["period"].to_numpy(), rtol=1e-9)
    assert set(jaxnh.labels(data["stability"]).to_numpy()) == {"saddle"}


def cubic_henon(m=0.815):
    """The three-dimensional Henon map with b = 0.7 (Gonchenko, Ovsyannikov, Simó and Turaev 2005)."""
    return {"map": lambda s: (s[1], s[2], 0.7 * s[0] + m * s[1] - s[2] ** 2), "coordinates": ("x", "y", "z")}


def strobes_of_duffing(force=0.38):
    """x'' + x'/2 - x + x³ = force cos t from strobe to strobe, by 128 steps of Runge and Kutta's method."""
    h = 2.0 * np.pi / 128

    def field(s, t):
        return jnp.stack([s[1], s[0] - s[0] ** 3 - 0.5 * s[1] + force * jnp.cos(t)])

    def step(i, s):
        k1 = field(s, i * h)
        k2 = field(s + h / 2 * k1, i * h + h / 2)
        k3 = field(s + h / 2 * k2, i * h + h / 2)
        return s + h / 6 * (k1 + 2.0 * k2 + 2.0 * k3 + field(s + h * k3, i * h + h))

    return {"map": lambda s: tuple(jax.lax.fori_loop(0, 128, step, jnp.stack(s))), "coordinates": ("x", "v")}


def distances_from_leaves(system, parameter, start, saddles, count):
    """Distances of fixed points (saddles, d), in sizes, from the leaves and from the points of a motion of that many."""
    (name, value), d = *parameter.items(), len(start)
    flow = discrete_map(system, parameter)
    batch = batch_of(flow, flow.start(dict(start)), np.array([value]), tsit5, 1, name=name)
    at = map_of_lanes(batch, lanes_with_kept_programs(), refined_maps(batch)[0])
    image = jax.jit(lambda s: jnp.stack(system(value)["map"](tuple(s))))
    motion = [jnp.array(list(start.values()))]
    for _ in range(512 + count):
        motion.append(image(motion[-1]))
    settled = np.array(motion[-count:])
    for _ in range(8):
        saddles = saddles - np.stack([np.linalg.solve(jax.jacfwd(image)(u) - np.eye(d), image(u) - u) for u in saddles])
    size, number = np.ptp(settled, axis=0), len(saddles)
    nearest = leaf_distances(
        at,
        lambda u, lane: np.asarray(at(u, lane).image),
        batch.chart,
        np.broadcast_to(settled, (number, count, d)),
        saddles[:, None],
        np.zeros(number, int),
        np.broadcast_to(size, (number, d)),
        np.full(number, 1e-5),
    )
    return nearest, np.min(np.linalg.norm((settled - saddles[:, None]) / size, axis=2), axis=1)


@pytest.mark.parametrize("a", [1.4, 1.4265])
def test_leaves_of_the_henon_attractor_come_to_the_saddle_in_it_and_to_no_other(a):
    """The fixed point inside is homoclinic (Benedicks and Carleson 1991); the other one is on the boundary of the basin.

    The attractor comes to that one at a = 1.42692 (test_crises_by_tangencies.py), and is as near to it
    before as to that inside.
    """
    x = np.sort(np.roots([a, 0.7, -1.0]))
    nearest, of_points = distances_from_leaves(
        henon, {"a": a}, {"x": 0.3, "y": 0.1}, np.stack([x, 0.3 * x], axis=1), 513
    )
    assert np.isinf(nearest[0])
    assert nearest[1] < 1e-5
    assert of_points[1] > 2e-4


@pytest.mark.slow  # cycles of maps are quick
@pytest.mark.parametrize("m", [0.815, 0.83, 0.85])
def test_leaves_of_a_discrete_lorenz_attractor_come_to_its_saddle_and_not_to_the_origin(m):
    saddles = np.array([[m - 0.3] * 3, [0.0] * 3])
    nearest, of_points = distances_from_leaves(cubic_henon, {"m": m}, {"x": 0.05, "y": 0.0, "z": 0.0}, saddles, 2048)
    assert nearest[0] < 1e-5
    assert of_points[0] > 1e-3
    assert np.isinf(nearest[1])


@pytest.mark.slow
@pytest.mark.parametrize(("force", "inside"), [(0.38, False), (0.382, False), (0.3835, True), (0.39, True)])
def test_leaves_of_duffings_twins_come_to_the_saddle_between_them_once_they_have_merged(force, inside):
    """By heyoka the twins merge between 0.3822 and 0.3825."""
    saddle = np.array([[-force / 2.125, force / 8.5]])
    nearest, of_points = distances_from_leaves(strobes_of_duffing, {"force": force}, {"x": 1.0, "v": 0.0}, saddle, 2048)
    assert of_points[0] < 0.06
    assert nearest[0] < 1e-3 if inside else np.isinf(nearest[0])


@pytest.mark.slow
def test_more_cycles_of_the_henon_map():
    options = jaxnh.Orbits(max_period=13, n_starts=8, box={"x": (-2.0, 2.0), "y": (-0.6, 0.6)})
    counts = jaxnh.Session(henon, start={"x": 0.3, "y": 0.1}).groups({"orbits": options})["orbit_counts"]
    assert counts["number"].to_numpy().tolist() == HENON
    assert abs(float(counts["entropy"]) - 0.4651) < float(counts["entropy_error"])


@pytest.mark.slow  # cycles of maps are quick
def test_orbits_on_a_torus():
    """The cat map has |det(Aⁿ − 1)| = 1, 5, 16, 45 points of period n; multipliers are those of Aⁿ."""
    groups = jaxnh.Session(cat, start={"x": 0.3, "y": 0.1}).groups({"orbits": jaxnh.Orbits(max_period=4)})
    data, counts = groups["orbits"], groups["orbit_counts"]
    assert counts["number"].to_numpy().tolist() == [1, 2, 5, 10]
    largest = ((3 + np.sqrt(5)) / 2) ** data["period"].to_numpy()
    error = data["multipliers_error"].to_numpy()[:, 0]
    assert np.all(np.abs(complex_multipliers(data)[:, 0] - largest) <= error)
    assert abs(float(counts["entropy"]) - np.log((3 + np.sqrt(5)) / 2)) < float(counts["entropy_error"])
    assert np.all(data["index"] == -1)


def test_orbits_over_a_parameter():
    """The fixed points 0 and 1 − 1/r, and from r = 3 on the cycle of two, whose multiplier is 4 + 2 r − r²."""
    r = np.array([2.8, 3.2])
    groups = jaxnh.Session(logistic, start={"x": 0.3}).groups({"orbits": jaxnh.Orbits(max_period=2)}, r=r)
    assert groups["orbit_counts"]["number"].to_numpy()[:, 1].tolist() == [0, 1]
    data = groups["orbits"]
    inside = np.abs(data["x"] - (1.0 - 1.0 / data["r"])) < 1e-12
    assert np.all(inside.sum("orbit") == 1)
    cycle = complex_multipliers(data)[1][data["period"].to_numpy()[1] == 2]
    np.testing.assert_allclose(cycle.real, [[4 + 2 * 3.2 - 3.2**2]], rtol=1e-12)


def cubic(a=3.0):
    """Onto thrice on (−2, 2), of three letters, the outer two of which x → −x exchanges."""
    return {"map": lambda y: (a * y[0] - y[0] ** 3,), "coordinates": "x"}


def test_images_under_a_symmetry():
    """Words of three letters 3, 3 and 8; but for the exchange of two letters 2, 2 and 4."""
    session = jaxnh.Session(cubic, start={"x": 0.3})
    groups = session.groups({"orbits": jaxnh.Orbits(max_period=3, symmetry=("x",))})
    data, counts = groups["orbits"], groups["orbit_counts"]
    assert counts["number"].to_numpy().tolist() == [3, 3, 8]
    assert counts["distinct"].to_numpy().tolist() == [2, 2, 4]
    image = data["image"].to_numpy() - 1
    assert np.all(image[image] == np.arange(len(image)))
    assert np.all(data["period"].to_numpy()[image] == data["period"].to_numpy())
    sums = np.nansum(data["x_points"].to_numpy(), axis=1)
    assert np.abs(sums[image] + sums).max() < 1e-9


def test_signs_that_are_no_symmetry():
    session = jaxnh.Session(logistic, start={"x": 0.3})
    with pytest.raises(InputError, match="signs of x are no symmetry: the image of an orbit is none"):
        session.run(jaxnh.Orbits(max_period=1, symmetry=("x",)))
    with pytest.raises(InputError, match="a symmetry changes signs of x, and there is no y"):
        session.run(jaxnh.Orbits(max_period=1, symmetry=("y",)))


def test_where_nothing_stays_there_are_the_orbits_of_random_starts():
    """At r = 5 almost all motions go to infinity, and all orbits of two letters are left, repelling."""
    options = jaxnh.Orbits(max_period=4, transient=64, n_starts=64, box={"x": (-0.1, 1.1)})
    groups = jaxnh.Session(logistic, start={"x": 0.3}).groups({"orbits": options}, r=5.0)
    assert groups["orbit_counts"]["number"].to_numpy().ravel().tolist() == TWO_LETTERS[:4]
    assert not groups["orbits"]["status"].to_numpy().any()
    alone = jaxnh.Session(logistic, start={"x": 0.3}).groups({"orbits": jaxnh.Orbits(max_period=2)}, r=5.0)
    assert jaxnh.labels(alone["orbits"]["status"]).to_numpy().ravel().tolist() == ["not finite"]


def test_orbits_are_recognised_whatever_point_they_begin_with():
    points = np.array([[[0.1], [0.7], [0.4]], [[0.4], [0.1], [0.7]], [[0.1], [0.4], [0.7]], [[0.7], [0.4], [0.1]]])
    size, lane = np.ones((4, 1)), np.zeros(4, int)
    assert equal_cycles(lane, points, size, np.asarray).tolist() == [0, 0, 2, 0]
    assert equal_cycles(np.array([0, 1, 0, 1]), points, size, np.asarray).tolist() == [0, 1, 2, 1]
    twice = np.tile(points[:1, :2], (1, 2, 1))
    assert primitive_period(np.concatenate([twice, twice * 0.0 + 0.3]), size[:2], np.asarray).tolist() == [2, 1]


@pytest.mark.parametrize("total", [4, 6, 12])
def test_the_interval_of_missing_orbits_covers_their_number(total):
    """Orbits are met in a round with chances spread as those of the logistic map at n = 9, over 0.15 to 0.9."""
    draws, chances = np.random.default_rng(1), np.linspace(0.15, 0.9, 56)
    covered = []
    for _ in range(1000):
        met = draws.binomial(total, chances)
        of = missing_orbits(met[met > 0], total)
        covered.append(of.low <= np.sum(met == 0) <= of.high)
    assert np.mean(covered) > 0.95 - 3 * np.sqrt(0.95 * 0.05 / 1000)


@pytest.mark.parametrize(("highest", "share"), [(0.3, 0.5), (0.9, 0.8)])
def test_the_interval_of_missing_orbits_where_many_are(highest, share):
    """Four rounds over the 30 words of eight letters meet so large a share of them, with chances down to 0.05."""
    draws, chances = np.random.default_rng(4), np.linspace(0.05, highest, 30)
    covered, known = list[bool](), list[int]()
    for _ in range(2000):
        met = draws.binomial(4, chances)
        of = missing_orbits(met[met > 0], 4)
        covered.append(of.low <= np.sum(met == 0) <= of.high)
        known.append(int(np.sum(met > 0)))
    assert np.mean(known) / 30 == pytest.approx(share, abs=0.06)
    assert np.mean(covered) > 0.95 - 3 * np.sqrt(0.95 * 0.05 / 2000)


def test_orbits_known_from_elsewhere_are_not_missing():
    met = np.array([1, 1, 1, 2, 2])
    alone, beside = missing_orbits(met, 4), missing_orbits(np.append(met, [0, 0]), 4)
    assert beside.high == alone.high - 2.0
    assert beside.estimate == max(alone.estimate - 2.0, 0.0)


@pytest.mark.slow
def test_searches_that_are_stopped_early(monkeypatch):
    """After four rounds of a search some of the 56 orbits of nine returns are missing: their number is in the interval.

    Each of the sixty starts is alone: orbits of neighbours are not tried.
    """
    monkeypatch.setattr(all_orbits, "search_neighbours", lambda known, *_: known)
    session, options = jaxnh.Session(logistic, start={"x": 0.3}), jaxnh.Orbits(max_period=9, transient=16, rounds=4)
    starts = np.random.default_rng(2).uniform(0.05, 0.95, 60)
    counts = session.groups({"orbits": options}, x=starts)["orbit_counts"]
    missing = np.array(TWO_LETTERS) - counts["number"].to_numpy()
    covered = (counts["missing_low"].to_numpy() <= missing) & (missing <= counts["missing_high"].to_numpy())
    assert missing[:, -1].max() > 5
    assert np.all(covered.mean(axis=0) > 0.95 - 3 * np.sqrt(0.95 * 0.05 / 60))


def test_entropy_of_numbers_that_are_known():
    """The full shift has ln 2 whatever the order; of one fixed point it is zero; missing orbits widen the error."""
    full, one, none = np.array(TWO_LETTERS, float), np.eye(1, 9)[0], np.zeros(9)
    np.testing.assert_allclose(topological_entropy(full, none), (np.log(2), 0.0), atol=1e-15)
    assert topological_entropy(one, none) == (0.0, 0.0)
    assert topological_entropy(full, one)[1] > 0.0
    assert np.isnan(topological_entropy(full[:3], none[:3])).all()
    assert np.isnan(topological_entropy(none, none)).all()


def test_options_that_do_not_go_together():
    with pytest.raises(InputError, match="needs a box to draw from"):
        jaxnh.Orbits(n_starts=4)
    session = jaxnh.Session(logistic, start={"x": 0.3})
    with pytest.raises(InputError, match="there is no coordinate y; known are x"):
        session.run(jaxnh.Orbits(n_starts=4, box={"y": (0.0, 1.0)}))


def lorenz_section(target):
    return jaxnh.Session(lorenz, start={"x": 1.0, "y": 1.0, "z": 20.0}, target=target).on(
        coordinate="z", value=27.0, direction="down"
    )


@pytest.mark.slow  # the matrix has orbits on sections, and symmetric ones of a map are quick
def test_short_orbits_of_lorenz():
    """The shortest takes 1.558652210716 (Viswanath 2003); the equilibria, which are on the section, are no orbits."""
    groups = lorenz_section(1e-5).groups(
        {"orbits": jaxnh.Orbits(max_period=2, transient=16, rounds=4, symmetry=("x", "y"))}
    )
    data, counts = groups["orbits"], groups["orbit_counts"]
    assert counts["number"].to_numpy().tolist() == counts["distinct"].to_numpy().tolist() == [0, 1]
    assert data["image"].to_numpy().tolist() == [1]
    assert abs(float(data["time"][0]) - 1.558652210716) < float(data["time_error"][0]) + 1e-12


@pytest.mark.slow
def test_searches_of_lorenz_that_are_stopped_early(monkeypatch):
    """Of rounds of a quarter of the starts, half to all words of six to eight letters; intervals cover 95 of 100.

    Each run is alone: orbits of neighbours are not tried.
    """
    monkeypatch.setattr(orbit_search, "WINDOWS", 4)
    monkeypatch.setattr(all_orbits, "search_neighbours", lambda known, *_: known)
    truth, starts = np.array([0, *TWO_LETTERS[1:8]]), np.random.default_rng(7).uniform(0.5, 15.0, 200)
    options = jaxnh.Orbits(max_period=8, transient=32, rounds=4)
    counts = lorenz_section(1e-5).groups({"orbits": options}, x=starts)["orbit_counts"]
    missing = truth - counts["number"].to_numpy()
    assert np.all(missing >= 0)
    assert 0.4 < missing[:, 7].mean() / truth[7] < 0.5
    covered = (counts["missing_low"].to_numpy() <= missing) & (missing <= counts["missing_high"].to_numpy())
    assert np.all(covered.mean(axis=0) > 0.95 - 3 * np.sqrt(0.95 * 0.05 / 200))


@pytest.mark.slow
def test_all_orbits_of_lorenz_up_to_eight_returns():
    """All words of two letters but those of one letter; periods and multipliers by heyoka's variational equations."""
    groups = lorenz_section(1e-12).groups({"orbits": jaxnh.Orbits()})
    data, counts = groups["orbits"], groups["orbit_counts"]
    assert counts["number"].to_numpy().tolist() == [0, *TWO_LETTERS[1:8]]
    assert_nothing_missing(counts)
    assert abs(float(data["time"][0]) - 1.558652210716) < 1e-11
    largest = complex_multipliers(data)[:, 0].real
    start = np.stack([data[name].to_numpy() for name in ("x", "y", "z")], axis=-1)
    exact, back = zip(*map(monodromy_by_heyoka, start, data["time"].to_numpy()), strict=True)
    np.testing.assert_allclose(largest, exact, rtol=1e-8)
    assert np.abs(back).max() < 1e-7
    assert abs(float(counts["entropy"]) - np.log(2)) < float(counts["entropy_error"])


def monodromy_by_heyoka(start, time):
    """The multiplier of largest modulus of an orbit from a state, and by how much it does not come back."""
    x, y, z = hy.make_vars("x", "y", "z")
    equations = hy.var_ode_sys(
        [(x, 10.0 * (y - x)), (y, x * (28.0 - z) - y), (z, x * y - 8 / 3 * z)], hy.var_args.vars, 1
    )
    integrator = hy.taylor_adaptive(equations, list(start), tol=1e-18, compact_mode=True)
    integrator.propagate_until(time)
    values = np.linalg.eigvals(integrator.state[3:].reshape(3, 3))
    return values[np.argmax(np.abs(values))].real, integrator.state[:3] - start
