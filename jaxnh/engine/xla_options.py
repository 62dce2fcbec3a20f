"""The one place that prepares JAX: double precision, CPU devices, XLA options and the cache of compiled programs.

All of it but double precision has to be set before JAX starts, that is before its first array or device. The commands,
`Session` and `jaxnh.run` call `configure`; where JAX has started by then, it warns and goes on: results are as
accurate, but slower.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import warnings
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax

from jaxnh.config.config import Config
from jaxnh.exceptions import JaxStartedWarning

_XLA_OPTIONS = {
    # The loop over kicks becomes one LLVM function, where each operation of it would be a call of its own: 2.0 ns a
    # kick in place of 4.0 (one core with AVX2). The operation counts of tests/costs notice where this is undone.
    "xla_cpu_small_while_loop_byte_threshold": "1000000000000",
    # Outputs of one shape share one loop, where each would compute the force anew.
    "xla_cpu_use_multi_output_fusion": "true",
}
# Two vectors in flight hide the latency of a kick's division; four no more leave registers enough for tangents. LLVM
# ends the process at an option that it does not know, so this one is kept to releases it was tried with. Without it the
# loop takes one vector a turn, and JAX 0.12 was 8 % slower than 0.10 in maps and 26 % in spectra; with it the loops of
# both have as many vector instructions (objdump of the object code; not timed). `make release-check` sees, of all
# options, whether they still act.
_LLVM_OPTION, _LLVM_TRIED = "-force-vector-interleave=2", ("0.10.", "0.11.", "0.12.")
_WIDTH = "--xla_cpu_prefer_vector_width"
_VECTORS = re.compile(r"avx2?|avx512(f|dq|vl|bw)|fma|asimd|sve2?")  # what arithmetic in float64 is compiled to
_NO_MATTER = re.compile(r"--xla_dump\w*|--xla_force_host_platform_device_count")  # options that change no number
_PROCESSOR_LINES = ("vendor_id", "cpu family", "model", "stepping", "flags", "CPU ", "Features")  # of /proc/cpuinfo
_in_effect: list[str] = []  # XLA_FLAGS as JAX has read them, once it is known


def configure(devices: int | None = None) -> None:
    """Prepare JAX: double precision, one CPU device a core, fast loops, and compiled programs kept from run to run.

    `JAX_NUM_CPU_DEVICES`, `JAX_CPU_ENABLE_ASYNC_DISPATCH`, `JAX_COMPILATION_CACHE_DIR` and options of XLA named here,
    where set, are left as they are.

    Args:
        devices: CPU devices, by default one a core.

    Warns:
        JaxStartedWarning: JAX had started without these options.
    """
    jax.config.update("jax_enable_x64", True)
    wanted = _flags(os.environ.get("XLA_FLAGS", ""))
    late = wanted != os.environ.get("XLA_FLAGS") and _has_started()
    if not _in_effect:
        _in_effect.append(os.environ.get("XLA_FLAGS", "") if late else wanted)
    os.environ["XLA_FLAGS"] = wanted
    os.environ.setdefault("EQX_ON_ERROR", "nan")  # no host callbacks: they keep diffrax programs out of the cache
    if "JAX_NUM_CPU_DEVICES" not in os.environ and not _has_started():
        jax.config.update("jax_num_cpu_devices", devices or len(cores()))
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        jax.config.update("jax_compilation_cache_dir", str(root / "jaxnh" / "programs"))
    if "JAX_CPU_ENABLE_ASYNC_DISPATCH" not in os.environ:
        # A program runs in the thread that calls it: handing it over took 4 % of a chart's seconds, four runners on two
        # cores, and gained nothing, as all wait for what they call.
        jax.config.update("jax_cpu_enable_async_dispatch", False)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    if late:
        warnings.warn(
            "JAX had started before jaxnh could set its options: it runs on "
            f"{len(jax.devices())} device(s) and without jaxnh's XLA options, more slowly; make a jaxnh.Session, or "
            "call jaxnh.run, before the first use of JAX",
            JaxStartedWarning,
            stacklevel=3,
        )


def machine(device: Any, flags: str | None = None) -> dict[str, str]:
    """The machine that decides the last bits: the kind of processor, and XLA's options.

    Args:
        device: of JAX.
        flags: XLA_FLAGS, by default those in effect in this process.

    Returns:
        `processor`: of a CPU its architecture and vector extensions, of another device its kind; `xla_options`.
    """
    options = (_in_effect[0] if _in_effect else os.environ.get("XLA_FLAGS", "")) if flags is None else flags
    kept = sorted(option for option in options.split() if not _NO_MATTER.match(option))
    kind = _processor() if device.platform == "cpu" else f"{device.platform} {device.device_kind}"
    return {"processor": kind, "xla_options": " ".join(kept)}


def describe_differences(made: Mapping[str, str], own: Mapping[str, str]) -> str:
    """Describe how tiles made on one machine differ from those of another; "" where they do not."""
    if made == own:
        return ""
    key, what = ("processor", "") if made.get("processor") != own["processor"] else ("xla_options", "XLA options ")
    told = f"of {what}[{made.get(key, 'unknown')}], and here it is {what}[{own[key]}], whose last bits may differ"
    return f"{told}: go on where they were made"


def flags_of_a_process() -> str:
    """XLA_FLAGS of a child process, once it is configured."""
    return _flags(os.environ.get("XLA_FLAGS", ""))


def _processor() -> str:
    """Architecture and vector extensions of this machine's CPU."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        words = next(line for line in lines if line.startswith(("flags", "Features"))).split(":", 1)[1].split()
    except (OSError, StopIteration, IndexError):
        words = []  # no Linux: the name has to do
    extensions = sorted(filter(_VECTORS.fullmatch, words))
    return " ".join([platform.machine(), *(extensions or [platform.processor()])]).strip()


def devices_of(config: Config) -> list[Any]:
    """Return the devices of JAX that compute.

    Where they are graphics cards, what is computed outside of their programs, tables and single numbers, stays on the
    host from now on.

    Raises:
        ConfigError: JAX finds none of the kind that the config names.
    """
    try:
        devices = jax.devices(config.device)
    except RuntimeError:
        raise config.missing_device(", ".join(sorted({device.device_kind for device in jax.devices()}))) from None
    if devices[0].platform != "cpu":
        jax.config.update("jax_default_device", jax.devices("cpu")[0])
    return devices


@cache
def host() -> str:
    """Hash of the description of the processor: compiled code is for this kind alone."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = [platform.processor(), platform.node()]
    kept = sorted({line for line in lines if line.startswith(_PROCESSOR_LINES)} or set(lines))
    return hashlib.sha256("\n".join([platform.machine(), *kept]).encode()).hexdigest()


def _flags(given: str) -> str:
    """XLA_FLAGS with the options of this package, where they are not named already."""
    flags = given
    if "--xla_backend_extra_options" not in flags:
        options = [f"{name}={value}" for name, value in _XLA_OPTIONS.items()]
        if version("jaxlib").startswith(_LLVM_TRIED):
            options.append(_LLVM_OPTION)
        flags = f"{flags} --xla_backend_extra_options={','.join(options)}".strip()
    if _WIDTH not in flags:
        flags = f"{flags} {_WIDTH}=512".strip()  # where the processor has it: vectors of eight lanes, not four
    return flags


def cores() -> list[int]:
    """Numbers of the cores that this process may use; all cores where the system does not tell, as on macOS."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def _has_started() -> bool:
    """Return whether JAX has started its devices. Their number is then fixed."""
    before = jax.config.jax_num_cpu_devices  # pyright: ignore[reportAttributeAccessIssue]
    try:
        jax.config.update("jax_num_cpu_devices", 2 if before == 1 else 1)
    except RuntimeError:
        return True
    jax.config.update("jax_num_cpu_devices", before)
    return False
