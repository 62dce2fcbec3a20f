"""Figures of what accuracy costs: their labels are of the parameter that is swept, and of the units of the data."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from jaxnh.exceptions import ResultError
from jaxnh.plotting import costs
from tests.helpers.hand_made_results import dataset


def price_of_a_doubling():
    method = np.array(["period detection"] * 2 + ["multisection"] * 2 + ["interpolation"] * 2)
    variables = {
        "method": (("estimate",), method, "method", "1"),
        "effort": (("estimate",), np.array([100, 1000, 1, 2, 0, 1]), "work", "1"),
        "value": (("estimate",), np.full(6, 5.5), "gain at the doubling", "V"),
        "error": (("estimate",), np.array([1e-3, 3e-4, 1e-4, 1e-7, 1e-6, 0.0]), "distance", "V"),
        "cpu_seconds": (("estimate",), np.linspace(0.1, 3, 6), "time", "s"),
        "period": ((), np.array(2), "period", "1"),
        "reference": ((), np.array(5.5196209), "gain at the doubling", "V"),
    }
    return dataset({}, variables)


def price_of_an_exponent():
    quantiles = np.array([[1, 2, 3], [0.4, 0.5, 0.6]]) * 1e-2
    variables = {
        "averaging_periods": (("averaging_periods",), np.array([16, 256]), "averaging time", "crossings"),
        "error": (("averaging_periods", "quantile"), quantiles, "error", "1/s"),
        "error_bar": (("averaging_periods", "quantile"), 2 * quantiles, "error bar", "1/s"),
        "cpu_seconds": (("averaging_periods",), np.array([0.1, 1.2]), "time", "s"),
        "value": ((), np.array(5.3), "gain of the lanes", "V"),
        "lanes": ((), np.array(64), "number of lanes", "1"),
        "reference": ((), np.array(0.1), "mean of a longer run", "1/s"),
    }
    return dataset({}, variables, reference_periods=2560)


def price_of_solvers():
    numbers = {
        "error": [1e-5, 1e-8],
        "seconds": [1e-6, 3e-6],
        "seconds_least": [9e-7, 2e-6],
        "seconds_largest": [2e-6, 4e-6],
    }
    variables = {name: (("setting",), np.array(data), name, "1") for name, data in numbers.items()}
    variables["method"] = (("setting",), np.array(["blanes_moan6", "diffrax Dopri8 adaptive"]), "solver", "1")
    variables["summation"] = (("setting",), np.array(["plain", "plain"]), "sums", "1")
    variables["steps"] = (("setting",), np.array([60, 0]), "steps", "1")
    variables["picked"] = (("setting",), np.array([1, 0]), "picked", "1")
    return dataset({}, variables, target=1e-6)


@pytest.mark.parametrize(("axes", "symbol"), [("gain mass", r"\mathrm{gain}"), ("b", "b")])
def test_a_doubling_is_of_the_first_axis(axes, symbol):
    ax = costs.doubling(price_of_a_doubling().assign_attrs(axes=axes))
    assert ax.get_ylabel() == f"error of the doubling point $|{symbol} - {symbol}^*|$ (V)"
    assert ax.get_title() == f"period 2 → 4 at ${symbol}^*$ = 5.519620900000"
    assert ax.get_legend().get_texts()[-1].get_text() == f"interpolation of det(M + 1) in ${symbol}$"
    ax.figure.draw_without_rendering()


def test_an_exponent_has_the_units_of_its_data():
    ax = costs.exponent(price_of_an_exponent().assign_attrs(axes="gain"))
    assert ax.get_xlabel() == "averaging time $N$ (crossings)"
    assert ax.get_ylabel() == "error of $λ_1$ (1/s)"
    assert ax.get_legend().get_title().get_text().startswith(r"$\mathrm{gain}$ = 5.3, $λ_1$ = 0.1000; median of 64")
    ax.figure.draw_without_rendering()


def test_a_figure_a_group(tmp_path):
    groups = {
        "solvers": price_of_solvers(),
        "doubling_cost": price_of_a_doubling(),
        "lyapunov_cost": price_of_an_exponent(),
    }
    tree = xr.DataTree.from_dict(groups)
    tree.attrs = {"title": "Prices", "jaxnh_version": "0.1.0", "device": "cpu", "axes": "gain"}
    path = tmp_path / "cost.h5"
    tree.to_netcdf(path, engine="h5netcdf")
    drawn = costs.figures(path)
    assert list(drawn) == ["", "_doubling", "_lyapunov"]
    assert r"$\mathrm{gain}^*$" in drawn["_doubling"].axes[0].get_title()
    for name, drawing in drawn.items():
        assert drawing.get_suptitle() == "Prices"
        drawing.savefig(tmp_path / f"cost{name}.png")


def test_a_bad_file(tmp_path):
    with pytest.raises(ResultError, match=r"none\.h5"):
        costs.figures(tmp_path / "none.h5")
