"""An atlas through the whole package: the Hopf curve of the Brusselator in closed form, and from numbers to orbits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxnh
from jaxnh.analyses.registry import ANALYSES
from jaxnh.exceptions import ConfigError
from jaxnh.explorer.atlas import limits_of
from jaxnh.explorer.overlays import layers_of
from jaxnh.explorer.recording import source_of
from jaxnh.orbits.continuation.kinds import KINDS
from tests.helpers import contract
from tests.helpers.kept_programs import QUICKLY_COMPILED, lanes_with_kept_programs, session_of
from tests.helpers.paths import ROOT

BRUSSELATOR = """\
def system(a=1.0, b=2.0):
    def rhs(state, t):
        u, y = state  # x - a, so that the equilibrium is on u = 0 at every a
        x = u + a
        return a - (b + 1.0) * x + x * x * y, b * x - x * x * y

    return {"rhs": rhs, "coordinates": ("u", "y")}
"""
CONFIG = """\
system: {file: brusselator.py}
initial: {u: 0.1, y: 2.0}
section: {coordinate: u, value: 0.0, direction: up, longest_return: 100}
sweep: {b: {start: 1.5, stop: 2.5, count: 5}, a: {values: [0.9, 1.0, 1.1]}}
accuracy: {solver: tsit5, steps: 40}
analyses:
"""
OPTIONS = "{max_period: 1, transient: 16, n_values: 2, equilibria: 4, levels: 0, box: {u: [-1, 1], y: [0.5, 4]}}"


def experiment(folder, *analyses):
    (folder / "brusselator.py").write_text(BRUSSELATOR)
    (folder / "flow.yaml").write_text(CONFIG + "".join(f"  {line}\n" for line in analyses))
    return jaxnh.load(folder / "flow.yaml")


@pytest.mark.slow  # the matrix has an atlas, and Hopf curves and cycles are quick
@pytest.mark.usefixtures("uncalibrated")
def test_the_hopf_curve_of_the_brusselator(tmp_path):
    """b = 1 + a² on both rows and along the curve that the Hopf points lead to, with the equilibrium (a, b/a) there."""
    session = session_of(experiment(tmp_path, f"atlas: {OPTIONS}"))
    session._lanes = lanes_with_kept_programs(None, session._lanes.devices[:1], 32, QUICKLY_COMPILED)
    groups = session.tree()
    for name, group in groups.children.items():
        contract.check(name, group.to_dataset(), ["u", "y", "a", "b", "t"])
    points, curves, orbits = (groups[name].to_dataset() for name in ("bifurcations", "curves", "curve_orbits"))
    hopf = points.isel(bifurcation=np.flatnonzero(points["kind"] == KINDS.index("hopf")))
    assert hopf["a"].values.tolist() == [0.9, 1.1]
    assert np.all(np.abs(hopf["b"] - (1 + hopf["a"] ** 2)) <= hopf["b_error"] + 1e-12)
    # One curve in all, and one Hopf point a row: in closed form there is no other, and by hand no cycle folds (below).
    assert (points.sizes["bifurcation"], curves.sizes["curve"]) == (2, 1)
    [number] = np.unique(hopf["curve"])
    curve, orbit = curves.isel(curve=number), orbits.isel(curve=number, iterate=0)
    assert KINDS[int(curve["kind"])] == "hopf"
    assert int(curve["period"]) == 0
    a, b = (curve[name].values[np.isfinite(curve["a"].values)] for name in "ab")
    assert np.abs(b - (1 + a**2)).max() < 1e-9
    assert np.ptp(a) == pytest.approx(0.2)
    assert np.abs(orbit["u_points"].values[: len(a)]).max() < 1e-9
    assert np.abs(orbit["y_points"].values[: len(a)] - b / a).max() < 1e-9
    branches = groups["branches"].to_dataset()
    born = branches.isel(branch=np.flatnonzero(branches["period"] == 1))
    assert sorted(set(born["a"].values)) == [0.9, 1.1]
    beyond = born["b"].values - (1 + born["a"].values[:, None] ** 2)
    assert np.nanmin(beyond) >= -1e-6
    with np.errstate(invalid="ignore"):
        assert np.all(born["stable"].values[beyond > 1e-3] == 1)  # nearer the multiplier is one to what steps leave
    data = groups["atlas"].to_dataset()
    assert [int(data[name].sum()) for name in ("branches", "bifurcations", "windows")] == [
        groups[name].sizes[dim]
        for name, dim in (("branches", "branch"), ("bifurcations", "bifurcation"), ("windows", "window"))
    ]
    table = ANALYSES["atlas"].table(data, {}, "")
    assert [row[0] for row in table.rows] == ["0.9", "1.1"]
    assert "at a = 0.9, 1.1; equilibria" in table.caption
    jaxnh.figure(groups)
    source = source_of(groups, "atlas.h5")  # there is no chart
    assert source.first.ranges == {"b": (1.5, 2.5), "a": (0.9, 1.1)}
    layers = {layer.name: layer.items for layer in layers_of(source.overlays, "b", "a")}
    [along] = layers["hopf, equilibria"]
    k = len(a) // 2
    assert along.orbit(k)["y"] == pytest.approx([along.x[k] / along.y[k]])  # b/a
    assert dict(layers["hopf"][0].facts(0))["on the curve of number"] == f"{number}"
    assert {float(item.y[0]) for item in layers["period 1, stable"]} == {0.9, 1.1}
    assert "complete to orbits of periods up to 1" in limits_of(source.overlays)[0]


@pytest.mark.slow
def test_the_brusselator_has_no_other_curve():
    """What the atlas's count is held against: one curve of Hopf points, and none of folds or doublings.

    The Jacobian at the equilibrium (a, b/a) has the determinant a² and the trace b − 1 − a²: no fold, and Hopf points on
    one curve. Cycles are zeros of P(y) − y of the returns to u = 0, rising, y > b/a, by DOP853: one beyond the curve,
    where P(y) − y passes zero from above to below, so that none folds, and none in front of it. In a plane none doubles.
    """

    def excess(a, b, y):
        def rates(t, s):
            x = s[0] + a
            return a - (b + 1.0) * x + x * x * s[1], b * x - x * x * s[1]

        def crosses(t, s):
            return s[0]

        crosses.direction = 1
        whole = solve_ivp(rates, (0.0, 60.0), [0.0, y], "DOP853", rtol=1e-10, atol=1e-12, events=crosses)
        return whole.y_events[0][whole.t_events[0] > 0.1][0, 1] - y

    for a in (0.9, 1.0, 1.1):
        for b in (1.5, 1.75, 2.0, 2.25, 2.5):
            if abs(b - 1 - a * a) < 0.05:
                continue
            beyond = np.array([excess(a, b, b / a + gap) for gap in (0.05, 0.15, 0.3, 0.6, 1.0, 1.5, 2.0, 3.0)])
            changes = np.flatnonzero(np.diff(np.sign(beyond)))
            assert len(changes) == (b > 1 + a * a), (a, b, beyond)
            assert beyond[-1] < 0.0


@pytest.mark.slow
def test_the_particle_over_b_and_d():
    """The first doublings at d = 0 and 0.1 are those of Tables 1 and 2, by splittings; one curve goes through each."""
    settings = [
        "sweep.b.count=9",
        "sweep.d.count=2",
        "analyses={atlas: {max_period: 2, transient: 256, n_values: 2, levels: 0}}",
    ]
    groups = session_of(jaxnh.load(ROOT / "configs/atlas_particle.yaml", settings)).tree()
    points = groups["bifurcations"].to_dataset()
    doublings = points.isel(bifurcation=np.flatnonzero(points["kind"] == KINDS.index("period_doubling")))
    numbers: dict[int, list[int]] = {1: [], 2: []}
    for row, name in enumerate(("table1", "table2")):
        known = jaxnh.open_result(ROOT / f"results/{name}.h5")["doubling"]
        for n in numbers:
            here = doublings.isel(bifurcation=np.flatnonzero((doublings["row"] == row) & (doublings["period"] == n)))
            gap = np.abs(here["b"].values - float(known["b"][n - 1]))
            k = int(np.argmin(gap))
            assert gap[k] <= float(here["b_error"][k]) + float(known["b_error"][n - 1])
            numbers[n].append(int(here["curve"][k]))
    kinds, periods = groups["curves"]["kind"].values, groups["curves"]["period"].values
    for n, (first, second) in numbers.items():
        assert first == second >= 0
        assert (KINDS[kinds[first]], periods[first]) == ("period_doubling", n)


@pytest.mark.parametrize(
    ("analyses", "message"),
    [
        ([f"atlas: {OPTIONS}", "curves: {}"], "atlas makes the group curves itself; leave it out"),
        (
            [f"atlas: {OPTIONS.replace('equilibria: 4, ', '')}"],
            "goes with equilibria, the number of random starts in it",
        ),
        ([f"atlas: {OPTIONS.replace('u: [', 'q: [')}"], "no coordinate q"),
    ],
)
def test_what_an_atlas_cannot_do_is_said(tmp_path, analyses, message):
    with pytest.raises(ConfigError, match=message):
        experiment(tmp_path, *analyses)


def test_an_atlas_has_two_axes(tmp_path):
    experiment(tmp_path, f"atlas: {OPTIONS}")
    with pytest.raises(ConfigError, match="over two axes of more than one value, and the sweep has b"):
        jaxnh.load(tmp_path / "flow.yaml", ["sweep.a=null"])
