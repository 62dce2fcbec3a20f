"""Gains of a graphics card: maps beside plain diffrax on the same device, spectra, charts, basins, Newton.

    python -m sweeps.timing.gpu [--small] [--repeats 3] [--tuned FILE] [--output results/gpu.md]

All of it runs on the device that JAX has first, a CPU as well; `--small` has sizes that a CPU does in minutes. A map's
solver and steps are the fastest that keep the error asked for, of either program, the truth being a Taylor integration
on the host; without heyoka there `--tune FILE` finds them elsewhere and `--tuned FILE` takes them. Scenes
are run into files, twice, the second time with the programs of the first. The last table has the rows that
GPUODEBenchmarks takes, in its own units: milliseconds of the best run.
"""

from __future__ import annotations

import argparse
import math
import pickle
import resource
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

import jaxnh
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.xla_options import configure
from jaxnh.maps.build import make_return_map, scheme_of
from jaxnh.maps.iterate import iterate
from sweeps.checks.measured_at import ROOT, stamp
from sweeps.peers.flows import peers_flow_diffrax, peers_flow_jaxnh
from sweeps.peers.flows.peers_flow_cases import CASES
from sweeps.peers.particle import peers_diffrax, peers_jaxnh
from sweeps.peers.particle.peers_cases import paper
from sweeps.peers.particle.peers_scene import Setting
from sweeps.timing.effects import processor

_SECONDS = 0.5  # of a sample
_START = {"x1": 0.1, "x2": 0.1, "y1": 0.1}


class Sizes(NamedTuple):
    """Sizes of the computations.

    Attributes:
        targets: errors of one period's map.
        lanes: of maps and of the benchmark, the least and the most.
        spectra, orbits: values of b.
        charts: pixels a side.
        levels: pixels a side, and levels, of a chart from coarse to fine.
        basins: starts a side.
    """

    targets: tuple[float, ...]
    lanes: tuple[int, ...]
    spectra: int
    orbits: int
    charts: tuple[int, ...]
    levels: tuple[int, int]
    basins: int


FULL = Sizes((1e-6, 1e-9), (1 << 12, 1 << 16, 1 << 20), 1 << 16, 100_000, (1024, 4096), (10_000, 6), 1024)
SMALL = Sizes((1e-6,), (256,), 64, 64, (16,), (33, 3), 16)


class MapRow(NamedTuple):
    """A map at a target: the settings of both programs, and lane-periods a second."""

    name: str
    target: float
    lanes: int
    setting: str
    rate: float
    other: str
    other_rate: float


class SceneRow(NamedTuple):
    """A scene: lanes, seconds of a first run, of compiling in it, of a second run; the most memory in use, in bytes."""

    name: str
    lanes: int
    seconds: float
    compiling: float
    again: float
    memory: int


class AgreementRow(NamedTuple):
    """Numbers on the device and on the host: how many, those that one alone has, the largest difference, and the share
    within the bar of the difference."""

    name: str
    numbers: int
    alone: int
    apart: float
    within: float


class BenchmarkRow(NamedTuple):
    """Lanes of Lorenz over one unit of time in a thousand steps, and the milliseconds of both programs."""

    lanes: int
    milliseconds: float
    other: float


def rate_of(run: Callable[[], float], seconds: float = _SECONDS) -> float:
    """Return what a program does a second, after a first run that compiles."""
    run()
    done, began = 0.0, time.perf_counter()
    while not done or time.perf_counter() < began + seconds:
        done += run()
    return done / (time.perf_counter() - began)


PROGRAMS: dict[str, tuple[Any, Any]] = {"particle": (peers_jaxnh, peers_diffrax)}
PROGRAMS |= dict.fromkeys(("duffing", "lorenz"), (peers_flow_jaxnh, peers_flow_diffrax))


class TunedScene(NamedTuple):
    """A map's lanes with their true ends, and the settings of both programs that keep each error.

    Attributes:
        scene: lanes and true ends.
        settings: of jaxnh and of diffrax, by the error asked for.
    """

    scene: Any
    settings: Mapping[float, tuple[list[Setting], list[Setting]]]


def tuned_maps(sizes: Sizes) -> dict[str, TunedScene]:
    """Tune both programs on the maps of the particle, Duffing and Lorenz; the device changes no setting.

    Of diffrax Dopri8 alone is tried, the particle's velocity as an angle: at these errors the others evaluate the field
    more often.
    """

    def wanted(key: tuple[str, str, str]) -> bool:
        return key[0] == "Dopri8" and key[2] != "unit vector"

    from sweeps.peers.flows import peers_flow_heyoka  # where a card is, heyoka need not be
    from sweeps.peers.particle import peers_heyoka

    tuned = {}
    for name, programs in PROGRAMS.items():
        flow = CASES.get(name)
        scene = peers_flow_heyoka.true_scene(flow, flow.values) if flow else peers_heyoka.true_scene(paper(0.1))
        ours, stock = (program.Contestant(scene) for program in programs)
        settings = {target: (ours.tune(target), stock.tune(target, wanted=wanted)) for target in sizes.targets}
        tuned[name] = TunedScene(scene, settings)
    return tuned


def measured_maps(sizes: Sizes, tuned: Mapping[str, TunedScene]) -> Iterator[MapRow]:
    """Yield the maps of the particle, Duffing and Lorenz, each beside stock diffrax at the same error.

    Which setting is the fastest is found at the second number of lanes.
    """
    for name, (scene, by_target) in tuned.items():
        contestants = [program.Contestant(scene) for program in PROGRAMS[name]]
        for target, (ours, stock) in by_target.items():
            trial = sizes.lanes[min(1, len(sizes.lanes) - 1)]
            best = [
                max(found, key=lambda s, c=c: rate_of(c.program(s, count=trial), 0.0), default=None)
                for c, found in zip(contestants, (ours, stock), strict=True)
            ]
            for lanes in sizes.lanes:
                (rate, mine), (other_rate, other) = (
                    (rate_of(c.program(s, count=lanes)), f"{s.peer} {s.form}, {s.label}")
                    if s
                    else (math.nan, "none reaches it")
                    for c, s in zip(contestants, best, strict=True)
                )
                yield MapRow(name, target, lanes, mine, rate, other, other_rate)


def scenes_of(sizes: Sizes) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield names and configs of the scenes."""

    def particle(analyses: Mapping[str, Any], *sweep: tuple[str, float, float, int], **more: Any) -> dict[str, Any]:
        axes = {name: {"start": start, "stop": stop, "count": count} for name, start, stop, count in sweep}
        system = {"constraint": "disturbed_speed" if "d" in axes else "constant_speed"}
        parts = {"title": "A scene of sweeps.timing.gpu", "system": system, "initial": _START, "sweep": axes}
        return {**parts, "accuracy": {"target": 1e-6}, "analyses": dict(analyses), **more}

    chart = {"lyapunov": {"transient": 128, "periods": 256, "exponents": 1}}
    spectra = {"lyapunov": {"transient": 128, "periods": 256, "method": "averages"}}
    yield "all three exponents", particle(spectra, ("b", 2.0, 6.0, sizes.spectra))
    for side in sizes.charts:
        yield f"chart of b by d, {side} x {side}", particle(chart, ("b", 0.01, 6.0, side), ("d", 0.0, 0.5, side))
    side, count = sizes.levels
    levels = {"count": count, "refine": "boundary"}
    yield (
        f"chart of b by d, {side} x {side} in {count} levels",
        particle(chart, ("b", 0.01, 6.0, side), ("d", 0.0, 0.5, side), levels=levels),
    )
    basins = particle({"basins": {}}, ("x1", -4.0, 4.0, sizes.basins), ("y1", -4.0, 4.0, sizes.basins))
    yield "basins at b = 5.475", {**basins, "system": {**basins["system"], "b": 5.475}, "initial": {"x2": 0.1}}
    orbits = particle({"period": {"transient": 64, "max_period": 4}}, ("b", 2.0, 3.0, sizes.orbits))
    yield "Newton on orbits of period 2", orbits


def measured_scene(name: str, content: Mapping[str, Any]) -> SceneRow:
    """Run a scene into a file, twice, and say what it took; the second time its programs are there."""
    experiment = jaxnh.Experiment.from_dict(content)
    seconds, compiling = [], 0.0
    with tempfile.TemporaryDirectory() as folder:
        for number in range(2):
            began = time.perf_counter()
            tree = jaxnh.run(experiment, Path(folder) / f"scene_{number}.h5", yes=True)
            seconds.append(time.perf_counter() - began)
            compiling = compiling or float(tree.attrs["compile_seconds"])
            tree.close()
    lanes = math.prod(axis["count"] for axis in content["sweep"].values())
    return SceneRow(name, lanes, seconds[0], compiling, seconds[1], peak_memory())


def compared(name: str, content: Mapping[str, Any], variable: str) -> AgreementRow:
    """Run a scene on the device and on the host, once where they are one, and compare a variable that has an error bar.

    Of chaotic lanes the last bits of both part, and with them the averages, by about their bars.
    """
    host = jaxnh.run(jaxnh.Experiment.from_dict({**content, "device": "cpu"}))
    on_host = jax.devices()[0].platform == "cpu"
    here = host if on_host else jaxnh.run(jaxnh.Experiment.from_dict({**content, "device": "gpu"}))
    (analysis,) = content["analyses"]
    values, others = (np.asarray(tree[analysis][variable], float) for tree in (here, host))
    bars = np.hypot(*(np.asarray(tree[analysis][f"{variable}_error"], float) for tree in (here, host)))
    both = np.isfinite(values) & np.isfinite(others)
    apart, bars = np.abs(values - others)[both], np.fmax(bars[both], np.finfo(float).tiny)
    alike = int((np.isnan(values) == np.isnan(others)).sum())
    return AgreementRow(name, both.sum(), values.size - alike, float(apart.max()), float((apart <= bars).mean()))


def agreement_scenes() -> Iterator[tuple[str, dict[str, Any], str]]:
    """Yield names and configs of what is run on the device and on the host, and the variable that is compared."""
    system, start = dict[str, Any](constraint="constant_speed"), {"initial": _START, "accuracy": {"target": 1e-6}}
    along = {"b": {"start": 4.0, "stop": 6.0, "count": 48}}
    spectra = {"lyapunov": {"transient": 128, "periods": 128}}
    particle = {"title": "Agreement", "system": system, **start, "sweep": along, "analyses": spectra}
    yield "exponents of the particle", particle, "exponents"
    doubling, along = {"doubling": {"levels": 4}}, {"b": {"start": 5.6, "stop": 5.45, "count": 128}}
    system = {**system, "a": 0.5, "c": 1.0, "omega": 1.0}
    table1 = {**particle, "system": system, "sweep": along, "analyses": doubling}
    yield "doublings of Table 1", table1, "b"


def peak_memory() -> int:
    """Return the most memory that has been in use: the device's own, or of this process where it is the host's."""
    stats = jax.devices()[0].memory_stats() or {}
    return int(stats.get("peak_bytes_in_use", 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss))


def measured_benchmark(lanes: int, repeats: int) -> BenchmarkRow:
    """Time Lorenz's flow as GPUODEBenchmarks has it: ρ from 0 to 21, from (1, 0, 0), Tsit5, steps of 0.001 to t = 1."""
    flow, rho = peers_flow_jaxnh.placed(CASES["lorenz"]).flow, np.linspace(0.0, 21.0, lanes)
    tsit5 = next(solver for solver in scheme_of(flow).solvers(flow) if solver.name == "tsit5")
    strobe, executor = make_return_map(flow, tsit5, 1000), LaneExecutor()
    start = jax.tree.map(lambda leaf: np.full(lanes, leaf), flow.chart.state(jnp.array([1.0, 0.0, 0.0])))
    parameters = {"rho": rho}

    def solve(value: Any) -> Any:
        field = diffrax.ODETerm(lambda t, y, p: CASES["lorenz"].field(jnp, y, 0.0, p))
        y0 = tuple(jnp.array(x) for x in (1.0, 0.0, 0.0))
        return diffrax.diffeqsolve(field, diffrax.Tsit5(), 0.0, 1.0, 0.001, y0, value, max_steps=1100).ys

    stock, device_rho = jax.jit(jax.vmap(solve)), jnp.asarray(rho)

    def best(run: Callable[[], Any]) -> float:
        run()
        times = []
        for _ in range(repeats):
            began = time.perf_counter()
            jax.block_until_ready(run())
            times.append(time.perf_counter() - began)
        return 1000.0 * min(times)

    ours = best(lambda: executor(iterate, (strobe, np.int32(1)), (start, parameters), periods=1))
    return BenchmarkRow(lanes, ours, best(lambda: stock(device_rho)))


def page(
    device: str,
    maps: list[MapRow],
    scenes: list[SceneRow],
    agreed: list[AgreementRow],
    rows: list[BenchmarkRow],
    small: bool,
) -> str:
    """The page in Markdown."""
    plain = jax.devices()[0].platform == "cpu"
    lines = [
        "# On a graphics card",
        "",
        f"`python -m sweeps.timing.gpu{' --small' if small else ''}` writes this page. Device: {device}.",
        "",
        str(stamp()),
        "",
    ]
    if plain:
        lines += [
            f"**No graphics card was at hand.** These are figures of a CPU{', of small sizes' if small else ''}:",
            "they show that the program runs, and say nothing of a card. On one, `python -m sweeps.timing.gpu`",
            "writes this page anew.",
            "",
        ]
    lines += [
        "## Maps, beside stock diffrax under vmap on the same device",
        "",
        "| map | error | lanes | jaxnh | lane-periods/s | diffrax | lane-periods/s | ratio |",
        "|---|---|---|---|---|---|---|---|",
        *(
            f"| {m.name} | {m.target:.0e} | {m.lanes:,} | {m.setting} | {m.rate:.3g} | {m.other} | {m.other_rate:.3g} "
            f"| {m.rate / m.other_rate:.3g} |"
            for m in maps
        ),
        "",
        "## Scenes",
        "",
        "Memory is the most that has been in use up to then, of the device, or on a CPU of the process.",
        "",
        "| scene | lanes | seconds | of them compiling | again, compiled | lanes/s | memory, MiB |",
        "|---|---|---|---|---|---|---|",
        *(
            f"| {s.name} | {s.lanes:,} | {s.seconds:.1f} | {s.compiling:.1f} | {s.again:.1f} | {s.lanes / s.again:.3g} "
            f"| {s.memory / 2**20:.0f} |"
            for s in scenes
        ),
        "",
        "## The same numbers as on the host",
        "",
        "| numbers | how many | on one side alone | largest difference | within the bar of the difference |",
        "|---|---|---|---|---|",
        *(f"| {a.name} | {a.numbers} | {a.alone} | {a.apart:.2g} | {100 * a.within:.3g} % |" for a in agreed),
        "",
        "## Rows for GPUODEBenchmarks",
        "",
        "Lorenz's flow as that suite has it, in float64: a thousand steps of Tsit5; milliseconds, the best run.",
        "" if not plain else "\nCPU alone: there is no row to hand in before a card has been measured.",
        "",
        "| lanes | jaxnh, ms | diffrax, ms |",
        "|---|---|---|",
        *(f"| {row.lanes} | {row.milliseconds:.3f} | {row.other:.3f} |" for row in rows),
    ]
    return "\n".join(lines).replace("\n\n\n", "\n\n") + "\n"


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--small", action="store_true", help="sizes that a CPU does in minutes")
    parser.add_argument("--tune", type=Path, help="tune the maps, where heyoka is; write the settings here, and end")
    parser.add_argument("--tuned", type=Path, help="settings of the maps that --tune wrote")
    parser.add_argument("--repeats", type=int, default=3, help="runs of each row of the benchmark")
    parser.add_argument("--output", type=Path, default=ROOT / "results" / "gpu.md")
    arguments = parser.parse_args()
    configure()
    first, sizes = jax.devices()[0], SMALL if arguments.small else FULL
    if arguments.tune:
        arguments.tune.write_bytes(pickle.dumps(tuned_maps(sizes)))
        return
    tuned = pickle.loads(arguments.tuned.read_bytes()) if arguments.tuned else tuned_maps(sizes)
    device = processor() if first.platform == "cpu" else first.device_kind
    maps, scenes, agreed, rows = list[MapRow](), list[SceneRow](), list[AgreementRow](), list[BenchmarkRow]()

    def keep() -> None:
        arguments.output.write_text(page(device, maps, scenes, agreed, rows, arguments.small), encoding="utf-8")

    for lanes in sizes.lanes:
        rows.append(measured_benchmark(lanes, arguments.repeats))
        keep()
    for name, content in scenes_of(sizes):
        scenes.append(measured_scene(name, content))
        print(scenes[-1], flush=True)
        keep()
    for scene in agreement_scenes():
        agreed.append(compared(*scene))
        print(agreed[-1], flush=True)
        keep()
    for row in measured_maps(sizes, tuned):
        maps.append(row)
        print(row, flush=True)
        keep()


if __name__ == "__main__":
    main()
