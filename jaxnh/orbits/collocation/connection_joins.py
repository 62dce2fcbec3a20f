"""Curves of connecting orbits compared: whether an orbit is on one, and one curve of two that overlap. Host code."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.orbits.collocation.connection_meshes import Connection, with_own_saddles
from jaxnh.orbits.collocation.connections import ConnectionCurve, Stretch, reversed_stretch
from jaxnh.orbits.collocation.equations import Problem

_NEAR = 0.1  # sizes and widths: an orbit this near to a chord may be on the curve
_SAME = 1e-2  # likewise, of the orbit that Newton comes to on the curve beside it: boxes are those of points of a mesh
_BEYOND = 1e-4  # widths: an orbit further beyond the end of a curve continues it
_CHORDS = 4  # of those that may be it, at most: next to a point there are two, and as many of a part of another shape
_LENGTHS = 0.1  # of the length of the path: an orbit of another number of pulses has another one


class _Place(NamedTuple):
    """A place on a curve: the stretch, the point before, and the share of the way to the next."""

    stretch: int
    point: int
    share: float


def is_on_curve(problem: Problem, curve: ConnectionCurve, orbit: Connection) -> bool:
    """Return whether an orbit is on a curve."""
    return _place(problem, curve, orbit) is not None


def join_connections(problem: Problem, curve: ConnectionCurve, other: ConnectionCurve) -> ConnectionCurve | None:
    """The curve of two that overlap, as where one or both are cut; None where they do not."""
    if not (curve.stretches and other.stretches):
        return None if curve.stretches else other
    first, last = (_place(problem, other, point) for point in _ends(curve))
    if first is not None and last is not None:
        return other
    start, end = (_place(problem, curve, point) for point in _ends(other))
    if start is not None and end is not None:
        return curve
    if (first is None) == (last is None) or (start is None) == (end is None):
        return None
    curve, other = curve if first is None else _reversed(curve), other if end is None else _reversed(other)
    place = _place(problem, other, _ends(curve)[1])
    if place is None:
        return None
    return ConnectionCurve(
        [*curve.stretches, *_from_place(other, place, _ends(curve)[1])], (curve.ends[0], other.ends[1])
    )


def _ends(curve: ConnectionCurve) -> tuple[Connection, Connection]:
    return curve.stretches[0].points[0], curve.stretches[-1].points[-1]


def _reversed(curve: ConnectionCurve) -> ConnectionCurve:
    first, last = curve.ends
    return ConnectionCurve([reversed_stretch(stretch) for stretch in curve.stretches[::-1]], (last, first))


def _from_place(curve: ConnectionCurve, place: _Place, orbit: Connection) -> list[Stretch]:
    """The stretches from an orbit on a curve to the end of that."""
    cut, (_, point, share) = curve.stretches[place.stretch], place

    def between(number: int, rest: float) -> Connection | None:
        return cut.between(point + number, rest if number else share + rest * (1.0 - share))

    first = with_own_saddles(cut.problem, orbit)
    return [Stretch(cut.problem, [first, *cut.points[point + 1 :]], between), *curve.stretches[place.stretch + 1 :]]


def _place(problem: Problem, curve: ConnectionCurve, orbit: Connection) -> _Place | None:
    """The place of an orbit on a curve, None where it is on none: a chord beside it, and by Newton the orbit there.

    Chords are taken by their distances in the parameters, those of a similar orbit alone: boxes say no more than that
    one is similar.
    """
    values, shape, near = (
        orbit.values / problem.widths,
        _shape(problem, orbit),
        list[tuple[float, _Place, np.ndarray]](),
    )
    for number, stretch in enumerate(curve.stretches):
        chain = np.array([point.values for point in stretch.points]) / problem.widths
        shapes = [_shape(problem, point) for point in stretch.points]
        for k, chord in enumerate(np.diff(chain, axis=0)):
            gap = values - chain[k]
            share = float(np.clip(gap @ chord / max(chord @ chord, 1e-300), 0.0, 1.0))
            between = (1.0 - share) * shapes[k] + share * shapes[k + 1]
            away = float(np.linalg.norm(gap - share * chord))
            if max(away, float(np.abs(between - shape).max())) <= _NEAR:
                near.append((away, _Place(number, k, share), chord))
    near.sort(key=lambda each: each[0])
    return next((place for _, place, chord in near[:_CHORDS] if _is_at(problem, curve, place, chord, orbit)), None)


def _is_at(
    problem: Problem, curve: ConnectionCurve, place: _Place, chord: Float[np.ndarray, " 2"], orbit: Connection
) -> bool:
    """Return whether Newton comes to an orbit at a place on a chord of a curve, or next to it along the curve."""
    there = curve.stretches[place.stretch].between(place.point, place.share)
    if there is None:
        return False
    gap = (orbit.values - there.values) / problem.widths
    on = place.share + gap @ chord / max(chord @ chord, 1e-300)  # along the chord
    beyond = abs(on - np.clip(on, 0.0, 1.0)) * np.linalg.norm(chord)
    across = np.linalg.norm(gap - (on - place.share) * chord)
    lengths = [_length(problem, point) for point in (there, orbit)]
    same = max(across, np.abs(_shape(problem, there) - _shape(problem, orbit)).max()) <= _SAME
    return bool(same and beyond <= _BEYOND and abs(lengths[0] - lengths[1]) <= _LENGTHS * lengths[1])


def _shape(problem: Problem, orbit: Connection) -> Float[np.ndarray, " 4d"]:
    """The box around an orbit with its saddles, and these, in sizes: how near to them it is cut says nothing of it."""
    saddles = np.stack([orbit.departure.state, orbit.arrival.state]) / problem.size
    path, d = orbit.solution.path, len(problem.size)
    states = np.concatenate([path.ends[0], path.stages[0].reshape(-1, d)])  # between two ends a box may be larger
    whole = np.concatenate([states / problem.size, saddles])
    return np.concatenate([whole.min(axis=0), whole.max(axis=0), *saddles])


def _length(problem: Problem, orbit: Connection) -> float:
    """The length of an orbit, in sizes."""
    return float(np.linalg.norm(np.diff(orbit.solution.path.ends[0] / problem.size, axis=0), axis=1).sum())
