"""sweeps/studies/dysts_flows.py: a stranger's class as a user's file, and its run in a process."""

from __future__ import annotations

import numpy as np

from jaxnh.engine.experiment import load
from sweeps.studies.dysts_flows import independent_spectra, run, scene, write_case
from tests.helpers.dysts_package import publish

REST = "accuracy: {target: 1.0e-8}\nanalyses:\n  portrait: {transient: 16, periods: 4}\n"


def test_flows_are_experiments(tmp_path, monkeypatch):
    """Both ways that dysts writes a flow: of components, and a method of a vector with others beside it."""
    flows = publish(tmp_path, monkeypatch)
    assert {name: len(flow.coordinates) for name, flow in flows.items()} == {"Roessler": 3, "Swing": 2, "Burst": 1}
    loaded = {name: load(write_case(tmp_path / name, flow.source, scene(flow) + REST)) for name, flow in flows.items()}
    for name, experiment in loaded.items():
        assert experiment.flow().coordinates == flows[name].coordinates
        assert experiment.sweep.lanes == 1
    swing, burst = loaded["Swing"].flow(), loaded["Burst"].flow()
    state = swing.chart.state(np.array([0.5, 0.1]))
    np.testing.assert_allclose(np.ravel(swing.rhs(0.0, state, {"k": 2.0}).y), [0.1, -2.0 * np.sin(0.5)], rtol=1e-15)
    assert float(np.ravel(burst.rhs(0.0, burst.chart.state(np.array([3.0])), {"k": 2.0}).y)[0]) == 18.0


def test_a_run_that_is_too_long_has_no_answer(tmp_path):
    system = "def system(k=1.0):\n    while True:\n        pass\n"
    config = write_case(tmp_path / "a", system, "system: {file: sys.py}\nsweep: {k: {values: [1.0]}}\n" + REST)
    answer = run(config, tmp_path / "a.h5", tmp_path / "cache", 0.5)
    assert answer.code == 124
    assert answer.text == "no answer in 0.5 s"


def test_independent_spectra_are_whole():
    for name, spectrum in independent_spectra().items():
        assert len(spectrum["mean"]) == len(spectrum["error"]), name
