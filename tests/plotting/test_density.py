import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from jaxnh.plotting.density import INK, DensityImage, column_shares


def test_density_is_a_plain_count():
    """The share of each cell against numpy.histogram2d on the same edges, b falling, in columns of three values."""
    b, values = np.linspace(5, 1, 3 * 1000), np.random.default_rng(0).normal(size=(3000, 40))
    across, up, share = column_shares(b, values)
    assert share.shape == (1000, len(up) - 1)
    counts, _, _ = np.histogram2d(np.repeat(b, 40), values.ravel(), (across, up))
    np.testing.assert_allclose(share, counts / 120, rtol=1e-12)


def test_density_of_a_periodic_orbit_and_of_what_is_not_finite():
    values = np.tile([1.0, -1.0, np.nan], (100, 4))
    values[7] = np.nan  # a lane with a non-finite state
    across, _, share = column_shares(np.arange(100.0), values)
    assert np.array_equal(np.unique(share[share > 0]), [0.5])
    assert np.array_equal(share.sum(axis=1), np.arange(100) != 7)
    assert (across[0], across[-1]) == (-0.5, 99.5)


@pytest.mark.parametrize("b", [np.array([2.0]), np.array([1.0, 4.0, 2.0, 2.0])])
def test_density_of_uneven_values(b):
    across, _, share = column_shares(b, np.ones((len(b), 3)))
    assert len(share) == len(np.unique(b))
    assert np.all(share.max(axis=1) == 1.0)
    assert np.all(np.diff(across) > 0)
    assert np.all((across[:-1] < np.unique(b)) & (np.unique(b) < across[1:]))


@pytest.mark.parametrize(("across", "up"), [(1.0, 1.0), (1.3, 0.7), (4.0, 4.0)])
def test_an_orbit_is_seen_at_every_value_however_few_pixels_there_are(across, up):
    """Of a rising orbit each column of pixels has one, in axes of fewer pixels than a density has cells, and of more."""
    figure = Figure((4.0 * across, 3.0 * up), dpi=100)
    canvas, ax = FigureCanvasAgg(figure), figure.add_axes((0.0, 0.0, 1.0, 1.0))
    ax.set_axis_off()
    b = np.linspace(0.0, 1.0, 2000)
    DensityImage(b, np.repeat(0.3 * b[:, None], 20, axis=1), INK, ax)
    canvas.draw()
    inked = np.asarray(canvas.buffer_rgba())[..., :3].min(axis=2) < 200
    assert np.all(inked.any(axis=0))
