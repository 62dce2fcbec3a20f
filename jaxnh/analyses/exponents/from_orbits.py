"""Exponents of lanes that have settled on a stable periodic orbit: ln|μ| of its multipliers over its period.

Newton finds the orbit from the last state of a lane; no average is taken. Multipliers are eigenvalues of the monodromy
matrix; those that rounding loses in it come from tangents carried around the orbit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.exponents.errors import change
from jaxnh.analyses.exponents.period_parts import period_parts
from jaxnh.analyses.exponents.tangent_growth import TangentState, advance_turns
from jaxnh.analyses.periodic.attractor_survey import Survey, early_timing, survey, survey_early
from jaxnh.analyses.periodic.newton_on_lanes import ORBIT_TILE, images, orbits
from jaxnh.analyses.section_points import states_at
from jaxnh.orbits.multipliers import eigenvalues
from jaxnh.orbits.newton import Images, solve
from jaxnh.systems.chart import Wrap
from jaxnh.systems.rows import select
from jaxnh.systems.state import LaneStates

_LONGEST = 64  # period of an orbit that is looked for
_SEEN = 1e-6  # a multiplier below this share of the monodromy matrix is left to tangents
_TURNS = 6  # around the orbit, that tangents are carried at most
_SETTLED = 1e-12  # a turn
_ULPS = 4  # that an iterate of a map may be off, in sizes of the motion
_NEIGHBOURS = np.array([-2.0, -1.0, 1.0, 2.0])  # of a point, in these
_ROUNDING = 1e-12  # of a multiplier's logarithm, times the matrix over the multiplier


class OrbitExponents(NamedTuple):
    """Exponents a period of lanes that are on an orbit.

    Attributes:
        lanes: their numbers, (some,).
        logs: ln|μ|/n, largest first, (some, k).
        error: (some, k): twice what twice the steps change, and rounding. An orbit of a map may be superstable: a
            multiplier that rounding does not tell from zero has the exponent −∞, without error; so it has of a flow
            that loses rank.
    """

    lanes: Int[np.ndarray, " some"]
    logs: Float[np.ndarray, "some k"]
    error: Float[np.ndarray, "some k"]


def no_orbits(k: int) -> OrbitExponents:
    """Return an empty result with k exponents per lane."""
    return OrbitExponents(np.zeros(0, int), *np.empty((2, 0, k)))


class EarlyOrbits(NamedTuple):
    """Orbits of lanes that were examined early in their transient.

    Attributes:
        survey: their orbits, where they are on one.
        state: of the flow, where they are then.
        periods: that are over.
    """

    survey: Survey
    state: LaneStates
    periods: int

    @property
    def settled(self) -> Int[np.ndarray, " some"]:
        """Numbers of the lanes that are on orbits."""
        return np.flatnonzero(self.survey.period > 0)


def early_orbits(batch: LaneBatch, lanes: LaneRunner, transient: int) -> EarlyOrbits | None:
    """Return lanes that are on stable orbits long before their transient is over; None where it is too short."""
    early = early_timing(transient)
    if early is None:
        return None
    orbits, ends = survey_early(batch, lanes, "lyapunov", early)
    return EarlyOrbits(orbits, states_at(batch, lanes, ends), early.periods)


def find_orbits(
    batch: LaneBatch,
    lanes: LaneRunner,
    growth: TangentState,
    candidates: Int[np.ndarray, " some"],
    parts: int,
    longest: int,
) -> OrbitExponents:
    """Return the candidates that are on a stable periodic orbit, and its exponents.

    Args:
        growth: of all lanes, at the end of their averages.
        candidates: numbers of lanes.
        parts: orthonormalisations a period.
        longest: period that is looked for, at most.
    """
    if not len(candidates):
        return no_orbits(len(growth.tangents))
    candidate_batch, u = batch.take(candidates), batch.chart.host_points(select(growth.state, candidates))
    orbits = survey(candidate_batch, lanes, u, min(longest, _LONGEST), "lyapunov", 0, tile=ORBIT_TILE)
    settled = np.flatnonzero(orbits.period > 0)
    return orbit_exponents(batch, lanes, growth, candidates[settled], select(orbits, settled), parts)


def orbit_exponents(
    batch: LaneBatch,
    lanes: LaneRunner,
    growth: TangentState,
    settled: Int[np.ndarray, " some"],
    survey: Survey,
    parts: int,
) -> OrbitExponents:
    """Return the exponents of the stable periodic orbits that these lanes are on.

    Args:
        growth: of all lanes, near the orbits of these.
        settled: numbers of these lanes.
        survey: their orbits.
        parts: orthonormalisations a period.
    """
    if not len(settled):
        return no_orbits(len(growth.tangents))
    order = np.argsort(survey.period, kind="stable")  # tiles of lanes that take equally long
    settled, survey = settled[order], select(survey, order)
    batch, growth, n = batch.take(settled), select(growth, settled), survey.period
    p = dict(batch.p)
    finer = orbits(lanes, batch.strobe(2 if batch.flow.continuous else 1), survey.u, p, n, survey.size)
    if batch.flow.continuous:
        first, u, monodromy = (survey.u, survey.monodromy), finer.u, finer.monodromy
    else:  # there are no steps, but a point is right to a few roundings only
        first = finer.u, finer.monodromy
        u, monodromy = _rounded_points(
            images(lanes, batch.strobe(), p, n.astype(np.int32)), batch.chart.wrap, finer.u, survey.size
        )
    logs, rounding = _logs(batch, lanes, growth, n, *first, parts, 1)
    fine, _ = _logs(batch, lanes, growth, n, u, monodromy, parts, 2)
    moved = change(logs, fine)
    error = np.where(np.isneginf(logs) & np.isneginf(fine), 0.0, 2.0 * moved + rounding)
    if not batch.flow.continuous:
        known = np.all(np.isfinite(monodromy), axis=(1, 2))[:, None]
        superstable = known & ~(moved * n[:, None] < np.log(2.0))
        logs, error = np.where(superstable, -np.inf, logs), np.where(superstable, 0.0, error)
    kept = np.all(np.isfinite(error), axis=1)
    return OrbitExponents(settled[kept], logs[kept], error[kept])


def _rounded_points(
    at: Images, wrap: Wrap, u: Float[np.ndarray, "lanes d"], size: Float[np.ndarray, "lanes d"]
) -> tuple[Float[np.ndarray, "lanes d"], Float[np.ndarray, "lanes d d"]]:
    """Return points as far from orbits of a map as rounding may leave Newton, and ∂Pⁿ/∂u there.

    A rounding ε of Pⁿ moves its zero by ε/(1 − μ): far, where a multiplier is nearly one. Roundings within a long orbit
    may grow before it closes: how much is seen of points a few roundings apart, whose images are not quite a line.
    """
    d, every, ulps = u.shape[1], np.arange(len(u)), _ULPS * np.finfo(float).eps * size
    here = at(u, every)
    monodromy, image = np.asarray(here.monodromy), np.asarray(here.image)
    moved = (u + _NEIGHBOURS[:, None, None] * ulps) - u
    images_beside = np.asarray(at((u + moved).reshape(-1, d), np.tile(every, len(_NEIGHBOURS))).image)
    scatter = wrap(images_beside.reshape(moved.shape) - image) - np.einsum("lij,klj->kli", monodromy, moved)
    rounding = np.maximum(ulps, np.max(np.abs(scatter), axis=0))
    shift = solve(monodromy - np.eye(d), rounding)
    u = u + np.where(np.abs(shift) > ulps, shift, ulps)
    return u, np.asarray(at(u, every).monodromy)


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
    """Return ln|μ|/n of orbits of periods n through points u, largest first, and its rounding, with refined steps."""
    k = len(growth.tangents)
    moduli = np.sort(np.abs(eigenvalues(monodromy)), axis=1)[:, ::-1][:, :k]
    with np.errstate(divide="ignore", invalid="ignore"):  # of maps a multiplier, or the whole matrix, may vanish
        share = moduli / np.linalg.norm(monodromy, axis=(1, 2))[:, None]
        logs, rounding = np.log(moduli) / n[:, None], _ROUNDING / share / n[:, None]
    unseen = ~(share > _SEEN)
    lost = np.flatnonzero(np.any(unseen, axis=1))
    if len(lost):
        unresolved = select(growth, lost), u[lost], n[lost]
        carried, moved = _carry_tangents(batch.take(lost), lanes, *unresolved, parts, refinement)
        logs[lost] = np.where(unseen[lost], carried, logs[lost])
        rounding[lost] = np.where(unseen[lost], moved + _ROUNDING, rounding[lost])
    return logs, rounding


def _carry_tangents(
    batch: LaneBatch,
    lanes: LaneRunner,
    growth: TangentState,
    u: Float[np.ndarray, "lanes d"],
    n: Int[np.ndarray, " lanes"],
    parts: int,
    refinement: int,
) -> tuple[Float[np.ndarray, "lanes k"], Float[np.ndarray, "lanes k"]]:
    """Carry tangents around orbits of periods n until a turn no longer changes their growth; return it and its change.

    Args:
        growth: of lanes near their orbits, a period before the point u of the orbit.
    """
    strobes, k, p = period_parts(batch, parts, refinement), len(growth.tangents), dict(batch.p)
    growth, _ = advance_turns(lanes, strobes, growth, p, np.ones_like(n), tile=ORBIT_TILE)
    growth = growth._replace(state=states_at(batch, lanes, u, ORBIT_TILE))
    rates, moved = np.full((2, len(u), k), np.inf)
    going = np.arange(len(u))
    for _ in range(_TURNS):
        growth, sums = advance_turns(lanes, strobes, growth, select(p, going), n[going], tile=ORBIT_TILE)
        moved[going] = change(sums, rates[going])
        rates[going] = sums
        left = ~np.all(moved[going] < _SETTLED, axis=1)
        going, growth = going[left], select(growth, left)
        if not len(going):
            break
    return rates, moved
