"""The one place that prepares JAX: double precision, devices, XLA options and the cache of compiled programs."""

from __future__ import annotations

import os
from importlib.metadata import version
from pathlib import Path

import jax

_XLA_OPTIONS = {
    # The loop over kicks becomes one LLVM function, where each operation of it would be a call of its own.
    "xla_cpu_small_while_loop_byte_threshold": "1000000000000",
    # Outputs of one shape share one loop, where each would compute the force anew.
    "xla_cpu_use_multi_output_fusion": "true",
}

_LLVM_OPTION, _LLVM_TRIED = "-force-vector-interleave=2", "0.10."

_WIDTH = "--xla_cpu_prefer_vector_width"


def configure(devices: int | None = None) -> None:
    """Prepare JAX before its first use: one CPU device a core, fast loops, and compiled programs kept from run to run.

    `JAX_NUM_CPU_DEVICES`, `JAX_COMPILATION_CACHE_DIR` and options of XLA named here, where set, are left as
    they are.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if "--xla_backend_extra_options" not in flags:
        options = [f"{name}={value}" for name, value in _XLA_OPTIONS.items()]
        if version("jaxlib").startswith(_LLVM_TRIED):
            options.append(_LLVM_OPTION)
        flags = f"{flags} --xla_backend_extra_options={','.join(options)}".strip()
    if _WIDTH not in flags:
        flags = f"{flags} {_WIDTH}=512".strip()  # where the processor has it: vectors of eight lanes, not four
    os.environ["XLA_FLAGS"] = flags
    os.environ.setdefault("EQX_ON_ERROR", "nan")  # no host callbacks: they keep diffrax programs out of the cache
    if "JAX_NUM_CPU_DEVICES" not in os.environ:
        count = devices or len(os.sched_getaffinity(0))
        if jax.config.jax_num_cpu_devices != count:  # pyright: ignore[reportAttributeAccessIssue]
            jax.config.update("jax_num_cpu_devices", count)
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        jax.config.update("jax_compilation_cache_dir", str(root / "jaxnh" / "programs"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
