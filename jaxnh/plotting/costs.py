"""Pictures of the cost of accuracy: files of `jaxnh.cost`, read by xarray, on matplotlib axes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from jaxnh.plotting.groups import declared_axes
from jaxnh.plotting.labels import symbol_of, with_units
from jaxnh.plotting.reading import load_result
from jaxnh.plotting.style import BLUE, GREEN, ORANGE, PAGE, PURPLE, SKY, VERMILION, YELLOW, package_style

_SIZE = (PAGE.width, 4.2)  # inches
_MICRO = 1e6
_SPLITTINGS = {
    "strang2": "#DDCC77",
    "blanes_moan4": ORANGE,
    "blanes_moan6": VERMILION,
    "processed6": PURPLE,
    "kahan_li8": "#882255",
    "sofroniou_spaletta10": "#332288",
}
_WRITTEN_OUT = {
    "tsit5": SKY,
    "dopri5": "#44AA99",
    "dopri8": GREEN,
    "tsitouras_papakostas8": BLUE,
    "verner9": "#999933",
    "nystrom8": VERMILION,
}
_STOCK = {"diffrax Tsit5": "#9a9a9a", "diffrax Dopri8": "#303030"}
_COLOURS = {**_SPLITTINGS, **_WRITTEN_OUT, **_STOCK}
_OTHER = "#661100"
_METHODS = {
    "period detection": (VERMILION, "o", "detection of the period after $N$ periods"),
    "multisection": (BLUE, "s", "multisection on the orbit's multiplier"),
    "interpolation": (GREEN, "D", "interpolation of det(M + 1) in {}"),
}
_SIXTH_DECIMAL = 5e-7


def work_precision(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Error of one period against time per lane-period: a curve a solver, the target, and the engine's pick."""
    ax = _axes(ax)
    method, summation = data["method"].to_numpy().astype(str), data["summation"].to_numpy().astype(str)
    seconds = _MICRO * np.stack([data[name].to_numpy() for name in ("seconds_least", "seconds", "seconds_largest")])
    error = data["error"].to_numpy()
    for name in dict.fromkeys(method):
        for sums in ("plain", "compensated"):
            chosen = (method == name) & (summation == sums)
            if chosen.any():
                _curve(ax, name, sums, seconds[:, chosen], error[chosen])
    target = float(data.attrs["target"])
    ax.axhline(target, color="black", linewidth=0.9, linestyle=(0, (6, 3)), label=f"target {target:.1g}")
    picked = np.flatnonzero(data["picked"].to_numpy())[0]
    label = f"picked: {method[picked]}, {int(data['steps'][picked])} steps"
    ax.plot(seconds[1, picked], error[picked], "*", color=YELLOW, markeredgecolor="black", markersize=12, zorder=5,
            linestyle="", label=label)  # fmt: skip
    ax.set(xscale="log", yscale="log")
    ax.grid(which="major")
    ax.set(xlabel="time per lane-period $τ$ (µs)", ylabel="error of one period's map $ε$")
    ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return ax


def doubling(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Error of a doubling point against processor time, by period detection, multisection and interpolation."""
    ax = _axes(ax)
    symbol = _parameter(data)
    located = f"{symbol[:-1]}^*$"
    method, effort = data["method"].to_numpy().astype(str), data["effort"].to_numpy()
    cpu, error = data["cpu_seconds"].to_numpy(), data["error"].to_numpy()
    smallest = np.min(error[error > 0], initial=1e-10) / 2
    for name, (colour, marker, label) in _METHODS.items():
        chosen = method == name
        shown = np.maximum(error[chosen], smallest)
        ax.plot(cpu[chosen], shown, color=colour, marker=marker, markersize=3.5, label=label.format(symbol))
    for x, y, transient in zip(*(leaf[method == "period detection"] for leaf in (cpu, error, effort)), strict=True):
        ax.annotate(f"$N$ = {transient:,}", (x, y), (6, 5), textcoords="offset points", fontsize="small")
    ax.axhline(_SIXTH_DECIMAL, color="0.5", linewidth=0.9, linestyle=(0, (6, 3)))
    ax.annotate("half of the sixth decimal", (0.99, _SIXTH_DECIMAL), (0, 3), xycoords=ax.get_yaxis_transform(),
                textcoords="offset points", ha="right", color="0.4", fontsize="small")  # fmt: skip
    n = int(data["period"])
    ax.set(xscale="log", yscale="log")
    ax.grid(which="major")
    distance = with_units(f"error of the doubling point $|{symbol[1:-1]} - {located[1:-1]}|$", data["error"])
    ax.set(xlabel="processor time $t$ (s)", ylabel=distance)
    ax.set_title(f"period {n} → {2 * n} at {located} = {float(data['reference']):.12f}")
    ax.set_xlim(cpu.min() / 1.3, cpu.max() * 2.5)
    ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return ax


def exponent(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Error of the largest Lyapunov exponent, true and as the analysis has it, against the averaging time."""
    ax = _axes(ax)
    periods = data["averaging_periods"].to_numpy()
    longer, lanes = int(data.attrs["reference_periods"]), int(data["lanes"])
    shown = (
        ("error", VERMILION, "o", f"distance from the mean of {lanes} lanes over {longer:,} periods"),
        ("error_bar", BLUE, "s", "error bar that the analysis gives"),
    )
    for name, colour, marker, label in shown:
        low, middle, high = data[name].to_numpy().T
        ax.fill_between(periods, low, high, color=colour, alpha=0.18, linewidth=0)
        ax.plot(periods, middle, color=colour, marker=marker, markersize=3.5, label=label)
    guide = data["error"].to_numpy()[-1, 1] * np.sqrt(periods[-1] / periods)
    ax.plot(periods, guide, color="black", linewidth=0.9, linestyle=(0, (6, 3)), label="$∝ N^{-1/2}$")
    ax.set(xscale="log", yscale="log")
    ax.set_xticks(periods, [f"{n:,}" for n in periods])
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.grid(which="major")
    cpu = data["cpu_seconds"].to_numpy()
    each = (cpu[-1] - cpu[0]) / (periods[-1] - periods[0])
    above = ax.secondary_xaxis("top", functions=(lambda n: n * each, lambda t: t / each))
    above.set_xlabel(f"processor time of the average at one {_parameter(data)} (s)")
    ax.set(
        xlabel=with_units("averaging time $N$", data["averaging_periods"]),
        ylabel=with_units("error of $λ_1$", data["error"]),
    )
    place = f"{_parameter(data)} = {float(data['value']):.6g}"
    title = f"{place}, $λ_1$ = {float(data['reference']):.4f}; median of {lanes} lanes, band: 10–90%"
    ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), alignment="left", title=title)
    return ax


DRAWINGS: Mapping[str, tuple[str, Callable[[xr.Dataset], Axes]]] = {
    "solvers": ("", work_precision),
    "doubling_cost": ("_doubling", doubling),
    "lyapunov_cost": ("_lyapunov", exponent),
}
"""Group of a file to what is added to the picture's name, and its drawing."""


def figures(path: Path) -> dict[str, Figure]:
    """Figures of the groups of a file of `jaxnh.cost`, by the suffix of the picture's name.

    Raises:
        ResultError: the file is damaged or none of ours.
    """
    tree = load_result(path)
    axes = {"axes": tree.attrs["axes"]} if "axes" in tree.attrs else {}
    drawn = {}
    with package_style():
        for name, (suffix, draw) in DRAWINGS.items():
            if name in tree.children:
                figure = draw(tree[name].to_dataset().assign_attrs(axes)).get_figure()
                assert isinstance(figure, Figure)
                figure.suptitle(tree.attrs["title"])
                made_by = f"jaxnh {tree.attrs['jaxnh_version']}, {tree.attrs['device']}"
                figure.supxlabel(made_by, fontsize="x-small", color="gray")
                drawn[suffix] = figure
    return drawn


def _parameter(data: xr.Dataset) -> str:
    """Symbol of the parameter that is swept: the first of the axes that the file names."""
    return symbol_of(next(iter(declared_axes(data)), "p"))


def _curve(ax: Axes, name: str, summation: str, seconds: np.ndarray, error: np.ndarray) -> None:
    """One solver: medians joined, thin lines from least to largest time; seconds (3, rows), error (rows,)."""
    plain, base = summation == "plain", name.removesuffix(" adaptive")
    line = "-" if plain and base == name else ":" if plain else (0, (4, 2))
    marker = "o" if base in _SPLITTINGS else "s" if base in _WRITTEN_OUT else "^"
    colour = _COLOURS.get(base, _OTHER)
    ax.hlines(error, seconds[0], seconds[2], color=colour, linewidth=0.7, alpha=0.6)
    ax.plot(seconds[1], error, color=colour, marker=marker, markersize=3, linewidth=1.0, linestyle=line,
            markerfacecolor=colour if plain and base == name else "white",
            label=name if plain else f"{name}, compensated")  # fmt: skip


def _axes(ax: Axes | None) -> Axes:
    return Figure(figsize=_SIZE, layout="constrained").subplots() if ax is None else ax
