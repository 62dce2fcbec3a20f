"""Axes to lanes and back: which lanes stand for a sweep, that pieces hold every lane once, and names of dimensions."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxnh.analyses.base import LANE, variable
from jaxnh.analyses.batch import Axis
from jaxnh.engine.accuracy.calibration import SAMPLED_LANES
from jaxnh.engine.axes import places_of, points, sample_places, to_axes
from jaxnh.engine.experiment import Experiment
from jaxnh.jobs.cutting import Cutting, Piece

KINDS = ("lane", "start", "shared")


def axis(number, size, kind):
    return Axis(f"q{number}", np.linspace(1, 2, size), f"parameter q{number}", kind)


axes_of_sweeps = st.lists(st.tuples(st.integers(1, 24), st.sampled_from(KINDS)), min_size=1, max_size=4).map(
    lambda found: [axis(k, size, kind) for k, (size, kind) in enumerate(found)]
)


# ---- samples


@pytest.mark.parametrize("count", [1, 2, 3, 7, 1000, 1023, 1024, 1025, 3000, 100_000])
def test_one_axis_is_sampled_evenly_with_both_ends(count):
    """The very lanes that a sweep of one axis has always been calibrated on."""
    [(places,)] = sample_places([axis(0, count, "lane")], SAMPLED_LANES)
    expected = np.unique(np.linspace(0, count - 1, min(count, 1024)).round().astype(int))
    np.testing.assert_array_equal(places, expected)
    assert (places[0], places[-1]) == (0, count - 1)


@given(axes_of_sweeps, st.sampled_from([SAMPLED_LANES, None]))
@settings(max_examples=50, deadline=None)
def test_samples_have_both_ends_of_every_axis(axes, most):
    """Every corner of the sweep is in; no lane twice; values of shared axes are the same throughout a row."""
    rows = list(sample_places(axes, most))
    lanes = [lane for row in rows for lane in zip(*(places.tolist() for places in row), strict=True)]
    assert len(lanes) == len(set(lanes))
    if most is not None:
        assert len(lanes) <= most
    ends = [(0, len(one.values) - 1) for one in axes]
    assert set(itertools.product(*ends)) <= set(lanes)
    for places, one in zip(zip(*rows, strict=True), axes, strict=True):
        assert all(np.all((part >= 0) & (part < len(one.values))) for part in places)
        if one.kind == "shared":
            assert all(len(set(part.tolist())) == 1 for part in places)
    if most is None:
        own = math.prod(len(one.values) for one in axes if one.kind != "shared")
        assert len(lanes) == own * len(rows)


@pytest.mark.parametrize(
    ("kinds", "lanes"), [(("lane", "lane"), 1024), (("lane", "start", "lane"), 1000), (("lane", "shared"), 1024)]
)
def test_large_sweeps_are_sampled_by_as_many_as_there_may_be(kinds, lanes):
    """Or by as many as a grid of equal sides has."""
    axes = [axis(k, 5000, kind) for k, kind in enumerate(kinds)]
    assert sum(len(row[0]) for row in sample_places(axes, SAMPLED_LANES)) == lanes


# ---- pieces


@given(
    st.lists(st.tuples(st.integers(1, 12), st.booleans()), min_size=1, max_size=4),
    st.integers(1, 100),
    st.sampled_from([("tiles",), ("tiles", "line"), ("line",)]),
)
@settings(max_examples=50, deadline=None)
def test_pieces_hold_every_lane_once(sizes, tile, order):
    """Of every analysis; a tile has one value of each shared axis, a line the whole first axis."""
    axes = tuple((f"q{k}", size, shared) for k, (size, shared) in enumerate(sizes))
    independent = tuple(name for name in order if name == "tiles")
    found = Cutting(axes, tile, order, independent).pieces()
    assert [piece.number for piece in found] == list(range(len(found)))
    for name in order:
        lanes = []
        for piece in (piece for piece in found if name in piece.names):
            places = places_of(piece)
            assert len(places) == len(axes)
            assert all(len(one) == piece.lanes for one in places)
            lanes += zip(*(one.tolist() for one in places), strict=True)
            if name == "tiles":
                assert piece.lanes <= tile
                assert all(len(set(one.tolist())) == 1 for one, axis in zip(places, axes, strict=True) if axis[2])
            else:
                np.testing.assert_array_equal(places[0], np.arange(axes[0][1]))
        assert sorted(lanes) == list(itertools.product(*(range(size) for _, size, _ in axes)))


# ---- lanes


def test_lanes_of_a_sweep_have_its_values():
    """b of the lane, x1 of the start, d of the flow; y2 follows from the constraint at the value of d."""
    experiment = Experiment.from_text(
        "system: {constraint: disturbed_speed}\n"
        "sweep: {b: {values: [1, 2, 3]}, d: {values: [0.1, 0.2]}, x1: {values: [-1, 1]}}\n"
        "analyses: {poincare: {}}\n"
    )
    b, d, x1 = experiment.axes
    assert [(one.name, one.kind) for one in (b, d, x1)] == [("b", "lane"), ("d", "shared"), ("x1", "start")]
    found = points(experiment, experiment.axes, places_of(Piece(0, (), (1, 1, 0), (3, 2, 2))))
    assert found.system.parameters["d"] == 0.2
    assert {name: values.tolist() for name, values in found.p.items()} == {"b": [2, 2, 3, 3]}
    assert {name: values.tolist() for name, values in found.where.items()} == {
        "b": [2, 2, 3, 3],
        "d": [0.2] * 4,
        "x1": [-1, 1, -1, 1],
    }
    coordinates = found.system.readout.coordinates(found.start, np.zeros(1))
    np.testing.assert_array_equal(np.ravel(coordinates["x1"].data), [-1, 1, -1, 1])


# ---- back to axes

AXES = (axis(0, 3, "lane"), axis(1, 4, "shared"))


def test_lanes_become_axes():
    """With coordinates of the piece alone, and dimensions of their own behind."""
    piece = Piece(0, ("a",), (1, 2), (3, 3))
    data = xr.Dataset({"x": variable((LANE, "strobe"), np.arange(6).reshape(2, 3), "x")}, attrs={"panel": "density"})
    found = to_axes(data, piece, AXES, line=False)
    assert found["x"].dims == ("q0", "q1", "strobe")
    np.testing.assert_array_equal(found["x"].values, np.arange(6).reshape(2, 1, 3))
    np.testing.assert_array_equal(found["q0"], AXES[0].values[1:])
    np.testing.assert_array_equal(found["q1"], AXES[1].values[2:3])
    assert found["q0"].attrs == {"long_name": "parameter q0", "units": "1"}
    assert found.attrs == {"panel": "density"}


@pytest.mark.parametrize("axes", [AXES[:1], AXES])
def test_what_a_line_leaves(axes):
    """Its variables lie along the other axes, where there are some."""
    piece = Piece(0, ("a",), (0, 2)[: len(axes)], (3, 3)[: len(axes)])
    data = xr.Dataset(
        {"level": variable("level", [1, 2], "number"), "delta": variable("level", [4.0, 5.0], "δ")}
        | {"found": variable((), 2, "number of them")}
    )
    found = to_axes(data, piece, axes, line=True)
    others = ("q1",) if len(axes) == 2 else ()
    assert found["delta"].dims == (*others, "level")
    assert found["level"].dims == ("level",)
    assert found["found"].dims == others
    assert found["found"].values.ravel().tolist() == [2]
    assert "q0" not in found


def test_states_over_their_starts():
    """A start coordinate x1 is the dimension start_x1, so that states keep their name."""
    axes = (Axis("x1", np.array([1.0, 2.0]), "position x1", "start"),)
    states = {name: variable((LANE, "strobe"), np.full((2, 1), value), name) for name, value in (("x1", 7), ("x2", 8))}
    data = xr.Dataset(states)
    found = to_axes(data, Piece(0, ("a",), (0,), (2,)), axes, line=False)
    assert found["x1"].dims == ("start_x1", "strobe")
    assert found["x1"].values.tolist() == [[7], [7]]
    assert found["start_x1"].values.tolist() == [1.0, 2.0]
    assert found["start_x1"].attrs["long_name"] == "start value of position x1"


def test_axes_of_an_experiment_are_made_once():
    """Each look at them would try out whether a parameter decides the clock."""
    made = Experiment.from_text(
        "system: {constraint: constant_speed}\nsweep: {b: {values: [1.0, 2.0]}}\nanalyses: {period: {}}\n"
    )
    assert made.axes is made.axes
    assert made.axes[0].values.tolist() == [1.0, 2.0]
