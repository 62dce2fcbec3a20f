"""Lanes and sessions that find the programs of earlier runs in this process."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

import jax

from jaxnh.engine.executor.lanes import TILE, LaneExecutor
from jaxnh.engine.executor.programs import Programs
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.progress import Progress
from jaxnh.engine.session import Session

_PROGRAMS = {unoptimised: Programs() for unoptimised in (False, True)}

# Compiled in a quarter of the time, and slower by several times: for runs so short that compiling is what takes time.
# 16 programs of the matrix took 4.6 s of processor as usual, 1.35 s without optimisation and fusion emitters, and 1.17 s
# where no module is split for threads.
QUICKLY_COMPILED = Programs(
    options={
        "xla_backend_optimization_level": 0,
        "xla_cpu_use_fusion_emitters": False,
        "xla_cpu_parallel_codegen_split_count": 1,
    }
)


class PaddedToFew(LaneExecutor):
    """Lanes in tiles as users have them, but for few lanes: in tiles of 32, as 256 take several times as long."""

    _FEW = 32

    def _tile(self, shared: Sequence[Any], count: int, tile: int | None) -> int:
        usual = super()._tile(shared, count, tile)
        return min(usual, self._FEW) if count <= 2 * self._FEW else usual


executor_of_tests: type[LaneExecutor] = LaneExecutor
"""Of sessions and commands: in quick runs `PaddedToFew`, which `conftest` puts here; slow tests have lanes as users do."""


@contextlib.contextmanager
def hardly_optimised() -> Iterator[None]:
    """Programs that are compiled meanwhile are compiled in a quarter of the time: for what runs for less time than that."""
    before = jax.config.read("jax_disable_most_optimizations")
    jax.config.update("jax_disable_most_optimizations", True)
    try:
        yield
    finally:
        jax.config.update("jax_disable_most_optimizations", before)


def lanes_with_kept_programs(
    progress: Progress | None = None,
    devices: list[Any] | None = None,
    tile: int = TILE,
    programs: Programs | None = None,
    kind: type[LaneExecutor] = LaneExecutor,
) -> LaneExecutor:
    """Lanes on all devices that find the programs of earlier runs in this process; their keys say all else there is."""
    if programs is None:
        programs = _PROGRAMS[jax.config.read("jax_disable_most_optimizations")]
    return kind(progress, devices, tile, programs)


def lanes_of_commands(
    progress: Progress | None = None, devices: list[Any] | None = None, tile: int = TILE
) -> LaneExecutor:
    """Lanes of commands that find the programs of earlier runs in this process."""
    return lanes_with_kept_programs(progress, devices, tile, kind=executor_of_tests)


def session_of(experiment: Experiment) -> Session:
    """A session that finds the programs of earlier ones in this process."""
    found = Session(experiment)
    found._lanes = lanes_with_kept_programs(found._progress, kind=executor_of_tests)
    return found


class FewLanes(LaneExecutor):
    """Lanes in small tiles, but for fields at the many points of paths, which one call takes in tiles of their own."""

    _MANY = 256

    def _tile(self, shared: Sequence[Any], count: int, tile: int | None) -> int:
        return tile if tile and tile >= self._MANY else super()._tile(shared, count, tile)
