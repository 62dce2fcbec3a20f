"""Tables of kicks: their sums, their capacity, what they leave out, and tables cut into parts."""

from __future__ import annotations

import numpy as np
import pytest
from measure import SYSTEMS, UNIT

from jaxnh.maps.build import cut_strobe, make_parts, make_strobe
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import constant_speed, disturbed_speed

systems = pytest.mark.parametrize("system", SYSTEMS.values(), ids=SYSTEMS)
splittings = pytest.mark.parametrize("solver", SPLITTINGS.values(), ids=SPLITTINGS)


@systems
@splittings
@pytest.mark.parametrize("steps", [7, 60])
def test_table_of_a_period(system, solver, steps):
    """As many kicks as the solver says, drifts that sum to the path of a period, and nothing in the rows not in use."""
    strobe = make_strobe(system, solver, steps)
    rows, used = np.asarray(strobe.table), int(strobe.kicks)
    assert used == solver.total_kicks(steps)
    assert rows.shape == (max(8192, 1 << (used - 1).bit_length()), 3)
    assert not np.any(rows[used:])
    path = system.path_length(np.linspace(0, system.period, 201)[:-1], np.linspace(0, system.period, 201)[1:]).sum()
    sums = np.abs(rows[:, 0]).sum() + abs(float(strobe.rest))
    assert abs(rows[:, 0].sum() + float(strobe.rest) - path) < used * UNIT * sums + 400 * UNIT * path
    assert strobe.turns == (used,)


@pytest.mark.parametrize("name", SPLITTINGS)
def test_no_disturbance_has_the_table_of_constant_speed(name):
    """d = 0 is another flow of the same kicks, bit for bit, for whole periods and for parts of them."""
    still, constant = disturbed_speed(d=0.0), constant_speed()
    for make in (
        lambda flow: make_strobe(flow, SPLITTINGS[name], 40),
        lambda flow: make_strobe(flow, SPLITTINGS[name], 40, span=(0.3, 2.0)),
        lambda flow: make_parts(flow, SPLITTINGS[name], 40, 4),
        lambda flow: cut_strobe(flow, SPLITTINGS[name], 40, 4),
    ):
        one, other = make(still), make(constant)
        for part in ("table", "kicks", "rest"):
            np.testing.assert_array_equal(getattr(one, part), getattr(other, part))


@systems
@pytest.mark.parametrize("name", ["blanes_moan6", "processed6"])
@pytest.mark.parametrize("parts", [1, 3, 7])
def test_cut_table_is_the_whole_one(system, name, parts):
    """All kicks in order, once; drifts between parts go to the next, or to the end of the one before."""
    solver, each = SPLITTINGS[name], 6
    whole, cut = make_strobe(system, solver, parts * each), cut_strobe(system, solver, parts * each, parts)
    assert np.asarray(cut.kicks).sum() == whole.kicks
    assert np.asarray(cut.table).shape[0] == parts
    rows = np.concatenate([table[:used] for table, used in zip(np.asarray(cut.table), cut.kicks, strict=True)])
    expected = np.asarray(whole.table)[: int(whole.kicks)]
    np.testing.assert_allclose(rows[:, 1:], expected[:, 1:], rtol=0, atol=4 * UNIT * np.abs(expected).max())
    # Where a part ends with a drift of its own, the next begins with the rest of what the whole table has in one row.
    drifts = rows[:, 0].copy()
    first = np.cumsum(cut.kicks)[:-1]
    drifts[first] += np.asarray(cut.rest)[:-1]
    np.testing.assert_allclose(drifts, expected[:, 0], rtol=0, atol=4 * UNIT * np.abs(expected).max())
    assert abs(float(np.asarray(cut.rest)[-1]) - float(whole.rest)) < 4 * UNIT
