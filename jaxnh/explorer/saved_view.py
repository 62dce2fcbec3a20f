"""The view of a page as a block of a config: a YAML that `jaxnh explore` opens and `jaxnh sweep` runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from jaxnh.config.blocks import ExploreBlock
from jaxnh.config.yaml_source import from_dict, from_text
from jaxnh.exceptions import InputError
from jaxnh.explorer.view import View, as_query, from_query


@dataclass(frozen=True)
class SavedView:
    """The view beside the numbers of a config.

    Attributes:
        view: words of the address of the page.
        whole: range of each axis that the page goes back to.
        selected: values of the axes of the lane that was clicked at.
        hidden: layers of the legend that are switched off.
        over: result files that are laid over the picture.
        result: result file that is shown; "": pictures are computed.
        camera: angles of the portrait in three dimensions; None: it is of two.
        system_file: text of the user's file; "": there is none.
    """

    view: Mapping[str, str] = field(default_factory=dict[str, str])
    whole: Mapping[str, tuple[float, float]] = field(default_factory=dict[str, tuple[float, float]])
    selected: Mapping[str, float] | None = None
    hidden: tuple[str, ...] = ()
    over: tuple[str, ...] = ()
    result: str = ""
    camera: Mapping[str, float] | None = None
    system_file: str = ""

    def with_files(self, result: str, over: Sequence[str]) -> SavedView:
        """The view with other names of result files."""
        return replace(self, result=result, over=tuple(over))

    def first(self, start: View) -> View:
        """The view that a page opens with.

        Args:
            start: the first view of the source.

        Raises:
            InputError: the source has no such axes, quantity or range.
        """
        first = from_query(start, self.view)
        if (first.axis, first.second) != (start.axis, start.second):
            raise InputError(f"explore.view: the axes are {' and '.join(start.ranges)}")
        return first


def saved_view(block: ExploreBlock | None) -> SavedView:
    """The block of a config; where it has none what a page opens with."""
    if block is None:
        return SavedView()
    words = {name: value if isinstance(value, str) else repr(value) for name, value in block.view.items()}
    camera = {str(name): angle for name, angle in block.camera.items()} if block.camera else None
    lists = tuple(block.hidden), tuple(block.over)
    return SavedView(words, block.whole, block.selected, *lists, block.result or "", camera, block.system_file or "")


def yaml_of(config: str, view: View, saved: SavedView) -> str:
    """The YAML of a config with the block of what is seen.

    Args:
        config: the YAML of the batch job that computes the view.
        view: ranges, quantity and depth; its parameters are those of the config.
        saved: the rest.
    """
    words = {name: _number(text) for name, text in as_query(view).items() if not name.startswith("p.")}
    block: dict[str, Any] = {"view": words}
    if saved.whole:
        block["whole"] = {name: list(ends) for name, ends in saved.whole.items()}
    for name in ("selected", "camera"):
        if given := getattr(saved, name):
            block[name] = dict(given)
    for name in ("hidden", "over"):
        if given := getattr(saved, name):
            block[name] = list(given)
    block |= {name: text for name in ("result", "system_file") if (text := getattr(saved, name))}
    return from_dict({**from_text(config).data, "explore": block}).text


def _number(text: str) -> int | float | str:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
