"""Lanes: the same bits however many there are and wherever they run, and nothing of one lane in another."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.analyses.batch import Link, keep_all
from jaxnh.engine import xla_options
from jaxnh.engine.executor import lanes as executor
from jaxnh.engine.executor.lanes import TILE, LaneExecutor
from jaxnh.maps.build import make_return_map
from jaxnh.maps.family import MapFamily
from jaxnh.maps.iterate import derivatives, iterate
from jaxnh.solvers import SPLITTINGS, tsit5
from jaxnh.systems.first_order import first_order
from tests.flows.particle import SYSTEMS
from tests.helpers.comparisons import same_leaves
from tests.helpers.paths import ROOT

MANY = 1000
STATE = (np.full(MANY, 0.1), np.full(MANY, 0.1)), (np.full(MANY, 0.1), np.full(MANY, math.sqrt(0.99)))
CHAOTIC = {"b": np.linspace(5.2, 5.45, MANY)}  # below the accumulation of doublings of table 1
PERIODS = 200
COUNTS = [1, TILE + 44, 2 * TILE + 1, *(pytest.param(n, marks=pytest.mark.slow) for n in (7, TILE, MANY))]


def strobe():
    return make_return_map(SYSTEMS["constant"], SPLITTINGS["blanes_moan6"], 80)


def lane(k, tree):
    """A slice of the lanes."""
    return jax.tree.map(lambda leaf: leaf[k], tree)


@pytest.fixture(scope="module")
def runners():
    """One runner a number of devices, so that equal programs are compiled once."""
    return {count: LaneExecutor(devices=jax.devices("cpu")[:count]) for count in (1, 2)}


@pytest.fixture(scope="module")
def chaos(runners):
    """The states of all lanes after many periods, on two devices."""
    return runners[2](iterate, (strobe(), np.int32(PERIODS)), (STATE, CHAOTIC))


def test_lanes_are_chaotic(runners, chaos):
    """What the tests here rest on: a change in the last bit of b alone has long become as large as the attractor."""
    nudged = runners[2](iterate, (strobe(), np.int32(PERIODS)), (STATE, {"b": np.nextafter(CHAOTIC["b"], 6)}))
    assert np.median(np.abs(nudged[0][0] - chaos[0][0])) > 0.01


@pytest.mark.parametrize("devices", [1, 2])
@pytest.mark.parametrize("count", COUNTS)
def test_same_bits_for_any_number_of_lanes_and_devices(runners, chaos, count, devices):
    """Chaos would blow a single bit up; the last lanes are asked for as well as the first, at other places of a tile."""
    for part in (slice(0, count), slice(MANY - count, MANY)):
        few = runners[devices](iterate, (strobe(), np.int32(PERIODS)), lane(part, (STATE, CHAOTIC)))
        same_leaves(few, lane(part, chaos))


@pytest.mark.parametrize("count", [pytest.param(1, marks=pytest.mark.slow), 300])
def test_same_bits_of_derivatives(runners, count):
    """Of another program with more outputs, and tiles of another size."""
    u = np.random.default_rng(4).uniform(-1, 1, (MANY, 3))
    shared = strobe(), np.int32(5)
    one, two = (
        runners[n](derivatives, shared, lane(slice(0, count), (u, CHAOTIC)), tile=64, static=("b",)) for n in (1, 2)
    )
    same_leaves(one, two)
    same_leaves(one, lane(slice(0, count), runners[2](derivatives, shared, (u, CHAOTIC), tile=64, static=("b",))))


def test_same_bits_in_any_order(runners, chaos):
    """A lane does not depend on its place, nor on its neighbours."""
    order = np.random.default_rng(6).permutation(MANY)
    shuffled = runners[2](iterate, (strobe(), np.int32(PERIODS)), lane(order, (STATE, CHAOTIC)))
    same_leaves(shuffled, lane(order, chaos))


@pytest.mark.parametrize("bad", [0, 5, TILE - 1, 699])
def test_lane_that_is_not_a_number(runners, bad):
    """Its results are not numbers, and those of all other lanes are the same bits; as the last lane it pads a tile."""
    count = 700
    state, p = lane(slice(0, count), (STATE, CHAOTIC))
    good = runners[2](iterate, (strobe(), np.int32(3)), (state, p))
    b = p["b"].copy()
    b[bad] = math.nan
    result = runners[2](iterate, (strobe(), np.int32(3)), (state, {"b": b}))
    others = np.arange(count) != bad
    same_leaves(lane(others, result), lane(others, good))
    assert all(math.isnan(leaf[bad]) for leaf in jax.tree.leaves(result))


# ---- the call itself, on a function that is easy to know


def _polynomial(shared, x, pair, power):
    return {"power": shared * x**power, "sum": pair[0] + jnp.sum(pair[1])}


@pytest.mark.parametrize("count", [1, 7, 300])
@pytest.mark.parametrize("tile", [None, 1, 4])
def test_results_are_those_of_a_loop(runners, count, tile):
    """Every lane once, in order, pytrees in and out, whole numbers exactly; padding leaves no trace."""
    x, pair = np.arange(count) + 1.0, (np.arange(count) % 3, np.arange(5 * count).reshape(count, 5))
    result = runners[2](_polynomial, (np.float64(2.0),), (x, pair), tile=tile, static=(3,))
    assert set(result) == {"power", "sum"}
    np.testing.assert_array_equal(result["power"], 2.0 * x**3)
    np.testing.assert_array_equal(result["sum"], pair[0] + pair[1].sum(axis=1))
    assert all(isinstance(leaf, np.ndarray) and len(leaf) == count for leaf in result.values())


def test_static_arguments_are_part_of_the_program(runners):
    x = np.arange(4.0)
    for power in (2, 3, 2):
        pair = (np.zeros(4, int), np.zeros((4, 1), int))
        result = runners[1](_polynomial, (np.float64(1.0),), (x, pair), static=(power,))
        np.testing.assert_array_equal(result["power"], x**power)


@pytest.mark.parametrize("devices", [1, 2])
@pytest.mark.parametrize("longest", [10**6, 7, 2])
def test_chain_is_its_functions_one_after_the_other(runners, devices, longest):
    """To the bit, in one call and cut into several, with a family too; only what is kept comes to the host."""
    state, p = lane(slice(0, 300), (STATE, CHAOTIC))
    values = ((1.0,), (2.0,))
    together, apart = (
        MapFamily(strobe().system, ("copy",), lambda value: strobe(), values_of_stack)
        for values_of_stack in (values, ())
    )
    copies = {**p, "copy": np.arange(300) % 2 + 1.0}
    for maps, own in ((strobe(), p), (together, copies), (apart, copies)):
        link = Link(iterate, (maps, np.int32(3)), periods=3, keep=lambda state: (state, state[0]))
        few, expected = runners[devices], [state]
        for _ in range(3):
            expected.append(few(iterate, (maps, np.int32(3)), (expected[-1], own)))
        with mock.patch.object(executor, "_LONGEST", longest * TILE):
            positions = few.chain([link, link, link._replace(keep=keep_all)], (state, own))
        same_leaves(positions[2], expected[3])
        same_leaves(positions[:2], [state[0] for state in expected[1:3]])


def test_observed_states_are_those_recorded(runners):
    """More of them than go into one call, and the last state; none has none."""
    state, p = lane(slice(0, 20), (STATE, CHAOTIC))
    for count in (0, 1, 5, 130):
        states = runners[1].record(strobe(), count, (state, p))
        seen, end = runners[1].observe(strobe(), count, (state, p), _first_of, (np.float64(2.0),))
        np.testing.assert_array_equal(seen, 2.0 * states[0][0])
        if count:
            same_leaves(end, lane((slice(None), -1), states))


def _first_of(factor, state):
    return factor * state[0][0]


class Recorder:
    """Progress that remembers."""

    def __init__(self):
        self.said = []

    def start(self, label, total):
        self.said.append((label, total))

    def advance(self, amount):
        self.said.append(amount)

    def finish(self):
        self.said.append("end")


def _double(x):
    return 2 * x


def test_accounts():
    """Lane-periods are those of the lanes asked for, not of the padding; a program is compiled once for all calls."""
    recorder = Recorder()
    lanes = LaneExecutor(recorder, devices=jax.devices("cpu")[:2], tile=8)
    with lanes.stage("doubling numbers", 40 * 3):
        lanes(_double, (), (np.arange(40.0),), periods=3)
    assert recorder.said == [("doubling numbers", 120), *[24] * 5, "end"]
    assert lanes.accounts.lane_periods == 120
    compiled, ran = lanes.accounts.compile_seconds, lanes.accounts.run_seconds
    assert compiled > 0
    lanes(_double, (), (np.arange(10.0),), periods=2)
    assert lanes.accounts.lane_periods == 140
    assert lanes.accounts.compile_seconds == compiled
    assert lanes.accounts.run_seconds > ran


def test_stage_ends_when_something_fails():
    recorder = Recorder()
    lanes = LaneExecutor(recorder)
    with pytest.raises(ZeroDivisionError), lanes.stage("failing", 1):
        raise ZeroDivisionError
    assert recorder.said == [("failing", 1), "end"]


@pytest.mark.parametrize(("number", "set_before", "devices"), [("3", {}, 3), ("", {"JAX_NUM_CPU_DEVICES": "1"}, 1)])
def test_configure(number, set_before, devices):
    """So many devices as asked for, unless the environment says otherwise, and all of them at work."""
    code = (
        f"from jaxnh.engine.xla_options import configure; from jaxnh.engine.executor.lanes import LaneExecutor; configure({number}); import jax, numpy as np;"
        "r = LaneExecutor()(abs, (), (np.linspace(-1, 0, 10),)); print(len(jax.devices()), r.sum())"
    )
    environment = {**os.environ, **set_before}
    environment.pop("XLA_FLAGS", None)
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == [str(devices), "5.0"]


def test_a_flow_first_seen_by_two_devices():
    """What is known of a flow's equations is found while the first program is traced, and is of no device."""

    def rotor(damping):
        return {"rhs": lambda y, t: (y[1], 0.5 - damping * y[1] - jnp.sin(y[0])), "coordinates": ("angle", "rate")}

    flow = first_order(rotor, {"damping": 0.1})
    step = make_return_map(flow, tsit5, 1)
    start = jax.vmap(flow.chart.state)(np.stack([np.linspace(0.0, 1.0, 8), np.zeros(8)], axis=1))
    lanes = start, {"damping": np.full(8, 0.1)}
    found = [LaneExecutor(devices=jax.devices("cpu")[:n])(iterate, (step, np.int32(20)), lanes) for n in (2, 1)]
    same_leaves(*found)


def test_cores_of_a_system_that_cannot_say(monkeypatch):
    """macOS has no affinities: all cores of the machine are there to be used."""
    monkeypatch.delattr(os, "sched_getaffinity")
    assert xla_options.cores() == list(range(os.cpu_count()))
