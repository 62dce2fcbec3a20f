"""Whether signs of test functions of pairs of multipliers are known. Host code.

Along a branch of a conservative flow the product of two multipliers is one everywhere, or the sum of two eigenvalues
zero: test functions of Neimark–Sacker and Hopf points are what rounding and steps make of that, and change sign
anywhere. A sign is known where the function is larger than what the last digits of the matrices and twice the steps
change it by.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from jaxnh.orbits.continuation.arclength import CurveOrbits, Family, PathVector, correct
from jaxnh.orbits.continuation.core import FINE
from jaxnh.orbits.continuation.kinds import HOPF, NEIMARK_SACKER, kinds, test_functions

PAIRS = (NEIMARK_SACKER, HOPF)
"""Bifurcations of two multipliers, or of two eigenvalues."""

_LAST_DIGITS = 16 * np.finfo(float).eps  # of the matrices' entries, after steps of a period
_DRAWS = 4  # of them
_STEPS = 0.1  # of a function, that twice the steps change it by: its sign may be another one then


def known_signs(families: Sequence[Family], at: PathVector, ways: PathVector) -> Bool[np.ndarray, " lanes"]:
    """Tell where the sign of the test function of pairs is that of the flow, or nothing says that it is not.

    Args:
        families: the map, and the same with twice the steps.
        at: orbits on branches.
        ways: directions of the branches there, of length one.
    """
    family, finer = families[:2]
    orbits = correct(family, *at, ways, FINE)
    test = _of_pairs(family, orbits)
    draws = np.random.default_rng(0).uniform(-1.0, 1.0, (_DRAWS, *orbits.blocks.shape[1:]))
    known = np.ones(len(test), bool)
    for draw in draws:
        changed = orbits._replace(blocks=orbits.blocks * (1.0 + _LAST_DIGITS * draw))
        known &= ~(np.abs(_of_pairs(family, changed) - test) >= np.abs(test))
    if finer is not family:
        known &= ~(np.abs(_of_pairs(finer, correct(finer, *at, ways, FINE)) - test) >= _STEPS * np.abs(test))
    return known


def _of_pairs(family: Family, orbits: CurveOrbits) -> Float[np.ndarray, " lanes"]:
    """The test function of the pairs of a family, not a number where there is no orbit."""
    safe = orbits._replace(blocks=np.where(orbits.converged[:, None, None, None], orbits.blocks, 0.0))
    (column,) = (number for number, kind in enumerate(kinds(family)) if kind in PAIRS)
    return np.where(orbits.converged, test_functions(family, safe)[:, column], np.nan)
