"""Experiments on right-hand sides written out in a test, and on Duffing's oscillator among them."""

from __future__ import annotations

from jaxnh.engine.experiment import Experiment

FLOW = """
import jax.numpy as jnp


def system({parameters}):
    def rhs(y, t):
        {names} = y
        return {rates}

    return {{"rhs": rhs, "coordinates": {coordinates}, {rest}}}
"""


def experiment(folder, coordinates, rates, sweep, options=None, rest="", parameters="", **more):
    """An experiment on a right-hand side written out."""
    names = ", ".join(coordinates) + ("," if len(coordinates) == 1 else "")
    file = folder / "flow.py"
    file.write_text(
        FLOW.format(parameters=parameters, names=names, rates=rates, coordinates=tuple(coordinates), rest=rest)
    )
    content = {
        "system": {"file": str(file)},
        "initial": {name: 0.0 for name in coordinates if name not in sweep},
        "sweep": sweep,
        "accuracy": {"target": 1e-8},
        "analyses": {"basins": options or {}},
    }
    return Experiment.from_dict({**content, **more})


OSCILLATOR = {
    "coordinates": ("x", "v"),
    "rates": "v, drive * jnp.cos(t) - damping * v + linear * x - x**3 + push",
    "rest": '"period": 2 * jnp.pi',
    "parameters": "linear=0.0, damping=0.08, drive=0.2, push=0.0",
}


def oscillator(folder, sweep, options=None, drive=0.2, **parameters):
    """x'' + damping x' = linear x − x³ + push + drive cos t, over its drive at least, so that one program serves all tests.

    With steps that are given, as those chosen depend on the sweep.
    """
    sweep = {"drive": {"values": [drive]}, **sweep}
    more = {"system": {"file": str(folder / "flow.py"), **parameters}}
    accuracy = {"solver": "nystrom8", "steps": 32}
    return experiment(folder, sweep=sweep, options=options, accuracy=accuracy, **OSCILLATOR, **more)


def line(start, stop, count):
    """An axis of a sweep with equal distances."""
    return {"start": start, "stop": stop, "count": count}
