"""Effects left out: programs that are the same or smaller, crossings and spectra against references, what is refused."""

from __future__ import annotations

import math
import re
import time

import jax
import numpy as np
import pytest
import xarray as xr

import jaxnh
from jaxnh.analyses import chaos01, verdict
from jaxnh.analyses.base import LANE
from jaxnh.analyses.exponents import lyapunov
from jaxnh.analyses.periodic import period
from jaxnh.analyses.price import map_alone
from jaxnh.analyses.registry import ANALYSES
from jaxnh.analyses.trajectories import diagram, poincare
from jaxnh.cli import pricing
from jaxnh.costs import effects as costs_of_effects
from jaxnh.costs.operations import count
from jaxnh.engine.experiment import load
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import iterate
from jaxnh.maps.section import Crossing, Section
from jaxnh.solvers import SPLITTINGS, tsit5
from jaxnh.systems.free_particle import free_particle
from jaxnh.systems.lagrangian import Motion
from jaxnh.systems.particle import constant_speed, disturbed_speed
from sweeps.timing import effects as page_of_effects
from tests.flows.unforced_particle import ANGLE, LANES, SPLITTING, START, P, write_config
from tests.helpers import taylor
from tests.helpers.batches import batch_of, broadcast_start
from tests.helpers.paths import ROOT

EFFECTS = ("forcing", "coupling", "cubic_stiffness")


def particle_without(*names, **others):
    return constant_speed(without=names, **others)


def spread(start, count=LANES):
    return broadcast_start(start, count)


def lowered(system, function=iterate):
    """The text that is compiled for three periods of a system."""
    strobe = make_return_map(system, SPLITTINGS["blanes_moan6"], 40)

    def tile(shared, z, p):
        return jax.vmap(lambda z, p: function(shared, 3, z, p))(z, p)

    return jax.jit(tile).lower(strobe, spread(START), P).as_text()


def operations(lanes, system):
    """Floating-point operations a period of the map of a system, under 40 steps."""
    strobe = make_return_map(system, SPLITTINGS["blanes_moan6"], 40)
    text, tile = lanes.program(iterate, (strobe, np.int32(1)), (spread(START), P))
    return count(text, tile).total((1.0, *strobe.trip_counts))


# ---- programs


def test_no_disturbance_is_constant_speed():
    """d = 0 compiles to the same text as constant speed, and not to another table."""
    assert lowered(disturbed_speed(d=0.0)) == lowered(constant_speed())
    tables = [make_return_map(s, SPLITTING, 40).table for s in (disturbed_speed(d=0.0), constant_speed())]
    np.testing.assert_array_equal(*tables)


def test_operations_are_those_of_a_kick(lanes):
    """Counted by hand: drift 4, force 15, z 3, N and D 7, m 6, its two products 6, quotient 2, n' 4; 11 at the end."""
    kicks = SPLITTINGS["blanes_moan6"].total_kicks(40)
    at_the_end = 4 + 7  # the last drift, and 1/|n|
    assert operations(lanes, constant_speed()) == kicks * (4 + 15 + 3 + 7 + 6 + 6 + 2 + 4) + at_the_end


@pytest.mark.parametrize(
    ("left_out", "saved"), [(("forcing",), 2), (("coupling",), 4), (("cubic_stiffness",), 6), (EFFECTS, 10)]
)
def test_operations_fall_with_every_effect(lanes, left_out, saved):
    """In a kick the coupling has two products, times a weight and a sum: 4; the cubic stiffness 3 and 3; the forcing 2.

    With a force of one term the weight of the coupling is that of all, and the forcing then saves nothing more. Without
    a clock every step has a last drift and a 1/|n| of its own.
    """
    kicks = SPLITTINGS["blanes_moan6"].total_kicks(40)
    ends = 39 * 11 if "forcing" in left_out else 0
    assert operations(lanes, constant_speed()) - operations(lanes, particle_without(*left_out)) == kicks * saved - ends


# ---- spectra


@pytest.fixture(scope="module")
def spectrum(lanes):
    """Scene without forcing, chaotic but at the last b, and its three exponents."""
    system = Section(particle_without("forcing"), "y1", 1, 0.0, "up")
    scene = batch_of(system, Crossing(START, 0.0, 0.0), [0.5, 0.8, 1.2], SPLITTING, 100, error=1e-9)
    options = lyapunov.LyapunovOptions(transient=64, periods=1024)
    return scene, lyapunov.run(options, scene, lanes)


@pytest.mark.slow
def test_exponents_pair_about_zero(spectrum):
    """One is zero, along the flow, and the others are ±λ: the divergence is a time derivative (Dettmann and Morriss).

    Of the sum a finite average keeps the difference of V/c and of the flow's speed between its ends: less than ten.
    """
    scene, group = spectrum
    exponents = group["exponents"].to_numpy()
    time = group["averaging_periods"].to_numpy() * scene.flow.period
    np.testing.assert_array_equal(exponents[:, 1], 0.0)
    np.testing.assert_array_equal(group["exponents_error"].to_numpy()[:, 1], 0.0)
    assert np.all(np.abs(exponents.sum(axis=1)) < 10 / time)
    # Steps are right to 1e-9 a period: so well do they keep the direction of the flow, whose growth is that of the field,
    # and the growth in them to a hundred times that.
    assert np.abs(group["sum_rule_residual"].to_numpy()).max() < 1e-7
    assert np.abs(group["volume_residual"].to_numpy()).max() < 1e-9
    largest, error = exponents[:, 0], group["exponents_error"].to_numpy()[:, 0]
    assert largest[0] > 3 * error[0]  # chaos
    assert largest[1] > 0.1 * largest[0]  # chaos that lingers beside tori, as its wider bar says
    assert largest[2] < 0.02 * largest[0]  # order: tangents grow in proportion to time, and so ln T/T


@pytest.mark.slow
def test_exponent_against_taylor(spectrum):
    """The largest exponent, by Taylor variational equations in float64 on the same lane, within both error bars."""
    scene, group = spectrum
    i = int(np.argmax(group["exponents"].to_numpy()[:, 0]))
    found = taylor.still_exponents(ANGLE + 1e-6 * np.arange(8)[:, None], scene.p["b"][i], 2000.0)
    bar = 2.5 * found.std(ddof=1) / math.sqrt(len(found))
    ours, error = (group[name].to_numpy()[i, 0] for name in ("exponents", "exponents_error"))
    assert bar + error < 0.5 * ours
    assert abs(found.mean() - ours) < bar + error


@pytest.mark.slow
def test_one_exponent_is_one_tangent(lanes, spectrum):
    """One exponent alone is the largest of three, the same where motion is orderly; it carries one tangent, three two."""
    scene, group = spectrum
    one = lyapunov.run(lyapunov.LyapunovOptions(transient=64, periods=1024, exponents=1), scene, lanes)
    assert one["exponents"].to_numpy().shape == (3, 1)
    np.testing.assert_allclose(one["exponents"].to_numpy()[2], group["exponents"].to_numpy()[2, :1], atol=1e-7)
    assert lyapunov.tangents(lyapunov.LyapunovOptions(exponents=1), scene) == 1
    assert lyapunov.tangents(lyapunov.LyapunovOptions(exponents=3), scene) == 2


@pytest.mark.slow
@pytest.mark.parametrize("exponents", [1, 4])
def test_motion_that_comes_to_rest(lanes, exponents):
    """A free particle with damping and no forcing ends at rest: no exponent is zero, that along the flow neither.

    Without coupling they are those of μ² + aμ + k = 0 with k = a and k = 1: both pairs have the real part −a/2. All four
    add up to the divergence, which is −2a everywhere: to the error of the map.
    """
    flow = free_particle(0.5, None, 1.0, ("forcing", "coupling"))
    system = Section(flow, "x1", 0, 0.0, "up")
    start = Crossing(Motion((0.1, 0.1), (0.1, 0.2), (0.0, 0.0)), 0.0, 0.0)
    scene = batch_of(system, start, [0.0, 0.0], tsit5, 60, error=1e-8)
    options = lyapunov.LyapunovOptions(transient=8, periods=64, exponents=exponents)
    found = lyapunov.run(options, scene, lanes)["exponents"].to_numpy()
    assert found.shape == (2, exponents)
    np.testing.assert_allclose(found, -0.25, atol=0.01)  # beats of rotating pairs over T
    if exponents == 4:
        np.testing.assert_allclose(found.sum(axis=1), -1.0, atol=1e-6)


@pytest.mark.slow
def test_other_analyses_on_a_section(lanes, spectrum):
    """The 0–1 test parts order from chaos on crossings; nothing is attracting, so that no period is found."""
    scene, group = spectrum
    largest = group["exponents"].to_numpy()[:, 0]
    k = chaos01.run(chaos01.Chaos01Options(transient=16, periods=600), scene, lanes)["k_median"].to_numpy()
    assert k[np.argmax(largest)] > 0.8
    assert k[np.argmin(largest)] < 0.2
    found = period.run(period.PeriodOptions(max_period=2, transient=16), scene, lanes)
    np.testing.assert_array_equal(found["period"].to_numpy(), 0)
    assert found["period"].attrs["counted_in"] == "crossings"


@pytest.mark.slow
def test_diagram_from_random_starts(lanes, spectrum):
    """Crossings with their times, rising, in each of the dimensions of the diagram."""
    scene, _ = spectrum
    options = diagram.DiagramOptions(transient=2, strobes=8, start="random", n_starts=3)
    group = diagram.run(options, scene, lanes)
    assert group["t"].dims == (LANE, "start", "strobe")
    assert np.all(np.diff(group["t"].to_numpy(), axis=-1) > 0)
    assert np.abs(group["y1"].to_numpy()).max() < 1e-14
    assert group.attrs["section"] == "y1 = 0, up"
    assert poincare.ANALYSIS.count(group) == {"trajectories": 9, "failed": 0}


# ---- configs


@pytest.fixture
def config(tmp_path):
    return write_config(tmp_path)


@pytest.mark.slow
def test_run_of_a_scene_without_a_clock(result, config):
    """One config to one file that opens: crossings with their times, a portrait in time, the exponents."""
    path, out, _ = result("effects", config)
    tree = xr.open_datatree(path, engine="h5netcdf").load()
    assert tree.attrs["section"] == "y1 = 0, up"
    maps = tree["poincare"].to_dataset()
    assert maps["t"].dims == ("b", "strobe")
    assert np.all(np.diff(maps["t"].to_numpy(), axis=1) > 0)
    assert maps["status"].to_numpy().tolist() == [0, 0]
    speed = maps["x2"].to_numpy() ** 2 + maps["y2"].to_numpy() ** 2
    np.testing.assert_allclose(speed, 1.0, atol=1e-14)
    assert np.all(maps["y2"] > 0)
    assert tree["diagram"].to_dataset()["t"].dims == ("b", "strobe")
    np.testing.assert_allclose(np.diff(tree["portrait"]["t"].to_numpy()), 2 * math.pi / 8)
    assert "error of one return" in out


@pytest.mark.slow
def test_price_of_every_effect(tmp_path, capsys):
    """Of each effect: fewer operations without it, or as many in another program; tangents add up; storage is counted."""
    overrides = ["accuracy={solver: blanes_moan6, steps: 40}", "analyses.portrait={periods: 2, samples: 16}"]
    experiment = load(ROOT / "configs" / "fig06.yaml", overrides)
    path = tmp_path / "effects.h5"
    pricing.price_effects(experiment, path, 1, time.perf_counter())
    group = xr.open_datatree(path, engine="h5netcdf").load()["effects"].to_dataset()
    columns = {name: variable.to_numpy() for name, variable in group.variables.items()}
    rows = {str(what): i for i, what in enumerate(columns["what"])}
    for what in ("forcing", "coupling", "cubic_stiffness", "constraint"):
        assert columns["operations_without"][rows[what]] < columns["operations"][rows[what]], what
    for what in ("disturbance", "damping"):
        assert columns["operations_without"][rows[what]] == columns["operations"][rows[what]], what
        assert str(columns["note"][rows[what]]).startswith("free: ")
    measured = columns["time_ratio"][[i for what, i in rows.items() if columns["kind"][i] == "effect"]]
    assert np.all(measured > 0)
    assert not np.any(measured == 1.0)  # two programs that were timed are never equal to the last bit
    tangents = [columns["operations"][rows[f"tangent {k}"]] for k in (1, 2, 3)]
    assert columns["operations_without"][rows["tangent 1"]] < tangents[0] < tangents[1] < tangents[2]
    assert (
        columns["stored"][rows["portrait"]] == 4 * 8 * 2 * 16 + 1
    )  # four numbers of eight bytes a sample, and a status
    assert columns["stored"][rows["poincare"]] == 4 * 8 * 2048 + 1
    out = capsys.readouterr().out
    assert all(any(line.startswith(what) for line in out.splitlines()) for what in rows)


def test_price_of_the_walks(lanes):
    """chaos01 costs more than its map, by what its walks do: counted by hand, to a tenth.

    Of N strobes and 64 angles, each has two walks: of the N/10 displacements of both over 9N/10 strobes a difference,
    a square and a sum. Beside these 64 × N/10 × 9N/10 × 6 operations all else is in proportion to N.
    """
    scene = batch_of(constant_speed(), START, np.linspace(5.2, 5.4, LANES), SPLITTING, 10)
    strobes = 1000
    options = chaos01.Chaos01Options(transient=20, periods=strobes)
    found = chaos01.ANALYSIS.price(options, scene)
    text, tile = lanes.program(*found.with_it[:3], found.with_it.static, LANES)
    whole = count(text, tile).whole(found.with_it.trip_counts)
    text, tile = lanes.program(*found.without_it[:3], found.without_it.static, LANES)
    alone = count(text, tile).total(found.without_it.trip_counts)
    walks = whole - (20 + strobes) * alone
    assert walks == pytest.approx(64 * (strobes // 10) * (strobes - strobes // 10) * 6, rel=0.1)


def test_prices_are_of_real_programs():
    """Every analysis has a price of its own; one without a program says that it is not measured."""
    for analysis in ANALYSES.values():
        assert analysis.price is not None
    scene = batch_of(constant_speed(), START, np.linspace(5.2, 5.4, LANES), SPLITTING, 10)
    found = verdict.ANALYSIS.price(verdict.VerdictOptions(), scene)
    assert found.with_it is None
    assert found.note.startswith("not measured")
    alone = batch_of(constant_speed(), START, [5.2], SPLITTING, 10)
    for start in ("fixed", "random", "up"):
        found = diagram.ANALYSIS.price(diagram.DiagramOptions(start=start), alone)
        assert found.with_it.function is not found.without_it.function


def test_prices_of_covariant_edges_transients_and_rotation(lanes):
    """Derivatives of the map for the first three, none for the last; programs of others are the same with these beside."""
    scene = batch_of(constant_speed(), START, np.linspace(5.2, 5.4, LANES), SPLITTING, 10)
    alone = costs_of_effects._operations(map_alone(scene), lanes)
    boxed = {"box": {"x1": (-1.0, 1.0)}}
    for name, options in {"covariant": {}, "edges": boxed, "transients": boxed, "rotation": {}}.items():
        analysis = ANALYSES[name]
        found = analysis.price(analysis.options(**options), scene)
        with_it, without_it = (costs_of_effects._operations(p, lanes) for p in (found.with_it, found.without_it))
        assert without_it == alone
        more = (with_it - alone) / alone
        assert more > 1.0 if name != "rotation" else 0.0 <= more < 0.01, name


def two_wells(a=0.4):
    return {"map": lambda y: ((1.0 + a) * y[0] - y[0] ** 3, 0.5 * y[1]), "coordinates": ("x", "y")}


@pytest.mark.usefixtures("quick_compiling_once")
@pytest.mark.parametrize(
    "others",
    [
        {
            "covariant": {"transient": 1, "strobes": 256},
            "rotation": {"transient": 1, "periods": 128},
            "edges": {"box": {"x": (-1.0, 1.0)}, "n_starts": 4, "directions": 0, "pairs": 1},
            "transients": {"box": {"x": (-1.0, 1.0)}, "n_starts": 16, "max_periods": 16, "saddle_points": 8},
        },
        pytest.param(
            {
                "orbits": {"max_period": 1, "transient": 8, "rounds": 4, "attractor": 256, "averages": True},
                "manifolds": {
                    "box": {"x": (-1.0, 1.0), "y": (-1.0, 1.0)},
                    "kind": "unstable",
                    "n_starts": 4,
                    "length": 0.2,
                },
            },
            marks=pytest.mark.slow,
        ),
    ],
    ids=["covariant, rotation, edges, transients", "orbits, manifolds"],
)
def test_programs_are_those_without_what_organises_chaos(others):
    """What they need comes beside the programs that are compiled without them, and changes none of these.

    A dimension of points that are there needs none.
    """

    def compiled(analyses, dimension):
        """The instructions of all programs, without the lines of the source that they come from."""
        session = jaxnh.Session(two_wells, start={"x": 0.3, "y": 0.1})
        poincare = {"poincare": {"transient": 1, "strobes": 256, "correlation_dimension": dimension}}
        session.groups(poincare | analyses, a=[0.3, 0.4])
        lines = (re.findall(r"^.* = .*$", text, re.MULTILINE) for text in session._lanes.programs.texts())
        return {re.sub(r", metadata=\{[^}]*\}", "", "\n".join(of)) for of in lines}

    alone = compiled({}, False)
    assert alone
    assert alone < compiled(others, False)
    assert alone == compiled({}, True)


def test_page_is_of_the_scenes_that_are_priced():
    """The page reads what `make effects` prices, scene by scene."""
    [line] = [line for line in (ROOT / "Makefile").read_text().splitlines() if line.startswith("EFFECTS :=")]
    assert tuple(line.split()[2:]) == page_of_effects.SCENES
