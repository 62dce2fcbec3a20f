"""Reversals: involutions R of state and time, (y, t) -> (R y, t0 - t), that take motions of a flow to motions.

A flow ẏ = f(y, t) is reversible under R where DR f(y, t) = −f(R y, t0 − t) (Roberts and Quispel, Phys. Rep. 216
(1992) 63). A system says R as signs of its coordinates, {"x": -1.0, "time": t0}, as a function of the state, or as a
pair of the function and t0. Of mechanics signs and functions are those of positions: velocities follow, with the
opposite sign. Quasi-velocities have signs of their own, as they may be of either kind.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxnh.exceptions import InputError
from jaxnh.systems.chart import wrap_angle
from jaxnh.systems.definition import DefinedFlow
from jaxnh.systems.first_order import PointFlow
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.lagrangian import Lagrangian
from jaxnh.systems.level import off_level
from jaxnh.systems.state import Number, State, Vector, error_components
from jaxnh.systems.user_functions import COMPILED_FOR_ONE_CALL, components_of, pointwise

EXACT = 1e-9
"""Largest violation of an identity of the field, relative to the largest rate, that rounding is taken for."""

_PROBES = 24  # random states and times at which the field is held against that of the images
_MOST_SIGNS = 8  # coordinates of which all changes of signs are tried
_INSTANTS = 8  # parts of a period that t0 is looked for among


class Reversal(NamedTuple):
    """An involution of state and time.

    Attributes:
        signs: of the coordinates, or where velocities follow from them of positions; None where the system's own
            function says the image.
        instant: t0, in the units of t; 0 without a clock.
    """

    signs: Vector | None
    instant: Number


class Probe(NamedTuple):
    """Both sides of the identities of a reversal at one state; numbers of a state in the order of its components.

    Attributes:
        t: time.
        state: y.
        image_of_rate: DR f(y, t).
        rate_of_image: f(R y, t0 − t).
        gap: largest violation of DR f + f(R y, t0 − t) = 0.
        strayed: largest violation of R R y = y and of the constraints at R y, t0 − t.
    """

    t: Number
    state: Array
    image_of_rate: Array
    rate_of_image: Array
    gap: Array
    strayed: Array


def _maps_all(flow: Flow) -> bool:
    """Return whether signs and images are those of all coordinates, and not of positions whose velocities follow."""
    return isinstance(flow, PointFlow) or (isinstance(flow, Lagrangian) and flow.quasi is not None)


def signed_names(flow: Flow) -> tuple[str, ...]:
    """Names of the coordinates that signs are given for: where velocities follow from them those of positions."""
    return flow.coordinates if _maps_all(flow) else flow.coordinates[::2]


def component_names(flow: Flow) -> tuple[str, ...]:
    """Names of the components of a state, in their order."""
    return flow.coordinates if _maps_all(flow) else (*flow.coordinates[::2], *flow.coordinates[1::2])


def declared_reversal(flow: Flow) -> Reversal | None:
    """Return the reversal that a system says; None where it says none.

    Raises:
        InputError: what it says is no reversal.
    """
    said = flow.reversal({})
    if said is None:
        return None
    if isinstance(said, Mapping):
        return _reversal_of_signs(flow, said)
    image, instant = said if isinstance(said, tuple | list) and len(said) == 2 else (said, 0.0)
    if not callable(image):
        raise InputError(
            'reversal must be signs of coordinates, as {"x": -1, "time": 0.0}, a function of the state, or '
            "(function, time)"
        )
    return Reversal(None, _checked_instant(flow, instant))


def _reversal_of_signs(flow: Flow, said: Mapping[str, Any]) -> Reversal:
    names = signed_names(flow)
    for name, sign in said.items():
        if name == "time":
            continue
        if name not in names:
            raise InputError(f"reversal has {name!r}; known are {', '.join(names)} and time")
        if sign not in (-1, 1):
            raise InputError(
                f"reversal of {name} must be 1 or -1, not {sign}; a function of the state says what is no sign"
            )
    return Reversal(tuple(float(said.get(name, 1.0)) for name in names), _checked_instant(flow, said.get("time", 0.0)))


def _checked_instant(flow: Flow, instant: Any) -> float:
    number = np.asarray(instant)
    if number.shape or number.dtype.kind not in "fiu" or not np.isfinite(number):
        raise InputError(f"the time of a reversal must be a number t0, for t -> t0 - t, not {instant!r}")
    return 0.0 if flow.autonomous else float(instant) % flow.period


def reverse(flow: Flow, signs: Vector | None, y: State, p: Parameters) -> State:
    """Return R y of a state; components () each."""
    image = _signed(signs) if signs is not None else _image_of(flow, p)
    parts = jax.tree.leaves(error_components(y))
    others = jax.tree.leaves(y)[len(parts) :]
    if _maps_all(flow):
        made = _filled(image(tuple(parts)), parts)
    else:
        q, v = tuple(parts[: len(parts) // 2]), tuple(parts[len(parts) // 2 :])
        at, rate = jax.jvp(lambda q: _filled(image(q), q), (q,), (v,))
        made = (*at, *(-x for x in rate))
    return jax.tree.unflatten(jax.tree.structure(y), [*made, *others])


def _signed(signs: Vector) -> Callable[[Vector], Vector]:
    return lambda x: tuple(sign * each for sign, each in zip(signs, x, strict=True))


def _image_of(flow: Flow, p: Parameters) -> Callable[[Vector], Vector]:
    said = flow.reversal(p)
    return pointwise(components_of(said if callable(said) else said[0]))


def _filled(image: Vector, like: Any) -> Vector:
    return tuple(jnp.asarray(x, float) + jnp.zeros_like(like[0]) for x in image)


def probe(flow: Flow, reversal: Reversal, u: Array, t: Number, p: Parameters) -> Probe:
    """Return both sides of the identities at section coordinates u (d,) and a time, brought to the constraints."""
    flow, (signs, instant) = off_level(flow), reversal

    def image_of(y: State) -> State:
        return reverse(flow, signs, y, p)

    y = flow.nearest(flow.chart.state(u), p, t)
    image, moved = jax.jvp(image_of, (y,), (flow.rhs(t, y, p),))
    later = flow.rhs(instant - t, image, p)
    state, image_of_rate, rate_of_image, twice, once, kept = (
        jnp.stack(jax.tree.leaves(error_components(each)))
        for each in (y, moved, later, image_of(image), image, flow.project(instant - t, image, p))
    )
    back = jnp.where(_angles(flow), wrap_angle(twice - state), twice - state)
    strayed = jnp.maximum(jnp.max(jnp.abs(back)), jnp.max(jnp.abs(kept - once)))
    gap = jnp.max(jnp.abs(image_of_rate + rate_of_image))
    return Probe(t + jnp.zeros(()), state, image_of_rate, rate_of_image, gap, strayed)


def _angles(flow: Flow) -> np.ndarray:
    """Flag the components of a state that are angles."""
    angles = flow.angles if isinstance(flow, DefinedFlow) else ()
    return np.array([*angles, *[False] * (len(component_names(flow)) - len(angles))])


def random_places(flow: Flow) -> tuple[np.ndarray, np.ndarray]:
    """Return section coordinates (probes, d) and times (probes,) at random."""
    draws = np.random.default_rng(0)
    u = draws.uniform(-1.0, 1.0, (_PROBES, flow.chart.dimension)) * flow.chart.scales(1.0)
    return u, np.zeros(_PROBES) if flow.autonomous else draws.uniform(0.0, flow.period, _PROBES)


def violation(flow: Flow, reversal: Reversal, places: tuple[ArrayLike, ArrayLike], p: Parameters) -> Array:
    """Return the largest violation of the identities over places, relative to the rates; inf where few are finite."""
    return _probed(flow, reversal, places, p)[1]


def _probed(flow: Flow, reversal: Reversal, places: tuple[ArrayLike, ArrayLike], p: Parameters) -> tuple[Probe, Array]:
    """Return the probes at all places, and the largest violation."""
    probes = jax.vmap(lambda u, t: probe(flow, reversal, u, t, p))(*places)
    fine = jnp.isfinite(probes.gap + probes.strayed)
    largest = jnp.max(jnp.where(fine[:, None], jnp.abs(probes.image_of_rate), 0.0))
    gap = jnp.max(jnp.where(fine, probes.gap, 0.0)) / jnp.where(largest > 0.0, largest, 1.0)
    worst = jnp.maximum(gap, jnp.max(jnp.where(fine, probes.strayed, 0.0)))
    return probes, jnp.where(jnp.sum(fine) >= _PROBES // 2, worst, jnp.inf)


def violations(flow: Flow, reversals: Reversal, p: Parameters) -> Float[np.ndarray, " reversals"]:
    """Return the largest violation of each of some reversals, whose signs and instants are (reversals,) each."""
    return np.asarray(_probe_each(flow, reversals, random_places(flow), dict(p))[1])


_probe_each = jax.jit(jax.vmap(_probed, in_axes=(None, 0, None, None)), compiler_options=COMPILED_FOR_ONE_CALL)


def sign_changes(flow: Flow) -> Reversal | None:
    """Return all changes of signs of coordinates, at all instants, as one record; None where these are too many.

    Instants without a clock are zero alone, with one the multiples of an eighth of the period.
    """
    names = signed_names(flow)
    if len(names) > _MOST_SIGNS:
        return None
    parts = 1 if flow.autonomous else _INSTANTS
    signs = np.array(list(itertools.product((1.0, -1.0), repeat=len(names))))
    signs = signs[np.argsort(np.sum(signs < 0, axis=1), kind="stable")]
    columns = np.repeat(signs, parts, axis=0).T
    return Reversal(tuple(columns), np.tile(np.arange(parts) * flow.period / parts, len(signs)))


def describe_reversal(flow: Flow, reversal: Reversal) -> str:
    """Return a reversal in words."""
    time = "-t" if not reversal.instant else f"{float(reversal.instant):.6g} - t"
    if reversal.signs is None:
        return f"the image that the system says, t -> {time}"
    names = [name for name, sign in zip(signed_names(flow), reversal.signs, strict=True) if sign < 0]
    velocities = [] if _maps_all(flow) else ["velocities opposite"]
    moved = [*(f"{name} -> -{name}" for name in names), *velocities]
    return ", ".join([*moved, f"t -> {time}"])


def describe_violation(flow: Flow, reversals: Reversal, number: int, p: Parameters) -> str:
    """Return the place where one of some reversals, as of `violations`, fails most, and both values there."""
    of_each, _ = _probe_each(flow, reversals, random_places(flow), dict(p))
    probes = jax.tree.map(lambda leaf: np.asarray(leaf)[number], of_each)
    worst = np.where(np.isfinite(probes.gap + probes.strayed), probes.gap + probes.strayed, -1.0)
    at = int(np.argmax(worst))
    state = jax.tree.map(lambda leaf: leaf[at], probes)
    if not worst[at] >= 0.0:
        return "the field is finite at none of some random states"
    names = component_names(flow)
    place = ", ".join(f"{name} = {x:.4g}" for name, x in zip(names, state.state, strict=True))
    time = "" if flow.autonomous else f", t = {state.t:.4g}"
    if state.gap <= EXACT * max(np.abs(state.image_of_rate).max(), 1e-300):
        strayed = f"{state.strayed:.3g}"
        return f"at {place}{time} the image of the image, or the constraint at the image, is another by {strayed}"
    k = int(np.argmax(np.abs(state.image_of_rate + state.rate_of_image)))
    return (
        f"at {place}{time} the image of the rate of {names[k]} is {state.image_of_rate[k]:.9g} and the rate at the "
        f"image {state.rate_of_image[k]:.9g}; one should be the opposite of the other"
    )
