"""Time until strangers' flows are answered, and how right the answers are; writes results/first_answer.md.

    python -m sweeps.timing.first_answer [NAME ...] [--every N] [--kept COUNT]

Every flow without delay of the package dysts (pip install dysts) becomes a user's file, as its author wrote it: one
lane, all exponents, a target of 1e-8. With N it is every N-th flow, by name. Each is one `jaxnh.sweep` in a process of
its own with an empty cache; COUNT of them run a second time, with programs kept. Flows that are named run alone and are
printed, not written. On a machine that does nothing else.

Spectra are held against those of an independent integration (`sweeps.studies.dysts_flows`).
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from sweeps.checks.measured_at import ROOT, stamp
from sweeps.studies.dysts_flows import Answer, independent_spectra, published_flows, run, scene, write_case
from sweeps.timing.effects import processor

_PAGE = ROOT / "results" / "first_answer.md"
_LONGEST = 900.0  # seconds after which a flow counts as not answered
_REST = """\
accuracy: {{target: 1.0e-8}}
analyses:
  lyapunov: {{transient: 256, periods: 1024, exponents: {count}}}
"""

_WHY = {
    "CaTwoPlusQuasiperiodic": "a torus, both of whose exponents are zero",
    "DoublePendulum": "its chaos ends when rounding decides: of five starts within 0.001 that of heyoka, at 1e-14, is "
    "over in four before the end",
    "HyperLu": "it escapes: of eight starts 0.001 apart, DOP853 leaves with five within 1,000 units of time",
    "IsothermalChemical": "too stiff for the equal steps of that integration",
    "StickSlipOscillator": "a direction is lost where it begins to stick; there jumps have no saltation",
    "Tsucs2": "that along the flow is zero, and not computed",
}
"""Why flows are apart from the independent integration, each looked at by itself."""

_WRONG = {
    "Torus": "rightly: its rates are functions of t alone, of sin t and sin 15.3 t, and the file gives no period",
}
"""Flows whose files are wrong as they are made, and rightly refused."""

_TEXT = """\
# The first answer

`python -m sweeps.timing.first_answer{every}` runs `jaxnh.sweep` on {count} of the {whole} flows without delay of dysts
{dysts}: one lane, all exponents over 1,024 units of time after 256, a target of 1e-8. {machine}

{measured_at}

| cache | flows | median | nine in ten | worst |
| :-- | --: | --: | --: | --: |
{summary}

Seconds from command to result, the process with it. {answered} of {count} flows are answered. Of {compared} there is an
independent integration; {agree} agree with it within half as much again as both errors together, 0.001 and 0.2 %.

Not answered, with the message in short:

{refused}

Apart from the independent integration, or from a flow that its steps do not resolve:

{differing}

## Every flow

| flow | coordinates | seconds | compiling | run |
| :-- | --: | --: | --: | --: |
{rows}
"""


def differs(name: str, output: Path, spectra: Mapping[str, Mapping[str, Sequence[float]]]) -> str | None:
    """Return how a spectrum differs from the independent one; "" where it does not, None where there is none."""
    if name not in spectra:
        return None
    with h5py.File(output) as file:
        group: Any = file["lyapunov"]
        ours, error = np.ravel(group["exponents"][...]), np.ravel(group["exponents_error"][...])
    mean, bar = np.array(spectra[name]["mean"]), np.array(spectra[name]["error"])
    if np.all(np.abs(ours - mean) <= 1.5 * (error + bar) + 1e-3 + 2e-3 * np.abs(mean)):
        return ""
    return f"{name}: {np.round(ours, 4)} ± {np.round(error, 5)}, there {np.round(mean, 4)} ± {np.round(bar, 5)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--every", type=int, default=1, metavar="N")
    parser.add_argument("--kept", type=int, default=11, metavar="COUNT")
    given = parser.parse_args()
    spectra = independent_spectra()
    empty, kept, said = dict[str, Answer](), dict[str, Answer](), dict[str, str | None]()
    with tempfile.TemporaryDirectory(prefix="jaxnh_first_answer_") as temporary:
        folder = Path(temporary)
        flows = published_flows()
        sizes = {name: len(flow.coordinates) for name, flow in flows.items()}
        chosen = given.names or list(sizes)[:: given.every]
        again = set(chosen[:: max(1, len(chosen) // given.kept)])
        for name in chosen:
            config = write_case(folder / name, flows[name].source, scene(flows[name]) + _REST.format(count=sizes[name]))
            output, cache = folder / f"{name}.h5", folder / f"{name}_cache"
            empty[name] = run(config, output, cache, _LONGEST)
            if empty[name].code == 0:
                said[name] = differs(name, output, spectra)
                if name in again:
                    kept[name] = run(config, output, cache, _LONGEST)
            last = (empty[name].text.strip().splitlines() or [""])[-1] if empty[name].code else ""
            print(f"{name}: {empty[name].code}, {empty[name].seconds:.1f} s {said.get(name) or last}"[:200], flush=True)
    if not given.names:
        _PAGE.write_text(page(empty, kept, said, sizes), encoding="utf-8")
        print(f"wrote {_PAGE}")


def page(
    empty: Mapping[str, Answer], kept: Mapping[str, Answer], said: Mapping[str, str | None], sizes: Mapping[str, int]
) -> str:
    """The page of results."""

    answered = {name: answer for name, answer in empty.items() if answer.code == 0}
    refused = [_refusal(name, answer) for name, answer in empty.items() if answer.code]
    compared = [name for name, words in said.items() if words is not None]
    differing = [f"- {words}; {_WHY.get(name, 'not explained')}" for name, words in said.items() if words]
    rows = [
        f"| {n} | {sizes[n]} | {a.seconds:.1f} | {a.part('compile'):.1f} | {a.part('run'):.1f} |"
        for n, a in answered.items()
    ]
    return _TEXT.format(
        dysts=version("dysts"),
        machine=f"{processor()}, {os.cpu_count()} cores.",
        measured_at=stamp(),
        summary="\n".join(_row(cache, answers) for cache, answers in (("empty", answered), ("kept", kept))),
        answered=len(answered),
        count=len(empty),
        whole=len(sizes),
        every=f" --every {len(sizes) // len(empty)}" if len(empty) < len(sizes) else "",
        agree=len(compared) - len(differing),
        compared=len(compared),
        refused="\n".join(refused) or "- none",
        differing="\n".join(differing) or "- none",
        rows="\n".join(rows),
    )


def _refusal(name: str, answer: Answer) -> str:
    """A line about a flow that is not answered."""
    why = f"; {_WRONG[name]}" if name in _WRONG else ""
    return f"- {name}: {' '.join(answer.text.split())[-240:]}{why}"


def _row(cache: str, answers: Mapping[str, Answer]) -> str:
    seconds = [answer.seconds for answer in answers.values()]
    most = float(np.percentile(seconds, 90))
    return f"| {cache} | {len(seconds)} | {statistics.median(seconds):.1f} | {most:.1f} | {max(seconds):.1f} |"


if __name__ == "__main__":
    main()
