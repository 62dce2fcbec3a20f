"""One verdict a lane from all criteria together: periodic, quasiperiodic, chaotic, undecided or failed.

The rule, with λ1 the largest exponent, ε its error bar of 95 % (`exponent_errors`), n the period found by Newton (0:
none up to the limit), μ its largest multiplier, K the 0–1 test, T the strobe period and N the periods that λ1 was
averaged over:

- failed: the state is not finite.
- periodic: n > 0 and |μ| < 1; λ1 agrees with ln|μ|/(nT) within ε + 4/(NT), the second being what a finite average keeps
  of how the lane came to its orbit; and K < 0.5.
- chaotic: n = 0, (λ1 − ε) NT > 2 ln N, K > 0.5, and the motion still does not repeat itself in a run ten times as long.
- quasiperiodic: n = 0, |λ1| ≤ ε with ε ≤ 0.005 · 2π/T, and K < 0.5, in a flow that knows the time.
- undecided: everything else, that is whenever the criteria disagree.

On a torus tangents grow in proportion to time, so that λ1 is positive in any finite average: ln N / NT, and twice that
allows for a shear of up to N. Chaos may be a transient: near a window it lasts thousands of periods. So lanes that look
chaotic are followed, by the map alone, for `longer` times as long as the criteria took, and then no lag of up to
512 periods may bring 512 points back to within 10⁻⁶ of the extent that the motion had in the beginning: chaos with
λ1 T > 0.05 parts points from 10⁻¹⁶ to more than that within as many periods.

Where the right-hand side is the same at all times, the strobe is no part of the motion: a limit cycle, whose own period
the strobe does not share, looks quasiperiodic on it. If there λ1 is zero as above and λ2 negative, by as much in the
other direction, the motion is periodic; else undecided.
"""

from __future__ import annotations

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, Int8
from pydantic import Field

from jaxnh.analyses.base import LANE, Analysis, Options, variable
from jaxnh.analyses.price import Price, map_alone
from jaxnh.analyses.scene import LaneRunner, Scene, picked
from jaxnh.maps.iterate import iterate, record
from jaxnh.maps.protocol import Strobe
from jaxnh.systems.flow import Flow, Parameters, State

KINDS = ("periodic", "quasiperiodic", "chaotic", "undecided", "failed")
"""Meanings of the flags 0, 1, 2, 3, 4."""

_LOOKS = 5
_SMALL_ERROR = 0.005 * 2 * np.pi  # of an exponent a period
_COMING = 4.0
_LONGEST = 512  # lags that a motion may repeat itself after, and points that have to come back
_BACK = 1e-6  # of the extent of the points
_PERIODIC, _QUASIPERIODIC, _CHAOTIC, _UNDECIDED = range(4)
_SHARE, _USUAL = 0.2, 1536  # of lanes that look chaotic, and how long their criteria took: for the expected work


class VerdictOptions(Options):
    """Options of `verdict`, beside those of the analyses that it needs."""

    longer: int = Field(
        default=10, ge=0, description="Lanes that look chaotic are followed for so many times as long; 0: they are not"
    )


def periods(options: VerdictOptions, lanes: int) -> float:
    """Lane-periods of a run, beyond the analyses that it needs: of a usual share of lanes that look chaotic."""
    return _SHARE * lanes * (options.longer * _USUAL + 3 * _LONGEST)


def run(options: VerdictOptions, scene: Scene, lanes: LaneRunner, done: Mapping[str, xr.Dataset]) -> xr.Dataset:
    """The verdict of every lane from the datasets `period`, `lyapunov` and `chaos01` of the same lanes."""
    period, lyapunov = done["period"], done["lyapunov"]
    exponents, errors = lyapunov["exponents"].to_numpy(), lyapunov["exponents_error"].to_numpy()
    span = lyapunov["averaged"].to_numpy()
    kind = judge(
        period["period"].to_numpy(),
        period["multiplier"].to_numpy(),
        period["failed"].to_numpy().astype(bool),
        exponents[:, 0],
        errors[:, 0],
        done["chaos01"]["k"].to_numpy(),
        scene.system.period,
        span,
    )
    timeless = _timeless(scene, lanes, np.flatnonzero(kind == _QUASIPERIODIC))
    cycle = contracts(exponents[timeless], errors[timeless], scene.system.period, span[timeless])
    kind[timeless] = np.where(cycle, _PERIODIC, _UNDECIDED)
    again = np.full(scene.count, -1)
    chaotic = np.flatnonzero(kind == _CHAOTIC)
    if options.longer and len(chaotic):
        taken = span[chaotic] + max(int(done[name].attrs["transient"]) for name in ("period", "chaos01"))
        again[chaotic] = _followed(scene.take(chaotic), lanes, options.longer * taken)
        kind[again > 0] = _UNDECIDED
    flags = {"flag_values": np.arange(len(KINDS), dtype=np.int8), "flag_meanings": " ".join(KINDS)}
    words = (
        f"period after which a lane that had looked chaotic repeats itself, 0: none up to {_LONGEST}, -1: not followed"
    )
    variables = {
        "kind": variable(LANE, kind, "kind of motion from all criteria together", **flags),
        "repeats": variable(LANE, again, words, "periods"),
    }
    attrs = {"longer": options.longer, "panel": "flags", "panel_variables": "kind", "panel_label": "verdict"}
    return xr.Dataset(variables, attrs=attrs)


def _timeless(scene: Scene, lanes: LaneRunner, some: Int[np.ndarray, " some"]) -> Int[np.ndarray, " timeless"]:
    """Those of some lanes whose right-hand side is the same at all times."""
    if not len(some):
        return some
    times = scene.flow.period * (np.arange(_LOOKS) + 0.3) / _LOOKS
    shared = (scene.strobe(), scene.flow, times)
    return some[lanes(knows_no_time, shared, picked(scene.lanes, some), periods=_LOOKS)]


def _followed(scene: Scene, lanes: LaneRunner, taken: Int[np.ndarray, " lanes"]) -> Int[np.ndarray, " lanes"]:
    """`repeats` of lanes, each so many periods from its start."""
    found, strobe = np.zeros(scene.count, int), scene.strobe()
    with lanes.stage(f"verdict: {scene.count} chaotic lanes, longer", float(np.sum(taken + 3 * _LONGEST))):
        for count in np.unique(taken):
            some = np.flatnonzero(taken == count)
            shared, cost = (strobe, np.int32(count)), int(count) + 3 * _LONGEST
            found[some] = lanes(repeats, shared, picked(scene.lanes, some), periods=cost, static=(_LONGEST,))
    return found


def repeats(strobe: Strobe, count: ArrayLike, state: State, p: Parameters, longest: int) -> Array:
    """Least lag up to `longest` at which as many points, `count` periods from a state, come back; 0: none."""
    system = strobe.system
    early = jax.vmap(system.chart)(record(strobe, state, p, longest)[1])[longest // 2 :]
    near = _BACK * (jnp.max(early, axis=0) - jnp.min(early, axis=0)).max()
    points = jax.vmap(system.chart)(record(strobe, iterate(strobe, count, state, p), p, 2 * longest)[1])
    first = points[:longest]

    def back(lag: Array) -> Array:
        later = lax.dynamic_slice_in_dim(points, lag, longest)
        return jnp.max(jnp.abs(system.wrap(later - first))) <= near

    found = lax.map(back, jnp.arange(1, longest + 1))
    return jnp.where(jnp.any(found), 1 + jnp.argmax(found), 0)


def knows_no_time(strobe: Strobe, flow: Flow, times: Float[Array, " times"], state: State, p: Parameters) -> Array:
    """Whether the right-hand side is the same at all times, to the bit, in states that a lane comes to."""
    _, states = record(strobe, state, p, _LOOKS)

    def rates(t: Array) -> State:
        return jax.vmap(lambda y: flow.rhs(t, y, p))(states)

    same = [jnp.all(leaf == leaf[:1]) for leaf in jax.tree.leaves(jax.vmap(rates)(times))]
    return jnp.all(jnp.stack(same))


def contracts(
    exponents: Float[np.ndarray, "lanes k"],
    errors: Float[np.ndarray, "lanes k"],
    strobe_period: float,
    averaged: Int[np.ndarray, " lanes"],
) -> Bool[np.ndarray, " lanes"]:
    """Whether the second exponent is known, and negative beyond what a torus leaves of it in a finite average."""
    if exponents.shape[1] < 2:
        return np.zeros(len(exponents), bool)
    return (exponents[:, 1] + errors[:, 1]) * averaged * strobe_period < -2.0 * np.log(averaged)


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
        (period == 0) & ((largest - error) * averaged * strobe_period > 2.0 * np.log(averaged)) & ~regular,
        (period == 0) & (np.abs(largest) <= error) & (error * strobe_period <= _SMALL_ERROR) & regular,
    ]
    return np.select(conditions, [4, 0, 2, 1], default=3).astype(np.int8)


def price(options: VerdictOptions, scene: Scene) -> Price:
    """The map alone, for lanes that look chaotic: which, is not known before."""
    return Price(None, map_alone(scene), "not measured: the map alone, for lanes that look chaotic")


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
