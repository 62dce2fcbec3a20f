"""The reference table: spectra with error bars of all flows without delay of dysts, and of the maps of configs/maps.

    python -m sweeps.studies.reference_flows [NAME ...] [--limit SECONDS] [--longer COUNT] [--again] [--table]

Each is one `jaxnh.sweep` in a process of its own that has a limit of time: one lane at the published values, all
exponents, a target of 1e-8. What has been answered or refused is kept in results/reference_flows/ and not run again,
so that a study that was killed goes on where it was; with `--again` it is. Flows that are named run alone; with
`--longer` so many flows, those that were answered soonest, run once more, ten times as long, from where the first
average ends, which tells how often error bars cover. Both end with results/reference_flows.h5 and
docs/reference/flows.md, which `--table` makes alone from what there is.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from sweeps.checks.measured_at import ROOT, stamp
from sweeps.studies.dysts_flows import PublishedFlow, published_flows, run, scene, write_case
from sweeps.studies.reference_flows_page import page
from sweeps.studies.reference_flows_table import LONGER, RECORD, RESULT, TIMED_OUT, reference_table, save

FOLDER = ROOT / "results" / "reference_flows"
TABLE = FOLDER.with_suffix(".h5")
PAGE = ROOT / "docs" / "reference" / "flows.md"
MAPS = {"henon": {"a": 1.4}, "logistic": {"r": 4.0}}
"""Maps of configs/maps, and the parameters at which they are taken: Hénon's own, and where the exponent is ln 2."""

# Averages of so many units of time have bars of about 0.01 of the largest exponent; those of a flow that does not end
# within its limit are shorter.
_TRANSIENT, _PERIODS, _SHORT, _ITERATES = 256, 8192, 512, 1 << 17
_LONGER_BY = 10
_ACCURACY = "accuracy: {target: 1.0e-8}\n"


class ReferenceCase(NamedTuple):
    """A flow or a map.

    Attributes:
        source: text of a user's file.
        configs: texts of configs: of the run, and of a short one for where that does not end in its time.
        longer: that of the longer run, or "".
    """

    source: str
    configs: tuple[str, ...]
    longer: str = ""


def cases() -> dict[str, ReferenceCase]:
    """Return all flows and maps by name, flows first.

    Raises:
        ModuleNotFoundError: dysts is not installed.
    """
    flows = {name: _flow_case(flow) for name, flow in published_flows().items()}
    return flows | {name: _map_case(name, values) for name, values in MAPS.items()}


def _flow_case(flow: PublishedFlow) -> ReferenceCase:
    begun, count = scene(flow) + _ACCURACY, len(flow.coordinates)
    whole, short = (begun + _lyapunov(_TRANSIENT, periods, count) for periods in (_PERIODS, _SHORT))
    longer = begun + _lyapunov(_TRANSIENT + _PERIODS, _LONGER_BY * _PERIODS, count)
    return ReferenceCase(flow.source, (whole, short), longer)


def _map_case(name: str, values: Mapping[str, float]) -> ReferenceCase:
    source = (ROOT / "configs" / "maps" / f"{name}.py").read_text(encoding="utf-8")
    config = (ROOT / "configs" / "maps" / f"{name}.yaml").read_text(encoding="utf-8")
    initial = re.search(r"^initial: .*$", config, re.M)
    names = re.search(r'"coordinates": (\(.*\)|".*")', source)
    if not initial or not names:
        raise ValueError(f"configs/maps/{name} has no start or no coordinates")
    sweep = ", ".join(f"{key}: {{values: [{value!r}]}}" for key, value in values.items())
    text = f"system: {{file: sys.py}}\n{initial[0]}\nsweep: {{{sweep}}}\n"
    count = names[1].count('"') // 2
    return ReferenceCase(source, (text + _lyapunov(_TRANSIENT, _ITERATES, count),))


def _lyapunov(transient: int, periods: int, exponents: int) -> str:
    return f"analyses:\n  lyapunov: {{transient: {transient}, periods: {periods}, exponents: {exponents}}}\n"


# ---- runs


def run_case(folder: Path, source: str, configs: Sequence[str], limit: float, *, again: bool = False) -> str:
    """Run the first config of a case that ends in its time, unless that has been done, and return its record in a line.

    A record is written whole or not at all, so that a case that was killed runs anew.

    Args:
        folder: gets `sys.py`, `c.yaml`, the result, and the record of all runs.
        limit: seconds of a run.
        again: run it also where that has been done.
    """
    inputs = hashlib.sha256("\n".join((source, *configs)).encode()).hexdigest()
    path = folder / RECORD
    if not again and path.exists() and json.loads(path.read_text(encoding="utf-8"))["inputs"] == inputs:
        return "done before"
    path.unlink(missing_ok=True)
    (folder / RESULT).unlink(missing_ok=True)
    tried = []
    for config in configs:
        answer = run(write_case(folder, source, config), folder / RESULT, FOLDER / "cache", limit)
        lines = answer.text.strip().splitlines() or [""]
        tried.append({"code": answer.code, "seconds": round(answer.seconds, 2), "message": lines[-1]})
        if answer.code != TIMED_OUT:
            break
    record = {"inputs": inputs, "measured_at": str(stamp()), "tried": tried}
    draft = path.with_suffix(".part")
    draft.write_text(json.dumps(record, indent=1), encoding="utf-8")
    draft.replace(path)
    return ", ".join(f"{one['code']} in {one['seconds']:.1f} s" for one in tried)


def soonest(names: Iterable[str], count: int) -> list[str]:
    """Return so many of those that have an answer at the first try, which took least time first."""
    seconds = dict[str, float]()
    for name in names:
        path = FOLDER / name / RECORD
        tried = json.loads(path.read_text(encoding="utf-8"))["tried"] if path.exists() else []
        if len(tried) == 1 and tried[0]["code"] == 0:
            seconds[name] = tried[0]["seconds"]
    return sorted(seconds, key=lambda name: seconds[name])[:count]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run what has not been run, and write the table and the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--limit", type=float, default=120.0, metavar="SECONDS", help="of a run")
    parser.add_argument("--longer", type=int, default=0, metavar="COUNT")
    parser.add_argument("--again", action="store_true", help="run what has been run as well")
    parser.add_argument("--table", action="store_true", help="run nothing")
    given = parser.parse_args(arguments)
    every = cases()
    unknown = [name for name in given.names if name not in every]
    if unknown:
        parser.error(
            f"no flow or map {', '.join(unknown)}; names are those of the classes of dysts and of configs/maps"
        )
    for name in [] if given.table else given.names or every:
        case, folder = every[name], FOLDER / name
        print(f"{name}: {run_case(folder, case.source, case.configs, given.limit, again=given.again)}", flush=True)
    for name in soonest({name: case for name, case in every.items() if case.longer}, given.longer):
        line = run_case(FOLDER / name / LONGER, every[name].source, (every[name].longer,), given.limit)
        print(f"{name}, longer: {line}", flush=True)
    data = reference_table(FOLDER, published_flows(), sorted(every, key=str.lower))
    save(TABLE, data)
    PAGE.write_text(page(data), encoding="utf-8")
    print(f"wrote {TABLE} and {PAGE}")


if __name__ == "__main__":
    main()
