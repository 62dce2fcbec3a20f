"""Derivatives of attractors in all parameters of a flow: of what solves equations, periodic orbits and equilibria.

Exponents of chaos are averages over time, and cycles without a clock and a section are seen and not solved for: they
have none here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.basins.classification import EQUILIBRIUM, PERIODIC, Attractors
from jaxnh.analyses.basins.continuation import Grid
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.continuation.equilibrium_sensitivities import lane_equilibrium_sensitivities
from jaxnh.analyses.periodic.sensitivities import (
    ROUNDING,
    Sensitivities,
    is_own,
    lane_sensitivities,
    no_sensitivities,
    parameter_names,
    scale_of,
    shifted_batch,
)
from jaxnh.analyses.section_points import states_at
from jaxnh.maps.section import outputs
from jaxnh.orbits.bifurcations.sensitivities import difference, error_along
from jaxnh.systems.rows import select


class _Part(NamedTuple):
    """Attractors of one batch: their places among all, their points (attractors, d), and derivatives.

    Attributes:
        multiplier, exponent: (attractors, parameters).
        points: of section coordinates, (attractors, d, parameters).
    """

    places: Int[np.ndarray, " attractors"]
    batch: LaneBatch
    u: Float[np.ndarray, "attractors d"]
    multiplier: Sensitivities
    exponent: Sensitivities
    points: Sensitivities


def attractor_sensitivities(
    grid: Grid,
    lanes: LaneRunner,
    point: Int[np.ndarray, " attractors"],
    judged: Attractors | None,
    names: Sequence[str],
) -> dict[str, Sensitivities]:
    """Return derivatives of `multiplier`, `exponent` and coordinates of a point of attractors, by name.

    Args:
        grid: values of the parameters.
        lanes: runs lanes.
        point: value that each attractor is at.
        judged: what they are; None where there are none.
        names: of the coordinates.

    Returns:
        Rates (attractors, parameters) each, not a number of attractors that solve no equation.
    """
    parameters = parameter_names(grid.batches[0])
    derived = {name: no_sensitivities(parameters, len(point)) for name in ("multiplier", "exponent", *names)}
    for part in _parts(grid, lanes, point, judged) if judged is not None else ():
        tables = {"multiplier": part.multiplier, "exponent": part.exponent, **_coordinates(part, lanes, names)}
        for name, table in tables.items():
            whole = derived[name]
            whole.rates[part.places], whole.errors[part.places] = table.rates, table.errors
            derived[name] = whole._replace(absent={**whole.absent, **table.absent})
    return derived


def _parts(grid: Grid, lanes: LaneRunner, point: Int[np.ndarray, " attractors"], judged: Attractors) -> Iterator[_Part]:
    """Yield the orbits and equilibria of every batch."""
    for block, batch in grid.batches_at(point):
        for kind, derive in ((PERIODIC, _orbits), (EQUILIBRIUM, _equilibria)):
            mine = np.flatnonzero(judged.kind[block] == kind)
            if len(places := block[mine]):
                yield derive(batch.take(mine), lanes, places, judged)


def _orbits(batch: LaneBatch, lanes: LaneRunner, places: Int[np.ndarray, " some"], judged: Attractors) -> _Part:
    """Derivatives of periodic orbits; their exponent is ln |μ| over the time of n periods."""
    u, n, period = judged.u[places], judged.period[places], float(batch.flow.period)
    derived = lane_sensitivities(batch, lanes, n, u)
    growth, time = derived.growth, (n * period)[:, None]
    rates, errors = growth.rates / time, growth.errors / time
    with np.errstate(divide="ignore"):
        coarse, exponent = np.log(derived.moduli) / time.T
    for k, name in enumerate(growth.names):
        if not is_own(batch, name) and name not in growth.absent:
            stretch, error = _period_rate(batch, name)
            rates[:, k] -= exponent * stretch / period
            errors[:, k] += (np.abs(exponent) * error + np.abs(exponent - coarse) * abs(stretch)) / period
    of_exponent = growth._replace(rates=rates, errors=errors + ROUNDING * np.abs(rates))
    return _Part(places, batch, u, derived.multiplier, of_exponent, derived.points)


def _period_rate(batch: LaneBatch, name: str) -> tuple[float, float]:
    """Return the derivative of the strobe's period in a parameter, and its error."""
    scale = scale_of(batch, name)

    def period(shift: float) -> np.ndarray:
        return np.asarray(shifted_batch(batch, name, shift).flow.period, float)

    if period(1e-3 * scale) == period(-1e-3 * scale):
        return 0.0, 0.0
    rate, error = difference(period, scale)
    return float(rate), float(error)


def _equilibria(batch: LaneBatch, lanes: LaneRunner, places: Int[np.ndarray, " some"], judged: Attractors) -> _Part:
    """Derivatives of equilibria."""
    u = judged.u[places]
    derived = lane_equilibrium_sensitivities(batch, lanes, u)
    none = no_sensitivities(derived.exponent.names, len(places))
    return _Part(places, batch, u, none, derived.exponent, derived.points)


def _coordinates(part: _Part, lanes: LaneRunner, names: Sequence[str]) -> Mapping[str, Sensitivities]:
    """Return derivatives of the coordinates of points that move with a parameter, from those of section coordinates."""
    parameters = part.points.names
    rates, errors = np.full((2, len(part.u), len(names), len(parameters)), np.nan)
    for k, name in enumerate(parameters):
        if name not in part.points.absent:
            rates[..., k], errors[..., k] = _coordinate_rates(part, lanes, names, name)
    return {
        name: part.points._replace(rates=rates[:, place], errors=errors[:, place]) for place, name in enumerate(names)
    }


def _coordinate_rates(
    part: _Part, lanes: LaneRunner, names: Sequence[str], parameter: str
) -> tuple[Float[np.ndarray, "attractors names"], Float[np.ndarray, "attractors names"]]:
    """Return derivatives of coordinates in one parameter, and their errors."""
    own, k = is_own(part.batch, parameter), part.points.names.index(parameter)
    moved, wrong = part.points.rates[..., k], part.points.errors[..., k]

    def at(shift: float, u: Float[np.ndarray, "attractors d"]) -> Float[np.ndarray, "attractors names"]:
        batch = part.batch if own else shifted_batch(part.batch, parameter, shift)
        state = select(states_at(batch, lanes, u), np.s_[:, None])
        every = outputs(batch.flow, state, np.zeros(1))
        return np.stack([np.asarray(every[name].data)[:, 0] for name in names], axis=1)

    rates, errors = difference(lambda s: at(s, part.u + s * moved), scale_of(part.batch, parameter))
    return rates, errors + error_along(lambda u: at(0.0, u), list(part.u[:, None]), wrong[None])
