"""The check of names: it finds what it is for, and package, sweeps and tests have none of it."""

from __future__ import annotations

import pytest

from sweeps.checks.measured_at import ROOT
from sweeps.checks.names import FOLDERS, faults


@pytest.mark.parametrize("folder", FOLDERS)
def test_names_of_a_folder(folder):
    assert list(faults(ROOT / folder)) == []


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({"a.py": "class Row: ...", "b.py": "class Row: ..."}, "a class Row is defined at p/a.py:1 as well"),
        ({"a.py": "class Judged: ..."}, "p/a.py:1: a class is named by what it is, not Judged"),
        ({"a.py": "class _Found: ..."}, "not _Found"),
        ({"a.py": "def _over(): ..."}, "p/a.py:1: a function is named by what it does or gives, not _over"),
        ({"a.py": "def known(): ..."}, "not known"),
        ({"a.py": "def halved(): ...\ndef put(): ..."}, ""),
        ({"along.py": ""}, "p/along.py: a module is named by what it has, not along"),
        ({"a.py": "class JudgedAttractor: ...\nclass Seed: ...\nclass Stopped: ..."}, ""),
    ],
)
def test_what_is_found(tmp_path, files, said):
    (tmp_path / "p").mkdir()
    for name, text in files.items():
        (tmp_path / "p" / name).write_text(text)
    found = list(faults(tmp_path / "p"))
    assert bool(found) == bool(said)
    assert all(said in line for line in found)
