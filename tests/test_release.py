"""What goes out with a release says what is true: the citation, badges, workflows and the paper."""

from __future__ import annotations

import re
import tomllib

import pytest
from ruamel.yaml import YAML

import jaxnh
from tests.helpers.paths import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
PAPER = (ROOT / "paper" / "paper.md").read_text()
SECTIONS = {
    "Summary",
    "Statement of need",
    "State of the field",
    "Software design",
    "Research impact statement",
    "References",
}
"""Sections that the Journal of Open Source Software asks for."""
WORDS = 750, 1750
"""Fewest and most words of an article there."""
ARTICLE = "Complete identification of chaos of nonlinear nonholonomic systems"


def loaded(path):
    return YAML(typ="safe").load(path.read_text())


def fields(entry):
    """Fields of an entry of BibTeX."""
    return dict(re.findall(r"(\w+) = \{(.*?)\}(?:,|\n|$)", entry))


def test_citation_is_that_of_the_repository():
    said, stated = fields(jaxnh.citation()), loaded(ROOT / "CITATION.cff")
    assert said["version"] == stated["version"] == jaxnh.__version__
    assert said["author"] == "{" + stated["authors"][0]["name"] + "}"
    assert said["title"].startswith(stated["title"])
    assert said["license"] == stated["license"] == PROJECT["license"]


def test_the_article_of_the_equations_is_named():
    """Wherever the package says how it is cited and what it rests on."""
    bibliography = (ROOT / "docs" / "reference" / "bibliography.md").read_text()
    for text in (loaded(ROOT / "CITATION.cff")["abstract"], bibliography, (ROOT / "README.md").read_text()):
        assert ARTICLE in " ".join(text.split())


def test_every_source_has_an_entry_with_its_doi():
    """Of theory and solvers: before each year stands the first author of an entry of that year."""
    entries = re.findall(r"^- (.*)$", (ROOT / "docs" / "reference" / "bibliography.md").read_text(), re.MULTILINE)
    assert all(("](https://doi.org/10." in entry) != entry.endswith("No DOI known.") for entry in entries)
    name, year = re.compile(r"[^\W\d_]{3,}"), re.compile(r"(?<![.\d])(?:19|20)\d\d(?=;|(?:, \d{4})*\))")
    for path in (ROOT / "docs" / "theory.md", *sorted((ROOT / "jaxnh" / "solvers").glob("*.py"))):
        text = path.read_text()
        for match in year.finditer(text):
            before = text[max(0, match.start() - 110) : match.start()]
            authors = {name.findall(entry)[0] for entry in entries if f"({match[0]})" in entry}
            assert authors & set(name.findall(before)), (path.name, before, match[0])


def test_badges_are_true():
    readme = (ROOT / "README.md").read_text()
    badges = re.findall(r"\[!\[([^]]*)\]", readme)
    assert sorted(badges) == [f"Licence: {PROJECT['license']}", PROJECT["requires-python"].replace(">=", "Python ≥ ")]


@pytest.mark.parametrize("path", sorted((ROOT / ".github" / "workflows").glob("*.yml")), ids=lambda path: path.stem)
def test_workflows_make_what_there_is(path):
    """Each target is in the Makefile, on Linux and macOS, with the Pythons that are supported."""
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for job in loaded(path)["jobs"].values():
        matrix = job["strategy"]["matrix"]
        assert set(matrix["target"]) == {"test", "docs"} <= targets
        assert {system.split("-")[0] for system in matrix["os"]} == {"ubuntu", "macos"}
        assert min(matrix["python"]) == PROJECT["requires-python"].removeprefix(">=")
        assert job["steps"][-1]["run"] == "make ${{ matrix.target }} PYTHON=python"


def test_issue_templates_are_forms():
    for path in (ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"):
        form = loaded(path)
        assert path.stem == "config" or {"name", "description", "body"} <= form.keys()


def test_paper_has_its_references_and_figures():
    """It has the sections and the length that are asked for, each key in its bibliography, each figure with its target."""
    head, _, body = PAPER.removeprefix("---\n").partition("\n---\n")
    assert {"title", "tags", "authors", "affiliations", "bibliography"} <= YAML(typ="safe").load(head).keys()
    assert set(re.findall(r"^# (.*)$", body, re.MULTILINE)) >= SECTIONS
    assert WORDS[0] <= len(body.split()) <= WORDS[1]
    keys = set(re.findall(r"^@\w+\{(\w+),", (ROOT / "paper" / "paper.bib").read_text(), re.MULTILINE))
    assert set(re.findall(r"@(\w+)", body)) == keys
    made = re.search(r"^PAPER_FIGURES := (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    figures = {name.removesuffix(".png") for name in re.findall(r"\]\((\w+\.png)\)", body)}
    assert made
    assert {f"paper_{name}" for name in figures} == set(made[1].split())
    assert all((ROOT / "paper" / f"{name}.png").exists() for name in figures)
