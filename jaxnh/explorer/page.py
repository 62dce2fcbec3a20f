"""The page of one tab: its figures and controls. Pictures are computed or read elsewhere (`source`)."""

from __future__ import annotations

import html
import io
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import panel as pn
from bokeh.document import Document
from bokeh.events import RangesUpdate, Tap
from bokeh.models import CustomJS

from jaxnh.exceptions import JaxnhError
from jaxnh.explorer.atlas import limits_of
from jaxnh.explorer.controls import Controls
from jaxnh.explorer.editor import Editor, EditorState
from jaxnh.explorer.figures import Drawing
from jaxnh.explorer.key import key_html
from jaxnh.explorer.layers import Hit, Layer
from jaxnh.explorer.opening import PageContent, keeping
from jaxnh.explorer.overlay_figure import LayerDrawing
from jaxnh.explorer.overlays import layers_of
from jaxnh.explorer.page_scripts import KEYBOARD, KEYS, LOST
from jaxnh.explorer.page_style import CSS, NARROW
from jaxnh.explorer.portrait_pane import PortraitPane
from jaxnh.explorer.report import facts_html, report_html
from jaxnh.explorer.saved_view import SavedView, yaml_of
from jaxnh.explorer.source import LaneReport, Picture
from jaxnh.explorer.view import History, View, as_query, from_query
from jaxnh.explorer.worker import Request, Worker
from jaxnh.plotting.results import figure as drawn
from jaxnh.plotting.style import package_style

_SILENT = 0.4  # share of a pass between two words of progress
_QUICK = 1.5  # seconds that a picture may take without a word of what is being done
_REFUSED = "files are edited on the loopback alone: start jaxnh explore without --address, on this machine"

Run = Callable[[dict[Path, str]], Iterator[PageContent | None]]
"""The function that opens edited texts anew, and yields None while it checks them; raises `JaxnhError`."""


class Page:
    """One tab."""

    def __init__(
        self,
        opened: PageContent,
        worker: Worker,
        document: Document,
        query: Mapping[str, str],
        reopen: Callable[[PageContent, EditorState], None],
        editor: EditorState | None = None,
        run: Run | None = None,
    ) -> None:
        """Nothing is asked for yet.

        Args:
            query: query of the address, which may name a view.
            reopen: shows what edited texts have been opened as, in place of this page.
            editor: the texts; None: those of the files.
            run: opens edited texts; None: nothing may be edited here.
        """
        self._source, self._worker, self._document = opened.source, worker, document
        self._saved, self._overlays, self._run, self._reopen = opened.saved, opened.overlays, run, reopen
        first, self._refused = self._first(query)  # why nothing else is shown, until another view is
        self._history = History([first])
        self._picture: Picture | None = None
        self._layers: dict[tuple[str, str], Sequence[Layer]] = {}
        self._selected = dict(opened.saved.selected or {})
        self._facts = ""  # of the curve that was clicked at, as HTML
        source = self._source
        self._drawing = Drawing(first, source.axis_words[first.axis], self._upward(first))
        self._laid = LayerDrawing(self._drawing.figure, opened.saved.hidden, edged=bool(first.second))
        self._portrait = PortraitPane(opened.saved.camera)
        self._drawing.figure.on_event(RangesUpdate, self._ranged)
        self._drawing.figure.on_event(Tap, self._tapped)
        self._drawing.figure.on_change("tags", lambda _, __, tags: self._pressed(str(tags[0])))
        self._controls = Controls(source, first, lambda: self._try(lambda: self._controls.view(self._history.now)))
        texts = opened.files and (editor or EditorState(opened.files, opened.files.texts))
        self._editor = Editor(texts, self._run_texts) if texts else None
        self._make_widgets(first)
        document.js_on_event("connection_lost", CustomJS(code=LOST))
        known = {"pressed": self._drawing.figure, "camera": self._portrait.camera, "pan": self._drawing.pan}
        self._drawing.run_with_pictures(CustomJS(args={**known, "keys": KEYS}, code=KEYBOARD))

    def _first(self, query: Mapping[str, str]) -> tuple[View, str]:
        """The view that is shown first, and why an address names none."""
        start = self._saved.first(self._source.first)
        try:
            first = from_query(start, query)
        except JaxnhError as error:
            return start, str(error)
        known = first.ranges.keys() == start.ranges.keys() and first.variable in self._source.variables
        return (first if known and first.axis == start.axis else start), ""

    def _upward(self, view: View) -> str:
        """The quantity that is drawn upward in a view, in words."""
        return self._source.axis_words[view.second] if view.second else self._source.variables[view.variable]

    # ---- layout

    def _make_widgets(self, view: View) -> None:
        self._back = pn.widgets.Button(name="◀ Back", width=90, on_click=lambda _: self._move(-1))
        self._forward = pn.widgets.Button(name="Forward ▶", width=90, on_click=lambda _: self._move(1))
        self._whole = pn.widgets.Button(name="Whole range", width=110, on_click=lambda _: self._go_whole())
        line: dict[str, Any] = {"css_classes": ["line"], "sizing_mode": "stretch_width"}
        self._status = pn.pane.HTML("", stylesheets=[CSS, NARROW], **line)
        self._notes = pn.pane.HTML("", stylesheets=[CSS], sizing_mode="stretch_width")
        self._lane = pn.pane.HTML(
            f"Click into the {'plane' if view.second else 'diagram'}: portrait, strobe points, period, spectrum and "
            "verdict of the lane there, as far as "
            f"{'they can be computed' if self._source.computes else 'the file has them'}. Press ? for the keys.",
            stylesheets=[CSS, NARROW],
            **line,
        )
        self._key = pn.pane.HTML("", stylesheets=[CSS], sizing_mode="stretch_width")

    def _saves(self) -> list[Any]:
        """Buttons that save, and the one that opens the editor."""
        look = {"width": 220, "button_type": "primary"}
        yaml = pn.widgets.FileDownload(callback=self._save_yaml, filename="view.yaml", label="Save as YAML", **look)
        png = pn.widgets.FileDownload(callback=self._save_picture, filename="view.png", label="Save picture", **look)
        edit = pn.widgets.Button(name="Edit the files", width=220, on_click=lambda _: self._edit())
        config = bool(self._source.batch_text(self._history.now))
        return [*([yaml] if config else []), png, *([edit] if self._editor else [])]

    def layout(self) -> pn.viewable.Viewable:
        """The whole page."""
        narrow: dict[str, Any] = {"stylesheets": [NARROW]}
        side = pn.Column(*self._controls.widgets, *self._saves(), width=240, css_classes=["whole"], **narrow)
        main = pn.Column(
            pn.pane.HTML(f"<h2 style='margin:4px 0'>{html.escape(self._source.title)}</h2>"),
            pn.Row(self._back, self._forward, self._whole, self._status, css_classes=["wrapped"], **narrow),
            *([self._editor.layout] if self._editor else []),
            self._key,
            pn.pane.Bokeh(self._drawing.figure, sizing_mode="stretch_width"),
            self._notes,
            pn.Row(self._portrait.layout, self._lane, sizing_mode="stretch_width", css_classes=["beside"], **narrow),
            sizing_mode="stretch_width",
            css_classes=["whole"],
            **narrow,
        )
        return pn.Row(side, main, sizing_mode="stretch_width", css_classes=["aside"], **narrow)

    # ---- what one does

    def begin(self) -> None:
        """Ask for the first view, and for the lane that a saved view has selected."""
        self._look()
        self._note(())
        if self._selected.keys() == set(self._history.now.ranges):
            self._ask_lane(self._selected)

    def end(self) -> None:
        """The tab is closed."""
        for what in ("picture", "lane", "texts"):
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
        hit = self._laid.hit(event.x, event.y, self._drawing.scale)
        self._tell_hit(hit)
        if hit is None or not self._portrait.show_orbit(hit.item.orbit(hit.point)):
            self._ask_lane(self._history.now.lane_at(event.x, event.y))

    def _tell_hit(self, hit: Hit | None) -> None:
        """Show the facts of what was clicked at; a lane's follow them."""
        self._facts = facts_html(hit.item.facts(hit.point)) if hit else ""
        self._lane.object = self._facts
        if hit is not None:
            self._drawing.unmark()
            self._worker.drop((id(self), "lane"))

    def _ask_lane(self, where: Mapping[str, float]) -> None:
        self._selected = dict(where)
        self._drawing.mark(where)
        place = ", ".join(f"{html.escape(name)} = {value!r}" for name, value in where.items())
        self._lane.object = f"{self._facts}{place}: {'computing' if self._source.computes else 'reading'}…"
        self._ask("lane", self._source.lane(self._history.now, where), self._show_lane)

    def _pressed(self, key: str) -> None:
        if key == "Escape":
            self._selected = {}
            self._tell_hit(None)
            self._drawing.unmark()
            self._portrait.hide()
        elif key in ("[", "]"):
            self._move(-1 if key == "[" else 1)
        elif key == "0":
            self._go_whole()
        else:
            whole, shown = self._source.first, self._picture.raster.up if self._picture else None
            self._try(lambda: self._history.now.by_key(key, whole, shown))

    def _try(self, change: Callable[[], View]) -> None:
        """Show another view, or say why there is none."""
        try:
            view = change()
        except (JaxnhError, ValueError) as error:
            self._refuse(str(error))
            return
        self._refused = ""
        if self._history.go(view):
            self._look()

    def _move(self, steps: int) -> None:
        self._history.move(steps)
        self._refused = ""
        self._look()

    def _go_whole(self) -> None:
        first = self._source.first
        self._try(lambda: replace(self._history.now, low=first.low, high=first.high, window=first.window))

    def _look(self) -> None:
        view = self._history.now
        self._controls.set(view)
        self._back.disabled = self._history.place == 0
        self._forward.disabled = self._history.place == len(self._history.views) - 1
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

        failed: Callable[[Exception], None] = lambda error: self._say(_sentence(error), error=True)  # noqa: E731
        if what == "texts" and self._editor is not None:
            failed = self._editor.show_error
        request = Request(
            passes, answer=answered_by, failed=lambda error: self._later(partial(failed, error)), told=told
        )
        self._worker.ask((id(self), what), request)

    def _later(self, action: Callable[[], None]) -> None:
        self._document.add_next_tick_callback(action)

    # ---- editing

    def _edit(self) -> None:
        if self._run is None:
            self._refuse(_REFUSED)
        elif self._editor is not None:
            self._editor.toggle()

    def _run_texts(self, texts: dict[Path, str]) -> None:
        run, editor = self._run, self._editor
        if run is None or editor is None:
            self._refuse(_REFUSED)
            return

        def answer(opened: PageContent | None) -> None:
            if opened is not None:
                self._reopen(keeping(opened, self._source, self.seen), editor.state)

        self._ask("texts", run(texts), answer)

    # ---- what is shown

    def _show(self, view: View, picture: Picture) -> None:
        self._picture = picture
        self._drawing.show(view, picture)
        self._laid.show(self._layers_of(view))
        self._laid.fit(self._drawing.scale)
        self._key.object = key_html(picture.pixels) if picture.pixels else ""
        self._say(picture.words)
        self._note(picture.notes)

    def _layers_of(self, view: View) -> Sequence[Layer]:
        names = view.axis, view.second or view.variable
        if names not in self._layers:
            self._layers[names] = [layer for groups in self._overlays for layer in layers_of(groups, *names)]
        return self._layers[names]

    def _show_lane(self, report: LaneReport) -> None:
        self._portrait.show(report)
        self._lane.object = self._facts + report_html(report)
        if report.whole and self._picture is not None:
            self._say(self._picture.words)

    def _refuse(self, why: str) -> None:
        """Say under the picture why what was asked for is not done, where no progress of a pass is written over it."""
        self._refused = why
        self._note(self._picture.notes if self._picture else ())

    def _note(self, notes: Sequence[str]) -> None:
        """Notes under the picture, limits of an atlas, and why what was asked for last is refused."""
        limits = [limit for groups in self._overlays for limit in limits_of(groups)]
        refused = [self._refused] if self._refused else []
        lines = [*(("status error", text) for text in refused), *(("notes", text) for text in (*notes, *limits))]
        self._notes.object = "".join(f"<div class='{kind}'>{html.escape(text)}</div>" for kind, text in lines)

    def _say(self, text: str, *, error: bool = False) -> None:
        self._status.object = f"<div class='status{' error' if error else ''}'>{html.escape(text)}</div>"

    # ---- what is saved

    @property
    def seen(self) -> SavedView:
        """The state of the page beside the view."""
        first = self._source.first
        whole = dict(first.ranges) if self._source.computes else {}
        selected = self._selected or None
        more: dict[str, Any] = {"hidden": tuple(sorted(self._laid.hidden)), "camera": self._portrait.angles}
        more |= {"whole": whole, "selected": selected, "system_file": self._source.system_text}
        return replace(self._saved, view=as_query(self._history.now), **more)

    def _save_yaml(self) -> io.StringIO:
        now = self._history.now
        return io.StringIO(yaml_of(self._source.batch_text(now), now, self.seen))

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
