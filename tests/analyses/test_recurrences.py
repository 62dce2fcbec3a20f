"""Periods after which points recur: the program of a card says of each lane what the host does, and is one for CUDA."""

from __future__ import annotations

from unittest import mock

import jax
import numpy as np
import pytest

from jaxnh.analyses.periodic.recurrences import Recurrence, recurrences, recurs_after
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.systems.first_order import CoordinateChart
from jaxnh.systems.particle import ParticleChart
from tests.helpers.kept_programs import QUICKLY_COMPILED

LIMIT = 6
CHARTS = {
    "particle": ParticleChart((False, False, True), 2, True),
    "coordinates": CoordinateChart((False, True), 2, False),
}


def lanes_of_points(d):
    """Strobe points (lanes, 2 LIMIT, d) of periods 1 to 6, with decaying and doubled ones, of noise, and lost ones."""
    rng, t = np.random.default_rng(1), np.arange(2 * LIMIT)
    periodic = [rng.normal(size=(n, d))[t % n] for n in range(1, LIMIT + 1) for _ in range(4)]
    doubled = [rng.normal(size=(n, d))[t % n] + 0.02 * ((t // n) % 2)[:, None] for n in (1, 2, 3)]
    decaying = [rng.normal(size=(2, d))[t % 2] * (1 + 0.01 * 0.7 ** t[:, None]) for _ in range(4)]
    noise = [rng.normal(size=(2 * LIMIT, d)) for _ in range(8)]
    near = [0.01 * rng.normal(size=(2 * LIMIT, d)) for _ in range(8)]
    lost = [np.where(t[:, None] > 3, np.nan, 0.0) * np.ones(d)]
    return np.array([*periodic, *doubled, *decaying, *noise, *near, *lost])


@pytest.mark.parametrize("sought", [Recurrence(LIMIT, False), Recurrence(LIMIT, True)])
@pytest.mark.parametrize("kind", list(CHARTS))
def test_a_card_says_what_the_host_says(kind, sought):
    chart = CHARTS[kind]
    points = lanes_of_points(chart.dimension)
    size = np.abs(np.random.default_rng(2).normal(1.0, 0.2, (len(points), chart.dimension)))
    lanes = LaneExecutor(None, jax.devices()[:1], 64, QUICKLY_COMPILED)
    host = recurrences(chart, lanes, points, size, sought)
    with mock.patch.object(LaneExecutor, "on_card", property(lambda self: True)):
        card = recurrences(chart, lanes, points, size, sought)
    assert np.array_equal(card, host)
    of_period = np.arange(1, LIMIT + 1).repeat(4)
    least = host[:, : len(of_period)].argmax(axis=0)
    assert np.array_equal(least, of_period)
    assert not host[:, -1].any()
    text = jax.jit(jax.vmap(lambda *one: recurs_after(chart, *one, sought))).trace(points, size)
    assert "custom_call" not in text.lower(lowering_platforms=("cuda",)).as_text()
