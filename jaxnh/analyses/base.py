"""Definition of an analysis: options and a batch (`batch`) in, a dataset out, and its cost (`price`). No files.

An analysis is one file: its numbers and its table for the terminal; `registry` lists them, `analyses.options`
has what each can be asked for, and `plotting.descriptions` says how they are drawn. Its dataset has the lanes as
dimension `LANE`, which the engine turns into the axes of the sweep.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Int

from jaxnh.analyses.batch import Axis, LaneBatch, LaneRunner
from jaxnh.analyses.options.base import Options
from jaxnh.analyses.price import Price
from jaxnh.exceptions import InputError
from jaxnh.systems.flow import Flow
from jaxnh.systems.readout import Output
from jaxnh.systems.state import State

if TYPE_CHECKING:
    import xarray as xr  # imported where the first result is made: with pandas it takes a third of a second

LANE = "lane"
"""Dimension of lanes side by side."""


# ---- what an analysis is asked for


class OptionError(InputError):
    """Options that do not suit a batch or sweep.

    Attributes:
        key: the option, "" for the analysis as such.
    """

    def __init__(self, message: str, key: str = "") -> None:
        super().__init__(message)
        self.key = key


class Setting(NamedTuple):
    """The system and the sweep, as `Analysis.check` sees them.

    Attributes:
        flow: the system in continuous time.
        autonomous: whether it has no clock and is seen on a section.
        axes: of the sweep.
        precision: "float64", "float32" or "extended".
        flow_at: the system in continuous time at a value of the first axis; raises ValueError where there is none.
    """

    flow: Flow
    autonomous: bool
    axes: tuple[Axis, ...]
    precision: str
    flow_at: Callable[[float], Flow]

    @property
    def advice(self) -> str:
        """Return advice on which parameter may be put first, where the first axis is no parameter of a lane's own."""
        names = [axis.name for axis in self.axes if axis.kind == "lane"]
        names = names[:1] or sorted(name for name in self.flow.parameters if not self.flow.roles.is_shared(name))[-1:]
        return f"; put a parameter such as {names[0]} first" if names else ""


# ---- what an analysis gives


Entry = tuple[tuple[str, ...], np.ndarray, dict[str, Any]]
"""A variable as `xarray.Dataset` takes it: dimensions, data, attributes."""


def variable(dims: Sequence[str] | str, data: Any, long_name: str, units: str = "1", **attrs: Any) -> Entry:
    """Return a variable of a dataset with its words and units: "1" where it has none, `UNSAID` where unknown."""
    names = (dims,) if isinstance(dims, str) else tuple(dims)
    return names, np.asarray(data), {"long_name": long_name, **({"units": units} if units else {}), **attrs}


def flag(
    dims: Sequence[str] | str, numbers: Any, long_name: str, meanings: Sequence[str], least: int = 0, **attrs: Any
) -> Entry:
    """Return a variable of flags: numbers, from `least` on, that stand for words."""
    values = np.arange(least, least + len(meanings), dtype=np.int8)
    flags = {"flag_values": values, "flag_meanings": " ".join(meanings)}
    return variable(dims, np.asarray(numbers, np.int8), long_name, **flags, **attrs)


def number_variable(
    dims: Sequence[str] | str, numbers: Any, long_name: str, meanings: Sequence[str], least: int = 0, **attrs: Any
) -> Entry:
    """Return a variable of whole numbers, of which the first, from `least` on, stand for words."""
    numbers = np.asarray(numbers)
    first = least + len(meanings)
    flags = {"flag_values": np.arange(least, first, dtype=numbers.dtype), "flag_meanings": " ".join(meanings)}
    return variable(dims, numbers, long_name, **flags, valid_min=numbers.dtype.type(first), **attrs)


def as_variable(dims: Sequence[str] | str, output: Output, **attrs: Any) -> Entry:
    """Return an output of a system, on its states or on a trajectory, as a variable."""
    return variable(dims, output.data, output.long_name, **output.attrs, **attrs)


class Table(NamedTuple):
    """A table of text for the terminal.

    Attributes:
        title: stands above it.
        heads: of the columns, (columns,).
        rows: cells, (rows, columns).
        caption: stands below it.
        left: numbers of the columns that are aligned on the left; all others are on the right.
        ruled: whether columns have lines between them; without, cells are never wrapped.
        bold: number of a row that stands out.
        breaks: numbers of the rows that begin a new part.
    """

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str | None = None
    left: tuple[int, ...] = ()
    ruled: bool = True
    bold: int | None = None
    breaks: tuple[int, ...] = ()


class SweepLanes(NamedTuple):
    """All lanes of a sweep, for quantities that need them together.

    Attributes:
        axes: of the sweep.
        rows: for each value of the axes that lanes share: the numbers of its lanes in C order of the sweep, and these.
    """

    axes: tuple[Axis, ...]
    rows: tuple[tuple[Int[np.ndarray, " some"], LaneBatch], ...]


class SweepReduction(NamedTuple):
    """The second half of an analysis: a result of all lanes of a sweep, once each has been run by itself.

    Attributes:
        brings: groups that it makes beside that of the analysis.
        run: (options, sweep, lane runner, what the lanes have left over the axes) to the datasets of all groups; these
            have the axes as dimensions, or `LANE` for all of them.
    """

    brings: tuple[str, ...]
    run: Callable[[Any, SweepLanes, LaneRunner, xr.Dataset], Mapping[str, xr.Dataset]]


Starts = Callable[[LaneBatch], tuple[State, Int[np.ndarray, " starts"]]]
"""Batch to random start states of its lanes, and the number of the lane of each."""


def number_lanes(options: Any, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Return the numbers of lanes: the `run` of an analysis that only its `whole` computes something for."""
    import xarray as xr

    return xr.Dataset({"lane_number": variable(LANE, np.arange(batch.count, dtype=np.int32), "number of a lane")})


def check_names(analysis: str, own: Collection[str], setting: Setting) -> None:
    """Check that no axis and no coordinate has a name that an analysis gives to a number of its own."""
    for name in sorted({*setting.flow.coordinates, *(axis.name for axis in setting.axes)} & {*own}):
        raise OptionError(f"{name} is what {analysis} calls a number of its own; rename it")


def range_in_words(values: np.ndarray) -> str:
    """Return the least and the largest of numbers for a table, one where they look alike; – where none is finite."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return "–"
    low, high = f"{finite.min():.3g}", f"{finite.max():.3g}"
    return low if low == high else f"{low} to {high}"


def table_of_kinds(
    title: str,
    data: xr.Dataset,
    kinds: Sequence[str],
    columns: Mapping[str, np.ndarray],
    caption: str,
    head: str = "kind",
) -> Table:
    """Return a table of how many lanes are of each kind, and the ranges of numbers (lanes,) of theirs, by head."""
    kind, rows = data["kind"].to_numpy().ravel(), list[tuple[str, ...]]()
    for number, word in enumerate(kinds):
        if (of_kind := kind == number).any():
            ranges = (range_in_words(values.ravel()[of_kind]) for values in columns.values())
            rows.append((word, f"{np.count_nonzero(of_kind):,}", *ranges))
    return Table(title, (head, "lanes", *columns), tuple(rows), caption, (0,))


def kind_of_lanes(data: xr.Dataset) -> Int[np.ndarray, ...]:
    """Return the kind, which tells lanes apart where a level of a sweep leaves some out (`Analysis.classes`)."""
    return data["kind"].to_numpy().astype(int)


@dataclass(frozen=True)
class Analysis:
    """An entry in the table of analyses.

    Attributes:
        name: the key in YAML and the group in the result file.
        options: the model of its options.
        periods: (options, number of lanes) to the lane-periods that a run of it is expected to integrate.
        run: (options, batch, lane runner) to its dataset; where its options have `needs`, also these datasets by name.
            Attributes of the dataset are those of the group, `warnings` among them, lines for the user.
        whole: what is made of all lanes in the end; what `run` gives is then kept until it is made, and no longer.
        independent: options to whether its lanes are independent. If not, it is run along the whole first
            axis, once for each point of the others (`LaneBatch.axis`); its variables then get the other axes.
        stackable: whether lanes at several values of what lanes share may go through one program: it sees the system
            through its maps alone, and no bit of theirs depends on the shape of a tile.
        numbers: options to about how many numbers a lane leaves.
        choose: (options, batch, lane runner) to whole numbers that hold for all lanes of a sweep; of several batches
            that sample one, the largest count. `run` reads them from `LaneBatch.chosen`.
        starts: options to where its lanes start at random in place of the batch's start states: batch to their states
            and the number of the lane of each; None where they do not.
        count: dataset to the number of `trajectories`, and how many have `failed`, that a warning is made of.
        classes: dataset over the axes to whole numbers over them, which differ where the kind of motion does; without
            it all lanes are of one kind.
        smooth: variables that a level of a sweep interpolates where it leaves lanes out; others are a neighbour's.
        check: (options, setting) raises `OptionError` where they do not go together.
        table: (dataset, published values by name, their source) to a table for the terminal.
        other_tables: name of a group of `whole` to its table for the terminal, of the group's dataset.
        price: (options, batch) to what a period of it costs; without, it is not measured.
        brief: options that make a run short and leave as many numbers a lane.
    """

    name: str
    options: type[Options]
    periods: Callable[[Any, int], float]
    run: Callable[..., xr.Dataset]
    whole: SweepReduction | None = None
    independent: Callable[[Any], bool] = lambda _: True
    stackable: bool = False
    numbers: Callable[[Any], int] = lambda _: 64
    choose: Callable[[Any, LaneBatch, LaneRunner], Mapping[str, int]] | None = None
    starts: Callable[[Any], Starts | None] = lambda _: None
    count: Callable[[xr.Dataset], Mapping[str, int]] = lambda _: {}
    classes: Callable[[xr.Dataset], Int[np.ndarray, ...]] | None = None
    smooth: tuple[str, ...] = ()
    check: Callable[[Any, Setting], None] = lambda _, __: None
    table: Callable[[xr.Dataset, Mapping[str, np.ndarray], str], Table] | None = None
    other_tables: Mapping[str, Callable[[xr.Dataset], Table]] = field(
        default_factory=dict[str, "Callable[[xr.Dataset], Table]"]
    )
    price: Callable[[Any, LaneBatch], Price] | None = None
    brief: Mapping[str, int] = field(default_factory=dict[str, int])
