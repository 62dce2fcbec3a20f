"""Compiled programs of functions over the lanes of a tile, made once for each shape of their arguments."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial, wraps
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from jaxnh.engine.cache import executables
from jaxnh.engine.executor.accounts import Accounts
from jaxnh.engine.kernels.cuda import capability_of, find_kernel, run_kernel
from jaxnh.engine.kernels.source import Kernel, shapes_of

_COMPILING = threading.Lock()  # one program at a time: JAX's cache is switched off for it


class Programs:
    """Compiled programs, which several executors may share if their devices are the same."""

    def __init__(self, *, kept: bool = True, options: Mapping[str, Any] | None = None) -> None:
        """Take none.

        Args:
            kept: whether those of earlier runs are looked for, and new ones kept.
            options: of XLA, beside those of the process; programs with options of their own are not kept.
        """
        self._programs: dict[Any, Any] = {}
        self._kernels: dict[Any, Kernel | None] = {}  # for any number of lanes
        self._kept = kept and not options
        self._options = dict(options or {})

    def __len__(self) -> int:
        """Number of compiled programs."""
        return len(self._programs)

    def texts(self) -> list[str]:
        """All programs as text."""
        return [program.as_text() for program in self._programs.values()]

    def find(
        self,
        function: Callable[..., Any],
        static: tuple[Any, ...],
        shared: tuple[Any, ...],
        lanes: Any,
        devices: Sequence[Any],
        accounts: Accounts,
    ) -> Any:
        """The program of function(*shared, *lane, *static) for every lane; its making is accounted for.

        Args:
            lanes: pytrees of the shapes and types of one tile a device, with the lanes as first axis.

        Returns:
            A function of the leaves of (shared, lanes).
        """
        key = *signature(function, static, (shared, lanes)), *devices
        if key not in self._programs:
            with _COMPILING:
                began = time.perf_counter()
                if key not in self._programs:  # by now, as another executor may have needed it
                    self._programs[key] = self._find_or_compile(function, static, (shared, lanes), devices)
                accounts.compile_seconds += time.perf_counter() - began
        return self._programs[key]

    def _find_or_compile(
        self, function: Callable[..., Any], static: tuple[Any, ...], arguments: tuple[Any, Any], devices: Sequence[Any]
    ) -> Any:
        """The program of such calls, from an earlier run or compiled now."""
        structure = jax.tree.structure(arguments)
        leaves: tuple[Any, ...] = tuple(map(jax.tree.leaves, arguments))
        if takes_count(devices):
            leaves = *leaves, np.int64(0)
        name = executables.name_of(function, static, arguments, devices) if self._kept else None
        if name and (program := executables.find(name, jax.tree.structure((leaves, {})), devices)):
            return program
        side_by_side = self._side_by_side(function, static, shapes_of(arguments), devices)

        def tile(shared: Any, lanes: Any, *asked: Any) -> Any:
            own = jax.tree.unflatten(structure, jax.tree.leaves((shared, lanes)))
            return side_by_side(
                *own, *(count - jax.lax.axis_index("lanes").astype(np.int64) * len(lanes[0]) for count in asked)
            )

        mesh = Mesh(np.array(devices), ("lanes",))
        split, same = PartitionSpec("lanes"), PartitionSpec()
        specs = (same, split, same)[: len(leaves)]
        sharded = jax.shard_map(tile, mesh=mesh, in_specs=specs, out_specs=split, check_vma=False)
        lowered = _lower(jax.jit(sharded).trace(*leaves))
        if self._kept and not name:
            return lowered.compile(self._options)
        with executables.compiling():
            program = lowered.compile(self._options)
        if name:
            executables.keep(name, program)
        return program

    def _side_by_side(
        self, function: Callable[..., Any], static: tuple[Any, ...], shapes: tuple[Any, Any], devices: Sequence[Any]
    ) -> Callable[..., Any]:
        """The function of a lane over many: as a kernel where there is one, else by `jax.vmap`."""

        @wraps(function)
        def one(shared: Any, lane: Any) -> Any:
            return function(*shared, *lane, *static)

        if capability := capability_of(devices[0]):
            shared, lanes = shapes
            lane = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), lanes)
            leaves, structure = jax.tree.flatten((shared, lane))
            key = (function, static, tuple((leaf.shape, leaf.dtype) for leaf in leaves), structure)
            if key not in self._kernels:
                self._kernels[key] = find_kernel(one, shared, lane)
            if kernel := self._kernels[key]:
                return partial(run_kernel, kernel, capability)
        return lambda shared, lanes, *asked: jax.vmap(one, in_axes=(None, 0))(shared, lanes)


def signature(function: Callable[..., Any], static: tuple[Any, ...], arguments: Any) -> tuple[Any, ...]:
    """What a trace of function(*arguments, *static) depends on: both, and the shapes and types of the arguments."""
    leaves, structure = jax.tree.flatten(arguments)
    shapes = tuple((np.shape(leaf), getattr(leaf, "dtype", None) or np.result_type(leaf)) for leaf in leaves)
    return function, static, shapes, structure


def takes_count(devices: Sequence[Any]) -> bool:
    """Return whether programs for these devices take, after all else, the number of lanes that are asked for.

    On a graphics card lanes that fill up a tile end at once.
    """
    return devices[0].platform != "cpu"


def _lower(traced: Any) -> Any:
    """Lower a traced program for the platform of its devices."""
    return traced.lower()
