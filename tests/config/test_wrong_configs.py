"""A wrong config is answered before JAX is imported: one line, exit code 2, in the words of the models that run."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from jaxnh.analyses.options import OPTIONS
from jaxnh.analyses.registry import ANALYSES
from jaxnh.config import solver_names
from jaxnh.config.config import load_config
from jaxnh.engine.experiment import load
from jaxnh.exceptions import ConfigError, UserFileError
from jaxnh.solvers import NYSTROM, RUNGE_KUTTA, SOLVERS, SPLITTINGS
from jaxnh.systems.user_file import UserFile
from jaxnh.systems.user_text import Names, names_in
from tests.helpers.paths import ROOT

TABLE, GOVERNOR = ROOT / "configs" / "table1.yaml", ROOT / "configs" / "governor.yaml"
WRONG = {
    "an unknown key": (TABLE, "titel=A", "titel: unknown key (did you mean title?)"),
    "an unknown analysis": (TABLE, "analyses.doublings={}", "analyses.doublings: unknown key (did you mean doubling?)"),
    "a wrong type": (TABLE, "sweep.b.count=ten", "sweep.b.count: must be a whole number, not the text 'ten'"),
    "no system": (TABLE, "system=free", "system: must be a mapping of keys to values, not the text 'free'"),
    "an option out of bounds": (TABLE, "analyses.doubling.levels=17", "analyses.doubling.levels: must be at most 16"),
    "options that do not go together": (TABLE, "analyses.diagram={seed: 1}", "analyses.diagram.seed: seed goes with"),
    "a key of another system": (TABLE, "system.d=0.1", "system.d: d does not go with constant_speed"),
    "no speed": (TABLE, "initial.x2=3", "initial.x2: the speed at t = 0 is 1, and |x2| cannot be above it"),
    "a parameter that is swept": (TABLE, "system.b=1", "system.b: b is swept; leave it out of system"),
    "another solver's flow": (TABLE, "accuracy={solver: nystrom8, steps: 9}", "accuracy.solver: nystrom8 is for flows"),
    "a coarse Newton": (TABLE, "accuracy={precision: float32}", "accuracy.precision: float32 is too coarse for Newton"),
    "a section beside a clock": (TABLE, "section={}", "section: this scene has a clock, and is seen at its strobes"),
    "a user's parameter": (GOVERNOR, "system.drove=1", "system.drove: unknown key (did you mean drive?); known keys are file"),
    "a user's coordinate": (GOVERNOR, "initial.z=1", "initial.z: unknown key; known keys are project, level, x, x_dot"),
    "a user's axis": (GOVERNOR, "sweep.omege={values: [1.0]}", "sweep.omege: unknown key"),
    "a user's section": (GOVERNOR, "section.coordinate=z", "section.coordinate: there is no coordinate z; known are x, y"),
    "a size of no coordinate": (GOVERNOR, "accuracy.scale={z: 1.0}", "accuracy.scale.z: unknown key; known keys are x, x_dot"),
    "a size that is none": (GOVERNOR, "accuracy.scale={x: 0.0}", "accuracy.scale.x: must be above 0, not 0.0"),
    "sizes of the particle": (TABLE, "accuracy.scale={x1: 1.0}", "accuracy.scale: unknown key; known keys are target"),
    "a file that is a number": (GOVERNOR, "system.file=5", "system.file: must be the name of a Python file, not 5"),
    "a file that is not there": (GOVERNOR, "system.file=none.py", "system.file: there is no file "),
}  # fmt: skip


def command(*arguments, first=""):
    """The real command in a process of its own, and whether JAX is among its modules at the end."""
    code = f"{first}import sys; from jaxnh.sweep import main; code = main(); "
    code += "print(*sorted({'jax', 'equinox', 'diffrax', 'xarray'} & sys.modules.keys())); sys.exit(code)"
    run = [sys.executable, "-c", code, *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(run, env=environment, capture_output=True, text=True, check=False)


def message(load, *arguments):
    with pytest.raises(ConfigError) as caught:
        load(*arguments)
    return str(caught.value)


@pytest.mark.parametrize(("config", "override", "words"), WRONG.values(), ids=WRONG)
def test_in_the_words_of_the_models(config, override, words):
    """What is told without JAX is what `load` tells."""
    told = message(load_config, config, [override])
    assert told.startswith(f"command line: {words}")
    assert "\n" not in told
    assert message(load, config, [override]) == told


@pytest.mark.parametrize("name", ["an unknown key", "no speed", "an option out of bounds", "a user's coordinate"])
def test_the_command_answers_without_jax(name):
    config, override, words = WRONG[name]
    done = command(config, override)
    assert (done.returncode, done.stdout.strip()) == (2, "")
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith(f"command line: {words}")


def test_the_line_of_the_file(tmp_path):
    path = tmp_path / "bad.yaml"
    path.write_text("system: free\nfoo: 1\n")
    done = command(path)
    assert (done.returncode, done.stdout.strip()) == (2, "")
    assert done.stderr == f"{path}:1: system: must be a mapping of keys to values, not the text 'free'\n"


def test_a_jax_that_cannot_be_imported_is_not_noticed(tmp_path):
    """A command ends with code 2 where the import of JAX would end with another one."""
    (tmp_path / "jax.py").write_text("raise SystemExit(7)\n")
    done = command(TABLE, "titel=A", first=f"import sys; sys.path.insert(0, {str(tmp_path)!r}); ")
    assert done.returncode == 2
    assert "titel: unknown key (did you mean title?)" in done.stderr


@pytest.mark.parametrize("module", ["jaxnh.analyses.options", "jaxnh.config.config", "jaxnh.systems.user_text"])
def test_options_and_blocks_import_no_jax(module):
    code = f"import sys, {module}; assert not {{'jax', 'equinox', 'diffrax', 'xarray'}} & sys.modules.keys()"
    subprocess.run([sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": str(ROOT)}, check=True)


def test_every_config_passes():
    for path in sorted((ROOT / "configs").rglob("*.yaml")):
        load_config(path)


def test_tables_without_jax_are_those_of_what_runs():
    assert {name: analysis.options for name, analysis in ANALYSES.items()} == OPTIONS
    assert list(OPTIONS) == list(ANALYSES)
    assert tuple(SOLVERS) == solver_names.SOLVERS
    assert tuple(SPLITTINGS) == solver_names.SPLITTINGS
    assert tuple(RUNGE_KUTTA) == solver_names.RUNGE_KUTTA
    assert tuple(NYSTROM) == solver_names.NYSTROM
    assert tuple(name for name, solver in SPLITTINGS.items() if solver.processed) == solver_names.PROCESSED


# ---- names of a user's file


@pytest.mark.parametrize("path", sorted((ROOT / "configs").rglob("*.py")), ids=lambda path: path.stem)
def test_names_of_a_users_file_are_those_that_it_has(path):
    """What the text says is what the function says when it is run; where it says nothing, nothing is refused."""
    names, made = names_in(path.read_text(), path), UserFile(path)
    assert names.parameters == tuple(made.parameters)
    assert names.states in (None, made.states)


@pytest.mark.parametrize(
    "text",
    [
        "def system(**more): return dict(rhs=rhs, coordinates=('x',))",
        "@traced\ndef system(a=1.0): return dict(rhs=rhs, coordinates=('x',))",
        "if 1:\n    def system(a=1.0): return dict(rhs=rhs, coordinates=('x',))",
        "system = make()",
    ],
)
def test_names_that_the_text_does_not_say(tmp_path, text):
    assert names_in(text, tmp_path / "own.py") == Names()


@pytest.mark.parametrize("names", ["('x', 't')", "('x', 'x')", "f('x')", "['x', 1]"])
def test_coordinates_that_are_left_to_the_file(tmp_path, names):
    text = f"def system(a=1.0): return dict(rhs=rhs, coordinates={names})"
    assert names_in(text, tmp_path / "own.py") == Names(("a",))


def test_a_file_that_is_not_python(tmp_path):
    path = tmp_path / "own.py"
    with pytest.raises(UserFileError, match=r"own.py:1: not valid Python: "):
        names_in("def system(a=1.0: return", path)


UNDECIDED = """\
import numpy
names = [f"x{k}" for k in range(2)]
def system(a=1.0): return dict(rhs=lambda y, t: (y[1], -a * y[0]), coordinates=tuple(names))
"""
CONFIG = "system: {file: own.py}\ninitial: {x0: 1.0}\nsweep: {a: {values: [1.0]}}\nanalyses: {portrait: {}}\n"


def test_the_same_models_check_names_that_only_the_run_file_gives(tmp_path):
    """Before it is run nothing is refused that its names decide; then in the words of any other file."""
    (tmp_path / "own.py").write_text(UNDECIDED)
    path = tmp_path / "own.yaml"
    path.write_text(CONFIG)
    assert load(path).coordinates == ("x0", "x1")
    assert load_config(path, ["initial.x7=1.0"]).title == ""
    told = message(load, path, ["initial.x7=1.0"])
    assert told == "command line: initial.x7: unknown key; known keys are project, level, x0, x1"
    told = message(load, path, ["accuracy.scale={x7: 1.0}"])
    assert told == "command line: accuracy.scale.x7: unknown key; known keys are x0, x1"
    assert message(load_config, path, ["system.b=1.0"]).startswith("command line: system.b: unknown key")


def test_a_system_without_parameters_has_no_keys_of_its_own(tmp_path):
    (tmp_path / "own.py").write_text("def system(): return dict(rhs=lambda y, t: (-y[0],), coordinates=('x',))\n")
    path = tmp_path / "own.yaml"
    path.write_text(CONFIG.replace("x0", "x").replace("{a: ", "{x: ").replace("initial: {x: 1.0}\n", ""))
    assert message(load_config, path, ["system.a=1.0"]).startswith("command line: system.a: unknown key")
