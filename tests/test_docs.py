"""The pages in docs/ and the README, without building them: links lead somewhere, configs load, commands and options exist."""

from __future__ import annotations

import re
import shlex
from importlib import import_module
from urllib.parse import unquote

import pytest
import typer

import jaxnh
from jaxnh.__main__ import COMMANDS
from jaxnh.analyses.registry import ANALYSES
from tests.helpers.paths import ROOT

OF_THE_ROOT = ("README.md", "CONTRIBUTING.md", "CODE_OF_CONDUCT.md", "SECURITY.md", "paper/paper.md")
PAGES = [*(ROOT / page for page in OF_THE_ROOT), *sorted((ROOT / "docs").rglob("*.md"))]
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


@pytest.mark.parametrize("page", [page for page in PAGES if page.is_relative_to(ROOT / "docs")], ids=name_of)
def test_links_of_the_built_pages_stay_among_them(page):
    """A page outside docs/ is a link to no built page, and a results page that is included links as the page that has it."""
    text = BLOCK.sub("", page.read_text())
    included = re.findall(r"^```{include} (\S+)", page.read_text(), re.MULTILINE)
    texts = [text, *((page.parent / other).read_text() for other in included if other.startswith("../../results/"))]
    for target in (link for text in texts for link in re.findall(r"\]\(([^)\s]+\.md)[)#]", text) if "//" not in link):
        linked = (page.parent / target).resolve()
        assert linked.is_relative_to(ROOT / "docs"), target
        assert linked.exists(), target


def test_the_changelog_says_nothing_twice():
    begun = [line[:45] for line in (ROOT / "CHANGELOG.md").read_text().splitlines() if line.startswith("- ")]
    assert len(set(begun)) == len(begun)
    assert not re.search("^(<{7}|={7}|>{7})", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)


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


def test_every_source_of_theory_and_solvers_is_in_the_bibliography():
    """By the name before a year; DOIs are what their links lead to, and none stands twice."""
    text = (ROOT / "docs" / "reference" / "bibliography.md").read_text()
    entries = [line for line in text.splitlines() if line.startswith("- ")]
    links = re.findall(r"\[(10\.\S+)\]\(https://doi\.org/(\S+)\)", text)
    assert len(links) == text.count("doi.org") == len(set(links))
    assert all(unquote(target) == doi for doi, target in links)
    theory = (ROOT / "docs" / "theory.md").read_text()
    named = {pair for part in re.findall(r"\(([^()]*\d{4}[^()]*)\)", theory) for pair in surnames_and_years(part)}
    named |= {(name, year) for name, year in re.findall(r"([A-Z]\w+)(?:'s)?(?: and co-workers)? \((\d{4})\)", theory)}
    sources = re.findall(
        r"[(\"]([A-Z][\w-]+)[\w ,-]*, [A-Z][\w. ]+ \d+ \((\d{4})\)",
        "".join(path.read_text() for path in sorted((ROOT / "jaxnh" / "solvers").glob("*.py"))),
    )
    assert len(named) > 25
    assert len(sources) > 8
    for name, year in [*named, *sources]:
        assert any(re.search(rf"\b{name}\b", entry) and f"({year})" in entry for entry in entries), (name, year)


def surnames_and_years(text):
    """The last surname before each year of what stands in brackets."""
    name = ""
    for word in re.findall(r"\w[\w-]*", text):
        if re.fullmatch(r"(18|19|20)\d\d", word):
            if name:
                yield name, word
        elif word[0].isupper():
            name = word
