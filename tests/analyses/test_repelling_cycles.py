"""Cycles that repel, from random starts and beside lanes that all rest, against r′ = μr + r³ − r⁵, θ′ = 1 in closed form.

Its cycles are r² = (1 ± √(1 + 4μ))/2: from μ = −1/4 on one repels and the other one attracts, up to μ = 0.
"""

from __future__ import annotations

import inspect
from dataclasses import replace

import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.continuation.motion_units import motion_unit, search_unit, sizes_in_motion
from jaxnh.analyses.continuation.seeds import random_wave
from jaxnh.analyses.periodic.attractor_survey import periods_in_motion, survey_from_start
from jaxnh.analyses.random_starts import random_start_batch
from jaxnh.analyses.section_points import points_of_starts
from jaxnh.maps.section import Section, begin
from jaxnh.solvers import verner9
from jaxnh.systems.first_order import first_order
from tests.helpers.batches import batch_of
from tests.helpers.kept_programs import session_of

BOX = {"x": (0.2, 1.2)}


def hard(mu=-0.1):
    def rhs(state, t):
        x, v = state
        square = x * x + v * v
        growth = mu + square - square * square
        return growth * x - v, growth * v + x

    return {"rhs": rhs, "coordinates": ("x", "v")}


HARD = inspect.getsource(hard).replace("def hard", "def system")


def radii(mu):
    """Radii of the cycles that repel and attract."""
    return [np.sqrt(0.5 + side * 0.5 * np.sqrt(1.0 + 4.0 * mu)) for side in (-1, 1)]


def lanes_from(x, values=(-0.2, -0.1)):
    """A batch of lanes on their way to v = 0 upward, where x is the radius."""
    section = Section(first_order(hard, {"mu": values[0]}), "v", 1, 0.0, "up")
    start = begin(section, section.flow.start({"x": x, "v": 0.0}))
    return batch_of(section, start, values, verner9, 6, name="mu")


def test_random_starts_find_cycles_that_repel(lanes):
    """At μ = −0.2 motions leave the smaller cycle by a factor of 4.7 a turn: after two turns none is near it any more."""
    seeds = random_wave(lanes_from(1.0), lanes, 8, 0, BOX, 1, np.ones(1), 32)
    for mu in (-0.2, -0.1):
        found = sorted({round(abs(float(seed.points[0, 0])), 6) for seed in seeds if seed.value == mu})
        # Newton ends within 1e-9 of the map's orbits, whose errors are below 1e-8 in six steps of order nine.
        assert np.abs(np.array(found) - radii(mu)).max() < 1e-6


def test_starts_of_newton_on_a_section(lanes):
    """First crossings, and the points of the section with the coordinates that are drawn."""
    many, drawn = random_start_batch(lanes_from(1.0), 4, 0, BOX)
    first, own = np.split(points_of_starts(many, lanes), 2)
    np.testing.assert_array_equal(own[:, 0], drawn["x"])
    away = np.abs(first[:, 0] ** 2 - 0.5) - np.abs(own[:, 0] ** 2 - 0.5)
    assert np.all(first[:, 0] > 0.0)
    assert np.abs(away).max() > 1e-2  # a whole turn later


@pytest.mark.parametrize("transient", [8, 256])
def test_sizes_where_all_lanes_rest(lanes, transient):
    """From x = 0.1 all lanes come to rest: sizes are those of the box, and not of what is left of a motion."""
    batch = lanes_from(0.1)
    survey = survey_from_start(batch, lanes, 1, "branches", transient)
    period = periods_in_motion(batch, lanes, survey)
    sizes = sizes_in_motion(batch, lanes, survey)
    assert not period.any()
    assert motion_unit([batch], lanes, period, sizes, BOX) == pytest.approx(1.2)
    assert motion_unit([batch], lanes, period, sizes, {}) == pytest.approx(0.1)
    assert motion_unit([batch], lanes, period[:0], sizes[:0], BOX) == pytest.approx(1.2)  # of equilibria alone
    given = replace(batch, given_sizes={"x": 3.0})
    assert motion_unit([given], lanes, period, sizes, BOX) == pytest.approx(3.0)
    assert search_unit(given, lanes, np.ones(1), {"x": (0.2, 7.0)}) == pytest.approx(3.0)


def test_sizes_of_lanes_that_move(lanes):
    """From x = 1 lanes settle on the cycle that attracts; its size counts, and the box where orbits are sought."""
    batch = lanes_from(1.0)
    survey = survey_from_start(batch, lanes, 1, "branches", 256)
    period = periods_in_motion(batch, lanes, survey)
    unit = motion_unit([batch], lanes, period, sizes_in_motion(batch, lanes, survey), {"x": (0.2, 30.0)})
    assert unit == pytest.approx(np.median([radii(mu)[1] for mu in (-0.2, -0.1)]), rel=1e-6)
    assert search_unit(batch, lanes, unit, {"x": (0.2, 30.0)}) == pytest.approx(30.0)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["shooting", "collocation"])
def test_branches_where_all_lanes_rest(tmp_path, method):
    """Both branches, from lanes that are all in the equilibrium."""
    (tmp_path / "hard.py").write_text(HARD)
    (tmp_path / "hard.yaml").write_text(
        "system: {file: hard.py}\ninitial: {x: 0.1, v: 0.0}\nsweep: {mu: {start: -0.2, stop: -0.05, count: 4}}\n"
        "section: {coordinate: v, value: 0.0, direction: up}\naccuracy: {target: 1.0e-8}\n"
        f"analyses: {{branches: {{max_period: 1, n_starts: 8, n_values: 2, method: {method}, box: {{x: [0.2, 1.2]}}}}}}\n"
    )
    branches = session_of(jaxnh.load(tmp_path / "hard.yaml")).tree()["branches"]
    values, radius = (branches[name].to_numpy() for name in ("mu", "x"))
    known = [np.isfinite(row) for row in values]
    assert len(known) == 2
    sides = set()
    for place, row in enumerate(known):
        mu, x = (each[place].ravel()[: row.size][row] for each in (values, radius))
        gaps = [np.abs(np.abs(x) - each).max() for each in radii(mu)]
        sides.add(int(np.argmin(gaps)))
        assert min(gaps) < 1e-7
        assert (mu.min(), mu.max()) == (-0.2, -0.05)
    assert sides == {0, 1}


@pytest.mark.parametrize(("steps", "wrong"), [(24, False), (2, True)])
def test_steps_that_are_too_long_are_seen_on_branches(tmp_path, steps, wrong):
    """Against the closed form: two steps a turn are too few for r⁵, and the warning says so."""
    timed = HARD.replace('"coordinates"', '"time_unit": 6.283185307179586, "coordinates"')
    (tmp_path / "hard.py").write_text(timed)
    (tmp_path / "hard.yaml").write_text(
        "system: {file: hard.py}\ninitial: {x: 1.0, v: 0.0}\n"
        "sweep: {mu: {start: -0.1, stop: -0.05, count: 3}}\nsection: {coordinate: v, value: 0.0, direction: up}\n"
        f"accuracy: {{solver: dopri8, steps: {steps}}}\nanalyses: {{branches: {{max_period: 1, transient: 64}}}}\n"
    )
    branches = session_of(jaxnh.load(tmp_path / "hard.yaml")).tree()["branches"].to_dataset()
    mu, x = (branches[name].to_numpy().ravel() for name in ("mu", "x"))
    missed = np.nanmax(np.abs(np.abs(x) - radii(mu)[1]))
    error = float(branches["step_change"].max())
    assert missed < 10.0 * error
    assert ("steps are too long on 1 of 1" in branches.attrs.get("warnings", "")) == wrong == (error > 1e-2)
