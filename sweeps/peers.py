"""How fast jaxnh is beside other integrators: side by side in one run, on named cores, at equal measured error.

    python -m sweeps.peers [--cores 1|2] [--repeats R] [--targets 1e-6 1e-8 1e-10] [--system constant_speed]
        [--only lyapunov]

An error is that of one period's map, largest component over all lanes, against a Taylor integration in long double.
Every peer is tuned until its error just meets the target; then all run in turn, several rounds, each in a process of
its own that sleeps while another runs. Prints the tables and writes results/peers.md. Lyapunov spectra come last, on
one core, where the error is that of the derivative of one period's map; alone they are printed only.
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

from sweeps.peers_report import AT_OWN_ERROR, Row, Scaling, Study, markdown, show, show_lyapunov
from sweeps.peers_scene import Setting, TangentScene, best
from sweeps.peers_worker import Peer, Sample

SYSTEMS = {"constant_speed": 0.0, "disturbed_speed": 0.1}
"""d of each system; a = 0.5 and c = 1."""

CONTESTANTS = ("jaxnh", "heyoka", "diffrax", "diffrax_options", "scipy")
TANGENT_CONTESTANTS = ("jaxnh_tangent", "heyoka_tangent")

_SAMPLE_SECONDS = 0.4
_SCALING_TARGET = 1e-8  # the setting of the sections on cores and lanes, where it is among the targets
_SCALING_LANES = (1024, 4096, 16384, 100_000)
_SCALING_PERIODS = 16
_TWO_CORES_LANES = 4096


class Entry(NamedTuple):
    """A row of the table while it is measured: samples of its own, each with one of the row it is compared with."""

    target: float
    name: str
    peer: Peer
    setting: Setting
    reference: Entry | None
    pairs: list[tuple[Sample, Sample]]


def main() -> None:
    args = _arguments()
    console = Console(width=None if sys.stdout.isatty() else 180)
    began = time.perf_counter()
    available = sorted(os.sched_getaffinity(0))
    if len(available) < args.cores:
        raise SystemExit(f"--cores {args.cores}: this process may run on {len(available)} only")
    cores = available[: args.cores]
    scene = _scene(args.system)
    console.log(f"true ends and derivatives of one period: {len(scene.b)} lanes")
    if args.only == "lyapunov":
        show_lyapunov(_lyapunov(args, scene, cores[0], console), console)
        return
    alone = [[core] for core in cores]
    peers = {kind: Peer(kind, scene, [cores] if kind == "jaxnh" else alone) for kind in CONTESTANTS}
    pair = Peer("jaxnh", scene, [available[:2]]) if len(available) > 1 else None
    try:
        entries, tried = _tuned(args.targets, peers, console)
        _timed(entries, args.repeats, console)
        chosen = min((e for e in entries if e.name == "jaxnh"), key=lambda e: abs(e.target - _SCALING_TARGET)).setting
        lanes = _lanes_scaling(peers["jaxnh"], chosen, args.repeats)
        two = _core_scaling(pair, chosen, args.repeats) if pair else None
    finally:
        for peer in (*peers.values(), *([pair] if pair else [])):
            peer.close()
    spectra = _lyapunov(args, scene, cores[0], console)
    study = Study(
        command=shlex.join(["python", "-m", "sweeps.peers", *sys.argv[1:]]),
        system=args.system,
        cores=args.cores,
        repeats=args.repeats,
        rows=[_row(e, args.cores) for e in entries],
        tried=tried,
        chosen=chosen,
        lanes=lanes,
        two_cores=two,
        lyapunov=spectra,
        seconds=time.perf_counter() - began,
    )
    show(study, console)
    args.output.parent.mkdir(parents=True, exist_ok=True)
    before = args.output.read_text(encoding="utf-8") if args.output.exists() else ""
    args.output.write_text(markdown(study, before), encoding="utf-8")
    console.print(f"wrote {args.output}")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m sweeps.peers", description="jaxnh beside other integrators.")
    parser.add_argument("--cores", type=int, choices=(1, 2), default=1, help="cores to run on")
    parser.add_argument("--repeats", type=int, default=7, help="rounds of the timing")
    parser.add_argument("--targets", type=float, nargs="+", default=[1e-6, 1e-8, 1e-10], help="largest errors allowed")
    parser.add_argument("--system", choices=tuple(SYSTEMS), default="constant_speed")
    parser.add_argument("--only", choices=("lyapunov",), help="this section alone, printed and not written")
    parser.add_argument("--output", type=Path, default=Path("results/peers.md"))
    return parser.parse_args()


def _scene(system: str) -> TangentScene:
    """The scene, from a process that ends: this one stays free of every integrator."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(_true_scene, SYSTEMS[system]).result()


def _true_scene(d: float) -> TangentScene:
    from sweeps.peers_heyoka import true_scene  # only in the process above
    from sweeps.peers_heyoka_tangent import true_derivatives

    scene = true_scene(0.5, 1.0, d)
    return TangentScene(**vars(scene), derivatives=true_derivatives(scene))


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
            first = Entry(target, own[0].peer, jaxnh, own[0], None, [])
            others = [Entry(target, s.peer, jaxnh, s, first, []) for s in own[1:]]
            found = best(heyoka.tune(target))
            rows = [first, *others, Entry(target, found.peer, heyoka, found, first, [])]
            for row in rows:
                console.log(_line(row))
            entries += rows
        _timed(entries, args.repeats, console)
    finally:
        for peer in peers:
            peer.close()
    return [_row(e, 1) for e in entries]


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
                rows[name] = Entry(
                    target, name, peer, best([s for s in settings[kind] if s.peer == name]), rows.get("jaxnh"), []
                )
                console.log(_line(rows[name]))
            if "jaxnh" not in rows:
                raise SystemExit(f"no splitting of jaxnh has an error of one period of {target:g} over these lanes")
        heyoka = rows["heyoka batch"]
        own = peers["jaxnh"].tune(heyoka.setting.errors.max)
        if own:
            rows[AT_OWN_ERROR] = Entry(target, AT_OWN_ERROR, peers["jaxnh"], best(own), heyoka, [])
        entries += rows.values()
        tried[target] = [s for group in settings.values() for s in group]
    return entries, tried


def _line(entry: Entry) -> str:
    setting = entry.setting
    return f"{entry.target:.0e}  {entry.name}: {setting.form}, {setting.label}, error {setting.errors.max:.2g}"


def _timed(entries: Sequence[Entry], repeats: int, console: Console) -> None:
    """Samples of all rows in turn, to and fro, each beside one of its reference; the first round warms up."""
    for turn in range(repeats + 1):
        for entry in entries if turn % 2 else reversed(entries):
            seconds = _SAMPLE_SECONDS if turn else 0.0
            both = [entry, entry.reference] if entry.reference else [entry]
            samples = {e.name: e.peer.sample(e.setting, seconds) for e in (both if turn % 2 else reversed(both))}
            if turn:
                entry.pairs.append((samples[both[0].name], samples[both[-1].name]))
        if turn:
            console.log(f"round {turn} of {repeats}")


def _row(entry: Entry, cores: int) -> Row:
    """What the report needs of a row. Ratios are jaxnh's rate over the peer's, of samples next to each other."""
    upside_down = entry.name == AT_OWN_ERROR
    over_under = [(own, other) if upside_down else (other, own) for own, other in entry.pairs]
    return Row(
        target=entry.target,
        name=entry.name,
        setting=entry.setting,
        rates=[own.rate for own, _ in entry.pairs],
        shares=[own.rate / own.processor_rate / cores for own, _ in entry.pairs],
        ratios=[over.rate / under.rate for over, under in over_under],
        processor_ratios=[over.processor_rate / under.processor_rate for over, under in over_under],
    )


def _interleaved(samplers: dict[str, Callable[[], Sample]], repeats: int) -> list[Scaling]:
    """Samples of a few programs in turn, beside the first; a first round warms up."""
    samples: dict[str, list[Sample]] = {name: [] for name in samplers}
    for turn in range(repeats + 1):
        for name in samplers if turn % 2 else reversed(samplers):
            samples[name].append(samplers[name]())
    first = next(iter(samples))
    return [
        Scaling(
            name,
            [s.rate for s in taken[1:]],
            [s.rate / s.processor_rate for s in taken[1:]],
            [a.rate / b.rate for a, b in zip(taken[1:], samples[first][1:], strict=True)],
        )
        for name, taken in samples.items()
    ]


def _lanes_scaling(peer: Peer, setting: Setting, repeats: int) -> list[Scaling]:
    def sampler(count: int) -> Callable[[], Sample]:
        return lambda: peer.sample(setting, 2 * _SAMPLE_SECONDS, count=count, periods=_SCALING_PERIODS)

    return _interleaved({f"{count:,}": sampler(count) for count in _SCALING_LANES}, repeats)


def _core_scaling(peer: Peer, setting: Setting, repeats: int) -> list[Scaling]:
    def sampler(one_device: bool) -> Callable[[], Sample]:
        return lambda: peer.sample(setting, 2 * _SAMPLE_SECONDS, count=_TWO_CORES_LANES, one_device=one_device)

    return _interleaved({"one device": sampler(True), "two devices": sampler(False)}, repeats)


if __name__ == "__main__":
    main()
