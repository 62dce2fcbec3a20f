"""Tori of the flow as invariant curves of its return map, lane by lane along an axis, stable or not.

A lane whose motion turns without being locked (`rotation`) begins with the curve of that motion; other lanes begin with
the curve of a neighbour, in rounds, so that tori are followed beyond where they attract. Newton then makes curves
that the map carries to themselves (`invariant_curves`). Within a tongue there is no such curve but where the tongue is
narrower than the error; where a torus breaks down its curve needs ever more harmonics.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from jaxnh.analyses.base import (
    LANE,
    Analysis,
    Entry,
    OptionError,
    Setting,
    Table,
    as_variable,
    flag,
    number_variable,
    table_of_kinds,
    variable,
)
from jaxnh.analyses.batch import LaneBatch, LaneRunner, iterate_units
from jaxnh.analyses.options.chaos import RotationOptions, ToriOptions
from jaxnh.analyses.periodic.newton_on_lanes import ORBIT_TILE, images
from jaxnh.analyses.price import newton_price
from jaxnh.analyses.rotation import rotation
from jaxnh.analyses.rotation.averages import birkhoff_average
from jaxnh.analyses.section_points import points_at, states_after, states_at
from jaxnh.analyses.tori.invariant_curves import (
    CurveQuality,
    InvariantCurve,
    curve_through,
    normal_growth,
    solve_curves,
)
from jaxnh.analyses.trajectories.states import section_attrs, state_variables
from jaxnh.maps.section import reports
from jaxnh.systems.state import LaneStates

KINDS = ("attracting", "saddle", "repelling", "neutral", "undecided", "none", "failed")
"""Meanings of the flags 0 to 6 of `kind`."""

_FIRST_HARMONICS = 16
_GROWTH_POINTS = 2048  # of the orbit along a curve that growth normal to it is averaged over
_NEUTRAL = 1e-6  # largest error of a growth that is called zero
_TANGENTS = 3
_ONE = {"periods": "period", "iterates": "iterate", "crossings": "crossing"}


class TurningMotions(NamedTuple):
    """TurningMotions of lanes after a transient.

    Attributes:
        states: (lanes, points).
        u: section coordinates, (lanes, points, d).
        kind: of the rotation, in `rotation.KINDS`, (lanes,).
        rotation: mean advance, in turns, (lanes,).
    """

    states: LaneStates
    u: Float[np.ndarray, "lanes points d"]
    kind: Int[np.ndarray, " lanes"]
    rotation: Float[np.ndarray, " lanes"]


Solutions = dict[int, tuple[InvariantCurve, CurveQuality]]
"""Curves that are solutions, by the number of their lane."""


def periods(options: ToriOptions, lanes: int) -> float:
    """Return the lane-periods that a run is expected to integrate, of which Newton has a third or so."""
    return float(lanes * (options.transient + options.periods + 1 + 5 * (4 * _FIRST_HARMONICS) * (1 + _TANGENTS)))


def check(options: ToriOptions, setting: Setting) -> None:
    """Check that there is an angle, as `rotation` does, and something normal to a curve."""
    if setting.flow.exponents - int(setting.autonomous) < 2:
        raise OptionError("a curve on a map of one direction has nothing normal to it; take rotation")
    rotation.check(_as_rotation(options), setting)


def _as_rotation(options: ToriOptions) -> RotationOptions:
    return RotationOptions(
        transient=options.transient,
        periods=options.periods,
        max_denominator=options.max_denominator,
        plane=options.plane,
        centre=options.centre,
    )


def run(options: ToriOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Return the invariant curve of every lane that has one, its rotation number and what is normal to it."""
    with lanes.stage(f"tori: {batch.count:,} lanes", periods(options, batch.count)):
        motions = _motions(options, batch, lanes)
        solutions = _solutions(options, batch, lanes, motions)
    return _dataset(options, batch, lanes, motions, solutions)


def _motions(options: ToriOptions, batch: LaneBatch, lanes: LaneRunner) -> TurningMotions:
    states = states_after(batch, lanes, batch.start, options.transient, options.periods + 1, ORBIT_TILE)
    asked = _as_rotation(options)
    with np.errstate(invalid="ignore", over="ignore"):
        advances = rotation.advances_of(asked, batch, states)
        average = birkhoff_average(advances.turns)
    kind = rotation.judge(asked, advances, average)[0]
    ended = reports(batch.flow, jax.tree.map(lambda leaf: leaf[:, -1:], states))["status"]
    u = points_at(batch, lanes, states, ORBIT_TILE)
    alive = (np.asarray(ended.data) == 0) & np.isfinite(u).all(axis=(1, 2))
    return TurningMotions(states, u, np.where(alive, kind, rotation.KINDS.index("failed")), average.value)


def _solutions(options: ToriOptions, batch: LaneBatch, lanes: LaneRunner, motions: TurningMotions) -> Solutions:
    """Return the curves of lanes from their own motion first, then in rounds from those of neighbours."""
    angles, error = np.array(batch.chart.angles), batch.error_estimate
    at = images(lanes, batch.strobe(), batch.p, np.ones(batch.count, np.int32))
    solved: Solutions = {}

    def solve(starts: dict[int, InvariantCurve]) -> None:
        ended = solve_curves(at, starts, options.harmonics, error, batch.chart.wrap)
        solved.update({lane: each for lane, each in ended.items() if each[1].converged})

    own = np.flatnonzero(motions.kind == rotation.KINDS.index("unlocked"))
    first = min(_FIRST_HARMONICS, options.harmonics)
    solve({int(i): curve_through(motions.u[i], float(motions.rotation[i]), first, angles) for i in own})
    tried = set[int]()
    while batch.axis is not None:
        seeds = {
            lane: min((solved[i][0] for i in (lane - 1, lane + 1) if i in solved), key=lambda curve: curve.harmonics)
            for lane in range(batch.count)
            if lane not in solved and lane not in tried and (lane - 1 in solved or lane + 1 in solved)
        }
        if not seeds:
            break
        tried.update(seeds)
        solve(seeds)
    return solved


# ---- results


def _dataset(
    options: ToriOptions, batch: LaneBatch, lanes: LaneRunner, motions: TurningMotions, solutions: Solutions
) -> xr.Dataset:
    count, d = batch.count, batch.chart.dimension
    k = batch.flow.exponents - int(batch.flow.autonomous and batch.on_section)
    value, error, residual, decay = (np.full(count, np.nan) for _ in range(4))
    growth, growth_error = (np.full((count, k - 1), np.nan) for _ in range(2))
    harmonics, curve_points = np.zeros(count, np.int32), np.full((count, options.points, d), np.nan)
    kind = np.full(count, KINDS.index("none"))
    kind[motions.kind == rotation.KINDS.index("failed")] = KINDS.index("failed")
    theta = np.linspace(0.0, 1.0, options.points)
    for lane, (curve, quality) in solutions.items():
        value[lane], error[lane], residual[lane] = curve.rotation, quality.rotation_error, quality.residual
        decay[lane], harmonics[lane], curve_points[lane] = quality.decay, curve.harmonics, curve.at(theta)
        growth[lane], growth_error[lane] = normal_growth(
            curve, quality.matrices, k, _GROWTH_POINTS, batch.error_estimate
        )
        kind[lane] = KINDS.index(_kind(growth[lane], growth_error[lane] + error[lane]))
    ended = reports(batch.flow, jax.tree.map(lambda leaf: leaf[:, -1:], motions.states))["status"]
    unit = _ONE.get(iterate_units(batch.system), "unit of time")
    turns = {"counted_in": f"turns per {unit}"}
    normal = (LANE, "normal")
    variables = {
        "normal": variable("normal", np.arange(1, k), "direction normal to the curve, largest growth first"),
        "theta": variable("theta", theta, "place along the curve in turns, both ends the same"),
        "kind": flag(LANE, kind, "the invariant curve, by what is normal to it", KINDS),
        "motion": flag(LANE, motions.kind, "the motion of the lane itself", rotation.KINDS),
        "rotation": variable(LANE, value, "rotation number on the curve", **turns),
        "rotation_error": variable(LANE, error, "error of the rotation number", **turns),
        "growth": variable(
            normal, growth, "growth of the logarithm of lengths normal to the curve", counted_in=f"1/{unit}"
        ),
        "growth_error": variable(normal, growth_error, "error of the growth", counted_in=f"1/{unit}"),
        "decay": variable(
            LANE, decay, "rate of decay of Fourier coefficients, the half-width of the strip of analyticity", "rad"
        ),
        "harmonics": number_variable(LANE, harmonics, "harmonics of the curve", ("none",)),
        "residual": variable(
            LANE, residual, "largest distance of the image of the curve from it, in sizes of the curve"
        ),
        **_curve_variables(batch, lanes, curve_points),
        "status": as_variable(LANE, ended),
    }
    return xr.Dataset(variables, attrs={"max_harmonics": options.harmonics, **section_attrs(batch)})


def _curve_variables(batch: LaneBatch, lanes: LaneRunner, u: Float[np.ndarray, "lanes points d"]) -> dict[str, Entry]:
    """Return coordinates and velocities along the curves."""
    states = states_at(batch, lanes, u.reshape(-1, u.shape[-1]), ORBIT_TILE)
    states = jax.tree.map(lambda leaf: np.reshape(leaf, u.shape[:2]), states)
    variables = state_variables(batch.system, states, np.zeros(1), (LANE, "theta"))
    return {name: entry for name, entry in variables.items() if entry[0] == (LANE, "theta") and name != "t"}


def _kind(growth: Float[np.ndarray, " k-1"], error: Float[np.ndarray, " k-1"]) -> str:
    if np.all(growth + error < 0):
        return "attracting"
    if np.all(growth - error > 0):
        return "repelling"
    if np.all(np.abs(growth) > error):
        return "saddle"
    return "neutral" if np.max(error[np.abs(growth) <= error]) < _NEUTRAL else "undecided"


def table(data: xr.Dataset, published: Any = None, source: str = "") -> Table:
    """Return how many lanes have curves of each kind, with the ranges of their numbers."""
    heads = {"rotation number": "rotation", "error": "rotation_error", "harmonics": "harmonics", "decay (rad)": "decay"}
    columns = {head: data[name].to_numpy().astype(float) for head, name in heads.items()}
    caption = f"up to {data.attrs.get('max_harmonics', '')} harmonics"
    return table_of_kinds("Invariant curves", data, KINDS, columns, caption, "curve")


ANALYSIS = Analysis(
    "tori",
    ToriOptions,
    periods,
    run,
    independent=lambda _: False,
    numbers=lambda options: 4 * options.points,
    check=check,
    table=table,
    price=lambda _, batch: newton_price(batch, ORBIT_TILE),
    brief={"transient": 1, "periods": 128},
)
