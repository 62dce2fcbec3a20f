"""Kernels of lanes compiled as C++ for the host, and run there."""

from __future__ import annotations

import ctypes
import hashlib
import shutil
import subprocess
from functools import cache
from pathlib import Path
from unittest import mock

import jax
import numpy as np

from jaxnh.engine.executor.programs import Programs
from jaxnh.engine.kernels.source import NAME, shapes_of, write_kernel
from jaxnh.engine.kernels.values import UnsupportedError

COMPILER = shutil.which("g++") or shutil.which("clang++")
_FLAGS = ("-std=c++17", "-O1", "-w", "-shared", "-fPIC", "-ffp-contract=off")


def run_kernel(folder, function, shared, lanes, static=()):
    """function(*shared, *lane, *static) of all lanes by its kernel, as a pytree of arrays."""
    one = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), shapes_of(lanes))
    kernel = write_kernel(lambda shared, lane: function(*shared, *lane, *static), shapes_of(shared), one)
    inputs = [np.ascontiguousarray(leaf) for leaf in jax.tree.leaves((shared, lanes))]
    count = np.array(len(jax.tree.leaves(lanes)[0]), np.int64)
    results = [np.empty((int(count), *result.shape), result.dtype) for result in kernel.results]
    run = getattr(ctypes.CDLL(str(_library(folder, kernel.text))), NAME)
    run(*(ctypes.c_void_p(array.ctypes.data) for array in (count, *inputs, *results)))
    return jax.tree.unflatten(kernel.structure, results)


@cache
def _library(folder: Path, text: str) -> Path:
    name = folder / hashlib.sha256(text.encode()).hexdigest()[:20]
    name.with_suffix(".cpp").write_text(text)
    assert COMPILER is not None
    command = [COMPILER, *_FLAGS, "-o", name.with_suffix(".so"), name.with_suffix(".cpp")]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr[:2000]
    return name.with_suffix(".so")


class HeldPrograms:
    """Programs of executors, each first call of which is held against its kernel's.

    Attributes:
        held: names of the functions that were.
        without: names of those without a kernel, with the reason.
        apart: largest difference of a number, over 1 or its size.
    """

    def __init__(self, folder):
        self.folder, self.held, self.without, self.apart = folder, [], {}, 0.0
        self._find = Programs._find_or_compile

    def patch(self):
        """Hold all programs that are found inside this context."""
        held = self

        def find(programs, function, static, arguments, devices):
            program, left = held._find(programs, function, static, arguments, devices), [function.__name__]

            def run(shared, lanes, *asked):
                results = program(shared, lanes, *asked)
                if left:
                    own = jax.tree.unflatten(jax.tree.structure(arguments), [*shared, *lanes])
                    held.hold(left.pop(), function, own, static, results)
                return results

            run.as_text = program.as_text
            return run

        return mock.patch.object(Programs, "_find_or_compile", find)

    def hold(self, name, function, arguments, static, results):
        """Hold results against those of the kernel."""
        shared, lanes = jax.tree.map(np.asarray, arguments)
        try:
            mine = run_kernel(self.folder, function, shared, lanes, static)
        except UnsupportedError as error:
            self.without[name] = str(error)
            return
        self.held.append(name)
        for x, y in zip(jax.tree.leaves(jax.tree.map(np.asarray, results)), jax.tree.leaves(mine), strict=True):
            assert (x.shape, x.dtype) == (y.shape, y.dtype)
            same = (x == y) | ((x != x) & (y != y))
            with np.errstate(invalid="ignore", over="ignore"):
                apart = np.where(same, 0.0, abs(x.astype(float) - y.astype(float)) / np.fmax(1.0, abs(x.astype(float))))
            self.apart = max(self.apart, float(apart.max(initial=0.0)))
