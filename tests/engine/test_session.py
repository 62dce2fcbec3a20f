"""A session: any analysis on any lanes in memory, what it refuses, and what it keeps."""

from __future__ import annotations

import jax
import numpy as np
import pytest
import xarray as xr

import jaxnh
from jaxnh.analyses.trajectories.poincare import PoincareOptions
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.session import Session
from tests.flows.double_well import DOUBLE_WELL
from tests.helpers.experiments import content
from tests.helpers.kept_programs import session_of

pytestmark = pytest.mark.usefixtures("calibrate_once")

CONTENT = {
    "title": "A session",
    "system": {"constraint": "disturbed_speed", "d": 0.1},
    "sweep": {"b": {"start": 5.2, "stop": 5.6, "count": 5}},
    "accuracy": {"solver": "blanes_moan6", "steps": 40},
    "analyses": {"poincare": {"transient": 20, "strobes": 3}},
}
UNFORCED = {
    "system": {"constraint": "constant_speed", "without": ["forcing"]},
    "sweep": {"b": {"start": 0.8, "stop": 0.9, "count": 3}},
    "accuracy": {"solver": "blanes_moan6", "steps": 40},
    "analyses": {"diagram": {"transient": 2, "strobes": 2}},
}


def identical(one, other):
    """To the bit, attributes and all."""
    xr.testing.assert_identical(one, other)
    for name, item in one.variables.items():
        assert item.values.tobytes() == other.variables[name].values.tobytes(), name


def equal(one, other):
    """The lanes to the bit; how many there are of a kind is another matter."""
    identical(one.drop_attrs(deep=False), other.drop_attrs(deep=False))


@pytest.fixture(scope="module")
def session():
    return session_of(Experiment.from_dict(CONTENT))


@pytest.fixture(scope="module")
def whole(session):
    """Every lane of the experiment's own."""
    return session.run("poincare")


def test_own_lanes(session, whole):
    """The experiment's axes and options where nothing else is said."""
    assert dict(whole.sizes) == {"b": 5, "strobe": 3}
    np.testing.assert_array_equal(whole["b"], np.linspace(5.2, 5.6, 5))
    identical(session.tree()["poincare"].to_dataset(), whole)
    assert (session.plan.solver.name, session.plan.steps) == ("blanes_moan6", 40)
    assert session.tree().attrs["error_estimate"] == session.plan.error_estimate


def test_options(session, whole):
    """As a mapping or as the model; what is not named has its default."""
    more = session.run("poincare", {"transient": 20, "strobes": 5})
    np.testing.assert_array_equal(more["x1"].isel(strobe=slice(3)), whole["x1"])
    identical(session.run("poincare", PoincareOptions(transient=20, strobes=5)), more)


def test_other_values_of_an_axis(session, whole):
    """The lanes at the same values are the same, wherever they stand."""
    b = whole["b"].values[[4, 1]]
    equal(session.run("poincare", b=b), whole.isel(b=[4, 1]))
    equal(session.run("poincare", b=list(map(float, b))), whole.isel(b=[4, 1]))


def test_fixed_value_is_no_dimension(session, whole):
    """It stays as a coordinate."""
    found = session.run("poincare", b=whole["b"].values[2])
    assert found["x1"].dims == ("strobe",)
    assert float(found["b"]) == whole["b"].values[2]
    np.testing.assert_array_equal(found["x1"], whole["x1"][2])


@pytest.mark.parametrize(
    ("axes", "sizes"),
    [
        pytest.param({"d": [0.05, 0.1]}, {"b": 5, "d": 2}, marks=pytest.mark.slow),
        ({"x1": [0.1, 0.3]}, {"b": 5, "start_x1": 2}),
        pytest.param({"a": [0.5, 0.6]}, {"b": 5, "a": 2}, marks=pytest.mark.slow),
        pytest.param({"c": [0.9, 1.0], "x1": 0.1}, {"b": 5, "c": 2}, marks=pytest.mark.slow),
    ],
)
def test_new_axes(session, whole, axes, sizes):
    """Behind those of the experiment: parameters of lanes, shared ones and starts; the old lanes are among the new."""
    found = session.run("poincare", **axes)
    assert dict(found.sizes) == {**sizes, "strobe": 3}
    assert found.attrs["axes"].split() == ["b", *("start_x1" if name == "x1" else name for name in axes)]
    name = next(iter(axes))
    place = axes[name].index({"d": 0.1, "x1": 0.1, "a": 0.5, "c": 1.0}[name])
    for key in ("x1", "x2", "y1", "y2"):
        ours = found[key].isel({[*sizes][1]: place})
        np.testing.assert_array_equal(ours.values, whole[key].values)


def test_analysis_that_needs_others():
    """They run with it, and it alone is given back; those the experiment asks for have its options."""
    analyses = {
        "lyapunov": {"transient": 8, "periods": 16, "exponents": 1},
        "period": {"max_period": 4, "transient": 16},
        "chaos01": {"transient": 4, "periods": 100},
        "verdict": {},
    }
    session = session_of(Experiment.from_dict({**CONTENT, "analyses": analyses}))
    found = session.run("verdict")
    assert list(found.data_vars) == ["kind", "status", "phase_volume", "recurrence_lag", "unsteadiness"]
    identical(found, session.tree()["verdict"].to_dataset())


def test_calibration_is_kept_within_its_ends():
    """A call within the experiment's sweep takes its plan; one beyond it is calibrated for itself, and once."""
    said = []
    experiment = Experiment.from_dict({**CONTENT, "accuracy": {"target": 1e-4}})
    session = Session(experiment, progress=lambda *told: said.append(told))

    def calibrations():
        return sum(label.startswith("accuracy") and not done for label, done, _ in said)

    session.run("poincare", b=[5.3, 5.4])
    assert calibrations() == 1
    plan = session.plan
    session.run("poincare")
    assert (calibrations(), session.plan) == (1, plan)
    session.run("poincare", b=[0.3, 0.4])
    session.run("poincare", b=[0.4])
    assert calibrations() == 2
    session.run("poincare", d=[0.1])
    assert calibrations() == 3
    assert session.plan == plan


@pytest.mark.slow
def test_a_plan_in_time_does_not_serve_returns():
    """A spectrum of a flow without a clock needs no section; a diagram has one, whose steps serve both."""
    system = {"constraint": "constant_speed", "a": 0.5, "c": 1.0, "without": ["forcing"]}
    content = {"system": system, "sweep": {"b": {"values": [0.2, 0.3]}}, "accuracy": UNFORCED["accuracy"]}
    said = []
    options = {"transient": 1, "periods": 16, "exponents": 1}
    session = Session(
        Experiment.from_dict({**content, "analyses": {"lyapunov": options}}), progress=lambda *told: said.append(told)
    )
    for analysis, given, calibrations in (
        ("lyapunov", options, 1),
        ("diagram", {"transient": 1, "strobes": 2}, 2),
        ("lyapunov", options, 2),
    ):
        session.run(analysis, given)
        assert sum(label.startswith("accuracy") and not done for label, done, _ in said) == calibrations


@pytest.mark.slow  # test_plan has pieces on one device beside two
def test_one_device(whole):
    """The lanes do not know on how many devices they are."""
    session = Session(Experiment.from_dict(CONTENT), devices=jax.devices()[:1])
    identical(session.run("poincare"), whole)


@pytest.mark.slow
def test_sections():
    """Without a clock lanes are seen on the section."""
    session = session_of(Experiment.from_dict(UNFORCED))
    alone = session.run("diagram")
    found = session.run("diagram", x2=[0.1, 0.3])
    assert dict(found.sizes) == {"b": 3, "start_x2": 2, "strobe": 2}
    assert found.attrs["section"] == alone.attrs["section"]
    np.testing.assert_array_equal(found["x1"].isel(start_x2=0), alone["x1"])


def test_the_analysis_that_has_no_section_is_the_one_asked_for():
    """`verdict` needs `period`, and both look at a section."""

    def turning(w=1.0):
        def rhs(y, t):
            return w * y[1], -w * y[0]

        return {"rhs": rhs, "coordinates": ("x", "y")}

    with pytest.raises(jaxnh.InputError, match=r"analyses\.verdict: the system has no period, and verdict looks at it"):
        jaxnh.Session(turning, start={"x": 1.0}).run(jaxnh.Verdict())


@pytest.mark.slow
def test_own_systems(tmp_path, monkeypatch):
    """A user's system has its parameters and coordinates as axes; its programs are those of test_two_axes."""
    monkeypatch.setattr("jaxnh.engine.accuracy.cost_model.quickest_form", lambda solver, *_: solver)
    (tmp_path / "own.py").write_text(DOUBLE_WELL)
    system = {"file": str(tmp_path / "own.py"), "damping": 0.2}
    sweep = {"drive": {"values": [0.3, 0.35, 0.4]}}
    own = content(sweep, system=system, accuracy={"solver": "tsit5", "steps": 60}, initial={"x": 0.5})
    session = session_of(Experiment.from_dict(own))
    alone = session.run("poincare", {"transient": 4, "strobes": 2})
    found = session.run("poincare", {"transient": 4, "strobes": 2}, damping=[0.2, 0.3], x=[0.5])
    assert found["x"].dims == ("drive", "damping", "start_x", "strobe")
    np.testing.assert_array_equal(found["x"].isel(damping=0, start_x=0), alone["x"])


REFUSED = {
    "analysis": (("poincaree",), {}, "there is no analysis poincaree; known are "),
    "option": (("poincare", {"strobe": 3}), {}, "analyses.poincare.strobe: unknown key"),
    "option's value": (("poincare", {"strobes": 0}), {}, "analyses.poincare.strobes: "),
    "option's type": (("poincare", {"strobes": "many"}), {}, "analyses.poincare.strobes: "),
    "options together": (("diagram", {"n_starts": 3}), {}, "diagram"),
    "name": (("poincare",), {"e": [1.0]}, "sweep.e: unknown key"),
    "derived coordinate": (("poincare",), {"y2": [0.5]}, "sweep.y2: y2 follows from the constraint"),
    "two dimensions": (("poincare",), {"b": [[1.0, 2.0]]}, "sweep.b.values"),
    "no values": (("poincare",), {"b": []}, "sweep.b.values"),
    "not a number": (("poincare",), {"b": [np.nan]}, "sweep.b.values"),
    "text": (("poincare",), {"b": "many"}, "sweep.b.values"),
    "speed vanishes": (("poincare",), {"d": [0.1, 1.5]}, "the speed vanishes"),
    "no common period": (("poincare",), {"omega": [1.2345678]}, "have no common period"),
    "negative c": (("poincare",), {"c": [-1.0]}, "must be above 0"),
    "x2 above the speed": (("poincare",), {"x2": [1.5]}, "the speed at t = 0 is 1"),
    "random and starts": (
        ("diagram", {"start": "random"}),
        {"x1": [0.1]},
        "analyses.diagram.start: random starts and the axis x1",
    ),
}


@pytest.mark.parametrize(("arguments", "axes", "said"), REFUSED.values(), ids=REFUSED)
def test_refused(session, arguments, axes, said):
    """One line that names what is wrong."""
    with pytest.raises(jaxnh.InputError) as caught:
        session.run(*arguments, **axes)
    assert said in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("first", "analysis", "options"),
    [("x1", "doubling", {"levels": 1}), ("x1", "diagram", {"start": "up"})],
)
def test_first_axis_that_nothing_can_be_carried_along(first, analysis, options):
    """With advice which axis to put first."""
    content = {
        **CONTENT,
        "system": {"constraint": "disturbed_speed", "b": 5.3},
        "sweep": {first: {"values": [0.1, 0.2]}},
    }
    session = session_of(Experiment.from_dict(content))
    with pytest.raises(
        jaxnh.InputError,
        match=rf"analyses\.{analysis}.* x1.* a coordinate of the start state; put a parameter such as b first$",
    ):
        session.run(analysis, options)


def test_clock_that_is_not_there():
    session = session_of(Experiment.from_dict(UNFORCED))
    with pytest.raises(jaxnh.InputError, match=r"analyses\.diagram\.phase: there is no period"):
        session.run("diagram", {"transient": 2, "phase": 0.5})


@pytest.mark.slow
def test_accuracy_out_of_reach():
    """Lanes so sensitive that no arithmetic of sixteen digits has the accuracy."""
    system = {"constraint": "constant_speed", "omega": 0.125}
    content = {**CONTENT, "system": system, "sweep": {"b": {"values": [5.9, 6.0]}}, "accuracy": {"target": 1e-13}}
    with pytest.raises(jaxnh.AccuracyError, match=r"accuracy\.target: no solver has an error of one period of 1e-13"):
        session_of(Experiment.from_dict(content)).run("poincare")


def halved(a=0.5, b=0.0):
    """A map without any bifurcation."""
    return {"map": lambda y: (a * y[0] + b,), "coordinates": ("x",)}


def test_warnings_of_a_result_are_warnings():
    """A search that finds nothing says what it looked at, and not in an attribute alone."""
    session = jaxnh.Session(halved, {"x": 0.1})
    with pytest.warns(jaxnh.JaxnhWarning, match="looked at branches over a of orbits of period 2 at most"):
        data = session.run(jaxnh.Curves(transient=64), a=[0.4, 0.5, 0.6], b=[0.0, 0.1])
    assert data.sizes["curve"] == 0
