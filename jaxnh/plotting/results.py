"""Pictures of results: a result file, or one group of it, onto matplotlib axes. No solver and no JAX is loaded here.

Every drawing function takes a dataset as xarray reads it and optional axes, and returns the axes. The table PANELS says
what a file's analyses look like together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colorizer import ColorizingArtist
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxnh.plotting.density import cell_edges, density
from jaxnh.plotting.labels import axis_label, first_pair, lane_title, named, same_plane
from jaxnh.storage import hdf5 as store

FEIGENBAUM = 4.669201609102990
"""Universal ratio of successive distances between period doublings (Feigenbaum 1978)."""

_WIDTH = 10.0  # inches
_MOST_PORTRAITS = 12
_MARKERS = 20_000  # up to so many points are drawn one by one
_DISTINCT = 256  # up to so many different strobe points get large markers
_FEW = 48  # curves over fewer values of b show their points
_LINE, _POINT, _MARK = "#7f9cb8", "#b3261e", "#1c6e4a"
_INK = ListedColormap(colormaps["magma_r"](np.linspace(0.22, 1.0, 24)))  # few steps: they print well, files stay small
_KINDS = {
    "periodic": "#3b6fb5",
    "quasiperiodic": "#e0a030",
    "chaotic": "#b3261e",
    "undecided": "#b8b8b8",
    "failed": "#000000",
}


class FigureError(Exception):
    """A file cannot be drawn; the message is one sentence."""


# ---- one analysis, one pair of axes


def portrait(data: xr.Dataset, index: int = 0, ax: Axes | None = None, *, strobes: xr.Dataset | None = None) -> Axes:
    """Phase portrait of one value of b in the plane of the first position and its velocity, (x1, x2) of the paper.

    The points of a `poincare` group are drawn over it.
    """
    ax = _axes(ax)
    chosen = data.isel(b=index)
    ax.plot(*(chosen[name] for name in first_pair(data)), color=_LINE, linewidth=0.5, zorder=1)
    if strobes is not None:
        _points(strobes.isel(b=index), ax)
    return _plane(data, index, ax)


def poincare(data: xr.Dataset, index: int = 0, ax: Axes | None = None) -> Axes:
    """Poincaré map of one value of b in the plane of the first position and its velocity."""
    ax = _axes(ax)
    _points(data.isel(b=index), ax)
    return _plane(data, index, ax)


def diagram(
    data: xr.Dataset, ax: Axes | None = None, *, variable: str = "", doublings: xr.Dataset | None = None
) -> Axes:
    """Bifurcation diagram: a variable, by default the first position, at the strobes against b.

    Unless the points are few, it is drawn as a density.

    The colour is the share of a column's strobe points that fall into a cell, on a logarithmic scale: an orbit of
    period n has n cells of 1/n each. With a `doubling` group its points are marked.
    """
    ax = _axes(ax)
    b = data["b"].to_numpy()
    variable = variable or first_pair(data)[0]
    values = data[variable].transpose("b", ...).to_numpy().reshape(len(b), -1)
    if values.size <= _MARKERS:
        ax.plot(np.repeat(b, values.shape[1]), values.ravel(), ".", color=_POINT, markersize=2, markeredgewidth=0)
    else:
        across, up, share = density(b, values)
        norm = LogNorm(share[share > 0].min(initial=0.5), 1.0)
        image = ax.pcolorfast(across, up, np.ma.masked_equal(share.T, 0.0), cmap=_INK, norm=norm)
        _key_to_colours(image, ax)
    _over_b(data, ax, axis_label(data[variable]))
    if doublings is not None:
        _mark_doublings(doublings, ax)
    return ax


def doubling(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Ratios δ of successive distances between doublings, with the universal one; the ticks name the doublings."""
    ax = _axes(ax)
    found = data.isel(level=np.flatnonzero(np.isfinite(data["b"].to_numpy())))
    level = found["level"].to_numpy()
    delta, error = found["delta"].to_numpy(), found["delta_error"].to_numpy()
    ax.axhline(FEIGENBAUM, color=_MARK, linewidth=1, linestyle="--", label=f"δ = {FEIGENBAUM:.6f}… (Feigenbaum)")
    ax.errorbar(level, delta, error, fmt="o", color=_POINT, capsize=3, label="δ of three successive doublings")
    for x, y in zip(level, delta, strict=True):
        if math.isfinite(y):
            ax.annotate(f"{y:.4f}", (x, y), (0, -14), textcoords="offset points", ha="center", fontsize=8)
    periods = found["period"].to_numpy()
    ax.set_xticks(
        level, [f"{n} → {2 * n}\n{b:.8f}" for n, b in zip(periods, found["b"].to_numpy(), strict=True)], fontsize=8
    )
    ax.set(
        xlabel=f"doubling of the period, and its {named(data['b'])[1]} (dimensionless)",
        ylabel="ratio δ (dimensionless)",
    )
    ax.set_xlim(level.min(initial=1) - 0.5, level.max(initial=1) + 0.5)
    ax.margins(y=0.25)
    ax.legend(fontsize=8, frameon=False, loc="lower right")
    return ax


def lyapunov(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Lyapunov exponents against b, each with its error as a band."""
    ax = _axes(ax)
    data = data.sortby("b")
    count = data.sizes["exponent"]
    ax.axhline(0.0, color="black", linewidth=0.6)
    for k in range(count):
        _curve(data["exponents"].isel(exponent=k), data["exponents_error"].isel(exponent=k), ax, f"$λ_{k + 1}$", k)
    ax.legend(loc="lower left", ncols=count, frameon=False)
    symbol = "$λ_1$" if count == 1 else "$λ_k$"
    name = "largest Lyapunov exponent" if count == 1 else "Lyapunov exponents"
    return _over_b(data, ax, f"{name} {symbol} ({data['exponents'].attrs['units']})")


def chaos01(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Growth rate K of the 0–1 test against b, with its error as a band."""
    ax = _axes(ax)
    data = data.sortby("b")
    for level in (0.0, 1.0):
        ax.axhline(level, color="black", linewidth=0.6)
    _curve(data["k"], data["k_error"], ax, "$K$", 0)
    return _over_b(data, ax, "0–1 test, $K$ (dimensionless)")


def period(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Least period against b on a logarithmic scale; values of b without one stand below it."""
    ax = _axes(ax)
    b, n = data["b"].to_numpy(), data["period"].to_numpy()
    none = 0.5
    ax.plot(b[n > 0], n[n > 0], ".", color=_KINDS["periodic"], markersize=3)
    ax.plot(b[n == 0], np.full(np.sum(n == 0), none), "|", color=_KINDS["undecided"], markersize=5)
    ax.set_yscale("log", base=2)
    highest = max(int(n.max(initial=1)), 1)
    ticks = [2**k for k in range(highest.bit_length())]
    ax.set_yticks([none, *ticks], ["none", *map(str, ticks)])
    ax.set_ylim(none / 1.5, 1.5 * highest)
    return _over_b(data, ax, f"least period ({data['period'].attrs['units']})")


def verdict(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Verdicts as a strip of colours along b, with their numbers."""
    ax = _axes(ax)
    data = data.sortby("b")
    kind, b = data["kind"].to_numpy(), data["b"].to_numpy()
    meanings = str(data["kind"].attrs["flag_meanings"]).split()
    flags = [int(flag) for flag in np.atleast_1d(data["kind"].attrs["flag_values"])]
    colours = ListedColormap([_KINDS.get(name, "#7a3b8f") for name in meanings])
    place = np.searchsorted(flags, kind)
    distinct, first = np.unique(b, return_index=True)
    norm = Normalize(-0.5, len(flags) - 0.5)
    ax.pcolorfast(cell_edges(distinct), [0.0, 1.0], place[None, first], cmap=colours, norm=norm)
    handles = [
        Patch(color=colours(i), label=f"{name}: {np.sum(kind == flag):,}")
        for i, (name, flag) in enumerate(zip(meanings, flags, strict=True))
        if np.any(kind == flag)
    ]
    ax.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(meanings), frameon=False)
    ax.set_yticks([])
    return _over_b(data, ax, "verdict")


# ---- a whole file


class Panel(NamedTuple):
    """A drawing of its own axes: `draw(ax)`, its height in inches, and whether it takes the whole width."""

    draw: Callable[[Axes], Axes]
    height: float
    wide: bool = True


def _portraits(tree: xr.DataTree) -> list[Panel]:
    data, strobes = tree["portrait"].to_dataset(), _group(tree, "poincare")
    strobes = strobes if strobes is not None and same_plane(strobes, data) else None
    return [Panel(partial(portrait, data, i, strobes=strobes), 3.4, False) for i in _drawn(data)]


def _maps(tree: xr.DataTree) -> list[Panel]:
    data, portraits = tree["poincare"].to_dataset(), _group(tree, "portrait")
    if portraits is not None and same_plane(data, portraits):
        return []  # over the portraits
    return [Panel(partial(poincare, data, i), 3.4, False) for i in _drawn(data)]


def _diagram(tree: xr.DataTree) -> list[Panel]:
    return [Panel(partial(diagram, tree["diagram"].to_dataset(), doublings=_group(tree, "doubling")), 4.6)]


def _alone(name: str, draw: Callable[[xr.Dataset, Axes], Axes], height: float) -> Callable[[xr.DataTree], list[Panel]]:
    return lambda tree: [Panel(partial(draw, tree[name].to_dataset()), height)]


PANELS: Mapping[str, Callable[[xr.DataTree], list[Panel]]] = {
    "portrait": _portraits,
    "poincare": _maps,
    "diagram": _diagram,
    "doubling": _alone("doubling", doubling, 2.8),
    "lyapunov": _alone("lyapunov", lyapunov, 4.0),
    "period": _alone("period", period, 2.8),
    "chaos01": _alone("chaos01", chaos01, 2.8),
    "verdict": _alone("verdict", verdict, 1.4),
}
"""Panels of each analysis, from the whole result."""


def figure(path: Path) -> Figure:
    """Every analysis of a result file, in the order of the file.

    Raises:
        FigureError: the file is damaged, none of ours, or has nothing to draw.
    """
    try:
        attrs = store.read_attrs(path)
        tree = xr.open_datatree(path, engine="h5netcdf").load()
    except store.StoreError as error:
        raise FigureError(str(error)) from error
    except (OSError, RuntimeError, ValueError, KeyError, TypeError) as error:
        raise FigureError(f"{path} is damaged: {error}") from error
    try:
        panels = [panel for name in tree.children if name in PANELS for panel in PANELS[name](tree)]
        if not panels:
            raise FigureError(f"{path} has no analysis that can be drawn")
        return _laid_out(panels, attrs, _left_out(tree))
    except (KeyError, IndexError, ValueError, TypeError) as error:
        raise FigureError(f"{path} is not as jaxnh writes it: {error}") from error


def _left_out(tree: xr.DataTree) -> str:
    """What a picture does not show because it would be too large."""
    counts = [tree[name].sizes["b"] for name in ("portrait", "poincare") if name in tree.children]
    if max(counts, default=0) <= _MOST_PORTRAITS:
        return ""
    swept = next(str(node["b"].attrs.get("long_name", "b")) for node in tree.children.values() if "b" in node)
    return f"; {_MOST_PORTRAITS} of the {max(counts):,} values of {swept.rsplit(' ', 1)[-1]} are drawn"


def _laid_out(panels: list[Panel], attrs: Mapping[str, object], note: str) -> Figure:
    """Wide panels a row each, others two a row; a title above, and below what the numbers are from, and a note."""
    rows: list[list[Panel]] = []
    for panel in panels:
        if panel.wide or not rows or rows[-1][0].wide or len(rows[-1]) == 2:
            rows.append([])
        rows[-1].append(panel)
    heights = [max(panel.height for panel in row) for row in rows]
    drawing = Figure(figsize=(_WIDTH, sum(heights) + 0.8), layout="constrained")
    grid = drawing.add_gridspec(len(rows), 2, height_ratios=heights)
    for i, row in enumerate(rows):
        for j, panel in enumerate(row):
            panel.draw(drawing.add_subplot(grid[i, :] if panel.wide else grid[i, j]))
    drawing.suptitle(str(attrs.get("title", "")))
    drawing.supxlabel(
        f"jaxnh {attrs['jaxnh_version']}, {attrs['solver']}, {attrs['steps_per_period']} steps a period, "
        f"error of one {'return' if 'section' in attrs else 'period'} {attrs['error_estimate']:.1g}{note}",
        fontsize=7,
        color="gray",
    )
    return drawing


# ---- parts of drawings


def _axes(ax: Axes | None) -> Axes:
    return Figure(figsize=(0.7 * _WIDTH, 4.5), layout="constrained").subplots() if ax is None else ax


def _over_b(data: xr.Dataset, ax: Axes, ylabel: str) -> Axes:
    """Axes over b: all panels of a file end at the same values."""
    edges = cell_edges(np.unique(data["b"].to_numpy()))
    ax.set(xlabel=axis_label(data["b"]), ylabel=ylabel, xlim=(edges[0], edges[-1]))
    return ax


def _plane(data: xr.Dataset, index: int, ax: Axes) -> Axes:
    x, y = first_pair(data)
    ax.set(xlabel=axis_label(data[x]), ylabel=axis_label(data[y]))
    ax.set_title(lane_title(data, index), fontsize=10)
    return ax


def _points(strobes: xr.Dataset, ax: Axes) -> None:
    """Strobe points of one b, large where few differ."""
    points = np.column_stack([strobes[name] for name in first_pair(strobes)])
    few = len(np.unique(points.round(4), axis=0)) <= _DISTINCT
    size = 5.0 if few else 1.4
    ax.plot(*points.T, "o", color=_POINT, markersize=size, markeredgewidth=0, zorder=2)


def _drawn(data: xr.Dataset) -> list[int]:
    """The values of b that get a panel: all, or some evenly picked."""
    count = data.sizes["b"]
    return np.unique(np.linspace(0, count - 1, min(count, _MOST_PORTRAITS)).round().astype(int)).tolist()


def _group(tree: xr.DataTree, name: str) -> xr.Dataset | None:
    return tree[name].to_dataset() if name in tree.children else None


def _curve(values: xr.DataArray, error: xr.DataArray, ax: Axes, label: str, k: int) -> None:
    """A curve over rising b with its error as a band; points as well where they are few."""
    b, y, e = values["b"].to_numpy(), values.to_numpy(), error.to_numpy()
    colour = ("#b3261e", "#3b6fb5", "#1c6e4a")[k % 3]
    ax.fill_between(b, y - e, y + e, color=colour, alpha=0.4, linewidth=0, label=f"error of {label}")
    ax.plot(b, y, color=colour, linewidth=0.5, marker="o" if len(b) < _FEW else "", markersize=3, label=label)


def _mark_doublings(doublings: xr.Dataset, ax: Axes) -> None:
    """A line at every doubling within the axes, labelled while there is room before it, then one label for the rest."""
    low, high = sorted(ax.get_xlim())
    b, n = doublings["b"].to_numpy(), doublings["period"].to_numpy()
    inside = (low <= b) & (b <= high)
    b, n = b[inside], n[inside]
    narrow = np.flatnonzero(np.abs(np.diff(b)) < 0.035 * (high - low))
    alone = int(narrow[0]) + 1 if len(narrow) else len(b)
    back = 1 if len(b) > 1 and b[-1] < b[0] else -1  # where the cascade comes from
    labels = [(b[k], back, f"{n[k]} → {2 * n[k]}") for k in range(alone)]
    if alone < len(b):
        more = "… " if alone + 1 < len(b) else ""
        labels.append((b[-1], -back, f"{more}{n[-1]} → {2 * n[-1]}"))
    bottom, top = ax.get_ylim()
    ax.set_ylim(bottom - 0.05 * (top - bottom), top)  # a strip for the labels
    for x in b:
        ax.axvline(x, color=_MARK, linewidth=0.8, linestyle=(0, (4, 3)))
    for x, side, label in labels:
        ax.annotate(
            label,
            (x, 0.01),
            (3 * side, 0),
            xycoords=ax.get_xaxis_transform(),
            textcoords="offset points",
            ha="left" if side > 0 else "right",
            color=_MARK,
            fontsize=8,
        )
    mark = Line2D([], [], color=_MARK, linewidth=0.8, linestyle=(0, (4, 3)), label="doubling of the period")
    ax.legend(handles=[mark], loc="upper right", fontsize=8, framealpha=0.9)


def _key_to_colours(image: ColorizingArtist, ax: Axes) -> None:
    """A small colour bar above the axes, which keeps their width."""
    bar = ax.figure.colorbar(image, cax=ax.inset_axes((0.7, 1.03, 0.3, 0.025)), orientation="horizontal")
    bar.ax.xaxis.set_ticks_position("top")
    bar.ax.tick_params(labelsize=7, pad=1)
    label = "share of the strobe points of a column"
    ax.annotate(label, (0.69, 1.04), xycoords="axes fraction", ha="right", va="center", fontsize=8)
