"""Views that are computed: coarse, then in full; nothing compiled by a zoom; the saved config gives the same numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import jaxnh
from jaxnh.engine.progress import CallbackProgress, NullProgress
from jaxnh.exceptions import InputError, Stopped
from jaxnh.explorer.live import live as source_of

pytestmark = pytest.mark.usefixtures("uncalibrated")
CONFIG = {
    "system": {"constraint": "constant_speed"},
    "sweep": {"b": {"start": 4.0, "stop": 6.0, "count": 8}},
    "accuracy": {"solver": "blanes_moan6", "steps": 60},
    "analyses": {"diagram": {"transient": 48, "strobes": 64}},
}
COLUMNS = 96


@pytest.fixture(scope="module")
def stopping():
    return [False]


@pytest.fixture(scope="module")
def live(stopping):
    def told(label, done, total):
        if stopping[0]:
            raise Stopped("stale")

    return source_of(jaxnh.Experiment.from_dict(CONFIG), CallbackProgress(told), COLUMNS)


def test_a_coarse_picture_comes_before_the_whole_and_a_zoom_compiles_nothing(live):
    first = list(live.passes(live.first))
    assert [picture.data is None for picture in first] == [True, False]
    before = live.sessions.compiled
    zoomed = live.first.zoom(5.41, 5.43, None)
    coarse, fine = live.passes(zoomed)
    assert live.sessions.compiled == before
    assert coarse.words.startswith("coarse: 96 values, 32 strobes after ")
    assert fine.words == "96 values, 64 strobes after 48 periods"
    assert np.array_equal(fine.data["b"], zoomed.values())


def test_programs_of_a_view_are_compiled_by_its_first_picture():
    """As the command has that made before a page asks (`Worker.ask_ahead`)."""
    source = source_of(jaxnh.Experiment.from_dict(CONFIG), NullProgress(), COLUMNS)
    next(source.passes(source.first))
    before = source.sessions.compiled
    assert before
    next(source.passes(source.first))
    assert source.sessions.compiled == before


def test_the_saved_config_gives_the_same_numbers(live):
    view = live.first.zoom(5.31, 5.32, (0.0, 3.0))
    *_, last = live.passes(view)
    batch = jaxnh.run(jaxnh.Experiment.from_text(live.batch_text(view)))["diagram"]
    for name in ("b", "x1", "y2"):
        assert np.array_equal(batch[name], last.data[name])


def test_a_moved_parameter_is_that_of_a_run_with_it(live):
    view = replace(live.first.zoom(5.0, 5.1, None), fixed={"a": 0.4})
    *_, last = live.passes(view)
    asked = jaxnh.Experiment.from_text(live.batch_text(view))
    assert asked.system.a == 0.4
    assert np.array_equal(jaxnh.run(asked)["diagram"]["x1"], last.data["x1"])
    assert "a in 0.25..0.75" in last.notes[0]


def test_a_stale_view_is_stopped_and_the_next_one_is_computed(live, stopping):
    passes = live.passes(live.first.zoom(4.5, 4.6, None))
    next(passes)
    stopping[0] = True
    with pytest.raises(Stopped):
        next(passes)
    stopping[0] = False
    assert list(live.passes(live.first))[-1].data is not None


def test_what_is_below_the_accuracy_is_said(live):
    *_, last = live.passes(live.first.zoom(5.4, 5.4 + 1e-13, None))
    assert any("places move with the accuracy" in note for note in last.notes)
    assert any("neighbouring doubles" in note for note in last.notes)


def test_an_axis_of_one_value_is_no_range():
    with pytest.raises(InputError, match="axis of two values or more"):
        source_of(
            jaxnh.Experiment.from_dict({**CONFIG, "sweep": {"b": {"values": [5.0]}}}),
            CallbackProgress(lambda *_: None),
            64,
        )


def test_a_parameter_that_is_not_there_is_named(live):
    passes = live.passes(replace(live.first, fixed={"nothing": 1.0}))
    with pytest.raises(InputError, match="no parameter nothing"):
        next(passes)
