"""A job: everything that is decided once for a sweep, and holds for every process that works on it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace

from jaxnh.jobs.cutting import Cutting
from jaxnh.jobs.provenance import Provenance


@dataclass(frozen=True)
class NumericalPlan:
    """Numerical choices for a sweep.

    Attributes:
        solver: its name.
        steps: a period.
        compensated: whether sums are.
        error_estimate: error of one period's map, of all components, that about one in 10,000 of the periods of a
            sweep's lanes exceeds.
        chosen: settings that analyses have chosen from the whole sweep, by analysis.
        rolled: whether the stages of a step are a loop.
        sizes: of the motion, by coordinate, that the error is relative to; none where it is absolute.
        parts: of a unit of time, of one of which the error is.
        step_classes: of lanes in C order, "k*n k*n" where n lanes in a row
            take 2^k times fewer steps; "" where none does.
    """

    solver: str
    steps: int
    compensated: bool
    error_estimate: float
    chosen: Mapping[str, Mapping[str, int]]
    rolled: bool = False
    sizes: Mapping[str, float] = field(default_factory=dict[str, float])
    parts: int = 1
    step_classes: str = ""


@dataclass(frozen=True)
class Job:
    """Numerical plan, cutting and provenance of a sweep, or of a level of one."""

    plan: NumericalPlan
    cutting: Cutting
    provenance: Provenance

    @property
    def id(self) -> str:
        """Hash of all of it."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()

    def stages(self) -> list[Job]:
        """The jobs of the levels, one after the other; without levels this one."""
        return [replace(self, cutting=cutting) for cutting in self.cutting.stages()]
