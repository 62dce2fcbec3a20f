"""How much finer steps are for tangents than for states: no finer for a processed method, whose parts are another map's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxnh.analyses.exponents.orthonormalisation import parts_needed, refinement_needed
from jaxnh.analyses.exponents.period_parts import cut_period
from jaxnh.analyses.exponents.tangent_growth import average, begin
from jaxnh.solvers import SPLITTINGS
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
