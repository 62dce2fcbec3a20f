"""Costs of every effect and every analysis, on scenes of the paper and beyond it, as one page.

    make effects

runs `python -m jaxnh.cost configs/NAME.yaml --effects` for each of them, and then this, which reads what they wrote.
"""

from __future__ import annotations

import math
import os
import platform
import sys
from pathlib import Path
from typing import Annotated

import typer

import jaxnh
from sweeps.checks.measured_at import measured_since, stamp

SCENES = ("table1", "fig01", "range_constant", "table2", "fig06", "range_disturbed", "unforced", "sleigh")

_HEAD = """\
# What each effect costs

`make effects` runs `python -m jaxnh.cost configs/NAME.yaml --effects` on the scenes below and writes this page from
what they leave in `results/NAME_effects.h5`. {machine}

{measured_at}

Operations are floating-point operations of the compiled program, a lane and a period: counted in its optimised HLO,
loop by loop, equal ones once, times the kicks (or steps and stages) of a period. An effect is left out by
`system.without`, by `d: 0` or by `constraint: free`, with nothing else changed; a processed solver is replaced by
another with as many kicks, since a scene without a clock has no use for it. The time, of all processors, is that of
the program with the effect over that without it, the median of {repeats} pairs on the same lanes, one after the other;
on a machine that does other things as well, ratios near one scatter by a tenth and more. Bytes are what a lane leaves
in the result.

Where leaving something out saves nothing, the table says why. The constraint is compared by the general route for both;
with it in closed form, as everywhere else here, a period costs what the other rows say.
"""


def page(folder: Path) -> str:
    """The page from the files of all scenes in a folder.

    Raises:
        jaxnh.ResultError: one of them is not there, or is none of jaxnh.cost.
    """
    parts: list[str] = []
    device, repeats = "", 0
    for name in SCENES:
        path = folder / f"{name}_effects.h5"
        with jaxnh.open_result(path) as tree:
            if "effects" not in tree:
                raise jaxnh.ResultError(f"{path} has no prices of effects")
            attrs, rows = tree.attrs, tree["effects"].to_dataset().load()
        group = rows.attrs
        device, repeats = str(attrs["device"]), int(group["repeats"])
        columns = {name: rows[name].to_numpy() for name in _COLUMNS}
        parts += [
            f"## {attrs['title']}",
            "",
            f"`configs/{name}.yaml`: effects by {group['solver']} in {group['steps_per_period']} steps a period, "
            f"tangents and analyses by {attrs['solver']} in {attrs['steps_per_period']}",
            "",
            "| | with it | without | time | bytes a lane | |",
            "| :-- | --: | --: | --: | --: | :-- |",
        ]
        for row in zip(*(columns[key] for key in _COLUMNS), strict=True):
            what, kind, with_it, without, ratio, stored, note = row
            numbers = (_format(with_it, ",.0f"), _format(without, ",.0f"), _format(ratio, ".2f"))
            size = f"{stored:,.0f}" if _text(kind) == "analysis" else ""
            parts.append(f"| {_text(what)} | {' | '.join(numbers)} | {size} | {_text(note)} |")
        parts.append("")
    machine = f"{processor()}, {os.cpu_count()} cores; {device}."
    # What was measured before the last change of the package is of a code that nothing names.
    fresh = measured_since(folder / f"{name}_effects.h5" for name in SCENES)
    measured_at = str(stamp()) if fresh else "Measured at an older code than the one that wrote this page."
    return _HEAD.format(machine=machine, repeats=repeats, measured_at=measured_at) + "\n" + "\n".join(parts)


_COLUMNS = ("what", "kind", "operations", "operations_without", "time_ratio", "stored", "note")


def _text(value: object) -> str:
    return value.decode() if isinstance(value, bytes) else str(value)


def _format(number: float, form: str) -> str:
    return "–" if math.isnan(number) else format(number, form)


def processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.split(": ", 1)[1] for line in lines if line.startswith("model name")), platform.machine())


def main(
    results: Annotated[Path, typer.Option(help="Folder to read from and to write to")] = Path("results"),
) -> None:
    """Write results/effects.md from the files of `jaxnh.cost --effects`."""
    try:
        text = page(results)
    except jaxnh.ResultError as error:
        print(f"{error}: run `make effects`", file=sys.stderr)
        raise typer.Exit(2) from None
    path = results / "effects.md"
    path.write_text(text, encoding="utf-8")
    print(f"wrote {path}")


if __name__ == "__main__":
    typer.run(main)
