"""Figures that single claims quote, each computed from the kept results that it rests on."""

from __future__ import annotations

import re
from pathlib import Path

from jaxnh.solvers import SPLITTINGS
from sweeps.checks.claims_reading import doublings, number, rows

PEERS, SLOWING, HARD = "results/peers.md", "results/critical_slowing.md", "results/hard.md"


def fewer_kicks(root: Path) -> list[float]:
    """Return how many times fewer kicks `processed6` needs than the next splitting, the most over the targets."""
    lines = [r for r in rows((root / PEERS).read_text(encoding="utf-8"), "Forms tried") if r["peer"] == "jaxnh"]
    ratios = []
    for target in dict.fromkeys(line["target"] for line in lines):
        kicks = {r["form"]: number(r["setting"].split("steps,")[1]) for r in lines if r["target"] == target}
        ratios.append(min(k for form, k in kicks.items() if form != "processed6") / kicks["processed6"])
    return [max(ratios)]


def of_spectra(root: Path) -> list[float]:
    """Over heyoka at the error that it has, at each target: averages alone, then the whole analysis."""
    lines = rows((root / PEERS).read_text(encoding="utf-8"), "Lyapunov spectra")
    named = ("jaxnh, at heyoka's own error", "jaxnh, the whole analysis")
    return [number(line["jaxnh's spectrum over it"]) for name in named for line in lines if line["peer"] == name]


def held_out(root: Path) -> list[float]:
    """The least and the most over heyoka, of all scenes held out and all targets."""
    text = (root / PEERS).read_text(encoding="utf-8")
    rows = re.findall(r"^\| held out \d \|.*processed6.*$", text, re.MULTILINE)
    ratios = [number(line.split("|")[6]) for line in rows]
    return [min(ratios), max(ratios)]


def largest_error(root: Path) -> list[float]:
    """A bound of all errors of b in both tables: the next whole 1e-11."""
    worst = max(
        doublings(f"results/{table}.h5", "b_error", level)(root)[0]
        for table in ("table1", "table2")
        for level in range(1, 7)
    )
    return [1e-11 * -(-worst // 1e-11)]


def orders(root: Path) -> list[float]:
    orders = [solver.convergence_order for solver in SPLITTINGS.values()]
    return [min(orders), max(orders)]


def slopes(root: Path) -> list[float]:
    """Flattest and steepest slope of the bias that was measured."""
    text = (root / SLOWING).read_text(encoding="utf-8")
    found = [float(slope) for slope in re.findall(r"\| (-\d\.\d{3}) \(", text)]
    found += [float(slope) for slope in re.findall(r"\) \| (-\d\.\d{3}) \(", text)]
    return [max(found), min(found)]


def agreement(root: Path) -> list[float]:
    """Ends of N at 10⁻⁴ with most rows and with half of them, and with most at 10⁻⁵ and 10⁻⁶."""
    lines = rows((root / SLOWING).read_text(encoding="utf-8"), "One transient for all rows?")
    most, half = "N with as many", "N with half of the rows"
    spans = [lines[0][most], lines[0][half], lines[1][most], lines[2][most]]
    return [float(end) for span in spans for end in span.split("–")]


def covered(root: Path) -> list[float]:
    """Shares of bars that cover, of the largest and of all exponents of random lanes, in percent."""
    lines = rows((root / HARD).read_text(encoding="utf-8"), "Error bars of exponents")
    shares = [
        number(r["measured"].partition(":")[2]) for r in lines if "exponents of random lanes" in r["what is shown"]
    ]
    return [100.0 * (1.0 - share) for share in shares]
