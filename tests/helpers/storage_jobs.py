"""Jobs as `jaxnh.storage` has them."""

from __future__ import annotations

from jaxnh.storage.pieces import Job
from jaxnh.storage.tiles import SecondsSpent


def job(axes=(("b", 10, False),), tile=4, order=("diagram", "doubling"), independent=("diagram",)):
    """A job of two analyses over an axis, or others."""
    return Job(
        "c" * 64,
        {"jaxnh": "0"},
        "blanes_moan6",
        40,
        False,
        1e-6,
        {"lyapunov": {"parts": 4}},
        order,
        independent,
        tuple(axes),
        tile,
    )


SPENT = SecondsSpent(1.0, 0.5, 100.0, "1 x cpu (cpu)")
