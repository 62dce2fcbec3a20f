"""Crises that `basins` and `windows` find beside the tangencies of manifolds at which they happen, of Henon's map and Lorenz's flow.

Grebogi, Ott and Yorke (Physica D 7 (1983) 181): an attractor is destroyed, or bands of it meet, where the unstable manifold in its closure
touches the stable one of a saddle on the boundary of its basin, or of its window's saddle orbit.
"""

from __future__ import annotations

import numpy as np
import pytest

import jaxnh
from tests.flows.known_maps import henon
from tests.flows.lorenz import lorenz

pytestmark = pytest.mark.usefixtures("always_shared_programs")


def session():
    return jaxnh.Session(henon, start={"x": 0.1, "y": 0.1})


def first_tangency(data, saddle):
    """The least value at which an unstable manifold is tangent to the stable one of a saddle, and its error."""
    values = data["tangency"].where(data["tangency_to"] == saddle).to_numpy()
    at = int(np.nanargmin(values))
    return float(values[at]), float(data["tangency_error"][at])


def test_a_set_that_motions_leave_is_no_attractor():
    """Its crisis is at a = 1.42692, beyond which some starts leave within some thousand iterates and others do not yet.

    Those that are left are followed to the end, and said to be on a transient.
    """
    box = {"x": (-0.5, 0.5), "y": (-0.1, 0.1)}
    options = jaxnh.Basins(box=box, n_starts=16, transient=256, max_periods=1024, max_period=4)
    data = session().run(options, a=[1.4268, 1.427])
    before, beyond = (data.isel(a=k) for k in range(2))
    assert np.all(before["attractor"] == 1)
    assert set(np.unique(beyond["attractor"])) == {-1, 0}
    assert np.all((jaxnh.labels(beyond["status"]) == "not finite") == (beyond["attractor"] == -1))
    assert np.all((beyond["attractor"] == -1) | (beyond["time"] == 1024))
    left = jaxnh.labels(beyond["undecided"]).where(beyond["attractor"] == 0, drop=True)
    assert np.any(left == "transient")
    assert np.all(left.isin(["transient", "time"]))


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


def test_chaos_that_comes_to_rest_while_it_is_looked_at():
    """Below rho = 24.06 Lorenz's chaos ends, after 1,000 to 2,000 units of time on average from 23.3 to 23.45.

    Of motions that end while they are looked at none is a limit cycle, and none of the others is on an attractor.
    """
    box = {"x": (-20.0, 20.0), "y": (-20.0, 20.0), "z": (5.0, 40.0)}
    options = jaxnh.Basins(box=box, n_starts=16, transient=64, max_periods=512)
    session = jaxnh.Session(lorenz, start={"x": 1.0, "y": 1.0, "z": 20.0}, target=1e-6)
    groups = session.groups({"basins": options}, rho=[23.3, 23.4, 23.45])
    assert set(jaxnh.labels(groups["attractors"]["kind"]).to_numpy().ravel()) == {"equilibrium"}
    left = groups["basins"]["attractor"] == 0
    assert np.any(left)
    assert set(np.unique(jaxnh.labels(groups["basins"]["undecided"]).where(left, "no"))) <= {"no", "time", "transient"}


@pytest.mark.slow
def test_the_crisis_of_a_flow():
    """Lorenz's chaos becomes an attractor at rho = 24.06 (Kaplan and Yorke, Commun. Math. Phys. 67 (1979) 93).

    At 23.5 some starts come to rest sooner than others, and none is on an attractor but the equilibria.
    """
    box = {"x": (-20.0, 20.0), "y": (-20.0, 20.0), "z": (5.0, 40.0)}
    options = jaxnh.Basins(box=box, n_starts=32, transient=64, max_periods=2048)
    session = jaxnh.Session(lorenz, start={"x": 1.0, "y": 1.0, "z": 20.0}, target=1e-6)
    groups = session.groups({"basins": options}, rho=[23.5, 24.3])
    data, kind = groups["basins"], jaxnh.labels(groups["attractors"]["kind"])
    assert sorted(kind.sel(rho=23.5).to_numpy().tolist()) == ["absent", "equilibrium", "equilibrium"]
    assert "chaotic" in kind.sel(rho=24.3)
    before, beyond = data["attractor"].sel(rho=23.5), data["attractor"].sel(rho=24.3)
    assert np.sum(before > 0) > 16
    assert set(np.unique(jaxnh.labels(data["undecided"]).sel(rho=23.5))) <= {"no", "time", "transient"}
    assert np.mean(kind.sel(rho=24.3)[beyond.to_numpy() - 1] == "chaotic") > 0.9
