"""The strobe map on calm systems, where errors are small and known: lanes, images, derivatives against the reference."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import taylor
from measure import CALM, CALM_B, CALM_STATES, apart, twin

from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import derivatives, section_map
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import CHART

# Roundings of some 2000 kicks add up at random to 1e-14, and the calm flow enlarges them up to ten times: with ten
# times that to spare,
ROUNDOFF = 1e-12
FINEST = max(SPLITTINGS.values(), key=lambda solver: solver.convergence_order)
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


def check_convergence(lanes, system, solver):
    """With twice the steps a method of order p has 2⁻ᵖ of the error; twice that is left for the terms that follow.

    Errors are geometric means over lanes, as some lanes are late to follow the law and others cross zero.
    """
    steps = 600 // solver.stages
    coarse, fine = (image(lanes, make_return_map(system, solver, n)) for n in (steps, 2 * steps))
    moved = math.exp(np.log(apart(fine, coarse)).mean())
    error = math.exp(np.log(apart(fine, taylor.strobe(twin(system), CALM_B, CALM_STATES))).mean())
    assert moved > 10 * ROUNDOFF
    assert error < moved * 2.0 ** (1 - solver.convergence_order) + ROUNDOFF


def check_derivatives(lanes, strobe, system, error):
    """Against the derivatives of the reference, to the error of the map; those of M and of the slope relative to it."""
    u, monodromy, slope = lanes(derivatives, (strobe, np.int32(1)), (CALM_STATES, P), static=("b",))
    exact, exact_monodromy, exact_slope = taylor.strobe_jacobian(twin(system), CALM_B, CALM_STATES)
    assert np.max(apart(u, exact)) < error
    gaps = derivatives_apart((monodromy, slope), (exact_monodromy, exact_slope))
    assert np.max(np.abs(gaps).max(axis=1) / size(exact_monodromy, exact_slope)) < error


def derivatives_apart(one, other):
    """Differences of monodromy matrices and slopes, all numbers of a lane in a row: (lanes, 12)."""
    return np.concatenate([(a - b).astype(float).reshape(len(a), -1) for a, b in zip(one, other, strict=True)], axis=1)


def size(monodromy, slope):
    """Largest derivative of each lane."""
    return np.maximum(np.abs(monodromy).max(axis=(1, 2)), np.abs(slope).max(axis=1))
