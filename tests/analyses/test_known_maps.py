"""What runs give of maps whose bifurcations, exponents and basins are known in closed form, or by iterating in NumPy."""

from __future__ import annotations

from decimal import Decimal, getcontext

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

import jaxnh
from jaxnh.engine.experiment import Experiment
from tests.flows import known_maps
from tests.helpers.kept_programs import session_of

DIGITS = 40
DOUBLINGS = (3.0, 1 + np.sqrt(6.0), 3.5440903595519228536)  # OEIS A086181 is the third
LIMIT, DELTA = 3.5699456718709449018, 4.6692016091029906718  # OEIS A098587 and A006890
TO_ROUNDING = 1e-14


def logistic(r=3.2):
    return {"map": lambda y: r * y[0] * (1.0 - y[0]), "coordinates": "x"}


def groups_of(map_text, config):
    """The groups that a config with a map asks for."""
    experiment = Experiment.from_text("system: {file: own.py}\n" + config, map_text)
    return session_of(experiment).groups(dict.fromkeys(experiment.analyses.options()))


def kinds_of(data, name="kind"):
    """The words of a variable of flags."""
    return jaxnh.labels(data[name]).to_numpy().ravel().tolist()


def test_doublings_of_the_logistic_map():
    config = "initial: {x: 0.3}\nsweep: {r: {start: 2.9, stop: 3.58, count: 100}}\nanalyses: {doubling: {levels: 8}}"
    data = groups_of(known_maps.LOGISTIC, config)["doubling"]
    assert data["period"].to_numpy().tolist() == [2**k for k in range(8)]
    assert data["period"].attrs["counted_in"] == "iterates"
    apart = np.abs(data["r"].to_numpy()[:3] - DOUBLINGS)
    assert np.all(apart < data["r_error"].to_numpy()[:3] + 4.5e-16)
    assert data["r_error"].to_numpy().max() < TO_ROUNDING
    assert abs(float(data["limit"]) - LIMIT) < float(data["limit_error"]) < 1e-9
    assert abs(float(data["delta_limit"]) - DELTA) < float(data["delta_limit_error"]) < 1e-4


def test_doublings_in_extended_precision():
    """The second one, 1 + √6, to thirty digits: the steps of a flow err at sixteen, and a map has none."""
    config = "initial: {x: 0.3}\nsweep: {r: {start: 2.9, stop: 3.58, count: 100}}\naccuracy: {precision: extended}\n"
    data = groups_of(known_maps.LOGISTIC, config + "analyses: {doubling: {levels: 4}}")["doubling"]
    getcontext().prec = DIGITS
    high, low = (Decimal(float(data[name][1])) for name in ("r", "r_low"))
    assert abs(high + low - (1 + Decimal(6).sqrt())) < Decimal("1e-30")


@pytest.mark.parametrize(
    ("name", "sweep", "at_most"),
    [("LOGISTIC", "r: {values: [4.0]}", 0.02), ("QUADRATIC", "c: {values: [-2.0]}", 0.03)],
)
def test_exponent_of_full_chaos(name, sweep, at_most):
    """Both are the tent map in another coordinate: ln 2 an iterate (Ulam and von Neumann 1947)."""
    config = f"initial: {{x: 0.31}}\nsweep: {{{sweep}}}\nanalyses: {{lyapunov: {{periods: 4096}}}}"
    data = groups_of(getattr(known_maps, name), config)["lyapunov"]
    assert abs(float(data["exponents"].item()) - np.log(2.0)) < float(data["exponents_error"].item()) < at_most
    assert (data["exponents"].attrs["units"], data["exponents"].attrs["counted_in"]) == ("1", "1/iterate")


def test_exponents_near_and_at_superstable_orbits():
    """ln |2 − r| of the fixed point of the logistic map; at r = 2 and 1 + √5 there is none, which is −∞."""
    values = [2.0, 1.0 + 5.0**0.5, 2.0001, 2.6]
    config = f"initial: {{x: 0.3}}\nsweep: {{r: {{values: {values}}}}}\nanalyses: {{lyapunov: {{}}}}"
    data = groups_of(known_maps.LOGISTIC, config)["lyapunov"]
    ours, error = data["exponents"].to_numpy()[:, 0], data["exponents_error"].to_numpy()[:, 0]
    assert kinds_of(data, "exponents_method") == ["orbit"] * 4
    assert kinds_of(data, "status") == ["ok"] * 4
    assert ours[:2].tolist() == [-np.inf, -np.inf]
    exact = np.log(np.abs(2.0 - np.array(values[2:])))
    assert np.all(np.abs(ours[2:] - exact) < error[2:])
    assert error[2:].max() < 1e-10


def exact_exponent(r, n):
    """ln|μ|/n of the cycle of n points of the logistic map that attracts, by Newton in fifty digits."""
    getcontext().prec = 50
    r, x = Decimal(r), 0.3
    for _ in range(100_000):
        x = float(r) * x * (1.0 - x)
    x = Decimal(x)
    for _ in range(40):
        image, slope = x, Decimal(1)
        for _ in range(n):
            image, slope = r * image * (1 - image), slope * r * (1 - 2 * image)
        x -= (image - x) / (slope - 1)
    assert abs(image - x) < Decimal("1e-40")
    return float(abs(slope).ln() / n)


@pytest.mark.parametrize(
    ("n", "values"), [(3, 1 + 8**0.5 + np.array([1e-9, 1e-8, 1e-6])), (2, 3 + np.array([1e-6, 1e-5, 1e-4]))]
)
def test_exponents_of_orbits_just_born(n, values):
    """Beside a fold and a doubling a rounding moves an orbit, and its multiplier, by many of its own: bars have that."""
    data = jaxnh.Session(logistic, start={"x": 0.3}).run(jaxnh.Lyapunov(periods=4096), r=values)
    assert kinds_of(data, "exponents_method") == ["orbit"] * 3
    off = np.abs(data["exponents"].to_numpy()[:, 0] - [exact_exponent(float(r), n) for r in values])
    error = data["exponents_error"].to_numpy()[:, 0]
    assert np.all(off <= error)
    assert error.max() < 1e-9


def test_periods_beside_a_doubling():
    """Points alternate for longer than any transient on both sides of r = 3: Newton on both orbits tells.

    The multiplier of the cycle of two is 4 + 2 r − r² = 1 − (r − 3)(r + 1).
    """
    away, session = 10.0 ** -np.arange(2.0, 13.0), jaxnh.Session(logistic, start={"x": 0.3})
    for values, period in ((3.0 - away, 1), (3.0 + away, 2)):
        assert session.run(jaxnh.Period(), r=values)["period"].to_numpy().tolist() == [period] * len(away)
    data = session.run(jaxnh.Lyapunov(periods=4096), r=values)
    off = np.abs(data["exponents"].to_numpy()[:, 0] - 0.5 * np.log1p(-(values - 3.0) * (values + 1.0)))
    assert np.all(off <= data["exponents_error"].to_numpy()[:, 0])


def test_no_orbit_before_its_fold():
    """Below r = 1 + √8 there is no cycle of three, however near to itself a point comes; at 3 there is none of two.

    There the fixed point attracts, and its multiplier is −1 to rounding.
    """
    values = np.append(1 + 8**0.5 - np.array([1e-9, 1e-8, 1.247e-7, 1e-6]), 3.0)
    session = jaxnh.Session(logistic, start={"x": 0.3})
    period = session.run(jaxnh.Period(), r=values)["period"].to_numpy()
    assert not period[:4].any()
    assert period[4] < 2
    data = session.run(jaxnh.Lyapunov(periods=4096), r=values)
    assert "orbit" not in kinds_of(data, "exponents_method")[:4]
    assert abs(data["exponents"].to_numpy()[4, 0]) <= data["exponents_error"].to_numpy()[4, 0]


LOZI = """
import jax.numpy as jnp


def system(a=1.7, b=0.5):
    def image(s):
        x, y = s
        return 1.0 - a * jnp.abs(x) + y, b * x

    return {"map": image, "coordinates": ("x", "y")}
"""


def test_exponents_where_a_multiplier_is_exactly_one():
    """At a = 1.5, b = 0.5 the cycles of period 4 of the Lozi map fill a line: multipliers 1 and b⁴, to the bit."""
    config = (
        "initial: {x: 0.1, y: 0.1}\nsweep: {a: {values: [1.5]}}\nanalyses: {lyapunov: {transient: 500}, period: {}}"
    )
    groups = groups_of(LOZI, config)
    assert float(groups["period"]["period"].item()) == 4
    assert float(groups["period"]["multiplier"].item()) == 1.0
    off = np.abs(groups["lyapunov"]["exponents"].to_numpy()[0] - (0.0, np.log(0.5)))
    assert np.all(off <= groups["lyapunov"]["exponents_error"].to_numpy()[0])


@pytest.mark.slow  # doublings and windows of maps are quick
def test_exactly_superstable_orbits():
    """The cycles 0 and 0, −1 of c + x²: a derivative that is zero to the bit."""
    config = "initial: {x: 0.1}\nsweep: {c: {values: [0.0, -1.0]}}\nanalyses: {verdict: {}, basins: {}}"
    groups = groups_of(known_maps.QUADRATIC, config)
    assert groups["lyapunov"]["exponents"].to_numpy().ravel().tolist() == [-np.inf, -np.inf]
    assert kinds_of(groups["verdict"]) == ["periodic", "periodic"]
    assert groups["period"]["period"].to_numpy().tolist() == [1, 2]
    assert groups["period"]["multiplier"].to_numpy().tolist() == [0.0, 0.0]
    assert np.all(groups["basins"]["attractor"].to_numpy() > 0)


@pytest.mark.parametrize(
    ("name", "config", "total"),
    [
        ("HENON", "initial: {x: 0.1}\nsweep: {a: {values: [0.2, 1.0, 1.4]}}", np.log(0.3)),
        ("STANDARD", "initial: {angle: 1.0, momentum: 0.5}\nsweep: {k: {values: [0.2, 0.9, 10.0]}}", 0.0),
        ("IKEDA", "initial: {x: 0.1}\nsweep: {u: {values: [0.9]}}", 2 * np.log(0.9)),
    ],
)
def test_sums_of_exponents(name, config, total):
    """The determinant of each of these maps is the same everywhere."""
    data = groups_of(getattr(known_maps, name), config + "\nanalyses: {lyapunov: {}}")["lyapunov"]
    assert np.abs(data["exponents"].sum("exponent") - total).max() < 1e-10
    assert np.abs(data["sum_rule_residual"]).max() < 1e-10


def test_largest_exponent_of_henon():
    """0.41922 (Sprott, Chaos and Time-Series Analysis, 2003, p. 423); an average has scatter."""
    config = "initial: {x: 0.1}\nsweep: {a: {values: [1.4]}}\nanalyses: {lyapunov: {periods: 65536}}"
    data = groups_of(known_maps.HENON, config)["lyapunov"]
    largest, error = float(data["exponents"][0, 0]), float(data["exponents_error"][0, 0])
    assert abs(largest - 0.41922) < error + 1e-5
    assert error < 0.01


TURNING = """
import jax.numpy as jnp


def system(turn=2.0):
    def image(s):
        angle, x = s
        return angle + turn, x * jnp.exp(0.2 * jnp.cos(angle) - 0.1)

    return {"map": image, "coordinates": ("angle", "x"), "angles": ("angle",)}
"""


@pytest.mark.parametrize("periods", [32 * 64, 32 * 61])
def test_exponents_of_a_turning_map(periods):
    """0 and −0.1, the mean of 0.2 cos φ − 0.1 over a turn: smooth averages, of eight iterates at once or of each."""
    config = f"sweep: {{turn: {{values: [2.0, 2.4]}}}}\nanalyses: {{lyapunov: {{periods: {periods}}}}}"
    data = groups_of(TURNING, "initial: {angle: 0.1, x: 0.0}\n" + config)["lyapunov"]
    off = np.abs(data["exponents"].to_numpy() - (0.0, -0.1))
    assert np.all(off <= data["exponents_error"].to_numpy())
    assert np.all(data["exponents_error"].to_numpy() < 1e-8)


def test_angles_wrap():
    config = "initial: {angle: 1.0, momentum: 0.5}\nsweep: {k: {values: [10.0]}}\n"
    data = groups_of(known_maps.STANDARD, config + "analyses: {poincare: {transient: 0, strobes: 16}}")["poincare"]
    angle, momentum = 1.0, 0.5
    for k in range(16):
        turn = 2 * np.pi
        for ours, exact in ((data["angle"], angle), (data["momentum"], momentum)):
            gap = float(ours[0, k]) - exact
            assert abs(gap - turn * round(gap / turn)) < 1e-8 * 10 ** min(k, 8)
            assert -np.pi <= float(ours[0, k]) < np.pi
        momentum = momentum + 10.0 * np.sin(angle)
        angle = angle + momentum


TRIPLING = """
import jax.numpy as jnp


def system(a=0.5):
    def image(s):
        x, y = s
        return 3.0 * x + a * jnp.sin(y), x + y

    return {"map": image, "coordinates": ("x", "y"), "angles": ("x", "y")}
"""


def test_a_map_that_stretches_angles():
    """Every image is that of the point before, up to whole turns, however often turns have been tripled."""
    config = "initial: {x: 0.1, y: 0.3}\nsweep: {a: {values: [0.5]}}\n"
    points = groups_of(TRIPLING, config + "analyses: {poincare: {transient: 600, strobes: 200}}")["poincare"]
    x, y = points["x"].to_numpy()[0], points["y"].to_numpy()[0]
    for image, exact in ((x[1:], 3.0 * x[:-1] + 0.5 * np.sin(y[:-1])), (y[1:], x[:-1] + y[:-1])):
        turns = (image - exact) / (2 * np.pi)
        assert np.abs(turns - np.round(turns)).max() < 1e-9


KICKED = """
import jax.numpy as jnp


def system(k=3.0):
    def image(s):
        angle, momentum = s
        momentum = jnp.exp(-0.9) * (momentum + k * jnp.sin(angle))
        return angle + momentum, momentum

    return {"map": image, "coordinates": ("angle", "momentum"), "angles": "angle"}
"""


def test_exponents_of_a_point_at_half_a_turn():
    """Rounding leaves its images on either side of the seam of its angle; both multipliers have the modulus e^−0.45."""
    config = "initial: {angle: 1.0, momentum: 0.4}\nsweep: {k: {start: 2.0, stop: 3.5, count: 16}}\n"
    data = groups_of(KICKED, config + "analyses: {lyapunov: {transient: 200, periods: 500, exponents: 2}}")["lyapunov"]
    error = data["exponents_error"].to_numpy()
    assert np.all(np.abs(data["exponents"].to_numpy() + 0.45) <= error)
    assert np.all(error < 1e-10)


def test_kinds_of_motion():
    """Below r = 2 a fixed point, beyond it a circle (Neimark–Sacker), at 2.27 chaos (Aronson and co-workers 1982)."""
    config = "initial: {x: 0.4, y: 0.4}\nsweep: {r: {values: [1.9, 2.05, 2.27]}}\nanalyses: {verdict: {}}"
    assert kinds_of(groups_of(known_maps.DELAYED, config)["verdict"]) == ["periodic", "quasiperiodic", "chaotic"]


def test_fold_and_doubling_of_the_quadratic_map():
    config = "sweep: {c: {start: -0.9, stop: 0.3, count: 24}}\nanalyses: {branches: {max_period: 1}}"
    located = groups_of(known_maps.QUADRATIC, config)["bifurcations"]
    where = dict(zip(kinds_of(located), located["c"].to_numpy(), strict=True))
    assert where == pytest.approx({"fold": 0.25, "period doubling": -0.75}, abs=TO_ROUNDING)
    assert located["c_error"].to_numpy().max() < TO_ROUNDING


def test_neimark_sacker_of_the_delayed_logistic_map():
    config = "initial: {x: 0.4, y: 0.4}\nsweep: {r: {start: 1.5, stop: 2.2, count: 15}}\n"
    located = groups_of(known_maps.DELAYED, config + "analyses: {branches: {max_period: 1}}")["bifurcations"]
    assert kinds_of(located) == ["neimark sacker"]
    assert kinds_of(located, "criticality") == ["supercritical"]
    assert float(located["r"][0]) == pytest.approx(2.0, abs=TO_ROUNDING)
    multipliers = located["multipliers"].to_numpy()[0]
    exact = np.exp(1j * np.pi / 3)
    assert np.sort_complex(multipliers[:, 0] + 1j * multipliers[:, 1]) == pytest.approx(
        np.sort_complex([exact, exact.conjugate()]), abs=TO_ROUNDING
    )


@pytest.mark.slow  # `orbits/test_curves` has these curves, and the matrix the analysis
def test_curves_of_henon():
    """a = −(1 − b)²/4 for folds of fixed points, 3 (1 − b)²/4 for their doublings, over the whole plane."""
    config = "initial: {x: 0.1}\nsweep: {a: {start: -0.3, stop: 0.5, count: 9}, b: {start: 0.1, stop: 0.4, count: 4}}\n"
    data = groups_of(known_maps.HENON, config + "analyses: {curves: {max_period: 1}}")["curves"]
    exact = {"fold": -0.25, "period doubling": 0.75}
    assert sorted(kinds_of(data)) == sorted(exact)
    for k, kind in enumerate(kinds_of(data)):
        a, b = (data[name].to_numpy()[k] for name in ("a", "b"))
        there = np.isfinite(a)
        assert there.sum() > 20
        assert np.abs(a - exact[kind] * (1.0 - b) ** 2)[there].max() < TO_ROUNDING


def test_window_of_period_three():
    """Born in a fold at 1 + √8."""
    config = "initial: {x: 0.3}\nsweep: {r: {start: 3.82, stop: 3.85, count: 121}}\n"
    data = groups_of(known_maps.LOGISTIC, config + "analyses: {windows: {max_period: 3, levels: 1}}")["windows"]
    [place] = np.flatnonzero(data["period"].to_numpy() == 3)
    assert kinds_of(data, "begin_kind")[place] == "fold"
    assert abs(float(data["begin"][place]) - (1.0 + np.sqrt(8.0))) < float(data["begin_error"][place]) + 4.5e-16


# ---- basins


def arnold(omega=0.5, k=0.95):
    return {
        "map": lambda y: (y[0] + 2 * jnp.pi * omega - k * jnp.sin(y[0]),),
        "coordinates": ("angle",),
        "angles": ("angle",),
    }


def border_of_the_half(k, side):
    """The border of the tongue of 1/2: the least, or largest, of the values at which an angle has come round in two."""

    def value(x):
        def missing(w):
            image = x + 2 * np.pi * w - k * np.sin(x)
            return image + 2 * np.pi * w - k * np.sin(image) - x - 2 * np.pi

        return brentq(missing, 0.4, 0.6, xtol=1e-15)

    best = min(np.linspace(-np.pi, np.pi, 200), key=lambda x: side * value(x))
    return value(minimize_scalar(lambda x: side * value(x), bracket=(best - 0.05, best, best + 0.05), tol=1e-9).x)


def test_window_of_points_half_a_turn_apart():
    """Two points of a circle go away from each other beyond half a turn, and not through each other."""
    session = jaxnh.Session(arnold, start={"angle": 0.3})
    data = session.run(jaxnh.Windows(max_period=2), omega=np.linspace(0.44, 0.56, 61))
    [begin], [end] = (data[name].to_numpy()[data["period"] == 2] for name in ("begin", "end"))
    for ours, side in ((begin, 1), (end, -1)):
        assert abs(ours - border_of_the_half(0.95, side)) < 1e-12


def test_curves_of_the_tongue_of_a_half():
    """Its two borders, each once, and the doubling of its orbit, which is lowest at K = √2, Omega = 1/2."""
    session = jaxnh.Session(arnold, start={"angle": 0.3})
    axes = {"omega": np.linspace(0.4, 0.6, 11), "k": np.array([0.6, 1.5])}
    data = session.run(jaxnh.Curves(max_period=2, n_values=2), **axes)
    kind, period = np.array(kinds_of(data)), data["period"].to_numpy()
    assert np.count_nonzero((kind == "fold") & (period == 2)) == 2
    [doubling] = np.flatnonzero((kind == "period doubling") & (period == 2))
    omega, k = (data[name].to_numpy()[doubling] for name in ("omega", "k"))
    assert np.nanmin(omega) < 0.48
    assert np.nanmax(omega) > 0.52
    assert 0.0 <= np.nanmin(k) - 2**0.5 < 1e-3


def test_basins_of_two_fixed_points():
    starts = np.linspace(-1.5, 1.5, 64)
    config = "sweep: {x: {start: -1.5, stop: 1.5, count: 64}}\nanalyses: {basins: {}}"
    groups = groups_of(known_maps.TWO_WELLS, config)
    x = starts
    for _ in range(2000):
        x = 1.4 * x - x**3
    assert np.abs(np.abs(x) - np.sqrt(0.4)).max() < 1e-12
    of = groups["attractors"]["x"].to_numpy()[groups["basins"]["attractor"].to_numpy() - 1]
    assert np.array_equal(np.sign(of), np.sign(x))
    assert groups["attractors"]["multiplier"].to_numpy() == pytest.approx(0.2, abs=1e-12)  # 1 − 2 a


def test_fixed_points_beside_starts_that_go_to_infinity():
    """Two of x → tanh 2x at ±0.9575, beyond 3 all grow tenfold: 1e120 is no size that points are told apart by."""
    text = """\
import jax.numpy as jnp

def system(k=2.0):
    def image(y):
        (x,) = y
        return jnp.where(jnp.abs(x) > 3.0, 10.0 * x, jnp.tanh(k * x)),

    return {"map": image, "coordinates": ("x",)}
"""
    groups = groups_of(text, "sweep: {x: {values: [-4.0, -2.0, -0.1, 0.2, 0.3, 3.5]}}\nanalyses: {basins: {}}")
    assert groups["basins"]["attractor"].to_numpy().tolist() == [-1, 1, 1, 2, 2, -1]
    root = brentq(lambda x: np.tanh(2.0 * x) - x, 0.5, 1.0, xtol=1e-15)
    assert groups["attractors"]["x"].to_numpy() == pytest.approx([-root, root], abs=TO_ROUNDING)


@pytest.mark.slow  # the matrix has basins of maps
def test_basin_of_henon():
    """The starts that escape are those that escape in NumPy, and all others lead to the one attractor."""
    axis = np.linspace(-2.0, 2.0, 41)
    config = "sweep: {x: {start: -2.0, stop: 2.0, count: 41}, y: {start: -2.0, stop: 2.0, count: 41}}\n"
    data = groups_of(known_maps.HENON, config + "analyses: {basins: {}}")["basins"]
    x, y = np.meshgrid(axis, axis, indexing="ij")
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(5000):
            x, y = 1.0 - 1.4 * x**2 + y, 0.3 * x
    escaped = ~np.isfinite(x)
    assert 500 < escaped.sum() < 1500
    number = data["attractor"].to_numpy()
    assert np.array_equal(data["status"].to_numpy() > 0, escaped)
    assert np.all(number[escaped] == -1)
    assert np.all(number[~escaped] == 1)
