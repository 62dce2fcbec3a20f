"""The systems of `configs/nonholonomic` against reduced equations written anew, and the exact statements on their motion.

No parameter here is that of the config: all are drawn at random, so that a term that vanishes there does not here.
"""

from __future__ import annotations

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxnh
from jaxnh.config.yaml_source import read
from jaxnh.maps.build import make_return_map
from jaxnh.solvers import dopri8
from jaxnh.solvers.adaptive import in_loop
from jaxnh.systems.lagrangian import Motion
from jaxnh.systems.user_file import UserFile
from tests.helpers.cases import some_slow
from tests.helpers.commands import run_here
from tests.helpers.kept_programs import session_of
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.usefixtures("uncalibrated", "quick_compiling")
FOLDER = ROOT / "configs/nonholonomic"
STATES = 40
EXACT = 1e-12  # of accelerations near ten, from some hundred products
ELSEWHERE = {
    "rattleback", "celtic_stone", "celtic_chart", "discrete_lorenz", "sleigh", "nose_hoover", "switched_sleigh",
}  # fmt: skip


def numbers(seed, k):
    return np.random.default_rng(seed).uniform(-1.5, 1.5, (k, STATES))


# ---- reduced equations: states on the constraint, and the rates of all coordinates, then of all velocities there


def oscillating_mass(t, p):
    """Momenta along and about the blade, and the one across it that the blade balances: Ṗ = w R, K̇ = -u R."""
    x, y, theta, u, w = numbers(1, 5)
    m, a, inner, xi, omega = p["mass"], p["length"], p["inner"], p["ahead"], p["omega"]
    eta = p["amplitude"] * np.sin(omega * t)
    eta_dot, eta_ddot = p["amplitude"] * omega * np.cos(omega * t), -(omega**2) * eta
    across = m * a * w + inner * (xi * w + eta_dot)
    # P = (m + inner) u - inner eta w,  K = (I + m a² + inner (eta² + xi²)) w - inner eta u + inner xi eta_dot
    matrix = np.empty((STATES, 2, 2))
    matrix[:, 0, 0] = m + inner
    matrix[:, 0, 1] = matrix[:, 1, 0] = -inner * eta
    matrix[:, 1, 1] = p["inertia"] + m * a**2 + inner * (eta**2 + xi**2)
    along = w * across + inner * eta_dot * w - p["damping"] * u
    about = -u * across - inner * (2 * eta * eta_dot * w - eta_dot * u + xi * eta_ddot) - p["turn_damping"] * w
    rates = np.linalg.solve(matrix, np.stack([along, about], axis=-1)[..., None])[..., 0].T
    return (x, y, theta), (u, w), (u * np.cos(theta), u * np.sin(theta), w, *rates)


def sleigh_in_a_valley(t, p):
    x, y, theta, u, w = numbers(2, 5)
    m, a, c, s = p["mass"], p["length"], np.cos(theta), np.sin(theta)
    force = -p["stiffness"] * (x + a * c)
    turn = (-m * a * u * w - a * force * s) / (p["inertia"] + m * a**2)
    return (x, y, theta), (u, w), (u * c, u * s, w, a * w**2 + force * c / m, turn)


def suslov(t, p):
    """Euler's equations and Poisson's, the moment of the constraint on the third axis alone."""
    g1, g2, g3, w1, w2 = numbers(3, 5)
    g1, g2, g3 = np.array([g1, g2, g3]) / np.sqrt(g1**2 + g2**2 + g3**2)
    third = p["i13"] * w1 + p["i23"] * w2
    first = (-w2 * third + g2 * p["b3"] - g3 * p["b2"]) / p["i1"]
    second = (w1 * third + g3 * p["b1"] - g1 * p["b3"]) / p["i2"]
    return (g1, g2, g3), (w1, w2), (-g3 * w2, g3 * w1, g1 * w2 - g2 * w1, first, second)


def appell_hamel(t, p):
    """A speed s and a heading: (1 + 1/r²) s' = F·e ± F_z/r, s θ' = F·n, where z' = ± s/r."""
    x, y, z, theta, s = numbers(4, 5)
    s, up, r = 1.0 + 0.3 * s, np.where(z > 0, 1.0, -1.0), p["ratio"]
    c, d = np.cos(theta), np.sin(theta)
    vx, vy, vz = s * c, s * d, up * s / r
    fx = -p["lattice"] * np.sin(x) - p["damping"] * vx + p["drive"] * np.sin(p["omega"] * t)
    fy, fz = -p["skew"] * np.sin(y) - p["damping"] * vy, -p["gravity"] - p["damping"] * vz
    faster, turn = (fx * c + fy * d + up * fz / r) / (1 + 1 / r**2), fy * c - fx * d
    return (x, y, z), (vx, vy, vz), (vx, vy, vz, faster * c - turn * d, faster * d + turn * c, up * faster / r)


def parallel_velocities(t, p):
    """Two speeds and one heading: m s' = F·e of each point, (Σ m s²) θ' = Σ s F·n."""
    q, (theta, s1, s2) = numbers(5, 4), numbers(6, 3)
    s1 = np.copysign(0.5 + np.abs(s1), s1)
    e, n = np.array([np.cos(theta), np.sin(theta)]), np.array([-np.sin(theta), np.cos(theta)])

    def energy(q):  # the potential's, of whatever numbers
        squares = p["k1"] * (q[0] ** 2 + q[2] ** 2) + p["k2"] * (q[1] ** 2 + q[3] ** 2)
        apart = p["coupling"] * ((q[0] - q[2]) ** 2 + (q[1] - q[3]) ** 2)
        return 0.5 * (squares + apart + p["cubic"] * ((q[0] * q[1]) ** 2 + (q[2] * q[3]) ** 2))

    force = -gradient(energy, q)
    m1, m2 = p["m1"], p["m2"]
    along, side = ([(f * axis).sum(0) for f in (force[:2], force[2:])] for axis in (e, n))
    turn = (s1 * side[0] + s2 * side[1]) / (m1 * s1**2 + m2 * s2**2)
    v = *(s1 * e), *(s2 * e)
    return tuple(q), v, (*v, *(along[0] / m1 * e + s1 * turn * n), *(along[1] / m2 * e + s2 * turn * n))


def thermostat(t, p):
    """Gauss's equations: v' = F - (F·v / v·v) v."""
    q, v = numbers(7, 4), numbers(8, 4)
    v *= np.sqrt(2 * p["kinetic"] / (v**2).sum(0))

    def energy(q):  # products of cosines as sums
        x, y, z, w = q
        pair = p["lattice"] * (np.cos(x + y) + np.cos(x - y) + np.cos(z + w) + np.cos(z - w))
        pull = p["coupling"] * (np.cos(x - z + y - w) + np.cos(x - z - y + w))
        return 0.5 * pair - 0.5 * pull - p["slope"] * (x - z / 2)

    force = -gradient(energy, q)
    return tuple(q), tuple(v), (*v, *(force - (force * v).sum(0) / (v**2).sum(0) * v))


def speed_in_space(t, p):
    """A velocity s n with n' = (F - (F·n) n)/s; the friction drops out."""
    q, n = numbers(9, 3), numbers(10, 3)
    n /= np.sqrt((n**2).sum(0))
    g, (x, y, z), a, b = 1 + np.sin(p["omega"] * t), q, p["a"], p["b"]
    force = np.array([b * y - a * g * x - g * x**3, b * x - g * y - a * g * y**3, -a * g * z - g * z**3])
    force[2] -= p["tie"] * y**2 * z
    v = np.sqrt(p["c"]) * n
    return tuple(q), tuple(v), (*v, *(force - (force * n).sum(0) * n))


def sleigh_with_rotor(t, p):
    """Newton along the blade; the momentum of the turning about the blade, with that of the rotor: K̇ = -m a u w."""
    x, y, theta, u, w = numbers(12, 5)
    m, a = p["mass"], p["length"]
    kicked = p["momentum"] * p["omega"] * np.cos(p["omega"] * t)
    turn = (-m * a * u * w - kicked - p["turn_damping"] * w) / (p["inertia"] + m * a**2)
    along = a * w**2 - p["damping"] * u / m
    return (x, y, theta), (u, w), (u * np.cos(theta), u * np.sin(theta), w, along, turn)


def roller_racer(t, p):
    """Newton and Euler for both platforms, with the reactions of the wheels and of the pivot, seen from the rear one."""
    x, y, theta, phi, u, s = numbers(13, 6)
    a, b, c, m, n = p["pivot"], p["reach"], p["ahead"], p["mass"], p["front_mass"]
    ca, sa, one, zero = np.cos(phi), np.sin(phi), np.ones(STATES), np.zeros(STATES)
    long, slope = a * ca + b, (u * (ca * (a * ca + b) + a * sa**2) - s * a * b * sa) / (a * ca + b) ** 2
    w, w_u, w_s, w_rest = (u * sa - b * s) / long, sa / long, -b / long, slope * s
    e, across = np.array([ca, sa]), np.array([-sa, ca])  # of the front platform

    def at(reach):  # accelerations of a point ahead of the rear axle: by u', by s', and what is left, (3, 2, STATES)
        return np.array([[one, reach * w_u], [zero, reach * w_s], [-reach * w**2, u * w + reach * w_rest]])

    rear, pivot = at(c), at(a)
    front = pivot + b * np.array([w_u * across, (w_s + 1.0) * across, w_rest * across - (w + s) ** 2 * e])
    speed = u * ca + a * w * sa
    joint = p["torque"] * np.sin(p["omega"] * t) - p["stiffness"] * phi - p["joint_damping"] * s
    drag_rear, drag_front = -p["damping"] * u, -p["damping"] * speed * e
    # unknown: u', s', side force of the rear wheels, both of the pivot on the rear platform, side force in front
    rows = [
        ((m * rear[0, 0], m * rear[1, 0], zero, -one, zero, zero), drag_rear - m * rear[2, 0]),
        ((m * rear[0, 1], m * rear[1, 1], -one, zero, -one, zero), -m * rear[2, 1]),
        ((p["inertia"] * w_u, p["inertia"] * w_s, c * one, zero, (c - a) * one, zero), -joint - p["inertia"] * w_rest),
        ((n * front[0, 0], n * front[1, 0], zero, one, zero, -across[0]), drag_front[0] - n * front[2, 0]),
        ((n * front[0, 1], n * front[1, 1], zero, zero, one, -across[1]), drag_front[1] - n * front[2, 1]),
        (
            (p["front_inertia"] * w_u, p["front_inertia"] * (w_s + 1.0), zero, b * sa, -b * ca, zero),
            joint - p["front_inertia"] * w_rest,
        ),
    ]
    matrix = np.moveaxis(np.array([row for row, _ in rows]), -1, 0)
    right = np.array([value for _, value in rows]).T[..., None]
    faster, steered = np.linalg.solve(matrix, right)[:, :2, 0].T
    moved = u * np.cos(theta), u * np.sin(theta), w, s
    return (x, y, theta, phi), (u, s), (*moved, faster, steered)


def rotators(t, p):
    """v' = λ M⁻¹ sin q with Σ cos q v² + sin q v' = 0, from velocities on Σ sin q v = 0."""
    q, v = numbers(14, 4), numbers(15, 4)
    sines, mass = np.sin(q), np.array([p["inertia"], 1.0, 1.0, 1.0])[:, None]
    v -= sines * (sines * v).sum(0) / (sines**2).sum(0)
    push = -(np.cos(q) * v**2).sum(0) / (sines**2 / mass).sum(0)
    return tuple(q), tuple(v), (*v, *(push * sines / mass))


def chaplygin_top(t, p):
    """Borisov and Mamaev's form: M' = M × w + m r' × (w × r) + m g r × γ with M = I w + m r × (w × r), r to the contact."""
    gamma, w = numbers(17, 3), numbers(18, 3)
    gamma /= np.sqrt((gamma**2).sum(0))
    inertia, m = np.array([p["i1"], p["i2"], p["i3"]]), p["mass"]
    aside, along = p["offset"] * np.sin(p["tilt"]), p["offset"] * np.cos(p["tilt"])
    turned = np.cross(gamma, w, axis=0)  # the rate of the vertical
    r = np.array([[0.6 * aside], [0.8 * aside], [along]]) - p["radius"] * gamma
    moved, pull = -p["radius"] * turned, np.cross(w, r, axis=0)
    momentum = inertia[:, None] * w + m * np.cross(r, pull, axis=0)
    right = np.cross(momentum, w, axis=0) + m * np.cross(moved, pull, axis=0)
    right += m * p["gravity"] * np.cross(r, gamma, axis=0)
    right -= m * (np.cross(moved, pull, axis=0) + np.cross(r, np.cross(w, moved, axis=0), axis=0))
    tensor = m * ((r**2).sum(0) * np.eye(3)[:, :, None] - r[:, None] * r[None]) + np.diag(inertia)[:, :, None]
    rates = np.linalg.solve(np.moveaxis(tensor, -1, 0), right.T[..., None])[..., 0].T
    return tuple(gamma), tuple(w), (*turned, *rates)


def rolls_without_spinning(gamma, w, r, moved, p):
    """A body under a moment λ γ that keeps w·γ = 0, with the velocity V = -w × r of its centre of mass.

    Its point of contact r is seen from there, and `moved` is ṙ.
    """
    inertia, m = np.diag([p["i1"], p["i2"], p["i3"]]), p["mass"]
    turned, pull = np.cross(gamma, w, axis=0), np.cross(w, r, axis=0)
    momentum = inertia @ w + m * np.cross(r, pull, axis=0)
    right = np.cross(momentum, w, axis=0) + m * p["gravity"] * np.cross(r, gamma, axis=0)
    right -= m * np.cross(r, np.cross(w, moved, axis=0), axis=0)
    tensor = m * ((r**2).sum(0) * np.eye(3)[:, :, None] - r[:, None] * r[None]) + inertia[:, :, None]
    solved = np.linalg.solve(np.moveaxis(tensor, -1, 0), np.stack([right.T, gamma.T], axis=-1))
    free, by_moment = solved[..., 0].T, solved[..., 1].T
    rates = free - (free * gamma).sum(0) / (by_moment * gamma).sum(0) * by_moment
    centre = -np.cross(rates, r, axis=0) - np.cross(w, moved, axis=0)
    return tuple(gamma), (*w, *-pull), (*turned, *rates, *centre)


def rubber_start(seed):
    """Verticals, and angular velocities across them."""
    gamma, w = numbers(seed, 3), numbers(seed + 1, 3)
    gamma /= np.sqrt((gamma**2).sum(0))
    return gamma, w - (w * gamma).sum(0) * gamma


def rubber_ball(t, p):
    gamma, w = rubber_start(19)
    aside, along = p["offset"] * np.sin(p["tilt"]), p["offset"] * np.cos(p["tilt"])
    r = np.array([[0.6 * aside], [0.8 * aside], [along]]) - p["radius"] * gamma
    return rolls_without_spinning(gamma, w, r, -p["radius"] * np.cross(gamma, w, axis=0), p)


def rubber_disk(t, p):
    """It touches the plane with the point of its rim that is lowest, along e = (γ1, γ2, 0) of length one."""
    gamma, w = rubber_start(27)
    steep = np.hypot(gamma[0], gamma[1])
    e, across = gamma[:2] / steep, np.array([-gamma[1], gamma[0]]) / steep
    swept = (across * np.cross(gamma, w, axis=0)[:2]).sum(0) / steep  # the rate of e's angle
    flat = np.zeros((1, STATES))
    r = np.array([[p["c1"]], [p["c2"]], [p["c3"]]]) - p["radius"] * np.concatenate([e, flat])
    return rolls_without_spinning(gamma, w, r, -p["radius"] * swept * np.concatenate([across, flat]), p)


def snakeboard(t, p):
    """Along the only way it can go, w = u tan φ / b: of the forces, and of the rates of both momenta, times their shares."""
    x, y, theta, u = numbers(21, 4)
    m, b, omega = p["mass"], p["half"], p["omega"]
    phi, phi_dot = p["steering"] * np.sin(omega * t + p["lag"]), p["steering"] * omega * np.cos(omega * t + p["lag"])
    slope, slope_dot = np.tan(phi) / b, phi_dot / np.cos(phi) ** 2 / b
    spun, inertia = -p["swing"] * omega**2 * np.sin(omega * t), p["inertia"] + 2 * p["wheels"] + p["rotor"]
    drag = p["damping"] * u * (1 + (b * slope) ** 2)
    push = -drag - slope * (inertia * u * slope_dot + p["rotor"] * spun)
    faster, w = push / (m + inertia * slope**2), u * slope
    return (x, y, theta), (u,), (u * np.cos(theta), u * np.sin(theta), w, faster)


def two_wheeled_carriage(t, p):
    """Chaplygin's sleigh with the inertia of the wheels: as masses J/r² along the axle's normal, at their places."""
    x, y, theta, left, right, u, w = numbers(22, 7)
    m, a, h, r = p["mass"], p["ahead"], p["gauge"], p["radius"]
    rolled = 2 * p["wheel"] / r**2
    along = m * a * w**2 - p["damping"] * u - p["push"]
    about = -m * a * u * w - p["turn_damping"] * w + 2 * h * p["swing"] * np.sin(p["omega"] * t)
    rates = along / (m + rolled), about / (p["inertia"] + m * a**2 + rolled * h**2)
    wheels = (u - h * w) / r, (u + h * w) / r
    return (x, y, theta, left, right), (u, w), (u * np.cos(theta), u * np.sin(theta), w, *wheels, *rates)


def pursuit(t, p):
    """A velocity s e at the bearing from the line of sight, which turns at its own rate θ': v' = s θ' n."""
    q, target = numbers(23, 4), numbers(24, 2)
    line = q[2:] - q[:2]
    heading = np.arctan2(line[1], line[0]) + p["bearing"]
    e, n = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
    v = p["speed"] * e
    turn = (line[0] * (target - v)[1] - line[1] * (target - v)[0]) / (line**2).sum(0)
    forced = p["push"] * np.array([np.cos(p["omega"] * t), np.sin(p["omega"] * t)]) - p["stiffness"] * q[2:]
    return tuple(q), (*v, *target), (*v, *target, *(p["speed"] * turn * n), *forced)


def two_particles(t, p):
    """A velocity √c n of each with n' = (F - (F·n) n)/√c; the friction drops out."""
    q, n = numbers(25, 4).reshape(2, 2, STATES), numbers(26, 4).reshape(2, 2, STATES)
    n /= np.sqrt((n**2).sum(1))[:, None]
    g, (x, y), a, b = 1 + np.sin(p["omega"] * t), np.moveaxis(q, 1, 0), p["a"], p["b"]
    force = np.stack([b * y - a * g * x - g * x**3, b * x - g * y - a * g * y**3], axis=1)
    force += p["coupling"] * (q[::-1] - q)
    v, rates = np.sqrt(p["c"]) * n, force - (force * n).sum(1)[:, None] * n
    return tuple(q.reshape(4, -1)), tuple(v.reshape(4, -1)), (*v.reshape(4, -1), *rates.reshape(4, -1))


SYSTEMS = {
    system.__name__: system
    for system in (
        oscillating_mass, sleigh_in_a_valley, suslov, appell_hamel, parallel_velocities, thermostat, speed_in_space,
        sleigh_with_rotor, roller_racer, rotators, chaplygin_top, rubber_ball, rubber_disk, snakeboard, two_wheeled_carriage,
        pursuit, two_particles,
    )
}  # fmt: skip


def gradient(energy, q):
    """By complex steps of 1e-40, exact to rounding; q (n, STATES)."""
    steps = 1e-40j * np.eye(len(q))[:, :, None]
    return np.stack([energy(q + step).imag / 1e-40 for step in steps])


def test_every_system_is_tested():
    assert {path.stem for path in FOLDER.glob("*.yaml")} == {*SYSTEMS} | ELSEWHERE


@pytest.mark.parametrize(
    "name", some_slow({name: name for name in SYSTEMS}, *sorted({*SYSTEMS} - {"rubber_ball", "rubber_disk"}))
)
def test_reduced_equations(name):
    """Rates of the file at random states and times, its parameters changed by up to a third."""
    file = UserFile(FOLDER / f"{name}.py")
    drawn = np.random.default_rng(11).uniform(0.7, 1.3, len(file.parameters))
    values = {key: float(value * by) or 0.3 for (key, value), by in zip(file.parameters.items(), drawn, strict=True)}
    t, zero = np.linspace(0.0, 7.0, STATES), np.zeros(STATES)
    q, v, exact = SYSTEMS[name](t, values)
    flow = jaxnh.load(FOLDER / f"{name}.yaml").flow()
    flow = getattr(flow, "flow", flow)  # without its section
    lanes = {key: zero + value for key, value in values.items()}
    rates = jax.jit(jax.vmap(flow.rhs))(t, Motion(q, v, (zero, zero)), lanes)
    assert not np.isnan(rates.watch[1]).any()
    assert np.abs(np.array([*rates.q, *rates.v]) - np.array(exact)).max() < EXACT


@pytest.mark.slow
def test_a_script_loads_a_config_before_it_starts_a_session():
    """In single precision the start on a level of the disk was not a number."""
    with jax.enable_x64(False):
        assert jaxnh.load(FOLDER / "rubber_disk.yaml").axes[0].name == "energy"


def test_equations_of_nose_and_hoover():
    """At random states and temperatures, to rounding."""
    q, p, friction, temperature = numbers(16, 4)
    flow = jaxnh.load(FOLDER / "nose_hoover.yaml").flow()
    states = jax.vmap(lambda *y: flow.chart.state(y))(q, p, friction)
    rates = jax.vmap(lambda y, value: flow.rhs(0.0, y, {"temperature": value}))(states, temperature)
    exact = np.array([p, -q - friction * p, p**2 - temperature])
    assert np.abs(np.array(jax.tree.leaves(rates))[:3] - exact).max() < EXACT


@pytest.mark.slow  # its equations are quick
def test_a_snakeboard_speeds_up_by_its_drive_gait():
    """Without friction √M u, M = m + J tan²φ/b², grows at the mean rate of its forcing, steadily; by `transport` as t.

    The mean over a period is that of 512 evenly spaced times, exact to rounding for a smooth periodic function.
    """
    made = jaxnh.load(
        FOLDER / "snakeboard.yaml",
        ["system.damping=0.0", "sweep.lag={values: [0.3, -0.8]}", "accuracy={solver: verner9, steps: 60}"],
    )
    session = session_of(made)
    u = session.run(jaxnh.Poincare(transient=0, strobes=65))["along"].to_numpy()
    data = session.run(jaxnh.Transport(growth=("along",), periods=256))
    t = 2 * np.pi * np.arange(512) / 512
    for lane, lag in enumerate((0.3, -0.8)):
        slope = np.tan(0.6 * np.sin(t + lag)) / 0.5
        root = np.sqrt(1.0 + (0.3 + 2 * 0.05 + 0.2) * slope**2)
        rate = np.mean(slope / root * 0.2 * np.sin(t))
        assert abs((u[lane, -1] - u[lane, 0]) * root[0] - rate * 64 * 2 * np.pi) < 1e-9
        assert abs(data["along_growth"][lane] - 1.0) <= data["along_growth_error"][lane]


def test_a_pursuit_of_bouguer():
    """A target that leaves the line of sight at a right angle, k times as fast, is pursued along Bouguer's curve.

    With the target on the axis x = 0 and the pursuer from x = 1, y = (x^(1+k)/(1+k) - x^(1-k)/(1-k))/2 + k/(1 - k²), and
    the tangent meets the axis at the target. Steps of order nine leave rounding.
    """
    start = "{x: 1.0, y: 0.0, X: 0.0, Y: 0.0, x_dot: -0.5, y_dot: 0.0}"
    made = jaxnh.load(
        FOLDER / "pursuit.yaml",
        [
            f"initial={start}",
            *("system.stiffness=0.0", "system.push=0.0", "system.bearing=0.0", "system.omega=16.0"),
            "sweep={speed: {values: [0.5]}, Y_dot: {values: [0.3, 0.8]}}",
            "accuracy={solver: verner9, steps: 32}",
        ],
    )
    data = session_of(made).run(jaxnh.Poincare(transient=0, strobes=5))
    x, y, target = (data[name].to_numpy()[0] for name in ("x", "y", "Y"))
    k = np.array([[0.6], [1.6]])
    slope = 0.5 * (x**k - x**-k)
    assert np.abs(y - 0.5 * (x ** (1 + k) / (1 + k) - x ** (1 - k) / (1 - k)) - k / (1 - k**2)).max() < 1e-12
    assert np.abs(target - (y - x * slope)).max() < 1e-12
    assert x.max() - x.min() > 0.3


@pytest.mark.slow
@pytest.mark.usefixtures("quick_programs")
def test_exponents_of_a_pursuit():
    """Those of its target are zero; the pursuer's sum to the mean of -s cos(bearing) / distance, the flow's divergence.

    That mean is taken by DOP853 with the target in closed form, over 200 periods after 20, within a few over that time.
    """
    bearings, speed = (0.0, 0.9), 0.6
    sweep = f"sweep={{bearing: {{values: {list(bearings)}}}}}"
    made = jaxnh.load(FOLDER / "pursuit.yaml", [sweep, "accuracy={solver: verner9, steps: 100}"])
    data = session_of(made).run(jaxnh.Lyapunov(transient=64, periods=128, exponents=6))
    ours, error = data["exponents"].to_numpy(), data["exponents_error"].to_numpy()
    own = np.sqrt(2.618)
    forced = 2.427 / (2.618 - 1.0)
    for lane, bearing in enumerate(bearings):

        def rhs(t, z, bearing=bearing):
            free = (1.9 - forced) * np.cos(own * t) + 1j * (2.147 - forced) / own * np.sin(own * t)
            line = forced * np.exp(1j * t) + free - (z[0] + 1j * z[1])
            v = speed * np.exp(1j * bearing) * line / abs(line)
            return v.real, v.imag, -speed * np.cos(bearing) / abs(line)

        times = 2 * np.pi * np.array([20.0, 220.0])
        path = solve_ivp(rhs, (0.0, times[1]), (0.0, 0.0, 0.0), "DOP853", times, rtol=1e-9, atol=1e-9)
        mean = np.diff(path.y[2])[0] / np.diff(times)[0]
        assert np.all(np.abs(ours[lane, :4]) <= error[lane, :4] + 1e-3)
        assert abs(ours[lane, 4:].sum() - mean) <= error[lane, 4:].sum() + 2 / np.diff(times)[0]


@pytest.mark.slow
def test_two_coupled_particles_are_hyperchaotic():
    """Exactly two exponents are positive; without the spring both are that of one particle, by its own kicks."""
    made = jaxnh.load(FOLDER / "two_particles.yaml", ["sweep={coupling: {values: [0.0, 0.04]}}"])
    data = session_of(made).run(jaxnh.Lyapunov(transient=128, periods=1024, exponents=6))
    ours, error = data["exponents"].to_numpy(), data["exponents_error"].to_numpy()
    assert np.all(ours[:, :2] - error[:, :2] > 0.0)
    assert np.all(ours[:, 2:] + error[:, 2:] < 0.0)
    one = jaxnh.Session(jaxnh.constant_speed(b=5.3), target=1e-6).run(
        jaxnh.Lyapunov(transient=128, periods=4096, exponents=1)
    )
    alone, bar = (float(one[name].squeeze()) for name in ("exponents", "exponents_error"))
    assert np.all(np.abs(ours[0, :2] - alone) <= error[0, :2] + bar)


def three_feet(state, p):
    """(along, across, turn) a period after the strobe, which is half an interval after a foot has come down.

    The edge makes a sleigh of Chaplygin's whose centre of mass is `ahead` of it: with the velocity s of the centre along
    the edge and the rate w of turning, s' = a w², w' = -(m a / J) s w with J = I + m a², so that at the energy E
    s = √(2E/m) tanh(k t + c), w = √(2E/J) / cosh(k t + c), k = a √(2E m)/ J.
    """
    u, v, w = state
    m, feet = p["mass"], p["ahead"] + p["radius"] * np.exp(2j * np.pi * (np.arange(5) - 2) / 3)
    foot = 0.0  # the first edge is at the centre of mass, along its velocity
    for number, share in ((None, 0.5), (2, 1.0), (3, 1.0), (4, 0.5)):
        if number is not None:
            foot = feet[number]
        edge = np.exp(1j * np.angle(u + 1j * v + 1j * w * foot))
        ahead = -(foot * edge.conjugate()).real if number is not None else 0.0
        s, J = (u * edge.real + v * edge.imag), p["inertia"] + m * ahead**2
        energy = 0.5 * (m * s**2 + J * w**2)
        k = ahead * np.sqrt(2 * energy * m) / J
        phase = np.arctanh(s / np.sqrt(2 * energy / m)) + k * share * p["interval"]
        s, w = np.sqrt(2 * energy / m) * np.tanh(phase), np.copysign(np.sqrt(2 * energy / J), w) / np.cosh(phase)
        u, v = (s * edge.real - w * ahead * edge.imag), (s * edge.imag + w * ahead * edge.real)
    return u, v, w


def test_three_feet():
    """A period of the sleigh whose constraint jumps from foot to foot, in closed form; and its energy."""
    p = {"mass": 1.3, "inertia": 0.9, "radius": 0.8, "ahead": 0.2, "interval": 1.1}
    flow = UserFile(FOLDER / "switched_sleigh.py").flow(p)
    names = dict.fromkeys((*flow.coordinates,), 0.0)
    states = [(1.0, 0.0, 0.5), (0.6, 0.0, -1.2), (0.2, 0.0, 0.9)]
    starts = [flow.start({**names, "along": u, "across": v, "turn": w}) for u, v, w in states]
    strobe = make_return_map(flow, in_loop(dopri8), 30)
    together = jax.tree.map(lambda *leaves: np.stack(leaves), *starts)
    after = jax.jit(jax.vmap(lambda y: strobe(y, {})))(together)
    ours = np.stack([np.asarray(x) for x in after.y[-3:]], axis=-1)
    assert ours == pytest.approx(np.array([three_feet(state, p) for state in states]), abs=1e-11)
    assert np.abs(np.asarray(after.watch[1])).max() < 1e-14


# ---- their motion

SMALL = {
    "diagram": "{transient: 4, strobes: 8}",
    "lyapunov": "{transient: 8, periods: 16, exponents: 1}",
    "portrait": "{transient: 0, periods: 4, samples: 4}",
}


STEPS = {"rattleback": 1600, "celtic_stone": 400, "celtic_chart": 400, "discrete_lorenz": 400}
"""A unit of time: a stone that rattles fast needs some 1,460 at 1e-9, one of larger sizes 240, the others below 100."""


def small_run(name, folder):
    """The result of a config at the ends of its sweep, few periods of it, by steps that are given."""
    config = read(FOLDER / f"{name}.yaml").data
    axes = {key: axis.get("values") or [axis["start"], axis["stop"]] for key, axis in config["sweep"].items()}
    ends = [f"sweep.{key}={{values: [{values[0]}, {values[-1]}]}}" for key, values in axes.items()]
    analyses = [f"analyses.{name}={SMALL[name]}" for name, options in config["analyses"].items() if options is not None]
    output = folder / f"{name}.h5"
    done = run_here(
        f"configs/nonholonomic/{name}.yaml",
        *ends,
        f"accuracy={{solver: verner9, steps: {STEPS.get(name, 100)}}}",
        *analyses,
        "--output",
        output,
    )
    assert done.returncode == 0, done.stderr
    return jaxnh.open_result(output)


def energy_in_a_valley(data):
    """On x = 0, with the parameters of the file."""
    along, turn, theta = data["along"], data["turn"], data["theta"]
    return 0.5 * (along**2 + (0.5 * turn) ** 2 + 0.2 * turn**2) + 0.5 * (0.5 * np.cos(theta)) ** 2


def energy_of_suslov(data):
    return 0.5 * (2.0 * data["w1"] ** 2 + 3.0 * data["w2"] ** 2) + data["g3"]


def energy_of_parallel_velocities(data):
    x, y, z, w = (data[name] for name in ("x1", "y1", "x2", "y2"))
    u, v, r, s = (data[f"{name}_dot"] for name in ("x1", "y1", "x2", "y2"))
    springs = x**2 + z**2 + 1.7 * (y**2 + w**2) + (x * y) ** 2 + (z * w) ** 2 + 0.5 * ((x - z) ** 2 + (y - w) ** 2)
    return 0.5 * (u**2 + v**2) + r**2 + s**2 + 0.5 * springs


def energy_on_three_feet(data):
    return 0.5 * (data["along"] ** 2 + data["across"] ** 2 + 1.4 * data["turn"] ** 2)


ENERGIES = {
    "switched_sleigh": energy_on_three_feet,
    "sleigh_in_a_valley": energy_in_a_valley,
    "suslov": energy_of_suslov,
    "parallel_velocities": energy_of_parallel_velocities,
}


@pytest.mark.slow
@pytest.mark.usefixtures("quick_programs")
@pytest.mark.parametrize("name", sorted({*SYSTEMS} | ELSEWHERE))
def test_config_in_small(name, tmp_path):
    """No lane fails, none leaves its constraint by more than steps of order nine do, and energies stay."""
    for group, node in small_run(name, tmp_path).children.items():
        data = node.to_dataset()
        assert np.all(data["status"] == 0), (name, group)
        if "drift" in data:
            assert float(data["drift"].max()) < 1e-8
        if group in ("diagram", "portrait") and name in ENERGIES:
            energy, level = ENERGIES[name](data), data["start_energy" if name == "switched_sleigh" else "energy"]
            assert float(np.abs(energy - level).max()) < 1e-8


@pytest.mark.slow
def test_exponents_of_the_thermostat_are_paired():
    """But for the flow's own, they come in three pairs of one sum (Dettmann and Morriss 1996), a third of all.

    The singular values of a tangent map are paired exactly over any time T; QR of it gives them up to factors that do
    not grow, exponents to a few over T.
    """
    duration = 400
    session = jaxnh.Session(jaxnh.load(FOLDER / "thermostat.yaml"))
    data = session.run(
        jaxnh.Lyapunov(transient=50, periods=duration, exponents=7, method="averages"), slope=[0.5, 0.75]
    )
    assert np.abs(data["sum_rule_residual"].to_numpy()).max() < 1e-9
    for exponents in data["exponents"].to_numpy():
        others = np.delete(exponents, np.argmin(np.abs(exponents)))
        sums = others + others[::-1]
        assert sums.mean() < -0.05  # the field does work, which the thermostat takes out
        assert np.abs(sums - sums.mean()).max() < 10 / duration


@pytest.mark.slow
def test_sum_rule_on_a_level():
    """Of all exponents on the level, and on a nonlinear constraint: the mean divergence, but for steps of order nine.

    What the gradients of the energy and of the constraint change by over this time is in it.
    """
    made = jaxnh.load(
        FOLDER / "parallel_velocities.yaml",
        ["sweep={energy: {values: [6.0]}}", "section=null", "accuracy={solver: verner9, steps: 200}"],
    )
    options = jaxnh.Lyapunov(transient=8, periods=32, exponents=made.flow().exponents, method="averages")
    data = session_of(made).run(options)
    assert np.abs(data["sum_rule_residual"].to_numpy()).max() < 1e-9
