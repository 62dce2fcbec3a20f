"""Basins of attraction: which attractor every start state leads to, and which there are. None is named before.

First every lane is run by itself until its means have settled (`settling`), in tiles like any other analysis. From what
all of them have left the attractors are found (`matching`, `attractors`), numbered from 1 by the size of their basins.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax
import numpy as np
import xarray as xr
from jaxtyping import Int
from pydantic import Field, model_validator

from jaxnh.analyses.attractors import NONE, POINTS, Judged
from jaxnh.analyses.base import LANE, Analysis, Options, Setting, Sweep, Whole, rule, variable
from jaxnh.analyses.growth import BLOCKS
from jaxnh.analyses.looks import PARTS, look, maps
from jaxnh.analyses.matching import Found, find
from jaxnh.analyses.price import Price, Program, map_alone
from jaxnh.analyses.random_starts import Side, check_box, started
from jaxnh.analyses.scene import LaneRunner, Scene, counted_in, picked
from jaxnh.analyses.settling import FAILED, REASONS, Lot, settle, states_at
from jaxnh.analyses.verdict import KINDS
from jaxnh.systems.flow import Flow, Output

_USUAL = 2.0  # looks as long as the transient that most lanes take, the transient among them
_QUANTILE = 1.959963984540054  # of a normal distribution, 95 % two-sided


class BasinsOptions(Options):
    """Options of `basins`."""

    transient: int = Field(
        default=64,
        ge=2 * BLOCKS,
        multiple_of=2 * BLOCKS,
        description="Periods, or units of time, before the first look, which is as long; the next take twice as long",
    )
    longest: int = Field(
        default=8192, ge=4 * BLOCKS, description="Periods after which a lane that has not settled is undecided"
    )
    limit: int = Field(default=64, ge=1, le=1024, description="Largest period looked for")
    starts: int = Field(default=0, ge=0, description="Random start states at each value of the parameters; needs a box")
    seed: int = Field(default=0, ge=0, description="Seed of the random start states")
    box: dict[str, Side] = Field(
        default_factory=dict, description="Coordinates of random start states, each with its lowest and highest value"
    )

    @model_validator(mode="after")
    def _check(self) -> BasinsOptions:
        if bool(self.starts) != bool(self.box):
            raise rule(*(("needs starts, their number", "box") if self.box else ("needs a box to draw from", "starts")))
        for name, (low, high) in self.box.items():
            if not low < high:
                raise rule(f"the first number must be the lower one, not {low:g} and {high:g}", f"box.{name}", "box")
        if "seed" in self.model_fields_set and not self.starts:
            raise rule("goes with starts, and there are none", "seed")
        if self.longest < 2 * self.transient:
            raise rule(f"must be at least twice the transient, {2 * self.transient}", "longest", "transient")
        return self


def periods(options: BasinsOptions, lanes: int) -> float:
    """Lane-periods of a run."""
    return _USUAL * options.transient * lanes * max(1, options.starts)


def numbers(options: BasinsOptions) -> int:
    """Numbers that a lane leaves, the blocks of a look among them."""
    return 12 * BLOCKS * max(1, options.starts)


def check(options: BasinsOptions, setting: Setting) -> None:
    """See that there is a box for random starts, and nothing else that says where lanes start."""
    if options.starts:
        check_box(options.box, setting, "box")


def run(options: BasinsOptions, scene: Scene, lanes: LaneRunner) -> xr.Dataset:
    """What every lane has come to by itself (`settling.Lot`), each (lane,), (lane, mean) or (lane, component).

    With random starts `start` is a dimension after the lanes.
    """
    scene = scene.in_time()
    rows = (scene.count, options.starts) if options.starts else (scene.count,)
    with lanes.stage(f"basins: {math.prod(rows):,} lanes to their attractors", periods(options, scene.count)):
        lot = settle(_started(options, scene)[0], lanes, options.transient, options.longest)
    dims = (LANE, "start")[: len(rows)]
    second = {"means": "lane_mean", "unit": "lane_mean", "u": "lane_component", "size": "lane_component"}
    return xr.Dataset(
        {
            f"lane_{name}": variable(
                (*dims, second[name]) if name in second else dims,
                values.reshape(*rows, *values.shape[1:]),
                f"{name} of a lane",
            )
            for name, values in lot._asdict().items()
        }
    )


def whole(options: BasinsOptions, sweep: Sweep, lanes: LaneRunner, data: xr.Dataset) -> Mapping[str, xr.Dataset]:
    """The groups `basins` and `attractors`, from what all lanes have come to by themselves."""
    shape = tuple(len(axis.values) for axis in sweep.axes)
    starts = (options.starts,) if options.starts else ()
    each = math.prod(starts)
    count = math.prod(shape) * each
    left = (data[f"lane_{name}"].to_numpy() for name in Lot._fields)
    lot = Lot(*(np.array(values).reshape(count, *values.shape[len(shape + starts) :]) for values in left))
    own = [k for k, axis in enumerate(sweep.axes) if axis.kind != "start"]
    sizes = tuple(shape[k] for k in own)
    place = np.unravel_index(np.arange(count) // each, shape)
    point = np.ravel_multi_index([place[k] for k in own], sizes) if own else np.zeros(count, int)
    number, known = np.zeros(count, np.int32), list[_Known]()
    drawn: dict[str, np.ndarray] = {name: np.zeros(count) for name in options.box}
    for row, at_row in sweep.rows:
        some = (row[:, None] * each + np.arange(each)).ravel()
        scene, here = _started(options, at_row.in_time())
        part = picked(lot, some)
        for name, values in here.items():
            drawn[name][some] = values
        found = find(scene, lanes, part, point[some], options.limit, options.longest)
        for leaf, changed in zip(lot, part, strict=True):
            leaf[some] = changed
        number[some], rank = _numbered(found, point[some])
        if found.attractors is not None:
            at = scene.take(np.array([int(np.flatnonzero(point[some] == k)[0]) for k in found.point]))
            known.append(_Known(found.point, rank, found.attractors, _coordinates(at, lanes, found.attractors)))
    number[lot.known == FAILED] = -1
    unit = counted_in(sweep.rows[0][1].flow)
    most = max([1, *(int(one.rank.max(initial=0)) for one in known)])
    dims = tuple(sweep.axes[k].name for k in own)
    return {
        "basins": _basins(lot, number, unit, sweep.rows[0][1].flow, drawn, (count // each, *starts)),
        "attractors": _attractors(known, dims, sizes, most, _shares(number, point, math.prod(sizes), most), unit),
    }


def _started(options: BasinsOptions, scene: Scene) -> tuple[Scene, dict[str, np.ndarray]]:
    """The lanes with their random starts, and what was drawn, where there are some."""
    return started(scene, options.starts, options.seed, options.box) if options.starts else (scene, {})


class _Known(NamedTuple):
    """Attractors of one value of the axes that lanes share.

    Attributes:
        point: value of the parameters, (attractors,).
        rank: number there, from 1 by size of basin; 0: no lane is on it in the end, (attractors,).
        judged: what they are.
        coordinates: of a point of each, and of its points, by name, each (attractors,) or (attractors, points).
    """

    point: Int[np.ndarray, " attractors"]
    rank: Int[np.ndarray, " attractors"]
    judged: Judged
    coordinates: Mapping[str, Output]


def _numbered(
    found: Found, point: Int[np.ndarray, " lanes"]
) -> tuple[Int[np.ndarray, " lanes"], Int[np.ndarray, " attractors"]]:
    """Numbers of lanes, and of attractors, from 1 by size of basin at each point, ties by the first lane."""
    on = np.flatnonzero(found.number >= 0)
    size = np.bincount(found.number[on], minlength=len(found.point))
    first = np.full(len(found.point), len(point))
    np.minimum.at(first, found.number[on], on)
    rank = np.zeros(len(found.point), np.int32)
    for at in np.unique(found.point):
        here = np.flatnonzero((found.point == at) & (size > 0))
        rank[here[np.lexsort((first[here], -size[here]))]] = np.arange(1, len(here) + 1)
    number = np.zeros(len(point), np.int32)
    number[on] = rank[found.number[on]]
    return number, rank


def _coordinates(scene: Scene, lanes: LaneRunner, judged: Judged) -> dict[str, Output]:
    """Coordinates of a point of every attractor, and under NAME_points of its points, at the strobe."""
    count, points = len(judged.u), judged.points[:, :POINTS]
    one = states_at(scene, lanes, judged.u)
    every = states_at(scene, lanes, points.reshape(-1, points.shape[-1]))
    every = jax.tree.map(lambda leaf: leaf.reshape(count, -1), every)
    start = np.zeros(1)
    found = scene.system.outputs(jax.tree.map(lambda leaf: leaf[:, None], one), start)
    found = {name: output._replace(data=output.data[:, 0]) for name, output in found.items()}
    return found | {f"{name}_points": output for name, output in scene.system.outputs(every, start).items()}


def _shares(
    number: Int[np.ndarray, " lanes"], point: Int[np.ndarray, " lanes"], points: int, most: int
) -> tuple[Int[np.ndarray, "points attractors"], Int[np.ndarray, " points"]]:
    """Number of lanes on each attractor at each point, and of all of them."""
    on = number > 0
    table = np.bincount(point[on] * most + number[on] - 1, minlength=points * most).reshape(points, most)
    return table, np.bincount(point, minlength=points)


def wilson(hits: Int[np.ndarray, ...], count: Int[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of a probability at 95 % (Wilson, J. Am. Stat. Assoc. 22 (1927) 209), of hits among so many."""
    z2 = _QUANTILE**2
    middle = (hits + z2 / 2) / (count + z2)
    half = _QUANTILE / (count + z2) * np.sqrt(hits * (count - hits) / count + z2 / 4)
    return np.maximum(middle - half, 0.0), np.minimum(middle + half, 1.0)


# ---- datasets


def _basins(
    lot: Lot,
    number: Int[np.ndarray, " lanes"],
    unit: str,
    flow: Flow,
    drawn: Mapping[str, np.ndarray],
    shape: tuple[int, ...],
) -> xr.Dataset:
    """What every start state leads to, of lanes of this shape: (lanes,), or (lanes, starts)."""
    dims = (LANE, "start")[: len(shape)]
    flags = {"flag_values": np.arange(len(REASONS), dtype=np.int8), "flag_meanings": " ".join(REASONS)}
    words = (
        "attractor that the start state leads to, by its number in `attractors`; 0: undecided, -1: failed or escaped"
    )
    variables = {
        "attractor": variable(dims, number.reshape(shape), words),
        "time": variable(dims, lot.time.astype(np.int32).reshape(shape), "time until it was known", unit),
        "failure": variable(dims, lot.reason.reshape(shape), "why the lane has failed", **flags),
        **{
            name: variable(dims, values.reshape(shape), f"{flow.words(name)} of the start state")
            for name, values in drawn.items()
        },
    }
    attrs = {"panel": "basins", "panel_variables": "attractor", "panel_label": "attractor"}
    if len(shape) > 1:  # no picture of its own: shares are
        attrs = {}
    return xr.Dataset(variables, attrs=attrs)


def _attractors(
    known: Sequence[_Known],
    axes: tuple[str, ...],
    sizes: tuple[int, ...],
    most: int,
    shares: tuple[np.ndarray, np.ndarray],
    unit: str,
) -> xr.Dataset:
    """All attractors over the axes that are parameters, and their numbers."""
    dims = (*axes, "attractor")

    def table(values: Sequence[np.ndarray], empty: float) -> np.ndarray:
        """Values of the attractors of every part of `known` where they belong."""
        first = np.asarray(values[0]) if values else np.zeros((0,), type(empty))
        whole = np.full((math.prod(sizes), most, *first.shape[1:]), empty, first.dtype)
        for one, here in zip(known, values, strict=True):
            there = one.rank > 0
            whole[one.point[there], one.rank[there] - 1] = here[there]
        return whole.reshape(*sizes, most, *first.shape[1:])

    kinds = ("absent", *KINDS)
    flags = {"flag_values": np.arange(-1, len(KINDS), dtype=np.int8), "flag_meanings": " ".join(kinds)}
    hits, count = shares
    low, high = wilson(hits, count[:, None])
    fraction = {"fraction": hits / count[:, None], "fraction_low": low, "fraction_high": high}
    words = {
        "fraction": "share of the start states in its basin",
        "fraction_low": "lower bound of the share at 95 %",
        "fraction_high": "upper bound of the share at 95 %",
    }
    judged = [one.judged for one in known]
    of_exponent = "largest Lyapunov exponent, without a clock that along the flow left out"
    variables = {
        "attractor": variable("attractor", np.arange(1, most + 1), "number of the attractor, by size of its basin"),
        "kind": variable(dims, table([one.kind for one in judged], NONE), "kind of motion", **flags),
        "period": variable(
            dims, table([one.period for one in judged], 0), "least period of a periodic orbit, 0 of others", unit
        ),
        "exponent": variable(dims, table([one.exponent for one in judged], np.nan), of_exponent, "1/time"),
        "multiplier": variable(
            dims,
            table([one.multiplier for one in judged], np.nan),
            "largest modulus of the Floquet multipliers of a periodic orbit",
        ),
        **{name: variable(dims, v.reshape(*sizes, most), words[name]) for name, v in fraction.items()},
    }
    for name, output in known[0].coordinates.items() if known else ():
        values = [one.coordinates[name].data for one in known]
        every = name.endswith("_points")
        said = f"{output.long_name} of {'points' if every else 'a point'} of the attractor"
        variables[name] = variable((*dims, "point") if every else dims, table(values, np.nan), said)
    return xr.Dataset(variables, attrs={"panel": "shares", "panel_variables": "fraction"})


def count(data: xr.Dataset) -> dict[str, int]:
    """Number of lanes on attractors, undecided, and failed."""
    number = data["attractor"].to_numpy()
    return {
        "on_attractors": int(np.sum(number > 0)),
        "undecided": int(np.sum(number == 0)),
        "failed": int(np.sum(number < 0)),
    }


def price(options: BasinsOptions, scene: Scene) -> Price:
    """A period of a look, with its means, against the map alone."""
    scene = scene.in_time()
    strobe, stacked = maps(scene)
    turns = (float(BLOCKS), 1.0, *((float(PARTS),) if stacked else ()), *strobe.turns)
    program = Program(look, (strobe, np.int32(1)), scene.lanes, turns, (stacked,), BLOCKS, whole=True)
    return Price(program, map_alone(scene), "means of every coordinate and its square")


ANALYSIS = Analysis(
    "basins",
    BasinsOptions,
    periods,
    run,
    whole=Whole(("attractors",), whole),
    newton=True,
    in_time=True,
    numbers=numbers,
    count=count,
    check=check,
    price=price,
    brief={"transient": 2 * BLOCKS},
)
"""The entry of this analysis in the table."""
