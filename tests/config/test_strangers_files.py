"""Files as strangers write them: fields of one array, derivatives inside, and a period that is none."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import session_of
from scipy.integrate import solve_ivp

from jaxnh.config.experiment import Experiment
from jaxnh.exceptions import JaxnhError

DUFFING = """\
import jax.numpy as jnp

def system(force=0.3, omega=1.0):
    def rhs(y, t):
        x, v = y
        return v, x - x**3 - 0.2 * v + force * jnp.cos(omega * t)

    return {{"rhs": rhs, "coordinates": ("x", "v"), "period": {period}}}
"""
NETWORK = """\
import jax.numpy as jnp

def system(gain=1.2):
    weights = jnp.array([[0.0, -1.0, 0.4], [1.0, 0.0, 0.3], [-0.2, 0.6, 0.0]])

    def rhs(y, t):
        x = jnp.stack(y)
        return -x + gain * weights @ jnp.tanh(x) + 0.1 * jnp.cos(t)

    return {"rhs": rhs, "coordinates": ("x", "y", "z"), "period": 2 * jnp.pi}
"""
POTENTIAL = """\
import jax
import jax.numpy as jnp

def system(drive=0.3):
    def potential(x):
        return 0.25 * x**4 - 0.5 * x**2

    def T(q, v, t):
        return 0.5 * v[0] ** 2

    def Q(q, v, t):
        return -jax.grad(potential)(q[0]) - 0.2 * v[0] + drive * jnp.cos(t)

    return {"T": T, "Q": Q, "coordinates": ("x",), "period": 2 * jnp.pi}
"""


def portrait(folder, text, initial, sweep):
    path = folder / "own.py"
    path.write_text(text)
    config = f"system: {{file: {path}}}\ninitial: {initial}\nsweep: {sweep}\naccuracy: {{solver: verner9, steps: 64}}\n"
    config += "analyses: {portrait: {transient: 0, periods: 2, samples: 4}}"
    return session_of(Experiment.from_text(config)).run("portrait")


@pytest.mark.parametrize("period", ["1.0", "6.28", "2.1 * jnp.pi / omega"])
def test_a_period_that_is_none(tmp_path, period):
    """Refused with both values; the other sweep is of the drive's frequency, which the period has to follow."""
    path = tmp_path / "own.py"
    path.write_text(DUFFING.format(period=period))
    config = f"system: {{file: {path}}}\ninitial: {{x: 0.1}}\nsweep: {{force: {{values: [0.3]}}}}\nanalyses: {{portrait: {{}}}}"
    with pytest.raises(JaxnhError, match=r"own.py:4: .* is no period of rhs: .* a period later"):
        Experiment.from_text(config).flow()


def test_a_period_that_follows_no_parameter(tmp_path):
    """Right at the default of the frequency, and not at the config's."""
    path = tmp_path / "own.py"
    path.write_text(DUFFING.format(period="2 * jnp.pi"))
    config = "system: {{file: {}, omega: {}}}\ninitial: {{x: 0.1}}\nsweep: {{force: {{values: [0.3]}}}}\nanalyses: {{portrait: {{}}}}"
    assert Experiment.from_text(config.format(path, 2.0)).flow().period == 2 * np.pi  # twice a period is one
    with pytest.raises(JaxnhError, match="is no period of rhs"):
        Experiment.from_text(config.format(path, 1.1)).flow()


def test_a_field_of_one_array(tmp_path):
    """A neural network of three cells, with a matrix: as DOP853 has it."""
    found = portrait(tmp_path, NETWORK, "{x: 0.3, y: -0.2, z: 0.1}", "{gain: {values: [0.9, 1.2]}}")
    weights = np.array([[0.0, -1.0, 0.4], [1.0, 0.0, 0.3], [-0.2, 0.6, 0.0]])
    for i, gain in enumerate((0.9, 1.2)):
        exact = solve_ivp(
            lambda t, x, gain=gain: -x + gain * weights @ np.tanh(x) + 0.1 * np.cos(t),
            (0.0, 4 * np.pi), [0.3, -0.2, 0.1], "DOP853", found["t"].to_numpy(), rtol=1e-12, atol=1e-13,
        )  # fmt: skip
        ours = np.stack([found[name].to_numpy()[i] for name in "xyz"])
        assert np.abs(ours - exact.y).max() < 1e-10


def test_a_derivative_inside_a_force(tmp_path):
    """`jax.grad` of a potential: the double well again, whatever asks for the force."""
    found = portrait(tmp_path, POTENTIAL, "{x: 0.1, x_dot: 0.2}", "{drive: {values: [0.2, 0.3]}}")
    for i, drive in enumerate((0.2, 0.3)):
        exact = solve_ivp(
            lambda t, y, drive=drive: [y[1], y[0] - y[0] ** 3 - 0.2 * y[1] + drive * np.cos(t)],
            (0.0, 4 * np.pi), [0.1, 0.2], "DOP853", found["t"].to_numpy(), rtol=1e-12, atol=1e-13,
        )  # fmt: skip
        assert np.abs(found["x"].to_numpy()[i] - exact.y[0]).max() < 1e-10
