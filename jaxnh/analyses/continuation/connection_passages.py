"""Passages of saddles by paths, and the sides on which they pass. Host code.

A path passes a saddle where it is nearest to it in the coordinates of the saddle's eigenvectors. The side is that of
the one direction in which paths leave the saddle.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.orbits.collocation.homoclinic import SaddlePoint
from jaxnh.systems.chart import Wrap

FARTHEST = 100.0
"""Sizes: paths further out leave all bounds."""

_LEAVES = 0.5  # of the distance beyond all bounds that is along the direction of the side, at least
_SHARE = 0.1  # of the largest component of a direction, whose first component beyond is positive


class SaddlePassage(NamedTuple):
    """A passage of a saddle.

    Attributes:
        place: number of the state.
        side: of the saddle, −1 or 1; 0 where a path leaves all bounds on none.
        distance: part of the largest one so far.
    """

    place: int
    side: float
    distance: float


class PassageView(NamedTuple):
    """How passages are seen.

    Attributes:
        wrap: brings the angles of differences into their range.
        size: of the motion in each coordinate.
        backward: whether paths go back in time, and leave a saddle by its stable direction.
        pulses: passages that are looked at, at most.
    """

    wrap: Wrap
    size: Float[np.ndarray, " d"]
    backward: bool
    pulses: int


def leading_directions(
    saddles: Sequence[SaddlePoint], backward: bool, before: Float[np.ndarray, " d"] | None = None
) -> list[Float[np.ndarray, " d"]]:
    """The directions that grow fastest at saddles one after the other, back in time or ahead, of length one.

    Each is near the one before it and not opposite, as eigenvectors come with either sign. The first is so near another
    one, or has a positive first component that is not small.
    """
    directions = list[np.ndarray]()
    for saddle in saddles:
        values, vectors = np.linalg.eig(saddle.jacobian)
        vector = np.real(vectors[:, _leading(values, backward)])
        vector = vector / np.linalg.norm(vector)
        last = directions[-1] if directions else before
        if last is None:
            last = np.eye(len(vector))[int(np.argmax(np.abs(vector) > _SHARE * np.abs(vector).max()))]
        directions.append(vector if vector @ last >= 0.0 else -vector)
    return directions


def passages_of_paths(
    view: PassageView,
    paths: Iterable[Float[np.ndarray, "count d"]],
    saddles: Sequence[SaddlePoint | None],
    passed: float,
) -> list[list[SaddlePassage]]:
    """The passages of paths by the saddles of each, at values of a parameter one after the other; none where none is.

    Args:
        view: how they are seen.
        paths: states.
        saddles: those passed.
        passed: part of the largest distance so far, below which a passage is one.
    """
    directions = iter(leading_directions([saddle for saddle in saddles if saddle is not None], view.backward))
    return [
        [] if saddle is None else _passages(view, path, saddle, next(directions), passed)
        for path, saddle in zip(paths, saddles, strict=True)
    ]


def first_difference(first: list[SaddlePassage], second: list[SaddlePassage]) -> int | None:
    """Number of the first passage that is on different sides, None where there is none."""
    for k, (a, b) in enumerate(zip(first, second, strict=False)):
        if a.side != b.side:
            return k if a.side * b.side else None
    return None


def _leading(values: np.ndarray, backward: bool) -> int:
    return int(np.argmin(np.real(values)) if backward else np.argmax(np.real(values)))


def _passages(
    view: PassageView,
    path: Float[np.ndarray, "count d"],
    saddle: SaddlePoint,
    direction: Float[np.ndarray, " d"],
    passed: float,
) -> list[SaddlePassage]:
    """The places where a path is nearest to a saddle, and the sides: positive in the direction, an eigenvector.

    A path that leaves all bounds is on a side there too, as far from the saddle as it has been.
    """
    values, vectors = np.linalg.eig(saddle.jacobian)
    real, leaving = np.where(np.imag(values) < 0.0, np.imag(vectors), np.real(vectors)), _leading(values, view.backward)
    real[:, leaving] = direction
    gaps = view.wrap(path - saddle.state) / view.size
    with np.errstate(invalid="ignore", over="ignore"):
        away = ~(np.abs(gaps).max(axis=1) <= FARTHEST)
    inside = int(np.argmax(away)) if away.any() else len(path)
    shares = np.linalg.solve(real / np.linalg.norm(real, axis=0), gaps[:inside].T).T
    distance = np.linalg.norm(shares, axis=1)
    if len(distance) < 3:
        return []
    largest = np.maximum.accumulate(distance)
    least = (distance[1:-1] <= distance[:-2]) & (distance[1:-1] < distance[2:])
    least &= distance[1:-1] < passed * largest[1:-1]
    places = [*(1 + np.flatnonzero(least)).tolist(), *([inside - 1] if away.any() else [])]
    sides = np.sign(shares[:, leaving])
    if away.any() and abs(shares[-1, leaving]) < _LEAVES * distance[-1]:
        sides[-1] = 0.0  # on none
    return [SaddlePassage(k, float(sides[k]), float(distance[k] / largest[k])) for k in places[: view.pulses]]
