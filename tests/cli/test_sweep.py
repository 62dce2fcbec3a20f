"""The command as users run it: what it refuses and how, what it leaves alone, and that it can be killed."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest

from tests.helpers import taylor
from tests.helpers.paths import ROOT

CONFIG = """\
title: One doubling
system:
  constraint: constant_speed
  a: 0.5
  c: 1.0
  omega: 1.0
initial: {x1: 0.1, x2: 0.1, y1: 0.1}
sweep:
  b: {start: 5.54, stop: 5.51, count: 64}
accuracy:
  target: 1.0e-6
analyses:
  doubling:
    levels: 1
"""
QUICK = "analyses={diagram: {transient: 1, strobes: 1}}"  # where any analysis will do
DISTURBED = CONFIG.replace("constant_speed", "disturbed_speed\n  d: 0.1")


@pytest.fixture
def config(tmp_path):
    """A config of a run of seconds, alone in a folder."""
    path = tmp_path / "small.yaml"
    path.write_text(CONFIG)
    return path


@pytest.fixture
def small_run(result, tmp_path_factory, tmp_path):
    """A config, its result beside it, and what was printed; the run itself is shared, the files are not."""
    source = tmp_path_factory.mktemp("source") / "small.yaml"
    source.write_text(CONFIG)
    kept, out, err = result("small", source)
    config, path = tmp_path / "small.yaml", tmp_path / "small.h5"
    config.write_text(CONFIG)
    path.write_bytes(kept.read_bytes())
    return config, path, out, err


@pytest.fixture(scope="module")
def exact():
    """b of the doubling that the config finds, by the reference."""
    par = taylor.Parameters()
    return float(taylor.doubling_point(par, 1, 5.5198, taylor.attractor(par, 5.53, par.start(), 400)[0])[0])


def tree(folder):
    """Every file below a folder with its content."""
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def refused(sweep, folder, *arguments):
    """The one line of a run that exits with 2, prints nothing else, and touches no file."""
    before = tree(folder)
    run = sweep(*arguments, cwd=folder)
    assert run.returncode == 2
    assert run.stdout == ""
    assert len(run.stderr.splitlines()) == 1
    assert run.stderr.endswith("\n")
    assert tree(folder) == before
    assert not (folder / "results").exists()
    return run.stderr.strip()


# ---- bad input

BAD = {
    "unknown key": (CONFIG.replace("  a: 0.5", "  aa: 0.5"), "small.yaml:4: system.aa: unknown key"),
    "wrong type": (CONFIG.replace("a: 0.5", "a: half"), "small.yaml:4: system.a: must be a number"),
    "duplicate key": (
        CONFIG.replace("  a: 0.5\n", "  a: 0.5\n  a: 0.6\n"),
        "small.yaml:5: system.a: this key is already",
    ),
    "count": (CONFIG.replace("count: 64", "count: 1"), "small.yaml:9: sweep.b.count: must be at least 2"),
    "c": (CONFIG.replace("c: 1.0", "c: 0"), "small.yaml:5: system.c: must be above 0"),
    "d as large as c": (DISTURBED.replace("d: 0.1", "d: 1.0"), "small.yaml:4: system.d: the speed vanishes"),
    "d at constant speed": (CONFIG.replace("  a:", "  d: 0.1\n  a:"), "small.yaml:4: system.d: d does not go with"),
    "no common period": (
        DISTURBED.replace("omega: 1.0", "omega: 1.2345678"),
        "small.yaml:7: system.omega: sin(1.23457 t) and the disturbance sin t have no common period",
    ),
    "x2 above the speed": (CONFIG.replace("x2: 0.1", "x2: 1.1"), "small.yaml:7: initial.x2: the speed at t = 0 is 1"),
    "not YAML": (CONFIG.replace("{x1", "[x1"), "small.yaml:7: this is not YAML"),
    "empty": ("", "small.yaml:1: the file is empty"),
    "unknown solver": (
        CONFIG.replace("target: 1.0e-6", "solver: euler\n  steps: 100"),
        "small.yaml:11: accuracy.solver: must be one of",
    ),
}


@pytest.mark.parametrize(("text", "message"), BAD.values(), ids=BAD)
def test_bad_config(sweep, config, text, message):
    config.write_text(text)
    assert refused(sweep, config.parent, config.name).startswith(message)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["absent.yaml"], "absent.yaml: there is no such file"),
        (["."], ".: this is a directory, not a config file"),
        (["small.yaml", "system.c=-1"], "command line: system.c: must be above 0"),
        (["small.yaml", "system.d=0.1"], "command line: system.d: d does not go with constant_speed"),
        (["small.yaml", "levels"], "command line: levels: an override is KEY=VALUE"),
        (["small.yaml", "--levels", "3"], "command line: "),
        ([], "command line: CONFIG: name a YAML file"),
    ],
)
def test_bad_command_line(sweep, config, arguments, message):
    assert refused(sweep, config.parent, *arguments).startswith(message)


@pytest.mark.parametrize("output", ["small.yaml/below.h5", "/proc/below/result.h5", "."])
def test_output_that_cannot_be_written(sweep, config, output):
    """Said before anything is computed: below a regular file, where not even root can write, and a folder."""
    assert refused(sweep, config.parent, config.name, "--output", output).startswith("command line: --output: ")


@pytest.mark.slow
def test_target_out_of_reach(sweep, config):
    """A sweep so sensitive that no arithmetic of sixteen digits has the accuracy: which key, and what can be had."""
    overrides = ("accuracy.target=1e-13", "system.omega=0.125", "sweep.b={start: 5.9, stop: 6, count: 2}")
    before = tree(config.parent)
    run = sweep(config.name, *overrides, cwd=config.parent)
    assert run.returncode == 2
    last = run.stderr.splitlines()[-1]
    assert "accuracy.target: no solver has an error of one period of 1e-13" in last
    assert float(re.search(r"comes down to (\S+);", last).group(1)) > 1e-13
    assert "that is rounding" in last
    assert last.endswith("ask for less")
    assert tree(config.parent) == before


# ---- what is there already


def test_run_and_what_it_leaves(small_run, exact):
    """One doubling, as the reference has it; on the terminal, in the file, and one file alone."""
    config, path, out, _ = small_run
    with h5py.File(path) as file:
        b, error = file["doubling/b"][0], file["doubling/b_error"][0]
        assert file.attrs["config"] == CONFIG
        assert file.attrs["error_estimate"] <= 1e-6
    assert abs(b - exact) <= error < 1e-6
    assert f"{b:.12f}" in out
    assert tree(path.parent) == {config: CONFIG.encode(), path: path.read_bytes()}


def test_same_config_is_not_run_again(sweep, small_run):
    """Also with other comments, title and spelling of numbers: it says so, exits with 0, and the file is the same."""
    config, path, _, _ = small_run
    config.write_text("# again\n" + CONFIG.replace("One doubling", "Another title").replace("1.0e-6", "1e-6"))
    before = tree(config.parent)
    run = sweep(config.name, "--output", path.name, cwd=config.parent)
    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout.splitlines() == [f"{path.name}: the result of this config is there; --fresh runs it again"]
    assert tree(config.parent) == before


def test_result_of_another_config_is_not_replaced(sweep, small_run):
    config, path, _, _ = small_run
    message = refused(sweep, config.parent, config.name, "sweep.b.count=65", "--output", path.name)
    assert message == "command line: --output: small.h5 holds the result of another config; --fresh replaces it"


@pytest.mark.parametrize("content", [b"precious text", b"\x89HDF\r\n\x1a\n cut off", b""])
def test_other_file_is_not_replaced(sweep, config, content):
    (config.parent / "other.h5").write_bytes(content)
    message = refused(sweep, config.parent, config.name, "--output", "other.h5")
    assert message == "command line: --output: other.h5 is there and is no result of jaxnh; --fresh replaces it"


def test_a_config_is_never_replaced_by_its_result(sweep, config):
    before = config.read_bytes()
    message = refused(sweep, config.parent, config.name, "--fresh", "--output", config.name)
    assert message == f"command line: --output: {config.name} is the file of the config; name another one"
    assert config.read_bytes() == before


def test_damaged_result_is_not_there(sweep, small_run):
    """One bit of its data, as inspect finds it: it is said, with what to do, and nothing is touched until then."""
    config, path, _, _ = small_run
    with h5py.File(path) as file:
        at = file["doubling/b"].id.get_offset()
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes(data)
    message = refused(sweep, config.parent, config.name, "--output", path.name)
    assert message == (
        "command line: --output: small.h5: the data of /doubling/b do not fit their checksum: "
        "the result of this config, but damaged; --fresh computes it again"
    )


@pytest.mark.parametrize("fresh", [[], ["--fresh"]])
@pytest.mark.parametrize(("output", "what"), [("below", "a folder"), ("pipe", "a device or a pipe")])
def test_output_that_is_no_file(sweep, config, output, what, fresh):
    """--fresh would not help, and is not advised."""
    (config.parent / "below").mkdir()
    os.mkfifo(config.parent / "pipe")
    message = refused(sweep, config.parent, config.name, "--output", output, *fresh)
    assert message == f"command line: --output: {output} is {what}, not a file to write"


def test_output_that_is_a_link(sweep, config, tmp_path_factory):
    """The file that it leads to is written, and read again; the link stays. Of links in a circle a line."""
    disk = tmp_path_factory.mktemp("disk")
    link = config.parent / "link.h5"
    link.symlink_to(disk / "result.h5")
    for words in ("wrote", "the result of this config is there"):
        run = sweep(config.name, QUICK, "--output", link.name, cwd=config.parent)
        assert run.returncode == 0, run.stderr
        assert words in run.stdout
        assert link.is_symlink()
        assert [path.name for path in disk.iterdir()] == ["result.h5"]
    assert "diagram" in h5py.File(link)
    circle = config.parent / "circle.h5"
    circle.symlink_to(circle.name)
    run = sweep(config.name, QUICK, "--output", circle.name, cwd=config.parent)
    assert run.returncode == 2
    assert run.stderr.splitlines() == ["command line: --output: circle.h5 is a link that leads nowhere"]


def test_fresh_replaces(sweep, small_run):
    """Another config's result by the one asked for; and the same config gives the same numbers bit for bit."""
    config, path, _, _ = small_run
    with h5py.File(path) as file:
        first = file["doubling/b"][()]
    run = sweep(config.name, "--output", path.name, "--fresh", cwd=config.parent)
    assert run.returncode == 0
    with h5py.File(path) as file:
        np.testing.assert_array_equal(file["doubling/b"][()], first)
    overrides = ("title=Changed", "sweep.b.count=48", QUICK)
    run = sweep(config.name, *overrides, "--output", path.name, "--fresh", cwd=config.parent)
    assert run.returncode == 0
    with h5py.File(path) as file:
        assert file.attrs["title"] == "Changed"
        assert "count: 48" in file.attrs["config"]
    assert set(tree(path.parent)) == {config, path}


def test_result_goes_by_the_name_of_the_config(sweep, config):
    """Without --output to results/NAME.h5 below the folder it is run in."""
    run = sweep(config.name, QUICK, cwd=config.parent)
    assert run.returncode == 0
    assert run.stdout.splitlines()[-1] == "wrote results/small.h5"
    assert set(tree(config.parent)) == {config, config.parent / "results" / "small.h5"}


@pytest.mark.parametrize(
    ("solver", "steps"), [("blanes_moan4", 100), pytest.param("tsit5", 300, marks=pytest.mark.slow)]
)
def test_solver_and_steps_asked_for(sweep, config, exact, solver, steps):
    """They are what is used, and the error estimate is theirs: the doubling is found to that, not to the target."""
    override = f"accuracy={{solver: {solver}, steps: {steps}}}"
    run = sweep(config.name, override, "--output", "asked.h5", cwd=config.parent)
    assert run.returncode == 0, run.stderr
    with h5py.File(config.parent / "asked.h5") as file:
        assert (file.attrs["solver"], file.attrs["steps_per_period"]) == (solver, steps)
        assert 1e-9 < file.attrs["error_estimate"] < 1
        assert abs(file["doubling/b"][0] - exact) <= file["doubling/b_error"][0]


def test_coarse_accuracy(sweep, config, exact):
    """With an error of 1e-3 allowed, the doubling is found less exactly, but it is found."""
    run = sweep(config.name, "accuracy.target=1e-3", "--output", "coarse.h5", cwd=config.parent)
    assert run.returncode == 0, run.stderr
    with h5py.File(config.parent / "coarse.h5") as file:
        assert abs(file["doubling/b"][0] - exact) <= file["doubling/b_error"][0]


@pytest.mark.slow
def test_compiled_programs_are_kept(sweep_process, config, monkeypatch):
    """A run leaves its programs in the cache, and the same run again finds every one: it adds none, and writes none anew.

    Those of lanes are in a folder of their own; others, if there are any, are kept by JAX.
    """
    cache = config.parent / "cache"
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(cache))
    kept = []
    for _ in range(2):
        assert sweep_process(config.name, QUICK, "--output", "kept.h5", "--fresh", cwd=config.parent).returncode == 0
        of_lanes = {(path.name, path.stat().st_ino) for path in (cache / "jaxnh").iterdir()}
        kept.append((of_lanes, {path.name for path in cache.iterdir() if path.name.endswith("-cache")}))
    assert kept[0] == kept[1]
    assert len(kept[0][0]) > 1


# ---- help


def test_schema(sweep, tmp_path):
    """Valid JSON Schema of the dialect it names, with a place for every key of the configs that are kept."""
    run = sweep("--schema", cwd=tmp_path)
    assert (run.returncode, run.stderr) == (0, "")
    content = json.loads(run.stdout)
    assert content["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert {
        "title",
        "system",
        "initial",
        "sweep",
        "levels",
        "section",
        "explore",
        "accuracy",
        "analyses",
        "device",
        "compare",
    } == set(content["properties"])
    assert {"system", "sweep", "analyses"} == set(content["required"])
    references = [line.split('"')[3] for line in run.stdout.splitlines() if '"$ref"' in line]
    assert references
    assert {reference.removeprefix("#/$defs/") for reference in references} <= set(content["$defs"])
    assert list(tmp_path.iterdir()) == []


def test_help(sweep, tmp_path):
    run = sweep("--help", cwd=tmp_path)
    assert (run.returncode, run.stderr) == (0, "")
    assert all(word in run.stdout for word in ("config", "KEY=VALUE", "--output", "--fresh", "--schema"))


# ---- ends


def started(config, stage):
    """A run that has come to a stage, and that Control-C reaches, which the workers of pytest-xdist ignore.

    It has programs and decisions of its own: with those of a run before it there is no stage of accuracy.
    """
    code = "import runpy, signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    code += "runpy.run_module('jaxnh.sweep', run_name='__main__')"
    command = [sys.executable, "-c", code, config.name, "--output", "killed.h5"]
    kept = config.parent.with_name(f"{config.parent.name}_programs")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "JAX_COMPILATION_CACHE_DIR": str(kept)}
    run = subprocess.Popen(
        command, cwd=config.parent, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    said = list[str]()
    for line in run.stderr:
        if line.startswith(stage):
            return run
        said.append(line)
    raise AssertionError(f"it ended with {run.wait()} before the stage {stage}: {''.join(said)}")


@pytest.mark.slow
@pytest.mark.parametrize("stage", ["accuracy", "doubling"])
def test_killed_run_leaves_no_result(config, stage):
    """Nor anything else but the folder in which it began; what a kill keeps is shown in tests/engine/test_run.py."""
    run = started(config, stage)
    time.sleep(0.3)
    run.kill()
    run.communicate()
    assert run.returncode == -signal.SIGKILL
    left = tree(config.parent)
    assert left.pop(config) == CONFIG.encode()
    assert {path.parent.name for path in left} == {"killed.h5.tiles"}


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_run_says_so(config, number):
    """Control-C or a scheduler's preemption: one line after the stages, no traceback, and the code to go on."""
    run = started(config, "accuracy")
    run.send_signal(number)
    out, err = run.communicate(timeout=120)
    assert run.returncode == 75
    assert out == ""
    assert err.splitlines()[-1] == f"stopped by {number.name}; run the same command again to go on where it stopped"
    assert "Traceback" not in err
    assert tree(config.parent) == {config: CONFIG.encode()}
