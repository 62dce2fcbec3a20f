"""The paper's particle with effects left out, as several tests have it: lanes, starts, and a config with a section."""

from __future__ import annotations

import math

import numpy as np

from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import constant_speed
from tests.helpers.batches import broadcast_start

START = ((0.1, 0.1), (0.1, math.sqrt(0.99)))
ANGLE = np.array([0.1, 0.1, math.atan2(math.sqrt(0.99), 0.1)])
LANES = 16
B = np.linspace(0.1, 0.8, LANES)
P = {"b": B}
SPLITTING = SPLITTINGS["kahan_li8"]
CONFIG = """\
title: Effects
system: {constraint: constant_speed, a: 0.5, c: 1.0, without: [forcing]}
sweep: {b: {values: [0.2, 0.3]}}
section: {coordinate: y1, value: 0.0, direction: up}
accuracy: {target: 1.0e-6}
analyses:
  poincare: {transient: 2, strobes: 16}
  diagram: {transient: 2, strobes: 4}
  portrait: {transient: 1, periods: 2, samples: 8}
"""


def particle_without(*names, **others):
    """The particle at a constant speed without some effects."""
    return constant_speed(without=names, **others)


def spread(start, count=LANES):
    """The same state on all lanes."""
    return broadcast_start(start, count)


def write_config(folder):
    """The config in a folder."""
    path = folder / "scene.yaml"
    path.write_text(CONFIG, encoding="utf-8")
    return path
