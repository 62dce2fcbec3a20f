"""Lyapunov spectrum of the flow, with error bars and exact checks.

The tangent flow is the exact derivative of the solver's own step. Tangents are orthonormalised by a written-out
Gram–Schmidt several times a period (Benettin and co-workers 1980), as often as the contraction needs.

Without a clock the flow carries its own direction along, whose exponent is zero unless the motion comes to rest: the
tangents are those across it, one fewer, and no section is needed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int
from pydantic import Field

from jaxnh.analyses.base import (
    LANE,
    Analysis,
    LaneRunner,
    OptionError,
    Options,
    Price,
    Program,
    Scene,
    Setting,
    counted_in,
    map_alone,
    picked,
    variable,
)
from jaxnh.maps.build import cut_strobe
from jaxnh.maps.iterate import iterate
from jaxnh.maps.protocol import Strobe, Tangent
from jaxnh.maps.single_precision import in_precision
from jaxnh.systems.flow import Flow, Parameters, State, Vector

_BLOCKS = 16
_LARGEST_LOSS = 18.0  # a tangent may shrink by e^−18 against another between orthonormalisations: eight digits are left
_LARGEST_SEEN = 24.0  # beyond that a loss drowns in rounding
_MOST_PARTS = 1024
_PILOT_LANES, _PILOT_PARTS, _PILOT_PERIODS = 64, 16, 4
_ALIGNING = 8  # of this many parts of the transient, the last also turns the tangents into place
_WINDOWS = (1.0, 2.0)  # powers of the two windows of `window`; their difference is the error of the smooth average
_AT_REST = -7.0  # of the logarithm of a flow's speed, over the whole average: the motion is coming to rest
_ROUNDING = 1e-10  # of a smooth average a period
_PRICED_PARTS = 4  # orthonormalisations a period in the program that is priced


class LyapunovOptions(Options):
    """Options of `lyapunov`."""

    transient: int = Field(default=256, ge=0, description="Periods before the average begins")
    periods: int = Field(default=1024, ge=_BLOCKS, description="Periods averaged over, at most")
    error: float = Field(default=0.0, ge=0.0, description="Stop a lane whose error bars are below this; 0: never")
    exponents: int = Field(default=3, ge=1, description="How many of the largest exponents are wanted")


class Growth(NamedTuple):
    """A lane on its way: state, orthonormal tangents in section coordinates, and logarithms of growth summed so far.

    Attributes:
        state: of the flow.
        tangents: k of d components each.
        logs: k sums of the logarithms of the tangents' growth; without a clock, that along the flow before them.
        volume: sum of the logarithms of the growth of volume.
        smooth: the same sums, of volume the last, over periods under two smooth windows, as tuples.
        loss: largest logarithm by which the last tangent shrank against the first in one part of a period.
    """

    state: State
    tangents: tuple[Vector, ...]
    logs: tuple[Array, ...]
    volume: Array
    smooth: tuple[tuple[Array, ...], ...]
    loss: Array


def periods(options: LyapunovOptions, lanes: int) -> float:
    """Lane-periods of a run; each costs one and about two more for every tangent."""
    return float(lanes * (options.transient + options.periods * (1 + 2 * options.exponents)))


def check(options: LyapunovOptions, setting: Setting) -> None:
    """See that no more exponents are named than there are; the default is cut down to them."""
    most = setting.flow.exponents
    if "exponents" in options.model_fields_set and options.exponents > most:
        raise OptionError(f"must be at most {most}, not {options.exponents}", "exponents")


def choose(options: LyapunovOptions, scene: Scene, lanes: LaneRunner) -> dict[str, int]:
    """How many times a period tangents are orthonormalised, the same for all lanes of a sweep."""
    scene = scene.in_time()
    return {"parts": _parts_needed(scene, lanes, tangents(options, scene))}


def run(options: LyapunovOptions, scene: Scene, lanes: LaneRunner) -> xr.Dataset:
    """The `exponents` largest exponents of every lane, their errors, and the sum rule where all are found."""
    scene = scene.in_time()
    count, k, lead = scene.count, tangents(options, scene), int(scene.flow.autonomous)
    parts = (scene.chosen.get("lyapunov") or choose(options, scene, lanes))["parts"]
    strobes = parts_of(scene, parts)
    aligning = options.transient // _ALIGNING
    settling = options.transient - aligning
    block = options.periods // _BLOCKS
    _, p = scene.lanes
    with lanes.stage(f"lyapunov: transient of {count} lanes", count * options.transient):
        state = lanes(iterate, (scene.strobe(), np.int32(settling)), scene.lanes, periods=settling)
        growth = lanes(begin, (scene.system,), (state,), static=(k,))
        growth = _average(lanes, strobes, growth, p, aligning)[0]
    sums = lead + k + 1
    rates = np.full((count, _BLOCKS, sums), np.nan)
    smooth = np.zeros((count, 2, sums))
    done = np.zeros(count, int)
    running = np.arange(count)
    with lanes.stage(f"lyapunov: averages of {count} lanes", count * options.periods):
        for i in range(_BLOCKS):
            part, part_p = picked((growth, p), running)
            part, rates[running, i] = _average(lanes, strobes, part, part_p, block, i / _BLOCKS)
            smooth[running] += _smooth_part(part, block)
            for whole, moved in zip(jax.tree.leaves(growth), jax.tree.leaves(part), strict=True):
                whole[running] = moved
            done[running] += 1
            if options.error and i + 1 >= _BLOCKS // 4:
                _, error = _statistics(rates[running, : i + 1])
                running = running[~(np.max(error[:, lead:-1], axis=1) < options.error)]
            if not len(running):
                break
    period = scene.system.period
    mean, error = np.empty((count, sums)), np.empty((count, sums))
    for blocks in np.unique(done):
        chosen = done == blocks
        mean[chosen], error[chosen] = _statistics(rates[chosen, :blocks])
    regular = (mean[:, lead] - error[:, lead] <= 0.0) & (done == _BLOCKS)
    mean[regular] = smooth[regular, 0]
    error[regular] = np.abs(smooth[regular, 0] - smooth[regular, 1]) + _ROUNDING
    return _dataset(scene, mean / period, error / period, done * block, parts, min(options.exponents, lead + k))


def tangents(options: LyapunovOptions, scene: Scene) -> int:
    """How many tangents are carried: one for each exponent that is wanted and not known."""
    return min(options.exponents, scene.flow.exponents - int(scene.flow.autonomous))


def parts_of(scene: Scene, parts: int) -> Strobe:
    """The maps between orthonormalisations, so many a period, stacked."""
    strobe = cut_strobe(scene.flow, scene.solver, scene.steps, parts, compensated=scene.compensated)
    return in_precision(strobe, scene.precision)


def _parts_needed(scene: Scene, lanes: LaneRunner, k: int) -> int:
    """Orthonormalisations a period, a power of two, so that no tangent is lost in another between them.

    Measured on lanes across the sweep: what one sixteenth of a period does to the spread of the tangents, at most,
    bounds what a longer part does; where that is all that rounding lets one see, a smaller part is looked at.
    """
    if k == 1:
        return 1
    few = scene.take(np.unique(np.linspace(0, scene.count - 1, _PILOT_LANES).round().astype(int)))
    parts = _PILOT_PARTS
    while True:
        state, p = few.lanes
        growth = lanes(begin, (scene.system,), (state,), static=(k,))
        growth, _ = _average(lanes, parts_of(scene, parts), growth, p, _PILOT_PERIODS)
        loss = float(np.max(growth.loss, initial=0.0, where=np.isfinite(growth.loss)))
        if loss < _LARGEST_SEEN or parts == _MOST_PARTS:
            break
        parts *= 4
    return int(np.clip(2 ** math.ceil(math.log2(max(parts * loss / _LARGEST_LOSS, 1.0))), 1, _MOST_PARTS))


def _average(
    lanes: LaneRunner, strobes: Strobe, growth: Growth, p: Parameters, count: int, begun: float = 0.0
) -> tuple[Growth, Float[np.ndarray, "lanes sums"]]:
    """Lanes `count` periods on, and growth a period of each tangent and of volume.

    `begun` is the share of the whole average that is over, for the smooth windows.
    """
    if not count:
        return growth, np.full((len(growth.volume), len(growth.logs) + 1), np.nan)
    growth = lanes(advance, (strobes, np.int32(count), np.float64(begun)), (growth, p), periods=count)
    return growth, np.stack([*growth.logs, growth.volume], axis=-1) / count


def begin(system: Flow, state: State, k: int) -> Growth:
    """A lane at a state with k tangents."""
    zero = jnp.zeros_like(state[0][0])
    tangents = jax.tree.map(lambda component: zero + component, system.directions(k))
    sums = k + int(system.autonomous)
    return Growth(state, tangents, (zero,) * sums, zero, ((zero,) * (sums + 1),) * 2, zero)


def advance(strobes: Strobe, count: ArrayLike, begun: ArrayLike, growth: Growth, p: Parameters) -> Growth:
    """One lane `count` periods on, its sums begun anew."""
    growth = Growth(growth.state, growth.tangents, *jax.tree.map(jnp.zeros_like, growth[2:]))
    # Where the divergence is a derivative more, it serves the sum rule alone.
    wanted = strobes.system.contraction or len(growth.logs) == strobes.system.exponents

    def part(growth: Growth, strobe: Strobe) -> tuple[Growth, None]:
        system = strobe.system
        pushed = strobe.push(growth.state, p, tuple(Tangent(system.lift(growth.state, v)) for v in growth.tangents))
        moved = [system.lower(pushed.state, t.state) for t in pushed.tangents]
        if system.autonomous:
            tangents, grown = _across(system, growth.state, pushed.state, moved, p)
        else:
            tangents, grown = gram_schmidt(moved)
        logs = tuple(sum_ + g for sum_, g in zip(growth.logs, grown, strict=True))
        largest = jnp.maximum(grown[0], grown[1]) if system.autonomous else grown[0]
        loss = jnp.maximum(growth.loss, largest - grown[-1])
        volume = growth.volume + jnp.log(pushed.volume) if wanted else growth.volume
        return Growth(pushed.state, tangents, logs, volume, growth.smooth, loss), None

    def period(i: Array, growth: Growth) -> Growth:
        after, _ = lax.scan(part, growth, strobes)
        grown = [new - old for new, old in zip((*after.logs, after.volume), (*growth.logs, growth.volume), strict=True)]
        at = begun + (jnp.float64(i) + 0.5) / (jnp.float64(count) * _BLOCKS)
        smooth = tuple(
            tuple(sum_ + window(at, power) * g for sum_, g in zip(sums, grown, strict=True))
            for power, sums in zip(_WINDOWS, growth.smooth, strict=True)
        )
        return after._replace(smooth=smooth)

    return lax.fori_loop(0, count, period, growth)


def _across(
    system: Flow, before: State, after: State, moved: Sequence[Vector], p: Parameters
) -> tuple[tuple[Vector, ...], tuple[Array, ...]]:
    """Orthonormal tangents across the flow, and the growth of the flow's own direction, then of each of them."""

    def direction(state: State) -> Vector:
        return system.lower(state, system.rhs(jnp.zeros_like(state[0][0]), state, p))

    (_, *tangents), (along, *grown) = gram_schmidt([direction(after), *moved])
    return tuple(tangents), (along - gram_schmidt([direction(before)])[1][0], *grown)


def window(at: Any, power: float) -> Any:
    """Weight exp(−1/(x(1−x))^p) of a smooth average at x in (0, 1) (Das and co-workers, Nonlinearity 30 (2017) 4111).

    On periodic and quasiperiodic motion such an average converges faster than any power of its length, where a plain
    one does so like its inverse: rotating tangents (complex multipliers) do no harm.
    """
    xp = np if isinstance(at, np.ndarray) else jnp
    return xp.exp(-((at * (1.0 - at)) ** -power))


def _smooth_part(growth: Growth, block: int) -> Float[np.ndarray, "lanes 2 sums"]:
    """What one block adds to the two smooth averages a period."""
    points = (np.arange(block * _BLOCKS) + 0.5) / (block * _BLOCKS)
    sums = [np.stack(sums, axis=-1) / window(points, p).sum() for p, sums in zip(_WINDOWS, growth.smooth, strict=True)]
    return np.stack(sums, axis=1)


def gram_schmidt(vectors: Sequence[Vector]) -> tuple[tuple[Vector, ...], tuple[Array, ...]]:
    """Orthonormal vectors that span the same, and the logarithms of the lengths they had, components of any shape."""
    orthonormal: list[Vector] = []
    logs = []
    for vector in vectors:
        for base in orthonormal:
            overlap = sum(v * e for v, e in zip(vector, base, strict=True))
            vector = tuple(v - overlap * e for v, e in zip(vector, base, strict=True))
        square = sum(v * v for v in vector)
        inverse = 1.0 / jnp.sqrt(square)
        orthonormal.append(tuple(v * inverse for v in vector))
        logs.append(0.5 * jnp.log(square))
    return tuple(orthonormal), tuple(logs)


def _statistics(
    rates: Float[np.ndarray, "lanes blocks sums"],
) -> tuple[Float[np.ndarray, "lanes sums"], Float[np.ndarray, "lanes sums"]]:
    """Mean over blocks and its error: of block averages, plus half of the drift between halves."""
    blocks = rates.shape[1]
    mean = rates.mean(axis=1)
    scatter = rates.std(axis=1, ddof=1) / math.sqrt(blocks)
    half = blocks // 2
    drift = 0.5 * np.abs(rates[:, :half].mean(axis=1) - rates[:, half : 2 * half].mean(axis=1))
    return mean, 2.0 * scatter + drift


def _dataset(
    scene: Scene,
    mean: Float[np.ndarray, "lanes sums"],
    error: Float[np.ndarray, "lanes sums"],
    averaged: Int[np.ndarray, " lanes"],
    parts: int,
    wanted: int,
) -> xr.Dataset:
    """Sums of the last column are those of volume, of the first without a clock those along the flow."""
    k = mean.shape[1] - 1
    found, spread = mean[:, :k].copy(), error[:, :k].copy()
    attrs: dict[str, Any] = {"orthonormalisations_per_period": parts}
    if scene.flow.autonomous:
        rests = mean[:, 0] * averaged * scene.flow.period < _AT_REST
        found[:, 0], spread[:, 0] = np.where(rests, found[:, 0], 0.0), np.where(rests, spread[:, 0], 0.0)
        lost = ~np.isfinite(mean[:, 0])
        found[lost, 0] = np.nan
        attrs["along_flow"] = "the exponent along the flow is known to be zero"
    attrs |= {
        "panel": "curves",
        "panel_variables": "exponents",
        "panel_label": "largest Lyapunov exponent" if wanted == 1 else "Lyapunov exponents",
    }
    order = np.argsort(-found, axis=1)[:, :wanted]
    exponents, errors = np.take_along_axis(found, order, axis=1), np.take_along_axis(spread, order, axis=1)
    each, unit = (LANE, "exponent"), "1/time"
    words = "Lyapunov exponents, natural logarithm"
    variables = {
        "exponent": variable("exponent", np.arange(1, wanted + 1), "number of the exponent, largest first"),
        "exponents": variable(each, exponents, words, unit, ancillary_variables="exponents_error"),
        "exponents_error": variable(each, errors, "error of the exponents: two standard errors", unit),
    }
    divergence = ""
    if symbols := scene.flow.contraction:
        divergence, words = f" −{symbols}", f"exponent off the constraint, −2{symbols}"
        variables["transverse"] = variable(LANE, 2.0 * mean[:, k], words, unit)
    variables["averaged"] = variable(LANE, averaged, "length of the average", counted_in(scene.system))
    if wanted == scene.flow.exponents:
        residual = np.take_along_axis(mean[:, :k], order, axis=1).sum(axis=1) - mean[:, k]
        words = f"sum of the exponents minus the mean divergence{divergence}"
        variables["sum_rule_residual"] = variable(LANE, residual, words, unit)
        # Without a clock the exponent along the flow counts as well.
        of = "of the flow" if scene.flow.autonomous else "of the Poincaré section"
        variables["kaplan_yorke"] = variable(LANE, kaplan_yorke(exponents), f"Kaplan–Yorke dimension {of}")
    return xr.Dataset(variables, attrs=attrs)


def kaplan_yorke(exponents: Float[np.ndarray, "lanes k"]) -> Float[np.ndarray, " lanes"]:
    """Kaplan–Yorke dimension of descending exponents; k where their sum is not negative."""
    total = np.cumsum(exponents, axis=1)
    lanes, k = exponents.shape
    whole = np.sum(total >= 0.0, axis=1)
    before = np.where(whole > 0, total[np.arange(lanes), np.maximum(whole, 1) - 1], 0.0)
    following = np.abs(exponents[np.arange(lanes), np.minimum(whole, k - 1)])
    return np.where(whole == k, float(k), whole + before / following)


def program(scene: Scene, k: int, parts: int = _PRICED_PARTS) -> Program:
    """A period of k tangents, orthonormalised so many times; of none the map alone."""
    scene = scene.in_time()
    if not k:
        return map_alone(scene)
    state, p = scene.lanes
    state = jax.tree.map(jnp.asarray, state)
    begun = jax.vmap(lambda z: begin(scene.flow, z, k))(state)
    strobes = parts_of(scene, parts)
    shared = (strobes, np.int32(1), np.float64(0.0))
    return Program(advance, shared, (jax.tree.map(np.asarray, begun), p), (1.0, float(parts), *strobes.turns))


def price(options: LyapunovOptions, scene: Scene) -> Price:
    """All tangents against the map alone."""
    k = tangents(options, scene)
    return Price(program(scene, k), program(scene, 0), f"{k} tangent{'s' if k > 1 else ''}")


ANALYSIS = Analysis(
    "lyapunov",
    LyapunovOptions,
    periods,
    run,
    in_time=True,
    choose=choose,
    check=check,
    price=price,
    brief={"transient": 1, "periods": _BLOCKS},
)
"""The entry of this analysis in the table."""
