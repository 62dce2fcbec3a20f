"""Cost of accuracy on a batch, a file a quantity: the map of one period, a doubling point, an exponent. No files."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import xarray as xr

from jaxnh.analyses.base import Table
from jaxnh.analyses.batch import LaneBatch
from jaxnh.costs import doubling, exponent, tables
from jaxnh.engine.executor.lanes import LaneExecutor


class Study(NamedTuple):
    """A study of what the accuracy of an analysis costs.

    Attributes:
        price: (batch along the first axis, lane runner) to its dataset; None where the sweep has nothing to measure.
        table: (dataset) to the table that is printed.
        absent: why there may be none.
    """

    price: Callable[[LaneBatch, LaneExecutor], xr.Dataset | None]
    table: Callable[[xr.Dataset], Table]
    absent: str


STUDIES: Mapping[str, Study] = {
    "doubling": Study(doubling.price, tables.doubling, "the sweep has no doubling to find"),
    "lyapunov": Study(
        exponent.price, tables.exponent, "no lane of the sweep has a largest exponent clearly above zero"
    ),
}
"""Studies of the analyses that have one, by their names."""
