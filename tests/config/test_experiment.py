"""Configs: what loads, what each fault says and where, and that nothing but ConfigError ever comes out."""

from __future__ import annotations

import json
import math
import tempfile
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from jaxnh.analyses.registry import ANALYSES
from jaxnh.config.schema import schema
from jaxnh.config.yaml_source import read
from jaxnh.engine.experiment import Experiment, load
from jaxnh.exceptions import ConfigError
from tests.helpers.paths import ROOT

EXAMPLE = """\
title: Period doubling at constant speed (Table 1)
system: {constraint: constant_speed, a: 0.5, c: 1.0, omega: 1.0}
initial: {x1: 0.1, x2: 0.1, y1: 0.1}        # y2 follows from the constraint, positive root
sweep: {b: {start: 5.6, stop: 5.45, count: 1024}}
accuracy: {target: 1.0e-10}                 # largest error of one period's map that is allowed
analyses:
  doubling: {levels: 6}
"""

# One key a line, so that every fault has a line of its own.
CONFIG = """\
# a comment
title: A test
system:
  constraint: disturbed_speed
  a: 0.5
  c: 1.0
  d: 0.1
  omega: 1.0
initial:
  x2: 0.1
sweep:
  b:
    start: 6.0
    stop: 5.0
    count: 64
accuracy:
  target: 1e-8
analyses:
  doubling:
    levels: 3
"""


def write(folder: Path, text: str | bytes) -> Path:
    path = folder / "config.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def edited(*edits: tuple[str, str]) -> str:
    """CONFIG with pieces of it replaced, each of which must be there once."""
    text = CONFIG
    for old, new in edits:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


def fault(path: Path, *overrides: str) -> str:
    """The message of a config that must not load, FILE for its name."""
    with pytest.raises(ConfigError) as caught:
        load(path, overrides)
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    return message.replace(str(path), "FILE")


# ---- what loads


def test_example_of_the_design(tmp_path):
    path = write(tmp_path, EXAMPLE)
    experiment = load(path)
    assert experiment.title == "Period doubling at constant speed (Table 1)"
    assert experiment.source == path
    assert experiment.text == EXAMPLE
    assert dict(experiment.flow().parameters) == {"a": 0.5, "b": 5.6, "c": 1.0, "d": 0.0, "omega": 1.0}
    (axis,) = experiment.axes
    assert (axis.name, axis.long_name, axis.kind) == ("b", "coupling b", "lane")
    grid = axis.values
    assert grid.dtype == np.float64
    assert grid.shape == (1024,)
    assert (grid[0], grid[-1]) == (5.6, 5.45)
    assert np.all(np.diff(grid) < 0)
    assert experiment.accuracy.target == 1e-10
    assert experiment.accuracy.solver is None
    assert experiment.accuracy.steps is None
    assert experiment.compare is None
    ((analysis, options),) = experiment.requested()
    assert analysis is ANALYSES["doubling"]
    assert options.levels == 6


@pytest.mark.parametrize("behind", ["", " {}", " null", "\n    # nothing yet"])
def test_least_config_has_the_paper_s_defaults(tmp_path, behind):
    text = (
        f"system: {{constraint: disturbed_speed}}\nsweep: {{b: {{values: [5, 2.5]}}}}\nanalyses:\n  doubling:{behind}\n"
    )
    experiment = load(write(tmp_path, text))
    assert dict(experiment.flow().parameters) == {"a": 0.5, "b": 5.0, "c": 1.0, "d": 0.1, "omega": 1.0}
    assert experiment.axes[0].values.tolist() == [5.0, 2.5]
    assert experiment.accuracy.target == 1e-10
    assert experiment.analyses.doubling == ANALYSES["doubling"].options()


@pytest.mark.parametrize("overrides", [(), ("system.c=4", "initial.x2=-2"), ("system.c=0.3", "initial.x1=7")])
def test_start_state_meets_the_constraint(tmp_path, overrides):
    experiment = load(write(tmp_path, EXAMPLE), overrides)
    start = experiment.start({}, 3)
    assert {leaf.shape for leaf in jax.tree.leaves(start)} == {(3,)}
    q, n = jax.tree.map(lambda component: float(component[1]), start)
    assert q == (experiment.initial.x1, experiment.initial.y1)
    assert math.hypot(*n) == pytest.approx(1.0, abs=4e-16)  # two roots and two quotients, each rounded once
    assert n[0] * math.sqrt(experiment.system.c) == pytest.approx(experiment.initial.x2, rel=4e-16)
    assert n[1] >= 0


def test_published_values_with_gaps(tmp_path):
    published = "compare:\n  doubling:\n    source: Table 1\n    b: [5.519779, 5.495639]\n    delta: [null, 3.8986]\n"
    experiment = load(write(tmp_path, CONFIG + published))
    table = experiment.compare["doubling"]
    assert table.source == "Table 1"
    columns = table.columns()
    assert columns["b"].tolist() == [5.519779, 5.495639]
    np.testing.assert_array_equal(columns["delta"], [math.nan, 3.8986])


OF_THE_PAPER = """\
compare:
  doubling:
    source: Table 1
    system: {constraint: constant_speed, a: 0.5, c: 1, omega: 1.0}
    initial: {x1: 0.1, x2: 0.1, y1: 0.1}
    b: [5.519779]
"""


@pytest.mark.parametrize(
    ("overrides", "unlike"),
    [
        ((), []),
        (("sweep.b.count=7", "sweep.b.start=5.7", "accuracy.target=1e-6", "title=x"), []),
        (("system.c=1.5",), ["c is 1.5 here, 1 there"]),
        (("initial.x2=0.2", "system.a=0.4"), ["a is 0.4 here, 0.5 there", "x2 is 0.2 here, 0.1 there"]),
        (("system.without=[damping]",), ["without is ['damping'] here, not given there"]),
        (("system={constraint: disturbed_speed}",), ["constraint is disturbed_speed here, constant_speed there",
                                                      "d is 0.1 here, not given there"]),
        (("sweep.c={values: [1.0]}", "system={constraint: constant_speed}"), ["c is swept"]),
        (("compare.doubling.initial={x1: 0.1, y1: 0.1}",), ["x2 is 0.1 here, not given there"]),
    ],
)  # fmt: skip
def test_what_published_values_are_of(tmp_path, overrides, unlike):
    """Equal in all parameters and in the start; the first axis is what they are along, accuracy and sweep are ours."""
    experiment = load(write(tmp_path, EXAMPLE + OF_THE_PAPER), overrides)
    assert experiment.differences_from(experiment.compare["doubling"]) == unlike


def test_records_are_frozen(tmp_path):
    experiment = load(write(tmp_path, CONFIG))
    with pytest.raises(ValidationError):
        experiment.system.a = 1.0
    with pytest.raises(ValidationError):
        experiment.title = "another"


def test_solver_and_steps(tmp_path):
    experiment = load(write(tmp_path, CONFIG), ["accuracy={solver: dopri8, steps: 120}"])
    assert (experiment.accuracy.solver, experiment.accuracy.steps) == ("dopri8", 120)


# ---- overrides


def test_overrides_change_values_and_make_keys(tmp_path):
    path = write(tmp_path, EXAMPLE.replace("  doubling: {levels: 6}", "  doubling:").replace("initial", "#initial"))
    overrides = ["analyses.doubling.levels=4", "initial.x1=1e-8", "sweep.b={values: [1, 2, 3]}", "sweep.b.values.1=2.5"]
    experiment = load(path, overrides)
    assert experiment.analyses.doubling.levels == 4
    assert experiment.initial.x1 == 1e-8
    assert experiment.axes[0].values.tolist() == [1.0, 2.5, 3.0]


def test_null_drops_an_analysis(tmp_path):
    """Also from the text that results keep and resumed runs read; what is not there need not be dropped."""
    path = write(tmp_path, EXAMPLE + "  lyapunov:\n  diagram: {strobes: 4}\n")
    left = load(path, ["analyses.lyapunov=null", "analyses.verdict=null"])
    assert [analysis.name for analysis, _ in left.requested()] == ["doubling", "diagram"]
    assert Experiment.from_text(left.text).sha256 == left.sha256
    assert load(path, ["analyses.lyapunov=null", "analyses.lyapunov.exponents=1"]).analyses.lyapunov.exponents == 1
    said = fault(path, "analyses.lyapunow=null")
    assert said.startswith("command line: analyses.lyapunow: unknown key (did you mean lyapunov?)")
    every = [f"analyses.{name}=null" for name in ("doubling", "lyapunov", "diagram")]
    assert "at least one analysis is needed" in fault(path, *every)


def test_null_leaves_out_what_is_swept_instead(tmp_path):
    """A start or parameter of the file makes way for an axis; a key that is unknown still is."""
    path = write(tmp_path, EXAMPLE)
    over_a_start = ["analyses={period: {}}", "sweep={x1: {values: [0.1, 0.2]}}", "system.b=5.5", "initial.x1=null"]
    assert list(load(path, over_a_start).sweep.grids) == ["x1"]
    assert load(path, ["system.a=null"]).system.a == 0.5
    assert list(
        load(path, ["sweep.a={values: [0.4, 0.5]}", "system.a=null", "sweep.b=null", "system.b=5.5"]).sweep.grids
    ) == ["a"]
    assert fault(path, "initial.x9=null").startswith("command line: initial.x9: unknown key")


def test_a_fault_of_an_option_is_not_an_axis_on_the_command_line(tmp_path):
    path = write(tmp_path, EXAMPLE + "  lyapunov: {exponents: 7}\n")
    said = fault(path, "sweep={b: {values: [5.5]}}")
    assert said == "FILE:8: analyses.lyapunov.exponents: must be at most 3, not 7"


def test_last_override_wins(tmp_path):
    assert load(write(tmp_path, CONFIG), ["system.d=0.2", "system.d=0.05"]).system.d == 0.05


def test_value_may_contain_an_equals_sign(tmp_path):
    assert load(write(tmp_path, CONFIG), ["title=b = 5"]).title == "b = 5"


def test_text_with_overrides_keeps_comments_and_means_the_same(tmp_path):
    experiment = load(write(tmp_path, EXAMPLE), ["system.c=2.50", "analyses.doubling.levels=4"])
    assert experiment.text == EXAMPLE.replace("c: 1.0", "c: 2.50").replace("levels: 6", "levels: 4")
    assert load(write(tmp_path, experiment.text)).sha256 == experiment.sha256


@settings(deadline=None)
@given(st.floats(-1e300, 1e300), st.sampled_from(["{!r}", "{:.17g}", "{:.4e}", "{:+.16E}"]))
@example(7.406053969734946e23, "{!r}")  # ruamel's own floats change the last digit of these
@example(6.19820033989617e-18, "{!r}")
def test_no_digit_of_a_number_is_lost(number, form):
    literal = form.format(number)
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder), EXAMPLE.replace("a: 0.5", f"a: {literal}"))
        experiment = load(path, [f"initial.y1={literal}"])
        assert experiment.system.a == experiment.initial.y1 == float(literal)
        again = load(write(Path(folder), experiment.text))
        assert again.system == experiment.system
        assert again.initial == experiment.initial


# ---- the hash


@pytest.mark.parametrize(
    "text",
    [
        "# a comment\n\n" + EXAMPLE,
        EXAMPLE.replace("title: Period", "title: period"),
        EXAMPLE.replace("1.0e-10", "1e-10").replace("c: 1.0", "c: 1").replace("5.6", "5.60"),
        EXAMPLE.replace("{levels: 6}", "\n    levels: 6"),
        EXAMPLE.replace("initial: {x1: 0.1, x2: 0.1, y1: 0.1}", "initial: {y1: 0.1}"),
        EXAMPLE.replace("accuracy: {target: 1.0e-10}", ""),
        "\n".join([*EXAMPLE.splitlines()[5:], *EXAMPLE.splitlines()[4::-1]]),
        EXAMPLE + "compare: {doubling: {source: Table 1, b: [5.519779]}}\n",
        EXAMPLE.replace("\n", "\r\n"),
        "\ufeff" + EXAMPLE,
    ],
    ids=["comment", "title", "numbers", "flow", "defaults", "section", "order", "compare", "crlf", "bom"],
)
def test_hash_is_that_of_the_content(tmp_path, text):
    assert load(write(tmp_path, text)).sha256 == load(write(tmp_path, EXAMPLE)).sha256


@pytest.mark.parametrize(
    "override",
    ["system.a=0.51", "sweep.b.count=1025", "accuracy.target=1e-9", "analyses.doubling.levels=5", "initial.x1=0.2"],
)
def test_hash_changes_with_every_number(tmp_path, override):
    path = write(tmp_path, EXAMPLE)
    assert load(path, [override]).sha256 != load(path).sha256


HASHES = {
    "fig01": "0c879f8f5b64ac56cf19fa1d3be5407d729816f73df0576746bca57df1f0f50d",
    "fig02": "2760508b40b76e77148034ae9da8fb22a117015255800677c2346b45c15a1a49",
    "fig03": "52e29aa421be73ac5a989cc1ad3409b76fc0960fbb92c2a43964cb9103b87dbe",
    "fig04": "9a9e04f3f43dff87a78ff1a6cc5d7654146bdec98933d0faaf6417fc4a0fd4c2",
    "fig05": "ad50b59cf500b30f3212425b5fa15e5f8de4dfee9e61e4b7bc7abd41cf356231",
    "fig06": "f8833a2ee22d35742f0a6a22369a138d0885191a947afa3e41af51c486014457",
    "fig07": "e4604b97518124bca7c620d61d4f31165dc9c32f30d82be0edeeebb5c01e79ab",
    "fig08": "369073e4dc7a5969966fbf01d7ece7943d1bdf8fb8ef1a03295c504d3fd00128",
    "fig09": "93386fcc39a1aba776281f7f31c002edc3e8528576826c9acab18716f6079f4c",
    "fig10": "96b88d36e64367d284889478668fd149e9a9fd0db7ccc97bcf5a463b71e1d517",
    "governor": "83d27a140402c14c2897f0dc3df9dc51db6fdaeb4b1cf5532a61cbc787bd288b",
    "range_constant": "efc005fc9f274be7071561492ac2b006a1fc659616ddf6244a7f33ede5bfca58",
    "range_disturbed": "730e3b5dd05cc0ee045e566a0dd1762ed27fd5c90d54f4c73673fd71fa579d3b",
    "sleigh": "5cd8696476e79cfe370ccda897f3c790d8c03d5131a5ba86313bf7b0c5987e3d",
    "table1": "7a752d77b2a9fe70e3f3b562fee2b98aea7c6fd54e0fc3a4728239fc0f3b611d",
    "table2": "ca06b47f1f8e528b2060b7a044b31a63075e5179e9b09b92c32ae93a0efc1756",
    "unforced": "2b670c905b1ba985a00c597878defc1603f5cfd89f69945ac1d93af6690a8661",
}
"""Of configs with one axis: results and tiles are known by these, whatever changes but the names of options."""


@pytest.mark.parametrize("name", HASHES)
def test_hash_of_one_axis_is_as_it_was(name):
    path = ROOT / "configs" / f"{name}.yaml"
    assert load(path).sha256 == HASHES[name]


OLDER = {
    "33249e9e0bf3b3d58d69d300ad20357df65baef7a9cbed145d055522eb70d887": "system: {constraint: constant_speed, b: 0.9}\nsweep: {a: {start: 0.4, stop: 0.8, count: 64}}\n",
    "e4f6a5621cb0081bc6ee830e0610ae813ca292188d318a5a0d72ad54f8fdf984": "system: {constraint: constant_speed, b: 0.9, without: [forcing]}\nsweep: {a: {values: [0.4, 0.8]}}\nsection: {coordinate: y1, direction: both}\n",
    "88d4cd1531a8364f01585a7fffd5d9610871f2f1770d0998d64c5d30f4a8e518": "system: {constraint: constant_speed, without: [forcing, damping]}\nsweep: {b: {values: [0.4, 0.8]}}\n",
    "00e26da5576ef61d1a1ae0e03073eae9866332fd8bea4e88a01d71d9fd863f42": "system: {constraint: disturbed_speed, d: 0.2, without: [forcing]}\nsweep: {b: {values: [0.4, 0.8]}}\n",
    "12137ed2b7846634b6742e644b0b207401aaeea8d71839dd15fcefa1245fe04f": "system: {constraint: free}\ninitial: {y2: 0.3}\nsweep: {b: {values: [0.4, 0.8]}}\naccuracy: {solver: dopri8, steps: 120}\n",
    "4a551d416dad6bde5ecc1d0531a61eaa164180548947d6397b011e980d044633": "system: {constraint: constant_speed, without: [coupling]}\nsweep: {a: {values: [0.4, 0.8]}}\n",
    "20dd25ab8547a1a93a9de5e3ed0aa8882d5942681f988ffb8c2fd85f0a82d054": "system: {constraint: constant_speed}\nsweep: {b: {values: [0.4, 0.8]}}\naccuracy: {precision: float32, target: 1e-4}\n",
}


@pytest.mark.parametrize("known", OLDER)
def test_hash_of_other_scenes_is_as_it_was(known):
    assert Experiment.from_text(OLDER[known] + "analyses: {poincare: {}}\n").sha256 == known


def test_hash_knows_the_order_of_axes(tmp_path):
    """It is the order of the results' dimensions; that of all other keys is none."""
    axes = ("b: {values: [5, 6]}", "d: {values: [0.1, 0.2]}")
    text = "system: {constraint: disturbed_speed}\nsweep: {%s, %s}\nanalyses: {lyapunov: {}}\n"
    one, other = (load(write(tmp_path, text % order)) for order in (axes, axes[::-1]))
    assert one.sha256 != other.sha256
    assert load(write(tmp_path, text % axes)).sha256 == one.sha256
    assert load(write(tmp_path, "\n".join(reversed((text % axes).splitlines())))).sha256 == one.sha256


# ---- from Python

CONTENT = {
    "title": "Period doubling at constant speed (Table 1)",
    "system": {"constraint": "constant_speed", "a": 0.5, "c": 1.0, "omega": 1.0},
    "initial": {"x1": 0.1, "x2": 0.1, "y1": 0.1},
    "sweep": {"b": {"start": 5.6, "stop": 5.45, "count": 1024}},
    "accuracy": {"target": 1e-10},
    "analyses": {"doubling": {"levels": 6}},
}


def test_dict_is_the_same_as_the_file(tmp_path):
    experiment, from_file = Experiment.from_dict(CONTENT), load(write(tmp_path, EXAMPLE))
    assert experiment.sha256 == from_file.sha256
    assert dict(experiment) == dict(from_file)
    assert (experiment.source, experiment.label) == (None, "experiment")
    assert (from_file.source, from_file.label) == (tmp_path / "config.yaml", str(tmp_path / "config.yaml"))
    again = Experiment.from_text(experiment.text)
    assert (again.sha256, again.text) == (experiment.sha256, experiment.text)


@pytest.mark.parametrize("path", sorted((ROOT / "configs").glob("*.yaml")), ids=lambda path: path.stem)
def test_every_config_as_a_dict(path, monkeypatch):
    monkeypatch.chdir(path.parent)  # a user's file is named from there
    experiment = Experiment.from_dict(read(path).data)
    assert experiment.sha256 == load(path).sha256
    assert Experiment.from_text(experiment.text).sha256 == experiment.sha256


def test_dict_of_numpy_and_overrides():
    content = {
        "system": {"constraint": "disturbed_speed", "c": np.float64(2.5)},
        "sweep": {
            "d": {"values": np.array([0.1, 1 / 3])},
            "b": {"start": np.int64(5), "stop": 6, "count": np.int64(3)},
        },
        "analyses": {"lyapunov": None},
    }
    experiment = Experiment.from_dict(content, ["sweep.b.count=4", "initial.x1=7.406053969734946e23"])
    assert [(axis.name, axis.values.tolist()) for axis in experiment.axes] == [
        ("d", [0.1, 1 / 3]),
        ("b", np.linspace(5, 6, 4).tolist()),
    ]
    assert experiment.initial.x1 == 7.406053969734946e23
    again = Experiment.from_text(experiment.text)
    assert (again.sha256, [axis.name for axis in again.axes]) == (experiment.sha256, ["d", "b"])
    assert content["sweep"]["b"] == {"start": 5, "stop": 6, "count": 3}  # what was given is left as it is


DICT_FAULTS = {
    "unknown key": ({"titel": "A"}, "experiment: titel: unknown key (did you mean title?); known keys are title, system, initial, sweep, levels, section, accuracy, analyses, device, compare, explore"),
    "a value": ({"sweep": {"b": {"start": 1.0, "stop": 2.0, "count": 1}}}, "experiment: sweep.b.count: must be at least 2, not 1"),
    "nothing": ({"sweep": {"b": {"values": np.array([])}}}, "experiment: sweep.b.values: must have at least 1 of them, not 0"),
    "text": ({"system": {"constraint": "constant_speed", "a": "0.5"}}, "experiment: system.a: must be a number, not the text '0.5'"),
    "number as a key": ({"system": {3: 0.5}}, "experiment: system: a key must be text, not 3"),
    "a function": ({"analyses": {"doubling": {"levels": len}}}, "experiment: analyses.doubling.levels: a config has mappings, lists, text and numbers, and no builtin_function_or_method"),
    "not a number": ({"initial": {"x1": math.nan}}, "experiment: initial.x1: must be a finite number, not .nan"),
    "no such file": ({"system": {"file": "nowhere.py"}}, "experiment: system.file: there is no file nowhere.py"),
}  # fmt: skip


@pytest.mark.parametrize("name", DICT_FAULTS)
def test_fault_in_a_dict(name):
    change, message = DICT_FAULTS[name]
    with pytest.raises(ConfigError) as caught:
        Experiment.from_dict(CONTENT | change)
    assert str(caught.value) == message


def test_first_fault_in_a_dict_is_reported():
    content = {**CONTENT, "accuracy": {"target": 1}, "sweep": {"b": {"values": [True]}}}
    with pytest.raises(ConfigError, match=r"experiment: sweep\.b\.values\.0: must be a number, not true"):
        Experiment.from_dict(content)
    with pytest.raises(ConfigError, match=r"experiment: system\.d: d does not go with constant_speed"):
        Experiment.from_dict(CONTENT, ["system.d=0.1"])
    with pytest.raises(ConfigError, match=r"experiment: system\.d: an override is KEY=VALUE"):
        Experiment.from_dict(CONTENT, ["system.d"])


@pytest.mark.parametrize("content", [[], "system", None, 3])
def test_no_dict(content):
    with pytest.raises(ConfigError, match="experiment: a config is a mapping of keys to values"):
        Experiment.from_dict(content)


def test_endless_dict():
    content = dict(CONTENT)
    content["compare"] = content
    with pytest.raises(ConfigError, match="nested too deeply"):
        Experiment.from_dict(content)


def test_text_without_a_file():
    assert Experiment.from_text(EXAMPLE).text == EXAMPLE
    with pytest.raises(ConfigError) as caught:
        Experiment.from_text(EXAMPLE.replace("count: 1024", "count: 1"))
    assert str(caught.value) == "experiment:4: sweep.b.count: must be at least 2, not 1"


# ---- faults in the file: what, where, which key

FAULTS = {
    "unknown key": (("title: A test", "titel: A test"), "FILE:2: titel: unknown key (did you mean title?); known keys"),
    "unknown key, nested": (("  a: 0.5", "  omga: 0.5"), "FILE:5: system.omga: unknown key (did you mean omega?)"),
    "known keys": (
        ("  a: 0.5", "  mass: 0.5"),
        "FILE:5: system.mass: unknown key; known keys are constraint, a, b, omega, without, c, d",
    ),
    "unknown key of the sweep": (("    count: 64", "    counts: 64"), "FILE:15: sweep.b.counts: unknown key (did you"),
    "unknown parameter": (("\n  b:\n", "\n  beta:\n"), "FILE:12: sweep.beta: unknown key; known keys are b, a"),
    "unknown analysis": (
        ("  doubling:", "  doublings:"),
        "FILE:19: analyses.doublings: unknown key (did you mean doubl",
    ),
    "unknown option": (("levels: 3", "level: 3"), "FILE:20: analyses.doubling.level: unknown key (did you mean levels"),
    "unknown constraint": (
        ("disturbed_speed", "disturbd_speed"),
        "FILE:4: system.constraint: must be one of constant_speed, disturbed_speed, free, not the text 'disturbd_speed'",
    ),
    "misspelt constraint": (
        ("constraint:", "constrain:"),
        "FILE:4: system.constrain: unknown key (did you mean constr",
    ),
    "text for a number": (("a: 0.5", "a: half"), "FILE:5: system.a: must be a number, not the text 'half'"),
    "quoted number": (("a: 0.5", "a: '0.5'"), "FILE:5: system.a: must be a number, not the text '0.5'"),
    "bool for a number": (("a: 0.5", "a: true"), "FILE:5: system.a: must be a number, not true"),
    "nothing for a number": (("a: 0.5", "a:"), "FILE:5: system.a: must be a number, not nothing"),
    "mapping for a number": (("a: 0.5", "a: {b: 1}"), "FILE:5: system.a: must be a number, not a mapping"),
    "date for a number": (("a: 0.5", "a: 2001-02-03"), "FILE:5: system.a: must be a number, not the text '2001-02-03'"),
    "number for text": (("title: A test", "title: 3"), "FILE:2: title: must be text, not 3"),
    "bool for a count": (("count: 64", "count: true"), "FILE:15: sweep.b.count: must be a whole number, not true"),
    "fraction for a count": (("count: 64", "count: 6.5"), "FILE:15: sweep.b.count: must be a whole number, not 6.5"),
    "list for a mapping": (
        ("initial:\n  x2: 0.1", "initial: [1]"),
        "FILE:9: initial: must be a mapping of keys to val",
    ),
    "list for the system": (
        ("\n  constraint: disturbed_speed\n  a: 0.5\n  c: 1.0\n  d: 0.1\n  omega: 1.0", " [1]"),
        "FILE:3: system: must be a mapping of keys to values, not a list",
    ),
    "text for the options": (
        ("\n    levels: 3", " all"),
        "FILE:19: analyses.doubling: must be a mapping of keys to val",
    ),
    "duplicate key": (("d: 0.1", "c: 2.0"), "FILE:7: system.c: this key is already given on line 6"),
    "duplicate section": (("accuracy:", "sweep:"), "FILE:16: sweep: this key is already given on line 11"),
    "count below two": (("count: 64", "count: 1"), "FILE:15: sweep.b.count: must be at least 2, not 1"),
    "c zero": (("c: 1.0", "c: 0"), "FILE:6: system.c: must be above 0, not 0"),
    "c negative": (("c: 1.0", "c: -1.5"), "FILE:6: system.c: must be above 0, not -1.5"),
    "omega zero": (("omega: 1.0", "omega: 0.0"), "FILE:8: system.omega: must be above 0, not 0.0"),
    "d as large as c": (("d: 0.1", "d: 1"), "FILE:7: system.d: the speed vanishes: |d| must be below c, and d is 1, c"),
    "d below -c": (("d: 0.1", "d: -1.5"), "FILE:7: system.d: the speed vanishes"),
    "c below the default d": (("c: 1.0\n  d: 0.1", "c: 0.05"), "FILE:6: system.c: the speed vanishes"),
    "d at constant speed": (
        ("disturbed_speed", "constant_speed"),
        "FILE:7: system.d: d does not go with constant_speed; known keys are constraint, a, b, omega, without, c",
    ),
    "no common period": (
        ("omega: 1.0", "omega: 1.4142135623730951"),
        "FILE:8: system.omega: sin(1.41421 t) and the disturbance sin t have no common period",
    ),
    "x2 above the speed": (
        ("x2: 0.1", "x2: -1.1"),
        "FILE:10: initial.x2: the speed at t = 0 is 1, and |x2| cannot be ab",
    ),
    "speed below the default x2": (
        ("c: 1.0\n  d: 0.1\n  omega: 1.0\ninitial:\n  x2: 0.1", "c: 0.0025\n  d: 0"),
        "FILE:6: system.c: the speed at t = 0 is 0.05, and |x2| cannot be above it; x2 is 0.1",
    ),
    "no interval": (("stop: 5.0", "stop: 6"), "FILE:14: sweep.b.stop: start and stop must differ, and both are 6"),
    "infinite interval": (
        ("6.0\n    stop: 5.0", "1e308\n    stop: -1e308"),
        "FILE:14: sweep.b.stop: start and stop are",
    ),
    "infinity": (("start: 6.0", "start: .inf"), "FILE:13: sweep.b.start: must be a finite number, not .inf"),
    "not a number": (("x2: 0.1", "x2: .nan"), "FILE:10: initial.x2: must be a finite number, not .nan"),
    "overflow": (("x2: 0.1", "x2: -1e999"), "FILE:10: initial.x2: must be a finite number, not -.inf"),
    "integer too large": (("x2: 0.1", "x2: 1" + 400 * "0"), "FILE:10: initial.x2: this number is too large"),
    "integer past reading": (("x2: 0.1", "x2: " + 5000 * "9"), "FILE:10: this is not YAML: the value '9999"),
    "no values": (
        ("start: 6.0\n    stop: 5.0\n    count: 64", "values: []"),
        "FILE:13: sweep.b.values: must have at le",
    ),
    "text among values": (
        ("start: 6.0\n    stop: 5.0\n    count: 64", "values:\n    - 1\n    - b"),
        "FILE:15: sweep.b.values.1: must be a number, not the text 'b'",
    ),
    "text as the only value": (
        ("start: 6.0\n    stop: 5.0\n    count: 64", "values: [b]"),
        "FILE:13: sweep.b.values.0: must be a number, not the text 'b'",
    ),
    "values and count": (
        ("start: 6.0\n    stop: 5.0", "values: [1]"),
        "FILE:14: sweep.b.count: count does not go with v",
    ),
    "unknown solver": (
        ("target: 1e-8", "solver: dopri9\n  steps: 9"),
        "FILE:17: accuracy.solver: must be one of strang2, blanes_moan4, blanes_moan6, processed6, kahan_li8, sofroniou_spaletta10, tsit5, dopri5, dopri8, tsitouras_papakostas8, verner9, nystrom8, rodas5p, adaptive_tsit5, adaptive_dopri5, adaptive_dopri8, adaptive_tsitouras_papakostas8, adaptive_verner9, not the text 'dopri9' (did you mean",
    ),
    "a solver of other flows": (
        ("target: 1e-8", "solver: nystrom8\n  steps: 40"),
        "FILE:17: accuracy.solver: nystrom8 is for flows x'' = F(x, t) - gamma x', and this particle is none",
    ),
    "solver without steps": (
        ("target: 1e-8", "solver: dopri8"),
        "FILE:17: accuracy.solver: solver and steps go together",
    ),
    "steps without solver": (("target: 1e-8", "steps: 100"), "FILE:17: accuracy.steps: solver and steps go together"),
    "no steps": (("target: 1e-8", "steps: 0\n  solver: dopri8"), "FILE:17: accuracy.steps: must be at least 1, not 0"),
    "target zero": (("1e-8", "0"), "FILE:17: accuracy.target: must be at least 1e-13, not 0"),
    "target beyond reach": (("1e-8", "1e-15"), "FILE:17: accuracy.target: must be at least 1e-13, not 1e-15"),
    "target too loose": (("1e-8", "0.5"), "FILE:17: accuracy.target: must be at most 0.01, not 0.5"),
    "levels too few": (("levels: 3", "levels: 0"), "FILE:20: analyses.doubling.levels: must be at least 1, not 0"),
    "levels too many": (("levels: 3", "levels: 99"), "FILE:20: analyses.doubling.levels: must be at most 16, not 99"),
    "no analysis": (
        ("\n  doubling:\n    levels: 3", ""),
        "FILE:18: analyses: at least one analysis is needed; known are",
    ),
    "no system": (
        ("system:\n  constraint: disturbed_speed\n  a: 0.5\n  c: 1.0\n  d: 0.1\n  omega: 1.0\n", ""),
        "FILE:2: system: this key is missing (The constraint",
    ),
    "no sweep": (
        ("sweep:\n  b:\n    start: 6.0\n    stop: 5.0\n    count: 64\n", ""),
        "FILE:2: sweep: this key is missing (The parameter",
    ),
    "no analyses": (
        ("analyses:\n  doubling:\n    levels: 3\n", ""),
        "FILE:2: analyses: this key is missing (Analyses to run",
    ),
    "no constraint": (
        ("  constraint: disturbed_speed\n", ""),
        "FILE:3: system.constraint: this key is missing; it says",
    ),
    "no count": (("    count: 64\n", ""), "FILE:12: sweep.b.count: this key is missing (Number of values"),
    "comparison with an unknown analysis": (
        ("accuracy:", "compare: {dubling: {source: here}}\naccuracy:"),
        "FILE:16: compare.dubling: unknown analysis (did you mean doubling?); known are",
    ),
    "comparison without a source": (
        ("accuracy:", "compare:\n  doubling: {b: [1]}\naccuracy:"),
        "FILE:17: compare.doubling.source: this key is missing (Where",
    ),
    "comparison with text": (
        ("accuracy:", "compare:\n  doubling:\n    source: here\n    b: [null, 1, one]\naccuracy:"),
        "FILE:19: compare.doubling.b.2: must be a number, not the text 'one'",
    ),
    "comparison with infinity": (
        ("accuracy:", "compare: {doubling: {source: here, b: [.inf]}}\naccuracy:"),
        "FILE:16: compare.doubling.b.0: must be a finite number, not .inf",
    ),
    "syntax": (("a: 0.5", "a: [0.5"), "FILE:6: this is not YAML: expected ',' or ']'"),
    "tab": (("  a: 0.5", "\ta: 0.5"), "FILE:5: this is not YAML: found character '\\t'"),
    "control character": (("a: 0.5", "a: \x07"), "FILE:5: this is not YAML: the character U+0007 is not allowed"),
    "anchor": (("a: 0.5", "a: &a 0.5"), "FILE:5: system: anchors (&) and aliases (*) are not used"),
    "alias": (("a: 0.5", "a: *a"), "FILE:5: system: anchors (&) and aliases (*) are not used"),
    "merge key": (("a: 0.5", "<<: {a: 0.5}"), "FILE:5: system: merge keys (<<) are not used"),
    "tag": (
        ("a: 0.5", "a: !!python/name:os.system x"),
        "FILE:5: system: tags (tag:yaml.org,2002:python/name:os.system)",
    ),
    "number as a key": (("a: 0.5", "3: 0.5"), "FILE:5: system: a key must be text"),
    "list as a key": (("a: 0.5", "[a]: 0.5"), "FILE:5: system: a key must be one word"),
    "two documents": (("initial:", "---\ninitial:"), "FILE:9: a second document begins here"),
    "older YAML": (("# a comment\n", "%YAML 1.1\n---\n"), "FILE:1: a config is YAML 1.2"),
    "deep nesting": (("a: 0.5", "a: " + 2000 * "["), "FILE:5: system.a.0: this is nested too deeply"),
    "line break in a key": (("a: 0.5", '"a\\nb": 0.5'), "FILE:5: 'system.a\\nb': unknown key"),
}


@pytest.mark.parametrize(("edit", "message"), FAULTS.values(), ids=FAULTS)
def test_fault_in_the_file(tmp_path, edit, message):
    assert fault(write(tmp_path, edited(edit))).startswith(message)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "FILE:1: the file is empty"),
        ("# only a comment\n", "FILE:1: the file is empty"),
        ("# a comment\n- 1\n", "FILE:2: the top level must be a mapping of keys to values"),
        ("just text\n", "FILE:1: the top level must be a mapping of keys to values"),
        (b"title: fine\nsystem: \xff\xfe\n", "FILE:2: this is not UTF-8 text"),
        (b"\x89HDF\r\n\x1a\n\x00\x00", "FILE:1: this is not UTF-8 text"),
        (b"title: a\nsystem: \x00\n", "FILE:2: this is not YAML: the character U+0000 is not allowed"),
    ],
)
def test_content_that_is_no_config(tmp_path, content, message):
    assert fault(write(tmp_path, content)).startswith(message)


def test_no_such_file(tmp_path):
    assert fault(tmp_path / "absent.yaml") == "FILE: there is no such file"


def test_directory(tmp_path):
    assert fault(tmp_path) == "FILE: this is a directory, not a config file"


def test_name_with_a_null_character():
    assert "cannot be read" in fault(Path("a\0b"))


def test_first_fault_in_the_file_is_reported(tmp_path):
    text = edited(("levels: 3", "levels: 0"), ("a: 0.5", "a: x"), ("count: 64", "count: 0"), ("x2: 0.1", "z: 1"))
    assert fault(write(tmp_path, text)).startswith("FILE:5: system.a:")
    assert fault(write(tmp_path, text), "title=3").startswith("FILE:5: system.a:")


# ---- faults on the command line

OVERRIDE_FAULTS = [
    ("system.d", "system.d: an override is KEY=VALUE; this one has no ="),
    ("=3", "=3: an override is KEY=VALUE"),
    ("system..d=3", "system..d=3: an override is KEY=VALUE"),
    ("system.d=[1,", "system.d: this is not YAML"),
    ("system.d=*x", "system.d: anchors (&) and aliases (*) are not used"),
    ("system.d={a: 1, a: 2}", "system.d: this key is already given"),
    ("system.a.b=1", "system.a.b: system.a is a single value; it has no keys"),
    ("sweep.b={values: [1]} 2", "sweep.b: this is not YAML"),
    ("system.d=2", "system.d: the speed vanishes"),
    ("system.c=0.05", "system.c: the speed vanishes: |d| must be below c, and d is 0.1, c is 0.05"),
    ("system.d='0.05'", "system.d: must be a number, not the text '0.05'"),
    ("system.d=true", "system.d: must be a number, not true"),
    ("system.d=", "system.d: an override is KEY=VALUE; this one has no value (null leaves a key out)"),
    ("system.omega=1.234567891", "system.omega: sin(1.23457 t) and the disturbance sin t have no common period"),
    ("initial.x2=3", "initial.x2: the speed at t = 0 is 1"),
    ("sytem.d=0.05", "sytem: unknown key (did you mean system?)"),
    ("system.e=0.05", "system.e: unknown key; known keys are constraint, a, b, omega, without, c, d"),
    ("analyses.lyapunow={}", "analyses.lyapunow: unknown key"),
    ("system={constraint: constant_speed, d: 0.1}", "system.d: d does not go with constant_speed"),
    ("system.constraint=constant_speed", "system.constraint: d does not go with constant_speed; known keys are"),
    (
        "sweep.b.values=[1]",
        "sweep.b.values: start does not go with values; the only known key is values; sweep.b={...}",
    ),
    ("sweep.b={start: 1, stop: 2}", "sweep.b.count: this key is missing"),
    ("sweep.b.count=1", "sweep.b.count: must be at least 2, not 1"),
    ("sweep.b.stop=6", "sweep.b.stop: start and stop must differ, and both are 6"),
    ("sweep.b.start=5", "sweep.b.start: start and stop must differ, and both are 5"),
    ("accuracy.solver=dopri8", "accuracy.solver: solver and steps go together; give steps as well"),
    ("accuracy.target=-1", "accuracy.target: must be at least 1e-13, not -1"),
    ("analyses={}", "analyses: at least one analysis is needed"),
    ("compare.doubling.b=[1]", "compare.doubling.source: this key is missing"),
]


@pytest.mark.parametrize(("override", "message"), OVERRIDE_FAULTS, ids=[override for override, _ in OVERRIDE_FAULTS])
def test_fault_on_the_command_line(tmp_path, override, message):
    assert fault(write(tmp_path, CONFIG), override).startswith(f"command line: {message}")


@pytest.mark.parametrize("item", ["2", "-1", "x", "1e0", "9" * 5000])
def test_override_of_an_item_that_is_not_there(tmp_path, item):
    path = write(tmp_path, CONFIG)
    message = fault(path, "sweep.b={values: [1, 2]}", f"sweep.b.values.{item}=3")
    assert message.startswith(f"command line: sweep.b.values.{item}: sweep.b.values is a list; it has no item")


def test_override_does_not_take_the_blame_for_the_file(tmp_path):
    path = write(tmp_path, edited(("count: 64", "count: 1")))
    assert fault(path, "sweep.b.start=7").startswith("FILE:15: sweep.b.count:")


# ---- anything at all


def loads_or_says(content: bytes, overrides: list[str]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder), content)
        message = ""
        try:
            experiment = load(path, overrides)
        except ConfigError as error:
            message = str(error)
        else:
            assert load(write(Path(folder), experiment.text)).sha256 == experiment.sha256
        assert len(message.splitlines()) <= 1


YAML_PIECES = st.lists(
    st.sampled_from(
        [
            *CONFIG.splitlines(keepends=True),
            *" \n\t:,-?&*!|>'\"%@`#{}[]\x85\u2028é",
            *("- ", ": ", "? ", "<<: ", "&a ", "*a", "!!int ", "---\n", "%YAML 1.1\n", "\r\n", "b: "),
            *("0x_", "1e5", ".inf", "null", "~", "2001-13-45"),
        ]
    ),
    max_size=30,
).map("".join)


@settings(deadline=None)
@given(st.text())
def test_any_text(text):
    loads_or_says(text.encode("utf-8", "surrogatepass"), [])


@settings(deadline=None)
@given(st.binary())
def test_any_bytes(content):
    loads_or_says(content, [])


@settings(deadline=None)
@given(YAML_PIECES)
def test_any_pieces_of_yaml(text):
    loads_or_says(text.encode(), [])


@settings(deadline=None)
@given(st.integers(0, len(CONFIG)), st.integers(0, 12), YAML_PIECES)
def test_any_damage_to_a_config(at, removed, inserted):
    loads_or_says((CONFIG[:at] + inserted + CONFIG[at + removed :]).encode(), ["sweep.b.count=32"])


JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)


@settings(deadline=None)
@given(st.sampled_from([line.split(":")[0].strip() for line in CONFIG.splitlines()[1:]]), JSON_VALUES)
@example("x2", 1.4e154)  # whose square is infinite
def test_any_value_of_any_key(key, value):
    lines = CONFIG.splitlines()
    (at,) = [i for i, line in enumerate(lines) if line.split(":")[0].strip() == key]
    loads_or_says(
        "\n".join([*lines[:at], f"{lines[at].split(':')[0]}: {json.dumps(value)}", *lines[at + 1 :]]).encode(), []
    )


@settings(deadline=None)
@given(st.dictionaries(st.sampled_from(list(CONTENT)), JSON_VALUES))
def test_any_dict(change):
    message = ""
    try:
        experiment = Experiment.from_dict(CONTENT | change)
    except ConfigError as error:
        message = str(error)
    else:
        assert Experiment.from_text(experiment.text).sha256 == experiment.sha256
    assert len(message.splitlines()) <= 1


@settings(deadline=None)
@given(st.lists(st.text() | st.builds("{}={}".format, st.text("abcdsweptmx.01", max_size=8), YAML_PIECES), max_size=3))
def test_any_overrides(overrides):
    loads_or_says(CONFIG.encode(), overrides)


@settings(deadline=None)
@given(st.sampled_from(["system.a", "sweep.b", "analyses", "compare.doubling", "title", "initial"]), JSON_VALUES)
def test_any_value_as_an_override(key, value):
    loads_or_says(CONFIG.encode(), [f"{key}={json.dumps(value)}"])


# ---- the schema


def test_every_key_of_the_schema_is_described():
    content = schema()
    assert content["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert set(content["properties"]) == set(Experiment.model_fields)
    assert set(content["$defs"]["Analyses"]["properties"]) == set(ANALYSES)
    for model in (content, *content["$defs"].values()):
        assert model["description"]
        for key, about in model["properties"].items():
            assert about.get("description"), key


def test_positions_are_those_of_the_keys(tmp_path):
    lines = CONFIG.splitlines()
    for path, (line, column) in read(write(tmp_path, CONFIG)).positions.items():
        if path:
            assert lines[line - 1][column - 1 :].startswith(f"{path[-1]}:")
