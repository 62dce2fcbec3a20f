"""The check of names that code mentions where no type checker looks."""

from __future__ import annotations

from sweeps.checks.quoted_names import faults

GONE = '''\
from PACKAGE.maps import iterate
from PACKAGE.maps.iterate import gone_one

CODE = """
import PACKAGE.maps.iterate as maps
from PACKAGE.maps.iterate import gone_two
maps.gone_three
"""


def test(monkeypatch, mock):
    monkeypatch.setattr(iterate, "gone_four", None)
    monkeypatch.setattr(iterate, "record", None)
    mock.patch("PACKAGE.maps.iterate.gone_five")
    iterate.gone_six
    other = None
    other.gone_seven
'''


def test_names_that_are_gone(tmp_path):
    """Each way to mention a name is seen, and none that is there or is no name of the package."""
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_it.py").write_text(GONE.replace("PACKAGE", "jaxnh"))
    places = {
        fault.rsplit("iterate.", 1)[1].split(",")[0]: int(fault.split(":")[1]) for fault in faults(tmp_path / "tests")
    }
    assert places == {"gone_one": 2, "gone_two": 6, "gone_three": 7, "gone_four": 12, "gone_five": 14, "gone_six": 15}
