"""Derivatives of the doublings of cascades in all parameters of a flow, and of where they accumulate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.cascade.limits import limit_rates
from jaxnh.analyses.periodic.location import LocatedDoubling
from jaxnh.analyses.periodic.sensitivities import Sensitivities, doubling_sensitivities
from jaxnh.analyses.table_arrays import padded


def cascade_sensitivities(
    batch: LaneBatch, lanes: LaneRunner, cascades: Sequence[Sequence[LocatedDoubling]], levels: int
) -> tuple[Sensitivities, Sensitivities]:
    """Return derivatives of the first axis in all other parameters: at doublings, and where these accumulate.

    Args:
        batch: lanes along the first axis.
        lanes: runs lanes.
        cascades: successive doublings of each, at most so many levels.
        levels: of the table.

    Returns:
        Rates (cascades, levels, parameters) of the doublings, and (cascades, parameters) of the limits, not a number
        where a level was not located, and of fewer than four doublings.
    """
    every = doubling_sensitivities(batch, lanes, [located for cascade in cascades for located in cascade])
    cuts = np.cumsum([len(cascade) for cascade in cascades])[:-1]
    parts = [(np.split(leaf, cuts) if len(cascades) else []) for leaf in (every.rates, every.errors)]
    limits = np.full((2, len(cascades), len(every.names)), np.nan)
    for k, (cascade, rates, errors) in enumerate(zip(cascades, *parts, strict=True)):
        if cascade:
            points = [located.point for located in cascade]
            values, roundings = (np.array([getattr(point, name) for point in points]) for name in ("value", "error"))
            limits[:, k] = limit_rates(values, roundings, rates, errors)
    rates, errors = (padded(part, (levels, len(every.names))) for part in parts)
    return every._replace(rates=rates, errors=errors), every._replace(rates=limits[0], errors=limits[1])
