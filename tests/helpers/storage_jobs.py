"""Jobs of small sweeps."""

from __future__ import annotations

from jaxnh.jobs.cutting import Cutting
from jaxnh.jobs.job import Job, NumericalPlan
from jaxnh.jobs.provenance import Provenance, SecondsSpent


def job(axes=(("b", 10, False),), tile=4, order=("diagram", "doubling"), independent=("diagram",)):
    """A job of two analyses over an axis, or others."""
    return Job(
        NumericalPlan("blanes_moan6", 40, False, 1e-6, {"lyapunov": {"parts": 4}}),
        Cutting(tuple(axes), tile, order, independent),
        Provenance("c" * 64, {"jaxnh": "0"}, {}),
    )


SPENT = SecondsSpent(1.0, 0.5, 100.0, "1 x cpu (cpu)")
