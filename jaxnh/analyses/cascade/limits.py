"""Limits of sequences of a cascade, with intervals that cover them: δ and b∞ of doublings, α of widths of orbits.

Renormalisation (Feigenbaum, J. Stat. Phys. 21 (1979) 669) makes both geometric, up to corrections that are so too,

    b_k = b∞ + A δ⁻ᵏ (1 + Σ B_j ρ_jᵏ),      w_k = A α⁻ᵏ (1 + Σ B_j ρ_jᵏ).

Some ρ follow from the ratio itself: a system is a smooth function of its parameter, which gives ρ = 1/δ, and widths are
measured in some smooth coordinate, which gives −1/α and its powers. Others belong to directions in which the operator
contracts, as −0.1237 for quadratic maxima (Christiansen, Cvitanović, Rugh, J. Phys. A 23 (1990) L713); here nothing is
known of them but that they are small. So these are any numbers up to a bound, and all amplitudes are random, of a size
that the sequence itself tells: a Gaussian process. No value of δ or α is put in.

With any other parameter q of the system b∞, A and B_j move, while δ and ρ_j are those of all maps: derivatives

    ∂b_k/∂q = ∂b∞/∂q + δ⁻ᵏ (∂A/∂q + Σ ∂(A B_j)/∂q ρ_jᵏ)

are another such sequence, of ratios that the doublings themselves tell. Host code.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

_SIZES = np.geomspace(0.003, 10.0, 9)  # of amplitudes B; each as likely as the others
_LEAST_RATIO = 1.05
_NODES = 61  # of a grid of ratios
_NEGLIGIBLE = 14.0  # below the largest logarithm of the density
_FINE = 3  # the grid is fine enough where a third of it is not negligible
_TAIL = 0.005  # of the probability, beyond either end of an interval: sequences are not quite as the model has them
_WIDE = 2.6  # standard deviations, which are as rare
_NUGGET = 1e-14  # of variances: keeps correlations of nearly one positive definite in rounding
_SEEN = 10.0  # errors: a step must be so large to count


class Limit(NamedTuple):
    """Limit of a sequence; NaN where it is too short to tell.

    Attributes:
        ratio, ratio_error: of successive distances, or widths, in the limit.
        value, error: of the sequence itself.
    """

    ratio: float
    ratio_error: float
    value: float
    error: float


class _Kind(NamedTuple):
    """Prior knowledge of a sequence.

    Attributes:
        tied: ratios of corrections that follow from r = 1/δ or 1/α, (ratios,) each.
        bounds: of the other ratios, each as likely as the others, (bounds,).
        reach: of the logarithm of the ratio, about that of the last levels.
        constant: whether the limit is unknown; else it is zero.
        last: whether the last step tells A, or else that which tells of the largest one.
    """

    tied: Callable[[np.ndarray], tuple[np.ndarray, ...]]
    bounds: Float[np.ndarray, " bounds"]
    reach: float
    constant: bool
    last: bool = True


# A cascade may begin where it is nearly of another kind, as at a flatter extremum: corrections then fall slowly.
_DOUBLINGS = _Kind(lambda r: (r,), np.array([0.1, 0.2, 0.4, 0.8]), 0.6, constant=True)
# A derivative of A may be anything, zero too: what corrections change by is then all that there is in its last step.
_RATES = _DOUBLINGS._replace(last=False)
_WIDTHS = _Kind(lambda r: (-r, r * r), np.array([0.1, 0.2, 0.4]), 0.25, constant=False)


class _Posterior(NamedTuple):
    """Posterior over a grid of ratios, under one model of the corrections: (ratios,) each.

    Attributes:
        density: logarithm, up to a constant that all models have.
        value, variance: of the limit of the sequence.
    """

    density: Float[np.ndarray, " ratios"]
    value: Float[np.ndarray, " ratios"]
    variance: Float[np.ndarray, " ratios"]


class _Nodes(NamedTuple):
    """All models of a sequence at nodes of ratios, in the order of these: (nodes,) each.

    Attributes:
        ratio: δ or α.
        weight: probability.
        bound: of the model's other ratios.
        value, variance: of the limit of the sequence.
    """

    ratio: Float[np.ndarray, " nodes"]
    weight: Float[np.ndarray, " nodes"]
    bound: Float[np.ndarray, " nodes"]
    value: Float[np.ndarray, " nodes"]
    variance: Float[np.ndarray, " nodes"]


_UNKNOWN = Limit(np.nan, np.nan, np.nan, np.nan)


def doublings_limit(values: Float[np.ndarray, " levels"], errors: Float[np.ndarray, " levels"]) -> Limit:
    """δ and b∞ of successive doublings, of four or more.

    Args:
        values: of the parameter.
        errors: of them, that differ from level to level: rounding. What all share, or what is a smooth function of the
            parameter, as the error of a map, changes b∞ but not δ, which all maps have.
    """
    levels = _levels_seen(values, errors)
    if levels < 4:
        return _UNKNOWN
    limit = _limit(_doublings_nodes(values[:levels], errors[:levels]))
    return limit._replace(value=float(values[levels - 1] + limit.value))


def limit_rates(
    values: Float[np.ndarray, " levels"],
    errors: Float[np.ndarray, " levels"],
    rates: Float[np.ndarray, "levels parameters"],
    rate_errors: Float[np.ndarray, "levels parameters"],
) -> tuple[Float[np.ndarray, " parameters"], Float[np.ndarray, " parameters"]]:
    """Derivatives of b∞ in other parameters, and their errors, of four doublings or more; else not a number.

    Args:
        values, errors: as of `doublings_limit`.
        rates, rate_errors: derivatives of the doublings, and their errors.
    """
    levels, limits = _levels_seen(values, errors), np.full((2, rates.shape[1]), np.nan)
    if levels < 4:
        return limits[0], limits[1]
    nodes = _doublings_nodes(values[:levels], errors[:levels])
    for k in np.flatnonzero(np.isfinite(rates[:levels] + rate_errors[:levels]).all(axis=0)):
        limits[:, k] = _limit_rate(nodes, rates[:levels, k], rate_errors[:levels, k])
    return limits[0], limits[1]


def _levels_seen(values: Float[np.ndarray, " levels"], errors: Float[np.ndarray, " levels"]) -> int:
    """Return the number of levels up to the first step that errors hide."""
    seen = np.abs(np.diff(values)) > _SEEN * (errors[1:] + errors[:-1])
    return len(values) if seen.all() else int(np.argmin(seen)) + 1


def _doublings_nodes(values: Float[np.ndarray, " levels"], errors: Float[np.ndarray, " levels"]) -> _Nodes:
    """Return models of doublings as seen from the last of them."""
    steps = np.abs(np.diff(values))
    return _nodes(values - values[-1], errors, steps[-2] / steps[-1], _DOUBLINGS)


def _limit_rate(
    nodes: _Nodes, rates: Float[np.ndarray, " levels"], errors: Float[np.ndarray, " levels"]
) -> tuple[float, float]:
    """Return the limit of derivatives and its error: at ratios as likely as the doublings have them, of all sizes."""
    weights, values, variances = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
    for bound in np.unique(nodes.bound):
        mine = nodes.bound == bound
        of_sizes = [
            _posterior(rates - rates[-1], errors, 1.0 / nodes.ratio[mine], _RATES, size, bound) for size in _SIZES
        ]
        density, value, variance = (np.stack(leaves) for leaves in zip(*of_sizes, strict=True))
        share = np.exp(density - density.max(axis=0))
        weights.append((nodes.weight[mine] * share / share.sum(axis=0)).ravel())
        values.append(value.ravel())
        variances.append(variance.ravel())
    weight, value, variance = (np.concatenate(parts) for parts in (weights, values, variances))
    limit = float(weight @ value)
    spread = float(weight @ (variance + (value - limit) ** 2))
    return float(rates[-1]) + limit, _WIDE * float(np.sqrt(spread))


def widths_limit(widths: Float[np.ndarray, " levels"], errors: Float[np.ndarray, " levels"]) -> Limit:
    """α of widths of orbits at successive doublings, of three or more since they last grew; their limit is zero."""
    grew = np.flatnonzero(np.diff(widths) >= 0.0)
    last = int(grew[-1]) + 1 if len(grew) else 0
    widths, errors = widths[last:], errors[last:]
    if len(widths) < 3:
        return _UNKNOWN
    return _limit(_nodes(widths, errors, widths[-2] / widths[-1], _WIDTHS))


def _nodes(
    sequence: Float[np.ndarray, " levels"], errors: Float[np.ndarray, " levels"], last: float, kind: _Kind
) -> _Nodes:
    """Return all models of the corrections, with ratios about that of the last levels."""
    middle = np.log(max(last, _LEAST_RATIO))
    ends = max(middle - kind.reach, np.log(_LEAST_RATIO)), middle + kind.reach
    models = list(itertools.product(_SIZES, kind.bounds))
    grids, posteriors = zip(*(_peak(sequence, errors, kind, size, bound, ends) for size, bound in models), strict=True)
    mass = np.concatenate([p.density + np.log(logs[1] - logs[0]) for logs, p in zip(grids, posteriors, strict=True)])
    logs = np.concatenate(grids)
    order = np.argsort(logs)
    weight = np.exp(mass - mass.max())[order]
    weight /= weight.sum()
    bound = np.repeat([bound for _, bound in models], [len(grid) for grid in grids])[order]
    value, variance = (np.concatenate([getattr(p, name) for p in posteriors])[order] for name in ("value", "variance"))
    return _Nodes(np.exp(logs[order]), weight, bound, value, variance)


def _limit(nodes: _Nodes) -> Limit:
    """Return the interval of the ratio, and the limit, over all models of the corrections."""
    ratios, weight, _, value, variance = nodes
    ratio = float(weight @ ratios)
    interval = np.interp([_TAIL, 1.0 - _TAIL], np.cumsum(weight) - 0.5 * weight, ratios)
    limit = float(weight @ value)
    spread = float(weight @ (variance + (value - limit) ** 2))
    return Limit(ratio, float(np.abs(interval - ratio).max()), limit, _WIDE * float(np.sqrt(spread)))


def _peak(
    sequence: Float[np.ndarray, " levels"],
    errors: Float[np.ndarray, " levels"],
    kind: _Kind,
    size: float,
    bound: float,
    ends: tuple[float, float],
) -> tuple[Float[np.ndarray, " ratios"], _Posterior]:
    """Logarithms of ratios where a model is likely, and how likely it is there: on ever closer grids.

    Each model has grids of its own: the more it ties the sequence down the narrower its peak, and between the nodes of
    a grid that is fine enough for one model that of another goes unseen.
    """
    low, high = ends
    while True:  # a grid that is not fine enough has its third kept at most
        logs = np.linspace(low, high, _NODES)
        posterior = _posterior(sequence, errors, np.exp(-logs), kind, size, bound)
        kept = np.flatnonzero(posterior.density > posterior.density.max() - _NEGLIGIBLE)
        first, final = max(kept[0] - 1, 0), min(kept[-1] + 1, _NODES - 1)
        if final - first > _NODES / _FINE:
            return logs, posterior
        low, high = logs[first], logs[final]


def _posterior(
    sequence: Float[np.ndarray, " levels"],
    errors: Float[np.ndarray, " levels"],
    r: Float[np.ndarray, " ratios"],
    kind: _Kind,
    size: float,
    bound: float,
) -> _Posterior:
    """Posterior of ratios r = 1/δ or 1/α, limit and A integrated out (Rasmussen, Williams 2006, 2.7)."""
    levels = len(sequence)
    k = np.arange(levels)
    power = r[:, None] ** k
    unit = abs(sequence[-1] - sequence[-2])
    if not kind.last:
        steps = np.maximum(np.abs(np.diff(sequence)), errors[1:])  # of the same derivative at all levels none
        scale = np.max(steps / (power[:, :-1] - power[:, 1:]), axis=1)
        unit = float(steps[-1])
    elif kind.constant:
        scale = unit / (power[:, -2] - power[:, -1])
    else:
        scale = abs(sequence[-1]) / power[:, -1]
    main = scale[:, None] * power
    covariance = _covariance(main, errors, k, kind.tied(r), size, bound)
    spread = np.sqrt(np.einsum("...ii->...i", covariance))
    correlation = covariance / (spread[..., :, None] * spread[..., None, :])
    root = np.linalg.cholesky(correlation + _NUGGET * np.eye(levels))
    known = [main, *([np.full_like(main, unit)] if kind.constant else []), np.broadcast_to(sequence, main.shape)]
    columns = np.stack(known, -1) / spread[..., None]
    upper = np.linalg.qr(np.linalg.solve(root, columns))[1]
    p = len(known) - 1
    diagonal = np.abs(np.einsum("...ii->...i", upper))
    halves = np.log(spread).sum(-1) + np.log(np.einsum("...ii->...i", root)).sum(-1)
    density = -0.5 * upper[..., p, p] ** 2 - halves - np.log(diagonal[..., :p]).sum(-1)
    if not kind.constant:
        return _Posterior(density, np.zeros_like(density), np.zeros_like(density))
    return _Posterior(density, unit * upper[..., 1, 2] / upper[..., 1, 1], (unit / diagonal[..., 1]) ** 2)


def _covariance(
    main: Float[np.ndarray, "ratios levels"],
    errors: Float[np.ndarray, " levels"],
    k: np.ndarray,
    tied: tuple[np.ndarray, ...],
    size: float,
    bound: float,
) -> Float[np.ndarray, "ratios levels levels"]:
    """Covariance of corrections and errors: E ρᵏ⁺ˡ over |ρ| below a bound and the tied ratios, times the size."""
    sums = k[:, None] + k
    others = np.where(sums % 2 == 0, bound**sums / (sums + 1.0), 0.0)
    own = np.sum([ratio[:, None, None] ** sums for ratio in tied], axis=0)
    return size**2 * main[:, :, None] * main[:, None, :] * (own + others) + np.diag(errors**2)
