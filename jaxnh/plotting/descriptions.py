"""Drawing of groups of a result, by name and variables; not by attributes, which arithmetic drops.

A dataset of another origin may describe itself: the attribute `panel` is the kind of panel, `panel_variables` are its
variables, `panel_label` its label, `panel_levels` its lines, and `axes` its axes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

import xarray as xr


class _Description(NamedTuple):
    """Kind of the panel, its variables, those of their dimensions that are no axes, and axes that are variables."""

    panel: str
    variables: Iterable[str]
    own: tuple[str, ...] = ()
    label: str = ""
    levels: str = "0"
    parameters: tuple[str, ...] = ()


def describe(name: str, data: xr.Dataset, axes: str = "") -> xr.Dataset:
    """Add the attributes that describe the drawing of a group, unless it has them or is none of a result.

    Args:
        name: of the group; "": the one that has such variables.
        axes: of the sweep, separated by blanks; "": those that the group says, or that its variables are over.
    """
    data = data.assign_attrs({"axes": axes} | data.attrs) if axes else data
    _, describe = _GROUPS.get(name or _name_of(data), ((), None))
    if describe is None or "panel" in data.attrs:
        return data
    panel, variables, own, label, levels, parameters = describe(data)
    shown = tuple(variables)
    dims = map(str, data[shown[0]].dims) if shown and shown[0] in data else ()
    over = " ".join((*parameters, *(dim for dim in dims if dim not in own)))
    said = {"panel": panel if shown else "", "panel_variables": " ".join(shown), "panel_label": label}
    along = {"along": parameters[0]} if parameters else {}
    return data.assign_attrs({"axes": over, **data.attrs, **said, "panel_levels": levels, **along})


def _name_of(data: xr.Dataset) -> str:
    """The group that has such variables; "" where none has, or nothing tells it from another."""
    there = {*map(str, data.variables), *map(str, data.dims)}
    if "strobe" in there:
        if "start" in there or "start_states" in data.attrs or "t" not in data:
            return "diagram"
        return "poincare" if data.attrs or data["t"].dims == ("strobe",) else ""
    return next((name for name, (signs, _) in _GROUPS.items() if there.issuperset(signs)), "")


def _names_over(data: xr.Dataset, *dims: str) -> list[str]:
    """Variables of numbers whose last dimensions are these."""
    items = ((str(name), item) for name, item in data.data_vars.items() if item.dtype.kind == "f")
    return [name for name, item in items if item.dims[-len(dims) :] == dims]


def _states_over(data: xr.Dataset, dim: str) -> list[str]:
    """Variables of numbers whose last dimension is this one, without the time."""
    return [name for name in _names_over(data, dim) if name != "t"]


def _with_errors(data: xr.Dataset, *dims: str) -> tuple[str, ...]:
    """Parameters: of variables over these dimensions those that have an error, but for δ."""
    return tuple(name for name in _names_over(data, *dims) if f"{name}_error" in data and name != "delta")


def _plane(data: xr.Dataset, panel: str, dim: str) -> _Description:
    names = _states_over(data, dim)
    return _Description(panel, names[:2] if len(names) > 1 else 2 * names, (dim,))


def _diagram(data: xr.Dataset) -> _Description:
    if "strobe" in data.dims:
        return _Description("density", _states_over(data, "strobe")[:1], ("start", "strobe"))
    first = next((str(name)[:-4] for name in data.data_vars if str(name).endswith("_max")), "")
    names = (name for name in (f"{first}_{kind}" for kind in ("max", "mean", "min")) if name in data)
    return _Description("curves", names, ("start",), f"{first} at the strobes", "none")


def _lyapunov(data: xr.Dataset) -> _Description:
    words = "largest Lyapunov exponent" if data.sizes.get("exponent") == 1 else "Lyapunov exponents"
    return _Description("curves", ("exponents",), ("exponent",), words)


def _period(data: xr.Dataset) -> _Description:
    if names := [name for name in _names_over(data, "phase") if name.endswith("_response")]:
        return _Description("phase_responses", names, ("phase",))
    return _Description("integers", ("period",), label="least period")


def _transport(data: xr.Dataset) -> _Description:
    names = [str(name) for name in data.data_vars if str(name).endswith("_growth") or name == "diffusion_exponent"]
    return _Description("curves", names, (), "exponents of time", "0 1")


def _doubling(data: xr.Dataset) -> _Description:
    parameters = _with_errors(data, "level")
    return _Description("cascade", (*parameters, "delta"), ("level",), "ratio δ", parameters=parameters)


def _of_orbits(data: xr.Dataset, panel: str, parameters: tuple[str, ...], *own: str) -> _Description:
    names = [name for name in _names_over(data, "iterate") if name.endswith("_points")]
    return _Description(panel, names[:1], (*own, "iterate"), parameters=parameters)


def _of_curves(data: xr.Dataset, panel: str, *own: str) -> _Description:
    parameters = _with_errors(data, *own)
    return _Description(panel, parameters, own, parameters=parameters)


def _manifolds(data: xr.Dataset) -> _Description:
    """Curves in a plane, or surfaces in space."""
    names = [name for name in _names_over(data, "point") if name.endswith("_points")]
    if "triangles" in data:
        return _Description("surfaces", names[:3], ("saddle", "surface", "point"))
    return _Description("manifolds", names[:2], ("saddle", "branch", "point"))


_GROUPS: Mapping[str, tuple[tuple[str, ...], Callable[[xr.Dataset], _Description] | None]] = {
    "orbit_counts": (
        ("missing_high",),
        lambda _: _Description("curves", ("number",), ("n",), "periodic orbits", "none"),
    ),
    "orbits": (
        ("met",),
        lambda data: _Description("flags", [name for name in ("scenario",) if name in data], label="scenario of chaos"),
    ),
    "edges": (
        ("edge_from",),
        lambda data: _Description(
            "curves", [name for name in ("shock",) if name in data], ("attractor",), "least shock", "0"
        ),
    ),
    "manifolds": (("arc_length", "end", "saddles"), _manifolds),
    "covariant": (
        ("angle_min", "tangency"),
        lambda _: _Description("curves", ("angle_min",), ("split",), "smallest angle", "0"),
    ),
    "transients": (("escape_rate",), lambda _: _Description("curves", ("escape_rate",), (), "escape rate", "0")),
    "reversal": (
        ("repeller_exponents",),
        lambda _: _Description("curves", ("distance", "overlap"), (), "distance and overlap", "0 1"),
    ),
    "torus_branches": (
        ("torus_branch", "torus_point"),
        lambda data: _Description(
            "torus_branches",
            ("rotation",),
            ("torus_branch", "torus_point"),
            parameters=tuple(_names_over(data, "torus_branch", "torus_point")[:1]),
        ),
    ),
    "torus_curves": (("torus_branch", "theta"), None),
    "tori": (("growth", "harmonics"), lambda data: _plane(data, "trajectories", "theta")),
    "transport": (("diffusion_kind",), _transport),
    "rotation": (
        ("rotation", "denominator"),
        lambda _: _Description("curves", ("rotation",), (), "rotation number", "none"),
    ),
    "lyapunov": (("exponents",), _lyapunov),
    "chaos01": (("k_median",), lambda _: _Description("curves", ("k_median",), (), "0–1 test, $K$", "0 1")),
    "verdict": (("recurrence_lag",), lambda _: _Description("flags", ("kind",), label="verdict")),
    "doubling": (("delta", "level"), _doubling),
    "windows": (
        ("crisis",),
        lambda data: _Description(
            "windows", ("period",), ("window",), parameters=tuple(_names_over(data, "searched")[:1])
        ),
    ),
    "branches": (
        ("begins", "stable"),
        lambda data: _of_orbits(data, "branches", tuple(_names_over(data, "branch", "point")[:1]), "branch", "point"),
    ),
    "bifurcations": (
        ("criticality",),
        lambda data: _of_orbits(data, "marks", _with_errors(data, "bifurcation"), "bifurcation"),
    ),
    "homoclinic": (
        ("saddle_quantity", "begins"),
        lambda data: _of_curves(data, "bifurcation_curves", "curve", "point"),
    ),
    "connecting_orbits": (("sample", "point"), None),
    "atlas": (("cut", "row"), None),
    "curve_orbits": (("curve", "iterate"), None),
    "curves": (("begins", "codimension_two"), lambda data: _of_curves(data, "bifurcation_curves", "curve", "point")),
    "codimension_two": (("codimension_two",), lambda data: _of_curves(data, "special_points", "codimension_two")),
    "attractors": (("fraction",), lambda _: _Description("shares", ("fraction",), ("attractor",))),
    "basins": (
        ("undecided",),
        lambda data: _Description("basins", () if "start" in data.dims else ("attractor",), label="attractor"),
    ),
    "period": (("period", "residual"), _period),
    "portrait": (("time", "status"), lambda data: _plane(data, "trajectories", "time")),
    "poincare": (("strobe",), lambda data: _plane(data, "points", "strobe")),
    "diagram": (("status",), _diagram),
}
"""Groups by name, with variables and dimensions that tell one from those after it."""
