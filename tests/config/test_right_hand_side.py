"""A user's right-hand side in a config: its clock, its section, its faults, and what runs give of known flows."""

from __future__ import annotations

import numpy as np
import pytest

import jaxnh
from jaxnh.exceptions import AccuracyError, ConfigError, InputError
from jaxnh.maps.section import Section, plot_plane
from tests.helpers.kept_programs import session_of
from tests.helpers.paths import ROOT

LORENZ = (ROOT / "configs/flows/lorenz.py").read_text()
CONFIG = """system: {file: own.py, sigma: 10.0}
initial: {x: 1.0, y: 1.0, z: 20.0}
sweep: {rho: {values: [28.0, 60.0]}}
section: {normal: {x: 1.0, y: -1.0}, value: 0.0, direction: up}
accuracy: {solver: dopri8, steps: 96}
analyses:
  lyapunov: {transient: 16, periods: 256, exponents: 3}
"""
CLOCKED = """import jax.numpy as jnp

def system(force=1.0, omega=1.0):
    def rhs(y, t):
        return y[1], force * jnp.cos(omega * t) - y[0]

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / omega}
"""


def write(folder, config=CONFIG, text=LORENZ):
    (folder / "own.py").write_text(text)
    (folder / "own.yaml").write_text(config)
    return folder / "own.yaml"


def test_system_and_section(tmp_path):
    experiment = jaxnh.load(write(tmp_path))
    section, flow = experiment.dynamics(), experiment.flow()
    assert isinstance(section, Section)
    assert section.flow == flow
    assert (flow.autonomous, section.chart.dimension, flow.exponents, flow.period) == (True, 2, 3, 1.0)
    assert section.description == "x - y = 0, up"
    assert plot_plane(section) == ("y", "z")
    assert dict(flow.parameters) == {"sigma": 10.0, "rho": 28.0, "beta": 8 / 3}
    assert flow.roles.of_lanes == ("rho",)
    assert [float(x[0]) for x in experiment.start({}, 1).state.y] == [1.0, 1.0, 20.0]


def test_one_coordinate_without_a_clock_has_no_exponent_across():
    def fading(k=1.0):
        return {"rhs": lambda y, t: (-k * y[0],), "coordinates": "x"}

    session = jaxnh.Session(fading, start={"x": 1.0}, target=1e-6)
    with pytest.raises(InputError, match="one coordinate without a clock has no exponent but that along it"):
        session.run(jaxnh.Lyapunov(transient=16, periods=64, exponents=1))


@pytest.mark.parametrize(
    ("normal", "words"),
    [("{x: -1, z: 2}", "-x + 2 z = 0, up"), ("{y: 0.5, z: -1}", "0.5 y - z = 0, up"), ("{z: -3}", "-3 z = 0, up")],
)
def test_a_plane_in_words(tmp_path, normal, words):
    config = CONFIG.replace("{x: 1.0, y: -1.0}", normal)
    assert jaxnh.load(write(tmp_path, config)).dynamics().description == words


def test_solver_of_other_flows_is_refused(tmp_path):
    """Whether a flow is of second order is seen when it is traced: one line, before anything is run."""
    config = CONFIG.replace("dopri8", "nystrom8")
    with pytest.raises(AccuracyError, match=r"own.yaml: accuracy.solver: nystrom8 is for flows x'' = F\(x\)"):
        jaxnh.run(jaxnh.load(write(tmp_path, config)))


def test_lengths_of_time_and_of_returns(tmp_path):
    text = LORENZ.replace('"coordinates"', '"time_unit": 0.5, "coordinates"')
    config = CONFIG.replace("direction: up", "direction: up, longest_return: 30.0")
    section = jaxnh.load(write(tmp_path, config, text)).dynamics()
    assert (section.flow.period, section.longest) == (0.5, 30.0)


@pytest.mark.slow
def test_without_a_section_what_needs_none_runs_in_time(tmp_path):
    """With solver and steps given, a section changes nothing of a spectrum, bit for bit, and is not stored."""
    whole = CONFIG.replace("dopri8", "tsit5")  # whose programs are smaller
    config = whole.replace("section: {normal: {x: 1.0, y: -1.0}, value: 0.0, direction: up}\n", "")
    experiment = jaxnh.load(write(tmp_path, config))
    assert experiment.autonomous
    assert not isinstance(experiment.dynamics(), Section)
    tree, sectioned = (session_of(one).tree() for one in (experiment, jaxnh.load(write(tmp_path, whole))))
    assert "section" not in tree.attrs
    assert sectioned.attrs["section"] == "x - y = 0, up"
    np.testing.assert_array_equal(tree["lyapunov"]["exponents"], sectioned["lyapunov"]["exponents"])
    assert np.all(tree["lyapunov"]["exponents"][:, 0] > 0.0)


FAULTS = {
    "no section": (
        ("section: {normal: {x: 1.0, y: -1.0}, value: 0.0, direction: up}\n", ""),
        ("lyapunov: {transient: 16, periods: 256, exponents: 3}", "diagram: {}"),
        "6: analyses.diagram: the system has no period, and diagram looks at it on a section: give one, as section: {coordinate: x,",
    ),
    "no such coordinate": (("y: -1.0", "w: -1.0"), None, "4: section.normal.w: there is no coordinate w; known are x, y, z"),
    "both": (("normal: {", "coordinate: x, normal: {"), None, "4: section.coordinate: a section is by a coordinate or by"),
    "no normal": (("{x: 1.0, y: -1.0}", "{x: 0.0}"), None, "4: section.normal: a normal has a length"),
    "no returns": (("direction: up", "longest_return: 0"), None, "4: section.longest_return: "),
}  # fmt: skip


@pytest.mark.parametrize(("first", "second", "message"), FAULTS.values(), ids=FAULTS)
def test_fault_in_the_config(tmp_path, first, second, message):
    config = CONFIG.replace(*first)
    config = config.replace(*second) if second else config
    assert config != CONFIG
    with pytest.raises(ConfigError) as caught:
        jaxnh.load(write(tmp_path, config))
    assert str(caught.value).startswith(f"{tmp_path}/own.yaml:{message}")


FILE_FAULTS = {
    "too few": (("x * y_ - beta * z", "x * y_ - beta * z, z"), ":9: rhs must return 3 numbers, one a coordinate, not 4"),
    "no clock": (("beta * z", "beta * z * t"), ":9: the system depends on t: give its period"),
    "a name": (("rho - z", "ro - z"), ":11: NameError: name 'ro' is not defined"),
    "complex": (("sigma * (y_ - x)", "1j"), ":9: rhs must return real numbers: a complex one is two, its real and its imaginary part"),
    "an ignorable coordinate": (('"coordinates"', '"ignorable": ("x",), "coordinates"'), ":8: system returns rhs and 'ignorable'"),
    "no unit": (('"coordinates"', '"time_unit": -1, "coordinates"'), ":8: time_unit must be a positive number, not -1"),
    "one number": (("return sigma * (y_ - x), x * (rho - z) - y_, x * y_ - beta * z", "return sigma"), ":9: rhs must return 3 numbers, one a coordinate, not 1"),
}  # fmt: skip


@pytest.mark.parametrize(("edit", "message"), FILE_FAULTS.values(), ids=FILE_FAULTS)
def test_fault_in_the_file(tmp_path, edit, message):
    assert edit[0] in LORENZ
    with pytest.raises(ConfigError) as caught:
        jaxnh.load(write(tmp_path, text=LORENZ.replace(*edit)))
    assert str(caught.value).startswith(f"{tmp_path}/own.py{message}")


def test_a_period_where_nothing_depends_on_time(tmp_path):
    text = CLOCKED.replace("force * jnp.cos(omega * t)", "force")
    config = "system: {file: own.py}\nsweep: {force: {values: [1.0]}}\nanalyses: {poincare: {}}\n"
    with pytest.raises(ConfigError, match=r"own\.py:4: nothing depends on t: leave period out"):
        jaxnh.load(write(tmp_path, config, text))


@pytest.mark.slow
def test_exponents_of_lorenz(tmp_path):
    """0.9056, 0, −14.5723 (Sprott 2003, to 5e-5) within the bars.

    Their sum is −(σ + 1 + β), but for what a window of 256 units keeps of the speed along the flow, which the exponent
    there, given as zero, leaves out: by its logarithm, no more than that of 1 to 150 on this attractor. The bar is itself
    an estimate from a few block means: of 256 lanes of this length half have one below 0.039, and 999 of 1,000 one below
    0.093, which depends on the motion and so on its last bits.
    """
    found = session_of(jaxnh.load(write(tmp_path))).run("lyapunov", rho=28.0)
    exponents, errors = found["exponents"].to_numpy(), found["exponents_error"].to_numpy()
    assert np.all(np.abs(exponents - [0.9056, 0.0, -14.5723]) <= errors + 5e-5)
    assert errors[0] < 0.1
    assert exponents.sum() == pytest.approx(-(10.0 + 1.0 + 8 / 3), abs=np.log(150.0) / 256)


@pytest.mark.slow
def test_crossings_of_lorenz_lie_on_the_plane(tmp_path):
    config = CONFIG.replace(
        "lyapunov: {transient: 16, periods: 256, exponents: 3}", "diagram: {transient: 4, strobes: 8}"
    )
    found = session_of(jaxnh.load(write(tmp_path, config))).run("diagram")
    x, y, t = (found[name].to_numpy() for name in ("x", "y", "t"))
    assert x.shape == (2, 8)
    assert np.abs(x - y).max() < 1e-9
    assert np.all(np.diff(t, axis=-1) > 0.3)  # a turn about one of the two wings takes some 0.6 units


def test_forced_oscillator_against_its_closed_form(tmp_path):
    """x'' = f cos ωt − x from rest: x(t) = f (cos ωt − cos t) / (1 − ω²), at the strobe t = 2π/ω.

    The motion comes to 2 f / |1 − ω²|, which errors are relative to.
    """
    config = (
        "system: {file: own.py, omega: 1.5}\nsweep: {force: {values: [1.0, 2.0]}}\n"
        "accuracy: {target: 1.0e-10}\nanalyses: {poincare: {transient: 0, strobes: 2}}\n"
    )
    found = session_of(jaxnh.load(write(tmp_path, config, CLOCKED))).run("poincare")
    force = np.array([1.0, 2.0])
    exact, size = force * (1.0 - np.cos(2 * np.pi / 1.5)) / (1.0 - 1.5**2), 2.0 * force / (1.5**2 - 1.0)
    assert np.max(np.abs(found["x"].to_numpy()[:, 1] - exact) / size) < 1e-10
