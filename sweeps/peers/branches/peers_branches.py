"""Bifurcations of two published flows beside other continuation programs; writes results/peers_branches.md.

    python -m sweeps.peers.branches.peers_branches [--jaxcont PYTHON] [--xpplab PYTHON] [--limit SECONDS] [--only CASE
    ...]

PYTHON is an interpreter that has JaxCont, or xpplab with the AUTO of XPPAUT; what is not named is left out. All run in
processes of their own, one after the other. Values are held against heyoka's Taylor integrator with a Newton of its own
(`tests/helpers/heyoka_newton.py`). Alone on a quiet machine.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jaxnh
from jaxnh.orbits.continuation.kinds import KINDS
from sweeps.checks.measured_at import ROOT, stamp
from sweeps.timing.effects import processor

_NEAR = 0.1  # of the range: a point of the same kind further away is another one
_OVERRIDES = ("accuracy.target=1e-10", "analyses.branches.max_period=1")
_HEAD = """\
# Branches beside other continuation programs

`{command}` follows the cycles of two published flows and marks their bifurcations. {machine}, {cores} cores.

{measured_at}

Seconds of whole processes, one run each: jaxnh with an empty cache of programs and with those kept, at a target of
1e-10; and of a second run in a session of Python. AUTO is XPPAUT's, by xpplab, from a Hopf point, with tolerances of
1e-7 (1e-6 for special points) in place of its 1e-4. JaxCont in double precision has a cycle that attracts to begin
with, and 25 or 50 intervals of four points. MatCont's and BifurcationKit's numbers are those that are published, and
were not computed here. In brackets: how far from heyoka's value.
"""


class BranchCase(NamedTuple):
    """A flow of `configs/flows`, and what is known of its bifurcations of cycles.

    Attributes:
        section: coordinate, level and direction, as in the config.
        others: coordinates that points of the section have.
        published: who, where, and the values by kind.
    """

    name: str
    axis: str
    section: tuple[int, float, int]
    others: tuple[str, ...]
    published: tuple[str, Mapping[str, float]]


CASES = (
    BranchCase(
        "circuit",
        "nu",
        (2, 0.02, 1),
        ("x", "y"),
        (
            "MatCont 7.6, `testtorBPC1`, as JaxCont's validation suite has it",
            {"fold": -0.584492842421877, "neimark_sacker": -0.595750403989607, "period_doubling": -0.61468165370709},
        ),
    ),
    BranchCase(
        "peroxidase",
        "k8",
        (0, 5.9, -1),
        ("b", "x", "y"),
        (
            "BifurcationKit, documentation of version 0.3.2, Steinmetz–Larter",
            {"fold": 0.84391360, "neimark_sacker": 0.82521357},
        ),
    ),
)


class Run(NamedTuple):
    """Points (kind, value) that a program found, its seconds, or in words why there are none."""

    found: Sequence[tuple[str, float]]
    seconds: float | None
    failed: str = ""


class Exact(NamedTuple):
    """A bifurcation by heyoka."""

    kind: str
    value: float


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m sweeps.peers.branches.peers_branches", description="Branches beside others."
    )
    parser.add_argument("--jaxcont", metavar="PYTHON", help="an interpreter that has JaxCont")
    parser.add_argument("--xpplab", metavar="PYTHON", help="an interpreter that has xpplab")
    parser.add_argument("--limit", type=float, default=900.0, metavar="SECONDS", help="of one process")
    parser.add_argument("--only", nargs="+", choices=[case.name for case in CASES], metavar="CASE")
    parser.add_argument("--output", type=Path, default=ROOT / "results" / "peers_branches.md")
    args = parser.parse_args()
    lines = list[str]()
    for case in CASES:
        if args.only and case.name not in args.only:
            continue
        runs, exact = _ours(case, args.limit)
        for label, python, worker in (
            ("AUTO (xpplab)", args.xpplab, "peers_branches_xpplab.py"),
            ("JaxCont", args.jaxcont, "peers_branches_jaxcont.py"),
        ):
            if python:
                runs[label] = _theirs(python, worker, case.name, args.limit)
        who, values = case.published
        runs[who] = Run(list(values.items()), None)
        lines += _part(case, exact, runs)
    head = _HEAD.format(
        command=" ".join(["python -m sweeps.peers.branches.peers_branches", *(Path(one).name for one in sys.argv[1:])]),
        machine=processor(),
        cores=len(os.sched_getaffinity(0)),
        measured_at=str(stamp()),
    )
    page = "\n".join([head, *lines])
    args.output.write_text(page, encoding="utf-8")
    print(page)


def _ours(case: BranchCase, limit: float) -> tuple[dict[str, Run], list[Exact]]:
    """Runs of the command with an empty and a kept cache, and its points by heyoka."""
    runs, config = dict[str, Run](), ROOT / "configs" / "flows" / f"{case.name}.yaml"
    with tempfile.TemporaryDirectory(prefix="jaxnh_branches_") as folder:
        result = Path(folder, "result.h5")
        command = [sys.executable, "-m", "jaxnh.sweep", str(config), *_OVERRIDES]
        command += ["--output", str(result), "--fresh", "--quiet"]
        for cache in ("empty", "kept"):
            seconds, _ = _process(command, {"JAX_COMPILATION_CACHE_DIR": str(Path(folder, "cache"))}, limit)
            data = jaxnh.open_result(result)["bifurcations"].to_dataset()
            kinds = [KINDS[int(kind)] for kind in data["kind"].to_numpy()]
            found = list(zip(kinds, data[case.axis].to_numpy().tolist(), strict=True))
            runs[f"jaxnh, {cache} cache"] = Run(found, seconds)
        points = [[float(data[name][k]) for name in case.others] for k in range(len(kinds))]
    runs["jaxnh, again in a session"] = Run(found, _again_in_a_session(config))
    exact = _by_heyoka(case, [(*pair, u) for pair, u in zip(found, points, strict=True)])
    return runs, exact


def _again_in_a_session(config: Path) -> float:
    """Seconds of the second run of two in one session."""
    session, seconds = jaxnh.Session(jaxnh.load(config, _OVERRIDES)), 0.0
    for _ in range(2):
        began = time.perf_counter()
        session.tree()
        seconds = time.perf_counter() - began
    return seconds


def _by_heyoka(case: BranchCase, found: Sequence[tuple[str, float, list[float]]]) -> list[Exact]:
    """Bifurcations of cycles, by the reference of the tests: its code and equations share nothing with the package."""
    from tests.flows import cycles
    from tests.helpers import heyoka_newton

    rates: dict[str, Callable[..., Any]] = {
        "circuit": cycles.circuit(0.001, 0.32858, 0.93358),
        "peroxidase": cycles.peroxidase,
    }
    image = heyoka_newton.section_map(rates[case.name], len(case.others) + 1, *case.section)
    cycles = [point for point in found if point[0] in heyoka_newton.TESTS]
    return [Exact(kind, heyoka_newton.bifurcation(image, kind, value, u)[0]) for kind, value, u in cycles]


def _theirs(python: str, worker: str, case: str, limit: float) -> Run:
    path = Path(__file__).with_name(worker)
    try:
        seconds, printed = _process([python, "-P", str(path), case], {"JAX_PLATFORMS": "cpu"}, limit)
    except subprocess.TimeoutExpired:
        return Run([], None, f"ended after {limit:g} s")
    except RuntimeError as error:
        return Run([], None, str(error).splitlines()[-1])
    return Run([(kind, value) for kind, value in json.loads(printed.splitlines()[-1])["found"]], seconds)


def _process(command: Sequence[str], environment: Mapping[str, str], limit: float) -> tuple[float, str]:
    """Seconds that a process takes, and what it prints.

    Raises:
        RuntimeError: it failed.
        subprocess.TimeoutExpired: it took longer than the limit.
    """
    began = time.perf_counter()
    done = subprocess.run(
        command, env={**os.environ, **environment}, capture_output=True, text=True, check=False, timeout=limit
    )
    if done.returncode:
        raise RuntimeError(f"{Path(command[-1]).name} failed: {done.stderr.strip()[-300:]}")
    return time.perf_counter() - began, done.stdout


def _part(case: BranchCase, exact: Sequence[Exact], runs: Mapping[str, Run]) -> Iterator[str]:
    """Lines of one flow: a row a program, a column a bifurcation of cycles; the others that it found are counted."""
    width = abs(max(point.value for point in exact) - min(point.value for point in exact))
    yield f"## {case.name} (`configs/flows/{case.name}.yaml`), over {case.axis}"
    yield ""
    yield "| | " + " | ".join(point.kind.replace("_", " ") for point in exact) + " | other points | seconds |"
    yield "| --- |" + " --- |" * (len(exact) + 2)
    yield "| heyoka | " + " | ".join(f"{point.value:.12g}" for point in exact) + " | | |"
    for label, run in runs.items():
        nearest = [_nearest(point, run.found, _NEAR * width) for point in exact]
        cells = [
            "–" if value is None else f"{value:.12g} ({abs(value - point.value):.1e})"
            for point, value in zip(exact, nearest, strict=True)
        ]
        others = [f"{kind.replace('_', ' ')} {value:.9g}" for kind, value in run.found if value not in nearest]
        seconds = "" if run.seconds is None else f"{run.seconds:.1f}"
        yield f"| {label} | {' | '.join(cells)} | {', '.join(others) or run.failed} | {seconds} |"
    yield ""


def _nearest(point: Exact, found: Sequence[tuple[str, float]], near: float) -> float | None:
    """The nearest value of the same kind, None where there is none nearby."""
    same = [value for kind, value in found if kind == point.kind and abs(value - point.value) < near]
    return min(same, key=lambda value: abs(value - point.value), default=None)


if __name__ == "__main__":
    main()
