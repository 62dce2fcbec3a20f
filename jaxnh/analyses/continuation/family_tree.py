"""All branches that orbits belong to, and those that cross them at their bifurcations, generation by generation.

Orbits come in waves. Those of a wave that are on no known branch are followed side by side; bifurcations are located on
what is new, doubled branches and the branches that cross at branch points are followed in turn, and so on up to a
limit of the period. Then comes the next wave.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Complex, Float

from jaxnh.analyses.continuation.known_branches import SAME, KnownBranches, same_orbit
from jaxnh.orbits.bifurcations.close_pairs import with_close_pairs
from jaxnh.orbits.bifurcations.grazing import GrazingOrbit
from jaxnh.orbits.bifurcations.location import Brackets, brackets, locate, locate_near, neutral_pair
from jaxnh.orbits.bifurcations.normal_forms import cubic
from jaxnh.orbits.bifurcations.sign_changes import PAIRS, known_signs
from jaxnh.orbits.continuation.arclength import CurveOrbits, Family, PathVector, along_parameter, correct, length, times
from jaxnh.orbits.continuation.branches import Branch, follow_both_ways
from jaxnh.orbits.continuation.core import FINE
from jaxnh.orbits.continuation.kinds import BRANCH_POINT, DOUBLING, FOLD, eigenvalues
from jaxnh.orbits.continuation.paths import COLLAPSED, StepControl
from jaxnh.orbits.continuation.switching import crossing_orbits, doubled_orbits
from jaxnh.systems.rows import concatenate, select, spread_indices

_BESIDE = 5e-6  # lengths: orbits that begin at a bifurcation are further than this from the branch that has it
_LOOKED_AT = 9  # points of a branch
_COMPARED = 3  # orbits of a branch, with those of the map of twice the steps
_ABREAST = 8  # times the branches that fill a tile: of 32 lanes a tile, calls of 64 to 512 take a quarter of the time
_SAME_POINT = 1e-6  # of the width of the range, and lengths: two branches have the bifurcation in common


class SeedOrbit(NamedTuple):
    """A periodic orbit at a value of the parameter.

    Attributes:
        points: of it, nearly, (n, d).
        value: of the parameter.
        starts: numbers of the random starts that led to it.
    """

    points: Float[np.ndarray, "n d"]
    value: float
    starts: tuple[int, ...] = ()


class Bifurcation(NamedTuple):
    """A bifurcation.

    Attributes:
        kind: number in `KINDS`.
        value, error: of the parameter.
        branch, place: number of the branch, and of the point of it that comes before.
        points: the orbit, (n, d).
        multipliers: of it, (d,).
        coefficient: cubic one of the normal form; of a fold the second derivative of the parameter along the curve.
        criticality: −1 subcritical, 1 supercritical, 0 none or not known.
        arcs: the orbit between its events, by steps of several lengths, where it grazes.
    """

    kind: int
    value: float
    error: float
    branch: int
    place: int
    points: Float[np.ndarray, "n d"]
    multipliers: Complex[np.ndarray, " d"]
    coefficient: float
    criticality: int
    arcs: Sequence[GrazingOrbit] = ()


class SignChange(NamedTuple):
    """A change of a test function's sign between two points of a branch, by the place of the first of them.

    Attributes:
        branch, place: number of the branch, and of the point.
        kind: of the bifurcation that it tells, a number in `KINDS`.
    """

    branch: int
    place: int
    kind: int


class Tree(NamedTuple):
    """Branches, their bifurcations, and the changes of sign of test functions that led to none."""

    branches: list[Branch]
    bifurcations: list[Bifurcation]
    lost: list[SignChange]


Stage = Callable[[str], AbstractContextManager[object]]
"""Shows what is done inside, by its label."""


def grow(
    families: Sequence[Family],
    waves: Sequence[Sequence[SeedOrbit]],
    limit: int,
    steps: StepControl,
    stage: Stage = nullcontext,
) -> Tree:
    """All branches that waves of orbits lead to.

    Args:
        families: the map, and the same with 2 and 4 times the steps, for the errors of parameters.
        waves: orbits to begin with.
        limit: largest period.
        steps: how branches are followed.
        stage: shows what is done inside, by its label.
    """
    tree = Tree([], [], [])
    for wave in waves:
        open_ = list(wave)
        starts: dict[int, list[CurveOrbits]] = {}
        while open_ or starts:
            n = min([*(len(orbit.points) for orbit in open_), *starts])
            mine = [orbit for orbit in open_ if len(orbit.points) == n]
            open_ = [orbit for orbit in open_ if len(orbit.points) != n]
            new = _follow_branches(families[0], tree, mine, starts.pop(n, []), steps, stage)
            if not new:
                continue
            tree, more, parents = _add_branches(families, tree, new, limit, stage)
            open_ += parents
            for orbits in more:
                starts.setdefault(orbits.points.shape[1], []).append(orbits)
    return tree._replace(branches=_with_step_changes(families, tree.branches))


def _with_step_changes(families: Sequence[Family], branches: Sequence[Branch]) -> list[Branch]:
    """The branches with what the map of twice the steps says of a few of their orbits.

    Steps suit what the sweep's lanes do; random starts lead to orbits elsewhere, where the map may be none of the flow.
    """
    family, finer = families[:2]
    if finer is family or not branches:
        return list(branches)
    sampled = [np.unique(np.linspace(0, len(branch.value) - 1, _COMPARED).astype(int)) for branch in branches]
    orbits = [branch.points[at] for branch, at in zip(branches, sampled, strict=True)]
    counts = [part.shape[0] * part.shape[1] for part in orbits]
    u = np.concatenate([part.reshape(-1, part.shape[2]) for part in orbits])
    values = np.concatenate(
        [np.repeat(branch.value[at], branch.period) for branch, at in zip(branches, sampled, strict=True)]
    )
    images = [np.asarray(each.period(u, values).image) for each in (family, finer)]
    apart = np.max(np.abs(family.wrap(images[1] - images[0])) / family.size, axis=1)
    parts = np.split(apart, np.cumsum(counts)[:-1])
    return [replace(branch, step_change=float(part.max())) for branch, part in zip(branches, parts, strict=True)]


def _follow_branches(
    family: Family,
    tree: Tree,
    seeds: Sequence[SeedOrbit],
    starts: Sequence[CurveOrbits],
    steps: StepControl,
    stage: Stage,
) -> list[Branch]:
    """The new branches through orbits, and on from orbits at bifurcations, all of one period."""
    queue = [orbits.take(orbits.converged) for orbits in starts]  # first, as they begin where their branches do
    beside = sum(len(orbits.value) for orbits in queue)
    if seeds:
        points, value = np.stack([orbit.points for orbit in seeds]), np.array([orbit.value for orbit in seeds])
        orbits = correct(family, points, value, along_parameter(family, *points.shape[:2]), FINE)
        queue.append(orbits.take(orbits.converged))
    orbits = concatenate(queue)
    n, at_once = orbits.points.shape[1], _at_once(family, seeds)
    kept, new = KnownBranches(family, tree.branches, n), list[Branch]()

    def is_new(known: KnownBranches, k: int) -> bool:
        return not known.has(orbits.points[k], float(orbits.value[k]), _BESIDE if k < beside else SAME)

    left = list(range(len(orbits.value)))
    while left:  # again where one was on a branch that is dropped, as it begins on another, and goes further than that
        with stage(f"branches of period {n} from {len(left)} orbits"):  # and back through bifurcations as well
            wanted = _WantedOrbits(KnownBranches(family, [*tree.branches, *new], n), left, is_new)
            followed = follow_both_ways(family, orbits.take(np.array(left)), steps, wanted, at_once)
        for i, branch in followed.items():
            k = left[i]
            if len(branch.value) > 1 and is_new(kept, k) and not (k < beside and _is_known(kept, branch)):
                new.append(branch)
                kept.add(branch)
        left = [k for i, k in enumerate(left) if i not in followed and is_new(kept, k)]
    return new


class _WantedOrbits:
    """Says which orbits are on no branch that is known or has been followed, and so begin one."""

    def __init__(self, known: KnownBranches, orbits: Sequence[int], is_new: Callable[[KnownBranches, int], bool]):
        self._known, self._orbits, self._is_new, self._seen = known, orbits, is_new, 0

    def __call__(self, followed: Sequence[Branch], i: int) -> bool:
        for branch in followed[self._seen :]:
            self._known.add(branch)
        self._seen = len(followed)
        return self._is_new(self._known, self._orbits[i])


def _at_once(family: Family, seeds: Sequence[SeedOrbit]) -> int:
    """Branches that are followed side by side: more where many orbits are at one value, mostly on as many branches."""
    values = np.array([orbit.value for orbit in seeds])
    most = int(np.unique(values, return_counts=True)[1].max(initial=0))
    return int(np.clip(most, family.at_once, _ABREAST * family.at_once))


def _is_known(known: KnownBranches, branch: Branch) -> bool:
    """Return whether all of a branch, as far as some of its points tell, is on others."""
    sampled = spread_indices(len(branch.value), _LOOKED_AT).tolist()
    return all(known.has(branch.points[i], float(branch.value[i])) for i in sampled)


def _add_branches(
    families: Sequence[Family], tree: Tree, new: Sequence[Branch], limit: int, stage: Stage
) -> tuple[Tree, list[CurveOrbits], list[SeedOrbit]]:
    """The tree with new branches of one period and their bifurcations; first orbits of the branches that leave there.

    And orbits of the shorter period where a branch ends because it was born in a doubling.
    """
    count, n = len(tree.branches), new[0].period
    new = with_close_pairs(families[0], new)
    tree = tree._replace(branches=[*tree.branches, *new])
    parents = [orbit for branch in new for orbit in _parents(families[0], branch)]
    stretch = brackets(families[0], new)
    if stretch is None:
        return tree, [], parents
    with stage(f"{len(stretch.kind)} bifurcations of period {n}"):
        points, first, vectors, lost = _locate(families, stretch, count)
        tree.lost.extend(lost)
        kept = new_bifurcations(families[0], tree.bifurcations, points)
        tree.bifurcations.extend(points[k] for k in kept)
        kind = np.array([points[k].kind for k in kept], int)
        double, cross = (np.array(kept, int)[kind == which] for which in (DOUBLING, BRANCH_POINT))
        starts = list[CurveOrbits]()
        if len(double) and 2 * n <= limit:
            starts.append(doubled_orbits(families[0], first.take(double), vectors[double]))
        if len(cross):
            starts.append(concatenate(crossing_orbits(families[0], first.take(cross), sign) for sign in (1.0, -1.0)))
    return tree, starts, parents


def _locate(
    families: Sequence[Family], stretch: Brackets, count: int
) -> tuple[list[Bifurcation], CurveOrbits, Float[np.ndarray, "some n d"], list[SignChange]]:
    """Bifurcations in brackets, of branches that are numbered from `count` on; orbits of the first map there.

    Also the critical vectors of real multipliers, and the sign changes that led to nothing.
    """
    stretch = _with_known_signs(families, stretch)
    first = locate(families[0], stretch)
    neutral = np.isin(stretch.kind, PAIRS) & first.exists
    neutral[neutral] = neutral_pair(families[0], first.orbits.take(neutral))
    located = np.flatnonzero(first.exists & ~neutral)
    lost = _sign_changes(stretch, ~first.exists, count)
    stretch, first = select((stretch, first), located)
    if not len(located):
        return [], first.orbits, np.zeros(first.orbits.points.shape), lost
    second, third = (locate_near(finer, stretch, first) for finer in families[1:])
    value = second.orbits.value
    error = np.abs(value - first.orbits.value) + np.abs(third.orbits.value - value)
    error += np.maximum(second.error, third.error)
    known = second.exists & third.exists & np.isfinite(error)
    sure, lost = np.flatnonzero(known), [*lost, *_sign_changes(stretch, ~known, count)]
    orbits, kind = second.orbits.take(sure), stretch.kind[sure]
    normal, values = cubic(families[1], orbits, kind), eigenvalues(families[1], orbits)
    coefficient = np.where(kind == FOLD, second.bend[sure], normal.coefficient)
    bifurcations = [
        Bifurcation(
            int(kind[k]),
            float(orbits.value[k]),
            float(error[at]),
            count + int(stretch.branch[at]),
            int(stretch.place[at]),
            orbits.points[k],
            values[k],
            float(coefficient[k]),
            int(normal.criticality[k]),
        )
        for k, at in enumerate(sure.tolist())
    ]
    return bifurcations, first.orbits.take(sure), np.real(normal.vectors), lost


def _with_known_signs(families: Sequence[Family], stretch: Brackets) -> Brackets:
    """The brackets but for those of pairs of multipliers that rounding or steps make, all along a conservative flow."""
    pairs = np.flatnonzero(np.isin(stretch.kind, PAIRS))
    if not len(pairs):
        return stretch
    part = select(stretch, pairs)
    size = length(families[0], part.chord)
    end = PathVector(part.start.points + part.chord.points, part.start.value + part.chord.value)
    ways = [times(1.0 / size, way) for way in part.ways]
    known = np.any([known_signs(families, *each) for each in zip((part.start, end), ways, strict=True)], axis=0)
    return jax.tree.map(lambda leaf: np.delete(leaf, pairs[~known], axis=0), stretch)


def _sign_changes(stretch: Brackets, which: Bool[np.ndarray, " some"], count: int) -> list[SignChange]:
    """A subset of the brackets, on branches that are numbered from `count` on."""
    rows = zip(stretch.branch[which] + count, stretch.place[which], stretch.kind[which], strict=True)
    return [SignChange(int(branch), int(place), int(kind)) for branch, place, kind in rows]


def _parents(family: Family, branch: Branch) -> list[SeedOrbit]:
    """Orbits of half the period that a branch of doubled ones ends in."""
    n = branch.period
    ends = [k for k, end in zip((0, -1), branch.ends, strict=True) if end == COLLAPSED and n % 2 == 0]
    return [SeedOrbit(_middle(family, branch.points[k]), float(branch.value[k])) for k in ends]


def _middle(family: Family, points: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "half d"]:
    half = len(points) // 2
    return points[:half] + 0.5 * family.wrap(points[half:] - points[:half])


def new_bifurcations(family: Family, known: Sequence[Bifurcation], points: Sequence[Bifurcation]) -> list[int]:
    """Numbers of those points that no branch has in common with what is known, or with a point before them."""
    every = [*known, *points]
    kind, value, error = (
        np.array([getattr(bifurcation, name) for bifurcation in every]) for name in ("kind", "value", "error")
    )
    kept, there = list[int](), np.arange(len(every)) < len(known)
    for k, point in enumerate(points):
        near = _SAME_POINT * family.width + point.error + error
        beside = np.flatnonzero(there & (kind == point.kind) & (np.abs(value - point.value) <= near)).tolist()
        if not any(same_orbit(family, point.points, every[i].points, 1e2 * _SAME_POINT) for i in beside):
            there[len(known) + k] = True
            kept.append(k)
    return kept
