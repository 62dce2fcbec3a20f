"""Surfaces of all lanes: of saddle equilibria in time, and of saddle cycles on a section."""

from __future__ import annotations

import numpy as np
import xarray as xr

from jaxnh.analyses.base import OptionError, Setting
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.manifolds.branches import SIDES, find_saddle_orbits, grow_branches, sides_of
from jaxnh.analyses.manifolds.cycle_surfaces import grow_surfaces_of_cycles, whole_points
from jaxnh.analyses.manifolds.equilibrium_surfaces import find_saddles, grow_surfaces_of_equilibria, local_surfaces
from jaxnh.analyses.manifolds.surface_tables import Surfaces, surface_variables
from jaxnh.analyses.manifolds.surfaces import Growth, SurfaceMesh
from jaxnh.analyses.manifolds.tables import KINDS
from jaxnh.analyses.options.orbits import ManifoldsOptions
from jaxnh.analyses.periodic.flow_cycles import no_collocation
from jaxnh.analyses.random_starts import box_size
from jaxnh.analyses.trajectories.states import section_attrs
from jaxnh.maps.section import Section

_SHARE = 0.01  # of the accuracy, that the local part of a surface may leave
_LEAST, _MOST = 1e-11, 1e-6  # sizes: deviations of surfaces that steps are chosen by, where none is asked for


def check_surfaces(setting: Setting) -> None:
    """Check that the system is a smooth flow without a clock, with directions beside two."""
    flow = setting.flow
    if not flow.continuous:
        raise OptionError("surfaces are of flows, and this is a map; take dimension: 1", "dimension")
    if not setting.autonomous:
        why = "surfaces are of a flow without a clock; of one with a clock take dimension: 1, the curves of its map"
        raise OptionError(why, "dimension")
    if why := no_collocation(flow):
        raise OptionError(f"surfaces are not grown: {why}", "dimension")
    if flow.chart.dimension < 3:
        raise OptionError("a surface is all there is of a flow with two coordinates", "dimension")


def run_surfaces(options: ManifoldsOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Return saddles and their manifolds of dimension two."""
    tolerance = max(batch.target or float(np.fmin(batch.error_estimate, _MOST)), _LEAST)
    run = _of_equilibria if options.of == "equilibria" else _of_cycles
    made = run(options, batch, lanes, tolerance)
    return xr.Dataset(surface_variables(options, batch, lanes, made), attrs=section_attrs(batch))


def _growth(options: ManifoldsOptions, batch: LaneBatch, size: np.ndarray, kind: int, tolerance: float) -> Growth:
    """Return how surfaces of a kind grow, with sizes and parameters of each lane."""
    p, timed = dict(batch.p), options.of == "cycles"
    return Growth(batch.flow, size, p, SIDES[kind], options.spacing, options.max_points, tolerance, timed)


def _of_equilibria(options: ManifoldsOptions, batch: LaneBatch, lanes: LaneRunner, tolerance: float) -> Surfaces:
    batch = batch.without_section()
    kinds = [kind for kind, word in enumerate(KINDS) if options.kind in (word, "both")]
    with lanes.stage(f"manifolds: equilibria of {batch.count:,} lanes", 0):
        size = box_size(batch, options.box)
        known = find_saddles(batch, lanes, options.n_starts, options.seed, options.box, size)
        local = {kind: local_surfaces(batch, lanes, known, size, SIDES[kind], _SHARE * tolerance) for kind in kinds}
    two = np.array([any(discs[k] is not None for discs in local.values()) for k in range(len(known.lane))], bool)
    number = np.bincount(known.lane[two], minlength=batch.count)
    place = np.cumsum(two) - 1 - (np.cumsum(number) - number)[known.lane]
    kept = np.flatnonzero(two & (place < options.saddles))
    lane = known.lane[kept]
    grown, eigenvalues = dict[int, list[SurfaceMesh | None]](), dict[int, np.ndarray]()
    with lanes.stage(f"manifolds: surfaces of {len(kept):,} saddles", 0):
        for kind in kinds:
            of_kind = [(i, each) for i, k in enumerate(kept) if (each := local[kind][k]) is not None]
            own = np.array([i for i, _ in of_kind], int)
            growth = _growth(options, batch, size, kind, tolerance)
            surfaces = grow_surfaces_of_equilibria(
                lanes, growth.take(lane[own]), [each for _, each in of_kind], options.length
            )
            grown[kind], eigenvalues[kind] = [None] * len(kept), np.full((len(kept), 2), np.nan + 0j)
            for (i, each), surface in zip(of_kind, surfaces, strict=True):
                grown[kind][i], eigenvalues[kind][i] = surface, SIDES[kind] * each.eigenvalues
    return Surfaces(lane, place[kept], known.points[kept][:, None], number, grown, eigenvalues, size)


def _of_cycles(options: ManifoldsOptions, batch: LaneBatch, lanes: LaneRunner, tolerance: float) -> Surfaces:
    assert isinstance(batch.system, Section)
    sides = sides_of(options, batch)
    with lanes.stage(f"manifolds: saddles of {batch.count:,} lanes", 0):
        size = box_size(batch.without_section(), options.box)
        saddles, number, _ = find_saddle_orbits(options, batch, lanes, sides)
    on_section, period = np.delete(size, batch.system.number, axis=1), options.period
    grown, multipliers = dict[int, list[SurfaceMesh | None]](), dict[int, np.ndarray]()
    with lanes.stage(f"manifolds: surfaces of {len(saddles.lane):,} saddles", 0):
        for kind, side in sides.items():
            branches = grow_branches(
                batch, lanes, side, saddles, on_section, options.length, options.spacing, options.max_points
            )
            growth = _growth(options, batch, size, kind, tolerance)
            grown[kind] = grow_surfaces_of_cycles(batch, lanes, growth, branches, saddles.lane)
            multipliers[kind] = branches.curves[0].multiplier[:: 2 * period] ** SIDES[kind]
    points = whole_points(batch, lanes, saddles.points.reshape(-1, batch.chart.dimension))
    points = points.reshape(len(saddles.lane), period, -1)
    return Surfaces(saddles.lane, saddles.place, points, number, grown, multipliers, size)
