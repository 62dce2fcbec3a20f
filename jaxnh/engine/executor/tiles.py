"""Calls cut into tiles of one fixed shape over all devices.

A chaotic lane's last bits can depend on the shape of the batch it runs in, because other shapes get other vector code.
So every tile is padded to one shape, and every device gets whole tiles: the results are the same bit for bit for any
number of lanes, tiles or devices.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
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
_SMALL = 64  # numbers of an array that goes there in every call: looking for it takes longer


class Call(NamedTuple):
    """Functions over many lanes, each of what the one before leaves on the device.

    Attributes:
        links: the functions, one or more.
        lanes: pytrees whose leaves are NumPy arrays with the lanes as first axis; in place of the first of them each
            function but the first takes what the one before leaves.
        tile: lanes a tile.
        spread: whether its tiles are spread over all devices.
    """

    links: tuple[Link, ...]
    lanes: tuple[Any, ...]
    tile: int
    spread: bool

    @property
    def periods(self) -> float:
        """Periods that a lane costs."""
        return sum(link.periods for link in self.links)


class Tiles(Protocol):
    """Something that runs calls tile by tile."""

    def run(self, call: Call, first: int = 0) -> Iterator[tuple[int, Any]]:
        """Results from the lane number `first` on, a tile for each device at a time, with the number of its first lane.

        They are those of each link that come to the host, as NumPy arrays.

        `first` is where such a tile begins.
        """
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
        self._devices, self._programs, self._accounts = devices, programs, accounts
        self._placed: dict[tuple[int, int], tuple[Any, Any]] = {}  # by the address of what is on so many devices
        self._prepared: dict[Any, _PreparedCall] = {}

    def run(self, call: Call, first: int = 0) -> Iterator[tuple[int, Any]]:
        """The tiles of a call; see `Tiles`."""
        devices = self._devices_of(call)
        chunk, count, programs = call.tile * len(devices), count_of(call.lanes), list[_PreparedCall]()
        for number in range(first, count, chunk):
            part = jax.tree.map(lambda leaf, number=number: _pad(leaf[number : number + chunk], chunk), call.lanes)
            left = min(chunk, count - number)
            asked = (np.int64(left),) if takes_count(devices) else ()
            results = self._follow(call, part, programs, asked)
            if left < chunk:
                results = jax.tree.map(lambda leaf, left=left: leaf[:left], results)
            yield number, results

    def _follow(self, call: Call, part: Any, programs: list[_PreparedCall], asked: tuple[Any, ...]) -> list[Any]:
        """Results of all links for one tile on each device; their programs are looked for with the first."""
        (carried, *others), devices, kept = part, self._devices_of(call), list[Any]()
        if len(call.links) > 1:
            others = jax.device_put(others, _sharding(devices, "lanes"))
        for k, link in enumerate(call.links):
            leaves, structure = jax.tree.flatten((carried, *others))
            if k == len(programs):
                programs.append(self._prepare(link, leaves, structure, devices))
            prepared = programs[k]
            began = time.perf_counter()
            result = jax.block_until_ready(prepared.program(prepared.placed, leaves, *asked))
            seconds = time.perf_counter() - began
            self._accounts.run_seconds += seconds
            if iterations := link.periods * prepared.trip_count:
                self._accounts.fastest = min(self._accounts.fastest, seconds / (iterations * count_of(part)))
            carried, read = link.keep(result)
            kept.append(read)
        return jax.tree.map(np.asarray, kept)

    def text(self, call: Call) -> str:
        """The compiled program of the first link of a call, as text."""
        devices = self._devices_of(call)
        chunk = call.tile * len(devices)
        lanes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((chunk, *leaf.shape[1:]), leaf.dtype), call.lanes)
        return self._program(call.links[0], lanes, devices).as_text()

    def _prepare(self, link: Link, leaves: Sequence[Any], structure: Any, devices: Sequence[Any]) -> _PreparedCall:
        """The program of a link for lanes of such leaves, and its shared arguments, looked for once.

        Newton's iterates call one function with the same maps hundreds of times, and to take a map apart takes as long
        as a short return.
        """
        shapes = tuple((leaf.shape, leaf.dtype) for leaf in leaves)
        same = tuple((part.dtype, part.item()) if isinstance(part, np.generic) else id(part) for part in link.shared)
        key = link.function, link.static, same, shapes, structure, len(devices)
        if key not in self._prepared:
            lanes = jax.tree.unflatten(structure, leaves)
            program, placed = self._program(link, lanes, devices), self._on_devices(link.shared, devices)
            if len(self._prepared) >= _PREPARED:
                self._prepared.clear()
            self._prepared[key] = _PreparedCall(link.shared, program, placed, inner_trip_count(link.shared))
        return self._prepared[key]

    def _program(self, link: Link, lanes: tuple[Any, ...], devices: Sequence[Any]) -> Any:
        """The compiled program of a link for the lanes of a tile on each device."""
        shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), lanes)
        return self._programs.find(link.function, link.static, link.shared, shapes, devices, self._accounts)

    def _devices_of(self, call: Call) -> Sequence[Any]:
        return self._devices if call.spread else self._devices[:1]

    def _on_devices(self, shared: tuple[Any, ...], devices: Sequence[Any]) -> list[Any]:
        """Place the arguments that all lanes share on all devices: tables go there once, not in every call."""
        leaves = jax.tree.leaves(shared)
        for k, leaf in enumerate(leaves):
            if isinstance(leaf, np.ndarray) and leaf.size > _SMALL:
                place = id(leaf), len(devices)
                if place not in self._placed:
                    if len(self._placed) >= _PLACED:
                        self._placed.clear()
                    self._placed[place] = leaf, jax.device_put(leaf, _sharding(devices))
                leaves[k] = self._placed[place][1]
        return leaves


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
