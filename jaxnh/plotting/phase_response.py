"""Panels of the phase response of one lane's limit cycle."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from jaxnh.plotting.frame import new_axes
from jaxnh.plotting.groups import axes_of, lane_of, variables_of
from jaxnh.plotting.labels import axis_label, symbol_of, title_of
from jaxnh.plotting.style import CURVES

_QUARTERS = ("0", "π/2", "π", "3π/2", "2π")


def phase_responses(data: xr.Dataset, ax: Axes | None = None, *, lane: int = 0) -> Axes:
    """Derivatives of the phase in all coordinates over the phase, with bands of their errors, of one lane.

    Args:
        data: variables `NAME_response` (axes, phase), and their errors.
        lane: its number in C order of the axes.

    Raises:
        ResultError: a variable is missing.
    """
    ax = new_axes(ax)
    of_lane = lane_of(data, lane)
    phase = of_lane["phase"].to_numpy()
    ax.axhline(0.0, color="black", linewidth=0.6)
    for k, curve in enumerate(variables_of(of_lane)):
        y, colour = curve.to_numpy(), CURVES[k % len(CURVES)]
        label = symbol_of(str(curve.name).removesuffix("_response"))
        around = np.append(phase, 2 * np.pi), np.append(y, y[:1])
        ax.plot(*around, color=colour, linewidth=0.8, label=label)
        if (error := of_lane.get(f"{curve.name}_error")) is not None:
            ax.fill_between(phase, y - error, y + error, color=colour, alpha=0.4, linewidth=0)
    ax.set_xticks(0.5 * np.pi * np.arange(5), _QUARTERS)
    label = "derivative of the phase (rad a unit)"
    ax.set(xlabel=axis_label(data["phase"]), ylabel=label, xlim=(0.0, 2 * np.pi))
    ax.set_title(title_of(of_lane, axes_of(data)), loc="left")
    ax.legend(loc="best")
    return ax
