"""Gain that steps chosen for each tile of neighbouring lanes would have over one number of steps for a whole sweep.

    python -m sweeps.timing.steps_per_tile [--repeats 7] [--tiles 128 64]

The largest error of a sweep is that of few lanes, and all take the steps that those need. Here each tile of
neighbouring values of b takes as many steps as it needs for the same largest error: on the scenes of
    `sweeps.peers.particle.peers` (`peers_cases`), with the errors that it measures, one device, both in turn in one
    run. A table of kicks belongs to a tile then, so that a tile is one call. The ratio is that of processor times; that
    of the kicks is what it would be if small tiles cost no more a lane.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from jaxnh.engine.executor.lanes import TILE, LaneExecutor
from jaxnh.engine.xla_options import configure
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import iterate
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import disturbed_speed
from sweeps.peers.particle.peers_cases import LANES, held_out, paper
from sweeps.peers.particle.peers_heyoka import true_scene
from sweeps.peers.particle.peers_scene import PERIODS, Errors, Scene, least_effort

_TARGETS = (1e-6, 1e-8, 1e-10)
_SOLVER = SPLITTINGS["processed6"]
_MOST_STEPS = 2000.0


class Tile(NamedTuple):
    """Neighbouring values of b: their numbers, (values,), and steps a period."""

    values: np.ndarray
    steps: int


def tiles_of(scene: Scene, lanes: LaneExecutor, target: float, size: int) -> list[Tile]:
    """Tiles of so many values, each with the least steps whose largest error meets the target."""
    system = disturbed_speed(scene.a, scene.c, scene.d)
    found = []
    for first in range(0, LANES, size):
        values = np.arange(first, first + size)
        both = np.concatenate([values, LANES + values])  # at the start, and past the transient

        def measure(steps: float, both: np.ndarray = both) -> Errors:
            strobe = make_return_map(system, _SOLVER, int(steps))
            (x, y), (n1, n2) = _iterated(scene, lanes, strobe, both, 1, size)
            error = np.abs(np.stack([x, y, n1, n2], axis=-1) - scene.ends[both]).max(axis=1).astype(float)
            return Errors(float(error.max()), float(np.median(error)))

        effort = least_effort(measure, target, 150.0, factor=1.5, most=_MOST_STEPS, whole=True)
        if effort is None:
            raise SystemExit(f"no number of steps up to {_MOST_STEPS:g} meets {target:g}")
        found.append(Tile(values, int(effort[0])))
    return found


def program(scene: Scene, lanes: LaneExecutor, tiles: list[Tile], size: int) -> Callable[[], None]:
    """A call that takes all lanes PERIODS periods on, tile after tile, `size` lanes in each call."""
    system = disturbed_speed(scene.a, scene.c, scene.d)
    strobes = [make_return_map(system, _SOLVER, tile.steps) for tile in tiles]

    def run() -> None:
        for tile, strobe in zip(tiles, strobes, strict=True):
            _iterated(scene, lanes, strobe, LANES + tile.values, PERIODS, size)

    return run


def _iterated(scene: Scene, lanes: LaneExecutor, strobe: object, some: np.ndarray, periods: int, size: int) -> tuple:
    x, y, n1, n2 = scene.unit_states[some].T
    start = ((x, y), (n1, n2)), {"b": scene.b[some]}
    return lanes(iterate, (strobe, np.int32(periods)), start, tile=size)


def ratio(whole: Callable[[], None], tiled: Callable[[], None], repeats: int) -> tuple[float, float]:
    """Median of processor time of the first over that of the second, in turn, and half the spread of the quartiles."""
    found = []
    for _ in range(repeats + 1):
        spent = []
        for call in (whole, tiled):
            began = time.process_time()
            call()
            spent.append(time.process_time() - began)
        found.append(spent[0] / spent[1])
    low, middle, high = np.quantile(found[1:], (0.25, 0.5, 0.75))  # the first compiles
    return float(middle), float(high - low) / 2


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=7, help="pairs of runs of each row")
    parser.add_argument("--tiles", type=int, nargs="+", default=[128, 64], help="values of b a tile")
    args = parser.parse_args()
    configure()
    lanes = LaneExecutor(devices=jax.devices()[:1])
    print("| scene | error | values a tile | steps | kicks, whole over tiles | time, whole over tiles |")
    print("| --- | --- | --- | --- | --- | --- |")
    for case in (paper(), *held_out()):
        scene = true_scene(case)
        for target in _TARGETS:
            [whole] = tiles_of(scene, lanes, target, LANES)
            for size in args.tiles:
                tiles = tiles_of(scene, lanes, target, size)
                kicks = _SOLVER.total_kicks(whole.steps) / np.mean([_SOLVER.total_kicks(t.steps) for t in tiles])
                one, many = program(scene, lanes, [whole], TILE), program(scene, lanes, tiles, size)
                middle, spread = ratio(one, many, args.repeats)
                steps = ", ".join(str(tile.steps) for tile in tiles)
                print(
                    f"| {case.name} | {target:g} | {size} | {whole.steps}: {steps} | {kicks:.2f} | "
                    f"{middle:.2f} ± {spread:.2f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
