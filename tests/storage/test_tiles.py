"""The folder of a run: who decides, who is kept out, and that a piece is whole and of this run."""

from __future__ import annotations

import dataclasses

import h5py
import numpy as np
import pytest
import xarray as xr

from jaxnh.exceptions import BusyError, DamagedError, ResultError
from jaxnh.storage import tiles
from tests.helpers.storage_jobs import SPENT, job

PLANE = (("b", 4, False), ("d", 2, True))


def test_of_two_processes_the_first_decides(tmp_path):
    one, other = job(PLANE), job(tile=5)
    origin = tiles.Origin("text", None, SPENT)
    assert tiles.publish(tmp_path, one, origin) == one
    assert tiles.publish(tmp_path, other, tiles.Origin("another", "a file", SPENT)) == one
    assert tiles.read_job(tmp_path) == one
    assert tiles.origin(tmp_path) == origin
    (tmp_path / "job.json").write_text("{")
    assert tiles.read_job(tmp_path) is None
    assert tiles.publish(tmp_path, other, origin) == other
    assert [path.name for path in tmp_path.iterdir()] == ["job.json"]


@pytest.mark.parametrize("text", ["", "[]", '{"job": {}}', '{"id": "0", "job": {"order": 3}}', "\x00\xff"])
def test_job_that_is_none(tmp_path, text):
    (tmp_path / "job.json").write_text(text)
    assert tiles.read_job(tmp_path) is None


def test_locks(tmp_path):
    """The whole keeps all others out, a part keeps out the whole and itself; the folder goes if nothing is in it."""
    folder = tmp_path / "result.h5.tiles"
    with tiles.hold(folder), pytest.raises(BusyError), tiles.hold(folder):
        pass
    assert not folder.exists()
    with tiles.hold(folder):
        for part in ((1, 2), (2, 2)):
            with pytest.raises(BusyError, match=f"result.h5, or on part {part[0]}/2"), tiles.hold(folder, part):
                pass
    with tiles.hold(folder, (1, 2)), tiles.hold(folder, (2, 2)):
        with pytest.raises(BusyError), tiles.hold(folder):
            pass
        with pytest.raises(BusyError), tiles.hold(folder, (2, 2)):
            pass
    with tiles.hold(folder):
        (folder / "job.json").write_text("")
    assert (folder / "job.json").exists()


# ---- pieces


@pytest.fixture
def piece_folder(tmp_path):
    """A folder with a piece in it, the second row of a plane, and the job."""
    plan = job(PLANE, tile=4, order=("diagram",))
    piece = plan.cutting.pieces()[1]
    data = xr.Dataset({"x": (("b", "d"), np.ones((4, 1)), {"long_name": "x", "units": "1"})})
    receipt = tiles.write_piece(tmp_path, plan, piece, {"diagram": data}, {"diagram": {"lost": 3}}, SPENT)
    return tmp_path, plan, piece, receipt


def test_piece_says_what_it_is(piece_folder):
    folder, plan, piece, receipt = piece_folder
    assert tiles.check(folder, plan, piece) == receipt
    assert receipt.spent == SPENT
    assert receipt.counts == {"diagram": {"lost": 3}}
    with h5py.File(receipt.path) as file:
        assert file.attrs["title"] == "lanes of a sweep: b 0 to 3 of 4, d 1 to 1 of 2"
        assert file.attrs["axes"] == "b d"
        assert file.attrs["jaxnh_version"] == "0"


def test_piece_of_another_run(piece_folder):
    folder, plan, piece, _ = piece_folder
    other = dataclasses.replace(plan, provenance=dataclasses.replace(plan.provenance, config_sha256="d" * 64))
    with pytest.raises(DamagedError, match="of another config"):
        tiles.check(folder, other, piece)
    with pytest.raises(DamagedError, match="of another run of this config"):
        tiles.check(folder, dataclasses.replace(plan, cutting=dataclasses.replace(plan.cutting, tile=2)), piece)
    for place in ({"begin": (0, 0), "end": (4, 1)}, {"names": ("lyapunov",)}):
        with pytest.raises(DamagedError, match="of another run of this config"):
            tiles.check(folder, plan, piece._replace(**place))
    with pytest.raises(FileNotFoundError):
        tiles.check(folder, plan, plan.cutting.pieces()[0])


@pytest.mark.parametrize("size", [0, 100, 2000])
def test_piece_cut_short(piece_folder, size):
    folder, plan, piece, receipt = piece_folder
    receipt.path.write_bytes(receipt.path.read_bytes()[:size])
    with pytest.raises(DamagedError, match="it is cut off or damaged"):
        tiles.check(folder, plan, piece)


def test_piece_with_a_changed_number(piece_folder):
    folder, plan, piece, receipt = piece_folder
    with h5py.File(receipt.path, "r+") as file:
        file["diagram/x"][2, 0] = 2.0
    with pytest.raises(DamagedError, match=r"^the data of /diagram/x do not fit their checksum"):
        tiles.check(folder, plan, piece)


def test_folder_that_is_gone(tmp_path):
    plan = job()
    with pytest.raises(ResultError, match="is gone"):
        tiles.write_piece(tmp_path / "gone", plan, plan.cutting.pieces()[0], {}, {}, SPENT)
    with pytest.raises(ResultError, match="is gone"):
        tiles.origin(tmp_path / "gone")


def test_what_a_killed_process_left_is_removed(piece_folder):
    """Beside a result: tiles that are all there, or that no job is known of; not those of a run that goes on."""
    folder, plan, _, receipt = piece_folder
    tiles.publish(folder, plan, tiles.Origin("text", None, SPENT))
    tiles.tidy(folder)
    assert receipt.path.exists()
    (folder / "job.json").unlink()
    tiles.tidy(folder)
    assert not receipt.path.exists()
