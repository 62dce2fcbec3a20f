"""How much finer steps are for tangents than for states: no finer for a processed method, whose parts are another map's."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from jaxnh.analyses.exponents.orthonormalisation import parts_needed, refinement_needed
from jaxnh.analyses.exponents.period_parts import cut_period
from jaxnh.analyses.exponents.tangent_growth import average, begin
from jaxnh.solvers import SPLITTINGS, verner9
from jaxnh.systems.first_order import first_order
from jaxnh.systems.particle import constant_speed
from tests.helpers.batches import batch_of

START = ((0.1, 0.1), (0.1, float(np.sqrt(0.99))))
B = np.linspace(5.0, 6.0, 8)


def scene(solver, steps):
    """Lanes of the particle with steps that are said to meet a target of 1e-6."""
    return replace(batch_of(constant_speed(), START, B, SPLITTINGS[solver], steps), error_estimate=1e-6, target=1e-6)


def growth(lanes, batch, periods=3):
    """Growth a period of three tangents, from the same start, over a few periods."""
    state, p = batch.lanes
    tangents = lanes(begin, (batch.system,), (state,), static=(3,))
    return average(lanes, cut_period(batch, 16), tangents, p, periods)[1][:, :3]


def test_steps_of_a_processed_method_serve_tangents_too(lanes):
    """They were sixteen times as many; with as many as states need, tangents grow as by a method of order eight."""
    batch = scene("processed6", 108)
    parts, tangents = parts_needed(batch, lanes, 3)
    assert refinement_needed(batch, lanes, tangents, parts) == 1
    apart = np.abs(growth(lanes, batch) - growth(lanes, scene("kahan_li8", 120)))
    assert apart.max() < 1e-4


def test_coarse_steps_are_refined(lanes):
    """Where steps are so long that tangents are wrong, a processed method has more of them."""
    batch = scene("processed6", 18)
    parts, tangents = parts_needed(batch, lanes, 3)
    assert refinement_needed(batch, lanes, tangents, parts) > 1


def phases(pull=2.0):
    """Five phases that synchronise: x_i' = ω_i + (pull/5) Σ sin(x_j − x_i), with frequencies whose mean is zero."""

    def rhs(y, t):
        return tuple(w + 0.2 * pull * sum(jnp.sin(other - x) for other in y) for w, x in zip(OMEGA, y, strict=True))

    return {"rhs": rhs, "coordinates": tuple("abcde")}


OMEGA = (-1.0, -0.3, 0.1, 0.4, 0.8)


def test_lanes_at_rest_ask_for_no_finer_steps(lanes):
    """They come to rest at a rate above 1: within the 64 units looked at, rounding is all that is left of their speed."""
    flow = first_order(phases, {"pull": 2.0}, ("pull",))
    start = flow.start(dict(zip("abcde", (0.0, 0.4, 1.6, 3.6, 6.4), strict=True)))
    batch = batch_of(flow, start, [2.0, 3.0], verner9, 4, name="pull")
    batch = replace(batch, error_estimate=1e-8, target=1e-8)
    parts, tangents = parts_needed(batch, lanes, 3)
    assert refinement_needed(batch, lanes, tangents, parts) == 1
