"""δ of cascades beyond float64: of a map located here in decimals, and of two flows in double-double precision."""

from __future__ import annotations

import itertools
from decimal import Decimal, localcontext

import jax
import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.cascade.extended_precision import alpha_limit, delta_limit, deltas
from jaxnh.exceptions import AccuracyError, ConfigError
from jaxnh.maps.double_double import Double
from jaxnh.maps.extended_precision import extend_precision
from jaxnh.maps.iterate import Derivatives
from jaxnh.orbits.bifurcations.extended_doublings import ExtendedPoint, extended_doubling, from_float64, next_doubling

pytestmark = pytest.mark.usefixtures("shared_programs")
FEIGENBAUM = 4.669201609102990671853  # Briggs, Math. Comp. 57 (1991) 435
ALPHA = 2.502907875095892822284  # the same
LEVELS = 10
PLACE = np.ones(1)


def logistic(levels):
    """Doublings of x → a x (1 − x) by Newton on fⁿ(x) = x, (fⁿ)′ = −1 in forty digits, and points of their orbits."""
    x, a, found, gap = Decimal("0.66"), Decimal("2.99"), [], Decimal("0.45")
    for k in range(levels):
        for _ in range(30):
            y, yx, ya, yxx, yxa = x, Decimal(1), Decimal(0), Decimal(0), Decimal(0)
            for _ in range(2**k):
                slope, here = a * (1 - 2 * y), y * (1 - y)
                yxx, yxa = slope * yxx - 2 * a * yx * yx, slope * yxa + yx * (1 - 2 * y - 2 * a * ya)
                y, yx, ya = a * here, slope * yx, slope * ya + here
            det = (yx - 1) * yxa - ya * yxx
            x += (ya * (yx + 1) - (y - x) * yxa) / det
            step = ((y - x) * yxx - (yx + 1) * (yx - 1)) / det
            a += step
            if abs(step) < Decimal("1e-32"):
                break
        orbit = [x]
        for _ in range(2**k - 1):
            orbit.append(a * orbit[-1] * (1 - orbit[-1]))
        found.append((a, orbit))
        gap = (a - found[-2][0]) / Decimal("4.669") if k else gap
        a, x = a + gap * Decimal("0.95"), x + Decimal("1e-3") * Decimal("0.4") ** k
        for _ in range(2 ** (k + 1) * max(6, 600 // 2**k)):
            x = a * x * (1 - x)
    return found


def halves(number):
    return float(number), float(number - Decimal(float(number)))


@pytest.fixture(scope="module")
def points():
    """The doublings, with a vector of −1 that has grown by the slopes from one at the first point."""
    with localcontext(prec=44):
        found = []
        for a, orbit in logistic(LEVELS):
            slopes = [float(a * (1 - 2 * x)) for x in orbit]
            vector = np.cumprod([1.0, *slopes[:-1]])[:, None]
            x = np.array([halves(x) for x in orbit])[:, :, None]
            found.append(ExtendedPoint(halves(a), 1e-30, (x[:, 0], x[:, 1]), (vector, np.zeros_like(vector))))
        return found


def test_limit_of_a_map(points):
    """The interval covers, from the first and the second doubling on; ten levels leave no more than 1e-7.

    Of δ_10 the corrections of δ⁻¹⁰, 2e-7 of it, and of 0.1237¹⁰ are taken out, and what is left is their products.
    """
    for first in (0, 1):
        limit, error = delta_limit(points[first:])
        assert abs(limit - FEIGENBAUM) <= error < 1e-7


def test_widths_of_a_map(points):
    """α likewise; its corrections are α⁻¹⁰ and δ⁻¹⁰, 1e-4 and 2e-7 of it."""
    for first in (0, 1):
        limit, error = alpha_limit(points[first:], PLACE, np.asarray)
        assert abs(limit - ALPHA) <= error < 1e-5


def test_next_doublings(points):
    """Each doubling of the map from the two before it, to what double-double precision leaves.

    Rounding moves a period by 2⁻¹⁰⁴, and the value by that times what noise of a period grows to at the end of a
    cascade, 6.6 a level (Crutchfield, Nauenberg, Rudnick, Phys. Rev. Lett. 46 (1981) 933) while distances fall by δ.
    """

    def plain(u, w, p):
        return jax.jvp(lambda u: p["a"] * u * (1.0 - u), (u,), (w,))

    compiled = jax.jit(lambda hidden, u, w, p: extend_precision(plain, hidden)(u, w, p))

    def period(u, w, value):
        """One program for all levels: points are padded to those of the last."""
        count, rest = len(u[0]), ((0, 2**LEVELS - len(u[0])), (0, 0))
        u, w = ([np.pad(half, rest) for half in pair] for pair in (u, w))
        a = Double(*(np.full_like(u[0], half) for half in value))
        image = compiled(np.int64(0), Double(*u), Double(*w), {"a": a})
        return tuple(tuple(half[:count] for half in pair) for pair in image)

    def slopes(u, values):
        a = values[:, None]
        return Derivatives(a * u * (1.0 - u), (a * (1.0 - 2.0 * u))[:, :, None], u * (1.0 - u))

    known = [
        extended_doubling(period, slopes, from_float64(at.value[0], at.orbit[0], at.vector[0]), PLACE, np.asarray)
        for at in points[1:3]
    ]
    while len(known) < LEVELS - 1:
        known.append(next_doubling(period, slopes, known, PLACE, np.asarray))
    gap, noise = points[1].value[0] - points[0].value[0], 2.0**-104
    for level, (found, wanted) in enumerate(zip(known, points[1:], strict=True), 1):
        with localcontext(prec=44):
            missed = float(sum(map(Decimal, found.value)) - sum(map(Decimal, wanted.value)))
        assert len(found.orbit[0]) == 2**level
        assert abs(missed) < 100 * noise * (6.619 / FEIGENBAUM) ** level
        assert abs(missed) < 1e-16 * gap / FEIGENBAUM**level


def test_deltas_of_a_map(points):
    """(14), with errors of the size of what the doublings' errors are of the distances."""
    with localcontext(prec=44):
        values = [Decimal(p.value[0]) + Decimal(p.value[1]) for p in points]
        wanted = [float((b - a) / (c - b)) for a, b, c in zip(values, values[1:], values[2:], strict=False)]
        gaps = [float(b - a) for a, b in itertools.pairwise(values)]
    found, errors = deltas(points)
    np.testing.assert_allclose(found, wanted, rtol=1e-15)
    np.testing.assert_allclose(errors, 2e-30 * np.array(found) * (1 / np.array(gaps[1:]) + 1 / np.array(gaps[:-1])))


def test_too_few(points):
    assert np.isnan(delta_limit(points[:8])).all()


CONFIG = {
    "system": {"constraint": "constant_speed"},
    "initial": {"x1": 0.1, "x2": 0.1, "y1": 0.1},
    "sweep": {"b": {"start": 5.6, "stop": 5.45, "count": 64}},
    "accuracy": {"target": 1e-5, "precision": "extended"},
    "analyses": {"doubling": {"levels": 9}},
}
BAD = {
    "without doublings": ({"analyses": {"period": {}}}, "extended is for doubling; ask for it as well"),
    "by a method of Nyström's": (
        {"accuracy": {"precision": "extended", "solver": "nystrom8", "steps": 50}},
        "extended goes with all solvers but nystrom8",
    ),
    "along what lanes share": ({"sweep": {"c": {"start": 1.0, "stop": 1.1, "count": 64}}}, "lanes have of their own"),
}


@pytest.mark.parametrize("name", BAD)
def test_contradictions_are_refused(name):
    changed, message = BAD[name]
    config = {**CONFIG, **changed}
    if name == "along what lanes share":
        config["system"] = {"constraint": "constant_speed", "b": 5.5}
    with pytest.raises(ConfigError, match=message):
        jaxnh.Experiment.from_dict(config)


def test_levels_beyond_float64_are_refused_in_it():
    config = {**CONFIG, "accuracy": {"target": 1e-5}, "analyses": {"doubling": {"levels": 13}}}
    with pytest.raises(ConfigError, match=r"doubling.levels: float64 tells 12 doublings .* need accuracy.precision"):
        jaxnh.Experiment.from_dict(config)


def test_unknown_operations_are_refused(tmp_path):
    """Before anything is computed, and by name."""
    (tmp_path / "bent.py").write_text(
        "import jax.numpy as jnp\n\n\ndef system(force=0.3):\n    def rhs(y, t):\n"
        "        return y[1], jnp.arcsin(0.1 * y[0]) - y[1] + force * jnp.cos(t)\n\n"
        '    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi}\n'
    )
    config = {
        "system": {"file": str(tmp_path / "bent.py")},
        "initial": {"x": 0.1, "v": 0.0},
        "sweep": {"force": {"start": 0.1, "stop": 0.2, "count": 4}},
        "accuracy": {"target": 1e-5, "precision": "extended"},
        "analyses": {"doubling": {"levels": 2}},
    }
    with pytest.raises(AccuracyError, match="asin is not known in extended precision, and the system has it"):
        jaxnh.Session(jaxnh.Experiment.from_dict(config)).run("doubling")
