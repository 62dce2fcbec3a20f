"""Panels of a result into one figure: rows, a title above, and lines below."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxnh.plotting.frame import WIDTH


class Panel(NamedTuple):
    """A drawing of its own axes: `draw(ax)`, its height in inches, and whether it takes the whole width."""

    draw: Callable[[Axes], object]
    height: float
    wide: bool


def laid_out(panels: Sequence[Panel], title: str, lines: Sequence[str]) -> Figure:
    """Wide panels a row each, others two a row; the title above, and the lines below in small letters."""
    rows: list[list[Panel]] = []
    for panel in panels:
        if panel.wide or not rows or rows[-1][0].wide or len(rows[-1]) == 2:
            rows.append([])
        rows[-1].append(panel)
    heights = [max(panel.height for panel in row) for row in rows]
    drawing = Figure(figsize=(WIDTH, sum(heights) + 0.8), layout="constrained")
    grid = drawing.add_gridspec(len(rows), 2, height_ratios=heights)
    for i, row in enumerate(rows):
        for j, panel in enumerate(row):
            panel.draw(drawing.add_subplot(grid[i, :] if panel.wide else grid[i, j]))
    drawing.suptitle(title)
    if lines:
        drawing.supxlabel("\n".join(lines), fontsize=7, color="gray")
    return drawing
