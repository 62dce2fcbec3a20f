"""Layers of a result: its curves, branches, orbits, windows, manifolds and doublings over a view of the same names."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Literal

import numpy as np
import xarray as xr

from jaxnh.explorer.atlas import ORBITS, with_orbits
from jaxnh.explorer.layers import Facts, Item, Layer, Points, finite_points
from jaxnh.explorer.report import with_error
from jaxnh.plotting.bifurcation_curves import SHORT_NAMES
from jaxnh.plotting.branches import MARKS, stretch_places
from jaxnh.plotting.groups import parameter_of, variables_of
from jaxnh.plotting.labels import coordinate_of
from jaxnh.plotting.meanings import meanings
from jaxnh.plotting.spans import PALE, reaches
from jaxnh.plotting.style import BLACK, BLUE, CURVES, GREEN, ORANGE, PURPLE, VERMILION

_INK = "#303030"
_MARKS = {"s": "square", "o": "circle", "^": "triangle", "D": "diamond", "v": "inverted_triangle", "x": "x"}
_STABILITIES = {"stable": GREEN, "saddle": VERMILION, "repelling": PURPLE, "neutral": ORANGE}
_ATTRACTS = {1: "stable", 0: "unstable", 2: "undecided"}  # by the number of `stable`
_MANIFOLDS = {"unstable": VERMILION, "stable": BLUE}


def layers_of(groups: Mapping[str, xr.Dataset], across: str, up: str) -> list[Layer]:
    """Return the layers of groups that are over the axes of a view.

    Args:
        groups: of a result, described (`plotting.descriptions`).
        across: the axis, a parameter or a coordinate of the start.
        up: the second axis of a plane, or the coordinate that a diagram is of.
    """
    across, up = coordinate_of(across), coordinate_of(up)
    there = with_orbits({name: groups[name].load() for name in (*_MAKERS, ORBITS) if name in groups})
    layers = list[Layer]()
    for name, data in there.items():
        turned = name in ALONG_ONE and _levels_of(data, up, across) is not None
        layers += map(_turned, _MAKERS[name](data, up, across)) if turned else _MAKERS[name](data, across, up)
    return layers


def _turned(layer: Layer) -> Layer:
    """The overlay with its axes exchanged."""
    return layer._replace(items=tuple(item._replace(x=item.y, y=item.x) for item in layer.items))


# ---- facts


def _number(data: xr.Dataset, name: str, at: tuple[int, ...]) -> str:
    """A number at a place, with its error where it has one."""
    error = f"{name}_error"
    value = float(data[name].to_numpy()[at])
    return with_error(value, float(data[error].to_numpy()[at]) if error in data else np.nan)


def _word(variable: xr.DataArray, *at: int) -> str:
    return meanings(variable).get(int(variable.to_numpy()[at]), ("unknown", ""))[0]


def _words(data: xr.Dataset, names: tuple[str, ...], *at: int) -> Facts:
    """Flags at a place in words, of those of some variables that a group has."""
    there = [name for name in names if name in data and "flag_meanings" in data[name].attrs]
    return [(name, _word(data[name], *at)) for name in there]


def _multipliers(data: xr.Dataset, at: tuple[int, ...]) -> Facts:
    """Floquet multipliers (..., multiplier, part) at a place."""
    if "multipliers" not in data:
        return []
    parts = data["multipliers"].transpose(..., "multiplier", "part").to_numpy()[at]
    words = [f"{re:.6g}{f'{im:+.6g} i' if im else ''}" for re, im in parts if np.isfinite(re)]
    return [("multipliers", ", ".join(words))]


def _points_at(data: xr.Dataset, *at: int) -> Points:
    return finite_points(data, at)


def _of_curve(data: xr.Dataset, at: int) -> Facts:
    """The number of the curve that a point is on, where the group says it."""
    number = int(data["curve"][at]) if "curve" in data.data_vars else -1
    return [("on the curve of number", f"{number}")] if number >= 0 else []


def _period(n: int) -> str:
    return f"period {n}" if n else "equilibria"


# ---- over two parameters


def _of_curves(data: xr.Dataset, across: str, up: str) -> Iterator[Layer]:
    if {across, up} != {str(variable.name) for variable in variables_of(data)[:2]}:
        return
    kind = data["kind"].to_numpy()
    period = data["period"].to_numpy() if "period" in data else np.full(len(kind), -1)  # connecting orbits have none
    named, periods = meanings(data["kind"]), np.unique(period).tolist()
    x, y = (data[name].transpose("curve", "point").to_numpy() for name in (across, up))

    def facts(c: int, k: int) -> Facts:
        ends = _words(data, ("begins", "ends"), c)
        where = [(name, _number(data, name, (c, k))) for name in (across, up)]
        known = [("curve", name_of(_word(data["kind"], c), period[c])), ("number", f"{c}")]
        return [*known, *where, *_multipliers(data, (c, k)), *ends]

    def name_of(words: str, n: int) -> str:
        return f"{words}, {_period(n)}" if n >= 0 else words

    for what, (words, _) in named.items():
        for n in periods:
            chosen = np.flatnonzero((kind == what) & (period == n)).tolist()
            items = tuple(Item(x[c], y[c], partial(facts, c), partial(_points_at, data, c)) for c in chosen)
            colour = CURVES[list(named).index(what) % len(CURVES)]
            if items:
                yield Layer(name_of(words, n), "line", colour, items, dash=periods.index(n))


def _of_codimension_two(data: xr.Dataset, across: str, up: str) -> Iterator[Layer]:
    if {across, up} != {str(variable.name) for variable in variables_of(data)[:2]}:
        return
    x, y = data[across].to_numpy(), data[up].to_numpy()

    def facts(c: int, _: int) -> Facts:
        where = [(name, _number(data, name, (c,))) for name in (across, up)]
        period = [("on curves of", f"period {int(data['period'][c])}")] if "period" in data else []
        along = _of_curve(data, c)
        return [("codimension two", _word(data["kind"], c)), *where, *period, *along, *_multipliers(data, (c,))]

    for what, (words, _) in meanings(data["kind"]).items():
        chosen = np.flatnonzero(data["kind"].to_numpy() == what).tolist()
        items = tuple(
            Item(x[c : c + 1], y[c : c + 1], partial(facts, c), partial(lambda c, _: finite_points(data, (c,)), c))
            for c in chosen
        )
        if items:
            yield Layer(words, "dots", BLACK, items, mark="hollow circle", label=SHORT_NAMES.get(words, words))


def _of_doublings(data: xr.Dataset, across: str, up: str) -> Iterator[Layer]:
    """Doublings along the axis across, a curve a level, as of a sweep of cascades over the other axis."""
    dims = [dim for dim in map(str, data.dims) if coordinate_of(dim) == up]
    if across not in data.data_vars or not dims or set(data[across].dims) != {dims[0], "level"}:
        return
    data = data.transpose("level", dims[0])
    y = data[dims[0]].to_numpy()

    def facts(level: int, k: int) -> Facts:
        period = f"period {int(data['period'].to_numpy().ravel()[level])}" if data["period"].ndim == 1 else ""
        where = [(across, _number(data, across, (level, k))), (up, repr(float(y[k])))]
        return [("period doubling", period or f"number {level + 1}"), *where]

    x = data[across].to_numpy()
    items = tuple(Item(x[level], y, partial(facts, level)) for level in range(len(x)))
    yield Layer("period doublings", "line", BLACK, items)


# ---- over a parameter and a coordinate


def _levels_of(data: xr.Dataset, across: str, up: str) -> np.ndarray | None:
    """Values of the second parameter of a plane that the items of a group along the first one are at, one an item.

    One for all, or of an atlas that of the row of each; None where the group has none.
    """
    if up == parameter_of(data) or across != parameter_of(data):
        return None
    if up in data.coords and not data[up].ndim:
        [count] = [data.sizes[dim] for dim in ("branch", "bifurcation", "window") if dim in data.sizes]
        return np.full(count, float(data[up]))
    return data[up].to_numpy() if up == data.attrs.get("rows") else None


def _of_branches(data: xr.Dataset, across: str, up: str) -> Iterator[Layer]:
    levels = _levels_of(data, across, up)
    if levels is None and (across != parameter_of(data) or f"{up}_points" not in data):
        return
    x = data[across].to_numpy()
    y = _heights(data, up, levels, "branch", "point", "iterate")
    stable, period = data["stable"].to_numpy(), data["period"].to_numpy()

    def facts(b: int, k: int) -> Facts:
        words = f"{_period(period[b])}, {_ATTRACTS.get(int(stable[b, k]), 'unstable')}"
        residual = [("residual", f"{float(data['residual'][b, k]):.1g}")] if "residual" in data else []
        known = [("branch", words), ("number", f"{b}"), (across, repr(float(x[b, k])))]
        return [*known, *_second(data, up, levels, b), *_multipliers(data, (b, k)), *residual]

    periods = np.unique(period).tolist()
    for n in periods:
        for dash, (kind, stability) in enumerate(_ATTRACTS.items()):
            items = []
            for b in np.flatnonzero(period == n).tolist():
                places = stretch_places(stable[b] == kind, np.zeros(len(x[b]), bool))
                if np.any(places & np.isfinite(x[b])):
                    items += [
                        Item(
                            np.where(places, x[b], np.nan), y[b, :, i], partial(facts, b), partial(_points_at, data, b)
                        )
                        for i in range(max(n, 1) if levels is None else 1)
                    ]
            if items:
                words = f"{_period(n)}, {stability}"
                colour = CURVES[periods.index(n) % len(CURVES)]
                yield Layer(words, "line", colour, tuple(items), dash=dash)


def _second(data: xr.Dataset, up: str, levels: np.ndarray | None, at: int) -> Facts:
    """The value of the second parameter of an item: of a plane, or of its row over other axes."""
    if levels is not None:
        return [(up, repr(float(levels[at])))]
    rows = str(data.attrs.get("rows", ""))
    return [(rows, repr(float(data[rows][at])))] if rows in data else []


def _heights(data: xr.Dataset, up: str, levels: np.ndarray | None, *dims: str) -> np.ndarray:
    """Points of orbits upward; where a plane is of two parameters the value of the second."""
    if levels is None:
        return data[f"{up}_points"].transpose(*dims).to_numpy()
    shape = *(data.sizes[dim] for dim in dims[:-1]), 1
    return np.broadcast_to(levels.reshape(-1, *(1 for _ in dims[1:])), shape)


def _of_bifurcations(data: xr.Dataset, across: str, up: str) -> Iterator[Layer]:
    levels = _levels_of(data, across, up)
    if levels is None and (across != parameter_of(data) or f"{up}_points" not in data):
        return
    y = _heights(data, up, levels, "bifurcation", "iterate")
    x = np.broadcast_to(data[across].to_numpy()[:, None], y.shape)

    def facts(c: int, _: int) -> Facts:
        period = _period(int(data["period"][c])) if "period" in data else ""
        more = [("normal form", f"{float(data['coefficient'][c]):.6g}")] if "coefficient" in data else []
        born = _words(data, ("criticality",), c)
        where = [(across, _number(data, across, (c,))), *_second(data, up, levels, c)]
        branch = [("of the branch of number", f"{int(data['branch'][c])}")] if "branch" in data.data_vars else []
        along = [*branch, *_of_curve(data, c)]
        return [(_word(data["kind"], c), period), *where, *born, *more, *along, *_multipliers(data, (c,))]

    for what, (words, _) in meanings(data["kind"]).items():
        chosen = np.flatnonzero(data["kind"].to_numpy() == what).tolist()
        items = tuple(
            Item(x[c], y[c], partial(facts, c), partial(lambda c, _: finite_points(data, (c,)), c)) for c in chosen
        )
        if items:
            yield Layer(words, "dots", _INK, items, mark=_MARKS[MARKS.get(words, "x")])


def _of_windows(data: xr.Dataset, across: str, up: str) -> Iterator[Layer]:
    levels = _levels_of(data, across, up)
    if across != parameter_of(data) or (levels is None and up in data.data_vars):
        return

    def facts(w: int, _: int) -> Facts:
        known = [name for name in ("begin", "end", "limit", "crisis") if np.isfinite(float(data[name][w]))]
        kinds = {name: f" ({_word(data[f'{name}_kind'], w)})" for name in ("begin", "end")}
        where = [(name, _number(data, name, (w,)) + kinds.get(name, "")) for name in known]
        return [("window", _period(int(data["period"][w]))), *where, *_second(data, up, levels, w)]

    ends, heights = reaches(data)[1], np.zeros(data.sizes["window"]) if levels is None else levels
    items = tuple(Item(ends[w], np.full(2, heights[w]), partial(facts, w)) for w in range(len(ends)))
    if items:
        look: tuple[Literal["line", "band"], str] = ("band", PALE) if levels is None else ("line", _INK)
        yield Layer("periodic windows", *look, items)


# ---- over coordinates


def _of_orbits(data: xr.Dataset, across: str, up: str) -> Iterator[Layer]:
    """Orbits of all lanes over a parameter, or those of the first lane over two coordinates."""
    names, axes = (f"{across}_points", f"{up}_points"), [str(dim) for dim in data["period"].dims if dim != "orbit"]
    along = [dim for dim in axes if coordinate_of(dim) == across]
    if names[1] not in data or (names[0] not in data and not along):
        return
    plane = names[0] in data and not along
    data = data.isel({dim: 0 for dim in axes if plane or dim not in along}).transpose(*([] if plane else along), ...)
    values = [0.0] if plane else data[along[0]].to_numpy().tolist()
    period, stability = data["period"].to_numpy(), data["stability"].to_numpy()
    y = data[names[1]].to_numpy()
    x = data[names[0]].to_numpy() if plane else np.broadcast_to(np.reshape(values, (-1, 1, 1)), y.shape)

    def facts(at: tuple[int, ...], _: int) -> Facts:
        where = [] if plane else [(across, repr(values[at[0]]))]
        numbers = [("time", _number(data, "time", at))] if "time" in data else []
        return [
            ("orbit", f"period {period[at]}, {_word(data['stability'], *at)}"),
            *where,
            *numbers,
            *_multipliers(data, at),
        ]

    places = [tuple(map(int, at)) for at in np.argwhere(period > 0)]
    for value, (words, _) in meanings(data["stability"]).items():
        items = tuple(
            Item(x[at], y[at], partial(facts, at), partial(lambda at, _: finite_points(data, at), at))
            for at in places
            if stability[at] == value
        )
        if items:
            yield Layer(f"orbits, {words}", "dots", _STABILITIES.get(words, _INK), items)


def _of_manifolds(data: xr.Dataset, across: str, up: str) -> Iterator[Layer]:
    if f"{across}_points" not in data or f"{up}_points" not in data or "branch_kind" not in data:  # as of surfaces
        return
    own = ("saddle", "branch", "point", "orbit_point", "crossing", "contact")
    data = data.isel({dim: 0 for dim in data.dims if dim not in own})
    x, y = (data[f"{name}_points"].transpose("saddle", "branch", "point").to_numpy() for name in (across, up))

    def facts(s: int, b: int, k: int) -> Facts:
        numbers = [
            (
                name.replace("_", " "),
                f"{float(data[name].isel(saddle=s, branch=b, point=k, missing_dims='ignore')):.6g}",
            )
            for name in ("multiplier", "arc_length", "deviation")
            if name in data
        ]
        kind = f"{_word(data['branch_kind'], b)}, of saddle {s + 1}"
        return [("manifold", kind), *numbers, *_words(data, ("end",), s, b)]

    for what, (words, _) in meanings(data["branch_kind"]).items():
        chosen = np.flatnonzero(data["branch_kind"].to_numpy() == what).tolist()
        orbit = [partial(lambda s, _: finite_points(data, (s,), "_orbit"), s) for s in range(len(x))]
        items = tuple(
            Item(x[s, b], y[s, b], partial(facts, s, b), orbit[s])
            for s in range(len(x))
            for b in chosen
            if np.isfinite(x[s, b]).any()
        )
        if items:
            yield Layer(f"{words} manifolds", "line", _MANIFOLDS.get(words, _INK), items)


_Maker = Callable[[xr.Dataset, str, str], Iterator[Layer]]
_MAKERS: Mapping[str, _Maker] = {
    "windows": _of_windows,
    "doubling": _of_doublings,
    "curves": _of_curves,
    "homoclinic": _of_curves,
    "branches": _of_branches,
    "manifolds": _of_manifolds,
    "orbits": _of_orbits,
    "bifurcations": _of_bifurcations,
    "codimension_two": _of_codimension_two,
}

GROUPS = (*_MAKERS, ORBITS, "atlas")
"""Groups that are laid over pictures, or say more of those that are."""

ALONG_ONE = ("windows", "branches", "bifurcations")
"""Groups along one parameter; over planes of two they lie at the value that the other has in their result."""
