"""A view: ranges of one axis or two, the quantity drawn over them, and the history of views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from jaxnh.exceptions import InputError

COLUMNS = 1000
"""Values of the axis in a picture."""

_MOVES = {"ArrowLeft": (-1, 0), "ArrowRight": (1, 0), "ArrowDown": (0, -1), "ArrowUp": (0, 1)}
_ZOOMS = {"+": 0.5, "=": 0.5, "-": 2.0}
_WORDS = ("low", "high", "bottom", "top")


@dataclass(frozen=True)
class View:
    """A bifurcation diagram, or a plane of two axes, in given ranges.

    Attributes:
        axis: parameter, or coordinate of the start state, across.
        low, high: its range, both ends are lanes.
        variable: what is drawn: of a diagram the coordinate of the states, upward, of a plane a quantity, as colours.
        window: range upward: of a plane that of its second axis, both ends are lanes; of a diagram that of the
            variable, None for all values there are.
        second: of a plane, the axis upward; "": a diagram.
        transient: periods before the first strobe, of a diagram.
        strobes: strobes a value, of a diagram.
        fixed: values of other parameters in place of those of the config.
        target: error of one period that is allowed; None: what the config says.
        columns: values of the axis.
        rows: values of the second axis.
    """

    axis: str
    low: float
    high: float
    variable: str
    window: tuple[float, float] | None = None
    second: str = ""
    transient: int = 512
    strobes: int = 128
    fixed: Mapping[str, float] = field(default_factory=dict[str, float])
    target: float | None = None
    columns: int = COLUMNS
    rows: int = 1

    def __post_init__(self) -> None:
        if not (np.isfinite(self.low) and np.isfinite(self.high) and self.low < self.high):
            raise InputError(f"a range of {self.axis} goes from a number up to a larger one")
        if self.window is not None and not (np.isfinite(self.window).all() and self.window[0] < self.window[1]):
            raise InputError(f"a range of {self.second or self.variable} goes from a number up to a larger one")
        if self.second and self.window is None:
            raise InputError(f"a plane needs a range of {self.second}")

    @property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        """Both ends of every axis, by name."""
        ranges = {self.axis: (self.low, self.high)}
        return ranges | {self.second: self.window} if self.second and self.window else ranges

    def values(self) -> Float[np.ndarray, " columns"]:
        """Values of the axis, as a config of `start`, `stop` and `count` has them."""
        return np.linspace(self.low, self.high, self.columns)

    @property
    def counts(self) -> Mapping[str, int]:
        """Number of values of every axis, by name."""
        return {self.axis: self.columns} | ({self.second: self.rows} if self.second else {})

    def grid(self) -> dict[str, Float[np.ndarray, " values"]]:
        """Values of every axis, by name."""
        return {name: np.linspace(*ends, self.counts[name]) for name, ends in self.ranges.items()}

    def zoom(self, low: float, high: float, window: tuple[float, float] | None) -> View:
        """The view of other ranges; where these have too few doubles for its lanes, of the narrowest that fit."""
        low, high = _wide(low, high, self.columns)
        if self.second:
            window = _wide(*(window or self.ranges[self.second]), self.rows)
        elif window is not None:
            bottom, top = min(window), max(window)
            least = 1e3 * float(np.spacing(max(abs(bottom), abs(top))))
            window = (bottom, max(top, bottom + least))
        return replace(self, low=low, high=high, window=window)

    def by_key(self, key: str, whole: View, shown: tuple[float, float] | None) -> View:
        """The view after a key: an arrow moves it by a fifth, + and - zoom about its middle, within the whole range.

        Args:
            key: as a browser names it.
            whole: whose ranges no key leaves.
            shown: range upward that a diagram of all values has.
        """
        step, factor = _MOVES.get(key, (0, 0)), _ZOOMS.get(key, 1.0)
        across = _moved((self.low, self.high), step[0], factor, (whole.low, whole.high))
        upward = self.window or shown
        if upward is None or (self.window is None and not step[1]):
            return self.zoom(*across, self.window)
        return self.zoom(*across, _moved(upward, step[1], factor, whole.window))

    @property
    def deepest(self) -> bool:
        """Return whether a narrower range of an axis has fewer doubles than lanes."""
        return any(
            high - low < 2 * self.counts[name] * float(np.spacing(max(abs(low), abs(high))))
            for name, (low, high) in self.ranges.items()
        )

    def lane_at(self, across: float, up: float) -> dict[str, float]:
        """Values of the axes, by name, of the lane whose column or pixel a place lies in."""
        places = {self.axis: across, self.second: up}
        return {name: float(values[np.argmin(np.abs(values - places[name]))]) for name, values in self.grid().items()}


def _moved(
    ends: tuple[float, float], step: int, factor: float, whole: tuple[float, float] | None
) -> tuple[float, float]:
    """A range moved by fifths of itself and scaled about its middle; inside the whole one it does not leave that."""
    low, high = ends
    middle, half = 0.5 * (low + high) + step * (high - low) / 5, 0.5 * factor * (high - low)
    if whole is not None and whole[0] <= low and high <= whole[1]:
        half = min(half, 0.5 * (whole[1] - whole[0]))
        middle = min(max(middle, whole[0] + half), whole[1] - half)
        return max(whole[0], middle - half), min(whole[1], middle + half)
    return middle - half, middle + half


def _wide(low: float, high: float, count: int) -> tuple[float, float]:
    """The smallest range around this one that has so many different doubles."""
    low, high = min(low, high), max(low, high)
    narrowest = count * float(np.spacing(max(abs(low), abs(high))))
    if high - low < narrowest:
        middle = 0.5 * (low + high)
        return middle - 0.5 * narrowest, middle + 0.5 * narrowest
    return low, high


@dataclass
class History:
    """Views in the order of their visits; a new one drops those after the present one.

    Attributes:
        views: all of them.
        place: number of the present one.
    """

    views: list[View]
    place: int = 0

    @property
    def now(self) -> View:
        """The present view."""
        return self.views[self.place]

    def go(self, view: View) -> bool:
        """Go to a view; returns whether it is another one."""
        if view == self.now:
            return False
        self.views[self.place + 1 :] = [view]
        self.place += 1
        return True

    def move(self, steps: int) -> View:
        """Go back (-1) or forward (1), as far as there are views."""
        self.place = min(max(self.place + steps, 0), len(self.views) - 1)
        return self.now


# ---- as text of an address


def as_query(view: View) -> dict[str, str]:
    """A view as words of a page's address; floats to the last bit."""
    words = {"axis": view.axis, "low": repr(view.low), "high": repr(view.high), "variable": view.variable}
    if view.window is not None:
        words |= {"bottom": repr(view.window[0]), "top": repr(view.window[1])}
    if view.second:
        words["second"] = view.second
    else:
        words |= {"transient": str(view.transient), "strobes": str(view.strobes)}
    if view.target is not None:
        words["target"] = repr(view.target)
    return words | {f"p.{name}": repr(value) for name, value in sorted(view.fixed.items())}


def from_query(start: View, query: Mapping[str, str]) -> View:
    """The view that an address names; what it leaves out is as in the first view.

    Raises:
        InputError: it names none.
    """
    try:
        numbers = {word: float(query[word]) for word in _WORDS if word in query}
        window = (numbers["bottom"], numbers["top"]) if {"bottom", "top"} <= set(numbers) else start.window
        return replace(
            start,
            axis=query.get("axis", start.axis),
            low=numbers.get("low", start.low),
            high=numbers.get("high", start.high),
            variable=query.get("variable", start.variable),
            window=window,
            second=query.get("second", start.second),
            transient=max(1, int(query.get("transient", start.transient))),
            strobes=min(max(1, int(query.get("strobes", start.strobes))), 1 << 14),
            target=float(query["target"]) if "target" in query else start.target,
            fixed={word[2:]: float(value) for word, value in query.items() if word.startswith("p.")},
        )
    except ValueError:
        raise InputError("the address of this page names no view; the first one is shown") from None
