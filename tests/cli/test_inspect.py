"""What is said of a result file: from the file alone, every number as it stands there."""

from __future__ import annotations

import csv
import io
import os
import subprocess
import sys

import h5py
import numpy as np
import pytest
import xarray as xr

from jaxnh.storage import hdf5 as store
from jaxnh.storage.tiles import folder_of
from tests.helpers.commands import run_here
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.usefixtures("uncalibrated", "quick_compiling")
CONFIG = """\
title: To be looked at
system: {constraint: disturbed_speed, d: 0.1}
sweep: {b: {start: 5.2, stop: 5.45, count: 32}}
accuracy: {solver: blanes_moan6, steps: 40}
analyses:
  diagram: {transient: 30, strobes: 3, start: random, n_starts: 2}
  lyapunov: {transient: 16, periods: 16, exponents: 2}
  doubling: {levels: 1}
"""


@pytest.fixture(scope="module")
def result_file(result, tmp_path_factory):
    source = tmp_path_factory.mktemp("source") / "looked.yaml"
    source.write_text(CONFIG)
    return result("looked", source)[0]


def inspect(*arguments):
    return run_here(*arguments, command="inspect")


def test_screen(result_file):
    """Provenance, groups with their sizes, units and ranges, on one screen."""
    run = inspect(result_file)
    assert (run.returncode, run.stderr) == (0, "")
    lines = run.stdout.splitlines()
    assert len(lines) < 45
    assert max(map(len, lines)) <= 110
    with h5py.File(result_file) as file:
        exponents = file["lyapunov/exponents"][()]
        steps = file.attrs["lane_periods"]
    text = " ".join(run.stdout.split())
    assert "To be looked at" in text
    assert "32 values of b, from 5.2 to 5.45" in text
    assert "blanes_moan6, 40 steps a period, plain sums" in text
    assert f"{steps:,.0f} lane-periods" in text
    assert f"exponents b 32 × exponent 2 1 {exponents.min():.5g} … {exponents.max():.5g}" in text
    assert "x1 b 32 × start 2 × strobe" in text
    assert "status b 32 × start 2 1 64 ok" in text
    assert ", levels_found 1" in text


def test_it_needs_no_jax(result_file):
    code = f"import sys; sys.argv = ['inspect', {str(result_file)!r}]; from jaxnh import inspect; inspect.main(); sys.exit('jax' in sys.modules)"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    assert (
        subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, check=False).returncode == 0
    )


def test_verify_runs_lanes_again(result_file, tmp_path):
    """All lanes of a sweep so small are in the sample; one whose last bit differs is found by it alone."""
    run = inspect(result_file, "--verify")
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines()[-4:] == [
        "all data, names and attributes fit their checksums",
        "diagram: 48 lanes run again are equal bit for bit",
        "lyapunov: 48 lanes run again are equal bit for bit",
        "doubling: runs as a whole, not lane by lane",
    ]
    other = tmp_path / "other.h5"
    other.write_bytes(result_file.read_bytes())
    with h5py.File(other, "r+") as file:  # changed and sealed anew, as by a program that computes other numbers
        data = file["lyapunov/exponents"]
        data[3, 0] = np.nextafter(data[3, 0], 9)
        data.attrs[store.DATA] = store.checksum(data[()]).hexdigest()
        file.attrs[store.SEAL] = store.digest(file)
    run = inspect(other, "--verify")
    assert run.returncode == 2
    assert "lyapunov: run again, 1 of 48 lanes differ" in run.stderr


def test_table(result_file):
    """A row a lane, start and strobe; numbers to the last digit."""
    rows = list(csv.reader(io.StringIO(inspect(result_file, "--csv", "diagram").stdout)))
    assert rows[0] == ["b", "start", "strobe", "x1", "x2", "y1", "y2", "status"]
    assert len(rows) == 1 + 32 * 2 * 3
    with h5py.File(result_file) as file:
        x1, b = file["diagram/x1"][()], file["diagram/b"][()]
    np.testing.assert_array_equal(np.array([row[3] for row in rows[1:]], float), x1.ravel())
    np.testing.assert_array_equal(np.array([row[0] for row in rows[1:]], float), np.repeat(b, 6))
    rows = list(csv.reader(io.StringIO(inspect(result_file, "--csv", "lyapunov").stdout)))
    assert rows[0][:4] == ["b", "exponent", "exponents", "exponents_error"]
    assert len(rows) == 1 + 32 * 2


def variable(dims, data, long_name, units="1", **attrs):
    return dims, data, {"long_name": long_name, "units": units, **attrs}


def test_failed_lanes_have_a_reason(tmp_path):
    path = tmp_path / "failed.h5"
    b, x = np.linspace(1, 2, 11), np.zeros((11, 2))
    why, codes = {"flag_values": np.arange(3), "flag_meanings": "ok singular not_finite"}, np.zeros(11, np.int8)
    codes[[4, 6, 7]] = 1, 2, 1
    axis = {"b": variable("b", b, "b")}
    groups = {
        "poincare": xr.Dataset({**axis, "status": variable("b", codes, "why", **why)}),
        "diagram": xr.Dataset({**axis, "x1": variable(("b", "strobe"), x, "x1")}),
    }
    store.write(path, {"jaxnh_version": "0", "axes": "b"}, groups)
    lines = inspect(path).stdout.splitlines()
    assert "poincare: 2 of 11 lanes failed: singular, at b = 1.4, 1.7" in [line.strip() for line in lines]
    assert "poincare: 1 of 11 lanes failed: not_finite, at b = 1.6" in [line.strip() for line in lines]


@pytest.fixture
def plane(tmp_path):
    """A result over two axes under names of their own, one of them after the dimensions of a variable."""
    path = tmp_path / "plane.h5"
    rng = np.random.default_rng(5)
    drive, omega = np.linspace(1, 2, 50), np.array([0.5, 1.0, 1.5])
    x = rng.normal(size=(50, 3, 400))
    x[7, 2, 399] = x[9, 0, 0] = np.nan
    axes = {"drive": variable("drive", drive, "drive"), "omega": variable("omega", omega, "frequency omega", "1/time")}
    codes = np.zeros((4, 3, 50), np.int8)
    codes[2, 1, [3, 4, 5, 6, 7]] = 1
    why = {"flag_values": np.arange(2), "flag_meanings": "ok singular"}
    diagram = {
        "x1": variable(("drive", "omega", "strobe"), x, "position"),
        "x2": variable(("drive", "omega", "strobe"), rng.normal(size=x.shape).astype(np.float32), "velocity"),
        "t": variable("strobe", np.arange(400) / 3, "time"),
        "period": variable("omega", 2 * np.pi / omega, "strobe period"),
        "word": variable("drive", np.array(["a", 'b, "c"'] * 25), "word"),
        "limit": variable((), np.array(1.5), "a number"),
        "kind": variable("drive", (np.arange(50) % 3).astype(np.int8), "kind"),
    }
    alone = {"delta": variable((), np.array(4.669), "δ"), "levels": variable((), np.array(6), "levels")}
    groups = {
        "diagram": xr.Dataset(diagram, axes).set_coords("t"),
        "poincare": xr.Dataset({"status": variable(("start", "omega", "drive"), codes, "why", **why)}, axes),
        "alone": xr.Dataset(alone, attrs={"warnings": "alone: one thing\nalone: another"}),
    }
    store.write(path, {"jaxnh_version": "0", "axes": "drive omega"}, groups)
    return path, groups


def test_two_axes(plane):
    path, _ = plane
    run = inspect(path)
    assert (run.returncode, run.stderr) == (0, "")
    text = " ".join(run.stdout.split())
    assert "sweep 50 values of drive, from 1 to 2 × 3 values of omega, from 0.5 to 1.5" in text
    assert "x1 drive 50 × omega 3 × strobe 400 1" in text
    assert "poincare: 5 of 150 lanes failed: singular, at (drive, omega) = (1.06122, 1)" in text
    assert "(1.12245, 1), …" in text
    assert "alone: one thing" in text
    assert "alone: another" in text


def test_table_of_two_axes(plane):
    """A row a place, more of them than are made at once; every number to its last bit, and text as it is."""
    path, groups = plane
    rows = list(csv.reader(io.StringIO(inspect(path, "--csv", "diagram").stdout)))
    data, columns = groups["diagram"], np.array(rows[1:]).T
    assert rows[0] == ["drive", "omega", "strobe", "x1", "x2", "t", "period", "word", "limit", "kind"]
    assert len(rows) == 1 + 50 * 3 * 400
    order = ("drive", "omega", "strobe")
    for name, column in zip(rows[0], columns, strict=True):
        values = data[name] if name in data.variables else xr.DataArray(np.arange(400), dims="strobe")
        expected = values.broadcast_like(data["x1"]).transpose(*order).values.ravel()
        if expected.dtype.kind == "U":
            assert column.tolist() == expected.tolist()
        else:
            np.testing.assert_array_equal(column.astype(float), expected.astype(float))
    rows = list(csv.reader(io.StringIO(inspect(path, "--csv", "alone").stdout)))
    assert rows == [["delta", "levels"], ["4.669", "6"]]


def test_flags_are_words_in_a_table(plane):
    """A kind, or why a lane has failed, by its meaning."""
    path, groups = plane
    rows = list(csv.reader(io.StringIO(inspect(path, "--csv", "poincare").stdout)))
    codes = groups["poincare"]["status"].to_numpy().ravel()
    assert rows[0][-1] == "status"
    assert [row[-1] for row in rows[1:]] == [("ok", "singular")[code] for code in codes]


def test_file_without_axes(tmp_path):
    """A result that does not say over what it goes is shown all the same."""
    path = tmp_path / "costs.h5"
    group = xr.Dataset(
        {
            "target": variable("target", np.array([1e-6, 1e-9]), "target"),
            "time": variable("target", np.ones(2), "seconds", "s"),
        }
    )
    store.write(path, {"jaxnh_version": "0", "cost_of": "c" * 64}, {"solvers": group})
    run = inspect(path)
    assert run.returncode == 0, run.stderr
    assert "time target 2 s 1 … 1" in " ".join(run.stdout.split())
    assert inspect(path, "--csv", "solvers").stdout == "target,time\n1e-06,1.0\n1e-09,1.0\n"


def test_what_is_no_result(result_file, tmp_path):
    """One line and exit code 2: not there, a folder, text, cut off, another program's, a flipped bit, no such group."""
    text, cut, other, bad = (tmp_path / name for name in ("text.h5", "cut.h5", "other.h5", "bad.h5"))
    text.write_text("hello")
    cut.write_bytes(result_file.read_bytes()[:9000])
    with h5py.File(other, "w") as file:
        file.attrs["title"] = "something else"
    with h5py.File(result_file) as file:
        place = file["diagram/b"].id.get_offset()
    content = bytearray(result_file.read_bytes())
    content[place + 9] ^= 1
    bad.write_bytes(content)
    folder_of(tmp_path / "begun.h5").mkdir()
    for arguments, said in (
        ([tmp_path / "begun.h5"], "is not there; a run of it was begun and is not at its end"),
        ([tmp_path / "absent.h5"], "is not there"),
        ([tmp_path], "is a folder"),
        ([text], "is not a readable HDF5 file"),
        ([cut], "is not a readable HDF5 file"),
        ([other], "is an HDF5 file, but not a result of jaxnh"),
        ([bad, "--verify"], "the data of /diagram/b do not fit their checksum"),
        ([result_file, "--csv", "poincare"], "has the groups diagram, lyapunov, doubling, and no poincare"),
    ):
        run = inspect(*arguments)
        assert run.returncode == 2
        assert len(run.stderr.splitlines()) == 1
        assert run.stderr.startswith("command line: ")
        assert said in run.stderr


@pytest.mark.parametrize("arguments", [(), ("--csv", "x"), ("--verify",)])
@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("x", "has the variable /x outside of all groups"),
        ("diagram/below/x", "has the group /diagram/below within a group"),
    ],
)
def test_layout_of_no_result(result_file, tmp_path, place, words, arguments):
    """A variable in the root, or a group in a group: one line in plain words."""
    other = tmp_path / "other.h5"
    other.write_bytes(result_file.read_bytes())
    with h5py.File(other, "r+") as file:
        file[place] = np.zeros(3)
    run = inspect(other, *arguments)
    assert (run.returncode, run.stdout) == (2, "")
    assert run.stderr == f"command line: FILE: {other} {words}, and no result of jaxnh has\n"
