"""Cycles begun at Hopf points of equilibria: Hopf's normal form and Langford's flow in closed form, the Brusselator."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxnh.analyses.continuation.cycles import grow_cycles
from jaxnh.analyses.continuation.equilibria import cycles_at_hopf_points, equilibria
from jaxnh.analyses.continuation.families import orbit_family
from jaxnh.analyses.continuation.family_tree import SeedOrbit, grow
from jaxnh.maps.section import Section, begin
from jaxnh.orbits.continuation.kinds import KINDS
from jaxnh.orbits.continuation.paths import COLLAPSED, RANGE, StepControl
from jaxnh.solvers import verner9
from jaxnh.systems.first_order import first_order
from tests.helpers.batches import batch_of


def swirl(cubic):
    """z' = (μ + 2i) z + c |z|² z: cycles of radius √(−μ/c)."""

    def define(mu=0.0):
        def rhs(u, t):
            x, y = u
            growth = mu + cubic * (x * x + y * y)
            return growth * x - 2.0 * y, growth * y + 2.0 * x

        return {"rhs": rhs, "coordinates": ("x", "y")}

    return define


def brusselator(b=2.0):
    """With A = 1: x = 1, y = B loses its stability at B = 1 + A² = 2."""

    def rhs(u, t):
        x, y = u
        return 1.0 + x * x * y - (b + 1.0) * x, b * x - x * x * y

    return {"rhs": rhs, "coordinates": ("x", "y")}


B, ROTATION, RHO = 0.7, 3.5, 0.25


def langford(a=0.0):
    """Langford's flow without the term that breaks its symmetry: cycles z = b, r² = (0.6 + a b − b³/3)/(1 + ρ b).

    (Langford, in Nonlinear Dynamics and Turbulence, 1983, 215.)
    """

    def rhs(u, t):
        x, y, z = u
        square = x * x + y * y
        return (
            (z - B) * x - ROTATION * y,
            ROTATION * x + (z - B) * y,
            0.6 + a * z - z**3 / 3 - square * (1.0 + RHO * z),
        )

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}


def batch_on(define, name, ends, section, steps=24):
    """Lanes on their way to a section."""
    plain = first_order(define, {name: ends[0]})
    flow = Section(plain, *section, "up")
    start = begin(flow, plain.start(dict.fromkeys(plain.coordinates, 0.3)))
    return batch_of(flow, start, np.linspace(*ends, 3), verner9, steps, name=name)


def no_stage(label):
    return contextlib.nullcontext()


def seeds_of(define, name, ends, section, box, lanes, steps=24):
    """The family of cycles on a section, Hopf points of equilibria, and the first cycles there."""
    batch = batch_on(define, name, ends, section, steps)
    still = equilibria(batch, lanes, 4, 1, box, ends, StepControl(), no_stage)
    family = orbit_family(batch, lanes, batch.strobe(), np.ones(batch.chart.dimension), ends)
    hopf = [point for point in still.tree.bifurcations if KINDS[point.kind] == "hopf"]
    return family, hopf, cycles_at_hopf_points(still, family, batch.system)


BOX = {"x": (-1.0, 1.0), "y": (-1.0, 1.0)}


@pytest.mark.parametrize("cubic", [-1.0, pytest.param(1.0, marks=pytest.mark.slow)])
def test_cycles_of_the_normal_form(lanes, cubic):
    """Of radius √|μ|, beyond the Hopf point where it is supercritical and before it where it is not."""
    _, [point], [cycle] = seeds_of(swirl(cubic), "mu", (-0.5, 0.71), ("y", 1, 0.0), BOX, lanes)
    assert point.criticality == -np.sign(cubic)
    assert np.sign(cycle.value) == -np.sign(cubic)
    # The map's error in 24 steps of order nine a unit of time is below 1e-12, and the radius goes like a root.
    assert abs(abs(cycle.points[0, 0]) - np.sqrt(-cycle.value / cubic)) < 1e-10
    assert cycle.points[0, 0] > 0.0  # y goes up where y' = 2x is positive


def test_cycles_that_grow_ten_thousand_times(lanes):
    """Of radius √μ up to μ = 100, followed from one of 10⁻³ in sizes of motions of as much: a thousand of these were all bounds."""
    ends, section = (-1.0, 100.0), ("y", 1, 0.0)
    seed = SeedOrbit(np.array([[1e-3]]), 1e-6)
    batch = batch_on(swirl(-1.0), "mu", ends, section)
    [followed] = grow_cycles(batch, lanes, [[seed]], np.array([1e-3]), 1, ends, StepControl(), no_stage)
    assert {*followed.branch.ends} == {COLLAPSED, RANGE}
    [last] = [point for point in followed.branch.points if point.value == 100.0]
    radius = np.linalg.norm(last.solution.path.ends[0], axis=1)
    assert np.abs(radius - 10.0).max() < 1e-6  # meshes are for errors of 1e-7


@pytest.mark.slow
def test_first_cycle_of_the_brusselator(lanes):
    """The Hopf point at B = 2, supercritical; beyond it a cycle that closes by DOP853."""
    box = {"x": (0.5, 2.0), "y": (1.0, 3.0)}
    _, [point], [cycle] = seeds_of(brusselator, "b", (1.5, 2.6), ("x", 0, 1.0), box, lanes)
    assert abs(point.value - 2.0) < point.error + 1e-13
    assert point.criticality == 1
    assert cycle.value > 2.0

    def rates(t, u):
        return brusselator(cycle.value)["rhs"](u, t)

    def crosses(t, u):
        return u[0] - 1.0

    start = [1.0, cycle.points[0, 0]]
    whole = solve_ivp(rates, (0.0, 12.0), start, method="DOP853", rtol=1e-13, atol=1e-14, events=crosses)
    upward = [state for time, state in zip(whole.t_events[0], whole.y_events[0], strict=True) if time > 1.0]
    after = next(state for state in upward if rates(0.0, state)[0] > 0.0)
    # scipy's own error over a turn, and that of its event, some 1e-12; the cycle's multiplier is near one.
    assert abs(after[1] - cycle.points[0, 0]) < 1e-10
    assert abs(cycle.points[0, 0] - cycle.value) > 1e-3  # not the equilibrium x = 1, y = B


@pytest.mark.slow
def test_branch_from_the_hopf_point_of_langfords_flow(lanes):
    """From (b³/3 − 0.6)/b on, all cycles of the branch have the radius of the closed form."""
    box = {"x": (-0.5, 0.5), "y": (-0.5, 0.5), "z": (-1.0, 2.0)}
    family, hopf, seeds = seeds_of(langford, "a", (-1.2, 1.0), ("y", 1, 0.0), box, lanes, 48)
    exact = (B**3 / 3 - 0.6) / B
    assert any(abs(point.value - exact) < point.error + 1e-12 for point in hopf)
    assert seeds
    tree = grow([family] * 3, [seeds], 1, StepControl())
    [branch] = [branch for branch in tree.branches if abs(branch.points[0, 0, 1] - B) < 1e-6]
    x, z = branch.points[:, 0].T
    square = (0.6 + branch.value * B - B**3 / 3) / (1.0 + RHO * B)
    assert np.abs(z - B).max() < 1e-9
    assert np.abs(x**2 - square).max() < 1e-9
    assert branch.value.max() == 1.0
    assert branch.value.min() < exact + 1e-3
