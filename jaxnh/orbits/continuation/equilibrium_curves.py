"""Curves of folds and Hopf points of equilibria over two parameters, followed by arclength. Host code.

The unknowns are the equilibrium, its critical eigenvector and both parameters (Moore and Spence, SIAM J. Numer. Anal.
17 (1980) 567); of Hopf points q = a + iωb and κ = ω² (Roose and Hlaváček, SIAM J. Appl. Math. 45 (1985) 879):

    fold:  f(u; λ) = 0,  A a = 0,  |a| = 1;
    Hopf:  f(u; λ) = 0,  A b = a,  A a = −κ b,  |a|² + |b|² = 1,  c · b = 0.

These equations are regular at cusps, at Bogdanov–Takens points, where κ = 0 and a curve of Hopf points goes on as one
of neutral saddles, at zero–Hopf and at double Hopf points. Rates are in units of a frequency.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Bool, Complex, Float

from jaxnh.orbits.continuation import core, paths
from jaxnh.orbits.continuation.core import FINE, Evaluation, Solution
from jaxnh.orbits.continuation.curves import CURVE_STEPS, Curve
from jaxnh.orbits.continuation.kinds import FOLD, HOPF
from jaxnh.orbits.continuation.paths import BOGDANOV_TAKENS, StepControl, Track
from jaxnh.orbits.continuation.tracks import joined, nearest
from jaxnh.systems.chart import Wrap
from jaxnh.systems.rows import select

_REAL = 1e-6  # imaginary part of an eigenvalue, of the largest modulus
_PHASE = 2.399963229728653  # between components of c, a golden angle: planes of eigenvectors are hardly ever across it


class VectorRates(Protocol):
    """Rates (lanes, d) and derivatives in u and both parameters: theirs (lanes, d, d + 2), and those of A v."""

    def __call__(
        self,
        u: Float[np.ndarray, "lanes d"],
        values: Float[np.ndarray, "lanes 2"],
        vectors: Float[np.ndarray, "lanes m d"],
        /,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Evaluate at points and values of the parameters, a lane each."""
        ...


class MixedDerivatives(Protocol):
    """Derivatives of the rates along k directions in u and both parameters."""

    def __call__(
        self,
        u: Float[np.ndarray, "lanes d"],
        values: Float[np.ndarray, "lanes 2"],
        ways: Float[np.ndarray, "lanes k d+2"],
        /,
    ) -> Float[np.ndarray, "lanes d"]:
        """Evaluate at points and values of the parameters, a lane each."""
        ...


class FieldPlane(NamedTuple):
    """A field over a plane of two parameters, and what is large there.

    Attributes:
        rates: the field with its derivatives.
        mixed: derivatives of any order.
        wrap: of differences of coordinates.
        size: of each coordinate, (d,).
        frequency: unit of rates and frequencies, in 1/time.
        low, high: ends of the ranges of the parameters, (2,).
    """

    rates: VectorRates
    mixed: MixedDerivatives
    wrap: Wrap
    size: Float[np.ndarray, " d"]
    frequency: float
    low: Float[np.ndarray, " 2"]
    high: Float[np.ndarray, " 2"]

    @property
    def width(self) -> Float[np.ndarray, " 2"]:
        """Widths of the ranges of the parameters."""
        return self.high - self.low


class CriticalEquilibria(NamedTuple):
    """Equilibria at bifurcations, with eigenvectors in sizes.

    Attributes:
        u: (lanes, d).
        first: real part a of the eigenvector, (lanes, d).
        second: b, its imaginary part over the frequency in its unit, (lanes, d); zero of folds.
        square: κ in its unit, (lanes,); zero of folds.
        values: of both parameters, (lanes, 2).
    """

    u: Float[np.ndarray, "lanes d"]
    first: Float[np.ndarray, "lanes d"]
    second: Float[np.ndarray, "lanes d"]
    square: Float[np.ndarray, " lanes"]
    values: Float[np.ndarray, "lanes 2"]

    def frequency(self, plane: FieldPlane) -> Float[np.ndarray, " lanes"]:
        """ω, zero of folds and neutral saddles."""
        return plane.frequency * np.sqrt(np.maximum(self.square, 0.0))

    def vector(self, plane: FieldPlane) -> Complex[np.ndarray, "lanes d"]:
        """The eigenvector q in units of the coordinates, of length one in these."""
        q = plane.size * (self.first + 1j * np.sqrt(np.maximum(self.square, 0.0))[:, None] * self.second)
        return q / np.linalg.norm(q, axis=1, keepdims=True)


class EigenvectorEquations(core.DenseEquations):
    """Equilibria with a zero or imaginary eigenvalue as `core.CurveEquations`, unknowns in their units."""

    def __init__(self, plane: FieldPlane, kind: int) -> None:
        d = len(plane.size)
        self._plane, self._hopf, self._d = plane, kind == HOPF, d
        self.unit = np.ones(3 * d + 3 if self._hopf else 2 * d + 2)
        self.low, self.high = plane.low / plane.width, plane.high / plane.width
        self._phase = np.cos(_PHASE * np.arange(d))

    def join(self, at: CriticalEquilibria) -> Float[np.ndarray, "lanes N"]:
        """Unknowns of equilibria, with the length and phase of the eigenvector that the equations have."""
        plane, (a, b), square = self._plane, (at.first, at.second), at.square[:, None]
        if not self._hopf:
            a = a / np.linalg.norm(a, axis=1, keepdims=True)
            return np.concatenate([at.u / plane.size, a, at.values / plane.width], axis=1)
        turn = -(b @ self._phase / (a @ self._phase))[:, None]
        a, b = a - turn * square * b, b + turn * a
        length = np.sqrt(np.sum(a**2 + b**2, axis=1, keepdims=True))
        return np.concatenate([at.u / plane.size, a / length, b / length, square, at.values / plane.width], axis=1)

    def split(self, z: Float[np.ndarray, "lanes N"]) -> CriticalEquilibria:
        """The equilibria of unknowns."""
        d, plane = self._d, self._plane
        u, a, values = z[:, :d] * plane.size, z[:, d : 2 * d], z[:, -2:] * plane.width
        b, square = (z[:, 2 * d : 3 * d], z[:, 3 * d]) if self._hopf else (np.zeros_like(a), np.zeros(len(z)))
        return CriticalEquilibria(u, a, b, square, values)

    def evaluate(self, z: Float[np.ndarray, "lanes N"], /) -> Evaluation:
        """Residuals and derivatives in units; kept are the linearisations A in units of the coordinates and time."""
        plane, d, lanes = self._plane, self._d, len(z)
        at, size = self.split(z), self._plane.size
        parts = [at.first, at.second] if self._hopf else [at.first]
        rate, slopes, images = plane.rates(at.u, at.values, size * np.stack(parts, axis=1))
        unit = np.concatenate([size, plane.width]) / (size[:, None] * plane.frequency)
        linear, images = slopes * unit, images * unit
        rows, missing = np.zeros((lanes, z.shape[1] - 1, z.shape[1])), np.zeros((lanes, z.shape[1] - 1))
        missing[:, :d] = rate / (size * plane.frequency)
        rows[:, :d, :d], rows[:, :d, -2:] = linear[..., :d], linear[..., d:]
        end = (1 + len(parts)) * d
        for k, part in enumerate(parts):
            mine = slice((k + 1) * d, (k + 2) * d)
            missing[:, mine] = (linear[..., :d] @ part[..., None])[..., 0]
            rows[:, mine, mine], rows[:, end, mine] = linear[..., :d], part
            rows[:, mine, :d], rows[:, mine, -2:] = images[:, k, :, :d], images[:, k, :, d:]
        missing[:, end] = 0.5 * (sum(np.sum(part**2, axis=1) for part in parts) - 1.0)
        if self._hopf:
            first, second, identity = slice(d, 2 * d), slice(2 * d, 3 * d), np.eye(d)
            missing[:, first] += at.square[:, None] * at.second
            missing[:, second] -= at.first
            rows[:, first, second] += at.square[:, None, None] * identity
            rows[:, second, first] -= identity
            rows[:, first, end] = at.second
            missing[:, -1], rows[:, -1, second] = at.second @ self._phase, self._phase
        return Evaluation(missing, slopes[:, :, :d], rows)

    def difference(self, gap: Float[np.ndarray, "lanes N"], /) -> Float[np.ndarray, "lanes N"]:
        """Angles wrapped."""
        d, size = self._d, self._plane.size
        return np.concatenate([self._plane.wrap(gap[:, :d] * size) / size, gap[:, d:]], axis=1)

    def equivalents(self, z: Float[np.ndarray, "lanes N"], /) -> Iterator[Float[np.ndarray, "lanes N"]]:
        """Both signs of the eigenvector."""
        yield z
        opposite, end = z.copy(), 3 * self._d if self._hopf else 2 * self._d
        opposite[:, self._d : end] *= -1.0
        yield opposite

    def endings(
        self, now: Solution, taken: Solution, /
    ) -> tuple[dict[int, Bool[np.ndarray, " lanes"]], Bool[np.ndarray, " lanes"]]:
        """Curves of Hopf points that go on as neutral saddles: with the first of these."""
        with np.errstate(invalid="ignore"):
            passed = self.split(taken.z).square < 0.0
        return {BOGDANOV_TAKENS: passed}, np.zeros(len(passed), bool)


def critical_equilibria(
    plane: FieldPlane,
    kind: int,
    u: Float[np.ndarray, "lanes d"],
    values: Float[np.ndarray, "lanes 2"],
    blocks: Float[np.ndarray, "lanes d d"],
    other_than: Float[np.ndarray, " lanes"] | None = None,
) -> CriticalEquilibria:
    """Equilibria with the eigenvector that belongs to a kind of bifurcation, nearly: NaN where none does.

    Args:
        plane: the field.
        kind: `FOLD` or `HOPF`.
        u, values: equilibria and parameters.
        blocks: linearisations there, in units of the coordinates.
        other_than: frequencies of pairs that are not meant, as at double Hopf points.
    """
    eigenvalues, vectors = np.linalg.eig(blocks * (plane.size / plane.size[:, None]) / plane.frequency)
    row, none = np.arange(len(u)), np.zeros(len(u))
    if kind == FOLD:
        vector = np.real(vectors[row, :, np.argmin(np.abs(eigenvalues), axis=1)])
        return CriticalEquilibria(u, vector, np.zeros_like(vector), none, values)
    away, largest = np.abs(np.real(eigenvalues)), np.abs(eigenvalues).max(axis=1, keepdims=True)
    away = np.where(np.imag(eigenvalues) > _REAL * largest, away, np.inf)
    if other_than is not None:
        away[row, np.argmin(np.abs(eigenvalues - 1j * other_than[:, None] / plane.frequency), axis=1)] = np.inf
    chosen = np.argmin(away, axis=1)
    vector = np.where(np.isfinite(away[row, chosen])[:, None], vectors[row, :, chosen], np.nan)
    omega = np.abs(np.imag(eigenvalues[row, chosen]))
    with np.errstate(divide="ignore", invalid="ignore"):
        return CriticalEquilibria(u, np.real(vector), np.imag(vector) / omega[:, None], omega**2, values)


def double_zero(
    plane: FieldPlane, u: Float[np.ndarray, "1 d"], values: Float[np.ndarray, "1 2"], matrix: Float[np.ndarray, "1 d d"]
) -> CriticalEquilibria:
    """A Bogdanov–Takens point as a first Hopf point: A a = 0, A b = a."""
    scaled = matrix[0] * (plane.size / plane.size[:, None]) / plane.frequency
    left, _, right = np.linalg.svd(scaled)
    bordered = np.block([[scaled, left[:, -1:]], [right[-1:], np.zeros((1, 1))]])
    second = np.linalg.solve(bordered, np.append(right[-1], 0.0))[:-1]
    return CriticalEquilibria(u, right[-1:], second[None], np.zeros(1), values)


def follow_curves(
    plane: FieldPlane, kind: int, start: CriticalEquilibria, steps: StepControl = CURVE_STEPS
) -> list[Curve | None]:
    """The curves through equilibria at bifurcations, each from end to end; None where Newton does not confirm one.

    Args:
        plane: the field.
        kind: `FOLD` or `HOPF`.
        start: equilibria, nearly.
        steps: how curves are followed.
    """
    equations = EigenvectorEquations(plane, kind)
    curves = list[Curve | None]([None] * len(start.u))
    finite = np.flatnonzero(np.isfinite(start.first).all(axis=1))
    at = core.correct(equations, equations.join(select(start, finite)), None, FINE)
    confirmed = finite[at.converged]
    if not len(confirmed):
        return curves
    for k, track in paths.follow_both_ways(equations, at.take(at.converged), steps).items():
        curves[confirmed[k]] = curve_of(plane, kind, track.points, track.ends)
    return curves


def curve_of(plane: FieldPlane, kind: int, track: Solution, ends: tuple[int, int]) -> Curve:
    """The curve of solutions of `EigenvectorEquations`; its multipliers are eigenvalues, largest real part first."""
    at = EigenvectorEquations(plane, kind).split(track.z)
    values = np.linalg.eigvals(track.blocks).astype(complex)
    order = np.lexsort((np.imag(values), -np.real(values)), axis=-1)
    values = np.take_along_axis(values, order, axis=-1)
    return Curve(kind, at.u[:, None], at.values, track, values, ends, equilibria=True)


def join_curves(plane: FieldPlane, first: Curve, second: Curve, near: float) -> Curve | None:
    """The curve that two are parts of, the first of them cut on the second (`tracks.joined`); None where it is not."""
    if first.kind != second.kind:
        return None
    equations = EigenvectorEquations(plane, first.kind)
    track = joined(equations, Track(first.track, first.ends), Track(second.track, second.ends), near)
    return None if track is None else curve_of(plane, first.kind, track.points, track.ends)


def passes(plane: FieldPlane, curves: Sequence[Curve], kind: int, at: CriticalEquilibria, near: float) -> bool:
    """Return whether one of the curves of a kind goes through an equilibrium with its frequency, within a distance."""
    equations, d = EigenvectorEquations(plane, kind), len(plane.size)
    keep = np.r_[np.arange(d), np.arange(-3 if kind == HOPF else -2, 0)]
    [z] = equations.join(at)
    tracks = [curve.track for curve in curves if curve.kind == kind]
    return any(nearest(track.z, track.way, z, keep, equations.difference).distance <= near for track in tracks)
