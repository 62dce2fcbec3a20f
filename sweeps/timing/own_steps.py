"""Gain of steps of lanes of their own over common ones, where one lane in a hundred is a hundred times as fast.

    python -m sweeps.timing.own_steps [--lanes 4096] [--repeats 3]

Van der Pol's oscillator with a clock, in time alone and on a section, the fast lanes in a corner of the sweep or spread
    over it. Both plans run in turn in one process on one device, compiled before; the ratio is that of processor times.
    Steps are those of lanes, without what fills up tiles. The time of the look at all lanes stands apart.
"""

from __future__ import annotations

import argparse
import time
from typing import NamedTuple, NoReturn

import jax
import numpy as np

from jaxnh.engine.accuracy.calibration import Plan
from jaxnh.engine.accuracy.step_classes import mean_steps
from jaxnh.engine.batches import batches
from jaxnh.engine.compute import compute
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.plan import find_plan, in_quickest_form, job_of, with_step_classes
from jaxnh.engine.xla_options import configure

_SOURCE = """
import jax.numpy as jnp

def system(rate=1.0):
    def rhs(y, t):
        x, v = y
        return rate * v, rate * ((1 - x * x) * v - x{drive})

    return {{"rhs": rhs, "coordinates": ("x", "v"), {clock}}}
"""
_CONFIG = """\
system: {{file: oscillator.py}}
sweep: {{rate: {{values: {rates}}}}}
initial: {{x: 1.0, v: 0.5}}
accuracy: {{target: 1.0e-8}}
{rest}
"""
_TIME = {"drive": "", "clock": '"time_unit": 1.0'}
_SECTION = "section: {coordinate: x, value: 0.0, direction: up}\n"
_SCENES = {
    "clock": (
        {"drive": " + 0.3 * jnp.cos(2 * jnp.pi * t)", "clock": '"period": 1.0'},
        "analyses: {poincare: {transient: 200, strobes: 8}}",
    ),
    "time": (_TIME, "analyses: {lyapunov: {transient: 32, periods: 128, exponents: 1, method: averages}}"),
    "section": (_TIME, _SECTION + "analyses: {poincare: {transient: 256, strobes: 8}}"),
}


class Comparison(NamedTuple):
    """Steps a period, the mean of lanes' own, seconds of the look, and times of both plans in pairs."""

    steps: int
    mean: float
    look: float
    common: list[float]
    own: list[float]


def rates(lanes: int, *, spread: bool) -> np.ndarray:
    """Speeds of lanes, one in a hundred a hundred times that of its neighbours."""
    values = 1.0 + 0.25 * np.linspace(0.0, 1.0, lanes)
    fast = np.arange(50, lanes, 100) if spread else np.arange(lanes - lanes // 100, lanes)
    values[fast] *= 100.0
    return values


def compare(name: str, lanes: int, repeats: int, *, spread: bool) -> Comparison:
    """Run one scene by both plans in turn."""
    formulas, rest = _SCENES[name]
    config = _CONFIG.format(rates=rates(lanes, spread=spread).tolist(), rest=rest)
    experiment = Experiment.from_text(config, _SOURCE.format(**formulas))
    axes, requested, runner = experiment.axes, experiment.requested(), LaneExecutor(devices=jax.devices()[:1])
    common = in_quickest_form(experiment, find_plan(experiment, axes, runner, requested), requested)
    began = time.process_time()
    own = with_step_classes(experiment, axes, common, requested, runner)
    look = time.process_time() - began

    def run(plan: Plan) -> float:
        job = job_of(experiment, axes, plan, {}, requested, {})
        began = time.process_time()
        for batch in batches(experiment, axes, requested, job, job.cutting.pieces(), runner):
            compute(experiment, axes, requested, job, batch, runner, _gather_none)
        return time.process_time() - began

    times = [(run(common), run(own)) for _ in range(repeats + 1)][1:]  # the first compiles
    return Comparison(common.steps, mean_steps(own), look, *map(list, zip(*times, strict=True)))


def _gather_none(name: str) -> NoReturn:
    raise AssertionError(name)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lanes", type=int, default=4096)
    parser.add_argument("--repeats", type=int, default=3, help="pairs of runs of each row")
    parser.add_argument("--scenes", nargs="+", default=list(_SCENES), choices=list(_SCENES))
    args = parser.parse_args()
    configure()
    print("| scene | fast lanes | steps: common, mean of own | common, s | own, s | time, common over own | look, s |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name in args.scenes:
        for spread in (False, True):
            row = compare(name, args.lanes, args.repeats, spread=spread)
            low, middle, high = np.quantile(np.divide(row.common, row.own), (0.25, 0.5, 0.75))
            print(
                f"| {name} | {'spread' if spread else 'a corner'} | {row.steps}, {row.mean:.3g} | "
                f"{np.median(row.common):.1f} | {np.median(row.own):.1f} | {middle:.1f} ± {(high - low) / 2:.1f} | "
                f"{row.look:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
