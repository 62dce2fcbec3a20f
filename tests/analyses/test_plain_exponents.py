"""Plain averages of exponents beside a closed form, where by default orbits say them."""

from __future__ import annotations

import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.exponents.estimates import SOURCES
from jaxnh.analyses.options.base import BLOCKS

pytestmark = pytest.mark.usefixtures("uncalibrated", "shared_programs")
OSCILLATOR = """
import jax.numpy as jnp

def system(damping=0.2):
    def rhs(y, t):
        x, v = y
        return v, -damping * v - 4.0 * x + jnp.cos(t)

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi}
"""


def test_a_linear_oscillator_s_exponents_are_minus_half_its_damping():
    """Both eigenvalues have that real part. Tangents turn, so that growth over a block strays by the ratio of the axes
    of the ellipse that they run on, 2 here, in the logarithm: within ln 2 over the length of the average.
    """
    text = "system: {file: oscillator.py}\nsweep: {damping: {values: [0.1, 0.2]}}\nanalyses: {lyapunov: {}}\n"
    text += "accuracy: {solver: dopri8, steps: 32}\n"
    session = jaxnh.Session(jaxnh.Experiment.from_text(text, OSCILLATOR))
    options = {"transient": 16, "periods": BLOCKS, "exponents": 1}
    plain, usual = (session.run("lyapunov", {**options, "method": plain}) for plain in ("averages", "orbits"))
    expected = -0.5 * plain["damping"].to_numpy()
    assert np.all(plain["exponents_method"] == SOURCES.index("average"))
    assert np.all(usual["exponents_method"] == SOURCES.index("orbit"))
    window = BLOCKS * 2 * np.pi
    assert np.all(np.abs(plain["exponents"][:, 0].to_numpy() - expected) <= np.log(2.0) / window)
    assert np.all(np.abs(usual["exponents"][:, 0].to_numpy() - expected) < 1e-6)


SLOW = """
def system(rate=0.03):
    def rhs(y, t):
        x, v = y
        return -rate * x, -v

    return {"rhs": rhs, "coordinates": ("x", "v")}
"""


def test_a_motion_that_comes_to_rest_slowly_has_no_exponent_zero():
    """Exponents are −0.03 and −1: where rest is not reached, the speed falls in each block by e^(−0.03)."""
    text = "system: {file: slow.py}\ninitial: {x: 1.0, v: 1.0}\nsweep: {rate: {values: [0.03]}}\n"
    text += "accuracy: {solver: dopri8, steps: 4}\nanalyses: {lyapunov: {}}\n"
    session = jaxnh.Session(jaxnh.Experiment.from_text(text, SLOW))
    data = session.run("lyapunov", {"transient": 32, "periods": 4 * BLOCKS, "exponents": 2, "method": "averages"})
    gap = np.abs(data["exponents"][0].to_numpy() - [-0.03, -1.0])
    assert np.all(gap <= data["exponents_error"][0].to_numpy() + 1e-6)
    assert gap[0] < 1e-6


LINE = """
import jax.numpy as jnp

def system(rate=3.0):
    def rhs(y, t):
        x, v = y
        return v, -jnp.where(x > 1.0, rate, 1.0) * v

    return {"rhs": rhs, "coordinates": ("x", "v"), "switches": ()}
"""


def test_equilibria_that_fill_a_line():
    """All states at rest are equilibria, those beyond x = 1 with the exponents 0 and −3: no step leads along the line."""
    text = "system: {file: line.py}\ninitial: {x: 2.0, v: 0.1}\nsweep: {rate: {values: [3.0]}}\n"
    text += "accuracy: {solver: dopri8, steps: 4}\nanalyses: {lyapunov: {}}\n"
    session = jaxnh.Session(jaxnh.Experiment.from_text(text, LINE))
    data = session.run("lyapunov", {"transient": 32, "periods": BLOCKS, "exponents": 2})
    assert data["exponents_method"][0] == SOURCES.index("equilibrium")
    assert np.abs(data["exponents"][0].to_numpy() - [0.0, -3.0]).max() < 1e-9


STRONGLY_CONTRACTING = """
import jax.numpy as jnp

def system(drive=1.0):
    def rhs(y, t):
        x, w = y
        return drive * jnp.cos(t) - x, -4.0 * (1.0 + jnp.cos(t)) * w

    return {"rhs": rhs, "coordinates": ("x", "w"), "period": 2 * jnp.pi}
"""


@pytest.mark.slow  # a linear oscillator's exponents are quick
@pytest.mark.parametrize("target", [1e-6, 1e-8])
def test_steps_resolve_what_tangents_do(target):
    """Exponents are -1 and -4, the mean of the rate of w; w vanishes on the orbit, so that its state needs no steps.

    With steps for the state alone the second is off by two, and only its bar, which the sum rule widens, knows of it.
    """
    text = "system: {file: contracting.py}\nsweep: {drive: {values: [1.0]}}\n"
    text += "analyses: {lyapunov: {transient: 16, periods: 64, exponents: 2, method: averages}}\n"
    text += f"accuracy: {{target: {target}}}\n"
    session = jaxnh.Session(jaxnh.Experiment.from_text(text, STRONGLY_CONTRACTING))
    found = session.run("lyapunov")
    off = np.abs(found["exponents"].to_numpy()[0] - (-1.0, -4.0))
    assert np.all(off <= found["exponents_error"].to_numpy()[0])
    assert np.all(off < 0.004)
    assert found.attrs["refinement_for_tangents"] > 1


def lorenz(rho=28.0):
    def rhs(s, t):
        x, y, z = s
        return 10.0 * (y - x), x * (rho - z) - y, x * y - 8.0 / 3.0 * z

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}


@pytest.mark.parametrize("z", [0.0, 5.0])
def test_a_motion_that_rests_on_a_saddle(z):
    """On the z axis, which leads into the origin, no rounding leaves it: the exponents are the saddle's eigenvalues."""
    data = jaxnh.Session(lorenz, start={"z": z}, target=1e-8).run(jaxnh.Lyapunov(periods=200, exponents=3))
    roots = np.roots([1.0, 11.0, 10.0 * (1.0 - 28.0)])
    exact = np.sort([*roots, -8.0 / 3.0])[::-1]
    assert np.all(np.abs(data["exponents"].to_numpy() - exact) <= data["exponents_error"].to_numpy())
    assert str(jaxnh.labels(data["exponents_method"]).to_numpy()) == "equilibrium"
