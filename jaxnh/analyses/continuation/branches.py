"""Branches of periodic orbits over the first axis, stable and unstable, and of equilibria; and their bifurcations.

Orbits to begin with are those that the sweep's lanes settle on and, where they are asked for, those that Newton finds
from random starts. What follows is for all lanes together (`family_tree`): branches are followed to their ends, doubled
orbits and those of branch points in turn, and none twice. Orbits are those of the return map, by shooting, or cycles of
the flow by collocation (`cycles`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from jaxnh.analyses.base import LANE, Analysis, OptionError, Setting, SweepLanes, SweepReduction, Table, variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.continuation.cycle_points import durations, tree_of_cycles
from jaxnh.analyses.continuation.cycles import grow_cycles
from jaxnh.analyses.continuation.equilibria import check_equilibria, cycles_at_hopf_points, equilibria
from jaxnh.analyses.continuation.families import orbit_family, step_control
from jaxnh.analyses.continuation.family_tree import SeedOrbit, Tree, grow
from jaxnh.analyses.continuation.grazing import may_graze, with_grazing
from jaxnh.analyses.continuation.motion_units import motion_unit, search_unit, sizes_in_motion
from jaxnh.analyses.continuation.search_evidence import search_evidence
from jaxnh.analyses.continuation.seeds import attractor_waves, random_wave
from jaxnh.analyses.continuation.tables import OWN_NAMES, FollowedBranches, bifurcations_table, datasets
from jaxnh.analyses.options.orbits import BranchesOptions
from jaxnh.analyses.periodic.attractor_survey import periods_in_motion, survey_from_start
from jaxnh.analyses.periodic.flow_cycles import duration_of, no_collocation
from jaxnh.analyses.periodic.location import price_of_orbits, refined_maps
from jaxnh.analyses.random_starts import check_box
from jaxnh.maps.section import Section
from jaxnh.orbits.continuation.paths import NO_CONVERGENCE, NO_RETURN
from jaxnh.systems.flow import Flow
from jaxnh.systems.rows import spread_indices

_WORK = 3.0  # of a run, in those of settling: a guess
# Steps of a return. Its derivatives take 17 μs a step, as of circuit.yaml (130 steps) and peroxidase.yaml (2,500); an
# evaluation of collocation takes 4 and 7 ms there, and a branch about as many.
_LONG_RETURN = 500


class SettledOrbits(NamedTuple):
    """Motions that lanes have settled on.

    Attributes:
        period: of the orbit, 0 where there is none, (lanes,).
        u: a point of it, (lanes, d).
        size: of the motion, NaN of lanes that have failed or come to rest, (lanes, d).
    """

    period: Int[np.ndarray, " lanes"]
    u: Float[np.ndarray, "lanes d"]
    size: Float[np.ndarray, "lanes d"]


def check(options: BranchesOptions, setting: Setting) -> None:
    """Check that there is one axis, a parameter that lanes may differ in, and a box for random starts."""
    first, *others = setting.axes
    if first.kind == "start":
        what = f"{first.name} is a coordinate of the start state"
        raise OptionError(f"branches are followed along the first axis of the sweep, and {what}" + setting.advice)
    if first.kind == "shared":
        what = f"the map has no derivative in {first.name}, which all lanes share"
        raise OptionError(f"branches are followed along the first axis of the sweep, and {what}" + setting.advice)
    if several := [axis for axis in others if len(axis.values) > 1]:
        names = " and ".join(axis.name for axis in several)
        raise OptionError(f"branches are followed along one axis; leave out {names}")
    if len(np.unique(first.values)) < 2:
        raise OptionError(f"branches are followed over a range of {first.name}, and the sweep has one value of it")
    taken = {*setting.flow.coordinates, *(f"{name}_points" for name in setting.flow.coordinates)}
    for name in {first.name, *taken} & {*OWN_NAMES, f"{first.name}_error"}:
        raise OptionError(f"{name} is what branches calls a number of its own; rename it")
    if options.box:
        check_box(options.box, setting)
    if options.equilibria:
        check_equilibria(setting)
    if options.method == "collocation" and (why := no_collocation(setting.flow)):
        raise OptionError(f"{why}; take method: shooting", "method")


def _has_long_returns(batch: LaneBatch, lanes: LaneRunner, waves: Sequence[Sequence[SeedOrbit]]) -> bool:
    """Return whether orbits of a flow without a clock take so many steps that collocation takes less time."""
    first = next((seed for wave in waves for seed in wave), None)
    if first is None or not batch.flow.autonomous or no_collocation(batch.flow):
        return False
    steps = batch.steps * duration_of(batch.at_values(np.array([first.value])), lanes, first.points) / batch.flow.period
    return steps > _LONG_RETURN * len(first.points)


def _needs_collocation(flow: Flow, tree: Tree) -> bool:
    """Return whether shooting has lost a branch of a flow without a clock, whose returns expand too much."""
    lost = any({NO_CONVERGENCE, NO_RETURN} & {*branch.ends} for branch in tree.branches)
    return lost and flow.autonomous and not no_collocation(flow)


def run(options: BranchesOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """The orbit that every lane has settled on: a point of it, its period, and the size of the motion."""
    settled = settle(options, batch, lanes)
    return xr.Dataset(
        {
            "lane_period": variable(LANE, settled.period, "period of a lane"),
            "lane_u": variable((LANE, "lane_component"), settled.u, "point of the orbit of a lane"),
            "lane_size": variable((LANE, "lane_component"), settled.size, "size of the motion of a lane"),
        }
    )


def settle(options: BranchesOptions, batch: LaneBatch, lanes: LaneRunner) -> SettledOrbits:
    """Motions that lanes settle on from their start."""
    attractors = survey_from_start(batch, lanes, options.max_period, "branches", options.transient)
    period = periods_in_motion(batch, lanes, attractors)
    return SettledOrbits(period, attractors.u, sizes_in_motion(batch, lanes, attractors))


def whole(options: BranchesOptions, sweep: SweepLanes, lanes: LaneRunner, data: xr.Dataset) -> Mapping[str, xr.Dataset]:
    """The groups `branches` and `bifurcations`, from what all lanes have settled on."""
    (axis, *_), [(order, row)] = sweep.axes, sweep.rows
    batch = replace(row, axis=replace(axis, values=axis.values[order]))
    points = (data[f"lane_{name}"].to_numpy() for name in SettledOrbits._fields)
    settled = SettledOrbits(*(x.reshape(-1, *x.shape[len(sweep.axes) :])[order] for x in points))
    grown = grow_branches(options, batch, lanes, settled)
    searched = _searched(options, batch.count)
    return datasets(lanes, grown, options.max_period, derived=bool(options.sensitivities), searched=searched)


def _searched(options: BranchesOptions, lanes: int) -> str:
    """Say what was looked at."""
    starts = f" and at {options.n_starts} random starts at each of {min(options.n_values, lanes)} values"
    return (
        f"looked at orbits of period {options.max_period} at most that {lanes} lanes settle on"
        f"{starts if options.n_starts else ''}"
    )


def grow_branches(
    options: BranchesOptions,
    batch: LaneBatch,
    lanes: LaneRunner,
    settled: SettledOrbits,
    seeds: Sequence[SeedOrbit] = (),
) -> list[FollowedBranches]:
    """All branches over the first axis: first those of orbits, then, where they are asked for, those of equilibria.

    Args:
        options: of the branches.
        batch: lanes along the axis.
        lanes: runs lanes.
        settled: motions of the lanes.
        seeds: orbits to begin with beside those of lanes.
    """
    axis, (period, u, size) = batch.first_axis, settled
    unit = motion_unit([batch], lanes, period, size, options.box)
    ends = float(axis.values.min()), float(axis.values.max())
    waves = [*attractor_waves(batch, lanes, u, period), list(seeds)]
    sampled = spread_indices(batch.count, options.n_values)
    sample = batch.take(np.argsort(axis.values, kind="stable")[sampled])
    if options.n_starts:
        with lanes.stage(f"branches: {options.n_starts} random starts at {len(sampled)} values of {axis.name}", 0):
            waves.append(
                random_wave(
                    sample,
                    lanes,
                    options.n_starts,
                    options.seed,
                    options.box,
                    options.max_period,
                    search_unit(sample, lanes, unit, options.box),
                    options.transient,
                )
            )

    def stage(label: str) -> AbstractContextManager[object]:
        return lanes.stage(f"branches: {label}", 0)

    steps = step_control(options)
    families = [orbit_family(batch, lanes, strobe, unit, ends) for strobe in refined_maps(batch)]
    still = list[FollowedBranches]()
    if options.equilibria:
        still.append(equilibria(sample, lanes, options.equilibria, options.seed, options.box, ends, steps, stage))
        if isinstance(batch.system, Section):
            waves.append(cycles_at_hopf_points(still[0], families[0], batch.system))
    tree = timed = evidence = None
    long = options.method == "auto" and _has_long_returns(batch, lanes, waves)
    if options.method != "collocation" and not long:
        tree = grow(families, waves, options.max_period, steps, stage)
        if may_graze(batch):
            with stage("orbits that graze"):
                tree = with_grazing(batch, lanes, families[0], tree, unit)
    if tree is None or (options.method == "auto" and _needs_collocation(batch.flow, tree)):
        followed = grow_cycles(batch, lanes, waves, unit, options.max_period, ends, steps, stage)
        tree, timed = tree_of_cycles(batch, followed), durations(followed)
    if options.n_starts and timed is None:
        evidence = search_evidence(families[0], tree.branches, waves, options.n_starts * len(sampled))
    return [FollowedBranches(tree, families[0], batch, timed, evidence), *still]


def table(data: xr.Dataset, published: Mapping[str, np.ndarray], source: str) -> Table:
    """A row a period: how many branches there are, how many of them are stable somewhere, and their range."""
    name, period = str(data.attrs["along"]), data["period"].to_numpy()
    rows = []
    for n in np.unique(period).tolist():
        places = np.flatnonzero(period == n)
        stable = np.any(data["stable"].to_numpy()[places] == 1, axis=1)
        values = data[name].to_numpy()[places]
        ends = f"{np.nanmin(values):.9g} to {np.nanmax(values):.9g}"
        rows.append((str(n) if n else "equilibria", str(len(places)), str(int(stable.sum())), ends))
    return Table("Branches of periodic orbits", ("period", "branches", "stable somewhere", name), tuple(rows))


ANALYSIS = Analysis(
    "branches",
    BranchesOptions,
    # a guess, as nobody knows how many branches there are
    lambda options, lanes: _WORK * lanes * (options.transient + 2 * options.max_period),
    run,
    whole=SweepReduction(("bifurcations",), whole),
    numbers=lambda options: 6 * options.max_period,
    check=check,
    table=table,
    other_tables={"bifurcations": bifurcations_table},
    price=price_of_orbits,
    brief={"transient": 1, "max_period": 1},
)
