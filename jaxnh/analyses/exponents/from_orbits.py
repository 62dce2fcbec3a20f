"""Exponents of lanes that have settled on a stable periodic orbit: ln|μ| of its multipliers over its period.

Newton finds the orbit from the last state of a lane; no average is taken. Multipliers are eigenvalues of the monodromy
matrix; those that rounding loses in it come from tangents carried around the orbit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner, picked
from jaxnh.analyses.exponents.tangent_growth import TangentState, parts_of, turn
from jaxnh.analyses.periodic.attractor_survey import Survey, early_timing, survey, survey_early
from jaxnh.analyses.periodic.newton_on_lanes import ORBIT_TILE, orbits
from jaxnh.systems.flow import Flow
from jaxnh.systems.state import State

_LONGEST = 64  # period of an orbit that is looked for
_SEEN = 1e-6  # a multiplier below this share of the monodromy matrix is left to tangents
_TURNS = 6  # around the orbit, that tangents are carried at most
_SETTLED = 1e-12  # a turn
_ROUNDING = 1e-12  # of a multiplier's logarithm, times the matrix over the multiplier


class OrbitExponents(NamedTuple):
    """Exponents a period of lanes that are on an orbit.

    Attributes:
        lanes: their numbers, (some,).
        logs: ln|μ|/n, largest first, (some, k).
        error: (some, k): twice what twice the steps change, and rounding.
    """

    lanes: Int[np.ndarray, " some"]
    logs: Float[np.ndarray, "some k"]
    error: Float[np.ndarray, "some k"]


def no_orbits(k: int) -> OrbitExponents:
    """Those of no lane, k each."""
    return OrbitExponents(np.zeros(0, int), *np.empty((2, 0, k)))


class Early(NamedTuple):
    """Lanes that were looked at early in their transient.

    Attributes:
        survey: their orbits, where they are on one.
        state: of the flow, where they are then.
        periods: that are over.
    """

    survey: Survey
    state: State
    periods: int

    @property
    def settled(self) -> Int[np.ndarray, " some"]:
        """Numbers of the lanes that are on orbits."""
        return np.flatnonzero(self.survey.period > 0)


def settled_early(batch: LaneBatch, lanes: LaneRunner, transient: int) -> Early | None:
    """Lanes that are on stable orbits long before their transient is over, as most are; None where it is too short."""
    early = early_timing(transient)
    if early is None:
        return None
    found, ends = survey_early(batch, lanes, "lyapunov", early)
    return Early(found, lanes(_state_at, (batch.system,), (ends,)), early.periods)


def joined(one: OrbitExponents, other: OrbitExponents) -> OrbitExponents:
    """Those of both."""
    return OrbitExponents(*(np.concatenate(leaves) for leaves in zip(one, other, strict=True)))


def on_orbits(
    batch: LaneBatch,
    lanes: LaneRunner,
    growth: TangentState,
    candidates: Int[np.ndarray, " some"],
    parts: int,
    longest: int,
) -> OrbitExponents:
    """Those candidates among the lanes that are on a stable periodic orbit, and its exponents.

    Args:
        growth: of all lanes, at the end of their averages.
        candidates: numbers of lanes.
        parts: orthonormalisations a period.
        longest: period that is looked for, at most.
    """
    if not len(candidates):
        return no_orbits(len(growth.tangents))
    some, u = batch.take(candidates), batch.chart.host_points(picked(growth.state, candidates))
    found = survey(some, lanes, u, min(longest, _LONGEST), "lyapunov", 0, tile=ORBIT_TILE)
    settled = np.flatnonzero(found.period > 0)
    return of_orbits(batch, lanes, growth, candidates[settled], picked(found, settled), parts)


def of_orbits(
    batch: LaneBatch,
    lanes: LaneRunner,
    growth: TangentState,
    settled: Int[np.ndarray, " some"],
    found: Survey,
    parts: int,
) -> OrbitExponents:
    """Exponents of stable periodic orbits that some lanes are on.

    Args:
        growth: of all lanes, near the orbits of these.
        settled: numbers of these lanes.
        found: their orbits.
        parts: orthonormalisations a period.
    """
    if not len(settled):
        return no_orbits(len(growth.tangents))
    order = np.argsort(found.period, kind="stable")  # tiles of lanes that take equally long
    settled, found = settled[order], picked(found, order)
    batch, growth, n = batch.take(settled), picked(growth, settled), found.period
    p = dict(batch.p)
    finer = orbits(lanes, batch.strobe(2), found.u, p, n, found.size)
    logs, rounding = _logs(batch, lanes, growth, n, found.u, found.monodromy, parts, 1)
    fine, _ = _logs(batch, lanes, growth, n, finer.u, finer.monodromy, parts, 2)
    error = 2.0 * np.abs(logs - fine) + rounding
    kept = np.all(np.isfinite(logs) & np.isfinite(error), axis=1)
    return OrbitExponents(settled[kept], logs[kept], error[kept])


def _logs(
    batch: LaneBatch,
    lanes: LaneRunner,
    growth: TangentState,
    n: Int[np.ndarray, " lanes"],
    u: Float[np.ndarray, "lanes d"],
    monodromy: Float[np.ndarray, "lanes d d"],
    parts: int,
    refinement: int,
) -> tuple[Float[np.ndarray, "lanes k"], Float[np.ndarray, "lanes k"]]:
    """ln|μ|/n of orbits of periods n through points u, largest first, and its rounding, of a map of refined steps."""
    k = len(growth.tangents)
    moduli = np.sort(np.abs(np.linalg.eigvals(monodromy)), axis=1)[:, ::-1][:, :k]
    share = moduli / np.linalg.norm(monodromy, axis=(1, 2))[:, None]
    with np.errstate(divide="ignore"):
        logs, rounding = np.log(moduli) / n[:, None], _ROUNDING / share / n[:, None]
    unseen = ~(share > _SEEN)
    lost = np.flatnonzero(np.any(unseen, axis=1))
    if len(lost):
        some = picked(growth, lost), u[lost], n[lost]
        carried, moved = _carried(batch.take(lost), lanes, *some, parts, refinement)
        logs[lost] = np.where(unseen[lost], carried, logs[lost])
        rounding[lost] = np.where(unseen[lost], moved + _ROUNDING, rounding[lost])
    return logs, rounding


def _carried(
    batch: LaneBatch,
    lanes: LaneRunner,
    growth: TangentState,
    u: Float[np.ndarray, "lanes d"],
    n: Int[np.ndarray, " lanes"],
    parts: int,
    refinement: int,
) -> tuple[Float[np.ndarray, "lanes k"], Float[np.ndarray, "lanes k"]]:
    """Growth a period of tangents carried around orbits of periods n, until a turn changes it no more, and its change.

    Args:
        growth: of lanes near their orbits, a period before the point u of the orbit.
    """
    strobes, k, p = parts_of(batch, parts, refinement), len(growth.tangents), dict(batch.p)
    growth, _ = turn(lanes, strobes, growth, p, np.ones_like(n), tile=ORBIT_TILE)
    growth = growth._replace(state=lanes(_state_at, (batch.system,), (u,), tile=ORBIT_TILE))
    rates, moved = np.full((2, len(u), k), np.inf)
    going = np.arange(len(u))
    for _ in range(_TURNS):
        growth, sums = turn(lanes, strobes, growth, picked(p, going), n[going], tile=ORBIT_TILE)
        moved[going] = np.abs(sums - rates[going])
        rates[going] = sums
        left = ~np.all(moved[going] < _SETTLED, axis=1)
        going, growth = going[left], picked(growth, left)
        if not len(going):
            break
    return rates, moved


def _state_at(system: Flow, u: Float[Array, " d"]) -> State:
    return system.chart.state(u)
