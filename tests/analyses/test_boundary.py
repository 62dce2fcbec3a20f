"""Entropies and uncertainty exponents of boundaries that are known: smooth ones, and Cantor sets times a line."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from jaxnh.analyses.basins.boundary import BOX, entropies, measure_boundary, uncertainty_exponent
from jaxnh.exceptions import ConfigError
from tests.flows.written_out import line, oscillator
from tests.helpers.kept_programs import session_of

TRIALS = 60


def grid(n, random):
    """A plane of n × n starts in the unit square, somewhere between its pixels."""
    return np.meshgrid(*((np.arange(n) + random.random(2)[:, None]) / n), indexing="ij")


def disc(n, random):
    x, y = grid(n, random)
    a, b = random.uniform(0.45, 0.55, 2)
    return 1 + (np.hypot(x - a, y - b) < random.uniform(0.1, 0.45)), 1.0


def straight(n, random):
    (x, y), angle = grid(n, random), random.uniform(0, np.pi)
    return 1 + (np.cos(angle) * (x - 0.5) + np.sin(angle) * (y - 0.5) > random.uniform(-0.2, 0.2)), 1.0


def cantor(n, random):
    """Of a Cantor set that keeps a share s at both ends, dimension D = ln 2/ln(1/s), along an oblique line: α = 1 − D.

    A start has the label of the stage at which its place is taken out, odd or even.
    """
    (x, y), angle, dimension = grid(n, random), random.uniform(0, np.pi / 2), random.uniform(0.4, 0.9)
    t = (np.cos(angle) * x + np.sin(angle) * y) / (np.cos(angle) + np.sin(angle))
    share, labels = 2 ** (-1 / dimension), np.zeros(t.shape, int)
    for stage in range(40):
        labels[(labels == 0) & (t >= share) & (t < 1 - share)] = 1 + stage % 2
        t = np.where(t < share, t / share, np.where(t >= 1 - share, (t - 1 + share) / share, t))
    return np.maximum(labels, 1), 1 - dimension


def two_slopes(n, random):
    """Of the map m x below a point and 1 + m' (x − 1) above it, which leaves [0, 1] through a gap to either side, along
    bent lines: m^(−D) + m'^(−D) = 1. Starts have the label of the side; slopes near 2 leave much of a coarse plane mixed.
    """
    (x, y), slopes, bent = grid(n, random), random.uniform(2.1, 3.2, 2), random.uniform(-0.2, 0.2, 2)
    x, y = 1.6 * x - 0.3, 2.0 * y - 1.0
    x, labels = x - bent[0] * y * y - bent[1] * y, np.zeros(x.shape, int)
    split = 0.5 * (1.0 / slopes[0] + 1.0 - 1.0 / slopes[1])
    for _ in range(100):
        labels = np.where(labels > 0, labels, np.where(x > 1.0, 2, np.where(x < 0.0, 1, 0)))
        x = np.where(labels > 0, x, np.where(x < split, slopes[0] * x, 1.0 + slopes[1] * (x - 1.0)))
    return np.maximum(labels, 1), 1.0 - brentq(lambda d: np.sum(slopes**-d) - 1.0, 0.0, 1.0)


@pytest.mark.parametrize("n", [64, 200])
@pytest.mark.parametrize("boundary", [disc, straight, cantor, two_slopes])
def test_errors_cover_the_exponent(boundary, n):
    """In 95 of 100 planes: of 60, at least 52 with a probability of 99.5 % (binomial). Of two slopes
    bars of a line through the logarithms covered 10 and 40 of these 60. Of the four distances of 64 starts three
    parameters leave one degree of freedom, with a Student's t of 13."""
    random = np.random.default_rng(5)
    hits, errors = [], []
    for _ in range(TRIALS):
        labels, exponent = boundary(n, random)
        found = uncertainty_exponent(labels)
        hits.append(abs(found.value - exponent) <= found.error)
        errors.append(found.error)
    assert np.sum(hits) >= 52
    assert np.median(errors) < (0.5 if n < 100 else 0.15)


def test_errors_cover_the_entropies():
    """The mean over 40 places of the plane between its pixels is what each is to cover; a disc, and three sectors."""

    def sectors(n, random):
        x, y = grid(n, random)
        return (np.floor(3 * ((np.arctan2(y - 0.47, x - 0.52) / (2 * np.pi) + 0.3) % 1))).astype(int) + 1

    def middle(n, random):
        x, y = grid(n, random)
        return 1 + (np.hypot(x - 0.5, y - 0.5) < 0.3)

    random = np.random.default_rng(2)
    for plane in (sectors, middle):
        both = np.array([entropies(plane(64, random)) for _ in range(40)])  # (places, quantities, value and error)
        truth = both[:, :, 0].mean(axis=0)
        assert np.all(np.mean(np.abs(both[:, :, 0] - truth) <= both[:, :, 1], axis=0) >= 0.95)
        assert np.all(both[:, :, 1] < 0.3 * truth)


def test_entropies_in_closed_form():
    """Columns of two labels in turn: boxes have three of five columns of one; ln 2 is never reached by two labels."""
    labels = np.broadcast_to(1 + np.arange(40) % 2, (40, 40))
    expected = -(0.6 * np.log(0.6) + 0.4 * np.log(0.4))
    whole, mixed = entropies(labels)
    assert whole.value == pytest.approx(expected, rel=1e-12)
    assert mixed == pytest.approx(whole)
    noise = np.random.default_rng(1).integers(1, 5, (400, 400))
    assert np.log(4) - 0.1 < entropies(noise)[1].value < np.log(4)


def test_undecided_and_failed():
    """What is undecided is no label, what has failed is one."""
    labels = np.ones((40, 40), int)
    labels[:, 20:] = 0
    found = measure_boundary(labels)
    assert found.basin_entropy.value == 0.0
    assert np.isnan([found.boundary_entropy.value, *found.uncertainty_exponent]).all()
    labels[:, 20:] = -1
    assert measure_boundary(labels).uncertainty_exponent.value == pytest.approx(1.0)
    places = 40 - BOX + 1
    mixed = [-(p * np.log(p) + (1 - p) * np.log(1 - p)) for p in np.arange(1, BOX) / BOX]
    assert measure_boundary(labels).basin_entropy.value == pytest.approx(np.sum(mixed) / places)


@pytest.mark.slow
def test_planes_of_a_sweep(tmp_path):
    """At each value of a parameter the measures of its plane; without them none is stored."""
    plane = {"x": line(-1.5, 1.5, 33), "v": line(-1.0, 1.0, 32)}
    options = {"transient": 32, "max_periods": 64, "max_period": 2}
    sweep = {"linear": {"values": [0.9, 1.0]}, **plane}
    tree = session_of(oscillator(tmp_path, sweep, {**options, "boundary": True}, 0.01, damping=0.4)).tree()
    basins = tree["basins"]
    assert basins["basin_entropy"].dims == ("drive", "linear")
    for k in range(2):
        expected = measure_boundary(basins["attractor"].values[0, k])
        for name, one in expected._asdict().items():
            assert tuple(basins[n].values[0, k] for n in (name, f"{name}_error")) == pytest.approx(one, nan_ok=True)
    assert np.all(basins["boundary_entropy"].values > 0.3)
    assert np.all(basins["boundary_entropy"].values < np.log(2))
    assert np.all(np.abs(basins["uncertainty_exponent"] - 1.0) <= basins["uncertainty_exponent_error"])


@pytest.mark.parametrize(
    ("sweep", "message"),
    [
        ({"x": line(-1.0, 1.0, 40)}, "needs a plane of start states: two axes of coordinates of the start"),
        ({"x": line(-1.0, 1.0, 40), "v": line(0.0, 1.0, 31)}, "needs at least 32 values of v, at equal distances"),
        (
            {"x": line(-1.0, 1.0, 40), "v": {"values": [*np.linspace(0.0, 1.0, 40).tolist(), 2.0]}},
            "needs at least 32 values of v, at equal distances",
        ),
    ],
)
def test_no_plane(tmp_path, sweep, message):
    with pytest.raises(ConfigError, match=message):
        oscillator(tmp_path, sweep, {"boundary": True})
