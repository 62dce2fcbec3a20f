"""Lanes: many values of the parameter through one compiled program, in tiles of one fixed shape over all devices.

A chaotic lane's last bits can depend on the shape of the batch it runs in, because other shapes get other vector code.
So every tile is padded to one shape, and every device gets whole tiles: the results are the same bit for bit for any
number of lanes, tiles or devices.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from jaxnh.engine.progress import Progress, Silent

TILE = 256
"""Lanes a tile: large enough to hide what a kernel call costs, small enough for a core's first cache."""


class Lanes:
    """Runs per-lane functions over any number of lanes.

    Attributes:
        devices: the JAX devices tiles go to.
        lane_periods: periods integrated so far, summed over lanes (derivatives count once).
        compile_seconds: time spent tracing and compiling so far.
        run_seconds: time spent in compiled programs so far.
    """

    def __init__(self, progress: Progress | None = None, devices: list[Any] | None = None, tile: int = TILE) -> None:
        self.devices: list[Any] = jax.devices() if devices is None else devices
        self.tile = tile
        self.lane_periods = 0.0
        self.compile_seconds = 0.0
        self.run_seconds = 0.0
        self._progress = progress or Silent()
        self._programs: dict[Any, Any] = {}

    @contextmanager
    def stage(self, label: str, total: float) -> Iterator[None]:
        """Show the calls inside as one stage of `total` lane-periods."""
        self._progress.start(label, total)
        try:
            yield
        finally:
            self._progress.finish()

    def __call__(
        self,
        function: Callable[..., Any],
        shared: tuple[Any, ...],
        lanes: tuple[Any, ...],
        *,
        periods: float = 0.0,
        tile: int | None = None,
        static: tuple[Any, ...] = (),
    ) -> Any:
        """function(*shared, *lane, *static) for every lane.

        Args:
            function: pure function of one lane, defined at module level (programs are kept by it).
            shared: pytrees that all lanes see alike.
            lanes: pytrees whose leaves have the lanes as first axis.
            periods: periods that a lane costs, for progress and accounts.
            tile: lanes a tile where a program has few lanes but much to do in each.
            static: further hashable arguments, part of the program.

        Returns:
            The function's results as NumPy arrays with the lanes as first axis.
        """
        chunk = self._tile(shared, tile) * len(self.devices)
        lanes = jax.tree.map(np.asarray, lanes)
        count = len(jax.tree.leaves(lanes)[0])
        results = []
        for start in range(0, count, chunk):
            part = jax.tree.map(lambda leaf, start=start: _padded(leaf[start : start + chunk], chunk), lanes)
            program = self._program(function, static, shared, part)
            began = time.perf_counter()
            results.append(jax.tree.map(np.asarray, program(shared, part)))
            self.run_seconds += time.perf_counter() - began
            done = periods * min(chunk, count - start)
            self.lane_periods += done
            self._progress.advance(done)
        return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:count], *results)

    def program(
        self,
        function: Callable[..., Any],
        shared: tuple[Any, ...],
        lanes: Any,
        static: tuple[Any, ...] = (),
        tile: int | None = None,
    ) -> tuple[str, int]:
        """The compiled program that such a call runs, as text, and the lanes of a tile in it."""
        tile = self._tile(shared, tile)
        chunk = tile * len(self.devices)
        part = jax.tree.map(lambda leaf: _padded(np.asarray(leaf)[:chunk], chunk), lanes)
        return self._program(function, static, shared, part).as_text(), tile

    def _tile(self, shared: tuple[Any, ...], tile: int | None) -> int:
        """Lanes a tile: as many as asked for, and no more than the maps in it are good for."""
        most = [most for part in shared if (most := getattr(part, "most_lanes", None))]
        return min(tile or self.tile, *most) if most else tile or self.tile

    def _program(self, function: Callable[..., Any], static: tuple[Any, ...], shared: Any, lanes: Any) -> Any:
        shapes = jax.tree.map(lambda leaf: (np.shape(leaf), np.result_type(leaf)), (shared, lanes))
        key = (function, static, tuple(jax.tree.leaves(shapes)), jax.tree.structure((shared, lanes)))
        if key not in self._programs:
            began = time.perf_counter()

            def tile(shared: Any, lanes: Any) -> Any:
                return jax.vmap(lambda lane: function(*shared, *lane, *static))(lanes)

            mesh = Mesh(np.array(self.devices), ("lanes",))
            split = PartitionSpec("lanes")
            sharded = jax.shard_map(
                tile, mesh=mesh, in_specs=(PartitionSpec(), split), out_specs=split, check_vma=False
            )
            self._programs[key] = jax.jit(sharded).lower(shared, lanes).compile()
            self.compile_seconds += time.perf_counter() - began
        return self._programs[key]


def _padded(leaf: np.ndarray, length: int) -> np.ndarray:
    """The leaf with its last row repeated up to a length."""
    missing = length - len(leaf)
    return leaf if not missing else np.concatenate([leaf, np.repeat(leaf[-1:], missing, axis=0)])
