"""δ of cascades beyond float64: of a map located here in decimals, and of two flows in double-double precision."""

from __future__ import annotations

import itertools
from decimal import Decimal, localcontext

import numpy as np
import pytest
from conftest import ROOT

import jaxnh
from jaxnh.analyses.extended import delta_limit, deltas
from jaxnh.exceptions import AccuracyError, ConfigError
from jaxnh.orbits.extended_doublings import ExtendedPoint

FEIGENBAUM = 4.669201609102990671853  # Briggs, Math. Comp. 57 (1991) 435
LEVELS = 10


def logistic(levels):
    """Doublings of x → a x (1 − x) by Newton on fⁿ(x) = x, (fⁿ)′ = −1 in forty digits."""
    x, a, values, gap = Decimal("0.66"), Decimal("2.99"), [], Decimal("0.45")
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
        values.append(a)
        gap = (values[-1] - values[-2]) / Decimal("4.669") if k else gap
        a, x = a + gap * Decimal("0.95"), x + Decimal("1e-3") * Decimal("0.4") ** k
        for _ in range(2 ** (k + 1) * max(6, 600 // 2**k)):
            x = a * x * (1 - x)
    return values


@pytest.fixture(scope="module")
def points():
    with localcontext(prec=44):
        return [ExtendedPoint((float(v), float(v - Decimal(float(v)))), 1e-30) for v in logistic(LEVELS)]


def test_limit_of_a_map(points):
    """The interval covers, from the first and the second doubling on; ten levels leave no more than 1e-7.

    Of δ_10 the corrections of δ⁻¹⁰, 2e-7 of it, and of 0.1237¹⁰ are taken out, and what is left is their products.
    """
    for first in (0, 1):
        limit, error = delta_limit(points[first:])
        assert abs(limit - FEIGENBAUM) <= error < 1e-7


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


@pytest.mark.slow
def test_governor_agrees():
    """A flow that is no particle: ten levels leave what they leave of a map, 1e-7."""
    asked = ["accuracy.precision=extended", "accuracy.target=1e-5", "sweep.drive.start=0.83"]
    asked += ["analyses={doubling: {levels: 10}}"]
    data = jaxnh.Session(jaxnh.load(ROOT / "configs/governor.yaml", asked)).run("doubling")
    assert data.attrs["levels_found"] == 10
    assert abs(data.attrs["delta_limit"] - FEIGENBAUM) <= data.attrs["delta_limit_error"] < 1e-6
    assert abs(data.attrs["delta_limit"] - FEIGENBAUM) < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize(
    "changed",
    [{}, {"system": {"constraint": "disturbed_speed"}, "sweep": {"b": {"start": 5.9, "stop": 5.72, "count": 64}}}],
    ids=["constant speed", "disturbed speed"],
)
def test_two_flows_agree(changed):
    """δ of two flows covers Feigenbaum's, far closer than float64 could tell: in nine levels to 1e-5."""
    data = jaxnh.Session(jaxnh.Experiment.from_dict({**CONFIG, **changed})).run("doubling")
    assert data.attrs["levels_found"] == 9
    assert abs(data.attrs["delta_limit"] - FEIGENBAUM) <= data.attrs["delta_limit_error"] < 1e-2
    assert abs(data.attrs["delta_limit"] - FEIGENBAUM) < 1e-5
    # The other digits are beyond float64, and of δ rounding leaves nothing but what steps do.
    assert np.all(np.abs(data["b_rest"]) <= np.spacing(data["b"]) / 2)


@pytest.mark.slow
@pytest.mark.parametrize("table", ["table1", "table2"])
def test_twelve_levels_of_the_tables(table):
    """δ to ten digits from both tables' cascades up to period 4096, and an error that covers.

    Rounding leaves δ_11 at 1e-14 of it; its correction of δ⁻¹² is 1e-8, of which extrapolation takes out two terms.
    """
    asked = ["accuracy.precision=extended", "accuracy.target=1e-8", "analyses={doubling: {levels: 12, search: false}}"]
    data = jaxnh.Session(jaxnh.load(ROOT / f"configs/{table}.yaml", asked)).run("doubling")
    assert data.attrs["levels_found"] == 12
    assert abs(data.attrs["delta_limit"] - FEIGENBAUM) <= data.attrs["delta_limit_error"] < 1e-8
    assert abs(data.attrs["delta_limit"] - FEIGENBAUM) < 1e-10
