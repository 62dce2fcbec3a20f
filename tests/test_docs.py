"""The pages in docs/ and the README, without building them: links lead somewhere, configs load, commands and options exist."""

from __future__ import annotations

import re
import shlex
from importlib import import_module

import pytest
import typer

import jaxnh
from jaxnh.__main__ import COMMANDS
from jaxnh.analyses.registry import ANALYSES
from tests.helpers.paths import ROOT

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES = [page for page in PAGES if "_build" not in page.parts]
BLOCK = re.compile(r"^```([^\n]*)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def name_of(page):
    return str(page.relative_to(ROOT))


def blocks(page, *kinds):
    """Texts of the fenced blocks of some kinds."""
    return [text for kind, text in BLOCK.findall(page.read_text()) if kind in kinds]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page):
    text = BLOCK.sub("", page.read_text())
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        file = target.partition("#")[0]
        assert "//" in target or not file or (page.parent / file).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_configs_load(page, tmp_path):
    """Those that are whole, with the user's files that the page writes."""
    texts = [
        text for text in blocks(page, "yaml") if all(f"{key}:" in text for key in ("initial", "sweep", "analyses"))
    ]
    for text in texts:
        assert jaxnh.Experiment.from_text(text).analyses
    written = [text.split("\n", 1) for text in blocks(page, "{code-cell}") if text.startswith("%%writefile ")]
    for first, text in written:
        (tmp_path / first.split()[1]).write_text(text)
    for path in tmp_path.glob("*.yaml"):
        assert jaxnh.load(path).analyses


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_commands_exist(page):
    """Every `jaxnh COMMAND` of a block or a cell, and its options."""
    text = "\n".join(blocks(page, "sh", "{code-cell}"))
    for line in re.findall(r"^!?(?:\.venv/bin/)?jaxnh ([a-z][^\n]*)$", text, re.MULTILINE):
        name, *words = shlex.split(line.partition("|")[0], comments=True)
        assert name in COMMANDS, line
        command = typer.main.get_command(import_module(f"jaxnh.cli.commands.{name}").app)
        known = {"--help", *(option for parameter in command.params for option in parameter.opts)}
        assert {word for word in words if word.startswith("--")} <= known, line


def test_every_analysis_and_option_is_in_the_table():
    text = (ROOT / "docs" / "howto" / "config.md").read_text()
    rows = dict(re.findall(r"^\| `(\w+)` \|.*\|([^|]*)\|$", text, re.MULTILINE))
    assert {name: set(re.findall(r"`(\w+)`", cell)) for name, cell in rows.items()} == {
        name: set(analysis.options.model_fields) for name, analysis in ANALYSES.items()
    }
