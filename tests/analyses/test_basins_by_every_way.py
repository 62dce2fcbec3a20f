"""Basins have the same bits in memory, by tiles, parts and workers, and after a stop; rows of shared values; bad starts."""

from __future__ import annotations

import numpy as np
import pytest

import jaxnh
from jaxnh.engine.experiment import Experiment
from jaxnh.exceptions import ConfigError
from jaxnh.systems.status import STATUS
from tests.flows.written_out import experiment, line, oscillator
from tests.helpers.commands import run_by_two_workers, run_here
from tests.helpers.comparisons import same_tree
from tests.helpers.kept_programs import lanes_with_kept_programs, session_of

pytestmark = pytest.mark.usefixtures("uncalibrated")


@pytest.fixture(autouse=True)
def kept_programs(monkeypatch):
    """Runs within this process find the programs of earlier ones."""
    for module in ("run", "session"):
        monkeypatch.setattr(f"jaxnh.engine.{module}.LaneExecutor", lanes_with_kept_programs)


@pytest.fixture(scope="module")
def double_well(tmp_path_factory):
    """Chaos beside periodic orbits: x'' = x − x³ − x'/5 + 0.3 cos t."""
    folder = tmp_path_factory.mktemp("double_well")
    sweep = {"x": line(-1.5, 1.5, 8), "v": line(-1.0, 1.0, 6)}
    options = {"transient": 32, "max_periods": 128, "max_period": 8}
    return oscillator(folder, sweep, options, 0.3, linear=1.0, damping=0.2)


@pytest.fixture(scope="module")
def in_memory(double_well):
    tree = session_of(double_well).tree()
    kinds = tree["attractors"]["kind"]
    assert "chaotic" in [str(kinds.attrs["flag_meanings"]).split()[k + 1] for k in kinds.values.ravel()]
    return tree


@pytest.mark.slow
def test_tiles(double_well, in_memory, tmp_path):
    """Tiles of 16 lanes on disk, and one group of a session alone."""
    same_tree(jaxnh.run(double_well, tmp_path / "tiles.h5", tile=16), in_memory)
    assert not list(tmp_path.glob("*.tiles"))


@pytest.mark.slow  # the matrix has basins of sessions
def test_one_group_of_a_session(tmp_path):
    asked = oscillator(tmp_path, {"x": line(0.5, 1.0, 3), "v": {"values": [0.0]}})
    whole = session_of(asked).tree()["attractors"].to_dataset()
    assert session_of(asked).run("attractors").identical(whole)


@pytest.mark.slow
def test_parts_are_joined(double_well, in_memory, tmp_path):
    """Four parts, then what needs all tiles; parts alone have no basins."""
    config = tmp_path / "job.yaml"
    config.write_text(double_well.text)
    for part in range(1, 5):
        done = run_here("job.yaml", "--tile", 12, "--part", f"{part}/4", "--output", "job.h5", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert not (tmp_path / "job.h5").exists()
    done = run_here("job.yaml", "--merge", "--output", "job.h5", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    same_tree(jaxnh.open_result(tmp_path / "job.h5"), in_memory)


@pytest.mark.slow
def test_stopped_in_the_last_piece(double_well, in_memory, tmp_path):
    """Stopped while attractors are judged, with all tiles done, and once more; what it comes to in the end is the same."""
    path = tmp_path / "job.h5"
    for stage in ("lyapunov: transient", "lyapunov: averages"):

        def stop(label, done, total, stage=stage):
            if label.startswith(stage):
                raise jaxnh.Stopped("enough for now")

        with pytest.raises(jaxnh.Stopped, match="enough for now with 4 of 5 tiles done"):
            jaxnh.run(double_well, path, progress=stop, tile=12)
        assert not path.exists()
    same_tree(jaxnh.run(double_well, path, tile=12), in_memory)
    assert not list(tmp_path.glob("*.tiles"))


@pytest.mark.slow
def test_two_workers(double_well, in_memory, tmp_path):
    """Of a local Dask cluster, each on one core."""
    result = jaxnh.open_result(run_by_two_workers(double_well.text, tmp_path, 16))
    same_tree(
        result, in_memory, but_for=("error_estimate", "sizes_of_motion")
    )  # which a process of its own has measured


@pytest.mark.slow  # the matrix has basins over a shared axis
def test_rows_of_a_shared_axis(tmp_path):
    """Over a frequency, which is the clock: each value as by itself, and an orbit has the same number at both."""
    rates = "v, 0.5 * jnp.cos(omega * t) - 0.2 * v - x - x**3"
    plane = {"x": line(-1.0, 1.0, 3), "v": line(-1.0, 1.0, 2)}

    def over(values):
        sweep = {"omega": {"values": values}, **plane}
        rest = '"period": 2 * jnp.pi / omega'
        accuracy = {"solver": "nystrom8", "steps": 32}
        asked = experiment(tmp_path, ("x", "v"), rates, sweep, {}, rest, "omega=1.5", accuracy=accuracy)
        return session_of(asked).tree()

    both = over([0.9, 0.95])
    assert both["basins"]["attractor"].values.tolist() == np.ones((2, 3, 2)).tolist()
    assert both["attractors"]["period"].values.tolist() == [[1], [1]]
    assert both["attractors"].sizes["change"] == 0
    for place, omega in enumerate([0.9, 0.95]):
        alone = over([omega])["attractors"]
        for name in ("multiplier", "exponent", "x", "v_points"):
            assert np.array_equal(both["attractors"][name].values[place], alone[name].values[0])


# ---- bad starts


def particle(sweep, options):
    content = {
        "system": {"constraint": "constant_speed"},
        "sweep": sweep,
        "accuracy": {"solver": "blanes_moan6", "steps": 40},
        "analyses": {"basins": {"transient": 32, "max_periods": 64, "max_period": 1, **options}},
    }
    return Experiment.from_dict(content)


def test_random_starts_off_the_constraint():
    """|x2| above the speed, 1: these lanes have failed, with the reason, and the others have not."""
    box = {"n_starts": 6, "seed": 1, "box": {"x2": [-2.0, 2.0]}}
    basins = session_of(particle({"b": {"values": [5.6]}}, box)).tree()["basins"]
    off = np.abs(basins["x2"].values) > 1.0
    assert 0 < off.sum() < 6
    assert np.array_equal(basins["attractor"].values == -1, off)
    assert {STATUS[k] for k in basins["status"].values[off]} == {"off_constraint"}
    assert {STATUS[k] for k in basins["status"].values[~off]} == {"ok"}


def test_an_axis_that_the_constraint_decides():
    with pytest.raises(ConfigError, match="y2 follows from the constraint, and cannot be swept"):
        particle({"y2": {"values": [0.1, 0.2]}}, {})
