"""Sweeps in levels, as mappings."""

from __future__ import annotations

WIDE = {"b": {"start": 5.4, "stop": 5.7, "count": 33}, "a": {"start": 0.49, "stop": 0.51, "count": 9}}
ANALYSES = {"lyapunov": {"transient": 16, "periods": 32, "exponents": 1}, "period": {"transient": 16, "max_period": 4}}


def sweep_content(sweep, levels=None, analyses=ANALYSES):
    """Return the content of an experiment."""
    return {
        "system": {"constraint": "disturbed_speed" if "d" in sweep else "constant_speed", "c": 1.0, "omega": 1.0},
        "sweep": sweep,
        "accuracy": {"solver": "blanes_moan6", "steps": 40},
        "analyses": analyses,
        **({"levels": levels} if levels else {}),
    }


PERIOD = {"period": ANALYSES["period"]}
