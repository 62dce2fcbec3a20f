"""Contents of a result besides the numbers of its tiles: root attributes, and warnings of all lanes together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from jaxnh.engine.experiment import Experiment
from jaxnh.engine.levels.levels import axes_of
from jaxnh.engine.plan import clock_of, count_warnings
from jaxnh.storage.pieces import Job
from jaxnh.storage.provenance import LevelOf, Method, UserFileText, root_attributes
from jaxnh.storage.tiles import SecondsSpent, TileRecord


def attributes(experiment: Experiment, job: Job, total: SecondsSpent, command: str = "") -> dict[str, object]:
    """Root attributes of a result; `command` is "" for a call from Python."""
    own, clock = experiment.user_file, clock_of(experiment, axes_of(experiment.axes, job))
    return root_attributes(
        title=experiment.title,
        config=experiment.text,
        config_sha256=experiment.sha256,
        versions=job.versions,
        method=Method(job.solver, job.steps, job.compensated, experiment.precision, job.error_estimate),
        spent=total,
        axes=job.names,
        strobe_period=clock.period,
        command=command,
        section=clock.section,
        user_file=UserFileText(str(own.path), own.text, own.sha256) if own else None,
        chosen=job.chosen,
        machine=job.machine,
        level=LevelOf(job.level, job.levels, job.refine) if job.level else None,
    )


def warnings_of(job: Job, receipts: Mapping[int, TileRecord]) -> dict[str, tuple[str, ...]]:
    """Warnings for every group of a job as a whole, from the receipts of all pieces by their numbers."""
    counts = {name: Counter[str]() for name in job.groups}
    for name, tally in counts.items():
        for piece in job.sources(name):
            tally.update(receipts[piece.number].counts.get(name, {}))
    return {name: count_warnings(name, tally) for name, tally in counts.items()}
