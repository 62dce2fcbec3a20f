"""Results of calls that a stopped run has left: found by a run of the same job alone, and up to where they are sound."""

from __future__ import annotations

import resource
from unittest import mock

import numpy as np
import pytest

from jaxnh.storage import calls as storage
from jaxnh.storage.calls import CallJournal, JournalEntry, interrupted_batches
from tests.helpers.storage_jobs import job

JOB = job(tile=2)
PIECES = JOB.cutting.pieces()[1:3]
RNG = np.random.default_rng(0)


def part(call, first, lanes=3, digest="d"):
    """Results of different types and shapes, a NaN and an infinity among them."""
    numbers = RNG.normal(size=(lanes, 2))
    numbers[0] = np.nan, -np.inf
    return JournalEntry(call, first, digest, (numbers, np.arange(lanes), numbers[:, 0] > 0, numbers.T.copy().T))


def same(found, expected):
    assert [p[:3] for p in found] == [p[:3] for p in expected]
    for one, other in zip(found, expected, strict=True):
        for a, b in zip(one.leaves, other.leaves, strict=True):
            assert (a.dtype, a.shape) == (b.dtype, b.shape)
            assert a.tobytes() == b.tobytes()


@pytest.fixture
def parts():
    return [part(0, 0), part(0, 3), part(1, 0), part(1, 5), part(2, 0)]


@pytest.fixture
def folder(tmp_path, parts):
    """A folder in which each part is a record."""
    kept = CallJournal(tmp_path, JOB, PIECES)
    for one in parts:
        kept.add(one)
        kept.flush()
    kept.close(remove=False)
    return tmp_path


def test_what_is_kept_is_found(folder, parts):
    """From the first lane on without a gap, bit for bit, and of the same call with the same arguments alone."""
    kept = CallJournal(folder, JOB, PIECES)
    same(kept.take_entries(0, "d"), parts[:2])
    same(kept.take_entries(1, "d"), parts[2:3])
    assert kept.take_entries(2, "other") == []
    assert kept.take_entries(3, "d") == []
    assert kept.seconds > 0
    assert interrupted_batches(folder, JOB) == [[piece.number for piece in PIECES]]


def test_of_another_job_or_other_pieces(folder):
    assert interrupted_batches(folder, job(tile=3)) == []
    for kept in (CallJournal(folder, job(tile=3), PIECES), CallJournal(folder, JOB, PIECES[:1])):
        assert kept.take_entries(0, "d") == []
        assert kept.seconds == 0
    kept.add(part(0, 0))  # what is written of others takes its place
    kept.close(remove=False)
    assert interrupted_batches(folder, JOB) == [[PIECES[0].number]]


@pytest.mark.parametrize("damage", ["cut", "bit", "tail"])
def test_damaged_record(folder, parts, damage):
    """What stands before it is found, and a later run writes on from there."""
    [path] = folder.glob("*.calls")
    data = bytearray(path.read_bytes())
    if damage == "cut":
        del data[-20:]
    elif damage == "bit":
        data[-20] ^= 1
    else:
        data += data[:50]
    path.write_bytes(data)
    kept = CallJournal(folder, JOB, PIECES)
    last = parts[4:] if damage == "tail" else []
    same(kept.take_entries(2, "d"), last)
    kept.add(parts[4])
    kept.close(remove=False)
    again = CallJournal(folder, JOB, PIECES)
    same(again.take_entries(0, "d"), parts[:2])
    same(again.take_entries(2, "d"), parts[4:])


def test_written_every_few_seconds(tmp_path, parts):
    """Not sooner, as most pieces are done by then; many bytes wait longer."""
    with mock.patch("time.monotonic") as clock:
        clock.return_value = 100.0
        kept = CallJournal(tmp_path, JOB, PIECES)
        clock.return_value = 104.9
        kept.add(parts[0])
        assert list(tmp_path.iterdir()) == []
        clock.return_value = 105.1
        with mock.patch.object(storage, "_BYTES", 10):
            kept.add(parts[1])
        assert list(tmp_path.iterdir()) == []
        kept.add(parts[2])
        assert len(list(tmp_path.iterdir())) == 1
        assert CallJournal(tmp_path, JOB, PIECES).seconds == pytest.approx(5.1)
    kept.close(remove=True)
    assert list(tmp_path.iterdir()) == []


def test_two_at_the_same_pieces(tmp_path, parts):
    """The first one's file stays as it is; the second keeps nothing, and does not fail."""
    one, other = CallJournal(tmp_path, JOB, PIECES), CallJournal(tmp_path, JOB, PIECES)
    one.add(parts[0])
    one.flush()
    other.add(parts[2])
    other.flush()
    one.add(parts[1])
    other.close(remove=False)
    one.close(remove=False)
    found = CallJournal(tmp_path, JOB, PIECES)
    same(found.take_entries(0, "d"), parts[:2])
    assert found.take_entries(1, "d") == []


def test_no_room(folder, parts):
    """A disk that is full is no reason to end: tiles may still fit. Half a record is not left, nor what it took."""
    kept = CallJournal(folder, JOB, PIECES)
    kept.add(parts[3])
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    [path] = folder.iterdir()
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 50, before[1]))
    try:
        kept.flush()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(folder.iterdir()) == []
    kept.add(parts[4])
    kept.close(remove=False)
    assert list(folder.iterdir()) == []
