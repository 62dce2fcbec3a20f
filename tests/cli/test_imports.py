"""What commands import before they need it: --help, --schema and faults of arguments start no JAX and no xarray."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from jaxnh.config import schema
from tests.helpers.paths import ROOT

HEAVY = {
    "jax",
    "jaxlib",
    "equinox",
    "diffrax",
    "xarray",
    "pandas",
    "matplotlib",
    "h5py",
    "ruamel",
    "panel",
    "bokeh",
}  # typer itself looks for pydantic
COMMANDS = ("sweep", "plot", "cost", "explore", "inspect")


def loaded_by(name, *arguments):
    """Exit code of a command in a process of its own, and the first names of the modules loaded at its end."""
    code = f"import sys; sys.argv = {[name, *map(str, arguments)]!r}; from jaxnh.cli.commands import {name}; code = {name}.main(); "
    code += "print(code, *{module.split('.')[0] for module in sys.modules}, file=sys.stderr)"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    code, *modules = done.stderr.splitlines()[-1].split()
    return int(code), set(modules), done.stdout


@pytest.mark.parametrize("name", COMMANDS)
def test_help_loads_nothing_heavy(name):
    code, modules, out = loaded_by(name, "--help")
    assert code == 0
    assert "Usage" in out
    assert "typer" in modules  # the test sees what is loaded
    assert not modules & HEAVY


def test_schema_is_printed_from_its_file():
    code, modules, out = loaded_by("sweep", "--schema")
    assert code == 0
    assert out == schema.text(), "run python -m jaxnh.config.schema: a model has changed"
    assert not modules & HEAVY


def test_faults_of_arguments_load_nothing_heavy(tmp_path):
    for name, *arguments in (("sweep", "--part", "3/2"), ("inspect", tmp_path / "a.h5"), ("plot", tmp_path / "a.h5")):
        code, modules, _ = loaded_by(name, *arguments)
        assert code == 2
        assert not modules & HEAVY


def test_faults_of_the_text_of_a_config_start_no_jax(tmp_path):
    """Not there, not YAML, an override without a place, a user's file that is not there or is not Python."""
    (tmp_path / "bad.yaml").write_text("sweep: {b: [1, 2}\n")
    (tmp_path / "good.yaml").write_text("system: {file: own.py}\nsweep: {r: {values: [1]}}\nanalyses: {portrait: {}}\n")
    for arguments in (["absent.yaml"], ["bad.yaml"], ["good.yaml", "sweep.r.values.7=1"], ["good.yaml"]):
        code, modules, _ = loaded_by("sweep", tmp_path / arguments[0], *arguments[1:])
        assert code == 2
        assert not modules & (HEAVY - {"ruamel"})
    (tmp_path / "own.py").write_text("def system(r=1.0:\n")
    code, modules, _ = loaded_by("cost", tmp_path / "good.yaml")
    assert code == 2
    assert not modules & (HEAVY - {"ruamel"})


def test_a_look_at_a_result_needs_h5py_alone():
    code, modules, out = loaded_by("inspect", ROOT / "results" / "table1.h5")
    assert code == 0
    assert "doubling" in out
    assert not modules & (HEAVY - {"h5py"})
