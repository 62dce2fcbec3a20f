"""The studies in sweeps/: what they read, their searches on problems with a known answer, and the pages they write."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
import pytest
import typer
import xarray as xr

import jaxnh
from jaxnh.maps.build import make_return_map
from jaxnh.solvers import SPLITTINGS
from jaxnh.storage import hdf5
from sweeps.peers.particle.peers_cases import held_out, paper
from sweeps.peers.particle.peers_heyoka_tangent import Contestant as HeyokaTangent
from sweeps.peers.particle.peers_jaxnh import Contestant
from sweeps.peers.particle.peers_report import AT_OWN_ERROR, WITHOUT, HeldOut, Row, Scaling, markdown, with_spectra
from sweeps.peers.particle.peers_report import Study as Peers
from sweeps.peers.particle.peers_report import spectra as section_of_spectra
from sweeps.peers.particle.peers_scene import Errors, Scene, Setting, TangentScene, best, least_effort, unit
from sweeps.studies import compositions, critical_slowing
from sweeps.studies.critical_slowing_study import (
    THRESHOLDS,
    Cascade,
    CascadeStudy,
    Law,
    _multisect,
    agreement,
    detected_period,
    needed_transient,
)
from sweeps.timing import effects
from tests.flows.calm_particle import CALM, CALM_B, CALM_STATES, ROUNDOFF
from tests.flows.particle import twin
from tests.helpers import taylor
from tests.helpers.paths import ROOT

# ---- prices of effects


def effects_file(path):
    columns = {
        "what": np.array(["forcing", "lyapunov"]),
        "kind": np.array(["effect", "analysis"]),
        "operations": np.array([1234.4, np.nan]),
        "operations_without": np.array([1000.0, 900.0]),
        "time_ratio": np.array([1.234, np.nan]),
        "stored": np.array([0.0, 4096.0]),
        "note": np.array(["19.0 % of the operations", "of the sweep"]),
    }
    rows = xr.Dataset(
        {name: ("row", data, {"long_name": name}) for name, data in columns.items()},
        attrs={"solver": "kahan_li8", "steps_per_period": 60, "repeats": 3},
    )
    attrs = {
        "jaxnh_version": "0.1.0", "title": path.stem, "device": "cpu", "solver": "processed6", "steps_per_period": 200
    }  # fmt: skip
    hdf5.write(path, attrs, {"effects": rows})


def test_page_of_effects(tmp_path):
    """A part for every scene, with rows in words and numbers; bytes of analyses alone."""
    for name in effects.SCENES:
        effects_file(tmp_path / f"{name}_effects.h5")
    effects.main(tmp_path)
    page = (tmp_path / "effects.md").read_text()
    assert [line for line in page.splitlines() if line.startswith("## ")] == [
        f"## {name}_effects" for name in effects.SCENES
    ]
    assert "| forcing | 1,234 | 1,000 | 1.23 |  | 19.0 % of the operations |" in page
    assert "| lyapunov | – | 900 | – | 4,096 | of the sweep |" in page
    assert "effects by kahan_li8 in 60 steps a period, tangents and analyses by processed6 in 200" in page
    assert "the median of 3 pairs" in page


def test_page_of_effects_that_are_not_priced(tmp_path, capsys):
    hdf5.write(tmp_path / "table1_effects.h5", {"jaxnh_version": "0.1.0"}, {"other": xr.Dataset()})
    with pytest.raises(jaxnh.ResultError, match="has no prices of effects"):
        effects.page(tmp_path)
    with pytest.raises(typer.Exit):
        effects.main(tmp_path)
    assert "run `make effects`" in capsys.readouterr().err


# ---- critical slowing down

TABLE = ROOT / "configs" / "table1.yaml"


def doublings(path, config, b):
    level = np.arange(1, len(b) + 1)
    data = xr.Dataset(
        {
            "period": ("level", 2 ** (level - 1), {"long_name": "period"}),
            "b": ("level", np.asarray(b, float), {"long_name": "coupling b"}),
        },
        coords={"level": ("level", level, {"long_name": "level"})},
    )
    hdf5.write(path, {"jaxnh_version": "0.1.0", "config": config}, {"doubling": data})


def test_cascade_of_a_result(tmp_path):
    """Doublings found, the distances ahead of them, published values beside them, and the start state of the config."""
    path = tmp_path / "table1.h5"
    found = [5.5196, 5.4955, 5.4894, np.nan]
    doublings(path, TABLE.read_text(), found)
    cascade = critical_slowing.read_cascade(path)
    experiment = jaxnh.load(TABLE)
    assert cascade.title == experiment.title
    np.testing.assert_array_equal(cascade.n, [1, 2, 4])
    np.testing.assert_array_equal(cascade.b, found[:3])
    np.testing.assert_allclose(cascade.ahead, [-0.0241, -0.0061, -(0.0061**2) / 0.0241], rtol=1e-9)
    np.testing.assert_array_equal(cascade.published, experiment.compare["doubling"].columns()["b"][:3])
    assert cascade.start[0] == (0.1, 0.1)
    np.testing.assert_allclose(cascade.start[1], (0.1, math.sqrt(0.99)), rtol=1e-15)
    np.testing.assert_allclose(cascade.before(cascade.b - 1e-3), -1e-3, rtol=1e-9)


def test_results_that_are_no_table(tmp_path):
    path = tmp_path / "table1.h5"
    with pytest.raises(critical_slowing.Missing, match="run `make table1 table2` first"):
        critical_slowing.read_cascade(path)
    doublings(path, TABLE.read_text(), [5.5196, np.nan])
    with pytest.raises(critical_slowing.Missing, match="fewer than three doublings"):
        critical_slowing.read_cascade(path)
    hdf5.write(path, {"jaxnh_version": "0.1.0", "config": TABLE.read_text()}, {"other": xr.Dataset()})
    with pytest.raises(critical_slowing.Missing, match="no table of doublings"):
        critical_slowing.read_cascade(path)
    path.write_text("no HDF5")
    with pytest.raises(critical_slowing.Missing, match="no table of doublings"):
        critical_slowing.read_cascade(path)


def test_plain_detection_of_a_period():
    """The least p that recurs within the threshold; none where nothing does; a slow spiral is taken for its half."""
    steps = np.arange(16)
    rows = [np.ones(16), steps % 2, steps % 4, np.sqrt(steps), 1e-5 * (-1.0) ** steps]
    x1, threshold = np.array(rows, float), np.array([1e-4, 1e-4, 1e-4, 1e-4, 1e-4])
    np.testing.assert_array_equal(detected_period(x1, threshold), [1, 2, 4, 0, 1])
    np.testing.assert_array_equal(detected_period(x1, 0.1 * threshold), [1, 2, 4, 0, 2])


def test_multisection_finds_where_a_verdict_turns():
    """From a bracket that holds it, and from one that misses it inside the window; NaN where the window misses it."""
    turn = np.array([0.3, -0.7, 2.0])
    window = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
    bracket = np.array([[0.0, 0.2, -0.5], [1.0, 0.4, 0.5]])
    found = _multisect(lambda values, jobs: values > turn[jobs], bracket, window, np.full(3, 1e-9))
    np.testing.assert_allclose(found[:2], turn[:2], atol=1e-9)
    assert np.isnan(found[2])


def test_law_of_the_bias():
    """ε² γ N = n ln(1 + s)/2s with s = κβ/γε²: late below N*, early above it, zero there."""
    law, n = Law(np.array([20.0]), np.array([70.0]), np.zeros(1)), np.array([1])
    crossing, threshold = law.crossing(n, 1e-3)[0], 1e-3
    transients = crossing * np.array([0.01, 0.3, 1.0, 1.5])
    bias = law.bias(n, transients, threshold)[0]
    s = 20.0 * bias / (70.0 * threshold**2)
    with np.errstate(invalid="ignore"):
        ratio = np.where(np.abs(s) < 1e-2, 1.0, np.log1p(s) / s)
    np.testing.assert_allclose(ratio, transients / crossing, rtol=1e-4)
    assert np.sign(bias).tolist()[:2] == [1.0, 1.0]
    assert bias[3] < 0
    measured = 1.0 / transients
    assert needed_transient(measured, transients, measured[1]) == pytest.approx(transients[1])
    assert needed_transient(measured, transients, 0.0) == math.inf
    assert needed_transient(measured, transients, 1.0) == 0.0


def test_agreement_with_published_values():
    """Biases C/N that two rows ask for at N = 400 and 900: the N within a factor of two are known, as is what is not."""
    transients = np.geomspace(100, 10_000, 9)
    needed = np.array([400.0, 900.0])
    published = np.array([1e-4, 2e-5])
    bias = (published * needed)[:, None, None] / transients * np.ones((2, len(THRESHOLDS), 1))
    nothing, unknown = np.zeros(2), np.full(2, np.nan)
    cascade = Cascade("", None, None, np.array([1, 2]), nothing, nothing, nothing, "")
    study = CascadeStudy(cascade, Law(unknown, unknown, unknown), bias, bias, published)
    found = agreement([study], transients, 0)
    assert found.most == 2
    np.testing.assert_allclose(found.best, (450, 800), rtol=5e-3)  # the N tried lie 0.23 % apart
    np.testing.assert_allclose(found.half, (200, 1800), rtol=5e-3)
    np.testing.assert_allclose(found.each, (400, 900), rtol=1e-9)
    rounded = study._replace(published_bias=np.array([1e-4, 9e-7]))  # below a last digit: says nothing
    assert agreement([rounded], transients, 0).most == 1


# ---- the search for compositions


@pytest.mark.slow
def test_free_algebra():
    """exp and log undo each other; a symmetric composition has no even terms; processed6 leaves none of degree 3 or 5."""
    solver = SPLITTINGS["processed6"]
    words = compositions.word_series(jnp.asarray(solver.drifts), jnp.asarray(solver.kicks), 5)
    log = compositions.logarithm(words)
    for one, other in zip(compositions.exponential(log), words, strict=True):
        assert np.abs(np.asarray(one) - np.asarray(other)).max() < 1e-13
    np.testing.assert_allclose(log[1], [1.0, 1.0], atol=1e-14)
    for even in (2, 4):
        assert np.abs(np.asarray(log[even])).max() < 1e-14
    assert [len(compositions.irremovable(n)) for n in (3, 5, 7)] == [1, 3, 9]
    left, _ = compositions.conjugated(jnp.asarray(solver.drifts), jnp.asarray(solver.kicks), 5)
    assert max(float(np.abs(np.asarray(terms)).max()) for terms in left) < 1e-12


# ---- peers


def test_least_effort_of_a_power_law():
    """Errors that fall as n⁻⁶: the least whole n, or none up to the most."""

    def measure(n):
        return Errors((n / 100) ** -6.0, 0.0)

    effort, errors = least_effort(measure, 1e-8, 300.0, factor=1.5, most=1e5, whole=True)
    assert 0.9e-8 <= errors.max <= 1e-8
    assert effort == int(effort)
    assert least_effort(measure, 1e-8, 300.0, factor=1.5, most=1000.0) is None


def test_best_setting():
    fast, slow = (Setting("a", "", 1.0, "", Errors(0.0, 0.0), rate=rate) for rate in (2.0, 1.0))
    assert best([slow, fast]) is fast
    few, many = (Setting("a", "", 1.0, "", Errors(0.0, 0.0), kicks=kicks) for kicks in (10, 20))
    assert best([many, few]) is few


@pytest.mark.parametrize("name", CALM)
def test_errors_of_a_contestant(name):
    """Of its map in components of (x1, y1, n1, n2), against the reference: those of its method, and no more."""
    system = CALM[name]
    ends = taylor.strobe(twin(system), CALM_B, CALM_STATES)
    scene = Scene(system.a, system.c, system.d, CALM_B, CALM_STATES, unit(ends))
    contestant = Contestant(scene)
    coarse, fine = (
        contestant.errors(make_return_map(contestant.system, SPLITTINGS["kahan_li8"], n)).max for n in (40, 80)
    )
    assert fine < 2.0**-7 * coarse + ROUNDOFF < 1e-10  # order eight, one power left for the terms that follow


def test_scenes_held_out():
    """The same for a seed; the fixed one first; both systems; none of them the scene that a solver was chosen on."""
    cases = held_out()
    assert cases == held_out()
    assert held_out(1)[1:] != cases[1:]
    first = cases[0]
    assert (first.a, first.c, first.d, first.low, first.high) == (0.8, 1.6, 0.0, 1.1, 5.3)
    assert {bool(case.d) for case in cases} == {True, False}
    assert all(abs(case.d) < case.c for case in cases)
    assert all((case.a, case.c) != (paper().a, paper().c) for case in cases)


def test_page_of_peers():
    """Ratios at heyoka's own error, scenes held out with and without the searched splitting, and Python's share."""

    def row(name, ratio, form="processed6", python=()):
        setting = Setting(name, form, 90.0, "90 steps", Errors(1e-7, 1e-8), kicks=748)
        return Row(1e-6, name, setting, [1e5] * 3, [1.0] * 3, [ratio] * 3, [ratio] * 3, list(python))

    spectra = [row("jaxnh", 1.0), row("heyoka batch", 3.0, "time", [0.25]), row(AT_OWN_ERROR, 2.0)]
    others = [row("heyoka batch", 3.0), row(AT_OWN_ERROR, 2.0), row(AT_OWN_ERROR + WITHOUT, 1.25, "blanes_moan6")]
    study = Peers(
        command="python -m sweeps.peers.particle.peers",
        case=paper(),
        measured_at="Measured at commit 0.",
        cores=1,
        repeats=3,
        rows=[row("jaxnh", 1.0), row("heyoka batch", 3.0), row(AT_OWN_ERROR, 2.0)],
        tried={},
        chosen=spectra[0].setting,
        lanes=[Scaling("256 × 64", [2.0], [1.0], [1.0]), Scaling("1,024 × 16", [1.0], [1.0], [0.5])],
        two_cores=None,
        lyapunov=spectra,
        held_out=[HeldOut(held_out()[0], others)],
        seconds=1.0,
    )
    page = markdown(study, "old\n<!-- Below this line: written by hand, kept by the next run. -->\nby hand\n")
    assert "Measured at commit 0." in page
    assert "| heyoka batch, at the error that it has | 2.00 ± 0.00× (meets 1.5) |" in page
    assert (
        "| held out 1 | 1e-06 | 1.0e-07 | 100,000 ± 0% | processed6, 748 | 2.00 ± 0.00× | blanes_moan6, 748 | 1.25 ± 0.00× |"
        in page
    )
    assert "time; 90 steps; Python's share 25.0%" in page
    assert "2.00 ± 0.00× (meets 1.5) heyoka; 1.50× were Python's share nothing" in page
    assert "| 1,024 × 16 | 1 ± 0% | 1.00 | 0.50 ± 0.00× | misses within 15% of 1 |" in page
    assert page.endswith("-->\nby hand\n")
    again = with_spectra(
        page, section_of_spectra([row("jaxnh", 1.0)], "python -m sweeps.peers.particle.peers --only lyapunov", "At 1.")
    )
    assert "`python -m sweeps.peers.particle.peers --only lyapunov`" in again
    assert "At 1. A row of jaxnh averages" in again
    assert "Python's share 25.0%" not in again
    assert again.partition("## Lyapunov")[0] == page.partition("## Lyapunov")[0]
    assert again.partition("## Forms tried")[2] == page.partition("## Forms tried")[2]
    with pytest.raises(SystemExit, match="run all of it first"):
        with_spectra("", "")


def test_tangents_as_heyoka_is_driven():
    """Growth while tangents are orthonormalised often: its sum is ln |det| of the derivative over the same time.

    At equal times over one period, against the reference; after whole steps, over the time that each lane has come.
    Calls with nothing to integrate leave all alone.
    """
    system = CALM["disturbed"]
    b, states = CALM_B[:4], CALM_STATES[:4]
    derivatives = taylor.strobe_jacobian(twin(system), b, states)[1]
    both = np.tile(b, 2), np.tile(states, (2, 1)), np.zeros((8, 4))
    contestant = HeyokaTangent(TangentScene(system.a, system.c, system.d, *both, derivatives))
    fleet = contestant.fleet(("clock equations", 2, (), 18))

    def volume(tangents):
        return np.log(np.abs(np.linalg.det(np.asarray(tangents, float))))

    logs = contestant.grown(fleet, 8, 0, system.period, periods=1)
    np.testing.assert_allclose(logs.sum(axis=0), volume(derivatives), atol=1e-11)
    assert np.abs(contestant.grown(fleet, 8, 0, 0.0, periods=1)).max() == 0.0
    logs = contestant.grown(fleet, 4, 2, system.period, periods=1)
    for ta, view, part in fleet:
        times = ta.time.copy()
        assert times.min() > 0.0
        contestant.reset(ta, states[part], b[part])
        ta.propagate_until(times.tolist())
        np.testing.assert_allclose(logs[:, part].sum(axis=0), volume(view.T.reshape(-1, 3, 3)), atol=1e-11)
