"""Contents of a result besides the numbers of its tiles: root attributes, and warnings of all lanes together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from jaxnh.engine.experiment import Experiment
from jaxnh.engine.failures import count_warnings
from jaxnh.engine.levels.levels import axes_of
from jaxnh.engine.plan import clock_of
from jaxnh.jobs.attributes import UserFileText, root_attributes
from jaxnh.jobs.cutting import Cutting
from jaxnh.jobs.job import Job
from jaxnh.jobs.provenance import SecondsSpent


def attributes(experiment: Experiment, job: Job, total: SecondsSpent, command: str = "") -> dict[str, object]:
    """Root attributes of a result; `command` is "" for a call from Python."""
    own, clock = experiment.user_file, clock_of(experiment, axes_of(experiment.axes, job.cutting))
    return root_attributes(
        job,
        title=experiment.title,
        config=experiment.text,
        precision=experiment.precision,
        spent=total,
        strobe_period=clock.period,
        command=command,
        section=clock.section,
        user_file=UserFileText(str(own.path), own.text, own.sha256) if own else None,
    )


def warnings_of(cutting: Cutting, counted: Mapping[int, Mapping[str, Mapping[str, int]]]) -> dict[str, tuple[str, ...]]:
    """Warnings for every group of a sweep as a whole, from the counts of all pieces by their numbers."""
    counts = {name: Counter[str]() for name in cutting.groups}
    for name, tally in counts.items():
        for piece in cutting.sources(name):
            tally.update(counted[piece.number].get(name, {}))
    return {name: count_warnings(name, tally) for name, tally in counts.items()}
