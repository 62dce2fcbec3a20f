"""Pieces of a sweep: every analysis has the same bits whatever it is cut into."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from jaxnh.analyses import ANALYSES
from jaxnh.config.experiment import Experiment
from jaxnh.engine import plan as work
from jaxnh.engine.lanes import Lanes
from jaxnh.storage.pieces import Piece

COUNT = 600
HEAD = f"""\
system: {{constraint: constant_speed}}
sweep: {{b: {{start: 5.2, stop: 5.45, count: {COUNT}}}}}
accuracy: {{solver: blanes_moan6, steps: 40}}
analyses:
"""
# Each with few periods, but enough for chaos to show a bit that differs; `verdict` brings the criteria it needs.
OPTIONS = {
    "verdict": "{}\n  lyapunov: {transient: 8, periods: 32}\n  period: {limit: 4, transient: 16}\n  chaos01: {transient: 4, periods: 100}",
    "lyapunov": "{transient: 16, periods: 32, error: 0.05, exponents: 2}",
    "diagram": "{transient: 30, strobes: 3, start: random, starts: 3, seed: 5, phase: 0.25}",
    "poincare": "{transient: 30, strobes: 4}",
    "portrait": "{transient: 30, periods: 1, samples: 4}",
}


def decided(text, lanes, tile):
    """An experiment and the job of its sweep."""
    experiment = Experiment.from_text(text)
    return experiment, work.decide(experiment, lanes, tile)


def compute(experiment, job, batch, lanes):
    return work.compute(experiment, experiment.axes, experiment.requested(), job, batch, lanes)


@pytest.fixture(scope="module")
def runners():
    return {count: Lanes(devices=jax.devices("cpu")[:count]) for count in (1, 2)}


@pytest.mark.parametrize("name", OPTIONS)
def test_pieces_are_rows_of_the_whole(runners, name):
    """Odd pieces on one device against all lanes at once on two: every variable over b, and every other one.

    All criteria together are compiled for two devices alone, which takes long enough.
    """
    experiment, job = decided(f"{HEAD}  {name}: {OPTIONS[name]}\n", runners[2], 1 << 20)
    [whole] = compute(experiment, job, job.pieces(), runners[2])
    assert set(whole.groups) == set(job.independent)
    for first, end in ((0, 1), (37, 300), (COUNT - 2, COUNT)):
        runner = runners[2 if name == "verdict" else 1]
        [done] = compute(experiment, job, [Piece(0, job.independent, (first,), (end,))], runner)
        for key, group in done.groups.items():
            assert set(group.variables) == set(whole.groups[key].variables)
            for variable_name, item in group.variables.items():
                expected = whole.groups[key].variables[variable_name]
                rows = expected.values[first:end] if expected.dims[0] == "b" else expected.values
                assert item.values.tobytes() == np.ascontiguousarray(rows).tobytes(), (key, variable_name)
                assert item.dims == expected.dims


def test_pieces_computed_together_are_those_computed_alone(runners):
    """Neighbouring tiles as one call, cut afterwards; what is counted is counted in each."""
    experiment, job = decided(f"{HEAD}  verdict: {OPTIONS['verdict']}\n", runners[2], 100)
    neighbours = job.pieces()[1:4]
    together = compute(experiment, job, neighbours, runners[2])
    for piece, one in zip(neighbours, together, strict=True):
        [alone] = compute(experiment, job, [piece], runners[2])
        assert one.counts == alone.counts
        assert sum(one.counts["verdict"].values()) == 100
        for key, group in alone.groups.items():
            for name, item in group.variables.items():
                np.testing.assert_array_equal(one.groups[key].variables[name].values, item.values)
    assert sum(one.spent.lane_periods for one in together) > 300 * 100


def test_every_analysis_says_whether_its_lanes_are_independent():
    """What carries something from lane to lane is run along the whole first axis."""
    whole = {name for name, a in ANALYSES.items() if not a.independent(a.options())}
    assert whole == {"doubling"}
    for start, independent in (("fixed", True), ("random", True), ("up", False), ("down", False)):
        options = ANALYSES["diagram"].options(start=start)
        assert ANALYSES["diagram"].independent(options) == independent
<<<<<<< HEAD


# ---- how a sweep is cut


@pytest.mark.parametrize(
    ("periods", "numbers", "lanes", "tile"),
    [
        (20, 32, 10**6, 65536),  # 2e6 lane-periods are 100,000 lanes
        (640, 512, 4096, 2048),
        (10_000, 64, 10**5, 128),
        (528, 16 * 65536 * 4, 10**5, 16),  # a lane of 34 MB
        (1e6, 64, 10**7, 512),  # no more than 16,384 tiles: 610 lanes each
    ],
)
def test_lanes_a_tile(periods, numbers, lanes, tile):
    assert pieces.tile_lanes(periods, numbers, lanes) == tile


def job(lanes=10, tile=4, order=("diagram", "doubling"), independent=("diagram",)):
    decided = ("blanes_moan6", 40, False, 1e-6, {"lyapunov": {"parts": 4}})
    return Job("c" * 64, {"jaxnh": "0"}, *decided, order, independent, (("b", lanes, False),), tile)


def test_pieces_cover_the_sweep():
    found = job().pieces()
    assert [(piece.begin[0], piece.end[0]) for piece in found] == [(0, 4), (4, 8), (8, 10), (0, 10)]
    assert [piece.names for piece in found] == [("diagram",)] * 3 + [("doubling",)]
    lines = [Piece(0, ("diagram",), (0,), (10,)), Piece(1, ("doubling",), (0,), (10,))]
    assert job(independent=()).pieces() == lines


@pytest.mark.parametrize("parts", [1, 2, 3, 7, 50])
def test_parts_share_all_pieces(parts):
    every = job(lanes=100).pieces()
    shares = [pieces.share(every, (k, parts)) for k in range(1, parts + 1)]
    assert [piece for share in shares for piece in share] == every
    assert max(map(len, shares)) - min(map(len, shares)) <= 1


# ---- the folder


def test_of_two_processes_the_first_decides(tmp_path):
    one, other = job(), job(tile=5)
    origin = tiles.Origin("text", None, SPENT)
    assert tiles.publish(tmp_path, one, origin) == one
    assert tiles.publish(tmp_path, other, tiles.Origin("another", "a file", SPENT)) == one
    assert tiles.read_job(tmp_path) == one
    assert tiles.origin(tmp_path) == origin
    (tmp_path / "job.json").write_text("{")
    assert tiles.read_job(tmp_path) is None
    assert tiles.publish(tmp_path, other, origin) == other
    assert [path.name for path in tmp_path.iterdir()] == ["job.json"]


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


# ---- merging


def written(first, end, width, seed=3):
    """A group of lanes as an analysis leaves it: variables over b of several kinds, and one without b."""
    x = np.random.default_rng(seed).normal(size=(10_000, width))
    x[7, 0] = np.nan
    return xr.Dataset(
        {
            "x1": variable(("b", "strobe"), x[first:end], "position"),
            "kind": variable("b", (np.arange(10_000) % 3).astype(np.int8)[first:end], "kind"),
        },
        coords={
            "b": variable("b", np.linspace(1, 2, 10_000)[first:end], "coupling b"),
            "t": variable("strobe", np.arange(width) / 3, "time"),
        },
        attrs={"start": "fixed"},
    )


@pytest.mark.parametrize(("tile", "width"), [(1024, 40), (1000, 40), (128, 3), (4096, 3), (20_000, 40)])
def test_merged_file_is_the_file_written_at_once(tmp_path, tile, width):
    """Blocks that go over as they are and blocks that do not, whatever the tile: data, order and attributes."""
    plan = job(10_000, tile, ("diagram",))
    for piece in plan.pieces():
        tiles.write_piece(tmp_path, plan, piece, {"diagram": written(piece.begin[0], piece.end[0], width)}, {}, SPENT)
    merged, plain = tmp_path / "merged.h5", tmp_path / "plain.h5"
    attrs = {"title": "t", "jaxnh_version": "0", "axes": "b"}
    merge.merge(merged, attrs, tmp_path, plan, {"diagram": Extra({"not_finite": 1}, ("one is lost",))})
    store.write(plain, attrs, {"diagram": written(0, 10_000, width)})
    store.verify(merged)
    with h5py.File(merged) as one, h5py.File(plain) as other:
        ours, expected = store.variables(one["diagram"]), store.variables(other["diagram"])
        assert list(ours) == list(expected)
        for name, item in expected.items():
            assert (ours[name].dtype, ours[name][()].tobytes()) == (item.dtype, item[()].tobytes())
            assert store.attributes(one["diagram"][name]) == store.attributes(other["diagram"][name])
            assert store.dimensions(one["diagram"][name]) == store.dimensions(other["diagram"][name])
        assert store.attributes(one["diagram"]) == {"start": "fixed", "not_finite": 1, "warnings": "one is lost"}
        assert one["diagram/x1"].fletcher32
        assert one["diagram/x1"].shuffle
        assert one["diagram/x1"].compression == "gzip"


def test_damaged_piece_is_named_while_merging(tmp_path):
    plan = job(3000, 1024, ("diagram",))
    for piece in plan.pieces():
        tiles.write_piece(tmp_path, plan, piece, {"diagram": written(piece.begin[0], piece.end[0], 40)}, {}, SPENT)
    bad = plan.pieces()[1]
    path = tiles.piece_path(tmp_path, bad)
    with h5py.File(path) as file:
        chunk = file["diagram/x1"].id.get_chunk_info(0)
    content = bytearray(path.read_bytes())
    content[chunk.byte_offset + chunk.size // 2] ^= 16
    path.write_bytes(content)
    with pytest.raises(DamagedError):
        tiles.check(tmp_path, plan, bad)
    with pytest.raises(merge.DamagedPieceError) as caught:
        merge.merge(tmp_path / "merged.h5", {}, tmp_path, plan, {"diagram": Extra({}, ())})
    assert caught.value.piece == bad
    assert not (tmp_path / "merged.h5").exists()
=======
>>>>>>> h-engtests
