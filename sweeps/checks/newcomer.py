"""Commands that a newcomer types, run as they stand on the pages: do they end well, and as soon as they did?

    make newcomer, or python -m sweeps.checks.newcomer [--only NAME] [--beside N] [--write]

The README's and the pages' examples are read from them, not repeated here, and so is which of them belong together: the
lines of a block of the shell one after the other, the cells of a page. Beside them there are three flows as a stranger
would write them, held against exponents from elsewhere (`newcomer_flows`). Each runs in a process of its own, in a copy
of the repository, with no program kept from an earlier one. It fails where one does not end with 0, or takes more than
twice what results/newcomer.md says: as often as this machine is slower than that one was in starting Python and JAX and
compiling a program that has nothing to do with us, and N times where N others work beside. `--write` writes that page.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from sweeps.checks.measured_at import ROOT, stamp
from sweeps.checks.newcomer_flows import FLOWS, check_of
from sweeps.timing.effects import processor

PAGE = ROOT / "results" / "newcomer.md"
LIMIT = 2.0
"""Times what the page says."""

_LEAST = 5.0  # seconds that a limit is at least: of what takes one, half may be the machine
_LEFT_OUT = {
    "make test": "is what runs this",
    "pip install": "needs a network",
    "up.h5": "stands for results of the reader's own",
    "manifolds.h5": "stands for results of the reader's own",
    "sleigh.h5": "stands for results of the reader's own",
    "duffing.h5": "stands for results of the reader's own",
}
"""Lines that are not run, by what they have in them, and why."""

_BEFORE = {"docs/howto/pictures.md": "jaxnh sweep configs/fig04.yaml"}
"""Commands that a page takes for done."""

_YARDSTICK = """\
import jax, jax.numpy as jnp
jax.config.update("jax_enable_x64", True)
def f(x):
    for k in range(60):
        x = jnp.sin(x) @ jnp.cos(x + k) / 8
    return x
jax.jit(f)(jnp.ones((8, 8))).block_until_ready()
"""
_HEAD = """\
# What a newcomer types

`python -m sweeps.checks.newcomer --write` runs what the README, the how-to pages and three strangers' flows have, each
in a process of its own with no program kept, and writes this page; `make newcomer` holds a run against it. {machine}

{stamp}

Start of Python and JAX and a small program of nobody's, to compare machines by: {yardstick:.2f} s.

| what | seconds |
|---|---|
"""
_ROW = re.compile(r"^\| `(?P<name>.+)` \| (?P<seconds>[0-9.]+) \|$", re.MULTILINE)
_FENCE = re.compile(r"^```(?P<language>\S*)\n(?P<body>.*?)^```$", re.MULTILINE | re.DOTALL)


class Example(NamedTuple):
    """Something that a reader would run.

    Attributes:
        name: where it stands, and what it is.
        commands: shell lines, or Python where `python` is true, in turn.
        files: what is written before, by name.
        python: whether the one command is Python.
    """

    name: str
    commands: tuple[str, ...]
    files: Mapping[str, str] = {}
    python: bool = False


def examples() -> list[Example]:
    """All of them, in the order of their documents."""
    found = list(_of_readme((ROOT / "README.md").read_text()))
    for page in sorted((ROOT / "docs" / "howto").glob("*.md")):
        found += _of_page(page.relative_to(ROOT).as_posix(), page.read_text())
    for name, flow in FLOWS.items():
        files = {"own.py": flow.system, "own.yaml": flow.config, "check.py": check_of(flow)}
        found.append(Example(f"a stranger's flow: {name}", ("jaxnh sweep own.yaml", "python check.py"), files))
    return found


def blocks(text: str) -> list[tuple[str, str]]:
    """Language and body of all fenced blocks."""
    return [(match["language"], match["body"]) for match in _FENCE.finditer(text)]


def _of_readme(text: str) -> Iterator[Example]:
    for language, body in blocks(text):
        if language == "sh" and (commands := _commands(body)):
            yield Example(f"README.md: {commands[0]}", commands)
        elif language == "yaml":
            yield Example("README.md: a config", ("jaxnh sweep own.yaml",), {"own.yaml": body})
        elif language == "python":
            yield Example("README.md: Python", (body,), python=True)


def _of_page(name: str, text: str) -> Iterator[Example]:
    """The cells of a page as one script, or the lines of its shell."""
    cells = [body for language, body in blocks(text) if language == "{code-cell}"]
    if cells:
        yield Example(f"{name}: cells", ("\n".join(map(_cell, cells)),), python=True)
    lines = tuple(line for language, body in blocks(text) if language == "sh" for line in _commands(body))
    if lines:
        before = (_BEFORE[name],) if name in _BEFORE else ()
        yield Example(f"{name}: commands", (*before, *lines))


def _cell(body: str) -> str:
    """A cell of a notebook as Python."""
    first, _, rest = body.partition("\n")
    if first.startswith("%%writefile "):
        return f"__import__('pathlib').Path({first.split()[1]!r}).write_text({rest!r})"
    if first.startswith("%%sh"):
        return f"__import__('subprocess').run(['bash', '-e', '-c', {rest!r}], check=True)"
    return body


def _commands(body: str) -> tuple[str, ...]:
    """The lines of a block of the shell that can be run, without their comments."""
    lines = (line.partition(" #")[0].strip() for line in body.splitlines())
    return tuple(line for line in lines if line and not any(part in line for part in _LEFT_OUT))


class Ran(NamedTuple):
    """End of an example: seconds, and what was wrong, or ""."""

    seconds: float
    fault: str


def run(example: Example) -> Ran:
    """Run an example in a copy of the repository."""
    with tempfile.TemporaryDirectory(prefix="jaxnh_newcomer_") as place:
        folder = Path(place) / "jaxnh"
        _copy(folder)
        for name, text in example.files.items():
            (folder / name).write_text(text)
        if example.python:
            (folder / "example.py").write_text(example.commands[0])
        commands = ("python example.py",) if example.python else example.commands
        begun = time.monotonic()
        for number, command in enumerate(commands):
            environment = _environment(folder, Path(place) / f"cache{number}")
            fault = (_served if " explore " in command else _ended)(command, folder, environment)
            if fault:
                return Ran(time.monotonic() - begun, fault)
        return Ran(time.monotonic() - begun, "")


def _copy(folder: Path) -> None:
    """The files of the repository, and its environment by a link, which make finds up to date: it is what runs this."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / name)
    (folder / ".venv").symlink_to(_environment_folder())
    for name in ("pyproject.toml", "constraints.txt"):
        os.utime(folder / name, (0, 0))
    for result in (folder / "results").glob("*.h5"):
        result.unlink()  # as in a fresh checkout nothing has been run


def _environment_folder() -> Path:
    return Path(sys.executable).parents[1]


def _environment(folder: Path, cache: Path) -> dict[str, str]:
    """Ours, with no programs kept, the copy's modules and the environment's commands first."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith(("JAX_", "XLA_", "PYTEST_"))}
    path = os.pathsep.join([str(_environment_folder() / "bin"), kept.get("PATH", "")])
    return kept | {"PATH": path, "PYTHONPATH": str(folder), "XDG_CACHE_HOME": str(cache), "MPLBACKEND": "agg"}


def _ended(command: str, folder: Path, environment: Mapping[str, str]) -> str:
    """Return what is wrong with how a command ends, or ""."""
    done = subprocess.run(["bash", "-e", "-c", command], cwd=folder, env=environment, capture_output=True, text=True)
    if done.returncode == 0 and "Traceback" not in done.stderr:
        return ""
    return f"{command}: exit code {done.returncode}\n{done.stdout[-2000:]}{done.stderr[-4000:]}"


def _served(command: str, folder: Path, environment: Mapping[str, str]) -> str:
    """The same of a server: it says where its page is, gives it, and ends when interrupted."""
    free = f"{command} --port 0"
    options = {"cwd": folder, "env": environment, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    with subprocess.Popen(["bash", "-c", f"exec {free}"], **options) as server:
        assert server.stdout is not None
        said = server.stdout.readline()
        address = re.search(r"http://\S+", said)
        try:
            page = urllib.request.urlopen(address[0], timeout=60).read() if address else b""
        except OSError as error:
            said, page = f"{said}{error}", b""
        server.send_signal(signal.SIGINT)
        rest = server.communicate(timeout=60)[0]
        if not page or "Traceback" in rest:
            return f"{free}: {said}{rest}"
    return ""


def yardstick() -> float:
    """Seconds of a start of Python and JAX with a program that is nobody's, the least of three."""
    with tempfile.TemporaryDirectory() as cache:
        environment, seconds = _environment(ROOT, Path(cache)), []
        for _ in range(3):
            begun = time.monotonic()
            subprocess.run([sys.executable, "-c", _YARDSTICK], env=environment, check=True)
            seconds.append(time.monotonic() - begun)
    return min(seconds)


def read_page(page: str) -> tuple[float, dict[str, float]]:
    """The yardstick of a page, and its seconds by name."""
    compared = re.search(r"to compare machines by: ([0-9.]+) s", page)
    if compared is None:
        raise ValueError(
            "results/newcomer.md has no yardstick: write it anew by python -m sweeps.checks.newcomer --write"
        )
    return float(compared[1]), {row["name"]: float(row["seconds"]) for row in _ROW.finditer(page)}


def limit_of(seconds: float, slower: float, beside: int) -> float:
    """Seconds that an example may take that took so long on another machine."""
    return LIMIT * max(seconds, _LEAST) * max(1.0, slower) * (1 + beside)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", default="", metavar="NAME", help="those that have this in their name")
    parser.add_argument("--beside", type=int, default=0, metavar="N", help="how many other jobs work beside")
    parser.add_argument("--write", action="store_true", help="write the page anew")
    asked = parser.parse_args(arguments)
    measured = yardstick()
    then, seconds = (measured, {}) if asked.write else read_page(PAGE.read_text())
    rows, faults = list[str](), list[str]()
    for example in examples():
        if asked.only not in example.name:
            continue
        ran = run(example)
        fault = ran.fault
        if not asked.write and not fault:
            if example.name not in seconds:
                fault = (
                    "results/newcomer.md has no time of it: write it anew by python -m sweeps.checks.newcomer --write"
                )
            elif ran.seconds > (most := limit_of(seconds[example.name], measured / then, asked.beside)):
                fault = f"took {ran.seconds:.1f} s, and may take {most:.1f} s"
        print(f"{ran.seconds:6.1f} s  {example.name}{f': {fault}' if fault else ''}", flush=True)
        rows.append(f"| `{example.name}` | {ran.seconds:.1f} |\n")
        faults += [example.name] if fault else []
    if faults:
        print(f"failed: {', '.join(faults)}")
        return 1
    if asked.write and not asked.only:
        PAGE.write_text(_HEAD.format(machine=processor(), stamp=stamp(), yardstick=measured) + "".join(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
