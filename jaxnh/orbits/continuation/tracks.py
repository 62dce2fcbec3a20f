"""Curves as the points that are known of them: states in between, distances, and curves put together from parts."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxnh.orbits.continuation.core import CurveEquations, Solution, correct, inner
from jaxnh.orbits.continuation.paths import CLOSED, MOST_POINTS, Track
from jaxnh.systems.rows import concatenate

Difference = Callable[[Float[np.ndarray, "k N"]], Float[np.ndarray, "k N"]]


class Foot(NamedTuple):
    """The place of a curve nearest to some unknowns: distance, number of the point before it, share of the chord."""

    distance: float
    place: int
    share: float


def hermite(
    z: Float[np.ndarray, "2 ... N"], way: Float[np.ndarray, "2 ... N"], share: Float[np.ndarray, ...]
) -> Float[np.ndarray, "... N"]:
    """Unknowns between two points of curves with their directions, at shares of the chord: Hermite's polynomial."""
    chord, s = z[1] - z[0], np.asarray(share)[..., None]
    length, left = np.linalg.norm(chord, axis=-1, keepdims=True), 1.0 - s
    return z[0] + s * s * (3.0 - 2.0 * s) * chord + length * (s * left**2 * way[0] - s * s * left * way[1])


def across_chord(
    z: Float[np.ndarray, "2 N"], way: Float[np.ndarray, "2 N"], share: Float[np.ndarray, " lanes"]
) -> tuple[Float[np.ndarray, "lanes N"], Float[np.ndarray, "lanes N"]]:
    """Unknowns between two points of a curve in the hyperplanes across the chord at shares of it, and its direction."""
    chord = z[1] - z[0]
    between = hermite(z[:, None], way[:, None], share)
    between += (share - (between - z[0]) @ chord / (chord @ chord))[:, None] * chord
    return between, np.tile(chord / np.linalg.norm(chord), (len(share), 1))


def nearest(
    z: Float[np.ndarray, "k N"],
    way: Float[np.ndarray, "k N"],
    at: Float[np.ndarray, " N"],
    counted: slice | Int[np.ndarray, " some"] = slice(None),
    difference: Difference = lambda gap: gap,
) -> Foot:
    """The place of a curve of points and directions that is nearest to unknowns.

    Args:
        z, way: of the curve; two equal points are one.
        at: the unknowns.
        counted: those of them that count, by default all.
        difference: of gaps between unknowns, wraps angles.
    """
    if len(z) < 2:
        return Foot(float(np.linalg.norm(difference(at - z)[:, counted], axis=1).min(initial=np.inf)), 0, 0.0)
    apart = difference(at - z[:-1])
    chord, gap = np.diff(z[:, counted], axis=0), apart[:, counted]
    share = np.sum(gap * chord, axis=1) / np.maximum(np.sum(chord**2, axis=1), np.finfo(float).tiny)
    share = np.clip(share, 0.0, 1.0)
    there = hermite(np.stack([z[:-1], z[1:]]), np.stack([way[:-1], way[1:]]), share)
    distance = np.linalg.norm((there - z[:-1] - apart)[:, counted], axis=1)
    place = int(np.argmin(distance))
    return Foot(float(distance[place]), place, float(share[place]))


def joined(equations: CurveEquations, first: Track, second: Track, near: float) -> Track | None:
    """The curve that two tracks are parts of, the first cut (`MOST_POINTS`) on the second; None where it is not.

    Args:
        equations: F, whose unknowns are in their units.
        first, second: the tracks.
        near: distance of an end of the first from the second, in lengths, below which it is on it.
    """
    ahead = _continued(equations, first, second, near)
    if ahead is not None and ahead.ends[1] == CLOSED:
        return ahead
    behind = _continued(equations, (ahead or first).backward(), second, near)
    return ahead if behind is None else behind.backward()


def _continued(equations: CurveEquations, first: Track, second: Track, near: float) -> Track | None:
    """The first track with what the second has beyond its last point; None where it is not cut there."""
    if first.ends[1] != MOST_POINTS:
        return None
    end, toward, unit = first.points.z[-1], first.points.way[-1], equations.unit
    alike = zip(equations.equivalents(second.points.z), equations.equivalents(second.points.way), strict=True)
    for z, way in alike:
        foot = nearest(z, way, end, difference=equations.difference)
        if foot.distance > near or len(z) < 2:
            continue
        gap = end - z[[foot.place]]
        z = z + (gap - equations.difference(gap))  # by whole turns of angles
        sign = 1.0 if (z[foot.place + 1] - z[foot.place]) @ toward > 0.0 else -1.0
        rest = np.arange(foot.place + 1, len(z)) if sign > 0.0 else np.arange(foot.place, -1, -1)
        beyond = inner(unit, z[rest] - end, np.tile(toward, (len(rest), 1))) > 0.0
        rest = rest if beyond[:1].all() else rest[1:]
        more = correct(equations, z[rest], sign * way[rest], tolerance=np.inf)
        return _closed(equations, first, more, near) or Track(
            concatenate([first.points, more]), (first.ends[0], second.ends[1 if sign > 0.0 else 0])
        )
    return None


def _closed(equations: CurveEquations, track: Track, more: Solution, near: float) -> Track | None:
    """The closed curve of a track cut at its beginning too, where what goes on beyond its end comes back to it."""
    if track.ends[0] != MOST_POINTS:
        return None
    last = concatenate([track.points.take(slice(-1, None)), more])
    for first in equations.equivalents(track.points.z[:1]):
        foot = nearest(last.z, last.way, first[0], difference=equations.difference)
        if foot.distance <= near:
            return Track(concatenate([track.points, more.take(slice(foot.place + 1))]), (CLOSED, CLOSED))
    return None
