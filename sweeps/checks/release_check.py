"""Check whether a release is fit to go out: wheel and sdist, each installed and used where the repository is not.

    make release-check [NEWEST=PYTHON]

Both are built in a temporary folder. Each is installed into an environment of its own with the versions that
constraints.txt names, and the wheel once more, with the newest there are, into one of the interpreter NEWEST. In each
a user's own system, written anew, is swept, drawn, priced and inspected, and every option of XLA that the package sets
is tried: whether it is known, and whether the code of a loop over kicks is another one than with its opposite. Nothing
is timed; the work takes some minutes, most of them the installer's.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

import jaxnh
from sweeps.checks.measured_at import ROOT

_SYSTEM = """\
import jax.numpy as jnp


def system(drive=0.3, damping=0.2):
    def rhs(y, t):
        x, v = y
        return v, x - x**3 - damping * v + drive * jnp.cos(t)

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi}
"""
_CONFIG = """\
title: A double well of one's own
system: {file: well.py, damping: 0.2}
initial: {x: 1.0}
sweep: {drive: {start: 0.1, stop: 0.3, count: 8}}
accuracy: {target: 1.0e-6}
analyses:
  diagram: {transient: 16, strobes: 16}
  lyapunov: {transient: 16, periods: 32, exponents: 2}
"""
_COMMANDS = (
    ["-m", "jaxnh.sweep", "well.yaml", "--quiet"],
    ["-m", "jaxnh", "plot", "results/well.h5", "--output", "well.pdf"],
    ["-m", "jaxnh", "cost", "well.yaml", "--repeats", "1"],
    ["-m", "jaxnh", "inspect", "results/well.h5", "--verify", "--trust"],
)
_KICKS = """\
import jax
import numpy as np

jax.config.update("jax_enable_x64", True)
from jaxnh.maps.build import make_return_map
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import constant_speed

flow = constant_speed(0.5, 1.0, 1.0, None)
strobe = make_return_map(flow, SPLITTINGS["processed6"], 8)
start = flow.start({name: np.full(256, 0.1) for name in ("x1", "x2", "y1")})
jax.jit(jax.vmap(strobe)).lower(start, {"b": np.linspace(2.0, 6.0, 256)}).compile()
"""
_OPPOSITES = {  # "": without it; XLA's default may come to be what the package asks for
    "xla_cpu_small_while_loop_byte_threshold=1000000000000": "xla_cpu_small_while_loop_byte_threshold=0",
    "xla_cpu_use_multi_output_fusion=true": "",  # =false is as good as =true to JAX 0.12
    "-force-vector-interleave=2": "-force-vector-interleave=1",
    "512": "256",
}
_SAME_SIZE = 0.04
_IN_WHEEL = ("jaxnh/py.typed", "jaxnh/config/schema.json", "jaxnh/plotting/jaxnh.mplstyle")
_IN_SDIST = ("pyproject.toml", "README.md", "CHANGELOG.md", "CITATION.cff", "LICENSE", "configs/table1.yaml")


class Unfit(Exception):
    """A fault that keeps the release back, in one sentence."""


def build(folder: Path) -> tuple[Path, Path]:
    """The wheel and the sdist of the repository.

    Raises:
        Unfit: they cannot be built, have another version than the package, or lack files.
    """
    _run([sys.executable, "-m", "hatchling", "build", "--directory", str(folder)], ROOT, "the build")
    name = f"jaxnh-{jaxnh.__version__}"
    wheel, sdist = folder / f"{name}-py3-none-any.whl", folder / f"{name}.tar.gz"
    for path in (wheel, sdist):
        if not path.is_file():
            raise Unfit(f"there is no {path.name}, but {', '.join(sorted(p.name for p in folder.iterdir()))}")
    with zipfile.ZipFile(wheel) as archive:
        _check_content(wheel, set(archive.namelist()), _IN_WHEEL)
    with tarfile.open(sdist) as archive:
        _check_content(sdist, set(archive.getnames()), [f"{name}/{file}" for file in _IN_SDIST])
    return wheel, sdist


def check_changelog(version: str) -> None:
    """See that the changelog begins with what is unreleased, or with this version.

    Raises:
        Unfit: it does not.
    """
    headings = re.findall(r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    release = re.sub(r"\.dev\d+$", "", version)
    if not any(heading.startswith(release) or f"({release})" in heading for heading in headings):
        raise Unfit(f"CHANGELOG.md has no heading for {release}; it has {', '.join(headings)}")


def install(python: str, package: Path, folder: Path, *, pinned: bool) -> str:
    """An environment with the package alone; returns its interpreter.

    Raises:
        Unfit: pip cannot.
    """
    _run([python, "-m", "venv", str(folder)], folder.parent, "a new environment")
    inside = str(folder / "bin" / "python")
    versions = ["--constraint", str(ROOT / "constraints.txt")] if pinned else []
    _run([inside, "-m", "pip", "install", "--quiet", *versions, str(package)], folder.parent, f"pip of {package.name}")
    return inside


def use(python: str, folder: Path) -> None:
    """Sweep, draw, price and inspect a system of one's own, in a folder of its own.

    Raises:
        Unfit: a command fails, or the package is not the installed one.
    """
    folder.mkdir()
    (folder / "well.py").write_text(_SYSTEM)
    (folder / "well.yaml").write_text(_CONFIG)
    program = str(Path(python).with_name("jaxnh"))
    for arguments in _COMMANDS:
        _run([python, *arguments], folder, " ".join(arguments))
    said = _run([program, "--version"], folder, "jaxnh --version").strip()
    if said != f"jaxnh {jaxnh.__version__}":
        raise Unfit(f"the program says that it is {said}, and the package is {jaxnh.__version__}")
    home = _run([python, "-c", "import jaxnh; print(jaxnh.__file__)"], folder, "import jaxnh").strip()
    if str(ROOT) in home:
        raise Unfit(f"the package is that of the repository, {home}")


def options_there(python: str, folder: Path) -> list[tuple[str, str]]:
    """Options of XLA that the package sets there, each as the flag of XLA_FLAGS and one of its values."""
    code = "from jaxnh.engine.xla_options import flags_of_a_process; print(flags_of_a_process())"
    flags = [flag.partition("=") for flag in _run([python, "-c", code], folder, "options of XLA").split()]
    return [(key, one) for key, _, value in flags for one in (value.split(",") if "extra_options" in key else [value])]


def refused_options(python: str, folder: Path) -> list[str]:
    """Return the options that the process of a first array does not survive."""
    first = "import jax; print(jax.jit(jax.numpy.sin)(jax.numpy.ones(8))[0])"
    refused = []
    for key, one in options_there(python, folder):
        environment = _environment() | {"XLA_FLAGS": f"{key}={one}"}
        done = subprocess.run([python, "-c", first], env=environment, cwd=folder, capture_output=True)
        refused += [f"{key}={one}"] if done.returncode else []
    return refused


def idle_options(python: str, folder: Path) -> list[str]:
    """Return the options in whose place the opposite gives a loop over kicks code of the same size.

    One program compiled twice differs by a register or an alignment, its code by less than 1 % in size; with the
    opposite of an option that acts it differs by 13 % and more.

    Raises:
        Unfit: no code is written where it is looked for, or an option has no opposite here.
    """
    options = options_there(python, folder)
    size = _code_of_kicks(python, folder, options)
    if not size:
        raise Unfit("XLA writes no object code where --xla_dump_to says")
    idle = []
    for place, (key, one) in enumerate(options):
        if one not in _OPPOSITES:
            raise Unfit(f"{key}={one}: sweeps/checks/release_check.py knows no opposite of it")
        if one == "512" and not _wide_vectors():
            continue
        other = [*options[:place], (key, _OPPOSITES[one]), *options[place + 1 :]]
        idle += [f"{key}={one}"] if abs(_code_of_kicks(python, folder, other) / size - 1) < _SAME_SIZE else []
    return idle


def _code_of_kicks(python: str, folder: Path, options: list[tuple[str, str]]) -> int:
    """Bytes of object code of a loop over kicks, compiled with these options of XLA."""
    values: dict[str, list[str]] = {}
    for key, one in options:
        values.setdefault(key, []).extend([one] if one else [])
    with tempfile.TemporaryDirectory(dir=folder) as dump:
        flags = [*(f"{key}={','.join(those)}" for key, those in values.items()), f"--xla_dump_to={dump}"]
        _run([python, "-c", _KICKS], folder, "a loop over kicks", {"XLA_FLAGS": " ".join(flags)})
        return sum(path.stat().st_size for path in Path(dump).glob("*.o"))


def _wide_vectors() -> bool:
    """Return whether the processor has vectors of eight float64, as Linux says it."""
    try:
        return "avx512f" in Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return False


def _check_content(path: Path, there: set[str], wanted: tuple[str, ...] | list[str]) -> None:
    if lacking := [name for name in wanted if name not in there]:
        raise Unfit(f"{path.name} lacks {', '.join(lacking)}")


def _environment() -> dict[str, str]:
    """That of this process, without what leads to the repository."""
    return {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV", "XLA_FLAGS")}


def _run(command: list[str], folder: Path, what: str, more: dict[str, str] | None = None) -> str:
    environment = _environment() | (more or {})
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    if done.returncode:
        last = (done.stderr.strip() or done.stdout.strip() or "it said nothing").splitlines()[-1]
        raise Unfit(f"{what} failed with code {done.returncode}: {last}")
    return done.stdout


def _check(newest: str) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        check_changelog(jaxnh.__version__)
        wheel, sdist = build(folder / "dist")
        print(f"built {wheel.name} and {sdist.name}", flush=True)
        trials = [("wheel", sys.executable, wheel, True), ("sdist", sys.executable, sdist, True)]
        if newest:
            trials.append(("newest", newest, wheel, False))
        for label, python, package, pinned in trials:
            inside = install(python, package, folder / label, pinned=pinned)
            code = "import platform, jax; print('Python', platform.python_version() + ', JAX', jax.__version__)"
            there = _run([inside, "-c", code], folder, "import jax").strip()
            if refused := refused_options(inside, folder):
                raise Unfit(f"{label}: {there}: XLA does not know {', '.join(refused)}")
            if idle := idle_options(inside, folder):
                raise Unfit(f"{label}: {there}: the code is the same without {', '.join(idle)}")
            use(inside, folder / f"{label}_work")
            print(f"{label}: {there}: installed, used, all options of XLA known and acting", flush=True)


def main() -> int:
    """Check all of it; returns 1, and says why, where the release is not fit."""
    parser = argparse.ArgumentParser(description="See whether wheel and sdist install and work without the repository.")
    parser.add_argument("--newest", default="", metavar="PYTHON", help="interpreter to try the newest versions with")
    arguments = parser.parse_args()
    try:
        _check(arguments.newest)
    except Unfit as unfit:
        print(f"not fit for release: {unfit}", file=sys.stderr)
        return 1
    print("fit for release")
    return 0


if __name__ == "__main__":
    sys.exit(main())
