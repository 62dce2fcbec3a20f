"""Lanes at several values of what lanes share, in one program: the bits that each has under a map of its own."""

from __future__ import annotations

import math
from unittest import mock

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxnh.analyses.batch import LaneBatch
from jaxnh.analyses.registry import ANALYSES
from jaxnh.engine.accuracy.calibration import Plan
from jaxnh.engine.batches import batches
from jaxnh.engine.compute import compute
from jaxnh.engine.executor.grouped_blocks import group_into_blocks
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.plan import job_of
from jaxnh.jobs.cutting import slab
from jaxnh.maps.family import ParameterFamily, stack
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import disturbed_speed
from tests.helpers.batches import batch_of
from tests.helpers.kept_programs import lanes_with_kept_programs

pytestmark = pytest.mark.usefixtures("uncalibrated")
START = ((0.1, 0.1), (0.1, math.sqrt(0.99)))
SOLVER, STEPS = SPLITTINGS["blanes_moan6"], 40


@given(st.lists(st.integers(0, 4), min_size=1, max_size=200), st.sampled_from([16, 64, 256]))
def test_blocks_hold_every_lane(rows, tile):
    """Each block has lanes of one group, and each lane has its place."""
    number = np.arange(len(rows))
    blocks = group_into_blocks(np.array(rows), (number, {"b": 0.5 * number}), tile)
    lane, p = blocks.lanes
    block, size = (16, 64) if tile <= 64 else (32, 256)
    assert lane.shape == (sum(-(-rows.count(row) // block) for row in set(rows)), block)
    assert blocks.a_tile * block == size
    assert np.all(np.array(rows)[lane] == blocks.groups[:, None])
    assert np.array_equal(lane.ravel()[blocks.back], number)
    assert np.array_equal(p["b"], 0.5 * lane)


def test_trees_that_do_not_fit():
    """Whole numbers, as of kicks, have to be the same in all trees."""
    with pytest.raises(ValueError, match="whole number"):
        stack([(np.float64(1.0), np.int32(2)), (np.float64(1.5), np.int32(3))])


BORN = 5.351778
"""Where, at d = 0.2, this map's orbit of period 8 is born."""
D, CUTS = (0.05, 0.2, 0.3), (0, 30, 37, 60)
OPTIONS = {
    "lyapunov": {"transient": 16, "periods": 32},
    "period": {"transient": 64, "max_period": 8},
}


@pytest.mark.slow  # in small: test_tiles_of_several_rows
def test_bits_are_those_of_each_value_alone():
    """Over orbits of many periods and chaos, all exponents with their sum rule, rows of unlike numbers of lanes.

    Those of the second row lie just beyond a doubling, where orbits are found by a program of their own.
    """
    lanes, b = lanes_with_kept_programs(), np.linspace(4.4, 5.7, CUTS[-1])
    b[CUTS[1] : CUTS[2]] = BORN + 4e-7 * np.arange(1, 8)
    chosen = {"chosen": {"lyapunov": {"parts": 16}}}
    flows = [disturbed_speed(d=d) for d in D]
    alone = [
        batch_of(flow, START, b[first:last], SOLVER, STEPS, **chosen)
        for flow, first, last in zip(flows, CUTS[:-1], CUTS[1:], strict=True)
    ]
    start = jax.tree.map(lambda *leaves: np.concatenate(leaves), *(one.start for one in alone))
    family = ParameterFamily(("d",), lambda values: disturbed_speed(d=values[0]), tuple((d,) for d in D))
    d = np.repeat(D, np.diff(CUTS))
    order = np.random.default_rng(0).permutation(len(b))  # lanes of a row need not be neighbours
    together = LaneBatch(flows[0], start, {"b": b, "d": d}, SOLVER, STEPS, False, 0.0, family=family, **chosen)
    together = together.take(order)
    assert {name for name, analysis in ANALYSES.items() if analysis.stackable} == set(OPTIONS)
    for name, said in OPTIONS.items():
        analysis = ANALYSES[name]
        options = analysis.options(**said)
        ours = analysis.run(options, together, lanes).isel(lane=np.argsort(order))
        for k, one in enumerate(alone):
            part = ours.isel(lane=slice(CUTS[k], CUTS[k + 1]))
            for variable, item in analysis.run(options, one, lanes).variables.items():
                assert part[variable].to_numpy().tobytes() == item.to_numpy().tobytes(), (name, variable, D[k])
    found = ours["period"].to_numpy()  # of period, the last
    born = ours["multiplier"].to_numpy()[CUTS[1] : CUTS[2]]
    assert np.any((found[CUTS[1] : CUTS[2]] == 8) & (np.abs(born - 1.0) < 1e-3))
    assert len(np.unique(found)) >= 3
    assert np.any(found == 0)


def rows_of_batches(sweep, analyses, devices=2, **system):
    """Of each batch of a sweep, at how many values of the second axis its tiles are."""
    content = {
        "system": {"constraint": "disturbed_speed", **system},
        "sweep": sweep,
        "accuracy": {"solver": "blanes_moan6", "steps": 40},
        "analyses": analyses,
    }
    experiment = Experiment.from_dict(content)
    requested, axes = experiment.requested(), experiment.axes
    lanes = LaneExecutor(devices=jax.devices("cpu")[:1] * devices)
    job = job_of(experiment, axes, Plan(SOLVER, STEPS, False, 1e-6), {}, requested, {}, on_card=lanes.on_card)
    found = batches(experiment, axes, requested, job, job.cutting.pieces(), lanes)
    return [len({piece.begin[1] for piece in batch}) for batch in found]


B = {"start": 5.2, "stop": 5.6, "count": 256}
QUICK = {"lyapunov": {"exponents": 1}, "period": {}}


def test_what_is_computed_together():
    """Values of d, in eight batches for two devices; of ω those with one period; and none with what is not in tables."""
    d = {"start": 0.1, "stop": 0.2, "count": 16}
    assert rows_of_batches({"b": B, "d": d}, QUICK) == [2] * 8
    assert rows_of_batches({"b": B, "d": d}, {**QUICK, "poincare": {}}) == [1] * 16
    omega = {"values": [0.5, *(1.0 + k for k in range(15))]}  # periods 4π, then 2π
    assert rows_of_batches({"b": B, "omega": omega}, QUICK) == [1, *[2] * 7, 1]


def test_what_a_card_computes_together():
    """Two batches of eight tiles, of all values that lanes share: a call takes no longer for all of them."""
    d = {"start": 0.1, "stop": 0.2, "count": 64}
    with mock.patch.object(LaneExecutor, "on_card", property(lambda self: True)):
        assert rows_of_batches({"b": B, "d": d}, QUICK, devices=1) == [8] * 2


@pytest.mark.slow  # pieces computed together, and files in parts over two axes, are quick
@pytest.mark.parametrize("tile", [45, 100])
def test_tiles_of_several_rows(tile):
    """The bits of tiles of one value of d each, wherever a tile ends; an axis of periods that differ has no such tiles."""
    options = {
        "lyapunov": {"transient": 16, "periods": 16, "exponents": 1},
        "period": {"transient": 16, "max_period": 4},
    }
    content = {"system": {"constraint": "disturbed_speed"}, "accuracy": {"solver": "blanes_moan6", "steps": 40}}
    sweep = {"b": {"start": 5.2, "stop": 5.6, "count": 20}, "d": {"start": 0.1, "stop": 0.2, "count": 5}}
    experiment = Experiment.from_dict({**content, "sweep": sweep, "analyses": options})
    requested, axes, lanes = experiment.requested(), experiment.axes, lanes_with_kept_programs(tile=64)
    plan = Plan(SOLVER, STEPS, False, 1e-6)
    found = []
    for lanes_of_tile in (20, tile):
        job = job_of(experiment, axes, plan, {"lyapunov": {"parts": 1}}, requested, {}, lanes_of_tile)
        assert job.cutting.pieces()[0].shape == (20, lanes_of_tile // 20)
        whole = {}
        for piece in job.cutting.pieces():
            [done] = compute(experiment, axes, requested, job, [piece], lanes, None)
            for name, group in done.groups.items():
                for variable, item in group.data_vars.items():
                    dims = tuple(map(str, item.dims))
                    assert dims[:2] == ("b", "d")
                    values = whole.setdefault((name, variable), np.zeros((20, 5, *item.shape[2:]), item.dtype))
                    values[slab(dims, piece, ("b", "d"))] = item.values
        found.append({key: values.tobytes() for key, values in whole.items()})
    assert found[0] == found[1]
    sweep["omega"] = {"values": [1.0, 2.0, 0.5]}
    unlike = Experiment.from_dict({**content, "sweep": {k: sweep[k] for k in ("b", "omega")}, "analyses": options})
    assert job_of(unlike, unlike.axes, plan, {}, unlike.requested(), {}, 100).cutting.shared_values == 1
