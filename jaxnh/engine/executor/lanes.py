"""Lanes: many values of the parameter through one compiled program, in tiles of one fixed shape over all devices.

A chaotic lane's last bits can depend on the shape of the batch it runs in, because other shapes get other vector code.
So every tile is padded to one shape, and every device gets whole tiles: the results are the same bit for bit for any
number of lanes, tiles or devices.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxnh.engine.cache import executables
from jaxnh.engine.cache.fingerprints import CallFingerprints
from jaxnh.engine.executor.row_blocks import has_rows, in_blocks, of_block
from jaxnh.engine.progress import NullProgress, Progress
from jaxnh.engine.xla_options import machine
from jaxnh.maps.iterate import iterate
from jaxnh.maps.protocol import ReturnMap
from jaxnh.storage.calls import CallJournal, JournalEntry

TILE = 256
"""Lanes a tile: large enough to hide what a kernel call costs, small enough for a core's first cache."""

_LONGEST = 1 << 15
"""Lane-periods of a map's iterates in one call and on one device: a program that runs can neither be stopped nor kept.

They take a tenth of a second of the fast maps and some seconds of slow ones, and a call a millisecond of its own. It is
no measured rate that decides, so that a later run makes the same calls.
"""

_RUNNERS_A_CORE = 2  # of a chart over b and d, 256 rows: 70 s in place of 77
_PLACED = 256  # arrays on the devices, at most
_COMPILING = threading.Lock()  # one program at a time: JAX's cache is switched off for it


class LaneExecutor:
    """Runs per-lane functions over any number of lanes.

    Attributes:
        devices: the JAX devices tiles go to.
        lane_periods: periods integrated so far, summed over lanes (derivatives count once).
        compile_seconds: time spent tracing and compiling so far.
        run_seconds: time spent in compiled programs so far.
        fastest: seconds a lane for a turn of the innermost loop of a map, in the call that was fastest so far.
    """

    def __init__(self, progress: Progress | None = None, devices: list[Any] | None = None, tile: int = TILE) -> None:
        self.devices: list[Any] = jax.devices() if devices is None else devices
        self.tile = tile
        self.lane_periods = 0.0
        self.compile_seconds = 0.0
        self.run_seconds = 0.0
        self.fastest = math.inf
        self._progress = progress or NullProgress()
        self._programs: dict[Any, Any] = {}
        self._placed: dict[int, tuple[Any, Any]] = {}  # by the address of what is on the devices
        self._names = CallFingerprints()
        self._kept: CallJournal | None = None
        self._calls = 0

    def apart(self) -> list[LaneExecutor]:
        """Runners to be used side by side, each with accounts of its own: one for each device, of cores two.

        CPU devices are the cores, on which the programs of one device run side by side as well if threads call them:
        none has to be compiled twice, and a core computes for one runner while another is between two calls.
        """
        cores = self.devices[0].platform == "cpu"
        programs: dict[Any, Any] = {}
        runners = []
        for device in self.devices * (_RUNNERS_A_CORE if cores else 1):
            runner = LaneExecutor(self._progress, self.devices[:1] if cores else [device], self.tile)
            runner._programs = programs if cores else {}
            runners.append(runner)
        return runners

    def add(self, others: Sequence[LaneExecutor]) -> None:
        """Add what others have run and compiled side by side to the accounts: of their seconds the mean."""
        for other in others:
            self.lane_periods += other.lane_periods
            self.compile_seconds += other.compile_seconds / len(others)
            self.run_seconds += other.run_seconds / len(others)
            self.fastest = min(self.fastest, other.fastest)

    @contextmanager
    def keeping(self, kept: CallJournal) -> Iterator[None]:
        """Keep the results of the calls inside, and take those from there that a stopped run has left.

        The calls inside have to follow from each other alone: the same ones in every run.
        """
        self._kept, self._calls = kept, 0
        try:
            yield
        except BaseException:
            kept.close(remove=False)
            raise
        finally:
            self._kept = None

    @property
    def machine(self) -> dict[str, str]:
        """The kind of processor and XLA's options (`xla_options.machine`)."""
        return machine(self.devices[0])

    @property
    def programs(self) -> int:
        """Number of compiled programs so far."""
        return len(self._programs)

    @property
    def earlier_seconds(self) -> float:
        """Seconds that a stopped run has spent on what is found of the calls being made."""
        return self._kept.seconds if self._kept else 0.0

    @contextmanager
    def stage(self, label: str, total: float) -> Iterator[None]:
        """Show the calls inside as one stage of `total` lane-periods."""
        self._progress.start(label, total)
        try:
            yield
        finally:
            self._progress.finish()

    def note(self, text: str) -> None:
        """Say something worth knowing of the stage in hand."""
        self._progress.note(text)

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
        lanes = jax.tree.map(np.asarray, lanes)
        tile = self._tile(shared, tile)
        if function is iterate and int(shared[1]) > (longest := max(1, _LONGEST // tile)):
            return self._iterates(longest, shared, lanes, tile=tile)
        if has_rows(shared) and function is not of_block:
            return self._rows(function, shared, lanes, periods, tile, static)
        call, name = self._calls, self._names.of(function, shared, lanes, static, tile) if self._kept else ""
        self._calls += 1
        count = len(jax.tree.leaves(lanes)[0])
        results = self._found(call, name, function, shared, lanes, static)
        start = sum(len(jax.tree.leaves(result)[0]) for result in results)
        if start:
            self._account(periods * start)
        tiles = self._tiles(function, shared, lanes, static, tile, periods, start) if start < count else ()
        for first, result in tiles:
            results.append(result)
            if self._kept:
                self._kept.add(JournalEntry(call, first, name, tuple(jax.tree.leaves(result))))
            self._account(periods * len(jax.tree.leaves(result)[0]))
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *results)

    def _tiles(
        self,
        function: Callable[..., Any],
        shared: tuple[Any, ...],
        lanes: tuple[Any, ...],
        static: tuple[Any, ...],
        tile: int,
        periods: float,
        start: int,
    ) -> Iterator[tuple[int, Any]]:
        """Results of the lanes from the number `start` on, a tile for each device at a time, with its first lane."""
        leaves, structure = jax.tree.flatten(lanes)
        chunk, count = tile * len(self.devices), len(leaves[0])
        roomy = jax.tree.unflatten(structure, [_padded(leaf[:chunk], chunk) for leaf in leaves])
        program, placed = self._program(function, static, shared, roomy), self._on_devices(shared)
        turns = periods * chunk * turns_of(shared)
        for first in range(start, count, chunk):
            part = [_padded(leaf[first : first + chunk], chunk) for leaf in leaves]
            began = time.perf_counter()
            result = jax.tree.map(np.asarray, program(placed, part))
            seconds = time.perf_counter() - began
            self.run_seconds += seconds
            if turns:
                self.fastest = min(self.fastest, seconds / turns)
            if (some := min(chunk, count - first)) < chunk:
                result = jax.tree.map(lambda leaf, some=some: leaf[:some], result)
            yield first, result

    def _iterates(self, longest: int, shared: tuple[Any, ...], lanes: tuple[Any, ...], *, tile: int) -> Any:
        """Iterates of a map in several calls: the same program, whose count is an argument, and so the same bits."""
        strobe, left = shared[0], int(shared[1])
        state, p = lanes
        while left:
            some = min(left, longest)
            state = self(iterate, (strobe, np.int32(some)), (state, p), periods=some, tile=tile)
            left -= some
        return state

    def _rows(
        self,
        function: Callable[..., Any],
        shared: tuple[Any, ...],
        lanes: tuple[Any, ...],
        periods: float,
        tile: int,
        static: tuple[Any, ...],
    ) -> Any:
        """Lanes that are in several rows, block by block."""
        blocks = in_blocks(lanes, tile)
        each = periods * len(blocks.back) / len(blocks.rows)
        arguments, static = (blocks.rows, blocks.lanes), ((function, static),)
        found = self(of_block, shared, arguments, periods=each, tile=blocks.a_tile, static=static)
        return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:])[blocks.back], found)

    def _on_devices(self, shared: tuple[Any, ...]) -> list[Any]:
        """What all lanes see alike, its arrays on all devices: tables of a map go there once, and not in every call."""
        leaves = jax.tree.leaves(shared)
        for k, leaf in enumerate(leaves):
            if isinstance(leaf, np.ndarray | float):
                if id(leaf) not in self._placed:
                    if len(self._placed) >= _PLACED:
                        self._placed.clear()
                    everywhere = NamedSharding(Mesh(np.array(self.devices), ("lanes",)), PartitionSpec())
                    self._placed[id(leaf)] = leaf, jax.device_put(leaf, everywhere)
                leaves[k] = self._placed[id(leaf)][1]
        return leaves

    def _account(self, lane_periods: float) -> None:
        self.lane_periods += lane_periods
        self._progress.advance(lane_periods)

    def _found(
        self,
        call: int,
        name: str,
        function: Callable[..., Any],
        shared: tuple[Any, ...],
        lanes: tuple[Any, ...],
        static: tuple[Any, ...],
    ) -> list[Any]:
        """Results of the first lanes of a call that a stopped run has left."""
        parts = self._kept.found(call, name) if self._kept else []
        if not parts:
            return []
        lane = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), lanes)
        structure = jax.tree.structure(jax.eval_shape(lambda lane: function(*shared, *lane, *static), lane))
        return [jax.tree.unflatten(structure, part.leaves) for part in parts]

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
            with _COMPILING:
                began = time.perf_counter()
                if key not in self._programs:  # by now, as another runner may have needed it
                    self._programs[key] = self._compiled(function, static, (shared, lanes))
                self.compile_seconds += time.perf_counter() - began
        return self._programs[key]

    def _compiled(self, function: Callable[..., Any], static: tuple[Any, ...], arguments: tuple[Any, Any]) -> Any:
        """The program of such calls, a function of the leaves of (shared, lanes): an earlier run's, or a new one."""
        structure = jax.tree.structure(arguments)
        leaves = tuple(map(jax.tree.leaves, arguments))
        name = executables.name_of(function, static, arguments, self.devices)
        if name and (found := executables.find(name, jax.tree.structure((leaves, {})), self.devices)):
            return found

        def tile(*leaves: Any) -> Any:
            shared, lanes = jax.tree.unflatten(structure, jax.tree.leaves(leaves))
            return jax.vmap(lambda lane: function(*shared, *lane, *static))(lanes)

        mesh = Mesh(np.array(self.devices), ("lanes",))
        split = PartitionSpec("lanes")
        sharded = jax.shard_map(tile, mesh=mesh, in_specs=(PartitionSpec(), split), out_specs=split, check_vma=False)
        lowered = jax.jit(sharded).lower(*leaves)
        if not name:
            return lowered.compile()
        with executables.compiling():
            program = lowered.compile()
        executables.keep(name, program)
        return program


def turns_of(shared: tuple[Any, ...]) -> float:
    """Turns a period of the innermost loop of the maps among these: of the one that has most."""
    return max((math.prod(part.turns) for part in shared if isinstance(part, ReturnMap)), default=0.0)


def _padded(leaf: np.ndarray, length: int) -> np.ndarray:
    """The leaf with its last row repeated up to a length."""
    missing = length - len(leaf)
    return leaf if not missing else np.concatenate([leaf, np.repeat(leaf[-1:], missing, axis=0)])
