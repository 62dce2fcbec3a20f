"""Report of `jaxnh.sweep` at its end: tables of analyses, warnings, accuracy and cost. No numerics."""

from __future__ import annotations

import sys
from pathlib import Path

from rich.console import Console

from jaxnh.analyses.registry import analysis_of
from jaxnh.cli.inspection import failed_in
from jaxnh.cli.terminal import show
from jaxnh.config.messages import join_words
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.run_records import RunSummary
from jaxnh.jobs.attributes import error_in_words, steps_in_words
from jaxnh.storage.hdf5 import read_attrs, read_group

_LOG_WIDTH = 100  # columns of a table that goes to a file


def report(
    experiment: Experiment, path: Path, outcome: RunSummary, part: tuple[int, int] | None, *, quiet: bool
) -> None:
    """Print what a run has come to."""
    plan, cutting, total = outcome.job.plan, outcome.job.cutting, outcome.spent
    if not outcome.whole and part:
        if not quiet:
            print(f"part {part[0]}/{part[1]}: {outcome.pieces[0]} of {outcome.pieces[1]} tiles")
        return
    for name in cutting.groups:
        if not quiet:
            _show_table(experiment, path, name)
        warnings = list(filter(None, str(read_attrs(path, name).get("warnings", "")).split("\n")))
        for warning in [*warnings, *(f"{name}: {line}" for line in (failed_in(path, name) if warnings else ()))]:
            print(f"warning: {warning}", file=sys.stderr)
    if quiet:
        return
    unit, attrs = "unit of time" if experiment.autonomous else "period", read_attrs(path)
    steps, error = steps_in_words(attrs, unit), error_in_words(attrs, unit, ".1e")
    print(f"{plan.solver} in {experiment.precision}, {steps}, {error}; {total.lane_periods:,.0f} lane-periods")
    if cutting.levels > 1:
        share = float(read_group(path, cutting.groups[0])["computed"].mean())
        print(f"{cutting.levels} levels; {share:.1%} of {cutting.lanes:,} lanes computed")
    if outcome.run_seconds:
        rest = outcome.seconds - outcome.compile_seconds - outcome.run_seconds
        parts = f"compile {outcome.compile_seconds:.1f} s, run {outcome.run_seconds:.1f} s"
        print(f"{outcome.seconds:.1f} s: {parts}, set-up and the rest {rest:.1f} s")
    else:
        print(f"{outcome.seconds:.1f} s")
    print(f"wrote {path}")


def _show_table(experiment: Experiment, path: Path, name: str) -> None:
    """The table of an analysis that has one, beside published values."""
    console = Console()
    console = console if console.is_terminal else Console(width=_LOG_WIDTH)
    analysis = analysis_of(name)
    if analysis and name in analysis.other_tables:
        console.print(show(analysis.other_tables[name](read_group(path, name))))
    draw = analysis.table if analysis and analysis.name == name else None
    if draw is None:
        return
    published = (experiment.compare or {}).get(name)
    unlike = experiment.differences_from(published) if published else []
    columns, source = (published.columns(), published.source) if published and not unlike else ({}, "")
    console.print(show(draw(read_group(path, name), columns, source)))
    if published and unlike:
        print(f"no values of {published.source} beside these, which are of another system: {join_words(unlike)}")
