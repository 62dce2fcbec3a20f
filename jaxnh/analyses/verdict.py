"""One verdict a lane from all criteria together: periodic, quasiperiodic, chaotic, undecided or failed.

The rule, with λ1 the largest exponent, ε its error bar (two standard errors and half the drift), n the period found by
Newton (0: none up to the limit), μ its largest multiplier, K the 0–1 test, T the strobe period and N the periods that
λ1 was averaged over:

- failed: the lane has left the numbers.
- periodic: n > 0 and |μ| < 1; λ1 agrees with ln|μ|/(nT) within ε + 4/(NT), the second being what a finite average keeps
  of how the lane came to its orbit; and K < 0.5.
- chaotic: n = 0, λ1 − ε > 0 and K > 0.5.
- quasiperiodic: n = 0, |λ1| ≤ ε with ε ≤ 0.005, and K < 0.5.
- undecided: everything else, that is whenever the criteria disagree.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from jaxnh.analyses.base import Group, LaneRunner, Options, Scene, Variable

KINDS = ("periodic", "quasiperiodic", "chaotic", "undecided", "failed")
"""Meanings of the flags 0, 1, 2, 3, 4."""

_SMALL_ERROR = 0.005
_COMING = 4.0


class VerdictOptions(Options):
    """`verdict` has no options: it takes what the analyses it needs were asked for."""


def periods(options: VerdictOptions, lanes: int) -> float:
    """Nothing beyond the analyses that it needs."""
    return 0.0


def run(options: VerdictOptions, scene: Scene, lanes: LaneRunner, done: Mapping[str, Group]) -> Group:
    """The verdict of every lane from the groups `period`, `lyapunov` and `chaos01` of the same run."""
    period, lyapunov = done["period"].variables, done["lyapunov"].variables
    kind = judge(
        period["period"].data,
        period["multiplier"].data,
        period["failed"].data.astype(bool),
        lyapunov["exponents"].data[:, 0],
        lyapunov["exponents_error"].data[:, 0],
        done["chaos01"].variables["k"].data,
        scene.system.period,
        lyapunov["averaged"].data,
    )
    flags = {"flag_values": np.arange(len(KINDS), dtype=np.int8), "flag_meanings": " ".join(KINDS)}
    variables = {
        "b": Variable(("b",), scene.values, scene.system.sweeps),
        "kind": Variable(("b",), kind, "kind of motion from all criteria together", attrs=flags),
    }
    return Group(variables)


def count(variables: Mapping[str, Variable]) -> dict[str, int]:
    """Lanes of each kind."""
    return {name: int(np.sum(variables["kind"].data == i)) for i, name in enumerate(KINDS)}


def judge(
    period: np.ndarray,
    multiplier: np.ndarray,
    failed: np.ndarray,
    largest: np.ndarray,
    error: np.ndarray,
    k: np.ndarray,
    strobe_period: float,
    averaged: np.ndarray,
) -> np.ndarray:
    """The rule of this module, arrays (lanes,) in, flags of `KINDS` (lanes,) out."""
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = np.log(multiplier) / (np.maximum(period, 1) * strobe_period)
        agrees = np.abs(largest - np.maximum(expected, -1e3)) <= error + _COMING / (averaged * strobe_period)
    regular = k < 0.5
    conditions = [
        failed | ~np.isfinite(largest),
        (period > 0) & (multiplier < 1.0) & agrees & regular,
        (period == 0) & (largest - error > 0.0) & ~regular,
        (period == 0) & (np.abs(largest) <= error) & (error <= _SMALL_ERROR) & regular,
    ]
    return np.select(conditions, [4, 0, 2, 1], default=3).astype(np.int8)
