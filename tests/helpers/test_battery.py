"""The page of the hard cases: what stands in it of the tests that ran now, and what of those before."""

from __future__ import annotations

from sweeps.checks.measured_at import Stamp, stamps_of
from tests.helpers.battery import CASES, Battery, BatteryRecord, page

FIRST, SECOND = Stamp("0" * 12, "a" * 12), Stamp("1" * 12, "b" * 12)


def ran(case, node, *, held=1.0, failed=""):
    """A test that has kept one row within its limit of one or beyond it, one that is refused, and a note."""
    kept = [("hard case", case)]
    battery = Battery(case, full=True, folder=None, keep=lambda name, item: kept.append((name, item)))
    try:
        battery.row("a number", held, 1.0, "error")
    except AssertionError as error:
        failed = str(error)
    battery.refused("|d| above c", "no: |d| | c")
    battery.note(f"a word of {node}")
    return BatteryRecord(f"tests/hard/{node}", 1.0, kept, failed)


def test_cases_are_kept_and_measured_anew():
    """Of cases without tests the section stays, with the code that it is of; totals are those of all sections."""
    first = page([ran(CASES[0], "test_a"), ran(CASES[1], "test_b", held=2.0)], FIRST)
    assert "1 rows held, 2 refused, 1 failed; 1 tests failed." in first
    assert "**failed**: `tests/hard/test_b`: a number: error 2.0 is above 1.0" in first
    second = page([ran(CASES[1], "test_b", held=0.5)], SECOND, first)
    assert "2 rows held, 2 refused, 0 failed; 0 tests failed." in second
    assert stamps_of(second) == [FIRST, SECOND]
    assert second.count("a word of test_a") == second.count("a word of test_b") == 1
    assert page([], SECOND, second) == second
    assert f"Not measured: {', '.join(CASES[2:])}." in second


def test_other_tests_of_a_case_are_kept():
    """One test of a case measured anew; a section without names of tests stands until all of its tests are anew."""
    first = page([ran(CASES[0], f"test_file.py::test_{letter}") for letter in "ab"], FIRST)
    second = page([ran(CASES[0], "test_file.py::test_b[1]"), ran(CASES[0], "test_file.py::test_b[2]")], SECOND, first)
    assert "3 rows held, 3 refused, 0 failed; 0 tests failed." in second
    assert stamps_of(second) == [FIRST, SECOND]
    assert second.index("### test_a") < second.index("### test_b") < second.index(str(SECOND))
    unnamed = first.replace("### test_a\n\n", "").replace("### test_b\n\n", "")
    half = page([ran(CASES[0], "test_file.py::test_a")], SECOND, unnamed)
    assert half.count("a word of test_file.py::test_a") == 2
    whole = page([ran(CASES[0], "test_file.py::test_b")], SECOND, half)
    assert stamps_of(whole) == [SECOND]
    assert "2 rows held, 2 refused, 0 failed" in whole


def test_failures_that_belong_to_no_case():
    """A test that fails before it says of which case it is stands at the head."""
    found = page([BatteryRecord("tests/hard/test_c", 0.1, [], "no such fixture")], FIRST)
    assert "0 rows held, 0 refused, 0 failed; 1 tests failed." in found
    assert "- **failed**: `tests/hard/test_c`: no such fixture" in found
