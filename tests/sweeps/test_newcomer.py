"""The canary of what a newcomer types: it sings, and it would fall silent."""

from __future__ import annotations

import functools

import pytest

from sweeps.checks import newcomer
from tests.helpers.paths import ROOT

EXAMPLES = {example.name: example for example in newcomer.examples()}
WITHOUT = {
    "atlas.md",
    "config.md",
    "covariant.md",
    "edges.md",
    "graphics_card.md",
    "homoclinic.md",
    "manifolds.md",
    "orbits.md",
    "reversal.md",
    "transients.md",
    "without_clock.md",
}  # pages with configs alone, in parts


def test_every_document_is_run():
    """All pages with something to run, all of the README's examples, each with its time in the page of results."""
    pages = {path.name for path in (ROOT / "docs/howto").glob("*.md")}
    run = {name.split("/")[-1].split(":")[0] for name in EXAMPLES if name.startswith("docs/howto/")}
    assert run == pages - WITHOUT
    assert newcomer.read_page(newcomer.PAGE.read_text())[1].keys() == EXAMPLES.keys()
    assert sum(name.startswith("README.md: ") for name in EXAMPLES) == 6
    readme = (ROOT / "README.md").read_text()
    shell = [line for language, body in newcomer.blocks(readme) if language == "sh" for line in body.splitlines()]
    of_readme = [c for e in EXAMPLES.values() if e.name.startswith("README") and not e.python for c in e.commands]
    assert len(set(of_readme) - {"jaxnh sweep own.yaml"}) == len(shell) - 1  # but make test


@pytest.mark.parametrize(
    ("example", "fault"),
    [
        (newcomer.Example("a line", ("true", "exit 3")), "exit 3: exit code 3"),
        (newcomer.Example("a script", ("raise ValueError('so')",), python=True), "ValueError: so"),
        (newcomer.Example("a cell", (newcomer._cell("%%sh\nfalse\n"),), python=True), "CalledProcessError"),
        (newcomer.Example("a page", ("echo nothing explore ",)), "nothing explore"),
        (newcomer.Example("well", ("test -e README.md", "test ! -e results/table1.h5")), ""),
        (newcomer.Example("a file", (newcomer._cell("%%writefile a.txt\ntext\n"),), python=True), ""),
    ],
)
def test_how_examples_end(example, fault):
    ran = newcomer.run(example)
    assert fault in ran.fault
    assert bool(ran.fault) == bool(fault)


@pytest.mark.parametrize(("seconds", "code"), [(1000.0, 0), (0.0, 1), (None, 1)])
def test_a_time_is_held_against_the_page(tmp_path, monkeypatch, capsys, seconds, code):
    row = f"| `slow` | {seconds} |\n" if seconds is not None else ""
    page = tmp_path / "newcomer.md"
    page.write_text(newcomer._HEAD.format(machine="", stamp="", yardstick=1.0) + row)
    monkeypatch.setattr(newcomer, "PAGE", page)
    monkeypatch.setattr(newcomer, "_LEAST", 0.0)
    monkeypatch.setattr(newcomer, "yardstick", lambda: 3.0)
    monkeypatch.setattr(newcomer, "examples", lambda: [newcomer.Example("slow", ("sleep 0.1",))])
    assert newcomer.main([]) == code
    said = capsys.readouterr().out
    assert ("may take" in said) == (seconds == 0.0)
    assert ("has no time of it" in said) == (seconds is None)


def test_limits_follow_the_machine():
    assert newcomer.limit_of(10.0, 1.0, 0) == 20.0
    assert newcomer.limit_of(10.0, 3.0, 0) == 60.0
    assert newcomer.limit_of(10.0, 0.5, 1) == 40.0  # a faster one's limits are no shorter


@functools.cache
def slower():
    """How many times as slow this machine is as the page's."""
    return newcomer.yardstick() / newcomer.read_page(newcomer.PAGE.read_text())[0]


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_what_a_newcomer_types(name):
    """Each example as it stands, beside another worker's test."""
    ran = newcomer.run(EXAMPLES[name])
    assert not ran.fault
    assert ran.seconds < newcomer.limit_of(newcomer.read_page(newcomer.PAGE.read_text())[1][name], slower(), 1)
