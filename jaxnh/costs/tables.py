"""Tables of what things cost, from the datasets of the other modules here."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

from jaxnh.analyses.base import Table


def solvers(data: xr.Dataset) -> Table:
    """A row a setting; the one that the engine uses is marked."""
    columns = _columns(data)
    rows = []
    for i, name in enumerate(columns["method"]):
        adaptive, picked = columns["steps"][i] == 0, bool(columns["picked"][i])
        rows.append(
            (
                f"{name}, comp." if columns["summation"][i] == "compensated" else str(name),
                f"tol {columns['tolerance'][i]:.0e}" if adaptive else str(columns["steps"][i]),
                "–" if adaptive else f"{columns['forces'][i]:.0f}",
                f"{columns['error'][i]:.1e}",
                f"{1e6 * columns['seconds'][i]:.2f}",
                _duration(columns["projected_seconds"][i]),
                "◀" if picked else "",
            )
        )
    work = data.attrs["projected_lane_periods"]
    return Table(
        "Error of one period, and its price",
        ("solver", "steps", "forces", "error", "µs", "whole run", ""),
        tuple(rows),
        f"µs a lane-period, of which the run has {work:,.0f}; comp.: compensated sums; ◀ picked",
        left=(0,),
        ruled=False,
        bold=int(np.argmax(columns["picked"])),
    )


def forms(data: xr.Dataset) -> Table:
    """A row a form of a step; that of the sweep is marked."""
    columns = _columns(data)
    rows = [
        (
            str(stages),
            f"{columns['compiling'][i]:.1f} s",
            *(_duration(columns["compiling"][i] + seconds) for seconds in columns["run"][i]),
            "◀" if columns["picked"][i] else "",
        )
        for i, stages in enumerate(columns["stages"])
    ]
    heads = [f"{count:,} lane{'s' if count > 1 else ''}" for count in columns["lanes"].tolist()]
    return Table(
        "Stages of a step in a loop, or written out",
        ("stages", "compiling", *heads, ""),
        tuple(rows),
        "from command to result with nothing kept, calibration left out; ◀ the form of this sweep",
        left=(0,),
        ruled=False,
        bold=int(np.argmax(columns["picked"])),
    )


def doubling(data: xr.Dataset) -> Table:
    """A row an estimate of the doubling point."""
    columns = _columns(data)
    name, n, reference = data.attrs["along"], int(data["period"]), float(data["reference"])
    rows = [
        (
            str(method),
            f"{columns['effort'][i]:,}",
            f"{columns['value'][i]:.12f}",
            f"{columns['error'][i]:.1e}",
            f"{columns['cpu_seconds'][i]:.3f}",
        )
        for i, method in enumerate(columns["method"])
    ]
    return Table(
        f"Price of the doubling {n} → {2 * n}",
        ("method", "after", name, f"|{name} − {name}*|", "seconds"),
        tuple(rows),
        f"processor time; {name}* = {reference:.13f}",
        left=(0,),
        ruled=False,
    )


def exponent(data: xr.Dataset) -> Table:
    """A row an averaging time."""
    columns, name = _columns(data), data.attrs["along"]
    rows = [
        (
            f"{periods:,}",
            f"{columns['error'][i, 1]:.1e}",
            f"{columns['error_bar'][i, 1]:.1e}",
            f"{columns['cpu_seconds'][i]:.4f}",
        )
        for i, periods in enumerate(columns["averaging_periods"])
    ]
    return Table(
        f"Price of λ₁ = {float(data['reference']):.4f} at {name} = {float(data['value']):.6g}",
        ("periods averaged", "error", "error bar", "seconds"),
        tuple(rows),
        f"medians of {int(data['lanes'])} lanes; processor time a value of {name}",
        ruled=False,
    )


def effects(data: xr.Dataset) -> Table:
    """A row an effect, a number of tangents or an analysis."""
    columns = _columns(data)
    kinds = columns["kind"]
    rows = []
    for i, what in enumerate(columns["what"]):
        cells = (columns["operations"][i], columns["operations_without"][i], columns["time_ratio"][i])
        words = [
            "–" if math.isnan(x) else form.format(x)
            for x, form in zip(cells, ("{:,.0f}", "{:,.0f}", "{:.2f}"), strict=True)
        ]
        stored = f"{columns['stored'][i]:,.0f}" if kinds[i] == "analysis" else ""
        rows.append((str(what), *words, stored, str(columns["note"][i])))
    return Table(
        "What each effect and analysis costs",
        ("", "with it", "without", "time", "bytes a lane", ""),
        tuple(rows),
        f"operations a lane-period by {data.attrs['solver']}; time: of processors, with it over without it",
        left=(0, 5),
        ruled=False,
        breaks=tuple(i for i in range(1, len(rows)) if kinds[i] != kinds[i - 1]),
    )


def _columns(data: xr.Dataset) -> dict[str, np.ndarray]:
    return {str(name): variable.to_numpy() for name, variable in data.variables.items()}


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.1f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
