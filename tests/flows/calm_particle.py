"""The paper's particle where errors are small and known: slow, near the origin, and on lanes of its own."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.maps.iterate import section_map
from jaxnh.systems.particle import CHART, constant_speed, disturbed_speed
from tests.flows.known_flow import KnownFlow
from tests.flows.particle import LANES, STATES, twin
from tests.helpers import taylor

CALM = {"constant": constant_speed(c=0.1), "disturbed": disturbed_speed(c=0.1, d=0.03)}
"""Slow particles near the origin, with CALM_B and CALM_STATES: the error of a method of order ten already falls by its
law well above the rounding floor, and the flow of a period hardly enlarges roundings."""
CALM_B = np.linspace(0.1, 0.5, LANES)
CALM_STATES = STATES * [0.2, 0.2, 1]
# Roundings of some 2000 kicks add up at random to 1e-14, and the calm flow enlarges them up to ten times: with ten
# times that to spare,
ROUNDOFF = 1e-12
P = {"b": CALM_B}
systems = pytest.mark.parametrize("system", CALM.values(), ids=CALM)


def image(lanes, strobe, n=1):
    """Pⁿ of the calm lanes."""
    return lanes(section_map, (strobe, np.int32(n)), (CALM_STATES, P))


def start_states():
    """The states of the calm lanes, components (lanes,)."""
    return jax.tree.map(np.asarray, jax.vmap(CHART.state)(jnp.asarray(CALM_STATES)))


def one_lane():
    """The state and parameters of the first of them."""
    return CHART.state(jnp.asarray(CALM_STATES[0])), {"b": jnp.asarray(CALM_B[0])}


def known_flow(name):
    """The calm lanes, by the Taylor reference."""
    system = CALM[name]
    exact = taylor.strobe(twin(system), CALM_B, CALM_STATES)
    return KnownFlow(system, start_states(), exact, CHART.host_points, P, 600, ROUNDOFF, CHART.wrap)
