"""Numbers of programs that well-known configs compile: compiling is most of what a small job waits for."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.executor.programs import Programs
from jaxnh.engine.experiment import Experiment, load
from jaxnh.engine.session import Session

ROOT = Path(__file__).resolve().parents[2]


def compiled_by(session):
    """Programs of all analyses of a session, by the function that each is of."""
    programs = Programs(kept=False)
    session._lanes = LaneExecutor(programs=programs)
    session.tree()
    return Counter(key[0].__name__ for key in programs._programs)


def test_programs_of_the_page_on_right_hand_sides():
    """docs/howto/right_hand_side.md: a diagram on a section and a spectrum by strobes of Lorenz's system.

    Returns are compiled once, in tiles of 32, for the samples of the calibration and the lanes of the diagram; strobes
    for the transient of the spectrum, which has no section. The spectrum looks whether lanes have come to rest (`_run`; none
    has, and nothing is linearised); tangents begin, and are advanced. The calibration takes a first look, and the rates of
    crossings.
    """
    content = {
        "system": {"file": str(ROOT / "configs" / "flows" / "lorenz.py")},
        "initial": {"x": 1.0, "y": 1.0, "z": 20.0},
        "sweep": {"rho": {"start": 28.0, "stop": 220.0, "count": 64}},
        "section": {"normal": {"x": 1.0, "y": -1.0}, "value": 0.0, "direction": "up"},
        "accuracy": {"target": 1e-6},
        "analyses": {
            "diagram": {"transient": 16, "strobes": 64},
            "lyapunov": {"transient": 16, "periods": 64, "exponents": 3},
        },
    }
    counts = compiled_by(Session(Experiment.from_dict(content)))
    assert counts == {
        "iterate": 2,
        "record": 1,
        "begin": 1,
        "advance": 1,
        "_run": 1,
        "_follow": 1,
        "_crossing_rates": 1,
    }


@pytest.mark.slow
def test_programs_of_table1():
    """configs/table1.yaml: the map is calibrated twice, with plain and with compensated sums.

    Derivatives are compiled for tiles of 128 and of 32 lanes, by how many lanes have an orbit, and with those in b for
    the doublings; section coordinates are read of 32 strobes of an early look, and of 128 after the transient.
    """
    counts = compiled_by(Session(load(ROOT / "configs" / "table1.yaml")))
    assert counts == {
        "iterate": 2,
        "record": 1,
        "_state_at": 1,
        "observe_states": 2,
        "derivatives": 3,
        "section_map": 1,
    }
