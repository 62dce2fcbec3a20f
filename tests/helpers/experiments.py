"""Experiments of the paper's particle as mappings, with few steps that are given."""

from __future__ import annotations

PARTICLE = {"constraint": "disturbed_speed", "a": 0.5, "b": 5.3, "c": 1.0, "d": 0.1, "omega": 1.0}
FEW = {"solver": "blanes_moan6", "steps": 40}
STROBES = {"poincare": {"transient": 20, "strobes": 3}}


def content(sweep, analyses=STROBES, system=None, accuracy=FEW, **others):
    """The content of an experiment; what is swept stands in the sweep alone."""
    system = dict(PARTICLE if system is None else system)
    return {
        "system": {name: value for name, value in system.items() if name not in sweep},
        "sweep": sweep,
        "accuracy": accuracy,
        "analyses": analyses,
        **others,
    }
