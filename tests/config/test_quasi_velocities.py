"""Quasi-velocities in a user's file: what is said of a wrong one, and the configs in `configs/nonholonomic`."""

from __future__ import annotations

import jax
import numpy as np
import pytest

import jaxnh
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.start_states import put_on_level
from jaxnh.exceptions import ConfigError
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import iterate
from jaxnh.maps.time_tables import time_split
from jaxnh.mechanics import ellipsoid, rolling_body
from jaxnh.solvers import dopri8, tsit5
from jaxnh.systems.lagrangian import Lagrangian, Motion, lagrangian
from jaxnh.systems.level import off_level, on_level
from tests.helpers.cases import some_slow
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.usefixtures("uncalibrated", "quick_compiling")
TOP = """\
from jaxnh.mechanics import quaternion_rates

def system(weight=1.0):
    def T(q, u, t):
        return 0.5 * (u[0] ** 2 + 1.7 * u[1] ** 2 + 2.3 * u[2] ** 2)

    def Q(q, u, t):
        return 0.0, 0.0, 0.0

    def rates(q, u, t):
        return quaternion_rates(q, u)

    e = ("e0", "e1", "e2", "e3")
    return dict(T=T, Q=Q, rates=rates, coordinates=e, quasi_velocities=("p", "q", "r"), norms=[e])
"""
CONFIG = """\
system: {{file: {file}}}
initial: {{{initial}}}
sweep: {{weight: {{values: [1.0, 2.0]}}}}
accuracy: {{solver: tsit5, steps: 20}}
analyses:
  portrait: {{}}
"""


def load(folder, text=TOP, initial="e0: 1.0, p: 0.3"):
    (folder / "top.py").write_text(text)
    return Experiment.from_text(CONFIG.format(file=folder / "top.py", initial=initial))


def test_names(tmp_path):
    """Coordinates, then quasi-velocities, from the text and from the function alike."""
    made = load(tmp_path)
    names = ("e0", "e1", "e2", "e3", "p", "q", "r")
    assert made.coordinates == made.flow().coordinates == names
    assert made.flow().readout.labels.long_names["p"] == "quasi-velocity p"
    written_out = TOP.replace("coordinates=e", 'coordinates=("e0", "e1", "e2", "e3")')
    assert load(tmp_path, written_out).coordinates == names


def test_start_off_a_norm(tmp_path):
    """A quaternion that is not of length one is refused in one line, or moved where that is asked for."""
    with pytest.raises(ConfigError) as refused:
        load(tmp_path, initial="e0: 0.9, e1: 0.1, p: 0.3")
    line = str(refused.value)
    assert "initial.e0: the sum of the squares of e0, e1, e2 and e3 is 0.82 at the start with weight = 1" in line
    assert "e0: 0.9938837347, e1: 0.1104315261" in line
    assert "\n" not in line
    moved = load(tmp_path, initial="e0: 0.9, e1: 0.1, p: 0.3, project: true")
    start = moved.start({}, 2)
    assert np.abs(np.sum(np.square(start.q), axis=0) - 1).max() < 1e-15
    assert np.all(np.asarray(start.watch[0]) == 0.0)  # what it was off is no drift of a step


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (", quasi_velocities=", ", angles=", "with rates, system must also return quasi_velocities"),
        ("rates=rates, ", "", "quasi_velocities goes with rates(q, u, t), the rates of the coordinates"),
        ("return 0.0, 0.0, 0.0", "return 0.0, 0.0", "Q must return 3 numbers, one a quasi-velocity, not 2"),
        ("return quaternion_rates(q, u)", "return u", "rates must return 4 numbers, one a coordinate, not 3"),
        ("return quaternion_rates(q, u)", "return (*u, u[0])", "the rates do not keep the sum of squares"),
        ("quaternion_rates(q, u)", "[x * u[0] for x in quaternion_rates(q, u)]", "rates must be linear"),
        ("norms=[e]", "norms=[('a', 'b')]", "norms has 'a', which is no coordinate"),
        ("norms=[e]", "dependent='z'", "dependent names 'z', which is no quasi-velocity"),
        ("norms=[e]", "dependent='p'", "dependent names quasi-velocities that the constraints f give"),
        ("norms=[e]", "f=lambda q, u, t: u[:1], dependent=('p', 'q')", "f returns 1 numbers, and must return 2"),
        ("norms=[e]", "f=lambda q, u, t: u", "f returns 3 numbers; 3 quasi-velocities can have 2 at most"),
        ("norms=[e]", "structure_constants=[[1.0]]", "structure_constants must be 3 times 3 times 3 plain numbers"),
        ('("p", "q", "r")', '("p", "q", "e0")', "coordinates must differ"),
    ],
)
def test_wrong_files(tmp_path, old, new, message):
    assert old in TOP
    with pytest.raises(ConfigError) as refused:
        load(tmp_path, TOP.replace(old, new, 1))
    line = str(refused.value)
    assert message in line
    assert "top.py:" in line
    assert "\n" not in line


def test_sleigh_is_the_one_of_configs_sleigh():
    """The same rates by q̇ with a multiplier, and in the sleigh's frame with the velocity across left out."""
    own, plain = (jaxnh.load(ROOT / f"configs/{name}.yaml").flow() for name in ("nonholonomic/sleigh", "sleigh"))
    x, y, theta, along, turn = np.random.default_rng(2).uniform(-2, 2, (5, 40))
    c, s, zero = np.cos(theta), np.sin(theta), np.zeros(40)

    @jax.jit
    @jax.vmap
    def rates(t, one, other):
        return own.rhs(t, one, {"drive": 2.0}), plain.rhs(t, other, {"drive": 2.0})

    states = (
        Motion((x, y, theta), (along, turn), (zero, zero)),
        Motion((x, y, theta), (along * c, along * s, turn), (zero, zero)),
    )
    one, other = rates(np.linspace(0, 6, 40), *states)
    faster = other.v[0] * c + other.v[1] * s  # along the blade; across it the velocity is zero
    exact = np.array([*other.q, faster, other.v[2]])
    assert np.abs(np.array([*one.q, *one.v]) - exact).max() < 1e-12


TENSOR = ((1.1, 0.15, -0.1), (0.15, 1.6, 0.05), (-0.1, 0.05, 1.9))
SURFACE = (1.0, 0.7, 0.5), (0.05, -0.1, 0.2)


def pebble(mass=1.4, gravity=0.9):
    """A rattleback of sizes near one."""
    return rolling_body(ellipsoid(*SURFACE), mass, TENSOR, gravity)


def energy(state, mass, gravity):
    """Of the pebble, written out: m |r × ω|²/2 + ω·J ω/2 + m g times the height −r·γ."""
    vertical, w = np.stack(state.q, axis=-1), np.stack(state.v, axis=-1)
    squares = np.square(SURFACE[0])
    r = np.array(SURFACE[1]) - squares * vertical / np.sqrt((squares * vertical**2).sum(-1, keepdims=True))
    turning = np.einsum("si,ij,sj->s", w, np.array(TENSOR), w)
    return 0.5 * (mass * (np.cross(r, w) ** 2).sum(-1) + turning) - mass * gravity * (r * vertical).sum(-1)


@pytest.mark.parametrize("units", some_slow({"20": 20, "1000": 1000}, "20"))
def test_energy_of_a_rolling_body(lanes, units):
    """It stays, and the vertical's length with it: order eight, steps of 1/64, a few 1e-15 a unit of time."""
    flow = lagrangian(pebble, {"mass": 1.4, "gravity": 0.9}, ("mass",))
    one = np.ones(3)
    start = Motion(
        (0 * one, 0.6 * one, 0.8 * one), (np.array([0.1, 1.0, -0.5]), 0.3 * one, 1.5 * one), (0 * one, 0 * one)
    )
    mass = np.array([1.0, 1.4, 2.0])
    strobe = make_return_map(flow, dopri8, 64)
    end = lanes(iterate, (strobe, np.int32(units)), (start, {"mass": mass}))
    assert np.abs(np.sum(np.square(end.q), axis=0) - 1).max() < 1e-14
    before, after = (energy(state, mass, 0.9) for state in (start, end))
    assert np.abs(after - before).max() < 1e-10
    assert np.abs(np.subtract(end.v, start.v)).max() > 0.1


LEVEL = """\
system: {{file: {file}}}
initial: {{g2: 0.6, g3: 0.8, w1: 0.3, w3: 1.5{more}}}
sweep: {{{sweep}}}
accuracy: {{solver: tsit5, steps: 20}}
analyses:
  portrait: {{}}
"""
PEBBLE = """\
from jaxnh.mechanics import ellipsoid, rolling_body

def system(mass=1.4, gravity=0.9):
    tensor = ((1.1, 0.15, -0.1), (0.15, 1.6, 0.05), (-0.1, 0.05, 1.9))
    return rolling_body(ellipsoid((1.0, 0.7, 0.5), (0.05, -0.1, 0.2)), mass, tensor, gravity)
"""


def pebbles(folder, sweep, more=""):
    (folder / "pebble.py").write_text(PEBBLE)
    return Experiment.from_text(LEVEL.format(file=folder / "pebble.py", sweep=sweep, more=more))


def test_start_on_a_level(tmp_path):
    """Velocities are scaled to an energy, given or swept, at each lane's own parameters; the direction stays."""
    made = pebbles(tmp_path, "energy: {values: [2.0, 5.0, 0.5]}")
    (axis,) = made.axes
    assert (axis.name, axis.kind, axis.dim) == ("energy", "lane", "energy")
    start = made.start({}, 3, own={"energy": axis.values})
    assert np.abs(energy(start, 1.4, 0.9)[:2] - axis.values[:2]).max() < 1e-12
    assert np.abs(start.v[2][:2] / start.v[0][:2] - 5.0).max() < 1e-13
    assert start.watch[1].tolist() == [0.0, 0.0, 2.0]  # at rest it has more than 0.5: off_constraint
    swept = pebbles(tmp_path, "gravity: {values: [0.5, 0.9]}", ", level: {energy: 3.0}")
    gravity = np.array([0.5, 0.9])
    start = swept.start({}, 2, own={"gravity": gravity})
    assert np.abs([energy(start, 1.4, g)[i] - 3.0 for i, g in enumerate(gravity)]).max() < 1e-12


@pytest.mark.parametrize(
    ("sweep", "more", "message"),
    [
        ("gravity: {values: [0.9]}", ", level: {energy: 0.5}", "initial.level.energy: no multiple of the start's"),
        (
            "gravity: {values: [0.9]}",
            ", level: {enrgy: 3.0}",
            "initial.level.enrgy: unknown key (did you mean energy?)",
        ),
        ("energy: {values: [3.0]}", ", level: {energy: 3.0}", "energy is swept; leave it out of initial.level"),
        ("energy: {values: [0.1, 0.2]}", "", "sweep.energy: no multiple of the start's velocities has energy = 0.1"),
    ],
)
def test_wrong_levels(tmp_path, sweep, more, message):
    with pytest.raises(ConfigError) as refused:
        pebbles(tmp_path, sweep, more)
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.slow  # starts on a level are quick
@pytest.mark.usefixtures("quick_compiling_once")
def test_steps_stay_on_a_level(lanes):
    """Long steps of low order leave it by 1e-3 and more, but for the projection; of it two steps of Newton leave rounding."""
    flow = on_level(lagrangian(pebble, {"mass": 1.4, "gravity": 0.9}, ("gravity",)), {"energy": 3.0}, ("energy",))
    assert (flow.roles.of_lanes, flow.exponents) == (("gravity", "energy"), 4)
    start = Motion((0.0, 0.6, 0.8), (0.1, 0.3, 1.5), (0.0, 0.0))
    levels, strobe = np.array([3.0, 5.0]), make_return_map(flow, tsit5, 4)
    (start, reached) = put_on_level(off_level(flow), jax.tree.map(lambda x: np.full(2, x), start), {}, "energy", levels)
    assert reached.all()
    end = lanes(iterate, (strobe, np.int32(20)), (start, {"gravity": np.full(2, 0.9), "energy": levels}))
    assert np.abs(energy(end, 1.4, 0.9) - levels).max() < 1e-13
    free = make_return_map(off_level(flow), tsit5, 4)
    end = lanes(iterate, (free, np.int32(20)), (start, {"gravity": np.full(2, 0.9), "energy": levels}))
    assert np.abs(energy(end, 1.4, 0.9) - levels).min() > 1e-4


@pytest.mark.slow
def test_exponents_of_a_rolling_body():
    """Their sum is the mean divergence; the energy and the flow give two that are zero."""
    session = jaxnh.Session(pebble, start={"g2": 0.6, "g3": 0.8, "w1": 0.3, "w3": 1.5}, target=1e-9)
    data = session.run(jaxnh.Lyapunov(periods=400, transient=20, exponents=5), mass=[1.0, 1.4])
    assert data.sizes["exponent"] == 5
    exponents, error = data["exponents"].to_numpy(), data["exponents_error"].to_numpy()
    assert np.abs(data["sum_rule_residual"].to_numpy()).max() < 1e-9
    near = np.sort(np.abs(exponents) - error, axis=-1)
    assert np.all(near[:, :2] <= 0.0)


def test_rattleback_is_a_config():
    """Ten lines: its names come from the function, its start is brought to a vertical of length one."""
    experiment = jaxnh.load(ROOT / "configs/nonholonomic/rattleback.yaml")
    assert experiment.coordinates == ("g1", "g2", "g3", "w1", "w2", "w3")
    start = experiment.start({"w3": np.array([-5.0, 5.0])}, 2)
    assert np.abs(np.sum(np.square(start.q), axis=0) - 1).max() < 1e-15
    assert jax.tree.leaves(start)[0].shape == (2,)


@pytest.mark.parametrize(("name", "most"), [("rattleback", 340), ("rubber_disk", 400)])
def test_equations_of_rolling_bodies(name, most):
    """Every program has them, and a user waits for the compiling of each: 356 and 579 with all entries of a matrix that
    is symmetric, exchanges of rows that it does not need, and moduli of its zeros."""
    assert time_split(jaxnh.load(ROOT / f"configs/nonholonomic/{name}.yaml").flow()).size <= most


def test_starts_have_one_program(monkeypatch):
    """Starts of all lanes, of samples and of one are brought to the constraints by one, which takes seconds to make."""
    traced, nearest = list[int](), Lagrangian.nearest
    monkeypatch.setattr(Lagrangian, "nearest", lambda *at: (traced.append(1), nearest(*at))[1])
    experiment = jaxnh.load(ROOT / "configs/nonholonomic/rubber_ball.yaml")
    values = experiment.axes[0].values
    starts = [experiment.start({}, count, own={"energy": values[:count]}) for count in (len(values), 5, 1)]
    assert len(traced) == 1
    for start in starts[1:]:
        for one, all_of_them in zip(jax.tree.leaves(start), jax.tree.leaves(starts[0]), strict=True):
            np.testing.assert_array_equal(one, all_of_them[: len(one)])
