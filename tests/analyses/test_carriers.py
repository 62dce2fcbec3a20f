"""Orbits inside attractors and outside: bands of the logistic map, Hénon's map, a discrete Lorenz attractor."""

from __future__ import annotations

import numpy as np

import jaxnh


def carriers(data):
    return jaxnh.labels(data["carrier"]).to_numpy().ravel().tolist()


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
    data = jaxnh.Session(henon, start={"x": 0.1, "y": 0.1}).run(
        jaxnh.Orbits(max_period=2, attractor=4096), a=np.array([1.4])
    )
    assert carriers(data) == ["flip saddle"]
    assert data["least_unstable"].to_numpy().tolist() == [1]
    assert places(data, 0) == ["outside", "inside", "inside"]  # the fixed point on the other side is on the boundary


def test_a_discrete_lorenz_attractor():
    """Its saddle is the fixed point x = M2 + B − 1, with the roots of μ³ + 2 x μ² = M2 μ + B as multipliers."""
    session = jaxnh.Session(henon_in_space, start={"x": 0.1, "y": 0.1})
    data = session.run(jaxnh.Orbits(max_period=1, attractor=8192), m2=np.array([0.815]))
    assert carriers(data) == ["discrete lorenz"]
    assert data["least_period"].to_numpy().tolist() == [1]
    assert places(data, 0) == ["outside", "inside"]  # the other one is 0
    at = int(np.argmax(data["x"].to_numpy()[0]))
    exact = np.roots([1.0, 2.0 * 0.515, -0.815, -0.7])
    assert np.abs(np.sort(data["multipliers"].to_numpy()[0, at, :, 0]) - np.sort(exact.real)).max() < 1e-9


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


def test_not_asked_for():
    """Nothing of it is there by default."""
    data = jaxnh.Session(henon, start={"x": 0.1, "y": 0.1}).run(jaxnh.Orbits(max_period=1), a=np.array([1.4]))
    assert not {"distance", "place", "carrier"} & set(data)
