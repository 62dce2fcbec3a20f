"""Families of maps of a batch for `orbits.continuation`: of orbits or equilibria over its first axis, or over two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxnh.analyses.base import OptionError, Setting
from jaxnh.analyses.batch import Axis, LaneBatch, LaneRunner
from jaxnh.analyses.options.orbits import Continuation
from jaxnh.maps.family import Maps
from jaxnh.maps.iterate import Derivatives, derivatives
from jaxnh.orbits.collocation.fields import eigenvector_rates, mixed_derivative, point_rates
from jaxnh.orbits.continuation.arclength import Family
from jaxnh.orbits.continuation.curves import ParameterPlane
from jaxnh.orbits.continuation.equilibrium_curves import FieldPlane
from jaxnh.orbits.continuation.paths import StepControl
from jaxnh.systems.rows import spread_indices

_TILE = 32  # lanes a tile: of 16 one lane takes three quarters of the time, and of hundreds each takes twice as long
# On a section, whose returns are of many steps, arithmetic decides: of the flows in configs/flows eight lanes take the
# time of four, and 32 take five to ten times as long (derivatives of peroxidase.yaml: 16, 17 and 172 ms).
_ON_SECTION = 8


def check_plane(what: str, setting: Setting) -> Setting:
    """Return the setting over two axes of more than one value, and check that lanes may differ in these parameters."""
    plane = setting._replace(axes=plane_axes(setting.axes))
    if len(plane.axes) != 2:
        names = " and ".join(axis.name for axis in plane.axes or setting.axes)
        raise OptionError(f"{what} are followed over two axes of more than one value, and the sweep has {names}")
    for axis in plane.axes:
        if axis.kind != "lane":
            other = "a coordinate of the start state" if axis.kind == "start" else "what all lanes of a program share"
            raise OptionError(f"{what} are followed over two parameters, and {axis.name} is {other}")
    return plane


def plane_axes(axes: Sequence[Axis]) -> tuple[Axis, ...]:
    """Return the axes of more than one value; the others are parameters that a call has fixed."""
    return tuple(axis for axis in axes if len(np.unique(axis.values)) > 1)


def lanes_along(row: LaneBatch, first: Axis, second: Axis, value: float) -> LaneBatch:
    """The lanes along the first axis at a value of the second, in the order of the first one's values."""
    batch = row.take(np.flatnonzero(row.p[second.name] == value))
    batch = batch.take(np.argsort(batch.p[first.name], kind="stable"))
    return replace(batch, axis=replace(first, values=batch.p[first.name]))


def values_searched(second: Axis, count: int) -> Float[np.ndarray, " values"]:
    """So many values of an axis, evenly over their numbers, both ends among them, or all; in order."""
    return np.unique(second.values[spread_indices(len(second.values), count)])


def step_control(options: Continuation) -> StepControl:
    """Steps along curves, from the options of an analysis."""
    return StepControl(options.ds_max, options.max_steps, options.ds, options.ds_min)


def orbit_family(
    batch: LaneBatch, lanes: LaneRunner, strobe: Maps, size: Float[np.ndarray, " d"], ends: tuple[float, float]
) -> Family:
    """Periodic orbits of a map of the batch.

    Args:
        batch: lanes along the first axis.
        lanes: runs lanes.
        strobe: the map, in any refinement.
        size: of the motion in each section coordinate.
        ends: of the range of the parameter, the lower one first.
    """
    name, shared = batch.first_axis.name, (strobe, np.int32(1))
    tile = _ON_SECTION if batch.flow.autonomous else _TILE

    def period(u: Float[np.ndarray, "lanes d"], values: Float[np.ndarray, " lanes"]) -> Derivatives:
        if not len(u):
            return _nothing(u)
        return lanes(derivatives, shared, (u, batch.at_values(values).p), tile=tile, static=(name,))

    # Both directions of branches fill a tile of long returns; more of them at once may be one branch many times.
    return Family(period, batch.chart.wrap, size, *ends, at_once=tile // 8)


def parameter_plane(
    batch: LaneBatch,
    lanes: LaneRunner,
    strobe: Maps,
    size: Float[np.ndarray, " d"],
    names: tuple[str, str],
    low: Float[np.ndarray, " 2"],
    high: Float[np.ndarray, " 2"],
) -> ParameterPlane:
    """A map of the batch over a plane of two parameters that lanes may have of their own, between their ends."""
    shared = (strobe, np.int32(1))

    def period(u: Float[np.ndarray, "lanes d"], values: Float[np.ndarray, "lanes 2"]) -> Derivatives:
        if not len(u):
            return _nothing(u)
        return lanes(derivatives, shared, (u, batch.parameters_at(names, values)), tile=_TILE, static=(names,))

    return ParameterPlane(period, batch.chart.wrap, size, low, high)


def equilibrium_family(
    batch: LaneBatch, lanes: LaneRunner, size: Float[np.ndarray, " d"], ends: tuple[float, float]
) -> Family:
    """Equilibria of the field of a batch's flow, which has no clock; sizes as of the flow's own coordinates."""
    name, batch = batch.first_axis.name, replace(batch.without_section(), axis=batch.first_axis)

    def period(u: Float[np.ndarray, "lanes d"], values: Float[np.ndarray, " lanes"]) -> Derivatives:
        if not len(u):
            return _nothing(u)
        p, still = batch.at_values(values).p, np.zeros(len(u))
        at: Any = lanes(point_rates, (batch.flow,), (u, still, p), tile=_TILE, static=((name,),))
        return Derivatives(u + at.rate, np.eye(u.shape[1]) + at.jacobian, at.by_parameters[..., 0])

    return Family(period, batch.chart.wrap, size, *ends, field=True)


def field_plane(
    batch: LaneBatch,
    lanes: LaneRunner,
    size: Float[np.ndarray, " d"],
    names: tuple[str, str],
    low: Float[np.ndarray, " 2"],
    high: Float[np.ndarray, " 2"],
) -> FieldPlane:
    """The field of a batch's flow, which has no clock, over a plane of two parameters, between their ends."""
    flow, at = batch.flow, partial(batch.parameters_at, names)

    def rates_at(u: np.ndarray, values: np.ndarray, vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rates = lanes(eigenvector_rates, (flow,), (u, vectors, at(values)), tile=_TILE, static=(names,))
        return np.asarray(rates.rate), np.asarray(rates.slopes), np.asarray(rates.of_images)

    def mixed(u: np.ndarray, values: np.ndarray, ways: np.ndarray) -> np.ndarray:
        return lanes(mixed_derivative, (flow,), (u, ways, at(values)), tile=_TILE, static=(names,))

    return FieldPlane(rates_at, mixed, flow.chart.wrap, size, 1.0 / flow.period, low, high)


def _nothing(u: Float[np.ndarray, "0 d"]) -> Derivatives:
    return Derivatives(u, np.zeros((0, u.shape[1], u.shape[1])), u)  # pyright: ignore[reportArgumentType]
