"""Systems ẏ = rhs(y, t) whose state jumps where a wall is met, or whose field changes where a surface is crossed.

Walls and surfaces are zeros of functions of (y, t), their heights. A field that changes reads on which sides of its
surfaces a state is, so that a step may keep to one branch of it beyond the surface as well, where it has none of its
own. How such motions are integrated is in `maps.jumping`, and how surfaces and walls hold them in `sliding`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxnh.systems.definition import Definition, marked
from jaxnh.systems.elimination import eliminate
from jaxnh.systems.first_order import CoordinateChart, FirstOrder, PointReadout
from jaxnh.systems.flow import Parameters
from jaxnh.systems.readout import Output, status
from jaxnh.systems.sliding import HeldMotion, free_motion, held_value, is_on, resting_motion, sliding_motion
from jaxnh.systems.state import Number, Vector, error_components
from jaxnh.systems.status import NOT_FINITE
from jaxnh.systems.tracing import Program

DIRECTIONS = ("up", "down", "both")
"""Directions in which a wall may be passed: its height rises through zero, falls, or either."""


_LINEAR = 1e-12  # what a jump that is linear leaves beside its slopes, of its size
_MANY = 12  # surfaces: a map across twenty is compiled in 8 s of processor in place of 70, their heights as a vector


class PiecewisePoint(NamedTuple):
    """State of a lane.

    Attributes:
        y: d coordinates.
        reason: why the lane has failed, else zero.
        watch: numbers that only report, of a mechanical system.
    """

    y: Vector
    reason: Any
    watch: Vector = ()


@error_components.register
def _(y: PiecewisePoint) -> tuple[Vector]:
    return (y.y,)


class PiecewiseChart(CoordinateChart):
    """All coordinates."""

    def state(self, u: Number) -> PiecewisePoint:
        return PiecewisePoint(tuple(u[i] for i in range(self.dimension)), jnp.zeros_like(u[0]))


class PiecewiseSmooth(FirstOrder):
    """A right-hand side with jumps of the state and switches of the field; made by `piecewise_smooth`.

    Attributes:
        jumps: direction in which each wall is passed.
        switches: number of surfaces where the field changes.
        holds: for each wall, whether motions may rest on it, and for each surface, whether they may slide along it.
        forgets: whether a jump takes different states to the same one, as one that sets a coordinate does.
        leaps: for each wall and surface those past which its height leaps, as of a comparison with a sawtooth; empty
            where no height does.
    """

    jumps: tuple[str, ...] = eqx.field(static=True)
    switches: int = eqx.field(static=True)
    holds: tuple[bool, ...] = eqx.field(static=True)
    forgets: bool = eqx.field(static=True)
    leaps: tuple[tuple[int, ...], ...] = eqx.field(static=True)

    @property
    def holding(self) -> bool:
        """Return whether motions may be held."""
        return any(self.holds)

    @property
    def loses_rank(self) -> bool:
        """Return whether motions may be held, or jumps forget, where different ones become the same."""
        return self.holding or self.forgets

    @property
    def needs_events(self) -> bool:
        """Return whether no steps follow motions but those that end at events: the state jumps there."""
        return bool(self.jumps)

    @property
    def constrained(self) -> bool:
        """Return whether states are brought back to constraints after each step."""
        return False

    @property
    def arrives_at_ends(self) -> bool:
        """Return whether a jump at the end of a stretch of time is one of it, and one at its beginning is not."""
        return True

    @property
    def many_surfaces(self) -> bool:
        """Return whether surfaces are so many, and nothing else there, that steps treat their heights as one vector."""
        return self.switches >= _MANY and not (self.jumps or self.holding or self.constrained)

    @property
    def section_number(self) -> int | None:
        """Return the number of the surface that is a section and may be a wall as well, if there is one."""
        return None

    @property
    def begins(self) -> tuple[bool, ...]:
        """Return for each wall and surface whether a constraint holds above it, and not below."""
        return (False,) * (len(self.jumps) + self.switches)

    def heights(
        self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...] | None = None
    ) -> tuple[Number, ...]:
        """Heights of a state above the walls, which rise where they are passed (either way for "both"), and surfaces.

        Args:
            sides: of walls and surfaces, on which heights that leap are continued beyond where they do.

        Returns:
            A number for each jump, then for each switch, of the shape of a component.
        """
        definition = self.definition(p)
        walls = [jump["when"](y.y, t) for jump in definition.get("jumps", ())]
        walls = [-wall if way == "down" else wall for wall, way in zip(walls, self.jumps, strict=True)]
        if self.leaps and sides is not None:
            surfaces = definition["heights"](y.y, t, sides[len(self.jumps) :])
        elif self.many_surfaces and "heights" in definition:
            surfaces = definition["heights"](y.y, t)
        else:
            surfaces = [switch["on"](y.y, t) for switch in definition.get("switches", ())]
        return tuple(jnp.asarray(height, jnp.float64) for height in (*walls, *surfaces))

    def jumped(
        self, number: int, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]
    ) -> PiecewisePoint:
        """The state after a jump, or where a constraint has begun.

        Args:
            number: of the wall or surface.
            sides: of all of them, before.
        """
        after = self.definition(p)["jumps"][number]["then"](tuple(y.y), t)
        return y._replace(y=tuple(jnp.asarray(x, jnp.float64) for x in after))

    @property
    def has_linear_jumps(self) -> bool:
        """Return whether all jumps are linear in the state, so that it is known where motions came from."""
        jumps = self.define(**self.values).get("jumps", ())
        return all(_is_linear(jump["then"], len(self.names)) for jump in jumps)

    def jump_slopes(self, p: Parameters) -> list[Float[Array, "n n"]]:
        """Derivatives of each jump, all of which are linear, in what it changes."""
        jumps, state = self.definition(p).get("jumps", ()), np.random.default_rng(0).uniform(0.5, 1.5, len(self.names))
        return [jax.jacfwd(_as_vector(jump["then"]))(state) for jump in jumps]

    def before_jump(
        self, number: int, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]
    ) -> PiecewisePoint:
        """The state that a jump, which is linear, takes to another.

        Args:
            number, sides: as of `jumped`.
        """

        def left(z: Any) -> Any:
            after = self.jumped(number, t, y._replace(y=tuple(z)), p, sides).y
            return jnp.stack([x - goal for x, goal in zip(after, y.y, strict=True)])

        z = jnp.stack(y.y)
        slopes, off, n = jax.jacfwd(left)(z), left(z), len(y.y)
        (step,), _ = eliminate([[slopes[i, j] for j in range(n)] for i in range(n)], [list(off)])
        return y._replace(y=tuple(x - dx for x, dx in zip(y.y, step, strict=True)))

    def heights_before_jumps(
        self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...] | None = None
    ) -> tuple[Number, ...]:
        """Heights as of `heights`, above each wall that of the state from which its jump leads here."""
        heights = self.heights(t, y, p, sides)
        known = sides or tuple(jnp.where(height >= 0.0, 1.0, -1.0) for height in heights)
        walls = range(len(self.jumps))
        before = [self.heights(t, self.before_jump(k, t, y, p, known), p, sides)[k] for k in walls]
        return *before, *heights[len(self.jumps) :]

    def constrain(self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]) -> PiecewisePoint:
        """The state after the constraints that hold on these sides have begun."""
        return y

    def on_constraints(
        self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]
    ) -> PiecewisePoint:
        """The state brought back to the constraints that hold on these sides."""
        return y

    def rhs(self, t: ArrayLike, y: PiecewisePoint, p: Parameters) -> PiecewisePoint:
        """Time derivative of a state by the branch of the field that it is in; on a surface by that above it.

        Where the surface or a wall holds it, along that.
        """
        return self.branch(t, y, p, self.sides(t, y, p))

    def divergence(self, t: ArrayLike, y: PiecewisePoint, p: Parameters) -> Number:
        """Divergence of the flow; −∞ where a motion is held, as those near it become the same in finite time."""
        divergence = super().divergence(t, y, p)
        if not self.holding:
            return divergence
        held = jnp.any(jnp.stack(self.sides(t, y, p)) == 0.0, axis=0)
        return jnp.where(held, -jnp.inf, divergence)

    def sides(self, t: ArrayLike, y: PiecewisePoint, p: Parameters) -> tuple[Number, ...]:
        """The side of each wall and surface that a state is on: +1 above it and on it, −1 below, 0 held there."""
        heights = self.heights(t, y, p) if self.switches or self.holding else ()
        sides = tuple(jnp.where(height >= 0.0, 1.0, -1.0) for height in heights)
        return self.held_sides(t, y, p, sides) if self.holding else sides

    def branch(self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]) -> PiecewisePoint:
        """Time derivative of a state by a branch of the field, wherever the state is.

        Args:
            sides: +1 above, −1 below, 0 held on, of each wall and surface.
        """
        held = self.held(t, y, p, sides).field if self.holding else self.rates(tuple(y.y), t, p, sides)
        return PiecewisePoint(held, jnp.zeros_like(y.y[0]), tuple(map(jnp.zeros_like, y.watch)))

    def rates(self, y: Vector, t: ArrayLike, p: Parameters, sides: tuple[Number, ...]) -> Vector:
        """Rates of the coordinates by a branch, none of its sides 0."""
        rhs, zero = self.definition(p)["rhs"], jnp.zeros_like(y[0])
        rates = rhs(y, t, sides[len(self.jumps) :]) if self.switches else rhs(y, t)
        return tuple(jnp.asarray(rate, jnp.float64) + zero for rate in rates)

    # ---- motions that are held

    @jax.jit  # traced once, and not for each of its uses: half the tracing of a ball's derivative (1.0 s of 2.2)
    def held(self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]) -> HeldMotion:
        """The motion on the wall or surface whose side is 0; where there is none the free one.

        Args:
            sides: of each wall and surface; at most one of them is 0.
        """
        jumps, reason = len(self.jumps), y.reason

        def height(y: Vector, t: ArrayLike) -> tuple[Number, ...]:
            return self.heights(t, PiecewisePoint(y, reason), p)

        def field(side: float) -> Callable[[Vector, ArrayLike], Vector]:
            kept = tuple(
                jnp.where(now == 0.0, side, now) if holds else now for now, holds in zip(sides, self.holds, strict=True)
            )
            return lambda y, t: self.rates(y, t, p, kept)

        walls = [k for k in range(jumps) if self.holds[k]]
        motion = free_motion(field(-1.0)(tuple(y.y), t), 2 if walls else 1)
        if any(self.holds[jumps:]):
            on = [k for k in range(jumps, len(sides)) if self.holds[k]]
            slid = [sides[k] for k in on]
            sliding = sliding_motion(
                field(1.0), field(-1.0), lambda y, t: held_value(slid, [height(y, t)[k] for k in on]), t, tuple(y.y)
            )
            sliding = sliding._replace(constraints=motion.constraints[1:] + sliding.constraints)
            motion = _select(held_value(slid, [1.0] * len(on)) > 0.0, sliding, motion)
        for k in walls:
            resting = resting_motion(
                field(-1.0),
                lambda y, t, k=k: self.jumped(k, t, PiecewisePoint(y, reason), p, sides).y,
                lambda y, t, k=k: height(y, t)[k],
                t, tuple(y.y),
            )  # fmt: skip
            motion = _select(sides[k] == 0.0, resting, motion)
        return motion

    def held_sides(
        self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]
    ) -> tuple[Number, ...]:
        """Sides of a state, 0 where it is held, and where it leaves a surface that it is on those that it leaves to."""
        definition, held_or_not = self.definition(p), list(sides)
        unit = definition.get("period", definition.get("time_unit", 1.0))
        for k, holds in enumerate(self.holds):
            if holds:
                held = self.held(t, y, p, (*sides[:k], jnp.zeros_like(sides[k]), *sides[k + 1 :]))
                there = jnp.where(held.holds, 0.0, held.leaves)
                held_or_not[k] = jnp.where(is_on(held, y.y, unit), there, sides[k])
        return tuple(held_or_not)

    @property
    def chart(self) -> PiecewiseChart:
        """All coordinates."""
        return PiecewiseChart(self.angles, positions=len(self.names), dimensionless=False)

    # ---- host: start states and results

    def start(self, coordinates: Mapping[str, ArrayLike]) -> PiecewisePoint:
        """The state with coordinates by name."""
        y = super().start(coordinates).y
        return PiecewisePoint(y, np.zeros_like(y[0]))

    @property
    def readout(self) -> PiecewiseReadout:
        """Coordinates as the definition calls them, and why a lane has failed."""
        return PiecewiseReadout(self)


class PiecewiseReadout(PointReadout):
    """States that are points, and say why they have failed."""

    def reports(self, y: PiecewisePoint) -> dict[str, Output]:
        reason = np.asarray(y.reason)[..., -1]
        finite = np.all([np.isfinite(x[..., -1]) for x in y.y], axis=0)
        return {"status": status(np.where(finite, 0, np.where(reason > 0, reason, NOT_FINITE)))}


def piecewise_smooth(
    define: Callable[..., Definition], parameters: Mapping[str, float], of_lanes: tuple[str, ...] | None = None
) -> PiecewiseSmooth:
    """The system that a function of its parameters defines.

    Args:
        define: as of `first_order`, with `jumps`, each a mapping of `when`, the height (y, t) to a number, `direction`,
            one of `DIRECTIONS`, and `then`, (y, t) to the d numbers after the jump; and `switches`, each a mapping of
            `on`, the height of a surface. Motions may rest on the wall of a jump that says `rest`, and slide along the
            surface of a switch that says `sliding`. With switches `rhs` is a function of (y, t, side), side a number ±1
            for each. Of many switches `heights`, a function of (y, t), may give all heights at once.
        parameters, of_lanes: as of `first_order`.
    """
    definition = define(**parameters)
    jumps = tuple(jump["direction"] for jump in definition.get("jumps", ()))
    resting = (bool(jump.get("rest", False)) for jump in definition.get("jumps", ()))
    sliding = (bool(switch.get("sliding", False)) for switch in definition.get("switches", ()))
    return PiecewiseSmooth(
        define,
        dict(parameters),
        of_lanes,
        tuple(definition["coordinates"]),
        marked(definition, "angles"),
        "period" in definition,
        jumps,
        len(definition.get("switches", ())),
        (*resting, *sliding),
        any(_forgets(jump["then"], len(definition["coordinates"])) for jump in definition.get("jumps", ())),
        _leaps(len(jumps), definition.get("leaps", ())),
    )


def _leaps(jumps: int, leaps: Sequence[tuple[int, ...]]) -> tuple[tuple[int, ...], ...]:
    """The same by numbers of walls and surfaces."""
    return (*((),) * jumps, *(tuple(jumps + k for k in each) for each in leaps)) if leaps else ()


def _is_linear(then: Callable[[Vector, ArrayLike], Sequence[Number]], dimension: int) -> bool:
    """Return whether a jump is linear in the state: its slopes do not depend on it, nor does what they leave."""

    def after(y: Any, t: Any) -> Any:
        return jnp.stack([jnp.asarray(x, jnp.float64) for x in then(tuple(y), t)])

    def slopes(y: Any, t: Any) -> Any:
        return jax.jacfwd(after)(y, t)

    random = np.random.default_rng(0)
    states = [size * random.uniform(-1.0, 1.0, dimension) for size in (0.0, 0.1, 1.0, 1.0, 10.0, 10.0)]
    left = np.stack([after(y, 0.1) - slopes(y, 0.1) @ y for y in states])  # a sign or a step has no slope
    if not np.allclose(left, left[0], rtol=0.0, atol=_LINEAR * (10.0 + np.max(np.abs(left)))):
        return False
    return not Program(slopes, np.zeros(dimension), 0.0).output_depends([1, 0])


def _as_vector(then: Callable[[Vector, ArrayLike], Sequence[Number]]) -> Callable[[Any], Array]:
    """A jump at a time in no special place, of vectors."""
    return lambda y: jnp.stack([jnp.asarray(x, jnp.float64) for x in then(tuple(y), 0.1)])


def _forgets(then: Callable[[Vector, ArrayLike], Sequence[Number]], dimension: int) -> bool:
    """Return whether the derivative of a jump is singular at a state in no special place, or finite at none."""
    random = np.random.default_rng(0)
    change = jax.jacfwd(lambda y: jnp.stack([jnp.asarray(x, jnp.float64) for x in then(tuple(y), 0.1)]))
    for size in (1.0, -1.0, 10.0, -10.0, 0.1, -0.1):  # jumps need not make sense everywhere
        matrix = np.asarray(change(size * random.uniform(0.5, 1.5, dimension)))
        if np.all(np.isfinite(matrix)):
            return bool(np.linalg.matrix_rank(matrix) < dimension)
    return True


def _select(condition: Number, yes: HeldMotion, no: HeldMotion) -> HeldMotion:
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), yes, no)
