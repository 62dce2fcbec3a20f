"""Files that `jaxnh explore` opens: a config, a saved view of it, or a result file, with results to be laid over it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import xarray as xr

from jaxnh.config.config import Config
from jaxnh.engine.progress import Progress
from jaxnh.exceptions import InputError, JaxnhError
from jaxnh.explorer.edited_files import EditedFiles, edited_files
from jaxnh.explorer.file_check import check_texts
from jaxnh.explorer.recording import described, open_recording
from jaxnh.explorer.saved_view import SavedView, saved_view
from jaxnh.explorer.source import PictureSource
from jaxnh.storage.hdf5 import open_result


class PageContent(NamedTuple):
    """A source of pictures and what its page begins with.

    Attributes:
        source: of the pictures.
        saved: what is seen first.
        overlays: groups of each result that is laid over the pictures, its own first.
        files: those that can be edited; None: there are none.
    """

    source: PictureSource
    saved: SavedView
    overlays: tuple[Mapping[str, xr.Dataset], ...]
    files: EditedFiles | None = None


def open_file(
    path: Path, content: Config | None, overrides: Sequence[str], over: Sequence[Path], progress: Progress, columns: int
) -> PageContent:
    """Open a config, or where there is none a result file.

    Args:
        path: of the file.
        content: the config that it has.
        overrides: KEY=VALUE that go with it.
        over: result files that are laid over it, beside those that a saved view names.
        progress: of sessions.
        columns: values of the axis in a diagram.

    Raises:
        InputError: nothing can be shown of it, or a saved view is not one of it.
    """
    saved = saved_view(content.explore if content else None)
    files = [*(_find_file(path, name) for name in saved.over), *over]
    more = tuple(map(read_overlays, files))
    result = _find_file(path, saved.result) if saved.result else path
    shown = content is None or bool(saved.result)
    saved = saved.with_files(str(result.resolve()) if shown else "", [str(file.resolve()) for file in files])
    if content is None or shown:
        source = open_recording(result)
        return PageContent(source, checked(saved, source, path), (source.overlays, *more))
    # Imports JAX, for a second.
    from jaxnh.engine.experiment import Experiment
    from jaxnh.engine.xla_options import configure
    from jaxnh.explorer.live import live

    configure()  # before a user's file is tried out
    source = live(Experiment.from_config(content), progress, columns)
    return PageContent(source, checked(saved, source, path), more, edited_files(content, overrides))


def open_texts(
    opened: PageContent, texts: dict[Path, str], progress: Progress, columns: int
) -> Iterator[PageContent | None]:
    """Open edited texts of the files of a config, with the results that were laid over it.

    They are first tried out in a process of their own (`file_check`); None is yielded while that goes on.

    Args:
        opened: the config as it was.
        texts: by file.
        progress: of sessions.
        columns: values of the axis in a diagram.

    Raises:
        InputError: they are no config that can be shown.
    """
    from jaxnh.explorer.live import live

    assert opened.files is not None
    yield from check_texts(opened.files, texts)
    source = live(opened.files.experiment(texts), progress, columns)
    yield opened._replace(source=source, saved=SavedView(over=opened.saved.over))


def keeping(opened: PageContent, before: PictureSource, seen: SavedView) -> PageContent:
    """The page with the view that was shown before, where its axes, ranges and quantity still exist."""
    source = opened.source
    same = source.first.ranges == before.first.ranges and source.first.axis == before.first.axis
    try:
        view = seen.first(source.first) if same else None
    except InputError:
        view = None
    known = {parameter.name for parameter in source.parameters}
    suits = view is not None and view.variable in source.variables and set(view.fixed) <= known
    return opened._replace(saved=seen) if suits else opened


def _find_file(path: Path, name: str) -> Path:
    """A file that a saved view names: where it was, or else in the folder of the saved view."""
    there = path.parent / name
    return there if there.is_file() else path.parent / there.name


def checked(saved: SavedView, source: PictureSource, path: Path) -> SavedView:
    """A saved view, which is one of a source.

    Raises:
        InputError: it is not.
    """
    try:
        view = saved.first(source.first)
    except InputError:
        view = None
    if view is None or view.variable not in source.variables:
        axes, words = " and ".join(source.first.ranges), ", ".join(source.variables)
        raise InputError(f"{path}: explore.view: it is no view of this, over {axes}, of {words}")
    return saved


def read_overlays(path: Path) -> Mapping[str, xr.Dataset]:
    """The groups of a result file, to be laid over pictures.

    Raises:
        InputError: there is no such file, or it is no result.
    """
    if not path.is_file():
        raise InputError(f"command line: --over: {path} is {'a folder' if path.is_dir() else 'not there'}")
    try:
        return described(open_result(path))
    except JaxnhError as error:
        raise InputError(f"command line: --over: {error}") from error
