"""Kernels in JAX programs: compiled by NVRTC, called through XLA, which owns memory, streams and devices."""

from __future__ import annotations

import ctypes
import logging
import re
from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from jaxnh.engine.kernels.source import NAME, THREADS, Kernel, write_kernel
from jaxnh.engine.kernels.values import UnsupportedError

_LOG = logging.getLogger(__name__)
_TARGET = "__gpu$xla.gpu.ptx"  # XLA's own call of a kernel given as PTX
_CAPABILITY = re.compile(r"(\d+)\.(\d+)")  # of NVIDIA's devices
_NAMES = ("libnvrtc.so", "libnvrtc.so.13", "libnvrtc.so.12")


def capability_of(device: Any) -> str:
    """Return the capability of a device for which kernels can be compiled here, as "90"; "" where they cannot."""
    capability = _CAPABILITY.fullmatch(str(getattr(device, "compute_capability", "")))
    return "" if capability is None or _nvrtc() is None else capability[1] + capability[2]


def find_kernel(function: Callable[..., Any], shared: Any, lane: Any) -> Kernel | None:
    """Return the kernel of function(shared, lane), or None: it has an operation that kernels do not know.

    Args:
        function: pure function of what all lanes share and of one lane.
        shared: pytree of shapes and types.
        lane: pytree of shapes and types of a lane.
    """
    try:
        return write_kernel(function, shared, lane)
    except UnsupportedError as error:
        _LOG.info("no kernel of %s: %s", getattr(function, "__name__", function), error)
        return None


def run_kernel(kernel: Kernel, capability: str, shared: Any, lanes: Any, asked: Any) -> Any:
    """Run a kernel over lanes, to be traced in a program for the device.

    Args:
        capability: of the device (`capability_of`).
        shared, lanes: pytrees of arrays; those of lanes have them as first axis.
        asked: number of lanes that are computed, the first ones; results of the others are arbitrary.

    Raises:
        RuntimeError: the compiler refuses the kernel.
    """
    count = jax.tree.leaves(lanes)[0].shape[0]
    results = [jax.ShapeDtypeStruct((count, *result.shape), result.dtype) for result in kernel.results]
    arguments = [jnp.asarray(asked, jnp.int64), *jax.tree.leaves((shared, lanes))]
    words = {
        "name": _quoted(NAME),
        "kernel_type": _quoted("ptx"),
        "kernel_data": _quoted(compile_kernel(kernel.text, f"compute_{capability}")),
        "grid_x": -(-count // THREADS),
        "grid_y": 1,
        "grid_z": 1,
        "block_x": THREADS,
        "block_y": 1,
        "block_z": 1,
        "shared_mem_bytes": 0,
        "output_indices": list(range(len(arguments), len(arguments) + len(results))),
    }
    config = ", ".join(f"{name} = {value}" for name, value in words.items())
    run = jax.ffi.ffi_call(_TARGET, results, custom_call_api_version=2, legacy_backend_config=f"{{{config}}}")
    return jax.tree.unflatten(kernel.structure, run(*arguments))


def _quoted(text: str) -> str:
    """Return a string as an attribute of MLIR."""
    escapes = {"\\": "\\\\", '"': '\\"', "\n": "\\0A", "\t": "\\09", "\r": ""}
    return f'"{"".join(escapes.get(letter, letter) for letter in text)}"'


@cache
def _nvrtc() -> Any:
    """Return NVIDIA's compiler for kernels, of the packages that JAX for CUDA installs or of the system, or None."""
    spec = find_spec("nvidia")
    folders = [Path(folder) for folder in (spec.submodule_search_locations or ())] if spec else []
    there = [path for folder in folders for path in sorted(folder.glob("**/libnvrtc.so.*"))]
    for name in (*map(str, there), *_NAMES):
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    return None


@cache
def compile_kernel(text: str, architecture: str) -> str:
    """Compile a kernel to PTX.

    Raises:
        RuntimeError: the compiler refuses it.
    """
    nvrtc, program = _nvrtc(), ctypes.c_void_p()
    options = [f"--gpu-architecture={architecture}".encode(), b"--std=c++17"]

    def checked(code: int, what: str) -> None:
        if code:
            raise RuntimeError(f"NVRTC, {what}: error {code}\n{_text(nvrtc, program, 'Log')}")

    checked(nvrtc.nvrtcCreateProgram(ctypes.byref(program), text.encode(), b"lanes.cu", 0, None, None), "a new program")
    array = (ctypes.c_char_p * len(options))(*options)
    checked(nvrtc.nvrtcCompileProgram(program, len(options), array), "compiling")
    return _text(nvrtc, program, "PTX")


def _text(nvrtc: Any, program: Any, what: str) -> str:
    """Return the log or the result of a compiled program."""
    size = ctypes.c_size_t()
    prefix = "nvrtcGetProgramLog" if what == "Log" else f"nvrtcGet{what}"
    getattr(nvrtc, f"{prefix}Size")(program, ctypes.byref(size))
    buffer = ctypes.create_string_buffer(size.value)
    getattr(nvrtc, prefix)(program, buffer)
    return buffer.value.decode()
