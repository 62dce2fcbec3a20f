"""Jumps and switches in a user's file: what they come to, and one line for what is wrong with them."""

from __future__ import annotations

import pytest

import jaxnh
from jaxnh.exceptions import ConfigError
from jaxnh.systems.first_order import FirstOrder
from jaxnh.systems.piecewise_smooth import PiecewiseSmooth
from jaxnh.systems.switched_mechanics import SwitchedMechanics

FILE = """import jax.numpy as jnp

def system(w=2.0, r=0.8, k=0.1):
    def rhs(y, t, side):
        return y[1], jnp.cos(w * t) - y[0] - k * side[0] * y[1]

    def wall(y, t):
        return y[0]

    def bounce(y, t):
        return y[0], -r * y[1]

    def surface(y, t):
        return y[0] + 1.0

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / w,
            "jumps": [{"when": wall, "direction": "up", "then": bounce}],
            "switches": [{"on": surface}]}
"""
CONFIG = """system: {file: own.py}
initial: {x: -1.0}
sweep: {r: {values: [0.8, 0.9]}}
accuracy: {solver: tsit5, steps: 40}
analyses:
  lyapunov: {transient: 4, periods: 16}
"""


def write(folder, text=FILE, config=CONFIG):
    (folder / "own.py").write_text(text)
    (folder / "own.yaml").write_text(config)
    return folder / "own.yaml"


def test_a_flow_with_events(tmp_path):
    flow = jaxnh.load(write(tmp_path)).flow()
    assert isinstance(flow, PiecewiseSmooth)
    assert (flow.jumps, flow.switches, flow.autonomous) == (("up",), 1, False)
    without = FILE.replace(", side)", ")").replace(" - k * side[0] * y[1]", "")
    without = without.replace('[{"when": wall, "direction": "up", "then": bounce}]', "[]").replace(
        '[{"on": surface}]', "()"
    )
    flow = jaxnh.load(write(tmp_path, without)).flow()
    assert type(flow) is FirstOrder


def test_up_is_the_default(tmp_path):
    assert jaxnh.load(write(tmp_path, FILE.replace('"direction": "up", ', ""))).flow().jumps == ("up",)


def test_what_holds_motions(tmp_path):
    assert not jaxnh.load(write(tmp_path)).flow().loses_rank
    text = FILE.replace('"on": surface', '"on": surface, "sliding": True').replace("bounce}", 'bounce, "rest": True}')
    assert jaxnh.load(write(tmp_path, text)).flow().holds == (True, True)


FAULTS = {
    "no list": (("[{\"on\": surface}]", "{\"on\": surface}"), ":3: switches must be a list of mappings, as in switches=[{\"on\": surface}]"),
    "no mapping": (("[{\"on\": surface}]", "[surface]"), ":3: switches must be a list of mappings, as in switches=[{\"on\": surface}]"),
    "a key": (('"direction"', '"dircetion"'), ":3: jumps[0] has 'dircetion', which is unknown (did you mean direction?); known are when, direction, then, rest"),
    "a direction": (('"up"', '"upwards"'), ":3: jumps[0].direction must be one of up, down, both, not 'upwards'"),
    "no flag": (("\"on\": surface", "\"on\": surface, \"sliding\": 1"), ":3: switches[0].sliding must be True or False, not 1"),
    "a flag of the other kind": (("\"on\": surface", "\"on\": surface, \"rest\": True"), ":3: switches[0] has 'rest', which is unknown"),
    "nothing after": ((', "then": bounce', ""), ":3: jumps[0] must also have then, as in jumps=[{"),
    "no function": (('"when": wall', '"when": 0.0'), ":3: jumps[0].when must be a function of (y, t)"),
    "other arguments": (("def bounce(y, t)", "def bounce(y)"), ":10: jumps[0].then must be a function of (y, t)"),
    "no side": (("def rhs(y, t, side)", "def rhs(y, t)"), ":4: with switches rhs is a function of (y, t, side); side has +1.0 or -1.0 for each"),
    "a vector for a wall": (("        return y[0]\n", "        return y\n"), ":7: jumps[0].when must return a number"),
    "a truth for a wall": (("        return y[0]\n", "        return y[0] > 0.0\n"), ":7: jumps[0].when must return a number that passes zero, as x - 1.0, and returns a truth value, as x > 1.0"),
    "too few after": (("return y[0], -r * y[1]", "return -r * y[1]"), ":10: jumps[0].then must return a number a coordinate"),
    "a wrong name": (("-r * y[1]", "-q * y[1]"), ":11: NameError: name 'q' is not defined"),
    "a choice": (("return y[0] + 1.0", "return y[0] + 1.0 if y[0] > 0 else y[0]"), ":14: if cannot decide by"),
    "no period of a wall": (("        return y[0]\n", "        return y[0] - 0.1 * jnp.sin(1.3 * t)\n"), ":7: 3.14159265 is no period of jumps[0].when: at one state"),
    "no period of a jump": (("-r * y[1]", "-r * y[1] + 0.1 * jnp.sin(1.3 * t)"), ":10: 3.14159265 is no period of jumps[0].then: at one state number 2 of jumps[0].then"),
    "mechanics": (('"rhs": rhs', '"T": wall, "Q": bounce'), ":7: jumps[0].when must be a function of (q, v, t)"),
}  # fmt: skip


@pytest.mark.parametrize(("edit", "message"), FAULTS.values(), ids=FAULTS)
def test_fault_in_the_file(tmp_path, edit, message):
    assert edit[0] in FILE
    with pytest.raises(ConfigError) as caught:
        jaxnh.load(write(tmp_path, FILE.replace(*edit)))
    assert str(caught.value).startswith(f"{tmp_path}/own.py{message}")
    assert "\n" not in str(caught.value)


MECHANICS = """import jax.numpy as jnp

def system(w=2.0, r=0.8):
    def T(q, v, t):
        return 0.5 * (v[0] ** 2 + v[1] ** 2)

    def Q(q, v, t):
        return -q[0], jnp.cos(w * t)

    def blade(q, v, t):
        return v[0] - q[1] * v[1]

    def lowered(q, v, t):
        return jnp.sin(w * t)

    def wall(q, v, t):
        return q[0] - 1.0

    def bounce(q, v, t):
        return q, (-r * v[0], v[1])

    return {"T": T, "Q": Q, "coordinates": ("x", "y"), "period": 2 * jnp.pi / w,
            "f": [{"constraint": blade, "when": lowered}],
            "jumps": [{"when": wall, "then": bounce}, {"when": wall, "direction": "down", "restitution": r}]}
"""

MECHANICS_FAULTS = {
    "a key": (('"when": lowered', '"while": lowered'), ":3: f[0] has 'while', which is unknown"),
    "no when": ((', "when": lowered', ""), ":3: f[0] must also have when, as in f=[{"),
    "no constraint": (('[{"constraint": blade, "when": lowered}]', "[1.0]"), ":3: f[0] must be a function of (q, v, t), or a mapping, as in f=[{"),
    "other arguments": (("def lowered(q, v, t)", "def lowered(y, t)"), ":13: f[0].when must be a function of (q, v, t)"),
    "two numbers for a height": (("return jnp.sin(w * t)", "return v"), ":13: f[0].when must return a number"),
    "no period": (("return jnp.sin(w * t)", "return jnp.sin(1.3 * t)"), ":13: 3.14159265 is no period of f[0].when: at one state"),
    "velocities alone": (("return q, (-r * v[0], v[1])", "return -r * v[0], v[1]"), ":19: jumps[0].then must return (q, v), the coordinates and the velocities after"),
    "both": (('"then": bounce', '"then": bounce, "restitution": r'), ":3: jumps[0] has then and restitution, which exclude each other"),
    "no number": (('"restitution": r', '"restitution": bounce'), ":3: jumps[1].restitution must be a number"),
    "no side": (('"jumps"', '"switches": [{"on": wall}], "jumps"'), ":7: with switches Q is a function of (q, v, t, side); side has +1.0 or -1.0 for each"),
}  # fmt: skip


def test_mechanics_with_events(tmp_path):
    flow = jaxnh.load(write(tmp_path, MECHANICS, CONFIG.replace("{x: -1.0}", "{y: 0.1}"))).flow()
    assert isinstance(flow, SwitchedMechanics)
    assert (flow.jumps, flow.switches, flow.begins) == (("up", "down"), 1, (False, False, True))
    assert (flow.coordinates, flow.exponents, flow.linear) == (("x", "x_dot", "y", "y_dot"), 4, True)


@pytest.mark.parametrize(("edit", "message"), MECHANICS_FAULTS.values(), ids=MECHANICS_FAULTS)
def test_fault_in_mechanics(tmp_path, edit, message):
    assert edit[0] in MECHANICS
    with pytest.raises(ConfigError) as caught:
        jaxnh.load(write(tmp_path, MECHANICS.replace(*edit), CONFIG.replace("{x: -1.0}", "{y: 0.1}")))
    assert str(caught.value).startswith(f"{tmp_path}/own.py{message}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("values", "written", "message"),
    [
        ("[0.8, -0.2]", "r", "own.yaml:3: sweep.r: jumps[1].restitution is -0.2 at r = -0.2, and must not be negative"),
        ("[0.8, 1.2]", "-0.5", "own.yaml:1: system: jumps[1].restitution is -0.5 at r = 0.8, and must not be negative"),
    ],
)
def test_a_negative_restitution(tmp_path, values, written, message):
    """A motion would go on through the wall."""
    config = CONFIG.replace("{x: -1.0}", "{y: 0.1}").replace("[0.8, 0.9]", values)
    with pytest.raises(ConfigError) as caught:
        jaxnh.load(write(tmp_path, MECHANICS.replace('"restitution": r', f'"restitution": {written}'), config))
    assert str(caught.value) == f"{tmp_path}/{message}"


def test_a_wall_alone_has_the_clock(tmp_path):
    """A ball on a table that moves: what falls knows no time, and where it falls on does."""
    text = FILE.replace("jnp.cos(w * t)", "1.0").replace(
        "        return y[0]\n", "        return y[0] - jnp.sin(w * t)\n"
    )
    assert not jaxnh.load(write(tmp_path, text)).flow().autonomous
    with pytest.raises(ConfigError, match=r"own\.py:4: the system depends on t: give its period"):
        jaxnh.load(write(tmp_path, text.replace(', "period": 2 * jnp.pi / w', "")))


CONFIG_FAULTS = {
    "a solver": (FILE, ("tsit5", "nystrom8"), "4: accuracy.solver: nystrom8 has no steps that end at jumps or switches; tsit5,"),
    "steps of a lane's own": (FILE, ("{solver: tsit5, steps: 40}", "{solver: rodas5p}"), "4: accuracy.solver: rodas5p has no steps that end at jumps or switches; tsit5,"),
    "precision": (FILE, ("lyapunov: {transient: 4, periods: 16}", "doubling: {}"), None),
}  # fmt: skip


@pytest.mark.parametrize(("text", "edit", "message"), CONFIG_FAULTS.values(), ids=CONFIG_FAULTS)
def test_fault_in_the_config(tmp_path, text, edit, message):
    config = CONFIG.replace(*edit)
    if message is None:
        config = config.replace("steps: 40", "steps: 40, precision: extended")
        message = "4: accuracy.precision: extended goes with smooth systems, and this one has jumps or switches"
    with pytest.raises(ConfigError) as caught:
        jaxnh.load(write(tmp_path, text, config))
    assert str(caught.value).startswith(f"{tmp_path}/own.yaml:{message}")


def test_from_python():
    """The function itself, in a session: its source goes into the config as a file's does."""

    def oscillator(r=0.8):
        return {
            "rhs": lambda y, t: (y[1], -1.0 - 0 * y[0]),
            "coordinates": ("x", "v"),
            "jumps": [{"when": lambda y, t: y[0], "direction": "down", "then": lambda y, t: (y[0], -r * y[1])}],
        }

    session = jaxnh.Session(oscillator, start={"x": 1.0}, target=1e-8)
    assert session.experiment.flow().jumps == ("down",)
    assert session.on(coordinate="v").experiment.sectioned
