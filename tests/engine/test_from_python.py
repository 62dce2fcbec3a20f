"""Systems that are no file: a function typed in a notebook, or a flow of the package, given to a session."""

from __future__ import annotations

import linecache
import math

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import jaxnh
from jaxnh.systems.function_source import source_text

pytestmark = pytest.mark.usefixtures("calibrate_once")

STEPS = 24
HALF = 0.5
TABLE = np.array([1.0, 2.0])


def stiffness(k, x):
    """Of a spring."""
    return k * x + HALF * x**3


def oscillator(k=1.0, damping=0.2 * HALF, drive=math.tau / 10):
    def rhs(y, t):
        x, v = y
        return v, drive * jnp.cos(TABLE[0] * t) - damping * v - stiffness(k, x)

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * np.pi}


def lorenz(sigma=10.0, rho=28.0, beta=8 / 3):
    def rhs(y, t):
        x, y_, z = y
        return sigma * (y_ - x), x * (rho - z) - y_, x * y_ - beta * z

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}


def timeless(a=1.0):
    return {"rhs": lambda y, t: (a * y[0],), "coordinates": ("x",), "period": "a"}


START = {"x": 1.0, "y": 1.0, "z": 20.0}
FILE = """\
def system(sigma=10.0, rho=28.0, beta=8 / 3):
    def rhs(y, t):
        x, y_, z = y
        return sigma * (y_ - x), x * (rho - z) - y_, x * y_ - beta * z

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}
"""
CONFIG = """\
system: {file: lorenz.py}
initial: {x: 1.0, y: 1.0, z: 20.0}
sweep: {rho: {start: 20.0, stop: 60.0, count: 5}}
accuracy: {target: 1.0e-6}
analyses: {lyapunov: {transient: 32, periods: 64}}
"""


def typed(cell):
    """The names that a cell of a notebook defines."""
    name, scope = f"<cell {hash(cell)}>", {"__name__": "__main__"}
    linecache.cache[name] = (len(cell), None, cell.splitlines(keepends=True), name)
    exec(compile(cell, name, "exec"), scope)
    return scope


@pytest.mark.usefixtures("quick_compiling_once")
def test_a_function_is_what_a_file_with_it_is(tmp_path):
    """Bit for bit; the text that the result keeps is a file, and the batch job that is saved has the same hash."""
    session = jaxnh.Session(lorenz, start=START, target=1e-6)
    ours = session.run(jaxnh.Lyapunov(transient=32, periods=64), rho=np.linspace(20.0, 60.0, 5))
    theirs = jaxnh.Session(jaxnh.Experiment.from_text(CONFIG, FILE)).run("lyapunov")
    xr.testing.assert_identical(ours, theirs)
    session.experiment.save(tmp_path / "lorenz.yaml")
    loaded = jaxnh.load(tmp_path / "lorenz.yaml")
    assert loaded.sha256 == session.experiment.sha256
    assert "start: 20.0" in loaded.text
    (tmp_path / "lorenz.py").write_text("other")
    with pytest.raises(jaxnh.InputError, match=r"lorenz\.py is there and says something else; overwrite=True"):
        session.experiment.save(tmp_path / "lorenz.yaml")
    session.experiment.save(tmp_path / "lorenz.yaml", overwrite=True)
    assert jaxnh.load(tmp_path / "lorenz.yaml").sha256 == session.experiment.sha256


@pytest.mark.usefixtures("quick_compiling_once")
def test_the_cell_of_a_notebook():
    """One cell, at the first try; growth adds up to −(σ + 1 + β) a time, and a lane alone has no dimension."""
    cell = (
        "import jaxnh, numpy as np\n\n"
        "def flow(sigma=10.0, rho=28.0, beta=8 / 3):\n"
        "    def rhs(y, t):\n"
        "        x, y_, z = y\n"
        "        return np.array(1.0) * sigma * (y_ - x), x * (rho - z) - y_, x * y_ - beta * z\n"
        "    return {'rhs': rhs, 'coordinates': ('x', 'y', 'z')}\n\n"
        "session = jaxnh.Session(flow, start={'x': 1.0, 'y': 1.0, 'z': 20.0}, target=1e-6)\n"
        "spectrum = session.run(jaxnh.Lyapunov(transient=32, periods=64), rho=np.linspace(30, 60, 3))\n"
        "alone = session.run(jaxnh.Lyapunov(transient=32, periods=64))\n"
    )
    scope = typed(cell)
    spectrum, alone = scope["spectrum"], scope["alone"]
    assert spectrum["exponents"].dims == ("rho", "exponent")
    assert alone["exponents"].dims == ("exponent",)
    for found in (spectrum, alone):
        assert np.abs(found["sum_rule_residual"]).max() < 1e-6
        off = found["exponents"].sum("exponent") + (10.0 + 1.0 + 8 / 3)
        assert np.all(
            np.abs(off) < found["exponents_error"].sum("exponent")
        )  # but for that along the flow, which is zero


def test_what_a_function_takes_from_around_it_goes_with_it():
    """Imports, numbers, arrays, and other functions, in the order that they need one another."""
    scope = {}
    exec(source_text(oscillator), scope)
    y, t = (0.3, -0.2), 1.7
    ours, theirs = oscillator()["rhs"](y, t), scope["system"]()["rhs"](y, t)
    assert np.array_equal(np.array(ours), np.array(theirs))
    assert scope["system"].__defaults__ == oscillator.__defaults__


def test_a_module_of_the_user_s_own_goes_with_it(tmp_path, monkeypatch):
    """Wherever it lies, in a checkout called as the package is as well; what is installed is imported by its name."""
    (tmp_path / "jaxnh").mkdir()
    (tmp_path / "jaxnh" / "springs_of_mine.py").write_text("def stiff(x):\n    return 3.0 * x\n")
    monkeypatch.syspath_prepend(tmp_path / "jaxnh")
    scope = typed(
        "from statistics import fmean\nfrom springs_of_mine import stiff\n\n"
        "def flow(a=1.0):\n"
        "    return {'rhs': lambda y, t: (fmean([a, a]) * stiff(y[0]),), 'coordinates': ('x',)}\n"
    )
    text = source_text(scope["flow"])
    assert "def stiff(x):" in text
    assert "from statistics import fmean" in text
    assert "springs_of_mine" not in text


def test_what_is_taken_from_a_function_around_it():
    def made(power):
        def system(k=1.0):
            return {"rhs": lambda y, t: (y[1], -k * y[0] ** power), "coordinates": ("x", "v")}

        return system

    scope = {}
    exec(source_text(made(3)), scope)
    assert scope["system"](2.0)["rhs"]((2.0, 1.0), 0.0) == (1.0, -16.0)


LEVEL = 0.5
cubic = lambda x, k=LEVEL: k * x**3  # noqa: E731
ROUGH, SMOOTH = {"rough": lambda x: abs(x), "smooth": lambda x: x * x}.values()


def test_lambdas_go_with_it_that_have_a_line_of_their_own():
    def hardening(a=1.0):
        return {"rhs": lambda y, t: (y[1], -a * y[0] - cubic(y[0])), "coordinates": ("x", "v")}

    scope = {}
    exec(source_text(hardening), scope)
    assert scope["system"]()["rhs"]((2.0, 1.0), 0.0) == (1.0, -6.0)

    def rough(a=1.0):
        return {"rhs": lambda y, t: (y[1], -a * y[0] - ROUGH(y[0])), "coordinates": ("x", "v")}

    with pytest.raises(
        jaxnh.InputError, match="rough uses ROUGH, a lambda without a line of its own; write it with def"
    ):
        source_text(rough)


def test_a_name_that_is_two_things_is_refused():
    """Two springs of one function each know a k of their own: a text with one of them would be another system."""

    def spring(k):
        def force(x):
            return k * x

        return force

    soft, hard = spring(1.0), spring(9.0)

    def system(a=1.0):
        return {"rhs": lambda y, t: (y[1], -soft(y[0]) - hard(y[1])), "coordinates": ("x", "v")}

    with pytest.raises(jaxnh.InputError, match="force is one thing to system and another"):
        source_text(system)

    def harder(k):
        def pull(x):
            return k * x

        return pull

    pull = harder(4.0)

    def two(a=1.0):
        return {"rhs": lambda y, t: (y[1], -soft(y[0]) - pull(y[1])), "coordinates": ("x", "v")}

    with pytest.raises(jaxnh.InputError, match=r"k is one thing to (pull|force) and another"):
        source_text(two)

    def force(x):
        return STEPS * x

    def other(x):
        STEPS = 3.0  # its own
        return STEPS * force(x)

    def nested(a=1.0):
        return {"rhs": lambda y, t: (y[1], -other(y[0])), "coordinates": ("x", "v")}

    scope = {}
    exec(source_text(nested), scope)
    assert scope["system"]()["rhs"]((2.0, 1.0), 0.0) == (1.0, -3.0 * STEPS * 2.0)


class Thing:
    """Nothing that a text could say."""


THING = Thing()


def strange(a=1.0):
    return {"rhs": lambda y, t: (a * THING.value,), "coordinates": ("x",)}


@pytest.mark.parametrize(
    ("flow", "config", "axis"),
    [
        (jaxnh.disturbed_speed(d=0.2, a=0.4), "constraint: disturbed_speed, d: 0.2, a: 0.4", "b"),
        (jaxnh.constant_speed(omega=1.5, without=("cubic_stiffness",)), None, "b"),
        (jaxnh.free_particle(0.5, 1.0, 1.0), "constraint: free", "b"),
    ],
    ids=["disturbed", "constant", "free"],
)
def test_flows_of_the_package(flow, config, axis):
    config = config or "constraint: constant_speed, omega: 1.5, without: [cubic_stiffness]"
    text = f"system: {{{config}}}\nsweep: {{b: {{values: [0.5, 1.0]}}}}\nanalyses: {{poincare: {{strobes: 4}}}}\n"
    text += "accuracy: {target: 1.0e-6}\n"
    ours = jaxnh.Session(flow, target=1e-6).run("poincare", {"strobes": 4}, b=[0.5, 1.0])
    xr.testing.assert_identical(ours, jaxnh.Session(jaxnh.Experiment.from_text(text)).run("poincare"))


def test_mechanics_in_python():
    """A pendulum by T and Q, and as `lagrangian` makes it: at small amplitude its frequency is that of its spring."""

    def pendulum(g=1.0):
        def T(q, v, t):
            return 0.5 * v[0] ** 2

        def Q(q, v, t):
            return (-g * jnp.sin(q[0]),)

        return {"T": T, "Q": Q, "coordinates": ("phi",), "time_unit": math.tau}

    options = {"transient": 0, "periods": 1, "samples": 8}
    one = jaxnh.Session(pendulum, {"phi": 1e-4}, 1e-9).run("portrait", options, g=1.0)
    other = jaxnh.Session(jaxnh.lagrangian(pendulum, {"g": 1.0}), {"phi": 1e-4}, 1e-9).run("portrait", options, g=1.0)
    xr.testing.assert_identical(one, other)
    assert np.abs(one["phi"].to_numpy() - 1e-4 * np.cos(one["t"].to_numpy())).max() < 1e-11


def test_a_section():
    """Returns of Lorenz's flow to z = 27, upward; the session that it is of is as it was."""
    session = jaxnh.Session(lorenz, start=START, target=1e-6)
    seen = session.on(coordinate="z", value=27.0, direction="up")
    assert session.on(coordinate="z", value=27.0, longest_return=50.0).experiment.dynamics().longest == 50.0
    found = seen.run(jaxnh.Poincare(transient=8, strobes=16), rho=[28.0])
    assert np.abs(found["z"].to_numpy() - 27.0).max() < 1e-9
    x, y = found["x"].to_numpy(), found["y"].to_numpy()
    assert np.all(x * y - 8 / 3 * 27.0 > 0.0)
    with pytest.raises(jaxnh.ConfigError, match="on a section"):
        session.run("poincare", rho=[28.0])


MISUSES = {
    "a path": (lambda s: jaxnh.Session("a.yaml"), "a config file is read by jaxnh.load"),
    "nothing": (lambda s: jaxnh.Session(None), "a system is a function with parameters"),
    "a lambda": (lambda s: jaxnh.Session(lambda a=1.0: {}), "a system is a function written with def"),
    "something strange": (lambda s: jaxnh.Session(strange), "strange uses THING, a Thing"),
    "a start by place": (lambda s: jaxnh.Session(lorenz, start=[1.0]), "start are numbers by name"),
    "an unknown start": (lambda s: jaxnh.Session(lorenz, start={"q": 1.0}), "initial.q: unknown key"),
    "an unknown parameter": (lambda s: jaxnh.Session(lorenz, parameters={"r": 1.0}), "system.r: unknown key"),
    "a start of an experiment": (
        lambda s: jaxnh.Session(s.experiment, start=START),
        "go with a system in Python; an experiment says its own",
    ),
    "run of a path": (lambda s: jaxnh.run("a.yaml"), "run takes an experiment, not str: jaxnh.load"),
    "load of nothing": (lambda s: jaxnh.load(None), "load takes the path of a YAML file, not NoneType"),
    "load of overrides in one text": (
        lambda s: jaxnh.load("a.yaml", "sweep.b.count=3"),
        "overrides are a list, as ['sweep.b.count=3'], and not one text",
    ),
    "a result of nothing": (
        lambda s: jaxnh.open_result(None),
        "open_result takes the path of a result file, not NoneType",
    ),
    "an output that is a number": (
        lambda s: jaxnh.run(s.experiment, 3),
        "output takes the path of a result file, not int",
    ),
    "a config saved as nothing": (
        lambda s: s.experiment.save(None),
        "save takes the path of a YAML file, not NoneType",
    ),
    "progress that is a number": (
        lambda s: jaxnh.run(s.experiment, progress=3),
        "progress is a function of (label, done, in all), not int",
    ),
    "an experiment by hand": (lambda s: jaxnh.Experiment(), "an experiment is read by jaxnh.load"),
    "a parameter of a flow in words": (
        lambda s: jaxnh.Session(jaxnh.disturbed_speed(d="a")),
        "d is a number, not the text 'a'",
    ),
    "a period in words": (lambda s: jaxnh.Session(timeless), "period must be a number, not the text 'a'"),
    "a page of nothing": (
        lambda s: jaxnh.bokeh_figure(None),
        "a figure is of a result, as of open_result, not NoneType",
    ),
    "analyses in a list": (lambda s: s.run([]), "there is no analysis []; known are doubling"),
    "a figure of nothing": (lambda s: jaxnh.figure(None), "a figure is of a result, one group of it"),
    "values in place of options": (
        lambda s: s.run("portrait", np.arange(3.0)),
        "options of portrait are jaxnh.Portrait(...) or a mapping, not ndarray; values of an axis are given by its name",
    ),
    "an option as an axis": (lambda s: s.run("portrait", samples=3), "run(jaxnh.Portrait(samples=...))"),
    "options of another": (lambda s: s.run("portrait", jaxnh.Lyapunov()), "portrait takes jaxnh.Portrait(...)"),
    "options twice": (lambda s: s.run(jaxnh.Portrait(), {}), "options are given once"),
    "options that are not made": (lambda s: s.run(jaxnh.Portrait), "as jaxnh.Portrait()"),
    "an unknown analysis": (lambda s: s.run("portraits"), "there is no analysis portraits"),
    "an unknown option": (lambda s: jaxnh.Lyapunov(period=1), "Lyapunov has no option period; it has transient"),
    "an option by place": (lambda s: jaxnh.Lyapunov(1000), "options are given by name, as Lyapunov(transient=...)"),
    "an option of a kind": (lambda s: jaxnh.Lyapunov(periods="a"), "Lyapunov(periods=...): must be a valid integer"),
    "an axis of words": (lambda s: s.run("portrait", rho="a"), "sweep.rho.values: must be a list"),
    "an unknown axis": (lambda s: s.run("portrait", r=[1.0]), "sweep.r: unknown key"),
    "a list for an axis": (
        lambda s: jaxnh.Experiment.from_text(
            "system: {constraint: free}\nsweep: {b: [1, 2]}\nanalyses: {portrait: {}}"
        ),
        "sweep.b: must be {start: ..., stop: ..., count: ...} or {values: [...]}, not a list",
    ),
}


@pytest.fixture(scope="module")
def session():
    return jaxnh.Session(lorenz, start=START, target=1e-6)


@pytest.mark.parametrize("case", MISUSES)
def test_misuse_is_said_in_words(session, case):
    call, words = MISUSES[case]
    with pytest.raises(jaxnh.JaxnhError) as told:
        call(session)
    assert words in str(told.value)


def test_parameters_hold_whatever_the_axes_are():
    """A parameter that is given and not swept stays as given, the first of a function too."""

    def decay(rate=1.0, other=0.0):
        return {"rhs": lambda y, t: (-rate * y[0] + other,), "coordinates": ("x",)}

    session = jaxnh.Session(decay, start={"x": 1.0}, parameters={"rate": 0.5}, target=1e-8)
    ends = session.run("portrait", x=[1.0, 2.0])["x"].to_numpy()
    times = session.run("portrait", x=[1.0, 2.0])["t"].to_numpy()
    np.testing.assert_allclose(ends, np.array([[1.0], [2.0]]) * np.exp(-0.5 * times), rtol=1e-7)


def test_options_are_typed():
    """Each analysis has its options under its own name, and they are those of a config."""
    from jaxnh.analyses.registry import ANALYSES

    for name, analysis in ANALYSES.items():
        assert name == analysis.name
        public = "".join(word.capitalize() for word in name.split("_"))
        assert getattr(jaxnh, public) is analysis.options
        assert public in jaxnh.__all__
