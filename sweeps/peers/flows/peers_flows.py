"""Speed of jaxnh on flows that users write, beside heyoka's batch integrator and stock diffrax, on one core.

    python -m sweeps.peers.flows.peers_flows [--repeats R] [--targets 1e-6 1e-8 1e-10] [--only NAME ...] [--part
    maps|spectra]

Spectra are held against lyapax and pynamicalsys as well where they are installed (`pip install 'jaxnh[peers]'`).
Everything as `sweeps.peers.particle.peers` does it: true ends and derivatives in long double, every peer tuned to a
measured largest error, samples of all in turn. Writes results/peers_flows.md; with `--only` or `--part` the tables are
printed alone.
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from rich.console import Console

from sweeps.checks.measured_at import stamp
from sweeps.peers.flows.peers_flow_cases import CASES, LANES, FlowCase, FlowScene
from sweeps.peers.flows.peers_flows_report import OTHERS, FlowRows, FlowStudy, markdown, show
from sweeps.peers.particle.peers_report import AT_OWN_ERROR, Row, write
from sweeps.peers.particle.peers_scene import WHOLE, Setting, best
from sweeps.peers.particle.peers_timing import Entry, entry, line, row, timed
from sweeps.peers.particle.peers_worker import Peer

MAPS = ("flow_jaxnh", "flow_heyoka", "flow_diffrax")
SPECTRA = (
    "flow_jaxnh_tangent",
    "flow_heyoka_tangent",
    *(f"flow_{name}_tangent" for name in OTHERS if find_spec(name)),
)
_FORMS = 4  # of heyoka's: at later targets the fastest of the first alone are tried


def main() -> None:
    args = _arguments()
    console = Console(width=None if sys.stdout.isatty() else 180)
    began, measured_at = time.perf_counter(), str(stamp())
    core = min(os.sched_getaffinity(0))
    flows = []
    for case in (CASES[name] for name in args.only or CASES):
        scene = true_scene(case, np.linspace(case.low, case.high, args.lanes))
        console.log(f"{case.name}: true ends and derivatives of {len(scene.b)} lanes")
        maps = _rows(MAPS, scene, core, args, console) if args.part != "spectra" else []
        spectra = _rows(SPECTRA, scene, core, args, console) if args.part != "maps" else []
        flows.append(FlowRows(case, maps, spectra))
    command = shlex.join(["python", "-m", "sweeps.peers.flows.peers_flows", *sys.argv[1:]])
    study = FlowStudy(command, measured_at, args.repeats, args.lanes, flows, time.perf_counter() - began)
    show(study, console)
    if args.only or args.part:
        return
    write(args.output, lambda before: markdown(study, before), console)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m sweeps.peers.flows.peers_flows", description="jaxnh's flows beside others."
    )
    parser.add_argument("--repeats", type=int, default=7, help="rounds of the timing")
    parser.add_argument("--targets", type=float, nargs="+", default=[1e-6, 1e-8, 1e-10], help="largest errors allowed")
    parser.add_argument("--only", nargs="+", choices=tuple(CASES), help="these flows alone, printed and not written")
    parser.add_argument("--part", choices=("maps", "spectra"), help="this part alone, printed and not written")
    parser.add_argument("--lanes", type=int, default=LANES, help="values of each flow's parameter, a multiple of 32")
    parser.add_argument("--output", type=Path, default=Path("results/peers_flows.md"))
    args = parser.parse_args()
    if args.lanes < 32 or args.lanes % 32:
        parser.error(f"--lanes: must be a multiple of 32, as heyoka's largest batches need it, not {args.lanes}")
    return args


def true_scene(case: FlowCase, values: np.ndarray) -> FlowScene:
    """The scene of a flow, from a process that ends: this one stays free of every integrator."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(_true_scene, case.name, values).result()


def _true_scene(name: str, values: np.ndarray) -> FlowScene:
    from sweeps.peers.flows.peers_flow_heyoka import true_scene

    return true_scene(CASES[name], values)


def _rows(kinds: Sequence[str], scene: FlowScene, core: int, args: argparse.Namespace, console: Console) -> list[Row]:
    """The rows of one flow at all targets: jaxnh, heyoka, and what else there is among the kinds."""
    peers = [Peer(kind, scene, [[core]]) for kind in kinds]
    entries: list[Entry] = []
    hints: list[Sequence[Setting]] = [()] * len(peers)
    try:
        for target in sorted(args.targets, reverse=True):
            entries += _tuned(target, peers, hints, console)
        timed(entries, args.repeats, console)
    finally:
        for peer in peers:
            peer.close()
    return [row(e, 1) for e in entries]


def _tuned(target: float, peers: Sequence[Peer], hints: list[Sequence[Setting]], console: Console) -> list[Entry]:
    """Rows at one target; none where jaxnh does not reach it. The fastest forms are hints for the next target."""
    jaxnh, heyoka, *others = peers
    own = jaxnh.tune(target)
    if not own:
        console.log(f"{target:.0e}: no solver of jaxnh has so small an error over these lanes")
        return []
    first = entry(target, "jaxnh", jaxnh, best(own))
    tangents = [best(own)] if first.setting.parts else []
    theirs = heyoka.tune(target, tangents or hints[1], only=bool(hints[1]) and not tangents)
    hints[1] = _fastest(theirs, _FORMS)
    second = entry(target, "heyoka batch", heyoka, best(theirs), first)
    rows = [first, second]
    for k, peer in enumerate(others, 2):
        found = peer.tune(target, tangents or hints[k], only=bool(hints[k]) and not tangents)
        hints[k] = _fastest(found, 1)
        rows += [entry(target, s.peer, peer, s, first) for s in hints[k]]
    equal = jaxnh.tune(second.setting.errors.max)
    if equal:
        found = best(equal)
        rows.append(entry(target, AT_OWN_ERROR, jaxnh, found, second, jaxnh_over=True))
        if found.parts:
            rows.append(entry(target, WHOLE, jaxnh, replace(found, peer=WHOLE), second, jaxnh_over=True))
    for each in rows:
        console.log(line(each))
    return rows


def _fastest(settings: Sequence[Setting], count: int) -> list[Setting]:
    return sorted(settings, key=lambda s: -s.rate)[:count]


if __name__ == "__main__":
    main()
