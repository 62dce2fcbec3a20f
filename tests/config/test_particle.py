"""Configs of the paper's particle: what is left out, axes over parameters and start states, and what does not go together."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from jaxnh.engine.experiment import load
from jaxnh.exceptions import ConfigError, InputError
from jaxnh.maps.section import Crossing, Section
from jaxnh.systems.particle import constant_speed, disturbed_speed
from tests.flows.unforced_particle import write_config


@pytest.fixture
def config(tmp_path):
    return write_config(tmp_path)


# ---- what is left out, and contradictions


BAD = {
    "unknown effect": (["system.without=[focing]"], "system.without", "no the text 'focing' (did you mean forcing?)"),
    "disturbance": (["system.without=[disturbance]"], "system.without", "of disturbance another key decides: d: 0"),
    "coupling swept": (["system.without=[forcing, coupling]"], "system.without", "there is no b to sweep; sweep a"),
    "b missing": (["sweep={a: {values: [0.5, 0.6]}}", "system={constraint: constant_speed, without: [forcing]}"], "system.b", "a is swept, and b must be given"),
    "a given": (["sweep={a: {values: [0.5, 0.6]}}", "system.b=1.0"], "sweep.a", "a is swept; leave it out of system"),
    "b given": (["system.b=1.0"], "system.b", "b is swept; leave it out of system"),
    "b and coupling": (["sweep={a: {values: [1, 2]}}", "system={constraint: constant_speed, b: 1.0, without: [coupling]}"], "system", "the coupling is left out; leave b out as well"),
    "nothing swept": (["sweep={}"], "sweep", "name an axis and its values, one at least of b, a, c, omega, d, x1, x2, y1, y2"),
    "axis without values": (["sweep={b: null}"], "sweep", "name an axis and its values"),
    "free with d": (["system={constraint: free, d: 0.1}"], "system", "d does not go with free"),
    "section with a clock": (["system.without=[damping]", "section={value: 1.0}"], "section", "this scene has a clock"),
    "section elsewhere": (["section.coordinate=z"], "section.coordinate", "must be 'x1' or 'y1'"),
    "no transient": (["analyses.poincare.transient=0"], "analyses.poincare.transient", "must be at least 1: crossings are counted from the first after the start"),
    "phase": (["analyses.diagram.phase=0.5"], "analyses.diagram.phase", "there is no period to have a phase in"),
    "processed": (["accuracy={solver: processed6, steps: 40}"], "accuracy", "steps end one by one at crossings"),
    "float32": (["accuracy={target: 1e-3, precision: float32}"], "accuracy", "float32 goes with a strobe"),
    "y2": (["initial={y2: 0.3}"], "initial", "y2 follows from the constraint; leave it out"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_contradictions_are_refused(config, name):
    overrides, key, message = BAD[name]
    with pytest.raises(ConfigError) as caught:
        load(config, overrides)
    said = str(caught.value)
    assert len(said.splitlines()) == 1
    assert said.startswith(f"command line: {key}"), said
    assert message in said


def test_the_hash_of_what_is_left_out(config):
    """Absent is absent in any order; a default section written out is the same; each effect changes the hash."""
    plain = load(config).sha256
    assert load(config, ["system.without=[forcing, forcing]"]).sha256 == plain
    orders = [
        load(config, [f"system.without={order}"]).sha256 for order in ("[damping, forcing]", "[forcing, damping]")
    ]
    assert orders[0] == orders[1] != plain
    assert load(config, ["section.direction=down"]).sha256 != plain
    clocked = ["section=null", "system.without=null"]
    assert load(config, clocked).sha256 == load(config, ["section=null", "system.without=[]"]).sha256
    assert load(config, ["section=null"]).sha256 == load(config, ["section={coordinate: x1}"]).sha256


def test_damping_may_be_left_out_for_free(config):
    """Under a constraint it is in no equation: the system is the very same."""
    one, other = (load(config, [f"system.without={names}"]).flow() for names in ("[forcing]", "[forcing, damping]"))
    assert one == other


# ---- axes

FORCED = """\
system:
  constraint: disturbed_speed
sweep:
  d: {values: [0.1, 0.2]}
  b: {start: 5.0, stop: 6.0, count: 3}
  x1: {values: [0.0, 0.5, 1.0, 1.5]}
analyses:
  lyapunov: {}
"""


def plane(folder, *edits):
    """FORCED with pieces of it replaced, each of which must be there once."""
    text = FORCED
    for old, new in edits:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = folder / "plane.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_axes_keep_their_order_and_kinds(tmp_path):
    experiment = load(plane(tmp_path))
    named = [(axis.name, axis.kind, axis.long_name) for axis in experiment.axes]
    assert named == [("d", "shared", "disturbance d"), ("b", "lane", "coupling b"), ("x1", "start", "position x1")]
    assert [axis.values.tolist() for axis in experiment.axes] == [[0.1, 0.2], [5.0, 5.5, 6.0], [0.0, 0.5, 1.0, 1.5]]
    assert all(axis.values.dtype == np.float64 for axis in experiment.axes)
    assert experiment.coordinates == ("x1", "x2", "y1")


KINDS = {
    "constant_speed": {"b": "lane", "a": "lane", "c": "shared", "omega": "shared", "x1": "start", "x2": "start", "y1": "start"},
    "disturbed_speed": {"b": "lane", "a": "lane", "c": "shared", "omega": "shared", "d": "shared", "x1": "start", "x2": "start", "y1": "start"},
    "free": {"b": "lane", "a": "lane", "omega": "shared", "x1": "start", "x2": "start", "y1": "start", "y2": "start"},
}  # fmt: skip


@pytest.mark.parametrize("constraint", KINDS)
def test_everything_of_a_particle_can_be_swept(tmp_path, constraint):
    """One axis after the other: each has its kind, and its first value is the flow's or the start's."""
    value = {"d": 0.25, "omega": 0.5, "y2": 0.25}
    for name, kind in KINDS[constraint].items():
        first = value.get(name, 0.75)
        system = f"{{constraint: {constraint}{'' if name == 'b' else ', b: 5.0'}}}"
        text = f"system: {system}\nsweep: {{{name}: {{values: [{first}, 0.5]}}}}\nanalyses: {{poincare: {{}}}}\n"
        path = tmp_path / "one.yaml"
        path.write_text(text)
        experiment = load(path)
        (axis,) = experiment.axes
        assert (axis.name, axis.kind) == (name, kind)
        if kind != "start":
            assert experiment.flow().parameters[name] == first


def test_shared_axes_change_the_flow(tmp_path):
    experiment = load(plane(tmp_path))
    assert experiment.flow() == disturbed_speed(d=0.1, b=5.0)
    assert experiment.flow({"d": 0.2}) == disturbed_speed(d=0.2, b=5.0)
    with pytest.raises(InputError, match="y does not go with disturbed_speed"):
        experiment.flow({"y": 0.2})


def test_no_disturbance_is_no_part_of_a_program_unless_it_is_an_axis(tmp_path):
    still = plane(tmp_path, ("disturbed_speed", "disturbed_speed\n  d: 0.0"), ("  d: {values: [0.1, 0.2]}\n", ""))
    assert load(still).flow() == constant_speed(b=5.0)
    assert load(plane(tmp_path, ("[0.1, 0.2]", "[0.0, 0.2]"))).flow() == disturbed_speed(d=0.0, b=5.0)


def test_start_states_of_lanes(tmp_path):
    """Coordinates of axes take the place of those of `initial`; y2 follows from the constraint in each lane."""
    experiment = load(plane(tmp_path, ("  d: {values: [0.1, 0.2]}", "  c: {values: [1.0, 4.0]}")))
    given = {"x1": np.array([0.0, 0.5]), "x2": np.array([0.6, -1.2])}
    (x1, y1), (n1, n2) = experiment.start(given, 2, {"c": 4.0})
    assert x1.tolist() == [0.0, 0.5]
    assert y1.tolist() == [0.1, 0.1]
    np.testing.assert_allclose(n1, [0.3, -0.6], rtol=1e-15)
    np.testing.assert_allclose(np.hypot(n1, n2), 1.0, rtol=1e-15)
    assert {leaf.dtype for leaf in jax.tree.leaves(experiment.start({}, 5))} == {np.dtype(float)}


def test_start_without_a_clock_is_on_its_way_to_the_section(config):
    experiment = load(config, ["sweep.x1={values: [0.0, 0.1]}"])
    section, start = experiment.dynamics(), experiment.start({"x1": np.array([0.0, 0.1])}, 2)
    assert isinstance(section, Section)
    assert (section.coordinate, section.number, section.value, section.direction) == ("y1", 1, 0.0, "up")
    assert section.flow == experiment.flow() == constant_speed(b=0.2, without=["forcing"])
    assert isinstance(start, Crossing)
    assert start.t.tolist() == start.reason.tolist() == [0.0, 0.0]
    assert start.state[0][0].tolist() == [0.0, 0.1]


def test_a_section_that_nothing_needs_is_left_out(config):
    """A spectrum is an average over time; what is found at crossings has the default section where none is given."""
    for analysis, sectioned in (("lyapunov", False), ("diagram", True)):
        experiment = load(config, ["section=null", f"analyses={{{analysis}: null}}"])
        assert isinstance(experiment.dynamics(), Section) == sectioned
        assert isinstance(experiment.start({}, 1), Crossing) == sectioned


def test_free_start_has_four_coordinates(tmp_path):
    path = plane(tmp_path, ("disturbed_speed", "free"), ("  d: {values: [0.1, 0.2]}", "  y2: {values: [0.3, 0.4]}"))
    experiment = load(path)
    assert experiment.coordinates == ("x1", "x2", "y1", "y2")
    start = experiment.start({"y2": np.array([0.3, 0.4])}, 2)
    assert [component.tolist() for component in (*start.q, *start.v)] == [[0.1] * 2, [0.1] * 2, [0.1] * 2, [0.3, 0.4]]


REFUSED = {
    "y2 by the constraint": (("  b: {", "  y2: {"), "FILE:5: sweep.y2: y2 follows from the constraint, and cannot be swept"),
    "no disturbance": (("disturbed_speed", "constant_speed"), "FILE:4: sweep.d: d does not go with constant_speed; what can be swept is b, a, c, omega, x1, x2, y1"),
    "no constraint": (("disturbed_speed", "free"), "FILE:4: sweep.d: d does not go with free; what can be swept is b, a, omega, x1, x2, y1, y2"),
    "unknown axis": (("  b: {", "  beta: {"), "FILE:5: sweep.beta: unknown key; known keys are b, a, c, omega, d, x1, x2, y1, y2"),
    "axis and parameter": (("disturbed_speed", "disturbed_speed\n  d: 0.3"), "FILE:3: system.d: d is swept; leave it out of system"),
    "axis and start": (("sweep:", "initial: {x1: 0.3}\nsweep:"), "FILE:3: initial.x1: x1 is swept; leave it out of initial"),
    "no coupling": (("  b: {start: 5.0, stop: 6.0, count: 3}\n", ""), "FILE:4: sweep.d: d and x1 are swept, and b must be given (Coupling b)"),
    "coupling left out": (("disturbed_speed", "disturbed_speed\n  without: [coupling]"), "FILE:6: sweep.b: the coupling is left out, and there is no b to sweep; sweep a"),
    "frequency of no forcing": (("disturbed_speed\nsweep:", "disturbed_speed\n  without: [forcing]\nsweep:\n  omega: {values: [1, 2]}"), "FILE:5: sweep.omega: the forcing is left out, and there is no omega to sweep"),
    "no speed": (("[0.1, 0.2]", "[0.1, -1.0]"), "FILE:4: sweep.d: the speed vanishes: |d| must be below c, and d is -1, c is 1"),
    "no speed at one c": (("  b: {", "  c: {values: [1, 0.15]}\n  b: {"), "FILE:4: sweep.d: the speed vanishes: |d| must be below c, and d is 0.2, c is 0.15"),
    "c below the default d": (("  d: {values: [0.1, 0.2]}", "  c: {values: [1, 0.05]}"), "FILE:4: sweep.c: the speed vanishes: |d| must be below c, and d is 0.1, c is 0.05"),
    "c of zero": (("  d: {values: [0.1, 0.2]}", "  c: {values: [1, 0]}"), "FILE:4: sweep.c: must be above 0, not 0"),
    "omega below zero": (("  d: {values: [0.1, 0.2]}", "  omega: {values: [1, -1]}"), "FILE:4: sweep.omega: must be above 0, not -1"),
    "no clock at one d": (("disturbed_speed\nsweep:\n  d: {values: [0.1, 0.2]}", "disturbed_speed\n  without: [forcing]\nsweep:\n  d: {start: -0.1, stop: 0.1, count: 3}"), "FILE:5: sweep.d: the forcing is left out, and there is no clock where d is 0; leave 0 out of the axis"),
    "no common period": (("  d: {values: [0.1, 0.2]}", "  omega: {values: [0.5, 0.123456789]}"), "FILE:4: sweep.omega: sin(0.123457 t) and the disturbance sin t have no common period to strobe at; omega must be a ratio p/q of whole numbers with q up to 64"),
    "no common period at one d": (("disturbed_speed", "disturbed_speed\n  omega: 0.123456789"), "FILE:3: system.omega: sin(0.123457 t) and the disturbance sin t have no common period to strobe at; omega must be a ratio p/q of whole numbers with q up to 64"),
    "too fast": (("  b: {", "  x2: {values: [0.1, -1.5]}\n  b: {"), "FILE:5: sweep.x2: the speed at t = 0 is 1, and |x2| cannot be above it; x2 is -1.5"),
    "too fast at one c": (("  d: {values: [0.1, 0.2]}", "  c: {values: [1, 0.25]}\n  x2: {values: [0.1, 0.6]}"), "FILE:5: sweep.x2: the speed at t = 0 is 0.5, and |x2| cannot be above it; x2 is 0.6"),
    "search along d": (("lyapunov: {}", "doubling: {search: true}"), "FILE:8: analyses.doubling.search: it looks beyond the sweep, and all lanes share d: the system may not exist there; leave it out"),
    "doubling along omega": (("  d: {values: [0.1, 0.2]}", "  omega: {values: [1, 2]}"), ("lyapunov: {}", "doubling: {}"), "FILE:8: analyses.doubling: doubling looks between the values of omega, and there sin(1.75855 t) and the disturbance sin t have no common period to strobe at; omega must be a ratio p/q of whole numbers with q up to 64; put a parameter such as b first"),
    "doubling along x1": (("  d: {values: [0.1, 0.2]}", "  x2: {values: [0.1, 0.2]}"), ("lyapunov: {}", "doubling: {}"), "FILE:8: analyses.doubling: doubling follows orbits along the first axis of the sweep, and x2 is a coordinate of the start state; put a parameter such as b first"),
    "carried along x2": (("  d: {values: [0.1, 0.2]}", "  x2: {values: [0.1, 0.2]}"), ("lyapunov: {}", "diagram: {start: down}"), "FILE:8: analyses.diagram.start: there is nothing to carry along x2, a coordinate of the start state; put a parameter such as b first"),
    "two kinds of starts": (("lyapunov: {}", "diagram: {start: random}"), "FILE:8: analyses.diagram.start: random starts and the axis x1 of start states exclude each other; leave one out"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_axes_that_do_not_go_together(tmp_path, name):
    *edits, message = REFUSED[name]
    path = plane(tmp_path, *edits)
    with pytest.raises(ConfigError) as caught:
        load(path)
    assert str(caught.value).replace(str(path), "FILE") == message


def test_one_value_of_d_keeps_the_strobe_of_any(tmp_path):
    """Where there is a forcing, d = 0 is a value like others, and omega alone decides the period there."""
    experiment = load(
        plane(tmp_path, ("[0.1, 0.2]", "[0.0, 0.2]"), ("disturbed_speed", "disturbed_speed\n  omega: 0.5"))
    )
    assert experiment.flow({"d": 0.0}).period == experiment.flow({"d": 0.2}).period == 4 * np.pi


def test_axes_may_be_given_by_an_override(tmp_path):
    """In the order in which they come: those of the file, then those of the command line."""
    experiment = load(plane(tmp_path), ["sweep.y1={values: [0.3]}", "sweep.b.count=5"])
    assert [(axis.name, len(axis.values)) for axis in experiment.axes] == [("d", 2), ("b", 5), ("x1", 4), ("y1", 1)]
    again = load(plane(tmp_path, *[(FORCED, experiment.text)]))
    assert again.sha256 == experiment.sha256
