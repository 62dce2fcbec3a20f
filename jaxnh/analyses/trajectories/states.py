"""What the analyses that keep states have in common: transients, variables of states, sections in words, failures."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from jaxtyping import Float

from jaxnh.analyses.base import Entry, OptionError, Setting, named
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.maps.family import Maps
from jaxnh.maps.section import Section, System, outputs, plot_plane, reports
from jaxnh.systems.flow import Parameters
from jaxnh.systems.state import State

TILE = 16
"""Lanes a tile where few lanes are followed for long: small tiles take a period sooner."""


def settled(
    lanes: LaneRunner, strobe: Maps, transient: int, start: State, p: Parameters, tile: int | None = None
) -> State:
    """Lanes after a transient: in calls of their own, of which a long one takes several, so that a run can stop."""
    if not transient:
        return start
    return lanes.iterate(strobe, transient, (start, p), tile=tile)


def state_variables(
    system: System,
    states: State,
    t: Float[np.ndarray, " times"],
    dims: tuple[str, ...],
    attrs: Mapping[str, str] | None = None,
) -> dict[str, Entry]:
    """Coordinates and velocities of states, those first that it is drawn over, and the status of each trajectory.

    Args:
        system: the flow or its section.
        states: components of the shape that the dimensions have.
        t: times of the states within a period, repeated along the last dimension.
        dims: names of the dimensions.
        attrs: attributes of each variable but the time.
    """
    found = outputs(system.flow, states, t)
    found = {**{name: found[name] for name in plot_plane(system)}, **found}
    of = {name: named(dims, output, **(attrs if attrs and name != "t" else {})) for name, output in found.items()}
    return of | {name: named(dims[:-1], output) for name, output in reports(system.flow, states).items()}


_STATISTICS = (
    ("max", "largest", np.max),
    ("min", "smallest", np.min),
    ("mean", "mean", np.mean),
    ("std", "standard deviation of", np.std),
)
_OF_ANGLES = ("max", "min")  # in [−π, π), where it has neither a mean nor a deviation


def statistics(variables: Mapping[str, Entry], dim: str) -> dict[str, Entry]:
    """Variables over a last dimension reduced to NAME_max, NAME_min, NAME_mean and NAME_std; others as they are.

    Those of a trajectory that does not stay finite are NaN. Of an angle there are the first two.
    """
    found = dict[str, Entry]()
    for name, (dims, values, attrs) in variables.items():
        if dims[-1:] != (dim,):
            found[name] = dims, values, attrs
            continue
        for ending, words, of in _STATISTICS:
            if ending in _OF_ANGLES or attrs.get("units") != "rad":
                kept = {**attrs, "long_name": f"{words} {attrs['long_name']} at the {dim}s"}
                found[f"{name}_{ending}"] = dims[:-1], of(values, axis=-1), kept
    return found


def section_attrs(batch: LaneBatch) -> dict[str, str]:
    """Attributes of a group of crossings: which section they cross; none of a group of strobes."""
    section = batch.system
    if not isinstance(section, Section):
        return {}
    return {"section": section.description, "section_coordinate": section.coordinate}


def count(data: xr.Dataset) -> dict[str, int]:
    """Number of trajectories, and of those that have failed."""
    return {"trajectories": data["status"].size, "failed": int(np.count_nonzero(data["status"]))}


def check_transient(transient: int, setting: Setting) -> None:
    """See that crossings are not counted from a start state that is on no section."""
    if setting.autonomous and not transient:
        raise OptionError("must be at least 1: the start state is not on the section", "transient")
