"""The claims: sentences of the README and the documentation, and what kept result each of them rests on."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from sweeps.checks.claims_figures import (
    HARD,
    PEERS,
    SLOWING,
    agreement,
    covered,
    fewer_kicks,
    held_out,
    largest_error,
    of_spectra,
    orders,
    slopes,
)
from sweeps.checks.claims_reading import cells, doublings, searched

_ACCURACY, _CONSTRAINT = "docs/accuracy.md", "docs/howto/constraint.md"
_SENSITIVITIES = "docs/howto/sensitivities.md"
_PEERS_COMMAND = "python -m sweeps.peers.particle.peers --repeats 3"
_FLOWS, _FLOWS_COMMAND = "results/peers_flows.md", "python -m sweeps.peers.flows.peers_flows --repeats 3"
_OVER = "jaxnh over each peer, 1 core"
_TARGETS = ("error ≤ 1e-06", "error ≤ 1e-08", "error ≤ 1e-10")


class Claim(NamedTuple):
    """A sentence, and what it rests on.

    Attributes:
        where: file that has the sentence.
        quote: its words, however its lines are broken; numbers that are checked stand in brackets, `[2.42]`.
        command: what makes the figure again.
        source: file that the numbers are read from, or the picture that they are seen in.
        place: where in it, in words.
        read: the values of the numbers in brackets, from a root folder; None for what a picture shows.
        kept: whether the source is kept with the code; else it is checked where it has been made.
    """

    where: str
    quote: str
    command: str
    source: str
    place: str
    read: Callable[[Path], Sequence[float]] | None = None
    kept: bool = True

    @property
    def words(self) -> str:
        """The quote as it stands in the text."""
        return self.quote.replace("[", "").replace("]", "")

    @property
    def numbers(self) -> list[str]:
        """The numbers that are checked, as they are quoted."""
        return [part.partition("]")[0] for part in self.quote.split("[")[1:]]


# ---- the claims


def _speeds() -> list[Claim]:
    def over(quote: str, row: str) -> Claim:
        read = cells(PEERS, _OVER, _TARGETS, over=row)
        return Claim(_ACCURACY, quote, _PEERS_COMMAND, PEERS, f"{_OVER}; {row}", read)

    scipy = cells(PEERS, _OVER, _TARGETS, over="scipy DOP853")

    def of_flow(quote: str, title: str, name: str) -> Claim:
        read = cells(_FLOWS, title, _TARGETS, flow=name)
        return Claim(_ACCURACY, quote, _FLOWS_COMMAND, _FLOWS, f"{title}; {name}", read)

    cores = cells(PEERS, "Two cores", ["over the first"], CPU_devices="two devices")
    maps, spectra = "Maps over heyoka batch", "Spectra over heyoka's variational batch"
    return [
        of_flow("Duffing's oscillator is [14.2], [9.90] and [4.90] times", maps, "duffing"),
        of_flow("a driven pendulum's [8.22], [3.93] and [2.78]", maps, "pendulum"),
        of_flow("Lorenz's [1.64], [1.09] and [0.97]", maps, "lorenz"),
        of_flow("Roessler's [2.32], [1.58] and [0.96]", maps, "roessler"),
        of_flow("a governor's by T, Q and f [2.93], [2.34] and [1.58]", maps, "governor"),
        of_flow("is slower: [0.59], [0.55] and [0.44]", maps, "double_pendulum"),
        of_flow("Duffing [2.55], [2.19] and [1.54]", spectra, "duffing"),
        of_flow("pendulum [2.06], [1.63] and [1.25]", spectra, "pendulum"),
        of_flow("Lorenz [1.09], [1.02] and [0.80]", spectra, "lorenz"),
        of_flow("Roessler [0.74], [0.66] and [0.51] times", spectra, "roessler"),
        of_flow("governor [0.75], [0.61] and [0.66]", spectra, "governor"),
        of_flow("double pendulum [0.36], [0.43] and [0.40] times", spectra, "double_pendulum"),
        over(
            "jaxnh is [2.51], [2.52] and [1.84] times as fast as it, on one core",
            "heyoka batch, at the error that it has",
        ),
        over("[50.8], [37.8] and [35.3] times as fast as stock diffrax", "stock diffrax, the better of both"),
        over(
            "[30.9], [29.4] and [24.9] times where diffrax has our XLA options",
            "stock diffrax with jaxnh's XLA options, the better",
        ),
        Claim(
            _ACCURACY,
            "on five others it is [1.21] to [2.91] times as fast as heyoka",
            _PEERS_COMMAND,
            PEERS,
            "Scenes held out, over heyoka",
            held_out,
        ),
        Claim(
            _ACCURACY,
            "averages of all three Lyapunov exponents [2.82], [1.86] and [1.41] times, with all else that `lyapunov` "
            "does [1.15], [0.83] and [0.74] times",
            "python -m sweeps.peers.particle.peers --only lyapunov --repeats 3",
            PEERS,
            "Lyapunov spectra, over heyoka at its own error, and the whole analysis",
            of_spectra,
        ),
        Claim(_ACCURACY, "Two cores are [1.86] times as fast as one", _PEERS_COMMAND, PEERS, "Two cores", cores),
        Claim(
            "docs/peers.md",
            "a sweep of the particle takes it [5,025], [4,710] and [3,998] times as long",
            _PEERS_COMMAND,
            PEERS,
            f"{_OVER}; scipy DOP853",
            scipy,
        ),
        Claim(
            "CHANGELOG.md",
            "up to [1.6] times fewer kicks than the best before",
            _PEERS_COMMAND,
            PEERS,
            "Forms tried, kicks of jaxnh's splittings",
            fewer_kicks,
        ),
    ]


def _tables() -> list[Claim]:
    """The doublings of both tables, as results/README.md has them; δ stands between its first and last level."""
    quoted = {
        "table1": (
            (
                "5.519620950004",
                "5.495524708041",
                "5.489401056080",
                "5.488064586993",
                "5.487776293683",
                "5.487714475689",
            ),
            ("3.934946", "4.581963", "4.635796", "4.663582"),
        ),
        "table2": (
            (
                "5.805186437960",
                "5.767843561936",
                "5.757968836976",
                "5.755804200167",
                "5.755336458363",
                "5.755236135790",
            ),
            ("3.781662", "4.561839", "4.627846", "4.662378"),
        ),
    }
    claims = []
    for table, (points, ratios) in quoted.items():
        source, command = f"results/{table}.h5", f"make {table}"
        claims += [
            Claim("results/README.md", f"[{b}]", command, source, f"doubling/b, level {k}", doublings(source, "b", k))
            for k, b in enumerate(points, 1)
        ]
        claims += [
            Claim(
                "results/README.md",
                f"[{d}]",
                command,
                source,
                f"doubling/delta, level {k}",
                doublings(source, "delta", k),
            )
            for k, d in enumerate(ratios, 2)
        ]
    return [
        *claims,
        Claim(
            "results/README.md",
            "All errors of b are below [1e-11].",
            "make table1 table2",
            "results/table1.h5",
            "doubling/b_error, and that of table2.h5",
            largest_error,
        ),
        Claim(
            _ACCURACY,
            "in all of both tables; all below [1e-11]",
            "make table1 table2",
            "results/table1.h5",
            "doubling/b_error, and that of table2.h5",
            largest_error,
        ),
        Claim(
            "README.md",
            "the cascade of period doublings at b ≈ [5.5].",
            "make table1",
            "results/table1.h5",
            "doubling/b, level 1",
            doublings("results/table1.h5", "b", 1),
        ),
    ]


def _bars() -> list[Claim]:
    quote = "on random lanes [99.5] % of 400 λ1 and [99.5] % of 800 of all exponents"
    return [Claim(_ACCURACY, quote, "make hard", HARD, "Error bars of exponents", covered)]


def _governor() -> list[Claim]:
    """The cascade of a user's own system, whose result is not kept."""
    drives = [
        "0.845218652286",
        "0.793347833804",
        "0.782672816467",
        "0.780314406641",
        "0.779808606268",
        "0.779700179688",
    ]
    source = "results/governor.h5"
    return [
        Claim(_CONSTRAINT, f"[{v}]", "make governor", source, f"drive, level {k}", doublings(source, "drive", k), False)
        for k, v in enumerate(drives, 1)
    ]


def _sensitivities() -> list[Claim]:
    """Derivatives of the doublings of the paper's tables, a row a level, of results that are not kept."""
    page = (Path(__file__).parents[2] / _SENSITIVITIES).read_text(encoding="utf-8")
    claims, lines = list[Claim](), re.findall(r"^\| \d.*$", page, re.MULTILINE)
    for name, names, first in (("table1", ("a", "c", "omega"), 0), ("table2", ("a", "c", "d"), 6)):
        source = f"results/{name}_sensitivities.h5"
        command = f"jaxnh sweep configs/{name}.yaml analyses.doubling.sensitivities=true --output {source}"
        for level, line in enumerate(lines[first : first + 6], 1):
            quote, read = re.sub(r"(-?\d\.\d+)", r"[\1]", line), doublings(source, "b_sensitivity", level, *names)
            claims.append(Claim(_SENSITIVITIES, quote, command, source, f"b_sensitivity, level {level}", read, False))
    return claims


def _slowing() -> list[Claim]:
    command = "python -m sweeps.studies.critical_slowing"

    def claim(quote: str, place: str, read: Callable[[Path], list[float]]) -> Claim:
        return Claim("results/README.md", quote, command, SLOWING, place, read)

    return [
        claim("on log–log axes are [−1.02] to [−1.33]", "measured slopes, both tables", slopes),
        claim(
            "At ε = 1e-4, N from [960] to [1100] gives nine of them within a factor of two, and N from [520] to [1900] "
            "at least half; smaller thresholds fit as well, with longer transients ([1900] to [2400] at 1e-5, [2800] "
            "to [3100] at 1e-6)",
            "One transient for all rows?",
            agreement,
        ),
        claim(
            "the bias falls only to [0.43] from level to level while the windows fall to [0.21]",
            "last paragraph",
            searched(SLOWING, r"falls to (0\.\d+) of the level before\. The windows fall to (0\.\d+)"),
        ),
    ]


def _settings() -> list[Claim]:
    """Return the claims of what a config or the code itself says."""
    fig04 = "configs/fig04.yaml"
    return [
        Claim(
            "README.md",
            "[4096] values of b, [256] strobe points each",
            "make fig04",
            fig04,
            "sweep.b.count, analyses.diagram.strobes",
            searched(fig04, r"count: (\d+)[^$]*?strobes: (\d+)"),
        ),
        Claim(
            "docs/theory.md",
            "Compositions of orders [2] to [10]",
            "make test",
            "jaxnh/solvers/compositions.py",
            "orders of SPLITTINGS; tests/solvers fits them",
            orders,
        ),
    ]


def _pictures() -> list[Claim]:
    """Return the claims of what is seen in a picture of results/, which its command draws again."""
    return [
        Claim(
            _ACCURACY,
            "by the stability of the orbit it costs a fraction of a second to eleven digits",
            "python -m jaxnh.cost configs/table1.yaml",
            "results/table1_cost_doubling.png",
            "time against error",
        ),
        Claim(
            _ACCURACY,
            "gains a digit for a hundred times the periods",
            "python -m jaxnh.cost configs/fig03.yaml",
            "results/fig03_cost_lyapunov.png",
            "slope of error against periods",
        ),
        Claim(
            "docs/howto/manifolds.md",
            "points of (b) lie on the curves that were there in (a) without a point on them",
            "make manifolds",
            "results/manifolds.png",
            "lower panels",
        ),
        Claim(
            "results/README.md",
            "chaos at small b too: b < 0.21 at constant speed, b < 0.05 disturbed",
            "make range_constant range_disturbed",
            "results/range_constant.png",
            "left end, and that of range_disturbed.png",
        ),
        Claim(
            "results/README.md",
            "period 2 at 4.48–4.56, period 6 at 4.69–4.77, period 8 at 4.94–5.02 at constant speed",
            "make range_constant",
            "results/range_constant.png",
            "windows",
        ),
        Claim(
            "results/README.md",
            "period 3 at 5.34–5.50 disturbed",
            "make range_disturbed",
            "results/range_disturbed.png",
            "windows",
        ),
        Claim(
            "results/README.md",
            "within the cascade period 3 at 5.469–5.4715",
            "make fig05",
            "results/fig05.png",
            "windows",
        ),
    ]


CLAIMS = (*_speeds(), *_tables(), *_governor(), *_sensitivities(), *_bars(), *_slowing(), *_settings(), *_pictures())
"""All claims, in the order of the page."""
