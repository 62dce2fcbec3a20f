"""A cascade of period doublings: its ratios as a panel, its points as marks on other panels."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from jaxnh.exceptions import ResultError
from jaxnh.plotting.frame import legend_above, narrow, new_axes
from jaxnh.plotting.groups import fixed_axes, label_of, other_axes, parameter_of, require_variables
from jaxnh.plotting.labels import symbol_of, title_of, with_units
from jaxnh.plotting.style import MARK, POINT

FEIGENBAUM = 4.669201609102990
"""Universal ratio of successive distances between period doublings (Feigenbaum 1978)."""

_PERIOD, _RATIO, _RATIO_ERROR = "period", "delta", "delta_error"  # the variables of a cascade beside its parameter
_CLOSE = 0.05  # of the width of the axes: marks nearer to each other share a label


def cascade(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Ratios δ of successive distances between doublings, with the universal one; the ticks name the doublings.

    Args:
        data: `period`, the parameter, `delta` and `delta_error` (level,); other axes have one point.

    Raises:
        ResultError: a variable is missing, or another axis has more than one point.
    """
    ax = new_axes(ax)
    require_variables(data, _PERIOD, _RATIO, _RATIO_ERROR)
    located = _doublings(data)
    where = located[parameter_of(data)]
    level = np.arange(1, len(where) + 1) if "level" not in located else located["level"].to_numpy()
    delta, error = located[_RATIO].to_numpy(), located[_RATIO_ERROR].to_numpy()
    ax.axhline(FEIGENBAUM, color=MARK, linewidth=0.8, linestyle="--", label=f"δ = {FEIGENBAUM:.6f}… (Feigenbaum)")
    ax.errorbar(level, delta, error, fmt="o", color=POINT, capsize=3, label="δ of three successive doublings")
    if limits := _limits(located):
        ax.plot([], [], " ", label=limits)
    for x, y in zip(level, delta, strict=True):
        if np.isfinite(y):
            ax.annotate(f"{y:.4f}", (x, y), (0, -11), textcoords="offset points", ha="center", fontsize="small")
    doublings = zip(located[_PERIOD].to_numpy(), where.to_numpy(), strict=True)
    whole = with_units(f"doubling of the period, and its {symbol_of(parameter_of(data))}", where)
    if narrow(ax):
        ax.set_xticks(level, [_doubling(n) for n, _ in doublings])
    else:
        ax.set_xticks(level, [f"{_doubling(n)}\n{value:.8f}" for n, value in doublings])
    ax.set(
        xlabel="doubling of the period" if narrow(ax) else whole,
        ylabel=with_units(label_of(data) or "ratio δ", located[_RATIO]),
        xlim=(level.min(initial=1) - 0.5, level.max(initial=1) + 0.5),
    )
    ax.set_title(title_of(data, fixed_axes(data, parameter_of(data))), loc="left")
    ax.margins(y=0.35)
    legend_above(ax, ax.get_legend_handles_labels()[0], 2)
    return ax


def mark_doublings(data: xr.Dataset, ax: Axes, axis: str) -> None:
    """A line at every doubling within axes over `axis`, labelled while there is room, then one label for the rest.

    Doublings along another axis are not marked.
    """
    if parameter_of(data) != axis:
        return
    require_variables(data, _PERIOD)
    doublings = _doublings(data)
    low, high = sorted(ax.get_xlim())
    where, period = doublings[axis].to_numpy(), doublings[_PERIOD].to_numpy()
    inside = (low <= where) & (where <= high)
    where, period = where[inside], period[inside]
    if not len(where):
        return
    bottom, top = ax.get_ylim()
    ax.set_ylim(bottom - 0.05 * (top - bottom), top)  # a strip for the labels
    for x in where:
        ax.axvline(x, color=MARK, linewidth=0.8, linestyle=(0, (4, 3)))
    for x, side, label in _labels(where, period, _CLOSE * (2 if narrow(ax) else 1) * (high - low)):
        ax.annotate(
            label,
            (x, 0.01),
            (3 * side, 0),
            xycoords=ax.get_xaxis_transform(),
            textcoords="offset points",
            ha="left" if side > 0 else "right",
            color=MARK,
            fontsize="small",
        )
    if not narrow(ax):
        mark = Line2D([], [], color=MARK, linewidth=0.8, linestyle=(0, (4, 3)), label="doubling of the period")
        ax.legend(handles=[mark], loc="upper right", bbox_to_anchor=(1.0, -0.1))


def _doublings(data: xr.Dataset) -> xr.Dataset:
    """Return the doublings of one cascade, variables (level,)."""
    if other_axes(data):
        raise ResultError(f"a panel is of one cascade, and there is one for every point of {other_axes(data)[0]}")
    *single, level = data[parameter_of(data)].dims
    selected = data.isel(dict.fromkeys(single, 0))
    return selected.isel({level: np.flatnonzero(np.isfinite(selected[parameter_of(data)].to_numpy()))})


def _limits(doublings: xr.Dataset) -> str:
    """The limit of δ, and α, each with its error, where they are known."""
    words = []
    for symbol, name in (("limit of δ", "delta_limit"), ("α", "alpha")):
        value, error = (float(doublings.get(key, np.nan)) for key in (name, f"{name}_error"))
        if np.isfinite([value, error]).all():
            digits = int(np.clip(np.ceil(-np.log10(error)), 2, 12)) if error > 0.0 else 12
            words.append(f"{symbol} = {value:.{digits}f} ± {error:.1g}")
    return ", ".join(words)


def _labels(where: np.ndarray, period: np.ndarray, narrow: float) -> list[tuple[float, int, str]]:
    """Place, side (1: right of it) and text of every label."""
    close = np.flatnonzero(np.abs(np.diff(where)) < narrow)
    alone = int(close[0]) + 1 if len(close) else len(where)
    back = 1 if len(where) > 1 and where[-1] < where[0] else -1  # where the cascade comes from
    labels = [(float(where[k]), back, _doubling(period[k])) for k in range(alone)]
    if alone < len(where):
        more = "… " if alone + 1 < len(where) else ""
        labels.append((float(where[-1]), -back, f"{more}{_doubling(period[-1])}"))
    return labels


def _doubling(period: int) -> str:
    return f"{period} → {2 * period}"
