"""Iterates of a map, their records and their derivatives, by identities."""

from __future__ import annotations

import jax
import numpy as np

from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import derivatives, iterate
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import CHART
from tests.flows.calm_particle import CALM, CALM_B, CALM_STATES, ROUNDOFF, P, image, start_states
from tests.flows.particle import SYSTEMS
from tests.helpers.convergence import size
from tests.helpers.measurement import largest_difference


def test_iterates_add_up(lanes):
    """Pⁿ is P n times, bit for bit: n is data of one program, and the clock starts anew each period."""
    strobe = make_return_map(SYSTEMS["disturbed"], SPLITTINGS["blanes_moan6"], 50)
    state = start_states()
    five = lanes(iterate, (strobe, np.int32(5)), (state, {"b": CALM_B + 5}))
    for n in (1, 3, 0, 1):
        state = lanes(iterate, (strobe, np.int32(n)), (state, {"b": CALM_B + 5}))
    for one, other in zip(jax.tree.leaves(five), jax.tree.leaves(state), strict=True):
        np.testing.assert_array_equal(one, other)


def test_record_is_every_iterate(lanes, monkeypatch):
    """The states after 1, 2, 3 periods, to the rounding of another program; the same bits in calls of two periods."""
    strobe = make_return_map(CALM["constant"], SPLITTINGS["blanes_moan6"], 100)
    states = lanes.record(strobe, 3, (start_states(), P))
    recorded = np.asarray(jax.vmap(jax.vmap(CHART.point))(states))
    for n in (1, 2, 3):
        assert (
            np.max(largest_difference(recorded[:, n - 1], image(lanes, strobe, n))) < 10**n * ROUNDOFF
        )  # the flow of n periods
    monkeypatch.setattr("jaxnh.engine.executor.lanes._ROOM", 2)
    jax.tree.map(np.testing.assert_array_equal, lanes.record(strobe, 3, (start_states(), P)), states)


def test_derivatives_over_periods_by_the_chain_rule(lanes):
    """M of P² is the product of two monodromy matrices, and ∂P²/∂b = M ∂P/∂b + ∂P/∂b at the image."""
    strobe = make_return_map(CALM["disturbed"], SPLITTINGS["blanes_moan6"], 100)
    u, first, slope = lanes(derivatives, (strobe, np.int32(1)), (CALM_STATES, P), static=("b",), tile=16)
    end, second, second_slope = lanes(derivatives, (strobe, np.int32(1)), (u, P), static=("b",), tile=16)
    both = lanes(derivatives, (strobe, np.int32(2)), (CALM_STATES, P), static=("b",), tile=16)
    product = second @ first
    chained = np.einsum("lij,lj->li", second, slope) + second_slope
    largest = 3 * size(second, second_slope) * np.maximum(size(first, slope), 1)
    assert np.max(largest_difference(both[0], end)) < ROUNDOFF
    assert np.max(np.abs(both[1] - product).max(axis=(1, 2)) / largest) < ROUNDOFF
    assert np.max(np.abs(both[2] - chained).max(axis=1) / largest) < ROUNDOFF
