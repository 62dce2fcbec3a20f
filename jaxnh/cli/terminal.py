"""What a run shows: progress with rate and time left, and tables at its end. No numerics."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, Task, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from jaxnh.analyses.base import Group

_LOG_SECONDS = 60.0


class _Rate(ProgressColumn):
    """Lane-periods a second."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:,.0f} lane-periods/s" if task.speed and task.total else "")


class Bar:
    """Progress as a bar on a terminal."""

    def __init__(self, console: Console) -> None:
        self._progress = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            _Rate(),
            TimeRemainingColumn(),
            console=console,
            transient=True,
        )
        self._task: int | None = None

    def start(self, label: str, total: float) -> None:
        self._progress.start()
        self._task = self._progress.add_task(label, total=total or None)

    def advance(self, amount: float) -> None:
        if self._task is not None:
            self._progress.update(self._task, advance=amount)  # pyright: ignore[reportArgumentType]

    def finish(self) -> None:
        if self._task is not None:
            self._progress.remove_task(self._task)  # pyright: ignore[reportArgumentType]
            self._task = None
        self._progress.stop()


class Log:
    """Progress as plain lines: one when a stage of some length begins, then one a minute."""

    def __init__(self) -> None:
        self._label, self._total, self._done, self._began, self._said = "", 0.0, 0.0, 0.0, 0.0

    def start(self, label: str, total: float) -> None:
        self._label, self._total, self._done = label, total, 0.0
        self._began = self._said = time.monotonic()
        size = f" ({total:,.0f} lane-periods)" if total else ""
        print(f"{label}{size}", file=sys.stderr, flush=True)

    def advance(self, amount: float) -> None:
        self._done += amount
        now = time.monotonic()
        if now - self._said < _LOG_SECONDS or not self._total:
            return
        self._said = now
        rate = self._done / (now - self._began)
        left = (self._total - self._done) / rate
        print(
            f"{self._label}: {self._done / self._total:.0%}, {rate:,.0f} lane-periods/s, {left:,.0f} s left",
            file=sys.stderr,
            flush=True,
        )

    def finish(self) -> None: ...


def progress(console: Console) -> Bar | Log:
    """A bar where the console is a terminal, else plain lines."""
    return Bar(console) if console.is_terminal else Log()


def doubling_table(group: Group, published: Mapping[str, np.ndarray], source: str, swept: str = "b") -> Table:
    """Levels of a cascade beside published values: b with its error, their difference, and δ of both.

    Args:
        group: result of the analysis `doubling`.
        published: published `b` and `delta`, a value a level, NaN where there is none; may be empty.
        source: where they are from.
        swept: what b is called.
    """
    ours = {name: variable.data for name, variable in group.variables.items()}
    levels = len(ours["b"])
    theirs = {
        name: np.append(published.get(name, np.empty(0)), np.full(levels, np.nan))[:levels] for name in ("b", "delta")
    }
    limit, error = group.attrs["delta_limit"], group.attrs["delta_limit_error"]
    caption = f"δ → {limit:.4f} ± {error:.1g}" if np.isfinite(limit) else None
    table = Table(title="Period doublings", caption=caption, padding=(0, 0, 0, 1))  # within 80 columns
    compared = bool(published)
    table.add_column("period", justify="right")
    if compared:
        table.add_column(f"{swept}, {source}", justify="right")
    for head in (swept, "± error"):
        table.add_column(head, justify="right")
    if compared:
        table.add_column("difference", justify="right")
        table.add_column(f"δ, {source}", justify="right")
    table.add_column("δ", justify="right")
    for k in range(levels):
        n = int(ours["period"][k])
        row = [f"{n} → {2 * n}", f"{ours['b'][k]:.12f}", f"{ours['b_error'][k]:.1e}", f"{ours['delta'][k]:.6f}"]
        if compared:
            difference = theirs["b"][k] - ours["b"][k]
            row[1:1] = [f"{theirs['b'][k]:.6f}"]
            row[4:4] = [f"{difference:+.1e}", f"{theirs['delta'][k]:.4f}"]
        table.add_row(*("–" if cell in ("nan", "+nan") else cell for cell in row))
    return table


TABLES = {"doubling": doubling_table}
"""Terminal tables by analysis; an analysis without one is summed up by its shapes."""
