"""Calls cut into tiles of one fixed shape over all devices.

A chaotic lane's last bits can depend on the shape of the batch it runs in, because other shapes get other vector code.
So every tile is padded to one shape, and every device gets whole tiles: the results are the same bit for bit for any
number of lanes, tiles or devices.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, Protocol

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxnh.engine.executor.accounts import Accounts
from jaxnh.engine.executor.programs import Programs, takes_count
from jaxnh.maps.family import TreeStack
from jaxnh.maps.protocol import ReturnMap

_PLACED = 256  # arrays on the devices, at most
_SMALL = 64  # numbers of an array that goes there in every call: looking for it takes longer


class Call(NamedTuple):
    """One function over many lanes: function(*shared, *lane, *static).

    Attributes:
        function: pure function of one lane, defined at module level (programs are kept by it).
        shared: pytrees that all lanes see alike.
        lanes: pytrees whose leaves are NumPy arrays with the lanes as first axis.
        static: further hashable arguments, part of the program.
        tile: lanes a tile.
        periods: periods that a lane costs.
        spread: whether its tiles are spread over all devices.
    """

    function: Callable[..., Any]
    shared: tuple[Any, ...]
    lanes: tuple[Any, ...]
    static: tuple[Any, ...]
    tile: int
    periods: float
    spread: bool


class Tiles(Protocol):
    """Something that runs calls tile by tile."""

    def run(self, call: Call, first: int = 0) -> Iterator[tuple[int, Any]]:
        """Results from the lane number `first` on, a tile for each device at a time, with the number of its first lane.

        `first` is where such a tile begins.
        """
        ...


class DeviceTiles:
    """Runs calls on devices."""

    def __init__(self, devices: Sequence[Any], programs: Programs, accounts: Accounts) -> None:
        self._devices, self._programs, self._accounts = devices, programs, accounts
        self._placed: dict[tuple[int, int], tuple[Any, Any]] = {}  # by the address of what is on so many devices

    def run(self, call: Call, first: int = 0) -> Iterator[tuple[int, Any]]:
        """The tiles of a call; see `Tiles`."""
        devices = self._devices_of(call)
        leaves, chunk, count = jax.tree.leaves(call.lanes), call.tile * len(devices), count_of(call.lanes)
        program, placed = self.program(call), self._on_devices(call.shared, devices)
        iterations = call.periods and call.periods * chunk * inner_trip_count(call.shared)
        for number in range(first, count, chunk):
            part = [_pad(leaf[number : number + chunk], chunk) for leaf in leaves]
            left = min(chunk, count - number)
            asked = (np.int64(left),) if takes_count(devices) else ()
            began = time.perf_counter()
            result = jax.tree.map(np.asarray, program(placed, part, *asked))
            seconds = time.perf_counter() - began
            self._accounts.run_seconds += seconds
            if iterations:
                self._accounts.fastest = min(self._accounts.fastest, seconds / iterations)
            if left < chunk:
                result = jax.tree.map(lambda leaf, left=left: leaf[:left], result)
            yield number, result

    def program(self, call: Call) -> Any:
        """The compiled program of a call."""
        devices = self._devices_of(call)
        chunk = call.tile * len(devices)
        lanes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((chunk, *leaf.shape[1:]), leaf.dtype), call.lanes)
        return self._programs.find(call.function, call.static, call.shared, lanes, devices, self._accounts)

    def _devices_of(self, call: Call) -> Sequence[Any]:
        return self._devices if call.spread else self._devices[:1]

    def _on_devices(self, shared: tuple[Any, ...], devices: Sequence[Any]) -> list[Any]:
        """Place the arguments that all lanes share on all devices: tables go there once, not in every call."""
        leaves, everywhere = jax.tree.leaves(shared), None
        for k, leaf in enumerate(leaves):
            if isinstance(leaf, np.ndarray) and leaf.size > _SMALL:
                place = id(leaf), len(devices)
                if place not in self._placed:
                    if len(self._placed) >= _PLACED:
                        self._placed.clear()
                    everywhere = everywhere or NamedSharding(Mesh(np.array(devices), ("lanes",)), PartitionSpec())
                    self._placed[place] = leaf, jax.device_put(leaf, everywhere)
                leaves[k] = self._placed[place][1]
        return leaves


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
