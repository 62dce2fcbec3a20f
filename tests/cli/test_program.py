"""The program `jaxnh`: its commands are those of `python -m jaxnh.COMMAND`; what a release says of itself agrees."""

from __future__ import annotations

import sys
import tomllib

import pytest
from ruamel.yaml import YAML

import jaxnh
from jaxnh.__main__ import COMMANDS, main
from tests.helpers.paths import ROOT


@pytest.fixture
def program(monkeypatch, capsys):
    """Exit code, standard output and standard error of the program, run in this process."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["jaxnh", *map(str, arguments)])
        code = main()
        return code, *capsys.readouterr()

    return run


def test_it_names_its_commands(program):
    code, out, err = program()
    assert (code, err) == (0, "")
    assert all(f"  {name} " in out for name in COMMANDS)
    assert program("--help")[1] == out
    assert program("--version") == (0, f"jaxnh {jaxnh.__version__}\n", "")
    assert program("sweeep") == (
        2,
        "",
        "command line: COMMAND: must be one of sweep, plot, cost, explore, inspect, not sweeep\n",
    )


def test_it_runs_them(program, tmp_path):
    """With their arguments, their words and their exit codes."""
    assert "jaxnh plot " in program("plot", "--help")[1]
    assert program("sweep", tmp_path / "a.yaml") == (2, "", f"{tmp_path}/a.yaml: there is no such file\n")
    code, out, _ = program("inspect", ROOT / "results" / "table1.h5")
    assert code == 0
    assert "doubling" in out


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("jaxnh sw", ["sweep"]),
        ("jaxnh sweep --fr", ["--fresh"]),
        ("jaxnh cost a.yaml analyses.chaos", ["transient=", "periods="]),
        ("jaxnh sweep a.yaml analyses.chaos01.p", ["periods="]),
        ("jaxnh sweep a.yaml system.constraint=f", ["free"]),
        ("jaxnh sweep a.yaml sweep.b.st", ["start=", "stop="]),
        ("jaxnh plot a.h5 --colour a", ["attractor"]),
        ("jaxnh plot a.h5 --size c", ["column"]),
        ("jaxnh sweep a.yaml nothing.", []),
    ],
)
def test_the_shell_completes(monkeypatch, capsys, words, offered):
    """Commands, their options, and the keys of a config with their values; JAX is not asked."""
    monkeypatch.setenv("_JAXNH_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    monkeypatch.setattr(sys, "argv", ["jaxnh"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
    said = capsys.readouterr().out.split()
    assert all(any(line.endswith(word) for line in said) for word in offered)
    assert bool(said) == bool(offered)


@pytest.mark.parametrize(
    ("word", "offered"),
    [
        ("system.", ["system.file=", "system.rate="]),
        ("initial.x", ["initial.x=", "initial.x_dot="]),
        ("sweep.rate.v", ["sweep.rate.values="]),
        ("sweep.b", []),
    ],
)
def test_the_shell_completes_names_of_a_users_file(tmp_path, monkeypatch, capsys, word, offered):
    """Parameters and coordinates as its text has them, and no keys of the particle."""
    (tmp_path / "own.py").write_text("def system(rate=1.0):\n    return dict(T=T, Q=Q, coordinates='x')\n")
    (tmp_path / "own.yaml").write_text("system: {file: own.py}\n")
    test_the_shell_completes(monkeypatch, capsys, f"jaxnh sweep {tmp_path}/own.yaml {word}", offered)
    monkeypatch.setattr(sys, "argv", ["jaxnh"])
    with pytest.raises(SystemExit):
        main()
    assert capsys.readouterr().out.split() == offered


def test_a_release_says_the_same_everywhere():
    """The version is that of the package alone; the citation has it, and the scripts lead to functions that are there."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert "version" in project["project"]["dynamic"]
    assert project["tool"]["hatch"]["version"]["path"] == "jaxnh/__init__.py"
    assert project["project"]["scripts"] == {"jaxnh": f"{main.__module__}:{main.__name__}"}
    citation = YAML(typ="safe").load((ROOT / "CITATION.cff").read_text())
    assert (citation["title"], citation["version"]) == ("jaxnh", jaxnh.__version__)
    assert (citation["license"], project["project"]["license"]) == ("MIT", "MIT")
    assert (ROOT / "jaxnh" / "py.typed").is_file()
