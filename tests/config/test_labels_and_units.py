"""Words and units of a user's file in results and pictures; what it does not say is not called dimensionless."""

from __future__ import annotations

import pytest

import jaxnh
from jaxnh.exceptions import ConfigError

FILE = """import jax.numpy as jnp
def system(drive=0.5, k=1.0):
    T = lambda q, v, t: 0.5 * v[0] ** 2
    Q = lambda q, v, t: -k * jnp.sin(q[0]) + drive * jnp.cos(t)
    return dict(T=T, Q=(lambda q, v, t: Q(q, v, t)), coordinates="theta", angles="theta", period=2 * jnp.pi,
                labels={"drive": "torque", "theta": "angle of the arm"}, units={"drive": "N m", "theta_dot": "rad/s"})
"""
pytestmark = pytest.mark.usefixtures("uncalibrated")
CONFIG = {
    "system": {"file": "own.py"},
    "sweep": {"drive": {"values": [0.1, 0.2]}, "k": {"values": [1.0]}},
    "accuracy": {"solver": "dopri8", "steps": 40},
    "analyses": {"poincare": {"transient": 0, "strobes": 2}},
}


def test_labels_and_units(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(FILE)
    tree = jaxnh.run(jaxnh.Experiment.from_dict(CONFIG))
    found = {
        name: (v.attrs["long_name"], v.attrs.get("units"))
        for name, v in tree["poincare"].to_dataset().variables.items()
    }
    assert found["drive"] == ("torque drive", "N m")
    assert found["theta"] == ("angle of the arm theta", "rad")
    assert found["theta_dot"] == ("velocity theta_dot = dtheta/dt", "rad/s")
    assert found["k"] == ("parameter k", None)
    assert found["t"] == ("time since the start", None)
    ax = jaxnh.figure(tree).axes[0]
    assert ax.get_xlabel() == r"angle of the arm $\theta$ (rad)"
    assert ax.get_ylabel() == r"velocity $\dot{\theta}$ (rad/s)"


PLANE = """def system(rate=1.0):
    return dict(rhs=lambda y, t: (y[1], y[0] - y[0] ** 3 - rate * y[1]), coordinates=("x", "v"), units={"x": "m"%s})
"""


@pytest.mark.parametrize(("more", "time"), [("", None), (', "t": "s"', "s")])
def test_units_of_attractors_and_of_time(tmp_path, more, time):
    """Points of attractors, random starts and times are in the user's units, or in none that anybody has said."""
    (tmp_path / "own.py").write_text(PLANE % more)
    box = {"x": [-1.0, 1.0], "v": [-1.0, 1.0]}
    config = {
        "system": {"file": str(tmp_path / "own.py")},
        "sweep": {"rate": {"values": [1.0]}},
        "accuracy": {"solver": "dopri8", "steps": 10},
        "analyses": {"portrait": {"periods": 1, "samples": 2}, "basins": {"n_starts": 4, "seed": 1, "box": box}},
    }
    tree = jaxnh.run(jaxnh.Experiment.from_dict(config))
    assert tree["portrait"]["t"].attrs.get("units") == time
    for group, names in (("basins", ("x", "v")), ("attractors", ("x", "v")), ("attractors", ("x_points", "v_points"))):
        assert [tree[group][name].attrs.get("units") for name in names] == ["m", None]


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (
            ('{"drive": "torque"', '{"drove": "torque"'),
            "own.py:2: labels names 'drove', which is no parameter, coordinate or",
        ),
        (('labels={"drive": "torque"', 'labels={"t": "time"'), "own.py:2: labels names 't', which is no parameter"),
        (('units={"drive": "N m"', 'units={"drive": 1'), "own.py:2: units must be words by name, as in units={"),
        (('{"drive": "N m", "theta_dot": "rad/s"}', '"m"'), "own.py:2: units must be words by name, as in units={"),
    ],
)
def test_faults(tmp_path, monkeypatch, edit, message):
    assert edit[0] in FILE
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(FILE.replace(*edit))
    with pytest.raises(ConfigError) as caught:
        jaxnh.Experiment.from_dict(CONFIG)
    assert str(caught.value).startswith(message)
