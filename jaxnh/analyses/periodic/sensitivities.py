"""Sensitivities of a batch: derivatives of its doublings, multipliers and periods in every parameter of its flow.

The mathematics is `bifurcations.sensitivities`; here are the maps with a parameter shifted. How results have them is
`sensitivity_tables`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.periodic.location import LocatedDoubling, refined_maps
from jaxnh.analyses.periodic.newton_on_lanes import ORBIT_TILE, images
from jaxnh.maps.family import Maps, ParameterFamily
from jaxnh.maps.iterate import Derivatives, return_time
from jaxnh.maps.section import System, flow_of, with_parameters
from jaxnh.orbits.bifurcations.sensitivities import (
    OrbitMotion,
    ShiftedMap,
    ShiftedTime,
    doubling_rates,
    fold_rates,
    implicit_rates,
    modulus_rates,
    orbit_motions,
    point_rates,
    time_rates,
)
from jaxnh.orbits.continuation.kinds import DOUBLING, FOLD, NEIMARK_SACKER
from jaxnh.orbits.multipliers import multipliers
from jaxnh.orbits.shooting import close_orbits
from jaxnh.systems.flow import Parameters
from jaxnh.systems.rows import select

ROUNDING = 16.0 * np.finfo(float).eps
"""Rounding of a derivative, relative to it: of the sums and quotients that it is made of."""

_LEAST = 32.0  # 2ᵖ at order 5: what twice the steps change is so much more than what they leave

SMALLEST_SHIFT = 2.0**-15
"""Shift of a parameter, in its size, by which it is asked whether the system exists nearby."""

Numbers = tuple[Float[np.ndarray, " numbers"], Float[np.ndarray, " numbers"]]
"""Derivatives in some parameters, and their errors."""


class Sensitivities(NamedTuple):
    """Derivatives of numbers in parameters.

    Attributes:
        names: of the parameters.
        rates: (numbers, parameters), numbers in one or several dimensions; not a number where there is no derivative.
        errors: of the rates, likewise.
        absent: why there is no derivative, by parameter.
    """

    names: tuple[str, ...]
    rates: Float[np.ndarray, "*numbers parameters"]
    errors: Float[np.ndarray, "*numbers parameters"]
    absent: dict[str, str]

    def row(self, k: int) -> Sensitivities:
        """Return the derivatives of the numbers at one place of the first dimension."""
        return self._replace(rates=self.rates[k], errors=self.errors[k])

    def with_rows(self, rows: Sequence[int], other: Sensitivities) -> Sensitivities:
        """Return the derivatives with those of some numbers from elsewhere, in the same parameters."""
        rates, errors = self.rates.copy(), self.errors.copy()
        rates[list(rows)], errors[list(rows)] = other.rates, other.errors
        return self._replace(rates=rates, errors=errors, absent={**self.absent, **other.absent})


class ParametrisedOrbits(NamedTuple):
    """Orbits of one map with the parameters of each: (n, d), and of all their points side by side (points,)."""

    orbits: Sequence[Float[np.ndarray, "n d"]]
    p: Parameters


Rates = Callable[[Sequence[Float[np.ndarray, "n d d"]], Sequence[Sequence[OrbitMotion]]], Sequence[Numbers]]
"""Blocks of each orbit, and its motions with each parameter, to derivatives of a number of each orbit."""


def parameter_names(batch: LaneBatch) -> tuple[str, ...]:
    """Return the names of all parameters of a batch's flow, the first axis first."""
    axis = (batch.axis.name,) if batch.axis else ()
    return tuple(dict.fromkeys((*axis, *batch.flow.roles.of_equations, *batch.p)))


def sensitivities(
    batch: LaneBatch,
    lanes: LaneRunner,
    coarse: ParametrisedOrbits,
    fine: ParametrisedOrbits,
    rates: Rates,
    *,
    timed: bool = False,
    isolated: Sequence[bool] | None = None,
) -> Sensitivities:
    """Derivatives of a number of each orbit in all parameters, by the map with twice the steps the accuracy asks for.

    Their errors are those of the differences, and the distance to what the map with the steps themselves says. That
    vanishes at some parameters by chance: a share of the largest of a number is kept, in sizes of the parameters.

    Args:
        batch: lanes of one system, or of a family.
        lanes: runs lanes.
        coarse, fine: the orbits of both maps.
        rates: the number's derivatives.
        timed: whether they need the time of return.
        isolated: as of `orbit_motions`.
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
            orbit_motions(shifted, at.orbits, blocks, name, scale_of(batch, name), batch.chart.wrap, time, isolated)
            for name in kept
        ]
        results.append(rates(blocks, list(zip(*moved, strict=True))))
    (first, _), (second, error) = (tuple(np.array(part) for part in zip(*each, strict=True)) for each in results)
    names = names[len(kept) - second.shape[1] :]  # that of an implicit number is no function of its own parameter
    whole, errors = np.full((len(second), len(names)), np.nan), np.full((len(second), len(names)), np.nan)
    places = [place for place, name in enumerate(names) if name in kept]
    change, scales = np.abs(second - first), np.array([scale_of(batch, name) for name in kept])[-second.shape[1] :]
    least = np.max(change * scales, axis=1, initial=0.0, keepdims=True) / (_LEAST * scales)
    whole[:, places], errors[:, places] = second, error + np.maximum(change, least) + ROUNDING * np.abs(second)
    return Sensitivities(names, whole, errors, absent)


def doubling_sensitivities(batch: LaneBatch, lanes: LaneRunner, doublings: Sequence[LocatedDoubling]) -> Sensitivities:
    """Derivatives of the first axis at doublings in all other parameters."""
    names = parameter_names(batch)[1:]
    if not doublings:
        nothing = np.zeros((0, len(names)))
        return Sensitivities(names, nothing, nothing, {})

    def of_map(refinement: int) -> ParametrisedOrbits:
        points = [located.refined[refinement] for located in doublings]
        values = np.repeat([point.value for point in points], [len(point.orbit) for point in points])
        return ParametrisedOrbits([point.orbit for point in points], batch.at_values(values).p)

    def rates(blocks: Sequence[np.ndarray], motions: Sequence[Sequence[OrbitMotion]]) -> list[Numbers]:
        return [implicit_rates(*doubling_rates(*each)) for each in zip(blocks, motions, strict=True)]

    return sensitivities(batch, lanes, of_map(0), of_map(1), rates)


class CriticalOrbit(NamedTuple):
    """The orbit at a bifurcation: kind, a number in `KINDS`, value of the first axis, (n, d) and multipliers (d,)."""

    kind: int
    value: float
    points: Float[np.ndarray, "n d"]
    multipliers: Complex[np.ndarray, " d"]


def bifurcation_sensitivities(batch: LaneBatch, lanes: LaneRunner, points: Sequence[CriticalOrbit]) -> Sensitivities:
    """Derivatives of the first axis at bifurcations of orbits in all other parameters.

    Not a number where there are none: at branch points, which most changes of a parameter leave none of.
    """
    names, count = parameter_names(batch)[1:], len(points)
    some = np.array([k for k, point in enumerate(points) if point.kind in (FOLD, DOUBLING, NEIMARK_SACKER)], int)
    if not len(some):
        return no_sensitivities(names, count)
    every = [points[k] for k in some]
    values = np.repeat([point.value for point in every], [len(point.points) for point in every])
    orbits = ParametrisedOrbits([point.points for point in every], batch.at_values(values).p)

    def rates(blocks: Sequence[np.ndarray], motions: Sequence[Sequence[OrbitMotion]]) -> list[Numbers]:
        of_kind = {
            FOLD: lambda block, each, _: fold_rates(block, each),
            DOUBLING: lambda block, each, _: doubling_rates(block, each),
            NEIMARK_SACKER: lambda block, each, point: modulus_rates(block, each, _on_circle(point.multipliers)),
        }
        return [implicit_rates(*of_kind[p.kind](b, m, p)) for b, m, p in zip(blocks, motions, every, strict=True)]

    isolated = [point.kind != FOLD for point in every]
    derived = sensitivities(batch, lanes, orbits, orbits, rates, isolated=isolated)
    return _spread(derived, np.arange(len(some)), some, count)


def _on_circle(multipliers: Complex[np.ndarray, " d"]) -> complex:
    """Return the multiplier off the real line nearest to the unit circle."""
    off = np.where(np.abs(np.imag(multipliers)) > 0.0, np.abs(np.abs(multipliers) - 1.0), np.inf)
    return complex(multipliers[np.argmin(off)])


class LaneSensitivities(NamedTuple):
    """Derivatives of the orbits that lanes are on, a row a lane; not a number where it is on none.

    Attributes:
        multiplier: of the largest modulus of the multipliers.
        time: of the time that the orbit takes on a section; None where there is a clock.
        times: this time, (lanes,).
        points: of each section coordinate of one point of it, (lanes, d, parameters).
        growth: of the logarithm of the multiplier.
        moduli: the multiplier, by the map with the steps that the accuracy asks for and by twice as many, (2, lanes).
    """

    multiplier: Sensitivities
    time: Sensitivities | None
    times: Float[np.ndarray, " lanes"]
    points: Sensitivities
    growth: Sensitivities
    moduli: Float[np.ndarray, "2 lanes"]


def lane_sensitivities(
    batch: LaneBatch, lanes: LaneRunner, period: Int[np.ndarray, " lanes"], u: Float[np.ndarray, "lanes d"]
) -> LaneSensitivities:
    """Derivatives of every lane's orbit: of its largest multiplier and a point, and without a clock of its time.

    Args:
        batch: the lanes.
        lanes: runs them.
        period: of their orbits, 0 where a lane is on none.
        u: a point of each in section coordinates.
    """
    timed, (count, d) = batch.on_section, u.shape
    orbits = [_lane_orbits(batch, lanes, strobe, period, u) for strobe in refined_maps(batch)[:2]]
    on_orbit = np.flatnonzero(np.all([[orbit is not None for orbit in each] for each in orbits], axis=0))
    times, nothing = np.full(count, np.nan), no_sensitivities(parameter_names(batch), count)
    moduli, of_maps = np.full((2, count), np.nan), list[np.ndarray]()
    if not len(on_orbit):
        points = no_sensitivities(nothing.names, count, d)
        return LaneSensitivities(nothing, nothing if timed else None, times, points, nothing, moduli)
    sizes = period[on_orbit]
    p = batch.parameters_of(np.repeat(on_orbit, sizes))
    coarse, fine = (ParametrisedOrbits([o for k in on_orbit if (o := each[k]) is not None], p) for each in orbits)

    def rates(blocks: Sequence[np.ndarray], motions: Sequence[Sequence[OrbitMotion]]) -> list[Numbers]:
        largest = [complex(multipliers(block)[0]) for block in blocks]
        of_maps.append(np.abs(largest))
        rows = [modulus_rates(*each) for each in zip(blocks, motions, largest, strict=True)]
        with np.errstate(divide="ignore", invalid="ignore"):
            rows += [(rate / size, error / size) for (rate, error), size in zip(rows, of_maps[-1], strict=True)]
        rows += [each for moved in motions for each in point_rates(moved)]
        return rows + [time_rates(each) for each in motions] if timed else rows

    derived, first = sensitivities(batch, lanes, coarse, fine, rates, timed=timed), len(on_orbit)
    moduli[:, on_orbit] = of_maps
    multiplier, growth, point, time = np.split(np.arange(len(derived.rates)), first * np.array([1, 2, 2 + d]))
    if timed:
        each = lanes(return_time, (refined_maps(batch)[1],), (np.concatenate(fine.orbits), p), tile=ORBIT_TILE)
        times[on_orbit] = np.add.reduceat(each, np.cumsum(np.append(0, sizes[:-1])))
    return LaneSensitivities(
        _spread(derived, multiplier, on_orbit, count),
        _spread(derived, time, on_orbit, count) if timed else None,
        times,
        _spread(derived, point.reshape(first, d), on_orbit, count),
        _spread(derived, growth, on_orbit, count),
        moduli,
    )


def no_sensitivities(names: tuple[str, ...], *shape: int) -> Sensitivities:
    """Return a table of numbers that have no derivatives."""
    rates, errors = np.full((2, *shape, len(names)), np.nan)
    return Sensitivities(names, rates, errors, {})


def _spread(
    derived: Sensitivities, rows: Int[np.ndarray, "some ..."], lane: Int[np.ndarray, " some"], count: int
) -> Sensitivities:
    """Return some rows as those of lanes."""
    whole = no_sensitivities(derived.names, count, *rows.shape[1:])
    whole.rates[lane], whole.errors[lane] = derived.rates[rows], derived.errors[rows]
    return whole._replace(absent=derived.absent)


def _lane_orbits(
    batch: LaneBatch,
    lanes: LaneRunner,
    strobe: Maps,
    periods: Int[np.ndarray, " lanes"],
    u: Float[np.ndarray, "lanes d"],
) -> list[Float[np.ndarray, "n d"] | None]:
    """Return all points of the orbit of every lane, of one map."""
    whole: list[Float[np.ndarray, "n d"] | None] = [None] * len(periods)
    p = dict(batch.p)

    def period(u: Float[np.ndarray, "points d"], lane: Float[np.ndarray, " points"]) -> Derivatives:
        once = np.ones(len(u), np.int32)
        return images(lanes, strobe, select(p, lane.astype(int)), once)(u, np.arange(len(u)))

    for n in np.unique(periods[periods > 0]).tolist():
        lane = np.flatnonzero(periods == n)
        points = [u[lane]]
        while len(points) < n:
            points.append(np.asarray(period(points[-1], lane.astype(float)).image))
        closed = close_orbits(period, np.stack(points, axis=1), lane.astype(float), batch.chart.wrap)
        for k, place in enumerate(lane.tolist()):
            whole[place] = closed.points[k] if closed.converged[k] else None
    return whole


def _shifted_maps(batch: LaneBatch) -> Callable[[str, float], tuple[Maps, ...]]:
    """Return name and shift of a parameter to the maps of `refined_maps` with it."""

    @functools.lru_cache(maxsize=64)
    def at(name: str, shift: float) -> tuple[Maps, ...]:
        if not shift or is_own(batch, name):
            return refined_maps(batch) if shift == 0.0 else at(name, 0.0)

        if (family := batch.family) is None:
            return refined_maps(shifted_batch(batch, name, shift))
        near = ParameterFamily(family.names, lambda values: _moved(family.at(values), name, shift))
        return refined_maps(replace(batch, family=near))

    return at


def shifted_batch(batch: LaneBatch, name: str, shift: float) -> LaneBatch:
    """Return a batch of one system with a parameter shifted, in its lanes where they have it of their own.

    Raises:
        ValueError: there is no such system.
    """
    if is_own(batch, name):
        return replace(batch, p=_own(batch, dict(batch.p), name, shift))
    return replace(batch, system=_moved(batch.system, name, shift)) if shift else batch


def _moved(system: System, name: str, shift: float) -> System:
    return with_parameters(system, {name: np.asarray(flow_of(system).parameters[name], float) + shift})


def is_own(batch: LaneBatch, name: str) -> bool:
    """Return whether lanes of a program may differ in a parameter."""
    return name in batch.p and not (batch.family is not None and name in batch.family.names)


def _own(batch: LaneBatch, p: Parameters, name: str, shift: float) -> dict[str, np.ndarray]:
    """Parameters of lanes with one shifted, if it is one of their own."""
    more = {name: np.asarray(p[name]) + shift} if is_own(batch, name) else {}
    return {key: np.asarray(value) for key, value in {**p, **more}.items()}


def _shifted(
    batch: LaneBatch, lanes: LaneRunner, maps: Callable[..., tuple[Maps, ...]], p: Parameters, refinement: int
) -> ShiftedMap:
    def at(name: str, shift: float, u: Float[np.ndarray, "points d"]) -> Derivatives:
        strobe = maps(name, 0.0 if is_own(batch, name) else shift)[refinement]
        once = np.ones(len(u), np.int32)
        return images(lanes, strobe, _own(batch, p, name, shift), once)(u, np.arange(len(u)))

    return at


def _times(
    batch: LaneBatch, lanes: LaneRunner, maps: Callable[..., tuple[Maps, ...]], p: Parameters, refinement: int
) -> ShiftedTime:
    def at(name: str, shift: float, u: Float[np.ndarray, "points d"]) -> Float[np.ndarray, " points"]:
        strobe = maps(name, 0.0 if is_own(batch, name) else shift)[refinement]
        return lanes(return_time, (strobe,), (u, _own(batch, p, name, shift)), tile=ORBIT_TILE)

    return at


def scale_of(batch: LaneBatch, name: str) -> float:
    """Return the size of a parameter over the whole sweep, one where it is zero."""
    return batch.largest.get(name, float(np.abs(np.asarray(batch.flow.parameters[name], float)))) or 1.0


def _reason(batch: LaneBatch, maps: Callable[..., tuple[Maps, ...]], name: str) -> str:
    """Return why the system does not exist near its value of a parameter; "" where it does."""
    try:
        _ = maps(name, SMALLEST_SHIFT * scale_of(batch, name))
    except ValueError as error:
        return str(error)
    return ""
