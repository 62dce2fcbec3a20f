"""Every solver on flows whose motion is known: its errors fall as its order says."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

from jaxnh.maps.second_order import second_order
from jaxnh.maps.section import flow_of
from jaxnh.solvers import NYSTROM, RUNGE_KUTTA, SOLVERS, SPLITTINGS
from tests.flows import (
    calm_particle,
    duffing_at_small_amplitude,
    hopf_normal_form,
    linear_oscillator,
    lorenz,
    sleigh,
)

pytestmark = pytest.mark.usefixtures("quick_compiling_always")

FLOWS = {
    "linear oscillator": linear_oscillator.known_flow,
    "Duffing at small amplitude": duffing_at_small_amplitude.known_flow,
    "Hopf on a section": hopf_normal_form.known_flow,
    "sleigh": sleigh.known_flow,
    "Lorenz": lorenz.known_flow,
    "particle, constant": functools.partial(calm_particle.known_flow, "constant"),
    "particle, disturbed": functools.partial(calm_particle.known_flow, "disturbed"),
}
SECOND_ORDER = ("linear oscillator", "Duffing at small amplitude")
AT_A_SPEED = ("particle, constant", "particle, disturbed")
QUICK = {  # beside all splittings: one compiles a flow's Runge–Kutta steps for a second
    "linear oscillator": (*RUNGE_KUTTA, *NYSTROM),
    "Duffing at small amplitude": ("verner9", "nystrom8"),
    "Hopf on a section": ("tsit5",),
    "sleigh": ("tsit5",),
    "Lorenz": ("dopri8",),
    "particle, disturbed": ("tsit5",),
}


def solvers_of(name):
    """Names of the solvers that integrate a flow; Runge–Kutta methods on the particle are fitted in `test_runge_kutta`."""
    if name in AT_A_SPEED:
        return [*SPLITTINGS, "tsit5"]
    return [*RUNGE_KUTTA, *(NYSTROM if name in SECOND_ORDER else ())]


CASES = [
    pytest.param(
        name,
        solver,
        id=f"{name}-{solver}",
        marks=[] if solver in SPLITTINGS or solver in QUICK.get(name, ()) else pytest.mark.slow,
    )
    for name in FLOWS
    for solver in solvers_of(name)
]


@functools.cache
def make_flow(name):
    return FLOWS[name]()


@pytest.mark.parametrize("name", FLOWS)
def test_every_flow_has_the_solvers_for_its_kind(name):
    assert bool(second_order(flow_of(make_flow(name).system))) == (name in SECOND_ORDER)


@pytest.mark.parametrize(("name", "solver"), CASES)
def test_error_falls_by_the_order(lanes, name, solver):
    """With twice the steps a method of order p has 2⁻ᵖ of the error: half an order less is the sign of a wrong coefficient.

    Errors are geometric means over lanes, as some lanes are late to follow the law and others cross zero.
    """
    flow, solver = make_flow(name), SOLVERS[solver]
    steps = flow.evaluations // solver.stages
    coarse, fine = (
        math.exp(np.log(np.maximum(flow.errors(lanes, solver, n), 1e-18)).mean()) for n in (steps, 2 * steps)
    )
    assert coarse > 10 * flow.rounding
    assert fine < coarse * 2.0 ** (0.5 - solver.convergence_order) + flow.rounding
