"""A view as a block of a config: what is seen comes back, and the config is run as it was."""

from __future__ import annotations

import pytest

import jaxnh
from jaxnh.config.config import load_config
from jaxnh.engine.progress import NullProgress
from jaxnh.exceptions import ConfigError, InputError
from jaxnh.explorer.opening import open_file
from jaxnh.explorer.saved_view import SavedView, saved_view, yaml_of
from jaxnh.explorer.view import View

CONFIG = """\
title: A view
system: {constraint: constant_speed}
sweep: {b: {start: 5.0, stop: 5.5, count: 8}}
accuracy: {solver: blanes_moan6, steps: 60}
analyses: {diagram: {transient: 48, strobes: 64}}
"""
VIEW = View("b", 5.1, 5.1 + 1.0 / 3.0, "y1", (-0.5, 1.5), transient=48, strobes=64)
SEEN = SavedView({}, {"b": (4.0, 6.0)}, {"b": 5.2}, ("fold",), (), "", {"azimuth": -30.0, "elevation": 12.5})


def opened(path, text):
    path.write_text(text)
    return open_file(path, load_config(path), (), (), NullProgress(), 96)


def test_what_is_seen_comes_back(tmp_path):
    found = opened(tmp_path / "view.yaml", yaml_of(CONFIG, VIEW, SEEN))
    assert found.saved.first(found.source.first) == View(**{**vars(VIEW), "columns": 96})
    assert found.source.first.ranges == {"b": (4.0, 6.0)}  # the range before the zoom
    assert (found.saved.selected, found.saved.hidden, found.saved.camera) == ({"b": 5.2}, ("fold",), SEEN.camera)


def test_a_run_does_not_depend_on_what_is_seen():
    plain = jaxnh.Experiment.from_text(CONFIG)
    assert jaxnh.Experiment.from_text(yaml_of(CONFIG, VIEW, SEEN)).sha256 == plain.sha256


def test_a_view_saved_again_is_the_same(tmp_path):
    text = yaml_of(CONFIG, VIEW, SEEN)
    block = saved_view(jaxnh.Experiment.from_text(text).explore)
    assert yaml_of(text, block.first(VIEW), block) == text


def test_a_view_of_something_else_is_refused_in_a_line(tmp_path):
    path = tmp_path / "view.yaml"
    for word, other in (("variable: y1", "variable: speed"), ("axis: b", "axis: c"), ("low: 5.1", "low: 7.0")):
        with pytest.raises(InputError, match=r"view.yaml: explore.view: it is no view of this, over b, of x1"):
            opened(path, yaml_of(CONFIG, VIEW, SEEN).replace(word, other))
    with pytest.raises(ConfigError, match=r"explore\.shown: unknown key"):
        opened(path, CONFIG + "explore: {shown: 1}\n")


SYSTEM = """\
def system(r=3.2):
\tdef image(y):      # a tab, and blanks at the end:   
\t\treturn (r * y[0] * (1 - y[0]),)

\treturn {"map": image, "coordinates": ("x",), "labels": {"x": "the share \\"x\\" of Müller's"}}
"""  # noqa: W291
OF_A_FILE = "system: {file: own.py}\ninitial: {x: 0.3}\nsweep: {r: {start: 3.0, stop: 3.4, count: 8}}\nanalyses: {diagram: {}}\n"


@pytest.fixture
def carried(tmp_path):
    """A saved view of a user's system, in a folder without the user's file."""
    path = tmp_path / "view.yaml"
    path.write_text(yaml_of(OF_A_FILE, View("r", 3.0, 3.2, "x"), SavedView(system_file=SYSTEM)))
    return path


def test_one_yaml_is_enough_to_open_a_view_of_a_user_s_system_and_to_run_it(carried):
    experiment = jaxnh.load(carried)
    assert experiment.user_file.text == SYSTEM
    found = open_file(carried, load_config(carried), (), (), NullProgress(), 96)
    assert found.saved.first(found.source.first).ranges == {"r": (3.0, 3.2)}
    assert found.source.system_text == found.saved.system_file == SYSTEM
    alone = jaxnh.Experiment.from_text(OF_A_FILE, SYSTEM)
    assert jaxnh.Experiment.from_text(carried.read_text(), SYSTEM).sha256 == alone.sha256


def test_a_file_that_says_something_else_than_the_view_is_refused(carried):
    (carried.parent / "own.py").write_text(SYSTEM)
    assert jaxnh.load(carried).user_file.text == SYSTEM
    (carried.parent / "own.py").write_text(SYSTEM.replace("3.2", "3.3"))
    with pytest.raises(
        ConfigError, match=r"view\.yaml:\d+: explore\.system_file: .*own\.py is there and says something"
    ):
        jaxnh.load(carried)


def test_what_is_edited_of_a_view_that_carries_its_file_is_saved_in_both(carried):
    found = open_file(carried, load_config(carried), (), (), NullProgress(), 96)
    config, system = found.files.texts
    edited = {**found.files.texts, system: SYSTEM.replace("3.2", "3.3")}
    saved = found.files.save(edited)
    assert system.read_text() == edited[system]
    assert jaxnh.load(config).user_file.text == edited[system]
    assert saved.save(saved.texts) == saved
