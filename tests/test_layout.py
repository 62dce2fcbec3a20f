"""The tests themselves: what they may import, and that their folders are those of what they test."""

from __future__ import annotations

import ast
import textwrap

from tests.helpers.paths import ROOT

TESTS = ROOT / "tests"
OF_NO_PACKAGE = {"flows", "hard", "helpers", "sweeps"}


def imported(text):
    """Dotted names of all that code imports; none of a text that is no code."""
    try:
        tree = ast.parse(textwrap.dedent(text))
    except SyntaxError:
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "import " in node.value:
            yield from imported(node.value)


def of_a_test(name):
    """Whether a module in a dotted name has tests, or is a conftest."""
    return any(part.startswith("test_") or part == "conftest" for part in name.split("."))


def test_no_test_is_imported():
    """Nor by code in a string that a process runs: what tests share is in helpers and flows, for each to import."""
    for folder in (TESTS, ROOT / "sweeps"):
        for path in sorted(folder.rglob("*.py")):
            names = [name for name in imported(path.read_text()) if of_a_test(name)]
            assert not names, f"{path.relative_to(ROOT)} imports {', '.join(names)}"


CODE = '''
from tests.maps.NAME import moved
import tests.NAME
import numpy

SCRIPT = """
    import NAME
"""
'''


def test_imports_of_tests_are_seen():
    names = [name for name in imported(CODE.replace("NAME", "test_kicks")) if of_a_test(name)]
    assert names == ["tests.maps.test_kicks.moved", "tests.test_kicks", "test_kicks"]


def test_folders_are_those_of_the_package():
    folders = {path.parent.name for path in TESTS.glob("*/*.py")}
    assert {name for name in folders - OF_NO_PACKAGE if not (ROOT / "jaxnh" / name).is_dir()} == set()
    assert [path for path in TESTS.rglob("*.py") if not (path.parent / "__init__.py").exists()] == []
