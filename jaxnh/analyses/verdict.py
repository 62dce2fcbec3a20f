"""One verdict a lane from all criteria together: periodic, quasiperiodic, chaotic, undecided or failed.

The rule, with λ1 the largest exponent, ε its error bar (two standard errors and half the drift), n the period found by
Newton (0: none up to the limit), μ its largest multiplier, K the 0–1 test, T the strobe period and N the periods that
λ1 was averaged over:

- failed: the state is not finite.
- periodic: n > 0 and |μ| < 1; λ1 agrees with ln|μ|/(nT) within ε + 4/(NT), the second being what a finite average keeps
  of how the lane came to its orbit; and K < 0.5.
- chaotic: n = 0, λ1 − ε > 0 and K > 0.5.
- quasiperiodic: n = 0, |λ1| ≤ ε with ε ≤ 0.005, and K < 0.5.
- undecided: everything else, that is whenever the criteria disagree.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int, Int8

from jaxnh.analyses.base import LANE, Analysis, LaneRunner, Options, Price, Scene, map_alone, variable

KINDS = ("periodic", "quasiperiodic", "chaotic", "undecided", "failed")
"""Meanings of the flags 0, 1, 2, 3, 4."""

_SMALL_ERROR = 0.005
_COMING = 4.0


class VerdictOptions(Options):
    """`verdict` has no options: it takes what the analyses it needs were asked for."""


def periods(options: VerdictOptions, lanes: int) -> float:
    """Nothing beyond the analyses that it needs."""
    return 0.0


def run(options: VerdictOptions, scene: Scene, lanes: LaneRunner, done: Mapping[str, xr.Dataset]) -> xr.Dataset:
    """The verdict of every lane from the datasets `period`, `lyapunov` and `chaos01` of the same lanes."""
    period, lyapunov = done["period"], done["lyapunov"]
    kind = judge(
        period["period"].to_numpy(),
        period["multiplier"].to_numpy(),
        period["failed"].to_numpy().astype(bool),
        lyapunov["exponents"].to_numpy()[:, 0],
        lyapunov["exponents_error"].to_numpy()[:, 0],
        done["chaos01"]["k"].to_numpy(),
        scene.system.period,
        lyapunov["averaged"].to_numpy(),
    )
    flags = {"flag_values": np.arange(len(KINDS), dtype=np.int8), "flag_meanings": " ".join(KINDS)}
    variables = {"kind": variable(LANE, kind, "kind of motion from all criteria together", **flags)}
    return xr.Dataset(variables, attrs={"panel": "flags", "panel_variables": "kind", "panel_label": "verdict"})


def count(data: xr.Dataset) -> dict[str, int]:
    """Number of lanes of each kind."""
    return {name: int(np.sum(data["kind"].to_numpy() == i)) for i, name in enumerate(KINDS)}


def judge(
    period: Int[np.ndarray, " lanes"],
    multiplier: Float[np.ndarray, " lanes"],
    failed: Bool[np.ndarray, " lanes"],
    largest: Float[np.ndarray, " lanes"],
    error: Float[np.ndarray, " lanes"],
    k: Float[np.ndarray, " lanes"],
    strobe_period: float,
    averaged: Int[np.ndarray, " lanes"],
) -> Int8[np.ndarray, " lanes"]:
    """The rule of this module: flags of `KINDS`."""
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


def price(options: VerdictOptions, scene: Scene) -> Price:
    """It integrates nothing and compiles nothing."""
    return Price(None, map_alone(scene), "not measured: some comparisons a lane of what the others have found")


ANALYSIS = Analysis(
    "verdict",
    VerdictOptions,
    periods,
    run,
    needs=("period", "lyapunov", "chaos01"),
    clock=True,
    count=count,
    price=price,
)
"""The entry of this analysis in the table."""
