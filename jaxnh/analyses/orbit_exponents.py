"""Exponents of lanes that have settled on a stable periodic orbit: ln|μ| of its multipliers over its period.

Newton finds the orbit from the last state of a lane; no average is taken. Multipliers are eigenvalues of the monodromy
matrix; those that rounding loses in it come from tangents carried around the orbit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from jaxnh.analyses.base import LaneRunner, Scene, picked
from jaxnh.analyses.growth import Growth, average, parts_of
from jaxnh.analyses.period import ORBIT_TILE, Survey, orbits, survey
from jaxnh.orbits.newton import Orbit
from jaxnh.systems.flow import Flow, Parameters, State

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


def on_orbits(
    scene: Scene, lanes: LaneRunner, growth: Growth, candidates: Int[np.ndarray, " some"], parts: int, longest: int
) -> OrbitExponents:
    """Those candidates among the lanes that are on a stable periodic orbit, and its exponents.

    Args:
        growth: of all lanes, at the end of their averages.
        candidates: numbers of lanes.
        parts: orthonormalisations a period.
        longest: period that is looked for, at most.
    """
    k = len(growth.tangents)
    scene, growth = scene.take(candidates), picked(growth, candidates)
    p = dict(scene.p)
    found = survey(scene, lanes, scene.system.section_point(growth.state), min(longest, _LONGEST), "lyapunov", 0)
    settled = np.flatnonzero(found.period > 0)
    logs, error = np.full((2, len(settled), k), np.nan)
    for n in np.unique(found.period[settled]):
        here = np.flatnonzero(found.period[settled] == n)
        some = settled[here]
        coarse, fine = (
            _logs(scene, lanes, picked(growth, some), picked(p, some), picked(found, some), int(n), parts, refinement)
            for refinement in (1, 2)
        )
        logs[here] = coarse[0]
        error[here] = 2.0 * np.abs(coarse[0] - fine[0]) + coarse[1]
    kept = np.all(np.isfinite(logs) & np.isfinite(error), axis=1)
    return OrbitExponents(candidates[settled[kept]], logs[kept], error[kept])


def _logs(
    scene: Scene,
    lanes: LaneRunner,
    growth: Growth,
    p: Parameters,
    found: Survey,
    n: int,
    parts: int,
    refinement: int,
) -> tuple[Float[np.ndarray, "lanes k"], Float[np.ndarray, "lanes k"]]:
    """ln|μ|/n of orbits of period n, as a survey has found them, largest first, and its rounding.

    With `refinement` times the steps.
    """
    k = len(growth.tangents)
    orbit = orbits(lanes, scene.strobe(refinement), found.u, p, n, found.size)
    moduli = np.sort(np.abs(np.linalg.eigvals(orbit.monodromy)), axis=1)[:, ::-1][:, :k]
    share = moduli / np.linalg.norm(orbit.monodromy, axis=(1, 2))[:, None]
    with np.errstate(divide="ignore"):
        logs, rounding = np.log(moduli) / n, _ROUNDING / share / n
    lost = np.flatnonzero(~np.all(share > _SEEN, axis=1))
    if len(lost):
        around = picked(growth, lost), picked(p, lost), picked(orbit, lost)
        carried, moved = _carried(scene, lanes, *around, n, parts, refinement)
        unseen = share[lost] <= _SEEN
        logs[lost] = np.where(unseen, carried, logs[lost])
        rounding[lost] = np.where(unseen, moved + _ROUNDING, rounding[lost])
    return logs, rounding


def _carried(
    scene: Scene, lanes: LaneRunner, growth: Growth, p: Parameters, orbit: Orbit, n: int, parts: int, refinement: int
) -> tuple[Float[np.ndarray, "lanes k"], Float[np.ndarray, "lanes k"]]:
    """Growth a period of tangents carried around orbits until a turn changes it no more, and its last change."""
    strobes, k = parts_of(scene, parts, refinement), len(growth.tangents)
    growth, _ = average(lanes, strobes, growth, p, 1, tile=ORBIT_TILE)  # to the point that the orbit begins at
    growth = growth._replace(state=lanes(_state_at, (scene.system,), (orbit.u,), tile=ORBIT_TILE))
    rates, moved = np.full((2, len(orbit.u), k), np.inf)
    going = np.arange(len(orbit.u))
    for _ in range(_TURNS):
        growth, sums = average(lanes, strobes, growth, picked(p, going), n, tile=ORBIT_TILE)
        moved[going] = np.abs(sums[:, :k] - rates[going])
        rates[going] = sums[:, :k]
        left = ~np.all(moved[going] < _SETTLED, axis=1)
        going, growth = going[left], picked(growth, left)
        if not len(going):
            break
    return rates, moved


def _state_at(system: Flow, u: Float[Array, " d"]) -> State:
    return system.unchart(u)
