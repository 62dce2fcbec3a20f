"""Tori of the flow as invariant curves of its return map, lane by lane along an axis, stable or not.

A lane whose motion turns without being locked (`rotation`) begins with the curve of that motion; other lanes begin with
the curve of a neighbour, in rounds, so that tori are followed beyond where they attract. Newton then makes curves
that the map carries to themselves (`invariant_curves`). Within a tongue there is no such curve but where the tongue is
narrower than the error; where a torus breaks down its curve needs ever more harmonics.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from jaxnh.analyses.base import LANE, Analysis, OptionError, Setting, Table, as_variable, flag, table_of_kinds
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.options.chaos import InvariantCurveOptions, RotationOptions, ToriOptions
from jaxnh.analyses.periodic.newton_on_lanes import ORBIT_TILE, images
from jaxnh.analyses.price import newton_price
from jaxnh.analyses.rotation import rotation
from jaxnh.analyses.rotation.averages import birkhoff_average
from jaxnh.analyses.section_points import points_at, states_after
from jaxnh.analyses.tori.curve_tables import KINDS, CurveTable
from jaxnh.analyses.tori.invariant_curves import CurveQuality, InvariantCurve, curve_through, solve_curves
from jaxnh.analyses.trajectories.states import section_attrs
from jaxnh.maps.section import reports
from jaxnh.systems.state import LaneStates

_FIRST_HARMONICS = 16
_TANGENTS = 3


class TurningMotions(NamedTuple):
    """Motions of lanes after a transient.

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


def periods(options: InvariantCurveOptions, lanes: int) -> float:
    """Return the lane-periods that a run is expected to integrate, of which Newton has a third or so."""
    return float(lanes * (options.transient + options.periods + 1 + 5 * (4 * _FIRST_HARMONICS) * (1 + _TANGENTS)))


def check(options: InvariantCurveOptions, setting: Setting) -> None:
    """Check that there is an angle, as `rotation` does, and something normal to a curve."""
    if setting.flow.exponents - int(setting.autonomous) < 2:
        raise OptionError("a curve on a map of one direction has nothing normal to it; take rotation")
    rotation.check(_as_rotation(options), setting)


def _as_rotation(options: InvariantCurveOptions) -> RotationOptions:
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
        motions = turning_motions(options, batch, lanes)
        solutions = _solutions(options, batch, lanes, motions)
    return _dataset(options, batch, lanes, motions, solutions)


def turning_motions(options: InvariantCurveOptions, batch: LaneBatch, lanes: LaneRunner) -> TurningMotions:
    """Return the motions of lanes after the transient, and whether they turn."""
    states = states_after(batch, lanes, batch.start, options.transient, options.periods + 1, ORBIT_TILE)
    asked = _as_rotation(options)
    with np.errstate(invalid="ignore", over="ignore"):
        advances = rotation.advances_of(asked, batch, states)
        average = birkhoff_average(advances.turns)
    kind = rotation.judge(asked, advances, average)[0]
    ended = reports(batch.flow, states)["status"]
    u = points_at(batch, lanes, states, ORBIT_TILE)
    alive = (np.asarray(ended.data) == 0) & np.isfinite(u).all(axis=(1, 2))
    return TurningMotions(states, u, np.where(alive, kind, rotation.KINDS.index("failed")), average.value)


def _solutions(options: ToriOptions, batch: LaneBatch, lanes: LaneRunner, motions: TurningMotions) -> Solutions:
    """Return the curves of lanes from their own motion first, then in rounds from those of neighbours."""
    error = batch.error_estimate
    at = images(lanes, batch.strobe(), batch.p, np.ones(batch.count, np.int32))
    solved: Solutions = {}

    def solve(starts: dict[int, InvariantCurve]) -> None:
        ended = solve_curves(at, starts, options.harmonics, error, batch.chart.wrap)
        solved.update({lane: each for lane, each in ended.items() if each[1].converged})

    solve(curves_of_motions(options, batch, motions))
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


def curves_of_motions(
    options: InvariantCurveOptions, batch: LaneBatch, motions: TurningMotions
) -> dict[int, InvariantCurve]:
    """Return the curves through motions that turn without being locked, by number of the lane, before Newton."""
    own = np.flatnonzero(motions.kind == rotation.KINDS.index("unlocked"))
    first, angles = min(_FIRST_HARMONICS, options.harmonics), np.array(batch.chart.angles)
    return {int(i): curve_through(motions.u[i], float(motions.rotation[i]), first, angles) for i in own}


# ---- results


def _dataset(
    options: ToriOptions, batch: LaneBatch, lanes: LaneRunner, motions: TurningMotions, solutions: Solutions
) -> xr.Dataset:
    curves = CurveTable((batch.count,), options.points, batch)
    curves.kind[motions.kind == rotation.KINDS.index("failed")] = KINDS.index("failed")
    for lane, (curve, quality) in solutions.items():
        curves.put((lane,), curve, quality)
    ended = reports(batch.flow, motions.states)["status"]
    variables = {
        **curves.numbers((LANE,)),
        **curves.coordinates(lanes, (LANE,)),
        "motion": flag(LANE, motions.kind, "the motion of the lane itself", rotation.KINDS),
        "status": as_variable(LANE, ended),
    }
    return xr.Dataset(variables, attrs={"max_harmonics": options.harmonics, **section_attrs(batch)})


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
