"""Growth of tangents and of volume along the motion of a lane, whose averages are exponents.

The tangent flow is the exact derivative of the solver's own step. Tangents are orthonormalised by Gram–Schmidt
several times a period (Benettin and co-workers 1980), as often as the contraction needs. The divergence of
the flow is integrated by itself, by Gauss–Legendre quadrature, where it is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner, Link, keep_all
from jaxnh.analyses.exponents.gram_schmidt import gram_schmidt
from jaxnh.analyses.exponents.period_parts import one_part
from jaxnh.analyses.options.base import BLOCKS
from jaxnh.analyses.smooth_window import DEGREE, half_window_weights, moment_weights
from jaxnh.maps.batching import as_batched
from jaxnh.maps.build import maps_between
from jaxnh.maps.family import Maps, ParameterFamily
from jaxnh.maps.protocol import ReturnMap, Tangent
from jaxnh.maps.section import rates
from jaxnh.maps.single_precision import in_precision
from jaxnh.maps.step_grids import step_grid
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.piecewise_smooth import PiecewiseSmooth
from jaxnh.systems.state import LaneStates, State, Vector, is_finite

_PANEL_NODES, _PANEL_WEIGHTS = np.polynomial.legendre.leggauss(12)
_BETWEEN_NODES = SPLITTINGS["blanes_moan6"]
LARGEST_LOSS = 18.0
"""A tangent may shrink by e^−18 against another between orthonormalisations: eight digits are left."""

LARGEST_SEEN = 24.0
"""Beyond e^−24 a tangent drowns in the rounding of the others, and its growth is theirs."""

_AS_LOSS = LARGEST_LOSS / 300.0  # of a logarithm of growth: the square of e^354 is no number
_ITERATES = 8  # of a map, at most, that have one weight in the sums that tell a drift
_KICKS_A_NODE = 4  # of the map: its own error, a processed one's too, is larger than that of a step of ten kicks


class TangentState(NamedTuple):
    """State of a lane, orthonormal tangents in section coordinates, and sums of the logarithms of growth.

    Attributes:
        state: of the flow.
        tangents: k of d components each.
        logs: k sums of the logarithms of the tangents' growth; without a clock, that along the flow before them.
        volume: sum of the logarithms of the growth of volume.
        divergence: integral of the flow's divergence by quadrature, zero where it is not asked for.
        smooth: the sums of logs and volume, over periods under the weights of `moment_weights`, as tuples.
        loss: of each of `logs`, the largest logarithm by which its tangent shrank against the first in one part of a
            period since the tangents began; as much as `LARGEST_LOSS` where squares of tangents come near the ends of
            the range of numbers.
    """

    state: LaneStates
    tangents: tuple[Vector, ...]
    logs: tuple[Array, ...]
    volume: Array
    divergence: Array
    smooth: tuple[tuple[Array, ...], ...]
    loss: tuple[Array, ...]


class Quadrature(NamedTuple):
    """Gauss–Legendre quadrature over a period along the motion.

    Attributes:
        flow: whose divergence is integrated.
        maps: from the beginning of the period to the first node and from node to node, stacked.
        t, weights: of the nodes, (nodes,).
    """

    flow: Flow
    maps: ReturnMap
    t: np.ndarray
    weights: np.ndarray


def quadrature(batch: LaneBatch) -> Quadrature | ParameterFamily[Quadrature]:
    """Return nodes and maps of the quadrature; for a family one for each value."""
    if batch.family is not None:
        return batch.family.derive("quadrature", lambda system: _nodes(batch.with_system(system)))
    return _nodes(batch)


def _nodes(batch: LaneBatch) -> Quadrature:
    """Return nodes in panels of twelve, in number with the kicks of a period, denser where the flow is faster.

    Their states are those of another map, a step of order six from node to node, so that neither determinants nor
    errors of the map's own kicks are part of the result.
    """
    flow, kicks = batch.flow, batch.solver.total_kicks(batch.steps)
    panels, span = -(-kicks // (_KICKS_A_NODE * len(_PANEL_NODES))), (0.0, flow.period)
    edges = np.linspace(*span, panels + 1) if flow.autonomous else step_grid(flow, panels, span)
    half = 0.5 * np.diff(edges)
    t = (edges[:-1, None] + half[:, None] * (1.0 + _PANEL_NODES)).ravel()
    maps = maps_between(flow, _BETWEEN_NODES, 1, np.append(0.0, t), compensated=batch.compensated)
    return Quadrature(flow, in_precision(maps, batch.precision), t, (half[:, None] * _PANEL_WEIGHTS).ravel())


def average(
    lanes: LaneRunner, strobes: Maps, growth: TangentState, p: Parameters, count: int, first: float = 0.0
) -> tuple[TangentState, Float[np.ndarray, "lanes sums"]]:
    """Advance lanes by `count` periods; return growth a period of tangents, of volume, and of volume by quadrature.

    `first` is the share of the whole average that is over, for the smooth windows.
    """
    if not count:
        return growth, np.full((len(growth.volume), len(growth.logs) + 2), np.nan)
    [(growth, grown)] = averages_in_turn(lanes, strobes, growth, p, count, (first,))
    return growth, grown


def averages_in_turn(
    lanes: LaneRunner,
    strobes: Maps,
    growth: TangentState,
    p: Parameters,
    count: int,
    firsts: Sequence[float],
    quadrature: Quadrature | ParameterFamily[Quadrature] | None = None,
) -> list[tuple[TangentState, Float[np.ndarray, "lanes sums"]]]:
    """Advance lanes by `count` periods, a time for each of `firsts`; return after each what `average` does.

    Tangents and how fast they were lost stay on the device: only the last of these states has any.
    """
    strobes, parts = (strobes, 1) if quadrature else one_part(strobes)
    links = [
        Link(advance, (strobes, quadrature, np.int32(count * parts), np.float64(share)), (), count, _sums)
        for share in firsts
    ]
    links[-1] = links[-1]._replace(keep=keep_all)
    averages = []
    for after in lanes.chain(links, (growth, p)):
        grown = np.stack([*after.logs, after.volume, after.divergence], axis=-1) / count
        grown[~is_finite(after.state)] = np.nan  # lost lanes have tangents of length zero, whose logarithm is none
        averages.append((after, grown))
    return averages


def _sums(growth: TangentState) -> tuple[TangentState, TangentState]:
    """The whole state for the next periods, and its part that averages are made of."""
    return growth, growth._replace(tangents=(), loss=())


def advance_turns(
    lanes: LaneRunner, strobes: Maps, growth: TangentState, p: Parameters, counts: Int[np.ndarray, " lanes"], tile: int
) -> tuple[TangentState, Float[np.ndarray, "lanes k"]]:
    """Advance each lane by its own number of periods, and return the growth a period of each tangent."""
    growth = lanes(_advance_each, (strobes,), (growth, p, counts.astype(np.int32)), tile=tile)
    return growth, np.stack(growth.logs, axis=-1) / counts[:, None]


def _advance_each(strobes: ReturnMap, growth: TangentState, p: Parameters, count: Array) -> TangentState:
    return advance(strobes, None, count, None, growth, p)


def begin(flow: Flow, state: State, k: int) -> TangentState:
    """Return a lane at a state with k tangents."""
    zero = jnp.zeros_like(state[0][0])
    tangents = jax.tree.map(lambda component: zero + component, flow.chart.directions(k))
    sums = k + int(flow.autonomous)
    smooth = ((zero,) * (sums + 1),) * (DEGREE + 2)
    return TangentState(state, tangents, (zero,) * sums, zero, zero, smooth, (zero,) * sums)


def advance(
    strobes: ReturnMap,
    quadrature: Quadrature | None,
    count: ArrayLike,
    first: ArrayLike | None,
    growth: TangentState,
    p: Parameters,
) -> TangentState:
    """Advance one lane by `count` periods, its sums begun anew, without smooth ones where no share is `first`."""
    zeros = jax.tree.map(jnp.zeros_like, growth[2:])
    anew = TangentState(growth.state, growth.tangents, *as_batched(zeros, growth.state[0][0]))
    growth = anew._replace(loss=growth.loss)
    # Where the divergence is a derivative more, it serves the sum rule, and says where the map loses rank.
    system = strobes.system
    wanted = system.readout.contraction or len(growth.logs) == system.exponents or _loses_rank(system)

    def period(growth: TangentState) -> TangentState:
        after, _ = lax.scan(lambda growth, strobe: (_pushed(strobe, growth, p, wanted), None), growth, strobes)
        if quadrature is not None:
            after = after._replace(divergence=growth.divergence + _divergence(quadrature, growth.state, p))
        return after

    if first is None:
        return lax.fori_loop(0, count, lambda _, growth: period(growth), growth)

    def shares(i: Any, n: ArrayLike) -> Any:
        """The middle of stretch i of n in the whole average."""
        return first + (i + 0.5) / (jnp.float64(n) * BLOCKS)

    def weighted_period(i: Array, growth: TangentState) -> TangentState:
        weights = moment_weights(shares(jnp.float64(i), count))
        return _with_sums(growth, period(growth), dict(enumerate(weights)))

    if system.continuous:
        return lax.fori_loop(0, count, weighted_period, growth)
    # An iterate of a map costs less than all sums and weights: those of higher powers, which tell a drift, are of
    # several iterates at once, and weights are made for these together.
    together = jnp.gcd(jnp.int32(count), _ITERATES)

    def iterates(i: Array, growth: TangentState) -> TangentState:
        whole, half = half_window_weights(shares(jnp.float64(i * together) + jnp.arange(float(_ITERATES)), count))

        def iterate(j: Array, growth: TangentState) -> TangentState:
            return _with_sums(growth, period(growth), {0: whole[j], DEGREE + 1: half[j]})

        after = lax.fori_loop(0, together, iterate, growth)
        weights = moment_weights(shares(jnp.float64(i), count // together))
        return _with_sums(growth, after, {k: weights[k] for k in range(1, DEGREE + 1)})

    return lax.fori_loop(0, count // together, iterates, growth)


def _loses_rank(flow: Flow) -> bool:
    """Return whether different motions may become one in finite time, so that tangents vanish."""
    return isinstance(flow, PiecewiseSmooth) and flow.loses_rank


def _pushed(strobe: ReturnMap, growth: TangentState, p: Parameters, volume: bool) -> TangentState:
    """A state after one part of a period, its tangents orthonormal, their growth and that of volume in the sums."""
    flow: Flow = strobe.system
    lifted = tuple(Tangent(flow.chart.lift(growth.state, v)) for v in growth.tangents)
    pushed = strobe.pushforward(growth.state, p, lifted, volume)
    moved = [flow.chart.lower(pushed.state, t.state) for t in pushed.tangents]
    singular = jnp.isneginf(pushed.log_volume) if _loses_rank(flow) else None
    if flow.autonomous:
        tangents, grown = _orthonormalise_across(flow, growth.state, pushed.state, moved, p, singular)
    else:
        tangents, grown = gram_schmidt(moved, singular)
    logs = tuple(sum_ + g for sum_, g in zip(growth.logs, grown, strict=True))
    largest = jnp.maximum(grown[0], grown[1]) if flow.autonomous else grown[0]
    now = [jnp.maximum(largest - g, _AS_LOSS * jnp.maximum(jnp.abs(largest), jnp.abs(g))) for g in grown]
    if _loses_rank(flow):  # what has vanished needs no digits
        now = [jnp.where(jnp.isneginf(g), 0.0, lost) for g, lost in zip(grown, now, strict=True)]
    return growth._replace(
        state=pushed.state,
        tangents=tangents,
        logs=logs,
        volume=growth.volume + pushed.log_volume if volume else growth.volume,
        loss=tuple(map(jnp.maximum, growth.loss, now)),
    )


def _with_sums(before: TangentState, after: TangentState, weights: Mapping[int, Array]) -> TangentState:
    """A later state with what has grown in some of its smooth sums, by the weight of each."""
    grown = [new - old for new, old in zip((*after.logs, after.volume), (*before.logs, before.volume), strict=True)]
    smooth = list(after.smooth)
    for k, weight in weights.items():
        smooth[k] = tuple(sum_ + weight * g for sum_, g in zip(smooth[k], grown, strict=True))
    return after._replace(smooth=tuple(smooth))


def _divergence(quadrature: Quadrature, state: State, p: Parameters) -> Array:
    """Return ∫ divergence dt over the period that begins at a state."""
    flow = quadrature.flow

    def node(carry: tuple[State, Array], item: Any) -> tuple[tuple[State, Array], None]:
        strobe, t, weight = item
        state = strobe(carry[0], p)
        return (state, carry[1] + weight * flow.divergence(t, state, p)), None

    nodes = (quadrature.maps, jnp.asarray(quadrature.t), jnp.asarray(quadrature.weights))
    return lax.scan(node, (state, as_batched(jnp.zeros_like(state[0][0]), state[0][0])), nodes)[0][1]


def _orthonormalise_across(
    flow: Flow, before: State, after: State, moved: Sequence[Vector], p: Parameters, singular: Array | None
) -> tuple[tuple[Vector, ...], tuple[Array, ...]]:
    """Return orthonormal tangents across the flow, and the growth of the flow's direction and of each of them."""

    def direction(state: State) -> Vector:
        return rates(flow, state, p)

    (_, *tangents), (along, *grown) = gram_schmidt([direction(after), *moved], singular)
    lengthened = along - gram_schmidt([direction(before)])[1][0]
    if singular is not None:  # at rest the flow has no direction
        lengthened = jnp.where(jnp.isneginf(along), along, lengthened)
    return tuple(tangents), (lengthened, *grown)
