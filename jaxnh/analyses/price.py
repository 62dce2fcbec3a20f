"""Cost of a period of an analysis: the compiled program that stands for it, beside the map alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from jaxnh.analyses.batch import LaneBatch
from jaxnh.maps.iterate import derivatives, iterate
from jaxnh.maps.protocol import ReturnMap


class PricedProgram(NamedTuple):
    """A compiled function of lanes that stands for a period of an analysis, for `jaxnh.cost --effects`.

    Attributes:
        function, shared, lanes, static, tile: as a `LaneRunner` takes them.
        trip_counts: of its loops in a period, outermost first; of a `whole` program in a call, where it does not say
            itself.
        periods: periods a call.
        whole: whether all of it counts, as it runs, and not the loop of a period alone.
    """

    function: Callable[..., Any]
    shared: tuple[Any, ...]
    lanes: tuple[Any, ...]
    trip_counts: tuple[float, ...]
    static: tuple[Any, ...] = ()
    periods: int = 1
    tile: int | None = None
    whole: bool = False


class Price(NamedTuple):
    """The program of an analysis (None: it is not measured), the program without it, and a note on either."""

    with_it: PricedProgram | None
    without_it: PricedProgram
    note: str


def map_alone(batch: LaneBatch, strobe: ReturnMap | None = None, tile: int | None = None) -> PricedProgram:
    """Return the program of one period of the batch's map, or of `strobe` on the same lanes, and nothing else."""
    strobe = batch.map() if strobe is None else strobe
    return PricedProgram(iterate, (strobe, np.int32(1)), batch.lanes, (1.0, *strobe.trip_counts), tile=tile)


def newton_price(batch: LaneBatch, tile: int) -> Price:
    """Return the price of a period of Newton on orbits: the map with a tangent for every coordinate."""
    strobe = batch.map()
    lanes = batch.chart.host_points(batch.start), dict(batch.p)
    program = PricedProgram(derivatives, (strobe, np.int32(1)), lanes, (1.0, *strobe.trip_counts), tile=tile)
    note = f"{batch.chart.dimension} tangents in every period of Newton, the map alone before it"
    return Price(program, map_alone(batch, tile=tile), note)
