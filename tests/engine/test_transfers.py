"""Bytes that come to the host in a chart: points, sums of growth and ends of motions, not what it would only pass on."""

from __future__ import annotations

import math

import jax
import pytest

import jaxnh
from jaxnh.analyses.options.base import BLOCKS
from jaxnh.analyses.smooth_window import DEGREE
from jaxnh.engine.executor.grouped_blocks import evaluate_block
from tests.helpers.experiments import content
from tests.helpers.kept_programs import QUICKLY_COMPILED, lanes_with_kept_programs, session_of

pytestmark = pytest.mark.usefixtures("uncalibrated")
POINT, STATE, TANGENT = 3, 4, 3  # numbers of a lane
SUMS = 2 * (DEGREE + 3) + 1  # growth and volume, plain, under the windows of moments and of a half; and divergence
ANALYSES = {
    "lyapunov": {"transient": 64, "periods": 32, "exponents": 1},
    "period": {"transient": 64, "max_period": 16},
}
B = {"start": 5.2, "stop": 5.6, "count": 4}


class CountedTiles:
    """Tiles that note the functions of each call, and for each of these the numbers a lane that came to the host."""

    def __init__(self, tiles):
        self.tiles, self.calls = tiles, []

    def run(self, call, first=0):
        functions, blocks = [], call.links[0].function is evaluate_block
        for link in call.links:
            function, *static = link.static[0][:2] if blocks else (link.function, link.static)
            functions.append((function.__name__, *static))
        for tile in self.tiles.run(call, first):
            if not tile.first:
                of_lane = [
                    sum(leaf.nbytes / math.prod(leaf.shape[: 1 + blocks]) / 8 for leaf in jax.tree.leaves(result))
                    for result in tile.each
                ]
                self.calls.append(list(zip(functions, of_lane, strict=True)))
            yield tile


@pytest.mark.parametrize(
    "other",
    [
        {"a": {"values": [0.4, 0.5]}},
        pytest.param({"d": {"start": 0.0, "stop": 0.3, "count": 3}}, marks=pytest.mark.slow),  # shared by a row
    ],
)
def test_numbers_of_a_chart_that_come_to_the_host(other):
    session = session_of(jaxnh.Experiment.from_dict(content({"b": B, **other}, ANALYSES)))
    counted = []

    def count(tiles):
        counted.append(CountedTiles(tiles))
        return counted[-1]

    session._lanes = lanes_with_kept_programs(None, None, 8, QUICKLY_COMPILED).through(count)
    session.tree()
    calls = [call for tiles in counted for call in tiles.calls]  # of each slice of the lanes
    records = [call for call in calls if call[0][0][0] == "record"]
    assert records
    for (_, nothing), ((name, (points, _)), numbers) in records:
        assert (name, nothing, numbers) == ("observe_states", 0, POINT * points + STATE)
    growth = [[numbers for _, numbers in call] for call in calls if call[0][0][0] == "advance"]
    whole = STATE + TANGENT + SUMS + 1
    of_steps = 4  # times a few periods, by steps and by twice as many, of lanes that are regular
    assert {len(numbers) for numbers in growth} == {1, of_steps, BLOCKS - 1}
    for numbers in growth:
        assert numbers == [whole - TANGENT - 1] * (len(numbers) - 1) + [whole]
    assert all(
        sum(numbers for _, numbers in call) <= whole for call in calls if call[0][0][0] not in ("record", "advance")
    )
