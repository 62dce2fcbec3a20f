"""Rasters: every point in its cell, shares as colours, and windows that leave points out."""

from __future__ import annotations

import numpy as np

from jaxnh.explorer.raster import PALETTE, ROWS, raster

WINDOW = (-0.5137, 1.5)  # no point lies on the edge of a cell


def row_of(value):
    return np.floor((value - WINDOW[0]) / (WINDOW[1] - WINDOW[0]) * ROWS).astype(int)


def test_every_point_lies_in_its_cell():
    axis = np.linspace(0.0, 1.0, 11)
    values = np.stack([axis, 1.0 - axis], axis=1)
    found = raster(axis, values, WINDOW)
    assert found.cells.shape == (ROWS, 11)
    assert found.up == WINDOW
    expected = np.zeros(found.cells.shape, bool)
    expected[row_of(values), np.arange(11)[:, None]] = True
    assert np.array_equal(found.cells != PALETTE[0], expected)


def test_colours_rise_with_the_share_of_a_columns_points():
    """An orbit of period one has the last colour; of 1000 points, one alone has the first."""
    axis = np.array([0.0, 1.0])
    many = np.concatenate([np.zeros(999), [1.0]])
    found = raster(axis, np.stack([np.zeros(1000), many]), WINDOW)
    zero, one = row_of(np.array([0.0, 1.0]))
    assert found.cells[zero, 0] == PALETTE[-1]
    assert found.cells[one, 1] == PALETTE[1]
    assert found.cells[one, 0] == PALETTE[0]


def test_a_window_leaves_out_what_lies_beyond_it_and_shares_stay():
    axis, values = np.array([0.0, 1.0]), np.array([[0.0, 5.0], [0.0, np.nan]])
    found = raster(axis, values, (-1.0, 1.0))
    place = [[list(PALETTE).index(cell) for cell in column] for column in found.cells.T]
    assert 0 < max(place[0]) < max(place[1]) == len(PALETTE) - 1
