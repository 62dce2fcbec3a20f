"""Views: ranges down to neighbouring doubles, where one has been, and views as words of an address."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.exceptions import InputError
from jaxnh.explorer.view import History, View, as_query, from_query

FIRST = View("b", 0.1, 6.0, "x1")


def test_a_range_is_of_a_config_s_values():
    assert np.array_equal(FIRST.values(), np.linspace(0.1, 6.0, 1000))
    assert FIRST.lane_at(FIRST.values()[17] + 1e-3, 0.0) == {"b": FIRST.values()[17]}


def test_a_zoom_ends_where_columns_are_neighbouring_doubles():
    view = FIRST.zoom(5.4, np.nextafter(5.4, 6.0), None)
    assert len(np.unique(view.values())) == view.columns
    assert view.deepest
    assert not FIRST.zoom(5.4, 5.4 + 1e-9, None).deepest
    assert FIRST.zoom(6.0, 5.0, (2.0, 1.0)) == FIRST.zoom(5.0, 6.0, (1.0, 2.0))


def test_a_range_needs_numbers_that_rise():
    for low, high in ((1.0, 1.0), (2.0, 1.0), (np.nan, 1.0), (0.0, np.inf)):
        with pytest.raises(InputError, match="goes from a number up to a larger one"):
            View("b", low, high, "x1")


def test_back_and_forward():
    history = History([FIRST])
    one, other = FIRST.zoom(1.0, 2.0, None), FIRST.zoom(1.2, 1.4, (0.0, 1.0))
    assert history.go(one)
    assert not history.go(one)
    history.go(other)
    assert [history.move(-1), history.move(-1), history.move(-1)] == [one, FIRST, FIRST]
    assert history.move(1) == one
    assert history.go(FIRST.zoom(3.0, 4.0, None))  # what one had gone back from is no longer there
    assert history.move(1).low == 3.0


def test_an_address_names_a_view_to_the_last_bit():
    third = 1.0 / 3.0
    view = View("b", third, 2 * third, "y1", (-third, third), "", 64, 256, {"a": 0.1 + 0.2}, 1e-8)
    assert from_query(FIRST, as_query(view)) == view
    assert from_query(FIRST, {}) == FIRST


def test_a_plane_has_a_range_and_lanes_of_both_axes():
    plane = View("b", 0.0, 2.0, "lyapunov", (-1.0, 1.0), "d", columns=5, rows=3)
    assert {name: values.tolist() for name, values in plane.grid().items()} == {
        "b": [0.0, 0.5, 1.0, 1.5, 2.0],
        "d": [-1.0, 0.0, 1.0],
    }
    assert plane.lane_at(0.8, -0.4) == {"b": 1.0, "d": 0.0}
    zoomed = plane.zoom(0.5, 1.0, (1.0, 0.5))
    assert zoomed.ranges == {"b": (0.5, 1.0), "d": (0.5, 1.0)}
    assert from_query(plane, as_query(zoomed)) == zoomed
    assert from_query(plane, {}) == plane
    deepest = plane.zoom(0.5, 1.0, (0.25, np.nextafter(0.25, 1.0)))
    assert len(np.unique(deepest.grid()["d"])) == 3
    assert deepest.deepest
    with pytest.raises(InputError, match="a range of d goes from a number up to a larger one"):
        View("b", 0.0, 1.0, "lyapunov", (1.0, 0.0), "d")


@pytest.mark.parametrize("query", [{"low": "x"}, {"low": "7"}, {"strobes": "1.5"}, {"bottom": "nan", "top": "1"}])
def test_an_address_that_names_none_is_refused(query):
    with pytest.raises(InputError):
        from_query(FIRST, query)


def test_keys_move_and_zoom_within_the_whole_range():
    view = FIRST.zoom(1.0, 2.0, (0.0, 1.0))
    assert view.by_key("ArrowRight", FIRST, None).ranges == {"b": (1.2, 2.2)}
    assert view.by_key("ArrowUp", FIRST, None).window == pytest.approx((0.2, 1.2))
    zoomed = view.by_key("+", FIRST, None)
    assert (zoomed.low, zoomed.high, zoomed.window) == (1.25, 1.75, (0.25, 0.75))
    assert zoomed.by_key("-", FIRST, None) == view
    edge = FIRST.by_key("ArrowLeft", FIRST, (0.0, 1.0))
    assert (edge.low, edge.high, edge.window) == (FIRST.low, FIRST.high, None)
    assert FIRST.zoom(0.2, 1.2, None).by_key("ArrowLeft", FIRST, None).low == FIRST.low
    assert FIRST.by_key("-", FIRST, (0.0, 1.0)) == FIRST
