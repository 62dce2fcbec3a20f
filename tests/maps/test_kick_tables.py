"""Tables of kicks: their sums, their capacity, what they leave out, and tables cut into parts."""

from __future__ import annotations

from unittest import mock

import numpy as np
import pytest

from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.maps import kick_tables
from jaxnh.maps.build import cut_strobe, make_parts, make_return_map, prepare_tables
from jaxnh.maps.family import GROUPS, ParameterFamily
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import constant_speed, disturbed_speed
from tests.flows.particle import SYSTEMS
from tests.helpers.measurement import UNIT

systems = pytest.mark.parametrize("system", SYSTEMS.values(), ids=SYSTEMS)
splittings = pytest.mark.parametrize("solver", SPLITTINGS.values(), ids=SPLITTINGS)


@systems
@splittings
@pytest.mark.parametrize("steps", [7, 60])
def test_table_of_a_period(system, solver, steps):
    """As many kicks as the solver says, drifts that sum to the path of a period, and nothing in the rows not in use."""
    strobe = make_return_map(system, solver, steps)
    rows, used = np.asarray(strobe.table), int(strobe.kicks)
    assert used == solver.total_kicks(steps)
    assert rows.shape == (max(8192, 1 << (used - 1).bit_length()), 3)
    assert not np.any(rows[used:])
    path = system.path_length(np.linspace(0, system.period, 201)[:-1], np.linspace(0, system.period, 201)[1:]).sum()
    sums = np.abs(rows[:, 0]).sum() + abs(float(strobe.rest))
    assert abs(rows[:, 0].sum() + float(strobe.rest) - path) < used * UNIT * sums + 400 * UNIT * path
    assert strobe.trip_counts == (used,)


@pytest.mark.parametrize("name", SPLITTINGS)
def test_no_disturbance_has_the_table_of_constant_speed(name):
    """d = 0 is another flow of the same kicks, bit for bit, for whole periods and for parts of them."""
    still, constant = disturbed_speed(d=0.0), constant_speed()
    for make in (
        lambda flow: make_return_map(flow, SPLITTINGS[name], 40),
        lambda flow: make_return_map(flow, SPLITTINGS[name], 40, span=(0.3, 2.0)),
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
    whole, cut = make_return_map(system, solver, parts * each), cut_strobe(system, solver, parts * each, parts)
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


@pytest.mark.parametrize("d", [0.0, 0.37])
def test_period_and_its_parts_have_one_table(d):
    """Made once for a clock, whatever the stiffness and coupling are, and not to be written to."""
    solver = SPLITTINGS["processed6"]
    with mock.patch.object(kick_tables, "_processed_tables", wraps=kick_tables._processed_tables) as made:
        for a in (0.5, 0.25):
            system = disturbed_speed(a=a, d=d, omega=2.0)
            whole, cut = make_return_map(system, solver, 84), cut_strobe(system, solver, 84, 1)
            np.testing.assert_array_equal(np.asarray(cut.table)[0], whole.table)
            make_return_map(disturbed_speed(a=a, d=d, omega=4.0), solver, 84)
    assert made.call_count == 2
    alone = kick_tables.processed_table(system, solver, 84, (0.0, system.period), smallest=8192)
    for part, found in zip(alone, (whole.table, whole.kicks, whole.rest), strict=True):
        np.testing.assert_array_equal(part, found)
    with pytest.raises(ValueError, match="read-only"):
        kick_tables.whole_period(system, solver, 84)[0][0, 0] = 1.0


@pytest.mark.parametrize("c", [1.0, 0.8])
def test_tables_of_many_values_are_those_made_alone(c):
    """Bit for bit, also without a disturbance, near a speed of zero, of several clocks at once, in more than a group."""
    solver, steps = SPLITTINGS["processed6"], 31
    values = [0.0, 1e-9, 0.1, 0.5, 0.97 * c, *np.linspace(0.2, 0.3, 9).tolist()]
    systems = [disturbed_speed(c=c, d=d, omega=omega) for omega in (0.5, 1.0, 3.0) for d in values]
    systems += [
        disturbed_speed(c=2.0 * c, d=0.1),
        constant_speed(c=c),
        disturbed_speed(c=c, d=0.1, without=("forcing",)),
    ]
    with mock.patch.object(kick_tables, "_TABLES", {}), mock.patch.object(kick_tables, "_TOGETHER", 8):
        together = kick_tables.whole_periods(systems, solver, steps)
    for system, tables in zip(systems, together, strict=True):
        alone = kick_tables.processed_table(system, solver, steps, (0.0, system.period))
        for one, other in zip(tables, alone, strict=True):
            np.testing.assert_array_equal(one, other)


def test_a_family_makes_its_tables_in_one_go():
    """Those of its stack, and those of values that are asked for one after the other; none is made a second time."""
    values = tuple((float(d),) for d in np.linspace(0.11, 0.19, 5))
    systems, solver = {value: disturbed_speed(d=value[0]) for value in values}, SPLITTINGS["processed6"]
    with mock.patch.object(kick_tables, "_processed_tables", wraps=kick_tables._processed_tables) as made:
        for together in (values, ()):
            family = ParameterFamily(("d",), systems.__getitem__, together)
            maps = family.maps(
                systems[values[0]],
                "period",
                lambda system: make_return_map(system, solver, 23),
                lambda trees: prepare_tables(trees, solver, 23),
            )
            if together:
                assert maps.stack.trees.table.shape[0] == GROUPS
            else:
                LaneExecutor()(_kicks, (maps,), ({"b": np.ones(5), "d": np.array([value[0] for value in values])},))
    assert made.call_count == 1


def _kicks(strobe, p):
    return strobe.kicks
