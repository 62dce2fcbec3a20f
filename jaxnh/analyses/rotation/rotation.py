"""Rotation numbers: turns a period, crossing or iterate, with errors, and whether they are fractions.

The angle is a coordinate that is one and keeps whole turns, the first such; else that of the points of a plane about a
centre, by default their mean. Of a coordinate the advance is known with its whole turns. About a centre it is known
up to whole turns where the points keep their cyclic order, as on an invariant curve that goes round the centre; the
rotation number is then in [0, 1).

The rule, of N advances whose average is ρ with the bar ε, and of which the averages of the halves differ by δ:

- unconverged: δ > N^(-3/2). A weighted average of quasiperiodic motion converges faster than any power of N, one of
  chaotic motion as N^(-1/2) (Sander and Meiss, Physica D 411 (2020) 132569), which comes so near by chance once in N
  lanes. So does a torus that breaks down.
- no_rotation: the points are a single one, come to the centre, or do not keep their cyclic order about it.
- locked: ρ is a fraction p/q within ε, with q up to Q, and the motion shows an orbit of it. Unlocked: no such fraction.
- undecided: ε > 1/(2 Q²), so that more than one fraction may be within it; or the motion shows no orbit of the one that
  is. It may be passing the place of one that is born near by: over a passage ρ is off the fraction by up to 1/(q N).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from jaxnh.analyses.base import (
    LANE,
    Analysis,
    OptionError,
    Setting,
    Table,
    as_variable,
    flag,
    number_variable,
    variable,
)
from jaxnh.analyses.batch import LaneBatch, LaneRunner, iterate_units
from jaxnh.analyses.options.chaos import RotationOptions
from jaxnh.analyses.price import Price, map_alone
from jaxnh.analyses.rotation.averages import (
    BirkhoffAverage,
    birkhoff_average,
    cyclic_advances,
    displacement,
    half_averages,
    least_fraction,
)
from jaxnh.analyses.rotation.locking import is_locked, passed_fraction
from jaxnh.analyses.section_points import states_after
from jaxnh.analyses.trajectories.poincare import recording_program
from jaxnh.analyses.trajectories.states import section_attrs
from jaxnh.maps.section import outputs, plot_plane, reports
from jaxnh.systems.rows import select
from jaxnh.systems.state import State

KINDS = ("locked", "unlocked", "unconverged", "no_rotation", "undecided", "failed")
"""Meanings of the flags 0 to 5 of `kind`."""

_TURN = 2 * np.pi
_SMALL = 1e-6  # of the size of the points, the start among them: what comes to less than that is a single point
_NOTHING = 1e-12  # of the size of the other coordinate: what is less is rounding
_INTEGER = 1e-9  # turns below a whole one, which is then taken as nought
_CENTRE = 1e-3  # of the largest radius: a point nearer to the centre has no angle


_ONE = {"periods": "period", "iterates": "iterate", "crossings": "crossing"}


class Advances(NamedTuple):
    """Angles that lanes advance by.

    Attributes:
        turns: in each iterate, (lanes, iterates).
        rotates: whether there is an angle, and the points keep their order, (lanes,).
        error: of an advance, by the steps and by rounding, (lanes,).
        description: how the angle is taken.
    """

    turns: Float[np.ndarray, "lanes iterates"]
    rotates: Bool[np.ndarray, " lanes"]
    error: Float[np.ndarray, " lanes"]
    description: str


def periods(options: RotationOptions, lanes: int) -> float:
    """Return the lane-periods of a run."""
    return float(lanes * (options.transient + options.periods + 1))


def check(options: RotationOptions, setting: Setting) -> None:
    """Check that the plane is one of coordinates."""
    names = setting.flow.coordinates
    for name in options.plane or ():
        if name not in names:
            raise OptionError(f"{name} is no coordinate; coordinates are {', '.join(names)}", "plane")
    if options.plane is None and options.centre is None and len(names) < 2 and not _lifted_angle(setting.flow.chart):
        raise OptionError("a rotation number needs an angle, or a plane of two coordinates", "plane")


def run(options: RotationOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Return the rotation number of every lane with its error, its kind and the fraction that it is locked to."""
    with lanes.stage(f"rotation: {batch.count:,} lanes", periods(options, batch.count)):
        states = states_after(batch, lanes, batch.start, options.transient, options.periods + 1)
    ended = reports(batch.flow, states)["status"]
    alive = np.asarray(ended.data) == 0
    with np.errstate(invalid="ignore", over="ignore"):
        advances = advances_of(options, batch, states)
        average = birkhoff_average(advances.turns)
    if batch.flow.continuous:
        average = _with_errors_of_steps(options, batch, lanes, states, advances, average)
    return _dataset(options, batch, advances, average, alive).assign(status=as_variable(LANE, ended))


def _with_errors_of_steps(
    options: RotationOptions,
    batch: LaneBatch,
    lanes: LaneRunner,
    states: State,
    advances: Advances,
    average: BirkhoffAverage,
) -> BirkhoffAverage:
    """Return averages whose errors have twice what twice the steps change in them, of lanes that are not locked.

    Steps that err by ε in each period move a torus that contracts by 1 − μ in one by ε/(1 − μ), and shear makes of that
    another rotation, on which both halves of a run agree. Both motions begin at the first state on the torus, for half
    of the run. What this does not show of the way to the other torus, by how the change grows in it, counts as well.
    """
    kind = judge(options, advances, average).kind
    open_ = np.flatnonzero(np.isin(kind, [KINDS.index("unlocked"), KINDS.index("undecided")]))
    if not len(open_):
        return average
    count, few, error = options.periods // 2, batch.take(open_), average.error.copy()
    coarse = select(states, np.s_[open_, : count + 1])
    with lanes.stage(f"rotation: {len(open_):,} lanes by twice the steps", len(open_) * count):
        begin = select(coarse, np.s_[:, 0])
        fine = lanes.record(batch.strobe(2), count, (begin, dict(few.p)))
    fine = jax.tree.map(lambda first, rest: np.concatenate([first[:, None], rest], axis=1), begin, fine)
    with np.errstate(invalid="ignore", over="ignore"):
        turns = [advances_of(options, few, part).turns for part in (coarse, fine)]
        first, second = (half_averages(each) for each in turns)
    moved = np.abs(second - first)
    moved = np.where(np.isnan(moved), np.inf, np.minimum(moved, np.abs(1.0 - moved)))  # whole turns may not be known
    error[open_] += 2.0 * displacement(moved[0], moved[1], count // 2 / (options.transient + options.periods))
    return average._replace(error=error)


# ---- angles


def advances_of(options: RotationOptions, batch: LaneBatch, states: State) -> Advances:
    """Return the advances of successive states (lanes, iterates + 1), of an angle or about a centre."""
    lifted = _lifted_angle(batch.chart)
    if lifted and options.plane is None and options.centre is None:
        turns = batch.chart.host_points(states)[..., lifted[0]] / _TURN
        advance = np.diff(turns, axis=1)
        rounding = np.finfo(float).eps * (1.0 + np.max(np.abs(turns), axis=1))
        error = batch.error_estimate * np.maximum(np.max(np.abs(advance), axis=1), 1.0 / _TURN)
        names = batch.flow.coordinates
        whole = len(names) == batch.chart.dimension  # of a section one is left out
        name = f"of {names[lifted[0]]}" if whole else f"section coordinate {lifted[0] + 1}"
        return Advances(advance, np.ones(len(turns), bool), error + 4.0 * rounding, name)
    return _about_centre(options, batch, states)


def _lifted_angle(chart: Any) -> list[int]:
    """Return the numbers of the section coordinates that are angles and keep whole turns in a state."""
    u = np.full(chart.dimension, 2.0 * _TURN)
    kept = np.asarray([float(x) for x in chart.components(chart.state(u))])
    return [i for i, angle in enumerate(chart.angles) if angle and abs(kept[i] - u[i]) < 1.0]


def _about_centre(options: RotationOptions, batch: LaneBatch, states: State) -> Advances:
    """Return the advances of the angle about a centre, in the plane asked for or in that of pictures."""
    names = options.plane or plot_plane(batch.system)
    points, begin = (outputs(batch.flow, y, np.zeros(1)) for y in (states, batch.start))
    x = np.stack([np.asarray(points[name].data) for name in names])  # (2, lanes, points)
    extent = np.maximum(np.max(np.abs(x), axis=2), [np.abs(np.ravel(begin[name].data)) for name in names])
    at = np.mean(x, axis=2) if options.centre is None else np.reshape(options.centre, (2, 1))
    side = x - at[..., None]
    # each coordinate in its own size, as a plane of a position and a velocity has no other measure; one that has come
    # to a value, or to the rounding of the other, has none
    width = np.max(np.abs(side), axis=2)
    size = np.maximum(np.maximum(width, _SMALL * extent), _NOTHING * np.max(extent, axis=0))
    east, north = side / np.where(size > 0, size, 1.0)[..., None]
    least = np.min(np.hypot(east, north), axis=1)
    last = np.ptp(x[..., -(x.shape[2] // 4) :], axis=2)
    turns, keeps_order = cyclic_advances(np.arctan2(north, east) / _TURN)
    apart = (least > _CENTRE) & np.any(last > _SMALL * extent, axis=0)
    with np.errstate(divide="ignore"):
        of_steps = batch.error_estimate * (1.0 if batch.sizes else 1.0 / np.max(width, axis=0))
        of_rounding = 4.0 * np.finfo(float).eps * np.max(extent / size, axis=0)
        error = (of_steps + of_rounding) / (_TURN * least)
    centre = "the mean of the points" if options.centre is None else f"{options.centre[0]:g}, {options.centre[1]:g}"
    turns = turns - np.floor(np.mean(turns, axis=1, keepdims=True) + _INTEGER)
    return Advances(turns, apart & keeps_order, error, f"of {names[0]}, {names[1]} about {centre}")


# ---- results


class Judgement(NamedTuple):
    """Rotation of lanes by the rule of this module, (lanes,) each.

    Attributes:
        kind: number in `KINDS`.
        numerator, denominator: of the fraction that a motion is locked to, 0 without one.
        error: of the rotation number.
    """

    kind: Int[np.ndarray, " lanes"]
    numerator: Int[np.ndarray, " lanes"]
    denominator: Int[np.ndarray, " lanes"]
    error: Float[np.ndarray, " lanes"]


def judge(options: RotationOptions, advances: Advances, average: BirkhoffAverage) -> Judgement:
    """Apply the rule of this module."""
    error, count, largest = average.error + advances.error, advances.turns.shape[1], options.max_denominator
    converged, resolved = average.difference <= count**-1.5, error <= 0.5 / largest**2
    value = np.where(advances.rotates & converged & resolved, average.value, np.nan)
    numerator, denominator = least_fraction(value, error, largest)
    locked = is_locked(advances.turns, numerator, denominator, advances.error)
    passed = passed_fraction(advances.turns, np.where(locked, np.nan, value), advances.error, largest)
    unseen = np.where(locked, 0, np.where(passed > 0, passed, denominator))
    conditions = [~advances.rotates, ~converged, ~resolved | (unseen > 0), locked]
    words = ("no_rotation", "unconverged", "undecided", "locked")
    kind = np.select(conditions, [KINDS.index(word) for word in words], KINDS.index("unlocked"))
    error = np.where(unseen > 0, np.maximum(error, 1.0 / (np.maximum(unseen, 1) * count)), error)
    return Judgement(kind, np.where(locked, numerator, 0), np.where(locked, denominator, 0), error)


def _dataset(
    options: RotationOptions,
    batch: LaneBatch,
    advances: Advances,
    average: BirkhoffAverage,
    alive: Bool[np.ndarray, " lanes"],
) -> xr.Dataset:
    kind, numerator, denominator, error = judge(options, advances, average)
    kind = np.where(alive, kind, KINDS.index("failed"))
    known = np.isin(kind, [KINDS.index(word) for word in ("locked", "unlocked", "undecided")])
    numerator, denominator = (np.where(alive, number, 0) for number in (numerator, denominator))
    value = np.where(known, average.value, np.nan)
    error = np.where(known, error, np.nan)
    difference = np.where(alive & advances.rotates, average.difference, np.nan)
    counted = {"counted_in": f"turns per {_ONE[iterate_units(batch.system)]}"}
    searched = f"denominators 1 to {options.max_denominator} were searched"
    variables = {
        "rotation": variable(LANE, value, "rotation number", **counted),
        "rotation_error": variable(LANE, error, "error of the rotation number", **counted),
        "difference": variable(LANE, difference, "difference between the averages of the halves of the run", **counted),
        "kind": flag(LANE, kind, "whether the rotation number is a fraction", KINDS, comment=searched),
        "numerator": variable(LANE, numerator, "numerator of the fraction that the motion is locked to; 0 without one"),
        "denominator": number_variable(LANE, denominator, "denominator of this fraction", ("none",), comment=searched),
    }
    attrs = {"rotating_angle": advances.description, "max_denominator": options.max_denominator, **section_attrs(batch)}
    return xr.Dataset(variables, attrs=attrs)


def table(data: xr.Dataset, published: Any = None, source: str = "") -> Table:
    """Return how many lanes are of each kind, their rotation numbers and the largest errors."""
    kind, value, error = (data[name].to_numpy().ravel() for name in ("kind", "rotation", "rotation_error"))
    rows = []
    for number, word in enumerate(KINDS):
        if (of_kind := kind == number).any():
            numbers = value[of_kind & np.isfinite(value)]
            extent = f"{numbers.min():.8g} to {numbers.max():.8g}" if numbers.size else "–"
            largest = f"{np.max(error[of_kind]):.1e}" if numbers.size else "–"
            rows.append((word.replace("_", " "), f"{np.count_nonzero(of_kind):,}", extent, largest))
    heads = ("kind", "lanes", "rotation number", "largest error")
    angle, largest = (data.attrs.get(name, "") for name in ("rotating_angle", "max_denominator"))
    caption = f"angle: {angle}; denominators up to {largest}"
    return Table("Rotation numbers", heads, tuple(rows), caption, (0,))


def classes(data: xr.Dataset) -> Int[np.ndarray, ...]:
    """Return the denominator of lanes that are locked, and minus the kind of others."""
    kind, denominator = data["kind"].to_numpy().astype(int), data["denominator"].to_numpy().astype(int)
    return np.where(denominator > 0, denominator, -kind)


ANALYSIS = Analysis(
    "rotation",
    RotationOptions,
    periods,
    run,
    classes=classes,
    smooth=("rotation",),
    check=check,
    table=table,
    price=lambda _, batch: Price(recording_program(batch), map_alone(batch), "every strobe is kept"),
    brief={"transient": 1, "periods": 128},
)
