"""Published numbers and statements on nonholonomic systems, and what runs say of the same.

Where an article gives a number or a law, that is what is compared; where it says what kind of motion there is, the kind.
docs/validation.md lists them, with the deviations.
"""

from __future__ import annotations

import numpy as np
import pytest

import jaxnh
from jaxnh.engine.experiment import Experiment
from tests.helpers.kept_programs import session_of
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.usefixtures("uncalibrated", "quick_compiling")

FOLDER = ROOT / "configs/nonholonomic"


def groups_of(config, text=None):
    """The groups that a config asks for, its system from a text if that is given."""
    made = Experiment.from_text(config, text) if text else Experiment.from_text(config)
    return session_of(made).groups(dict.fromkeys(made.analyses.options()))


def of_config(name, *changes):
    """The groups of a config of the gallery with changes."""
    made = jaxnh.load(FOLDER / f"{name}.yaml", list(changes))
    return session_of(made).groups(dict.fromkeys(made.analyses.options()))


def words(variable):
    return jaxnh.labels(variable).to_numpy().ravel().tolist()


ROLLING = """
import jax.numpy as jnp

def system(axle=0.5, upright=0.25, gravity=1.0):
    def T(q, v, t):  # of a thin disk of mass and radius one; x and y are the point of contact, tilt is off the upright
        x_dot, y_dot, psi_dot, tilt_dot, roll_dot = v
        s, c, spin = jnp.sin(q[3]), jnp.cos(q[3]), v[4] - v[2] * jnp.sin(q[3])
        e = jnp.cos(q[2]), jnp.sin(q[2])
        side = -e[1], e[0]
        x = x_dot + tilt_dot * c * side[0] - psi_dot * s * e[0]
        y = y_dot + tilt_dot * c * side[1] - psi_dot * s * e[1]
        turn = upright * (tilt_dot**2 + (psi_dot * c) ** 2) + axle * spin**2
        return 0.5 * (x**2 + y**2 + (tilt_dot * s) ** 2 + turn)

    def Q(q, v, t):
        return 0.0, 0.0, 0.0, gravity * jnp.sin(q[3]), 0.0

    def f(q, v, t):
        return v[0] - v[4] * jnp.cos(q[2]), v[1] - v[4] * jnp.sin(q[2])

    names = ("x", "y", "psi", "tilt", "roll")
    return {"T": T, "Q": Q, "f": f, "coordinates": names, "angles": ("psi", "roll")}
"""


@pytest.mark.slow
@pytest.mark.usefixtures("quick_programs")
@pytest.mark.parametrize(("axle", "upright", "critical"), [(0.5, 0.25, 1 / 3), (1.0, 0.5, 1 / 4)])
def test_a_disk_that_rolls_upright(axle, upright, critical):
    """It falls below the squared rates g/3r of a thin disk and g/4r of a hoop (Routh, Advanced Rigid Dynamics, 1905).

    In general λ² = (m g r A - C (C + m r²) Ω²) / (A (A + m r²)), of moments A about a diameter and C about the axle. Steps
    of order five, 100 a unit of time, leave 1e-10; an average over 32 units has its own bar. In 64 units, at rates up to
    0.45, rounding grows to no more than 1e-4 of a fall.
    """
    rates = np.sqrt(critical * np.array([0.75, 0.85, 0.95, 1.1]))
    started = (
        f"sweep: {{roll_dot: {{values: {(rates * (axle + 1.0) / axle).tolist()}}}}}\n"  # what is more goes to x_dot
    )
    config = f"system: {{file: disk.py, axle: {axle}, upright: {upright}}}\ninitial: {{project: true}}\n{started}"
    config += "accuracy: {solver: tsit5, steps: 100}\nanalyses: {lyapunov: {transient: 32, periods: 32, exponents: 1}}"
    data = groups_of(config, ROLLING)["lyapunov"]
    squared = (upright - axle * (axle + 1.0) * rates**2) / (upright * (upright + 1.0))
    ours, error = (data[name].to_numpy()[:, 0] for name in ("exponents", "exponents_error"))
    assert np.all(np.abs(ours - np.sqrt(np.maximum(squared, 0.0))) <= error + 1e-9)
    assert np.all((ours > error) == (squared > 0.0))


NORMAL_FORM = """
import jax.numpy as jnp

def system(f0=0.0, f1=0.0, f2=0.0):
    def rhs(y, t):
        v, u = y
        return f2 * u**2 + f1 * jnp.cos(t) * u + f0, -u * v + jnp.cos(t)

    return {"rhs": rhs, "coordinates": ("v", "u"), "period": 2 * jnp.pi}
"""


@pytest.mark.parametrize(("name", "power", "factor"), [("f0", 1, 1.0), ("f1", 2, 1.0), ("f2", 3, 1.5)])
def test_three_laws_of_nonholonomic_acceleration(name, power, factor):
    """v = t^(1/k) with k = 1, 2 or 3 (Bizyaev, Bolotin and Mamaev, Chaos 31 (2021) 013132, abstract).

    As u goes to cos t / v, v' has the mean f0, f1/2v or f2/2v²: v^k grows by `factor` times f a unit of time, but for what
    is smaller by 1/v² and the oscillation, which the strobes leave out.
    """
    config = f"system: {{file: form.py}}\ninitial: {{v: 2.0}}\nsweep: {{{name}: {{values: [1.0, 2.0]}}}}\n"
    config += "accuracy: {solver: dopri8, steps: 192}\nanalyses: {poincare: {transient: 0, strobes: 257}}"
    if power == 1:  # it is stiff as it grows
        config = config.replace("strobes: 257", "strobes: 9")
    v = groups_of(config, NORMAL_FORM)["poincare"]["v"].to_numpy()
    half, whole = v.shape[1] // 2, v.shape[1] - 1
    grown = (v[:, whole] ** power - v[:, half] ** power) / ((whole - half) * 2 * np.pi)
    assert np.abs(grown / (factor * np.array([1.0, 2.0])) - 1.0).max() < 3.0 / v[:, half].min() ** 2


def test_a_rotor_accelerates_a_sleigh_by_the_cube_root_of_time():
    """u grows as t^(1/3) for ever without friction (Bizyaev, Borisov, Kozlov and Mamaev, Nonlinearity 32 (2019) 3209, abstract).

    u³ grows by 3 <k'²> / (m² a), but for terms smaller by (J ω / m a u)², J about the blade.
    """
    k = np.array([0.5, 2.0])
    data = of_config(
        "sleigh_with_rotor",
        "accuracy={solver: verner9, steps: 56}",
        "analyses.portrait=null",
        "analyses.poincare={transient: 0, strobes: 257}",
    )["poincare"]
    u, mass, length, inertia = data["along"].to_numpy(), 1.0, 0.4, 0.5
    grown = (u[:, -1] ** 3 - u[:, 128] ** 3) / (128 * 2 * np.pi)
    law = 3.0 * 0.5 * k**2 / (mass**2 * length)
    left = ((inertia + mass * length**2) / (mass * length * u[:, 128])) ** 2
    assert np.all(np.abs(grown / law - 1.0) < left)
    assert left.max() < 0.05


def test_exponents_of_that_acceleration():
    """1/3 of the speed, -1/3 of the rate of turning, 2/3 of the energy, within bars that are small; by `transport`."""
    data = of_config(
        "sleigh_with_rotor",
        "accuracy={solver: verner9, steps: 56}",
        "analyses.portrait=null",
        "analyses.poincare=null",
        "analyses.transport={growth: [along, turn, kinetic_energy], periods: 512}",
    )["transport"]
    for name, power in (("along", 1 / 3), ("turn", -1 / 3), ("kinetic_energy", 2 / 3)):
        exponent, error = data[f"{name}_growth"].to_numpy(), data[f"{name}_growth_error"].to_numpy()
        assert np.all(np.abs(exponent - power) <= error)
        assert error.max() < 0.1
        assert words(data[f"{name}_kind"]) == 2 * ["decaying" if power < 0 else "growing"]


@pytest.mark.slow
def test_where_an_oscillating_mass_accelerates_a_sleigh():
    """By t^(1/3) without friction, or not at all, by the place of the mass before the blade and the centre of mass.

    Bizyaev, Borisov and Mamaev (Regul. Chaotic Dyn. 22 (2017) 955) and Bizyaev, Bolotin and Mamaev (2021), abstracts. At
    large u, with M = m a + μ ξ the moment about the blade, w goes to -μ ξ η''/(M u), and (m + μ) u' has the mean
    μ² ξ <η''²> (m a (ξ - a) - I) / (M u)², but for terms smaller by η² and (J/M u)².
    """
    common = ["accuracy={solver: verner9, steps: 90}", "system.damping=0.0", "system.turn_damping=0.0"]
    common += ["initial.along=2.0", "system.length=0.5", "sweep.amplitude={values: [0.3, 0.6]}"]
    common += ["analyses.diagram=null", "analyses.lyapunov=null", "analyses.transport={growth: [along], periods: 2048}"]
    ahead = of_config("oscillating_mass", *common, "system.ahead=2.0")["transport"]
    exponent, error = ahead["along_growth"].to_numpy(), ahead["along_growth_error"].to_numpy()
    assert np.all(np.abs(exponent - 1 / 3) <= error)
    assert error.max() < 0.1
    behind = of_config("oscillating_mass", *common, "system.ahead=0.5")["transport"]
    assert "growing" not in words(behind["along_kind"])


@pytest.mark.slow
def test_a_chaotic_sleigh_walks_at_random():
    """With friction the motion on a chaotic attractor is like a random walk on the plane (arXiv 1807.06340, abstract).

    Halves of the starts have the same diffusion coefficient within their bars.
    """
    common = ["accuracy={solver: verner9, steps: 60}", "sweep.amplitude={values: [1.0, 1.2]}"]
    common += ["analyses.diagram=null", "analyses.lyapunov=null"]
    box = "path: [x, y], transient: 128, periods: 1024, n_starts: 32, box: {along: [-0.5, 0.5], turn: [-0.5, 0.5]}"
    one, other = (
        of_config("oscillating_mass", *common, f"analyses.transport={{{box}, seed: {seed}}}")["transport"]
        for seed in (0, 1)
    )
    assert words(one["diffusion_kind"]) == words(other["diffusion_kind"]) == ["normal", "normal"]
    gap = np.abs(one["diffusion"] - other["diffusion"])
    assert np.all(gap <= one["diffusion_error"] + other["diffusion_error"])
    for name in ("x_drift", "y_drift"):
        assert np.all(np.abs(one[name]) <= one[f"{name}_error"])


def test_friction_ends_that_acceleration_on_a_limit_cycle():
    """The same article, abstract: trajectories of the reduced system tend to a limit cycle."""
    data = of_config(
        "sleigh_with_rotor",
        "accuracy={solver: verner9, steps: 56}",
        "sweep={damping: {values: [0.05, 0.2]}}",
        "system.turn_damping=0.1",
        "analyses.portrait=null",
        "analyses.poincare={transient: 512, strobes: 2}",
    )["poincare"]
    for name in ("along", "turn"):
        assert np.ptp(data[name].to_numpy(), axis=1).max() < 1e-10
    assert data["along"].to_numpy().min() > 0.5


SKATES = """
import jax.numpy as jnp

def system(push=0.8, swing=0.3, gauge=0.4, rolled=0.1):
    def rates(q, u, t):
        c, s = jnp.cos(q[2]), jnp.sin(q[2])
        return u[0] * c - u[1] * s, u[0] * s + u[1] * c, u[2]

    def T(q, u, t):  # of the platform, and of the inertia of wheels at the places of two skates
        left, right = u[0] - gauge * u[2], u[0] + gauge * u[2]
        platform = u[0] ** 2 + (u[1] + 0.5 * u[2]) ** 2 + 0.2 * u[2] ** 2
        return 0.5 * (platform + rolled * (left**2 + right**2))

    def Q(q, u, t):
        return -0.3 * u[0] - push, 0.0, -0.3 * u[2] + 2.0 * gauge * swing * jnp.sin(t)

    def f(q, u, t):
        return (u[1],)

    names = {"coordinates": ("x", "y", "theta"), "angles": ("theta",), "ignorable": ("x", "y")}
    quasi = {"rates": rates, "quasi_velocities": ("along", "across", "turn"), "dependent": ("across",)}
    return {"T": T, "Q": Q, "f": f, "period": 2 * jnp.pi, **quasi, **names}
"""


@pytest.mark.slow  # equations of a carriage on wheels are quick
def test_a_vehicle_moves_on_wheels_as_on_skates():
    """But for the angles of the wheels (Borisov, Kilin and Mamaev, Regul. Chaotic Dyn. 20 (2015) 752, abstract).

    The carriage of the gallery and one on skates, which knows no wheels, by the same steps: rounding, which chaos
    enlarges little in six periods.
    """
    sweep = "sweep={push: {values: [0.2, 0.6, 1.1]}}"
    asked = ["accuracy={solver: verner9, steps: 60}", "analyses.poincare={transient: 0, strobes: 7}"]
    asked += ["analyses.diagram=null", "analyses.lyapunov=null"]
    wheels = of_config("two_wheeled_carriage", sweep, *asked)["poincare"]
    config = "system: {file: skates.py}\ninitial: {along: -0.3, turn: 0.1}\nsweep: {push: {values: [0.2, 0.6, 1.1]}}\n"
    config += "accuracy: {solver: verner9, steps: 60}\nanalyses: {poincare: {transient: 0, strobes: 7}}"
    skates = groups_of(config, SKATES)["poincare"]
    for name in ("along", "turn", "x", "y"):
        if name in skates:
            assert np.abs(wheels[name].to_numpy() - skates[name].to_numpy()).max() < 1e-11
    assert np.ptp(skates["along"].to_numpy(), axis=1).min() > 0.05


RACER = """
import jax.numpy as jnp

def system(swing=0.5, damping=0.0, pivot=0.4, reach=1.0):
    def angle(t):
        return swing * jnp.sin(t), swing * jnp.cos(t)

    def rates(q, u, t):
        c, s = jnp.cos(q[2]), jnp.sin(q[2])
        return u[0] * c - u[1] * s, u[0] * s + u[1] * c, u[2]

    def front(u, t):
        (phi, phi_dot), side = angle(t), u[1] + pivot * u[2]
        c, s = jnp.cos(phi), jnp.sin(phi)
        return u[0] * c + side * s, -u[0] * s + side * c + reach * (u[2] + phi_dot)

    def T(q, u, t):
        forth, aside = front(u, t)
        rear = u[0] ** 2 + (u[1] + 0.2 * u[2]) ** 2 + 0.3 * u[2] ** 2
        return 0.5 * (rear + 0.6 * (forth**2 + aside**2) + 0.1 * (u[2] + angle(t)[1]) ** 2)

    def Q(q, u, t):
        c, s = jnp.cos(angle(t)[0]), jnp.sin(angle(t)[0])
        drag = -damping * front(u, t)[0]
        return -damping * u[0] + drag * c, drag * s, drag * pivot * s

    def f(q, u, t):
        return u[1], front(u, t)[1]

    names = {"coordinates": ("x", "y", "theta"), "angles": ("theta",), "ignorable": ("x", "y")}
    quasi = {"quasi_velocities": ("along", "across", "turn"), "dependent": ("across", "turn")}
    return {"T": T, "Q": Q, "f": f, "rates": rates, "period": 2 * jnp.pi, **quasi, **names}
"""


@pytest.mark.slow  # a snakeboard speeds up in a quick test, and `test_transport` has growth
def test_a_roller_racer_whose_angle_is_given_speeds_up_for_ever():
    """Bizyaev, Borisov and Mamaev (Regul. Chaotic Dyn. 23 (2018) 983), as commonly quoted.

    The speed obeys one linear equation with a period, whose mean growth is zero without friction: the velocity grows as t.
    With friction it is bounded; the pivots of its constraints are then decided by time alone, in a loop over stages.
    """
    start = "system: {file: racer.py}\ninitial: {along: 0.2}\naccuracy: {solver: verner9, steps: 60}\n"
    free = start + "sweep: {swing: {values: [0.8]}}\nanalyses: {transport: {growth: [along], periods: 512}}"
    data = groups_of(free, RACER)["transport"]
    assert np.all(np.abs(data["along_growth"] - 1.0) <= data["along_growth_error"])
    assert float(data["along_growth_error"].max()) < 0.1
    rubbed = start + "sweep: {damping: {values: [0.1]}}\nanalyses: {transport: {growth: [along], periods: 256}}"
    assert words(groups_of(rubbed, RACER)["transport"]["along_kind"]) == ["bounded"]


def test_kinds_of_motion_of_the_particle_at_constant_speed():
    """Periods 1, 2 and 4 and chaos at b = 5.8, 2.5, 4.1 and 5.3 (figure 1 of the article)."""
    config = "system: {constraint: constant_speed}\ninitial: {x1: 0.1, x2: 0.1, y1: 0.1}\naccuracy: {target: 1.0e-6}\n"
    config += "sweep: {b: {values: [5.8, 2.5, 4.1, 5.3]}}\nanalyses: {period: {max_period: 16, transient: 1024}}"
    assert groups_of(config)["period"]["period"].to_numpy().tolist() == [1, 2, 4, 0]


@pytest.mark.slow
def test_kinds_of_motion_of_the_disturbed_particle():
    """Periods 1, 2 and 4 and chaos at b = 5.9, 2.5, 4.2 and 5.6 (figure 6 of the article)."""
    config = "system: {constraint: disturbed_speed}\ninitial: {x1: 0.1, x2: 0.1, y1: 0.1}\naccuracy: {target: 1.0e-6}\n"
    config += "sweep: {b: {values: [5.9, 2.5, 4.2, 5.6]}}\nanalyses: {verdict: {}}"
    groups = groups_of(config)
    assert groups["period"]["period"].to_numpy().tolist() == [1, 2, 4, 0]
    assert words(groups["verdict"]["kind"]) == ["periodic"] * 3 + ["chaotic"]


ROTATORS = """
import jax.numpy as jnp

N = {count}

def system(scale=1.0):
    def T(q, v, t):
        return 0.5 * scale * sum(rate**2 for rate in v)

    def Q(q, v, t):
        return (0.0,) * N

    def f(q, v, t):
        return (sum(jnp.sin(angle) * rate for angle, rate in zip(q, v, strict=True)),)

    names = tuple(f"q{{k}}" for k in range(N))
    return {{"T": T, "Q": Q, "f": f, "coordinates": names, "angles": names}}
"""


def start_of_rotators(count):
    """A start of energy 1 whose cosines sum to zero, as a config has it."""
    cosines = {3: [0.6, -0.2, -0.4], 4: [0.6, -0.2, 0.3, -0.7], 5: [0.6, -0.2, 0.3, -0.5, -0.2]}[count]
    angles, rates = np.arccos(cosines), np.random.default_rng(5).standard_normal(count)
    sines = np.sin(angles)
    rates -= sines * (sines @ rates) / (sines @ sines)
    rates *= np.sqrt(2.0 / (rates @ rates))
    start = {f"q{k}": float(angles[k]) for k in range(count)} | {f"q{k}_dot": float(rates[k]) for k in range(count)}
    return ", ".join(f"{name}: {value!r}" for name, value in start.items())


@pytest.mark.slow
@pytest.mark.parametrize(("count", "strobes", "tangency"), [(3, 1024, "bounded"), (4, 4096, "tangent")])
def test_three_rotators_are_hyperbolic_and_four_are_not(count, strobes, tangency):
    """By the angles of those vectors that grow, of those that shrink, and of all others (Kuznetsov, arXiv 1810.08002, abstract).

    All but count - 2 at either end have exponents zero. A force that is zero makes a clock of one unit of time.
    """
    config = f"system: {{file: own.py}}\ninitial: {{{start_of_rotators(count)}, project: true}}\n"
    config += "sweep: {scale: {values: [1.0]}}\naccuracy: {target: 1.0e-8}\n"
    config += f"analyses: {{covariant: {{transient: 512, strobes: {strobes}}}}}"
    text = ROTATORS.format(count=count).replace("(0.0,) * N", "(0.0 * jnp.sin(2 * jnp.pi * t),) * N")
    data = groups_of(config, text.replace('"angles": names', '"angles": names, "period": 1.0'))["covariant"]
    splits, growing = jaxnh.labels(data["tangency"]).to_numpy()[0], count - 2
    assert [splits[growing - 1], splits[-growing]] == [tangency] * 2
    exponents, error = (data[name].to_numpy()[0] for name in ("exponents", "exponents_error"))
    assert np.all(exponents[:growing] - error[:growing] > 0.2)
    assert np.all(np.abs(exponents[growing:-growing]) < 0.01)
    assert np.all(np.abs(exponents + exponents[::-1]) <= error + error[::-1])


@pytest.mark.slow
def test_as_many_positive_exponents_of_rotators_as_published():
    """Three of 5 rotators whose cosines sum to zero (Kuznetsov, arXiv 1810.08002, abstract).

    One of 3 and two of 4, as published too, are those of `test_three_rotators_are_hyperbolic_and_four_are_not`.
    """
    config = f"system: {{file: own.py}}\ninitial: {{{start_of_rotators(5)}, project: true}}\nsweep: {{scale: {{values: [1.0]}}}}\n"
    config += "accuracy: {target: 1.0e-8}\nanalyses: {lyapunov: {transient: 64, periods: 2048, exponents: 5}}"
    data = groups_of(config, ROTATORS.format(count=5))["lyapunov"]
    ours, error = (data[name].to_numpy()[0] for name in ("exponents", "exponents_error"))
    positive = ours - error > 0.05
    assert positive.sum() == 3
    assert np.abs(ours[~positive]).max() < 0.01


@pytest.mark.slow
def test_suslov_s_top_and_the_sleigh_in_a_valley_between_conservative_and_dissipative():
    """Conservative motion at low energies, strange attractors at higher ones.

    Bizyaev, Borisov and Kazakov (2015) of the top, Kuznetsov (arXiv 1909.01130) of the sleigh, abstracts.
    """
    spectrum = "analyses.lyapunov={exponents: 3, periods: 4096}"
    common = ("analyses.diagram=null", "analyses.verdict={confirmation_factor: 1}", "accuracy.target=1.0e-9", spectrum)
    top = of_config("suslov", "sweep.energy={values: [-0.7, 0.2]}", *common)["verdict"]
    assert words(top["phase_volume"]) == ["conservative", "dissipative"]
    sleigh = of_config("sleigh_in_a_valley", "sweep.energy={values: [1.0, 4.0]}", *common)["verdict"]
    assert words(sleigh["phase_volume"]) == ["dissipative", "dissipative"]
    assert words(sleigh["kind"]) == ["chaotic", "chaotic"]


@pytest.mark.slow
def test_a_rubber_disk_is_chaotic_and_yet_as_if_conservative():
    """Mixed dynamics that is extremely difficult to tell from conservative (Gonchenko, Gonchenko and Kazakov 2020, abstract).

    The equations that `test_nonholonomic` holds the file against, by RK4 with steps of 0.005 and a shadow over 60,000 units
    from this start, have the largest exponent 0.030 ± 0.004 and the mean divergence -0.00008 ± 0.00010 at the energy 1.54,
    and 0.0001 ± 0.0002 and -0.00004 ± 0.00007 at 1.8.
    """
    data = of_config(
        "rubber_disk",
        "section=null",
        "sweep.energy={values: [1.54, 1.8]}",
        "accuracy={solver: verner9, steps: 24}",
        "analyses={lyapunov: {transient: 128, periods: 4096, exponents: 3}}",
    )["lyapunov"]
    (chaotic, torus), (error, of_torus) = (data[name].to_numpy() for name in ("exponents", "exponents_error"))
    total, bar = (data[name].to_numpy() for name in ("exponent_sum", "exponent_sum_error"))
    assert chaotic[0] - error[0] > 0.0
    assert abs(chaotic[0] - 0.030) <= error[0] + 0.004
    assert torus[0] - of_torus[0] <= 0.0002
    assert np.all(np.abs(total) <= bar + 0.0001)
    assert bar.max() < 0.1 * chaotic[0]


@pytest.mark.slow
def test_a_rattleback_turns_back_in_both_senses_sooner_in_one():
    """Without friction it reverses from either (Garcia and Hubbard, Proc. R. Soc. Lond. A 418 (1988) 165), and soon
    from one alone (Kane and Levinson 1982; Kondo and Nakanishi, arXiv 1704.06717, abstract).
    """
    portrait = of_config(
        "rattleback",
        "accuracy={solver: verner9, steps: 1600}",
        "analyses.lyapunov=null",
        "analyses.portrait={transient: 0, periods: 20, samples: 4}",
    )["portrait"]
    spin, t = portrait["w3"].to_numpy(), portrait["t"].to_numpy()
    turned = [t[np.argmax(np.sign(path) != np.sign(path[0]))] for path in spin]
    assert 0.0 < turned[0] < 5.0 < turned[1] < 20.0


@pytest.mark.slow  # its equations and a vehicle that moves are quick
def test_a_sleigh_with_friction_is_driven_one_way_by_small_oscillations_and_chaotically_by_large_ones():
    """Bizyaev, Borisov and Kuznetsov (arXiv 1807.06340), abstract: the speed of the first is stabilised by friction."""
    groups = of_config(
        "oscillating_mass",
        "accuracy={solver: verner9, steps: 60}",
        "initial.along=0.05",
        "sweep.amplitude={values: [0.2, 1.2]}",
    )
    along = groups["diagram"]["along"].to_numpy()
    assert np.ptp(along[0]) < 1e-3 * abs(along[0].mean())
    assert abs(along[0].mean()) > 0.1
    exponent, error = (groups["lyapunov"][name].to_numpy()[:, 0] for name in ("exponents", "exponents_error"))
    assert abs(exponent[0]) < 1e-3
    assert exponent[1] - error[1] > 0.05
