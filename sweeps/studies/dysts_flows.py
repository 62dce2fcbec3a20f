"""The flows without delay of the package dysts (pip install dysts) as users' files: a system and a config each.

Equations are those of its classes, as their authors wrote them; values and start states are the published ones, and the
unit of time is the published period. Nothing here is tuned to any flow.

`dysts_spectra.json` has spectra of two thirds of the flows by an independent integration: the classical method of order
4, 2,000 steps a `period` of dysts, tangents by forward derivatives, QR a hundred times a period, 1,000 periods after
300, means and two standard errors over eight starts. Stiff flows are not resolved by it.
"""

from __future__ import annotations

import ast
import importlib
import json
import os
import re
import subprocess
import sys
import textwrap
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from sweeps.checks.measured_at import ROOT

_SPECTRA = Path(__file__).with_name("dysts_spectra.json")
_UNLIKE = ("rhs", "_jac", "jac", "_postprocessing", "__init__")  # methods that a user's file does not need


class PublishedFlow(NamedTuple):
    """A flow of dysts.

    Attributes:
        source: text of a user's file, `sys.py`.
        coordinates: their names.
        parameters: published values, arrays left out.
        start: published start state.
        entry: all that dysts publishes of it.
    """

    source: str
    coordinates: tuple[str, ...]
    parameters: Mapping[str, float]
    start: tuple[float, ...]
    entry: Mapping[str, Any]


class Answer(NamedTuple):
    """One run of a config.

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


def published_flows() -> dict[str, PublishedFlow]:
    """Return all flows without delay by name.

    Raises:
        ModuleNotFoundError: dysts is not installed.
    """
    package = Path(str(importlib.import_module("dysts").__file__)).parent
    data = json.loads((package / "data" / "chaotic_attractors.json").read_text(encoding="utf-8"))
    source = (package / "flows.py").read_text(encoding="utf-8")
    classes = {node.name: node for node in ast.parse(source).body if isinstance(node, ast.ClassDef)}
    return {
        name: _published_flow(name, entry, _methods(classes, name), source.splitlines())
        for name, entry in data.items()
        if not entry["delay"]
    }


def scene(flow: PublishedFlow) -> str:
    """Return system, start and sweep of a config: one lane, at the published values."""
    scalars, coordinates, start = flow.parameters, flow.coordinates, flow.start
    swept = next((key for key in scalars if scalars[key]), next(iter(scalars), None))
    sweep = f"{swept}: {{values: [{scalars[swept]!r}]}}" if swept else f"{coordinates[0]}: {{values: [{start[0]!r}]}}"
    begun = list(zip(coordinates, start, strict=True))[0 if swept else 1 :]
    initial = ", ".join(f"{key}: {value!r}" for key, value in begun)
    return f"system: {{file: sys.py}}\ninitial: {{{initial}}}\nsweep: {{{sweep}}}\n"


def write_case(folder: Path, source: str, config: str) -> Path:
    """Write a user's file and a config of it into a folder, `sys.py` and `c.yaml`; return the path of the config."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "sys.py").write_text(source, encoding="utf-8")
    path = folder / "c.yaml"
    path.write_text(config, encoding="utf-8")
    return path


def independent_spectra() -> dict[str, dict[str, list[float]]]:
    """Return `mean` and `error` of the exponents of flows by name, of an independent integration."""
    return json.loads(_SPECTRA.read_text(encoding="utf-8"))


def run(config: Path, output: Path, cache: Path, limit: float) -> Answer:
    """Run a config in a process of its own, which has so many seconds, with a cache of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(cache)}
    environment["JAX_COMPILATION_CACHE_DIR"] = str(cache)
    command = [sys.executable, "-m", "jaxnh.sweep", str(config), "--output", str(output), "--fresh"]
    began = time.perf_counter()
    try:
        done = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=limit, check=False
        )
        code, text = done.returncode, (done.stdout + done.stderr).replace(f"{config.parent}/", "")
    except subprocess.TimeoutExpired:
        code, text = 124, f"no answer in {limit:g} s"
    return Answer(code, time.perf_counter() - began, text)


def _methods(classes: Mapping[str, ast.ClassDef], name: str) -> dict[str, ast.FunctionDef]:
    """Methods of a class by name, those of its bases among them."""
    methods: dict[str, ast.FunctionDef] = {}
    for base in reversed(classes[name].bases):
        if isinstance(base, ast.Name) and base.id in classes:
            methods |= _methods(classes, base.id)
    return methods | {node.name: node for node in classes[name].body if isinstance(node, ast.FunctionDef)}


def _text(lines: Sequence[str], node: ast.FunctionDef, *, whole: bool = False) -> str:
    first = node.lineno if whole else node.body[0].lineno
    text = textwrap.dedent("\n".join(lines[first - 1 : node.end_lineno])).replace("np.", "jnp.")
    return re.sub(r"(?<![\w.])(max|min)\(", r"jnp.\1imum(", text)


def _published_flow(
    name: str, entry: Mapping[str, Any], methods: Mapping[str, ast.FunctionDef], lines: Sequence[str]
) -> PublishedFlow:
    parameters, start = entry["parameters"], tuple(float(value) for value in entry["initial_conditions"])
    scalars = {key: float(value) for key, value in parameters.items() if isinstance(value, int | float)}
    text = ["import jax.numpy as jnp", "", "", f"def system({', '.join(f'{k}={v!r}' for k, v in scalars.items())}):"]
    text += [f"    {key} = jnp.array({value!r})" for key, value in parameters.items() if key not in scalars]
    if "_rhs" in methods:
        arguments = [argument.arg for argument in methods["_rhs"].args.args]
        coordinates = tuple(arguments[: arguments.index("t")])
        text += ["    def rhs(y_in, t):", f"        {', '.join(coordinates)}{',' * (len(coordinates) == 1)} = y_in"]
        text += [textwrap.indent(_text(lines, methods["_rhs"]), " " * 8)]
    else:
        letter = "u" if not any(re.fullmatch(r"u\d", key) for key in parameters) else "q"
        coordinates = tuple(f"{letter}{i}" for i in range(len(start)))
        text += _method_lines(name, list(parameters), methods, lines)
    said = f"'coordinates': {coordinates!r}, 'time_unit': {float(entry['period'])!r}"
    source = "\n".join([*text, "", f"    return {{'rhs': rhs, {said}}}", ""])
    return PublishedFlow(source, coordinates, scalars, start, entry)


def _method_lines(
    name: str, parameters: Sequence[str], methods: Mapping[str, ast.FunctionDef], lines: Sequence[str]
) -> list[str]:
    """Lines of a system whose right-hand side is a method of a vector, with the methods that it may call."""
    text = ["    class Self:", "        pass", "", "    self = Self()"]
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
    return [*text, textwrap.indent(body, " " * 8)]
