"""A user's system: its file, its place in a config, its analyses beside those of the built-in systems."""

from __future__ import annotations

import shutil

import diffrax
import heyoka as hy
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.batch import Axis, LaneBatch
from jaxnh.analyses.cascade import doubling
from jaxnh.analyses.exponents import lyapunov
from jaxnh.config.schema import schema
from jaxnh.config.yaml_source import read
from jaxnh.engine.axes import points
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.experiment import load
from jaxnh.exceptions import ConfigError, UserFileError
from jaxnh.maps.build import make_return_map
from jaxnh.maps.general_flow import GeneralStrobe
from jaxnh.maps.iterate import derivatives, section_map
from jaxnh.plotting import results as figures
from jaxnh.solvers import SOLVERS, SPLITTINGS
from jaxnh.storage import hdf5 as store
from jaxnh.systems.lagrangian import Motion
from jaxnh.systems.status import STATUS
from jaxnh.systems.user_file import UserFile
from tests.flows.particle import SYSTEMS
from tests.helpers import taylor
from tests.helpers.commands import run_here, run_process
from tests.helpers.diffrax_solvers import ProjectedSolver
from tests.helpers.kept_programs import QUICKLY_COMPILED, lanes_with_kept_programs, session_of
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.usefixtures("quickly_uncalibrated")
PARTICLE = """import jax.numpy as jnp

def system(a=0.5, b=5.5, c=1.0, d=0.0, omega=1.0):
    def T(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2)

    def Q(q, v, t):
        (x, y), g = q, 1 + jnp.sin(omega * t)
        return -a * g * x - g * x**3 - a * v[0] + b * y, -g * y - a * g * y**3 - a * v[1] + b * x

    def f(q, v, t):
        return (v[0] ** 2 + v[1] ** 2 - c - d * jnp.sin(t),)

    return dict(T=T, Q=Q, f=f, coordinates=("x1", "y1"), period=2 * jnp.pi / omega)
"""
CONFIG = """system: {file: own.py}
initial: {x1: 0.1, x1_dot: 0.1, y1: 0.1, y1_dot: 0.99498743710662}
sweep: {b: {values: [5.3, 5.6]}}
accuracy: {solver: dopri8, steps: 200}
analyses:
  diagram: {transient: 4, strobes: 2}
"""


def write(folder, text=PARTICLE, config=CONFIG):
    (folder / "own.py").write_text(text)
    (folder / "own.yaml").write_text(config)
    return folder / "own.yaml"


def scene(folder, values, steps=200):
    return batch_of(load(write(folder)), values, steps)


def batch_of(experiment, values, steps):
    """The scene of an experiment of one axis, at other values along it."""
    (axis,), values = experiment.axes, np.asarray(values)
    along = Axis(axis.name, values, axis.long_name)
    start = experiment.start({}, len(values))
    return LaneBatch(
        experiment.dynamics(), start, {axis.name: values}, SOLVERS["dopri8"], steps, False, 0.0, axis=along
    )


# ---- the map


@pytest.mark.slow
def test_map_is_diffeqsolve_with_projected_steps(tmp_path):
    """The loop of steps is the written-out solver, projected, under `diffrax.diffeqsolve`, to rounding."""
    own = scene(tmp_path, [2.0], 100)
    strobe = make_return_map(own.system, SOLVERS["tsit5"], 100)
    assert isinstance(strobe, GeneralStrobe)
    start = jax.tree.map(lambda component: jnp.float64(component[0]), own.start)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(own.flow.rhs), ProjectedSolver(SOLVERS["tsit5"], own.flow), 0.0, own.flow.period,
        own.flow.period / 100, start, args={"b": 2.0}, max_steps=128,
    )  # fmt: skip
    moved = LaneExecutor()(section_map, (strobe, np.int32(1)), (own.system.chart.host_points(own.start), own.p))[0]
    exact = np.array([float(x[-1]) for x in (*solution.ys.q, *solution.ys.v)])
    assert np.abs(moved - exact).max() < 1e-11


@pytest.mark.slow
def test_map_and_its_derivatives_are_those_of_the_splitting(tmp_path):
    """Two methods that share no code: positions after a period, and their slopes in positions and in b.

    Across the constraint the map has no slope: one multiplier more is zero.
    """
    own, planar = scene(tmp_path, [5.3, 5.6]), SYSTEMS["constant"]
    fine = make_return_map(planar, SPLITTINGS["sofroniou_spaletta10"], 200)
    x2, y2 = (float(component[0]) for component in own.start.v)
    lanes, one = LaneExecutor(), np.int32(1)
    u = np.tile([0.1, 0.1, np.arctan2(y2, x2)], (2, 1))
    exact, monodromy, slope = lanes(derivatives, (fine, one), (u, own.p), static=("b",))
    points = own.system.chart.host_points(own.start)
    image, whole, general_slope = lanes(derivatives, (own.strobe(), one), (points, own.p), static=("b",))
    assert np.abs(image[:, :2] - exact[:, :2]).max() < 1e-9
    assert np.abs(general_slope[:, :2] - slope[:, :2]).max() < 1e-8
    assert np.abs(whole[:, :2, :2] - monodromy[:, :2, :2]).max() < 1e-8
    assert np.abs(np.linalg.eigvals(whole)).min(axis=1).max() < 1e-9


# Two values on each stable orbit of the cascade, of periods 1 to 16: by the paper's table.
CASCADE = (
    5.53,
    5.525,
    5.51,
    5.50,
    5.4935,
    5.4905,
    5.489,
    5.4884,
    5.48797,
    5.48785,
)


@pytest.mark.slow
def test_doublings_of_table_1(tmp_path):
    """Doublings from T, Q and f are those of the isokinetic route in results/table1.h5, to 1e-8.

    The first four of six: the next have the same map, twice as often each.
    """
    general = doubling.run(doubling.DoublingOptions(levels=4), scene(tmp_path, CASCADE), LaneExecutor())
    isokinetic = store.read_group(ROOT / "results" / "table1.h5", "doubling").isel(level=slice(4))
    np.testing.assert_array_equal(general["period"], isokinetic["period"])
    apart = np.abs(general["b"].to_numpy() - isokinetic["b"].to_numpy())
    assert apart.max() < 1e-8


# ---- a cascade of the user's own


def governor():
    """configs/governor.py without its multiplier: u' = (Q1 + 2 r u Q2)/(1 + 4 r² u²); x stays within half a turn."""
    u, y, x = hy.make_vars("u", "y", "x")
    drive, rate, level, damping, omega = (hy.par[i] for i in range(5))
    rise = rate * (u * u - level)
    force = drive * hy.sin(omega * hy.time) + x - x * x * x - damping * u
    lift = -y - damping * rise
    return (u, y, x), drive, [(u, (force + 2 * rate * u * lift) / (1 + 4 * rate * rate * u * u)), (y, rise), (x, u)]


class Governor(taylor.Parameters):
    equations = staticmethod(governor)


@pytest.fixture(scope="module")
def governor_doublings():
    """The first two, with their errors, by the Taylor reference, which needs rough values as guesses only."""
    par, start = Governor(a=0.5, c=0.5, d=0.2), np.array([0.0, 0.0, 0.5])
    return [(float(b), info.error) for b, _, info in taylor.cascade(par, [0.8452, 0.7933], start, first=2, before=0.87)]


@pytest.mark.slow
def test_doublings_of_the_governor(governor_doublings):
    """The first two against the Taylor reference, whose equations have no multipliers: within the errors of both."""
    values = np.linspace(0.87, 0.785, 24)
    own = batch_of(load(ROOT / "configs" / "governor.yaml"), values, 136)
    found = doubling.run(doubling.DoublingOptions(levels=2), own, LaneExecutor())
    assert found["period"].to_numpy().tolist() == [2, 4]
    drives, errors = found["drive"].to_numpy(), found["drive_error"].to_numpy()
    for drive, error, (exact, exact_error) in zip(drives, errors, governor_doublings, strict=True):
        assert abs(drive - exact) < error + exact_error


@pytest.mark.slow
@pytest.mark.usefixtures("quick_programs")
def test_lyapunov_spectrum_has_its_sum(tmp_path):
    """Three exponents on the constraint, their sum the mean divergence of all four equations; none is transverse."""
    options = lyapunov.LyapunovOptions(transient=16, periods=16)
    found = lyapunov.run(options, scene(tmp_path, [5.6]), LaneExecutor())
    assert found["exponents"].shape == (1, 3)
    assert abs(float(found["sum_rule_residual"][0])) < 1e-6
    assert "transverse" not in found


# ---- the section


ROLLING = """import jax.numpy as jnp
def system(r=1.0):
    T = lambda q, v, t: 0.5 * (v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    Q = lambda q, v, t: (jnp.sin(t) - q[0], 0.0, jnp.cos(q[2]))
    f = lambda q, v, t: (v[1] - r * v[2],)
    return dict(T=T, Q=Q, f=f, coordinates=("x", "y", "phi"), angles=("phi",), ignorable=("y",), period=2 * jnp.pi)
"""


def test_section_leaves_out_ignorable_coordinates_and_wraps_angles(tmp_path):
    config = CONFIG.replace("initial: {x1: 0.1, x1_dot: 0.1, y1: 0.1, y1_dot: 0.99498743710662}\n", "")
    experiment = load(write(tmp_path, ROLLING, config.replace("b: {", "r: {")))
    system = experiment.flow()
    assert (system.chart.dimension, system.exponents, system.constraints) == (5, 4, 1)
    state = Motion((0.5, 7.0, 4.0), (1.0, 2.0, 3.0), (0.0, 0.0))
    point = np.asarray(system.chart.point(jax.tree.map(jnp.float64, state)))
    assert np.abs(point - [0.5, 4.0 - 2 * np.pi, 1.0, 2.0, 3.0]).max() < 1e-15
    assert system.chart.state(point).q[1] == 0
    assert (
        np.abs(
            system.chart.wrap(np.array([[9.0, 4.0, 9.0, 0.0, 0.0]]))[0] - [9.0, 4.0 - 2 * np.pi, 9.0, 0.0, 0.0]
        ).max()
        < 1e-15
    )


# ---- the file and the config

FAULTS = {
    "not Python": (("return 0.5", "return 0.5 *)"), "own.py:5: not valid Python: "),
    "no function": (("def system(", "def machine("), "own.py:1: there is no function system"),
    "a name in Q": (("b * y,", "beta * y,"), "own.py:9: NameError: name 'beta' is not defined"),
    "forces in a string": (("+ b * y, -g", "+ b * y, '' if 1 else g"), "own.py:7: Q must return a number a coordinate"),
    "no forces": (("        return -a * g", "        -a * g"), "own.py:7: Q must return a number a coordinate, and returns nothing"),
    "too few forces": (("+ b * y, -g", "+ b * y - g"), "own.py:7: Q must return 2 numbers, one a coordinate, not 1"),
    "no period": ((", period=2 * jnp.pi / omega", ""), "own.py:4: the system depends on t: give its period"),
    "a clock and a unit": (("period=", "time_unit=1.0, period="), "own.py:3: period and time_unit exclude each other"),
    "both ways": (("f=f", "rhs=f"), "own.py:3: system returns rhs and 'T'; a system is a right-hand side, or T and Q"),
    "neither way": (("T=T, ", ""), "own.py:3: system must also return T, or a right-hand side rhs"),
    "unknown key": (("f=f", "F=f"), "own.py:3: system returns 'F', which is unknown; known are T, Q"),
    "no default": (("a=0.5", "a"), "own.py:3: parameter a of system needs a number as its default"),
    "taken name": (('("x1", "y1")', '("x1", "t")'), "own.py:3: coordinates must differ, and not be one of"),
    "a parameter called as a velocity": (("omega=1.0", "omega=1.0, x1_dot=1.0"), "own.py:3: x1_dot names a parameter and a coordinate"),
    "a period below zero": (("/ omega", "/ omega * (5.4 - b)"), "own.py:3: period must be a positive number, not -"),
}  # fmt: skip


@pytest.mark.parametrize(("edit", "message"), FAULTS.values(), ids=FAULTS)
def test_fault_in_the_users_file(tmp_path, edit, message):
    assert edit[0] in PARTICLE
    with pytest.raises(ConfigError) as caught:
        load(write(tmp_path, PARTICLE.replace(*edit)))
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{tmp_path}/{message}")


OSCILLATOR = """import math
from math import cos as cosine
import jax.numpy as jnp
import numpy as np
def system(drive=0.5, damping=0.1):
    def rhs(y, t):
        x, v = y
        force = -x
        return v, force - damping * v + drive * jnp.sin(t)
    return dict(rhs=rhs, coordinates=("x", "v"), period=2 * math.pi)
"""
PYTHON_OF_PLAIN_NUMBERS = {
    "math": (("jnp.sin(t)", "math.sin(t)"), 9, "math.sin takes plain numbers, not what changes during the run: use jnp.sin (import jax.numpy as jnp)"),
    "math by another name": (("jnp.sin(t)", "cosine(t)"), 9, "cosine takes plain numbers, not what changes during the run: use jnp.cos ("),
    "numpy": (("jnp.sin(t)", "np.sin(t)"), 9, "np.sin takes plain numbers, not what changes during the run: use jnp.sin ("),
    "an array of numpy": (("return v, force", "return np.array([v, force])"), 9, "np.array takes plain numbers, not what changes during the run: use jnp.array ("),
    "an array changed in place": (("force = -x", "force = np.zeros(1); force[0] = -x"), 8, "NumPy's arrays hold plain numbers, not what changes during the run: return a tuple"),
    "if": (("force = -x", "force = -x\n        if x > 0:\n            force = 0.0"), 9, "if cannot decide by what changes during the run: use jnp.where(x > 0, a, b) ("),
    "a conditional expression": (("= -x", "= -x if x > 0 else 0.0"), 8, "if cannot decide by what changes during the run: use jnp.where(x > 0, a, b) ("),
    "while": (("force = -x", "while x > 1: x = x - 1"), 8, "while cannot decide by what changes during the run: use jnp.where(x > 1, a, b) ("),
    "and": (("= -x", "= -x * (x > 0 and x < 1)"), 8, "and cannot decide by what changes during the run: use jnp.logical_and ("),
    "a comparison of three": (("= -x", "= -x * (0 < x < 1)"), 8, "a comparison of three cannot decide by what changes during the run: use jnp.logical_and ("),
    "max": (("= -x", "= max(-x, 0.0)"), 8, "max() cannot choose by what changes during the run: use jnp.maximum ("),
    "float": (("= -x", "= -float(x)"), 8, "float() takes a plain number, not what changes during the run: leave it out"),
    "an index": (("= -x", "= [1.0, 2.0][x]"), 8, "TypeError: "),
}  # fmt: skip


@pytest.mark.parametrize(("edit", "line", "message"), PYTHON_OF_PLAIN_NUMBERS.values(), ids=PYTHON_OF_PLAIN_NUMBERS)
def test_python_of_plain_numbers_is_named_with_what_to_use(tmp_path, edit, line, message):
    """The functions and choices of Python that newcomers write, each with its counterpart in jax.numpy."""
    assert edit[0] in OSCILLATOR
    path = tmp_path / "own.py"
    path.write_text(OSCILLATOR.replace(*edit))
    with pytest.raises(UserFileError) as caught:
        UserFile(path)
    assert str(caught.value).startswith(f"{path}:{line}: {message}")
    assert "\n" not in str(caught.value)


def test_one_number_and_one_name_stand_for_tuples_of_them(tmp_path):
    """One degree of freedom said without commas is the same system, bit for bit."""
    path = tmp_path / "own.py"
    path.write_text(
        """import jax.numpy as jnp
def system(drive=0.5):
    T = lambda q, v, t: 0.5 * v[0] ** 2
    Q = lambda q, v, t: (-jnp.sin(q[0]) + drive * jnp.cos(t))
    return dict(T=T, Q=Q, coordinates="theta", angles="theta", period=2 * jnp.pi)
"""
    )
    single = UserFile(path)
    path.write_text(path.read_text().replace("jnp.cos(t))", "jnp.cos(t),)").replace('"theta"', '("theta",)'))
    pair = UserFile(path)
    assert single.states == pair.states == ("theta", "theta_dot")
    assert single.traced == pair.traced
    flow = single.flow({"drive": 0.5})
    assert flow.angles == (True,)
    assert float(flow.rhs(0.0, flow.start({"theta": 0.0, "theta_dot": 0.0}), {}).v[0]) == 0.5
    path.write_text("def system(r=2.0): return dict(rhs=lambda y, t: r * y[0] * (1 - y[0]), coordinates='x')\n")
    assert UserFile(path).coordinates == ("x",)
    path.write_text(path.read_text().replace("'x'", "'x, y'"))
    with pytest.raises(UserFileError, match=r"own.py:1: coordinates must be names"):
        UserFile(path)


def test_a_flow_is_made_once_for_equal_numbers(tmp_path):
    """Sessions ask for the same flow again and again; numbers are equal to the bit, and few flows are kept."""
    path = tmp_path / "own.py"
    path.write_text("def system(a=1.0, b=2.0): return dict(rhs=lambda y, t: b / a - y[0], coordinates='x')\n")
    file = UserFile(path)
    first = file.flow({"a": 0.0, "b": 2.0})
    assert file.flow({"a": 0.0, "b": 2.0}) is first
    assert np.signbit(file.flow({"a": -0.0, "b": 2.0}).parameters["a"])
    assert file.flow({"a": 0.0, "b": 2.0}, ("b",)).roles.of_lanes == ("b",)
    assert file.flow({"a": 0.0, "b": 2.0}).roles.of_lanes == ()
    for a in range(300):
        assert file.flow({"a": float(a), "b": 2.0}).parameters["a"] == a
    assert len(file._flows) <= 256


CONFIG_FAULTS = {
    "off the constraint": (("x1_dot: 0.1,", "x1_dot: 0.2,"), ":2: initial.x1_dot: f[0] is 0.03 at the start with b = 5.3"),
    "unknown coordinate": (("x1: 0.1", "z: 0.1"), ":2: initial.z: unknown key"),
    "unknown parameter": (("own.py}", "own.py, e: 1}"), ":1: system.e: unknown key"),
    "swept and given": (("own.py}", "own.py, b: 1}"), ":1: system.b: b is swept"),
    "start swept and given": (("{b:", "{x1:"), ":2: initial.x1: x1 is swept; leave it out of initial"),
    "unknown sweep": (("{b:", "{bb:"), ":3: sweep.bb: unknown key"),
    "no sweep": (("{b: {values: [5.3, 5.6]}}", "{}"), ":3: sweep: name an axis and its values, one at least of a, b, c, d, omega, x1, x1_dot, y1, y1_dot"),
    "off the constraint elsewhere": (("sweep: {", "sweep: {c: {values: [1.0, 2.0]}, "), ":2: initial.x1_dot: f[0] is -1 at the start with c = 2 and b = 5.3, and must be 0; the nearest velocities that make it so are x1_dot: 0.14142"),
    "no such file": (("own.py", "other.py"), ":1: system.file: there is no file"),
    "a splitting": (("dopri8", "kahan_li8"), ":4: accuracy.solver: kahan_li8 is for a particle"),
    "too many exponents": (("analyses:", "analyses:\n  lyapunov: {exponents: 4}"), ":6: analyses.lyapunov.exponents: must be at most 3"),
}  # fmt: skip


@pytest.mark.parametrize(("edit", "message"), CONFIG_FAULTS.values(), ids=CONFIG_FAULTS)
def test_fault_in_the_config(tmp_path, edit, message):
    assert edit[0] in CONFIG
    with pytest.raises(ConfigError) as caught:
        load(write(tmp_path, config=CONFIG.replace(*edit)))
    assert str(caught.value).startswith(f"{tmp_path}/own.yaml{message}")


def test_axes_of_a_users_system(tmp_path):
    """Parameters, coordinates and velocities in the order of the config; omega changes the clock, which lanes share."""
    (tmp_path / "sleigh.py").write_text((ROOT / "configs" / "sleigh.py").read_text())
    path = tmp_path / "sleigh.yaml"
    path.write_text(
        "system: {file: sleigh.py, mass: 2.0}\n"
        "sweep:\n  x: {values: [0.5, 0.6]}\n  omega: {values: [0.5, 1.0]}\n  drive: {values: [1.0, 2.0, 3.0]}\n"
        "  x_dot: {values: [0.0, 0.3]}\n  theta_dot: {values: [0.0]}\n"
        "analyses: {lyapunov: {}}\n"
    )
    experiment = load(path)
    assert [(axis.name, axis.kind, axis.long_name) for axis in experiment.axes] == [
        ("x", "start", "coordinate x"),
        ("omega", "shared", "parameter omega"),
        ("drive", "lane", "parameter drive"),
        ("x_dot", "start", "velocity x_dot"),
        ("theta_dot", "start", "velocity theta_dot"),
    ]
    assert experiment.flow().period == 4 * np.pi
    assert experiment.flow({"omega": 1.0}).period == 2 * np.pi
    given = experiment.flow({"omega": 1.0}).parameters
    assert (given["mass"], given["drive"], given["omega"], given["inertia"]) == (2.0, 1.0, 1.0, 0.2)
    start = experiment.start({"x": np.array([0.5, 0.6]), "x_dot": np.array([0.0, 0.3])}, 2)
    assert [component.tolist() for component in start.q] == [[0.5, 0.6], [0.0, 0.0], [0.0, 0.0]]
    assert [component.tolist() for component in start.v] == [[0.0, 0.3], [0.0, 0.0], [0.0, 0.0]]
    assert experiment.coordinates == ("x", "x_dot", "y", "y_dot", "theta", "theta_dot")
    assert experiment.user_file is not None
    assert experiment.user_file.path == tmp_path / "sleigh.py"


def test_a_plane_of_starts_that_are_all_off_the_constraint(tmp_path):
    """The worst is named, which is looked for at the corners too, however many points there are."""
    (tmp_path / "sleigh.py").write_text((ROOT / "configs" / "sleigh.py").read_text())
    path = tmp_path / "sleigh.yaml"
    path.write_text(
        "system: {file: sleigh.py}\ninitial: {theta_dot: 0.1}\n"
        "sweep:\n  theta: {start: 0.1, stop: 0.5, count: 3001}\n  x_dot: {start: 0.5, stop: 2.0, count: 3000}\n"
        "analyses: {lyapunov: {}}\n"
    )
    with pytest.raises(ConfigError) as caught:
        load(path)
    message = str(caught.value).removeprefix(str(path))
    assert message.startswith(
        ":5: sweep.x_dot: f[0] is -0.959 at the start with theta = 0.5 and x_dot = 2, and must be 0; "
        "the nearest velocities that make it so are x_dot: 1.540302306, y_dot: 0.8414709848"
    )


def sleigh(folder, initial):
    """A plane of starts of the sleigh, half of them with a velocity across its blade."""
    (folder / "sleigh.py").write_text((ROOT / "configs" / "sleigh.py").read_text())
    path = folder / "sleigh.yaml"
    path.write_text(
        f"system: {{file: sleigh.py}}\ninitial: {initial}\n"
        "sweep:\n  theta: {values: [0.0, 0.5]}\n  x_dot: {values: [0.5, 1.0]}\n"
        "accuracy: {target: 1.0e-6}\nanalyses:\n  lyapunov: {transient: 16, periods: 16, exponents: 1, method: averages}\n"
    )
    return load(path)


def test_starts_off_the_constraint_fail_and_no_others(tmp_path):
    experiment = sleigh(tmp_path, "{theta_dot: 0.1}")
    axes = experiment.axes
    start = points(experiment, axes, np.unravel_index(np.arange(4), (2, 2))).start
    off = [False, False, True, True]  # θ = 0.5, where the blade does not point along x
    assert list(np.isnan(start.v[0])) == list(np.isnan(start.q[0])) == off
    assert [STATUS[int(reason)] for reason in start.watch[1]] == [
        "ok",
        "ok",
        "off_constraint",
        "off_constraint",
    ]


def test_lanes_that_start_off_the_constraint_fail_and_the_others_go_on(tmp_path):
    session = session_of(sleigh(tmp_path, "{theta_dot: 0.1}"))
    session._lanes = lanes_with_kept_programs(None, None, 8, QUICKLY_COMPILED)
    data = session.run("lyapunov")
    assert list(np.isnan(data["exponents"].to_numpy().ravel())) == [False, False, True, True]
    assert jaxnh.labels(data["status"]).to_numpy().ravel().tolist() == ["ok", "ok", "off constraint", "off constraint"]


def test_starts_off_the_constraint_are_moved_where_that_is_asked_for(tmp_path):
    """Onto the blade's line: the nearest by the mass matrix, in which the blade's velocity and turning are coupled."""
    experiment = sleigh(tmp_path, "{theta_dot: 0.1, project: true}")
    start = points(experiment, experiment.axes, np.unravel_index(np.arange(4), (2, 2))).start
    (x, y, turning), theta = start.v, start.q[2]
    assert np.max(np.abs(y * np.cos(theta) - x * np.sin(theta))) < 1e-12
    assert list(x[:2]) == [0.5, 1.0]
    assert list(turning[:2]) == [0.1, 0.1]
    assert np.all(start.watch[1] == 0.0)
    assert experiment.sha256 != sleigh(tmp_path, "{theta_dot: 0.1}").sha256


def test_constraint_that_is_no_number_at_the_start(tmp_path):
    text = PARTICLE.replace("- c - d * jnp.sin(t),)", "- c - d * jnp.sin(t) + jnp.log(q[0]) * 0,)")
    with pytest.raises(ConfigError, match=r"f\[0\] is nan at the start with b = 5.3, and must be 0"):
        load(write(tmp_path, text, CONFIG.replace("x1: 0.1", "x1: -0.1")))


def test_system_without_parameters(tmp_path):
    text = """
def system():
    return dict(T=lambda q, v, t: 0.5 * v[0] ** 2, Q=lambda q, v, t: (t % 1.0 - q[0],), coordinates=("x",), period=1.0)
"""
    config = "system: {file: own.py}\nsweep: {x: {values: [0.1, 0.2]}}\nanalyses: {poincare: {}}\n"
    (axis,) = load(write(tmp_path, text, config)).axes
    assert (axis.name, axis.kind) == ("x", "start")


def test_names_of_our_own_are_as_good_as_others(tmp_path):
    """Parameters and coordinates may have names that the classes of a config use themselves."""
    text = """
import jax.numpy as jnp

def system(copy=1.0, model_config=2.0, flow=3.0, known=4.0, check=5.0):
    def Q(q, v, t):
        return jnp.cos(2 * jnp.pi * t) - copy * model_config * q[0], -flow * known * check * q[1]

    return dict(T=lambda q, v, t: 0.5 * (v[0] ** 2 + v[1] ** 2), Q=Q, coordinates=("given", "json"), period=1.0)
"""
    config = (
        "system: {file: own.py, check: 0.5, flow: 0.25}\ninitial: {given: 0.1, json_dot: 0.2}\n"
        "sweep: {copy: {values: [0.1, 0.2]}}\nanalyses: {poincare: {}}\n"
    )
    experiment = load(write(tmp_path, text, config))
    expected = {"copy": 0.1, "model_config": 2.0, "flow": 0.25, "known": 4.0, "check": 0.5}
    assert dict(experiment.flow().parameters) == expected
    assert [float(x[0]) for x in experiment.start({}, 1).q] == [0.1, 0.0]


def test_experiment_from_the_texts_alone(tmp_path):
    """As a worker makes it, wherever the file was: the same hash, and the name of the file as the config has it."""
    experiment = load(write(tmp_path))
    again = type(experiment).from_text(experiment.text, experiment.user_file.text)
    assert again.sha256 == experiment.sha256
    assert str(again.user_file.path) == "own.py"


def test_axis_called_as_a_dimension_of_results(tmp_path):
    (tmp_path / "governor.py").write_text((ROOT / "configs" / "governor.py").read_text())
    config = "system: {file: governor.py}\nsweep: {level: {values: [0.0]}}\nanalyses: {poincare: {}}\n"
    message = "sweep.level: results have a variable called level; give the parameter another name to sweep it"
    with pytest.raises(ConfigError, match=message):
        load(write(tmp_path, config=config))


def test_another_file_is_another_experiment(tmp_path):
    one = load(write(tmp_path)).sha256
    assert load(write(tmp_path)).sha256 == one
    assert load(write(tmp_path, PARTICLE + "\n# the same\n")).sha256 != one


# ---- from the file to the result


EVERYTHING = """\
title: Every analysis of a governor
system: {file: governor.py}
initial: {x: 0.5, y_dot: -0.25}
sweep: {drive: {values: [0.86, 0.845, 0.84, 0.83, 0.72, 0.7]}}
accuracy: {solver: dopri5, steps: 80}
analyses:
  portrait: {transient: 200, periods: 8, samples: 64}
  poincare: {transient: 200, strobes: 64}
  diagram: {transient: 200, strobes: 32}
  lyapunov: {transient: 64, periods: 200, exponents: 3}
  period: {max_period: 8, transient: 400}
  chaos01: {transient: 100, periods: 400}
  verdict: {}
  doubling: {levels: 1}
"""


@pytest.mark.slow
@pytest.mark.usefixtures("quick_programs")
def test_every_analysis(result, tmp_path, governor_doublings):
    """Of a user's system, with a picture of all. The doubling is that of the Taylor reference, to the error of 80 steps."""
    config = tmp_path / "everything.yaml"
    config.write_text(EVERYTHING)
    shutil.copy(ROOT / "configs" / "governor.py", tmp_path)
    path, *_ = result("own_everything", config)
    found = {analysis.name: store.read_group(path, analysis.name) for analysis, _ in load(config).requested()}
    assert found["period"]["period"].values.tolist() == [2, 4, 4, 4, 0, 0]
    assert found["verdict"]["kind"].values.tolist() == [0, 0, 0, 0, 2, 2]
    assert abs(float(found["doubling"]["drive"][0]) - governor_doublings[0][0]) < 1e-8
    for name in ("portrait", "poincare", "diagram"):
        x, y_dot = found[name]["x_dot"].values, found[name]["y_dot"].values
        assert np.abs(y_dot - 0.5 * (x**2 - 0.5)).max() < 1e-12  # every state is on f = 0
    assert len(figures.figure(path).axes) == 6 + 6


SMALL = """\
system: {file: governor.py}
initial: {x: 0.5, y_dot: -0.25}
sweep: {drive: {start: 0.7, stop: 0.9, count: 64}}
accuracy: {solver: dopri5, steps: 40}
analyses:
  diagram: {transient: 16, strobes: 4}
"""


def run(module, folder, *arguments):
    """Exit code and lines of a command of ours in a folder; workers of Dask need a process to be started from."""
    if "--dask" in arguments:
        done = run_process(*arguments, cwd=folder)
    else:
        done = run_here(*arguments, cwd=folder, command=module)
    return done.returncode, done.stdout.splitlines(), done.stderr.splitlines()


@pytest.mark.slow
@pytest.mark.usefixtures("uncalibrated", "quick_programs")
def test_file_goes_with_plan_and_result(tmp_path, monkeypatch):
    """Parts, Dask workers and lanes run again know it from the text that is kept; one that has changed is not mixed in."""
    monkeypatch.setenv("JAX_DISABLE_MOST_OPTIMIZATIONS", "true")  # the worker's programs are those of this process
    (tmp_path / "job.yaml").write_text(SMALL)
    file = tmp_path / "governor.py"
    shutil.copy(ROOT / "configs" / "governor.py", file)
    text = file.read_text()
    tiles = ("--tile", 16, "--output", "job.h5")
    assert run("sweep", tmp_path, "job.yaml", *tiles, "--part", "1/2")[0] == 0
    file.write_text(text.replace("-q[1]", "-2 * q[1]"))
    code, _, err = run("sweep", tmp_path, "job.yaml", *tiles)
    assert (code, len(err)) == (2, 1)
    assert err[0].endswith("job.h5.tiles holds tiles of another text of governor.py; --fresh drops them")
    file.write_text(text)
    shutil.copytree(tmp_path / "job.h5.tiles", tmp_path / "whole.h5.tiles")
    code, out, err = run("sweep", tmp_path, "job.yaml", *tiles, "--part", "2/2", "--dask", "local:1")
    assert (code, out) == (0, ["part 2/2: 2 of 4 tiles"]), err
    assert run("sweep", tmp_path, "job.yaml", *tiles, "--merge")[0] == 0
    code, _, err = run("sweep", tmp_path, "job.yaml", "--output", "whole.h5")
    assert code == 0
    assert "2 of 4 tiles are done; going on" in err
    for name in ("x", "x_dot", "y", "y_dot", "drift"):
        one, other = (store.read_group(tmp_path / f"{which}.h5", "diagram")[name] for which in ("job", "whole"))
        assert one.values.tobytes() == other.values.tobytes()
    assert store.read_attrs(tmp_path / "job.h5")["system_file"] == text
    equal = "diagram: 48 lanes run again are equal bit for bit"
    again = "lanes are run again by its text in the result"
    for change, said in (
        (None, "is as it was"),
        ("# another", f"has changed since; {again}"),
        ("", f"is not there; {again}"),
    ):
        if change is not None:
            file.write_text(change) if change else file.unlink()
        if again in said:  # the text in a result runs where it is that of the user's own file, else on request alone
            code, out, err = run("inspect", tmp_path, "job.h5", "--verify")
            assert (code, len(err)) == (2, 1)
            assert err[0].startswith(f"command line: --verify: governor.py {said.split(';')[0]}")
            assert "--trust runs that text" in err[0]
            assert equal not in out
        trust = ["--trust"] if again in said else []
        code, out, err = run("inspect", tmp_path, "job.h5", "--verify", *trust)
        assert code == 0, err
        assert out[-2:] == [f"governor.py {said}", equal]
    file.write_text(text + "# another\n")
    code, _, err = run("sweep", tmp_path, "job.yaml", "--output", "job.h5")
    assert code == 2
    assert err == [
        "command line: --output: job.h5 holds the result of another text of governor.py; --fresh replaces it"
    ]


# ---- the schema for editors

TYPES = {"object": dict, "array": (list, tuple), "string": str, "null": type(None)}


def fits(content, schema, root):
    """Whether a config is valid by a JSON Schema: the keywords that ours has, by the words of the specification."""
    kind = schema.get("type")
    number = isinstance(content, int | float) and not isinstance(content, bool)
    if kind in ("number", "integer") and not (number and (kind == "number" or int(content) == content)):
        return False
    if kind in TYPES and not isinstance(content, TYPES[kind]):
        return False
    within = {
        "$ref": lambda name: fits(content, root["$defs"][name.removeprefix("#/$defs/")], root),
        "const": lambda one: content == one,
        "enum": lambda some: content in some,
        "minimum": lambda low: not number or content >= low,
        "maximum": lambda high: not number or content <= high,
        "exclusiveMinimum": lambda low: not number or content > low,
        "minItems": lambda least: len(content) >= least,
        "maxItems": lambda most: len(content) <= most,
        "minProperties": lambda least: len(content) >= least,
        "maxProperties": lambda most: len(content) <= most,
        "required": lambda names: set(names) <= set(content),
        "prefixItems": lambda each: all(fits(i, one, root) for i, one in zip(content, each, strict=False)),
        "items": lambda each: all(fits(item, each, root) for item in content),
        "oneOf": lambda several: sum(fits(content, one, root) for one in several) == 1,
        "anyOf": lambda several: any(fits(content, one, root) for one in several),
        "properties": lambda known: all(fits(content[key], known[key], root) for key in set(known) & set(content)),
        "if": lambda case: fits(content, schema["then" if fits(content, case, root) else "else"], root),
    }
    others = set(content) - set(schema.get("properties", {})) if isinstance(content, dict) else set()
    further = schema.get("additionalProperties", True)
    if others and (
        further is False or (further is not True and not all(fits(content[o], further, root) for o in others))
    ):
        return False
    words = {"type", "title", "description", "default", "discriminator", "additionalProperties", "then", "else"}
    assert set(schema) <= set(within) | words | {"$schema", "$defs"}, set(schema) - set(within)
    return all(rule(schema[word]) for word, rule in within.items() if word in schema)


@pytest.mark.parametrize("path", sorted((ROOT / "configs").glob("*.yaml")), ids=lambda path: path.stem)
def test_configs_are_valid_by_the_schema(path):
    described = schema()
    assert fits(read(path).data, described, described)


@pytest.mark.parametrize("edit", ["sweep.a={values: [1.0]}", "sweep.x1={start: 0.0, stop: 1.0, count: 3}"])
def test_several_axes_are_valid_by_the_schema(tmp_path, edit):
    described = schema()
    for path in (ROOT / "configs" / "table1.yaml", write(tmp_path)):
        assert fits(read(path, [edit]).data, described, described)


SCHEMA_FAULTS = {
    "a parameter that is text": ("system.a=much", "system.a='much'"),
    "no such key of a system of ours": ("system.mass=1", None),
    "a sweep of nothing": ("sweep={}", "sweep={}"),
    "an axis of no values": ("sweep.a={values: []}", "sweep.a={values: []}"),
    "an axis of numbers": ("sweep.a=[1.0]", "sweep.a=[1.0]"),
    "an axis that ours does not have": ("sweep.drive={values: [1.0]}", None),
    "a start of no coordinate of ours": ("initial.x=0.5", None),
    "a start that is text": ("initial.x1=up", "initial.x1=up"),
    "unknown section": ("accuracies={}", "accuracies={}"),
    "a file and a constraint": ("system.file=own.py", "system.constraint=constant_speed"),
}


@pytest.mark.parametrize("edits", SCHEMA_FAULTS.values(), ids=SCHEMA_FAULTS)
def test_schema_marks_faults(tmp_path, edits):
    """Of a config of a built-in system, and of one of a user's: both valid without the fault."""
    described = schema()
    for path, edit in zip((ROOT / "configs" / "table1.yaml", write(tmp_path)), edits, strict=True):
        assert fits(read(path).data, described, described)
        if edit:
            assert not fits(read(path, [edit]).data, described, described)
