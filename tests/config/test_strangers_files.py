"""Files as strangers write them: fields of one array, derivatives inside, and a period that is none."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxnh.engine.experiment import Experiment
from jaxnh.exceptions import JaxnhError
from jaxnh.systems.user_file import UserFile
from tests.helpers.kept_programs import session_of

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


def test_a_period_in_single_precision(tmp_path):
    """A script that loads a config before anything has set JAX to double precision: a period of ten digits will do."""
    path = tmp_path / "own.py"
    path.write_text(DUFFING.format(period="6.283185307"))
    config = f"system: {{file: {path}}}\ninitial: {{x: 0.1}}\nsweep: {{force: {{values: [0.3]}}}}\nanalyses: {{portrait: {{}}}}"
    with jax.enable_x64(False):
        assert Experiment.from_text(config).flow().period == 6.283185307


@pytest.mark.parametrize(("text", "name", "vectors", "d"), [(NETWORK, "rhs", 1, 3), (POTENTIAL, "Q", 2, 1)])
def test_functions_see_one_state(tmp_path, text, name, vectors, d):
    """A field of one array by a matrix, and a force by `jax.grad`: asked for many states, each is as if it were alone."""
    path = tmp_path / "own.py"
    path.write_text(text)
    function = UserFile(path).define()[name]
    states = np.random.default_rng(0).uniform(-1, 1, (vectors, d, 4, 5))
    many = function(*map(tuple, states), 0.7)
    assert [np.shape(one) for one in many] == [(4, 5)] * d
    alone = [np.array(function(*map(tuple, states[..., i, j]), 0.7)) for i, j in np.ndindex(4, 5)]
    assert np.abs(np.stack(many, axis=-1).reshape(20, d) - alone).max() < 1e-15


WELL = """\
import jax.numpy as jnp

def system(force=0.07):
    def rhs(y, t):
        x, v = y
        return v, -x + x**2 - 0.1 * v + force * jnp.cos(0.85 * t)

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / 0.85}
"""


def test_lanes_that_escape(tmp_path):
    """Helmholtz's oscillator: above a force of about 0.08 lanes leave the well for ever. Steps are chosen by the others,
    and who has left is marked; at 0.05 the strobes are those of DOP853."""
    path = tmp_path / "own.py"
    path.write_text(WELL)
    config = (
        f"system: {{file: {path}}}\ninitial: {{x: 0.0}}\nsweep: {{force: {{start: 0.05, stop: 0.11, count: 64}}}}\n"
    )
    config += "accuracy: {target: 1.0e-9}\nanalyses: {diagram: {transient: 64, strobes: 2}}"
    found = session_of(Experiment.from_text(config)).run("diagram")
    reasons = found["status"].attrs["flag_meanings"].split()
    why = [reasons[k] for k in found["status"].to_numpy()]
    assert set(why) == {"ok", "not_finite"}
    assert why[0] == "ok"
    exact = solve_ivp(
        lambda t, y: [y[1], -y[0] + y[0] ** 2 - 0.1 * y[1] + 0.05 * np.cos(0.85 * t)],
        (0.0, 65 * 2 * np.pi / 0.85), [0.0, 0.0], "DOP853", rtol=1e-12, atol=1e-13,
    ).y[:, -1]  # fmt: skip
    assert np.abs([float(found[name][0, 1]) - one for name, one in zip("xv", exact, strict=True)]).max() < 1e-6
