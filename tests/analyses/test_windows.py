"""Windows of stable orbits along a parameter, against maps whose windows are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.cascade.plateaus import PeriodScan
from jaxnh.analyses.continuation.family_tree import SeedOrbit
from jaxnh.analyses.windows.crisis import locate_crisis
from jaxnh.analyses.windows.search import ENDS, all_lanes, period_runs, search
from jaxnh.engine.experiment import Experiment
from jaxnh.exceptions import ConfigError
from jaxnh.maps.iterate import Derivatives
from jaxnh.orbits.continuation.arclength import Family
from tests.helpers.cases import some_slow
from tests.helpers.kept_programs import session_of

pytestmark = pytest.mark.usefixtures("always_few_lanes")


def quadratic(x, a):
    """x → 1 − a x² and its derivatives."""
    return Derivatives(1 - a[:, None] * x**2, (-2 * a[:, None] * x)[..., None], -(x**2))


def cubic(x, a):
    """x → a x − x³, its own image under x → −x."""
    return Derivatives(a[:, None] * x - x**3, (a[:, None] - 3 * x**2)[..., None], x)


FLOW = """
import jax.numpy as jnp

SHARE = 2 * jnp.pi / (9 * 3**0.5 / 8 - 7 * jnp.pi / 12)

def system(a=1.7):
    def rhs(y, t):
        x, z = y
        kick, shrink, turn = (
            SHARE * jnp.maximum(jnp.cos(2 * jnp.pi * (t - place)) - 0.5, 0.0) ** 3 for place in (1 / 6, 1 / 2, 5 / 6)
        )
        angle = 0.5 * jnp.pi * turn
        return angle * z - 30 * shrink * (x - 1), kick * (2 - a * x * x) - angle * x

    return {"rhs": rhs, "coordinates": ("x", "z"), "period": 1.0}
"""
"""The quadratic map as a flow: in thirds of a period z is kicked by 2 − a x², x shrinks to 1, and both turn by 90°.

At the strobes z is −1 and x is 1 − a x² of the x before, but for ε (x − 1) of that before it, with ε = exp(−30) = 1e-13.
Steps that are stable where x shrinks have an error of 2e-13 a period, whatever is asked for.
"""


def flow(folder, sweep, options="{}", more=""):
    (folder / "flow.py").write_text(FLOW)
    text = f"""\
system: {{file: {folder / "flow.py"}}}
initial: {{x: 0.1{"" if "z:" in sweep else ", z: -1.0"}}}
sweep: {{{sweep}}}
accuracy: {{target: 1.0e-7{more}}}
analyses:
  windows: {options}
"""
    return Experiment.from_text(text)


def of_period_three(multiplier):
    """Parameters of the quadratic map with an orbit of period 3 and this multiplier (Stephenson, Physica A 177 (1991) 416).

    The product of its points x has 8 a³ x x' x'' = −μ, and c = −a the cubic c³ + 2c² + (1 − μ/8) c + (1 − μ/8)² = 0.
    """
    s = 1 - multiplier / 8
    roots = -np.roots([1.0, 2.0, s, s * s])
    return float(roots[np.abs(roots.imag) < 1e-12].real.max())


FOLD, DOUBLING = of_period_three(1), of_period_three(-1)
LIMIT = 1.779818075835
"""Of superstable orbits of periods 3, 6, …, 3072 of the quadratic map, each by Newton with 40 digits, extrapolated."""


def settled(image, a, limit, start):
    """What lanes of a map settle on, by iteration: the shortest period that they recur after."""
    x = np.broadcast_to(np.asarray(start, float), a.shape)[:, None]
    for _ in range(20_000):
        x = image(x, a).image
    path, period = [x], np.zeros(len(a), int)
    for n in range(1, limit + 1):
        path.append(image(path[-1], a).image)
        period[(period == 0) & (np.abs(path[-1] - x)[:, 0] < 1e-7)] = n
    return PeriodScan(a, period, x), np.stack(path, axis=1)


def windows_of(image, a, start=0.1, limit=12, lost=()):
    line, path = settled(image, a, limit, start)
    line.period[list(lost)] = 0

    def orbits(some):
        return [SeedOrbit(path[k, : line.period[k]], float(a[k])) for k in some]

    def families(low, high):
        return [Family(image, lambda gap: gap, np.ones(1), low, high)] * 3

    return search(line, limit, orbits, families)


def kinds(window):
    return ENDS[window.begin.kind], ENDS[window.end.kind]


def test_runs_of_lanes_are_cascades():
    """Periods 3, 6, 12 are one run and 5, 5 another; a lane alone, or one without a period, is none."""
    period = np.array([7, 0, 0, 3, 3, 6, 12, 5, 5, 0, 4, 0])
    assert period_runs(period) == [(3, 6), (7, 8)]


def test_period_three_from_its_fold_to_its_doubling():
    """From 7/4 on; lanes of periods 6 and 12 are its own, and a lane without a period does not cut it in two."""
    assert pytest.approx(1.75, abs=1e-14) == FOLD
    a = np.linspace(1.74, 1.785, 46)
    [[window]] = windows_of(quadratic, a, lost=[20])
    assert (window.period, *kinds(window)) == (3, "fold", "period_doubling")
    for end, exact in ((window.begin, FOLD), (window.end, DOUBLING)):
        assert abs(end.value - exact) < min(1e-10, end.error + 1e-14)  # of the roots of a cubic
    assert set(all_lanes([window])) == set(range(11, 40)) - {20}  # 1.751 to 1.779; doublings end at 1.7798


def test_an_orbit_that_lanes_have_left_is_followed_to_its_end():
    """Where lanes settle on something else the orbit still attracts."""
    a = np.linspace(1.70, 1.80, 101)
    [window] = next(g for g in windows_of(quadratic, a, lost=[*range(58), *range(61, 101)]) if g[0].period == 3)
    assert all_lanes([window]).tolist() == [58, 59, 60]
    assert window.begin.value == pytest.approx(FOLD, abs=1e-10)
    assert window.end.value == pytest.approx(DOUBLING, abs=1e-10)


def test_a_cascade_that_lanes_have_left_for_a_while_is_one_window():
    """Of periods 1 to 8, doubling at 3/4 and 5/4; between lanes of periods 2 and 4 others settle on something else."""
    a = np.linspace(0.3, 1.38, 55)
    lost = np.flatnonzero((a > 1.2) & (a < 1.3))
    [[window]] = windows_of(quadratic, a, lost=lost.tolist())
    assert (window.period, *kinds(window)) == (1, "range", "period_doubling")
    assert abs(window.end.value - 0.75) < 1e-9
    assert set(all_lanes([window])) == set(range(55)) - set(lost.tolist())


def test_what_begins_beyond_the_sweep_has_no_value():
    [[window]] = windows_of(quadratic, np.linspace(1.755, 1.765, 6))
    assert kinds(window) == ("range", "range")
    assert np.isnan([window.begin.value, window.end.value]).all()
    [[window]] = windows_of(quadratic, np.linspace(1.755, 1.775, 11))
    assert kinds(window) == ("range", "period_doubling")


def test_twins_are_one_window():
    """0 attracts up to 1, then ±√(a − 1) with the multiplier 3 − 2a, up to 2; lanes of either are of one window."""
    a = np.linspace(0.5, 2.1, 33)
    zero, pair = windows_of(cubic, a, start=np.where(np.arange(33) % 3, 0.2, -0.2))
    assert [len(zero), len(pair)] == [1, 2]
    assert kinds(zero[0]) == ("branch_point", "range")
    for twin in pair:
        assert (twin.period, *kinds(twin)) == (1, "branch_point", "period_doubling")
        assert abs(twin.begin.value - 1) < twin.begin.error < 1e-8
        assert abs(twin.end.value - 2) < twin.end.error < 1e-9
    assert len(all_lanes(pair)) > 20


def on_bands(start):
    """Paths of the quadratic map from a point, after a transient that the slowest of them here have by far enough of."""

    def paths(a, count):
        x, found = np.full(len(a), start), np.empty((count, len(a)))
        for _ in range(600):
            x = 1 - a * x * x
        for n in range(count):
            x = found[n] = 1 - a * x * x
        return found.T[..., None]

    return paths


def extremum_lands(early, late, guess):
    """Where two iterates of the extremum 0 are one, so that it lands on an orbit that repels. By Newton."""
    a = guess
    for _ in range(40):
        x, rate, seen = 0.0, 0.0, []
        for _ in range(late):
            x, rate = 1 - a * x * x, -x * x - 2 * a * x * rate
            seen.append((x, rate))
        (x, rate), (y, other) = seen[early - 1], seen[late - 1]
        a -= (y - x) / (other - rate)
    assert a == pytest.approx(guess, abs=1e-4)
    return a


ACCUMULATION = 1.401155189092
"""Of the doublings of period 1 of the quadratic map (Feigenbaum, J. Stat. Phys. 21 (1979) 669)."""


CRISES = {
    "3, of a fold": (3, LIMIT, extremum_lands(6, 9, 1.7903)),
    "5, of a fold": (5, 1.631021, extremum_lands(10, 15, 1.63336)),
    "6, of a fold": (6, 1.482800, extremum_lands(12, 18, 1.4856)),
    "2, of a doubling": (2, ACCUMULATION, extremum_lands(3, 4, 1.54368)),
    "4, of a doubling": (4, ACCUMULATION, extremum_lands(6, 8, 1.43035)),
}
"""Windows born in a fold or a doubling: periods, where doublings end, and where bands meet the orbit that bounds them.

That is the orbit born in the fold, or the one that has doubled, of half the period; the iterates 2n and 3n of the
extremum are one there, or 3n/2 and 2n.
"""


@pytest.mark.parametrize(("period", "limit", "exact"), some_slow(CRISES, "3, of a fold", "2, of a doubling"))
def test_crisis_is_where_bands_meet_the_orbit_that_bounds_them(period, limit, exact):
    """Within the error, which is not wide: paths of t turns that lie within about 1/t² of the crisis keep their phase, as
    τ ~ 1/√x, of x in distances from where doublings end. A hundred times that has room for the factor, which is not one.
    """
    most = 1024
    found = locate_crisis(on_bands(0.1), limit, limit + 1.5 * (exact - limit), period, most)
    assert abs(found.value - exact) < found.error < 100.0 * (exact - limit) * (period / most) ** 2


@pytest.mark.slow
def test_intervals_of_crises_cover():
    """19 of 20 at least, of five windows: other paths, at other values, each time. Intervals are of 99 in 100."""
    rng, covered = np.random.default_rng(0), list[bool]()
    for period, limit, exact in CRISES.values():
        for _ in range(8):
            stop = limit + rng.uniform(1.2, 2.5) * (exact - limit)
            found = locate_crisis(on_bands(rng.uniform(-0.1, 0.1)), limit, stop, period, 512)
            covered.append(found is not None and abs(found.value - exact) <= found.error)
    assert np.mean(covered) >= 0.95


def test_no_crisis_where_none_is_between():
    """Bands do not meet before; beyond the crisis the phase is lost from the first value on."""
    assert locate_crisis(on_bands(0.1), LIMIT, 1.7895, 3, 512) is None
    assert locate_crisis(on_bands(0.1), 1.792, 1.8, 3, 512) is None
    assert locate_crisis(on_bands(0.1), ACCUMULATION, 1.54, 2, 512) is None


@pytest.mark.parametrize(
    ("sweep", "message"),
    [
        ("z: {start: -1.0, stop: 1.0, count: 3}", "along a parameter, and z is a coordinate of the start state"),
        ("a: {values: [1.7, 1.8]}, z: {values: [0.1, 0.2]}", "along one axis; leave out z"),
        ("a: {values: [1.7]}", "over a range of a, and the sweep has one value of it"),
    ],
)
def test_what_windows_cannot_do_is_said(tmp_path, sweep, message):
    with pytest.raises(ConfigError, match=message):
        flow(tmp_path, sweep).requested()


@pytest.mark.slow
def test_windows_of_a_flow(tmp_path):
    """The flow whose strobe map is the quadratic map: period 3, the doublings by Newton on it, where these end, and the crisis.

    Paths of 512 strobes for the crisis: their error is that of the map's own (above), and longer ones are all that costs.
    """
    most = 512
    options = f"{{max_period: 3, crisis: {most}}}"
    tree = session_of(flow(tmp_path, "a: {start: 1.74, stop: 1.80, count: 61}", options)).tree()
    data = tree["windows"].to_dataset()
    assert (data["period"].values.tolist(), data["orbits"].values.tolist()) == ([3], [1])
    off = 5 * np.exp(-30)  # the map with ε doubles 4.2 ε before that without, by Newton at ε = 1e-5 and 1e-6
    ends = [ENDS[int(data[f"{name}_kind"][0])] for name in ("begin", "end")]
    assert ends == ["fold", "period_doubling"]
    for name, exact in (("begin", FOLD), ("end", DOUBLING), ("limit", LIMIT), ("crisis", CRISES["3, of a fold"][2])):
        assert abs(float(data[name][0]) - exact) <= float(data[f"{name}_error"][0]) + off
    assert float(data["begin_error"][0]) < 1e-8
    assert np.abs(data["doubling"].values[0, 0] - DOUBLING) <= data["doubling_error"].values[0, 0] + off
    assert float(data["limit_error"][0]) < 1e-4
    assert float(data["crisis_error"][0]) < 100.0 * (CRISES["3, of a fold"][2] - LIMIT) * (3 / most) ** 2
    assert data["end_multipliers"].values[0, 0] == pytest.approx([-1.0, 0.0], abs=1e-8)
    jaxnh.figure(tree)


@pytest.mark.slow
def test_crisis_of_a_flow_whose_bands_are_born_in_a_doubling(tmp_path):
    """The same flow: the two bands meet at the orbit of period 1 that doubled before the sweep begins."""
    tree = session_of(flow(tmp_path, "a: {start: 1.2, stop: 1.56, count: 61}", "{max_period: 2, crisis: 512}")).tree()
    data = tree["windows"].to_dataset().isel(window=0)
    assert int(data["period"]) == 2
    crisis, error = float(data["crisis"]), float(data["crisis_error"])
    assert abs(crisis - CRISES["2, of a doubling"][2]) <= error < 1e-4


FORKED = """
import jax.numpy as jnp

def system(v=0.1, bend=0.3):
    def rhs(y, t):
        turn = 2 * jnp.pi * t
        x, z = y[0] - 0.3 * jnp.cos(turn), y[1]
        return v * x - x**3 - 0.6 * jnp.pi * jnp.sin(turn), bend * x * x - z

    return {"rhs": rhs, "coordinates": ("x", "z"), "period": 1.0}
"""


def test_twins_in_a_coordinate_that_vanishes_before_they_are_born(tmp_path):
    """x' = v x − x³ and z' = bend x² − z, with x from a place that a clock moves, has a pitchfork at v = 0.

    Before it z vanishes. In sizes of most lanes, 10⁻⁴ of the start's, z of the twins was so large that their branches
    ended beside each lane, and windows of two lanes began and ended nowhere.
    """
    (tmp_path / "forked.py").write_text(FORKED)
    text = f"""\
system: {{file: {tmp_path / "forked.py"}}}
initial: {{x: 0.1, z: 0.1}}
sweep: {{v: {{start: -0.91, stop: 0.5, count: 24}}}}
accuracy: {{solver: dopri8, steps: 16}}
analyses:
  windows: {{max_period: 1, crisis: 0, levels: 0}}
"""
    data = session_of(Experiment.from_text(text)).groups({"windows": {"max_period": 1, "crisis": 0, "levels": 0}})
    data = data["windows"]
    assert data.sizes["window"] == 1
    assert jaxnh.labels(data["begin_kind"]).to_numpy().tolist() == ["branch point"]
    assert abs(float(data["begin"][0])) <= float(data["begin_error"][0]) < 1e-9
    assert float(data["last"][0]) == pytest.approx(0.5, abs=1e-12)
