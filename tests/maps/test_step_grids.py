"""Grids of steps: their ends, and the smooth map that they are samples of."""

from __future__ import annotations

import numpy as np
import pytest

from jaxnh.maps.step_grids import SmoothGrid, step_grid
from jaxnh.systems.particle import disturbed_speed
from tests.flows.particle import SYSTEMS


@pytest.mark.parametrize("system", [*SYSTEMS.values(), disturbed_speed(d=0.999)])
@pytest.mark.parametrize("steps", [1, 2, 7, 1000])
def test_grid_of_steps(system, steps):
    """From one end of the span to the other, as many steps as asked for, each forwards."""
    for span in ((0.0, system.period), (1.5, 2.5)):
        grid = step_grid(system, steps, span)
        assert grid.shape == (steps + 1,)
        assert (grid[0], grid[-1]) == span
        assert np.all(np.diff(grid) > 0)


@pytest.mark.parametrize("system", [*SYSTEMS.values(), disturbed_speed(d=0.999)])
def test_smooth_grid(system):
    """Its map and inverse undo each other, its rate is its slope, and its steps end where `step_grid` has them."""
    grid = SmoothGrid(system)
    t = np.linspace(-0.3, 1.2, 1001)[None] * system.period
    share = grid.share(t)
    np.testing.assert_allclose(grid.time(share), t, rtol=0, atol=1e-13 * system.period)
    slope = (grid.time(share + 1e-6) - grid.time(share - 1e-6)) / 2e-6
    np.testing.assert_allclose(slope, grid.rate(t), rtol=1e-6)
    ends = grid.time(np.linspace(0.0, grid.share(np.array([system.period])), 101, axis=-1))[0]
    np.testing.assert_allclose(ends, step_grid(system, 100, (0.0, system.period)), rtol=0, atol=1e-4 * system.period)
