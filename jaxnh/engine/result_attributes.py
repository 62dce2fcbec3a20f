"""What a result says besides the numbers of its tiles: root attributes, and what is counted over all lanes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from jaxnh.engine.experiment import Experiment
from jaxnh.engine.levels.levels import axes_of
from jaxnh.engine.plan import clock_of, count_warnings
from jaxnh.storage.merge import Extra
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


def extras_of(job: Job, receipts: Mapping[int, TileRecord]) -> dict[str, Extra]:
    """What every group of a job has besides its tiles, from the receipts of all pieces by their numbers."""
    of = {name: [receipts[piece.number] for piece in job.sources(name)] for name in job.groups}
    counts = {name: _counts(name, some) for name, some in of.items()}
    return {name: Extra(found, count_warnings(name, found)) for name, found in counts.items()}


def _counts(name: str, receipts: Sequence[TileRecord]) -> dict[str, int]:
    """What is counted in a group, over all pieces."""
    found: dict[str, int] = {}
    for receipt in receipts:
        for key, value in receipt.counts.get(name, {}).items():
            found[key] = found.get(key, 0) + value
    return found
