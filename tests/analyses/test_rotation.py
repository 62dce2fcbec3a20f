"""Rotation numbers against closed forms: rigid turns, Moebius maps of the circle, Adler's equation, Arnold's tongues."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.rotation.averages import birkhoff_average, cyclic_advances, displacement, least_fraction
from jaxnh.analyses.smooth_window import window_weights
from jaxnh.exceptions import InputError

TURN = 2 * math.pi
GOLDEN = (math.sqrt(5) - 1) / 2
CRITICAL = 0.60666106347011  # where Arnold's map of K = 1 has the golden mean (Shenker, Physica D 5 (1982) 405)


def kinds(data):
    return jaxnh.labels(data["kind"]).to_numpy().ravel().tolist()


def rigid(omega=GOLDEN):
    return {"map": lambda y: (y[0] + TURN * omega,), "coordinates": ("angle",), "angles": ("angle",)}


def ellipse(omega=GOLDEN):
    """A turn on ellipses about (0.3, -0.2), one axis a hundred times the other."""

    def image(s):
        u, v = s[0] - 0.3, 100.0 * (s[1] + 0.2)
        c, d = jnp.cos(TURN * omega), jnp.sin(TURN * omega)
        return 0.3 + c * u - d * v, -0.2 + (d * u + c * v) / 100.0

    return {"map": image, "coordinates": ("x", "y")}


def arnold(omega=0.5, k=1.0):
    return {
        "map": lambda y: (y[0] + TURN * omega - k * jnp.sin(y[0]),),
        "coordinates": ("angle",),
        "angles": ("angle",),
    }


def moebius(alpha=1.0, a=0.5):
    """z -> e^(i alpha) (z + a)/(1 + a z) on the circle: cos(pi rho) = cos(alpha/2)/sqrt(1 - a^2), or locked to 0."""

    def image(y):
        (x,) = y
        return (x + alpha - 2.0 * jnp.arctan2(a * jnp.sin(x), 1.0 + a * jnp.cos(x)),)

    return {"map": image, "coordinates": ("angle",), "angles": ("angle",)}


def ring(omega=2.0, rate=0.0126, shear=-0.73):
    """r′ = μ(1 − r²)r and φ′ = ω + σr², about a point that the clock moves and bent: (ω + σ)/2π turns a period."""

    def rhs(s, t):
        at, moving = 0.25 * jnp.cos(TURN * t), -0.25 * TURN * jnp.sin(TURN * t)
        x, v = s[0] - at, s[1] - 0.2 * at
        y = v + 0.08 * x * x
        square, fast = x * x + y * y, 1.0 - 0.31 * jnp.cos(TURN * t)
        turn = omega + shear * square
        dx = fast * (rate * (1.0 - square) * x - turn * y)
        dy = fast * (rate * (1.0 - square) * y + turn * x)
        return dx + moving, dy - 0.16 * x * dx + 0.2 * moving

    return {"rhs": rhs, "coordinates": ("x", "y"), "period": 1.0}


@pytest.mark.parametrize(("rate", "transient"), [(0.0126, 512), (2e-4, 40_000)])
def test_steps_that_move_a_torus_are_in_the_errors(rate, transient):
    """Steps that err by 1e-7 in a period move a torus that contracts by e^(−0.025) by forty times that, and shear turns
    it faster: both halves of a run agree on it, and a bar of theirs is seven to fourteen times too small. Of a torus that
    contracts by e^(−0.0004) half of a run of twice the steps shows a tenth of it."""
    session = jaxnh.Session(ring, start={"x": 1.0, "y": 0.0}, target=1e-6, parameters={"rate": rate})
    omega = np.linspace(1.9, 2.2, 8)
    data = session.run(jaxnh.Rotation(transient=transient, periods=1024), omega=omega)
    off = np.abs(data["rotation"].to_numpy() - (omega - 0.73) / TURN)
    error = data["rotation_error"].to_numpy()
    assert np.all(off <= error)
    assert np.all(error < 1e-7 / rate)
    assert np.max(off) > 1e-7  # steps do move it


def test_a_displacement_that_is_not_yet_there():
    """Of 1 − e^(−λt), from its averages over two windows, whatever λ; none of what does not grow."""
    at = (np.arange(4000) + 0.5) / 4000
    weights = window_weights(at) / np.sum(window_weights(at))
    rates = np.array([0.03, 0.1, 1.0, 10.0])
    first, second = (1.0 - np.exp(-np.outer(rates, at + late)) @ weights for late in (0.0, 1.0))
    assert displacement(first, second, 1e-3) == pytest.approx(1.0, abs=2e-3)
    assert displacement(np.array([2.0]), np.array([2.0]), 1e-3).tolist() == [2.0]


def adler(a=0.5):
    """Adler's equation x' = 1 - a sin x of an angle x + 0.3 sin(2 pi t), which has its rotation number and a clock."""

    def rhs(y, t):
        return (1.0 - a * jnp.sin(y[0] - 0.3 * jnp.sin(2 * jnp.pi * t)) + 0.6 * jnp.pi * jnp.cos(2 * jnp.pi * t),)

    return {
        "rhs": rhs,
        "coordinates": ("angle",),
        "angles": ("angle",),
        "period": 1.0,
    }


def standard(k=0.5):
    def image(y):
        momentum = y[1] + k * jnp.sin(y[0])
        return y[0] + momentum, momentum

    return {"map": image, "coordinates": ("angle", "momentum"), "angles": ("angle",)}


@pytest.mark.parametrize("system", [rigid, ellipse])
def test_linear_torus(system):
    """An irrational turn to 1e-12, and a fraction as such, by an angle and about the mean of an ellipse's points."""
    start = {"angle": 0.2} if system is rigid else {"x": 0.9, "y": -0.2}
    data = jaxnh.Session(system, start=start).run(jaxnh.Rotation(), omega=np.array([GOLDEN, 2 / 7, 0.98]))
    assert kinds(data) == ["unlocked", "locked", "locked"]
    assert data.attrs["rotating_angle"] == ("of angle" if system is rigid else "of x, y about the mean of the points")
    assert data["denominator"].to_numpy().tolist() == [0, 7, 50]
    assert data["numerator"].to_numpy().tolist() == [0, 2, 49]
    error = np.abs(data["rotation"].to_numpy() - [GOLDEN, 2 / 7, 0.98])
    assert error.max() < 1e-12
    assert np.all(error <= data["rotation_error"])


def test_moebius_maps_of_the_circle():
    """Of 400 maps with a rotation number in closed form the bar covers 95 of 100; locked lanes are those it says."""
    alpha = np.linspace(0.02, math.pi, 400)
    data = jaxnh.Session(moebius, start={"angle": 0.2}).run(jaxnh.Rotation(periods=1024), alpha=alpha)
    cosine = np.cos(alpha / 2) / math.sqrt(0.75)
    exact = np.arccos(np.minimum(cosine, 1.0)) / math.pi
    words = np.array(kinds(data))
    near = np.abs(cosine - 1.0) < 1e-3  # the passage of the ghost of the fold takes as long as half of a run
    assert np.all(words[(cosine > 1) & ~near] == "locked")
    denominator = data["denominator"].to_numpy()
    assert np.all(denominator[(cosine > 1) & ~near] == 1)
    locked = denominator > 0
    assert np.all(np.abs(data["numerator"] - denominator * exact)[locked] < 1e-12)  # and no others
    known = np.isfinite(data["rotation"].to_numpy())
    assert known[~near].mean() > 0.95
    within = np.abs(data["rotation"] - exact).to_numpy() <= data["rotation_error"].to_numpy()
    assert within[known].mean() >= 0.95


@pytest.mark.parametrize("iterates", [512, 2048, 8192])
def test_passages_that_take_longer_than_a_run(iterates):
    """Beside the border of a tongue, where whole passages take 1/rho: locked within it, and not locked without."""
    beside = np.array([-1e-3, -1e-4, -1e-5, -1e-7, 1e-7, 1e-6, 1e-5])
    session = jaxnh.Session(moebius, start={"angle": 0.2})
    data = session.run(jaxnh.Rotation(periods=iterates), alpha=math.pi / 3 + beside)
    exact = np.arccos(np.minimum(np.cos(math.pi / 6 + beside / 2) / math.sqrt(0.75), 1.0)) / math.pi
    words = np.array(kinds(data))
    assert np.all(words[:2] == "locked")
    assert not np.any(words[4:] == "locked")
    assert not np.any(words[:4] == "unlocked")
    known = np.isfinite(data["rotation"].to_numpy())
    assert np.all(np.abs(data["rotation"] - exact)[known] <= data["rotation_error"][known] * (1 + 1e-9))


def test_no_lock_to_a_fraction_near_by():
    """At K = 0.9, Omega = 0.4 the rotation number is 1.2e-5 from 11/28: a motion of 4,096 iterates goes round once."""
    data = jaxnh.Session(arnold, start={"angle": 0.3}).run(jaxnh.Rotation(periods=4096), omega=[0.4], k=[0.9])
    assert kinds(data) == ["undecided"]
    assert data["denominator"].item() == 0
    longer = jaxnh.Session(arnold, start={"angle": 0.3}).run(jaxnh.Rotation(periods=1 << 17), omega=[0.4], k=[0.9])
    assert kinds(longer) == ["unlocked"]
    assert abs(data["rotation"].item() - longer["rotation"].item()) <= data["rotation_error"].item()


def test_arnolds_staircase():
    """At K = 1 a devil's staircase that never falls, the tongue of 0 to |Omega| = 1/(2 pi), and the golden mean."""
    omega = np.append(np.linspace(0.0, 1.0, 201), [CRITICAL, (1 - 1e-5) / TURN, (1 + 1e-5) / TURN])
    data = jaxnh.Session(arnold, start={"angle": 0.3}).run(jaxnh.Rotation(transient=4096, periods=8192), omega=omega)
    value, error = data["rotation"].to_numpy(), data["rotation_error"].to_numpy()
    steps = np.flatnonzero(np.isfinite(value[:201]))
    assert len(steps) > 190
    assert np.all(np.diff(value[steps]) >= -error[steps][1:] - error[steps][:-1])
    assert abs(value[201] - GOLDEN) <= error[201] < 1e-5
    denominator = data["denominator"].to_numpy()
    assert np.all(denominator[:201][omega[:201] < 1 / TURN] == 1)
    assert denominator[202] == 1
    assert denominator[203] != 1
    assert denominator[100] == 2


def test_border_of_a_tongue():
    """The tongue of 0 ends at Omega = k/(2 pi), to 1e-6: beyond it a passage takes 1/sqrt(distance) iterates."""
    border = 0.9 / TURN
    options = jaxnh.Rotation(transient=8192, periods=8192)
    data = jaxnh.Session(arnold, start={"angle": 0.4}).run(options, omega=border + np.array([-1e-6, 1e-6]), k=[0.9])
    assert kinds(data) == ["locked", "unconverged"]
    assert data["denominator"].to_numpy().ravel()[0] == 1


def forced_van_der_pol(mu=0.5, drive=1.0, omega=2.9):
    def rhs(y, t):
        x, v = y
        return v, mu * (1 - x * x) * v - x + drive * jnp.cos(omega * t)

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": TURN / omega}


@pytest.mark.slow
def test_border_of_a_tongue_of_van_der_pols_oscillator():
    """Locked to 1/3 on one side of the fold that `curves` follows over the drive and μ, and not on the other: to 1e-6."""
    session = jaxnh.Session(forced_van_der_pol, start={"x": 1.0}, target=1e-10)
    options = jaxnh.Curves(max_period=3, transient=1024, n_values=1, ds_max=0.05)
    data = session.run(options, drive=np.linspace(0.6, 2.1, 6), mu=np.array([0.45, 0.5, 0.55]))
    folds = np.flatnonzero((jaxnh.labels(data["kind"]) == "fold") & (data["period"] == 3))
    assert len(folds)
    drive, mu = (data[name].to_numpy()[folds[0]] for name in ("drive", "mu"))
    known = np.flatnonzero(np.isfinite(drive))
    for place in known[[len(known) // 4, len(known) // 2, 3 * len(known) // 4]]:
        options = jaxnh.Rotation(transient=1 << 15, periods=1 << 15)
        beside = drive[place] + np.array([-1e-6, 1e-6])
        turns = session.run(options, drive=beside, mu=mu[place : place + 1])
        assert [word == "locked" for word in kinds(turns)] == [False, True]
        assert turns["denominator"].to_numpy().ravel()[1] == 3


@pytest.mark.slow
def test_border_of_a_tongue_of_van_der_pols_oscillator_by_heyoka():
    """Three points of that fold to 1e-8 of a Newton on P³, by a Taylor series, and within their errors."""
    hy = pytest.importorskip("heyoka")
    newton = pytest.importorskip("tests.helpers.heyoka_newton")
    real = newton.REAL
    session = jaxnh.Session(forced_van_der_pol, start={"x": 1.0}, target=1e-10)
    options = jaxnh.Curves(max_period=3, transient=1024, n_values=1, ds_max=0.05)
    data = session.run(options, drive=np.linspace(0.6, 2.1, 6), mu=np.array([0.45, 0.5, 0.55]))
    fold = np.flatnonzero((jaxnh.labels(data["kind"]) == "fold") & (data["period"] == 3))[0]
    names = ("drive", "mu", "drive_error", "mu_error")
    drive, mu, drive_error, mu_error = (data[name].to_numpy()[fold] for name in names)
    known = np.flatnonzero(np.isfinite(drive))

    def image(at):
        def rates(x, v, drive, t):
            cosine = hy.cos if isinstance(x, hy.expression) else np.cos
            return v, real(at) * (1 - x * x) * v - x + drive * cosine(real(2.9) * t)

        return newton.strobe_map(rates, 2, 2 * np.arccos(real(-1)) / real(2.9), 3)

    def fold_at(at, near, inside):
        u, returns = np.array([1.0, 0.0]), image(at)
        for _ in range(400):  # to the orbit that attracts, near the fold with the one that does not
            u = returns(near + inside, u)[0].astype(float)
        return newton.bifurcation(returns, "fold", near, u)[0]

    for place in known[[len(known) // 4, len(known) // 2, 3 * len(known) // 4]]:
        exact = fold_at(mu[place], drive[place], 1e-6)
        beside = fold_at(mu[place] + 1e-6, drive[place], 1e-5)
        slope = abs(beside - exact) / 1e-6
        gap = abs(drive[place] - exact)
        assert gap < 1e-8
        assert gap <= drive_error[place] + slope * mu_error[place] + 1e-11  # of differences in the reference


def test_chaos_has_no_rotation_number():
    """A torus of the standard map has one, the chaotic sea has not: its average converges no better than a plain one."""
    session = jaxnh.Session(standard, start={"angle": 0.3, "momentum": TURN * GOLDEN})
    data = session.run(jaxnh.Rotation(periods=4096), k=np.array([0.5, 5.0, 7.0]))
    assert kinds(data) == ["unlocked", "unconverged", "unconverged"]
    assert np.isnan(data["rotation"].to_numpy()).tolist() == [False, True, True]
    assert np.all(data["difference"].to_numpy()[1:] > 1e-4)


def nontwist(a=0.686049, b=0.5):
    def image(s):
        momentum = s[1] - b * jnp.sin(s[0])
        return s[0] + TURN * a * (1.0 - momentum**2), momentum

    return {"map": image, "coordinates": ("angle", "momentum"), "angles": ("angle",)}


@pytest.mark.parametrize("side", [0.25, -0.25])
def test_a_torus_without_twist(side):
    """The last one, of the golden mean, is critical at b = 0.742493131039 (del-Castillo-Negrete et al., Physica D 100, 1997).

    It passes the points (a/2 ± 1/4, 0), from which there is no torus at a larger b. Tori beside it turn less, on both sides.
    """
    session = jaxnh.Session(nontwist, start={"angle": TURN * (0.5 * 0.686049 + side), "momentum": 0.0})
    data = session.run(jaxnh.Rotation(transient=1, periods=8192), b=[0.6, 0.742493131039, 0.8, 0.9])
    assert kinds(data) == ["unlocked", "unlocked", "unconverged", "unconverged"]
    value, error = data["rotation"].to_numpy(), data["rotation_error"].to_numpy()
    assert abs(value[1] - GOLDEN) <= error[1] < 1e-7
    assert error[0] < 1e-11
    momentum = np.array([-0.2, -0.1, 0.0, 0.1, 0.2])
    beside = session.run(jaxnh.Rotation(transient=1, periods=8192), b=[0.3], momentum=momentum)["rotation"].to_numpy()[
        0
    ]
    assert np.all(np.sign(np.diff(beside)) == [1, 1, -1, -1])


def test_adlers_equation():
    """Turns per unit of time sqrt(1 - a^2)/(2 pi), within the bar that the steps have their part in; locked from a = 1."""
    data = jaxnh.Session(adler, start={"angle": 0.1}, target=1e-9).run(
        jaxnh.Rotation(periods=1024), a=np.array([0.0, 0.3, 0.8, 1.2])
    )
    exact = np.sqrt(1 - np.array([0.0, 0.3, 0.8]) ** 2) / TURN
    value, error = data["rotation"].to_numpy(), data["rotation_error"].to_numpy()
    assert np.all(np.abs(value[:3] - exact) <= error[:3])
    assert np.all(error[:3] < 1e-7)
    assert data["denominator"].to_numpy()[3] == 1


def test_points_out_of_their_cyclic_order():
    """A map that folds the circle keeps no order; two points that change places turn by a half, however near they are."""
    n = np.arange(200)
    turns = np.stack([(GOLDEN * n) % 1.0, np.abs(np.sin(n**2)), 0.05 * (n % 2)])
    advances, keeps_order = cyclic_advances(turns)
    assert keeps_order.tolist() == [True, False, True]
    assert abs(birkhoff_average(advances[[0]]).value[0] - GOLDEN) < 1e-12
    assert abs(advances[2].mean() - 0.5) < 0.01


def test_least_fraction():
    """Of all fractions within the bar that of least denominator; none up to the largest, none of what is not finite."""
    p, q = least_fraction(np.array([0.334, 0.334, GOLDEN, np.nan, -0.5]), np.array([1e-3, 1e-9, 1e-9, 1.0, 1e-9]), 50)
    assert (p.tolist(), q.tolist()) == ([1, 0, 0, 0, -1], [3, 0, 0, 0, 2])


def test_refusals():
    """A coordinate that there is none of, and a system of one coordinate that is no angle."""
    with pytest.raises(InputError, match="z is no coordinate; coordinates are x, y"):
        jaxnh.Session(ellipse).run(jaxnh.Rotation(plane=("x", "z")), omega=np.array([0.1]))

    def logistic(r=3.2):
        return {"map": lambda y: (r * y[0] * (1 - y[0]),), "coordinates": "x"}

    with pytest.raises(InputError, match="needs an angle, or a plane of two coordinates"):
        jaxnh.Session(logistic).run(jaxnh.Rotation(), r=np.array([3.2]))
