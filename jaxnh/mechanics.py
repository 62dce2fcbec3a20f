"""Parts of mechanical systems that users put together: orientations, and bodies that roll without slipping.

    from jaxnh.mechanics import ellipsoid, rolling_body

    def system(mass=1.0, gravity=9.81):
        return rolling_body(ellipsoid((0.2, 0.03, 0.02), center=(0.0, 0.0, 0.01)), mass, INERTIA, gravity)

Vectors are tuples of numbers in the frame of the body, whose origin is the centre of mass.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp

from jaxnh.systems.state import Number, Vector
from jaxnh.systems.tracing import slope

Support = Callable[[Vector], Number]
"""Support function h of a convex body: of a direction n of any length, the largest n·x over points x of the body."""

_CYCLIC = ((0, 1, 2), (1, 2, 0), (2, 0, 1))


def cross(first: Sequence[Number], second: Sequence[Number]) -> Vector:
    """The vector product of two vectors of three components."""
    return tuple(first[j] * second[k] - first[k] * second[j] for _, j, k in _CYCLIC)


def dot(first: Sequence[Number], second: Sequence[Number]) -> Number:
    """The scalar product of two vectors."""
    return sum(x * y for x, y in zip(first, second, strict=True))


def quaternion_rates(q: Sequence[Number], w: Sequence[Number]) -> Vector:
    """Rates of the quaternion (scalar, vector) of an orientation: q̇ = q∘(0, w)/2, w the angular velocity in the body.

    The body's frame is turned by q: a vector x of the body is q∘x∘q* in space. Its length is kept; name its four
    coordinates in `norms`, so that rounding and steps do not change it either.

    Args:
        q: 4 components.
        w: 3 components, in radians a unit of time.
    """
    scalar, vector = q[0], tuple(q[1:])
    turned = cross(vector, w)
    return -0.5 * dot(vector, w), *(0.5 * (scalar * x + y) for x, y in zip(w, turned, strict=True))


def ellipsoid(semiaxes: Sequence[Number], center: Sequence[Number] = (0.0, 0.0, 0.0)) -> Support:
    """Support function of an ellipsoid along the axes of the body's frame.

    Args:
        semiaxes: its three semi-axes, in units of length.
        center: its centre, seen from the centre of mass.
    """

    def support(direction: Vector) -> Number:
        squares = sum((a * n) ** 2 for a, n in zip(semiaxes, direction, strict=True))
        return jnp.sqrt(squares) + dot(center, direction)

    return support


def contact_point(support: Support, normal: Vector) -> Vector:
    """The point at which a convex body touches a plane, seen from its centre of mass: the support function's gradient.

    Args:
        support: support function of the body.
        normal: unit vector across the plane, towards the body, 3 components.
    """
    down = tuple(-x for x in normal)
    return tuple(slope(lambda *direction: support(direction), down, i) for i in range(3))


def rolling_body(
    support: Support, mass: Number, inertia: Sequence[Sequence[Number]], gravity: Number = 9.81
) -> dict[str, Any]:
    """A convex body that rolls without slipping on a horizontal plane, as a definition that `system` returns.

    Its state is the upward vertical in the body, g1, g2, g3, a unit vector, and the angular velocity in the body, w1,
    w2, w3. The velocity V of the centre of mass follows from that of the point of contact, V + w × r = 0. Jourdain's
    principle then gives the equations of Borisov and Mamaev (Phys. Usp. 46 (2003) 393). Its integral is the `energy`;
    its outputs are the `normal_force`, of which the body lifts off where it is negative, and the `friction_ratio`, the
    coefficient of friction that rolling takes: horizontal over normal force.

    Args:
        support: support function of its surface, homogeneous of degree one, seen from the centre of mass.
        mass: its mass.
        inertia: its tensor of inertia about the centre of mass, 3 rows of 3.
        gravity: acceleration of gravity, downwards.
    """

    def T(q: Vector, u: Vector, t: Number) -> Number:
        w, velocity = u[:3], u[3:]
        return 0.5 * (dot(w, [dot(row, w) for row in inertia]) + mass * dot(velocity, velocity))

    def Q(q: Vector, u: Vector, t: Number) -> Vector:
        return 0.0, 0.0, 0.0, *(-mass * gravity * x for x in q)

    def f(q: Vector, u: Vector, t: Number) -> Vector:
        w, velocity = u[:3], u[3:]
        return tuple(x + y for x, y in zip(velocity, cross(w, contact_point(support, q)), strict=True))

    def rates(q: Vector, u: Vector, t: Number) -> Vector:
        return cross(q, u[:3])

    def energy(q: Vector, u: Vector, t: Number) -> Number:
        return T(q, u, t) + mass * gravity * support(tuple(-x for x in q))

    def normal_force(q: Vector, u: Vector, t: Number, multipliers: Vector) -> Number:
        return dot(multipliers, q)

    def friction_ratio(q: Vector, u: Vector, t: Number, multipliers: Vector) -> Number:
        normal = dot(multipliers, q)
        along = [x - normal * g for x, g in zip(multipliers, q, strict=True)]
        return jnp.sqrt(dot(along, along)) / jnp.abs(normal)

    vertical, velocities = ("g1", "g2", "g3"), ("V1", "V2", "V3")
    return {
        "T": T, "Q": Q, "f": f, "rates": rates,
        "coordinates": vertical, "quasi_velocities": ("w1", "w2", "w3", *velocities), "dependent": velocities,
        "norms": (vertical,), "structure_constants": RIGID_MOTION,
        "integrals": {"energy": energy}, "labels": _LABELS,
        "outputs": {"normal_force": normal_force, "friction_ratio": friction_ratio},
    }  # fmt: skip


_LABELS = {
    **{f"g{i}": "component of the upward vertical" for i in (1, 2, 3)},
    **{f"w{i}": "angular velocity" for i in (1, 2, 3)},
    "normal_force": "normal force",
    "friction_ratio": "horizontal over normal force",
}


def _rigid_motion() -> tuple[tuple[tuple[float, ...], ...], ...]:
    constants = [[[0.0] * 6 for _ in range(6)] for _ in range(6)]
    for i, j, k in _CYCLIC:
        for shifts in ((0, 0, 0), (0, 3, 3), (3, 0, 3)):  # turning by turning turns, turning by moving moves
            for first, second, sign in ((i, j, 1.0), (j, i, -1.0)):
                constants[first + shifts[0]][second + shifts[1]][k + shifts[2]] = sign
    return tuple(tuple(map(tuple, rows)) for rows in constants)


RIGID_MOTION = _rigid_motion()
"""Structure constants of a body's angular velocity and velocity in its own frame, three of each, in this order."""
