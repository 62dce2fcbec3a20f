"""Decisions kept from run to run: what a calibration comes to, without one, and none in place of another."""

from __future__ import annotations

import jax
import pytest

from jaxnh.engine import plan
from jaxnh.engine.cache import calibrations, executables
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.experiment import Experiment, load
from jaxnh.engine.session import Session
from jaxnh.exceptions import AccuracyError, ConfigError
from tests.helpers.kept_programs import lanes_with_kept_programs

pytestmark = pytest.mark.usefixtures("calibrate_once")

# A target of a few steps, and an analysis that chooses (`lyapunov` its parts).
TEXT = """\
title: {title}
system: {{constraint: constant_speed}}
sweep: {{b: {{start: 5.2, stop: {stop}, count: 5}}}}
accuracy: {accuracy}
analyses:
  lyapunov: {{transient: 8, periods: 32, error: 0.05, exponents: {exponents}}}
"""
TARGET = "{target: 1.0e-2}"


def experiment(title="one", stop=5.45, accuracy=TARGET, exponents=1):
    return Experiment.from_text(TEXT.format(title=title, stop=stop, accuracy=accuracy, exponents=exponents))


@pytest.fixture
def folder(tmp_path):
    """Where decisions are kept in this test."""
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    yield tmp_path / "jaxnh"
    jax.config.update("jax_compilation_cache_dir", before)


@pytest.fixture
def calibrated(monkeypatch):
    """The experiments that are calibrated in this test."""
    found, calibrate = [], plan.calibrate

    def noted(experiment, *arguments):
        found.append(experiment)
        return calibrate(experiment, *arguments)

    monkeypatch.setattr(plan, "calibrate", noted)
    return found


def decided(*arguments, **words):
    return plan.decide(experiment(*arguments, **words), lanes_with_kept_programs())


def decisions(folder):
    return [path for path in folder.iterdir() if b'{"solver"' in path.read_bytes()]


def name_of(experiment, lanes):
    return calibrations.name_of(experiment, lanes.devices, lanes.tile)


def test_a_second_run_calibrates_nothing(folder, calibrated):
    """Its job is the first one's in every bit, and no lane is run for it; a title decides nothing."""
    first = decided()
    assert first.plan.chosen["lyapunov"]
    assert first.plan.error_estimate > 0
    runner = LaneExecutor()
    assert plan.decide(experiment("another title"), runner) == first
    assert runner.accounts.lane_periods == 0
    assert len(calibrated) == 1


@pytest.mark.parametrize("fault", ["cut", "digit"])
def test_a_damaged_decision_is_taken_anew(folder, calibrated, fault):
    first = decided()
    [path] = decisions(folder)
    sound = path.read_bytes()
    path.write_bytes(sound[:-9] if fault == "cut" else sound.replace(b'"steps": ', b'"steps": 1'))
    assert [decided(), decided()] == [first, first]
    assert len(calibrated) == 2
    assert path.read_bytes()[:64] != sound[:64] or path.read_bytes()[65:] == sound[65:]


def test_what_decides_is_in_the_name(folder, monkeypatch):
    """Values, accuracy, analyses, lanes a tile, the text of the package; and not how many cores there are."""
    one = experiment()
    names = [name_of(one, LaneExecutor(*how)) for how in ((), (None, None, 32))]
    assert len(jax.devices()) > 1
    assert name_of(one, LaneExecutor(None, jax.devices()[:1])) == names[0]
    for other in ({"stop": 5.5}, {"accuracy": "{target: 1.0e-3}"}, {"exponents": 2}):
        names.append(name_of(experiment(**other), LaneExecutor()))
    monkeypatch.setattr(executables, "_versions", lambda: ["another text of the package"])
    names.append(name_of(one, LaneExecutor()))
    assert None not in names
    assert len(set(names)) == len(names)
    monkeypatch.setenv("JAXNH_KEEP_PROGRAMS", "0")
    assert name_of(one, LaneExecutor()) is None


def test_what_cannot_be_met_is_not_kept(folder, monkeypatch):
    def calibrate(*_):
        raise AccuracyError("no solver")

    monkeypatch.setattr(plan, "calibrate", calibrate)
    with pytest.raises(AccuracyError, match="no solver"):
        decided()
    assert not folder.exists() or not decisions(folder)


def test_a_sweep_of_days_is_refused_where_its_decision_is_kept(folder, calibrated, monkeypatch):
    """One that was asked for is no reason to run it unasked: how fast the machine is, is kept as well."""
    asked = lanes_with_kept_programs()
    asked.accounts.fastest = 1e-6
    plan.decide(experiment(), asked)
    monkeypatch.setattr(plan, "_LONGEST_RUN", 0.0)
    with pytest.raises(ConfigError, match="--yes goes on"):
        plan.decide(experiment(), LaneExecutor(), asked=False)
    assert len(calibrated) == 1


SYSTEM = """\
import jax.numpy as jnp
import numpy as np

{before}
def system(drive=0.3):
    def rhs(y, t):
        return y[1], {force} - y[0] ** 3 - 0.1 * y[1] + drive * jnp.cos(t)

    return dict(rhs=rhs, coordinates=("x", "v"), period=2 * jnp.pi)
"""
OF_USER = """\
system: {file: own.py}
sweep: {drive: {start: 0.2, stop: 0.3, count: 3}}
accuracy: {target: 1.0e-3}
analyses: {diagram: {transient: 4, strobes: 2}}
"""


def name_of_user(folder, before="", force="y[0]"):
    (folder / "own.py").write_text(SYSTEM.format(before=before, force=force))
    (folder / "own.yaml").write_text(OF_USER)
    return name_of(load(folder / "own.yaml"), LaneExecutor())


def test_data_of_users_are_in_the_name(folder, tmp_path):
    """Numbers that a file reads decide as its text does; where equations do not say all, nothing is kept."""
    data = tmp_path / "data.txt"
    reads = {"before": f"DATA = float(np.loadtxt({str(data)!r}))", "force": "DATA * y[0]"}
    names = []
    for number in ("1.0", "1.5"):
        data.write_text(number)
        names.append(name_of_user(tmp_path, **reads))
    assert None not in names
    assert names[0] != names[1]
    before = "import jax\n@jax.custom_jvp\ndef own(x):\n    return x\nown.defjvp(lambda p, t: (p[0], t[0]))\n"
    assert name_of_user(tmp_path, before=before, force="own(y[0])") is None


def test_a_second_session_calibrates_nothing_and_has_the_same_plan(folder, calibrated):
    first, second = (Session(experiment()).plan for _ in range(2))
    assert len(calibrated) == 1
    assert second == first
