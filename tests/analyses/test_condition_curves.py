"""Curves of cycles that keep a condition, against closed forms: amplitude, mean, duration, grazing, and their ends."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipk

import jaxnh
from jaxnh.analyses.continuation.curve_tables import CURVE_KINDS
from jaxnh.exceptions import ConfigError
from jaxnh.orbits.continuation.paths import BEYOND, ENDS, RANGE
from tests.helpers import contract
from tests.helpers.kept_programs import session_of

pytestmark = pytest.mark.usefixtures("quick_compiling")

HOPF = """
import jax.numpy as jnp


def system(mu=0.5, nu=1.0):
    def rhs(state, t):
        x, y = state
        growth = mu - nu * (x * x + y * y)
        return growth * x - 2.0 * y, growth * y + 2.0 * x

    def height(state, t):
        return 0.6 * state[0] + 0.8 * state[1]

    def power(state, t):
        return jnp.exp(state[0])

    def across(state, t):
        return 0.25 - state[0] ** 2

    observables = {"height": height, "power": power, "across": across}
    return {"rhs": rhs, "coordinates": ("x", "y"), "observables": observables}
"""

PUMPED_DUFFING = """
def system(energy=0.5, alpha=1.0):
    def rhs(state, t):
        x, v = state
        own = v * v / 2 + x * x / 2 + alpha * x**4 / 4
        return v, -x - alpha * x**3 + 0.5 * (energy - own) * v

    return {"rhs": rhs, "coordinates": ("x", "v")}
"""

WALL = 'lambda y, t: y[0] - 1.0, "then": lambda y, t: (y[0], -0.8 * y[1])'
IMPACT = """
import jax.numpy as jnp


def system(force=0.3, zeta=0.1, omega=0.8):
    def rhs(y, t, side=None):
        x, v = y
        return v, force * jnp.cos(omega * t) - 2 * zeta * v - x

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / omega, EVENTS}
"""
OSCILLATOR = IMPACT.replace(", EVENTS", "")
DUFFING = OSCILLATOR.replace("- x", "- x - x**3")
UP = "section: {coordinate: y, value: 0.0, direction: up}\n"
HOPF_SWEEP = "mu: {start: 0.3, stop: 0.7, count: 3}, nu: {start: 0.8, stop: 1.2, count: 2}"
IMPACT_SWEEP = "force: {start: 0.2, stop: 0.8, count: 3}, zeta: {start: 0.05, stop: 0.3, count: 2}"


def curves_of(folder, text, initial, sweep, options, section="", max_period=1):
    """A session that asks for `curves` of a system in a file."""
    (folder / "flow.py").write_text(text)
    (folder / "flow.yaml").write_text(
        f"system: {{file: flow.py}}\ninitial: {initial}\nsweep: {{{sweep}}}\n{section}accuracy: {{target: 1.0e-6}}\n"
        f"analyses: {{curves: {{max_period: {max_period}, transient: 32, bifurcations: false, {options}}}}}\n"
    )
    return session_of(jaxnh.load(folder / "flow.yaml"))


def data_of(session):
    tree = session.tree()
    data = tree["curves"].to_dataset()
    contract.check("curves", data, ("mu", "nu", "energy", "alpha", "force", "zeta", "omega", "tilt", "t", "duration"))
    jaxnh.figure(tree)
    return data


def points_of(data, k, *names):
    """Both parameters of a curve, and their errors."""
    known = np.isfinite(data[names[0]].values[k])
    return *(data[name].values[k][known] for name in names), *(data[f"{name}_error"].values[k][known] for name in names)


def kinds_of(data):
    return [CURVE_KINDS[kind] for kind in data["kind"].values]


@pytest.mark.slow  # `test_bars_of_curves` has both kinds
def test_amplitudes_of_hopfs_normal_form(tmp_path):
    """The radius is √(μ/ν), which any function of length one has as its largest value: straight lines μ = c² ν."""
    options = "n_values: 1, ds_max: 0.2, maximum: {height: 0.7}, minimum: {y: -0.75}"
    data = data_of(curves_of(tmp_path, HOPF, "{x: 0.5}", HOPF_SWEEP, options, UP))
    assert kinds_of(data) == ["maximum", "minimum"]
    assert data["condition"].values.tolist() == ["maximum of height = 0.7", "minimum of y = -0.75"]
    assert data["begins"].values.tolist() == data["ends"].values.tolist() == [RANGE, RANGE]
    for k, level in enumerate((0.7, 0.75)):
        mu, nu, mu_error, nu_error = points_of(data, k, "mu", "nu")
        assert np.all(np.abs(mu - level**2 * nu) <= mu_error + level**2 * nu_error)
        assert max(mu_error.max(), nu_error.max()) < 1e-8
        assert (nu.min(), nu.max()) == pytest.approx((0.8, 1.2))
    multipliers = data["multipliers"].values[0, : len(points_of(data, 0, "mu")[0]), 0, 0]
    mu = points_of(data, 0, "mu")[0]
    assert multipliers == pytest.approx(np.exp(-2 * mu * np.pi), abs=1e-6)
    assert np.nanmax(np.abs(data["duration"].values - np.pi)) < 1e-9
    assert "warnings" not in data.attrs


@pytest.mark.slow  # the bars of such curves are quick
def test_amplitude_of_an_observable(tmp_path):
    """exp(x) is between exp(−r) and exp(r) along the circle of radius r = √(μ/ν): its amplitude is 2 sinh r."""
    data = data_of(
        curves_of(tmp_path, HOPF, "{x: 0.5}", HOPF_SWEEP, "n_values: 1, ds_max: 0.2, amplitude: {power: 1.5}", UP)
    )
    assert kinds_of(data) == ["amplitude"]
    assert data["condition"].values.tolist() == ["amplitude of power = 1.5"]
    mu, nu, mu_error, nu_error = points_of(data, 0, "mu", "nu")
    square = np.arcsinh(0.75) ** 2
    assert np.all(np.abs(mu - square * nu) <= mu_error + square * nu_error)
    assert max(mu_error.max(), nu_error.max()) < 1e-8
    assert (nu.min(), nu.max()) == pytest.approx((0.8, 1.2))


@pytest.mark.slow  # the bars of such curves are quick
def test_exponents_equal_to_zero_and_their_sum(tmp_path):
    """Of z′ = (1/4 − x²)z along the circle x² + y² = μ/ν the exponent is 1/4 − μ/(2ν); that of the circle is −2μ."""
    options = "n_values: 1, ds_max: 0.2, mean: {across: 0.0}, exponent_sum: -1.0"
    data = data_of(curves_of(tmp_path, HOPF, "{x: 0.5}", HOPF_SWEEP, options, UP))
    assert kinds_of(data) == ["mean", "exponent_sum"]
    assert data["condition"].values.tolist() == ["mean of across = 0", "exponent_sum = -1"]
    mu, nu, mu_error, nu_error = points_of(data, 0, "mu", "nu")
    assert np.all(np.abs(mu - 0.5 * nu) <= mu_error + 0.5 * nu_error)
    assert max(mu_error.max(), nu_error.max()) < 1e-8
    assert (nu.min(), nu.max()) == pytest.approx((0.8, 1.2))
    mu, nu, mu_error, nu_error = points_of(data, 1, "mu", "nu")
    assert np.all(np.abs(mu - 0.5) <= mu_error)
    assert mu_error.max() < 1e-8
    assert (nu.min(), nu.max()) == pytest.approx((0.8, 1.2))


@pytest.mark.slow
def test_mean_power_and_exponents_over_the_drives_frequency(tmp_path):
    """Of the linear oscillator, whose period is swept: v² has the mean (ωF)²/2((1 − ω²)² + 4ζ²ω²), and −2ζ is the sum."""
    text = OSCILLATOR.replace("}\n", ', "observables": {"square": lambda y, t: y[1] ** 2}}\n')
    sweep = "zeta: {start: 0.05, stop: 0.3, count: 3}, omega: {start: 0.7, stop: 1.3, count: 2}"
    options = "n_values: 2, ds_max: 0.1, mean: {square: 0.06}, exponent_sum: -0.3"
    data = data_of(curves_of(tmp_path, text, "{x: 0.1}", sweep, options))
    assert {*kinds_of(data)} == {"mean", "exponent_sum"}
    for k, kind in enumerate(kinds_of(data)):
        zeta, omega, zeta_error, omega_error = points_of(data, k, "zeta", "omega")
        assert max(zeta_error.max(), omega_error.max()) < 1e-8
        if kind == "exponent_sum":
            assert np.all(np.abs(zeta - 0.15) <= zeta_error)
            assert (omega.min(), omega.max()) == pytest.approx((0.7, 1.3))
            continue

        def gap(zeta, omega):
            return 0.045 * omega**2 - 0.06 * ((1 - omega**2) ** 2 + 4 * zeta**2 * omega**2)

        slopes = [np.abs(gap(zeta + a, omega + b) - gap(zeta - a, omega - b)) / 2e-6 for a, b in ((1e-6, 0), (0, 1e-6))]
        assert np.all(np.abs(gap(zeta, omega)) <= slopes[0] * zeta_error + slopes[1] * omega_error + 1e-15)


VAN_DER_POL = """
import jax.numpy as jnp


def system(force=0.6, mu=0.1):
    def rhs(y, t):
        x, v = y
        return v, mu * (1 - x * x) * v - x + force * jnp.cos(0.8 * t)

    observables = {"square": lambda y, t: y[0] ** 2}
    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / 0.8, "observables": observables}
"""


def square_of_van_der_pol(force, mu):
    """The mean of x² along the cycle of x″ − μ(1 − x²)x′ + x = F cos 0.8t, by heyoka.

    Newton begins with the first harmonic where the mean is 1, X = F/(1 − ω² − iμω(1 − |X|²/4)).
    """
    heyoka = pytest.importorskip("heyoka")
    strobe = pytest.importorskip("tests.helpers.heyoka_newton").strobe_map

    def rates(x, v, _, force, mu, t):
        return v, mu * (1 - x * x) * v - x + force * heyoka.cos(0.8 * t), x * x

    image = strobe(rates, 3, 2 * np.pi / 0.8, parameters=2)
    harmonic = force / (0.36 - 0.4j * mu)
    point = np.array([harmonic.real, -0.8 * harmonic.imag, 0.0])
    for _ in range(8):
        after, slopes = (np.asarray(part, float) for part in image(np.array([force, mu]), point))
        step = np.linalg.solve(np.eye(2) - slopes[:2, :2], (after - point)[:2])
        point[:2] += step
    assert np.abs(step).max() < 1e-13
    return after[2] * 0.8 / (2 * np.pi)


@pytest.mark.slow
def test_a_driven_cycle_that_keeps_volumes(tmp_path):
    """The divergence of van der Pol's field is μ(1 − x²): its mean is zero where that of x² is one, by heyoka."""
    sweep = "force: {start: 0.4, stop: 0.9, count: 5}, mu: {start: 0.1, stop: 0.3, count: 2}"
    options = "n_values: 2, ds_max: 0.1, mean: {square: 1.3}, exponent_sum: 0.0"
    data = data_of(curves_of(tmp_path, VAN_DER_POL, "{x: 1.5}", sweep, options))
    assert sorted(kinds_of(data)) == ["exponent_sum", "mean"]
    for k, kind in enumerate(kinds_of(data)):
        force, mu, *errors = points_of(data, k, "force", "mu")
        assert (mu.min(), mu.max()) == pytest.approx((0.1, 0.3))
        assert max(error.max() for error in errors) < 1e-8
        pairs = list(zip(force, mu, *errors, strict=True))
        covered = 0
        for one, other, *bars in pairs:
            shift = 1e-5
            slopes = [
                abs(square_of_van_der_pol(one + a, other + b) - square_of_van_der_pol(one - a, other - b)) / (2 * shift)
                for a, b in ((shift, 0.0), (0.0, shift))
            ]
            off = abs(square_of_van_der_pol(one, other) - (1.3 if kind == "mean" else 1.0))
            covered += off <= slopes[0] * bars[0] + slopes[1] * bars[1] + 1e-15
        assert covered >= 0.95 * len(pairs)


# ---- bars over many set-ups


class Condition(NamedTuple):
    """A condition at levels in a range, and a function of level and both parameters that is zero on its curve."""

    levels: tuple[float, float]
    options: Callable[[float], dict[str, Any]]
    exact: Callable[..., np.ndarray]


class SetUp(NamedTuple):
    """Curves whose closed form is known: a flow, both parameters, and conditions, which one run follows together."""

    flow: tuple[str, str, str, str]
    names: tuple[str, str]
    conditions: dict[str, Condition]


def duration_of_duffing(energy, alpha):
    square = (np.sqrt(1 + 4 * alpha * energy) - 1) / alpha
    return 4 / np.sqrt(1 + alpha * square) * ellipk(alpha * square / (2 + 2 * alpha * square))


ENERGY_SWEEP = "energy: {start: 0.2, stop: 2.0, count: 3}, alpha: {start: 0.2, stop: 2.0, count: 3}"
SET_UPS = {
    "hopf": SetUp(
        (HOPF, "{x: 0.5}", HOPF_SWEEP, UP),
        ("mu", "nu"),
        {
            "maximum": Condition(
                (0.65, 0.9),
                lambda level: {"maximum": {"height": level}},
                lambda level, mu, nu: mu - level**2 * nu,
            ),
            "amplitude": Condition(
                (1.4, 2.0),
                lambda level: {"amplitude": {"power": level}},
                lambda level, mu, nu: mu - np.arcsinh(0.5 * level) ** 2 * nu,
            ),
            "mean": Condition(
                (-0.05, 0.0),
                lambda level: {"mean": {"across": level}},
                lambda level, mu, nu: mu - 2.0 * (0.25 - level) * nu,
            ),
            "exponent_sum": Condition(
                (-1.2, -0.8),
                lambda level: {"exponent_sum": level},
                lambda level, mu, nu: mu + 0.5 * level + 0.0 * nu,
            ),
        },
    ),
    "duffing": SetUp(
        (PUMPED_DUFFING, "{x: 0.5, v: 0.5}", ENERGY_SWEEP, UP.replace("coordinate: y", "coordinate: x")),
        ("energy", "alpha"),
        {
            "duration": Condition(
                (5.25, 6.0),
                lambda level: {"duration": level},
                lambda level, energy, alpha: duration_of_duffing(energy, alpha) - level,
            )
        },
    ),
    "clock": SetUp(
        (OSCILLATOR, "{x: 0.1}", IMPACT_SWEEP, ""),
        ("force", "zeta"),
        {
            "maximum": Condition(
                (0.6, 1.2),
                lambda level: {"maximum": {"v": level}},
                lambda level, force, zeta: 0.8 * force - level * np.hypot(1 - 0.64, 1.6 * zeta),
            )
        },
    ),
}


def shares_covered(name, folder, count, kinds=None):
    """Of each condition the share of points of curves at so many levels that are on the closed form within both bars.

    Slopes of the function that is zero on a curve say how far from it the bars of both parameters reach.
    """
    (text, initial, sweep, section), names, conditions = SET_UPS[name]
    conditions = {kind: conditions[kind] for kind in kinds or conditions}
    session = curves_of(folder, text, initial, sweep, "duration: 9.0" if section else "maximum: {x: 9.0}", section)
    covered = {kind: list[bool]() for kind in conditions}
    for step in np.linspace(0.0, 1.0, count):
        levels = {kind: low + step * (high - low) for kind, ((low, high), _, _) in conditions.items()}
        asked = {key: value for kind, each in conditions.items() for key, value in each.options(levels[kind]).items()}
        options = jaxnh.Curves(max_period=1, transient=32, bifurcations=False, n_values=1, ds_max=0.1, **asked)
        data = session.run(options)
        assert sorted(kinds_of(data)) == sorted(conditions)
        for k, kind in enumerate(kinds_of(data)):
            exact, level = conditions[kind].exact, levels[kind]
            one, other, *errors = points_of(data, k, *names)
            slopes = [
                np.abs(exact(level, one + a, other + b) - exact(level, one - a, other - b)) / 2e-6
                for a, b in ((1e-6, 0.0), (0.0, 1e-6))
            ]
            off = np.abs(exact(level, one, other))
            covered[kind] += (off <= slopes[0] * errors[0] + slopes[1] * errors[1]).tolist()
            assert max(error.max() for error in errors) < 1e-7
    return [np.mean(each) for each in covered.values()]


def test_bars_of_curves(tmp_path):
    assert min(shares_covered("hopf", tmp_path, 2, ["maximum", "amplitude"])) >= 0.95


@pytest.mark.slow
@pytest.mark.parametrize("name", SET_UPS)
def test_bars_of_many_curves(tmp_path, name):
    """Of ten curves of each condition, sixty in all."""
    assert min(shares_covered(name, tmp_path, 10)) >= 0.95


@pytest.mark.slow
def test_backbone_of_duffings_oscillator(tmp_path):
    """Cycles at the energy E of x″ + x + αx³ = 0, which a pump there leaves as they are, take 4K(m)/√(1 + αA²).

    A is the amplitude, m = αA²/(2 + 2αA²) (Kovacic and Brennan, The Duffing Equation, 2011).
    """
    section = UP.replace("coordinate: y", "coordinate: x")
    options = "n_values: 2, ds_max: 0.1, duration: 5.0"
    data = data_of(curves_of(tmp_path, PUMPED_DUFFING, "{x: 0.5, v: 0.5}", ENERGY_SWEEP, options, section))
    assert kinds_of(data) == ["duration"]
    energy, alpha, energy_error, alpha_error = points_of(data, 0, "energy", "alpha")

    shift = 1e-6
    slopes = [
        np.abs(duration_of_duffing(energy + de, alpha + da) - duration_of_duffing(energy - de, alpha - da))
        / (2 * shift)
        for de, da in ((shift, 0.0), (0.0, shift))
    ]
    gap = np.abs(duration_of_duffing(energy, alpha) - 5.0)
    assert np.all(gap <= slopes[0] * energy_error + slopes[1] * alpha_error + 1e-14)
    assert max(energy_error.max(), alpha_error.max()) < 1e-8
    assert np.ptp(alpha) > 1.0
    assert np.nanmax(np.abs(data["duration"].values - 5.0)) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["jump", "switch"])  # a wall below is the second one of the next test
def test_grazing_of_the_impact_oscillator(tmp_path, kind):
    """Before it touches, x″ + 2ζx′ + x = F cos ωt has the amplitude F/√((1 − ω²)² + 4ζ²ω²): that of the wall, here 1."""
    events = {
        "jump": f'"jumps": [{{"when": {WALL}}}]',
        "switch": '"switches": [{"on": lambda y, t: y[0] - 1.0}]',
    }[kind]
    text = IMPACT.replace("EVENTS", events)
    data = data_of(curves_of(tmp_path, text, "{x: 0.1}", IMPACT_SWEEP, "n_values: 2, ds_max: 0.1, grazing: true"))
    assert kinds_of(data) == ["grazing"]
    assert data["condition"].values[0].startswith("grazing of ")
    holds_for_the_oscillator(data)


def holds_for_the_oscillator(data):
    force, zeta, force_error, zeta_error = points_of(data, 0, "force", "zeta")
    exact = np.hypot(1 - 0.64, 1.6 * zeta)
    assert np.all(np.abs(force - exact) <= force_error + 1.6 * zeta_error)
    assert max(force_error.max(), zeta_error.max()) < 1e-8
    assert (zeta.min(), zeta.max()) == pytest.approx((0.05, 0.3))


@pytest.mark.slow
def test_grazing_with_a_second_wall(tmp_path):
    """The wall at −0.9 is met before that at 1: the first one grazed is the only curve, and is 0.9 times the other."""
    second = '{"when": lambda y, t: y[0] + 0.9, "direction": "down", "then": lambda y, t: (y[0], -y[1])}'
    text = IMPACT.replace("EVENTS", f'"jumps": [{{"when": {WALL}}}, {second}]')
    data = data_of(curves_of(tmp_path, text, "{x: 0.1}", IMPACT_SWEEP, "n_values: 1, ds_max: 0.2, grazing: true"))
    assert data["condition"].values.tolist() == ["grazing of jumps[1]"]
    force, zeta, force_error, zeta_error = points_of(data, 0, "force", "zeta")
    exact = 0.9 * np.hypot(1 - 0.64, 1.6 * zeta)
    assert np.all(np.abs(force - exact) <= force_error + 1.6 * zeta_error)


@pytest.mark.slow
def test_resonance_curves_over_the_drives_frequency(tmp_path):
    """Of the linear oscillator over ω, which its period depends on: F/√((1 − ω²)² + 4ζ²ω²) of the displacement.

    ω times that of the velocity, whose amplitude, here between its extrema, is twice its maximum.
    """
    sweep = "omega: {start: 0.5, stop: 1.5, count: 2}, force: {start: 0.1, stop: 1.2, count: 3}"
    text = OSCILLATOR.replace("zeta=0.1", "zeta=0.15")
    options = "n_values: 3, ds_max: 0.1, maximum: {v: 0.7}, amplitude: {v: 1.4, x: 1.0}"
    data = data_of(curves_of(tmp_path, text, "{x: 0.1}", sweep, options))
    said = data["condition"].values.tolist()
    assert {*said} == {"maximum of v = 0.7", "amplitude of v = 1.4", "amplitude of x = 1"}
    assert "duration" not in data
    for k, condition in enumerate(said):
        omega, force, omega_error, force_error = points_of(data, k, "omega", "force")
        of_velocity = " v " in condition

        def exact(omega, of_velocity=of_velocity):
            return (0.7 / omega if of_velocity else 0.5) * np.hypot(1 - omega**2, 0.3 * omega)

        slope = np.abs(exact(omega + 1e-6) - exact(omega - 1e-6)) / 2e-6
        assert np.all(np.abs(force - exact(omega)) <= force_error + slope * omega_error + 1e-14)
        assert max(omega_error.max(), force_error.max()) < 1e-8
        if of_velocity:
            assert (omega.min(), omega.max()) == pytest.approx((0.5, 1.5))


@pytest.mark.slow
def test_largest_displacement_of_duffings_oscillator(tmp_path):
    """Points of a curve against DOP853 over sixty periods, which leaves 1e-11 and finds the extremum by v = 0."""
    sweep = "force: {start: 0.2, stop: 0.8, count: 3}, zeta: {start: 0.15, stop: 0.3, count: 2}"
    data = data_of(curves_of(tmp_path, DUFFING, "{x: 0.1}", sweep, "n_values: 2, ds_max: 0.1, maximum: {x: 0.6}"))
    force, zeta, force_error, zeta_error = points_of(data, 0, "force", "zeta")
    for k in (0, len(force) // 2, len(force) - 1):

        def rates(t, y, k=k):
            return [y[1], force[k] * np.cos(0.8 * t) - 2 * zeta[k] * y[1] - y[0] - y[0] ** 3]

        def turns(t, y):
            return y[1]

        turns.direction = -1
        span = (0.0, 60 * 2 * np.pi / 0.8)
        path = solve_ivp(rates, span, [0.6, 0.0], "DOP853", rtol=1e-12, atol=1e-13, events=turns)
        last = path.t_events[0] > span[1] - 2 * np.pi / 0.8
        assert abs(path.y_events[0][last, 0].max() - 0.6) < 1e-9
    assert max(force_error.max(), zeta_error.max()) < 1e-8


TWO_PEAKS = """
def system(mu=0.5, tilt=0.0):
    def rhs(state, t):
        x, y = state
        growth = 1.0 - x * x - y * y
        return growth * x - 2.0 * y, growth * y + 2.0 * x

    def height(state, t):
        x, y = state
        return mu * (x * x - y * y) / (x * x + y * y) + tilt * x

    return {"rhs": rhs, "coordinates": ("x", "y"), "observables": {"height": height}}
"""


@pytest.mark.slow
def test_a_curve_ends_where_another_part_goes_beyond_the_level(tmp_path):
    """μ cos 2φ + tilt cos φ along r = 1 is largest at φ = 0 with tilt above zero: μ + tilt; below it is at φ = π."""
    sweep = "mu: {start: 0.2, stop: 1.2, count: 2}, tilt: {start: -0.3, stop: 0.3, count: 2}"
    options = "n_values: 2, ds_max: 0.05, maximum: {height: 0.8}"
    data = data_of(curves_of(tmp_path, TWO_PEAKS, "{x: 0.9}", sweep, options, UP))
    assert kinds_of(data) == ["maximum", "maximum"]
    for k in range(2):
        mu, tilt, mu_error, tilt_error = points_of(data, k, "mu", "tilt")
        assert np.all(np.abs(mu + np.abs(tilt) - 0.8) <= mu_error + tilt_error + 1e-3 * (np.abs(tilt) < 1e-3))
        assert {ENDS[int(data[end][k])] for end in ("begins", "ends")} == {"range", "beyond"}
        assert np.abs(tilt).min() < 0.05
    assert BEYOND in data["ends"].values.tolist() + data["begins"].values.tolist()


def test_what_is_not_met_is_said(tmp_path):
    """No curve, and a line for each condition."""
    data = curves_of(tmp_path, HOPF, "{x: 0.5}", HOPF_SWEEP, "n_values: 1, maximum: {x: 3.0}, exponent_sum: 0.0", UP)
    said = data.tree()["curves"].attrs["warnings"].splitlines()
    looked = "looked at branches over mu of orbits of period 1 at most that 3 lanes settle on, at 1 value of nu"
    assert said == [
        f"curves: there is no cycle with maximum of x = 3 to follow over mu and nu; {looked}",
        f"curves: there is no cycle with exponent_sum = 0 to follow over mu and nu; {looked}",
    ]


@pytest.mark.parametrize(
    ("text", "section", "options", "max_period", "message"),
    [
        (HOPF, UP, "grazing: true", 1, "there is no jump and no switch to graze"),
        (HOPF, UP, "maximum: {z: 1.0}", 1, "there is no observable z; known are x, y, height"),
        (HOPF, UP, "n_values: 1", 1, "then nothing is left to follow"),
        (HOPF, UP, "duration: 5.0", 0, "give a max_period of 1 or more"),
        (IMPACT, "", "duration: 5.0", 1, "collocation is of smooth motions, without jumps or switches"),
        (OSCILLATOR, "", "duration: 5.0", 1, "with a clock orbits take whole periods of it"),
    ],
)
def test_conditions_that_make_no_sense(tmp_path, text, section, options, max_period, message):
    text, sweep = text.replace("EVENTS", f'"jumps": [{{"when": {WALL}}}]'), HOPF_SWEEP if section else IMPACT_SWEEP
    with pytest.raises(ConfigError, match=message):
        curves_of(tmp_path, text, "{x: 0.5}", sweep, options, section, max_period).experiment.requested()
