"""Programs kept from run to run: the bits of fresh ones, nothing traced, and no program in place of another."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnh.engine.cache import executables
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import derivatives, iterate
from jaxnh.solvers import SPLITTINGS, tsit5
from jaxnh.systems.user_file import UserFile
from tests.flows.particle import SYSTEMS
from tests.helpers.cases import some_slow
from tests.helpers.paths import ROOT

COUNT = 9
STATE = (np.full(COUNT, 0.1), np.full(COUNT, 0.1)), (np.full(COUNT, 0.1), np.full(COUNT, math.sqrt(0.99)))
LANES = (STATE, {"b": np.linspace(5.2, 5.45, COUNT)})  # chaotic ones among them, see test_lanes

PROCESS = f"""
import math, sys
import numpy as np
from jaxnh.engine import xla_options
from jaxnh.engine.executor import lanes
from jaxnh.maps.build import make_return_map
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import constant_speed
xla_options.configure(2)
if "found" in sys.argv:
    lanes.jax.vmap = None  # nothing is traced
at = lambda value: np.full({COUNT}, value)
start = (at(0.1), at(0.1)), (at(0.1), at(math.sqrt(0.99)))
strobe = make_return_map(constant_speed(), SPLITTINGS["blanes_moan6"], 40)
q, n = lanes.LaneExecutor()(lanes.iterate, (strobe, np.int32(200)), (start, {{"b": np.linspace(5.2, 5.45, {COUNT})}}))
print(*(value.hex() for leaf in (*q, *n) for value in leaf.tolist()))
"""


def strobe(steps=40, solver="blanes_moan6"):
    return make_return_map(SYSTEMS["constant"], SPLITTINGS[solver], steps)


def start_process(folder, *arguments, keep="1", code=PROCESS, cwd=None):
    """A process that runs lanes, chaotic ones unless its code is another, with its programs in a folder."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    environment |= {"JAX_COMPILATION_CACHE_DIR": str(folder), "JAXNH_KEEP_PROGRAMS": keep}
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True, cwd=cwd)


def bits(process):
    out, _ = process.communicate()
    assert process.returncode == 0
    return out


@pytest.mark.slow  # in one process: test_some_of_the_devices
def test_bits_of_fresh_and_kept_programs(tmp_path):
    """Two processes that compile at the same time, one that finds the program, and one that keeps none: equal bits.

    After 200 periods a last bit of chaotic lanes is as large as the attractor (test_lanes).
    """
    fresh = [bits(process) for process in [start_process(tmp_path), start_process(tmp_path)]]
    assert len(list((tmp_path / "jaxnh").iterdir())) == 1  # of one name, and nothing half-written beside it
    found, traced = [bits(p) for p in [start_process(tmp_path, "found"), start_process(tmp_path / "none", keep="0")]]
    assert fresh == [traced, traced]
    assert found == traced
    assert not (tmp_path / "none" / "jaxnh").exists()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where programs are kept in this test."""
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    yield tmp_path / "jaxnh"
    jax.config.update("jax_compilation_cache_dir", before)


@pytest.mark.parametrize(
    "fault", some_slow({fault: fault for fault in ("cut", "bit", "empty", "of another program")}, "bit")
)
def test_a_file_that_is_no_program_is_written_anew(folder, fault):
    shared = strobe(), np.int32(3)
    expected = LaneExecutor()(iterate, shared, LANES)
    (path,) = folder.iterdir()
    sound = path.read_bytes()
    if fault == "of another program":
        LaneExecutor()(iterate, shared, LANES, tile=16)
        (other,) = set(folder.iterdir()) - {path}
        path.write_bytes(other.read_bytes())
    else:
        flipped = sound[:999] + bytes([sound[999] ^ 1]) + sound[1000:]
        path.write_bytes({"cut": sound[:-1], "bit": flipped, "empty": b""}[fault])
    bad = path.read_bytes()
    for _ in range(2):
        result = LaneExecutor()(iterate, shared, LANES)
        for one, other in zip(jax.tree.leaves(result), jax.tree.leaves(expected), strict=True):
            np.testing.assert_array_equal(one, other)
        assert path.read_bytes() != bad
    assert executables.find(
        path.name, jax.tree.structure((tuple(map(jax.tree.leaves, (shared, LANES))), {})), jax.devices()
    )


def test_what_nothing_asks_for_is_removed(folder):
    """Where a program is written, those of more than sixty days are removed; one that is found counts as new."""
    LaneExecutor()(iterate, (strobe(), np.int32(1)), LANES)
    (kept,) = folder.iterdir()
    old, recent = folder / ("a" * 64), folder / ("b" * 64)
    days = {old: 61, recent: 59, kept: 61}
    for path, age in days.items():
        path.touch()
        os.utime(path, (time.time() - 86400 * age,) * 2)
    LaneExecutor()(iterate, (strobe(), np.int32(1)), LANES)
    LaneExecutor()(derivatives, (strobe(), np.int32(1)), (np.full((COUNT, 3), 0.1), LANES[1]))
    names = {path.name for path in folder.iterdir()}
    assert {kept.name, recent.name} < names
    assert old.name not in names


def test_some_of_the_devices(folder, monkeypatch):
    """A program of one device of two, and that of the other, are found and run where they were compiled for."""
    shared, results = (strobe(), np.int32(3)), []
    for devices in (jax.devices()[:1], jax.devices()[1:], jax.devices()):
        results += [LaneExecutor(devices=devices)(iterate, shared, LANES)]
        with monkeypatch.context() as patch:
            patch.setattr(jax, "vmap", None)  # nothing is traced
            results += [LaneExecutor(devices=devices)(iterate, shared, LANES)]
    assert len(jax.devices()) > 1
    for result in results[1:]:
        jax.tree.map(np.testing.assert_array_equal, result, results[0])


def test_programs_of_others_are_kept_by_jax(folder):
    """As before the call, and after it."""
    LaneExecutor()(iterate, (strobe(), np.int32(1)), LANES)
    before = set(folder.parent.glob("*-cache"))
    jax.block_until_ready(jax.jit(lambda x: jnp.sin(x) + 0.625)(1.0))
    assert set(folder.parent.glob("*-cache")) > before


def test_a_folder_that_cannot_be_written_keeps_nothing(folder):
    folder.write_text("a file in its place")
    assert np.all(np.isfinite(LaneExecutor()(iterate, (strobe(), np.int32(1)), LANES)[0][0]))


# ---- names


def name(function=iterate, static=(), shared=None, lanes=LANES, devices=None):
    shared = (strobe(), np.int32(3)) if shared is None else shared
    return executables.name_of(function, static, (shared, lanes), devices or jax.devices())


def test_one_program_one_name(folder):
    """What is data alone has a part in no name."""
    assert name() == name(shared=(strobe(), np.int32(8)))
    assert name() == name(shared=(strobe(41), np.int32(8)))  # as many rows of its table


def test_other_programs_have_other_names(folder, monkeypatch):
    compensated = make_return_map(SYSTEMS["constant"], SPLITTINGS["blanes_moan6"], 40, compensated=True)
    general = [make_return_map(SYSTEMS["constant"], tsit5, 40), make_return_map(SYSTEMS["disturbed"], tsit5, 40)]
    few = jax.tree.map(lambda leaf: leaf[:4], LANES)
    names = [
        name(),
        name(lanes=few),
        name(shared=(strobe(4000), np.int32(3))),
        name(shared=(strobe(), 3)),
        name(shared=(compensated, np.int32(3))),
        *(name(shared=(one, np.int32(3))) for one in general),
        name(devices=jax.devices()[:1]),
        name(derivatives),
        name(derivatives, ("b",)),
        name(derivatives, (1,)),
        name(derivatives, (1.0,)),
        name(derivatives, (True,)),
        name(partial(iterate, 1)),
    ]
    before = jax.config.read("jax_disable_most_optimizations")
    jax.config.update("jax_disable_most_optimizations", not before)
    names.append(name())
    jax.config.update("jax_disable_most_optimizations", before)
    monkeypatch.setattr(executables, "_versions", lambda: ["another text of the package"])
    names.append(name())
    assert None not in names
    assert len(set(names)) == len(names)


def test_bytecode_is_no_part_of_the_package_s_text(tmp_path):
    """A second command has more of it than the first, which programs of the first must not be lost by."""
    (tmp_path / "map.py").write_text("period = 1.0\n")
    (tmp_path / "kernel.h").write_text("#pragma once\n")
    before = executables.hash_of_sources(tmp_path)
    (tmp_path / "__pycache__").mkdir()
    (tmp_path / "__pycache__" / "map.cpython-311.pyc").write_bytes(b"\x00")
    assert executables.hash_of_sources(tmp_path) == before
    (tmp_path / "kernel.h").write_text("#pragma twice\n")
    assert executables.hash_of_sources(tmp_path) != before


def test_what_has_no_certain_name_is_not_kept(folder, monkeypatch):
    """Functions of other packages, whose text may change, objects of a kind that is not known, and where it is off."""

    def ours(strobe, n, state, p):
        return state

    assert name() is not None
    assert name(ours) is None
    assert name(partial(iterate, ours)) is None
    assert name(static=(object(),)) is None
    assert name(static=(jnp.sin,)) is None
    monkeypatch.setenv("JAXNH_KEEP_PROGRAMS", "0")
    assert name() is None


SYSTEM = """import jax.numpy as jnp
import numpy as np
{before}
def system(drive=0.3):
    def rhs(y, t):
        return y[1], {force} - y[0] ** 3 - 0.1 * y[1] + drive * jnp.cos(t)

    return dict(rhs=rhs, coordinates=("x", "v"), period=2 * jnp.pi)
"""


def of_user(path, **words):
    path.write_text(SYSTEM.format(**{"before": "", "force": "y[0]"} | words))
    file = UserFile(path)
    shared = (make_return_map(file.flow(file.parameters, ("drive",)), tsit5, 20), np.int32(1))
    return name(shared=shared, lanes=((np.zeros(2), np.zeros(2)), {"drive": np.zeros(2)}))


def test_text_and_data_of_users_are_in_the_name(folder, tmp_path):
    """The same text is the same program wherever it lies; other text is another, and so are other data that it reads."""
    first = of_user(tmp_path / "a.py")
    assert first is not None
    assert of_user(tmp_path / "b.py") == first
    assert of_user(tmp_path / "a.py", force="2.0 * y[0]") != first
    data = tmp_path / "data.txt"
    reads = {"before": f"DATA = np.loadtxt({str(data)!r})", "force": "DATA[0] * jnp.interp(y[0], DATA, DATA)"}
    names = set()
    for text in ("1.0 2.0", "1.0 3.0"):
        data.write_text(text)
        names.add(of_user(tmp_path / "c.py", **reads))
    assert len(names - {None, first}) == 2


def test_derivatives_of_users_own_are_not_kept(folder, tmp_path):
    """What they come to stands in no equation."""
    before = "import jax\n@jax.custom_jvp\ndef own(x):\n    return x\nown.defjvp(lambda p, t: (p[0], t[0]))\n"
    assert of_user(tmp_path / "d.py", before=before, force="own(y[0])") is None


RATES = """import jax.numpy as jnp


def system(fast=50.0):
    def rhs(y, t):
        return [x * (1.0 - x * x) - fast * (x - after) for x, after in zip(y, y[1:] + y[:1], strict=True)]

    return dict(rhs=rhs, coordinates=tuple(f"x{i}" for i in range(9)))
"""
STIFF = """
import pathlib, sys
import numpy as np
from jaxnh.engine import xla_options
from jaxnh.engine.executor import lanes
from jaxnh.maps.build import make_return_map
from jaxnh.solvers import SOLVERS
from jaxnh.systems.user_file import UserFile
xla_options.configure(2)
found = "found" in sys.argv
if found:
    lanes.jax.vmap = None  # nothing is traced
lanes.jax.config.update("jax_disable_most_optimizations", True)  # compiled sooner, and with LAPACK all the same
file = UserFile(pathlib.Path("rates.py"))
flow = file.flow(file.parameters, ("fast",))
shared = make_return_map(flow, SOLVERS["rodas5p"], 8), np.int32(1)
start = flow.start({name: 0.1 * i * np.ones(2) for i, name in enumerate(flow.coordinates)})
end = lanes.LaneExecutor(devices=lanes.jax.devices()[:1])(lanes.iterate, shared, (start, {"fast": np.array([50.0, 60.0])}))
print(*(value.hex() for leaf in lanes.jax.tree.leaves(end) for value in leaf.tolist()))
"""


@pytest.mark.slow  # two processes; that kept programs are found is quick
def test_functions_of_lapack_are_looked_up_for_a_kept_program(tmp_path):
    """Matrices of nine coordinates are factorised by LAPACK, which a process that lowers nothing has not looked up."""
    (tmp_path / "rates.py").write_text(RATES)
    first, second = (bits(start_process(tmp_path, *words, code=STIFF, cwd=tmp_path)) for words in ((), ("found",)))
    kept = [path.read_bytes() for path in (tmp_path / "jaxnh").iterdir()]
    assert any(b"lapack_dgetrf" in data for data in kept)
    assert first == second
