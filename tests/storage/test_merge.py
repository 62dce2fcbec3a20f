"""Pieces put together: in a file and in memory they are the dataset written at once, over one axis or several."""

from __future__ import annotations

import itertools
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from jaxnh.exceptions import DamagedError, ResultError, RunError
from jaxnh.jobs.arrays import with_indices
from jaxnh.jobs.assembly import assemble
from jaxnh.jobs.cutting import Piece, slab
from jaxnh.storage import hdf5 as store
from jaxnh.storage import merge, parts, tiles
from tests.helpers.cases import some_slow
from tests.helpers.storage_jobs import SPENT, job

ATTRS = {"title": "t", "jaxnh_version": "0"}
DIAGRAM = ("diagram",)


def variable(dims, data, long_name, units="1", **attrs):
    return dims, data, {"long_name": long_name, "units": units, **attrs}


def line(size):
    """A sweep over b alone."""
    return (("b", size, False),)


def numbers(*shape):
    """Numbers that a file keeps to the last bit on any machine."""
    return (np.arange(np.prod(shape)) * 7919 % 10007 / 1024).reshape(shape)


def structure(path):
    """All that is in a file: names in their order, types, layout, filters, attributes, and the bytes of all data."""

    def attributes(item):
        kept = {key: value for key, value in item.attrs.items() if key not in ("DIMENSION_LIST", "REFERENCE_LIST")}
        return [(key, str(value), item.attrs.get_id(key).dtype) for key, value in kept.items()]

    with h5py.File(path) as file:
        found: list = [attributes(file)]
        for group in file.values():
            found.append((group.name, attributes(group)))
            for item in group.values():
                layout = (item.shape, item.dtype, item.chunks, item.compression, item.shuffle, item.fletcher32)
                found.append((item.name, *layout, item.is_scale, store.dimensions(item), attributes(item)))
                found.append(store.read(item).tobytes())
    return found


# ---- one axis


def group_of_lanes(first, end, width, seed=3):
    """A group of lanes as an analysis leaves it: variables over b of several kinds, and one without b."""
    x = np.random.default_rng(seed).normal(size=(10_000, width))
    x[7, 0] = np.nan
    return xr.Dataset(
        {
            "b": variable("b", np.linspace(1, 2, 10_000)[first:end], "coupling b"),
            "t": variable("strobe", np.arange(width) / 3, "time"),
            "x1": variable(("b", "strobe"), x[first:end], "position"),
            "kind": variable("b", (np.arange(10_000) % 3).astype(np.int8)[first:end], "kind"),
        },
        attrs={"start": "fixed"},
    )


WIDTHS = {
    f"{tile}-{width}": (tile, width) for tile, width in [(1024, 40), (1000, 40), (128, 3), (4096, 3), (20_000, 40)]
}


@pytest.mark.parametrize(("tile", "width"), some_slow(WIDTHS, "1000-40", "4096-3"))
def test_merged_file_is_the_file_written_at_once(tmp_path, tile, width):
    """Blocks that go over as they are and blocks that do not, whatever the tile: data, order and attributes."""
    plan = job(line(10_000), tile, DIAGRAM)
    parts = [(piece, group_of_lanes(piece.begin[0], piece.end[0], width)) for piece in plan.cutting.pieces()]
    for piece, data in parts:
        tiles.write_piece(tmp_path, plan, piece, {"diagram": data}, {}, SPENT)
    merged, plain = tmp_path / "merged.h5", tmp_path / "plain.h5"
    merge.merge(merged, ATTRS, tmp_path, plan.cutting, {"diagram": ["one is lost"]})
    store.write(plain, ATTRS, {"diagram": group_of_lanes(0, 10_000, width)})
    store.verify(merged)
    ours, expected = store.read_group(merged, "diagram"), store.read_group(plain, "diagram")
    assert list(ours) == list(expected)
    for name, data in expected.variables.items():
        assert (ours[name].dtype, ours[name].values.tobytes()) == (data.dtype, data.values.tobytes())
    with h5py.File(merged) as one, h5py.File(plain) as other:
        for name in expected.variables:
            assert store.attributes(one["diagram"][name]) == store.attributes(other["diagram"][name])
            assert store.dimensions(one["diagram"][name]) == store.dimensions(other["diagram"][name])
        assert dict(one["diagram"].attrs) == {"start": "fixed", "warnings": "one is lost"}
        assert one["diagram/x1"].fletcher32
        assert one["diagram/x1"].shuffle
        assert one["diagram/x1"].compression == "gzip"
    xr.testing.assert_equal(assemble(parts, plan.cutting, ["one is lost"]), ours)
    assert assemble(parts, plan.cutting, ["one is lost"]).attrs == ours.attrs


def diagram(first, end, size=300, strobes=40):
    """Every kind of variable over b, as the package wrote it into one_axis.h5 before there were several axes."""
    x = numbers(size, strobes)
    x[7, 0] = np.nan
    words = np.array(["fixed", "random δ", "up"])[np.arange(size) % 3]
    flags = {"flag_values": np.arange(3, dtype=np.int8), "flag_meanings": "periodic chaotic undecided"}
    content = {
        "t": variable("strobe", np.arange(strobes) / 4, "time since the start"),
        "x1": variable(("b", "strobe"), x[first:end], "position x1"),
        "x2": variable(("b", "strobe"), x[first:end].astype(np.float32), "velocity x2", "1/time"),
        "kind": variable("b", (np.arange(size) % 3).astype(np.int8)[first:end], "kind of motion", **flags),
        "exponent": variable("exponent", np.arange(1, 4), "number of the exponent, largest first"),
        "exponents": variable(("b", "exponent"), numbers(size, 3)[first:end], "Lyapunov exponents", "1/time"),
        "word": variable("b", words[first:end], "a word"),
        "residual": variable((), np.array(0.125), "a number"),
    }
    b = variable("b", (2 + np.arange(size) / 128)[first:end], "coupling b")
    data = xr.Dataset(content, {"b": b}, {"start": "fixed", "phase": 0.25, "angles": 100, "not_finite": 1})
    return data.set_coords("t")


def doubling():
    level = np.arange(1, 4)
    return xr.Dataset(
        {
            "level": variable("level", level, "number of the period doubling"),
            "period": variable("level", 2**level, "period", "forcing periods"),
            "b": variable("level", np.array([5.25, 5.375, np.nan]), "coupling b at the doubling"),
            "b_error": variable("level", np.array([2.0**-40, 2.0**-38, np.nan]), "largest error of b"),
        },
        attrs={"delta_limit": np.nan, "levels_found": 2, "warnings": "the cascade ends\nat 2 of 3 levels"},
    )


def test_one_axis_is_kept_as_it_was(tmp_path):
    """The file of a sweep over one axis: not an attribute, a type, a block or a bit differs, nor does its seal."""
    plan = job(line(300), 128, ("diagram", "doubling"))
    for piece in plan.cutting.pieces():
        groups = (
            {"diagram": diagram(piece.begin[0], piece.end[0])} if piece.names == DIAGRAM else {"doubling": doubling()}
        )
        tiles.write_piece(tmp_path, plan, piece, groups, {}, SPENT)
    attrs = {
        "title": "Täst δ",
        "jaxnh_version": "0",
        "steps_per_period": 40,
        "error_estimate": 1e-6,
        "strobe_period": np.float64(6.25),
    }
    path = tmp_path / "merged.h5"
    merge.merge(path, attrs, tmp_path, plan.cutting, {"diagram": ["one is lost"]})
    expected = structure(Path(__file__).parent / "one_axis.h5")
    assert structure(path) == expected
    assert {key: value for key, value, _ in expected[0]}[store.SEAL] == store.read_attrs(path)[store.SEAL]
    whole = {
        "diagram": diagram(0, 300).assign_attrs(warnings="one is lost"),
        "doubling": doubling(),
    }
    store.write(path, {**attrs, "axes": "b"}, whole)
    assert structure(path)[1:] == expected[1:]


# ---- several axes


def whole(axes, strobes=3, levels=2):
    """Datasets over all axes: per lane, per line along the first axis, along some axes alone, along none."""
    names, shape = [name for name, _, _ in axes], [size for _, size, _ in axes]
    coordinates = {name: variable(name, numbers(size) + 1, f"axis {name}") for name, size, _ in axes}
    others, rest = names[1:], shape[1:]
    x = numbers(*shape, strobes)
    x[(0,) * x.ndim] = np.nan
    lanes = {
        "x1": variable((*names, "strobe"), x, "position"),
        "kind": variable(names, (numbers(*shape) * 1024 % 3).astype(np.int8), "kind"),
        "word": variable(names, np.array(["a", "bcd", "δδ"])[(numbers(*shape) * 1024 % 3).astype(int)], "word"),
        "strobe_period": variable(names[-1:], numbers(shape[-1]), "period, of the last axis alone"),
        "back": variable(("strobe", *reversed(names)), numbers(strobes, *reversed(shape)), "axes from the last"),
        "t": variable("strobe", np.arange(strobes) / 4, "time"),
        "single": variable((), np.array(1.5), "a number"),
    }
    lines = {
        "level": variable("level", np.arange(1, levels + 1), "level"),
        names[0]: variable((*others, "level"), numbers(*rest, levels), f"axis {names[0]} at the doubling"),
        "delta_limit": variable(others, numbers(*rest), "limit"),
    }
    along = {name: coordinates[name] for name in others}
    return {
        "diagram": xr.Dataset(lanes, coordinates, {"start": "fixed"}).set_coords("t"),
        "doubling": xr.Dataset(lines, along, {"levels": levels}),
    }


def cut(data, piece, names):
    """The dataset of a piece."""
    dims = [str(dim) for dim in data.dims]
    return data.isel(dict(zip(dims, slab(dims, piece, names), strict=True)))


def parts_of(plan, groups):
    """Pieces with their groups, of which those of doubling have a warning of their own."""
    for piece in plan.cutting.pieces():
        found = {name: cut(groups[name], piece, plan.cutting.names) for name in piece.names}
        if piece.names == ("doubling",):
            found["doubling"] = found["doubling"].assign_attrs(warnings=f"at {piece.begin[1:]}\nincomplete")
        yield piece, found


def assert_same(one, other):
    """Equal in names, types, dimensions and every bit."""
    assert set(one.variables) == set(other.variables)
    assert set(one.coords) == set(other.coords)
    for name, expected in other.variables.items():
        assert one[name].dims == expected.dims
        if expected.dtype.kind == "U":
            assert one[name].values.tolist() == expected.values.tolist()
        else:
            assert one[name].dtype == expected.dtype
            assert one[name].values.tobytes() == expected.values.tobytes()


AXES = {
    "two": (("b", 5, False), ("a", 4, False)),
    "shared last": (("b", 5, False), ("omega", 3, True)),
    "shared first": (("omega", 3, True), ("b", 5, False)),
    "shared between": (("a", 3, False), ("d", 2, True), ("b", 4, False)),
    "three": (("c", 3, False), ("a", 2, False), ("b", 4, False)),
    "all shared": (("c", 2, True), ("omega", 3, True)),
}


CUTS = {f"{axes}-{tile}": (axes, tile) for axes, tile in itertools.product(AXES, (3, 100))}


@pytest.mark.parametrize("collected", [True, False], ids=["collected", "slab by slab"])
@pytest.mark.parametrize(("axes", "tile"), some_slow(CUTS, "shared first-3", "shared between-3", "three-100"))
def test_merged_is_assembled_is_written_at_once(tmp_path, monkeypatch, axes, tile, collected):
    if not collected:
        monkeypatch.setattr(merge, "_COLLECTED", 0)
        monkeypatch.setattr(store, "_LARGE", 16)
    axes = AXES[axes]
    plan, groups = job(axes, tile), whole(axes)
    parts = list(parts_of(plan, groups))
    for piece, data in parts:
        tiles.write_piece(tmp_path, plan, piece, data, {}, SPENT)
    merged, plain = tmp_path / "merged.h5", tmp_path / "plain.h5"
    attrs = {**ATTRS, "axes": " ".join(plan.cutting.names)}
    merge.merge(merged, attrs, tmp_path, plan.cutting, {"diagram": ["two are lost"]})
    store.verify(merged)
    store.write(plain, attrs, groups)
    with store.open_result(merged) as tree:
        assert tuple(tree.attrs["axes"].split()) == plan.cutting.names
        for name in plan.cutting.order:
            found, expected = tree[name].to_dataset().load(), store.read_group(plain, name)
            assert_same(found, expected)
            assembled = assemble([(piece, data[name]) for piece, data in parts if name in data], plan.cutting)
            assert_same(assembled, expected)
            for key in assembled.variables:
                assert assembled[key].attrs.items() <= found[key].attrs.items()
        assert tree["diagram"].attrs == {"start": "fixed", "warnings": "two are lost"}
        lines = tree["doubling"].attrs["warnings"].split("\n")
        assert lines.count("incomplete") == 1
        assert len(lines) == 1 + np.prod(plan.cutting.shape[1:], dtype=int)
    with h5py.File(merged) as one, h5py.File(plain) as other:
        for name in plan.cutting.order:
            assert list(one[name]) == list(other[name])
            assert {key: item.attrs[store.DATA] for key, item in one[name].items()} == {
                key: item.attrs[store.DATA] for key, item in other[name].items()
            }


@settings(deadline=None, max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.tuples(st.integers(1, 4), st.booleans()), min_size=1, max_size=3),
    st.integers(1, 20),
)
@pytest.mark.slow
def test_any_axes(tmp_path_factory, drawn, tile):
    axes = tuple((f"p{k}", size, shared) for k, (size, shared) in enumerate(drawn))
    folder = tmp_path_factory.mktemp("any")
    plan, groups = job(axes, tile), whole(axes)
    parts = list(parts_of(plan, groups))
    for piece, data in parts:
        tiles.write_piece(folder, plan, piece, data, {}, SPENT)
    merge.merge(folder / "merged.h5", ATTRS, folder, plan.cutting, {})
    for name in plan.cutting.order:
        found = store.read_group(folder / "merged.h5", name)
        assert_same(found, with_indices(groups[name]))
        assert_same(assemble([(piece, data[name]) for piece, data in parts if name in data], plan.cutting), found)


def test_large_variable_lies_in_blocks_that_fit_the_pieces(tmp_path, monkeypatch):
    """A row of 2 shared values beside 64 lanes in tiles of 16: blocks of 16 lanes of one value."""
    monkeypatch.setattr(merge, "_COLLECTED", 1 << 16)
    axes = (("b", 64, False), ("omega", 2, True))
    plan, groups = job(axes, 16, DIAGRAM), whole(axes, strobes=400)
    for piece, data in parts_of(plan, groups):
        tiles.write_piece(tmp_path, plan, piece, data, {}, SPENT)
    merge.merge(tmp_path / "merged.h5", ATTRS, tmp_path, plan.cutting, {})
    with h5py.File(tmp_path / "merged.h5") as file:
        assert file["diagram/x1"].chunks == (8, 1, 400)  # 8 rows of 6.4 kB together are less than 65 kB
        assert file["diagram/x1"].fletcher32
    store.verify(tmp_path / "merged.h5")


# ---- files that a result leads to


@pytest.mark.parametrize("axes", [line(3000), (("b", 64, False), ("omega", 2, True))], ids=["one", "two"])
def test_virtual_is_the_same_result_and_copies_nothing(tmp_path, monkeypatch, axes):
    """Bit for bit, by the checksums of a merge that copies; tiles may go, and the result and its folder may move."""
    monkeypatch.setattr(store, "_LARGE", 16)
    plan, groups = job(axes, 16 if len(axes) > 1 else 1024, DIAGRAM), whole(axes, strobes=40)
    folder = tmp_path / "tiles"
    folder.mkdir()
    for piece, data in parts_of(plan, groups):
        tiles.write_piece(folder, plan, piece, data, {}, SPENT)
    made, copied = tmp_path / "made" / "whole.h5", tmp_path / "copied.h5"
    made.parent.mkdir()
    merge.merge(copied, ATTRS, folder, plan.cutting, {})
    merge.merge(made, ATTRS, folder, plan.cutting, {}, virtual=True)
    assert {path.name for path in made.parent.iterdir()} == {"whole.h5", "whole.h5.parts"}
    tiles.clear(folder)
    moved = made.parent.rename(tmp_path / "moved") / "whole.h5"
    store.verify(moved)
    with h5py.File(moved) as one, h5py.File(copied) as other:
        assert one["diagram/x1"].is_virtual
        assert {key: item.attrs[store.DATA] for key, item in one["diagram"].items()} == {
            key: item.attrs[store.DATA] for key, item in other["diagram"].items()
        }
    with store.open_result(moved) as tree:
        assert_same(tree["diagram"].to_dataset().load(), store.read_group(copied, "diagram"))
    (moved.parent / "whole.h5.parts" / "000001.h5").unlink()
    with pytest.raises(DamagedError, match=r"whole\.h5 has its data in .*whole\.h5\.parts, where \d+ of \d+ files are"):
        store.open_result(moved)


def test_virtual_of_too_many_files(tmp_path, monkeypatch):
    """HDF5 would give fill values in silence; a later result that copies removes the links."""
    plan, groups = job(line(12), 4, DIAGRAM), whole(line(12))
    for piece, data in parts_of(plan, groups):
        tiles.write_piece(tmp_path, plan, piece, data, {}, SPENT)
    path = tmp_path / "whole.h5"
    merge.merge(path, ATTRS, tmp_path, plan.cutting, {}, virtual=True)
    assert parts.folder_of(path).exists()
    merge.merge(path, ATTRS, tmp_path, plan.cutting, {})
    assert not parts.folder_of(path).exists()
    monkeypatch.setattr(parts, "MOST", 2)
    with pytest.raises(
        ResultError, match="3 tiles are more files than HDF5 can read as one, 2: merge without --virtual"
    ):
        merge.merge(path, ATTRS, tmp_path, plan.cutting, {}, virtual=True)


# ---- what does not fit


def test_damaged_piece_is_named_while_merging(tmp_path):
    plan = job(line(3000), 1024, DIAGRAM)
    for piece in plan.cutting.pieces():
        data = group_of_lanes(piece.begin[0], piece.end[0], 40)
        tiles.write_piece(tmp_path, plan, piece, {"diagram": data}, {}, SPENT)
    bad = plan.cutting.pieces()[1]
    path = tiles.piece_path(tmp_path, bad)
    with h5py.File(path) as file:
        chunk = file["diagram/x1"].id.get_chunk_info(0)
    content = bytearray(path.read_bytes())
    content[chunk.byte_offset + chunk.size // 2] ^= 16
    path.write_bytes(content)
    with pytest.raises(DamagedError):
        tiles.check(tmp_path, plan, bad)
    with pytest.raises(merge.DamagedPieceError) as caught:
        merge.merge(tmp_path / "merged.h5", {}, tmp_path, plan.cutting, {"diagram": []})
    assert caught.value.piece == bad
    assert not (tmp_path / "merged.h5").exists()


PLANE = (("b", 4, False), ("d", 3, True))
FAULTS = {
    "time of its own": (lambda data: data.assign_coords(t=data["t"] + 1), "t is not that of the other tiles"),
    "another axis": (lambda data: data.assign_coords(b=data["b"] + 1), "b is not that of the other tiles"),
    "lanes missing": (lambda data: data.isel(b=slice(0, 2)), r"has the shape \(2,.*\) in place of \(4,"),
    "strobes missing": (lambda data: data.isel(strobe=slice(0, 2)), r"has the shape .* in place of"),
    "variable missing": (lambda data: data.drop_vars("x1"), "its variables are not those of the other tiles"),
    "other numbers": (
        lambda data: data.assign(x1=data["x1"].astype(np.float32)),
        "x1 has numbers float32 in place of float64",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_piece_that_does_not_fit_the_others(tmp_path, fault):
    """Sound in itself, and not of the same sweep: which piece, and what differs."""
    spoil, said = FAULTS[fault]
    plan, groups = job(PLANE, 4, DIAGRAM), whole(PLANE)
    parts = [(piece, data["diagram"]) for piece, data in parts_of(plan, groups)]
    parts[2] = (parts[2][0], spoil(parts[2][1]))
    for piece, data in parts:
        tiles.write_piece(tmp_path, plan, piece, {"diagram": data}, {}, SPENT)
    with pytest.raises(merge.DamagedPieceError, match=said) as caught:
        merge.merge(tmp_path / "merged.h5", {}, tmp_path, plan.cutting, {})
    assert caught.value.piece == parts[2][0]
    with pytest.raises(RunError, match=f"do not fit together: .*{said}"):
        assemble(parts, plan.cutting)


def test_parts_that_are_not_all(tmp_path):
    plan, groups = job(PLANE, 4, DIAGRAM), whole(PLANE)
    parts = [(piece, data["diagram"]) for piece, data in parts_of(plan, groups)]
    with pytest.raises(RunError, match="x1 is not there as a whole"):
        assemble(parts[:2], plan.cutting)
    with pytest.raises(RunError, match="nothing to put together"):
        assemble([], plan.cutting)
    for piece, data in parts[:2]:
        tiles.write_piece(tmp_path, plan, piece, {"diagram": data}, {}, SPENT)
    with pytest.raises(merge.DamagedPieceError) as caught:
        merge.merge(tmp_path / "merged.h5", {}, tmp_path, plan.cutting, {})
    assert caught.value.piece == parts[2][0]


def test_attributes_on_which_pieces_differ_are_left_out(tmp_path):
    """In a file as in memory; NaN is equal to itself."""
    plan = job(line(4), 2, DIAGRAM)
    attrs = [{"start": "up", "limit": np.nan, "place": 0}, {"start": "up", "limit": np.nan, "place": 1}]
    parts = [
        (piece, whole(line(4))["diagram"].isel(b=slice(piece.begin[0], piece.end[0])).assign_attrs(own))
        for piece, own in zip(plan.cutting.pieces(), attrs, strict=True)
    ]
    for piece, data in parts:
        tiles.write_piece(tmp_path, plan, piece, {"diagram": data}, {}, SPENT)
    merge.merge(tmp_path / "merged.h5", ATTRS, tmp_path, plan.cutting, {})
    for found in (store.read_group(tmp_path / "merged.h5", "diagram").attrs, assemble(parts, plan.cutting).attrs):
        assert (list(found), found["start"]) == (["start", "limit"], "up")
        assert np.isnan(found["limit"])


def test_stopped_while_merging(tmp_path):
    """Whatever `heed` raises goes through, and nothing is left."""
    plan, groups = job(line(4), 2, DIAGRAM), whole(line(4))
    for piece, data in parts_of(plan, groups):
        tiles.write_piece(tmp_path, plan, piece, data, {}, SPENT)

    def heed():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        merge.merge(tmp_path / "merged.h5", ATTRS, tmp_path, plan.cutting, {}, heed)
    assert {path.name for path in tmp_path.iterdir()} == {"000000.h5", "000001.h5"}
    with pytest.raises(ResultError, match="cannot write in"):
        merge.merge(tmp_path / "gone" / "merged.h5", ATTRS, tmp_path, plan.cutting, {})


def test_job_without_axes():
    """One lane, and nothing that grows."""
    plan = job((), order=DIAGRAM)
    [piece] = plan.cutting.pieces()
    assert piece == Piece(0, DIAGRAM, (), ())
    data = xr.Dataset({"x": ("strobe", numbers(3))})
    xr.testing.assert_equal(assemble([(piece, data)], plan.cutting), with_indices(data))
