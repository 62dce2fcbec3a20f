"""Curves of tori over a parameter, by pseudo-arclength: invariant curves of a map from one end of their range on.

Unknown are the points of an invariant curve at its nodes, its rotation number and the parameter, so that folds of tori
are points like others (Schilder, Osinga and Vogt, SIAM J. Appl. Dyn. Syst. 4 (2005) 459). The phase along the curve is
fixed against the curve before. Harmonics are doubled where the last ones are no longer rounding. Host code.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import solve_triangular

from jaxnh.analyses.tori.invariant_curves import InvariantCurve, invariance_system, is_resolved
from jaxnh.orbits.bifurcations.hopf_cycles import HopfPoint
from jaxnh.orbits.continuation import core
from jaxnh.orbits.continuation.arclength import Family
from jaxnh.orbits.continuation.core import EquationsOfPaths, Evaluation, Solution
from jaxnh.orbits.continuation.paths import COLLAPSED, NO_CONVERGENCE, START, UNRESOLVED, Path, StepControl
from jaxnh.systems.rows import spread_indices

_FIRST_HARMONICS = 8  # of a curve beside a Neimark–Sacker point
_AMPLITUDES = 0.02, 0.005, 0.08, 0.002  # natural ones, of curves that Newton begins with beside such a point
_NATURAL = 0.4  # widths of the range, by which the parameter differs where the amplitude is the natural one
_LARGEST = 10.0  # sizes of the motion: the natural amplitude at most
_IN_PLANE = 1e-9  # of the critical vector in sizes: what is less takes no part in it
_STRONG = 1e-3  # turns from a resonance, within which the normal form is none of tori
_SMALLEST = 1e-3  # lengths: a curve that is smaller has come to an orbit
_BESIDE = 0.2  # lengths from a Neimark–Sacker point: a curve that comes to an orbit here has come to this one
_SAME = 1e-3  # turns, and sizes of the motion: a torus this near to a branch is on it
_COMPARED = 5  # tori of a branch, with another one
_TINY = np.finfo(float).tiny


class Torus(NamedTuple):
    """An invariant curve at a value of the parameter."""

    curve: InvariantCurve
    value: float


class TorusBranch(NamedTuple):
    """A curve of tori.

    Attributes:
        iterates: of the map, that carry each curve to itself.
        tori: point by point.
        ends: why it ends where it begins, and at its end, numbers in `continuation.paths.ENDS`.
        born: the parameter of the Neimark–Sacker bifurcation that it begins at, else NaN.
    """

    iterates: int
    tori: list[Torus]
    ends: tuple[int, int]
    born: float = np.nan

    def born_at(self, value: float) -> TorusBranch:
        """The branch from its end that is nearer to a value of the parameter on, born there; as it is without one."""
        if not abs(self.tori[-1].value - value) < abs(self.tori[0].value - value):
            return self._replace(born=value)
        return TorusBranch(self.iterates, self.tori[::-1], (self.ends[1], self.ends[0]), value)


class TorusEquations(EquationsOfPaths):
    """Pⁿ(K(θ)) = K(θ + ρ) of 2m + 1 nodes of K, ρ and the parameter, as equations of the core.

    Args:
        family: the map.
        iterates: n.
        winding: whole turns of each coordinate along K, which the unknowns are without.
        harmonics: m.
        reference: the curve before, that the phase is fixed against; without, it is left as it is in each iterate.
    """

    def __init__(
        self,
        family: Family,
        iterates: int,
        winding: Int[np.ndarray, " d"],
        harmonics: int,
        reference: InvariantCurve | None = None,
    ) -> None:
        self._family, self._winding, self.iterates, self._reference = family, winding, iterates, reference
        self.harmonics, nodes = harmonics, 2 * harmonics + 1
        self.unit = np.concatenate([np.tile(family.size, nodes) * np.sqrt(nodes), [1.0, family.width]])
        self.low, self.high = np.array([family.low]), np.array([family.high])

    def with_harmonics(self, m: int) -> TorusEquations:
        """The same equations of curves with so many harmonics."""
        reference = None if self._reference is None else self._reference.with_harmonics(m)
        return TorusEquations(self._family, self.iterates, self._winding, m, reference)

    def after(self, z: Float[np.ndarray, " N"]) -> TorusEquations:
        """The same equations of curves in phase with a solution: guesses are not, and their error would grow."""
        return TorusEquations(self._family, self.iterates, self._winding, self.harmonics, self.torus(z).curve)

    def unknowns(self, torus: Torus) -> Float[np.ndarray, "1 N"]:
        """The unknowns of a torus, with as many harmonics as there are here."""
        curve = torus.curve.with_harmonics(self.harmonics)
        return np.concatenate([curve.periodic.ravel(), [curve.rotation, torus.value]])[None]

    def torus(self, z: Float[np.ndarray, " N"]) -> Torus:
        """The torus of unknowns."""
        periodic = z[:-2].reshape(-1, len(self._winding))
        return Torus(InvariantCurve.of_periodic(periodic, self._winding, float(z[-2])), float(z[-1]))

    def carried(self, z: Float[np.ndarray, "lanes N"], other: TorusEquations) -> Float[np.ndarray, "lanes N"]:
        """Unknowns or directions with as many harmonics as there are in other equations."""
        whole = list[np.ndarray]()
        for row in z:
            periodic = row[:-2].reshape(-1, len(self._winding))
            curve = InvariantCurve.of_periodic(periodic, 0 * self._winding, 0.0).with_harmonics(other.harmonics)
            whole.append(np.concatenate([curve.points.ravel(), row[-2:]]))
        return np.stack(whole)

    def evaluate(self, z: Float[np.ndarray, "lanes N"], /) -> Evaluation:
        """Solve where it evaluates; kept are the derivatives of Pⁿ at the nodes."""
        rows = [self._solved(row) for row in z]
        return Evaluation(*(np.stack(leaves) for leaves in zip(*rows, strict=True)))

    def _solved(self, z: Float[np.ndarray, " N"]) -> Evaluation:
        torus = self.torus(z)
        image, matrices, column = self._image(torus)
        missing, square = invariance_system(torus.curve, image, matrices, self._family.wrap)
        if self._reference is not None:
            along = self._reference.tangents(np.arange(len(image)) / len(image)) / torus.curve.size / len(image)
            square[-1, :-1] = along.ravel()
            missing[-1] = np.sum(along * (self._reference.periodic - torus.curve.periodic) / torus.curve.size)
        size = np.append(np.tile(torus.curve.size, len(image)), 1.0)
        whole = np.concatenate([square, np.append((column / torus.curve.size).ravel(), 0.0)[:, None]], axis=1)
        whole *= self.unit / np.append(size, 1.0)
        residual = missing[:-1] * size[:-1] / np.tile(self._family.size, len(image))
        if not (np.isfinite(whole).all() and np.isfinite(missing).all()):
            return Evaluation(residual, matrices, np.full((2, len(z)), np.nan))
        rotated, triangle = np.linalg.qr(whole.T, mode="complete")
        square, null = triangle[:-1], rotated[:, -1]
        if np.min(np.abs(np.diagonal(square))) <= _TINY:
            return Evaluation(residual, matrices, np.full((2, len(z)), np.nan))
        least = rotated[:, :-1] @ solve_triangular(square.T, missing, lower=True)
        return Evaluation(residual, matrices, self.unit * np.stack([least, null]))

    def _image(
        self, torus: Torus
    ) -> tuple[Float[np.ndarray, "nodes d"], Float[np.ndarray, "nodes d d"], Float[np.ndarray, "nodes d"]]:
        """Pⁿ, ∂Pⁿ/∂u and ∂Pⁿ/∂λ at the nodes."""
        u = torus.curve.points
        values, matrix, column = np.full(len(u), torus.value), np.eye(u.shape[1]), np.zeros_like(u)
        for _ in range(self.iterates):
            at = self._family.period(u, values)
            assert at.by_parameter is not None
            step = np.asarray(at.monodromy)
            matrix, column = step @ matrix, (step @ column[..., None])[..., 0] + np.asarray(at.by_parameter)
            u = np.asarray(at.image)
        return u, matrix, column

    def equivalents(self, z: Float[np.ndarray, "lanes N"], /) -> Iterable[Float[np.ndarray, "lanes N"]]:
        """The unknowns alone: a phase is as good as another, and curves that come back are not looked for."""
        return (z,)

    def endings(self, now: Solution, taken: Solution, /) -> tuple[dict[int, np.ndarray], np.ndarray]:
        """Curves that come to an orbit, or have passed it: beyond it there are the same again, half a turn on."""
        if np.any(self._winding):
            none = np.zeros(len(now.z), bool)
            return {}, none
        before, after = self._deviation(now.z), self._deviation(taken.z)
        with np.errstate(invalid="ignore"):
            collapsed = self.is_orbit(taken.z) | (np.sum(before * after, axis=1) <= 0.0)
        return {COLLAPSED: collapsed}, collapsed

    def is_orbit(self, z: Float[np.ndarray, "lanes N"]) -> Bool[np.ndarray, " lanes"]:
        """Return whether curves are so small that they are orbits."""
        small = np.sqrt(np.sum(self._deviation(z) ** 2, axis=1)) <= _SMALLEST
        return small & ~np.any(self._winding)

    def _deviation(self, z: Float[np.ndarray, "lanes N"]) -> Float[np.ndarray, "lanes k"]:
        """Curves less their means, in lengths."""
        points = (z / self.unit)[:, :-2].reshape(len(z), -1, len(self._winding))
        return (points - points.mean(axis=1, keepdims=True)).reshape(len(z), -1)


def natural_units(family: Family, point: HopfPoint) -> tuple[Family, float]:
    """The family in sizes of the tori that a Neimark–Sacker point begins, and their amplitude of one length.

    By the normal form it is that of the torus 0.4 of the range from the point. Sizes of orbits may be none of tori:
    an orbit may rest in coordinates that its tori move in, and may be much larger than these.
    """
    in_sizes = np.abs(point.vector) / family.size
    largest = _LARGEST / np.min(in_sizes[in_sizes > _IN_PLANE * in_sizes.max()])
    with np.errstate(divide="ignore"):
        amplitude = min(np.sqrt(_NATURAL * family.width / np.abs(point.bend)), largest)
    size = np.maximum(2.0 * np.abs(point.vector) * amplitude, family.size * min(1.0, amplitude))
    return family._replace(size=size), float(amplitude)


def strong_resonance(point: HopfPoint) -> int | None:
    """Return the number of iterates, up to four, after which a Neimark–Sacker point's multipliers are nearly one.

    There the normal form has further terms of the orders that decide on tori, and need not begin any (Kuznetsov,
    Elements of Applied Bifurcation Theory, 2004, 9.5). None at other points.
    """
    return next((q for q in range(1, 5) if abs(point.turn - round(q * point.turn) / q) < _STRONG), None)


def tori_at(family: Family, iterates: int, point: HopfPoint, steps: StepControl, most: int) -> TorusBranch | None:
    """The curve of tori that a Neimark–Sacker point begins; None where Newton confirms none near it.

    Args:
        family: the map.
        iterates: points of the orbit.
        point: the normal form there.
        steps: how the curve is followed.
        most: harmonics at most.
    """
    family, unit = natural_units(family, point)
    equations = TorusEquations(family, iterates, np.zeros(len(point.u), int), _FIRST_HARMONICS)
    for amplitude in _AMPLITUDES:
        z, none = (equations.unknowns(_small_torus(point, r)) for r in (amplitude * unit, 0.0))
        across = (z - none) / core.norm(equations.unit, z - none)[:, None]
        now = core.correct(equations, z, across, core.FINE)
        if now.converged[0] and not equations.is_orbit(now.z)[0] and family.low <= now.z[0, -1] <= family.high:
            return follow_tori(equations, now, steps, most)._replace(born=point.value)
    return None


def torus_through(family: Family, torus: Torus) -> tuple[TorusEquations, Solution] | None:
    """The torus of a map near a curve, at the same parameter; None where Newton confirms none, or has an orbit."""
    equations = TorusEquations(family, 1, torus.curve.winding, torus.curve.harmonics)
    z = equations.unknowns(torus)
    across = np.zeros_like(z)
    across[0, -1] = family.width
    now = core.correct(equations, z, across, core.FINE)
    return None if not now.converged[0] or equations.is_orbit(now.z)[0] else (equations, now)


def tori_through(equations: TorusEquations, now: Solution, steps: StepControl, most: int) -> TorusBranch:
    """The curve of tori of a map through one, from one end to the other."""
    ahead, behind = (follow_tori(equations, start, steps, most) for start in (now, now.backward()))
    return TorusBranch(1, [*behind.tori[:0:-1], *ahead.tori], (behind.ends[1], ahead.ends[1]))


def ends_at(family: Family, branch: TorusBranch, point: HopfPoint) -> bool:
    """Return whether a branch of tori has come to an orbit beside a Neimark–Sacker point."""
    if branch.ends[1] != COLLAPSED:
        return False
    family, _ = natural_units(family, point)
    last = branch.tori[-1]
    gap = family.wrap(last.curve.periodic.mean(axis=0) - point.u) / family.size
    return bool(np.hypot(np.linalg.norm(gap), (last.value - point.value) / family.width) < _BESIDE)


def is_on_branch(family: Family, branch: TorusBranch, torus: Torus) -> bool:
    """Return whether a torus is on a branch, by its place and rotation number between two points of it."""
    if branch.iterates != 1 or np.any(branch.tori[0].curve.winding != torus.curve.winding):
        return False
    value = np.array([each.value for each in branch.tori])
    numbers = np.array([_invariants(family, each) for each in branch.tori])
    if np.isfinite(branch.born):  # there the first torus is a point
        value, numbers = np.append(branch.born, value), np.concatenate([numbers[:1], numbers])
        numbers[0, 1 + len(family.size) :] = 0.0
    own = _invariants(family, torus)
    for k in np.flatnonzero((value[:-1] - torus.value) * (value[1:] - torus.value) <= 0.0).tolist():
        rise = value[k + 1] - value[k]
        between = numbers[k] + (torus.value - value[k]) / (rise or 1.0) * (numbers[k + 1] - numbers[k])
        if np.all(np.abs(own - between) <= _SAME + 0.5 * np.abs(numbers[k + 1] - numbers[k])):
            return True
    return False


def is_part(family: Family, part: TorusBranch, branch: TorusBranch) -> bool:
    """Return whether all of a branch of tori, as far as a few of them tell, is on another."""
    places = spread_indices(len(part.tori), _COMPARED)
    return part.iterates == branch.iterates and all(is_on_branch(family, branch, part.tori[k]) for k in places)


def _invariants(family: Family, torus: Torus) -> Float[np.ndarray, " 1+2d"]:
    """Invariants of a torus under changes of phase and sense: its rotation number, the mean and extent of its curve.

    Of a coordinate that winds the mean is the phase, and is left out.
    """
    periodic, turn = torus.curve.periodic / family.size, torus.curve.rotation % 1.0
    mean = np.where(torus.curve.winding != 0, 0.0, periodic.mean(axis=0))
    return np.concatenate([[min(turn, 1.0 - turn)], mean, periodic.std(axis=0)])


def follow_tori(equations: TorusEquations, start: Solution, steps: StepControl, most: int) -> TorusBranch:
    """The curve of tori from a solution in its direction, to where it ends.

    Args:
        equations: of as many harmonics as the solution has.
        start: the solution.
        steps: how long steps are, and how many there may be.
        most: harmonics at most.
    """
    path, last, tori = _path(equations, start, steps), start, [equations.torus(start.z[0])]
    while True:
        ended = path.step()
        if path.met(0):
            points = path.track(0)
            last, tori = points.take(slice(-1, None)), [*tori, *map(equations.torus, points.z)]
        end, resolved = int(path.end[0]), is_resolved(tori[-1].curve)
        if resolved and end != NO_CONVERGENCE:
            if len(ended):
                return TorusBranch(equations.iterates, tori, (START, end))
            equations = equations.after(last.z[0])
            path.move(equations, last, lambda z: z)
            continue
        if 2 * equations.harmonics > most:
            return TorusBranch(equations.iterates, tori, (START, NO_CONVERGENCE if resolved else UNRESOLVED))
        finer = equations.with_harmonics(2 * equations.harmonics)
        carry = partial(equations.carried, other=finer)
        last = core.correct(finer, carry(last.z), carry(last.way))
        if not last.converged[0]:
            return TorusBranch(equations.iterates, tori, (START, NO_CONVERGENCE))
        tori[-1] = finer.torus(last.z[0])
        if len(ended) and end != NO_CONVERGENCE:
            return TorusBranch(equations.iterates, tori, (START, end))
        if len(ended):
            path = _path(finer, last, steps)
        else:
            path.move(finer, last, carry)
        equations = finer


def _path(equations: TorusEquations, first: Solution, steps: StepControl) -> Path:
    """The path from a torus that is known."""
    path = Path(equations, first, steps)
    path.begin(np.zeros(1, int))
    path.track(0)
    return path


def _small_torus(point: HopfPoint, amplitude: float) -> Torus:
    """The torus of an amplitude beside a Neimark–Sacker point, by the normal form."""
    change = point.bend * amplitude**2
    turns = np.exp(2j * np.pi * np.arange(2 * _FIRST_HARMONICS + 1) / (2 * _FIRST_HARMONICS + 1))
    points = point.u + change * point.drift + 2.0 * amplitude * np.real(turns[:, None] * point.vector)
    return Torus(InvariantCurve(points, np.zeros(len(point.u), int), point.turn), point.value + change)
