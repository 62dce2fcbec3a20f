"""The cost command on a small scene: orders, the mark, the files, and the price of derived quantities."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from jaxnh.costs import exponent, forms
from jaxnh.costs import solvers as costs_of_solvers
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.experiment import load
from jaxnh.solvers import RUNGE_KUTTA, SPLITTINGS
from jaxnh.storage.hdf5 import open_result
from jaxnh.systems.particle import constant_speed
from tests.helpers.batches import batch_of
from tests.helpers.commands import run_here
from tests.helpers.paths import ROOT

TABLE1 = ROOT / "configs" / "table1.yaml"
SMALL = ("sweep.b.count=32", "analyses.doubling.levels=1", "accuracy.target=1e-6", "--repeats", "2")
# The command with a row a Runge–Kutta method, each of which is compiled, and short transients.
FEWER = """
import sys
from jaxnh import cost
from jaxnh.costs import doubling, solvers
solvers._FEW_ROWS = 1
doubling._TRANSIENTS = (100, 1000)
sys.exit(cost.main())
"""
PUBLISHED = 5.519779  # first row of table 1, which comes too early by up to 3e-4 (DESIGN section 3)


def command(*arguments: object) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, *map(str, arguments)], cwd=ROOT, capture_output=True, text=True, timeout=500, check=False
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> tuple[Path, str]:
    """Result file and standard output of one run."""
    path = tmp_path_factory.mktemp("cost") / "small_cost.h5"
    done = command("-c", FEWER, TABLE1, *SMALL, "--output", path)
    assert done.returncode == 0, done.stderr
    return path, done.stdout


@pytest.fixture(scope="module")
def tree(run) -> xr.DataTree:
    return xr.open_datatree(run[0], engine="h5netcdf").load()


@pytest.fixture(scope="module")
def solvers(tree) -> xr.Dataset:
    return tree["solvers"].to_dataset()


def rows(solvers, name, summation="plain"):
    return solvers.isel(
        setting=np.flatnonzero((solvers["method"] == name).to_numpy() & (solvers["summation"] == summation).to_numpy())
    )


def test_solvers_of_a_users_system():
    """Its own method first, then all that go with any flow, each under its name once."""
    flow = load(ROOT / "configs" / "flows" / "duffing_single_well.yaml").flow()
    names = [next(ladder).method for ladder in costs_of_solvers._explicit(flow)]
    assert names[0] == "nystrom8"
    assert len(set(names)) == len(names)
    assert {*RUNGE_KUTTA, "diffrax Tsit5", "diffrax Dopri8 adaptive"} < set(names)
    assert not set(names) & set(SPLITTINGS)


@pytest.mark.usefixtures("quickly_uncalibrated", "quick_compiling_once")
def test_both_forms_of_a_step(tmp_path):
    """Without a clock they are all that is priced: compiling apart, the run for this sweep and for larger ones."""
    path = tmp_path / "lorenz_cost.h5"
    small = [
        "sweep.rho.count=4",
        "accuracy={solver: tsit5, steps: 64}",
        "analyses={lyapunov: {periods: 64, exponents: 1}}",
    ]
    run = run_here(ROOT / "configs" / "flows" / "lorenz.yaml", *small, "--output", path, command="cost")
    assert run.returncode == 0, run.stderr
    assert "solvers are priced on a strobe map, and this scene has no clock: stages alone are" in run.stderr
    assert "Stages of a step in a loop, or written out" in run.stdout
    with open_result(path) as tree:
        data = tree["stages"].to_dataset()
        assert data["stages"].to_numpy().tolist() == ["loop", "written out"]
        assert data["picked"].to_numpy().tolist() == [1, 0]
        assert data["lanes"].to_numpy().tolist() == [4, 40, 400]
        assert np.all(data["compiling"] > 0)
        assert np.all(data["run"] > 0)


def test_solvers_of_one_form_have_none_to_compare(tmp_path):
    """Kicks of the particle are written out, and so cheap to compile that there is no other form."""
    scene = batch_of(constant_speed(), ((0.1, 0.1), (0.1, math.sqrt(0.99))), [5.2], SPLITTINGS["blanes_moan6"], 40)
    assert forms.price(scene, (), LaneExecutor(), 1, 1.0, rolled=False) is None


@pytest.mark.slow
@pytest.mark.parametrize("name", SPLITTINGS)
def test_errors_fall_at_the_order(solvers, name):
    """The last rows above what rounding leaves; what still falls faster has larger terms of higher orders."""
    found = rows(solvers, name)
    error, steps = found["error"].to_numpy(), found["steps"].to_numpy()
    above = np.flatnonzero(error > 1e-10)[-3:]
    assert len(above) == 3
    assert np.all(np.diff(error[above]) < 0)
    order = -np.polyfit(np.log(steps[above]), np.log(error[above]), 1)[0]
    assert order > SPLITTINGS[name].convergence_order - 1.5
    if not SPLITTINGS[name].processor[1]:  # its terms of the first order were made small for this flow
        assert order < SPLITTINGS[name].convergence_order + 1.5


@pytest.mark.slow
def test_every_method_has_a_row(solvers):
    """The solvers of the package that this particle may have, and those of diffrax with constant and adaptive steps."""
    stock = {f"diffrax {name}{kind}" for name in ("Tsit5", "Dopri8") for kind in ("", " adaptive")}
    assert set(solvers["method"].to_numpy()) == {*SPLITTINGS, *RUNGE_KUTTA, *stock}
    assert np.all(solvers["error"] <= 1e-3)
    assert np.all(solvers["seconds_least"] <= solvers["seconds"])
    assert np.all(solvers["seconds"] <= solvers["seconds_largest"])
    assert np.all(solvers["seconds_least"] > 0)


@pytest.mark.slow
def test_written_out_and_stock_are_one_method(solvers):
    """The same tableau on the same steps: equal errors, but for rounding."""
    for written_out, stock in (("tsit5", "diffrax Tsit5"), ("dopri8", "diffrax Dopri8")):
        ours, theirs = rows(solvers, written_out), rows(solvers, stock)
        np.testing.assert_array_equal(ours["steps"], theirs["steps"])
        np.testing.assert_allclose(ours["error"], theirs["error"], rtol=1e-4)


@pytest.mark.slow
def test_compensated_sums_go_below_plain_ones(solvers):
    """Rounding is what ends the rows of plain sums of high order, and compensation lowers it (DESIGN section 3).

    No estimate goes below the 1e-12 that the reference itself is known to.
    """
    for name in ("blanes_moan6", "kahan_li8", "sofroniou_spaletta10"):
        plain, compensated = (rows(solvers, name, *sums)["error"].min() for sums in ((), ("compensated",)))
        assert compensated < max(0.5 * plain, 1e-12)
        assert compensated < plain


@pytest.mark.slow
def test_mark_is_at_the_cheapest(tree, solvers):
    """Among splittings with plain sums, the fewest kicks that meet the target; the engine looks for them to 2%."""
    picked = solvers.isel(setting=np.flatnonzero(solvers["picked"].to_numpy()))
    assert picked.sizes["setting"] == 1
    assert (str(picked["method"].item()), picked["steps"].item()) == (
        tree.attrs["solver"],
        tree.attrs["steps_per_period"],
    )
    target = solvers.attrs["target"]
    assert target == 1e-6
    assert picked["error"].item() <= target
    splittings = np.isin(solvers["method"].to_numpy(), list(SPLITTINGS)) & (solvers["summation"] == "plain").to_numpy()
    meeting = solvers["forces"].to_numpy()[splittings & (solvers["error"].to_numpy() <= target)]
    assert picked["forces"].item() <= 1.02 * meeting.min()


@pytest.mark.slow
def test_projected_time_is_that_of_the_analyses(solvers):
    """Lane-periods that the analyses expect, of lanes padded to whole tiles, times the time of one."""
    work = solvers.attrs["projected_lane_periods"]
    np.testing.assert_allclose(solvers["projected_seconds"], work * solvers["seconds"], rtol=1e-12)
    assert work >= 32 * 512


@pytest.mark.slow
def test_price_of_a_doubling(tree):
    """Detection comes too early and gains with N; both ways by the orbit end at the error of the steps, or below."""
    data = tree["doubling_cost"].to_dataset()
    by = {name: data.isel(estimate=np.flatnonzero((data["method"] == name).to_numpy())) for name in
          ("period detection", "multisection", "interpolation")}  # fmt: skip
    reference = float(data["reference"])
    assert 0 < PUBLISHED - reference < 3e-4
    detected = by["period detection"]
    assert np.all(detected["value"] > reference)
    assert np.all(np.diff(detected["error"]) < 0)
    assert detected["error"].min() > 1e-4
    order = SPLITTINGS[tree.attrs["solver"]].convergence_order
    errors = [
        by[name]["error"][-1] for name in ("multisection", "interpolation")
    ]  # at the scene's steps, and at twice as many
    most = 0.1 * tree["solvers"].attrs["target"]
    assert errors[0] < most
    assert errors[1] < min(2.0 ** (1 - order) * most, errors[0])  # in one lane terms of several orders may cancel
    assert all(np.all(np.diff(by[name]["cpu_seconds"]) >= 0) for name in ("multisection", "interpolation"))
    np.testing.assert_allclose(data["error"], np.abs(data["value"] - reference), atol=1e-15)


@pytest.mark.slow
def test_file_and_figures(run, tree):
    """Provenance at the root, units everywhere, figures beside the file; no figure of what was not asked for."""
    path, out = run
    assert {"title", "config", "cost_of", "jaxnh_version", "device", "wall_seconds"} <= set(tree.attrs)
    assert set(tree.children) == {"solvers", "doubling_cost"}
    for group in tree.children.values():
        for variable in group.variables.values():
            assert variable.attrs["long_name"]
            assert "units" in variable.attrs
    pictures = sorted(path.parent.glob("*.png"))
    assert [picture.name for picture in pictures] == ["small_cost.png", "small_cost_doubling.png"]
    assert all(10_000 < picture.stat().st_size < 1 << 20 for picture in pictures)
    lines = out.splitlines()
    assert [line.split()[0] for line in lines if line.endswith("◀")] == [tree.attrs["solver"]]
    assert "…" not in out  # nothing is cut off at eighty columns
    assert all(part in lines[-2] for part in ("accuracy", "solvers", "doubling", "compile"))


@pytest.mark.slow
def test_price_of_an_exponent(monkeypatch):
    """At the most chaotic b, the error falls as averages do: fourfold over sixteen times the periods, on the whole."""
    for name, value in (("_SEARCHED", 8), ("_LANES", 64), ("_AVERAGED", (16, 256))):
        monkeypatch.setattr(exponent, name, value)
    group = exponent.price(scene(np.linspace(5.3, 5.35, 8)), LaneExecutor())
    assert group is not None
    error = group["error"].to_numpy()[:, 1]
    assert group.attrs["reference_periods"] == 2560
    assert 5.3 <= float(group["value"]) <= 5.35
    assert 0.02 < float(group["reference"]) < 0.5
    assert 2 < error[0] / error[1] < 12
    assert np.all(np.diff(group["cpu_seconds"]) > 0)


def test_no_price_without_chaos(monkeypatch):
    """Before the first doubling every lane is of period one."""
    for name, value in (("_SEARCHED", 8), ("_SEARCH_PERIODS", 64)):
        monkeypatch.setattr(exponent, name, value)
    assert exponent.price(scene(np.linspace(5.6, 5.55, 8)), LaneExecutor()) is None


def scene(values):
    system = constant_speed()
    start = ((0.1, 0.1), (0.1, float(np.sqrt(0.99))))
    return batch_of(system, start, values, SPLITTINGS["blanes_moan6"], 60, error=1e-5)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ((), "command line: CONFIG: "),
        ((TABLE1, "sweep.b.cuont=3"), "command line: sweep.b.cuont: "),
        ((TABLE1, "--repeats", "0"), "command line: "),
        ((TABLE1, "--output", ROOT / "pyproject.toml"), "command line: --output: "),
        ((TABLE1, "--output", ROOT / "results" / "a.png"), "command line: --output: "),
        ((ROOT / "configs" / "none.yaml",), f"{ROOT / 'configs' / 'none.yaml'}"),
    ],
)
def test_bad_input(arguments, line):
    done = run_here(*arguments, command="cost")
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith(line)
