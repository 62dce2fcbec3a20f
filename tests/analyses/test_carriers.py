"""Orbits inside attractors and outside: bands of the logistic map, Hénon's map, a discrete Lorenz attractor."""

from __future__ import annotations

import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.orbits.scenarios import SCENARIOS, CarrierChart, scenarios
from jaxnh.plotting.descriptions import describe
from tests.flows.lorenz import lorenz

pytestmark = pytest.mark.usefixtures("always_shared_programs")


def carriers(data):
    return jaxnh.labels(data["carrier"]).to_numpy().ravel().tolist()


def roads(data):
    return jaxnh.labels(data["scenario"]).to_numpy().ravel().tolist()


def places(data, lane):
    """Places of the orbits of a lane."""
    of_lane = data.isel({str(data.attrs["axes"]): lane})
    return jaxnh.labels(of_lane["place"]).to_numpy()[of_lane["period"].to_numpy() > 0].tolist()


def logistic(r=3.7):
    return {"map": lambda y: (r * y[0] * (1.0 - y[0]),), "coordinates": ("x",)}


def henon(a=1.4, b=0.3):
    return {"map": lambda y: (1.0 - a * y[0] ** 2 + y[1], b * y[0]), "coordinates": ("x", "y")}


def henon_in_space(m2=0.815, b=0.7):
    """Of Gonchenko, Ovsyannikov, Simó and Turaev (2005), at M1 = 0."""

    def image(s):
        x, y, z = s
        return y, z, m2 * y + b * x - z * z

    return {"map": image, "coordinates": ("x", "y", "z")}


def test_bands_of_the_logistic_map():
    """Bands merge at 3.59257 and 3.67857 (Grossmann and Thomae, 1977): so many bands, no shorter orbit is inside."""
    r = np.array([3.2, 3.58, 3.62, 3.7, 4.0])
    data = jaxnh.Session(logistic, start={"x": 0.4}).run(jaxnh.Orbits(max_period=4, attractor=4096), r=r)
    assert data["least_period"].to_numpy().tolist() == [2, 4, 2, 1, 1]
    assert carriers(data) == ["stable", *["repelling"] * 4]
    assert places(data, 3) == ["outside", "inside", "inside", "inside"]  # 0, and of periods 1, 2 and 4
    assert places(data, 4) == ["inside"] * 8  # the map is onto at 4


def test_a_flip_saddle_carries_henons_attractor():
    """Just before its crisis points come nearer to the saddle on the boundary than to each other, and no leaf passes it."""
    data = jaxnh.Session(henon, start={"x": 0.1, "y": 0.1}).run(
        jaxnh.Orbits(max_period=2, attractor=4096), a=np.array([1.4, 1.4269])
    )
    assert carriers(data)[0] == "flip saddle"
    assert data["least_unstable"].to_numpy()[0] == 1
    assert places(data, 0) == ["outside", "inside", "inside"]  # the fixed point on the other side is on the boundary
    assert places(data, 1) == ["undecided", "inside", "inside"]


def test_a_discrete_lorenz_attractor():
    """Its saddle is the fixed point x = M2 + B − 1, with the roots of μ³ + 2 x μ² = M2 μ + B as multipliers."""
    session = jaxnh.Session(henon_in_space, start={"x": 0.1, "y": 0.1})
    data = session.run(jaxnh.Orbits(max_period=1, attractor=8192), m2=np.array([0.815]))
    assert carriers(data) == roads(data) == ["discrete lorenz"]
    assert data["least_period"].to_numpy().tolist() == [1]
    assert places(data, 0) == ["outside", "inside"]  # the other one is 0
    at = int(np.argmax(data["x"].to_numpy()[0]))
    exact = np.roots([1.0, 2.0 * 0.515, -0.815, -0.7])
    assert np.abs(np.sort(data["multipliers"].to_numpy()[0, at, :, 0]) - np.sort(exact.real)).max() < 1e-9


def test_a_saddle_inside_that_motions_come_near_to_only_after_very_long():
    """Beside the logistic map at 4, y ↦ c y + (1 − c) x: with its fixed point 3/4 the attractor holds (3/4, 3/4), as with
    every orbit of it. The multipliers are −2 and c, and y is far from 3/4 unless x has been there for long.
    """

    def slow(c=0.9):
        return {"map": lambda s: (4.0 * s[0] * (1.0 - s[0]), c * s[1] + (1.0 - c) * s[0]), "coordinates": ("x", "y")}

    session = jaxnh.Session(slow, start={"x": 0.3, "y": 0.5})
    data = session.run(jaxnh.Orbits(max_period=1, attractor=2048), c=np.array([0.3, 0.9, 0.97, 0.99]))
    at = np.abs(data["x"].to_numpy() - 0.75).argmin(axis=1)
    assert np.abs(data["y"].to_numpy()[np.arange(4), at] - 0.75).max() < 1e-9
    words = jaxnh.labels(data["place"]).to_numpy()[np.arange(4), at].tolist()
    assert words[0] == "inside"
    assert "outside" not in words


@pytest.mark.slow  # other roads are quick
def test_multipliers_that_are_zero_are_counted_out():
    """A coordinate that each iterate puts to zero adds one, as a constraint or a level does.

    Of 2,048 points none is near the saddle: an unstable leaf of the motion is.
    """

    def with_zero(m2=0.815):
        three = henon_in_space(m2)
        return {"map": lambda y: (*three["map"](y[:3]), 0.0 * y[3]), "coordinates": (*three["coordinates"], "w")}

    session = jaxnh.Session(with_zero, start={"x": 0.1, "y": 0.1})
    data = session.run(jaxnh.Orbits(max_period=1, attractor=2048), m2=np.array([0.815]))
    assert carriers(data) == ["discrete lorenz"]


def test_the_road_of_the_logistic_map():
    """Bands of chaos behind cycles of 1, 2 and 4; at 4 the origin, which has never flipped, lies in the attractor too."""
    r = np.array([3.7, 2.8, 3.2, 4.0, 3.5, 3.62])  # in any order
    data = jaxnh.Session(logistic, start={"x": 0.4}).run(jaxnh.Orbits(max_period=4, attractor=4096), r=r)
    expected = ["feigenbaum", "regular", "regular", "none of these", "regular", "feigenbaum"]
    assert roads(data) == expected
    assert describe("orbits", data).attrs["panel"] == "flags"
    alone = jaxnh.Session(logistic, start={"x": 0.4}).run(jaxnh.Orbits(max_period=4, attractor=4096), r=r[:1])
    assert roads(alone) == ["undecided"]


@pytest.mark.slow
def test_a_torus_that_breaks_down():
    """The delayed logistic map: an invariant circle from r = 2, chaos at 2.27 (Aronson et al., Comm. Math. Phys. 83, 1982)."""

    def delayed(r=2.1):
        return {"map": lambda s: (r * s[0] * (1.0 - s[1]), s[0]), "coordinates": ("x", "y")}

    r = np.array([1.9, 2.05, 2.1, 2.15, 2.2, 2.25, 2.27])
    data = jaxnh.Session(delayed, start={"x": 0.4, "y": 0.4}).run(jaxnh.Orbits(max_period=8, attractor=4096), r=r)
    assert roads(data)[:4] == ["regular", "undecided", "undecided", "undecided"]  # circles are no chaos
    # Locked to 1/7 at 2.2. At 2.27 motions come to 0.002 of the origin, on one side of x = 0, which goes there at once.
    assert roads(data)[4:] == ["regular", "torus breakdown", "undecided"]
    origin = data.isel(r=-1, orbit=np.abs(data["x"].isel(r=-1)).to_numpy().argmin())
    assert jaxnh.labels(origin["place"]).item() == "undecided"
    beyond = jaxnh.Session(delayed, start={"x": 0.4, "y": 0.4}).run(jaxnh.Orbits(max_period=8, attractor=4096), r=r[5:])
    assert roads(beyond) == ["undecided", "undecided"]


@pytest.mark.slow
def test_a_spiral_attractor():
    """Of a map in space with a saddle-focus at the origin: the roots of μ³ + 0.78885 μ² + 0.4174 μ = 0.5 are multipliers."""

    def spiral(a=-0.78885, b=0.5, c=-0.4174):
        return {
            "map": lambda s: (s[1], s[2], b * s[0] + c * s[1] + a * s[2] - s[2] ** 2),
            "coordinates": ("x", "y", "z"),
        }

    start = {"x": 0.001, "y": 0.001, "z": 0.001}
    data = jaxnh.Session(spiral, start=start).run(jaxnh.Orbits(max_period=1, attractor=32768), a=np.array([-0.78885]))
    assert roads(data) == ["spiral"]
    at = int(np.argmin(np.abs(data["x"].to_numpy()[0])))
    ours = np.sort_complex(data["multipliers"].to_numpy()[0, at] @ [1.0, 1.0j])
    assert np.abs(ours - np.sort_complex(np.roots([1.0, 0.78885, 0.4174, -0.5]))).max() < 1e-9


def roessler(c=5.7):
    def rhs(s, t):
        x, y, z = s
        return -y - z, x + 0.2 * y, 0.2 + z * (x - c)

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}


def langford(a=0.95):
    """Of Langford, Int. Ser. Numer. Math. 70 (1984) 285: a cycle sheds a torus, which an asymmetry breaks."""

    def rhs(s, t):
        x, y, z = s
        square = x**2 + y**2
        return (
            (z - 0.7) * x - 3.5 * y,
            3.5 * x + (z - 0.7) * y,
            0.6 + a * z - z**3 / 3.0 - square * (1.0 + 0.25 * z) + 0.1 * z * x**3,
        )

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}


@pytest.mark.slow
def test_roads_of_flows():
    """Doublings of Roessler's cycle, a torus that breaks, and Lorenz's attractor, which comes by neither.

    The least orbit in Lorenz's attractor turns about either equilibrium once, and its multiplier 4.7 (Viswanath 2003) is positive.
    """
    options = {"attractor": 2048, "max_period": 4, "rounds": 6}
    session = jaxnh.Session(roessler, start={"x": 5.0, "y": 0.0, "z": 0.1}, target=1e-7)
    section = session.on(coordinate="y", value=0.0, direction="up")
    data = section.run(jaxnh.Orbits(**options), c=np.array([2.5, 3.5, 4.0, 4.3, 5.0]))
    assert roads(data) == [*["regular"] * 3, "feigenbaum", "feigenbaum"]
    assert data["least_period"].to_numpy().tolist() == [1, 2, 4, 2, 1]
    assert carriers(data)[3:] == ["flip saddle"] * 2

    session = jaxnh.Session(langford, start={"x": 0.4, "y": 0.0, "z": 0.6}, target=1e-6)
    section = session.on(coordinate="y", value=0.0, direction="up")
    # The cycle is outside where it is four times further than any point from the next. Points in the thin parts of an
    # attractor are lonely where there are few: at 24 values from 0.98 on it is undecided at four of 4,096, none of 8,192.
    boxed = options | {"attractor": 8192, "n_starts": 4, "box": {"x": (0.1, 1.5), "z": (-0.5, 1.7)}}
    a = np.array([0.6, 0.7, 0.8, 0.9, 0.98, 1.0])
    data = section.run(jaxnh.Orbits(**boxed), a=a)
    kinds = jaxnh.labels(section.run(jaxnh.Verdict(), a=a)["kind"]).to_numpy().tolist()
    assert roads(data) == ["regular", "undecided", "undecided", "regular", *["torus breakdown"] * 2]
    assert (kinds[2], kinds[4:]) == ("quasiperiodic", ["chaotic"] * 2)

    session = jaxnh.Session(lorenz, start={"x": 1.0, "y": 1.0, "z": 20.0}, target=1e-7)
    section = session.on(coordinate="z", value=27.0, direction="down")
    data = section.run(jaxnh.Orbits(**options), rho=[28.0])
    assert (carriers(data), roads(data)) == (["saddle"], ["none of these"])
    assert data["least_period"].to_numpy().tolist() == [2]


def test_roads_of_charts():
    """Of two axes the second has the road; a window on the way is passed; a focus that was never stable tells nothing."""
    kinds = ["stable", "stable", "repelling", "stable", "repelling"]
    line = CarrierChart(
        np.array([1, 2, 1, 3, 1]), kinds, np.array([0, 0, 1, 0, 1], bool), np.zeros(5, bool), np.zeros(5, int)
    )
    two = CarrierChart(
        *(np.repeat(leaf, 2) if isinstance(leaf, np.ndarray) else np.repeat(leaf, 2).tolist() for leaf in line)
    )
    for chart, axes, times in ((line, [np.arange(5.0)], 1), (two, [np.arange(5.0), np.arange(2.0)], 2)):
        names = [SCENARIOS[k] for k in scenarios(chart, axes)]
        assert names == list(np.repeat(["regular", "regular", "feigenbaum", "regular", "feigenbaum"], times))
    focus = np.array([0, 1, 1, 1])
    for turns, name in ((True, "torus_breakdown"), (False, "undecided")):
        chart = CarrierChart(
            np.array([1, 0, 7, 6]),
            ["stable", "none", "stable", "saddle"],
            np.zeros(4, bool),
            np.arange(4) < turns,
            focus,
        )
        assert SCENARIOS[scenarios(chart, [np.arange(4.0)])[3]] == name
    kinds = ["unstable_focus_saddle", "saddle", "undecided", "discrete_lorenz"]
    zeros = np.zeros(4, int)
    chart = CarrierChart(zeros + 1, kinds, zeros.astype(bool), zeros.astype(bool), zeros)
    names = [SCENARIOS[k] for k in scenarios(chart, [np.arange(4.0)])]
    assert names == ["spiral", "none_of_these", "undecided", "discrete_lorenz"]


def test_not_asked_for():
    """Nothing of it is there by default."""
    data = jaxnh.Session(henon, start={"x": 0.1, "y": 0.1}).run(jaxnh.Orbits(max_period=1), a=np.array([1.4]))
    assert not {"distance", "place", "carrier", "scenario"} & set(data)
