"""Error bars of averages on growth whose mean is known: noise with and without memory, tori, shear, laminar drift."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.analyses.exponents.errors import (
    average_blocks,
    average_windows,
    unseen_bursts,
    widen_by_drift,
    widen_to_sum_rule,
    widen_to_zero,
    widen_unsettled,
)
from jaxnh.analyses.options.base import BLOCKS
from jaxnh.analyses.smooth_window import drift_basis, moment_weights

PERIODS, LANES = 1024, 2000


def blocks_of(growth):
    """Means of the blocks of growth (lanes, periods), (lanes, blocks, 1)."""
    return growth.reshape(len(growth), BLOCKS, -1).mean(axis=2)[..., None]


def smooth_of(growth):
    """Smooth averages over the whole and both halves of growth (lanes, periods), and how it drifts, (lanes, parts, 1)."""
    x = (np.arange(growth.shape[1]) + 0.5) / growth.shape[1]
    *moments, half = moment_weights(x)
    coefficients = growth @ np.stack(moments).T @ drift_basis(x)[0].T
    halves = [growth[:, part] @ half[part] / half[part].sum() for part in (x < 0.5, x > 0.5)]
    return np.column_stack([coefficients[:, :1], *halves, coefficients[:, 1:]])[..., None]


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
    np.testing.assert_array_equal(widen_to_sum_rule(error, residual, np.zeros(len(residual))), expected)


def uncovered(growth, truth, before=32):
    """Shares of lanes whose bar of a smooth average does not cover, without and with what a drift may come to."""
    parts = smooth_of(growth)
    alone = average_windows(parts, before, growth.shape[1])
    widened = widen_by_drift(alone, parts)
    return [np.mean(np.abs(found.mean[:, 0] - truth) > found.error[:, 0]) for found in (alone, widened)]


def attracted_to_a_torus(rate, inside=0.05, outside=1.8, periods=4096, before=512, lanes=200):
    """Growth across the torus of r' = γ r (1 − r²) a period in closed form, of lanes that begin at r; its mean is −2γ.

    With s = r² the growth γ(1 − 3s) has the integral ln(s/s0)·3/2 − 2γt.
    """
    s0 = np.linspace(inside, outside, lanes)[:, None] ** 2
    t = before + np.arange(periods + 1)
    grown = np.exp(2 * rate * t)
    s = s0 * grown / (1 - s0 + s0 * grown)
    return np.diff(1.5 * np.log(s) - 2 * rate * t, axis=1)


@pytest.mark.parametrize("rate", [1e-6, 1e-5, 1e-4, 1e-3, 1e-2])
def test_a_motion_that_comes_to_its_torus_slowly(rate):
    """All bars cover, where of rates below 1e-3 few did; a lane whose drift grows has no bar, and none has that is there."""
    growth = attracted_to_a_torus(rate)
    alone, widened = uncovered(growth, -2 * rate, 512)
    assert widened == 0.0
    assert alone > 0.9 or rate > 1e-4
    parts = smooth_of(growth)
    error = widen_by_drift(average_windows(parts, 512, 4096), parts).error
    assert np.isinf(error[20]) or rate > 1e-4  # r = 0.22: the growth falls the faster, the nearer r comes to 1/√2
    assert np.all(np.isfinite(error)) or rate < 1e-2


@pytest.mark.parametrize("share", [0.01, 0.1, 1.0, 3.0, 10.0, 30.0])
def test_a_mean_that_settles_exponentially(share):
    """Over windows that hold from a hundredth of the decay to all of it, beside a fast wave, all bars cover."""
    rng, t = np.random.default_rng(8), np.arange(4096)
    rates = rng.uniform(0.5, 2.0, (200, 1)) * share / 4096
    growth = rng.normal(size=(200, 1)) * 1e-3 * np.exp(-rates * t) + 0.1 * np.cos(2.1 * t + rates * 1e6)
    assert uncovered(growth, 0.0)[1] == 0.0


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_a_mean_that_settles_like_a_power_of_time(power):
    """As at the onset of an attractor, from a window of 130 times what has passed to one of half of it, all bars cover."""
    before = np.geomspace(32, 8192, 200)[:, None]
    alone, widened = uncovered((before + np.arange(4096)) ** -power, 0.0)
    assert widened == 0.0
    assert alone > 0.15


def test_no_drift_where_there_is_none():
    """Of waves no bar is wider, of noise smooth and plain at most 1 in 500 are."""
    rng, t = np.random.default_rng(9), np.arange(PERIODS)
    phase, frequency = rng.uniform(0, 2 * np.pi, (LANES, 2, 1)), rng.uniform(0.2, 3.0, (LANES, 2, 1))
    waves, noise = np.cos(frequency * t + phase).sum(axis=1), rng.normal(size=(LANES, PERIODS))
    for growth, share in ((waves, 0.0), (noise, 0.002)):
        parts = smooth_of(growth)
        alone = average_windows(parts, 32, PERIODS)
        assert np.mean(widen_by_drift(alone, parts).error > 1.1 * alone.error) <= share
    blocks = blocks_of(noise)
    plain = average_blocks(blocks)
    np.testing.assert_array_equal(widen_by_drift(plain, smooth_of(noise), blocks).error, plain.error)


@pytest.mark.parametrize("every", [2, 3, 4, 6])
def test_no_drift_of_events_at_equal_times(every):
    """As of a ball that loses half its speed every few units of time: all blocks are the same, and none scatters."""
    growth = np.zeros((every, 12 * BLOCKS))
    for phase in range(every):
        growth[phase, phase::every] = np.log(0.5)
    blocks = blocks_of(growth)
    assert np.ptp(blocks) < 1e-15
    widened = widen_by_drift(average_blocks(blocks), smooth_of(growth), blocks)
    np.testing.assert_allclose(widened.mean, np.log(0.5) / every, rtol=1e-14)
    assert widened.error.max() < 1e-14


def test_a_drift_along_a_family_of_orbits():
    """A rise that steps account for is the error of the mean; one beyond them has no end in the run."""
    growth = -1.2 + 1e-5 * np.arange(4096)[None] / 4096
    parts = smooth_of(growth)
    alone = average_windows(parts, 512, 4096)
    assert alone.error < 1e-5
    assert float(widen_by_drift(alone, parts, steps=2e-5).error[0, 0]) == pytest.approx(1e-5, rel=1e-3)
    assert np.isinf(widen_by_drift(alone, parts, steps=5e-6).error)


def test_a_drift_of_chaos_beyond_its_scatter():
    """A mean that rises by eighty times the noise of a block over the run has no bar; one that rises by a hundredth has its own."""
    noise = np.random.default_rng(10).normal(size=(50, PERIODS)) * 0.01
    for rise, drifts in ((0.1, True), (1e-4, False)):
        growth = 0.1 + noise + rise * np.arange(PERIODS) / PERIODS
        blocks = blocks_of(growth)
        error = widen_by_drift(average_blocks(blocks), smooth_of(growth), blocks).error
        assert np.all(np.isinf(error) == drifts)


def test_a_sum_of_exponents_before_the_motion_has_settled():
    """A sum of −7e-5 ± 2e-6 after 4,608 periods: volumes have shrunk by a third, and the bar is 4 over the periods. One of
    −2e-3, one of a constant divergence and one that may be zero have the bars that they had."""
    wave = 1e-3 * np.cos(np.arange(BLOCKS))
    rates = np.stack([-7e-5 + wave, -2e-3 + wave, np.full(BLOCKS, -7e-5), 1e-6 + wave])[..., None]
    total = average_blocks(rates)._replace(error=np.full((4, 1), 2e-6))
    error = widen_unsettled(total._replace(mean=np.array([[-7e-5], [-2e-3], [-7e-5], [1e-6]])), rates, 4608).error
    np.testing.assert_allclose(error[:, 0], [4 / 4608, 2e-6, 2e-6, 2e-6])
