"""Controls of the page: ranges, quantity, parameters, depth and accuracy of a view."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import panel as pn

from jaxnh.explorer.source import PictureSource
from jaxnh.explorer.view import View

_STROBES = (64, 128, 256, 512, 1024, 2048)
_TRANSIENTS = (64, 256, 512, 1024, 4096, 16384)
_TARGETS = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
_WIDTH = 220


class Controls:
    """Widgets that say what is seen; set to a view, or moved by hand."""

    def __init__(self, source: PictureSource, view: View, changed: Callable[[], None]) -> None:
        """Make the widgets of a source.

        Args:
            view: the first one.
            changed: called where one is moved by hand.
        """
        self._source, self._changed = source, changed
        self._setting = False  # whether they are being set to a view, and not moved by hand
        self._low = pn.widgets.TextInput(name=f"{view.axis} from", width=_WIDTH)
        self._high = pn.widgets.TextInput(name="to", width=_WIDTH)
        self._bottom = pn.widgets.TextInput(name=f"{view.second} from", width=_WIDTH)
        self._top = pn.widgets.TextInput(name="to", width=_WIDTH)
        self._variable = pn.widgets.Select(
            name="quantity" if view.second else "coordinate",
            options={words: name for name, words in source.variables.items()},
            width=_WIDTH,
        )
        self._transient = pn.widgets.Select(name="transient (periods)", width=_WIDTH)
        self._strobes = pn.widgets.Select(name="strobes a value", width=_WIDTH)
        self._target = pn.widgets.Select(name="error of one period", width=_WIDTH)
        self._sliders = {
            p.name: pn.widgets.EditableFloatSlider(
                name=p.words, value=p.value, start=p.low, end=p.high, step=(p.high - p.low) / 200, width=_WIDTH
            )
            for p in source.parameters
        }
        self.set(view)
        ends = (self._low, self._high, self._bottom, self._top)
        for control in (*ends, self._variable, self._transient, self._strobes, self._target):
            control.param.watch(self._moved, "value")
        for slider in self._sliders.values():
            slider.param.watch(self._moved, "value_throttled")

    @property
    def widgets(self) -> list[Any]:
        """The widgets that the source has a use for, from the top."""
        plane, computes = bool(self._source.first.second), self._source.computes
        ends = [self._low, self._high, *((self._bottom, self._top) if plane else ())]
        depth = [] if plane or not computes else [self._transient, self._strobes]
        return [self._variable, *ends, *self._sliders.values(), *depth, *([self._target] if computes else [])]

    def set(self, view: View) -> None:
        """Set all widgets to a view."""
        self._setting = True
        self._low.value, self._high.value = repr(view.low), repr(view.high)
        if view.second and view.window:
            self._bottom.value, self._top.value = map(repr, view.window)
        self._variable.value = view.variable
        for control, known, value in (
            (self._transient, _TRANSIENTS, view.transient),
            (self._strobes, _STROBES, view.strobes),
        ):
            control.options = sorted({*known, value})
            control.value = value
        targets = {f"{t:g}": t for t in sorted({*_TARGETS, *([view.target] if view.target else [])})}
        self._target.options = {"as the config says": 0.0, **targets}
        self._target.value = view.target or 0.0
        for p in self._source.parameters:
            value = view.fixed.get(p.name, p.value)
            slider = self._sliders[p.name]
            slider.start, slider.end = min(p.low, value), max(p.high, value)
            slider.value = value
        self._setting = False

    def view(self, now: View) -> View:
        """The view that the widgets say.

        Args:
            now: the present one.

        Raises:
            ValueError: an end is no number.
            InputError: a range is none.
        """
        moved = {
            p.name: float(self._sliders[p.name].value)
            for p in self._source.parameters
            if self._sliders[p.name].value != p.value
        }
        low, high = float(self._low.value), float(self._high.value)
        window = (float(self._bottom.value), float(self._top.value)) if now.second else None
        other = self._variable.value != now.variable or moved != dict(now.fixed)
        view = replace(
            now,
            variable=self._variable.value,
            window=None if other and not now.second else now.window,
            transient=self._transient.value,
            strobes=self._strobes.value,
            target=self._target.value or None,
            fixed=moved,
        )
        same = (low, high) == (now.low, now.high) and window in (None, now.window)
        return view if same else view.zoom(low, high, window)

    def _moved(self, _: Any) -> None:
        if not self._setting:
            self._changed()
