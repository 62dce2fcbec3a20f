"""Edited texts: checked as the command checks files, at their lines, and saved whole, over nobody else's change."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from jaxnh.config.config import load_config
from jaxnh.engine.progress import NullProgress
from jaxnh.exceptions import ConfigError, InputError, ResultError
from jaxnh.explorer.edited_files import MOST, edited_files, place_of
from jaxnh.explorer.file_check import check_texts
from jaxnh.explorer.opening import open_file

SYSTEM = """\
def system(r=3.2):
    def image(y):
        (x,) = y
        return (r * x * (1 - x),)

    return {"map": image, "coordinates": ("x",)}
"""
CONFIG = """\
system: {file: own.py}
initial: {x: 0.3}
sweep: {r: {start: 3.0, stop: 3.4, count: 8}}
analyses: {diagram: {transient: 8, strobes: 8}}
"""


@pytest.fixture
def files(tmp_path):
    (tmp_path / "own.py").write_text(SYSTEM)
    (tmp_path / "own.yaml").write_text(CONFIG)
    return edited_files(load_config(tmp_path / "own.yaml"), ())


def edited(files, old, new):
    return {path: text.replace(old, new) for path, text in files.texts.items()}


def test_edited_texts_are_run_and_the_files_stay(files):
    config, system = files.texts
    experiment = files.experiment(edited(files, "r=3.2", "r=3.2, s=1.0"))
    assert list(experiment.flow().parameters) == ["r", "s"]
    assert (config.read_text(), system.read_text()) == (CONFIG, SYSTEM)


@pytest.mark.parametrize(
    ("old", "new", "name", "line", "words"),
    [
        ("strobes: 8", "strobbes: 8", "own.yaml", 4, "unknown key"),
        ("r * x", "q * x", "own.py", 4, "name 'q' is not defined"),
        ("def image(y):", "def image(y)", "own.py", 2, "not valid Python"),
        ("count: 8", "count: [", "own.yaml", 3, "YAML"),
    ],
)
def test_an_error_has_its_file_and_its_line(files, old, new, name, line, words):
    with pytest.raises(ConfigError) as error:
        files.experiment(edited(files, old, new))
    path, at, what = place_of(str(error.value), files)
    assert path.name == name
    assert abs(at - line) <= (1 if words == "YAML" else 0)  # a bracket that is not closed is missed a line below
    assert words in what or words == "YAML"


def test_a_text_without_end_is_refused(files):
    with pytest.raises(InputError, match="has at most 262,144 characters"):
        files.experiment({**files.texts, files.config: "#" * (MOST + 1)})


def test_saving_writes_what_has_changed_and_keeps_ends_of_lines(files):
    config, system = files.texts
    config.write_bytes(CONFIG.replace("\n", "\r\n").encode())
    before = system.stat().st_mtime_ns
    saved = files.save(edited(files, "x: 0.3", "x: 0.4"))
    assert config.read_bytes() == CONFIG.replace("x: 0.3", "x: 0.4").replace("\n", "\r\n").encode()
    assert system.stat().st_mtime_ns == before
    assert saved.texts[config] == CONFIG.replace("x: 0.3", "x: 0.4")
    assert sorted(path.name for path in config.parent.iterdir()) == ["own.py", "own.yaml"]  # no part of a file is left


def test_nothing_is_saved_over_a_change_of_somebody_else(files):
    files.config.write_text(CONFIG + "# theirs\n")
    with pytest.raises(ResultError, match="has changed on disk since it was read"):
        files.save(edited(files, "3.", "2."))
    assert files.config.read_text() == CONFIG + "# theirs\n"
    assert (files.config.parent / "own.py").read_text() == SYSTEM


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        (
            "        (x,) = y\n",
            "        (x,) = y\n        while True:\n            pass\n",
            (4, 5),
            "a loop without an end",
        ),
        ("        (x,) = y\n", "        x = y[0] + 0 * 9 ** 9 ** 9\n", (3,), "stopped after 1 s"),
        ("r * x", "q * x", (4,), "name 'q' is not defined"),
        ("        (x,) = y\n", "        (x,) = y\n        import os\n        os._exit(3)\n", (1,), "status 3"),
    ],
)
def test_texts_are_checked_by_a_process_of_its_own_that_may_not_go_on(files, old, new, line, words):
    """A loop in Python, one inside of a single instruction, a fault, and an end of the process."""
    with pytest.raises(InputError) as error:
        list(check_texts(files, edited(files, old, new), seconds=1.0 if "stopped" in words else 4.0))
    path, at, what = place_of(str(error.value), files)
    assert path.name == ("own.yaml" if "status" in words else "own.py")
    assert at in line
    assert words in what


def test_a_check_that_nobody_waits_for_is_ended(files):
    before = set(children())
    check = check_texts(files, edited(files, "        (x,) = y\n", "        while True:\n            pass\n"))
    next(check)
    [child] = set(children()) - before
    check.close()
    assert child not in children()


def children():
    """Processes that this one has started."""
    return Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()


def test_texts_that_are_right_pass_whatever_they_print(files):
    assert set(check_texts(files, edited(files, "        (x,) = y\n", "        print('x')\n        (x,) = y\n"))) <= {
        None
    }


def test_a_page_that_is_seen_from_elsewhere_edits_and_runs_nothing(files, tmp_path):
    """`make_server` gives a page nothing to run texts with where it does not listen on the loopback."""
    pytest.importorskip("panel", reason="the extra explore is missing")
    from bokeh.document import Document

    from jaxnh.explorer.page import Page
    from jaxnh.explorer.worker import Worker

    path = tmp_path / "own.yaml"
    opened = open_file(path, load_config(path), (), (), NullProgress(), 64)
    page = Page(opened, Worker(), Document(), {}, lambda *_: None)
    for ask in (page._edit, lambda: page._run_texts(files.texts)):
        page._refused = ""
        ask()
        page._say("computing…")  # as a pass that is under way does
        assert "files are edited on the loopback alone" in page._notes.object
