"""Speed of jaxnh beside other integrators: side by side in one run, on named cores, at equal measured error.

    python -m sweeps.peers.particle.peers [--cores 1|2] [--repeats R] [--targets 1e-6 1e-8 1e-10] [--system
    constant_speed] [--held-out 5] [--only lyapunov]

An error is that of one period's map, largest component over all lanes, against a Taylor integration in long double.
Every peer is tuned until its error just meets the target; then all run in turn, several rounds, each in a process of
its own that sleeps while another runs. Then the same on scenes held out (`peers_cases`), with `processed6` and without.
Lyapunov spectra come last, on one core, where the error is that of the derivative of one period's map; alone they take
their section's place in the page that there is. Prints the tables and writes results/peers.md.
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

from rich.console import Console

from sweeps.checks.measured_at import stamp
from sweeps.peers.particle.peers_cases import LANES, Case, paper
from sweeps.peers.particle.peers_cases import held_out as held_out_cases
from sweeps.peers.particle.peers_held_out import held_out
from sweeps.peers.particle.peers_report import (
    AT_OWN_ERROR,
    Row,
    Scaling,
    Study,
    markdown,
    show,
    show_lyapunov,
    spectra,
    with_spectra,
    write,
)
from sweeps.peers.particle.peers_scene import PERIODS, WHOLE, Setting, TangentScene, best
from sweeps.peers.particle.peers_timing import SAMPLE_SECONDS, Entry, entry, interleaved, line, row, timed
from sweeps.peers.particle.peers_worker import Peer, Sample

SYSTEMS = {case.name: case for case in (paper(), paper(0.1))}

CONTESTANTS = ("jaxnh", "heyoka", "diffrax", "diffrax_options", "scipy")
TANGENT_CONTESTANTS = ("jaxnh_tangent", "heyoka_tangent")

_SCALING_TARGET = 1e-8  # the setting of the sections on cores and lanes, where it is among the targets
_SCALING_LANES, _SCALING_PERIODS = (1024, 4096, 16384, 100_000), 16
_TWO_CORES_LANES = 4096


def main() -> None:
    args = _arguments()
    console = Console(width=None if sys.stdout.isatty() else 180)
    began, measured_at = time.perf_counter(), str(stamp())
    available = sorted(os.sched_getaffinity(0))
    if len(available) < args.cores:
        raise SystemExit(f"--cores {args.cores}: this process may run on {len(available)} only")
    cores = available[: args.cores]
    scene = _scenes([SYSTEMS[args.system]])[0]
    console.log(f"true ends and derivatives of one period: {len(scene.b)} lanes")
    cases = held_out_cases()[: args.held_out]
    if args.only == "lyapunov":
        rows = _lyapunov(args, scene, cores[0], console)
        show_lyapunov(rows, console)
        section = spectra(rows, _command(), measured_at)
        write(args.output, lambda before: with_spectra(before, section), console)
        return
    alone = [[core] for core in cores]
    peers = {kind: Peer(kind, scene, [cores] if kind == "jaxnh" else alone) for kind in CONTESTANTS}
    pair = Peer("jaxnh", scene, [available[:2]]) if len(available) > 1 else None
    try:
        entries, tried = _tuned(args.targets, peers, console)
        timed(entries, args.repeats, console)
        chosen = min((e for e in entries if e.name == "jaxnh"), key=lambda e: abs(e.target - _SCALING_TARGET)).setting
        lanes = _lanes_scaling(peers["jaxnh"], chosen, LANES * args.cores, args.repeats)
        two = _core_scaling(pair, chosen, args.repeats) if pair else None
        others = held_out(
            list(zip(cases, _scenes(cases), strict=True)), peers, tried, args.repeats, args.cores, console
        )
    finally:
        for peer in (*peers.values(), *([pair] if pair else [])):
            peer.close()
    exponents = _lyapunov(args, scene, cores[0], console)
    study = Study(
        command=_command(),
        case=SYSTEMS[args.system],
        measured_at=measured_at,
        cores=args.cores,
        repeats=args.repeats,
        rows=[row(e, args.cores) for e in entries],
        tried=tried,
        chosen=chosen,
        lanes=lanes,
        two_cores=two,
        lyapunov=exponents,
        held_out=others,
        seconds=time.perf_counter() - began,
    )
    show(study, console)
    write(args.output, lambda before: markdown(study, before), console)


def _command() -> str:
    return shlex.join(["python", "-m", "sweeps.peers.particle.peers", *sys.argv[1:]])


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m sweeps.peers.particle.peers", description="jaxnh beside other integrators."
    )
    parser.add_argument("--cores", type=int, choices=(1, 2), default=1, help="cores to run on")
    parser.add_argument("--repeats", type=int, default=7, help="rounds of the timing")
    parser.add_argument("--targets", type=float, nargs="+", default=[1e-6, 1e-8, 1e-10], help="largest errors allowed")
    parser.add_argument("--system", choices=tuple(SYSTEMS), default="constant_speed")
    parser.add_argument("--held-out", type=int, default=5, help="scenes held out that are measured, at most 5")
    parser.add_argument("--only", choices=("lyapunov",), help="this section alone, put into the page that there is")
    parser.add_argument("--output", type=Path, default=Path("results/peers.md"))
    return parser.parse_args()


def _scenes(cases: Sequence[Case]) -> list[TangentScene]:
    """The scenes of cases, from a process that ends: this one stays free of every integrator."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return list(pool.map(_true_scene, cases))


def _true_scene(case: Case) -> TangentScene:
    from sweeps.peers.particle.peers_heyoka import equations, true_scene
    from sweeps.peers.particle.peers_heyoka_tangent import true_derivatives

    scene = true_scene(case)
    motion = equations(case.a, case.c, case.d, "angle", "time")
    return TangentScene(**vars(scene), derivatives=true_derivatives(scene, motion))


def _lyapunov(args: argparse.Namespace, scene: TangentScene, core: int, console: Console) -> list[Row]:
    """The rows of Lyapunov spectra."""
    jaxnh, heyoka = peers = [Peer(kind, scene, [[core]]) for kind in TANGENT_CONTESTANTS]
    entries: list[Entry] = []
    try:
        for target in args.targets:
            own = jaxnh.tune(target)
            if not own:
                console.log(f"no splitting of jaxnh has an error of the derivatives of {target:g} over these lanes")
                continue
            first = entry(target, own[0].peer, jaxnh, own[0])
            found = best(heyoka.tune(target, own[:1]))
            second = entry(target, found.peer, heyoka, found, first)
            rows = [first, *(entry(target, s.peer, jaxnh, s, first) for s in own[1:]), second]
            equal = jaxnh.tune(found.errors.max)[:1]
            rows += [entry(target, AT_OWN_ERROR, jaxnh, s, second, jaxnh_over=True) for s in equal]
            rows += [entry(target, WHOLE, jaxnh, replace(s, peer=WHOLE), second, jaxnh_over=True) for s in equal]
            for each in rows:
                console.log(line(each))
            entries += rows
        timed(entries, args.repeats, console)
    finally:
        for peer in peers:
            peer.close()
    return [row(e, 1) for e in entries]


def _tuned(
    targets: Sequence[float], peers: dict[str, Peer], console: Console
) -> tuple[list[Entry], dict[float, list[Setting]]]:
    """The best setting of every row at every target, and all settings that were tried."""
    entries: list[Entry] = []
    tried: dict[float, list[Setting]] = {}
    for target in targets:
        settings: dict[str, list[Setting]] = {}
        rows: dict[str, Entry] = {}
        for kind, peer in peers.items():
            settings[kind] = peer.tune(target, settings.get("diffrax", ()) if kind == "diffrax_options" else ())
            for name in dict.fromkeys(s.peer for s in settings[kind]):
                found = best([s for s in settings[kind] if s.peer == name])
                rows[name] = entry(target, name, peer, found, rows.get("jaxnh"))
                console.log(line(rows[name]))
            if "jaxnh" not in rows:
                raise SystemExit(f"no splitting of jaxnh has an error of one period of {target:g} over these lanes")
        heyoka = rows["heyoka batch"]
        own = peers["jaxnh"].tune(heyoka.setting.errors.max)
        if own:
            rows[AT_OWN_ERROR] = entry(target, AT_OWN_ERROR, peers["jaxnh"], best(own), heyoka, jaxnh_over=True)
        entries += rows.values()
        tried[target] = [s for group in settings.values() for s in group]
    return entries, tried


def _lanes_scaling(peer: Peer, setting: Setting, usual: int, repeats: int) -> list[Scaling]:
    """More lanes and fewer periods a call, all beside the call that the other timings make."""
    calls = [(usual, PERIODS), *((count, _SCALING_PERIODS) for count in (usual, *_SCALING_LANES))]

    def sampler(count: int, periods: int) -> Callable[[], Sample]:
        return lambda: peer.sample(setting, 2 * SAMPLE_SECONDS, count=count, periods=periods)

    return interleaved({f"{count:,} × {n}": sampler(count, n) for count, n in calls}, repeats)


def _core_scaling(peer: Peer, setting: Setting, repeats: int) -> list[Scaling]:
    def sampler(one_device: bool) -> Callable[[], Sample]:
        return lambda: peer.sample(setting, 2 * SAMPLE_SECONDS, count=_TWO_CORES_LANES, one_device=one_device)

    return interleaved({"one device": sampler(True), "two devices": sampler(False)}, repeats)


if __name__ == "__main__":
    main()
