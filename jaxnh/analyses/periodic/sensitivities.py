"""Sensitivities of a batch: derivatives of its doublings, multipliers and periods in every parameter of its flow.

The mathematics is `bifurcations.sensitivities`; here are the maps with a parameter shifted, and the numbers as variables.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jaxnh.analyses.base import Entry, variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.periodic.location import LocatedDoubling, refined_maps
from jaxnh.analyses.periodic.newton_on_lanes import ORBIT_TILE, images
from jaxnh.maps.family import Maps, ParameterFamily
from jaxnh.maps.iterate import Derivatives, return_time
from jaxnh.maps.section import System, with_parameters
from jaxnh.orbits.bifurcations.sensitivities import (
    OrbitMotion,
    ShiftedMap,
    ShiftedTime,
    doubling_rates,
    implicit_rates,
    orbit_motions,
)
from jaxnh.systems.flow import UNSAID, Parameters

Numbers = tuple[Float[np.ndarray, " numbers"], Float[np.ndarray, " numbers"]]
"""Derivatives in some parameters, and their errors."""


class Sensitivities(NamedTuple):
    """Derivatives of numbers in parameters.

    Attributes:
        names: of the parameters.
        rates: (numbers, parameters), not a number where there is no derivative.
        errors: of them.
        absent: why there is none, by parameter.
    """

    names: tuple[str, ...]
    rates: Float[np.ndarray, "numbers parameters"]
    errors: Float[np.ndarray, "numbers parameters"]
    absent: dict[str, str]

    def padded(self, count: int) -> Sensitivities:
        """Return the derivatives of so many numbers, not a number of those that are missing."""
        room = [(0, count - len(self.rates)), (0, 0)]
        rates, errors = (np.pad(table, room, constant_values=np.nan) for table in (self.rates, self.errors))
        return self._replace(rates=rates, errors=errors)


class ParametrisedOrbits(NamedTuple):
    """Orbits of one map with the parameters of each: (n, d), and of all their points side by side (points,)."""

    orbits: Sequence[Float[np.ndarray, "n d"]]
    p: Parameters


Rates = Callable[[Sequence[Float[np.ndarray, "n d d"]], Sequence[Sequence[OrbitMotion]]], Sequence[Numbers]]
"""Blocks of each orbit, and its motions with each parameter, to derivatives of a number of each orbit."""


def parameter_names(batch: LaneBatch) -> tuple[str, ...]:
    """Return the names of all parameters of a batch's flow, the first axis first."""
    axis = (batch.axis.name,) if batch.axis else ()
    return tuple(dict.fromkeys((*axis, *batch.flow.equation_parameters, *batch.p)))


def sensitivities(
    batch: LaneBatch,
    lanes: LaneRunner,
    coarse: ParametrisedOrbits,
    fine: ParametrisedOrbits,
    rates: Rates,
    *,
    timed: bool = False,
) -> Sensitivities:
    """Derivatives of a number of each orbit in all parameters, by the map with twice the steps the accuracy asks for.

    Their errors are those of the differences, and the distance to what the map with the steps themselves says.

    Args:
        batch: lanes of one system, or of a family.
        lanes: runs lanes.
        coarse, fine: the orbits of both maps.
        rates: the number's derivatives.
        timed: whether they need the time of return.
    """
    names, maps = parameter_names(batch), _shifted_maps(batch)
    absent = {name: reason for name in names if (reason := _reason(batch, maps, name))}
    results = list[Sequence[Numbers]]()
    kept = tuple(name for name in names if name not in absent)
    for refinement, at in enumerate((coarse, fine)):
        shifted = _shifted(batch, lanes, maps, at.p, refinement)
        points = np.concatenate(at.orbits)
        flat = np.asarray(shifted(names[0], 0.0, points).monodromy)
        blocks = np.split(flat, np.cumsum([len(orbit) for orbit in at.orbits])[:-1])
        time = _times(batch, lanes, maps, at.p, refinement) if timed else None
        moved = [
            orbit_motions(shifted, at.orbits, blocks, name, _scale(batch, name), batch.chart.wrap, time)
            for name in kept
        ]
        results.append(rates(blocks, list(zip(*moved, strict=True))))
    (first, _), (second, error) = (tuple(np.array(part) for part in zip(*found, strict=True)) for found in results)
    names = names[len(kept) - second.shape[1] :]  # that of an implicit number is no function of its own parameter
    whole, errors = (np.full((len(second), len(names)), np.nan) for _ in range(2))
    places = [place for place, name in enumerate(names) if name in kept]
    whole[:, places], errors[:, places] = second, error + np.abs(second - first)
    return Sensitivities(names, whole, errors, absent)


def doubling_sensitivities(batch: LaneBatch, lanes: LaneRunner, doublings: Sequence[LocatedDoubling]) -> Sensitivities:
    """Derivatives of the first axis at doublings in all other parameters."""
    names = parameter_names(batch)[1:]
    if not doublings:
        return Sensitivities(names, *np.full((2, 0, len(names)), np.nan), {})

    def of_map(refinement: int) -> ParametrisedOrbits:
        points = [located.refined[refinement] for located in doublings]
        values = np.repeat([point.value for point in points], [len(point.orbit) for point in points])
        return ParametrisedOrbits([point.orbit for point in points], batch.at_values(values).p)

    def rates(blocks: Sequence[np.ndarray], motions: Sequence[Sequence[OrbitMotion]]) -> list[Numbers]:
        return [implicit_rates(*doubling_rates(*each)) for each in zip(blocks, motions, strict=True)]

    return sensitivities(batch, lanes, of_map(0), of_map(1), rates)


def sensitivity_variables(
    found: Sensitivities, batch: LaneBatch, dim: str, name: str, words: str, units: str
) -> dict[str, Entry]:
    """Variables of derivatives of a number, over its own dimension and `parameter`, with their errors.

    Args:
        found: the derivatives.
        batch: whose flow has the parameters.
        dim: of the numbers.
        name, words, units: of the number.
    """
    each = [batch.flow.labels.units.get(parameter, UNSAID) for parameter in found.names]
    common = units if set(each) <= {"1"} else UNSAID
    key, dims = f"{name}_sensitivity", (dim, "parameter")
    what = f"derivative of {words} in a parameter, all others held"
    return {
        "parameter": variable("parameter", np.array(found.names), "parameter of the flow"),
        "parameter_units": variable(
            "parameter", np.array(each), "units of the parameter, which divide those of the number"
        ),
        key: variable(dims, found.rates, what, common, ancillary_variables=f"{key}_error"),
        f"{key}_error": variable(dims, found.errors, f"error of the {what}", common),
    }


def absent_words(analysis: str, found: Sensitivities) -> str:
    """Return a line for the user for each parameter in which there is no derivative; "" where there is none."""
    lines = (f"{analysis}: no derivative in {name}: {reason}" for name, reason in found.absent.items())
    return "\n".join(lines)


def sensitivity_heads(data: xr.Dataset, name: str) -> tuple[str, ...]:
    """Return heads of columns of a table for the derivatives of a number, one a parameter; none where none are given."""
    asked = f"{name}_sensitivity" in data
    return tuple(f"∂{name}/∂{parameter}" for parameter in data["parameter"].to_numpy()) if asked else ()


def sensitivity_cells(data: xr.Dataset, name: str, row: int) -> tuple[str, ...]:
    """Return the cells below, of one number: as many digits as the error leaves, at most eight."""
    if f"{name}_sensitivity" not in data:
        return ()
    rates, errors = (data[f"{name}_sensitivity{end}"].to_numpy()[row] for end in ("", "_error"))
    with np.errstate(divide="ignore", invalid="ignore"):
        digits = np.nan_to_num(-np.floor(np.log10(errors)), nan=0.0, posinf=8.0)
    return tuple(f"{rate:.{int(k)}f}" for rate, k in zip(rates, np.clip(digits, 0, 8), strict=True))


def _shifted_maps(batch: LaneBatch) -> Callable[[str, float], tuple[Maps, ...]]:
    """Return name and shift of a parameter to the maps of `refined_maps` with it."""

    @functools.lru_cache(maxsize=64)
    def at(name: str, shift: float) -> tuple[Maps, ...]:
        if not shift or _is_own(batch, name):
            return refined_maps(batch) if shift == 0.0 else at(name, 0.0)

        def moved(system: System) -> System:
            value = np.asarray(system.flow.parameters[name], float) + shift
            return with_parameters(system, {name: value})

        if (family := batch.family) is None:
            return refined_maps(replace(batch, system=moved(batch.system)))
        near = ParameterFamily(family.names, lambda values: moved(family.at(values)))
        return refined_maps(replace(batch, family=near))

    return at


def _is_own(batch: LaneBatch, name: str) -> bool:
    """Return whether lanes of a program may differ in a parameter."""
    return name in batch.p and not (batch.family is not None and name in batch.family.names)


def _own(batch: LaneBatch, p: Parameters, name: str, shift: float) -> dict[str, np.ndarray]:
    """Parameters of lanes with one shifted, if it is one of their own."""
    more = {name: np.asarray(p[name]) + shift} if _is_own(batch, name) else {}
    return {key: np.asarray(value) for key, value in {**p, **more}.items()}


def _shifted(
    batch: LaneBatch, lanes: LaneRunner, maps: Callable[..., tuple[Maps, ...]], p: Parameters, refinement: int
) -> ShiftedMap:
    def at(name: str, shift: float, u: Float[np.ndarray, "points d"]) -> Derivatives:
        strobe = maps(name, 0.0 if _is_own(batch, name) else shift)[refinement]
        once = np.ones(len(u), np.int32)
        return images(lanes, strobe, _own(batch, p, name, shift), once)(u, np.arange(len(u)))

    return at


def _times(
    batch: LaneBatch, lanes: LaneRunner, maps: Callable[..., tuple[Maps, ...]], p: Parameters, refinement: int
) -> ShiftedTime:
    def at(name: str, shift: float, u: Float[np.ndarray, "points d"]) -> Float[np.ndarray, " points"]:
        strobe = maps(name, 0.0 if _is_own(batch, name) else shift)[refinement]
        return lanes(return_time, (strobe,), (u, _own(batch, p, name, shift)), tile=ORBIT_TILE)

    return at


def _scale(batch: LaneBatch, name: str) -> float:
    """Return the size of a parameter, one where it is zero."""
    values = batch.p[name] if name in batch.p else batch.flow.parameters[name]
    return float(np.abs(np.asarray(values, float)).max()) or 1.0


def _reason(batch: LaneBatch, maps: Callable[..., tuple[Maps, ...]], name: str) -> str:
    """Return why the system does not exist near its value of a parameter; "" where it does."""
    try:
        _ = maps(name, 2.0**-15 * _scale(batch, name))
    except ValueError as error:
        return str(error)
    return ""
