"""Result files: what xarray and netCDF4 see in them, and that a file is there whole or not at all."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys

import h5py
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from jaxnh.exceptions import DamagedError, ResultError
from jaxnh.storage.atomic import check_writable
from jaxnh.storage.chunks import slab_chunks
from jaxnh.storage.hdf5 import (
    SEAL,
    attributes,
    blocks,
    dimensions,
    open_result,
    read,
    read_attrs,
    read_group,
    verify,
    write,
)
from tests.helpers.paths import ROOT
from tests.helpers.small_results import ATTRS, group, variable, write_group

ENGINES = ["h5netcdf", "netcdf4"]


# ---- what is in a file


@pytest.mark.parametrize("engine", ENGINES)
def test_file_opens_as_a_data_tree(tmp_path, engine):
    """Every value, dimension, coordinate, long_name, units and attribute that went in comes out."""
    path = tmp_path / "result.h5"
    write_group(path)
    with xr.open_datatree(path, engine=engine) as tree:
        assert {name: tree.attrs[name] for name in ATTRS} == ATTRS
        assert set(tree.children) == {"diagram", "second"}
        for child in tree.children.values():
            ours, data = group(), child.to_dataset()
            assert dict(data.sizes) == {"b": 7, "strobe": 900}
            for name, variable in ours.variables.items():
                assert data[name].dims == variable.dims
                assert data[name].attrs["long_name"] == variable.attrs["long_name"]
                assert data[name].attrs["units"] == variable.attrs["units"]
                np.testing.assert_array_equal(data[name].values, variable.values)
                assert data[name].dtype == variable.dtype
            assert set(data.coords) == {"b", "strobe"}
            np.testing.assert_array_equal(data["strobe"].values, np.arange(900))
            assert data["strobe"].attrs["units"] == "1"
            assert data["strobe"].attrs["long_name"]
            np.testing.assert_array_equal(data["kind"].attrs["flag_values"], [0, 1])
            assert data["kind"].attrs["flag_meanings"] == "periodic chaotic"
            assert data.attrs["levels_found"] == 3
            assert np.isnan(data.attrs["delta_limit"])
            assert data.attrs["warnings"] == "one\ntwo"


def test_every_axis_is_a_dimension_scale(tmp_path):
    """As netCDF4 wants it: coordinates are scales, and every axis of every other variable has one attached."""
    path = tmp_path / "result.h5"
    write_group(path)
    with h5py.File(path) as file:
        for item in file["diagram"].values():
            if item.is_scale:
                assert item.name.rsplit("/", 1)[1] in ("b", "strobe")
            else:
                assert all(len(dimension) == 1 for dimension in item.dims)
        assert list(file["diagram"])[:4] == ["b", "x1", "residual", "kind"]  # in the order they were given


def test_text_scalars_and_coordinates(tmp_path):
    """Text, a number without dimensions, int8, and a coordinate that is no dimension, named as CF has it."""
    path = tmp_path / "result.h5"
    data = xr.Dataset(
        {
            "x1": variable(("b", "time"), np.ones((2, 3)), "position"),
            "word": variable("word", np.array(["δ", "long word"]), "words"),
            "limit": variable((), np.array(4.669), "limit of δ"),
            "kind": variable("b", np.array([1, -1], np.int8), "kind"),
        },
        {"t": variable("time", np.arange(3.0), "time"), "b": variable("b", np.arange(2.0), "coupling b")},
    )
    write(path, {**ATTRS, "axes": "b"}, {"one": data, "empty": xr.Dataset(attrs={"warnings": ""})})
    verify(path)
    with open_result(path) as tree:
        found = tree["one"].to_dataset().load()
        assert tree["empty"].attrs == {}
    xr.testing.assert_equal(found.drop_vars("time"), data)
    assert found["x1"].encoding["coordinates"] == "t"
    assert {name: found[name].dtype for name in data.variables} == {name: data[name].dtype for name in data.variables}
    xr.testing.assert_identical(read_group(path, "one"), found)
    with h5py.File(path) as file:
        assert list(file["one"]) == ["b", "x1", "word", "limit", "kind", "t", "time"]  # the axis first


def test_opened_result_reads_where_it_is_used(tmp_path):
    """Nothing is in memory before, and the file that was opened is read even where another takes its place."""
    path = tmp_path / "result.h5"
    write_group(path)
    with open_result(str(path)) as tree:
        assert not tree["diagram"]["x1"].variable._in_memory
        path.unlink()
        np.testing.assert_array_equal(tree["diagram"]["x1"], group()["x1"])


@settings(deadline=None, max_examples=30)
@given(
    arrays.arrays(
        st.sampled_from([np.float64, np.float32, np.int64, np.int8]),
        arrays.array_shapes(min_dims=1, max_dims=3, max_side=30),
    )
)
def test_every_array_comes_back_bit_for_bit(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("any") / "result.h5"
    dims = ("u", "v", "w")[: data.ndim]
    write(path, ATTRS, {"any": xr.Dataset({"data": variable(dims, data, "anything")})})
    back = read_group(path, "any")["data"].values
    assert back.dtype == data.dtype
    assert back.tobytes() == data.tobytes()
    assert {name: value for name, value in read_attrs(path).items() if name != SEAL} == ATTRS


def test_writing_replaces_a_file_and_nothing_else(tmp_path):
    path = tmp_path / "result.h5"
    path.write_bytes(b"something else")
    write_group(path)
    assert read_attrs(path)["title"] == ATTRS["title"]
    assert [entry.name for entry in tmp_path.iterdir()] == ["result.h5"]
    mask = os.umask(0)
    os.umask(mask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~mask  # as any other file that is made here


# ---- what is no result file


def test_files_that_are_no_results(tmp_path):
    """A sentence each: not HDF5, cut off, another program's, not there, and a group that is not there."""
    text, cut, other, ours = (tmp_path / name for name in ("text.h5", "cut.h5", "other.h5", "ours.h5"))
    text.write_text("hello")
    write_group(ours)
    cut.write_bytes(ours.read_bytes()[:3000])
    with h5py.File(other, "w") as file:
        file.attrs["title"] = "something else"
    for path, said in ((text, "not a readable"), (cut, "not a readable"), (other, "not a result of jaxnh")):
        for look in (read_attrs, open_result):
            with pytest.raises(ResultError, match=said):
                look(path)
    for look in (read_attrs, open_result):
        with pytest.raises(ResultError, match=r"absent\.h5 is not there"):
            look(tmp_path / "absent.h5")
        with pytest.raises(ResultError, match="is a folder"):
            look(tmp_path)
    with pytest.raises(ResultError, match="no group lyapunov"):
        read_attrs(ours, "lyapunov")
    with pytest.raises(ResultError, match="no readable group lyapunov"):
        read_group(ours, "lyapunov")


def test_damaged_data_is_not_read_as_numbers(tmp_path):
    """A flipped bit in a compressed array is found by its checksum."""
    path = tmp_path / "result.h5"
    write_group(path)
    with h5py.File(path) as file:
        chunk = file["diagram/x1"].id.get_chunk_info(0)
    content = bytearray(path.read_bytes())
    content[chunk.byte_offset + chunk.size // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(ResultError, match="no readable group diagram"):
        read_group(path, "diagram")


# ---- checksums


def test_file_fits_its_checksums(tmp_path):
    path = tmp_path / "result.h5"
    write_group(path)
    verify(path)


def everything(path):
    """All that a reader sees in a file."""
    with h5py.File(path) as file:
        seen = [sorted((key, str(value)) for key, value in file.attrs.items())]
        for group in file.values():
            seen.append((group.name, sorted((key, str(value)) for key, value in group.attrs.items())))
            for item in group.values():
                attrs = sorted((key, str(value)) for key, value in attributes(item).items())
                seen.append((item.name, item.shape, item.dtype, dimensions(item), read(item).tobytes(), attrs))
    return seen


def test_any_flipped_bit_is_found(tmp_path):
    """Of some hundred all over the file: what is not found is not seen by a reader either (gaps that HDF5 leaves)."""
    path = tmp_path / "result.h5"
    write(path, ATTRS, {"diagram": group()})
    sound, seen = path.read_bytes(), everything(path)
    bits = np.random.default_rng(3).integers(0, 8 * len(sound), 400)
    found = 0
    for bit in bits.tolist():
        content = bytearray(sound)
        content[bit // 8] ^= 1 << bit % 8
        path.write_bytes(content)
        try:
            verify(path)
        except ResultError:
            found += 1
        else:
            assert everything(path) == seen
    assert found > 300


@settings(deadline=None, max_examples=60)
@given(st.data())
def test_blocks_are_the_data_in_their_order(tmp_path_factory, data):
    """However a variable is laid out in blocks, also such as hold several rows and part of what lies along others."""
    shape = tuple(data.draw(st.lists(st.integers(1, 9), min_size=1, max_size=4), label="shape"))
    slab = tuple(data.draw(st.integers(1, size), label="slab") for size in shape)
    numbers = np.arange(np.prod(shape)).reshape(shape)
    path = tmp_path_factory.mktemp("blocks") / "any.h5"
    with h5py.File(path, "w") as file:
        item = file.create_dataset("data", data=numbers, chunks=slab_chunks(slab, shape, 8, 1 << 20))
        np.testing.assert_array_equal(np.concatenate([block.ravel() for block in blocks(item)]), numbers.ravel())


def test_blocks_of_large_variables_are_read_once_each(tmp_path):
    """Two axes of which the second is cut: no block of some megabytes is read for a part of it alone."""
    shape = (40, 3000, 50)
    chunks = slab_chunks((1, 1024, 50), shape, 8, 1 << 26)
    assert chunks == (1, 1024, 50)
    assert slab_chunks((1, 4096, 50), (40, 8192, 50), 8, 1 << 26) == (1, 2048, 50)
    assert slab_chunks((4096, 1, 50), (8192, 4000, 50), 8, 1 << 26) == (32, 1, 50)  # 32 rows of 1.6 MB
    with h5py.File(tmp_path / "large.h5", "w") as file:
        item = file.create_dataset("x", shape, "f8", chunks=chunks)
        found = [block.shape for block in blocks(item)]
    assert sum(np.prod(size) for size in found) == np.prod(shape)
    assert max(np.prod(size) for size in found) * 8 <= 1 << 23


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.9, 0.999])
def test_file_cut_short_is_found(tmp_path, share):
    path = tmp_path / "result.h5"
    write_group(path)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(DamagedError, match="cannot be read: it is damaged"):
        verify(path)


def test_changed_name_or_attribute_is_found(tmp_path):
    """Changed by HDF5 itself, so that only the seal can tell."""
    for change in (
        lambda file: file.attrs.update({"config": "a: 2"}),
        lambda file: file["diagram"].attrs.update({"levels_found": 4}),
        lambda file: file["diagram/x1"].attrs.update({"units": "1/length"}),
        lambda file: file.move("second", "third"),
    ):
        path = tmp_path / "result.h5"
        write_group(path)
        with h5py.File(path, "r+") as file:
            change(file)
        with pytest.raises(DamagedError, match="names or attributes do not fit their checksum"):
            verify(path)


@pytest.mark.skipif(not shutil.which("h5dump"), reason="h5dump is not installed")
def test_h5dump_reads_it(tmp_path):
    path = tmp_path / "result.h5"
    write_group(path)
    command = ["h5dump", "-d", "/diagram/kind", "-y", "-w", "0", str(path)]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "0, 1, 0, 1, 0, 1, 0" in out


# ---- folders and disks that refuse


@pytest.mark.parametrize("where", ["file/result.h5", "file/below/result.h5", "/proc/result.h5", "/proc/new/result.h5"])
def test_folder_that_cannot_be_written(tmp_path, where):
    """Below a regular file, and in /proc, not even root can write: one sentence with the folder, nothing left."""
    (tmp_path / "file").write_text("a file")
    path = tmp_path / where
    with pytest.raises(ResultError, match=f"cannot write in {path.parent}: "):
        check_writable(path)
    with pytest.raises(ResultError, match=f"cannot write in {path.parent}: "):
        write_group(path)
    assert (tmp_path / "file").read_text() == "a file"


def test_folder_as_the_file(tmp_path):
    with pytest.raises(ResultError, match="is a folder"):
        check_writable(tmp_path)
    with pytest.raises(ResultError, match="cannot write"):
        write_group(tmp_path)
    assert list(tmp_path.iterdir()) == []
    assert not list(tmp_path.parent.glob(f".{tmp_path.name}*"))


def test_check_makes_the_folder_and_leaves_nothing_in_it(tmp_path):
    path = tmp_path / "new" / "folder" / "result.h5"
    check_writable(path)
    assert path.parent.is_dir()
    assert list(path.parent.iterdir()) == []


def run(code, *arguments):
    """Python code in a process of its own, that may import the tests' helpers; what it prints, as JSON."""
    command = [sys.executable, "-W", "ignore", "-c", code, *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


LIMITED = """
import json, os, resource, sys
from pathlib import Path
from tests.helpers.small_results import write_group
from jaxnh.storage.hdf5 import ResultError

path, limit = Path(sys.argv[1]), int(sys.argv[2])
reading, writing = os.pipe()
child = os.fork()
if not child:
    os.dup2(writing, 1), os.dup2(writing, 2)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    try:
        write_group(path)
    except ResultError as error:
        print(error, flush=True)
    sys.exit()
os.close(writing)
said = open(reading).read()
print(json.dumps([os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), said]))
"""


# Each is a process; a limit of zero and one amid the data are no other to the writer than one amid the attributes.
LIMITS = [(2_000, "a result of old"), *(pytest.param(one, marks=pytest.mark.slow) for one in ((0, ""), (60_000, "")))]


@pytest.fixture(scope="module", params=LIMITS, ids=str)
def full_disk(request, tmp_path_factory):
    """Writing where files cannot grow past a limit, below the 110 kB needed: status, words, and files as expected."""
    limit, before = request.param
    path = tmp_path_factory.mktemp("full") / "result.h5"
    if before:
        path.write_text(before)
    status, said = run(LIMITED, path, limit)
    return path, status, said, [before] if before else []


@pytest.mark.slow
def test_full_disk_leaves_all_as_it_was(full_disk):
    path, _, said, before = full_disk
    assert f"cannot write {path}: " in said
    assert [entry.read_text() for entry in path.parent.iterdir()] == before


def test_full_disk_is_said_in_a_sentence(full_disk):
    """One line, no traceback, and the process lives."""
    path, status, said, _ = full_disk
    assert said.startswith(f"cannot write {path}: ")
    assert len(said.splitlines()) == 1
    assert status == 0


KILLED = """
import json, os, random, signal, sys, time
from pathlib import Path
from tests.helpers.small_results import ATTRS
from tests.helpers.small_results import group
from jaxnh.storage.hdf5 import read_attrs, read_group, write

folder, trials = Path(sys.argv[1]), int(sys.argv[2])
expected = group()["x1"].values
began = time.perf_counter()
for _ in range(5):
    write(folder / "timing.h5", ATTRS, {"diagram": group(), "second": group()})
took = (time.perf_counter() - began) / 5
random.seed(1)
absent = whole = interrupted = 0
for trial in range(trials):
    path = folder / f"{trial}.h5"
    child = os.fork()
    if not child:
        while True:
            write(path, ATTRS, {"diagram": group(), "second": group()})
    time.sleep(random.uniform(0, 3 * took))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    interrupted += bool(list(folder.glob(f".{trial}.h5*")))
    if path.exists():
        read_attrs(path)
        for name in ("diagram", "second"):
            assert (read_group(path, name)["x1"] == expected).all()
        whole += 1
    else:
        absent += 1
print(json.dumps([absent, whole, interrupted]))
"""


@pytest.mark.slow
def test_killed_at_any_moment(tmp_path):
    """Under its final name a file is absent or whole, after kills during the first writing and during later ones."""
    absent, whole, interrupted = run(KILLED, tmp_path, 60)
    assert absent + whole == 60
    assert min(absent, whole, interrupted) > 0  # or no kill came while a file was being written, and nothing was shown
