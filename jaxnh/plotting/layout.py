"""Panels of a result into one figure: rows, a title above, and lines below."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxnh.plotting.style import NARROW, PAGE, Size

_TITLE = 0.35  # inches
_LETTER = 0.0445  # of a small letter, as those below a figure


class Panel(NamedTuple):
    """A panel: `draw(ax)`, its height in inches on a whole page, and whether it takes the whole width."""

    draw: Callable[[Axes], object]
    height: float
    wide: bool


def lay_out(panels: Sequence[Panel], title: str, lines: Sequence[str], size: Size = PAGE) -> Figure:
    """Wide panels a row each, others two a row; the title above, and the lines below in small letters."""
    single = size.width < NARROW
    below = [part for line in lines for part in textwrap.wrap(line, int(size.width / _LETTER))]
    rows: list[list[Panel]] = []
    for panel in panels:
        if panel.wide or single or not rows or rows[-1][0].wide or len(rows[-1]) == 2:
            rows.append([])
        rows[-1].append(panel)
    shrunk = math.sqrt(size.width / PAGE.width)  # a narrow panel is not as flat as a wide one
    heights = [shrunk * max(panel.height for panel in row) for row in rows]
    drawing = Figure(figsize=(size.width, size.height or sum(heights) + _TITLE * (1 + 0.25 * len(below))))
    grid = drawing.add_gridspec(len(rows), 1 if single else 2, height_ratios=heights)
    for i, row in enumerate(rows):
        for j, panel in enumerate(row):
            panel.draw(drawing.add_subplot(grid[i, :] if panel.wide else grid[i, j]))
    drawing.suptitle(title)
    if below:
        drawing.supxlabel("\n".join(below), fontsize="x-small", color="gray")
    return drawing
