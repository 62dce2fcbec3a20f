"""sweeps/timing/startup.py: what a run is split into, the table of its medians, and a checkout that is none."""

from __future__ import annotations

import pytest

from sweeps.timing import startup
from sweeps.timing.startup import CACHES, PARTS, Checkout, RunSeconds
from tests.helpers.paths import ROOT


def sample(whole, each):
    return RunSeconds(whole, {part: each for part in PARTS if part != "rest"})


def test_table_has_medians_and_shares():
    measured = {
        ("table1", cache, name): [sample(whole, 0.5) for whole in times]
        for cache in CACHES
        for name, times in (("here", (4.0, 99.0, 5.0)), ("abc", (20.0, 10.0, 21.0)))
    }
    head, rule, *rows = startup.table(measured)
    assert head.count("|") == rule.count("|") == rows[0].count("|")
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    assert [row[:3] for row in cells] == [["table1", cache, name] for cache in CACHES for name in ("here", "abc")]
    assert cells[0][3:] == ["5.00", *["0.50"] * 6, "2.00", "10", "0.25"]
    assert cells[1][3] == "20.00"
    assert cells[1][-1] == ""
    text = startup.page(measured, 3)
    assert "medians of 3 runs, here and abc in turn" in text
    assert "Measured at commit" in text


@pytest.mark.slow
def test_a_run_is_split(tmp_path, monkeypatch):
    """Two runs of a small scene, of which the second finds its programs: parts are there and are no more than all."""
    few = startup.TimedConfig(startup.SMALL, ("sweep.b.count=4",))
    monkeypatch.setitem(startup.SCENES, "small", few)
    empty, kept = (startup.run_once(Checkout(ROOT, "here"), "small", tmp_path / "cache", tmp_path) for _ in CACHES)
    for one in (empty, kept):
        assert all(one.of(part) >= 0 for part in PARTS)
        assert one.of("import") > 0
        assert one.of("calibration") > 0
        assert one.of("run") > 0
        assert one.of("writing") > 0
    assert empty.of("compiling") > 0
    assert kept.of("compiling") == 0  # every program outside calibration was found


def test_what_is_no_checkout(tmp_path):
    with pytest.raises(SystemExit, match="there is no jaxnh in it"):
        startup.checkouts_of(tmp_path)
