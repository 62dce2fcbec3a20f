"""What a config's schema refuses is said before JAX is imported, in the words that the models would have."""

from __future__ import annotations

import itertools
import subprocess
import sys

import pytest
from conftest import ROOT

from jaxnh.config.experiment import load
from jaxnh.config.schema_check import check_by_schema
from jaxnh.config.user_names import names_in, users_file
from jaxnh.config.yaml_source import read
from jaxnh.exceptions import ConfigError
from jaxnh.systems.user_file import UserFile

OVERRIDES = [
    "titel=A",
    "analyses.doublings={}",
    "analyses.doubling.level=3",
    "sweep.beta={start: 1.0, stop: 2.0, count: 4}",
    "accuracy.targets=1.0e-6",
    "initial.y3=0.1",
    "levels={count: 2, refines: all}",
    "title=3",
    "system.a=half",
    "system.c=-1",
    "initial=[1]",
    "initial.x1=true",
    "sweep.b.count=10.5",
    "sweep.b.count=1",
    "accuracy.target=0.5",
    "accuracy.precision=double",
    "analyses.doubling.levels=17",
    "analyses.doubling.search=1",
    "analyses.doubling=all",
]
WRONG = ["half", "true", "", "1.5", "-1.0e+9", "1000000000000", ".nan", ".inf", "[1]", "{a: 1}"]


def said(check, *arguments):
    with pytest.raises(ConfigError) as caught:
        check(*arguments)
    return str(caught.value)


@pytest.mark.parametrize("override", OVERRIDES)
def test_in_the_words_of_the_models(override):
    table = ROOT / "configs" / "table1.yaml"
    assert said(lambda: check_by_schema(read(table, [override]))) == said(load, table, [override])


def leaves(content, above=""):
    for key, value in content.items():
        yield above + key
        if isinstance(value, dict):
            yield from leaves(value, f"{above}{key}.")


@pytest.mark.parametrize("config", ["table1", "basins"])
def test_nothing_else_is_said(config):
    """Whatever stands at whatever key: the schema's check is silent, or says what the models say."""
    path, heard = ROOT / "configs" / f"{config}.yaml", {}
    keys = [key for key in leaves(read(path).data) if not key.startswith("compare")]
    for key, value in itertools.product(keys, WRONG):
        override = f"{key}={value}"
        try:
            check_by_schema(read(path, [override]))
        except ConfigError as error:
            heard[override] = str(error)
    assert heard == {override: said(load, path, [override]) for override in heard}
    assert len(heard) > 4 * len(keys)


def test_every_config_passes():
    for path in sorted((ROOT / "configs").rglob("*.yaml")):
        file = users_file(path, read(path).data)
        check_by_schema(read(path), names_in(file) if file else None)


@pytest.mark.parametrize("path", sorted((ROOT / "configs").rglob("*.py")), ids=lambda path: path.stem)
def test_names_of_a_users_file_are_those_that_it_has(path):
    """What the text says is what the function says when it is run; where it says nothing, nothing is refused."""
    names, made = names_in(path), UserFile(path)
    assert names.parameters == tuple(made.parameters)
    assert names.states in (None, made.states)


@pytest.mark.parametrize(
    "text",
    [
        "def system(**more): return dict(rhs=rhs, coordinates=('x',))",
        "@traced\ndef system(a=1.0): return dict(rhs=rhs, coordinates=('x',))",
        "if 1:\n    def system(a=1.0): return dict(rhs=rhs, coordinates=('x',))",
        "def system(a=1.0: return",
        "system = make()",
    ],
)
def test_names_that_the_text_does_not_say(tmp_path, text):
    (tmp_path / "own.py").write_text(text)
    assert names_in(tmp_path / "own.py") == (None, None)
    assert names_in(tmp_path / "none.py") == (None, None)


@pytest.mark.parametrize("override", ["system.drove=1", "initial.z=1", "sweep.omega={values: [1.0]}", "system.rate=a"])
def test_keys_that_a_users_file_does_not_name(override):
    path = ROOT / "configs" / "governor.yaml"
    names = names_in(ROOT / "configs" / "governor.py")
    assert said(lambda: check_by_schema(read(path, [override]), names)) == said(load, path, [override])


def test_jax_is_not_imported(tmp_path):
    """A command ends with code 2 where the import of JAX would end with another one."""
    path = tmp_path / "jax.py"
    path.write_text("raise SystemExit(7)\n")
    command = [
        sys.executable,
        "-c",
        f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import jaxnh.sweep; sys.exit(jaxnh.sweep.main())",
    ]
    done = subprocess.run(
        [*command, str(ROOT / "configs" / "table1.yaml"), "titel=A"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "titel: unknown key (did you mean title?)" in done.stderr
