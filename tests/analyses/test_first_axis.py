"""What goes along a first axis that all lanes share, against the Taylor reference: doublings, and carried states."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.engine.experiment import Experiment
from tests.helpers import taylor
from tests.helpers.kept_programs import session_of
from tests.helpers.measurement import largest_difference

NAMES = ("x1", "x2", "y1", "y2")


def sweep(system, name, values, accuracy):
    content = {
        "system": system,
        "sweep": {name: {"values": values}},
        "accuracy": accuracy,
        "analyses": {"portrait": {}},
    }
    return session_of(Experiment.from_dict(content))


@pytest.mark.slow
def test_doubling_along_a_shared_parameter():
    """Along d at b = 5.6; at this d the reference finds it along b. A change of d moves it by less than ten times in b."""
    system = {"constraint": "disturbed_speed", "b": 5.6}
    values = np.linspace(0.02, 0.04, 6).tolist()
    group = sweep(system, "d", values, {"target": 1e-8}).run("doubling", {"levels": 1})
    d, error = float(group["d"][0]), float(group["d_error"][0])
    assert values[0] < d < values[-1]
    assert error < 1e-9
    par = taylor.Parameters(d=d)
    start = taylor.attractor(par, 5.62, par.start(), 400)[0]  # before the doubling: it comes as b falls
    b = taylor.doubling_point(par, 1, 5.6, taylor.periodic_orbit(par, 1, 5.6, start[None])[0])[0]
    assert abs(float(b) - 5.6) < 10 * error


@pytest.mark.parametrize("name", [pytest.param("omega", marks=pytest.mark.slow), "c"])
def test_state_carried_along_a_shared_parameter(name):
    """The last state at a value is the first at the next one, and each value has its own clock and speed."""
    values = [1.1, 0.9, 1.3]  # b = 2.5 attracts; one period has an error of 1e-8 and three add up
    system = {"constraint": "constant_speed", "b": 2.5}
    session = sweep(system, name, values, {"target": 1e-8})
    group = session.run("diagram", {"transient": 1, "strobes": 2, "start": "up"})
    x1, x2, y1, y2 = (group[key].to_numpy() for key in NAMES)
    ours = np.stack([x1, y1, np.arctan2(y2, x2)], axis=-1)
    state = taylor.Parameters(**({"c": values[0]} if name == "c" else {})).start()[None]
    for k in np.argsort(values):
        par = taylor.Parameters(**{name: values[k]})
        for strobe in range(2):
            state = taylor.strobe(par, 2.5, state)
            assert largest_difference(ours[k, strobe][None], state).max() < 1e-6
