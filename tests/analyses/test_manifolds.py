"""Stable and unstable manifolds: straight lines, power series, crossings on a lattice, and tangencies."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.orbits.search import newton
from jaxnh.exceptions import InputError
from tests.flows.known_maps import henon

pytestmark = pytest.mark.usefixtures("always_shared_programs")
GOLDEN = 0.5 * (1.0 + np.sqrt(5.0))
FORNAESS_GAVOSTO = 1.392419807915
"""A tangency of the manifolds of Henon's fixed point at b = 0.3 (Fornæss and Gavosto, Ergod. Th. Dyn. Sys. 12, 1992)."""

HOMOCLINIC = 1.3924198079228514
"""The same by Newton on power series of order 36, in 45 digits: 8e-12 above that published."""


def cat(repetition=0.0):
    del repetition

    def image(y):
        x, z = y
        return jnp.stack([2.0 * x + z, x + z]) % (2.0 * jnp.pi)

    def inverse(y):
        x, z = y
        return jnp.stack([x - z, 2.0 * z - x]) % (2.0 * jnp.pi)

    return {"map": image, "inverse": inverse, "coordinates": ("x", "z"), "angles": ("x", "z")}


def duffing(F=0.0075, d=0.01, w=1.0):
    def rhs(y, t):
        x, v = y
        return v, x - x**3 - d * v + F * jnp.cos(w * t)

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / w}


def wrapped(difference):
    return (difference + np.pi) % (2 * np.pi) - np.pi


def test_the_cat_map():
    """Lines through the fixed point along the eigenvectors; they cross at right angles, in a lattice's projections."""
    options = jaxnh.Manifolds(box={"x": (-1.0, 1.0), "z": (-1.0, 1.0)}, length=20.0, spacing=0.2, n_starts=4)
    data = jaxnh.Session(cat, start={"x": 0.1, "z": 0.2}).run(options, repetition=[0.0]).isel(repetition=0)
    lines = {"unstable": np.array([GOLDEN, 1.0]), "stable": np.array([-1.0, GOLDEN])}
    points = np.stack([data["x_points"], data["z_points"]], axis=-1).reshape(4, -1, 2)
    arc, signs = data["arc_length"].to_numpy().reshape(4, -1), data["branch_sign"].to_numpy()
    for k, kind in enumerate(jaxnh.labels(data["branch_kind"]).to_numpy().tolist()):
        way = signs[k] * lines[kind] / np.linalg.norm(lines[kind])
        known = np.isfinite(arc[k])
        assert arc[k][known].max() >= 20.0
        assert np.abs(wrapped(points[k] - arc[k][:, None] * way)[known]).max() < 1e-12  # sums of some 200 chords
    assert float(data["deviation"].max()) < 1e-12
    crossings = np.stack([data["x_crossings"], data["z_crossings"]], axis=-1).reshape(-1, 2)
    # Rounding of the first segments, 1e-10 of x, moves points along either curve; not where the curves cross.
    error = data["crossing_deviation"].to_numpy().ravel()
    assert error.max() < 1e-13
    assert data["crossing_angle"].to_numpy() == pytest.approx(np.pi / 2, abs=1e-9)
    i, j = np.meshgrid(np.arange(-9, 10), np.arange(-9, 10))
    lattice = 2 * np.pi * np.stack([i.ravel(), j.ravel()], axis=1)
    for kind in lines:
        normal = np.array([-lines[kind][1], lines[kind][0]]) / np.linalg.norm(lines[kind])
        # Lattice and lines are rounded as well.
        assert np.all(np.abs((crossings[:, None] + lattice[None]) @ normal).min(axis=1) <= error + 1e-14)


def pendulum(g=1.0):
    """In a time that runs unevenly, and is a unit later after a period."""

    def rhs(y, t):
        (angle, rate), speed = y, 1.0 + 0.5 * jnp.cos(2 * jnp.pi * t)
        return speed * rate, -speed * g * jnp.sin(angle)

    return {"rhs": rhs, "coordinates": ("angle", "rate"), "angles": ("angle",), "period": 1.0}


def test_starts_that_all_escape():
    """Newton from no point, as where no start of a box meets the section, finds no orbit."""
    assert newton(None, None, None, np.zeros((0, 1, 2)), np.zeros(0, int), np.ones((1, 2))) == []


def test_the_separatrix_of_a_pendulum_on_its_circle():
    """From the saddle at π around the circle to itself both kinds are rate² = 4g cos²(angle/2); multipliers e^(±√g)."""
    options = jaxnh.Manifolds(
        box={"angle": (np.pi - 0.5, np.pi + 0.5), "rate": (-0.5, 0.5)},
        length=12.0,
        spacing=0.2,
        crossings=0,
        n_starts=4,
    )
    g = np.array([1.0, 1.5])
    data = jaxnh.Session(pendulum, start={"angle": 0.1, "rate": 0.0}, target=1e-9).run(options, g=g)
    assert data["saddles"].to_numpy().tolist() == [1, 1]
    for k, lane in enumerate(g):
        here = data.isel(g=k, saddle=0)
        angle, rate = (here[name].to_numpy() for name in ("angle_points", "rate_points"))
        known = np.isfinite(angle)
        assert (
            np.abs(rate**2 - 4 * lane * np.cos(angle / 2) ** 2)[known].max() < 1e-7
        )  # the target, over some ten periods
        middle = np.abs(np.sin(angle / 2)) < 0.5
        for kind, sign in (("unstable", 1.0), ("stable", -1.0)):
            of_kind = jaxnh.labels(here["branch_kind"]).to_numpy() == kind
            np.testing.assert_allclose(np.abs(here["multiplier"])[of_kind], np.exp(sign * np.sqrt(lane)), rtol=1e-8)
            signs = [np.sign(row[seen].mean()) for row, seen in zip(rate[of_kind], middle[of_kind], strict=True)]
            assert sorted(signs) == [-1.0, 1.0]


def straight_spring(bent=1.0):
    """A saddle between springs, ẍ = x up to |x| = 1 and 2 sgn x − x beyond, by |x|; time runs unevenly, for a clock."""

    def rhs(y, t):
        x, v = y
        rate = 1.0 + 0.3 * jnp.cos(2 * jnp.pi * t / 0.7)
        force = x - 2.0 * bent * jnp.maximum(jnp.abs(x) - 1.0, 0.0) * jnp.where(x > 0.0, 1.0, -1.0)
        return rate * v, rate * force

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 0.7}


def between_walls(r=0.8):
    """A saddle between walls (Shaw and Rand, Int. J. Non-Linear Mech. 24 (1989) 41), ẍ = x for |x| < 1; time likewise."""

    def rhs(y, t):
        rate = 1.0 + 0.3 * jnp.cos(2 * jnp.pi * t / 0.7)
        return rate * y[1], rate * y[0]

    def bounce(y, t):
        return y[0], -r * y[1]

    walls = [{"when": lambda y, t: y[0] - 1.0, "then": bounce}]
    walls.append({"when": lambda y, t: y[0] + 1.0, "direction": "down", "then": bounce})
    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 0.7, "jumps": walls}


def grown_from_zero(define, **lane):
    """Points of both kinds of branches of the saddle at zero, (branches, points), by kind."""
    options = jaxnh.Manifolds(
        box={"x": (-0.5, 0.5), "v": (-0.5, 0.5)}, length=24.0, spacing=0.2, crossings=0, n_starts=4
    )
    data = jaxnh.Session(define, start={"x": 0.1, "v": 0.0}, target=1e-9).run(options, **lane)
    here = data.isel(saddle=0, **dict.fromkeys(lane, 0))
    kinds = jaxnh.labels(here["branch_kind"]).to_numpy()
    np.testing.assert_allclose(
        np.abs(here["multiplier"]), np.where(kinds == "unstable", np.exp(0.7), np.exp(-0.7)), rtol=1e-8
    )
    return {
        kind: (here["x_points"].to_numpy()[kinds == kind], here["v_points"].to_numpy()[kinds == kind]) for kind in kinds
    }


def test_stable_manifolds_across_corners():
    """Of a level of energy both kinds are, v² = x² up to the corners and 4 |x| − x² − 2 beyond."""
    for kind, (x, v) in grown_from_zero(straight_spring, bent=[1.0]).items():
        known = np.isfinite(x)
        level = np.where(np.abs(x) < 1.0, x * x, 4.0 * np.abs(x) - x * x - 2.0)
        assert np.abs(v * v - level)[known].max() < 1e-7, kind
        assert np.nanmax(np.abs(x)) > 3.3, kind  # they turn at 2 + √2


def test_stable_manifolds_between_walls():
    """v² − x² is r^(2k) − 1 after k impacts, and r^(−2k) − 1 before them."""
    for kind, (x, v) in grown_from_zero(between_walls, r=[0.8]).items():
        known = np.isfinite(x)
        levels = 0.8 ** ((2.0 if kind == "unstable" else -2.0) * np.arange(6)) - 1.0
        gaps = np.abs((v * v - x * x)[known][:, None] - levels)
        assert gaps.min(axis=1).max() < 1e-7, kind
        assert {0, 1, 2} <= set(gaps.argmin(axis=1).tolist()), kind
        assert np.abs(x[known]).max() <= 1.0 + 1e-12, kind


def bent_saddle(grown=3.9, shrunk=0.92, a=0.2, b=0.3, c=0.1, x0=0.4, y0=-0.5):
    """(p, q) → (grown p, shrunk q) in coordinates x = x0 + p + a q² + c q³, y = y0 + q + b (x − x0)²."""

    def straight(x, y):
        q = y - y0 - b * (x - x0) ** 2
        return x - x0 - a * q * q - c * q**3, q

    def moved(s, by_p, by_q):
        p, q = straight(*s)
        x = by_p * p + a * (by_q * q) ** 2 + c * (by_q * q) ** 3
        return x0 + x, y0 + by_q * q + b * x * x

    return {
        "map": lambda s: moved(s, grown, shrunk),
        "inverse": lambda s: moved(s, 1.0 / grown, 1.0 / shrunk),
        "coordinates": ("x", "y"),
    }


@pytest.mark.parametrize("shrunk", [0.92, 0.995, -0.4])
def test_deviations_cover_how_far_points_are_from_manifolds(shrunk):
    """Those of a linear map in bent coordinates, on x = a y² + c y³ and y = b x², in long double.

    Where little shrinks across, what is left of a first segment that is straight is all that points are off by.
    """
    options = jaxnh.Manifolds(box={"x": (-0.6, 1.4), "y": (-1.5, 0.5)}, length=4.0, spacing=0.1, n_starts=4)
    session = jaxnh.Session(bent_saddle, start={"x": 0.1, "y": 0.1}, parameters={"shrunk": shrunk})
    grown = [1.3, 2.5, -3.9]
    data, a, b, c = session.run(options, grown=grown).isel(saddle=0), *map(np.longdouble, (0.2, 0.3, 0.1))
    for lane in range(len(grown)):
        for k, kind in enumerate(jaxnh.labels(data["branch_kind"]).to_numpy()[lane].tolist()):
            here = data.isel(grown=lane, branch=k)
            x, y = (here[name].to_numpy().astype(np.longdouble) for name in ("x_points", "y_points"))
            x, y = x[np.isfinite(x)] - np.longdouble(0.4), y[np.isfinite(y)] + np.longdouble(0.5)
            q = y - b * x * x  # zero on the unstable manifold; by how much a point is off along y or x
            away = q / np.hypot(1.0, 2 * b * x)
            if kind == "stable":
                away = (x - a * q * q - c * q**3) / np.hypot(1.0 + (2 * a * q + 3 * c * q * q) * 2 * b * x, 0.0)
            assert len(x) > 20
            assert np.abs(away).max() <= float(here["deviation"])
            assert float(here["deviation"]) < 1e-10


def series(a, b, kind, order=60):
    """Fixed point, multiplier and coefficients (order, 2) of K with P(K(s)) = K(μ s), by powers of s."""
    x = (b - 1.0 + np.sqrt((1.0 - b) ** 2 + 4.0 * a)) / (2.0 * a)
    root = np.sqrt((a * x) ** 2 + b)
    mu = -a * x - root if kind == "unstable" else -a * x + root
    terms = np.zeros((order, 2))
    terms[0], terms[1] = (x, b * x), (1.0, b / mu)
    for k in range(2, order):  # x_k μ^k = −a Σ x_i x_(k−i) + y_k, y_k μ^k = b x_k
        square = terms[1:k, 0] @ terms[k - 1 : 0 : -1, 0]
        terms[k, 0] = -a * square / (mu**k + 2.0 * a * x - b / mu**k)
        terms[k, 1] = b * terms[k, 0] / mu**k
    return mu, terms


BOX = {"x": (0.0, 2.0), "y": (-1.0, 1.0)}


def distance_from_series(points, kind, pulls=8):
    """Distances of points, brought near the fixed point by the map that contracts along the curve, from K."""
    mu, terms = series(1.4, 0.3, kind)
    x, y = points.T
    for _ in range(pulls):
        x, y = (y / 0.3, x - 1.0 + 1.4 * (y / 0.3) ** 2) if kind == "unstable" else (1.0 - 1.4 * x**2 + y, 0.3 * x)
    s, slopes = x - terms[0, 0], terms[1:] * np.arange(1, len(terms))[:, None]
    for _ in range(8):
        gap = np.polynomial.polynomial.polyval(s, terms) - np.stack([x, y])
        way = np.polynomial.polynomial.polyval(s, slopes)
        s = s - np.sum(gap * way, axis=0) / np.sum(way * way, axis=0)
    assert np.abs(s).max() < 0.3 * abs(mu) ** 0.5
    return np.linalg.norm(gap, axis=0)


def test_henons_manifolds_by_their_power_series():
    """Both kinds, beyond their first folds. What rounding does across grows by 6.4 a step on the way: to 1e-9 in all."""
    options = jaxnh.Manifolds(box=BOX, length=5.0, spacing=0.05, crossings=0)
    data = jaxnh.Session(henon, start={"x": 0.1, "y": 0.1}).run(options, a=[1.4]).isel(a=0, saddle=0)
    for k, kind in enumerate(jaxnh.labels(data["branch_kind"]).to_numpy().tolist()):
        here = data.isel(branch=k)
        assert float(here["multiplier"]) == pytest.approx(series(1.4, 0.3, kind)[0], rel=1e-12)
        points = np.stack([here["x_points"], here["y_points"]], axis=-1)
        known = np.isfinite(here["arc_length"].to_numpy())
        assert known.sum() > 100
        assert distance_from_series(points[known], kind).max() < 1e-9
        assert float(here["deviation"]) < 1e-8


def test_tangencies_of_henons_manifolds():
    """The published one from lanes on both sides of it, and that in more digits, within the errors that they say."""
    options = jaxnh.Manifolds(box=BOX, length=12.0, tangency="a", crossings=0)
    data = jaxnh.Session(henon, start={"x": 0.1, "y": 0.1}).run(options, a=[1.391, 1.394])
    value, error = data["tangency"].to_numpy()[:, 0], data["tangency_error"].to_numpy()[:, 0]
    assert np.all(np.abs(value - FORNAESS_GAVOSTO) < 1e-11)
    assert np.all(np.abs(value - HOMOCLINIC) < error)
    assert error.max() < 1e-11
    assert np.all(data["tangency_from"].to_numpy()[:, 0] == 1)


@pytest.mark.parametrize(("offset", "rate"), [(1000.0, 1.0), (0.0, 1.0)])
def test_tangencies_do_not_depend_on_the_units_of_the_parameter(offset, rate):
    """Of a parameter that lies far from zero or around it they are as exact as the numbers there."""

    def moved(p=0.0):
        return henon(1.39 + (p - offset) * rate, 0.3)

    options = jaxnh.Manifolds(box=BOX, length=7.0, spacing=0.05, n_starts=4, tangency="p", crossings=0)
    data = jaxnh.Session(moved, start={"x": 0.1, "y": 0.1}).run(options, p=[offset + 0.001 / rate])
    value, error = float(data["tangency"][0, 0]), float(data["tangency_error"][0, 0])
    assert abs(1.39 + (value - offset) * rate - HOMOCLINIC) < error * rate
    assert error < 1e-12 / rate + 2 * np.spacing(abs(offset))


def test_what_does_not_go():
    def folded(a=1.4):
        def image(s):
            return 1.0 - a * s[0] ** 2, 0.3 * s[0]

        return {"map": image, "coordinates": ("x", "y")}

    session = jaxnh.Session(folded, start={"x": 0.1, "y": 0.1})
    with pytest.raises(InputError, match="the map says no inverse; stable manifolds need that: take kind: unstable"):
        session.run(jaxnh.Manifolds(box=BOX), a=[1.4])
    with pytest.raises(InputError, match="needs a box"):
        session.run(jaxnh.Manifolds(kind="unstable"), a=[1.4])
    with pytest.raises(InputError, match="tangencies are along an axis that lanes may differ in; these are a"):
        session.run(jaxnh.Manifolds(box=BOX, tangency="b"), a=[1.4])
    with pytest.raises(InputError, match="take kind: both"):
        jaxnh.Manifolds(box=BOX, tangency="a", kind="unstable")
    with pytest.raises(InputError, match="gives no inverse of itself"):
        jaxnh.Session(wrong_inverse, start={"x": 0.1, "y": 0.1}).run(jaxnh.Manifolds(box=BOX), a=[1.4])


def wrong_inverse(a=1.4, b=0.3):
    def image(s):
        x, y = s
        return 1.0 - a * x**2 + y, b * x

    def inverse(s):
        x, y = s
        return y / b, x + 1.0 + a * (y / b) ** 2

    return {"map": image, "inverse": inverse, "coordinates": ("x", "y")}


def independent_gap(force, damping=0.01, samples=40):
    """Largest of (x_s − x_u) over the time of passage through v = 0, x > 1, in units of the force, by heyoka."""
    import heyoka as hy  # the other tests here do without

    turn, passages = 2 * np.pi, []
    x, v = hy.make_vars("x", "v")

    def passage(ta, t, sign):
        ta.update_d_output(t)
        if ta.d_output[0] > 1.0:
            passages.append((t, ta.d_output[0]))

    motion = [(x, v), (v, x - x**3 - damping * v + force * hy.cos(hy.time))]
    ta = hy.taylor_adaptive(motion, [0.0, 0.0], tol=1e-16, nt_events=[hy.nt_event(v, passage)])

    def after(y, t):
        ta.state[:], ta.time = y, 0.0
        ta.propagate_until(t)
        return ta.state.copy()

    saddle, h, matrix = np.array([-force / 2, 0.0]), 1e-5, np.eye(2)
    for _ in range(6):
        columns = [(after(saddle + h * e, turn) - after(saddle - h * e, turn)) / (2 * h) for e in np.eye(2)]
        matrix = np.stack(columns, axis=1)
        saddle = saddle - np.linalg.solve(matrix - np.eye(2), after(saddle, turn) - saddle)
    values, vectors = np.linalg.eig(matrix)
    harmonics = []
    for which, sign in ((np.argmax(values), 1.0), (np.argmin(values), -1.0)):
        way = vectors[:, which] * np.sign(vectors[0, which])
        size = abs(np.log(values[which]))
        phase, place = [], []
        for k in range(samples):
            passages.clear()
            after(saddle + 1e-7 * np.exp(size * k / samples) * way, sign * 60.0)
            phase.append(passages[0][0])
            place.append(passages[0][1])
        n = np.arange(1, 9)
        basis = np.concatenate([np.ones((samples, 1)), np.cos(np.outer(phase, n)), np.sin(np.outer(phase, n))], axis=1)
        harmonics.append(np.linalg.lstsq(basis, np.array(place), rcond=None)[0])
    t = np.linspace(0.0, turn, 4001)
    basis = np.concatenate([np.ones((len(t), 1)), np.cos(np.outer(t, n)), np.sin(np.outer(t, n))], axis=1)
    gap = basis @ (harmonics[0] - harmonics[1])
    k = int(np.argmax(gap[1:-1])) + 1
    bend = gap[k + 1] - 2 * gap[k] + gap[k - 1]
    return gap[k] - (gap[k + 1] - gap[k - 1]) ** 2 / (8 * bend)


@pytest.mark.slow
def test_the_first_tangency_of_duffings_saddle():
    """Within 2 % of Melnikov's value, and to 1e-6 of heyoka on another section: both graphs over the phase touch.

    The gap of both is linear in the force near zero, but for its square: a secant through two values near it.
    """
    melnikov = 0.01 * 4.0 / 3.0 * np.cosh(np.pi / 2) / (np.sqrt(2.0) * np.pi)
    session = jaxnh.Session(duffing, start={"x": 0.1, "v": 0.1}, target=1e-11)
    options = jaxnh.Manifolds(
        box={"x": (-0.5, 0.5), "v": (-0.5, 0.5)}, length=8.0, tangency="F", crossings=0, n_starts=16
    )
    data = session.run(options, F=[0.97 * melnikov, 1.03 * melnikov])
    value, error = data["tangency"].to_numpy()[:, 0], data["tangency_error"].to_numpy()[:, 0]
    assert value == pytest.approx(melnikov, rel=0.02)
    assert abs(value[0] - value[1]) < error.sum() + 1e-13
    low, high = value[0] * (1 - 1e-4), value[0] * (1 + 1e-4)
    gaps = [independent_gap(force) for force in (low, high)]
    exact = low - gaps[0] * (high - low) / (gaps[1] - gaps[0])
    assert value == pytest.approx(exact, rel=1e-6)
