"""Rows of the peers study while they are timed: samples of all in turn, each beside one of the row of its ratio."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from rich.console import Console

from sweeps.peers.particle.peers_report import Row, Scaling
from sweeps.peers.particle.peers_scene import Setting
from sweeps.peers.particle.peers_worker import Peer, Sample

SAMPLE_SECONDS = 0.4


class Entry(NamedTuple):
    """A row of a table: samples of its own, each with one of the row it is compared with.

    Attributes:
        target: largest error allowed.
        name: of the row.
        peer, setting: what is run.
        reference: the row that it is compared with, if any.
        jaxnh_over: whether the row is jaxnh's, so that its ratio is its own rate over the reference's, not the other
            way round.
        pairs: samples of the row and of its reference.
        idle: samples of the same calls with nothing to integrate, where Python drives the integrator.
    """

    target: float
    name: str
    peer: Peer
    setting: Setting
    reference: Entry | None
    jaxnh_over: bool
    pairs: list[tuple[Sample, Sample]]
    idle: list[Sample]


def entry(
    target: float, name: str, peer: Peer, setting: Setting, reference: Entry | None = None, jaxnh_over: bool = False
) -> Entry:
    """A row that nothing is measured of yet."""
    return Entry(target, name, peer, setting, reference, jaxnh_over, [], [])


def line(e: Entry) -> str:
    """A row in a line of the log."""
    return f"{e.target:.0e}  {e.name}: {e.setting.form}, {e.setting.label}, error {e.setting.errors.max:.2g}"


def timed(entries: Sequence[Entry], repeats: int, console: Console, seconds: float = SAMPLE_SECONDS) -> None:
    """Samples of all rows in turn, to and fro, each beside one of its reference; the first round warms up."""
    for turn in range(repeats + 1):
        for e in entries if turn % 2 else reversed(entries):
            long = seconds if turn else 0.0
            both = [e, e.reference] if e.reference else [e]
            samples = {x.name: x.peer.sample(x.setting, long) for x in (both if turn % 2 else reversed(both))}
            if turn:
                e.pairs.append((samples[both[0].name], samples[both[-1].name]))
        if turn:
            console.log(f"round {turn} of {repeats}")
    for e in entries:
        if e.name.startswith("heyoka"):
            e.idle.append(e.peer.sample(e.setting, 0.25 * seconds, idle=True))


def row(e: Entry, cores: int) -> Row:
    """Return what the report needs of a row. Ratios are jaxnh's rate over the peer's, of samples next to each other."""
    over_under = [(own, other) if e.jaxnh_over else (other, own) for own, other in e.pairs]
    return Row(
        target=e.target,
        name=e.name,
        setting=e.setting,
        rates=[own.rate for own, _ in e.pairs],
        shares=[own.rate / own.processor_rate / cores for own, _ in e.pairs],
        ratios=[over.rate / under.rate for over, under in over_under],
        processor_ratios=[over.processor_rate / under.processor_rate for over, under in over_under],
        python=[own.processor_rate / idle.processor_rate for idle in e.idle for own, _ in e.pairs],
    )


def interleaved(samplers: dict[str, Callable[[], Sample]], repeats: int) -> list[Scaling]:
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
