"""What a newcomer meets whose own system cannot be run: one line with the reason, in words of mechanics."""

from __future__ import annotations

import pytest

from jaxnh.cli import slow_files
from jaxnh.engine.accuracy import calibration, reference, sample_maps, samples
from tests.helpers.commands import run_here
from tests.helpers.short_portrait import short_portrait

CONFIG = short_portrait(2.0, 1000.0, 1e-6)
SYSTEMS = {
    "no mass in a coordinate": (
        "def system(rate=1.0):\n"
        "    return dict(T=lambda q, v, t: v[0] ** 2, Q=lambda q, v, t: (-rate * q[0], -q[1]), coordinates=('x', 'y'))\n",
        "at rate = 1000 the mass matrix, the second derivatives of T by the velocities, is singular: T has no term with "
        "the square of y_dot",
    ),
    "the same constraint twice": (
        "def system(rate=1.0):\n"
        "    return dict(T=lambda q, v, t: sum(w * w for w in v), Q=lambda q, v, t: (-rate * q[0], -q[1], 0.0),\n"
        "                f=lambda q, v, t: (v[0] - v[1], 2 * v[0] - 2 * v[1]), coordinates=('x', 'y', 'z'))\n",
        "at rate = 1000 the constraints f are not independent: df/dv has not the full rank",
    ),
}


@pytest.mark.parametrize(("system", "reason"), SYSTEMS.values(), ids=SYSTEMS)
def test_why_no_lane_has_a_period(tmp_path, system, reason):
    (tmp_path / "own.py").write_text(system)
    (tmp_path / "own.yaml").write_text(CONFIG)
    run = run_here("own.yaml", "--quiet", cwd=tmp_path)
    assert run.returncode == 2
    assert len(run.stderr.splitlines()) == 1
    assert "sweep: every lane of this sweep has a non-finite state within a period; " in run.stderr
    assert reason in run.stderr


def test_without_a_clock_accuracy_is_that_of_a_unit_of_time(tmp_path):
    (tmp_path / "own.py").write_text(
        "def system(rate=1.0):\n    return dict(rhs=lambda y, t: (y[1], -rate * y[0]), coordinates=('x', 'v'))\n"
    )
    (tmp_path / "own.yaml").write_text(CONFIG)
    run = run_here("own.yaml", "accuracy={solver: verner9, steps: 400}", cwd=tmp_path)
    assert run.returncode == 0
    assert "verner9 in float64, 400 steps a unit of time, error of one unit of time " in run.stdout


@pytest.mark.slow
def test_a_calibration_that_takes_long_says_how_far_it_is(tmp_path, monkeypatch):
    """Its steps and what they have come to, and of a field with a jump why it comes no further."""
    monkeypatch.setattr(sample_maps, "_SILENT_SECONDS", 0.0)
    for module in (calibration, reference):
        monkeypatch.setattr(module, "MOST_KICKS", 1 << 15)
    (tmp_path / "own.py").write_text(
        "import jax.numpy as jnp\n"
        "def system(rate=1.0):\n"
        "    def rhs(y, t):\n"
        "        stair = jnp.argmin((y[1] - jnp.arange(-4.0, 5.0)) ** 2).astype(float)\n"
        "        return y[1], -y[0] - 0.3 * stair + 2 * jnp.cos(t)\n"
        "    return dict(rhs=rhs, coordinates=('x', 'v'), period=2 * jnp.pi)\n"
    )
    (tmp_path / "own.yaml").write_text(CONFIG)
    run = run_here("own.yaml", cwd=tmp_path)
    *said, last = run.stderr.splitlines()
    assert run.returncode == 2
    assert any(" evaluations of the field a period, references differ by " in line for line in said)
    assert "; the right-hand side jumps at t = " in last


def test_a_file_that_takes_long_to_read_says_where_it_is(tmp_path, monkeypatch):
    """Every five seconds, here fractions of one, the line of the user's file that is being run."""
    monkeypatch.setattr(slow_files, "_SILENT_SECONDS", 0.2)
    (tmp_path / "own.py").write_text("import time\n\ntime.sleep(0.7)\n\ndef system(rate=1.0): return 1\n")
    (tmp_path / "own.yaml").write_text(CONFIG)
    run = run_here("own.yaml", cwd=tmp_path)
    *said, last = run.stderr.splitlines()
    assert run.returncode == 2
    assert "reading own.yaml for 0 s, now at own.py:3" in said
    words = "dict(rhs=..., coordinates=...), or dict(T=..., Q=..., ...), or dict(map=..., ...)"
    assert last == f"own.py:5: system must return {words}"


CONE = """\
import jax.numpy as jnp

def system(g=1.0):
    return dict(T=lambda q, v, t: 0.5 * sum(w * w for w in v), Q=lambda q, v, t: FORCES,
                f=lambda q, v, t: (v[0] ** 2 + v[1] ** 2 - v[2] ** 2,), coordinates=('x', 'y', 'z'))
"""
CONE_CONFIG = """\
system: {file: own.py}
initial: {x_dot: 0.3, y_dot: 0.4, z_dot: 0.5, z: 0.3}
sweep: {g: {SPEC}}
accuracy: {target: 1.0e-8}
analyses:
  portrait: {transient: 0, periods: 2}
"""


@pytest.mark.usefixtures("quick_programs")
@pytest.mark.parametrize(
    ("forces", "spec", "what"),
    [
        (
            "(0.0, 0.0, -g)",
            "values: [1.0]",
            "every lane of this sweep has a non-finite state within a period; at g = 1 ",
        ),
        pytest.param(
            "(-0.3 * jnp.sin(q[0]), -0.2 * q[1], -g * q[2] - 0.1 * v[2])",
            "values: [0.9, 1.0]",
            "at g = 0.9 steps do not follow the motion: ",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "(-0.3 * jnp.sin(q[0]), -0.2 * q[1], -g * q[2] - 0.1 * v[2])",
            "start: 0.9, stop: 1.0, count: 200",
            "at g = 0.9 steps do not follow the motion: ",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_constraints_that_lose_rank_on_the_way(tmp_path, monkeypatch, forces, spec, what):
    """The cone v_x² + v_y² = v_z² has no tangent plane at v = 0, which motion comes to, or passes at no distance."""
    for module in (calibration, reference):
        monkeypatch.setattr(module, "MOST_KICKS", 1 << 15)
    monkeypatch.setattr(samples, "_MOST_SEED_KICKS", 1 << 12)
    (tmp_path / "own.py").write_text(CONE.replace("FORCES", forces))
    (tmp_path / "own.yaml").write_text(CONE_CONFIG.replace("SPEC", spec))
    run = run_here("own.yaml", "--quiet", cwd=tmp_path)
    assert run.returncode == 2
    assert len(run.stderr.splitlines()) == 1
    assert what in run.stderr
    assert "the constraints f lose rank on the way: at t = " in run.stderr
    assert "corner" not in run.stderr


def test_a_unit_of_time_of_many_oscillations(tmp_path):
    """96 steps a unit make no finite state of it; more do, whatever the unit."""
    (tmp_path / "own.py").write_text(
        "def system(rate=1.0):\n"
        "    return dict(rhs=lambda y, t: (y[1], -rate * y[0] - y[0] ** 3), coordinates=('x', 'v'), time_unit=300.0)\n"
    )
    (tmp_path / "own.yaml").write_text(CONFIG.replace("1000.0", "1.0"))
    run = run_here("own.yaml", cwd=tmp_path)
    assert run.returncode == 0
    assert " steps a unit of time, error of one unit of time " in run.stdout
