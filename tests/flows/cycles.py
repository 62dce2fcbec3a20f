"""Flows without a clock whose cycles bifurcate, of heyoka's expressions as of numbers."""

from __future__ import annotations

from tests.helpers import taylor


def peroxidase(a, b, x, y, k8, t):
    """configs/flows/peroxidase.py."""
    real = taylor.REAL
    one, three, two = real(0.1631021) * a * b * x, real(0.046875) * a * b * y, real(2500) * (x * x)
    return (
        real(1.5) - real(0.1175) * a - one - three,
        k8 - one - three,
        one - two + real(2) * three - real(20) * x + real(0.001),
        two - three - real(1.104) * y,
    )


def circuit(epsilon, a3, b3):
    """configs/flows/circuit.py."""
    real = taylor.REAL

    def rates(x, y, z, nu, t):
        gap = y - x
        bent = real(b3) * (gap * gap * gap)
        first = bent - real(a3) * (x * x * x) + real(0.5) * y - (real(0.5) + nu) * x
        return first / real(0.6), real(0.5) * x + real(0.1) * y - z - bent, y + real(epsilon)

    return rates
