"""The group `manifolds` of surfaces: saddles, corners and triangles of lanes as variables, and their table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from jaxnh.analyses.base import LANE, Entry, Table, as_variable, flag, number_variable, range_in_words, variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner, rate_attrs
from jaxnh.analyses.coordinates import named_points
from jaxnh.analyses.manifolds.surfaces import ENDS, SurfaceMesh
from jaxnh.analyses.manifolds.tables import KINDS, SIZES
from jaxnh.analyses.options.orbits import ManifoldsOptions
from jaxnh.analyses.section_points import statuses
from jaxnh.analyses.table_arrays import RowPlaces, real_and_imaginary
from jaxnh.systems.readout import status

LENGTHS = {
    "equilibria": "arc length of the motion from the saddle",
    "cycles": "arc length of the branch on the section from the saddle to the motion",
}
"""Arc lengths of corners, in words, by what the saddles are."""


class Surfaces(NamedTuple):
    """Surfaces of the saddles of a batch.

    Attributes:
        lane, place: of each saddle, (saddles,).
        points: of the saddles, (saddles, n, d).
        number: of all saddles of each lane, (lanes,).
        grown: by number of their kind, of each saddle; None where the manifold has not two dimensions.
        rates: by number of the kind, eigenvalues within each, the slower one first, (saddles, 2), or multipliers of
            cycles, (saddles,); not numbers where there is none.
        size: of the coordinates, (lanes, d).
    """

    lane: Int[np.ndarray, " saddles"]
    place: Int[np.ndarray, " saddles"]
    points: Float[np.ndarray, "saddles n d"]
    number: Int[np.ndarray, " lanes"]
    grown: Mapping[int, list[SurfaceMesh | None]]
    rates: Mapping[int, np.ndarray]
    size: Float[np.ndarray, "lanes d"]


def surface_variables(
    options: ManifoldsOptions, batch: LaneBatch, lanes: LaneRunner, made: Surfaces
) -> dict[str, Entry]:
    """Return all variables of a batch."""
    kinds, d = list(made.grown), batch.flow.chart.dimension
    shape = batch.count, options.saddles, len(kinds)
    points = np.full((*shape, options.max_points, d), np.nan)
    arc, deviation = np.full(points.shape[:-1], np.nan), np.full(points.shape[:-1], np.nan)
    triangles = np.full((*shape, 2 * options.max_points, 3), -1, np.int32)
    end, gaps = np.zeros(shape, np.int8), np.zeros(shape, np.int32)
    saddles = RowPlaces(shape[:2], (made.lane, made.place)).put(made.points)
    for k, kind in enumerate(kinds):
        for lane, place, surface in zip(made.lane, made.place, made.grown[kind], strict=True):
            if surface is not None:
                at, count = (lane, place, k), len(surface.points)
                points[at][:count] = surface.points * made.size[lane]
                arc[at][:count], deviation[at][:count] = surface.arc, surface.error
                triangles[at][: len(surface.triangles)] = surface.triangles
                end[at], gaps[at] = surface.end, surface.gaps
    dims, flow = (LANE, "saddle", "surface"), batch.without_section()
    repeated = np.tile(np.array(kinds), (batch.count, 1))
    corners = "numbers of the points that are corners of a triangle, the first is 0"
    return {
        "surface_kind": flag((LANE, "surface"), repeated, "kind of manifold that the surface is of", KINDS),
        "saddles": variable(LANE, made.number.astype(np.int32), "number of saddles known, kept or not"),
        **named_points(flow, lanes, saddles, (LANE, "saddle", "orbit_point"), "_orbit", "of the points of the saddle"),
        **_rates(options, batch, made, dims),
        **named_points(flow, lanes, points, (*dims, "point"), "_points", "on the surface"),
        "arc_length": variable((*dims, "point"), arc, f"{LENGTHS[options.of]}, {SIZES}"),
        "deviation": variable((*dims, "point"), deviation, f"distance of the point from the manifold, {SIZES}"),
        "triangles": number_variable((*dims, "triangle", "corner"), triangles, corners, ("none",), -1),
        "end": flag(dims, end, "how the surface ends", ENDS),
        "gaps": variable(dims, gaps, "pairs of neighbouring motions that the surface is open between"),
        "status": as_variable(LANE, status(np.where(made.number > 0, 0, statuses(batch, batch.start)))),
    }


def _rates(options: ManifoldsOptions, batch: LaneBatch, made: Surfaces, dims: tuple[str, ...]) -> dict[str, Entry]:
    """Return the eigenvalues within manifolds of equilibria, or the multipliers of cycles."""
    shape = batch.count, options.saddles, len(made.rates)
    if options.of == "cycles":
        multiplier = np.full(shape, np.nan)
        for k, of_kind in enumerate(made.rates.values()):
            multiplier[made.lane, made.place, k] = of_kind
        return {"multiplier": variable(dims, multiplier, "multiplier of the cycle along the surface")}
    eigenvalues = np.full((*shape, 2, 2), np.nan)
    for k, of_kind in enumerate(made.rates.values()):
        eigenvalues[made.lane, made.place, k] = real_and_imaginary(of_kind)
    words = "eigenvalues within the manifold, real and imaginary part"
    return {"eigenvalues": variable((*dims, "eigenvalue", "part"), eigenvalues, words, **rate_attrs(batch.flow))}


def surface_table(data: xr.Dataset) -> Table:
    """Return the ranges over lanes of the number of points, arc lengths, deviations and gaps."""
    rows = [("saddles", range_in_words(data["saddles"].to_numpy().astype(float)))]
    kind = data["surface_kind"].transpose("surface", ...).to_numpy().reshape(data.sizes["surface"], -1)[:, 0]
    for k, number in enumerate(kind.tolist()):
        of_kind = data.isel(surface=k)
        known = of_kind["end"].to_numpy().ravel() > 0
        point_last = [d for d in of_kind["arc_length"].dims if d != "point"]
        columns = {
            name: of_kind[name].transpose(*point_last, "point").to_numpy().reshape(len(known), -1)[known]
            for name in ("arc_length", "deviation")
        }
        counts = np.isfinite(columns["arc_length"]).sum(axis=1)
        rows += [
            (f"points, {KINDS[number]}", range_in_words(counts.astype(float))),
            *(
                (f"{name.replace('_', ' ')}, {KINDS[number]}", range_in_words(np.nanmax(columns[name], axis=1)))
                for name in columns
                if known.any()
            ),
            (f"gaps, {KINDS[number]}", range_in_words(of_kind["gaps"].to_numpy().ravel()[known].astype(float))),
        ]
    return Table("Manifolds", ("quantity", "values"), tuple(rows), left=(0,))
