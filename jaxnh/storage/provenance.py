"""Origin of a result: its root attributes, from plain values. No JAX, and nothing of how a command was called."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np

from jaxnh import __version__
from jaxnh.storage.hdf5 import Attributes
from jaxnh.storage.tiles import SecondsSpent

_LIBRARIES = ("jax", "jaxlib", "diffrax", "equinox", "numpy", "h5py")


class LevelOf(NamedTuple):
    """The level of a result, from 1, of how many, and which lanes a level adds: "all" or "boundary"."""

    level: int
    levels: int
    refine: str


class Method(NamedTuple):
    """The method that a period is computed with.

    Attributes:
        solver: its name.
        steps: steps a period.
        compensated: whether sums are.
        precision: "float64", "float32" or "extended", of the arithmetic within a period.
        error_estimate: error of one period's map, of all components, that about one in 10,000 of the periods of a
            sweep's lanes exceeds.
    """

    solver: str
    steps: int
    compensated: bool
    precision: str
    error_estimate: float


class UserFileText(NamedTuple):
    """A user's system: the file as the config names it, its text, and the SHA-256 of that."""

    path: str
    text: str
    sha256: str


def versions() -> dict[str, str]:
    """Versions of the package, under the name jaxnh, and of the libraries that the numbers rest on."""
    return {"jaxnh": __version__, **{name: version(name) for name in _LIBRARIES}}


def root_attributes(
    *,
    title: str,
    config: str,
    config_sha256: str,
    versions: Mapping[str, str],
    method: Method,
    spent: SecondsSpent,
    axes: Sequence[str],
    strobe_period: float | np.ndarray,
    command: str = "",
    section: str = "",
    user_file: UserFileText | None = None,
    chosen: Mapping[str, Mapping[str, int]] | None = None,
    machine: Mapping[str, str] | None = None,
    level: LevelOf | None = None,
) -> Attributes:
    """Root attributes of a result file, in their order.

    Args:
        title: of the experiment.
        config, config_sha256: its YAML, and the hash of what it says.
        versions: of the package, under the name jaxnh, and of libraries (`versions`).
        spent: on all of it.
        axes: names of the axes of the sweep, in order.
        strobe_period: or several, over the shared axes in C order, where these decide it.
        command: the command that was run; "" for a call from Python.
        section: the section in words, of a flow without a clock.
        user_file: of a user's system.
        chosen: what analyses have chosen from the whole sweep; None for what cannot be computed again from the file.
        machine: kind of processor and options of the compiler, each under its name.
        level: that the result is of, where the sweep has levels.
    """
    libraries = {name: number for name, number in versions.items() if name != "jaxnh"}
    period = np.ravel(np.asarray(strobe_period, np.float64))  # netCDF has attributes of one dimension alone
    attrs: dict[str, Any] = {
        "title": title,
        "Conventions": "CF-1.11",
        "history": f"{datetime.now(UTC).isoformat(timespec='seconds')} {command or 'a call from Python'}",
        "config": config,
        "config_sha256": config_sha256,
        "jaxnh_version": versions["jaxnh"],
        "versions": json.dumps(libraries),
        **_of_method(method),
        **_of_cost(spent),
        **(machine or {}),
        "strobe_period": period if np.ndim(strobe_period) else period[0],
        "axes": " ".join(axes),
    }
    if section:
        attrs["section"] = section
    if user_file:
        attrs |= _of_user_file(user_file)
    if level:
        attrs |= level._asdict()
    if chosen is not None:
        attrs["auto_settings"] = json.dumps(chosen)
    return attrs


def _of_user_file(file: UserFileText) -> dict[str, Any]:
    return {"system_file": file.text, "system_file_path": file.path, "system_file_sha256": file.sha256}


def _of_method(method: Method) -> dict[str, Any]:
    return {
        "solver": method.solver,
        "steps_per_period": method.steps,
        "summation": "compensated" if method.compensated else "plain",
        "precision": method.precision,
        "error_estimate": method.error_estimate,
    }


def _of_cost(spent: SecondsSpent) -> dict[str, Any]:
    return {
        "wall_seconds": spent.seconds,
        "compile_seconds": spent.compile_seconds,
        "lane_periods": spent.lane_periods,
        "device": spent.device,
    }


def steps_in_words(attrs: Mapping[Any, object], unit: str = "period") -> str:
    """Steps of the solver, from attributes of a result: "60 steps a period", on a section "6 steps in a time of 1".

    Args:
        unit: what they are in where there is no section.

    Raises:
        KeyError: they have none.
        ValueError: a length of time is no number.
    """
    steps = attrs["steps_per_period"]
    if "section" not in attrs:
        return f"{steps} steps a {unit}"
    units = np.unique(np.asarray(attrs["strobe_period"], dtype=float))
    return f"{steps} steps in a {f'time of {units[0]:.4g}' if len(units) == 1 else 'unit of time'}"
