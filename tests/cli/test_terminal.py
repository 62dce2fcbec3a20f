"""What a run shows: tables whose every cell is known, and progress whose numbers add up."""

from __future__ import annotations

import io
import re

import numpy as np
import pytest
import xarray as xr
from rich.console import Console

from jaxnh.analyses.base import Table
from jaxnh.analyses.batch import Axis
from jaxnh.analyses.cascade import doubling
from jaxnh.analyses.cascade.follow import Cascade
from jaxnh.cli import terminal
from jaxnh.systems.particle import constant_speed

B = np.array([5.25, 5.125, np.nan])
PUBLISHED = {"b": np.array([5.2501, 5.1249, 5.0625]), "delta": np.array([np.nan, 4.5, np.nan])}


def dataset(limit=4.6692, error=0.0312):
    """A cascade as a file of one axis has it, of which the limit of δ is known."""
    columns = {
        "period": np.array([1, 2, 4]),
        "b": B,
        "b_error": np.array([2.5e-12, 1e-9, np.nan]),
        "delta": np.array([np.nan, 4.66920161, np.nan]),
    }
    numbers = {"delta_limit": limit, "delta_limit_error": error}
    numbers |= dict.fromkeys(("alpha", "alpha_error", "limit", "limit_error"), np.nan)
    variables = {name: ("level", column) for name, column in columns.items()}
    return xr.Dataset({**variables, **{name: ((), number) for name, number in numbers.items()}}, attrs={"along": "b"})


def table(*arguments):
    return terminal.show(doubling.table(*arguments))


def rendered(renderable, width=200):
    console = Console(file=io.StringIO(), width=width)
    console.print(renderable)
    return console.file.getvalue()


def cells(text):
    """The cells of the rows of a table."""
    rows = [line.split("│")[1:-1] for line in text.splitlines() if "│" in line]
    return [[cell.strip() for cell in row] for row in rows]


# ---- tables


def test_table_beside_published_values():
    """Theirs, ours with its error, theirs less ours, and both δ; a dash where there is no number."""
    text = rendered(table(dataset(), PUBLISHED, "paper"))
    assert cells(text) == [
        ["1 → 2", "5.250100", "5.250000000000", "2.5e-12", "+1.0e-04", "–", "–"],
        ["2 → 4", "5.124900", "5.125000000000", "1.0e-09", "-1.0e-04", "4.5000", "4.669202"],
        ["4 → 8", "5.062500", "–", "–", "–", "–", "–"],
    ]
    assert "b, paper" in text
    assert "δ, paper" in text
    assert "δ → 4.6692 ± 0.03" in text
    assert "nan" not in text


def test_table_alone():
    """Without published values there are no columns for them, and without a limit no line about it."""
    text = rendered(table(dataset(np.nan, np.nan), {}, ""))
    assert cells(text) == [
        ["1 → 2", "5.250000000000", "2.5e-12", "–"],
        ["2 → 4", "5.125000000000", "1.0e-09", "4.669202"],
        ["4 → 8", "–", "–", "–"],
    ]
    assert "δ →" not in text
    assert "nan" not in text


@pytest.mark.parametrize("count", [1, 5])
def test_published_values_fewer_or_more(count):
    """They go by their level: fewer leave dashes, more are left out."""
    published = {"b": np.linspace(5.3, 5.1, count)}
    rows = cells(rendered(table(dataset(), published, "paper")))
    assert [row[1] for row in rows] == [f"{b:.6f}" for b in published["b"][:3]] + ["–"] * max(0, 3 - count)
    assert [row[5] for row in rows] == ["–"] * 3


def test_no_digit_is_lost_on_a_terminal_of_80_columns():
    rows = cells(rendered(table(dataset(), PUBLISHED, "paper"), width=80))
    assert [row[2] for row in rows] == ["5.250000000000", "5.125000000000", "–"]


def test_a_table_says_how_far_its_cascade_is_found():
    """A dataset of the analysis itself has the limit of δ as a variable, and other axes than b give other heads."""
    found = doubling._dataset(
        constant_speed(), Axis("drive", np.zeros(2), "parameter drive"), 2, Cascade(3, (), (), "nothing")
    )
    drawn = doubling.table(found, {}, "")
    assert drawn.heads == ("period", "drive", "± error", "δ")
    assert drawn.rows == (("3 → 6", "–", "–", "–"), ("6 → 12", "–", "–", "–"))
    assert drawn.caption is None


def test_table_of_many_cascades():
    """A row a point of the other axes, with the first and the last doubling of it; no more than fit a screen."""
    ones = [dataset(limit).assign(delta_limit=limit, delta_limit_error=0.01, levels_found=found)
            for limit, found in ((4.5, 2), (np.nan, 0))]  # fmt: skip
    many = xr.concat([one.drop_attrs().assign_attrs(along="b") for one in ones], xr.Variable("d", [0.1, 0.2]))
    assert doubling.table(many, {}, "").rows == (
        ("0.1", "2", "5.250000000000", "5.125000000000", "δ → 4.5000 ± 0.01"),
        ("0.2", "0", "–", "–", "–"),
    )
    assert doubling.table(many.isel(d=[0] * 100), {}, "").caption == "16 of 100 cascades"


def test_tables_without_rules():
    """Text on the left where it is asked for, no edge, and no cell is wrapped, however narrow the terminal."""
    text = rendered(
        terminal.show(Table("Title", ("", "n"), (("long name of a row", "1"), ("x", "22")), left=(0,), ruled=False))
    )
    assert [line.rstrip() for line in text.splitlines()][-2:] == ["long name of a row   1", "x                   22"]


# ---- progress


class Clock:
    """Time that passes when told to."""

    def __init__(self, monkeypatch):
        self.now = 1000.0
        monkeypatch.setattr(terminal.time, "monotonic", lambda: self.now)


def test_log_says_how_far_it_is_once_a_minute(monkeypatch, capsys):
    """At a rate of ten a second: share, rate and time left; nothing sooner than a minute after the last line."""
    clock = Clock(monkeypatch)
    log = terminal.Log()
    log.start("survey", 6000)
    for _ in range(60):
        clock.now += 5
        log.advance(50)
    log.finish()
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == [
        "survey (6,000 lane-periods)",
        "survey: 10%, 10 lane-periods/s, 540 s left",
        "survey: 20%, 10 lane-periods/s, 480 s left",
        "survey: 30%, 10 lane-periods/s, 420 s left",
        "survey: 40%, 10 lane-periods/s, 360 s left",
        "survey: 50%, 10 lane-periods/s, 300 s left",
    ]


def test_log_of_a_stage_of_no_known_length(monkeypatch, capsys):
    """Its name, and no share of nothing; the next stage counts from zero again."""
    clock = Clock(monkeypatch)
    log = terminal.Log()
    log.start("accuracy", 0)
    clock.now += 100
    log.advance(5)
    log.finish()
    log.start("survey", 100)
    clock.now += 60
    log.advance(50)
    assert capsys.readouterr().err.splitlines() == [
        "accuracy",
        "survey (100 lane-periods)",
        "survey: 50%, 1 lane-periods/s, 60 s left",
    ]


def test_lines_where_there_is_no_terminal(monkeypatch):
    """A bar on a terminal; in a file plain lines, without control characters."""
    monkeypatch.delenv("JPY_PARENT_PID", raising=False)
    assert isinstance(terminal.progress(Console(file=io.StringIO(), force_terminal=False)), terminal.Log)
    assert isinstance(terminal.progress(Console(file=io.StringIO(), force_terminal=True)), terminal.Bar)
    monkeypatch.setenv("JPY_PARENT_PID", "1")  # in a cell of a notebook, which cannot take lines back
    assert isinstance(terminal.progress(Console(file=io.StringIO(), force_terminal=True)), terminal.Log)


def test_bar_goes_away():
    """It shows its stage while it lasts, and none is left when stages follow each other."""
    console = Console(file=io.StringIO(), force_terminal=True, width=120)
    bar = terminal.Bar(console)
    for label, total in (("accuracy", 0), ("survey", 100)):
        bar.start(label, total)
        bar.advance(50)
        bar.finish()
        assert label in console.file.getvalue()
    bar.advance(1)  # between stages: nothing to advance, and no failure
    after = console.file.getvalue().rsplit("\x1b[2K", 1)[1]  # since the line was last erased
    assert re.sub(r"\x1b\[[?0-9;]*[a-zA-Z]|\r", "", after) == ""
