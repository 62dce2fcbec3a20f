"""A user's map in a config, a session and commands: what only flows have is refused in one line."""

from __future__ import annotations

import numpy as np
import pytest

import jaxnh
from jaxnh.exceptions import ConfigError, InputError
from jaxnh.systems.discrete_map import DiscreteMap
from tests.flows.known_maps import HENON, henon
from tests.helpers.commands import run_here
from tests.helpers.paths import ROOT

CONFIG = """system: {file: own.py, b: 0.3}
initial: {x: 0.1}
sweep: {a: {values: [0.2, 1.0, 1.4]}}
analyses:
  poincare: {transient: 0, strobes: 4}
"""


def write(folder, config=CONFIG, text=HENON):
    (folder / "own.py").write_text(text)
    (folder / "own.yaml").write_text(config)
    return folder / "own.yaml"


def test_a_map_is_a_system(tmp_path):
    flow = jaxnh.load(write(tmp_path)).flow()
    assert isinstance(flow, DiscreteMap)
    assert (flow.autonomous, flow.continuous, flow.period, flow.exponents) == (False, False, 1.0, 2)
    assert flow.readout.labels.units == {"a": "", "b": "", "x": "", "y": "", "t": "1"}


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("accuracy: {target: 1.0e-8}\n", ":6: accuracy.target: a map is iterated as it is, exact to rounding"),
        ("accuracy: {solver: verner9, steps: 8}\n", ":6: accuracy.solver: a map is iterated as it is"),
        ("accuracy: {precision: float32}\n", ":6: accuracy.precision: float32 is for a particle"),
        ("section: {coordinate: x}\n", ":6: section: a map is seen at its iterates; leave section out"),
        ("  portrait: {}\n", ":6: analyses.portrait: a map has nothing between its iterates"),
        ("  diagram: {phase: 0.5}\n", ":6: analyses.diagram.phase: there is no period to have a phase in"),
        (
            "  branches: {equilibria: 4, box: {x: [0, 1], y: [0, 1]}}\n",
            ":6: analyses.branches.equilibria: a map has orbits of period 1, and has no equilibria",
        ),
    ],
)
def test_what_only_flows_have(tmp_path, more, message):
    with pytest.raises(ConfigError) as caught:
        jaxnh.load(write(tmp_path, CONFIG + more))
    assert str(caught.value).startswith(f"{tmp_path}/own.yaml{message}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (('("x", "y")}', '("x", "y"), "period": 1.0}'), ":1: a map has no period: lengths of time are counted in"),
        (('("x", "y")}', '("x", "y"), "time_unit": 1.0}'), ":1: a map has no time_unit: lengths of time are"),
        (('"map": image', '"map": image, "rhs": image'), ":1: system returns map and 'rhs'; a system is a right-hand"),
        (('"map": image', '"map": image, "angle": "x"'), ":1: system returns 'angle', which is unknown (did you mean"),
        (('"map": image', '"map": 1.0'), ":1: map must be a function of (y)"),
        (("+ y, b * x", "+ y"), ":2: map must return 2 numbers, one a coordinate, not 1"),
        (("image(s)", "image(s, t)"), ":1: TypeError: system.<locals>.image() missing 1 required positional argument"),
        (('("x", "y")}', '("x", "y"), "units": {"t": "s"}}'), ":1: units names 't', which is no parameter"),
    ],
)
def test_fault_in_the_file(tmp_path, edit, message):
    assert edit[0] in HENON
    with pytest.raises(ConfigError) as caught:
        jaxnh.load(write(tmp_path, text=HENON.replace(*edit)))
    assert str(caught.value).startswith(f"{tmp_path}/own.py{message}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("path", sorted((ROOT / "configs/maps").glob("*.yaml")), ids=lambda path: path.stem)
def test_configs_load(path):
    experiment = jaxnh.load(path)
    assert isinstance(experiment.flow(), DiscreteMap)
    assert {"diagram", "lyapunov"} <= set(experiment.analyses.options())


def test_a_session(tmp_path):
    """A function in Python, and the batch job of it."""
    session = jaxnh.Session(henon, start={"x": 0.1})
    data = session.run(jaxnh.Poincare(transient=0, strobes=3), a=[0.2, 1.4])
    assert data["x"].to_numpy()[:, :2].tolist() == [[0.1, 1.0 - 0.2 * 0.1**2], [0.1, 1.0 - 1.4 * 0.1**2]]
    assert data["t"].to_numpy().tolist() == [0.0, 1.0, 2.0]
    assert repr(session).endswith("iterates of a map>")
    session.experiment.save(tmp_path / "job.yaml")
    again = jaxnh.run(jaxnh.load(tmp_path / "job.yaml"), tmp_path / "job.h5")["poincare"].to_dataset()
    assert np.array_equal(again["y"], data["y"])
    with pytest.raises(InputError, match="a map is iterated as it is, exact to rounding; leave target out"):
        jaxnh.Session(henon, target=1e-8)
    with pytest.raises(InputError, match="a map is seen at its iterates; leave section out"):
        session.on("x")


def test_commands(tmp_path):
    """A sweep, its verification, its figure, and no price of steps that there are not."""
    write(tmp_path, CONFIG + "  lyapunov: {transient: 32, periods: 64}\n")
    sweep = run_here("own.yaml", cwd=tmp_path)
    assert sweep.returncode == 0
    assert "iteration in float64, no steps, error of one iterate 2.2e-16" in sweep.stdout
    checked = run_here("results/own.h5", "--verify", cwd=tmp_path, command="inspect")
    assert checked.returncode == 0, checked.stderr
    assert run_here("results/own.h5", cwd=tmp_path, command="plot").returncode == 0
    cost = run_here("own.yaml", cwd=tmp_path, command="cost")
    assert cost.returncode == 2
    assert cost.stderr.splitlines()[-1].endswith("the cost of accuracy is that of steps in time, and a map has none")
