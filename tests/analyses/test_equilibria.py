"""Equilibria that `branches` follows, and their bifurcations, against closed forms: Lorenz's and Roessler's flows."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
import scipy.optimize

import jaxnh
from jaxnh.analyses.continuation.equilibria import equilibria
from jaxnh.analyses.continuation.seeds import random_wave
from jaxnh.analyses.random_starts import random_start_batch
from jaxnh.exceptions import ConfigError
from jaxnh.maps.section import Crossing, Section, begin
from jaxnh.orbits.continuation.kinds import KINDS
from jaxnh.orbits.continuation.paths import StepControl
from jaxnh.solvers import verner9
from jaxnh.systems.first_order import first_order
from tests.helpers.batches import batch_of
from tests.helpers.kept_programs import session_of
from tests.helpers.paths import ROOT

ROUNDING = 1e-12  # of a parameter of order ten that a polynomial through values of a determinant gives


def lorenz(rho=28.0):
    def rhs(y, t):
        x, y_, z = y
        return 10.0 * (y_ - x), x * (rho - z) - y_, x * y_ - 8 / 3 * z

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}


def roessler(c=5.7):
    """With a = 0.2 and b = 0.4: where they are equal, fold and Hopf point are one."""

    def rhs(y, t):
        x, y_, z = y
        return -y_ - z, x + 0.2 * y_, 0.4 + z * (x - c)

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}


def followed(define, name, ends, box, lanes):
    """The branches of equilibria over a range, and the family's bifurcations as (kind, parameter, point)."""
    flow = Section(first_order(define, {name: ends[0]}), "y", 1, 0.0, "up")
    scene = batch_of(
        flow, begin(flow, flow.flow.start({"x": 1.0, "y": 1.0, "z": 1.0})), np.linspace(*ends, 3), verner9, 8, name=name
    )
    found = equilibria(scene, lanes, 8, 1, box, ends, StepControl(), lambda label: contextlib.nullcontext())
    points = sorted(found.tree.bifurcations, key=lambda point: point.value)
    return found.tree.branches, points


def test_equilibria_of_lorenz(lanes):
    """The origin, and from the pitchfork at rho = 1 on ±√(β(ρ − 1)), which lose their stability at 470/19, subcritically.

    Subcritical: Marsden and McCracken, The Hopf Bifurcation and Its Applications, 1976, 4B.
    """
    box = {"x": (-10.0, 10.0), "y": (-10.0, 10.0), "z": (-5.0, 30.0)}
    branches, points = followed(lorenz, "rho", (0.5, 30.0), box, lanes)
    assert len(branches) == 2
    assert [KINDS[point.kind] for point in points] == ["branch_point", "hopf", "hopf"]
    for point, exact in zip(points, (1.0, 470 / 19, 470 / 19), strict=True):
        assert abs(point.value - exact) < point.error + ROUNDING
    assert [point.criticality for point in points] == [1, -1, -1]
    # At a Hopf point the eigenvalues are ±i √(β(σ + ρ)) and −(σ + β + 1).
    for point in points[1:]:
        largest = np.sort_complex(point.multipliers)
        frequency = np.sqrt(8 / 3 * (10 + 470 / 19))
        assert np.abs(largest - [-(10 + 8 / 3 + 1), -1j * frequency, 1j * frequency]).max() < 1e-9
    [pair] = [branch for branch in branches if np.abs(branch.points[:, 0, 0]).max() > 1.0]
    x, rho = pair.points[:, 0, 0], pair.value
    assert np.abs(x**2 - 8 / 3 * (rho - 1)).max() < 1e-9
    assert x.min() == pytest.approx(-x.max(), abs=1e-9)


def test_equilibria_of_roessler(lanes):
    """One branch, z = (c ± √(c² − 4ab))/2a, folded at c = 2√(ab), and its Hopf points."""
    box = {"x": (-1.0, 3.0), "y": (-5.0, 5.0), "z": (-5.0, 15.0)}
    branches, points = followed(roessler, "c", (0.4, 3.0), box, lanes)
    assert len(branches) == 1
    named = [(KINDS[point.kind], point) for point in points]
    [fold] = [point for kind, point in named if kind == "fold"]
    assert abs(fold.value - np.sqrt(0.32)) < fold.error + ROUNDING
    hopf = [point for kind, point in named if kind == "hopf"]
    assert len(hopf) == len(points) - 1

    def oscillates(c, sign):
        """a₂a₁ − a₀ of the characteristic polynomial λ³ + a₂λ² + a₁λ + a₀ (Routh and Hurwitz)."""
        z = (c + sign * np.sqrt(c * c - 0.32)) / 0.4
        matrix = np.array([[0, -1, -1], [1, 0.2, 0], [z, 0, 0.2 * z - c]])
        _, *a = np.poly(matrix)
        return a[0] * a[1] - a[2], a[1]

    exact = []
    for sign in (-1, 1):
        grid = np.linspace(np.sqrt(0.32) + 1e-9, 3.0, 2601)
        values = np.array([oscillates(c, sign)[0] for c in grid])
        for k in np.flatnonzero(values[1:] * values[:-1] < 0):
            root = scipy.optimize.brentq(lambda c, s=sign: oscillates(c, s)[0], grid[k], grid[k + 1], xtol=1e-14)
            exact += [root] if oscillates(root, sign)[1] > 0 else []  # else two real ones of sum zero
    assert len(exact) == len(hopf)
    for point, value in zip(hopf, sorted(exact), strict=True):
        assert abs(point.value - value) < point.error + ROUNDING


def test_random_starts_are_on_their_way_to_the_section():
    """Those drawn over the box, the other coordinates as in the scene, each a crossing at t = 0."""
    section = Section(first_order(lorenz, {"rho": 28.0}), "z", 2, 27.0, "up")
    start = begin(section, section.flow.start({"x": 1.0, "y": 1.0, "z": 20.0}))
    scene = batch_of(section, start, [28.0, 30.0], verner9, 64, name="rho")
    there, drawn = random_start_batch(scene, 3, 1, {"x": (-10.0, 10.0)})
    assert isinstance(there.start, Crossing)
    x, y, z = there.start.state.y
    np.testing.assert_array_equal(x, drawn["x"])
    assert (y.tolist(), z.tolist()) == ([1.0] * 6, [20.0] * 6)


@pytest.mark.slow
def test_random_starts_on_a_section(lanes):
    """Newton finds Lorenz's shortest orbit, which repels (Viswanath, Nonlinearity 16 (2003) 1035), from random starts."""
    flow = Section(first_order(lorenz, {"rho": 28.0}), "z", 2, 27.0, "up")
    scene = batch_of(
        flow, begin(flow, flow.flow.start({"x": 1.0, "y": 1.0, "z": 20.0})), [28.0], verner9, 64, name="rho"
    )
    box = {"x": (-10.0, 10.0), "y": (-10.0, 10.0)}
    found = random_wave(scene, lanes, 16, 1, box, 2, np.array([8.0, 8.0]), 16)
    assert {len(orbit.points) for orbit in found} >= {2}
    for orbit in found:
        assert np.isfinite(orbit.points).all()


@pytest.mark.slow
def test_equilibria_beside_orbits():
    """Through the whole package: Hopf points with period 0, and orbits of the Lorenz flow beside them."""
    settings = [
        "sweep={rho: {start: 20.0, stop: 30.0, count: 4}}",
        "analyses={branches: {max_period: 1, transient: 16, equilibria: 8, box: {x: [-10, 10], y: [-10, 10], z: [0, 30]}}}",
    ]
    tree = session_of(jaxnh.load(ROOT / "configs/flows/lorenz.yaml", settings)).tree()
    marks, branches = tree["bifurcations"], tree["branches"]
    hopf = marks["kind"].values == KINDS.index("hopf")
    assert hopf.sum() == 2
    assert np.all(marks["period"].values[hopf] == 0)
    assert np.all(marks["criticality"].values[hopf] == -1)
    assert np.abs(marks["rho"].values[hopf] - 470 / 19).max() < 1e-9
    assert np.sum(branches["period"].values == 0) == 3
    jaxnh.figure(tree)


def test_a_clock_leaves_no_equilibria():
    settings = ["analyses={branches: {equilibria: 4, box: {x1: [-1, 1]}}}"]
    with pytest.raises(ConfigError, match="a flow with a clock has no equilibria"):
        jaxnh.load(ROOT / "configs/branches.yaml", settings).requested()


@pytest.mark.parametrize("centre", [0.0, 1024.0])
def test_curves_of_equilibria_need_no_section(centre):
    """The cusp 27 b1² = 4 b2³ of b1 + b2 x − x³, whose every lane comes to rest and returns to no section; also where x
    is measured from far away."""

    def cusp(b1=0.1, b2=0.3, centre=0.0):
        def rhs(y, t):
            x = y[0] - centre
            return b1 + b2 * x - x**3, -y[1]

        return {"rhs": rhs, "coordinates": ("x", "y")}

    box = {"x": [centre - 2, centre + 2], "y": [-1, 1]}
    asked = jaxnh.Curves(max_period=0, equilibria=4, box=box, n_values=2)
    session = jaxnh.Session(cusp, start={"x": centre - 0.3}, parameters={"centre": centre})
    groups = session.groups({"curves": asked}, b1=np.linspace(-2.0, 2.0, 3), b2=np.array([-1.0, 2.0]))
    assert "section" not in groups["curves"].attrs
    [fold], [point] = groups["curves"]["curve"].to_numpy(), groups["codimension_two"]["codimension_two"].to_numpy()
    b1, b2, error = (groups["curves"][name].to_numpy()[fold] for name in ("b1", "b2", "b1_error"))
    known = np.isfinite(b1)
    slope = np.sqrt(b2[known] / 3.0)  # of the curve, over which an error of b2 moves b1
    off = np.abs(np.abs(b1[known]) - 2.0 * (b2[known] / 3.0) ** 1.5)
    assert np.all(off <= error[known] + slope * groups["curves"]["b2_error"].to_numpy()[fold][known])
    assert jaxnh.labels(groups["codimension_two"]["kind"]).to_numpy()[point] == "cusp"
    for name in ("b1", "b2"):
        value, error = (groups["codimension_two"][each].to_numpy()[point] for each in (name, f"{name}_error"))
        assert abs(value) <= error < 1e-12
    np.testing.assert_allclose(groups["codimension_two"]["coefficients"].to_numpy()[point, 0], -1.0, rtol=1e-10)
