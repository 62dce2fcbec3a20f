"""What a process does for a sweep: decide once what holds for all of it, and compute pieces of it. No files."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jaxnh
from jaxnh.analyses import ANALYSES
from jaxnh.analyses.base import Group, Options, Scene
from jaxnh.cli.command import account, calibrate, scene_of, versions
from jaxnh.config.experiment import Experiment, load
from jaxnh.engine.lanes import TILE, Lanes
from jaxnh.solvers import SOLVERS
from jaxnh.storage.tiles import Job, Piece, Spent, tile_lanes

_BATCH_BYTES = 1 << 28  # of results that are computed at once


class Done(NamedTuple):
    """A piece that is computed: its groups, what is counted in each, and what it has cost."""

    piece: Piece
    groups: Mapping[str, Group]
    counts: Mapping[str, Mapping[str, int]]
    spent: Spent


def decide(experiment: Experiment, lanes: Lanes, tile: int | None) -> Job:
    """Solver, steps and whatever else analyses choose from the whole sweep, and how it is cut.

    Args:
        tile: lanes a tile in place of those that the config suggests.

    Raises:
        jaxnh.exits.Refused: no solver meets the target.
    """
    with lanes.stage("accuracy: errors of one period on sample lanes", 0):
        scene = scene_of(experiment, calibrate(experiment, lanes))
        requested = experiment.requested()
        split = [(analysis, options) for analysis, options in requested if analysis.splits(options)]
        chosen = {a.name: dict(a.choose(options, scene, lanes)) for a, options in split if a.choose}
    return Job(
        config_sha256=experiment.sha256,
        versions={"jaxnh": jaxnh.__version__, **versions()},
        solver=scene.solver.name,
        steps=scene.steps,
        compensated=scene.compensated,
        error_estimate=scene.error_estimate,
        chosen=chosen,
        order=tuple(analysis.name for analysis, _ in requested),
        split=tuple(analysis.name for analysis, _ in split),
        lanes=len(scene.values),
        tile=tile or tile_lanes(work_of(experiment, split), numbers_of(split), len(scene.values)),
    )


def work_of(experiment: Experiment, analyses: Sequence[tuple[Any, Options]]) -> float:
    """Expected lane-periods a lane."""
    count = len(experiment.sweep.grid())
    return sum(analysis.periods(options, count) for analysis, options in analyses) / count


def numbers_of(analyses: Sequence[tuple[Any, Options]]) -> int:
    """About how many numbers a lane leaves."""
    return sum(analysis.numbers(options) for analysis, options in analyses)


def scene_of_job(experiment: Experiment, job: Job) -> Scene:
    """The scene that a job has decided on, with all values of b."""
    return Scene(
        *experiment.system_and_start(),
        experiment.sweep.grid(),
        SOLVERS[job.solver],
        job.steps,
        job.compensated,
        job.error_estimate,
        precision=experiment.precision,
        chosen=job.chosen,
    )


def batches(experiment: Experiment, job: Job, pieces: Sequence[Piece], devices: int) -> list[list[Piece]]:
    """Pieces that are computed together: neighbouring tiles enough for all devices, one by one what is not a tile."""
    options = {analysis.name: options for analysis, options in experiment.requested()}
    numbers = max(1, numbers_of([(ANALYSES[name], options[name]) for name in job.split]))
    most = max(1, min(devices * TILE // job.tile, _BATCH_BYTES // (8 * numbers * job.tile)))
    found: list[list[Piece]] = []
    for piece in pieces:
        last = found[-1] if found else []
        if last and piece.names == job.split == last[-1].names and last[-1].end == piece.first and len(last) < most:
            last.append(piece)
        else:
            found.append([piece])
    return found


def compute(experiment: Experiment, job: Job, batch: Sequence[Piece], lanes: Lanes) -> list[Done]:
    """The groups of neighbouring pieces, each what it is if computed alone, bit for bit."""
    began, before = time.perf_counter(), account(lanes, 0.0)
    scene = scene_of_job(experiment, job)
    first, end = batch[0].first, batch[-1].end
    scene = replace(scene, values=scene.values[first:end], first=first)
    options = {analysis.name: options for analysis, options in experiment.requested()}
    groups: dict[str, Group] = {}
    for name in batch[0].names:
        analysis = ANALYSES[name]
        needed = ({need: groups[need] for need in analysis.needs},) if analysis.needs else ()
        groups[name] = analysis.run(options[name], scene, lanes, *needed)
    after = account(lanes, time.perf_counter() - began)
    done = []
    for piece in batch:
        share = (piece.end - piece.first) / (end - first)
        spent = Spent(
            after.wall_seconds * share,
            (after.compile_seconds - before.compile_seconds) * share,
            (after.lane_periods - before.lane_periods) * share,
            after.device,
        )
        cut = groups if len(batch) == 1 else {n: _rows(g, piece, first) for n, g in groups.items()}
        counts = {name: dict(ANALYSES[name].count(group.variables)) for name, group in cut.items()}
        done.append(Done(piece, cut, counts, spent))
    return done


def _rows(group: Group, piece: Piece, first: int) -> Group:
    """The lanes of a piece of a group that begins with a lane `first`."""
    rows = slice(piece.first - first, piece.end - first)
    variables = {
        name: replace(variable, data=variable.data[rows]) if variable.dims[:1] == ("b",) else variable
        for name, variable in group.variables.items()
    }
    return replace(group, variables=variables)


def experiment_from(text: str, own_text: str | None = None) -> Experiment:
    """The experiment of a YAML text, and of the text of the user's file that it names, that have been valid before.

    Raises:
        jaxnh.experiment.ConfigError: they are so no more.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "config.yaml"
        path.write_text(text, encoding="utf-8")
        return load(path, own_text=own_text)
