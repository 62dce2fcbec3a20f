"""Scenes of lanes with several parameters of their own, and what every analysis owes to those who read its dataset."""

from __future__ import annotations

import ast
import dataclasses
import functools

import jax
import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.base import LANE, OptionError, Setting, SweepLanes
from jaxnh.analyses.batch import Axis, iterate_units
from jaxnh.analyses.cascade import follow
from jaxnh.analyses.exponents import lyapunov
from jaxnh.analyses.periodic import period
from jaxnh.analyses.registry import ANALYSES
from jaxnh.analyses.trajectories import diagram, poincare
from jaxnh.maps.section import Section
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.free_particle import free_particle
from jaxnh.systems.particle import constant_speed, disturbed_speed
from tests.helpers import contract
from tests.helpers.batches import batch_of
from tests.helpers.kept_programs import QUICKLY_COMPILED, lanes_with_kept_programs
from tests.helpers.paths import ROOT

START = ((0.1, 0.1), (0.1, float(np.sqrt(0.99))))
B = np.linspace(5.6, 5.4, 64)
STEPS = SPLITTINGS["blanes_moan6"], 60
IN_A_BOX = ("transients", "manifolds", "edges", "homoclinic")  # whose starts need one
WITHOUT_A_CLOCK = ("homoclinic",)  # of such flows alone; its groups are looked at in test_homoclinic.py


def own(scene, **p):
    """The scene with further parameters of the lanes' own, the same in all."""
    return dataclasses.replace(scene, p={**scene.p, **{name: np.full(scene.count, v) for name, v in p.items()}})


@pytest.fixture(scope="module")
def twins():
    """A scene with the stiffness in its flow, and one whose lanes have it of their own."""
    inside = batch_of(constant_speed(a=0.45), START, B, *STEPS)
    return inside, own(batch_of(constant_speed(), START, B, *STEPS), a=0.45)


# ---- lanes with two parameters


@pytest.mark.slow  # the matrix has two axes
def test_a_parameter_of_the_lanes_is_one_of_the_flow(lanes, twins):
    """Strobe points and periods are the same where a comes from the lane, to the rounding of a chaotic few."""
    maps = [poincare.run(poincare.PoincareOptions(transient=4, strobes=4), scene, lanes) for scene in twins]
    np.testing.assert_allclose(maps[0]["x1"], maps[1]["x1"], rtol=1e-9)
    found = [period.run(period.PeriodOptions(max_period=4), scene, lanes)["period"].to_numpy() for scene in twins]
    np.testing.assert_array_equal(*found)


@pytest.mark.slow
def test_a_cascade_at_a_point_of_the_other_axis(lanes):
    """The doubling along b at a = 0.5 is that of the flow with this a: all that goes along the line keeps it."""
    inside = batch_of(constant_speed(), START, B, *STEPS)
    outside = own(batch_of(constant_speed(a=0.3), START, B, *STEPS), a=0.5)
    one, other = (follow.follow(scene, lanes, 1) for scene in (inside, outside))
    assert one.period == other.period == 1
    assert one.points[0].value == pytest.approx(5.5197, abs=2e-3)  # first row of table 1, with coarse steps
    assert other.points[0].value == pytest.approx(one.points[0].value, abs=1e-10)


def test_a_carried_state_keeps_the_other_parameters(lanes, twins):
    options = diagram.DiagramOptions(transient=2, strobes=2, start="up")
    one, other = (diagram.run(options, scene, lanes)["x1"] for scene in (s.take(slice(0, 40)) for s in twins))
    np.testing.assert_allclose(one, other, atol=1e-6)


def test_random_starts_go_by_the_place_along_the_first_axis():
    """Lanes at one place have the same states, whatever lanes they are computed with, in whatever order."""
    options = diagram.DiagramOptions(start="random", n_starts=3, seed=5)
    scene = batch_of(disturbed_speed(), START, B, *STEPS)
    ((x, _), _), p = diagram.random_starts(options, scene)
    x = x.reshape(-1, 3)
    place = np.array([40, 7, 7, 12])
    ((some, _), _), _ = diagram.random_starts(options, scene.take(place))
    np.testing.assert_array_equal(some.reshape(-1, 3), x[place])
    np.testing.assert_array_equal(p["b"].reshape(-1, 3), np.repeat(B[:, None], 3, axis=1))


def test_scene_along_its_first_axis():
    scene = own(batch_of(constant_speed(), START, B, *STEPS), a=0.4)
    there = scene.at_values(np.array([1.0, 2.0]))
    assert {name: values.tolist() for name, values in there.p.items()} == {"b": [1.0, 2.0], "a": [0.4, 0.4]}
    assert there.first_axis.values.tolist() == [1.0, 2.0]
    assert there.chart.host_points(there.start).shape == (2, 3)
    few = scene.take(np.array([3, 1]))
    assert few.first_axis.values.tolist() == few.p["b"].tolist() == B[[3, 1]].tolist()
    assert few.places.tolist() == [3, 1]
    with pytest.raises(ValueError, match="do not lie along one axis"):
        _ = dataclasses.replace(scene, axis=None).first_axis


# ---- what a dataset owes


@pytest.fixture(scope="module")
def few_lanes():
    """Small tiles and little optimisation, where words are looked at and no numbers."""
    return lanes_with_kept_programs(None, jax.devices()[:1], 8, QUICKLY_COMPILED)


@pytest.mark.parametrize("name", [name for name in ANALYSES if name not in WITHOUT_A_CLOCK])
def test_a_dataset_says_what_it_is(few_lanes, name):
    """Words and units everywhere, errors of what is there, and a status of lanes."""
    scene = dataclasses.replace(batch_of(constant_speed(), START, B[:3], *STEPS), chosen={"lyapunov": {"parts": 4}})

    def run(analysis, brief):
        given = {**brief, "box": {"x1": (-0.5, 0.5)}} if analysis.name in IN_A_BOX else brief
        options = analysis.options(**{k: v for k, v in given.items() if k in analysis.options.model_fields})
        needed = (
            ({need: run(ANALYSES[need], ANALYSES[need].brief) for need in analysis.options.needs},)
            if analysis.options.needs
            else ()
        )
        return analysis.run(options, scene, few_lanes, *needed)

    analysis = ANALYSES[name]
    data = left = run(
        analysis, {"strobes": 2, "levels": 1, "periods": 100 if name == "chaos01" else 16, **analysis.brief}
    )
    groups = {name: data}
    if analysis.whole:
        scene = own(scene, a=0.4)
        axes = (Axis("b", B[:3], "b"), Axis("a", np.array([0.4, 0.5]), "a"))[: 2 if name in ("curves", "atlas") else 1]
        whole = SweepLanes(axes, ((np.arange(3), scene),))
        groups = analysis.whole.run(analysis.options(**analysis.brief), whole, few_lanes, data)
        assert set(groups) == {name, *analysis.whole.brings}
        data = groups[name]
    for key, group in groups.items():
        contract.check(key, group)
    assert LANE in left.dims or not analysis.independent(
        analysis.options()
    )  # along a line some have lanes, others rows


@pytest.mark.slow
def test_words_without_a_clock(lanes):
    """Lengths are in units of time, and the dimension is that of the flow; with a clock, in periods and on the section."""
    still = Section(constant_speed(without=("forcing",)), "y1", 1, 0.0, "up").flow
    options = lyapunov.LyapunovOptions(transient=8, periods=16)
    for flow, unit, of in (
        (still, "units of time 2 pi/omega", "flow"),
        (constant_speed(), "periods", "Poincaré section"),
    ):
        scene = dataclasses.replace(batch_of(flow, START, [0.5], *STEPS), chosen={"lyapunov": {"parts": 4}})
        data = lyapunov.run(options, scene, lanes)
        assert data["averaging_periods"].attrs["counted_in"] == unit
        assert data["kaplan_yorke"].attrs["long_name"] == f"Kaplan–Yorke dimension of the {of}"


def test_a_parameter_called_omega_makes_no_clock():
    def rotor(omega=2.0):
        return {"rhs": lambda y, t: (omega * y[1], -omega * y[0]), "coordinates": ("x", "v")}

    still = constant_speed(without=("forcing",))
    assert iterate_units(still) == "units of time 2 pi/omega"
    assert iterate_units(jaxnh.Session(rotor, start={"x": 1.0, "v": 0.0}).experiment.flow()) == "units of time"


# ---- options that a sweep has no place for

LANES_B, LANES_A = (Axis(name, B, name) for name in "ba")
SHARED = Axis("d", B, "disturbance d", "shared")
CLOCKS = Axis("omega", np.array([1.0, 2.0]), "frequency omega", "shared")
START_X1 = Axis("x1", B, "position x1", "start")
REFUSED = {
    "exponents": ("lyapunov", {"exponents": 4}, (LANES_B,), "exponents", "must be at most 3, not 4"),
    "search, shared": ("doubling", {"search": True}, (SHARED, LANES_A), "search", "it looks beyond the sweep, and all lanes share d: the system may not exist there; leave it out"),
    "doubling, no clock": ("doubling", {}, (CLOCKS,), "", "doubling looks between the values of omega, and there sin(1.75855 t) and the disturbance sin t have no common period to strobe at; omega must be a ratio p/q of whole numbers with q up to 64; put a parameter such as b first"),
    "doubling, start": ("doubling", {}, (START_X1,), "", "doubling follows orbits along the first axis of the sweep, and x1 is a coordinate of the start state; put a parameter such as b first"),
    "down, start": ("diagram", {"start": "down"}, (START_X1,), "start", "there is nothing to carry along x1, a coordinate of the start state; put a parameter such as b first"),
    "random, start": ("diagram", {"start": "random"}, (LANES_B, START_X1), "start", "random starts and the axis x1 of start states exclude each other; leave one out"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_go_together(case):
    name, options, axes, key, message = REFUSED[case]
    setting = Setting(
        disturbed_speed(b=1.0), False, axes, "float64", lambda value: disturbed_speed(b=1.0, **{axes[0].name: value})
    )
    with pytest.raises(OptionError) as caught:
        ANALYSES[name].check(ANALYSES[name].options(**options), setting)
    assert (str(caught.value), caught.value.key) == (message, key)


@pytest.mark.parametrize(
    ("name", "options", "key"),
    [("poincare", {"transient": 0}, "transient"), ("diagram", {"transient": 0}, "transient"), ("diagram", {"phase": 0.5}, "phase")],
)  # fmt: skip
def test_what_a_section_has_no_place_for(name, options, key):
    analysis, flow = ANALYSES[name], free_particle(0.5, None, 1.0, ("forcing",))
    analysis.check(analysis.options(**options), Setting(flow, False, (LANES_B,), "float64", lambda value: flow))
    with pytest.raises(OptionError) as caught:
        analysis.check(analysis.options(**options), Setting(flow, True, (LANES_B,), "float64", lambda value: flow))
    assert caught.value.key == key


def test_defaults_go_with_everything_along_a_parameter():
    """No default is refused, but that those with random starts name no box, and transport nothing to follow.

    Three exponents are cut down to those that there are.
    """
    for flow in (constant_speed(), free_particle(0.5, None, 1.0)):
        setting = Setting(flow, False, (LANES_B, SHARED), "float64", functools.partial(_same, flow))
        for analysis in ANALYSES.values():
            # Branches and windows are along one axis, curves over two that lanes may differ in.
            along = {"branches": (LANES_B,), "windows": (LANES_B,)}
            along |= {"torus_branches": (LANES_B,)} | dict.fromkeys(("curves", "atlas"), (LANES_B, LANES_A))
            axes = along.get(analysis.name, setting.axes)
            if analysis.name not in (*IN_A_BOX, "transport"):
                analysis.check(analysis.options(), setting._replace(axes=axes))


def _same(flow, value):
    return flow


def test_records_of_lanes_have_types_that_a_checker_sees():
    """`State` is Any: a field of that type took a list of shares for states once, and every exponent was wrong."""
    untyped = [
        f"{path.name}: {kind.name}.{field.target.id}"
        for path in sorted((ROOT / "jaxnh" / "analyses").rglob("*.py"))
        for kind in ast.walk(ast.parse(path.read_text()))
        if isinstance(kind, ast.ClassDef)
        for field in kind.body
        if isinstance(field, ast.AnnAssign) and ast.unparse(field.annotation) in ("State", "Any")
    ]
    assert untyped == ["batch.py: LaneBatch.start"]
