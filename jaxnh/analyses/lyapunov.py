"""Lyapunov spectrum of the flow, with error bars and exact checks.

The tangent flow is the exact derivative of the solver's own step. Tangents are orthonormalised by a written-out
Gram–Schmidt several times a period (Benettin and co-workers 1980), as often as the contraction needs.

Without a clock the flow carries its own direction along, whose exponent is zero unless the motion comes to rest: the
tangents are those across it, one fewer, and no section is needed.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array
from pydantic import Field

from jaxnh.analyses.base import Group, LaneRunner, Options, Scene, Variable
from jaxnh.maps.build import cut_strobe
from jaxnh.maps.iterate import iterate
from jaxnh.maps.protocol import Strobe, Tangent
from jaxnh.maps.section import Flow as FlowSystem
from jaxnh.maps.single_precision import in_precision
from jaxnh.systems.particle import IsokineticParticle, State, Vector

_BLOCKS = 16
_LARGEST_LOSS = 18.0  # a tangent may shrink by e^−18 against another between orthonormalisations: eight digits are left
_LARGEST_SEEN = 24.0  # beyond that a loss drowns in rounding
_MOST_PARTS = 1024
_PILOT_LANES, _PILOT_PARTS, _PILOT_PERIODS = 64, 16, 4
_ALIGNING = 8  # of this many parts of the transient, the last also turns the tangents into place
_WINDOWS = (1.0, 2.0)  # powers of the two windows of `window`; their difference is the error of the smooth average
_AT_REST = -7.0  # of the logarithm of a flow's speed, over the whole average: the motion is coming to rest
_ROUNDING = 1e-10  # of a smooth average a period


class LyapunovOptions(Options):
    """Options of `lyapunov`."""

    transient: int = Field(default=256, ge=0, description="Periods before the average begins")
    periods: int = Field(default=1024, ge=_BLOCKS, description="Periods averaged over, at most")
    error: float = Field(default=0.0, ge=0.0, description="Stop a lane whose error bars are below this; 0: never")
    exponents: int = Field(default=3, ge=1, description="How many of the largest exponents are wanted")


class Flow(NamedTuple):
    """A lane on its way: state, orthonormal tangents in section coordinates, and logarithms summed so far.

    Attributes:
        state: (q, n).
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


def choose(options: LyapunovOptions, scene: Scene, lanes: LaneRunner) -> dict[str, int]:
    """How many times a period tangents are orthonormalised, the same for all lanes of a sweep."""
    scene = scene.in_time()
    return {"parts": _parts_needed(scene, lanes, _tangents(options, scene))}


def run(options: LyapunovOptions, scene: Scene, lanes: LaneRunner) -> Group:
    """The `exponents` largest exponents of every lane, their errors, and the sum rule where there are three."""
    scene = scene.in_time()
    count, k, lead = len(scene.values), _tangents(options, scene), int(scene.flow.autonomous)
    parts = (scene.chosen.get("lyapunov") or choose(options, scene, lanes))["parts"]
    strobes = parts_of(scene, parts)
    aligning = options.transient // _ALIGNING
    settling = options.transient - aligning
    block = options.periods // _BLOCKS
    with lanes.stage(f"lyapunov: transient of {count} values", count * options.transient):
        state = jax.tree.map(lambda leaf: np.full(count, leaf, float), scene.start)
        state = lanes(iterate, (scene.strobe(), np.int32(settling)), (state, scene.values), periods=settling)
        flow = lanes(begin, (scene.system,), (state,), static=(k,))
        flow = _average(lanes, strobes, flow, scene.values, aligning)[0]
    sums = lead + k + 1
    rates = np.full((count, _BLOCKS, sums), np.nan)
    smooth = np.zeros((count, 2, sums))
    done = np.zeros(count, int)
    running = np.arange(count)
    with lanes.stage(f"lyapunov: averages of {count} values", count * options.periods):
        for i in range(_BLOCKS):
            part = jax.tree.map(lambda leaf, running=running: leaf[running], flow)
            part, rates[running, i] = _average(lanes, strobes, part, scene.values[running], block, i / _BLOCKS)
            smooth[running] += _smooth_part(part, block)
            for whole, moved in zip(jax.tree.leaves(flow), jax.tree.leaves(part), strict=True):
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
    return _group(scene, mean / period, error / period, done * block, parts, min(options.exponents, lead + k))


def _tangents(options: LyapunovOptions, scene: Scene) -> int:
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
    picked = scene.values[np.unique(np.linspace(0, len(scene.values) - 1, _PILOT_LANES).round().astype(int))]
    state = jax.tree.map(lambda leaf: np.full(len(picked), leaf, float), scene.start)
    parts = _PILOT_PARTS
    while True:
        flow = lanes(begin, (scene.system,), (state,), static=(k,))
        flow, _ = _average(lanes, parts_of(scene, parts), flow, picked, _PILOT_PERIODS)
        loss = float(np.max(flow.loss, initial=0.0, where=np.isfinite(flow.loss)))
        if loss < _LARGEST_SEEN or parts == _MOST_PARTS:
            break
        parts *= 4
    return int(np.clip(2 ** math.ceil(math.log2(max(parts * loss / _LARGEST_LOSS, 1.0))), 1, _MOST_PARTS))


def _average(
    lanes: LaneRunner, strobes: Strobe, flow: Flow, b: np.ndarray, count: int, begun: float = 0.0
) -> tuple[Flow, np.ndarray]:
    """Lanes `count` periods on, and growth a period of each tangent and of volume, (lanes, k + 1).

    `begun` is the share of the whole average that is over, for the smooth windows.
    """
    if not count:
        return flow, np.full((len(b), len(flow.logs) + 1), np.nan)
    flow = lanes(advance, (strobes, np.int32(count), np.float64(begun)), (flow, b), periods=count)
    return flow, np.stack([*flow.logs, flow.volume], axis=-1) / count


def begin(system: FlowSystem, state: State, k: int) -> Flow:
    """A lane at a state with k tangents."""
    zero = jnp.zeros_like(state[0][0])
    tangents = jax.tree.map(lambda component: zero + component, system.directions(k))
    sums = k + int(system.autonomous)
    return Flow(state, tangents, (zero,) * sums, zero, ((zero,) * (sums + 1),) * 2, zero)


def advance(strobes: Strobe, count: Any, begun: Any, flow: Flow, b: Any) -> Flow:
    """One lane `count` periods on, its sums begun anew."""
    flow = Flow(flow.state, flow.tangents, *jax.tree.map(jnp.zeros_like, flow[2:]))
    # Of T, Q and f the divergence is a derivative more, and serves the sum rule alone.
    wanted = isinstance(strobes.system, IsokineticParticle) or len(flow.logs) == strobes.system.exponents

    def part(flow: Flow, strobe: Strobe) -> tuple[Flow, None]:
        system = strobe.system
        pushed = strobe.push(flow.state, b, tuple(Tangent(system.lift(flow.state, v)) for v in flow.tangents))
        moved = [system.lower(pushed.state, t.state) for t in pushed.tangents]
        if system.autonomous:
            tangents, grown = _across(system, flow.state, pushed.state, moved, b)
        else:
            tangents, grown = gram_schmidt(moved)
        logs = tuple(sum_ + g for sum_, g in zip(flow.logs, grown, strict=True))
        largest = jnp.maximum(grown[0], grown[1]) if system.autonomous else grown[0]
        loss = jnp.maximum(flow.loss, largest - grown[-1])
        volume = flow.volume + jnp.log(pushed.volume) if wanted else flow.volume
        return Flow(pushed.state, tangents, logs, volume, flow.smooth, loss), None

    def period(i: Array, flow: Flow) -> Flow:
        after, _ = lax.scan(part, flow, strobes)
        grown = [new - old for new, old in zip((*after.logs, after.volume), (*flow.logs, flow.volume), strict=True)]
        at = begun + (jnp.float64(i) + 0.5) / (jnp.float64(count) * _BLOCKS)
        smooth = tuple(
            tuple(sum_ + window(at, power) * g for sum_, g in zip(sums, grown, strict=True))
            for power, sums in zip(_WINDOWS, flow.smooth, strict=True)
        )
        return after._replace(smooth=smooth)

    return lax.fori_loop(0, count, period, flow)


def _across(
    system: FlowSystem, before: Any, after: Any, moved: list[Vector], b: Any
) -> tuple[tuple[Vector, ...], tuple[Array, ...]]:
    """Orthonormal tangents across the flow, and the growth of the flow's own direction, then of each of them."""

    def direction(state: Any) -> Vector:
        return system.lower(state, system.vector_field(jnp.zeros_like(state[0][0]), state, b))  # pyright: ignore[reportArgumentType]

    (_, *tangents), (along, *grown) = gram_schmidt([direction(after), *moved])
    return tuple(tangents), (along - gram_schmidt([direction(before)])[1][0], *grown)


def window(at: Any, power: float) -> Any:
    """Weight exp(−1/(x(1−x))^p) of a smooth average at x in (0, 1) (Das and co-workers, Nonlinearity 30 (2017) 4111).

    On periodic and quasiperiodic motion such an average converges faster than any power of its length, where a plain
    one does so like its inverse: rotating tangents (complex multipliers) do no harm.
    """
    xp = np if isinstance(at, np.ndarray) else jnp
    return xp.exp(-((at * (1.0 - at)) ** -power))


def _smooth_part(flow: Flow, block: int) -> np.ndarray:
    """What one block adds to the two smooth averages a period, (lanes, 2, k + 1)."""
    points = (np.arange(block * _BLOCKS) + 0.5) / (block * _BLOCKS)
    sums = [np.stack(sums, axis=-1) / window(points, p).sum() for p, sums in zip(_WINDOWS, flow.smooth, strict=True)]
    return np.stack(sums, axis=1)


def gram_schmidt(vectors: list[Vector]) -> tuple[tuple[Vector, ...], tuple[Array, ...]]:
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


def _statistics(rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean over blocks (lanes, blocks, ...) and its error: of block averages, plus half of the drift between halves."""
    blocks = rates.shape[1]
    mean = rates.mean(axis=1)
    scatter = rates.std(axis=1, ddof=1) / math.sqrt(blocks)
    half = blocks // 2
    drift = 0.5 * np.abs(rates[:, :half].mean(axis=1) - rates[:, half : 2 * half].mean(axis=1))
    return mean, 2.0 * scatter + drift


def _group(scene: Scene, mean: np.ndarray, error: np.ndarray, averaged: np.ndarray, parts: int, wanted: int) -> Group:
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
    order = np.argsort(-found, axis=1)[:, :wanted]
    exponents, errors = np.take_along_axis(found, order, axis=1), np.take_along_axis(spread, order, axis=1)
    unit = "1/time"
    variables = {
        "b": Variable(("b",), scene.values, scene.system.sweeps),
        "exponent": Variable(("exponent",), np.arange(1, wanted + 1), "number of the exponent, largest first"),
        "exponents": Variable(("b", "exponent"), exponents, "Lyapunov exponents, natural logarithm", unit),
        "exponents_error": Variable(("b", "exponent"), errors, "error of the exponents: two standard errors", unit),
    }
    divergence = ""
    if isinstance(scene.flow, IsokineticParticle):  # a field of T, Q and f keeps f off the constraint as well
        divergence = " −⟨n·F⟩/s"
        variables["transverse"] = Variable(("b",), 2.0 * mean[:, k], "exponent off the constraint, −2⟨n·F⟩/s", unit)
    variables["averaged"] = Variable(("b",), averaged, "periods averaged over", "forcing periods")
    if wanted == scene.flow.exponents:
        residual = np.take_along_axis(mean[:, :k], order, axis=1).sum(axis=1) - mean[:, k]
        variables["sum_rule_residual"] = Variable(
            ("b",), residual, f"sum of the exponents minus the mean divergence{divergence}", unit
        )
        variables["kaplan_yorke"] = Variable(
            ("b",), kaplan_yorke(exponents), "Kaplan–Yorke dimension of the Poincaré section"
        )
    return Group(variables, attrs)


def kaplan_yorke(exponents: np.ndarray) -> np.ndarray:
    """Kaplan–Yorke dimension of descending exponents (lanes, k); k where their sum is not negative."""
    total = np.cumsum(exponents, axis=1)
    lanes, k = exponents.shape
    whole = np.sum(total >= 0.0, axis=1)
    before = np.where(whole > 0, total[np.arange(lanes), np.maximum(whole, 1) - 1], 0.0)
    following = np.abs(exponents[np.arange(lanes), np.minimum(whole, k - 1)])
    return np.where(whole == k, float(k), whole + before / following)
