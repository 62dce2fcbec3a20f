"""A sweep of several axes is its rows, each run by itself, bit for bit, by every way to a result."""

from __future__ import annotations

import copy

import numpy as np
import pytest

import jaxnh
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.executor.programs import Programs
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.plan import clock_of
from jaxnh.engine.session import Session
from tests.flows.double_well import DOUBLE_WELL
from tests.helpers.cases import some_slow
from tests.helpers.commands import run_here
from tests.helpers.comparisons import same_attrs, same_tree
from tests.helpers.experiments import content
from tests.helpers.kept_programs import session_of

pytestmark = pytest.mark.usefixtures("uncalibrated")
B = {"start": 5.2, "stop": 5.6, "count": 5}


def at(said, axis, value):
    """The same with one axis fixed: a parameter in the system, a coordinate in the start state."""
    said = copy.deepcopy(said)
    del said["sweep"][axis]
    place = said.setdefault("initial", {}) if axis in ("x1", "x2", "y1", "y2", "x", "x_dot") else said["system"]
    place[axis] = value
    return said


def values_of(grid):
    return grid["values"] if "values" in grid else np.linspace(grid["start"], grid["stop"], grid["count"])


def tree_of(said):
    return session_of(Experiment.from_dict(said)).tree()


def same_rows(whole, row, axis, place):
    """A group at one place of an axis has the variables of the row run alone, to the bit."""
    cut = whole.isel({axis: place})
    for name, item in row.variables.items():
        ours = cut.variables[name]
        assert ours.dims == item.dims, name
        assert ours.values.tobytes() == np.ascontiguousarray(item.values).tobytes(), name
        assert list(ours.attrs) == list(item.attrs), name
        same_attrs(ours.attrs, item.attrs)


CASES = {
    "b and d": content({"b": B, "d": {"values": [0.05, 0.3]}}),
    "d and b": content({"d": {"values": [0.05, 0.3]}, "b": {"values": [5.2, 5.6]}}),
    "b and x1": content({"b": B, "x1": {"values": [-0.4, 0.2]}}, {"diagram": {"transient": 20, "strobes": 3}}),
    "x1 and b": content({"x1": {"start": -0.4, "stop": 0.4, "count": 5}, "b": {"values": [5.2, 5.3]}}),
    "a and b": content({"a": {"start": 0.4, "stop": 0.6, "count": 5}, "b": {"values": [5.2, 5.3]}}),
    "b and omega": content(
        {"b": {"start": 0.9, "stop": 1.2, "count": 4}, "omega": {"values": [0.5, 2.0]}},
        {"diagram": {"transient": 10, "strobes": 2, "start": "random", "n_starts": 2, "seed": 3, "phase": 0.25}},
        {"constraint": "constant_speed"},
    ),
    "b and c": content({"b": B, "c": {"values": [0.9, 1.1]}}, system={"constraint": "constant_speed"}),
}


@pytest.mark.parametrize("said", some_slow(CASES, "b and x1", "b and omega"))
def test_rows_are_those_run_alone(said):
    """Lane by lane, shared and start axes, in either order; what the rows have besides is there as well."""
    whole = tree_of(said)
    *_, swept = said["sweep"]
    dims = ["start_x1" if name == "x1" else name for name in said["sweep"]]
    assert whole.attrs["axes"].split() == dims
    second = dims[-1]
    for place, value in enumerate(values_of(said["sweep"][swept])):
        alone = tree_of(at(said, swept, float(value)))
        assert set(alone.children) == set(whole.children)
        for name, group in whole.children.items():
            assert tuple(group.dataset.coords[second].dims) == (second,)
            same_rows(group.to_dataset(), alone[name].to_dataset(), second, place)


def test_diagonals_of_three_axes():
    """b by d by x1: each of the lanes is the one of its three values."""
    sweep = {"b": {"values": [5.2, 5.5]}, "d": {"values": [0.05, 0.3]}, "x1": {"values": [-0.4, 0.2, 0.3]}}
    said = content(sweep)
    whole = tree_of(said)["poincare"].to_dataset()
    assert dict(whole.sizes) == {"b": 2, "d": 2, "start_x1": 3, "strobe": 3}
    for d, x1 in ((0, 2), (1, 0)):
        alone = tree_of(at(at(said, "x1", sweep["x1"]["values"][x1]), "d", sweep["d"]["values"][d]))
        plane = whole.isel(start_x1=x1).drop_vars("start_x1")
        same_rows(plane, alone["poincare"].to_dataset(), "d", d)


CRITERIA = {
    "portrait": {"transient": 20, "periods": 1, "samples": 4},
    "verdict": {},
    "lyapunov": {"transient": 8, "periods": 16, "exponents": 1},
    "period": {"max_period": 4, "transient": 16},
    "chaos01": {"transient": 4, "periods": 100},
}


def test_criteria_of_rows():
    """All analyses of independent lanes over b and d, which changes the table of kicks."""
    said = content({"b": B, "d": {"values": [0.1, 0.12]}}, CRITERIA)
    whole = tree_of(said)
    assert set(whole.children) == set(CRITERIA)
    assert whole["verdict"]["kind"].dims == ("b", "d")
    assert whole["lyapunov"]["exponents"].dims == ("b", "d", "exponent")
    for place, d in enumerate((0.1, 0.12)):
        alone = tree_of(at(said, "d", d))
        for name, group in whole.children.items():
            same_rows(group.to_dataset(), alone[name].to_dataset(), "d", place)


def test_lines_along_the_first_axis():
    """A carried diagram and a cascade for each value of the second axis."""
    said = content(
        {"b": {"start": 5.82, "stop": 5.79, "count": 16}, "d": {"values": [0.1, 0.102]}},
        {"diagram": {"transient": 4, "strobes": 2, "start": "up"}, "doubling": {"levels": 1}},
    )
    whole = tree_of(said)
    doubling = whole["doubling"].to_dataset()
    assert doubling["delta"].dims == ("d", "level")
    assert doubling["levels_found"].values.tolist() == [1, 1]
    assert np.diff(doubling["b"].values.ravel()) > 1e-3
    assert whole["diagram"]["x1"].dims == ("b", "d", "strobe")
    for place, d in enumerate((0.1, 0.102)):
        alone = tree_of(at(said, "d", d))
        same_rows(whole["diagram"].to_dataset(), alone["diagram"].to_dataset(), "d", place)
        same_rows(doubling, alone["doubling"].to_dataset(), "d", place)


@pytest.mark.parametrize("second", ["omega", pytest.param("damping", marks=pytest.mark.slow)])
def test_own_system(tmp_path, second, monkeypatch):
    """Its lanes share omega, on which its period depends, and differ in damping.

    Steps are written out, as of a large sweep: in a loop a number that all lanes share, as the damping where it is no
    axis, is rounded with other numbers that they share before it meets those of a lane.
    """
    monkeypatch.setattr("jaxnh.engine.accuracy.cost_model.quickest_form", lambda solver, *_: solver)
    (tmp_path / "own.py").write_text(DOUBLE_WELL)
    system = {"file": str(tmp_path / "own.py"), "damping": 0.25}
    values = {"omega": [1.0, 1.5], "damping": [0.2, 0.25]}[second]
    sweep = {"drive": {"values": [0.3, 0.35, 0.4]}, second: {"values": values}}
    said = content(sweep, system=system, accuracy={"solver": "tsit5", "steps": 60}, initial={"x": 0.5})
    whole, periods = tree_of(said), 2 * np.pi
    assert whole["poincare"].attrs["axes"] == f"drive {second}"
    if second == "omega":
        periods = 2 * np.pi / np.array(values)
        assert whole["poincare"]["t"].dims == ("omega", "strobe")
    np.testing.assert_allclose(whole.attrs["strobe_period"], periods, rtol=1e-15)
    for place, value in enumerate(values):
        alone = tree_of(at(said, second, value))
        np.testing.assert_array_equal(alone.attrs["strobe_period"], np.broadcast_to(periods, 2)[place])
        same_rows(whole["poincare"].to_dataset(), alone["poincare"].to_dataset(), second, place)


# ---- what a result says


def test_strobe_period_of_each_value():
    """A number where all lanes have the same, else one for each value of the axes that lanes share."""
    for name, periods in {"b and omega": [4 * np.pi, np.pi], "b and d": 2 * np.pi, "b and c": 2 * np.pi}.items():
        experiment = Experiment.from_dict(CASES[name])
        np.testing.assert_array_equal(clock_of(experiment, experiment.axes).period, periods)


def test_rows_share_their_programs():
    """More values of an axis that lanes share are more calls of the same programs."""
    counts, programs = [], Programs()
    for d in (np.linspace(0.1, 0.2, count).tolist() for count in (5, 6)):
        session = Session(Experiment.from_dict(content({"b": B, "d": {"values": d}})))
        session._lanes = LaneExecutor(programs=programs)
        session.tree()
        counts.append(len(programs))
    assert 0 < counts[0] == counts[1]


# ---- every way

WAYS = content(
    {"b": {"start": 5.2, "stop": 5.45, "count": 6}, "d": {"values": [0.1, 0.105, 0.11]}},
    {
        "diagram": {"transient": 30, "strobes": 3, "start": "up"},
        "chaos01": {"transient": 30, "periods": 100},
        "poincare": {"transient": 130, "strobes": 2},
    },
)
PIECES = 3 * 2 + 3  # tiles of four and of two values of b for each d, and a line for each


@pytest.fixture(scope="module")
def experiment():
    return Experiment.from_dict(WAYS)


@pytest.fixture(scope="module")
def whole(experiment):
    """The result in memory."""
    return session_of(experiment).tree()


def same_file(path, whole):
    """A file has what is in memory."""
    with jaxnh.open_result(path) as tree:
        same_tree(tree, whole)


def command(folder, *arguments):
    (folder / "job.yaml").write_text(Experiment.from_dict(WAYS).text)
    done = run_here("job.yaml", "--output", "job.h5", "--tile", 4, *arguments, cwd=folder)
    assert done.returncode == 0, done.stderr
    return done


def test_lanes_of_ways_are_chaotic(whole):
    """What these tests rest on: a bit that differs has grown as large as the attractor."""
    x1 = whole["poincare"]["x1"].values
    assert np.median(np.abs(np.diff(x1[..., -1], axis=0))) > 0.01


def test_tiles(tmp_path, whole):
    done = command(tmp_path)
    assert "chaos01, poincare: 6 tiles" in done.stderr
    same_file(tmp_path / "job.h5", whole)


def test_parts_and_merge(tmp_path, whole):
    """One part after the other; `test_level_files` has two axes on workers of Dask."""
    for k in (1, 2):
        done = command(tmp_path, "--part", f"{k}/2")
        assert done.stdout.startswith(f"part {k}/2: ")
        assert done.stdout.endswith(f" of {PIECES} tiles\n")
    command(tmp_path, "--merge")
    same_file(tmp_path / "job.h5", whole)


def test_stopped_and_resumed(tmp_path, experiment, whole):
    """Stopped by the progress callback after each few tiles."""
    path, stops = tmp_path / "job.h5", 0
    tiles = tmp_path / "job.h5.tiles"

    def stop(label, done, total):
        if len(list(tiles.glob("0*.h5"))) >= 3 * stops:
            raise jaxnh.Stopped("enough for now")

    for stops in (1, 2):
        with pytest.raises(jaxnh.Stopped, match=rf"enough for now with \d of {PIECES} tiles done"):
            jaxnh.run(experiment, path, progress=stop, tile=4)
        assert not path.exists()
        assert len(list(tiles.glob("0*.h5"))) >= 3 * stops
    jaxnh.run(experiment, path, tile=4)
    assert not tiles.exists()
    same_file(path, whole)
