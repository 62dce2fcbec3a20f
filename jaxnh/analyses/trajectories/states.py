"""Functions shared by the analyses that keep states: transients, variables of states, sections in words, failures."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence

import jax
import numpy as np
import xarray as xr
from jaxtyping import Float

from jaxnh.analyses.base import Entry, OptionError, Setting, as_variable, variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.maps.family import Maps
from jaxnh.maps.section import Crossing, Section, System, flow_of, outputs, plot_plane, reports
from jaxnh.systems.flow import Parameters
from jaxnh.systems.mechanical_outputs import describe_output, evaluate_outputs, output_names
from jaxnh.systems.state import State
from jaxnh.systems.status import STATUS

TILE = 16
"""Lanes a tile where few lanes are followed for long: small tiles take a period sooner."""


def settle_lanes(
    lanes: LaneRunner, strobe: Maps, transient: int, start: State, p: Parameters, tile: int | None = None
) -> State:
    """Return lanes after a transient: in calls of their own, several for a long one, so that a run can stop."""
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
    """Return coordinates and velocities of states, the drawn ones first, and the status of each trajectory.

    Args:
        system: the flow or its section.
        states: components of the shape that the dimensions have.
        t: times of the states within a period, repeated along the last dimension.
        dims: names of the dimensions.
        attrs: attributes of each variable but the time.
    """
    flow = flow_of(system)
    coordinates = outputs(flow, states, t)
    coordinates = {**{name: coordinates[name] for name in plot_plane(system)}, **coordinates}
    variables = {
        name: as_variable(dims, output, **(attrs if attrs and name != "t" else {}))
        for name, output in coordinates.items()
    }
    return variables | {name: as_variable(dims[:-1], output) for name, output in reports(flow, states).items()}


def check_outputs(names: Sequence[str], setting: Setting) -> None:
    """Check that a flow has the outputs that are asked for."""
    known = output_names(setting.flow) if names else {}
    for name in names:
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1)
            meant = f" (did you mean {close[0]}?)" if close else ""
            has = f"there are {', '.join(known)}" if known else "systems of T and Q have some"
            raise OptionError(f"there is no output {name}{meant}; {has}", "outputs")
        if taken := set(known[name]) & set(setting.flow.coordinates):
            raise OptionError(f"{taken.pop()} names a coordinate or velocity and an output; rename it", "outputs")


def output_variables(
    names: Sequence[str],
    lanes: LaneRunner,
    system: System,
    states: State,
    p: Parameters,
    t: Float[np.ndarray, " times"],
    dims: tuple[str, ...],
    attrs: Mapping[str, str] | None = None,
) -> dict[str, Entry]:
    """Return the outputs asked for at states, as of `state_variables`.

    Args:
        names: of the outputs.
        lanes: runs them.
        p: parameters, (lanes,).
    """
    if not names:
        return {}
    flow = flow_of(system)
    states = states.state if isinstance(states, Crossing) else states
    known, points = output_names(flow), jax.tree.leaves(states)[0].shape[-1]
    made = [variable for name in names for variable in known[name]]
    times = np.resize(t, points)  # they repeat
    values = lanes(evaluate_outputs, (flow, times), (states, dict(p)), static=(tuple(made),))
    variables = {}
    for name, numbers in zip(made, values, strict=True):
        words, units = describe_output(flow, name)
        variables[name] = variable(dims, numbers, words, units, **(attrs or {}))
    return variables


_STATISTICS = (
    ("max", "largest", np.max),
    ("min", "smallest", np.min),
    ("mean", "mean", np.mean),
    ("std", "standard deviation of", np.std),
)
_OF_ANGLES = ("max", "min")  # in [−π, π), where it has neither a mean nor a deviation


def statistics(variables: Mapping[str, Entry]) -> dict[str, Entry]:
    """Reduce variables over strobes, their last dimension, to NAME_max, NAME_min, NAME_mean and NAME_std; keep others.

    Those of a trajectory that does not stay finite are NaN. Of an angle there are the first two.
    """
    reduced = dict[str, Entry]()
    for name, (dims, values, attrs) in variables.items():
        if dims[-1:] != ("strobe",):
            reduced[name] = dims, values, attrs
            continue
        for ending, words, reduce in _STATISTICS:
            if ending in _OF_ANGLES or attrs.get("units") != "rad":
                kept = {**attrs, "long_name": f"{words} {attrs['long_name']} at the strobes"}
                reduced[f"{name}_{ending}"] = dims[:-1], reduce(values, axis=-1), kept
    return reduced


def section_attrs(batch: LaneBatch) -> dict[str, str]:
    """Return the attributes of a group of crossings that name the section; none for a group of strobes."""
    section = batch.system
    if not isinstance(section, Section):
        return {}
    return {"section": section.description, "section_coordinate": section.coordinate}


def count(data: xr.Dataset) -> dict[str, int]:
    """Return the number of trajectories, and of those that have failed: in all, and for each reason under its name."""
    tally = np.bincount(data["status"].to_numpy().ravel().astype(int), minlength=len(STATUS))
    reasons = {STATUS[code]: int(tally[code]) for code in range(1, len(STATUS)) if tally[code]}
    return {"trajectories": data["status"].size, "failed": int(tally[1:].sum()), **reasons}


def check_transient(transient: int, setting: Setting) -> None:
    """Check that crossings are not counted from a start state, which need not be on the section."""
    if setting.autonomous and not transient:
        raise OptionError("must be at least 1: crossings are counted from the first after the start", "transient")
