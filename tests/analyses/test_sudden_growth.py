"""Sudden growth of chaotic attractors: of the quadratic map, whose crises are known, and of twins of a flow that merge."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.analyses.crises.sudden_growth import keep_common_growths, sudden_growths
from tests.flows.written_out import experiment
from tests.helpers.attractors import changes
from tests.helpers.kept_programs import session_of

CRISIS = 1.790327
"""Of period 3: the iterates 6 and 9 of 0 are one (tests/analyses/test_windows.py)."""


def clouds(values, shift=0.0, points=2048):
    """Points of the attractor of x → 1 − a x², moved by `shift` from one value to the next."""
    a, found = np.asarray(values), []
    x = np.full(len(a), 0.1)
    for n in range(-1000, points):
        x = 1 - a * x * x
        found += [x] if n >= 0 else []
    return [(cloud + k * shift)[:, None] for k, cloud in enumerate(np.transpose(found))]


def test_growth_is_where_the_crisis_is():
    """Three bands before, all of the interval between the extremum's first two images beyond: in one step of six."""
    values = CRISIS + 0.001 * np.arange(-3.5, 4.0)
    assert np.flatnonzero(sudden_growths(clouds(values), values)).tolist() == [3]


@pytest.mark.parametrize("shift", [0.0, 0.05, 0.3])
def test_a_trend_is_no_crisis(shift):
    """Beyond the crisis it fills the interval, which goes on as the parameter does, wherever it lies."""
    values = 1.93 + 0.001 * np.arange(8)
    assert not np.any(sudden_growths(clouds(values, shift), values))


def test_twins_agree():
    """Of two with the same exponents what one shows alone is none; of others, or at other values, it is."""
    first, second = np.array([False, True, True]), np.array([False, True, False])
    rates = np.array([0.10, 0.12, 0.11, 0.13])
    places = [3, 4, 5, 6]

    def shown(other, where=places):
        return [found.tolist() for found in keep_common_growths([first, second], [places, where], [rates, other])]

    assert shown(1.02 * rates) == [second.tolist()] * 2
    assert shown(1.2 * rates) == [first.tolist(), second.tolist()]
    assert shown(1.02 * rates, [3, 4, 5, 7]) == [first.tolist(), second.tolist()]
    assert keep_common_growths([], [], []) == []


@pytest.mark.slow
def test_twins_change_together(tmp_path):
    """x'' + x'/2 − x + x³ = F cos t: two attractors that (x, t) → (−x, t + π) makes of each other, until they merge.

    By heyoka eight motions of 12,000 strobes stay above x = −0.17 at 0.3822, and come down to −1.15 at 0.3825.
    """
    sweep = {"F": {"start": 0.368, "stop": 0.384, "count": 9}}
    drawn = {"n_starts": 40, "box": {"x": [-2.0, 2.0], "v": [-2.0, 2.0]}}
    rates = "v, -0.5 * v + x - x**3 + F * jnp.cos(t)"
    asked = experiment(tmp_path, ("x", "v"), rates, sweep, drawn, '"period": 2 * jnp.pi', "F=0.37")
    found = changes(session_of(asked).tree()["attractors"].to_dataset(), "F")
    assert [one[:2] for one in found] == [("crisis", 1), ("crisis", 2), ("crisis", 3)]  # two end, one begins
    for *_, at, error in found:
        assert at - error < 0.3822 < 0.3825 < at + error == pytest.approx(at + 0.001)
