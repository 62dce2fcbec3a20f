"""Calls cut into tiles of one fixed shape, which all devices compute.

A chaotic lane's last bits can depend on the shape of the batch it runs in, because other shapes get other vector code.
So every tile is padded to one shape, and every device gets whole tiles: the results are the same bit for bit for any
number of lanes, tiles or devices.

CPU devices are the cores. Each tile there is a call of the program of one device, in as many threads as there are
cores: none waits for another, and a call of one tile has nothing to pad. One program over all devices took 1.4 times
as long as the tiles one after the other, where most calls are of few lanes, as Newton's are. Graphics cards have one
program over all of them.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import cached_property, partial
from typing import Any, NamedTuple, Protocol

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxnh.analyses.batch import Link
from jaxnh.engine.executor.accounts import Accounts
from jaxnh.engine.executor.programs import Programs, takes_count
from jaxnh.maps.family import TreeStack
from jaxnh.maps.protocol import ReturnMap

_PLACED = 256  # arrays on the devices, at most
_PREPARED = 64  # calls whose programs and shared arguments are at hand, at most
_AHEAD = 2  # tiles a thread that are begun before the first of them is taken
_SMALL = 64  # numbers of an array that goes there in every call: looking for it takes longer


class Call(NamedTuple):
    """Functions over many lanes, each of what the one before leaves on the device.

    Attributes:
        links: the functions, one or more.
        lanes: pytrees whose leaves are NumPy arrays with the lanes as first axis; in place of the first of them each
            function but the first takes what the one before leaves.
        tile: lanes a tile.
    """

    links: tuple[Link, ...]
    lanes: tuple[Any, ...]
    tile: int

    @property
    def periods(self) -> float:
        """Periods that a lane costs."""
        return sum(link.periods for link in self.links)


class TileResults(NamedTuple):
    """Results of a tile, or on graphics cards of a tile on each.

    Attributes:
        first: number of the first lane.
        each: of each link what comes to the host, as NumPy arrays.
        seconds: that its programs took.
    """

    first: int
    each: list[Any]
    seconds: float


class Tiles(Protocol):
    """Something that runs calls tile by tile."""

    def run(self, call: Call, first: int = 0) -> Iterator[TileResults]:
        """Results from the lane number `first` on, in order; `first` is where a tile begins."""
        ...


class _PreparedCall(NamedTuple):
    """Parts that calls with the same function and shared arguments have in common.

    Attributes:
        shared: the arguments, kept so that no others have their addresses.
        program: compiled.
        placed: leaves of `shared`, large arrays on the devices.
        trip_count: iterations a period of the innermost loop.
    """

    shared: tuple[Any, ...]
    program: Any
    placed: list[Any]
    trip_count: float


class DeviceTiles:
    """Runs calls on devices."""

    def __init__(self, devices: Sequence[Any], programs: Programs, accounts: Accounts) -> None:
        self._on_cards = takes_count(devices)
        self._devices = devices if self._on_cards else devices[:1]  # of a program
        self._threads = 1 if self._on_cards else len(devices)
        self._programs, self._accounts, self._accounting = programs, accounts, threading.Lock()
        self._placed: dict[int, tuple[Any, Any]] = {}  # by the address of what is there
        self._prepared: dict[Any, _PreparedCall] = {}

    def run(self, call: Call, first: int = 0) -> Iterator[TileResults]:
        """The tiles of a call; see `Tiles`."""
        numbers = range(first, count_of(call.lanes), call.tile * len(self._devices))
        threads, programs = min(self._threads, len(numbers)), dict[int, _PreparedCall]()
        tile = partial(self._tile, call, programs, threads)
        return map(tile, numbers) if threads <= 1 else _in_threads(tile, numbers, threads, self._workers)

    @cached_property
    def _workers(self) -> ThreadPoolExecutor:
        """Threads of its own: slices of lanes side by side have theirs."""
        return ThreadPoolExecutor(self._threads, "tile")

    def _tile(self, call: Call, programs: dict[int, _PreparedCall], threads: int, first: int) -> TileResults:
        """The tile that begins with a lane, beside others in so many threads."""
        chunk = call.tile * len(self._devices)
        part = jax.tree.map(lambda leaf: _pad(leaf[first : first + chunk], chunk), call.lanes)
        left = min(chunk, count_of(call.lanes) - first)
        results, seconds, fastest = self._follow(call, part, programs, (np.int64(left),) if self._on_cards else ())
        with self._accounting:
            self._accounts.run_seconds += seconds / threads
            self._accounts.fastest = min(self._accounts.fastest, fastest / threads)
        if left < chunk:
            results = jax.tree.map(lambda leaf: leaf[:left], results)
        return TileResults(first, results, seconds)

    def _follow(
        self, call: Call, part: Any, programs: dict[int, _PreparedCall], asked: tuple[Any, ...]
    ) -> tuple[list[Any], float, float]:
        """Results of all links for a tile, the seconds of their programs, and of an iteration of a lane in the fastest.

        Programs are looked for with the first tile.
        """
        (carried, *others), kept, total, fastest = part, list[Any](), 0.0, math.inf
        if len(call.links) > 1:
            others = jax.device_put(others, _sharding(self._devices, "lanes"))
        for k, link in enumerate(call.links):
            leaves, structure = jax.tree.flatten((carried, *others))
            if (prepared := programs.get(k)) is None:
                prepared = programs[k] = self._prepare(link, leaves, structure)
            began = time.perf_counter()
            result = jax.block_until_ready(prepared.program(prepared.placed, leaves, *asked))
            seconds = time.perf_counter() - began
            total += seconds
            if iterations := link.periods * prepared.trip_count:
                fastest = min(fastest, seconds / (iterations * count_of(part)))
            carried, read = link.keep(result)
            kept.append(read)
        return jax.tree.map(np.asarray, kept), total, fastest

    def text(self, call: Call) -> str:
        """The compiled program of the first link of a call, as text."""
        chunk = call.tile * len(self._devices)
        lanes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((chunk, *leaf.shape[1:]), leaf.dtype), call.lanes)
        return self._program(call.links[0], lanes).as_text()

    def _prepare(self, link: Link, leaves: Sequence[Any], structure: Any) -> _PreparedCall:
        """The program of a link for lanes of such leaves, and its shared arguments, looked for once.

        Newton's iterates call one function with the same maps hundreds of times, and to take a map apart takes as long
        as a short return.
        """
        shapes = tuple((leaf.shape, leaf.dtype) for leaf in leaves)
        same = tuple((part.dtype, part.item()) if isinstance(part, np.generic) else id(part) for part in link.shared)
        key = link.function, link.static, same, shapes, structure
        if (prepared := self._prepared.get(key)) is None:
            lanes = jax.tree.unflatten(structure, leaves)
            program, placed = self._program(link, lanes), self._on_devices(link.shared)
            prepared = _PreparedCall(link.shared, program, placed, inner_trip_count(link.shared))
            if len(self._prepared) >= _PREPARED:
                self._prepared.clear()
            self._prepared[key] = prepared
        return prepared

    def _program(self, link: Link, lanes: tuple[Any, ...]) -> Any:
        """The compiled program of a link for the lanes of a tile on each of its devices."""
        shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), lanes)
        return self._programs.find(link.function, link.static, link.shared, shapes, self._devices, self._accounts)

    def _on_devices(self, shared: tuple[Any, ...]) -> list[Any]:
        """Place the arguments that all lanes share on all devices: tables go there once, not in every call."""
        leaves = jax.tree.leaves(shared)
        for k, leaf in enumerate(leaves):
            if isinstance(leaf, np.ndarray) and leaf.size > _SMALL:
                if (there := self._placed.get(id(leaf))) is None:
                    there = leaf, jax.device_put(leaf, _sharding(self._devices))
                    if len(self._placed) >= _PLACED:
                        self._placed.clear()
                    self._placed[id(leaf)] = there
                leaves[k] = there[1]
        return leaves


def _in_threads(
    function: Callable[[int], TileResults], numbers: Sequence[int], threads: int, workers: ThreadPoolExecutor
) -> Iterator[TileResults]:
    """Yield the function of each number in order, as so many threads compute it; they are a few numbers ahead."""
    ahead = deque[Future[TileResults]]()
    try:
        for number in numbers:
            ahead.append(workers.submit(function, number))
            if len(ahead) == _AHEAD * threads:
                yield ahead.popleft().result()
        while ahead:
            yield ahead.popleft().result()
    finally:
        for future in ahead:
            future.cancel()
        wait(ahead)


def _sharding(devices: Sequence[Any], *axes: str) -> NamedSharding:
    """Sharding of arrays over devices: split along their first axis, "lanes", or whole on each."""
    return NamedSharding(Mesh(np.array(devices), ("lanes",)), PartitionSpec(*axes))


def count_of(lanes: Any) -> int:
    """Number of lanes of pytrees whose leaves have the lanes as first axis."""
    return len(jax.tree.leaves(lanes)[0])


def inner_trip_count(shared: tuple[Any, ...]) -> float:
    """Iterations a period of the innermost loop of the maps among these, of the map with the most."""
    maps = [part.trees if isinstance(part, TreeStack) else part for part in shared]
    return max((math.prod(part.trip_counts) for part in maps if isinstance(part, ReturnMap)), default=0.0)


def _pad(leaf: np.ndarray, length: int) -> np.ndarray:
    """Pad a leaf to a length by its last row."""
    if len(leaf) == length:
        return leaf
    return np.concatenate([leaf, np.repeat(leaf[-1:], length - len(leaf), axis=0)])
