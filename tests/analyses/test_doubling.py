"""Period doublings that the command finds, each against the Taylor reference; δ by its definition and on known series."""

from __future__ import annotations

import functools
import json

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from jaxnh.analyses.cascade.doubling import _deltas
from jaxnh.analyses.cascade.limits import doublings_limit
from jaxnh.engine.experiment import load
from tests.helpers import taylor
from tests.helpers.cases import some_slow
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.usefixtures("always_shared_programs")

FEIGENBAUM = 4.669201609102990  # Briggs, Math. Comp. 57 (1991) 435
TABLES = {"table1": taylor.Parameters(), "table2": taylor.Parameters(d=0.1)}
SMALL = ("accuracy.target=1e-9", "analyses.doubling.levels=3")
OTHERS = {
    "d": ("table2", ("system.d=0.05", "sweep.b={start: 5.75, stop: 5.6, count: 64}"), taylor.Parameters(d=0.05)),
    "c": ("table1", ("system.c=1.1", "sweep.b={start: 5.95, stop: 5.8, count: 64}"), taylor.Parameters(c=1.1)),
    "omega": (
        "table1",
        ("system.omega=1.02", "sweep.b={start: 5.5, stop: 5.3, count: 64}"),
        taylor.Parameters(omega=1.02),
    ),
    "omega, from period 2": (
        "table1",
        ("system.omega=0.95", "sweep.b={start: 5.4, stop: 5.53, count: 64}"),
        taylor.Parameters(omega=0.95),
    ),
    "omega, from period 3": (
        "table1",
        ("system.omega=0.9", "sweep.b={start: 5.722, stop: 5.71, count: 64}", "analyses.doubling.levels=4"),
        taylor.Parameters(omega=0.9),
    ),
    "omega, disturbed": (
        "table2",
        ("system.omega=2", "sweep.b={start: 1.5, stop: 1.9, count: 64}", "analyses.doubling.levels=2"),
        taylor.Parameters(d=0.1, omega=2),
    ),
    "upwards": ("table1", ("sweep.b={start: 5.45, stop: 5.6, count: 64}",), taylor.Parameters()),
}


def doubling(path):
    """The group of a result file, loaded."""
    with xr.open_datatree(path, engine="h5netcdf") as tree:
        return tree["doubling"].to_dataset().load()


def published(name):
    return load(ROOT / "configs" / f"{name}.yaml").compare["doubling"].columns()["b"]


@functools.cache
def exact(name, levels=6):
    """b of the first doublings of a table by the reference, which needs the paper's values as guesses only."""
    return np.array([b for b, _, _ in taylor.cascade(TABLES[name], published(name)[:levels])])


RUNS = {  # overrides, and levels that are held against the reference, of which the last two take it most of its time
    "table1, few values": ("table1", ("sweep.b.count=64",), 4),
    "table1": ("table1", (), 6),
    "table2": ("table2", (), 6),
}


@pytest.fixture(scope="module", params=some_slow({name: (run,) for name, run in RUNS.items()}, "table1, few values"))
def table(request, result):
    """Name and overrides of a config of the paper's tables, result file and terminal output of its run as a user runs
    it, and its first doublings by the reference."""
    name, overrides, levels = request.param
    path, out, _ = result(f"{name}_{len(overrides)}", ROOT / "configs" / f"{name}.yaml", *overrides)
    return name, overrides, path, out, exact(name, levels)


# ---- the two tables


def check_table(path, exact):
    """Every b to 1e-9 and within its own error, which is no excuse: below 1e-10, as the map's is."""
    group = doubling(path)
    np.testing.assert_array_equal(group["period"], [1, 2, 4, 8, 16, 32])
    difference = np.abs(group["b"].values[: len(exact)] - exact)
    assert np.all(difference < 1e-9)
    assert np.all(difference <= group["b_error"].values[: len(exact)])
    assert np.all(group["b_error"].values < 1e-10)


def test_tables_of_the_paper(table):
    *_, path, _, exact = table
    check_table(path, exact)


def test_errors_say_what_was_achieved(table):
    """No more than some twenty times the error, against the reference: a bound of about eight, and rounding."""
    *_, path, _, exact = table
    group = doubling(path)
    achieved = np.abs(group["b"].values[: len(exact)] - exact)
    assert np.median(group["b_error"].values[: len(exact)] / achieved) < 20


@pytest.mark.parametrize("levels", [4, pytest.param(6, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", TABLES)
def test_kept_results(name, levels):
    path = ROOT / "results" / f"{name}.h5"
    check_table(path, exact(name, levels))
    with xr.open_datatree(path, engine="h5netcdf") as tree:
        assert tree.attrs["config_sha256"] == load(ROOT / "configs" / f"{name}.yaml").sha256


def test_paper_is_off_by_its_transients(table):
    """The paper's six decimals are early by up to 3e-4, less with each level (DESIGN section 3): ours are not copies."""
    name, _, path, *_ = table
    early = published(name) - doubling(path)["b"].values
    assert 1e-4 < early[0] < 3e-4
    assert np.all(np.diff(np.abs(early)) < 0)


def test_delta_is_that_of_the_definition(table):
    """(14) at the middle level, none at the ends; and within its error of δ from the reference's b."""
    *_, path, _, exact = table
    group = doubling(path)
    b, delta = group["b"].values, group["delta"].values
    assert np.isnan(delta[[0, -1]]).all()
    for k in range(1, 5):
        assert delta[k] == pytest.approx((b[k] - b[k - 1]) / (b[k + 1] - b[k]), rel=1e-14)
    truth, known = (exact[1:-1] - exact[:-2]) / (exact[2:] - exact[1:-1]), np.s_[1 : len(exact) - 1]
    assert np.all(np.abs(delta[known] - truth) <= group["delta_error"].values[known])
    # No wider than twice the last step of δ: corrections fall at least by half a level (theory: by δ, and by −8), so
    # that what is left is no more than that step. Those of α fall by −1/α: of one as large as the first width, the
    # five widths here leave 0.4⁴ = 0.026, and an interval has it on both sides of it. Briggs' numbers.
    widest = 2 * abs(delta[4] - delta[3])
    assert abs(group["delta_limit"] - FEIGENBAUM) <= group["delta_limit_error"] < widest
    assert abs(group["alpha"] - 2.502907875) <= group["alpha_error"] < 0.05


def test_root_attributes(table):
    """All that section 5 of the design promises, and the error estimate meets the target."""
    name, overrides, path, *_ = table
    experiment = load(ROOT / "configs" / f"{name}.yaml", overrides)
    with xr.open_datatree(path, engine="h5netcdf") as tree:
        attrs, units = tree.attrs, {key: variable.attrs for key, variable in tree["doubling"].variables.items()}
    assert attrs["title"] == experiment.title
    assert attrs["Conventions"].startswith("CF-")
    assert f"configs/{name}.yaml" in attrs["history"]
    assert attrs["config"] == experiment.text
    assert overrides or attrs["config"] == (ROOT / "configs" / f"{name}.yaml").read_text()
    assert attrs["config_sha256"] == experiment.sha256
    assert {"jax", "diffrax", "numpy"} <= set(json.loads(attrs["versions"]))
    assert attrs["error_estimate"] <= experiment.accuracy.target
    assert attrs["lane_periods"] >= len(experiment.axes[0].values) * 512  # every lane went through the transient
    assert attrs["steps_per_period"] > 0
    assert attrs["wall_seconds"] > 0
    assert {"jaxnh_version", "solver", "device"} <= set(attrs)
    assert set(units) >= {"level", "period", "b", "b_error", "delta"}
    assert all(about["long_name"] and about["units"] for about in units.values())


def test_terminal_says_what_the_file_says(table):
    """Every b with all its digits, also in a log, and the limit of δ."""
    *_, path, out, _ = table
    group = doubling(path)
    for b in group["b"].values:
        assert f"{b:.12f}" in out
    assert f"δ → {float(group['delta_limit']):.4f}"[:-1] in out  # as many digits as its error has a say in
    assert str(path) in out.replace("\n", "")


# ---- other systems


@pytest.mark.parametrize(("config", "overrides", "par"), some_slow(OTHERS, "omega, from period 2"))
def test_other_systems(result, request, config, overrides, par):
    """Other parameters, periods of the forcing, first periods and directions of the sweep: as the reference has them."""
    name = request.node.callspec.id.replace(",", "").replace(" ", "_")
    path, _, err = result(name, ROOT / "configs" / f"{config}.yaml", *SMALL, *overrides)
    group = doubling(path)
    b, first = group["b"].values, int(group["period"].values[0])
    assert np.isfinite(b).all()
    assert "warning" not in err
    before = b[0] - (b[1] - b[0] if len(b) > 1 else 0.02) / 2
    difference = np.abs(b - [float(point) for point, _, _ in taylor.cascade(par, b, first=first, before=before)])
    assert np.all(difference < 1e-9)
    assert np.all(difference <= group["b_error"].values)
    np.testing.assert_array_equal(group["period"].values, first * 2 ** np.arange(len(b)))


# ---- ranges with fewer doublings than asked for


def test_fewer_doublings_than_asked_for(result):
    """The sweep ends before the third: two doublings, then NaN, and what was searched, on the terminal and in the file."""
    overrides = (*SMALL, "analyses.doubling.search=false", "sweep.b={start: 5.6, stop: 5.4935, count: 64}")
    path, out, err = result("fewer", ROOT / "configs" / "table1.yaml", *overrides)
    group = doubling(path)
    assert np.all(np.abs(group["b"].values[:2] - exact("table1", 4)[:2]) < 1e-9)
    for variable in ("b", "b_error"):
        np.testing.assert_array_equal(np.isnan(group[variable].values), [False, False, True])
    np.testing.assert_array_equal(group["period"].values, [1, 2, 4])
    assert np.isnan(group["delta"].values).all()
    assert np.isnan(group["delta_limit"])
    assert group["levels_found"] == 2
    (first, second) = group.attrs["warnings"].split("\n")
    assert first.startswith("doubling: 2 of 3 levels found; 4 → 8 was not located between b = 5.4955247")
    assert first.endswith(" and 5.4935")
    assert second.startswith("doubling: periods seen along b: 1 at 5.6 to 5.5")
    assert "; tried: 1 → 2 down from 5.5" in second
    for line in (first, second):
        assert f"warning: {line}" in err
    assert "nan" not in out


@pytest.mark.slow  # doublings within it are quick
def test_doublings_beyond_the_sweep(result):
    """The same sweep where looking beyond it is allowed, as it is by default: all three, and it says where they are."""
    overrides = (*SMALL, "sweep.b={start: 5.6, stop: 5.4935, count: 64}")
    path, _, err = result("beyond", ROOT / "configs" / "table1.yaml", *overrides)
    group = doubling(path)
    assert np.all(np.abs(group["b"].values - exact("table1", 4)[:3]) < 1e-9)
    assert group.attrs["warnings"] == "doubling: doublings were found beyond the sweep, which is b = 5.6 to 5.4935"
    assert group.attrs["warnings"] in err


def test_no_doubling_at_all(result):
    """One period all the way: NaN, and a warning that says what was seen; not a failure."""
    overrides = (*SMALL, "analyses.doubling.search=false", "sweep.b={start: 5.6, stop: 5.55, count: 64}")
    path, out, err = result("none", ROOT / "configs" / "table1.yaml", *overrides)
    group = doubling(path)
    assert np.isnan(group["b"].values).all()
    assert np.isnan(group["delta"].values).all()
    assert group["levels_found"] == 0
    (first, second) = group.attrs["warnings"].split("\n")
    assert first == "doubling: 0 of 3 levels found; no doubling was located between b = 5.6 and 5.55"
    assert second == (
        "doubling: periods seen along b: 1 at 5.6 to 5.55; tried: nothing, as no period ends between two values of b"
    )
    assert f"warning: {second}" in err
    assert "nan" not in out


@pytest.mark.slow
def test_one_doubling_of_an_orbit_of_period_two(result):
    """The doubling 2 → 4 at b = 1.7 (`test_other_systems` finds it when asked for two), asked for alone."""
    overrides = ("accuracy.target=1e-9", "system.omega=2", "sweep.b={start: 1.5, stop: 1.9, count: 64}")
    path, _, _ = result("one", ROOT / "configs" / "table2.yaml", *overrides, "analyses.doubling.levels=1")
    assert doubling(path)["period"].values.tolist() == [2]
    assert np.isfinite(doubling(path)["b"].values).all()


@pytest.mark.slow  # a first period of two, and doublings beyond the sweep, are quick
def test_doubling_in_a_wide_bracket(result):
    """Values before and after the doubling 3 → 6 of a window, and nothing between: it is there by the reference."""
    par, ends = taylor.Parameters(omega=0.9), (5.722, 5.7145)
    points = taylor.orbit(par, 3, ends[0], taylor.attractor(par, ends[0], par.start(), 900)[0])
    for b in np.linspace(*ends, 12)[:-1]:
        points = taylor.periodic_orbit(par, 3, b, points)
    exact = taylor.doubling_point(par, 3, b, points[0])[0]
    overrides = ("accuracy.target=1e-9", "system.omega=0.9", f"sweep.b={{values: {list(ends)}}}")
    path, _, _ = result("wide", ROOT / "configs" / "table1.yaml", *overrides, "analyses.doubling.levels=2")
    assert abs(doubling(path)["b"].values[0] - exact) < 1e-9


# ---- cascades that a survey hides


def check_doublings(par, group, place):
    """Every doubling by the reference, from an orbit of the reference's own at a value before the first one.

    The attractor there is found by a plain transient; each later orbit is met midway to its doubling, as `taylor.cascade`
    does. Values of the analysis serve as guesses only: Newton of the reference moves them to its own.
    """
    b, first = group["b"].values, int(group["period"].values[0])
    assert np.isfinite(b).all()
    exact = taylor.cascade(par, b, first=first, before=place)
    difference = np.abs(b - np.array([float(value) for value, _, _ in exact]))
    assert np.all(difference <= group["b_error"].values)
    assert np.all(difference < 1e-9)


HIDDEN = {
    "the longest chain is a jump": ((), "sweep.b={start: 3.9, stop: 6, count: 182}", taylor.Parameters(), 5.53),
    "one lane before chaos": ((), "sweep.b={start: 5.4885, stop: 5.40, count: 64}", taylor.Parameters(), 5.4885),
}


@pytest.mark.slow
@pytest.mark.parametrize(("system", "values", "par", "place"), HIDDEN.values(), ids=HIDDEN)
def test_hidden_cascades(result, request, system, values, par, place):
    """A longer chain of runs that is none; 8 → 16 between one lane and the next."""
    name = request.node.callspec.id.replace(" ", "_")
    path, _, err = result(name, ROOT / "configs" / "table1.yaml", *SMALL, *system, values)
    assert "warning" not in err
    check_doublings(par, doubling(path), place)


@pytest.mark.slow
def test_further_down_a_hidden_cascade(result):
    """A cascade of period 12 to 96 → 192, of whose periods above 24 no survey has a lane."""
    values = "sweep.b={start: 4.3605, stop: 4.3545, count: 48}"
    levels = ("accuracy.target=1e-9", "analyses.doubling.levels=4", "system.a=0.3")
    path, _, err = result("further_down", ROOT / "configs" / "table1.yaml", *levels, values)
    assert "warning" not in err
    group = doubling(path)
    assert group["period"].values.tolist() == [12, 24, 48, 96]
    check_doublings(taylor.Parameters(a=0.3), group, 4.3605)
    assert abs(group["delta_limit"] - FEIGENBAUM) <= group["delta_limit_error"]


@pytest.mark.slow
def test_the_whole_range_of_b(result):
    """b from 0.1 to 6 in 512 values: six doublings of period 1 where the paper's are, or of another cascade as deep."""
    overrides = ("accuracy.target=1e-9", "sweep.b={start: 0.1, stop: 6, count: 512}")
    path, _, err = result("whole", ROOT / "configs" / "table1.yaml", *overrides)
    group = doubling(path)
    assert "warning" not in err
    assert group["period"].values[0] == 1
    assert np.all(np.abs(group["b"].values - exact("table1")) <= group["b_error"].values)


@pytest.mark.slow
def test_the_example_of_the_readme(result):
    """At d = 0.05 the cascade lies beyond the config's range: it is found there, and the paper's d = 0.1 stays away."""
    overrides = (*SMALL, "system.d=0.05", "sweep.b.count=64")
    path, out, err = result("example", ROOT / "configs" / "table2.yaml", *overrides)
    check_doublings(taylor.Parameters(d=0.05), doubling(path), 5.72)
    assert "warning: doubling: doublings were found beyond the sweep, which is b = 5.9 to 5.72" in err
    assert "b, paper" not in out
    assert "no values of paper beside these, which are of another system: d is 0.05 here, 0.1 there" in out.replace(
        "\n", " "
    )


# ---- δ on known series


@given(st.floats(2, 10), st.floats(-1, 1).filter(lambda c: abs(c) > 0.1), st.floats(-5, 5))
def test_delta_of_a_geometric_series(ratio, c, limit):
    """b_k = b∞ + c δ⁻ᵏ: every quotient of distances is δ, to the cancellation in the distances."""
    b = limit + c * ratio ** -np.arange(6.0)
    delta, error = _deltas(b, np.full(6, 1e-16))
    gaps = np.abs(np.diff(b))
    rounding = 4 * np.finfo(float).eps * (np.abs(b).max() + 1) / np.minimum(gaps[:-1], gaps[1:])
    assert np.all(np.abs(delta[1:-1] / ratio - 1) < rounding)
    assert np.isnan(delta[[0, -1]]).all()
    assert np.isnan(error[[0, -1]]).all()
    assert np.all(error[1:-1] > 0)


@given(st.integers(0, 2**32 - 1))
def test_delta_error_covers_errors_of_b(seed):
    """No shift of the b within their errors moves δ by more than its error, to first order in the errors."""
    rng = np.random.default_rng(seed)
    b = 5 + 4.67 ** -np.arange(5.0) * rng.uniform(0.9, 1.1, 5)
    b_error = rng.uniform(0, 1e-7, 5)
    delta, error = _deltas(b, b_error)
    for _ in range(20):
        moved, _ = _deltas(b + b_error * rng.choice([-1, 1], 5), b_error)
        assert np.all(np.abs(moved - delta)[1:-1] <= 1.001 * error[1:-1] + 1e-12)


CASCADES = {
    # Doublings of x → r x (1 − x), published to these digits in many places.
    "logistic map": [3, 3.449489742783178, 3.544090359551922, 3.564407266095432, 3.568759419543826, 3.569691609801401],
    # The cascade 3, 6, 12, … of the particle with a = 0.3, whose first levels are far from the law.
    "a = 0.3": [4.397020433118, 4.374274624529, 4.359783337793, 4.356175457585, 4.355451099702, 4.355302653479],
    # A user's system, whose δ overshoot: an extrapolation with one ratio gave 4.6649 ± 4e-5.
    "governor": np.cumsum([0, *np.cumprod([1, *1 / np.array([4.859085, 4.526362, 4.662729, 4.664911])])]),
}


@pytest.mark.parametrize("name", CASCADES)
def test_limit_is_feigenbaums(name):
    """From any levels on end of a cascade that are four or more; digits are those that are given."""
    assert windows_that_miss(np.array(CASCADES[name]), np.full(6, 1e-12)) == []


@pytest.mark.parametrize("name", TABLES)
def test_limit_of_kept_results_is_feigenbaums(name):
    """The same of the paper's cascades."""
    group = doubling(ROOT / "results" / f"{name}.h5")
    assert windows_that_miss(group["b"].values, np.full(6, 1e-14)) == []


def windows_that_miss(values, errors):
    """Ends of the levels whose limit of δ is farther from Feigenbaum's than its error."""
    ends = [(i, k) for i in range(len(values)) for k in range(i + 4, len(values) + 1)]
    limits = [doublings_limit(values[i:k], errors[i:k]) for i, k in ends]
    return [
        at for at, found in zip(ends, limits, strict=True) if not abs(found.ratio - FEIGENBAUM) <= found.ratio_error
    ]
