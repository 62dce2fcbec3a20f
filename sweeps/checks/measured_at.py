"""The code that a page of results was measured at: one line of the page, and whether it is still the code there is.

The line names the commit, and a hash of the package's own files, which also tells apart changes not yet committed and
needs no git to be compared.
"""

from __future__ import annotations

import hashlib
import re
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
PACKAGE = "jaxnh"
_MEASURING = (PACKAGE, "sweeps", "tests", "configs", "pyproject.toml", "constraints.txt")  # results/ is being written
_LINE = re.compile(r"Measured at commit (?P<commit>.+?), `jaxnh/` of hash (?P<code>[0-9a-f]{12})\.")


class Stamp(NamedTuple):
    """The code that was measured.

    Attributes:
        commit: in short, "unknown" outside a git checkout, and " with changes" where files differed from it.
        code: first twelve digits of the SHA-256 of the package's Python files.
    """

    commit: str
    code: str

    def __str__(self) -> str:
        return f"Measured at commit {self.commit}, `jaxnh/` of hash {self.code}."


def stamp(root: Path = ROOT) -> Stamp:
    """The code as it stands now."""
    commit = _git(root, "rev-parse", "--short=12", "HEAD")
    changed = _git(root, "status", "--porcelain", "--", *_MEASURING) if commit else ""
    return Stamp((commit or "unknown") + (" with changes" if changed else ""), code_hash(root))


def code_hash(root: Path = ROOT) -> str:
    """First twelve digits of the SHA-256 of names and text of the package's Python files."""
    total = hashlib.sha256()
    for path in sorted((root / PACKAGE).rglob("*.py")):
        text = path.read_bytes()
        total.update(f"{path.relative_to(root).as_posix()} {len(text)}\n".encode() + text)
    return total.hexdigest()[:12]


def measured_since(files: Iterable[Path], root: Path = ROOT) -> bool:
    """Return whether all files were written after the package's last change, by the times of the file system."""
    changed = max(path.stat().st_mtime for path in (root / PACKAGE).rglob("*.py"))
    return all(path.stat().st_mtime >= changed for path in files)


def stamps_of(page: str) -> list[Stamp]:
    """The stamps in the text of a page, each once: one, or where its parts were measured by themselves some."""
    return list(dict.fromkeys(Stamp(found["commit"], found["code"]) for found in _LINE.finditer(page)))


def age(page: str, root: Path = ROOT) -> str:
    """In words, how the code that a page was measured at compares with the code there is."""
    now = code_hash(root)
    same = [was.code == now for was in stamps_of(page)]
    if not same:
        return "names no commit"
    return "the code as it is" if all(same) else "in part an older code" if any(same) else "an older code"


def last_commit(path: str, root: Path = ROOT) -> str:
    """The commit that last changed a file, in short; "" where there is none."""
    return _git(root, "log", "-1", "--format=%h", "--", path)


def _git(root: Path, *arguments: str) -> str:
    """Return what git prints, "" where there is no git or no checkout."""
    try:
        done = subprocess.run(["git", "-C", str(root), *arguments], capture_output=True, text=True, check=False)
    except OSError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
