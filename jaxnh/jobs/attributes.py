"""Root attributes of a result: what it was made from, by what, and what it has cost."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, NamedTuple

import numpy as np

from jaxnh.jobs.arrays import Attributes
from jaxnh.jobs.job import Job, NumericalPlan
from jaxnh.jobs.provenance import SecondsSpent

ITERATION = "iteration"
"""Name in place of a solver's where a map is iterated (`solvers.iterations`)."""


class UserFileText(NamedTuple):
    """A user's system: the file as the config names it, its text, and the SHA-256 of that."""

    path: str
    text: str
    sha256: str


def root_attributes(
    job: Job,
    *,
    title: str,
    config: str,
    precision: str,
    spent: SecondsSpent,
    strobe_period: float | np.ndarray,
    command: str = "",
    section: str = "",
    user_file: UserFileText | None = None,
) -> Attributes:
    """Root attributes of a result file, in their order.

    Args:
        title: of the experiment.
        config: its YAML.
        precision: "float64", "float32" or "extended", of the arithmetic within a period.
        spent: on all of it.
        strobe_period: or several, over the shared axes in C order, where these decide it.
        command: the command that was run; "" for a call from Python.
        section: the section in words, of a flow without a clock.
        user_file: of a user's system.
    """
    plan, cutting, provenance = job.plan, job.cutting, job.provenance
    libraries = {name: number for name, number in provenance.versions.items() if name != "jaxnh"}
    period = np.ravel(np.asarray(strobe_period, np.float64))  # netCDF has attributes of one dimension alone
    attrs: dict[str, Any] = {
        "title": title,
        "Conventions": "CF-1.11",
        "history": f"{datetime.now(UTC).isoformat(timespec='seconds')} {command or 'a call from Python'}",
        "config": config,
        "config_sha256": provenance.config_sha256,
        "jaxnh_version": provenance.versions["jaxnh"],
        "versions": json.dumps(libraries),
        **_of_plan(plan, precision),
        "wall_seconds": spent.seconds,
        "compile_seconds": spent.compile_seconds,
        "lane_periods": spent.lane_periods,
        "device": spent.device,
        **provenance.machine,
        "strobe_period": period if np.ndim(strobe_period) else period[0],
        "axes": " ".join(cutting.names),
    }
    if section:
        attrs["section"] = section
    if user_file:
        attrs |= {
            "system_file": user_file.text,
            "system_file_path": user_file.path,
            "system_file_sha256": user_file.sha256,
        }
    if cutting.level:
        attrs |= {"level": cutting.level, "levels": cutting.levels, "refine": cutting.refine}
    return {**attrs, "auto_settings": json.dumps(plan.chosen)}


def _of_plan(plan: NumericalPlan, precision: str) -> Attributes:
    return {
        "solver": plan.solver,
        "steps_per_period": plan.steps,
        "stages": "loop" if plan.rolled else "written out",
        "summation": "compensated" if plan.compensated else "plain",
        "precision": precision,
        "error_estimate": plan.error_estimate,
        **({"sizes_of_motion": json.dumps(plan.sizes)} if plan.sizes else {}),
        **({"error_estimate_parts": plan.parts} if plan.parts > 1 else {}),
        **({"step_classes": plan.step_classes} if plan.step_classes else {}),
    }


def error_in_words(attrs: Mapping[Any, object], unit: str = "period", digits: str = ".1g") -> str:
    """The error estimate of a result, from its attributes: "error of one period 1e-09 of the size of the motion".

    Args:
        unit: what it is of where there is no section.
        digits: format of the number.

    Raises:
        KeyError: they have none.
        ValueError: it is no number.
    """
    parts = attrs.get("error_estimate_parts", 1)
    whole = "iterate" if attrs.get("solver") == ITERATION else "return" if "section" in attrs else unit
    turn = f"one {whole}" if parts == 1 else f"1/{parts} of a {whole}"
    relative = ", relative to the size of the motion" if "sizes_of_motion" in attrs else ""
    return f"error of {turn} {float(str(attrs['error_estimate'])):{digits}}{relative}"


def steps_in_words(attrs: Mapping[Any, object], unit: str = "period") -> str:
    """Steps of the solver, from attributes of a result: "60 steps a period", on a section "6 steps in a time of 1".

    Where lanes have steps of their own, "15 to 60 steps a period". Of a map there are none.

    Args:
        unit: what they are in where there is no section.

    Raises:
        KeyError: they have none.
        ValueError: a length of time is no number.
    """
    steps = attrs["steps_per_period"]
    if attrs.get("solver") == ITERATION:
        return "no steps"
    if classes := str(attrs.get("step_classes", "")):
        halvings = max(int(run.partition("*")[0]) for run in classes.split())
        steps = f"{-(-int(str(steps)) // (1 << halvings))} to {steps}"
    if "section" not in attrs:
        return f"{steps} steps a {unit}"
    units = np.unique(np.asarray(attrs["strobe_period"], dtype=float))
    return f"{steps} steps in a {f'time of {units[0]:.4g}' if len(units) == 1 else 'unit of time'}"
