"""Probes of the surfaces of a field: whether its branches differ there, and whether they push motions towards it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxnh.systems.user_functions import COMPILED_FOR_ONE_CALL, pointwise

_PROBES = 16  # random states at a time, for each surface
_ROUNDS = 4  # of them, where a surface shows no part in the field: of its states a quarter may
_NEWTON_STEPS = 40  # to a surface
_BESIDE = 0.01  # so far from it branches are compared
_ALIKE = 1e-9  # of their size: the difference of two branches that are one function


class SeenSurfaces(NamedTuple):
    """Findings of probes of surfaces, each (surfaces,).

    Attributes:
        part: whether a surface has a part in the field, which is not one function on both sides; or is not reached.
        attracts: whether motions may slide along it, as the field pushes towards it from both sides.
        pushes: whether the field jumps there by what moves the surface's own coordinates.
        sides: the side of it that most states are on; of a surface that is touched alone, all of them.
    """

    part: np.ndarray
    attracts: np.ndarray
    pushes: np.ndarray
    sides: np.ndarray


def probe_field(
    heights: Callable[..., tuple[Any, ...]],
    rates: Callable[..., Any],
    parameters: Mapping[str, float],
    dimension: int,
    count: int,
) -> SeenSurfaces:
    """Probe a field at all of its surfaces.

    Random states and times go to each surface by Newton, half of them in units drawn at random, as coordinates may have
    any. A little beside it, on either side, the field is compared with that of the other side. A surface that is
    touched alone, as r = 0, has no part, nor has one beyond which the field of a side is not defined, as of √max(x, 0);
    one that is not reached, or beside which nothing is finite, has. Surfaces where none is seen are probed anew: of
    five numbers two that are equal are the least of all in a quarter of all states.

    Args:
        heights: (parameters, y, t) to the heights above all surfaces.
        rates: (parameters, y, t, sides) to the rates by a branch.
        parameters: their defaults, near which branches are compared.
        dimension: number of coordinates.
        count: number of surfaces.
    """
    draws, shape = np.random.default_rng(0), (_PROBES, count)
    sloping = jax.jit(_with_slopes(heights), compiler_options=COMPILED_FOR_ONE_CALL)
    branch = jax.jit(
        pointwise(lambda p, z, sides: list(rates(p, z[:-1], z[-1], sides))), compiler_options=COMPILED_FOR_ONE_CALL
    )
    (reached, *seen), above = np.zeros((4, count), bool), np.zeros(count)
    for _ in range(_ROUNDS):
        p = {
            name: value + (0.1 * abs(value) + 0.1) * draws.uniform(-1.0, 1.0, shape)
            for name, value in parameters.items()
        }
        z = draws.uniform(-2.0, 2.0, (dimension + 1, *shape))
        units = 10.0 ** draws.uniform(-6.0, 6.0, z.shape)
        units[:, ::2] = 1.0
        above += np.sum(np.asarray(sloping(p, tuple(z))[0]) >= 0.0, axis=(1, 2)) - 0.5 * z[0].size
        there, *more = _probe_surfaces(
            lambda z, p=p: sloping(p, tuple(z)), lambda z, side, p=p: branch(p, z, side), z, units
        )
        unknown, reached = ~seen[0], reached | there
        seen = [before | (other & unknown) for before, other in zip(seen, more, strict=True)]
        if np.all(seen[0] | ~reached):
            break
    differs, attracts, pushes = seen
    return SeenSurfaces(differs | ~reached, attracts, pushes, np.where(above >= 0.0, 1.0, -1.0))


def _with_slopes(heights: Callable[..., tuple[Any, ...]]) -> Callable[..., tuple[Any, list[Any]]]:
    """Heights above all surfaces at (y, t) of any shape, and their derivatives in each of these numbers."""

    def of_one(p: Mapping[str, Any], z: Any) -> tuple[Any, Any]:
        above, change = jax.linearize(lambda z: jnp.stack(heights(p, tuple(z[:-1]), z[-1])), z)
        return above, jax.vmap(change)(jnp.eye(len(z)))

    def sloping(p: Mapping[str, Any], z: tuple[Any, ...]) -> tuple[Any, list[Any]]:
        shape = jnp.shape(z[0])
        numbers = {name: jnp.ravel(value) for name, value in p.items()}
        height, slopes = jax.vmap(of_one)(numbers, jnp.stack([jnp.ravel(x) for x in z], axis=-1))
        return height.T.reshape(-1, *shape), [slopes[:, j].T.reshape(-1, *shape) for j in range(len(z))]

    return sloping


def _probe_surfaces(
    heights: Callable[[np.ndarray], tuple[Any, list[Any]]],
    rates: Callable[[tuple[Any, ...], tuple[Any, ...]], list[Any]],
    z: np.ndarray,
    units: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return which surfaces are reached, have a part there, may be slid along, and push, (surfaces,).

    Args:
        heights: of states and times, above all surfaces, and their slopes.
        rates: of states and times, by sides.
        z: states and times that go to the surfaces, (d + 1, probes, surfaces).
        units: of them, in which each goes the shortest way.
    """
    each = np.arange(z.shape[-1])

    def above(z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Heights (surfaces, probes, surfaces); that above the surface that is gone to, and its slopes."""
        height, slopes = heights(z)
        height, slopes = np.asarray(height), np.stack([np.asarray(slope)[each, :, each].T for slope in slopes])
        return height, height[each, :, each].T, slopes

    for _ in range(_NEWTON_STEPS):
        _, height, slopes = above(z)
        way = slopes * units**2
        z = z - height * way / np.maximum(np.sum(slopes * way, axis=0), 1e-300)
    _, height, slopes = above(z)
    reached = np.abs(height) < _ALIKE
    normal = _BESIDE * slopes / np.sqrt(np.maximum(np.sum(slopes**2, axis=0), 1e-300))

    def branches(z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The side of a surface that is gone to; the field of that side and of the other, (d, probes, surfaces)."""
        own = np.where(above(z)[0] >= 0.0, 1.0, -1.0)
        other = own * np.where(each[:, None] == each, -1.0, 1.0)[:, None, :]
        first, second = (np.stack(np.broadcast_arrays(*rates(tuple(z), tuple(side)))) for side in (own, other))
        return own[each, :, each].T, first, second

    below, on, upon = (branches(z + shift * normal) for shift in (-1.0, 0.0, 1.0))
    differs = _differ(*below[1:]) | _differ(*upon[1:])
    gain = on[0] * np.sum(slopes[:-1] * (on[1] - on[2]), axis=0)  # of the height's rate, from below to above
    size = np.sum(np.abs(slopes[:-1]) * np.maximum(np.abs(on[1]), np.abs(on[2])), axis=0)
    push = np.sum(np.abs(slopes[:-1] * (on[1] - on[2])), axis=0)
    seen = below[0] != upon[0], gain < -_ALIKE * size, push > _ALIKE * size
    defined, beyond = (np.all(np.isfinite(below[k]) & np.isfinite(upon[k]), axis=0) for k in (1, 2))
    ends = np.any(reached & defined, axis=0) & ~np.any(reached & defined & beyond, axis=0)
    return (
        np.any(reached, axis=0),
        np.any(reached & seen[0] & differs, axis=0) & ~ends,
        *(np.any(reached & each, axis=0) for each in seen[1:]),
    )


def _differ(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return whether two fields (components, ...) differ, or none of them is finite."""
    finite = np.isfinite(first) & np.isfinite(second)
    size = np.max(np.where(finite, np.maximum(np.abs(first), np.abs(second)), 0.0), axis=0)
    return np.any(np.where(finite, np.abs(first - second), np.inf) > _ALIKE * size, axis=0)
