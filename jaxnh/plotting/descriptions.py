"""How each group of a result is drawn, by its name and its variables; attributes, which arithmetic drops, have no say.

A dataset of another origin may say it itself: by the attribute `panel` the kind of panel, by `panel_variables` of what,
by `panel_label` in which words and by `panel_levels` where lines are, and by `axes` over what.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

import xarray as xr

from jaxnh.exceptions import ResultError


class Description(NamedTuple):
    """How a group is drawn.

    Attributes:
        panel: kind of the panel, a key of `panels.PANELS`.
        variables: that the panel shows.
        own: dimensions of these that are no axes of the sweep.
        label: what is shown in words; "": those of the variable.
        levels: numbers that it is held against, separated by blanks, or "none".
        parameters: axes of the sweep that are variables.
    """

    panel: str
    variables: Iterable[str]
    own: tuple[str, ...] = ()
    label: str = ""
    levels: str = "0"
    parameters: tuple[str, ...] = ()


def described(name: str, data: xr.Dataset, axes: str = "") -> xr.Dataset:
    """A group with attributes that say how it is drawn; as it is where it has these, or is none of a result.

    Args:
        name: of the group; "": the one that has such variables.
        axes: of the sweep, separated by blanks; "": those that the group says, or that its variables are over.

    Raises:
        ResultError: it may be one of two groups, or lacks what it is known by.
    """
    data = data.assign_attrs({"axes": axes} | data.attrs) if axes else data
    describe = _GROUPS.get(name or _name_of(data))
    if describe is None or "panel" in data.attrs:
        return data
    try:
        panel, variables, own, label, levels, parameters = describe(data)
        shown = tuple(variables)
        over = (*parameters, *(dim for name in shown[:1] for dim in map(str, data[name].dims) if dim not in own))
    except KeyError as missing:
        raise ResultError(f"there is no variable {missing.args[0]}") from missing
    said = {"panel": panel if shown else "", "panel_variables": " ".join(shown), "panel_label": label}
    along = {"along": parameters[0]} if parameters else {}
    return data.assign_attrs({"axes": " ".join(over), **data.attrs, **said, "panel_levels": levels, **along})


def _name_of(data: xr.Dataset) -> str:
    """The group that has such variables; "" where none has."""
    there = {*map(str, data.variables), *map(str, data.dims)}
    for name, signs in _SIGNS.items():
        if signs <= there:
            return name
    if "strobe" not in data.dims:
        return ""
    if "start" in there | data.attrs.keys() or "t" not in data:
        return "diagram"
    if data.attrs or data["t"].dims == ("strobe",):
        return "poincare"
    raise ResultError(
        "its strobes may be those of diagram or of poincare, and no attribute says which; "
        "give it by its name, as xarray.DataTree.from_dict({'poincare': data})"
    )


def _over(data: xr.Dataset, *dims: str) -> list[str]:
    """Variables of numbers whose last dimensions are these, but for times."""
    items = ((str(name), item) for name, item in data.data_vars.items() if item.dtype.kind == "f")
    return [name for name, item in items if name != "t" and tuple(map(str, item.dims))[-len(dims) :] == dims]


def _with_errors(data: xr.Dataset, *dims: str) -> tuple[str, ...]:
    """Parameters: of variables over these dimensions those that have an error, but for δ."""
    return tuple(name for name in _over(data, *dims) if f"{name}_error" in data and name != "delta")


def _plane(data: xr.Dataset, dim: str) -> list[str]:
    """The first two coordinates, or the only one twice."""
    return (2 * _over(data, dim)[:1])[:2] if len(_over(data, dim)) < 2 else _over(data, dim)[:2]


def _diagram(data: xr.Dataset) -> Description:
    if "strobe" in data.dims:
        return Description("density", _over(data, "strobe")[:1], ("start", "strobe"))
    first = next((str(name)[:-4] for name in data.data_vars if str(name).endswith("_max")), "")
    names = (name for name in (f"{first}_{kind}" for kind in ("max", "mean", "min")) if name in data)
    return Description("curves", names, ("start",), f"{first} at the strobes", "none")


def _lyapunov(data: xr.Dataset) -> Description:
    words = "largest Lyapunov exponent" if data.sizes.get("exponent") == 1 else "Lyapunov exponents"
    return Description("curves", ("exponents",), ("exponent",), words)


def _doubling(data: xr.Dataset) -> Description:
    parameters = _with_errors(data, "level")
    return Description("cascade", (*parameters, "delta"), ("level",), "ratio δ", parameters=parameters)


def _of_orbits(panel: str, parameters: tuple[str, ...], data: xr.Dataset) -> Description:
    own = ("branch", "point", "bifurcation", "iterate")
    names = [name for name in _over(data, "iterate") if name.endswith("_points")]
    return Description(panel, names[:1], own, parameters=parameters)


def _of_curves(panel: str, data: xr.Dataset, *dims: str) -> Description:
    parameters = _with_errors(data, *dims)
    return Description(panel, parameters, dims, parameters=parameters)


_GROUPS: Mapping[str, Callable[[xr.Dataset], Description]] = {
    "portrait": lambda data: Description("trajectories", _plane(data, "time"), ("time",)),
    "poincare": lambda data: Description("points", _plane(data, "strobe"), ("strobe",)),
    "diagram": _diagram,
    "period": lambda data: Description("integers", ("period",), label="least period"),
    "lyapunov": _lyapunov,
    "chaos01": lambda data: Description("curves", ("k_median",), label="0–1 test, $K$", levels="0 1"),
    "verdict": lambda data: Description("flags", ("kind",), label="verdict"),
    "doubling": _doubling,
    "windows": lambda data: Description(
        "windows", ("period",), ("window",), parameters=tuple(_over(data, "searched")[:1])
    ),
    "branches": lambda data: _of_orbits("branches", tuple(_over(data, "branch", "point")[:1]), data),
    "bifurcations": lambda data: _of_orbits("marks", _with_errors(data, "bifurcation"), data),
    "curves": lambda data: _of_curves("bifurcation_curves", data, "curve", "point"),
    "codimension_two": lambda data: _of_curves("special_points", data, "codimension_two"),
    "basins": lambda data: Description("basins", () if "start" in data.dims else ("attractor",), label="attractor"),
    "attractors": lambda data: Description("shares", ("fraction",), ("attractor",)),
}

_SIGNS: Mapping[str, set[str]] = {
    "lyapunov": {"exponents"},
    "chaos01": {"k_median"},
    "verdict": {"recurrence_lag"},
    "doubling": {"delta", "level"},
    "windows": {"crisis"},
    "branches": {"begins", "stable"},
    "bifurcations": {"criticality"},
    "curves": {"begins", "codimension_two"},
    "codimension_two": {"codimension_two"},
    "attractors": {"fraction"},
    "basins": {"undecided"},
    "period": {"period", "residual"},
    "portrait": {"time", "status"},
}
"""Variables and dimensions that tell a group from those after it."""
