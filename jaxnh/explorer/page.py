"""The page of one tab: its figures and controls. Pictures are computed or read elsewhere (`source`)."""

from __future__ import annotations

import html
import io
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import panel as pn
from bokeh.document import Document
from bokeh.events import RangesUpdate, Tap
from bokeh.models import CustomJS

from jaxnh.exceptions import JaxnhError
from jaxnh.explorer.figures import Drawing, Portrait
from jaxnh.explorer.key import key_html
from jaxnh.explorer.page_style import CSS, LOST
from jaxnh.explorer.report import report_html
from jaxnh.explorer.source import LaneReport, Picture, PictureSource
from jaxnh.explorer.view import History, View, as_query, from_query
from jaxnh.explorer.worker import Request, Worker
from jaxnh.plotting.results import figure as drawn
from jaxnh.plotting.style import package_style

_STROBES = (64, 128, 256, 512, 1024, 2048)
_TRANSIENTS = (64, 256, 512, 1024, 4096, 16384)
_TARGETS = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
_SILENT = 0.4  # share of a pass between two words of progress
_QUICK = 1.5  # seconds that a picture may take without a word of what is being done


class Page:
    """One tab."""

    def __init__(self, source: PictureSource, worker: Worker, document: Document, query: Mapping[str, str]) -> None:
        """Nothing is asked for yet.

        Args:
            query: query of the address, which may name a view.
        """
        self._source, self._worker, self._document = source, worker, document
        self._wrong = ""
        try:
            first = from_query(source.first, query)
        except JaxnhError as error:
            first, self._wrong = source.first, str(error)
        known = first.ranges.keys() == source.first.ranges.keys() and first.variable in source.variables
        if not known or first.axis != source.first.axis:
            first = source.first
        self._history = History([first])
        self._picture: Picture | None = None
        self._setting = False  # whether controls are being set to a view, and not moved by hand
        self._drawing = Drawing(first, source.axis_words[first.axis], self._upward(first))
        self._portrait = Portrait()
        self._drawing.figure.on_event(RangesUpdate, self._ranged)
        self._drawing.figure.on_event(Tap, self._tapped)
        self._make_controls(first)
        document.js_on_event("connection_lost", CustomJS(code=LOST))

    def _upward(self, view: View) -> str:
        """The quantity that is drawn upward in a view, in words."""
        return self._source.axis_words[view.second] if view.second else self._source.variables[view.variable]

    # ---- layout

    def _make_controls(self, view: View) -> None:
        source = self._source
        self._back = pn.widgets.Button(name="◀ Back", width=90, on_click=lambda _: self._move(-1))
        self._forward = pn.widgets.Button(name="Forward ▶", width=90, on_click=lambda _: self._move(1))
        self._whole = pn.widgets.Button(name="Whole range", width=110, on_click=lambda _: self._go_whole())
        self._status = pn.pane.HTML("", stylesheets=[CSS], sizing_mode="stretch_width")
        self._notes = pn.pane.HTML("", stylesheets=[CSS], sizing_mode="stretch_width")
        self._lane = pn.pane.HTML(
            f"Click into the {'plane' if view.second else 'diagram'}: portrait, strobe points, period, spectrum and "
            "verdict of the lane there, as far as "
            f"{'they can be computed' if source.computes else 'the file has them'}.",
            stylesheets=[CSS],
            sizing_mode="stretch_width",
        )
        drawn_lane = pn.pane.Bokeh(self._portrait.figure, sizing_mode="stretch_width")
        self._portrait_pane = pn.Column(drawn_lane, sizing_mode="stretch_width", visible=False)
        self._low = pn.widgets.TextInput(name=f"{view.axis} from", width=190)
        self._high = pn.widgets.TextInput(name="to", width=190)
        self._bottom = pn.widgets.TextInput(name=f"{view.second} from", width=190)
        self._top = pn.widgets.TextInput(name="to", width=190)
        self._variable = pn.widgets.Select(
            name="quantity" if view.second else "coordinate",
            options={words: name for name, words in source.variables.items()},
            width=190,
        )
        self._transient = pn.widgets.Select(name="transient (periods)", width=190)
        self._strobes = pn.widgets.Select(name="strobes a value", width=190)
        self._target = pn.widgets.Select(name="error of one period", width=190)
        self._sliders = {
            p.name: pn.widgets.EditableFloatSlider(
                name=p.words, value=p.value, start=p.low, end=p.high, step=(p.high - p.low) / 200, width=210
            )
            for p in source.parameters
        }
        self._yaml = pn.widgets.FileDownload(
            callback=self._save_yaml, filename="view.yaml", label="Save as YAML", width=190, button_type="primary"
        )
        self._png = pn.widgets.FileDownload(
            callback=self._save_picture, filename="view.png", label="Save picture", width=190, button_type="primary"
        )
        self._key = pn.pane.HTML("", stylesheets=[CSS], sizing_mode="stretch_width")
        self._set_controls(view)
        ends = (self._low, self._high, self._bottom, self._top)
        for control in (*ends, self._variable, self._transient, self._strobes, self._target):
            control.param.watch(self._controlled, "value")
        for slider in self._sliders.values():
            slider.param.watch(self._controlled, "value_throttled")

    def layout(self) -> pn.viewable.Viewable:
        """The whole page."""
        plane, computes = bool(self._source.first.second), self._source.computes
        ends = [self._low, self._high, *((self._bottom, self._top) if plane else ())]
        depth = [] if plane or not computes else [self._transient, self._strobes]
        saves = [self._target, self._yaml, self._png] if computes else [self._png]
        side = pn.Column(self._variable, *ends, *self._sliders.values(), *depth, *saves, width=230)
        main = pn.Column(
            pn.pane.HTML(f"<h2 style='margin:4px 0'>{html.escape(self._source.title)}</h2>"),
            pn.Row(self._back, self._forward, self._whole, self._status),
            self._key,
            pn.pane.Bokeh(self._drawing.figure, sizing_mode="stretch_width"),
            self._notes,
            pn.Row(
                self._portrait_pane,
                self._lane,
                sizing_mode="stretch_width",
            ),
            sizing_mode="stretch_width",
        )
        return pn.Row(side, main, sizing_mode="stretch_width")

    def _set_controls(self, view: View) -> None:
        """Set all controls to a view."""
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
        self._target.options = {"as the config says": 0.0, **{f"{t:g}": t for t in _TARGETS}}
        self._target.value = view.target or 0.0
        for p in self._source.parameters:
            value = view.fixed.get(p.name, p.value)
            slider = self._sliders[p.name]
            slider.start, slider.end = min(p.low, value), max(p.high, value)
            slider.value = value
        self._back.disabled = self._history.place == 0
        self._forward.disabled = self._history.place == len(self._history.views) - 1
        self._setting = False

    # ---- what one does

    def begin(self) -> None:
        """Ask for the first view."""
        self._look()
        self._note(())

    def end(self) -> None:
        """The tab is closed."""
        for what in ("picture", "lane"):
            self._worker.drop((id(self), what))

    def _ranged(self, event: Any) -> None:
        now = self._history.now
        window: tuple[float, float] | None = (event.y0, event.y1)
        shown = self._picture.raster.up if self._picture else None
        if (
            shown is not None
            and now.window is None
            and max(abs(a - b) for a, b in zip(window, shown, strict=True)) < 1e-12 * (shown[1] - shown[0])
        ):
            window = None
        self._try(lambda: now.zoom(event.x0, event.x1, window))

    def _tapped(self, event: Any) -> None:
        if event.x is None:
            return
        view = self._history.now
        where = view.lane_at(event.x, event.y)
        self._drawing.mark(where)
        place = ", ".join(f"{html.escape(name)} = {value!r}" for name, value in where.items())
        self._lane.object = f"{place}: {'computing' if self._source.computes else 'reading'}…"
        self._ask("lane", self._source.lane(view, where), self._show_lane)

    def _controlled(self, _: Any) -> None:
        if self._setting:
            return

        def changed() -> View:
            now = self._history.now
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

        self._try(changed)

    def _try(self, change: Callable[[], View]) -> None:
        """Show another view, or say why there is none."""
        try:
            view = change()
        except (JaxnhError, ValueError) as error:
            self._say(str(error), error=True)
            return
        if self._history.go(view):
            self._look()

    def _move(self, steps: int) -> None:
        self._history.move(steps)
        self._look()

    def _go_whole(self) -> None:
        first = self._source.first
        self._try(lambda: replace(self._history.now, low=first.low, high=first.high, window=first.window))

    def _look(self) -> None:
        view = self._history.now
        self._set_controls(view)
        self._picture = None
        self._drawing.name(self._upward(view))
        self._say("computing…")
        if pn.state.location is not None:
            pn.state.location.search = "?" + "&".join(f"{key}={value}" for key, value in as_query(view).items())
        self._ask("picture", self._source.passes(view), lambda picture: self._show(view, picture))

    def _ask(self, what: str, passes: Any, answer: Callable[[Any], None]) -> None:
        """Request the passes of a view; answers are shown in the page's own thread."""
        said, answered = [-1.0, ""], [time.monotonic()]

        def told(label: str, share: float) -> None:
            quick = what == "picture" and time.monotonic() - answered[0] < _QUICK
            if not quick and (label != said[1] or share - float(said[0]) > _SILENT):
                said[:] = [share, label]
                known = f"{self._picture.words} · " if self._picture and what == "picture" else ""
                self._later(lambda: self._say(f"{known}{label}{f' · {share:.0%}' if share else ''}"))

        def answered_by(answer_of_pass: Any) -> None:
            answered[0] = time.monotonic()
            self._later(lambda: None if request.stale else answer(answer_of_pass))

        request = Request(
            passes,
            answer=answered_by,
            failed=lambda error: self._later(lambda: self._say(_sentence(error), error=True)),
            told=told,
        )
        self._worker.ask((id(self), what), request)

    def _later(self, action: Callable[[], None]) -> None:
        self._document.add_next_tick_callback(action)

    # ---- what is shown

    def _show(self, view: View, picture: Picture) -> None:
        self._picture = picture
        self._drawing.show(view, picture)
        self._key.object = key_html(picture.pixels) if picture.pixels else ""
        self._say(picture.words)
        self._note(picture.notes)

    def _show_lane(self, report: LaneReport) -> None:
        self._portrait.show(report)
        self._portrait_pane.visible = "portrait" in report.groups or "poincare" in report.groups
        self._lane.object = report_html(report)
        if report.whole and self._picture is not None:
            self._say(self._picture.words)

    def _note(self, notes: Sequence[str]) -> None:
        """Notes under the picture, and while the first view is shown, why an address names no view."""
        wrong = [self._wrong] if self._wrong and self._history.place == 0 else []
        lines = [*(("status error", text) for text in wrong), *(("notes", text) for text in notes)]
        self._notes.object = "".join(f"<div class='{kind}'>{html.escape(text)}</div>" for kind, text in lines)

    def _say(self, text: str, *, error: bool = False) -> None:
        self._status.object = f"<div class='status{' error' if error else ''}'>{html.escape(text)}</div>"

    # ---- what is saved

    def _save_yaml(self) -> io.StringIO:
        return io.StringIO(self._source.batch_text(self._history.now))

    def _save_picture(self) -> io.BytesIO:
        return picture_file(self._picture)


def picture_file(picture: Picture | None) -> io.BytesIO:
    """A picture as a PNG in the style of all pictures; empty while it is coarse."""
    stream = io.BytesIO()
    if picture is not None and picture.data is not None:
        with package_style():
            drawn(picture.data).savefig(stream, format="png")
        stream.seek(0)
    return stream


def _sentence(error: Exception) -> str:
    if isinstance(error, JaxnhError):
        return str(error)
    return f"{type(error).__name__}: {' '.join(str(error).split())[:500]}"
