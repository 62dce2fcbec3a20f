"""Manifolds of dimension two of equilibria: graphs in closed form, Lorenz's by heyoka, and what does not go."""

from __future__ import annotations

import heyoka as hy
import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.batch import LaneBatch, broadcast_start
from jaxnh.analyses.manifolds import manifolds
from jaxnh.exceptions import InputError
from jaxnh.solvers import dopri8
from jaxnh.systems.first_order import Point, first_order
from tests.flows.lorenz import lorenz

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
    return points, triangles[triangles[:, 0] >= 0], data["deviation"].to_numpy()[known], data["arc_length"].to_numpy()[known]


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


def surfaces_of(lanes, kind, length, **p):
    """The surfaces of lanes with such parameters, which must be as many of each."""
    p = {name: np.asarray(values, float) for name, values in p.items()}
    flow = first_order(leaving, {"b": 1.0, "w": 0.0, "n": 0.0, "c": 2.0, "s": 1.0}, ("b", "w", "n", "s"))
    count = len(p["b"])
    batch = LaneBatch(flow, broadcast_start(Point((0.1, 0.1, 0.1)), count), p, dopri8, 64, False, 1e-9)
    options = jaxnh.Manifolds(
        dimension=2, kind=kind, box=BOX, n_starts=4, length=length, spacing=0.1, max_points=4096
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
