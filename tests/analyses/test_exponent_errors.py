"""Error bars of averages on growth whose mean is known: noise with and without memory, tori, shear, laminar drift."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.analyses.exponents.errors import (
    average_blocks,
    average_windows,
    unseen_bursts,
    widen_to_sum_rule,
    widen_to_zero,
)
from jaxnh.analyses.options.base import BLOCKS
from jaxnh.analyses.smooth_window import half_window_weights

PERIODS, LANES = 1024, 2000


def blocks_of(growth):
    """Means of the blocks of growth (lanes, periods), (lanes, blocks, 1)."""
    return growth.reshape(len(growth), BLOCKS, -1).mean(axis=2)[..., None]


def smooth_of(growth):
    """Smooth averages over the whole and both halves of growth (lanes, periods), (lanes, 3, 1)."""
    x = (np.arange(growth.shape[1]) + 0.5) / growth.shape[1]
    whole, half = half_window_weights(x)
    parts = [whole, half * (x < 0.5), half * (x > 0.5)]
    return np.stack([growth @ weights / weights.sum() for weights in parts], axis=1)[..., None]


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.98])
def test_noise_is_covered(memory):
    """Of noise whose memory is up to fifty of 1,024 periods 95 % of the bars cover, but for five standard errors of that
    share; and bars are no wider than three times the standard deviation of the mean."""
    rng = np.random.default_rng(4)
    noise = rng.normal(size=(LANES, PERIODS + 512))
    for i in range(1, noise.shape[1]):
        noise[:, i] += memory * noise[:, i - 1]
    found = average_blocks(blocks_of(noise[:, 512:]))
    missed = np.mean(np.abs(found.mean) > found.error)
    assert missed < 0.05 + 5 * np.sqrt(0.05 * 0.95 / LANES)
    assert np.median(found.error) < 3.0 * found.mean.std() * 1.3


def test_smooth_averages_on_tori():
    """Growth that is a sum of incommensurate waves has the mean zero, to the rounding that is allowed for and better."""
    t = np.arange(PERIODS)
    phase = np.random.default_rng(5).uniform(0, 2 * np.pi, (64, 1))
    found = average_windows(smooth_of(np.cos(2.0 * t + phase) + 0.5 * np.cos(np.sqrt(5.0) * t + phase)), 32, PERIODS)
    assert np.all(np.abs(found.mean) <= found.error)
    assert np.all(found.error < 1e-6)


@pytest.mark.parametrize(("before", "periods"), [(32, 64), (256, 64), (32, 4096), (4, 1024)])
def test_tangents_that_grow_in_proportion_to_time(before, periods):
    """On tori with shear rates fall like 1/t: zero is covered by the window and by the plain mean."""
    t = before + np.arange(periods) + 0.5
    growth = (1 / t)[None]
    window = average_windows(smooth_of(growth), before, periods)
    assert 0 < window.mean <= window.error
    plain = widen_to_zero(average_blocks(blocks_of(growth)), before, periods)
    assert 0 < plain.mean <= plain.error


def test_a_mean_far_from_zero_has_the_bar_that_it_had():
    plain = average_blocks(blocks_of(0.5 + 0.1 * np.random.default_rng(6).normal(size=(8, PERIODS))))
    np.testing.assert_array_equal(widen_to_zero(plain, 32, PERIODS).error, plain.error)


def test_bursts_are_allowed_for_where_blocks_only_drift():
    """A laminar phase of 64 periods: its drift gets a bar of 21 over its length; noise gets none, but 1 in 100 lanes."""
    drift = np.tile(np.linspace(-0.02, 0.04, 64), (1, 1))
    assert unseen_bursts(blocks_of(drift), 64) == pytest.approx(21 / 64)
    noise = np.random.default_rng(7).normal(size=(LANES, 64))
    assert np.mean(unseen_bursts(blocks_of(noise), 64) > 0) < 0.01


def test_a_sum_rule_that_contradicts():
    """Of lanes whose exponents miss the divergence by more than all their bars, each bar is the residual; others keep theirs."""
    error = np.array([[1e-3, 2e-3], [1e-3, 2e-3], [1e-2, 2e-3], [1e-3, 2e-3]])
    residual = np.array([2.9e-3, -2.8e-2, 5e-3, np.nan])
    expected = np.array([[1e-3, 2e-3], [2.8e-2, 2.8e-2], [1e-2, 2e-3], [1e-3, 2e-3]])
    np.testing.assert_array_equal(widen_to_sum_rule(error, residual), expected)
