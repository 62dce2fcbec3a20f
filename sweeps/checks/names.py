"""Names that say too little: a class name that a folder has twice, or one word that is a participle or an adverb.

Of classes and modules of the package, of sweeps and of tests; and of functions of modules such a word of its own, a
preposition or an irregular participle (regular ones say what a function gives, as Python's `sorted` does).

    python -m sweeps.checks.names

`make test` runs this. A class is what it is, a module what it has: `CalibratedSession`, not `Calibrated`.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from sweeps.checks.measured_at import PACKAGE, ROOT

FOLDERS = (PACKAGE, "sweeps", "tests")

_PARTICIPLES = [
    "begun",
    "built",
    "chosen",
    "done",
    "drawn",
    "found",
    "given",
    "gone",
    "grown",
    "held",
    "kept",
    "known",
    "left",
    "lost",
    "made",
    "met",
    "put",
    "said",
    "seen",
    "sent",
    "shown",
    "spent",
    "taken",
    "told",
    "written",
]
_PLACES = [
    "about",
    "above",
    "across",
    "after",
    "along",
    "apart",
    "around",
    "before",
    "behind",
    "below",
    "beneath",
    "beside",
    "besides",
    "between",
    "beyond",
    "evenly",
    "from",
    "in",
    "inside",
    "into",
    "near",
    "of",
    "off",
    "on",
    "onto",
    "outside",
    "over",
    "past",
    "through",
    "to",
    "toward",
    "towards",
    "under",
    "until",
    "up",
    "upon",
    "with",
    "within",
    "without",
]
_OF_FUNCTIONS = {*_PARTICIPLES, *_PLACES} - {"left", "put"}  # a side, and a verb
_NOUNS = {"seed", "speed", "_seed", "bed", "feed", "need"}
_ALLOWED = {"Stopped": "the public exception of a call that was stopped, as `asyncio.CancelledError` is named"}
_OF_SEVERAL = {"Contestant": "a program of `sweeps.peers`, which the worker makes by the name of its module"}


def faults(folder: Path) -> Iterator[str]:
    """Lines that say what is wrong with the names in a folder."""
    homes = defaultdict[str, list[str]](list)
    for path in sorted(folder.rglob("*.py")):
        place = path.relative_to(folder.parent).as_posix()
        if _says_too_little(path.stem):
            yield f"{place}: a module is named by what it has, not {path.stem}"
        tree = ast.parse(path.read_text())
        for node in tree.body:
            if isinstance(node, ast.FunctionDef) and node.name.strip("_") in _OF_FUNCTIONS:
                yield f"{place}:{node.lineno}: a function is named by what it does or gives, not {node.name}"
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                homes[node.name].append(f"{place}:{node.lineno}")
                if _says_too_little(node.name) and node.name not in _ALLOWED:
                    yield f"{place}:{node.lineno}: a class is named by what it is, not {node.name}"
    for name, places in homes.items():
        if len(places) > 1 and name not in _OF_SEVERAL:
            yield f"{places[1]}: a class {name} is defined at {places[0]} as well"


def _says_too_little(name: str) -> bool:
    """Return whether a name is one word, and that a participle, a preposition or an adverb."""
    words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)
    if len(words) != 1:
        return False
    word = words[0].lower()
    return word in _PARTICIPLES or word in _PLACES or (word.endswith("ed") and word not in _NOUNS)


def main() -> int:
    """Run the check; returns its exit code."""
    found = [fault for folder in FOLDERS for fault in faults(ROOT / folder)]
    print("\n".join(found) or "names: every class has one of its own, and nothing is a bare participle or preposition")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
