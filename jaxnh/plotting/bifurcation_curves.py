"""Curves of bifurcations and of homoclinic orbits over two parameters, with their points of codimension two named."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from jaxnh.plotting.frame import narrow, new_axes
from jaxnh.plotting.groups import require_variables, variables_of
from jaxnh.plotting.labels import axis_label
from jaxnh.plotting.meanings import meanings
from jaxnh.plotting.style import CURVES

_DASHES = ("-", (0, (4, 2)), (0, (1, 1.5)), (0, (4, 1, 1, 1)))
_EDGE = [withStroke(linewidth=2.0, foreground="white")]  # names stand on whatever colour a chart has
SHORT_NAMES = {
    "cusp": "CP",
    "generalised doubling": "GPD",
    "chenciner": "CH",
    "fold flip": "LPPD",
    "resonance 1 1": "R1",
    "resonance 1 2": "R2",
    "resonance 1 3": "R3",
    "resonance 1 4": "R4",
    "bogdanov takens": "BT",
    "generalised hopf": "GH",
    "zero hopf": "ZH",
    "double hopf": "HH",
    "neutral saddle": "NSS",
    "neutral saddle focus": "NSF",
    "neutral bi focus": "NFF",
    "double real stable": "DRS",
    "double real unstable": "DRU",
    "three leading stable": "TLS",
    "three leading unstable": "TLU",
    "neutrally divergent stable": "NDS",
    "neutrally divergent unstable": "NDU",
    "orbit flip stable": "OFS",
    "orbit flip unstable": "OFU",
    "inclination flip stable": "IFS",
    "inclination flip unstable": "IFU",
}
"""Short names of points of codimension two."""


def bifurcation_curves(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Both parameters of all curves: a colour a kind, a dash a period; points of codimension two are dots with names.

    Args:
        data: two parameters (curve, point), `kind` and, of cycles, `period` of each curve, and those of points
            `codimension_two`.

    Raises:
        ResultError: a variable is missing.
    """
    ax = new_axes(ax)
    across, up = variables_of(data)[:2]
    draw_curves(data, ax)
    x, y = across.to_numpy(), up.to_numpy()
    for values, limits in ((x, ax.set_xlim), (y, ax.set_ylim)):
        if np.isfinite(values).any():
            limits(np.nanmin(values), np.nanmax(values))
    ax.set(xlabel=axis_label(across), ylabel=axis_label(up))
    return ax


def draw_curves(data: xr.Dataset, ax: Axes, background: bool = False) -> None:
    """The curves alone, on axes that are there: over a chart (`background`) each has a white edge.

    Raises:
        ResultError: a variable is missing.
    """
    across, up = variables_of(data)[:2]
    [kind] = require_variables(data, "kind")
    period = data["period"].to_numpy() if "period" in data else np.zeros(data.sizes["curve"], int)  # of cycles alone
    named = meanings(kind)
    order, periods = list(named), np.unique(period).tolist()
    seen: set[tuple[int, int]] = set()
    for k in range(data.sizes["curve"]):
        what, n = int(kind[k]), int(period[k])
        of_orbits = (f", period {n}" if n else ", equilibria") if "period" in data else ""
        words = f"{named[what][0]}{of_orbits}" if (what, n) not in seen else None
        seen.add((what, n))
        x, y = across.isel(curve=k).to_numpy(), up.isel(curve=k).to_numpy()
        dash = _DASHES[periods.index(n) % len(_DASHES)]
        if background:
            ax.plot(x, y, color="white", linewidth=2.2)
        ax.plot(x, y, color=CURVES[order.index(what) % len(CURVES)], linestyle=dash, linewidth=1.1, label=words)
    x, y, what = require_variables(data, *(f"codimension_two_{name}" for name in (across.name, up.name, "kind")))
    _dots(x, y, what, ax)
    if seen:
        columns = 1 if narrow(ax) else min(3, len(seen))
        ax.legend(fontsize=7, frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns)


def special_points(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Points of codimension two alone, as dots with short names over both parameters.

    Raises:
        ResultError: a variable is missing.
    """
    ax = new_axes(ax)
    across, up = variables_of(data)[:2]
    _dots(across, up, require_variables(data, "kind")[0], ax)
    ax.set(xlabel=axis_label(across), ylabel=axis_label(up))
    return ax


def _dots(x: xr.DataArray, y: xr.DataArray, kind: xr.DataArray, ax: Axes) -> None:
    words = {value: name for value, (name, _) in meanings(kind).items()}
    for across, up, what in zip(x.to_numpy(), y.to_numpy(), kind.to_numpy(), strict=True):
        ax.plot(across, up, "o", color="black", markerfacecolor="white", markersize=4, zorder=5)
        label = SHORT_NAMES.get(words[int(what)], words[int(what)])
        ax.annotate(label, (across, up), (4, 4), textcoords="offset points", fontsize=7, zorder=5, path_effects=_EDGE)
