"""Planes of more lanes than pixels: blocks of lanes by their rules, overviews made once and beside, and few bytes read."""

from __future__ import annotations

import gc
from collections import Counter
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

import jaxnh
from jaxnh.explorer import recording, tiled_plane
from jaxnh.explorer.lane_blocks import lane_blocks, merge_blocks
from jaxnh.explorer.raster import PlaneEdges, plane_raster
from jaxnh.explorer.recording import open_recording, source_of
from jaxnh.explorer.tiled_plane import CHAOS, TiledPlane
from jaxnh.plotting.pixels import flag_pixels
from sweeps.timing.explore_tiles import make_chart
from tests.helpers.hand_made_results import dataset, tree

COUNT = 2100  # lanes of each axis: more than are read at once


@pytest.fixture(scope="module")
def chart(tmp_path_factory):
    path = tmp_path_factory.mktemp("tiles") / "chart.h5"
    make_chart(path, COUNT)
    return path


@pytest.fixture
def short(monkeypatch):
    """A page of few pixels, and few lanes read at once."""
    monkeypatch.setattr(recording, "MOST_CELLS", 30)
    monkeypatch.setattr(tiled_plane, "MOST_CELLS", 30)
    monkeypatch.setattr(tiled_plane, "_AT_ONCE", 1000)


def naive(values, size):
    """Blocks of lanes one by one."""
    rows, columns = (range(0, count, size) for count in values.shape)
    return [[values[i : i + size, j : j + size].ravel() for j in columns] for i in rows]


def test_a_block_of_numbers_has_the_mean_of_those_that_are_finite():
    values = np.random.default_rng(0).normal(size=(23, 37))
    values[4:8, 8:12], values[0, 0] = np.nan, np.inf
    every = lane_blocks(values, "mean", [(2, 2), (2, 2), (2, 2)])
    for blocks, size in zip(every, (2, 4, 8), strict=True):
        for mine, share, row in zip(blocks.values, blocks.share, naive(values, size), strict=True):
            finite = [lanes[np.isfinite(lanes)] for lanes in row]
            expected = [np.mean(lanes) if len(lanes) else np.nan for lanes in finite]
            assert mine == pytest.approx(expected, abs=1e-14, nan_ok=True)
            assert share == pytest.approx([len(a) / len(b) for a, b in zip(finite, row, strict=True)])
    assert np.isnan(every[1].values[1, 2])


@pytest.mark.parametrize("dtype", [np.int8, np.int32, float])
def test_a_block_of_categories_has_the_most_frequent_and_its_share(dtype):
    values = np.random.default_rng(1).choice([-1, 0, 3, 100], p=[0.1, 0.2, 0.4, 0.3], size=(19, 26)).astype(dtype)
    for blocks, size in zip(lane_blocks(values, "majority", [(2, 2), (2, 2)]), (2, 4), strict=True):
        assert blocks.values.dtype == dtype
        for mine, share, row in zip(blocks.values, blocks.share, naive(values, size), strict=True):
            counted = [Counter(lanes.tolist()) for lanes in row]
            assert mine.tolist() == [min(c, key=lambda v: (-c[v], v)) for c in counted]
            assert share == pytest.approx([max(c.values()) / c.total() for c in counted])


def test_blocks_of_blocks_are_blocks_of_their_lanes_where_shares_say_all():
    """Of numbers always, of categories where every block has one alone; the share is never too large."""
    rng = np.random.default_rng(2)
    values = rng.normal(size=(24, 32))
    values[rng.random(values.shape) < 0.3] = np.nan
    values = values[:23, :31]  # the last blocks are smaller
    [small, large] = lane_blocks(values, "mean", [(2, 2), (4, 1)])
    lanes = np.outer([2] * 11 + [1], [2] * 15 + [1])
    merged = merge_blocks(small, lanes, "mean", (4, 1))
    assert merged.values == pytest.approx(large.values, rel=1e-5, nan_ok=True)
    assert merged.share == pytest.approx(large.share)
    kinds = np.repeat(np.repeat(rng.integers(0, 3, (12, 16)), 2, 0), 2, 1)
    [small, large] = lane_blocks(kinds, "majority", [(2, 2), (1, 4)])
    merged = merge_blocks(small, np.full((12, 16), 4), "majority", (1, 4))
    assert np.array_equal(merged.values, large.values)
    assert merged.share == pytest.approx(large.share)
    kinds = rng.integers(0, 3, (24, 32))
    [small, large] = lane_blocks(kinds, "majority", [(2, 2), (2, 2)])
    merged = merge_blocks(small, np.full((12, 16), 4), "majority", (2, 2))
    for value in range(3):
        [exact] = lane_blocks((kinds == value).astype(float), "mean", [(4, 4)])
        mine = merged.values == value
        assert np.all(merged.share[mine] <= exact.values[mine] + 1e-6)


def flags(values):
    """A group of flags over b and d."""
    about = {"flag_values": np.arange(3, dtype=np.int8), "flag_meanings": "periodic chaotic undecided"}
    variables = {"kind": (("b", "d"), values, "kind of motion", "1", about)}
    axes = {name: (np.arange(float(size)), name) for name, size in zip("bd", values.shape, strict=True)}
    return dataset(axes, variables, panel="flags", panel_variables="kind").assign_attrs(axes="b d")


def test_a_mixed_pixel_is_paler_by_the_share_of_the_others():
    pixels = flag_pixels(flags(np.array([[0, 0], [1, 1]], np.int8)))
    edges: PlaneEdges = (np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 2.0]))
    share = np.array([[1.0, 0.5], [0.75, 1.0]])  # (up, across), as pixels are
    plain, paled = (
        plane_raster(pixels, edges, each).cells.view(np.uint8).reshape(2, 2, 4).astype(int) for each in (None, share)
    )
    assert np.array_equal(paled[0, 0], plain[0, 0])
    assert np.allclose(255 - paled[..., :3], share[..., None] * (255 - plain[..., :3]), atol=0.5)
    assert np.all(paled[..., 3] == 255)


@pytest.mark.slow  # its parts are quick, each in small
def test_a_large_plane_is_first_a_sample_then_its_means_and_the_file_stays(chart):
    before = chart.read_bytes()
    source = open_recording(chart)
    assert list(source.variables) == ["lyapunov", "period", "verdict", CHAOS]
    first, *_, last = source.passes(source.first)
    assert "128 × 1,050 of 2,100 × 2,100 lanes; overviews are made once, 0%" in first.words
    assert first.data is None
    assert last.words == "2,100 × 2,100 lanes, 2 × 2 a pixel"
    with h5py.File(chart) as file:
        lanes = file["lyapunov/exponents"][..., 0]
    means = lanes.reshape(1050, 2, 1050, 2).mean(axis=(1, 3))
    assert last.pixels.plane.values == pytest.approx(means.T, abs=1e-6)  # kept in single precision
    half = 0.5 / (COUNT - 1)
    assert last.raster.across == pytest.approx((-half, 1 + half))
    assert jaxnh.figure(last.data).axes[0].get_xlim() == pytest.approx((-half, 1 + half))
    assert chart.read_bytes() == before
    assert [path.name for path in chart.parent.glob("chart.h5.overviews/*")] == ["lyapunov.h5"]


def bytes_read(action):
    """Bytes that this process asks the system for."""

    def now():
        return int(Path("/proc/self/io").read_text().split("rchar:")[1].split()[0])

    before = now()
    action()
    return now() - before


@pytest.mark.skipif(not Path("/proc/self/io").exists(), reason="the system does not count what is read")
def test_overviews_are_made_once_and_a_zoom_reads_a_part_of_the_file(chart):
    list(open_recording(chart).passes(open_recording(chart).first))
    source, pictures = open_recording(chart), []
    whole = bytes_read(lambda: pictures.extend(source.passes(source.first)))
    assert len(pictures) == 1
    part = bytes_read(lambda: list(source.passes(source.first.zoom(0.5, 0.52, (0.3, 0.32)))))
    with h5py.File(chart) as file:
        stored = file["lyapunov/exponents"].id.get_storage_size()
    assert whole < stored / 4  # blocks of two by two, a number of four bytes and a share of one for 32 bytes
    assert part < stored / 10  # 42 of 2,100 rows, in blocks of 32


def test_a_view_of_few_lanes_has_them_as_they_are(chart):
    source = open_recording(chart)
    view = replace(source.first, variable="period").zoom(0.4, 0.45, (0.7, 0.8))
    [picture] = source.passes(view)
    axis = np.linspace(0.0, 1.0, COUNT)
    inside = [np.flatnonzero((low <= axis) & (axis <= high)) for low, high in ((0.4, 0.45), (0.7, 0.8))]
    with h5py.File(chart) as file:
        lanes = file["period/period"][:][np.ix_(*inside)]
    assert np.array_equal(picture.pixels.plane.values, lanes.T)
    assert picture.words == f"{len(inside[0])} × {len(inside[1])} lanes"


@pytest.mark.usefixtures("short")
def test_a_strip_has_blocks_of_its_own_shape(chart):
    source = open_recording(chart)
    *_, picture = source.passes(source.first.zoom(0.2, 0.22, (0.5, 0.51)))  # 42 by 21 lanes
    assert picture.words == "42 × 21 lanes, 2 × 1 a pixel"
    *_, picture = source.passes(source.first.zoom(0.0, 1.0, (0.5, 0.51)))  # by overviews of 8 by 8
    assert picture.words == "2,100 × 21 lanes, 128 × 8 a pixel"
    first = int(np.searchsorted(np.linspace(0.0, 1.0, COUNT), 0.5)) // 8 * 8
    with h5py.File(chart) as file:
        lanes = file["lyapunov/exponents"][:, first : first + 8, 0]
    expected = [lanes[k : k + 128].mean() for k in range(0, COUNT, 128)]
    assert picture.pixels.plane.values[0] == pytest.approx(expected, abs=1e-5)


def test_the_share_of_chaos_is_of_lanes_with_a_verdict_or_by_the_error_of_the_exponent(chart):
    source = open_recording(chart)
    view = replace(source.first, variable=CHAOS).zoom(0.3, 0.9, (0.1, 0.7))
    [picture] = source.passes(view)
    axis = np.linspace(0.0, 1.0, COUNT)
    with h5py.File(chart) as file:
        rows, columns = (np.flatnonzero((low <= axis) & (axis <= high)) for low, high in ((0.3, 0.9), (0.1, 0.7)))
        kind = file["verdict/kind"][rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    block = kind[:2, :2] if picture.pixels.plane.values.shape[0] < len(columns) else kind[:1, :1]
    known = block[block != 3]
    assert picture.pixels.plane.values[0, 0] == pytest.approx(np.mean(known == 2))
    exponents = np.array([[0.3, -0.2], [0.05, np.nan]])
    group = xr.Dataset(
        {
            "exponents": (("b", "d", "exponent"), exponents[..., None]),
            "exponents_error": (("b", "d", "exponent"), np.full((2, 2, 1), 0.1)),
        },
        {"b": [0.0, 1.0], "d": [0.0, 1.0]},
        {"panel": "curves", "panel_variables": "exponents", "axes": "b d"},
    )
    known = {"lyapunov": tiled_plane.Quantity("lyapunov", "mean", group, lambda part: part["exponents"], (1, 1))}
    shares = tiled_plane._chaos(known)[CHAOS].values(group).to_numpy()
    assert np.array_equal(shares, [[1.0, 0.0], [0.0, np.nan]], equal_nan=True)


@pytest.mark.usefixtures("short")
def test_making_goes_on_where_it_was_left_and_leaves_no_part_of_a_file(tmp_path, monkeypatch):
    monkeypatch.setattr("jaxnh.explorer.overviews._STRIP", 1 << 11)
    result = tree({"verdict": flags(np.zeros((120, 90), np.int8))}, axes="b d")
    path = tmp_path / "plane.h5"
    result.to_netcdf(path, engine="h5netcdf")

    def words(pictures, count):
        return [next(pictures).words for _ in range(count)]

    source = open_recording(path)
    both = words(source.passes(source.first), 2) + words(source.passes(source.first.zoom(0.0, 100.0, (0.0, 80.0))), 2)
    assert [each.rsplit(" ", 1)[1] for each in both] == ["0%", "17%", "17%", "33%"]  # strips of 20 rows
    folder = tmp_path / "plane.h5.overviews"
    assert [each.suffix for each in folder.iterdir()] == [".part"]
    del source
    gc.collect()
    assert list(folder.iterdir()) == []
    source = open_recording(path)
    assert len(list(source.passes(source.first))) > 2
    assert len(list(open_recording(path).passes(source.first))) == 1
    changed = tree({"verdict": flags(np.ones((120, 90), np.int8))}, axes="b d")
    changed.to_netcdf(tmp_path / "other.h5", engine="h5netcdf")
    (tmp_path / "other.h5").replace(path)
    *_, picture = open_recording(path).passes(source.first)
    assert np.all(picture.pixels.plane.values == 1)


@pytest.mark.usefixtures("short")
def test_overviews_that_cannot_be_kept_beside_go_with_the_program(tmp_path):
    result = tree({"verdict": flags(np.tile(np.array([[0, 1]], np.int8), (64, 32)))}, axes="b d")
    path = tmp_path / "plane.h5"
    result.to_netcdf(path, engine="h5netcdf")
    (tmp_path / "plane.h5.overviews").write_text("in the way")
    for source in (open_recording(path), source_of(jaxnh.open_result(path), "a tree")):
        *_, picture = source.passes(source.first)
        assert picture.words == "64 × 64 lanes, 4 × 4 a pixel; 100% of the pixels are mixed"
        assert len(list(source.passes(source.first))) == 1
    assert sorted(each.name for each in tmp_path.iterdir()) == ["plane.h5", "plane.h5.overviews"]


class VirtualPeriods(xr.backends.BackendArray):
    """10,000 × 10,000 lanes that are nowhere: 1 where both numbers of a lane are even, 2 elsewhere; counts what is read."""

    def __init__(self):
        self.shape, self.dtype, self.read = (10_000, 10_000), np.dtype(np.int64), 0

    def __getitem__(self, key):
        every = xr.core.indexing.IndexingSupport.OUTER
        return xr.core.indexing.explicit_indexing_adapter(key, self.shape, every, self.lanes)

    def lanes(self, key):
        across, up = (np.arange(10_000)[part] for part in key)
        values = np.where((np.add.outer(across % 2, 0 * up) == 0) & (np.add.outer(0 * across, up % 2) == 0), 1, 2)
        self.read += values.size
        return values


@pytest.fixture
def virtual():
    lanes, about = VirtualPeriods(), {"panel": "integers", "panel_variables": "period", "axes": "b d"}
    lazily = xr.Variable(("b", "d"), xr.core.indexing.LazilyIndexedArray(lanes), {"long_name": "least period"})
    axis = np.linspace(0.0, 1.0, 10_000)
    data = xr.Dataset({"period": lazily}, {"b": axis, "d": axis}, about)
    return lanes, TiledPlane({"period": data}, ["period"], ("b", "d"), {"title": "Virtual"}, "nowhere", None)


def test_of_a_hundred_million_lanes_a_zoom_and_a_click_read_few(virtual):
    lanes, source = virtual
    first = next(source.passes(source.first))
    assert "of 10,000 × 10,000 lanes" in first.words
    assert lanes.read < 2e6  # 128 rows
    before = lanes.read
    [picture] = source.passes(source.first.zoom(0.5, 0.52, (0.3, 0.32)))
    assert picture.words == "200 × 200 lanes"
    assert np.mean(picture.pixels.plane.values == 1) == 0.25
    [_] = source.lane(source.first, {"b": 0.5, "d": 0.5})
    assert lanes.read - before < 1e5


@pytest.mark.slow  # all lanes are read once, some 10 s of processor
def test_a_hundred_million_lanes_are_a_pyramid_of_blocks(virtual):
    """Three of four lanes of each block of 2 × 2 and larger have period 2; views of all sizes have few pixels."""
    _, source = virtual
    *_, whole = source.passes(source.first)
    assert whole.words == "10,000 × 10,000 lanes, 16 × 16 a pixel; 100% of the pixels are mixed"
    assert np.all(whole.pixels.plane.values == 2)
    [part] = source.passes(source.first.zoom(0.2, 0.7, (0.1, 0.6)))
    assert part.words.startswith("5,000 × 5,000 lanes, 8 × 8 a pixel")
    assert np.all(part.pixels.plane.values == 2)
    for picture in (whole, part):
        assert max(picture.raster.cells.shape) <= tiled_plane.MOST_CELLS
