"""Corners and jumps that a right-hand side has by |x|, sign, max, min, clip, floor or a comparison, as switches.

Each of these equations has a surface on which its operands are equal, or its argument is zero, or of floor an integer.
The right-hand side is written anew as a function of (y, t, side), in which they read the side of their surface, so that
steps may end there (`maps.jumping`). It is left as it is where nothing depends on a side. The height above the surface
of what is compared with a sawtooth leaps with that: by sides of floor it goes on beyond, up to the event.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxnh.systems.definition import Definition
from jaxnh.systems.straight_pieces import (
    COMPARISONS,
    MOST_SURFACES,
    OPERANDS,
    WITHOUT_SURFACE,
    floor_of_parity,
    is_real,
    written_in_pieces,
)
from jaxnh.systems.surface_probes import probe_field
from jaxnh.systems.tracing import KnownValue, Program, Slot, Step
from jaxnh.systems.user_functions import pointwise

_CONTINUOUS = ("abs", "max", "min", "clamp", "reduce_max", "reduce_min", "sort")

Read = Slot | KnownValue


class Surface(NamedTuple):
    """Zeros of the difference of two values, or of an element of it; of one value alone where the other is None.

    Attributes:
        above, below: the values.
        element: of their arrays.
        at_integers: whether it is every integer, and not zero alone.
        leaps_on: numbers of the surfaces of floor past which the difference leaps, and its sign with it.
    """

    above: Read
    below: Read | None
    element: int
    at_integers: bool = False
    leaps_on: tuple[int, ...] = ()


class PiecewiseField:
    """A right-hand side as its equations, and the surfaces that its branches meet on.

    Attributes:
        surfaces: one for each corner or jump of the field.
        attracts: along which surfaces motions may slide.
        pushes: across which surfaces the field jumps by what moves the surface's own coordinates.
    """

    def __init__(
        self, define: Callable[..., Definition], parameters: Mapping[str, float], *, leaping: bool = True
    ) -> None:
        """Trace the right-hand side of a definition, all in double precision.

        Args:
            define: parameters to a definition with `rhs`.
            parameters: their defaults, near which branches are compared.
            leaping: whether surfaces are placed whose height leaps, as that of a comparison with a sawtooth.
        """
        self._leaping = leaping
        y = (0.0,) * len(define(**parameters)["coordinates"])
        self._program = program = Program(
            lambda p, y, t: define(**p)["rhs"](y, t), dict(parameters), y, 0.0, written_out=written_in_pieces
        )
        moving = [0] * len(parameters) + [1] * (len(y) + 1)
        self._moves, self._fixed = program.depends(moving), self._constants()
        self._needed = program.needed(program.outputs)
        self.surfaces: list[Surface] = []
        self._sides: dict[Slot, list[list[tuple[int, float]]]] = {}
        self._numbers: dict[Any, int] = {}
        self._place_all()
        if len(self.surfaces) > MOST_SURFACES:
            self.surfaces, self._sides = [], {}
        self.attracts = self.pushes = np.zeros(0, bool)
        if self.surfaces:
            seen = probe_field(self.heights, self.rates, parameters, len(y), len(self.surfaces))
            part = seen.part.copy()
            for surface, has_part in zip(self.surfaces, seen.part, strict=True):
                part[list(surface.leaps_on)] |= has_part
            self.attracts, self.pushes = seen.attracts[part], seen.pushes[part]
            self._drop(~part, seen.sides)

    def rates(self, p: Mapping[str, Any], y: tuple[Any, ...], t: Any, sides: tuple[Any, ...]) -> Any:
        """Rates by one branch.

        Args:
            sides: +1 or −1 for each surface.
        """
        located = (step for step in self._program.steps if step.makes[0] in self._sides)
        instead = {step.makes[0]: self._branch(step, sides) for step in located}
        return self._program.results(self._values(p, y, t, self._needed, instead))

    def height(self, number: int, p: Mapping[str, Any], y: tuple[Any, ...], t: Any) -> Any:
        """Height of a state above a surface."""
        return self._heights([self.surfaces[number]], p, y, t)[0]

    def heights(
        self, p: Mapping[str, Any], y: tuple[Any, ...], t: Any, sides: tuple[Any, ...] | None = None
    ) -> tuple[Any, ...]:
        """Heights of a state above all surfaces; what they share is computed once.

        Args:
            sides: those that floor is read on, where heights do not leap.
        """
        return self._heights(self.surfaces, p, y, t, sides)

    @property
    def leaps(self) -> tuple[tuple[int, ...], ...]:
        """The surfaces past which the height above each leaps."""
        return tuple(surface.leaps_on for surface in self.surfaces)

    def _heights(
        self,
        surfaces: Sequence[Surface],
        p: Mapping[str, Any],
        y: tuple[Any, ...],
        t: Any,
        sides: tuple[Any, ...] | None = None,
    ) -> tuple[Any, ...]:
        needed = self._program.needed([read for surface in surfaces for read in surface[:2] if read is not None])
        floors = [
            step
            for step in self._program.steps
            if sides is not None and step.equation.primitive.name == "floor" and step.makes[0] in self._sides
        ]
        values = self._values(p, y, t, needed, {step.makes[0]: self._branch(step, sides or ()) for step in floors})
        return tuple(_height(surface, values) for surface in surfaces)

    # ---- surfaces

    def _place_all(self) -> None:
        """Note the surfaces of all equations that change with the motion.

        What comes after floor is constant on an arc where nothing else of it moves. Where something does, its surfaces
        leap with floor. Surfaces of what jumps in another way are left to the steps.
        """
        leaping, glides = set[Slot](), set[Slot](self._program.inputs)
        floors: dict[Slot, frozenset[int]] = {}
        for step in self._program.steps:
            if self._needed.isdisjoint(step.makes) or not self._moves[step.makes[0]]:
                continue
            name = step.equation.primitive.name
            reads = {each for each in step.reads if not isinstance(each, KnownValue)}
            before = frozenset[int]().union(*(floors.get(slot, ()) for slot in reads))
            corner, leaps, moves = name in OPERANDS and is_real(step.equation), reads & leaping, reads & glides
            floored = corner and name == "floor" and not step.equation.outvars[0].aval.shape
            placed = corner and moves and not leaps and not (before and not self._leaping)
            placed = placed and not (name == "floor" and (before or not floored))
            if placed:
                self._place(step, tuple(sorted(before)))
            if floored and placed:
                before |= {number for number, _ in self._sides[step.makes[0]][0]}
            elif not floored or moves:
                glides |= set(step.makes) if moves else set()
                if leaps or (moves and (corner or name in WITHOUT_SURFACE) and name not in _CONTINUOUS):
                    leaping |= set(step.makes)
            floors |= dict.fromkeys(step.makes, before)

    def _place(self, step: Step, leaps_on: tuple[int, ...]) -> None:
        """Note the surfaces of an equation."""
        count = int(np.prod(step.equation.outvars[0].aval.shape))
        integers = step.equation.primitive.name == "floor"
        sides = list[list[tuple[int, float]]]()
        for first, second in OPERANDS[step.equation.primitive.name]:
            above, below = step.reads[first], None if second is None else step.reads[second]
            sign = 1.0
            if count == 1 and not integers:
                above, below, sign = self._ordered(above, below)
            surfaces = [Surface(above, below, element, integers, leaps_on) for element in range(count)]
            sides.append([(self._number(surface), sign) for surface in surfaces])
        self._sides[step.makes[0]] = sides

    def _ordered(self, above: Read, below: Read | None) -> tuple[Read, Read | None, float]:
        """Operands of a difference or a sum in place of the result of it, in one order; and whether the sign stays."""
        made_by = {step.makes[0]: step for step in self._program.steps}
        step = None if isinstance(above, KnownValue) else made_by.get(above)
        zero = below is None or self._constant(below) == 0.0
        if zero and step and step.equation.primitive.name == "sub":
            above, below, zero = *step.reads, False
        elif zero and step and step.equation.primitive.name == "add":
            for first, second in (step.reads, step.reads[::-1]):
                if (value := self._constant(second)) is not None:
                    above, below, zero = first, KnownValue(np.float64(-value)), False
        inner = None if isinstance(above, KnownValue) else made_by.get(above)
        value = 0.0 if zero or below is None else self._constant(below)
        if inner and inner.equation.primitive.name == "neg" and value is not None:
            return inner.reads[0], KnownValue(np.float64(-value)) if value else None, -1.0
        if zero or below is None:
            return above, None, 1.0
        if self._key(above) > self._key(below):
            return below, above, -1.0
        return above, below, 1.0

    def _number(self, surface: Surface) -> int:
        """Number of a surface, a new one unless there is an equal one."""
        key = self._key(surface.above), surface.below and self._key(surface.below), *surface[2:4]
        if key not in self._numbers:
            self._numbers[key] = len(self.surfaces)
            self.surfaces.append(surface)
        return self._numbers[key]

    def _key(self, read: Read) -> tuple[int, float]:
        """Slots by their number, numbers by their value, after all slots."""
        value = self._constant(read)
        return (0, float(read)) if value is None and not isinstance(read, KnownValue) else (1, float(value or 0.0))

    def _constant(self, read: Read) -> float | None:
        """Value of a number that depends on nothing; None of others, and of arrays."""
        value = read.value if isinstance(read, KnownValue) else self._fixed.get(read)
        return None if value is None or np.ndim(value) else float(value)

    def _constants(self) -> dict[Slot, Any]:
        """Values of slots that depend on no argument."""
        depends, values = self._program.depends([1] * len(self._program.inputs)), dict[Slot, Any]()
        with jax.ensure_compile_time_eval():
            self._program.run(values, lambda step: not depends[step.makes[0]])
        return values

    def _drop(self, unused: np.ndarray, sides: np.ndarray) -> None:
        """Leave surfaces out, on these sides, and equations all of whose surfaces are left out as they are."""
        kept = [k for k in range(len(self.surfaces)) if not unused[k]]
        number = {k: i for i, k in enumerate(kept)}
        self.surfaces = [
            surface._replace(leaps_on=tuple(number[i] for i in surface.leaps_on))
            for surface in map(self.surfaces.__getitem__, kept)
        ]
        self._sides = {
            slot: [[(number[k], sign) if k in number else (-1, sign * sides[k]) for k, sign in pair] for pair in pairs]
            for slot, pairs in self._sides.items()
            if any(k in number for pair in pairs for k, _ in pair)
        }

    # ---- equations

    def _values(
        self,
        p: Mapping[str, Any],
        y: tuple[Any, ...],
        t: Any,
        needed: set[Slot],
        instead: Mapping[Any, Callable[..., Any]] | None = None,
    ) -> dict[Slot, Any]:
        leaves = [jnp.asarray(leaf, jnp.float64) for leaf in jax.tree.leaves((dict(p), y, t))]
        values = dict(zip(self._program.inputs, leaves, strict=True))
        self._program.run(values, lambda step: not needed.isdisjoint(step.makes), instead)
        return values

    def _branch(self, step: Step, sides: tuple[Any, ...]) -> Callable[..., Any]:
        """An equation that reads the sides of its surfaces, of one left out that of most states."""
        name, shape = step.equation.primitive.name, step.equation.outvars[0].aval.shape

        def side(pair: list[tuple[int, float]]) -> Any:
            each = [sides[k] * sign if k >= 0 else jnp.asarray(sign) for k, sign in pair]
            return jnp.stack(each).reshape(shape) if shape else each[0]

        first, *second = map(side, self._sides[step.makes[0]])
        if name in COMPARISONS:
            return lambda a, b: first * COMPARISONS[name] > 0.0
        return {
            "abs": lambda x: first * x,
            "sign": lambda x: first,
            "floor": lambda x: floor_of_parity(x, first),
            "max": lambda a, b: jnp.where(first > 0.0, a, b),
            "min": lambda a, b: jnp.where(first > 0.0, b, a),
            "clamp": lambda low, x, high: jnp.where(second[0] > 0.0, high, jnp.where(first > 0.0, x, low)),
        }[name]


def with_switches(define: Callable[..., Definition], parameters: Mapping[str, float]) -> Callable[..., Definition]:
    """The definition of a right-hand side with switches for its corners and jumps; itself where there are none.

    Nothing is looked for where the definition has `switches` of its own, be it none.

    Args:
        define: parameters to a definition with `rhs`, of (y, t) to d numbers.
        parameters: their defaults.
    """
    if "switches" in define(**parameters):
        return define
    with jax.enable_x64(True):
        field = PiecewiseField(define, parameters)
    if not field.surfaces:
        return define

    def with_switches(**p: Any) -> Definition:
        return {
            **define(**p),
            "rhs": pointwise(lambda y, t, side: field.rates(p, y, t, side)),
            "switches": tuple(
                {"on": pointwise(lambda y, t, k=k: field.height(k, p, y, t)), "sliding": bool(slides)}
                for k, slides in enumerate(field.attracts)
            ),
            "heights": pointwise(lambda y, t, *side: field.heights(p, y, t, *side)),
            **({"leaps": field.leaps} if any(field.leaps) else {}),
        }

    return with_switches


def forces_with_switches(
    define: Callable[..., Definition], parameters: Mapping[str, float], sizes: tuple[int, int]
) -> Callable[..., Definition]:
    """The definition of a mechanical system with switches for the corners and jumps of `Q`; itself where it has none.

    Motions may slide along a surface that velocities decide and across which a force jumps, as of dry friction: which
    way the masses let it push is not asked.

    Args:
        define: parameters to a definition with `Q`, of (q, v, t).
        parameters: their defaults.
        sizes: numbers of coordinates and of velocities.
    """
    if "switches" in define(**parameters):
        return define
    k, n = sizes

    def as_field(**p: Any) -> Definition:
        forces = define(**p)["Q"]
        still = (0.0,) * k
        return {"coordinates": (0.0,) * (k + n), "rhs": lambda y, t: (*still, *forces(y[:k], y[k:], t))}

    with jax.enable_x64(True):
        field = PiecewiseField(as_field, parameters, leaping=False)
    if not field.surfaces:
        return define

    def forces_with_switches(**p: Any) -> Definition:
        return {
            **define(**p),
            "Q": pointwise(lambda q, v, t, side: tuple(field.rates(p, (*q, *v), t, side))[k:]),
            "switches": tuple(
                {"on": pointwise(lambda q, v, t, i=i: field.height(i, p, (*q, *v), t)), "sliding": bool(slides)}
                for i, slides in enumerate(field.pushes)
            ),
        }

    return forces_with_switches


def _height(surface: Surface, values: Mapping[Slot, Any]) -> Any:
    above, below, *_ = surface
    value = _value(above, values) if below is None else _value(above, values) - _value(below, values)
    value = jnp.ravel(value)[surface.element] if jnp.ndim(value) else value
    if surface.at_integers:
        value = jnp.sin(jnp.pi * value)
    return value


def _value(read: Read, values: Mapping[Slot, Any]) -> Any:
    return read.value if isinstance(read, KnownValue) else values[read]
