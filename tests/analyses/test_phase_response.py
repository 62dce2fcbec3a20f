"""Phase response curves: closed forms, and direct kicks of an integration that shares no code."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxnh
from jaxnh.exceptions import ConfigError
from tests.helpers import contract
from tests.helpers.kept_programs import session_of

SHEAR, TURN = 0.7, 2.0

STUART_LANDAU = f"""
def system(mu=0.5):
    def rhs(state, t):
        x, y = state
        r2 = x * x + y * y
        growth, turn = mu - r2, {TURN} - {SHEAR} * r2
        return growth * x - turn * y, growth * y + turn * x

    return {{"rhs": rhs, "coordinates": ("x", "y")}}
"""

POINCARE = """
import jax.numpy as jnp


def system(rate=3.0):
    def rhs(state, t):
        x, y = state
        growth = rate * (1.0 - jnp.sqrt(x * x + y * y))
        return growth * x - y, growth * y + x

    return {"rhs": rhs, "coordinates": ("x", "y")}
"""

BENT = f"""
def system(mu=0.5, shear=0.7, bend=0.4):
    def rhs(state, t):
        x, y = state
        height = y - bend * x * x
        r2 = x * x + height * height
        growth, turn = mu - r2, {TURN} - shear * r2
        dx = growth * x - turn * height
        return dx, growth * height + turn * x + 2.0 * bend * x * dx

    return {{"rhs": rhs, "coordinates": ("x", "y")}}
"""

WEAK = f"""
def system(mu=0.001):
    def rhs(state, t):
        x, y, z = state
        pull = mu * (1.0 - x * x - y * y)
        turn = {TURN} - {SHEAR} * pull
        return pull * x - turn * y, pull * y + turn * x, x - z

    return {{"rhs": rhs, "coordinates": ("x", "y", "z")}}
"""

VAN_DER_POL = """
def system(mu=1.0):
    def rhs(state, t):
        x, v = state
        return v, mu * (1.0 - x * x) * v - x

    return {"rhs": rhs, "coordinates": ("x", "v")}
"""


def responses(folder, text, sweep, section="{coordinate: y, value: 0.0, direction: up}", more="", phases=16, x=0.9):
    """The group `period` with phase responses."""
    (folder / "flow.py").write_text(text)
    config = (
        f"system: {{file: flow.py}}\ninitial: {{x: {x}}}\nsweep: {{{sweep}}}\nsection: {section}\n"
        f"accuracy: {{target: 1.0e-7}}\nanalyses: {{period: {{max_period: 1, transient: 32, "
        f"phase_response: {phases}{more}}}}}\n"
    )
    (folder / "flow.yaml").write_text(config)
    data = session_of(jaxnh.load(folder / "flow.yaml")).tree()["period"].to_dataset()
    contract.check("period", data, ("x", "y", "z", "v", "mu", "rate", "shear", "bend", "t"))
    return data


def holds(data, name, exact):
    """A variable lies within its error of what is known, and the error is small."""
    error = data[f"{name}_error"].values
    assert np.all(np.abs(data[name].values - exact) <= error), name
    assert error.max() < 1e-8, name


def test_stuart_landau_with_shear(tmp_path):
    """With r′ = μr − r³ and θ′ = Ω − c r² the phase is θ − c log r + const; along the cycle r² = μ."""
    data = responses(tmp_path, STUART_LANDAU, "mu: {values: [0.2, 0.5]}")
    mu, phase = data["mu"].values[:, None], data["phase"].values
    assert phase == pytest.approx(2 * np.pi * np.arange(16) / 16)
    radius = np.sqrt(mu)
    holds(data, "time", 2 * np.pi / (TURN - SHEAR * mu[:, 0]))
    holds(data, "x", radius * np.cos(phase))
    holds(data, "y", radius * np.sin(phase))
    holds(data, "x_response", (-np.sin(phase) - SHEAR * np.cos(phase)) / radius)
    holds(data, "y_response", (np.cos(phase) - SHEAR * np.sin(phase)) / radius)


def test_cycles_that_attract_weakly(tmp_path):
    """r′ = μ(1 − r²)r, whose multiplier is within 6μ of one, and z′ = x − z, which moves nothing: its response is zero, to
    what rounding of the others leaves in it."""
    data = responses(tmp_path, WEAK, "mu: {values: [0.0005, 0.001, 0.002, 0.004, 0.008]}", x=1.0)
    phase = data["phase"].values
    holds(data, "x_response", SHEAR * np.cos(phase) - np.sin(phase))
    holds(data, "y_response", SHEAR * np.sin(phase) + np.cos(phase))
    holds(data, "z_response", 0.0)


@pytest.mark.slow  # a cycle with shear is quick
def test_poincares_oscillator(tmp_path):
    """Isochrons are radii: a small kick along x moves the phase by −sin φ of it, however fast the cycle attracts."""
    data = responses(tmp_path, POINCARE, "rate: {values: [0.5, 20.0]}")
    holds(data, "x_response", -np.sin(data["phase"].values))
    holds(data, "y_response", np.cos(data["phase"].values))


# ---- bars over many set-ups


def shares_covered_of_bent_cycles(folder, sweep):
    """Stuart and Landau's cycles in x = X, y = Y + κX², from X = 0 downward on: κ makes them uneven.

    Of every number the share that its bar covers, and the largest bar.
    """
    data = responses(folder, BENT, sweep, "{coordinate: x, value: 0.0, direction: down}")
    mu, shear, bend = (data[name].values for name in ("mu", "shear", "bend"))
    mu, shear, bend = (part[..., None] for part in np.meshgrid(mu, shear, bend, indexing="ij"))
    angle, radius = data["phase"].values + 0.5 * np.pi, np.sqrt(mu)
    x = radius * np.cos(angle)
    by_y = (np.cos(angle) - shear * np.sin(angle)) / radius
    exact = {
        "time": 2 * np.pi / (TURN - shear * mu)[..., 0],
        "x": x,
        "y": radius * np.sin(angle) + bend * x**2,
        "x_response": (-np.sin(angle) - shear * np.cos(angle)) / radius - 2.0 * bend * x * by_y,
        "y_response": by_y + 0.0 * bend,
    }
    dims = ("mu", "shear", "bend", "phase")
    ratios = {name: np.abs(data[name].transpose(*dims[: value.ndim]).values - value) for name, value in exact.items()}
    errors = {name: data[f"{name}_error"].transpose(*dims[: value.ndim]).values for name, value in exact.items()}
    return {name: np.mean(ratios[name] <= errors[name]) for name in exact}, max(e.max() for e in errors.values())


@pytest.mark.slow  # bars cover closed forms in quick tests of straight ones
def test_bars_of_bent_cycles(tmp_path):
    sweep = "mu: {values: [0.3, 0.9]}, shear: {values: [0.5]}, bend: {values: [0.0, 0.8]}"
    shares, largest = shares_covered_of_bent_cycles(tmp_path, sweep)
    assert min(shares.values()) >= 0.95, shares
    assert largest < 1e-7


@pytest.mark.slow
def test_bars_of_many_bent_cycles(tmp_path):
    """Of 48 sets of parameters: no fewer than 95 in 100 are covered, of each kind of number."""
    mu, shear, bend = (
        f"{{start: {a}, stop: {b}, count: {n}}}" for a, b, n in ((0.1, 1.2, 4), (-1.0, 1.5, 3), (0.0, 1.5, 4))
    )
    sweep = f"mu: {mu}, shear: {shear}, bend: {bend}"
    shares, largest = shares_covered_of_bent_cycles(tmp_path, sweep)
    assert min(shares.values()) >= 0.95, shares
    assert largest < 1e-6


def rates_of_van_der_pol(mu, y):
    x, v = y
    return np.array([v, mu * (1.0 - x * x) * v - x])


def passage(mu, start, count):
    """Time of a passage of v = 0 downward, by DOP853."""

    def height(t, y):
        return y[1]

    height.direction = -1
    options = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14, "events": height}
    path = solve_ivp(lambda t, y: rates_of_van_der_pol(mu, y), (0.0, 9.0 * (count + 1)), start, **options)
    times = path.t_events[0]
    return times[times > 0.5][count - 1]


@pytest.mark.slow
def test_kicks_of_van_der_pol(tmp_path):
    """The time that a small kick along x or v gains at a late passage, of kicks to either side: its error is their square.

    DOP853 leaves 1e-12 of a time, over kicks of 1e-4 1e-8 of a response; third derivatives of the phase leave as much.
    """
    mu, kick, turns = 1.0, 1e-4, 6
    section = "{coordinate: v, value: 0.0, direction: down}"
    data = responses(tmp_path, VAN_DER_POL, "mu: {values: [1.0]}", section, phases=8).isel(mu=0)
    duration = float(data["time"])
    for k in range(8):
        state = np.array([float(data["x"][k]), float(data["v"][k])])
        for axis, name in enumerate(("x", "v")):
            late, early = (passage(mu, state + sign * kick * np.eye(2)[axis], turns) for sign in (1.0, -1.0))
            measured = 2 * np.pi / duration * (early - late) / (2 * kick)
            assert abs(float(data[f"{name}_response"][k]) - measured) < 1e-6, (k, name)
    assert float(data["x_response_error"].max()) < 1e-8


def test_a_lane_without_a_cycle_has_no_response(tmp_path):
    """Below the Hopf bifurcation the motion does not return: not a number, and the other lane has its own."""
    data = responses(tmp_path, STUART_LANDAU, "mu: {values: [-0.2, 0.5]}", phases=4)
    assert np.isnan(data["x_response"].values[0]).all()
    assert np.isfinite(data["x_response"].values[1]).all()
    assert data.attrs["warnings"].startswith("period: 1 lanes have no phase response")
    jaxnh.figure(data)


def test_what_has_no_phase_response_is_said(tmp_path):
    (tmp_path / "flow.py").write_text(
        "import jax.numpy as jnp\n\n\ndef system(a=0.1):\n    return dict(rhs=lambda y, t: (y[1], -a * y[1] - y[0] + jnp.cos(t)), "
        'coordinates=("x", "v"), period=2 * jnp.pi)\n'
    )
    config = tmp_path / "flow.yaml"
    config.write_text(
        "system: {file: flow.py}\ninitial: {x: 0.9}\nsweep: {a: {values: [0.1]}}\nanalyses: {period: {phase_response: 8}}\n"
    )
    with pytest.raises(ConfigError, match=r"the drive gives the phase; with a clock there is no phase response"):
        jaxnh.load(config).requested()
