"""Period doublings of the cascade reached from the start state (`cascade` finds them), and the Feigenbaum numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from jaxtyping import Float

from jaxnh.analyses.base import Analysis, OptionError, Setting, Table, variable
from jaxnh.analyses.batch import Axis, LaneBatch, LaneRunner, iterate_units
from jaxnh.analyses.cascade.cascade_sensitivities import cascade_sensitivities
from jaxnh.analyses.cascade.extended_precision import (
    FLOAT64_LEVELS,
    ExtendedDoublings,
    alpha_limit,
    append_extended,
    check_operations,
    delta_limit,
    deltas,
    extended_doublings,
)
from jaxnh.analyses.cascade.follow import TRANSIENT, Cascade, follow, survey_limit
from jaxnh.analyses.cascade.limits import doublings_limit, widths_limit
from jaxnh.analyses.options.orbits import DoublingOptions
from jaxnh.analyses.periodic.location import LocatedDoubling, price_of_orbits
from jaxnh.analyses.periodic.sensitivity_tables import absent_words, sensitivity_variables, sensitivity_words
from jaxnh.maps.section import System, flow_of
from jaxnh.systems.chart import Wrap
from jaxnh.systems.piecewise_smooth import PiecewiseSmooth
from jaxnh.systems.rows import spread_indices

_LIMITS = ("delta_limit", "alpha", "limit")  # each with its error
_NUMBERS = (*_LIMITS, *(f"{name}_error" for name in _LIMITS), "levels_found")
_BETWEEN = np.array([1.0, math.pi]) / (1.0 + math.pi)  # shares of two values: no ratio of whole numbers
_OWN_NAMES = ("level", "parameter", "period", "delta", "delta_error", *_NUMBERS)
_MOST_SHOWN = 16  # cascades in a table of many
_ROUNDING = 1e-14  # of points of an orbit, in sizes of the motion
_ASTRIDE = 10.0  # of the distances a period before and after: a pair further apart has a jump between its points
_DIGITS = 4  # of a limit in words, at least
_LEVELS = 12  # of float64, of which the distances of doublings are then 1e-9 of the first


def check(options: DoublingOptions, setting: Setting) -> None:
    """Check that the first axis is a parameter for which the system exists between grid values."""
    first = setting.axes[0]
    if options.sensitivities and setting.precision == "extended":
        raise OptionError("derivatives in parameters are of float64; leave it out", "sensitivities")
    if options.levels > _LEVELS and setting.precision != "extended":
        message = f"float64 tells {_LEVELS} doublings of a cascade apart; more need accuracy.precision: extended"
        raise OptionError(message, "levels")
    if first.kind == "shared" and setting.precision == "extended":
        raise OptionError(f"extended precision is along a parameter that lanes have of their own{setting.advice}")
    if taken := [axis.name for axis in setting.axes if axis.name in _OWN_NAMES]:
        raise OptionError(f"{taken[0]} is what doubling calls a number of its own; rename the parameter")
    if first.kind == "start":
        what = f"{first.name} is a coordinate of the start state"
        message = f"doubling follows orbits along the first axis of the sweep, and {what}"
        raise OptionError(message + setting.advice)
    if first.kind == "shared" and options.search and "search" in options.model_fields_set:
        message = f"it looks beyond the sweep, and all lanes share {first.name}: the system may not exist there"
        raise OptionError(f"{message}; leave it out", "search")
    if first.kind == "shared":
        try:
            _ = setting.flow_at(float(_BETWEEN @ first.values[[0, -1]])).period
        except ValueError as error:
            message = f"doubling looks between the values of {first.name}, and there {error}"
            raise OptionError(message + setting.advice) from None


def run(options: DoublingOptions, batch: LaneBatch, lanes: LaneRunner) -> xr.Dataset:
    """Up to `levels` doublings n → 2n, each with its value of the first axis, the error of that, and δ."""
    if batch.precision == "extended":
        check_operations(batch)
    search = options.search and batch.family is None
    extended, levels = batch.precision == "extended", options.levels
    in_float64 = min(levels, FLOAT64_LEVELS) if extended else levels
    cascade = follow(batch, lanes, in_float64, search=search)
    if not extended:
        data = _dataset(batch.system, batch.first_axis, levels, cascade)
        return _with_sensitivities(data, batch, lanes, cascade.doublings) if options.sensitivities else data
    beyond = extended_doublings(batch, lanes, cascade, levels)
    whole = append_extended(batch, cascade, beyond, levels)
    limits = delta_limit(beyond.fine), alpha_limit(beyond.fine, cascade.size, batch.chart.wrap)
    return _extended(_dataset(batch.system, batch.first_axis, levels, whole), beyond, *limits)


def _dataset(system: System, axis: Axis, levels: int, cascade: Cascade) -> xr.Dataset:
    """Points as the variables of the contract, NaN where a level was not located."""
    name, count = axis.name, len(cascade.doublings)
    refined, rounding, value_error = np.full((3, levels), np.nan), np.full(levels, np.nan), np.full(levels, np.nan)
    refined[:, :count] = np.reshape(
        [[point.value for point in level.refined] for level in cascade.doublings], (count, 3)
    ).T
    rounding[:count] = [level.point.error for level in cascade.doublings]
    value_error[:count] = [level.error for level in cascade.doublings]
    value = refined[1]
    delta, delta_error = _deltas(value, rounding)
    delta_error += np.abs(np.diff([_deltas(each, rounding)[0] for each in refined], axis=0)).sum(axis=0)
    limit = doublings_limit(value[:count], rounding[:count])
    widths, width_errors = _widths(system, cascade)
    alpha = widths_limit(widths, width_errors)
    index = np.arange(1, levels + 1)
    period_words = "period n of the orbit that doubles to 2n"
    error_words = f"largest error of {name}, from step refinement and the Newton residual"
    unit = iterate_units(system)
    variables = {
        "level": variable("level", index, "number of the period doubling"),
        "period": variable("level", cascade.period * 2 ** (index - 1), period_words, counted_in=unit),
        name: variable(
            "level", value, f"{axis.long_name} at the doubling", axis.units, ancillary_variables=f"{name}_error"
        ),
        f"{name}_error": variable("level", value_error, error_words, axis.units),
        "delta": variable(
            "level",
            delta,
            "ratio δ of successive distances between doublings, equation (14)",
            ancillary_variables="delta_error",
        ),
        "delta_error": variable("level", delta_error, f"error of δ, from step refinement and the rounding of {name}"),
        "delta_limit": variable((), limit.ratio, "limit of δ", ancillary_variables="delta_limit_error"),
        "delta_limit_error": variable((), limit.ratio_error, "error of the limit of δ"),
        "alpha": variable(
            (), alpha.ratio, "limit α of the ratio of widths of successive orbits", ancillary_variables="alpha_error"
        ),
        "alpha_error": variable((), alpha.ratio_error, "error of α"),
        "limit": variable(
            (), limit.value, f"{axis.long_name} where the cascade ends", ancillary_variables="limit_error"
        ),
        "limit_error": variable((), limit.error + value_error[max(count - 1, 0)], f"error of {name} there"),
        "levels_found": variable((), count, "number of doublings found"),
    }
    attrs = {"along": name, **({"warnings": warnings} if (warnings := _warnings(axis, levels, cascade)) else {})}
    return xr.Dataset(variables, attrs=attrs)


def _with_sensitivities(
    data: xr.Dataset, batch: LaneBatch, lanes: LaneRunner, doublings: Sequence[LocatedDoubling]
) -> xr.Dataset:
    """The dataset with derivatives of all doublings, and of their limit, in the other parameters of the flow."""
    name, levels = batch.first_axis.name, data.sizes["level"]
    derived, limits = (each.row(0) for each in cascade_sensitivities(batch, lanes, [doublings], levels))
    warnings = "\n".join(filter(None, (data.attrs.get("warnings", ""), absent_words("doubling", derived))))
    words, units = batch.first_axis.long_name, batch.first_axis.units
    more = sensitivity_variables(derived, batch, ("level",), name, f"{words} at the doubling", units)
    more |= sensitivity_variables(limits, batch, (), "limit", f"{words} where the cascade ends", units)
    return data.assign(more).assign_attrs({"warnings": warnings} if warnings else {})


def _extended(
    data: xr.Dataset, doublings: ExtendedDoublings, of_delta: tuple[float, float], of_alpha: tuple[float, float]
) -> xr.Dataset:
    """The dataset with what double-double precision knows of its doublings: their other digits, δ, and limits."""
    name, levels = str(data.attrs["along"]), data.sizes["level"]
    count = min(len(doublings.coarse), len(doublings.fine))
    value, low, delta, error = (np.full(levels, np.nan) for _ in range(4))
    value[:count], low[:count] = np.reshape([point.value for point in doublings.fine[:count]], (count, 2)).T
    if count > 2:
        (coarse, _), (fine, rounding) = deltas(doublings.coarse[:count]), deltas(doublings.fine[:count])
        delta[1 : count - 1], error[1 : count - 1] = fine, np.abs(np.subtract(fine, coarse)) + rounding
    new = {name: np.where(np.isnan(value), data[name], value), "delta": delta, "delta_error": error}
    for limit, numbers in (("delta_limit", of_delta), ("alpha", of_alpha)):
        new |= dict(zip((limit, f"{limit}_error"), numbers, strict=True)) if np.isfinite(numbers).all() else {}
    data = data.assign({key: (data[key].dims, numbers, data[key].attrs) for key, numbers in new.items()})
    words = f"what is to be added to {name} for its digits beyond float64, of the map as it is computed"
    return data.assign({f"{name}_low": variable("level", low, words, str(data[name].attrs.get("units", "")))})


def _warnings(axis: Axis, levels: int, cascade: Cascade) -> str:
    """Lines for the user: how many levels are missing, what was searched, and which lie outside the sweep."""
    lines = []
    if cascade.end:
        end, *more = cascade.end.split("\n")
        lines = [f"{len(cascade.points)} of {levels} levels found; {end}", *more]
    if cascade.outside:
        ends = f"{axis.values[0]:.6g} to {axis.values[-1]:.6g}"
        lines.append(f"doublings were found beyond the sweep, which is {axis.name} = {ends}")
    return "\n".join(f"doubling: {line}" for line in lines)


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


def _widths(system: System, cascade: Cascade) -> tuple[Float[np.ndarray, " even"], Float[np.ndarray, " even"]]:
    """Widths of the orbits of even period, and their errors by step refinement and by rounding of the parameter."""
    even, flow = [level for level in cascade.doublings if len(level.point.orbit) % 2 == 0], flow_of(system)
    jumps = isinstance(flow, PiecewiseSmooth) and flow.needs_events
    widths = np.array(
        [
            [orbit_width(system.chart.wrap, point.orbit, cascade.size, jumps=jumps) for point in level.refined]
            for level in even
        ]
    ).reshape(-1, 3)
    errors = np.abs(np.diff(widths, axis=1)).sum(axis=1) + _ROUNDING
    return widths[:, 1], errors


def orbit_width(wrap: Wrap, orbit: Float[np.ndarray, "n d"], size: Float[np.ndarray, " d"], *, jumps: bool) -> float:
    """Return the largest distance of a point from that half a period later, in sizes of the motion.

    It is near the extremum of the map that the motion contracts to, and falls by α a level, elsewhere faster. Where
    states jump, pairs of points one of which is before a jump and the other after it are left out: theirs is that of
    the jump at every level.
    """
    distance = np.linalg.norm(wrap(orbit - np.roll(orbit, len(orbit) // 2, axis=0)) / size, axis=1)
    if jumps:
        beside = np.maximum(np.roll(distance, 1), np.roll(distance, -1))
        distance = distance[distance <= _ASTRIDE * beside]
    return float(distance.max())


def table(data: xr.Dataset, published: Mapping[str, np.ndarray], source: str) -> Table:
    """Levels of a cascade beside published values: the parameter with its error, their difference, and δ of both.

    Of many cascades, one for each point of the other axes, only what each has come to.

    Args:
        data: result of this analysis.
        published: published values of the parameter by its name and `delta`, a value a level, NaN where there is none.
        source: where they are from.
    """
    others = tuple(str(dim) for dim in data["delta"].dims if dim != "level")
    return _cascades(data, others) if others else _levels(data, published, source)


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
        rows.append(tuple("–" if cell in ("nan", "+nan") else cell for cell in row))
    words = filter(None, (_limit_words(data), sensitivity_words(data, name)))
    return Table("Period doublings", heads, tuple(rows), "; ".join(words) or None)


def _cascades(data: xr.Dataset, others: tuple[str, ...]) -> Table:
    """A row a cascade: its point of the other axes, its first and last doubling, and the limit of δ."""
    name = str(data.attrs["along"])
    points = list(np.ndindex(*(data.sizes[other] for other in others)))
    shown = spread_indices(len(points), _MOST_SHOWN)
    rows = []
    for point in (points[i] for i in shown):
        cascade = data.isel(dict(zip(others, point, strict=True)))
        count = int(cascade["levels_found"])
        ends = [f"{cascade[name].to_numpy()[k]:.12f}" if count else "–" for k in (0, count - 1)]
        place = [f"{float(cascade[other]):.6g}" for other in others]
        rows.append((*place, str(count), *ends, _limit_words(cascade) or "–"))
    caption = f"{len(rows)} of {len(points):,} cascades" if len(rows) < len(points) else None
    return Table("Period doublings", (*others, "found", f"{name}, first", f"{name}, last", "δ"), tuple(rows), caption)


def _limit_words(data: xr.Dataset) -> str:
    """δ, α and the end of the cascade with their errors, of those that there are."""
    symbols = ("δ", "α", str(data.attrs["along"]))
    pairs = zip(symbols, _LIMITS, strict=True)
    limits = [(symbol, float(data[name]), float(data[f"{name}_error"])) for symbol, name in pairs]
    return ", ".join(f"{symbol} → {_with_error(*limit)}" for symbol, *limit in limits if np.isfinite(limit).all())


def _with_error(value: float, error: float) -> str:
    """A number with as many digits as its error has a say in."""
    digits = max(_DIGITS, math.ceil(-math.log10(error))) if error > 0.0 else _DIGITS
    return f"{value:.{digits}f} ± {error:.1g}"


ANALYSIS = Analysis(
    "doubling",
    DoublingOptions,
    lambda options, lanes: 2.0 * lanes * (TRANSIENT + 2 * survey_limit(options.levels)),
    run,
    independent=lambda _: False,
    check=check,
    table=table,
    price=price_of_orbits,
)
