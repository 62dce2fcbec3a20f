"""Groups of an atlas on the page: orbits of its curves, and how far it is complete. No JAX."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

ORBITS = "curve_orbits"
"""The group that has the points of the orbits of all points of curves."""


def with_orbits(groups: Mapping[str, xr.Dataset]) -> dict[str, xr.Dataset]:
    """Return the other groups, of which curves have the points of their orbits (curve, point, iterate).

    Points of codimension two have those (codimension_two, iterate) of the nearest point of their curve.
    """
    others = {name: data for name, data in groups.items() if name != ORBITS}
    if ORBITS not in groups or "curves" not in groups:
        return others
    orbits, curves = groups[ORBITS], groups["curves"]
    names = [str(name) for name in orbits.data_vars if str(name).endswith("_points")]
    points = {
        name: (("curve", "point", "of_orbit"), orbits[name].transpose("curve", "point", "iterate").to_numpy())
        for name in names
    }
    others["curves"] = curves.assign(points)
    if "codimension_two" in groups and "curve" in groups["codimension_two"].data_vars:
        special = groups["codimension_two"]
        curve, at = _nearest_points(special, curves)
        chosen = {
            name: (("codimension_two", "of_orbit"), np.where(curve[:, None] < 0, np.nan, values[curve, at]))
            for name, (_, values) in points.items()
        }
        others["codimension_two"] = special.assign(chosen)
    return others


def _nearest_points(special: xr.Dataset, curves: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the curves of points of codimension two, −1 for none, and the points of these that are nearest."""
    number = special["curve"].to_numpy().astype(int)
    far = np.zeros((len(number), curves.sizes["point"]))
    if not far.size:
        return number, np.zeros(len(number), int)
    for name in str(special.attrs["panel_variables"]).split()[:2]:
        values = curves[name].transpose("curve", "point").to_numpy()
        width = max(float(np.ptp(values[np.isfinite(values)])), 1e-300)
        far += ((values[number] - special[name].to_numpy()[:, None]) / width) ** 2
    return number, np.argmin(np.where(np.isfinite(far), far, np.inf), axis=1)


def limits_of(groups: Mapping[str, xr.Dataset]) -> tuple[str, ...]:
    """The limits up to which an atlas among some groups is complete, in words; nothing where there is none."""
    if "atlas" not in groups:
        return ()
    data = groups["atlas"]
    counts = f"{int(data['curves'])} curves, of which {int(data['cut'])} go on beyond their last point"
    lost = f"{int(data['not_located'])} bifurcations not located"
    spacing = f"spacing = {float(data['spacing']):.3g}"
    return (f"atlas: {counts}; {lost}; complete to {data.attrs['complete_to']}; {spacing}",)
