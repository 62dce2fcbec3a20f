"""A result as a figure of Bokeh, for a notebook or a web page."""

from __future__ import annotations

from dataclasses import replace

import xarray as xr
from bokeh.plotting import figure

from jaxnh.exceptions import InputError, ResultError
from jaxnh.explorer.figures import Drawing
from jaxnh.explorer.overlay_figure import LayerDrawing
from jaxnh.explorer.overlays import layers_of
from jaxnh.explorer.recording import source_of


def bokeh_figure(result: xr.DataTree, quantity: str | None = None) -> figure:
    """Return the first view of a result in the explorer: a plane over its first two axes, or the diagram over the
    first, with curves, branches and other layers of the result over it.

    Args:
        result: of `open_result` or `run`.
        quantity: of planes the group, of a diagram the coordinate; None, or "diagram" of a diagram: the first.

    Raises:
        InputError: that is no result.
        ResultError: there is no plane, diagram, curve or branch, or not this quantity.
    """
    if not isinstance(result, xr.DataTree):
        raise InputError(f"a figure is of a result, as of open_result, not {type(result).__name__}")
    source = source_of(result, str(result.attrs.get("title") or "the result"))
    first = quantity is None or (quantity == "diagram" and not source.first.second)
    view = source.first if first else replace(source.first, variable=quantity)
    if view.variable not in source.variables:
        raise ResultError(f"there is no {view.variable} to be drawn; there are {', '.join(source.variables)}")
    upward = source.axis_words[view.second] if view.second else source.variables[view.variable]
    drawing = Drawing(view, source.axis_words[view.axis], upward)
    *_, picture = source.passes(view)
    drawing.show(view, picture)
    laid = LayerDrawing(drawing.figure, (), edged=bool(view.second))
    laid.show(layers_of(source.overlays, view.axis, view.second or view.variable))
    laid.fit(drawing.scale)
    return drawing.figure
