"""δ, α and b∞ of cascades of one-dimensional maps, located here in long double: what their intervals cover."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from jaxnh.analyses.cascade.doubling import orbit_width
from jaxnh.analyses.cascade.limits import doublings_limit, limit_rates, widths_limit

REAL = np.longdouble
DELTA, ALPHA = 4.669201609102990, 2.502907875095892  # Briggs, Math. Comp. 57 (1991) 435
LEVELS = 9


class Cascade(NamedTuple):
    """Doublings of the periods 1, 2, 4, … of a map, and the widths of the orbits there, from period 2 on."""

    values: np.ndarray
    widths: np.ndarray


def logistic(x, a):
    """f with ∂f/∂x, ∂f/∂a, ∂²f/∂x², ∂²f/∂x∂a, as all maps here."""
    return a * x * (1 - x), a * (1 - 2 * x), x * (1 - x), -2 * a, 1 - 2 * x


def sine(x, a):
    pi = REAL("3.14159265358979323846264338327950288")
    s, c = np.sin(pi * x), np.cos(pi * x)
    return a * s, a * pi * c, s, -a * pi * pi * s, pi * c


def cubic(x, a):
    return a * x * (1 - x * x), a * (1 - 3 * x * x), x * (1 - x * x), -6 * a * x, 1 - 3 * x * x


def polynomial(third, fourth):
    """1 − a x² (1 + c₃ x + c₄ x²)."""

    def f(x, a):
        p = x * x * (1 + third * x + fourth * x * x)
        px, pxx = x * (2 + 3 * third * x + 4 * fourth * x * x), 2 + 6 * third * x + 12 * fourth * x * x
        return 1 - a * p, -a * px, -p, -a * pxx, -px

    return f


MAPS = {  # with a point, a parameter before the first doubling and a step that is short beside the distance to it
    "logistic": (logistic, 0.3, 2.9, 0.2),
    "sine": (sine, 0.3, 0.7, 0.05),
    "cubic": (cubic, 0.5, 1.9, 0.1),
    "lopsided": (polynomial(0.32, 0.16), 0.3, 0.5, 0.1),
    "flat": (polynomial(0.07, -0.17), 0.3, 0.5, 0.1),
}


def orbit(f, x, a, n):
    """x, f(x), …, n points."""
    points = [x]
    for _ in range(n - 1):
        points.append(f(points[-1], a)[0])
    return np.array(points)


def doubled(f, x, a, n):
    """(x, a) with fⁿ(x) = x and (fⁿ)′ = −1, by Newton."""
    last = np.inf
    for _ in range(40):
        y, yx, ya, yxx, yxa = x, REAL(1), REAL(0), REAL(0), REAL(0)
        for _ in range(n):
            f0, fx, fa, fxx, fxa = f(y, a)
            yxx, yxa = fxx * yx * yx + fx * yxx, fxx * ya * yx + fxa * yx + fx * yxa
            y, yx, ya = f0, fx * yx, fx * ya + fa
        det = (yx - 1) * yxa - ya * yxx
        dx, da = (ya * (yx + 1) - (y - x) * yxa) / det, ((y - x) * yxx - (yx + 1) * (yx - 1)) / det
        x, a = x + dx, a + da
        if abs(da) < 1e-17 and abs(da) >= last / 4:
            return x, a
        last = abs(da)
    raise AssertionError("Newton has not settled")


def at_multiplier(f, x, a, n):
    """The period-n orbit near x by Newton, and its multiplier."""
    for _ in range(6):
        y, yx = x, REAL(1)
        for _ in range(n):
            y, fx, *_ = f(y, a)
            yx = yx * fx
        x = x - (y - x) / (yx - 1)
    return x, yx


def located(f, x, a, step):
    """The cascade from a stable fixed point: its multiplier is followed to nearly −1, then Newton takes both."""
    values, widths = [], []
    x, a, step = REAL(x), REAL(a), REAL(step)
    x = orbit(f, x, a, 2000)[-1]
    for k in range(LEVELS):
        n = 2**k
        while (found := at_multiplier(f, x, a, n))[1] > -0.9:
            x, a = found[0], a + step * REAL(0.25 if found[1] > -0.5 else 0.06)
        x, a = doubled(f, found[0], a, n)
        points = orbit(f, x, a, n)
        if n > 1:
            widths.append(float(np.abs(points - np.roll(points, n // 2)).max()))
            step = (a - values[-1]) / REAL(DELTA)  # only how far to go
        else:
            step = step / 2
        values.append(a)
        x = orbit(f, x + REAL(1e-3) * (widths[-1] if widths else 1), a + REAL(0.4) * step, 2 * n * max(40, 1000 // n))[
            -1
        ]
        a = a + REAL(0.4) * step
    return Cascade(np.array(values), np.array(widths))


@pytest.fixture(scope="module")
def cascades():
    return {name: located(*how) for name, how in MAPS.items()}


def checked(name, miss, bar, *, most):
    """Intervals that miss, counted: at most so large a share of them."""
    share = np.mean(np.abs(miss) > bar)
    assert share <= most, f"{name}: {share:.3f} of {len(miss)} intervals miss"


@pytest.mark.slow  # intervals of widths are quick
@pytest.mark.parametrize("noise", [1e-15, 1e-11])
def test_intervals_of_doublings_cover(cascades, noise):
    """Of δ and of b∞, at 95 in 100 ends of cascades: from the first, second and third doubling on, four levels or more."""
    rng = np.random.default_rng(1)
    of_delta, of_limit = [], []
    for values, _ in cascades.values():
        # With the known δ the last distance gives the rest of the way to 1e-3 of it: 2e-9 of what three levels leave.
        end = values[-1] + (values[-1] - values[-2]) / (REAL(DELTA) - 1)
        for first in range(3):
            for last in range(first + 4, LEVELS + 1):
                part = (values[first:last] - values[-1]).astype(float) + noise * rng.normal(size=last - first)
                found = doublings_limit(part, np.full(len(part), noise))
                of_delta.append((found.ratio - DELTA, found.ratio_error))
                if last < LEVELS - 2:
                    of_limit.append((found.value - float(end - values[-1]), found.error))
    checked("δ", *np.array(of_delta).T, most=0.05)
    checked("b∞", *np.array(of_limit).T, most=0.05)


def test_intervals_of_widths_cover(cascades):
    """Of α likewise, three levels or more."""
    rng, noise, found = np.random.default_rng(1), 1e-12, []
    for _, widths in cascades.values():
        for first in range(3):
            for last in range(first + 3, len(widths) + 1):
                part = widths[first:last] + noise * rng.normal(size=last - first)
                alpha = widths_limit(part, np.full(len(part), noise))
                found.append((alpha.ratio - ALPHA, alpha.ratio_error))
    checked("α", *np.array(found).T, most=0.05)


def test_digits(cascades):
    """Nine levels give five digits of δ and of α, where the last ratios of some maps have but three, and say so.

    In the last of the seven ratios of distances the tied correction of δ, that falls by δ, is 4.67⁻⁷ = 2e-5 of δ times
    an amplitude of one, 1e-4. Of α, eight widths tell the first tied correction; the next falls by α² and is α⁻¹² of α in
    the first of the last two widths, 4e-5, of an amplitude of one. Intervals are at most ten times as wide as δ's.
    """
    for values, widths in cascades.values():
        delta = doublings_limit((values - values[-1]).astype(float), np.full(LEVELS, 1e-15))
        alpha = widths_limit(widths, np.full(LEVELS - 1, 1e-13))
        assert abs(delta.ratio - DELTA) < 1e-4
        assert delta.ratio_error < 1e-3
        assert abs(alpha.ratio - ALPHA) < 4e-5
        assert alpha.ratio_error < 1e-3


def test_too_few():
    """Three doublings or two widths tell nothing; nor do steps that rounding hides."""
    assert np.isnan(doublings_limit(np.array([1.0, 1.5, 1.6]), np.zeros(3))).all()
    assert np.isnan(widths_limit(np.array([1.0, 0.4]), np.zeros(2))).all()
    hidden = 1.0 - 0.2 ** np.arange(6.0)
    assert np.isnan(doublings_limit(hidden, np.full(6, 1e-2))).all()
    exact = doublings_limit(hidden, np.full(6, 1e-15))
    assert abs(exact.ratio - 5.0) < exact.ratio_error
    assert abs(exact.value - 1.0) < exact.error


def test_pairs_astride_a_jump_have_no_part_in_widths():
    """Orbits of the logistic map near its doublings, one point of which has jumped by one and its partner not yet.

    The strobe of an impact oscillator over its drive's frequency has such pairs at some levels and not at others, and
    α was 1.1 ± 0.2 there.
    """
    widths, plain = [], []
    for level, a in ((3, 3.5644), (4, 3.5688), (5, 3.56969)):
        n = 2**level
        points = [0.5]
        for _ in range(200_000):
            points.append(a * points[-1] * (1.0 - points[-1]))
        orbit = np.array(points[-n:])[:, None]
        plain.append(orbit_width(lambda gap: gap, orbit, np.ones(1), jumps=True))
        largest = int(np.argmax(np.abs(orbit - np.roll(orbit, n // 2, axis=0))))
        orbit[(largest + 2) % n] += 1.0
        widths.append(orbit_width(lambda gap: gap, orbit, np.ones(1), jumps=True))
        assert orbit_width(lambda gap: gap, orbit, np.ones(1), jumps=False) > 0.9
    assert widths == plain
    assert np.isnan(widths_limit(np.array([2.4, 2.1, 2.2, 0.025, 2.2]), np.full(5, 1e-12))).all()


@pytest.mark.parametrize("factor", [-1e-6, 1e6])
def test_units(cascades, factor):
    """Neither the unit of the parameter nor its sign nor its origin plays a part, but for rounding."""
    values = (cascades["sine"].values[:7] - cascades["sine"].values[0]).astype(float)
    one = doublings_limit(values, np.full(7, 1e-12))
    other = doublings_limit(factor * (values + 1.0), np.full(7, 1e-12 * abs(factor)))
    assert other.ratio == pytest.approx(one.ratio, abs=0.01 * one.ratio_error)
    assert other.ratio_error == pytest.approx(one.ratio_error, rel=0.01)
    assert other.value / factor - 1.0 == pytest.approx(one.value, abs=0.01 * one.error)


@pytest.mark.slow  # sequences with the same derivatives are quick
@pytest.mark.parametrize("noise", [1e-13, 1e-10])
def test_intervals_of_derivatives_of_limits_cover(noise):
    """Of b∞ of x → 1 − a x² (1 + c₃ x + c₄ x²) in c₃ and c₄, by differences of cascades in long double."""
    step, rng, found = REAL("1e-3"), np.random.default_rng(1), []
    for third, fourth in ((0.32, 0.16), (-0.2, 0.05), (0.15, 0.0)):
        values, rates = located(polynomial(REAL(third), REAL(fourth)), 0.3, 0.5, 0.1).values, []
        for way in np.eye(2):
            run = {
                k: located(polynomial(*(third, fourth) + k * step * way), 0.3, 0.5, 0.1).values for k in (-2, -1, 1, 2)
            }
            rates.append((8 * (run[1] - run[-1]) - (run[2] - run[-2])) / (12 * step))
        rates = np.array(rates).T
        end = rates[-1] + (rates[-1] - rates[-2]) / (REAL(DELTA) - 1)
        for first in range(3):
            for last in range(first + 4, LEVELS - 1):
                part, error = (values[first:last] - values[-1]).astype(float), np.full(last - first, 1e-15)
                seen = (rates[first:last] - end).astype(float) + noise * rng.normal(size=(last - first, 2))
                found += zip(*limit_rates(part, error, seen, np.full(seen.shape, noise)), strict=True)
    checked("∂b∞", *np.array(found).T, most=0.05)


def test_derivatives_of_limits(cascades):
    """What is a number and a share of the doublings themselves has that number and share of their limit, to rounding."""
    for values, _ in cascades.values():
        part, error = (values[:6] - values[0]).astype(float), np.full(6, 1e-14)
        limit = doublings_limit(part, error)
        rates = np.stack([0.3 - 2.0 * part, np.full(6, 0.7), np.full(6, np.nan)], axis=1)
        got, bar = limit_rates(part, error, rates, np.full(rates.shape, 1e-13))
        assert abs(got[0] - (0.3 - 2.0 * limit.value)) < 0.1 * bar[0] < 0.4 * limit.error
        assert abs(got[1] - 0.7) <= bar[1] < 1e-12
        assert np.isnan([got[2], bar[2]]).all()
    assert np.isnan(limit_rates(part[:3], error[:3], rates[:3], np.ones((3, 3)))).all()
