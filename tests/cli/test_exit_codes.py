"""How commands end: damage is said where there is some; any other failure is one line and code 1, its traceback on request."""

from __future__ import annotations

import sys

import h5py
import jax
import numpy as np
import pytest
import xarray as xr

from jaxnh.cli import inspection
from jaxnh.cli.commands import cost, inspect, plot, sweep
from jaxnh.exceptions import DamagedError
from jaxnh.plotting import results
from jaxnh.storage import hdf5 as store
from jaxnh.storage.damage import fault_of

COMMANDS = {"sweep": sweep, "cost": cost, "plot": plot, "inspect": inspect}


def variable(dims, data, name):
    return dims, data, {"long_name": name, "units": "1"}


@pytest.fixture
def result_file(tmp_path):
    """A result of one group, large enough that its data lie in blocks of their own."""
    path = tmp_path / "made.h5"
    b = np.linspace(1, 2, 60)
    x1 = np.random.default_rng(0).normal(size=(60, 100))
    group = xr.Dataset({"b": variable("b", b, "b"), "x1": variable(("b", "strobe"), x1, "x1")})
    group.attrs = {"panel": "density", "panel_variables": "x1"}
    method = {"solver": "strang2", "steps_per_period": 4, "error_estimate": 1e-3}
    store.write(path, {"jaxnh_version": "0", "axes": "b", **method}, {"diagram": group})
    return path


@pytest.fixture
def command(monkeypatch, capsys):
    """Exit code, standard output and standard error of a command, run in this process."""

    def run(name, *arguments):
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        return COMMANDS[name].main(), *capsys.readouterr()

    return run


def broken(*_, **__):
    raise TypeError("a fault of the program")


@pytest.mark.parametrize("debug", [False, True])
@pytest.mark.parametrize("name", COMMANDS)
def test_a_fault_of_the_program_is_no_damage(result_file, tmp_path, command, monkeypatch, name, debug):
    """A sound file and a program that fails: code 1 and one line, and the traceback where it is asked for."""
    monkeypatch.setattr(inspection, "_facts", broken)
    monkeypatch.setattr(results, "lay_out", broken)
    monkeypatch.setattr("jaxnh.cli.arguments.read_config", broken)
    if debug:
        monkeypatch.setenv("JAXNH_DEBUG", "1")
    code, _, err = command(name, result_file if name in ("plot", "inspect") else tmp_path / "job.yaml")
    assert code == 1
    lines = err.splitlines()
    assert lines[-1] == "failed: TypeError: a fault of the program"
    assert (len(lines) > 1) == debug
    assert any(line.startswith("Traceback") for line in lines) == debug


@pytest.mark.parametrize("debug", [False, True])
@pytest.mark.parametrize("name", ["plot", "inspect"])
def test_bad_input_has_its_traceback_on_request(tmp_path, command, monkeypatch, name, debug):
    if debug:
        monkeypatch.setenv("JAXNH_DEBUG", "1")
    code, _, err = command(name, tmp_path / "absent.h5")
    assert code == 2
    assert err.splitlines()[-1].endswith("is not there")
    assert ("Traceback" in err) == debug


@pytest.mark.parametrize("name", ["plot", "inspect"])
def test_damaged_data_are_damage(result_file, command, name):
    """A bit of a compressed block: HDF5 finds it, and the line names the file and the variable."""
    with h5py.File(result_file) as file:
        place = file["diagram/x1"].id.get_chunk_info(0).byte_offset
    content = bytearray(result_file.read_bytes())
    content[place + 200] ^= 1
    result_file.write_bytes(content)
    code, _, err = command(name, result_file)
    assert (code, len(err.splitlines())) == (2, 1)
    assert err.startswith("command line: FILE: ")
    assert str(result_file) in err
    assert "damaged" in err


def test_damage_is_said_on_evidence_alone(result_file, tmp_path):
    """Of a sound file an error stays what it is; without checksums HDF5's own word counts, and no other."""
    error = ValueError("anything")
    assert fault_of(result_file, error) is error
    bare = tmp_path / "bare.h5"
    with h5py.File(bare, "w") as file:
        file.attrs["jaxnh_version"] = "0"
    assert fault_of(bare, error) is error
    assert isinstance(fault_of(bare, OSError("cannot read data")), DamagedError)
    with h5py.File(result_file, "r+") as file:
        file["diagram"].attrs["panel"] = "points"
    assert isinstance(fault_of(result_file, error), DamagedError)


SMALL = """\
system: {constraint: constant_speed}
sweep: {b: {values: [5.0]}}
accuracy: {solver: strang2, steps: 8}
analyses: {diagram: {transient: 1, strobes: 2}}
"""


def test_a_device_that_is_not_there(tmp_path, command):
    """One line that says what is there, with the line of the file or of the command; and one that is there computes."""
    config, output = tmp_path / "small.yaml", tmp_path / "small.h5"
    config.write_text(SMALL + "device: cpu\n")
    assert command("sweep", config, "--output", output)[0] == 0
    if any(device.platform != "cpu" for device in jax.devices()):
        pytest.skip("there is a GPU")
    code, _, error = command("sweep", config, "--output", output, "--fresh", "--device", "gpu")
    assert (code, error) == (
        2,
        "command line: device: JAX finds no gpu here, but cpu; leave it out, or install JAX for it\n",
    )
    config.write_text(SMALL + "device: gpu\n")
    code, _, error = command("sweep", config, "--output", tmp_path / "other.h5")
    assert (code, error) == (
        2,
        f"{config}:5: device: JAX finds no gpu here, but cpu; leave it out, or install JAX for it\n",
    )
