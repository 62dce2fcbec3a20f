"""jaxnh, with `processed6` and without it, beside its peers on scenes that no solver was searched or chosen on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from rich.console import Console

from sweeps.peers.particle.peers_cases import Case
from sweeps.peers.particle.peers_report import AT_OWN_ERROR, WITHOUT, HeldOut
from sweeps.peers.particle.peers_scene import Scene, Setting, best
from sweeps.peers.particle.peers_timing import Entry, entry, line, row, timed
from sweeps.peers.particle.peers_worker import Peer

SEARCHED = "processed6"
"""The splitting that was searched for on the main scene."""

KINDS = ("jaxnh", "heyoka", "diffrax_options")
_SAMPLE_SECONDS = 0.25
_FORMS = 3  # of heyoka's, the fastest on the main scene
_DIFFRAX = "diffrax Dopri8, jaxnh's XLA options"


class Hints(NamedTuple):
    """Settings of the main scene, whose forms alone are tried."""

    heyoka: Sequence[Setting]
    diffrax: Sequence[Setting]


def hints(tried: Sequence[Setting]) -> Hints:
    """The fastest forms among all settings of a target."""

    def fastest(name: str, count: int) -> list[Setting]:
        return sorted((s for s in tried if s.peer.startswith(name)), key=lambda s: -s.rate)[:count]

    return Hints(fastest("heyoka batch", _FORMS), fastest(_DIFFRAX, 1))


def held_out(
    scenes: Sequence[tuple[Case, Scene]],
    peers: Mapping[str, Peer],
    tried: Mapping[float, Sequence[Setting]],
    repeats: int,
    cores: int,
    console: Console,
) -> list[HeldOut]:
    """Rows of every scene at every target; the peers go from scene to scene."""
    found = []
    for case, scene in scenes:
        console.log(f"{case.name}: {case.words}")
        for kind in KINDS:
            peers[kind].enter(scene)
        entries: list[Entry] = []
        for target, settings in tried.items():
            entries += _tuned(target, peers, hints(settings), console)
        timed(entries, repeats, console, _SAMPLE_SECONDS)
        found.append(HeldOut(case, [row(e, cores) for e in entries]))
    return found


def _tuned(target: float, peers: Mapping[str, Peer], among: Hints, console: Console) -> list[Entry]:
    """Rows of one scene at one target; none where jaxnh or heyoka does not reach it."""
    jaxnh, heyoka, diffrax = (peers[kind] for kind in KINDS)
    own = jaxnh.tune(target)
    theirs = heyoka.tune(target, among.heyoka, only=True)
    if not own or not theirs:
        console.log(f"{target:.0e}: not reached by {'heyoka' if own else 'jaxnh'}")
        return []
    first = entry(target, "jaxnh", jaxnh, best(own))
    second = entry(target, "heyoka batch", heyoka, best(theirs), first)
    rows = [first, second]
    rows += [entry(target, _DIFFRAX, diffrax, s, first) for s in diffrax.tune(target, among.diffrax, only=True)[:1]]
    equal = jaxnh.tune(second.setting.errors.max)
    for name, splittings in (
        (AT_OWN_ERROR, equal),
        (AT_OWN_ERROR + WITHOUT, [s for s in equal if s.form != SEARCHED]),
    ):
        if splittings:
            rows.append(entry(target, name, jaxnh, best(splittings), second, jaxnh_over=True))
    for e in rows:
        console.log(line(e))
    return rows
