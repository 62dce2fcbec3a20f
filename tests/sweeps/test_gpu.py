"""sweeps/timing/gpu.py on a CPU: a scene, the benchmark's row, and the page that says that no card was at hand."""

from __future__ import annotations

import sys

import pytest

from jaxnh.solvers import SPLITTINGS
from sweeps.peers.particle import peers_jaxnh
from sweeps.timing import gpu

TINY = gpu.SMALL._replace(lanes=(8,), spectra=8, orbits=8, charts=(4,), levels=(5, 2), basins=4)


@pytest.mark.slow  # `test_programs_of_analyses` has kernels of Newton's steps
def test_newton_and_the_page():
    *_, (name, content) = gpu.scenes_of(TINY)
    scene = gpu.measured_scene(name, content)
    assert scene.lanes == 8
    assert 0 < scene.compiling < scene.seconds
    assert scene.memory > 1 << 26
    made = gpu.MapRow("lorenz", 1e-6, 8, "ours", 200.0, "theirs", 100.0)
    agreed = [gpu.AgreementRow("exponents", 3, 0, 1e-9, 1.0)]
    text = gpu.page("a processor", [made], [scene], agreed, [gpu.BenchmarkRow(8, 1.0, 2.0)], small=True)
    assert "| exponents | 3 | 0 | 1e-09 | 100 % |" in text
    assert "No graphics card was at hand" in text
    assert "| lorenz | 1e-06 | 8 | ours | 200 | theirs | 100 | 2 |" in text
    assert "there is no row to hand in" in text
    assert "Measured at commit" in text


def test_scenes_are_configs():
    for _, content in gpu.scenes_of(gpu.FULL):
        assert gpu.jaxnh.Experiment.from_dict(content).analyses


def test_a_rate_counts_what_is_done_after_the_first_run():
    calls = []

    def run():
        calls.append(None)
        return 3.0

    assert gpu.rate_of(run, 0.0) > 0
    assert len(calls) == 2


@pytest.mark.slow
def test_all_of_it(tmp_path, monkeypatch):
    """In a minute: both programs reach the error, and every scene and row is on the page.

    Of the flows the particle, by two splittings, and Lorenz, which have different programs of ours and of diffrax; of the
    scenes the chart in levels, as orbits are run above; and of what host and device agree on the doublings: on a
    processor that is one run beside itself.
    """
    programs = {name: gpu.PROGRAMS[name] for name in ("particle", "lorenz")}
    levels = next(scene for scene in gpu.scenes_of(TINY) if "levels" in scene[0])
    *_, doublings = gpu.agreement_scenes()
    splittings = {name: SPLITTINGS[name] for name in ("blanes_moan6", "kahan_li8")}
    monkeypatch.setattr(peers_jaxnh, "SPLITTINGS", splittings)
    monkeypatch.setattr(gpu, "PROGRAMS", programs)
    monkeypatch.setattr(gpu, "scenes_of", lambda sizes: [levels])
    monkeypatch.setattr(gpu, "agreement_scenes", lambda: [doublings])
    monkeypatch.setattr(gpu, "SMALL", TINY)
    monkeypatch.setattr(sys, "argv", ["gpu", "--small", "--repeats", "1", "--output", str(tmp_path / "gpu.md")])
    gpu.main()
    text = (tmp_path / "gpu.md").read_text()
    assert "none reaches it" not in text
    assert all(name in text for name in (*programs, levels[0], doublings[0]))
