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
