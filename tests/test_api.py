"""The public face: what a script, a notebook and a program that has JAX at work already get from `jaxnh`."""

from __future__ import annotations

import ast
import importlib
import os
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import nbclient
import nbformat
import numpy as np
import pytest

import jaxnh
from jaxnh import exceptions
from jaxnh.engine.experiment import Experiment
from tests.helpers import taylor
from tests.helpers.commands import run_here
from tests.helpers.comparisons import same_tree
from tests.helpers.kept_programs import lanes_with_kept_programs, session_of
from tests.helpers.paths import ROOT

PACKAGE = ROOT / "jaxnh"
TITLE = "In memory and on disk"
CONTENT = {
    "title": TITLE,
    "system": {"constraint": "constant_speed"},
    "sweep": {"b": {"start": 5.2, "stop": 5.45, "count": 40}},
    "accuracy": {"solver": "blanes_moan6", "steps": 40},
    "analyses": {
        "diagram": {"transient": 130, "strobes": 3, "start": "random", "n_starts": 2},
        "poincare": {"transient": 130, "strobes": 2},
    },
}
SMALL = ["sweep.b={start: 5.56, stop: 5.48, count: 96}", "accuracy.target=1e-9", "analyses.doubling.levels=2"]


def python(code, **environment):
    """Standard output of a fresh interpreter."""
    found = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    found = {name: value for name, value in found.items() if value is not None}
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        cwd=ROOT,
        env=found,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def lines():
    """The lines that the package shows first, on fewer lanes."""
    shown = textwrap.dedent("\n".join(line for line in jaxnh.__doc__.splitlines() if line.startswith("    ")))
    assert 'jaxnh.load("configs/table1.yaml")' in shown
    return shown.replace('table1.yaml")', f'table1.yaml", {SMALL})')


# ---- a fresh interpreter


def test_import_is_light():
    """Neither JAX nor a library for figures and files is loaded by a name alone, nor by a look at what there is."""
    code = "import sys, jaxnh; dir(jaxnh); jaxnh.InputError, jaxnh.__version__; print(*sys.modules)"
    loaded = set(python(code).split())
    assert not {"jax", "jaxlib", "numpy", "diffrax", "equinox", "matplotlib", "xarray", "h5py"} & loaded
    code = "import sys, jaxnh; jaxnh.figure, jaxnh.open_result; print('jax' in sys.modules)"
    assert python(code).strip() == "False"


def test_a_session_imports_what_it_is_asked_for():
    """No analysis is imported but those of the run, and no library that these do not need."""
    code = "import sys, jaxnh; jaxnh.Session; print(*sys.modules)"
    loaded = set(python(code).split())
    folders = {name.split(".")[2] for name in loaded if name.startswith("jaxnh.analyses.")}
    assert folders == {"base", "batch", "options", "price", "registry"}
    assert not {"diffrax", "matplotlib", "scipy.special", "scipy.spatial", "scipy.linalg", "dask"} & loaded


def test_first_lines(capsys, monkeypatch):
    """As the package shows them: the doublings of Table 1, by their name and with an error."""
    *body, last = lines().splitlines()
    code = "\n".join([*body, f"b = {last}", "print(b.dims, b.values[0], tree['doubling']['b_error'].values[0])"])
    monkeypatch.chdir(ROOT)
    exec(code, {})
    *dims, first, error = capsys.readouterr().out.split()
    assert dims == ["('level',)"]
    par = taylor.Parameters()
    exact = taylor.doubling_point(par, 1, 5.5196, taylor.attractor(par, 5.53, par.start(), 400)[0])[0]
    assert abs(float(first) - float(exact)) <= float(error) < 1e-6


def test_every_name_resolves():
    assert sorted(jaxnh.__all__) == jaxnh.__all__ == dir(jaxnh)
    for name in jaxnh.__all__:
        found = getattr(jaxnh, name)
        assert isinstance(found, str) or found.__doc__, name
    page = (ROOT / "docs" / "reference" / "api.md").read_text()
    assert [
        name for name in set(jaxnh.__all__) - {*vars(exceptions), "__version__"} if not re.search(rf"\b{name}\b", page)
    ] == []
    for name, each in vars(exceptions).items():
        if isinstance(each, type) and each.__module__ == exceptions.__name__:
            assert name in jaxnh.__all__
    with pytest.raises(AttributeError, match="no attribute sweeps"):
        jaxnh.sweeps  # noqa: B018


@pytest.mark.slow
def test_jax_started_before():
    """A warning that says what to do, and the same numbers to what they are stated to: here one period's."""
    content = {**CONTENT, "accuracy": {"target": 1e-6}, "analyses": {"poincare": {"transient": 1, "strobes": 1}}}
    code = f"""
        import warnings
        import jax
        jax.numpy.zeros(1) + 1
        import jaxnh
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", jaxnh.JaxnhWarning)
            tree = jaxnh.run(jaxnh.Experiment.from_dict({content!r}))
        [warning] = [one for one in caught if issubclass(one.category, jaxnh.JaxnhWarning)]
        assert warning.category is jaxnh.JaxStartedWarning
        print(str(warning.message).replace(" ", "_"), tree["poincare"]["x1"].dtype, *tree["poincare"]["x1"].values.ravel())
    """
    unset = dict.fromkeys(("XLA_FLAGS", "EQX_ON_ERROR"))
    message, dtype, *x1 = python(code, JAX_NUM_CPU_DEVICES="1", **unset).split()
    assert message.startswith("JAX_had_started_before_jaxnh_could_set_its_options")
    assert dtype == "float64"
    expected = session_of(Experiment.from_dict(content)).tree()
    np.testing.assert_allclose(
        np.array(x1, float), expected["poincare"]["x1"].values.ravel(), rtol=0, atol=expected.attrs["error_estimate"]
    )


@pytest.mark.slow
def test_notebook(tmp_path):
    """Table 1 in three lines, and the doublings as the last cell shows them."""
    imported, *body = filter(None, lines().splitlines())
    book = nbformat.v4.new_notebook()
    book.cells = [nbformat.v4.new_code_cell(imported), nbformat.v4.new_code_cell("\n".join(body))]
    kernel = {"env": {**os.environ, "PYTHONPATH": str(ROOT), "IPYTHONDIR": str(tmp_path / "ipython")}}
    nbclient.NotebookClient(
        book, timeout=600, kernel_name="python3", resources={"metadata": {"path": str(ROOT)}}
    ).execute(**kernel)
    assert book.cells[0].outputs == []
    [shown] = [output for output in book.cells[1].outputs if output.output_type == "execute_result"]
    assert not [output for output in book.cells[1].outputs if output.output_type == "stream"]
    text = shown["data"]["text/plain"]
    assert "<xarray.DataArray 'b' (level: 2)>" in text
    assert "5.5196" in text
    assert "coupling b at the doubling" in text
    assert "coupling b at the doubling" in shown["data"]["text/html"]


# ---- memory, file and command


@pytest.fixture(autouse=True)
def kept_programs(monkeypatch):
    """Calls within this process find the programs of earlier ones."""
    for module in ("run", "session"):
        monkeypatch.setattr(f"jaxnh.engine.{module}.LaneExecutor", lanes_with_kept_programs)


@pytest.fixture(scope="module")
def experiment():
    return Experiment.from_dict(CONTENT)


@pytest.fixture(scope="module")
def in_memory(experiment):
    return session_of(experiment).tree()


def test_run_in_memory(experiment, in_memory):
    """`jaxnh.run` is a session's tree, and says what decided its numbers."""
    same_tree(jaxnh.run(experiment), in_memory)
    attrs = in_memory.attrs
    assert (attrs["title"], attrs["axes"], attrs["strobe_period"]) == (TITLE, "b", 2 * np.pi)
    assert (attrs["solver"], attrs["steps_per_period"], attrs["summation"]) == ("blanes_moan6", 40, "plain")
    assert attrs["config"] == experiment.text
    assert 0 < attrs["error_estimate"] < 1


def test_run_with_an_output(tmp_path, experiment, in_memory):
    """The same in a file, in one tile or many; a second call reads it; the command writes the same."""
    path = tmp_path / "job.h5"
    with jaxnh.run(experiment, path, tile=16) as tree:
        same_tree(tree, in_memory)
        assert "history" in tree.attrs
    assert [entry.name for entry in tmp_path.iterdir()] == ["job.h5"]
    before = path.read_bytes()
    with jaxnh.run(experiment, str(path), progress=lambda *_: pytest.fail("there is nothing to do")) as tree:
        same_tree(tree, in_memory)
    assert path.read_bytes() == before
    (tmp_path / "job.yaml").write_text(experiment.text)
    done = run_here("job.yaml", "--output", "command.h5", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    with jaxnh.open_result(tmp_path / "command.h5") as tree:
        same_tree(tree, in_memory)
    done = run_here("job.yaml", "--output", "job.h5", cwd=tmp_path)
    assert done.stdout == "job.h5: the result of this config is there; --fresh runs it again\n"


def test_other_output_is_not_replaced(tmp_path, experiment):
    """But when that is asked for."""
    path = tmp_path / "job.h5"
    path.write_text("precious text")
    with pytest.raises(
        jaxnh.ArgumentError, match=r"^output: .*job\.h5 is there and is no result of jaxnh; fresh=True replaces it$"
    ):
        jaxnh.run(experiment, path)
    assert path.read_text() == "precious text"
    with jaxnh.run(experiment, path, fresh=True) as tree:
        assert tree.attrs["title"] == TITLE


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"tile": 16}, "dask and tile are for a run with an output"),
        ({"dask": "local"}, "dask and tile are for a run with an output"),
        ({"output": "/proc/none/job.h5"}, "output: "),
        ({"output": "job.h5", "dask": "nowhere"}, "dask: nowhere is neither local"),
    ],
)
def test_arguments_that_cannot_be_used(experiment, arguments, said):
    with pytest.raises(jaxnh.InputError) as caught:
        jaxnh.run(experiment, **arguments)
    assert str(caught.value).startswith(said)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("output", [None, "job.h5"])
def test_progress(tmp_path, experiment, output, monkeypatch):
    """(label, done, total) of stage after stage, what is done growing to the total."""
    monkeypatch.setattr("jaxnh.engine.cache.calibrations.find", lambda _: None)  # a first run
    said = []
    jaxnh.run(experiment, output and tmp_path / output, progress=lambda *told: said.append(told))
    labels = list(dict.fromkeys(label for label, _, _ in said))
    assert labels[0] == "accuracy: errors of one period on sample lanes"
    assert len(labels) > 1
    for label in labels[1:]:
        told = [(done, total) for name, done, total in said if name == label]
        assert told[0][0] == 0
        assert told[-1][0] == pytest.approx(told[-1][1])
        assert told == sorted(told)
        assert all(0 <= done <= total * (1 + 1e-9) for done, total in told)


def test_stopped_by_the_callback(tmp_path, experiment, in_memory):
    """In memory at once; with an output what is done is kept, and the next call goes on."""

    class Enough(Exception):
        pass

    def stop(label, done, total):
        raise Enough

    with pytest.raises(Enough):
        jaxnh.run(experiment, progress=stop)
    path, tiles = tmp_path / "job.h5", tmp_path / "job.h5.tiles"

    def after_some(label, done, total):
        if list(tiles.glob("0*.h5")):
            raise jaxnh.Stopped("enough for now")

    with pytest.raises(jaxnh.Stopped, match=r"^enough for now with \d+ of 40 tiles done$"):
        jaxnh.run(experiment, path, progress=after_some, tile=1)
    assert not path.exists()
    kept = {entry.name: entry.stat().st_mtime_ns for entry in tiles.glob("0*.h5")}
    assert kept
    with jaxnh.run(experiment, path) as tree:
        same_tree(tree, in_memory)
    assert not tiles.exists()


def test_figure_of_a_tree(in_memory):
    """What is in memory is drawn as a file is."""
    drawing = jaxnh.figure(in_memory)
    assert drawing.get_suptitle() == TITLE


# ---- the source


def modules():
    """Every module of the package with its tree."""
    return {path.relative_to(PACKAGE): ast.parse(path.read_text()) for path in sorted(PACKAGE.rglob("*.py"))}


# What is raised and is not for users, and why.
OTHERS = {
    "AttributeError": {"__init__.py": "what a module must raise for a name that it has not"},
    "BlockingIOError": {"storage/tiles.py": "caught at once: another process has the lock"},
    "ConstructorError": {"config/yaml_tree.py": "caught by the reader of YAML, which says it in a line"},
    "EventFault": {"systems/user_functions.py": "caught at once, and given its line"},
    "Fault": {"config/yaml_tree.py": "caught at once, and given its line", "config/yaml_source.py": "likewise"},
    "FileNotFoundError": {"storage/tiles.py": "a tile that is not there: caught by those who look for it"},
    "_NoNameError": {"engine/cache/executables.py": "caught at once: such a program is compiled and not kept"},
    "NotImplementedError": {
        "config/user_system.py": "a method for subclasses",
        "engine/experiment/base.py": "likewise",
        "maps/protocol.py": "likewise",
        "maps/extended_precision.py": "an operation that no flow with a table of kicks has",
    },
    "PydanticCustomError": dict.fromkeys(
        (
            "config/blocks.py",
            "config/config.py",
            "config/fitting.py",
            "analyses/options/base.py",
            "analyses/options/basins.py",
            "analyses/options/chaos.py",
            "analyses/options/orbits.py",
            "analyses/options/trajectories.py",
            "config/particle.py",
            "config/user_system.py",
            "engine/fitting.py",
            "engine/start_states.py",
        ),
        "of a validator: caught by the config or the session, which say it in a line",
    ),
    "RuntimeError": {
        "engine/dask_workers.py": "in a worker: becomes a RunError in the process of the run",
        "engine/kernels/cuda.py": "a kernel that the compiler refuses: a flaw of the package",
    },
    "self.error": {"storage/atomic.py": "the OSError of a write, which the writer of files says in a sentence"},
    "SystemExit": dict.fromkeys(
        ("sweep.py", "plot.py", "cost.py", "inspect.py", "explore.py"), "the exit code of a command"
    ),
    "TypeError": {
        "maps/build.py": "a solver that does not go with a flow: an error of the caller's program",
        "systems/backward_motion.py": "motions that become one, which have no way back: caught by analyses",
        "maps/inverse.py": "a map that has no inverse: an error of the caller's program, whom analyses check first",
        "storage/hdf5.py": "within one that is read: among UNREADABLE, caught by all readers",
    },
    "UnsupportedError": dict.fromkeys(
        (f"engine/kernels/{name}.py" for name in ("arithmetic", "arrays", "control", "emitter", "source", "values")),
        "caught where a kernel is asked for: XLA compiles the function",
    ),
    "_UnknownEquationError": {"systems/small_arrays.py": "caught at once: such a right-hand side stays as it is"},
    "_NoPointError": {"orbits/collocation/bifurcations.py": "within the search for a zero: caught there"},
    "np.linalg.LinAlgError": {
        "orbits/collocation/adjoint.py": "singular equations, as NumPy's own: caught by the meshes"
    },
    "fault_of": {"plotting/reading.py": "a DamagedError, or the very error that was met: an ordinary failure"},
    "ValueError": {
        "analyses/batch.py": "a batch without a line: an error of the caller's program",
        "maps/general_flow.py": "lanes with a parameter that the flow does not know of: likewise",
        "explorer/fixed_parameters.py": "caught at once: what is not written out is not known",
        "maps/family.py": "maps that do not go into one program: likewise",
        "systems/particle_parameters.py": "no common period: an argument of a constructor; caught by the config",
    },
}


def names_raised(trees):
    """(file, line, name of the class) of every raise; where a function makes it, what its annotation returns."""
    makers = {}
    for tree in trees.values():
        for node in ast.walk(tree):
            returned = ast.unparse(node.returns) if isinstance(node, ast.FunctionDef) and node.returns else ""
            if returned.endswith(("Error", "Fault")):
                makers.setdefault(node.name, set()).add(returned)
    for path, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Raise) and node.exc is not None:
                called = isinstance(node.exc, ast.Call)
                said = ast.unparse(node.exc.func if called else node.exc)
                made = makers.get(said.rsplit(".", 1)[-1], ()) if called else ()
                for name in made or (said,):
                    yield str(path), node.lineno, name


def test_every_exception_is_one_of_the_package():
    """Every `raise` of the package is of a class of `jaxnh.exceptions`, but for those above."""
    trees, ours, met = modules(), {}, set()
    for path in trees:
        module = importlib.import_module(".".join(["jaxnh", *path.with_suffix("").parts]).removesuffix(".__init__"))
        found = {name: value for name, value in vars(module).items() if isinstance(value, type)}
        ours |= {name: value for name, value in found.items() if issubclass(value, jaxnh.JaxnhError)}
    for path, line, name in names_raised(trees):
        if name not in ours:
            assert path in OTHERS.get(name, {}), f"{path}:{line}: {name} is raised"
            met.add((name, path))
    assert met == {(name, path) for name, places in OTHERS.items() for path in places}


COMMANDS = {Path(name) for name in ("__main__.py", "sweep.py", "plot.py", "cost.py", "inspect.py", "explore.py")}


def test_only_commands_speak_and_listen():
    """Nothing else prints, reads the command line or a terminal, or ends the process."""
    for path, tree in modules().items():
        if path in COMMANDS or path.parts[0] == "cli":
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in ("print", "input", "exit", "quit"), f"{path}:{node.lineno}"
            if isinstance(node, ast.Attribute):
                said = ast.unparse(node)
                forbidden = ("sys.argv", "sys.stdout", "sys.stderr", "sys.stdin", "sys.exit", "os._exit")
                assert said not in forbidden, f"{path}:{node.lineno}: {said}"
