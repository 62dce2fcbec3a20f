"""Rounding on a motion: whether an error is nothing else, and which coordinate's last digit a map enlarges most."""

from __future__ import annotations

import math
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxnh.engine.accuracy.sample_maps import Image, SampleMaps, Samples, differences, gaps_between, image_of
from jaxnh.engine.accuracy.sizes import coordinate_names

_NEIGHBOURS = 4  # numbers of steps, one after the other, whose maps differ by rounding where steps are enough
_FALLS = 8.0  # times by which what steps of a high order leave falls, at least, with twice of them; rounding does not
_SHARE = 0.05  # of an error, that neighbours differ by where it is rounding


class LastDigit(NamedTuple):
    """The coordinate whose last digit a map enlarges most.

    Attributes:
        name, value: of the coordinate.
        digit: its last digit.
        change: what this changes after the map, in units of the sizes.
    """

    name: str
    value: float
    digit: float
    change: float


def is_rounding(maps: SampleMaps, sample: Samples, sizes: Float[np.ndarray, " components"], error: float) -> bool:
    """Return whether the error of one sample is rounding: another step changes as much, and of twice the steps too.

    Between neighbouring numbers of steps truncation differs by a small share of itself, which falls with more steps.
    """
    most = maps.scheme.reference.most_steps(maps.tried)
    few, many = (_spread(maps, sample, sizes, max(1, steps)) for steps in (most // 2, most - _NEIGHBOURS))
    return many > few / _FALLS and max(few, many) > _SHARE * error


def last_digit(maps: SampleMaps, sample: Samples, sizes: Float[np.ndarray, " components"]) -> LastDigit:
    """Change the last digit of each coordinate of one sample, and return the one whose change grows most."""
    steps = max(1, maps.scheme.reference.most_steps(maps.tried) // 2)
    leaves, structure = jax.tree.flatten(sample.states)
    names = coordinate_names(maps.flow)
    image = _image(maps, sample, steps)
    changes = []
    for i in range(len(names)):
        moved = [np.nextafter(leaf, np.inf) if i == j else leaf for j, leaf in enumerate(leaves)]
        other = _image(maps, sample._replace(states=jax.tree.unflatten(structure, moved)), steps)
        gap = float(gaps_between(differences(other, image), sizes)[0])
        changes.append(gap if math.isfinite(gap) else 0.0)
    worst = int(np.argmax(changes))
    value = float(image_of(sample.states)[worst][0])
    return LastDigit(names[worst], value, float(np.spacing(abs(value))), changes[worst])


def _spread(maps: SampleMaps, sample: Samples, sizes: Float[np.ndarray, " components"], steps: int) -> float:
    """Distance between the images under maps of neighbouring numbers of steps."""
    images = [_image(maps, sample, steps + i) for i in range(_NEIGHBOURS)]
    return max(float(gaps_between(differences(images[0], image), sizes)[0]) for image in images[1:])


def _image(maps: SampleMaps, sample: Samples, steps: int) -> Image:
    return maps.image(maps.of(maps.scheme.reference, steps, compensated=True), sample)
