"""Period doublings of the cascade reached from the start state, and the Feigenbaum number.

A survey sends thousands of lanes to their attractors and finds the period of each: candidates come from the strobe
points, the decision from Newton on the orbit and its multipliers, so that slow convergence near a doubling does not
bias it. Between neighbouring lanes, multisection on the multiplier brackets a doubling, and Newton on orbit, parameter
and multiplier −1 together finishes. Where the survey is too coarse for the next level, a new one looks closer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int
from pydantic import Field

from jaxnh.analyses.base import (
    Analysis,
    Axis,
    LaneRunner,
    OptionError,
    Options,
    Price,
    Program,
    Scene,
    Setting,
    Table,
    map_alone,
    section_points,
    variable,
)
from jaxnh.analyses.period import CONVERGED, Survey, orbits, survey
from jaxnh.maps.iterate import section_map
from jaxnh.maps.protocol import Strobe
from jaxnh.orbits.shooting import DoublingPoint, Segment, refine_doubling, segment

_TRANSIENT = 512  # periods before the strobe points are looked at
_SMALLEST_LIMIT = 16  # periods looked for even where few levels are asked for: the cascade may begin at 2 or 3
_CANDIDATES = 64  # lanes of a multisection
_CLOSER = 64  # lanes of a closer survey
_CLOSER_TRIES = 4
SEGMENT_TILE = 32
_REFINEMENTS = (1, 2, 4)
_MOST_SHOWN = 16  # cascades in a table of many


class DoublingOptions(Options):
    """Options of `doubling`."""

    levels: int = Field(default=6, ge=1, le=12, description="Number of period doublings to find")


def periods(options: DoublingOptions, lanes: int) -> float:
    """Lane-periods of a run, Newton's iterations at their price: the survey, and as much again for the orbits."""
    return 2.0 * lanes * (_TRANSIENT + 2 * 2**options.levels)


def independent(options: DoublingOptions) -> bool:
    """Never: a cascade is found by comparing neighbouring lanes."""
    return False


def check(options: DoublingOptions, setting: Setting) -> None:
    """See that the first axis is a parameter of the lanes' own, by which the map has a derivative."""
    first = setting.axes[0]
    if first.kind == "lane":
        return
    why = (
        f"all lanes share {first.name}" if first.kind == "shared" else f"{first.name} is a coordinate of the start state"
    )
    message = f"doubling follows the first axis of the sweep by its derivatives, and {why}"
    raise OptionError(message + setting.advice)


# ---- the search


class Line(NamedTuple):
    """Lanes along the first axis, on their attractors.

    Attributes:
        value: of the first axis, (lanes,).
        period: least period of the attractor, 0 where it is none up to the limit, (lanes,).
        u: a point of the orbit in section coordinates, (lanes, d).
    """

    value: Float[np.ndarray, " lanes"]
    period: Int[np.ndarray, " lanes"]
    u: Float[np.ndarray, "lanes d"]

    def without_holes(self) -> Line:
        """The line without lanes that stand alone or in pairs and are no part of a cascade.

        Undecided ones lie in windows or at doublings; ones of another period than both neighbours, which have the
        same, are on a coexisting attractor.
        """
        starts = np.flatnonzero(np.diff(self.period, prepend=-1))
        lengths = np.diff(np.append(starts, len(self.period)))
        found = self.period[starts]
        before, after = np.append(-1, found[:-1]), np.append(found[1:], -2)
        keep = np.repeat((lengths > 2) | ((found != 0) & (before != after)), lengths)
        return Line(*(leaf[keep] for leaf in self))

    def run_end(self, first: int) -> int:
        """Last lane of the run of equal periods that begins at a lane."""
        other = np.flatnonzero(self.period[first:] != self.period[first])
        return first + int(other[0]) - 1 if len(other) else len(self.value) - 1


def run(options: DoublingOptions, scene: Scene, lanes: LaneRunner) -> xr.Dataset:
    """Up to `levels` doublings n → 2n, each with its value of the first axis, the error of that, and δ."""
    name = scene.line.name
    limit = max(_SMALLEST_LIMIT, 2**options.levels)
    found = survey(scene, lanes, section_points(scene), limit, "doubling", _TRANSIENT, only_doublings=True)
    followed = _follow(_line(scene, found))
    points: list[DoublingPoint] = []
    errors: list[float] = []
    warning = ""
    if followed is None:
        period = 1
        warning = f"no period doubling in this range of {name}: no two neighbouring values have periods n and 2n"
    else:
        line, lane = followed
        period = int(line.period[lane])
        end = float(line.value[-1])
        for level in range(options.levels):
            n = period << level
            located = _locate(scene, lanes, line, lane, n)
            if located is None:
                warning = f"the orbit of period {n} does not double before {name} = {end:g}"
                break
            point, error = located
            points.append(point)
            errors.append(error)
            if level + 1 == options.levels:
                break
            ahead = _next_run(scene, lanes, line, points, 2 * n, max(limit, period << options.levels), end)
            if ahead is None:
                warning = (
                    f"no stable orbit of period {2 * n} was found beyond the doubling at {name} = {point.value:.9g}"
                )
                break
            line, lane = ahead
    if warning:
        warning = f"doubling: {len(points)} of {options.levels} levels found; {warning}"
    return _dataset(scene.line, options.levels, period, points, errors, warning)


def _line(scene: Scene, found: Survey) -> Line:
    """A survey of lanes along the first axis, without its holes."""
    return Line(scene.line.values, found.period, found.u).without_holes()


def _follow(found: Line) -> tuple[Line, int] | None:
    """The line in the direction in which a cascade goes furthest, and the lane where its first run begins.

    A cascade is a row of neighbouring runs of lanes, each with twice (or a higher power of two times, where the survey
    steps over a level) the period of the one before. A tie goes to the direction of the sweep, and there to the first.
    """
    best: tuple[int, Line, int] | None = None
    for ordered in (found, Line(*(leaf[::-1] for leaf in found))):
        starts = np.flatnonzero(np.diff(ordered.period, prepend=-1))
        periods = ordered.period[starts]
        for k in range(len(starts)):
            length = 0
            while k + length + 1 < len(starts) and _doubles(periods[k + length], periods[k + length + 1]):
                length += 1
            if length and (best is None or length > best[0]):
                best = length, ordered, int(starts[k])
    return None if best is None else best[1:]


def _doubles(n: np.integer, following: np.integer) -> np.bool:
    """Whether `following` is n times a power of two above one."""
    ratio = following // np.maximum(n, 1)
    return (n > 0) & (ratio > 1) & (ratio * n == following) & (ratio & (ratio - 1) == 0)


def _locate(scene: Scene, lanes: LaneRunner, found: Line, lane: int, n: int) -> tuple[DoublingPoint, float] | None:
    """The doubling of the stable period-n orbit that a lane of a line is on, and the error of its value."""
    last = found.run_end(lane)
    if last + 1 == len(found.value):
        return None
    bracket = np.linspace(found.value[last], found.value[last + 1], _CANDIDATES)
    with lanes.stage(f"doubling: period {n} → {2 * n}, multisection of {_CANDIDATES}", 0):
        start = np.broadcast_to(found.u[last], (_CANDIDATES, found.u.shape[1]))
        orbit = orbits(lanes, scene.strobe(), start, scene.at(bracket).p, n)
    ok = (orbit.residual < CONVERGED) & np.all(np.isfinite(orbit.monodromy), axis=(1, 2))
    beyond = np.flatnonzero(ok & (smallest_multiplier(np.where(ok[:, None, None], orbit.monodromy, 0.0)) < -1.0))
    if not len(beyond):
        return None
    seed = max(int(beyond[0]) - 1, 0)
    return _refine(scene, lanes, orbit.u[seed], orbit.monodromy[seed], float(bracket[seed]), n)


def smallest_multiplier(monodromy: Float[np.ndarray, "lanes d d"]) -> Float[np.ndarray, " lanes"]:
    """The smallest real eigenvalue; +∞ where all are complex."""
    values = np.linalg.eigvals(monodromy)
    return np.where(np.abs(values.imag) < 1e-12, values.real, np.inf).min(axis=1)


def _refine(
    scene: Scene,
    lanes: LaneRunner,
    u: Float[np.ndarray, " d"],
    monodromy: Float[np.ndarray, "d d"],
    value: float,
    n: int,
) -> tuple[DoublingPoint, float] | None:
    """The doubling point with twice the steps, and the error of its value: what refinements and Newton moved it by."""
    orbit, carried = around(scene, lanes, u, monodromy, value, n)
    refined: list[DoublingPoint] = []
    for refinement in _REFINEMENTS:
        strobe = scene.strobe(refinement)
        point = refine_doubling(
            lambda *at, strobe=strobe: segments(scene, lanes, strobe, *at), orbit, carried, value, scene.system.wrap
        )
        if not point.converged:
            return None
        orbit, carried, value = point.orbit, point.vector, point.value
        refined.append(point)
    coarse, fine, finest = refined
    return fine, abs(fine.value - coarse.value) + abs(finest.value - fine.value) + fine.last_step


def around(
    scene: Scene,
    lanes: LaneRunner,
    u: Float[np.ndarray, " d"],
    monodromy: Float[np.ndarray, "d d"],
    value: float,
    n: int,
) -> tuple[Float[np.ndarray, "n d"], Float[np.ndarray, "n d"]]:
    """The n points of an orbit, and its eigenvector of −1 carried along it."""
    eigenvalues, eigenvectors = np.linalg.eig(monodromy)
    vector = np.real(eigenvectors[:, np.argmin(np.abs(eigenvalues + 1.0))])
    orbit = _walk(scene, lanes, u, value, n)
    carried = np.empty((n, len(u)))
    for i in range(n):
        carried[i] = vector
        moved = segments(scene, lanes, scene.strobe(), orbit[i : i + 1], vector[None], np.array([value]))
        vector = moved.carried[0]
    return orbit, carried


def _walk(
    scene: Scene, lanes: LaneRunner, u: Float[np.ndarray, " d"], value: float, n: int
) -> Float[np.ndarray, "n d"]:
    """The n points of an orbit."""
    points, p = [u], scene.at(np.array([value])).p
    for _ in range(n - 1):
        points.append(lanes(section_map, (scene.strobe(), np.int32(1)), (points[-1][None], p), tile=SEGMENT_TILE)[0])
    return np.array(points)


def segments(
    scene: Scene,
    lanes: LaneRunner,
    strobe: Strobe,
    u: Float[np.ndarray, "n d"],
    w: Float[np.ndarray, "n d"],
    values: Float[np.ndarray, " n"],
) -> Segment:
    """`segment` at so many points, vectors and values of the first axis."""
    static = (scene.line.name,)
    return lanes(segment, (strobe,), (u, w, scene.at(values).p), tile=SEGMENT_TILE, static=static)


def _next_run(
    scene: Scene, lanes: LaneRunner, found: Line, points: list[DoublingPoint], n: int, limit: int, end: float
) -> tuple[Line, int] | None:
    """A line and the first lane in it that is on the period-n orbit born at the last doubling."""
    born = points[-1]
    sign = np.sign(found.value[-1] - found.value[0])
    ahead = np.flatnonzero(sign * (found.value - born.value) > 0)
    if len(ahead) and found.period[ahead[0]] == n and found.run_end(int(ahead[0])) > ahead[0]:
        return found, int(ahead[0])
    spacing = abs(found.value[1] - found.value[0])
    reach = 0.5 * abs(born.value - points[-2].value) if len(points) > 1 else 8 * spacing
    for _ in range(_CLOSER_TRIES):
        stop = born.value + sign * min(reach, abs(end - born.value))
        near = scene.at(np.linspace(born.value, stop, _CLOSER + 1)[1:])
        start = np.broadcast_to(born.orbit[0] + 0.01 * born.vector[0], (_CLOSER, born.orbit.shape[1]))
        label = f"doubling, beyond {scene.line.name} = {born.value:.9g}"
        closer = survey(near, lanes, start, limit, label, _TRANSIENT, least=n, only_doublings=True)
        closer = _line(near, closer)
        first = np.flatnonzero(closer.period == n)
        if len(first):
            return closer, int(first[0])
        reach /= 8
    return None


# ---- what it gives


def _dataset(
    axis: Axis, levels: int, period: int, points: list[DoublingPoint], errors: list[float], warning: str
) -> xr.Dataset:
    """Points as the variables of the contract, NaN where a level was not found."""
    name = axis.name
    value = np.full(levels, np.nan)
    value[: len(points)] = [point.value for point in points]
    value_error = np.full(levels, np.nan)
    value_error[: len(points)] = errors
    delta, delta_error = _deltas(value, value_error)
    limit, limit_error = _delta_limit(delta[np.isfinite(delta)], delta_error[np.isfinite(delta)])
    index = np.arange(1, levels + 1)
    error_words = f"largest error of {name}, from step refinement and the Newton residual"
    variables = {
        "level": variable("level", index, "number of the period doubling"),
        "period": variable("level", period * 2 ** (index - 1), "period n of the orbit that doubles to 2n", "periods"),
        name: variable("level", value, f"{axis.long_name} at the doubling", ancillary_variables=f"{name}_error"),
        f"{name}_error": variable("level", value_error, error_words),
        "delta": variable(
            "level",
            delta,
            "ratio δ of successive distances between doublings, equation (14)",
            ancillary_variables="delta_error",
        ),
        "delta_error": variable("level", delta_error, f"error of δ that the errors of {name} cause"),
        "delta_limit": variable((), limit, "limit of δ", ancillary_variables="delta_limit_error"),
        "delta_limit_error": variable((), limit_error, "error of the limit of δ"),
        "levels_found": variable((), len(points), "number of doublings found"),
    }
    attrs = {
        "along": name,
        "panel": "cascade",
        "panel_variables": f"{name} delta",
        "panel_label": "ratio δ",
        **({"warnings": warning} if warning else {}),
    }
    return xr.Dataset(variables, attrs=attrs)


def _deltas(
    value: Float[np.ndarray, " levels"], value_error: Float[np.ndarray, " levels"]
) -> tuple[Float[np.ndarray, " levels"], Float[np.ndarray, " levels"]]:
    """δ_k = (b_k − b_{k−1})/(b_{k+1} − b_k) at the middle level, NaN at both ends, and its propagated error."""
    delta = np.full(len(value), np.nan)
    error = np.full(len(value), np.nan)
    gap = np.diff(value)
    gap_error = value_error[1:] + value_error[:-1]
    delta[1:-1] = gap[:-1] / gap[1:]
    error[1:-1] = np.abs(delta[1:-1]) * (gap_error[:-1] / np.abs(gap[:-1]) + gap_error[1:] / np.abs(gap[1:]))
    return delta, error


def _delta_limit(delta: Float[np.ndarray, " found"], error: Float[np.ndarray, " found"]) -> tuple[float, float]:
    """Limit of δ by Aitken's Δ² from the last three, with the distance from the last as part of its error.

    With two δ the last one stands for the limit, and their distance for its error; with fewer there is none (NaN).
    """
    if len(delta) < 2:
        return math.nan, math.nan
    if len(delta) == 2:
        return float(delta[1]), float(abs(delta[1] - delta[0]) + error[1])
    first, second, third = delta[-3:]
    bend = third - 2.0 * second + first
    limit = third - (third - second) ** 2 / bend if bend else third
    return float(limit), float(abs(limit - third) + error[-3:].max())


def table(data: xr.Dataset, published: Mapping[str, np.ndarray], source: str) -> Table:
    """Levels of a cascade beside published values: the parameter with its error, their difference, and δ of both.

    Of many cascades, one for each point of the other axes, only what each has come to.

    Args:
        data: result of this analysis; numbers of a cascade are variables, or attributes where there is one cascade.
        published: published values of the parameter by its name and `delta`, a value a level, NaN where there is none.
        source: where they are from.
    """
    data = data.assign({name: ((), data.attrs[name]) for name in _NUMBERS if name in data.attrs})
    others = tuple(str(dim) for dim in data["delta"].dims if dim != "level")
    return _cascades(data, others) if others else _levels(data, published, source)


_NUMBERS = ("delta_limit", "delta_limit_error", "levels_found")


def _levels(data: xr.Dataset, published: Mapping[str, np.ndarray], source: str) -> Table:
    """A row a level."""
    name = str(data.attrs["along"])
    ours = {key: data[key].to_numpy() for key in ("period", name, f"{name}_error", "delta")}
    levels = len(ours[name])
    none = np.full(levels, np.nan)
    theirs = {key: np.append(published.get(key, none[:0]), none)[:levels] for key in (name, "delta")}
    heads = ("period", name, "± error", "δ")
    if published:
        heads = ("period", f"{name}, {source}", name, "± error", "difference", f"δ, {source}", "δ")
    rows = []
    for k in range(levels):
        n = int(ours["period"][k])
        row = [f"{n} → {2 * n}", f"{ours[name][k]:.12f}", f"{ours[f'{name}_error'][k]:.1e}", f"{ours['delta'][k]:.6f}"]
        if published:
            difference = theirs[name][k] - ours[name][k]
            row[1:1] = [f"{theirs[name][k]:.6f}"]
            row[4:4] = [f"{difference:+.1e}", f"{theirs['delta'][k]:.4f}"]
        rows.append(tuple(_cell(cell) for cell in row))
    return Table("Period doublings", heads, tuple(rows), _limit_words(data) or None)


def _cascades(data: xr.Dataset, others: tuple[str, ...]) -> Table:
    """A row a cascade: its point of the other axes, its first and last doubling, and the limit of δ."""
    name = str(data.attrs["along"])
    points = list(np.ndindex(*(data.sizes[other] for other in others)))
    shown = np.unique(np.linspace(0, len(points) - 1, min(len(points), _MOST_SHOWN)).round().astype(int))
    rows = []
    for point in (points[i] for i in shown):
        cascade = data.isel(dict(zip(others, point, strict=True)))
        found = int(cascade["levels_found"])
        ends = [f"{cascade[name].to_numpy()[k]:.12f}" if found else "–" for k in (0, found - 1)]
        place = [f"{float(cascade[other]):.6g}" for other in others]
        rows.append((*place, str(found), *ends, _limit_words(cascade) or "–"))
    caption = f"{len(rows)} of {len(points):,} cascades" if len(rows) < len(points) else None
    return Table("Period doublings", (*others, "found", f"{name}, first", f"{name}, last", "δ"), tuple(rows), caption)


def _limit_words(data: xr.Dataset) -> str:
    """The limit of δ and its error; nothing where there is none."""
    limit, error = float(data["delta_limit"]), float(data["delta_limit_error"])
    return f"δ → {limit:.4f} ± {error:.1g}" if math.isfinite(limit) else ""


def _cell(text: str) -> str:
    return "–" if text in ("nan", "+nan") else text


def price(options: DoublingOptions, scene: Scene) -> Price:
    """Newton at a doubling needs second derivatives; before it comes the map alone."""
    strobe, u = scene.strobe(), section_points(scene)
    lanes: tuple[Any, ...] = u, np.ones_like(u), dict(scene.p)
    program = Program(segment, (strobe,), lanes, strobe.turns, (scene.line.name,), tile=SEGMENT_TILE)
    note = "second derivatives in every period of Newton at a doubling, the map alone before it"
    return Price(program, map_alone(scene, tile=SEGMENT_TILE), note)


ANALYSIS = Analysis(
    "doubling",
    DoublingOptions,
    periods,
    run,
    independent=independent,
    newton=True,
    clock=True,
    check=check,
    table=table,
    price=price,
)
"""The entry of this analysis in the table."""

