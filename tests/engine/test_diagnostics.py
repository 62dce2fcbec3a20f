"""What is fast on a motion is named by the eigenvalues there: decay that binds steps alone, growth, or turning."""

from __future__ import annotations

import numpy as np
import pytest

import jaxnh
from jaxnh.engine.accuracy.diagnostics import describe_rates, fault_of
from jaxnh.systems.first_order import first_order

pytestmark = pytest.mark.usefixtures("quick_compiling")

STIFF = "the system is stiff"
PARTS = "motions near this one part as fast, as where one escapes"
TURNS = "the motion turns as fast"


def linear(a=0.0, b=0.0, c=0.0, d=0.0):
    """x′ = a x + b y, y′ = c x + d y."""

    def rhs(state, time):
        x, y = state
        return a * x + b * y, c * x + d * y

    return {"rhs": rhs, "coordinates": ("x", "y")}


def hardening(a=-0.5):
    """x″ = −x − a x³ − 0.1 x′: beyond 1/√(−a) motions escape."""

    def rhs(state, time):
        x, v = state
        return v, -x - a * x**3 - 0.1 * v

    return {"rhs": rhs, "coordinates": ("x", "v")}


@pytest.mark.parametrize(
    ("matrix", "fastest", "kind"),
    [
        ((300.0, 0.0, 0.0, -1.0), 300, PARTS),
        ((0.0, 300.0, 300.0, -0.1), 300, PARTS),  # a saddle: decay and growth are as fast
        ((0.1, 0.0, 300.0, -300.0), 300, STIFF),  # y follows x
        ((-300.0, 0.0, 0.0, -1.0), 300, STIFF),
        ((-300.0, 100.0, -100.0, -300.0), 316, STIFF),  # −300 ± 100 i
        ((0.0, 300.0, -300.0, 0.0), 300, TURNS),
        ((-1.0, 300.0, -300.0, -1.0), 300, TURNS),
    ],
)
def test_linear_flows(matrix, fastest, kind):
    """Eigenvalues in closed form."""
    p = dict(zip("abcd", matrix, strict=True))
    flow = first_order(linear, p)
    words = describe_rates(flow, flow.start({"x": 1.0, "y": 0.5}), p)
    rate, said = words.removeprefix("rates of change reach ").split(" a unit of time: ")
    assert float(rate) == pytest.approx(fastest, rel=0.05)  # two digits
    assert said == kind


def test_an_escape_is_no_stiffness():
    """x = 300 of x″ = −x + x³/2 − …: eigenvalues ±√(1.5 x²) there, and what a first look sees is the cause."""
    flow, far = first_order(hardening, {}), {"x": 300.0, "v": 1.0}
    assert describe_rates(flow, flow.start(far), {}) == f"rates of change reach 3.7e+02 a unit of time: {PARTS}"
    seen = "the motion goes to infinity at t = 0.00943"
    assert fault_of(flow, flow.start(far), {}, seen) == seen
    assert PARTS in fault_of(flow, flow.start(far), {})


@pytest.mark.parametrize(
    ("define", "start", "axis", "words"),
    [
        # Its rate, 800 e^(800 t), is the largest number, e^709.78, at t = 0.8789; no step goes beyond it.
        (linear, {"x": 1.0, "y": 0.5}, {"a": [800.0]}, r"grows beyond the largest number at t = 0\.87[89]"),
        # From rest at x₀, without what is small there, infinity is at 1.31103/(x₀ √(−a/2)) = 0.009772, with ∫ ds/√(1 − s⁴).
        (hardening, {"x": 300.0, "v": 0.0}, {"a": [-0.4]}, r"the motion goes to infinity at t = 0\.0097[678]"),
    ],
)
def test_a_sweep_whose_lanes_all_escape(define, start, axis, words):
    """The message names the escape and no stiffness."""
    with pytest.raises(jaxnh.AccuracyError, match=words) as refused:
        jaxnh.Session(define, start=start, target=1e-6).run(
            jaxnh.Lyapunov(periods=16, transient=16), **{name: np.array(values) for name, values in axis.items()}
        )
    assert "stiff" not in str(refused.value)
