"""Words, symbols and units of variables: symbols are made of names, never read out of words."""

import pytest
import xarray as xr
from matplotlib.mathtext import MathTextParser

from jaxnh.plotting.labels import axis_label, symbol_of, words_of


@pytest.mark.parametrize(
    ("name", "symbol"),
    [
        ("b", "$b$"),
        ("x1", "$x_1$"),
        ("q_12", "$q_{12}$"),
        ("x_dot", r"$\dot{x}$"),
        ("q1_dot", r"$\dot{q_1}$"),
        ("theta", r"$\theta$"),
        ("theta_dot", r"$\dot{\theta}$"),
        ("omega0", r"$\omega_0$"),
        ("drive", r"$\mathrm{drive}$"),
        ("spring_rate_2", r"$\mathrm{spring\_rate\_2}$"),
        ("arm_dot", r"$\dot{\mathrm{arm}}$"),
    ],
)
def test_symbols(name, symbol):
    assert symbol_of(name) == symbol
    MathTextParser("agg").parse(symbol)  # raises where matplotlib cannot write it


def test_an_index():
    assert [symbol_of("exponents", 1), symbol_of("x1", "k")] == ["$λ_1$", "$x_{1,k}$"]


@pytest.mark.parametrize(
    ("name", "long_name", "units", "words", "label"),
    [
        ("b", "coupling b", "1", "coupling", "coupling $b$ (dimensionless)"),
        ("x2", "velocity x2 = dx1/dt", "m/s", "velocity", "velocity $x_2$ (m/s)"),
        ("drive", "parameter drive", "1", "parameter", r"parameter $\mathrm{drive}$ (dimensionless)"),
        ("period", "least period", "crossings", "least", r"least $\mathrm{period}$ (crossings)"),
        ("period", "least period, or none", "crossings", "least period, or none", "least period, or none (crossings)"),
        ("n", "position", "1", "position", "position $n$ (dimensionless)"),  # no letter of the words is its name
        ("rate_of_turn", "rate_of_turn", "1/s", "", r"$\mathrm{rate\_of\_turn}$ (1/s)"),
        ("gain", None, None, "", r"$\mathrm{gain}$"),
    ],
)
def test_labels(name, long_name, units, words, label):
    given = {"long_name": long_name, "units": units}
    variable = xr.DataArray(0.0, name=name, attrs={key: value for key, value in given.items() if value is not None})
    assert words_of(variable) == words
    assert axis_label(variable) == label


def test_other_words():
    variable = xr.DataArray(0.0, name="k", attrs={"long_name": "growth rate of the walk", "units": "1"})
    assert axis_label(variable, "0–1 test") == "0–1 test (dimensionless)"
    assert axis_label(variable, "0–1 test", "$K$") == "0–1 test $K$ (dimensionless)"
    assert axis_label(variable, "0–1 test, $K$", "$k_1$") == "0–1 test, $K$ (dimensionless)"
