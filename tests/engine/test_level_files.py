"""Levels of a sweep on disk: a result at each of them, and the same bits however the run was stopped or shared out."""

from __future__ import annotations

import functools
from unittest import mock

import pytest

import jaxnh
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.output import is_there
from jaxnh.engine.plan import decide
from jaxnh.engine.progress import NullProgress
from jaxnh.engine.run import run_to_file
from jaxnh.engine.run_records import RunOptions
from jaxnh.engine.verification import sample
from jaxnh.exceptions import Stopped
from jaxnh.plotting.reading import load_result
from jaxnh.storage import tiles
from jaxnh.storage.hdf5 import read_attrs, read_group, verify
from tests.helpers.comparisons import same_tree
from tests.helpers.jobs import content
from tests.helpers.kept_programs import lanes_with_kept_programs, session_of
from tests.helpers.level_sweeps import PERIOD, WIDE, sweep_content

pytestmark = pytest.mark.usefixtures("uncalibrated")
EXPERIMENT = Experiment.from_dict(sweep_content(WIDE, {"count": 3, "refine": "boundary"}, PERIOD))


@functools.cache
def _job(tile, parts):
    return decide(EXPERIMENT, lanes_with_kept_programs(), tile, parts)


def _decided(experiment, lanes, tile, parts, machine, *, asked):
    """What is decided for the whole sweep, once for all tests."""
    return _job(tile, parts)


def run(path, check=lambda: None, **how):
    with (
        mock.patch("jaxnh.engine.run.LaneExecutor", lanes_with_kept_programs),
        mock.patch("jaxnh.engine.run.decide", _decided),
    ):
        return run_to_file(EXPERIMENT, path, RunOptions(tile=32, **how), NullProgress(), check)


def numbers(path):
    """All groups and variables, without what only says how a run went."""
    return {name: item for name, item in content(path).items() if name != "/"}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The result of a run that nothing has stopped."""
    path = tmp_path_factory.mktemp("levels") / "whole.h5"
    run(path)
    return path


def test_result_is_that_in_memory(whole):
    ours = load_result(whole)
    same_tree(ours, session_of(EXPERIMENT).tree())
    share = 100 * float(ours["period"]["computed"].mean())
    assert f"level 3 of 3, {share:.3g} % of the points computed" in jaxnh.figure(ours).get_supxlabel()
    assert (ours.attrs["level"], ours.attrs["levels"], ours.attrs["refine"]) == (3, 3, "boundary")
    assert not whole.with_name("whole.h5.tiles").exists()


def test_result_at_each_level(tmp_path, whole):
    """A file that can be read, over the values that the level has; it is not taken for the result."""
    path, seen = tmp_path / "a.h5", {}

    def look():
        if path.is_file():
            level = int(read_attrs(path)["level"])
            if level not in seen:
                seen[level] = read_group(path, "period")
                verify(path)
                assert is_there(EXPERIMENT, path, fresh=False) == (level == 3)

    run(path, look)
    look()
    assert sorted(seen) == [1, 2, 3]
    finest = seen[3]
    for level, group in seen.items():
        step = 2 ** (3 - level)
        assert group["period"].shape == (-(-33 // step), -(-9 // step))
        here = group["computed"].to_numpy()
        assert here.all() == (level == 1)
        same = group["period"].to_numpy() == finest["period"].to_numpy()[::step, ::step]
        assert same[here].all()
    assert numbers(path) == numbers(whole)


@pytest.mark.parametrize("count", [1, 5, 14])
def test_stopped_and_resumed(tmp_path, whole, count):
    """Stopped where so many tiles are there, on each of the levels and between them."""
    path = tmp_path / "a.h5"

    def stop():
        if len(list(tiles.folder_of(path).glob("0*.h5"))) >= count:
            raise Stopped("stopped")

    with pytest.raises(Stopped):
        run(path, stop)
    run(path)
    assert numbers(path) == numbers(whole)


def test_damaged_level_is_made_again(tmp_path, whole):
    path = tmp_path / "a.h5"
    folder = tiles.folder_of(path)

    def stop():
        if (folder / "level-1.h5").is_file():
            raise Stopped("stopped")

    with pytest.raises(Stopped):
        run(path, stop)
    (folder / "level-1.h5").write_bytes(b"nothing")
    run(path)
    assert numbers(path) == numbers(whole)


@pytest.mark.slow
def test_four_parts(tmp_path, whole):
    """A part goes on to the next level once the others have done theirs; then they are joined."""
    path = tmp_path / "a.h5"
    waits = []
    for _ in range(3):  # as often as there are levels, whoever comes last in one
        for k in range(1, 5):
            try:
                run(path, part=(k, 4))
            except Stopped as end:
                waits.append(str(end))
    assert all(" tiles of other parts are not" in said for said in waits)
    assert waits[0].startswith("part 1/4 of level 1 of 3 is done, and ")
    run(path, merge=True)
    assert numbers(path) == numbers(whole)


@pytest.mark.slow
def test_two_workers(tmp_path, whole):
    path = tmp_path / "a.h5"
    run(path, dask="local:2")
    assert numbers(path) == numbers(whole)


def test_sample_is_run_again(whole):
    """Of lanes that were computed alone."""
    again, differ = sample(whole)["period"]
    assert 0 < again <= 3 * 16
    assert differ == 0
