"""The one style of all pictures: the package's style sheet, its colours, and the widths of a journal's page."""

from __future__ import annotations

import warnings
from contextlib import AbstractContextManager
from pathlib import Path
from typing import NamedTuple

from matplotlib import style
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from jaxnh.exceptions import ArgumentError

SHEET = Path(__file__).with_name("jaxnh.mplstyle")
"""The style sheet."""

Colour = str | tuple[float, float, float] | tuple[float, float, float, float]
"""A colour of matplotlib: a name, or its components."""

BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK, YELLOW = (
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#F0E442",
)  # fmt: skip
CURVES = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK, YELLOW)
"""Colours of what has no meaning of its own, in their order: Okabe and Ito's, which the colour-blind tell apart."""

LINE, POINT, MARK = "#8DA0B3", VERMILION, GREEN
"""Colours of a trajectory, of points, and of what marks a place."""

MANY = ("#332288", "#88CCEE", "#44AA99", "#117733", "#999933", "#DDCC77", "#CC6677", "#882255", "#AA4499", "#661100")
"""Ten colours for what has more kinds: Paul Tol's muted ones (Colour Schemes, SRON/EPS/TN/09-002, 2021)."""

TINTS = ("#77AADD", "#EE8866", "#EEDD88", "#FFAABB", "#99DDFF", "#44BB99", "#BBCC33", "#AAAA00", "#CBB8DE", "#CDB5A2")
"""Ten for areas: the first eight are Paul Tol's light ones."""

_DARKER = 0.45
_MM = 25.4  # an inch
_LONGEST = 100.0  # inches


class Size(NamedTuple):
    """Width of a figure in inches, and its height; None: as its panels need."""

    width: float
    height: float | None = None


COLUMN, PAGE = Size(86 / _MM), Size(7.0)
"""Widths of one column and of both, as most journals of physics have them."""

NARROW = 0.5 * (COLUMN.width + PAGE.width)
"""Width in inches below which a figure is a column: one panel a row, short labels, legends of two columns."""


def size_of(text: str) -> Size:
    """A size by its name, "column" or "page", or in millimetres, "120" or "120x80".

    Raises:
        ArgumentError: it is none.
    """
    named = {"column": COLUMN, "page": PAGE}
    if text in named:
        return named[text]
    width, cross, height = text.partition("x")
    try:
        size = Size(float(width) / _MM, float(height) / _MM if cross else None)
    except ValueError:
        size = Size(0.0)
    if not all(0 < length < _LONGEST for length in size if length is not None):
        raise ArgumentError("size", f"it is column, page, or millimetres as 120 or 120x80, not {text}")
    return size


def darker(colour: str) -> Colour:
    """A darker colour, for lines on an area of this one."""
    red, green, blue = to_rgb(colour)
    return _DARKER * red, _DARKER * green, _DARKER * blue


def package_style() -> AbstractContextManager[None]:
    """Use the style of the package inside."""
    return style.context(["default", SHEET])


def save(figure: Figure, path: Path) -> None:
    """Write a figure in the style of the package, in the format of the name's suffix.

    Raises:
        ArgumentError: there is no room for its panels.
    """
    with package_style(), warnings.catch_warnings():
        warnings.filterwarnings("error", message="constrained_layout not applied")
        try:
            figure.savefig(path)
        except UserWarning:
            path.unlink(missing_ok=True)
            raise ArgumentError("size", "the panels do not fit into it; give more, or leave a height out") from None
