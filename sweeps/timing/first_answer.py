"""How soon strangers' flows are answered, and how rightly; writes results/first_answer.md.

    python -m sweeps.timing.first_answer [NAME ...] [--every N] [--kept COUNT]

Every flow without delay of the package dysts (pip install dysts) becomes a user's file, as its author wrote it: one
lane, all exponents, a target of 1e-8. With N it is every N-th flow, by name. Each is one `jaxnh.sweep` in a process of
its own with an empty cache; COUNT of them run a second time, with programs kept. Flows that are named run alone and are
printed, not written. On a machine that does nothing else.

`first_answer_spectra.json` has spectra of two thirds of the flows by an independent integration: the classical method
of order 4, 2,000 steps a `period` of dysts, tangents by forward derivatives, QR a hundred times a period, 1,000 periods
after 300, means and two standard errors over eight starts. Stiff flows are not resolved by it.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from sweeps.checks.measured_at import ROOT, stamp
from sweeps.timing.effects import processor

_PAGE = ROOT / "results" / "first_answer.md"
_SPECTRA = Path(__file__).with_name("first_answer_spectra.json")
_LONGEST = 900.0  # seconds after which a flow counts as not answered
_UNLIKE = ("rhs", "_jac", "jac", "_postprocessing", "__init__")  # methods that a user's file does not need

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


class Answer(NamedTuple):
    """One run of a flow.

    Attributes:
        code: exit code; 124: no answer in time.
        seconds: of the process.
        text: what it printed.
    """

    code: int
    seconds: float
    text: str

    def part(self, name: str) -> float:
        """Seconds of a part, as the run itself says: "compile" or "run"."""
        said = re.search(rf"{name} ([0-9.]+) s", self.text)
        return float(said[1]) if said else float("nan")


# ---- flows as users' files


def write_flows(folder: Path) -> dict[str, int]:
    """Write every flow into a folder of its name, `sys.py` and `c.yaml`; number of coordinates by name."""
    package = Path(str(importlib.import_module("dysts").__file__)).parent
    data = json.loads((package / "data" / "chaotic_attractors.json").read_text(encoding="utf-8"))
    source = (package / "flows.py").read_text(encoding="utf-8")
    classes = {node.name: node for node in ast.parse(source).body if isinstance(node, ast.ClassDef)}
    sizes = {}
    for name, entry in data.items():
        if entry["delay"]:
            continue
        text, coordinates = _system(name, entry, _methods(classes, name), source.splitlines())
        into = folder / name
        into.mkdir(parents=True)
        (into / "sys.py").write_text(text, encoding="utf-8")
        (into / "c.yaml").write_text(_config(entry, coordinates), encoding="utf-8")
        sizes[name] = len(coordinates)
    return sizes


def _methods(classes: Mapping[str, ast.ClassDef], name: str) -> dict[str, ast.FunctionDef]:
    """Methods of a class by name, those of its bases among them."""
    methods: dict[str, ast.FunctionDef] = {}
    for base in reversed(classes[name].bases):
        if isinstance(base, ast.Name) and base.id in classes:
            methods |= _methods(classes, base.id)
    return methods | {node.name: node for node in classes[name].body if isinstance(node, ast.FunctionDef)}


def _text(lines: Sequence[str], node: ast.FunctionDef, *, whole: bool = False) -> str:
    first = node.lineno if whole else node.body[0].lineno
    return textwrap.dedent("\n".join(lines[first - 1 : node.end_lineno])).replace("np.", "jnp.")


def _system(
    name: str, entry: Mapping[str, Any], methods: Mapping[str, ast.FunctionDef], lines: Sequence[str]
) -> tuple[str, list[str]]:
    """A user's file, and the names of its coordinates."""
    parameters = entry["parameters"]
    scalars = {key: float(value) for key, value in parameters.items() if isinstance(value, int | float)}
    text = ["import jax.numpy as jnp", "", "", f"def system({', '.join(f'{k}={v!r}' for k, v in scalars.items())}):"]
    text += [f"    {key} = jnp.array({value!r})" for key, value in parameters.items() if key not in scalars]
    if "_rhs" in methods:
        arguments = [argument.arg for argument in methods["_rhs"].args.args]
        coordinates = arguments[: arguments.index("t")]
        text += ["    def rhs(y_in, t):", f"        {', '.join(coordinates)} = y_in"]
        text += [textwrap.indent(_text(lines, methods["_rhs"]), " " * 8)]
    else:
        coordinates = [f"u{i}" for i in range(len(entry["initial_conditions"]))]
        text += ["    class Self:", "        pass", "", "    self = Self()"]
        text += [f"    self.{key} = {key}" for key in parameters]
        for other in methods.values():
            if other.name not in _UNLIKE:
                bound = bool(other.args.args) and other.args.args[0].arg == "self"
                text += [textwrap.indent(_text(lines, other, whole=True), "    ")]
                text += [f"    self.{other.name} = " + (f"lambda *a: {other.name}(self, *a)" if bound else other.name)]
        body = _text(lines, methods["rhs"])
        if name == "Lorenz96":  # writes into an array there
            body = "return (jnp.roll(X, -1) - jnp.roll(X, 2)) * jnp.roll(X, 1) - X + self.f"
        unpacked = re.search(r"^\s*[\w, ()]+ = X$", body, re.M)
        text += ["    def rhs(y_in, t):", "        X = " + ("y_in" if unpacked else "jnp.stack(y_in)")]
        text += [textwrap.indent(body, " " * 8)]
    said = f"'coordinates': {tuple(coordinates)!r}, 'time_unit': {float(entry['period'])!r}"
    return "\n".join([*text, "", f"    return {{'rhs': rhs, {said}}}", ""]), coordinates


def _config(entry: Mapping[str, Any], coordinates: Sequence[str]) -> str:
    """A config of one lane, at the published values."""
    scalars = {key: float(v) for key, v in entry["parameters"].items() if isinstance(v, int | float)}
    start = [float(value) for value in entry["initial_conditions"]]
    swept = next((key for key in scalars if scalars[key]), next(iter(scalars), None))
    sweep = f"{swept}: {{values: [{scalars[swept]!r}]}}" if swept else f"{coordinates[0]}: {{values: [{start[0]!r}]}}"
    begun = list(zip(coordinates, start, strict=True))[0 if swept else 1 :]
    return (
        f"system: {{file: sys.py}}\ninitial: {{{', '.join(f'{key}: {value!r}' for key, value in begun)}}}\n"
        f"sweep: {{{sweep}}}\naccuracy: {{target: 1.0e-8}}\n"
        f"analyses:\n  lyapunov: {{transient: 256, periods: 1024, exponents: {len(coordinates)}}}\n"
    )


# ---- runs


def run(config: Path, output: Path, cache: Path) -> Answer:
    """One run of a config in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(cache)}
    environment["JAX_COMPILATION_CACHE_DIR"] = str(cache)
    command = [sys.executable, "-m", "jaxnh.sweep", str(config), "--output", str(output), "--fresh"]
    began = time.perf_counter()
    try:
        done = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=_LONGEST, check=False
        )
        code, text = done.returncode, (done.stdout + done.stderr).replace(f"{config.parent}/", "")
    except subprocess.TimeoutExpired:
        code, text = 124, f"no answer in {_LONGEST:g} s"
    return Answer(code, time.perf_counter() - began, text)


def differs(name: str, output: Path, spectra: Mapping[str, Mapping[str, Sequence[float]]]) -> str | None:
    """How a spectrum differs from the independent one; "" where it does not, None where there is none."""
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
    spectra = json.loads(_SPECTRA.read_text(encoding="utf-8"))
    empty, kept, said = dict[str, Answer](), dict[str, Answer](), dict[str, str | None]()
    with tempfile.TemporaryDirectory(prefix="jaxnh_first_answer_") as temporary:
        folder = Path(temporary)
        sizes = write_flows(folder)
        chosen = given.names or list(sizes)[:: given.every]
        again = set(chosen[:: max(1, len(chosen) // given.kept)])
        for name in chosen:
            config, output, cache = folder / name / "c.yaml", folder / f"{name}.h5", folder / f"{name}_cache"
            empty[name] = run(config, output, cache)
            if empty[name].code == 0:
                said[name] = differs(name, output, spectra)
                if name in again:
                    kept[name] = run(config, output, cache)
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
    refused = [f"- {n}: {' '.join(a.text.split())[-240:]}" for n, a in empty.items() if a.code]
    compared = [name for name, words in said.items() if words is not None]
    differing = [f"- {words}" for words in said.values() if words]
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


def _row(cache: str, answers: Mapping[str, Answer]) -> str:
    seconds = [answer.seconds for answer in answers.values()]
    most = float(np.percentile(seconds, 90))
    return f"| {cache} | {len(seconds)} | {statistics.median(seconds):.1f} | {most:.1f} | {max(seconds):.1f} |"


if __name__ == "__main__":
    main()
