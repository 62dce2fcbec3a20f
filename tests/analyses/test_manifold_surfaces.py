"""Manifolds of dimension two of equilibria: graphs in closed form, Lorenz's by heyoka, and what does not go."""

from __future__ import annotations

import heyoka as hy
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import jaxnh
from jaxnh.analyses.batch import LaneBatch
from jaxnh.analyses.manifolds import manifolds
from jaxnh.exceptions import InputError
from jaxnh.solvers import dopri8
from jaxnh.systems.first_order import Point, first_order
from tests.flows.lorenz import lorenz
from tests.helpers.batches import broadcast_start

BOX = {"x": (-1.0, 1.0), "y": (-1.0, 1.0), "z": (-1.0, 1.0)}


def graph(x, y):
    """A surface z = p(x, y) through zero, and its slopes."""
    return 0.5 * x**2 - 0.3 * x * y + 0.2 * y**3, x - 0.3 * y, -0.3 * x + 0.6 * y**2


def leaving(b=1.0, w=0.0, n=0.0, c=2.0, s=1.0):
    """x' = x − w y + n y, y' = b y + w x, times s, and z − p(x, y) shrinks as e^(−s c t): for s = 1 the unstable manifold is p."""

    def rhs(u, t):
        x, y, z = u
        p, by_x, by_y = graph(x, y)
        dx, dy = s * (x - w * y + n * y), s * (b * y + w * x)
        return dx, dy, -s * c * (z - p) + by_x * dx + by_y * dy

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}


def corners(data):
    """Points, triangles, deviations and arc lengths of a lane's surface."""
    known = np.isfinite(data["deviation"].to_numpy())
    points = np.stack([data[f"{name}_points"].to_numpy()[known] for name in "xyz"], axis=1)
    triangles = data["triangles"].to_numpy()
    return (
        points,
        triangles[triangles[:, 0] >= 0],
        data["deviation"].to_numpy()[known],
        data["arc_length"].to_numpy()[known],
    )


def edges_of(triangles):
    """Each edge once, with how many triangles have it."""
    every = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    return np.unique(every, axis=0, return_counts=True)


def is_a_disc(points, triangles):
    """V − E + F = 1, no edge in more than two triangles, and one loop of edges in one alone."""
    edges, counts = edges_of(triangles)
    assert counts.max() == 2
    assert len(points) - len(edges) + len(triangles) == 1
    rim, degree = np.unique(edges[counts == 1], return_counts=True)
    assert np.all(degree == 2)
    return rim


def surfaces_of(lanes, kind, length, max_points=4096, **p):
    """The surfaces of lanes with such parameters, which must be as many of each."""
    p = {name: np.asarray(values, float) for name, values in p.items()}
    flow = first_order(leaving, {"b": 1.0, "w": 0.0, "n": 0.0, "c": 2.0, "s": 1.0}, ("b", "w", "n", "s"))
    count = len(p["b"])
    batch = LaneBatch(
        flow, broadcast_start(Point((0.1, 0.1, 0.1)), count), p, dopri8, 64, False, 1e-9, np.zeros(count, int)
    )
    options = jaxnh.Manifolds(
        dimension=2, kind=kind, box=BOX, n_starts=4, length=length, spacing=0.1, max_points=max_points
    )
    return manifolds.run(options, batch, lanes).isel(saddle=0, surface=0)


def test_graphs_in_closed_form(lanes):
    """Real, equal, defective and complex eigenvalues; all corners are within their deviations of the graph."""
    b, w, n = np.array([(1, 0, 0), (8, 0, 0), (1, 0, 1), (1, 2, 0), (3, 2, 1)], float).T
    data = surfaces_of(lanes, "unstable", 1.0, b=b, w=w, n=n, s=np.ones(5))
    for k in range(5):
        lane = data.isel(lane=k)
        matrix = np.array([[1.0, n[k] - w[k]], [w[k], b[k]]])
        values = np.sort_complex(lane["eigenvalues"].to_numpy() @ [1.0, 1j])
        # A double eigenvalue moves by the root of rounding.
        assert values == pytest.approx(np.sort_complex(np.linalg.eigvals(matrix).astype(complex)), abs=1e-7)
        points, triangles, deviation, arc = corners(lane)
        x, y, z = points.T
        p, by_x, by_y = graph(x, y)
        assert np.all(np.abs(z - p) / np.sqrt(1.0 + by_x**2 + by_y**2) <= deviation)
        assert deviation.max() < 1e-9
        assert int(lane["end"]) == 1
        assert int(lane["gaps"]) == 0
        rim = is_a_disc(points, triangles)
        assert arc[rim].min() > 1.0
        lengths = np.linalg.norm(np.diff(points[edges_of(triangles)[0]], axis=1)[:, 0], axis=1)
        assert lengths.max() < 0.2 * np.sqrt(2.0)  # sides of two spacings at right angles


def test_stable_manifolds_are_those_of_reversed_time(lanes):
    """The same surface where all signs are changed, corner by corner."""
    of = {
        kind: surfaces_of(lanes, kind, 0.5, b=[3.0], w=[0.0], n=[0.0], s=[s]).isel(lane=0)
        for s, kind in ((1.0, "unstable"), (-1.0, "stable"))
    }
    for name in ("x_points", "z_points", "triangles"):
        np.testing.assert_allclose(of["stable"][name], of["unstable"][name], atol=1e-12)
    np.testing.assert_array_equal(of["stable"]["eigenvalues"], -of["unstable"]["eigenvalues"])


def test_as_many_points_as_there_may_be(lanes):
    """A surface of more points is cut at an arc length, and is a disc still."""
    data = surfaces_of(lanes, "unstable", 4.0, b=[3.0], w=[0.0], n=[0.0], s=[1.0]).isel(lane=0)
    points, triangles, _, arc = corners(data)
    assert jaxnh.labels(data["end"]).item() == "max points"
    assert 2048 < len(points) <= 4096
    rim = is_a_disc(points, triangles)
    assert np.ptp(arc[rim]) < 0.5  # the boundary of the local manifold is no circle
    few = surfaces_of(lanes, "unstable", 4.0, b=[3.0], w=[0.0], n=[0.0], s=[1.0], max_points=16).isel(lane=0)
    assert len(corners(few)[0]) == 1  # not even the local manifold has so few
    assert jaxnh.labels(few["end"]).item() == "max points"


def test_a_lane_is_the_same_with_others(lanes):
    """To the bit, steps of its own included: a lane of fast and one of slow eigenvalues, together and alone."""
    together = surfaces_of(lanes, "unstable", 1.0, b=[8.0, 1.0], w=[0.0, 2.0], n=[0.0, 0.0], s=[1.0, 1.0])
    for k, (b, w) in enumerate(((8.0, 0.0), (1.0, 2.0))):
        alone = surfaces_of(lanes, "unstable", 1.0, b=[b], w=[w], n=[0.0], s=[1.0])
        xr.testing.assert_identical(together.isel(lane=k), alone.isel(lane=0))


def in_four_dimensions(b=1.0):
    """A focus that leaves along a graph over (x, y), to which the differences from it come; these alone are the other one."""

    def rhs(u, t):
        x, y, z, w = u
        p, by_x, by_y = graph(x, y)
        q, of_x, of_y = 0.4 * x * y + 0.1 * x**3, 0.4 * y + 0.3 * x**2, 0.4 * x
        dx, dy, one, other = x - 2.0 * y, 2.0 * x + b * y, z - p, w - q
        dz = -one + 3.0 * other + by_x * dx + by_y * dy
        return dx, dy, dz, -3.0 * one - 2.0 * other + 0.5 * one * other + of_x * dx + of_y * dy

    return {"rhs": rhs, "coordinates": ("x", "y", "z", "w")}


@pytest.mark.slow
def test_both_surfaces_in_four_dimensions():
    """Distances from a graph in two directions are those along its normals; the stable plane is x = y = 0."""
    box = dict.fromkeys("xyzw", (-1.0, 1.0))
    session = jaxnh.Session(in_four_dimensions, start={"x": 0.0, "y": 0.0, "z": 0.1, "w": 0.1}, target=1e-8)
    options = jaxnh.Manifolds(dimension=2, box=box, n_starts=4, length=1.0, max_points=4096)
    data = session.run(options, b=[1.0, 3.0]).isel(saddle=0)
    assert jaxnh.labels(data["surface_kind"].isel(b=0)).to_numpy().tolist() == ["unstable", "stable"]
    for b in (0, 1):
        unstable, stable = (data.isel(b=b, surface=k) for k in (0, 1))
        known = np.isfinite(unstable["deviation"].to_numpy())
        x, y, z, w = (unstable[f"{name}_points"].to_numpy()[known] for name in "xyzw")
        p, by_x, by_y = graph(x, y)
        off = np.stack([z - p, w - 0.4 * x * y - 0.1 * x**3], axis=1)
        one, zero = np.ones_like(x), np.zeros_like(x)
        normal = np.array([[-by_x, -by_y, one, zero], [-0.4 * y - 0.3 * x**2, -0.4 * x, zero, one]])
        square = np.linalg.inv(np.einsum("kin,lin->nkl", normal, normal))
        deviation = unstable["deviation"].to_numpy()[known]
        assert np.mean(np.sqrt(np.einsum("nk,nkl,nl->n", off, square, off)) <= deviation) >= 0.95
        assert deviation.max() < 1e-8
        known = np.isfinite(stable["deviation"].to_numpy())
        assert known.sum() > 500
        x, y = (stable[f"{name}_points"].to_numpy()[known] for name in "xy")
        assert np.all(np.hypot(x, y) <= stable["deviation"].to_numpy()[known])


def test_what_does_not_go():
    """Systems without such surfaces, and options of curves."""

    def henon(a=1.4):
        return {"map": lambda s: (1.0 - a * s[0] ** 2 + s[1], 0.3 * s[0]), "coordinates": ("x", "y")}

    def driven(F=0.1):
        def rhs(y, t):
            return y[1], y[0] - y[0] ** 3 + F * jnp.cos(t)

        return {"rhs": rhs, "coordinates": ("x", "y"), "period": 2 * jnp.pi}

    def plane(F=0.1):
        return {"rhs": lambda y, t: (y[1], F * y[0]), "coordinates": ("x", "y")}

    box = {"x": (-1.0, 1.0), "y": (-1.0, 1.0)}
    options = jaxnh.Manifolds(dimension=2, box=box)
    for system, axis, words in (
        (henon, "a", "surfaces are of flows, and this is a map"),
        (driven, "F", "surfaces are of a flow without a clock"),
        (plane, "F", "a surface is all there is of a flow with two coordinates"),
    ):
        with pytest.raises(InputError, match=words):
            jaxnh.Session(system, start={"x": 0.1, "y": 0.1}).run(options, **{axis: [1.0]})
    for given, words in (
        ({"tangency": "a"}, "crossings and tangencies are of curves"),
        ({"crossings": 4}, "crossings and tangencies are of curves"),
        ({"period": 2}, "equilibria have no period"),
        ({"dimension": 1, "of": "cycles"}, "curves are of orbits of the return map anyway"),
    ):
        with pytest.raises(InputError, match=words):
            jaxnh.Manifolds(**{"dimension": 2, "box": box} | given)


# ---- saddle cycles


def wound(x, y, z):
    """A surface r = 1 + p(z, θ) through the unit circle, and its slopes in z and along the circle."""
    r = jnp.hypot(x, y)
    cos, sin = x / r, y / r
    return r - 1.0 - 0.3 * z**2 - 0.2 * z * cos, 0.6 * z + 0.2 * cos, -0.2 * z * sin


def ring(a=0.1, s=1.0):
    """θ' = 1, z' = a z, times s, and what r is off the surface shrinks as e^(−s t)."""

    def rhs(u, t):
        x, y, z = u
        r = jnp.hypot(x, y)
        off, by_z, by_angle = wound(x, y, z)
        dr = -off + by_z * a * z + by_angle
        return s * (dr * x / r - y), s * (dr * y / r + x), s * a * z

    return {"rhs": rhs, "coordinates": ("x", "y", "z"), "time_unit": 2 * jnp.pi}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["unstable", "stable"])
def test_surfaces_of_a_cycle_in_closed_form(kind):
    """Both kinds, at two multipliers; all corners are within their deviations, and the surface goes around."""
    s, middle = (1.0, 1.0) if kind == "unstable" else (-1.0, -1.0)
    options = jaxnh.Manifolds(
        dimension=2,
        of="cycles",
        kind=kind,
        box={"x": (middle - 1.0, middle + 1.0), "y": (-1.0, 1.0), "z": (-1.0, 1.0)},
        n_starts=4,
        length=1.0,
        max_points=8192,
    )
    session = jaxnh.Session(ring, start={"x": 1.1 * middle, "y": 0.0, "z": 0.0}, target=1e-9, parameters={"s": s})
    data = session.on(coordinate="y", value=0.0, direction="up").run(options, a=[0.1, 0.3])
    for a in (0, 1):
        lane = data.isel(a=a, saddle=0, surface=0)
        assert float(lane["multiplier"]) == pytest.approx(np.exp(2 * np.pi * s * float(lane["a"])), rel=1e-7)
        points, triangles, deviation, _ = corners(lane)
        off, by_z, by_angle = (np.asarray(leaf) for leaf in wound(*points.T))
        r = np.hypot(points[:, 0], points[:, 1])
        assert np.all(np.abs(off) / np.sqrt(1.0 + by_z**2 + (by_angle / r) ** 2) <= deviation)
        assert deviation.max() < 1e-7
        assert jaxnh.labels(lane["end"]).item() == "length"
        # Each motion is a turn, on either side of the cycle, to the end of the curve, which is a size long.
        assert np.abs(np.arctan2(points[:, 1], points[:, 0])).max() > 3.0
        assert min(points[:, 2].max(), -points[:, 2].min()) > 0.8
        lengths = np.linalg.norm(np.diff(points[edges_of(triangles)[0]], axis=1)[:, 0], axis=1)
        assert lengths.max() < 0.2 * np.sqrt(2.0)


def turning_over(a=0.1):
    """About the unit circle ξ' = a ξ and η' = −η, in a plane of (r − 1, z) that makes half a turn on the way."""

    def rhs(u, t):
        x, y, z = u
        r = jnp.hypot(x, y)
        rho, cc, ss, cs = r - 1.0, 0.5 + 0.5 * x / r, 0.5 - 0.5 * x / r, 0.5 * y / r
        of_rho = a * (cc * rho + cs * z) - ss * rho + cs * z - z / 2
        of_z = a * (cs * rho + ss * z) + cs * rho - cc * z + rho / 2
        return of_rho * x / r - y, of_rho * y / r + x, of_z

    return {"rhs": rhs, "coordinates": ("x", "y", "z"), "time_unit": 2 * jnp.pi}


@pytest.mark.slow
def test_a_surface_that_turns_over():
    """A cycle of a negative multiplier: its manifold is the Möbius strip η = 0. Coarse steps compile in half the time."""
    options = jaxnh.Manifolds(
        dimension=2,
        of="cycles",
        kind="unstable",
        box={"x": (0.5, 1.5), "y": (-0.5, 0.5), "z": (-0.5, 0.5)},
        n_starts=4,
        length=0.5,
        spacing=0.05,
    )
    # Outside the cycle: from the cycle itself rounding decides whether the motion comes to r = 0, where there is no field.
    session = jaxnh.Session(turning_over, start={"x": 1.01, "y": 0.0, "z": 0.0}, target=1e-5)
    session = session.on(coordinate="y", value=0.0, direction="up")
    data = session.run(options, a=[0.1]).isel(a=0, saddle=0, surface=0)
    assert float(data["multiplier"]) == pytest.approx(-np.exp(0.2 * np.pi), rel=1e-3)
    (x, y, z), _, deviation, _ = (leaf.T for leaf in corners(data))
    half = 0.5 * np.arctan2(y, x)
    assert np.all(np.abs(np.cos(half) * z - np.sin(half) * (np.hypot(x, y) - 1.0)) <= deviation)
    assert deviation.max() < 1e-3


# ---- Lorenz's manifold


SPAN = np.linspace(0.0, 8.0, 1601)  # bars of 1e-13 are seen after 3 and more


def heyoka_lorenz(rho):
    x, y, z = hy.make_vars("x", "y", "z")
    field = [(x, 10.0 * (y - x)), (y, rho * x - y - x * z), (z, x * y - 8.0 / 3.0 * z)]
    integrator = hy.taylor_adaptive(field, [0.0, 0.0, 0.0], tol=1e-16)

    def motion(u, times=SPAN):
        integrator.time = 0.0
        integrator.state[:] = u
        return integrator.propagate_grid(times)[-1]

    return motion


def lorenz_surface(rho, length, spacing, most):
    options = jaxnh.Manifolds(
        dimension=2,
        kind="stable",
        box={"x": (-20.0, 20.0), "y": (-20.0, 20.0), "z": (-20.0, 20.0)},
        n_starts=4,
        length=length,
        spacing=spacing,
        max_points=most,
    )
    session = jaxnh.Session(lorenz, start={"x": 1.0, "y": 1.0, "z": 20.0}, target=1e-9)
    return session.run(options, rho=rho).isel(saddle=0, surface=0)


def normals(points, triangles):
    """Unit normals at corners, by the planes of their triangles, of either sign."""
    across = np.cross(
        points[triangles[:, 1]] - points[triangles[:, 0]], points[triangles[:, 2]] - points[triangles[:, 0]]
    )
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    sums = np.zeros((len(points), 3, 3))
    for k in range(3):
        np.add.at(sums, triangles[:, k], across[:, :, None] * across[:, None])
    return np.linalg.eigh(sums)[1][:, :, 2]


def pass_on_both_sides(one, other):
    """Whether two motions that begin next to each other part beside the origin, to different sides of its manifold."""
    apart = np.flatnonzero(np.linalg.norm(one - other, axis=1) > 1.0)
    if not len(apart):
        return False
    here, there = one[apart[0]], other[apart[0]]
    return here[0] * there[0] < 0.0 and max(np.linalg.norm(here), np.linalg.norm(there)) < 6.0


@pytest.mark.slow
@pytest.mark.parametrize(("rho", "length", "largest"), [(28.0, 5.0, 1e-9), (13.926557, 8.0, 1e-5)])
def test_lorenz_manifold_is_within_its_deviations(rho, length, largest):
    """Of 200 corners: motions from both ends of the bar, by heyoka at 1e-16, pass the origin on different sides.

    A value between them is on the manifold, and a deviation covers it; how many do is the coverage, 95 in 100 at least.
    Where the unstable manifold comes back, motions pass close to the origin again, where the field turns fast.
    """
    data = lorenz_surface([rho], length, 0.1, 65536).isel(rho=0)
    points, triangles, deviation, arc = corners(data)
    is_a_disc(points, triangles)
    assert jaxnh.labels(data["end"]).item() == "length"
    assert arc.max() > length
    assert deviation.max() < largest
    across, motion = 20.0 * deviation[:, None] * normals(points, triangles), heyoka_lorenz(rho)
    chosen = np.random.default_rng(0).choice(len(points), 200, replace=False)
    covered = [pass_on_both_sides(*(motion(points[k] + sign * across[k]) for sign in (-1.0, 1.0))) for k in chosen]
    assert np.mean(covered) >= 0.95


@pytest.mark.slow
def test_the_homoclinic_orbit_is_on_lorenz_manifold():
    """The unstable manifold passes through the stable one at the published ρ = 13.926557.

    Its distance from a cubic graph through the corners near by, which are a twentieth of the loop apart: to the fourth
    power 1e-5, beside changes with ρ of order one, between lanes of both signs 0.01 apart, linear to 1e-4.
    """
    rho, gaps = np.array([13.92, 13.93]), []
    data = lorenz_surface(rho, 2.5, 0.05, 32768)
    for k, value in enumerate(rho):
        points, triangles, _, _ = corners(data.isel(rho=k))
        way = np.array(
            [1.0, 1.0 + (np.sqrt(81.0 + 40.0 * value) - 11.0) / 20.0, 0.0]
        )  # (λ + σ)/σ of the unstable vector
        end = heyoka_lorenz(value)(1e-6 * way, np.array([0.0, 3.0]))[-1]  # on its way back
        near = np.argsort(np.linalg.norm(points - end, axis=1))[:40]
        normal = normals(points, triangles)[near[0]]
        normal *= np.sign(normal[0])
        basis = np.linalg.svd(normal[None])[2][1:]
        u, v = (points[near] - end) @ basis.T[:, 0], (points[near] - end) @ basis.T[:, 1]
        terms = np.stack([u**i * v**j for i in range(4) for j in range(4 - i)], axis=1)
        gaps.append(np.linalg.lstsq(terms, (points[near] - end) @ normal, rcond=None)[0][0])
    root = rho[0] - gaps[0] * (rho[1] - rho[0]) / (gaps[1] - gaps[0])
    assert gaps[0] * gaps[1] < 0.0
    assert root == pytest.approx(13.926557, abs=1e-4)
