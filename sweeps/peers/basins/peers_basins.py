"""Basins of a pendulum from 100,000 starts, end to end beside pybasin; writes results/peers_basins.md.

    python -m sweeps.peers.basins.peers_basins [--pybasin PYTHON] [--repeats 3] [--starts ACROSS UP]

PYTHON is an interpreter that has pybasin with its extra `jax`; without it there is no peer. Both start from the same
grid of `configs/flows/torque_pendulum.yaml`, in processes of their own that take turns. Alone on a quiet machine.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import jaxnh
from jaxnh.analyses.basins.tables import wilson
from jaxnh.analyses.verdict import KINDS
from sweeps.checks.measured_at import ROOT, stamp
from sweeps.timing.effects import processor

CONFIG = ROOT / "configs" / "flows" / "torque_pendulum.yaml"
_KIND = {"rest": "equilibrium", "rotation": "limit_cycle"}
_HEAD = """\
# Basins beside pybasin

`{command}` runs a damped pendulum under a constant torque
(`configs/flows/torque_pendulum.yaml`) from {starts:,} starts, and pybasin's own benchmark of it from the same ones.
{machine}, {cores} cores.

{measured_at}

Seconds of whole processes, {repeats}: jaxnh with an empty cache of programs and with those kept. jaxnh finds the
attractors, and is done with a lane once its motion has settled, at a target of 1e-8 a unit of time; pybasin integrates
every start to t = 1000 at rtol 1e-8 and atol 1e-6 in double precision (JAX_ENABLE_X64=1), and is given both attractors.
Shares have intervals of 95 % (Wilson), as those of random starts would.
"""


class BasinRun(NamedTuple):
    """One run: seconds of the process, and the share of starts that lead to each kind."""

    seconds: float
    shares: Mapping[str, float]


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m sweeps.peers.basins.peers_basins", description="Basins beside pybasin."
    )
    parser.add_argument("--pybasin", metavar="PYTHON", help="an interpreter that has pybasin")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--starts", type=int, nargs=2, metavar=("ACROSS", "UP"), help="a grid of other sizes")
    parser.add_argument("--output", type=Path, default=ROOT / "results" / "peers_basins.md")
    args = parser.parse_args()
    axes = jaxnh.load(CONFIG).axes
    across, up = args.starts or (len(axis.values) for axis in axes)
    grid = [f"sweep.{axis.name}.count={count}" for axis, count in zip(axes, (across, up), strict=True)]
    measured: dict[str, list[BasinRun]] = {}
    with tempfile.TemporaryDirectory(prefix="jaxnh_basins_") as name:
        for repeat in range(args.repeats):
            folder = Path(name, str(repeat))
            folder.mkdir()
            for cache in ("empty", "kept"):
                measured.setdefault(f"jaxnh, {cache} cache", []).append(_ours(folder, grid))
            if args.pybasin:
                measured.setdefault("pybasin", []).append(_theirs(args.pybasin, across, up))
            last = ", ".join(f"{peer} {samples[-1].seconds:.1f} s" for peer, samples in measured.items())
            print(f"run {repeat + 1} of {args.repeats}: {last}", file=sys.stderr, flush=True)
    head = _HEAD.format(
        command=" ".join(["python -m sweeps.peers.basins.peers_basins", *_without_folders(sys.argv[1:])]),
        starts=across * up,
        machine=processor(),
        cores=len(os.sched_getaffinity(0)),
        measured_at=str(stamp()),
        repeats="one run each" if args.repeats == 1 else f"medians of {args.repeats} runs in turn",
    )
    page = "\n".join([head, *_table(measured, across * up), ""])
    args.output.write_text(page, encoding="utf-8")
    print(page)


def _without_folders(arguments: Sequence[str]) -> list[str]:
    """Arguments of the command line, of paths the name alone."""
    return [Path(one).name if "/" in one else one for one in arguments]


def _ours(folder: Path, grid: Sequence[str]) -> BasinRun:
    """One run of the command from a grid of starts, its programs kept in the folder."""
    result = folder / "result.h5"
    command = [sys.executable, "-m", "jaxnh.sweep", str(CONFIG), *grid]
    command += ["--output", str(result), "--fresh", "--quiet"]
    seconds = _run(command, {"JAX_COMPILATION_CACHE_DIR": str(folder / "cache")})[0]
    attractors = jaxnh.open_result(result)["attractors"].to_dataset()
    kinds = [KINDS[int(kind)] for kind in attractors["kind"].to_numpy()]
    found = dict(zip(kinds, attractors["fraction"].to_numpy().tolist(), strict=True))
    return BasinRun(seconds, {kind: found[_KIND[kind]] for kind in _KIND})


def _theirs(python: str, across: int, up: int) -> BasinRun:
    worker = Path(__file__).with_name("peers_basins_pybasin.py")
    seconds, printed = _run([python, "-P", str(worker), str(across), str(up)], {"JAX_ENABLE_X64": "1"})
    return BasinRun(seconds, json.loads(printed.splitlines()[-1])["shares"])


def _run(command: Sequence[str], environment: Mapping[str, str]) -> tuple[float, str]:
    """Seconds that a process takes, and what it prints.

    Raises:
        RuntimeError: it failed.
    """
    began = time.perf_counter()
    done = subprocess.run(command, env={**os.environ, **environment}, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} failed: {done.stderr.strip()[-500:]}")
    return time.perf_counter() - began, done.stdout


def _table(measured: Mapping[str, Sequence[BasinRun]], starts: int) -> Iterator[str]:
    """Lines of the page, a row a peer."""
    ours = statistics.median(sample.seconds for sample in measured["jaxnh, kept cache"])
    yield "| | seconds | over jaxnh with programs kept | rest | rotation |"
    yield "| --- | --- | --- | --- | --- |"
    for peer, samples in measured.items():
        seconds = statistics.median(sample.seconds for sample in samples)
        shares = [_interval(samples[-1].shares[kind], starts) for kind in _KIND]
        yield f"| {peer} | {seconds:.1f} | {seconds / ours:.2f}× | {shares[0]} | {shares[1]} |"


def _interval(share: float, starts: int) -> str:
    low, high = wilson(round(share * starts), starts)  # pyright: ignore[reportArgumentType]
    return f"{100 * share:.2f} % [{100 * float(low):.2f}, {100 * float(high):.2f}]"


if __name__ == "__main__":
    main()
