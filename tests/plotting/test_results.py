"""Drawings: what is drawn is the data, whole and named; densities against a plain count."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxnh.analyses import ANALYSES
from jaxnh.plotting import results as figures

rng = np.random.default_rng(0)
WORDS = {"x1": "position x1", "x2": "velocity x2 = dx1/dt", "y1": "position y1", "y2": "velocity y2 = dy1/dt"}


def dataset(b, variables, **coords):
    """A group as the store writes it: variables as (dims, data, long_name, units)."""
    named = {
        name: xr.Variable(dims, data, {"long_name": words, "units": units})
        for name, (dims, data, words, units) in variables.items()
    }
    axis = xr.Variable(("b",), np.asarray(b, float), {"long_name": "coupling b", "units": "1"})
    return xr.Dataset(named, coords={"b": axis, **coords})


def states(b, points, dim="strobe"):
    return dataset(b, {name: (("b", dim), rng.normal(size=(len(b), points)), w, "1") for name, w in WORDS.items()})


def exponents(b, count):
    values = rng.normal(size=(len(b), count))
    return dataset(
        b,
        {
            "exponents": (("b", "exponent"), values, "Lyapunov exponents, natural logarithm", "1/time"),
            "exponents_error": (("b", "exponent"), 0.1 + 0 * values, "error", "1/time"),
        },
    )


def doublings(b=(5.52, 5.495, 5.489, np.nan)):
    level = np.arange(1, len(b) + 1)
    delta = np.full(len(b), np.nan)
    delta[1] = 4.1
    table = {"period": 2 ** (level - 1), "b": np.array(b), "delta": delta, "delta_error": 0 * delta}
    return xr.Dataset({name: ("level", data) for name, data in table.items()}, coords={"level": level})


def over_b(name, b):
    """Dataset of an analysis that has one number a b."""
    count = len(b)
    columns = {
        "period": {"period": (("b",), np.resize([0, 1, 2, 4, 24], count), "least period", "forcing periods")},
        "chaos01": {"k": (("b",), np.linspace(0, 1, count), "K", "1"), "k_error": (("b",), np.ones(count), "e", "1")},
        "verdict": {"kind": (("b",), np.resize([0, 2, 0, 3], count), "kind of motion", "1")},
    }
    data = dataset(b, columns[name])
    if name == "verdict":
        data["kind"].attrs |= {"flag_values": np.arange(4), "flag_meanings": "periodic quasiperiodic chaotic undecided"}
    return data


MANY, FEW = np.linspace(6.0, 0.1, 500), np.array([5.8, 2.5, 4.1, 5.3])
DRAWINGS = {
    "portrait": lambda ax: figures.portrait(states(FEW, 64, "time"), 1, ax, strobes=states(FEW, 8)),
    "poincare": lambda ax: figures.poincare(states(FEW, 8), 2, ax),
    "diagram": lambda ax: figures.diagram(states(MANY, 50), ax),
    "few points": lambda ax: figures.diagram(states(FEW, 50), ax),
    "doubling": lambda ax: figures.doubling(doublings(), ax),
    "lyapunov": lambda ax: figures.lyapunov(exponents(MANY, 3), ax),
    "largest": lambda ax: figures.lyapunov(exponents(FEW, 1), ax),
    **{name: lambda ax, name=name: getattr(figures, name)(over_b(name, MANY), ax) for name in ("period", "chaos01")},
    "verdict": lambda ax: figures.verdict(over_b("verdict", MANY), ax),
}


@pytest.mark.parametrize("name", DRAWINGS)
def test_axes_are_returned_and_named(name):
    """Given axes come back; without any, new ones do. Both axes say what they show, and its units where it has any."""
    ax = Figure().subplots()
    assert DRAWINGS[name](ax) is ax
    alone = DRAWINGS[name](None)
    assert isinstance(alone, Axes)
    for axes in (ax, alone):
        assert "(" in axes.get_xlabel()
        assert "(" in axes.get_ylabel() or name == "verdict"
        axes.figure.canvas.draw()


@pytest.mark.parametrize("name", DRAWINGS)
def test_limits_contain_what_is_drawn(name):
    """Every point of every line and the whole of every image lie within the axes."""
    ax = DRAWINGS[name](None)
    ax.figure.canvas.draw()
    (left, right), (low, high) = sorted(ax.get_xlim()), sorted(ax.get_ylim())
    for line in ax.get_lines():
        if line.get_transform() != ax.transData:
            continue  # lines across the axes
        x, y = line.get_data()
        assert np.nanmin(x) >= left
        assert np.nanmax(x) <= right
        assert np.nanmin(y) >= low
        assert np.nanmax(y) <= high
    for image in ax.images:
        x0, x1, y0, y1 = image.get_extent()
        assert (x0, x1) == pytest.approx((left, right))
        assert low <= y0 < y1 <= high


def test_a_diagram_of_many_points_is_an_image():
    many, few = figures.diagram(states(MANY, 50)), figures.diagram(states(FEW, 50))
    assert len(many.images) == 1
    assert not many.lines
    assert not few.images
    assert len(few.lines[0].get_xdata()) == 4 * 50


def test_random_starts_are_all_drawn():
    data = dataset(
        FEW, {name: (("b", "start", "strobe"), rng.normal(size=(4, 5, 6)), w, "1") for name, w in WORDS.items()}
    )
    x, y = figures.diagram(data).lines[0].get_data()
    assert np.array_equal(np.sort(y[x == 2.5]), np.sort(data["x1"].to_numpy()[1].ravel()))


def test_lanes_that_have_all_left_the_numbers_are_drawn():
    figures.diagram(states(MANY, 50) * np.nan).figure.canvas.draw()


def test_doubling_points_are_marked_where_they_are():
    ax = figures.diagram(states(np.linspace(5.6, 5.45, 500), 50), doublings=doublings((5.7, 5.52, 5.489, 5.488)))
    marks = [line.get_xdata()[0] for line in ax.lines]
    assert marks == [5.52, 5.489, 5.488]
    labels = {text.get_text() for text in ax.texts}
    assert {"2 → 4", "4 → 8", "8 → 16"} <= labels
    ax = figures.diagram(states(np.linspace(5.6, 5.45, 500), 50), doublings=doublings((5.52, 5.489, 5.488, 5.4878)))
    assert {"1 → 2", "2 → 4", "… 8 → 16"} <= {text.get_text() for text in ax.texts}


def test_exponents_are_drawn_with_their_error():
    data = exponents(FEW, 2)
    ax = figures.lyapunov(data)
    order = np.argsort(FEW)
    for k, band in enumerate(ax.collections):
        line = ax.lines[k + 1]
        assert np.array_equal(line.get_xdata(), FEW[order])
        assert np.array_equal(line.get_ydata(), data["exponents"].to_numpy()[order, k])
        edge = band.get_paths()[0].vertices
        for i in order:
            heights = edge[edge[:, 0] == FEW[i], 1]
            assert heights.min() == pytest.approx(data["exponents"].to_numpy()[i, k] - 0.1)
            assert heights.max() == pytest.approx(data["exponents"].to_numpy()[i, k] + 0.1)


def test_verdicts_are_counted():
    ax = figures.verdict(over_b("verdict", MANY))
    assert [text.get_text() for text in ax.get_legend().get_texts()] == [
        "periodic: 250",
        "chaotic: 125",
        "undecided: 125",
    ]


def test_values_without_a_period_are_shown_as_such():
    ax = figures.period(over_b("period", MANY))
    labels = [label.get_text() for label in ax.get_yticklabels()]
    assert labels == ["none", "1", "2", "4", "8", "16"]
    assert len(ax.lines[1].get_xdata()) == 100


def test_every_analysis_has_its_picture():
    assert set(figures.PANELS) == set(ANALYSES)


def test_no_jax_is_loaded():
    code = "import sys, jaxnh.figures; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=120).returncode == 0
