"""sweeps/studies/reference_flows.py: the table of a few flows and a map, of one that fails, and runs that go on."""

from __future__ import annotations

import math

import numpy as np
import pytest
import xarray as xr

from sweeps.studies import reference_flows
from sweeps.studies.dysts_flows import Answer
from sweeps.studies.reference_flows_page import page, with_error
from sweeps.studies.reference_flows_table import LONGER, MOTIONS, RECORD, RUNS
from tests.helpers.commands import run_here
from tests.helpers.dysts_package import publish


@pytest.fixture
def study(tmp_path, monkeypatch):
    """The study of a package like dysts and of the logistic map, by short runs in this process: what has been run."""
    publish(tmp_path, monkeypatch)
    runs = []

    def run(config, output, cache, limit):
        runs.append(config.parent.name)
        done = run_here(config, "--output", output, "--fresh")
        return Answer(done.returncode, 1.5, done.stdout + done.stderr)

    for name, value in {
        "FOLDER": tmp_path / "work", "TABLE": tmp_path / "table.h5", "PAGE": tmp_path / "page.md", "run": run,
        "MAPS": {"logistic": {"r": 4.0}}, "_TRANSIENT": 64, "_PERIODS": 256, "_ITERATES": 4096,
    }.items():  # fmt: skip
        monkeypatch.setattr(reference_flows, name, value)
    return runs


def table(folder):
    """The table as any reader has it."""
    with xr.open_dataset(folder / "table.h5", group="flows", engine="h5netcdf") as data:
        return data.load()


@pytest.mark.slow  # runs that go on have a table, too
def test_table_and_page(study, tmp_path):
    """Against closed forms: ln 2, a divergence of zero, the sum of Roessler's exponents, and a flow that is refused."""
    reference_flows.main([])
    data = table(tmp_path)
    assert data["flow"].to_numpy().tolist() == ["Burst", "logistic", "Roessler", "Swing"]
    assert data["is_map"].to_numpy().tolist() == [0, 1, 0, 0]
    words = [RUNS[code] for code in data["status"].to_numpy()]
    assert words == ["refused", "ok", "ok", "ok"]
    assert "one coordinate without a clock" in str(data["message"].to_numpy()[0])
    value, error = data["exponents"].to_numpy(), data["exponents_error"].to_numpy()
    assert np.isnan(value[0]).all()
    assert np.isfinite(value[1:]).sum(axis=1).tolist() == [1, 3, 2]
    assert abs(value[1, 0] - math.log(2.0)) < error[1, 0] < 0.01
    assert abs(value[2, 0] - 0.0714) < error[2, 0] < 0.03  # Sprott, Chaos and Time-Series Analysis, 2003
    assert 2.0 < data["kaplan_yorke"].to_numpy()[2] < 2.03
    assert (np.abs(data["sum_rule_residual"].to_numpy()[1:]) < 1e-3).all()
    assert [MOTIONS[k] for k in data["motion"].to_numpy()[1:3]] == ["chaotic", "chaotic"]
    assert (data["error_estimate"].to_numpy()[1:] <= 1e-8).all()
    text = (tmp_path / "page.md").read_text()
    assert "3 of 4 have an answer" in text
    assert "| Burst | refused |" in text
    assert "**0.15** | – |" in text
    assert "Measured at commit" in text


def test_runs_go_on(study, tmp_path):
    """A case that was killed leaves no record and runs anew, with others' results as they are; so does a changed one."""
    reference_flows.main(["logistic", "Burst"])
    assert study == ["logistic", "Burst"]
    (tmp_path / "work" / "logistic" / RECORD).unlink()
    reference_flows.main(["logistic", "Burst"])
    assert study == ["logistic", "Burst", "logistic"]
    assert table(tmp_path).sizes["flow"] == 2
    case, folder = reference_flows.cases()["Burst"], tmp_path / "work" / "Burst"
    assert reference_flows.run_case(folder, case.source, case.configs, 1.0) == "done before"
    assert reference_flows.run_case(folder, case.source + "\n", case.configs, 1.0).startswith("2 in")
    with pytest.raises(SystemExit):
        reference_flows.main(["Rössler"])


@pytest.mark.slow  # runs that go on are quick
def test_what_does_not_end_has_a_short_run(study, tmp_path, monkeypatch):
    late, begun = Answer(124, 9.0, "no answer in 9 s"), reference_flows.run
    monkeypatch.setattr(reference_flows, "run", lambda *a: late if "periods: 256" in a[0].read_text() else begun(*a))
    reference_flows.main(["Roessler"])
    assert table(tmp_path)["averaging_periods"].to_numpy().tolist() == [512.0]
    monkeypatch.setattr(reference_flows, "run", lambda *a: late)
    reference_flows.main(["Roessler", "--again"])
    assert RUNS[int(table(tmp_path)["status"][0])] == "timed_out"
    assert "no answer in 9 s" in (tmp_path / "page.md").read_text()


@pytest.mark.slow  # runs that go on are quick
def test_longer_runs_say_what_bars_cover(study, tmp_path):
    reference_flows.main(["Swing", "--longer", "1"])
    assert study == ["Swing", LONGER]
    data = table(tmp_path)
    data["exponents"][0], data["exponents_error"][0] = [0.1, -0.1], [0.01, 0.02]
    data["longer_exponents"][0], data["longer_exponents_error"][0] = [0.105, -0.14], [0.001, 0.001]
    text = page(data)
    assert "Of their 2 exponents that have a bar, 1 (50.0 %) are within it" in text
    assert "Swing λ2 (2.0 bars)" in text


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (0.905612, 0.002234, "0.9056(22)"),
        (0.0, 0.0, "0"),
        (-14.57294, 0.0024, "-14.5729(24)"),
        (3.03187e-6, 2.1e-8, "3.032(21)e-6"),
        (math.nan, 0.1, "–"),
        (12787.3, 130.0, "1.279(13)e4"),
        (0.00996, 0.000996, "0.0100(10)"),
    ],
)
def test_numbers_have_their_errors_in_brackets(value, error, text):
    assert with_error(value, error) == text
