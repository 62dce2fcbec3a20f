"""Layers of a result: its curves, branches, orbits, windows, manifolds and doublings over a view of the same names."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Literal

import numpy as np
import xarray as xr

from jaxnh.explorer.layers import Facts, Item, Layer, Points
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
_MANIFOLDS = {"unstable": VERMILION, "stable": BLUE}


def layers_of(groups: Mapping[str, xr.Dataset], across: str, up: str) -> list[Layer]:
    """Return the layers of groups that are over the axes of a view.

    Args:
        groups: of a result, described (`plotting.descriptions`).
        across: the axis, a parameter or a coordinate of the start.
        up: the second axis of a plane, or the coordinate that a diagram is of.
    """
    across, up = coordinate_of(across), coordinate_of(up)
    there = {name: groups[name].load() for name in _MAKERS if name in groups}
    layers = list[Layer]()
    for name, data in there.items():
        turned = name in ALONG_ONE and _level_of(data, up, across) is not None
        layers += map(_turned, _MAKERS[name](data, up, across)) if turned else _MAKERS[name](data, across, up)
    return layers


def _turned(layer: Layer) -> Layer:
    """The same with the axes exchanged."""
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


def _points(data: xr.Dataset, at: tuple[int, ...], ending: str = "_points") -> Points:
    """Finite points of an orbit, by coordinate."""
    names = [str(name) for name in data.data_vars if str(name).endswith(ending)]
    every = {name.removesuffix(ending): data[name].to_numpy()[at].ravel() for name in names}
    known = np.all([np.isfinite(values) for values in every.values()], axis=0) if every else np.zeros(0, bool)
    return {name: values[known] for name, values in every.items()}


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
        return [("curve", name_of(_word(data["kind"], c), period[c])), *where, *_multipliers(data, (c, k)), *ends]

    def name_of(words: str, n: int) -> str:
        return f"{words}, period {n}" if n >= 0 else words

    for what, (words, _) in named.items():
        for n in periods:
            chosen = np.flatnonzero((kind == what) & (period == n)).tolist()
            items = tuple(Item(x[c], y[c], partial(facts, c)) for c in chosen)
            colour = CURVES[list(named).index(what) % len(CURVES)]
            if items:
                yield Layer(name_of(words, n), "line", colour, items, dash=periods.index(n))


def _of_codimension_two(data: xr.Dataset, across: str, up: str) -> Iterator[Layer]:
    if {across, up} != {str(variable.name) for variable in variables_of(data)[:2]}:
        return
    x, y = data[across].to_numpy(), data[up].to_numpy()

    def facts(c: int, _: int) -> Facts:
        where = [(name, _number(data, name, (c,))) for name in (across, up)]
        of = [("on curves of", f"period {int(data['period'][c])}")] if "period" in data else []
        return [("codimension two", _word(data["kind"], c)), *where, *of, *_multipliers(data, (c,))]

    for what, (words, _) in meanings(data["kind"]).items():
        chosen = np.flatnonzero(data["kind"].to_numpy() == what).tolist()
        items = tuple(Item(x[c : c + 1], y[c : c + 1], partial(facts, c)) for c in chosen)
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


def _level_of(data: xr.Dataset, across: str, up: str) -> float | None:
    """The value of the second parameter of a plane that a group along the first one is at; None where it has none."""
    fixed = up in data.coords and not data[up].ndim and up != parameter_of(data)
    return float(data[up]) if fixed and across == parameter_of(data) else None


def _of_branches(data: xr.Dataset, across: str, up: str) -> Iterator[Layer]:
    level = _level_of(data, across, up)
    if level is None and (across != parameter_of(data) or f"{up}_points" not in data):
        return
    x = data[across].to_numpy()
    y = _heights(data, up, level, "branch", "point", "iterate")
    stable, period = data["stable"].to_numpy() == 1, data["period"].to_numpy()

    def facts(b: int, k: int) -> Facts:
        words = f"{_period(period[b])}, {'stable' if stable[b, k] else 'unstable'}"
        residual = [("residual", f"{float(data['residual'][b, k]):.1g}")] if "residual" in data else []
        return [
            ("branch", words),
            (across, repr(float(x[b, k]))),
            *_second(up, level),
            *_multipliers(data, (b, k)),
            *residual,
        ]

    periods = np.unique(period).tolist()
    for n in periods:
        for attracts in (True, False):
            items = []
            for b in np.flatnonzero(period == n).tolist():
                here = stretch_places(stable[b] == attracts, np.zeros(len(x[b]), bool))
                if np.any(here & np.isfinite(x[b])):
                    orbit = partial(lambda b, k: _points(data, (b, k)), b)
                    items += [
                        Item(np.where(here, x[b], np.nan), y[b, :, i], partial(facts, b), orbit)
                        for i in range(max(n, 1) if level is None else 1)
                    ]
            if items:
                words = f"{_period(n)}, {'stable' if attracts else 'unstable'}"
                colour = CURVES[periods.index(n) % len(CURVES)]
                yield Layer(words, "line", colour, tuple(items), dash=0 if attracts else 1)


def _second(up: str, level: float | None) -> Facts:
    return [] if level is None else [(up, repr(level))]


def _heights(data: xr.Dataset, up: str, level: float | None, *dims: str) -> np.ndarray:
    """Points of orbits upward; where a plane is of two parameters the value of the second."""
    if level is None:
        return data[f"{up}_points"].transpose(*dims).to_numpy()
    return np.full((*(data.sizes[dim] for dim in dims[:-1]), 1), level)


def _of_bifurcations(data: xr.Dataset, across: str, up: str) -> Iterator[Layer]:
    level = _level_of(data, across, up)
    if level is None and (across != parameter_of(data) or f"{up}_points" not in data):
        return
    y = _heights(data, up, level, "bifurcation", "iterate")
    x = np.broadcast_to(data[across].to_numpy()[:, None], y.shape)

    def facts(c: int, _: int) -> Facts:
        of = _period(int(data["period"][c])) if "period" in data else ""
        more = [("normal form", f"{float(data['coefficient'][c]):.6g}")] if "coefficient" in data else []
        born = _words(data, ("criticality",), c)
        where = [(across, _number(data, across, (c,))), *_second(up, level)]
        return [(_word(data["kind"], c), of), *where, *born, *more, *_multipliers(data, (c,))]

    for what, (words, _) in meanings(data["kind"]).items():
        chosen = np.flatnonzero(data["kind"].to_numpy() == what).tolist()
        items = tuple(Item(x[c], y[c], partial(facts, c), partial(lambda c, _: _points(data, (c,)), c)) for c in chosen)
        if items:
            yield Layer(words, "dots", _INK, items, mark=_MARKS[MARKS.get(words, "x")])


def _of_windows(data: xr.Dataset, across: str, up: str) -> Iterator[Layer]:
    if across != parameter_of(data) or up in data.data_vars:
        return

    def facts(w: int, _: int) -> Facts:
        known = [name for name in ("begin", "end", "limit", "crisis") if np.isfinite(float(data[name][w]))]
        kinds = {name: f" ({_word(data[f'{name}_kind'], w)})" for name in ("begin", "end")}
        where = [(name, _number(data, name, (w,)) + kinds.get(name, "")) for name in known]
        return [("window", _period(int(data["period"][w]))), *where, *_second(up, level)]

    ends, level = reaches(data)[1], _level_of(data, across, up)
    items = tuple(Item(ends[w], np.full(2, level or 0.0), partial(facts, w)) for w in range(len(ends)))
    if items:
        look: tuple[Literal["line", "band"], str] = ("band", PALE) if level is None else ("line", _INK)
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
            Item(x[at], y[at], partial(facts, at), partial(lambda at, _: _points(data, at), at))
            for at in places
            if stability[at] == value
        )
        if items:
            yield Layer(f"orbits, {words}", "dots", _STABILITIES.get(words, _INK), items)


def _of_manifolds(data: xr.Dataset, across: str, up: str) -> Iterator[Layer]:
    if f"{across}_points" not in data or f"{up}_points" not in data:
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
        orbit = [partial(lambda s, _: _points(data, (s,), "_orbit"), s) for s in range(len(x))]
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

GROUPS = tuple(_MAKERS)
"""Groups that are laid over pictures."""

ALONG_ONE = ("windows", "branches", "bifurcations")
"""Those along one parameter; over planes of two they lie at the value that the other has in their result."""
