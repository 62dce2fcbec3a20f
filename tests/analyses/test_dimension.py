"""Kaplan–Yorke dimensions by hand, and what their errors cover."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.exponents.dimension import kaplan_yorke, kaplan_yorke_error


@pytest.mark.parametrize(
    ("exponents", "dimension"),
    [((0.5, -1.0, -2.0), 1.5), ((-0.1, -1.0, -2.0), 0.0), ((0.5, 0.1, -1.2), 2.5), ((0.5, 0.1, -0.2), 3.0)],
)
def test_kaplan_yorke(exponents, dimension):
    """The definition, worked by hand."""
    assert kaplan_yorke(np.array([exponents]))[0] == pytest.approx(dimension)


@pytest.mark.parametrize(
    "exponents",
    [
        (0.9, 0.0, -14.57),
        (0.5, 0.2, 0.0, -3.0),
        (-0.1, -2.0),
        (0.3, -0.2),
        (0.3, -0.2999),
        (0.0, -5e-5, -1.0),
        (0.5, 0.4),
    ],
)
def test_error_of_the_dimension(exponents):
    """What the worst of all changes of the exponents by their errors does; one where an exponent may be zero."""
    value = np.array([exponents])
    error = np.linspace(1.0, 2.0, value.shape[1])[None] * 1e-4
    changed = [value + error * sign for sign in itertools.product((-1.0, 1.0), repeat=value.shape[1])]
    worst = np.abs(kaplan_yorke(-np.sort(-np.concatenate(changed), axis=1)) - kaplan_yorke(value)).max()
    assert kaplan_yorke_error(value, error)[0] == pytest.approx(worst, rel=1e-12)


@pytest.mark.parametrize(
    "exponents", [(0.42, -1.62), (0.9, 0.0, -14.57), (0.11, 0.02, 0.0, -24.0), (-0.1, -2.0), (0.3, -0.2)]
)
def test_error_of_the_dimension_where_the_sum_is_known(exponents):
    """No changes within the errors of exponents and of their sum go beyond the bar, and of two exponents some reach it."""
    value, rng = np.array([exponents]), np.random.default_rng(3)
    error, of_sum = np.linspace(2.0, 1.0, value.shape[1])[None] * 1e-3, 1e-5
    changes = error * rng.uniform(-1.0, 1.0, (200_000, value.shape[1]))
    last = rng.uniform(-of_sum, of_sum, len(changes)) - changes[:, :-1].sum(axis=1)
    changes = np.column_stack([changes[:, :-1], last])[np.abs(last) <= error[0, -1]]
    off = np.abs(kaplan_yorke(-np.sort(-(value + changes), axis=1)) - kaplan_yorke(value)).max()
    bar, plain = kaplan_yorke_error(value, error, np.array([of_sum]))[0], kaplan_yorke_error(value, error)[0]
    assert off <= bar * (1 + 1e-12)
    assert bar <= plain
    if exponents == (0.42, -1.62):
        assert off > 0.98 * bar
        assert bar < 0.4 * plain


def test_error_of_the_dimension_covers():
    """Hénon's attractor from 400 starts, whose dimension is 1 + λ₁/|λ₂|, with 4 million iterates in NumPy beside it."""

    def henon(a=1.4, b=0.3):
        return {"map": lambda y: (1 - a * y[0] ** 2 + y[1], b * y[0]), "coordinates": ("x", "y")}

    x, y, q = np.linspace(-0.2, 0.2, 400), np.zeros(400), np.array([np.ones(400), np.zeros(400)])
    total = np.zeros(400)
    for n in range(11_000):
        slope, (x, y) = -2.8 * x, (1 - 1.4 * x**2 + y, 0.3 * x)
        q = np.array([slope * q[0] + q[1], 0.3 * q[0]])
        length = np.hypot(*q)
        q, total = q / length, total + (np.log(length) if n >= 1000 else 0.0)
    largest = total.mean() / 10_000
    data = jaxnh.Session(henon).run(jaxnh.Lyapunov(periods=1024), x=np.linspace(-0.2, 0.2, 400))
    off = np.abs(data["kaplan_yorke"] - (1 + largest / (largest - np.log(0.3))))
    assert float(np.mean(off <= data["kaplan_yorke_error"])) >= 0.95
    assert float(data["kaplan_yorke_error"].median()) < 0.018  # 0.027 where the errors of both exponents add up
