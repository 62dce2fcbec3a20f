"""Tools of the hard cases: a scene calibrated and held against the Taylor reference on lanes it was not measured on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxnh.engine.accuracy.calibration import Plan
from jaxnh.exceptions import AccuracyError
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import section_map
from tests.flows.particle import twin
from tests.helpers import taylor
from tests.helpers.batches import calibrated
from tests.helpers.battery import worst
from tests.helpers.measurement import UNIT, largest_difference

PAPER_B = np.linspace(0.1, 6.0, 48)
LOOKED_AT = 170
"""Periods of every lane that a calibration looks at."""


class PlanCheck(NamedTuple):
    """A plan and how it did: the largest error of other lanes, by the reference; or why there is no plan."""

    plan: Plan | None
    error: float
    refusal: str
    target: float


def hold(lanes, system, start, values, target, count=24):
    """Calibrate a scene and measure one period on `count` lanes, a third each after 0, 3 and 20 periods."""
    calibration = calibrated(system, start, values, lanes)
    try:
        plan = calibration.cheapest(target)
    except AccuracyError as refusal:
        return PlanCheck(None, np.inf, str(refusal), target)
    strobe = make_return_map(system, plan.solver, plan.steps, compensated=plan.compensated)
    b = np.random.default_rng(11).choice(values, count)
    u = np.tile(system.chart.host_points(start), (count, 1))
    for k, n in enumerate((0, 3, 20)):
        part = slice(k * count // 3, (k + 1) * count // 3)
        u[part] = lanes(section_map, (strobe, np.int32(n)), (u[part], {"b": b[part]}))
    image = lanes(section_map, (strobe, np.int32(1)), (u, {"b": b}))
    exact = taylor.settled_strobe(twin(system), b, u, 0.1 * plan.error_estimate)
    return PlanCheck(plan, float(largest_difference(image, exact).max()), "", target)


def roundings(enlarged):
    """Return what the roundings of a period come to that enlarges small errors so many times.

    Those of N kicks add up at random, to √N uE if all are enlarged E times as some are; N is at most 2²⁰.
    """
    return 1024 * UNIT * enlarged


def hold_to_rounding(battery, lanes, what, system, start, values, target, count=24):
    """`hold`, shown; where a scene is refused its target has to be below what rounding leaves, and that much is held.

    The factor E is the largest of all periods that calibration looks at, by heyoka: in chaotic motion E is ever larger
    the more periods there are, as it passes nearer to states that enlarge every error without bound.
    """
    held = hold(lanes, system, start, values, target, count)
    show(battery, what, held)
    if held.plan is None:
        u, par = system.chart.host_points(start), twin(system)
        enlarged = max(taylor.enlargement(par, float(b), u, LOOKED_AT) for b in values)
        assert target < roundings(enlarged)
        held = hold(lanes, system, start, values, roundings(enlarged), count)
        show(battery, f"{what}, roundings enlarged {enlarged:.0e} times", held)
        assert held.plan is not None
    return held


def start_at(system, x1=0.1, y1=0.1):
    """The paper's start direction (x2 a tenth of the speed) at a position."""
    return system.start({"x1": x1, "x2": 0.1 * system.c**0.5, "y1": y1})


def show(battery, what, held):
    """The row of a scene: its error within the estimate, or the reason of its refusal.

    One period in 10,000 may err by more (`test_accuracy_contract`): of some dozens in a scene none is expected.
    """
    target = held.target
    if held.plan is None:
        battery.refused(f"{what}, target {target:.2g}", held.refusal)
        return
    plan = held.plan
    kicks = plan.solver.total_kicks(plan.steps)
    battery.row(
        f"{what}, target {target:.2g}: {plan.solver.name}, {kicks:,} kicks, estimate {plan.error_estimate:.1e}",
        held.error,
        plan.error_estimate,
        "error by Taylor",
    )
    assert plan.error_estimate <= target


def show_sum_rule(battery, what, found, error):
    """Rows of the sum rule: against the divergence integrated by itself, and against the determinants of the steps.

    The first is of the size of the map's own error: the divergence of a step's modified field differs from the flow's
    by what an error of one period makes of a period's growth, some ten errors where the flow turns sharply; a hundred
    are allowed. The second is rounding, of some thousand steps in each of the periods that are averaged.
    """
    residual = worst(np.abs(found["sum_rule_residual"].to_numpy()))
    battery.row(f"{what}: sum of exponents against the divergence by quadrature", residual, 100 * error, "residual")
    scale = np.abs(found["exponents"].to_numpy()).sum(axis=1)
    rounding = worst(np.abs(found["volume_residual"].to_numpy()) / scale)
    battery.row(f"{what}: against the determinants of the steps", rounding, 1e-10, "residual, relative,")
