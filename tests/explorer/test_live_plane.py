"""Planes that are computed: coarse, then all lanes; nothing compiled by a zoom; the saved config gives the same numbers."""

from __future__ import annotations

from dataclasses import replace
from unittest import mock

import numpy as np
import pytest

import jaxnh
from jaxnh.engine.progress import NullProgress
from jaxnh.exceptions import InputError
from jaxnh.explorer.lattice import Lattice, blocks
from jaxnh.explorer.live import live
from jaxnh.explorer.quantities import analyses_of
from jaxnh.explorer.view import View
from tests.flows.known_maps import HENON
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.usefixtures("uncalibrated")
CONFIG = {
    "system": {"constraint": "constant_speed"},
    "sweep": {"b": {"start": 4.0, "stop": 6.0, "count": 8}, "a": {"start": 0.4, "stop": 0.6, "count": 8}},
    "accuracy": {"solver": "blanes_moan6", "steps": 60},
    "analyses": {"lyapunov": {"transient": 32, "periods": 32}, "diagram": {}},
}
COLUMNS = 160  # of a diagram: 32 of the plane, which has 24 rows


@pytest.fixture(scope="module")
def plane():
    return live(jaxnh.Experiment.from_dict(CONFIG), NullProgress(), COLUMNS)


def test_a_coarse_picture_comes_before_all_lanes_and_a_zoom_compiles_nothing(plane):
    first = list(plane.passes(plane.first))
    assert first[0].words.startswith("coarse: ")  # of how many lanes, depends on the number of devices
    assert [picture.data is None for picture in first] == [True] * (len(first) - 1) + [False]
    before = plane.sessions.compiled
    zoomed = plane.first.zoom(4.1, 4.3, (0.52, 0.53))
    *_, last = plane.passes(zoomed)
    assert plane.sessions.compiled == before
    assert last.words == "32 × 24 lanes"
    for name, values in zoomed.grid().items():
        assert np.array_equal(last.data["lyapunov"][name], values)


def test_the_saved_config_gives_the_same_numbers(plane):
    view = plane.first.zoom(5.31, 5.32, (0.5, 0.51))
    *_, last = plane.passes(view)
    batch = jaxnh.run(jaxnh.Experiment.from_text(plane.batch_text(view)))["lyapunov"]
    for name in ("b", "a", "exponents", "exponents_error"):
        assert np.array_equal(batch[name], last.data["lyapunov"][name])


def test_quantities_are_those_that_go_with_the_system_those_asked_for_first():
    asked = jaxnh.Experiment.from_dict({**CONFIG, "analyses": {"period": {}, "verdict": {}}})
    assert list(live(asked, NullProgress(), COLUMNS).variables) == ["period", "verdict", "lyapunov", "chaos01"]


@pytest.mark.slow  # a click on a map is quick, and the matrix has exponents and portraits in time alone
def test_a_flow_without_clock_and_section_has_exponents_and_a_portrait():
    """A click gives what goes without strobe points; exponents add up to the divergence, a constant."""
    sweep = "sweep={rho: {start: 20, stop: 30, count: 4}, sigma: {start: 9, stop: 11, count: 4}}"
    nowhere = ["system={file: lorenz.py}", sweep, "section=null", "analyses={lyapunov: {}}"]
    plane = live(jaxnh.load(ROOT / "configs/flows/lorenz.yaml", nowhere), NullProgress(), COLUMNS)
    assert list(plane.variables) == ["lyapunov"]
    first, last = plane.lane(plane.first, {"rho": 28.0, "sigma": 10.0})
    assert list(first.groups) == ["portrait"]
    assert list(last.groups) == ["portrait", "lyapunov"]
    spectrum = last.groups["lyapunov"]
    within = float(spectrum["exponents_error"].sum())
    assert within < 0.1
    assert float(spectrum["exponents"].sum()) == pytest.approx(-(10.0 + 1.0 + 8.0 / 3.0), abs=within)


def test_a_diagram_of_two_axes_becomes_a_plane_and_says_so():
    diagram = jaxnh.Experiment.from_dict({**CONFIG, "analyses": {"diagram": {}}})
    found = live(diagram, NullProgress(), COLUMNS)
    assert found.first.second == "a"
    assert analyses_of("lyapunov", found.sessions.own) == {"lyapunov": {"exponents": 1}}


def test_basins_of_random_starts_are_no_plane():
    basins = {"n_starts": 16, "box": {"x1": [-1.0, 1.0]}}
    with pytest.raises(InputError, match=r"basins\.n_starts: explore shows basins over start states, a lane each"):
        live(jaxnh.Experiment.from_dict({**CONFIG, "analyses": {"basins": basins}}), NullProgress(), COLUMNS)


def test_a_plane_of_starts_is_one_of_its_coordinates():
    starts = {"x1": {"start": -1.0, "stop": 1.0, "count": 4}, "y1": {"start": -1.0, "stop": 1.0, "count": 4}}
    system = {"constraint": "constant_speed", "b": 5.4}
    found = live(
        jaxnh.Experiment.from_dict({**CONFIG, "system": system, "sweep": starts, "analyses": {"basins": {}}}),
        NullProgress(),
        COLUMNS,
    )
    assert next(iter(found.variables)) == "basins"
    assert found.first.ranges == {"x1": (-1.0, 1.0), "y1": (-1.0, 1.0)}
    assert jaxnh.Experiment.from_text(found.batch_text(found.first)).requested()[0][0].name == "basins"


def test_every_lane_is_wanted_once():
    shape, seen = (21, 10), np.zeros((21, 10), int)
    for step in (8, 4, 2, 1):
        for places in blocks(shape, step, lambda: 12, first=step == 8):
            seen[np.ix_(*places)] += 1
    assert np.all(seen == 1)


def test_blocks_grow_as_they_are_allowed_to_and_none_is_a_small_rest():
    most = iter([20, 40, 200])
    sizes = [len(columns) * len(rows) for columns, rows in blocks((10, 21), 1, lambda: next(most), first=True)]
    assert sizes == [20, 40, 150]
    assert [len(rows) for _, rows in blocks((10, 21), 1, lambda: 100, first=True)] == [7, 7, 7]


def test_a_block_that_took_little_time_is_followed_by_a_larger_one():
    live_plane = live(jaxnh.Experiment.from_dict(CONFIG), NullProgress(), COLUMNS)
    session, view, sizes = mock.Mock(devices=2), live_plane.first, []
    for lanes, seconds in ((500, 0.9), (1000, 1.2), (100, 0.5), (2000, 2.5), (2000, 7.0), (100, 7.0)):
        live_plane._adapt(view, session, lanes, seconds)
        sizes.append(live_plane._lanes_of_a_block(view, session))
    assert sizes == [1000, 2000, 2000, 2000, 1000, 512]


def test_a_lane_stands_for_its_neighbours_until_these_are_known():
    view = View("b", 0.0, 7.0, "period", (0.0, 5.0), "a", columns=8, rows=6)
    lattice, number = Lattice(view, {"b": "b", "a": "a"}), lambda b, a: 10 * b + a
    for step in (4, 1):
        for places in blocks((8, 6), step, lambda: 1000, first=True):
            at = {name: values[place] for (name, values), place in zip(view.grid().items(), places, strict=True)}
            lattice.put(dataset(number, **at), places, step)
        if step == 4:
            nearest = number(4.0 * (np.arange(8)[:, None] >= 2), 4.0 * (np.arange(6) >= 2))
            assert np.array_equal(lattice.dataset()["period"], nearest)
    assert np.array_equal(lattice.dataset()["period"], number(np.arange(8.0)[:, None], np.arange(6.0)))


def dataset(number, b, a):
    import xarray as xr

    return xr.Dataset({"period": (("a", "b"), number(b[None, :], a[:, None]))}, {"b": b, "a": a})


def test_a_moved_parameter_is_that_of_the_saved_config(plane):
    view = replace(plane.first, fixed={"c": 1.2})
    next(plane.passes(view))
    assert jaxnh.Experiment.from_text(plane.batch_text(view)).system.c == 1.2


@pytest.mark.slow  # planes of flows are quick, and maps are in the matrix
def test_a_map_has_no_solver_to_write_down(tmp_path):
    """A click gives its iterates, and the batch job of a view is the same to the bit."""
    (tmp_path / "own.py").write_text(HENON)
    (tmp_path / "own.yaml").write_text(
        "system: {file: own.py}\ninitial: {x: 0.1}\nsweep: {a: {start: 0.9, stop: 1.2, count: 4}, "
        "b: {start: 0.1, stop: 0.3, count: 4}}\nanalyses: {lyapunov: {transient: 64, periods: 128}}\n"
    )
    plane = live(jaxnh.load(tmp_path / "own.yaml"), NullProgress(), COLUMNS)
    first, last = plane.lane(plane.first, {"a": 1.0, "b": 0.2})
    assert list(first.groups) == ["poincare", "period"]
    assert int(last.groups["verdict"]["status"]) == 0
    view = plane.first
    *_, drawn = plane.passes(view)
    assert "accuracy" not in plane.batch_text(view)
    assert any("iterates of a map" in note for note in drawn.notes)
    batch = jaxnh.run(jaxnh.Experiment.from_text(plane.batch_text(view), HENON))["lyapunov"]
    assert np.array_equal(batch["exponents"], drawn.data["lyapunov"]["exponents"])
