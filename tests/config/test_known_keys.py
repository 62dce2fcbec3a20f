"""Keys that are not known are said before JAX is imported, in the words that the models would have."""

from __future__ import annotations

import subprocess
import sys

import pytest
from conftest import ROOT

from jaxnh.config.experiment import load
from jaxnh.config.known_keys import check_keys
from jaxnh.config.yaml_source import read
from jaxnh.exceptions import ConfigError

OVERRIDES = [
    "titel=A",
    "analyses.doublings={}",
    "analyses.doubling.level=3",
    "sweep.beta={start: 1.0, stop: 2.0, count: 4}",
    "accuracy.targets=1.0e-6",
    "initial.y3=0.1",
    "levels={count: 2, refines: all}",
]


def said(check, *arguments):
    with pytest.raises(ConfigError) as caught:
        check(*arguments)
    return str(caught.value)


@pytest.mark.parametrize("override", OVERRIDES)
def test_in_the_words_of_the_models(override):
    table = ROOT / "configs" / "table1.yaml"
    assert said(lambda: check_keys(read(table, [override]))) == said(load, table, [override])


def test_every_config_has_known_keys():
    for path in sorted((ROOT / "configs").rglob("*.yaml")):
        check_keys(read(path))


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
