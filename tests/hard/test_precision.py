"""float32, where it is asked for: stated by the calibration against float64, kept in the file, refused where it cannot do."""

from __future__ import annotations

import math
import time

import h5py
import jax
import numpy as np
import pytest

from jaxnh.engine.experiment import load
from jaxnh.exceptions import AccuracyError, ConfigError
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import derivatives, iterate, section_map
from jaxnh.maps.single_precision import in_precision
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import constant_speed, disturbed_speed
from tests.flows.particle import twin
from tests.helpers import taylor
from tests.helpers.batches import calibrated
from tests.helpers.hard_scenes import start_at
from tests.helpers.measurement import largest_difference

pytestmark = pytest.mark.case("float32 on request")
UNIT = 2.0**-24  # roundoff of one operation in single precision
CONFIG = """\
system: {constraint: constant_speed}
sweep: {b: {start: 5.2, stop: 5.8, count: 32}}
accuracy: {target: 1.0e-3, precision: float32}
analyses: {diagram: {transient: 20, strobes: 4}}
"""


def enlargement(lanes, system, calibration):
    """How many times a period enlarges a rounding, by heyoka, in the sample that a calibration goes by.

    Which sample that is, of those whose matrices are largest but for the share left out, the package may say.
    """
    strobe, samples = make_return_map(system, SPLITTINGS["kahan_li8"], 120), calibration._samples
    u = system.chart.host_points(samples.states)
    found = lanes(derivatives, (strobe, np.int32(1)), (u, dict(samples.p)))
    i = calibration._largest_at(np.linalg.norm(found.monodromy, ord=2, axis=(1, 2)))
    monodromy = taylor.strobe_jacobian(twin(system), samples.p["b"][i], u[i : i + 1])[1][0]
    return float(np.linalg.norm(monodromy.astype(float), ord=2))


@pytest.mark.slow
def test_error_and_gain(battery, lanes):
    """The estimate is of float32's own rounding; beside it float64 with the same steps, and the time of both.

    One rounding of the start becomes u‖M‖ in a period of the most sensitive sample, and a tenth of that must be refused.
    Roundings of N = 600 kicks add up at random, to √N u‖M‖ if the flow enlarged all of them as much as the first, and the
    estimate is twice the error of the samples: ten times u‖M‖, between the two, must be met.
    """
    for system in (constant_speed(), disturbed_speed()) if battery.full else (constant_speed(),):
        values = np.linspace(4, 6, 256 if battery.full else 16)
        start = start_at(system)
        calibration = calibrated(system, start, values, lanes, "float32")
        rounding = UNIT * enlargement(lanes, system, calibration)
        plan = calibration.cheapest(10 * rounding)
        count = 48 if battery.full else 12
        b = np.random.default_rng(3).choice(values, count)
        u = np.tile(constant_speed().chart.host_points(start), (count, 1))
        maps = {
            precision: in_precision(
                make_return_map(system, plan.solver, plan.steps, compensated=plan.compensated), precision
            )
            for precision in ("float64", "float32")
        }
        u = lanes(section_map, (maps["float64"], np.int32(7)), (u, {"b": b}))
        exact = taylor.strobe(twin(system), b, u)
        errors = {
            p: largest_difference(lanes(section_map, (m, np.int32(1)), (u, {"b": b})), exact).max()
            for p, m in maps.items()
        }
        kicks = plan.solver.total_kicks(plan.steps)
        battery.row(
            f"d = {system.d:g}, b in [4, 6], target 10u‖M‖ = {10 * rounding:.1e}: {plan.solver.name}, {kicks} kicks, estimate {plan.error_estimate:.1e} "
            f"(float64 with the same kicks: {errors['float64']:.1e})",
            float(errors["float32"]),
            plan.error_estimate,
            "error by Taylor",
        )
        with pytest.raises(AccuracyError) as refusal:
            calibration.cheapest(0.1 * rounding)
        battery.refused(f"d = {system.d:g}, float32 with target 0.1u‖M‖ = {0.1 * rounding:.1e}", str(refusal.value))
        if battery.full:
            spent = seconds(lanes, maps, start)
            gain = spent["float64"] / spent["float32"]
            battery.note(
                f"d = {system.d:g}: 4096 lanes take {gain:.2f} times as long in float64 (best of five each, in turn)."
            )


def seconds(lanes, maps, start):
    """Best of five runs of 4096 lanes over 20 periods in each precision, in turn, after warm-up."""
    b = np.linspace(4, 6, 4096)
    state = jax.tree.map(lambda leaf: np.full(len(b), leaf), start)
    best = dict.fromkeys(maps, math.inf)
    for _ in range(6):
        for precision, strobe in maps.items():
            began = time.perf_counter()
            lanes(iterate, (strobe, np.int32(20)), (state, {"b": b}))
            best[precision] = min(best[precision], time.perf_counter() - began)
    return best


@pytest.mark.slow
def test_never_silently(battery, sweep, tmp_path):
    """Printed and in the file; and refused for what rests on Newton, and for Runge–Kutta methods."""
    path = tmp_path / "single.yaml"
    path.write_text(CONFIG)
    done = sweep(path, "--output", tmp_path / "single.h5")
    assert done.returncode == 0, done.stderr
    assert " in float32, " in done.stdout
    with h5py.File(tmp_path / "single.h5") as file:
        assert file.attrs["precision"] == "float32"
        estimate, solver = float(file.attrs["error_estimate"]), file.attrs["solver"]
    battery.row(f"the command with precision: float32 ({solver}), printed and in the file", estimate, 1e-3, "estimate")
    assert estimate > 1e-7  # of single precision indeed
    for wrong, word in (
        (CONFIG.replace("diagram: {transient: 20, strobes: 4}", "period: {}"), "Newton"),
        (CONFIG.replace("target: 1.0e-3", "solver: dopri8, steps: 200"), "splittings"),
    ):
        path.write_text(wrong)
        with pytest.raises(ConfigError, match=word) as refusal:
            load(path)
        battery.refused("float32 where it cannot do", str(refusal.value).split(": ", 1)[1])
