"""Display of a run: progress with rate and time left, and tables at its end. No numerics."""

from __future__ import annotations

import os
import sys
import time

from rich import box
from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, Task, TextColumn, TimeRemainingColumn
from rich.table import Table as Renderable
from rich.text import Text

from jaxnh.analyses.base import Table

_LOG_SECONDS = 60.0
_KERNEL = "JPY_PARENT_PID"  # of the environment of a notebook's kernel


class _Rate(ProgressColumn):
    """Lane-periods a second."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:,.0f} lane-periods/s" if task.speed and task.total else "")


class Quiet:
    """Warnings alone."""

    def start(self, label: str, total: float) -> None: ...

    def advance(self, amount: float) -> None: ...

    def finish(self) -> None: ...

    def note(self, text: str) -> None: ...

    def warn(self, text: str) -> None:
        print(text, file=sys.stderr, flush=True)


class Bar(Quiet):
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

    def note(self, text: str) -> None:
        self.warn(text)

    def finish(self) -> None:
        if self._task is not None:
            self._progress.remove_task(self._task)  # pyright: ignore[reportArgumentType]
            self._task = None
        self._progress.stop()


class Log(Quiet):
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
        share = f"{self._done / self._total:.0%}, " if left > 0 else ""
        ahead = f"{left:,.0f} s left" if left > 0 else "longer than expected"
        print(f"{self._label}: {share}{rate:,.0f} lane-periods/s, {ahead}", file=sys.stderr, flush=True)

    def note(self, text: str) -> None:
        self.warn(text)


def progress(console: Console, *, quiet: bool = False) -> Quiet:
    """A bar where the console is a terminal, else plain lines; or warnings alone.

    In a cell of a notebook, which cannot take lines back but says that it is a terminal, plain lines.
    """
    if quiet:
        return Quiet()
    return Bar(console) if console.is_terminal and _KERNEL not in os.environ else Log()


def show(table: Table) -> Renderable:
    """A table of an analysis or of costs, for a console to print."""
    if table.ruled:
        drawn = Renderable(title=table.title, caption=table.caption, padding=(0, 0, 0, 1))  # within 80 columns
    else:
        drawn = Renderable(
            title=table.title,
            caption=table.caption,
            box=box.SIMPLE_HEAD,
            show_edge=False,
            pad_edge=False,
            collapse_padding=True,
        )
    for i, head in enumerate(table.heads):
        drawn.add_column(head, justify="left" if i in table.left else "right", no_wrap=not table.ruled)
    for i, row in enumerate(table.rows):
        if i in table.breaks:
            drawn.add_section()
        drawn.add_row(*row, style="bold" if i == table.bold else None)
    return drawn
