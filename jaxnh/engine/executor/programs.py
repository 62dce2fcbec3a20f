"""Compiled programs of functions over the lanes of a tile, made once for each shape of their arguments."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from jaxnh.engine.cache import executables
from jaxnh.engine.executor.accounts import Accounts
from jaxnh.engine.kernels.cuda import lane_program
from jaxnh.engine.kernels.source import shapes_of

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
        leaves, structure = jax.tree.flatten((shared, lanes))
        shapes = tuple((np.shape(leaf), getattr(leaf, "dtype", None) or np.result_type(leaf)) for leaf in leaves)
        key = (function, static, shapes, structure, tuple(devices))
        if key not in self._programs:
            with _COMPILING:
                began = time.perf_counter()
                if key not in self._programs:  # by now, as another executor may have needed it
                    self._programs[key] = _compiled(
                        function, static, (shared, lanes), devices, self._options, kept=self._kept
                    )
                accounts.compile_seconds += time.perf_counter() - began
        return self._programs[key]


def _compiled(
    function: Callable[..., Any],
    static: tuple[Any, ...],
    arguments: tuple[Any, Any],
    devices: Sequence[Any],
    options: dict[str, Any],
    *,
    kept: bool,
) -> Any:
    """The program of such calls, from an earlier run or compiled now."""
    structure = jax.tree.structure(arguments)
    leaves = tuple(map(jax.tree.leaves, arguments))
    name = executables.name_of(function, static, arguments, devices) if kept else None
    if name and (program := executables.find(name, jax.tree.structure((leaves, {})), devices)):
        return program

    def one(shared: Any, lane: Any) -> Any:
        return function(*shared, *lane, *static)

    shared, lanes = shapes_of(arguments)
    count = jax.tree.leaves(lanes)[0].shape[0] // len(devices)
    side_by_side = lane_program(one, shared, lanes, count, devices[0]) or jax.vmap(one, in_axes=(None, 0))

    def tile(*leaves: Any) -> Any:
        return side_by_side(*jax.tree.unflatten(structure, jax.tree.leaves(leaves)))

    mesh = Mesh(np.array(devices), ("lanes",))
    split = PartitionSpec("lanes")
    sharded = jax.shard_map(tile, mesh=mesh, in_specs=(PartitionSpec(), split), out_specs=split, check_vma=False)
    lowered = _lower(jax.jit(sharded).trace(*leaves))
    if kept and not name:
        return lowered.compile(options)
    with executables.compiling():
        program = lowered.compile(options)
    if name:
        executables.keep(name, program)
    return program


def _lower(traced: Any) -> Any:
    """Lower a traced program for the platform of its devices."""
    return traced.lower()
