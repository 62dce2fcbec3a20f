"""The editor of a config and of the user's file that it names, with what is wrong beside its line."""

from __future__ import annotations

import html
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import panel as pn

from jaxnh.exceptions import JaxnhError
from jaxnh.explorer.edited_files import MOST, EditedFiles, place_of
from jaxnh.explorer.page_style import CSS, NARROW

_LINE = 18  # pixels, as the style has it
_TEXT = """
textarea { font: 13px/18px ui-monospace, monospace !important; white-space: pre; overflow-x: auto; padding: 5px; }
"""
_WIDE, _NUMBERS, _NARROW = 620, 48, 380  # pixels
_TALL = 420


@dataclass(frozen=True)
class EditorState:
    """The state of an editor: its files, its texts, and whether it is open.

    Attributes:
        files: as they are on disk.
        texts: as they are edited, by file.
        is_open: whether it is seen.
        note: what is said above the texts.
    """

    files: EditedFiles
    texts: dict[Path, str]
    is_open: bool = False
    note: str = ""


class Editor:
    """Texts that are checked and run, and saved where that is asked for."""

    def __init__(self, state: EditorState, run: Callable[[dict[Path, str]], None]) -> None:
        """Show the texts.

        Args:
            run: called with the texts by file, to check and run them.
        """
        self._files, self._run_texts = state.files, run
        self._areas = {
            path: pn.widgets.TextAreaInput(
                value=text, max_length=MOST, rows=_rows(text), width=_WIDE, height=_LINE * _rows(text) + 16,
                stylesheets=[_TEXT], margin=(0, 0),
            )
            for path, text in state.texts.items()
        }  # fmt: skip
        self._gutters = {
            path: pn.pane.HTML(_gutter(text, 0), stylesheets=[CSS], width=_NUMBERS, margin=(0, 0))
            for path, text in state.texts.items()
        }
        self._wrong = {path: pn.pane.HTML("", stylesheets=[CSS], width=_NARROW, margin=(8, 0)) for path in self._areas}
        for path, area in self._areas.items():
            area.param.watch(lambda event, path=path: self._typed(path, str(event.new)), "value_input")
        self._said = pn.pane.HTML("", stylesheets=[CSS, NARROW], css_classes=["line"], sizing_mode="stretch_width")
        self.layout = self._layout(state)
        self.say(state.note)

    def _layout(self, state: EditorState) -> pn.Column:
        rows = [
            pn.Column(
                pn.pane.HTML(f"<b>{html.escape(str(path))}</b>"),
                pn.Column(
                    pn.Row(self._gutters[path], area, self._wrong[path]),
                    scroll=True,
                    max_height=_TALL,
                    sizing_mode="stretch_width",
                    css_classes=["whole"],
                    stylesheets=[NARROW],
                ),
                sizing_mode="stretch_width",
                css_classes=["whole"],
                stylesheets=[NARROW],
            )
            for path, area in self._areas.items()
        ]
        run = pn.widgets.Button(name="Check and run", button_type="primary", width=130, on_click=lambda _: self._run())
        save = pn.widgets.Button(name="Save to the files", width=140, on_click=lambda _: self._save())
        close = pn.widgets.Button(name="Close the editor", width=140, on_click=lambda _: self.toggle())
        buttons = pn.Row(run, save, close, self._said, css_classes=["wrapped"], stylesheets=[NARROW])
        return pn.Column(
            buttons,
            *rows,
            visible=state.is_open,
            sizing_mode="stretch_width",
            css_classes=["whole"],
            stylesheets=[NARROW],
        )

    @property
    def state(self) -> EditorState:
        """The state to open another editor with."""
        return EditorState(self._files, self.texts, self.layout.visible)

    @property
    def texts(self) -> dict[Path, str]:
        """Texts as they are edited, by file."""
        return {path: area.value_input or area.value for path, area in self._areas.items()}

    def toggle(self) -> None:
        """Open or close it."""
        self.layout.visible = not self.layout.visible

    def say(self, text: str, *, error: bool = False) -> None:
        """Say something beside the buttons."""
        self._said.object = f"<div class='status{' error' if error else ''}'>{html.escape(text)}</div>"

    def show_error(self, error: Exception) -> None:
        """Show what is wrong beside its line."""
        path, line, what = place_of(str(error), self._files)
        self._clear()
        self._gutters[path].object = _gutter(self.texts[path], line)
        top = _LINE * (line - 1)
        self._wrong[path].object = f"<div class='wrong'><div style='top:{top}px'>◀ {html.escape(what)}</div></div>"
        self.say(f"{path.name}, line {line}: {what}", error=True)

    def _clear(self) -> None:
        for path in self._areas:
            self._wrong[path].object = ""
            self._gutters[path].object = _gutter(self.texts[path], 0)

    def _typed(self, path: Path, text: str) -> None:
        area, rows = self._areas[path], _rows(text)
        if rows != area.rows:
            area.rows, area.height = rows, _LINE * rows + 16
        self._wrong[path].object = ""
        self._gutters[path].object = _gutter(text, 0)

    def _run(self) -> None:
        self._clear()
        self.say("checking…")
        self._run_texts(self.texts)

    def _save(self, *_: Any) -> None:
        try:
            self._files = self._files.save(self.texts)
        except JaxnhError as error:
            self.say(str(error), error=True)
            return
        self.say(f"saved: {', '.join(path.name for path in self._areas)}")


def _rows(text: str) -> int:
    return max(3, text.count("\n") + 2)


def _gutter(text: str, wrong: int) -> str:
    """Numbers of lines; the one that is wrong is marked."""
    numbers = (f"<b>{k}</b>" if k == wrong else str(k) for k in range(1, text.count("\n") + 2))
    return f"<div class='gutter'>{'<br>'.join(numbers)}</div>"
