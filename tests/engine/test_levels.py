"""Levels of a sweep, from coarse to fine: the finest is the plain run, and near a boundary alone it is most of it."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.analyses.registry import ANALYSES as KINDS
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.levels.levels import lanes_near_changes
from jaxnh.exceptions import ConfigError
from sweeps.timing.adaptive_charts import refined
from tests.helpers.cases import some_slow
from tests.helpers.kept_programs import session_of
from tests.helpers.level_sweeps import ANALYSES, PERIOD, WIDE, sweep_content

pytestmark = pytest.mark.usefixtures("uncalibrated")
LANE_AXES = {"b": {"start": 4.6, "stop": 5.6, "count": 20}, "a": {"start": 0.45, "stop": 0.55, "count": 9}}
ROWS = {"b": {"start": 5.2, "stop": 6.0, "count": 9}, "d": {"start": 0.05, "stop": 0.4, "count": 5}}


def tree_of(*what):
    return session_of(Experiment.from_dict(sweep_content(*what))).tree()


@pytest.mark.parametrize(
    ("sweep", "analyses"), some_slow({"lanes": (LANE_AXES, ANALYSES), "rows": (ROWS, PERIOD)}, "rows")
)
def test_all_levels_are_the_plain_run(sweep, analyses):
    """Every bit of it, whatever the level at which a lane was computed; `computed` says that all were."""
    plain, levels = tree_of(sweep, None, analyses), tree_of(sweep, {"count": 3}, analyses)
    assert set(plain.children) == set(levels.children)
    for name, group in plain.children.items():
        ours = levels[name].to_dataset()
        assert set(ours.variables) == {*group.dataset.variables, "computed"}
        assert ours["computed"].dims == tuple(sweep)
        assert ours["computed"].to_numpy().all()
        for key, item in group.dataset.variables.items():
            assert ours.variables[key].dims == item.dims
            assert ours.variables[key].values.tobytes() == item.values.tobytes(), f"{name}/{key}"
        assert ours.attrs == group.attrs


def test_boundary_alone():
    """Lanes that are computed have the bits of the plain run; the others are of the kind of a neighbour two apart."""
    plain, near = tree_of(WIDE), tree_of(WIDE, {"count": 3, "refine": "boundary"})
    period = near["period"].to_dataset()
    computed = period["computed"].to_numpy()
    assert computed[::4, ::4].all()
    assert 0.2 < computed.mean() < 0.9
    for name, group in plain.children.items():
        for key, item in group.dataset.variables.items():
            if item.dims[:2] == tuple(WIDE):
                ours = near[name].to_dataset().variables[key].values
                assert ours[computed].tobytes() == item.values[computed].tobytes(), f"{name}/{key}"
    for place in np.argwhere(~computed):
        low = [slice(max(0, k - 2), k + 3) for k in place]
        assert period["period"].to_numpy()[tuple(place)] in period["period"].to_numpy()[*low][computed[*low]]
    # The study of what levels make of a full chart says the same of it, without computing anything.
    kinds = [KINDS[name].classes(plain[name].to_dataset())[..., None] for name in ANALYSES]
    ours = [KINDS[name].classes(near[name].to_dataset())[..., None] for name in ANALYSES]
    other = [np.any(one != kind, axis=-1) for kind, one in zip(kinds, ours, strict=True)]
    assert refined(kinds, 3) == (computed.mean(), np.any(other, axis=0).mean(), tuple(one.mean() for one in other))


def test_what_is_near_a_change():
    """In a plane of two halves: the lanes beside the edge, those beside them on the coarse level, and one more each."""
    halves = np.zeros((8, 3), int)
    halves[4:] = 1
    expected = np.zeros((15, 5), bool)
    expected[5:10] = True  # coarse lanes 3 and 4 are at 6 and 8
    np.testing.assert_array_equal(lanes_near_changes([halves], (15, 5)), expected)
    np.testing.assert_array_equal(lanes_near_changes([0 * halves], (15, 5)), False)
    both = np.stack([0 * halves, halves], axis=-1)
    np.testing.assert_array_equal(lanes_near_changes([0 * halves, both], (15, 5)), expected)


@pytest.mark.parametrize(
    ("levels", "analyses", "message"),
    [
        ({"count": 5}, ANALYSES, "levels.count: 9 values of a are too few for 5 levels: 4 at most, or 17 values"),
        ({"count": 1}, ANALYSES, "levels.count: must be at least 2, not 1"),
        (
            {"count": 2, "refine": "boundary"},
            {"diagram": {}},
            "levels.refine: a boundary is seen in lyapunov, period, verdict, basins, reversal, covariant and rotation; ask for one of them as well",
        ),
        (
            {"count": 2},
            {"doubling": {}},
            "analyses.doubling: doubling runs along all values of b, and levels leave some out: run it without them",
        ),
    ],
)
def test_levels_that_cannot_be(levels, analyses, message):
    with pytest.raises(ConfigError) as caught:
        Experiment.from_dict(sweep_content(LANE_AXES, levels, analyses))
    assert str(caught.value) == f"experiment: {message}"
