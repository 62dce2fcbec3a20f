"""Names of the package that code mentions where no type checker looks: in strings, and as attributes that are replaced.

    python -m sweeps.checks.quoted_names

`make test` runs this over tests and sweeps: what `monkeypatch.setattr` and `mock.patch` replace, attributes of modules,
and imports, those of code in strings too, have to be there. A slow test that names what is gone fails only when it is
run.
"""

from __future__ import annotations

import ast
import importlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

from sweeps.checks.measured_at import PACKAGE, ROOT

FOLDERS = ("tests", "sweeps")
_IMPORTING = re.compile(rf"(import|from) {PACKAGE}\b")
_REPLACING = re.compile(r"(^|\.)(setattr|delattr|patch|patch\.object)$")


def faults(folder: Path) -> Iterator[str]:
    """Mentions of names that are not there, in every module of a folder: file, line and name."""
    for path in sorted(folder.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for line, name in _of_module(tree):
            yield f"{path.relative_to(folder.parent)}:{line}: there is no {name}"
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and _IMPORTING.search(node.value):
                for line, name in _of_text(node.value):
                    yield f"{path.relative_to(folder.parent)}:{node.lineno + line - 1}: there is no {name}, in a string"


def _of_text(text: str) -> Iterator[tuple[int, str]]:
    """The same of code in a string; nothing of what is no code."""
    try:
        tree = ast.parse(text)
    except SyntaxError:
        return
    yield from _of_module(tree)


def _of_module(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and name of what a module mentions and is not there."""
    modules: dict[str, ModuleType] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == PACKAGE:
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                if (target := _resolve(name)) is None:
                    yield node.lineno, name
                elif isinstance(target, ModuleType):
                    modules[alias.asname or alias.name] = target
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.asname and alias.name.split(".")[0] == PACKAGE:
                    if (target := _resolve(alias.name)) is None:
                        yield node.lineno, alias.name
                    elif isinstance(target, ModuleType):
                        modules[alias.asname] = target
    assigned = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    assigned |= {node.arg for node in ast.walk(tree) if isinstance(node, ast.arg)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id not in assigned:
            module = modules.get(node.value.id)
            if module and _resolve(f"{module.__name__}.{node.attr}") is None:
                yield node.lineno, f"{module.__name__}.{node.attr}"
        elif isinstance(node, ast.Call) and (name := _replaced(node, modules)):
            yield node.lineno, name


def _replaced(call: ast.Call, modules: dict[str, ModuleType]) -> str | None:
    """The name that a call replaces, if it is of the package and not there."""
    if not _REPLACING.search(ast.unparse(call.func)):
        return None
    first, *more = [*call.args, None]
    name = None
    if isinstance(first, ast.Constant) and str(first.value).startswith(f"{PACKAGE}."):
        name = str(first.value)
    elif isinstance(first, ast.Name) and first.id in modules and isinstance(more[0], ast.Constant):
        name = f"{modules[first.id].__name__}.{more[0].value}"
    return name if name and _resolve(name) is None else None


def _resolve(name: str) -> object | None:
    """The module, or attribute of one or of a class in it, of a dotted name; None where there is none."""
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        try:
            target: object = importlib.import_module(".".join(parts[:k]))
        except ModuleNotFoundError:
            continue
        for part in parts[k:]:
            if not hasattr(target, part):
                return None
            target = getattr(target, part)
        return target
    return None


def main() -> int:
    """Print all faults; 1 if there are any."""
    wrong = [fault for folder in FOLDERS for fault in faults(ROOT / folder)]
    print("\n".join(wrong) if wrong else f"quoted names: all that {' and '.join(FOLDERS)} mention are there")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
