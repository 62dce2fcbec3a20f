"""The paper's particle as several tests have it: systems, their twins in the Taylor reference, and lanes."""

from __future__ import annotations

import numpy as np

from jaxnh.systems.particle import constant_speed, disturbed_speed
from tests.helpers import taylor

SYSTEMS = {
    "constant": constant_speed(),
    "disturbed": disturbed_speed(),
    "other": disturbed_speed(a=0.3, c=1.7, d=0.2, omega=1.5),
}
LANES = 16
B = np.linspace(0.2, 2.4, LANES)
STATES = np.random.default_rng(3).uniform([-1, -1, -3], [1, 1, 3], (LANES, 3))


def twin(system):
    """The parameters of the same system in the Taylor reference."""
    return taylor.Parameters(system.a, system.c, system.d, system.omega)
