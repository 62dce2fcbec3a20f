"""Crises that `basins` and `windows` find beside the tangencies of manifolds at which they happen, of Henon's map.

Grebogi, Ott and Yorke (Physica D 7 (1983) 181): an attractor is destroyed, or bands of it meet, where the unstable manifold in its closure
touches the stable one of a saddle on the boundary of its basin, or of its window's saddle orbit.
"""

from __future__ import annotations

import numpy as np
import pytest

import jaxnh
from tests.flows.known_maps import henon


def session():
    return jaxnh.Session(henon, start={"x": 0.1, "y": 0.1})


def first_tangency(data, saddle):
    """The least value at which an unstable manifold is tangent to the stable one of a saddle, and its error."""
    values = data["tangency"].where(data["tangency_to"] == saddle).to_numpy()
    at = int(np.nanargmin(values))
    return float(values[at]), float(data["tangency_error"][at])


def test_motions_that_escape_after_they_had_seemed_to_stay():
    """Beyond its crisis Henon's attractor is left after some thousand iterates: no start is on one."""
    options = jaxnh.Basins(box={"x": (-0.5, 0.5), "y": (-0.1, 0.1)}, n_starts=16, transient=256)
    data = session().run(options, a=[1.4271])
    assert np.all(data["attractor"] == -1)
    assert np.all(jaxnh.labels(data["status"]) == "not finite")


def test_edges_of_motions_that_all_escape():
    """Beyond the crisis there is one end of motions and no boundary; numbers beyond 1e154 have no squares."""
    data = session().run(jaxnh.Edges(box={"x": (-2.0, 2.0), "y": (-0.6, 0.6)}), a=[1.428])
    assert np.all(data["attractors"] == 0)
    assert np.all(np.isnan(data["x_edge"]))


@pytest.mark.slow
def test_the_crisis_of_a_basin():
    """The attractor meets the saddle on its basin's boundary between two lanes, of which one has it yet."""
    box = {"x": (-2.0, 2.0), "y": (-0.6, 0.6)}
    options = jaxnh.Manifolds(box=box, length=12.0, n_starts=64, saddles=2, crossings=0, tangency="a")
    manifolds = session().run(options, a=[1.425]).isel(a=0)
    assert np.all(np.diff(manifolds["x_orbit"].isel(orbit_point=0)) < 0.0)  # the saddle inside comes first
    value, error = first_tangency(manifolds, 2)
    assert error < 1e-10
    options = jaxnh.Basins(box={"x": (-0.5, 0.5), "y": (-0.1, 0.1)}, n_starts=64, transient=4096)
    attractors = session().run("attractors", options, a=np.linspace(1.426, 1.428, 21))
    assert attractors.sizes["change"] == 1
    assert abs(float(attractors["change_a"][0]) - value) < float(attractors["change_a_error"][0])


@pytest.mark.slow
def test_the_crisis_of_a_window():
    """The seven bands of the window that begins at 1.2266 meet its saddle orbit: its homoclinic tangency, from lanes on both sides."""
    box = {"x": (-1.5, 1.5), "y": (-0.5, 0.5)}
    options = jaxnh.Manifolds(box=box, period=7, length=2.0, n_starts=128, saddles=2, crossings=0, tangency="a")
    manifolds = session().run(options, a=[1.2715, 1.272])
    assert np.all(manifolds["saddles"] == 2)
    (below, error), (above, other) = (first_tangency(manifolds.isel(a=k), 2) for k in range(2))
    assert max(error, other) < 1e-10
    assert abs(below - above) < 1e-9  # of a family that the contraction of a turn, 2e-4, brings together
    windows = session().run(jaxnh.Windows(max_period=8, levels=6, crisis=256), a=np.linspace(1.22, 1.29, 281))
    window = windows.isel(window=windows["period"].to_numpy().tolist().index(7))
    assert abs(float(window["crisis"]) - below) < float(window["crisis_error"])
    assert float(window["limit"]) < below
