"""Any mechanical system of T, Q and f as a flow: its lanes, its section, and its projection on the constraints.

The exact flow of the equations of motion (`jourdain`) keeps f, on the constraint and off it. A computed step leaves
f = 0 by the error of the method, and `Lagrangian.project` goes back along M⁻¹ Aᵀ, which is orthogonal in the metric of
the mass.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike

from jaxnh.systems.chart import Chart, general_directions, wrap_angle
from jaxnh.systems.definition import DefinedFlow, Definition, marked
from jaxnh.systems.elimination import eliminate, is_positive_definite, largest_of
from jaxnh.systems.explicit import Explicit, all_velocities, explicit_velocities, free_accelerations
from jaxnh.systems.flow import UNSAID, Labels, Output, Parameters, Reduction, status
from jaxnh.systems.jourdain import (
    SMALLEST_PIVOT,
    Equations,
    accelerations,
    bordered_matrix,
    constraint_functions,
    constraint_slopes,
    matrices,
)
from jaxnh.systems.state import Number, Vector, error_components, masked
from jaxnh.systems.tracing import cached_by_structure

_SINGULAR, _OFF, _NOT_FINITE = 1.0, 2.0, 3.0
_PROJECTIONS = 2  # the first leaves the square of the drift, the second its cube: rounding, for any drift worth having
_APPROACHES = 12  # projections from a random state to one on f = 0
_NEARLY_LOST = 0.01  # of the smallest singular value of df/dv on a motion: steps do not follow what turns there
_LARGEST_DRIFT = 1e-9  # of f after projection, in units of |A q̇| + 1


class Motion(NamedTuple):
    """State of a lane.

    Attributes:
        q: k coordinates.
        v: k velocities q̇.
        watch: largest |f| before a projection so far, and the reason of its failure, a number of `STATUS`.
    """

    q: Vector
    v: Vector
    watch: Vector


@error_components.register
def _(y: Motion) -> tuple[Vector, Vector]:
    return y.q, y.v


@masked.register
def _(y: Motion, kept: Number) -> Motion:
    q, v = masked((y.q, y.v), kept)
    return Motion(q, v, y.watch)


class ReducedMotion(NamedTuple):
    """State that steps carry of a lane whose constraints give some of its velocities.

    Attributes:
        q: k coordinates.
        u: k − m velocities, the others being functions of them.
    """

    q: Vector
    u: Vector


class MotionChart(Chart):
    """Coordinates of a motion, those that are ignorable left out, and all its velocities.

    Attributes:
        kept: numbers of the coordinates that are not left out.
        count: number of all of them.
    """

    kept: tuple[int, ...] = eqx.field(static=True)
    count: int = eqx.field(static=True)

    def components(self, y: Motion) -> Vector:
        return *(y.q[i] for i in self.kept), *y.v

    def state(self, u: Number) -> Motion:
        """The motion with section coordinates; ignorable coordinates are zero."""
        zero = np.zeros_like(u[0]) if isinstance(u, np.ndarray) else jnp.zeros_like(u[0])
        q = [zero] * self.count
        for j, i in enumerate(self.kept):
            q[i] = u[j]
        return Motion(tuple(q), tuple(u[len(self.kept) + i] for i in range(len(q))), (zero, zero))

    def directions(self, k: int) -> tuple[Vector, ...]:
        return general_directions(self.dimension, k)


class ExplicitReduction(Reduction):
    """Coordinates and the free velocities of a motion whose constraints give the others."""

    leaves_constraints = False

    def __init__(self, flow: Lagrangian, explicit: Explicit) -> None:
        self.flow, self.explicit = flow, explicit

    def reduce(self, y: Motion) -> ReducedMotion:
        return ReducedMotion(y.q, tuple(y.v[j] for j in self.explicit.free))

    def rhs(self, t: ArrayLike, z: ReducedMotion, p: Parameters) -> ReducedMotion:
        equations = self.flow.equations(p)
        v = all_velocities(equations, self.explicit, z.q, z.u, t)
        return ReducedMotion(v, free_accelerations(equations, self.explicit, z.q, z.u, t))

    def restore(self, t: ArrayLike, z: ReducedMotion, y: Motion, p: Parameters) -> Motion:
        return Motion(z.q, all_velocities(self.flow.equations(p), self.explicit, z.q, z.u, t), y.watch)


class Lagrangian(DefinedFlow):
    """Any system of a definition's `T`, `Q` and, where it has constraints, `f`; made by `lagrangian`.

    Attributes:
        constraints: number m of constraints.
        ignorable: for each coordinate, whether nothing depends on it: such are left out of the section.
    """

    constraints: int = eqx.field(static=True)
    ignorable: tuple[bool, ...] = eqx.field(static=True)

    # ---- names

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of each coordinate and its velocity: x, x_dot, y, y_dot, …"""
        return tuple(word for name in self.names for word in (name, f"{name}_dot"))

    @property
    def labels(self) -> Labels:
        """Labels of the definition; each coordinate of the section is drawn with its velocity, then all others."""
        kinds = {name: "angle" if angle else "coordinate" for name, angle in zip(self.names, self.angles, strict=True)}
        rates = {f"{name}_dot": "velocity" for name in self.names}
        order = sorted(range(len(self.names)), key=self.ignorable.__getitem__)
        return self.labelled(kinds | rates, tuple((self.names[i], f"{self.names[i]}_dot") for i in order))

    # ---- motion

    def equations(self, p: Parameters) -> Equations:
        """T, Q and f of a lane."""
        definition = self.definition(p)
        return Equations(definition["T"], definition["Q"], definition.get("f"))

    def rhs(self, t: ArrayLike, y: Motion, p: Parameters) -> Motion:
        """Time derivative of a state; a singular matrix makes the rate of the reason not a number."""
        solved = accelerations(self.equations(p), y.q, y.v, t)
        zero = jnp.zeros_like(y.q[0])
        return Motion(y.v, solved.a, (zero, jnp.where(solved.singular, jnp.nan, zero)))

    def fault_at(self, t: ArrayLike, y: Motion, p: Parameters) -> str:
        """Return which matrix is singular at a state, and for which velocities."""
        equations, k = self.equations(p), len(y.q)
        if not bool(accelerations(equations, y.q, y.v, t).singular):
            return ""
        mass = np.array(matrices(equations, (*y.q, *y.v, t), k)[0], float)
        if np.linalg.matrix_rank(mass) == k:
            return "the constraints f are not independent: df/dv has not the full rank"
        without = [f"{name}_dot" for name, row in zip(self.names, mass, strict=True) if not row.any()]
        missing = f": T has no term with the square of {', '.join(without)}" if without else ""
        return f"the mass matrix, the second derivatives of T by the velocities, is singular{missing}"

    def near_degeneracy(self, t: ArrayLike, y: Motion, p: Parameters) -> str:
        """Describe a near loss of rank of the constraints: the smallest singular value of df/dv against its largest."""
        times = np.asarray(t, float)
        slopes = constraint_slopes(self.equations(p), (*y.q, *y.v, times), len(y.q))
        matrix = np.moveaxis(
            np.array([[np.broadcast_to(entry, times.shape) for entry in row] for row in slopes]), -1, 0
        )
        if not matrix.size:
            return ""
        finite = np.all(np.isfinite(matrix), axis=(1, 2))
        least = np.linalg.svd(np.where(finite[:, None, None], matrix, 0.0), compute_uv=False)[:, -1]
        least = np.where(finite, least, np.inf)
        at, largest = int(np.argmin(least)), np.max(least, initial=0.0, where=finite)
        if not finite.any() or least[at] > _NEARLY_LOST * largest:
            return ""
        velocities = ", ".join(f"{name}_dot = {v[at]:.2g}" for name, v in zip(self.names, np.asarray(y.v), strict=True))
        return (
            f"the constraints f lose rank on the way: at t = {times[at]:.3g}, {velocities} df/dv comes down to "
            f"{least[at] / largest:.1g} of what it is elsewhere"
        )

    def multipliers(self, t: ArrayLike, y: Motion, p: Parameters) -> Vector:
        """The m multipliers λ of (6)."""
        return accelerations(self.equations(p), y.q, y.v, t).multipliers

    def residuals(self, t: ArrayLike, y: Motion, p: Parameters) -> Vector:
        """The m values of f, zero on the constraints."""
        return constraint_functions(self.equations(p), len(y.q))(*y.q, *y.v, t)

    def project(self, t: ArrayLike, y: Motion, p: Parameters, *, trust: bool = True) -> Motion:
        """The state brought back to f = 0 along M⁻¹ Aᵀ, or marked as failed: not a number from there on.

        Newton on the multipliers with the matrix of the state itself. The largest |f| met here is kept in `watch`.
        Without trust a state that is still off f = 0 is no failure.
        """
        equations, k = self.equations(p), len(y.q)
        q, v, (drift, reason) = y
        f = constraint_functions(equations, k)
        finite = jnp.isfinite(sum(x * x for x in (*q, *v)))
        singular = jnp.isnan(reason)
        off = ~finite
        residuals = f(*q, *v, t)
        if residuals:
            at = (*q, *v, t)
            mass, slopes = matrices(equations, at, k)
            ends = [[float(i == k + j) for i in range(k + len(slopes))] for j in range(len(slopes))]
            ways, smallest = eliminate(bordered_matrix(mass, slopes), ends, k * is_positive_definite(mass))
            singular |= smallest <= SMALLEST_PIVOT
            largest = largest_of(list(residuals))
            drift = jnp.where(largest > drift, largest, drift)
            for _ in range(_PROJECTIONS):
                v = tuple(v[i] - sum(r * way[i] for r, way in zip(residuals, ways, strict=True)) for i in range(k))
                residuals = f(*q, *v, t)
            sizes = [1.0 + sum(jnp.abs(a * vi) for a, vi in zip(row, v, strict=True)) for row in slopes]
            if trust:
                off = ~(largest_of([r / size for r, size in zip(residuals, sizes, strict=True)]) < _LARGEST_DRIFT)
        code = jnp.where(off, jnp.where(finite, _OFF, _NOT_FINITE), jnp.zeros_like(drift))
        code = jnp.where(singular, _SINGULAR, code)
        reason = jnp.where(reason > 0.0, reason, code)
        q, v = (tuple(jnp.where(reason > 0.0, jnp.nan, x) for x in side) for side in (q, v))
        return Motion(q, v, lax.stop_gradient((drift, reason)))

    # ---- what maps act on, and what steps carry: no velocity that the constraints give

    @property
    def exponents(self) -> int:
        """Lyapunov exponents of motions that keep the constraints."""
        return self.chart.dimension - self.constraints

    @property
    def chart(self) -> MotionChart:
        """Coordinates but for those that are ignorable, and all velocities."""
        kept = tuple(i for i, left_out in enumerate(self.ignorable) if not left_out)
        angles = *(self.angles[i] for i in kept), *(False for _ in self.names)
        return MotionChart(angles, len(kept), dimensionless=False, kept=kept, count=len(self.names))

    @property
    def explicit(self) -> Explicit | None:
        """Return which velocities the constraints give; None where there are none."""
        return _explicit(jax.tree.structure(self), tuple(np.shape(leaf) for leaf in jax.tree.leaves(self)))

    @property
    def reduction(self) -> Reduction:
        """Coordinates and the free velocities, where there is a choice."""
        explicit = self.explicit
        return Reduction(self) if explicit is None else ExplicitReduction(self, explicit)

    def nearest(self, y: Motion, p: Parameters) -> Motion:
        """The state near one that is on the constraints at t = 0: of other velocities, by many projections."""
        zero = jnp.zeros_like(y.q[0])

        def again(_: Number, state: Motion) -> Motion:
            q, v, (drift, _) = state
            moved = self.project(zero, Motion(q, v, (drift, zero)), p, trust=False)
            return Motion(q, moved.v, (drift, zero))

        return self.project(zero, lax.fori_loop(0, _APPROACHES, again, y), p)

    # ---- host: start states and results

    def start(self, coordinates: Mapping[str, ArrayLike]) -> Motion:
        """(q, q̇) at t = 0."""
        q = tuple(np.asarray(coordinates[name], float) for name in self.names)
        v = tuple(np.asarray(coordinates[f"{name}_dot"], float) for name in self.names)
        return Motion(q, v, (np.zeros_like(q[0]), np.zeros_like(q[0])))

    def outputs(self, y: Motion, t: np.ndarray) -> dict[str, Output]:
        """Coordinates and velocities of states by name: x, x_dot, y, y_dot, …"""
        words, units, _ = self.labels
        outputs: dict[str, Output] = {}
        for name, q, v, is_angle in zip(self.names, y.q, y.v, self.angles, strict=True):
            rate = f"{name}_dot"
            outputs[name] = Output(wrap_angle(q) if is_angle else q, words[name], {"units": units[name]})
            outputs[rate] = Output(v, f"{words[rate]} = d{name}/dt", {"units": units[rate]})
        return outputs

    def reports(self, y: Motion) -> dict[str, Output]:
        """Return the largest |f| before a projection and the status of each trajectory, from states (..., points)."""
        drift, reason = (component[..., -1] for component in y.watch)
        return {
            "drift": Output(drift, "largest |f| that a step left before its projection", {"units": UNSAID}),
            "status": status(reason),
        }


@cached_by_structure
def _explicit(structure: Any, shapes: tuple[tuple[int, ...], ...]) -> Explicit | None:
    """Compute the velocities once for a structure: parameters are no numbers then, and decide nothing."""
    velocities: list[Explicit | None] = []

    def look(system: Lagrangian, own: Parameters) -> float:
        velocities.append(explicit_velocities(system.equations(own), len(system.names)) if system.constraints else None)
        return 0.0

    system = jax.tree.unflatten(structure, [np.zeros(shape) for shape in shapes])
    jax.eval_shape(look, system, dict.fromkeys(system.lane_parameters, 0.0))
    return velocities[0]


def lagrangian(
    define: Callable[..., Definition], parameters: Mapping[str, float], of_lanes: tuple[str, ...] | None = None
) -> Lagrangian:
    """The system that a function of its parameters defines.

    Args:
        define: parameters by name to a mapping with `T`, `Q` and, unless the system is free, `f`: functions of
            (q, q̇, t), with q and q̇ tuples of k numbers; `coordinates`, their k names; with a clock its `period`,
            that of the strobe; and where there are some, names of coordinates that are `angles` or `ignorable`.
        parameters: values of all parameters.
        of_lanes: names of those that lanes may have of their own, by default all.
    """
    definition = define(**parameters)
    names = tuple(definition["coordinates"])
    zeros = (jnp.zeros(()),) * len(names)
    equations = Equations(definition["T"], definition["Q"], definition.get("f"))
    m = len(jax.eval_shape(lambda q, t: constraint_functions(equations, len(q))(*q, *q, t), zeros, zeros[0]))
    angles, ignorable = marked(definition, "angles"), marked(definition, "ignorable")
    return Lagrangian(define, dict(parameters), of_lanes, names, angles, "period" in definition, m, ignorable)
