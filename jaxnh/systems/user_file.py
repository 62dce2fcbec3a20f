"""A system of the user's own: a Python file with one function `system`, read, tried out and turned into a flow.

    def system(sigma=10.0, rho=28.0, beta=8 / 3):     # parameters, each with its default
        def rhs(y, t): ...                            # a right-hand side: a number a coordinate
        return dict(rhs=rhs, coordinates=("x", "y", "z"))

    def system(mass=1.0, drive=0.5):
        def T(q, v, t): ...                           # or mechanics: kinetic energy, a number
        def Q(q, v, t): ...                           # generalised forces: a number a coordinate
        def f(q, v, t): ...                           # constraints: numbers that are zero; without any, leave it out
        return dict(T=T, Q=Q, f=f, coordinates=("x", "y"), period=2 * jnp.pi)

    def system(a=1.4, b=0.3):
        def image(y): ...                             # or a map: the next iterate, a number a coordinate
        return dict(map=image, coordinates=("x", "y"))

A right-hand side may have jumps of the state and switches of the field:

    jumps=[{"when": wall, "direction": "up", "then": bounce}]     # where wall(y, t) rises through zero the state jumps
    switches=[{"on": surface}]                                    # where surface(y, t) is zero the field changes

`bounce(y, t)` is the state after; with switches the right-hand side is rhs(y, t, side), side a tuple of +1.0 or -1.0 a
switch. With `"rest": True` motions may come to rest on a wall, with `"sliding": True` slide along a surface. Mechanics
has them as functions of (q, v, t), and Q reads the sides; `bounce` returns (q, v), or a wall has a `restitution`:

    f=[rope, {"constraint": blade, "when": lowered}]              # holds always, and while lowered(q, v, t) is positive

With `rates`, mechanics is in quasi-velocities (`quasi_velocities`). `y`, `q` and `v` are tuples, a number a coordinate,
and functions are those of `jax.numpy`. One number or one name stands for the tuple of it. What depends on t has a
`period`; what does not may have a `time_unit`. Results and pictures take words and units of parameters and coordinates,
and units of t, from labels={"x": "displacement"} and units={"x": "m"}. Whatever
is wrong with the file is said in one line with its place.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike

from jaxnh.exceptions import InputError, UserFileError
from jaxnh.systems.corners import forces_with_switches, with_switches
from jaxnh.systems.definition import unit_of_time
from jaxnh.systems.discrete_map import DiscreteMap, discrete_map
from jaxnh.systems.first_order import FirstOrder, first_order
from jaxnh.systems.lagrangian import Lagrangian, lagrangian
from jaxnh.systems.piecewise_smooth import piecewise_smooth
from jaxnh.systems.scaled_time import in_periods
from jaxnh.systems.small_arrays import by_numbers
from jaxnh.systems.switched_mechanics import switched_mechanics
from jaxnh.systems.tracing import Program
from jaxnh.systems.user_code import explain_error
from jaxnh.systems.user_functions import (
    EVENTS,
    FUNCTIONS,
    EventFault,
    components_of,
    count_of,
    functions_of,
    line_of_code,
    pointwise,
    with_events,
    with_lists_of_names,
)
from jaxnh.systems.user_names import CLOCKS, check_keys, check_names, fault_of_count, state_sizes, states_in
from jaxnh.systems.user_period import period_fault
from jaxnh.systems.user_text import Names, read_text

_OF_COMPONENTS = ("map", "rhs", "rates", "Q", "f")  # functions that return a number a coordinate, or a constraint
_KEYS = ("file", "constraint")  # of a config, beside the parameters
_MOST_FLOWS = 256  # flows kept, at most: a session asks for the same ones again and again
_RETURNED = dict.fromkeys(_OF_COMPONENTS, "a number a coordinate") | {"T": "a number", "f": "a number a constraint"}


UserFlow = Lagrangian | FirstOrder | DiscreteMap
"""A system that a user's file defines."""


class UserFile:
    """Contents of a user's file.

    Attributes:
        path: the file, as the config names it from where the command runs.
        text: its text.
        parameters: names of the parameters with their defaults.
        coordinates: names of the coordinates.
        states: names of the coordinates of a state: of mechanics with velocities NAME_dot, or with quasi-velocities.
        integrals: names of its integrals, of mechanics.
        mechanical: whether it says T and Q, so that each coordinate has a velocity.
        discrete: whether it says a map, so that nothing is integrated.
    """

    def __init__(self, path: Path, text: str | None = None) -> None:
        """Read the file and try its function out.

        Args:
            path: the file.
            text: what it says, where it has been read before; the file is then not looked at.

        Raises:
            UserFileError: anything that keeps it from being a system.
        """
        self.path, self._equations = path, list[str | None]()
        self.text = read_text(path) if text is None else text
        self._define = self._function()
        self.parameters = self._defaults()
        self._periodic: set[tuple[float, ...]] = set()  # parameters at which the equations were seen to have the period
        self._periods, self._flows = dict[tuple[tuple[str, float], ...], float](), dict[str, UserFlow]()
        definition = self.define(**self.parameters)
        self.coordinates: tuple[str, ...] = tuple(definition["coordinates"])
        self.states, self.integrals = states_in(definition), tuple(definition.get("integrals", ()))
        self.discrete, self.mechanical = "map" in definition, "T" in definition
        if self.mechanical:
            uses_time = self._try_mechanics(definition)
        else:
            uses_time = self._try_point("map" if self.discrete else "rhs")
        if uses_time and "period" not in definition:
            raise self._fault(self._line_of("rhs"), "the system depends on t: give its period, period=2 * jnp.pi")
        if not uses_time and "period" in definition:
            message = "nothing depends on t: leave period out (time_unit says what lengths of time are counted in)"
            raise self._fault(self._line_of("rhs"), message)

    @property
    def names(self) -> Names:
        """Names of its parameters, coordinates and states."""
        return Names(tuple(self.parameters), self.coordinates, self.states, self.integrals)

    @property
    def sha256(self) -> str:
        """Hash, in hex, of the text."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    @property
    def traced(self) -> str | None:
        """Hash, in hex, of the equations that its functions come to, whatever modules and data these are from.

        None where equations do not say all, as of functions that define derivatives of their own.
        """
        texts = [text for text in self._equations if text]
        return hashlib.sha256("".join(texts).encode()).hexdigest() if len(texts) == len(self._equations) else None

    def define(self, **parameters: Any) -> Mapping[str, Any]:
        """Return the function's result, checked; one name, or one number that a function returns, as a tuple of it.

        Raises:
            UserFileError: it fails, or says what is no definition.
        """
        said = self._guarded(lambda: self._define(**parameters))
        line = self._define.__code__.co_firstlineno
        if not isinstance(said, Mapping):
            message = (
                "system must return dict(rhs=..., coordinates=...), or dict(T=..., Q=..., ...), or dict(map=..., ...)"
            )
            raise self._fault(line, message)
        definition = with_lists_of_names(said)
        try:
            main = check_keys(definition)
            definition = with_events(definition, main)
            check_names(definition, tuple(inspect.signature(self._define).parameters))
        except EventFault as fault:
            raise self._fault(fault.line or line, str(fault)) from None
        except InputError as error:
            raise self._fault(line, str(error)) from None
        if all(name in definition for name in CLOCKS):
            raise self._fault(line, "period and time_unit exclude each other: with a period, it is the unit of time")
        for name in CLOCKS:
            length = definition.get(name, 1.0)
            if isinstance(length, str):
                raise self._fault(line, f"{name} must be a number, not the text {length!r}")
            if not isinstance(length, Tracer) and not (math.isfinite(float(length)) and float(length) > 0):
                raise self._fault(line, f"{name} must be a positive number, not {length}")
        made = {
            key: components_of(value) if key in _OF_COMPONENTS and value else value for key, value in definition.items()
        }
        if "rhs" in made:
            made["rhs"] = by_numbers(made["rhs"])
        return {key: pointwise(value) if key in FUNCTIONS and value else value for key, value in made.items()}

    def period(self, parameters: Mapping[str, ArrayLike]) -> float:
        """Strobe period, or the unit of time, with these parameters."""
        at = tuple((name, float(np.asarray(value))) for name, value in parameters.items())
        if at not in self._periods:  # sweeps ask for the same ones again and again
            self._periods[at] = unit_of_time(self.define(**parameters))
        return self._periods[at]

    def flow(
        self, parameters: Mapping[str, float], of_lanes: tuple[str, ...] = (), *, in_periods: bool = False
    ) -> UserFlow:
        """The system with these parameters.

        Args:
            parameters: values of all of them.
            of_lanes: names of those that lanes have of their own, but for those that decide the clock of all.
            in_periods: whether time is over the period, which then is that of all lanes; of systems that can be
                (`can_scale_time`).

        Raises:
            UserFileError: the equations are other ones a period later.
        """
        asked = repr(given := (parameters, of_lanes, in_periods))  # numbers to the bit, with their types
        if len(self._flows) >= _MOST_FLOWS:
            self._flows.clear()
        return self._flows.get(asked) or self._flows.setdefault(asked, self._make_flow(*given))

    def _make_flow(self, parameters: Mapping[str, float], of_lanes: tuple[str, ...], in_periods: bool) -> UserFlow:
        self._check_period(parameters)
        define = self.define if self.discrete else self._with_switches
        define = self._over_period if in_periods else define
        eventful = any(define(**parameters).get(kind) for kind in (*EVENTS, "constraints"))
        of_points = piecewise_smooth if eventful else first_order
        of_mechanics = switched_mechanics if eventful else lagrangian
        made = of_mechanics if self.mechanical else discrete_map if self.discrete else of_points
        try:
            flow = made(define, parameters, of_lanes)
        except UserFileError:
            raise
        except InputError as error:
            raise self._fault(self._line_of("rates"), str(error)) from None
        return replace(flow, of_lanes=tuple(name for name in of_lanes if not flow.roles.is_shared(name)))

    @functools.cached_property
    def can_scale_time(self) -> bool:
        """Tell whether it is a right-hand side with a period."""
        return not (self.mechanical or self.discrete) and "period" in self.define(**self.parameters)

    @functools.cached_property
    def _over_period(self) -> Callable[..., Mapping[str, Any]]:
        """Its definition in time over the period."""
        return in_periods(self._with_switches)

    @functools.cached_property
    def _with_switches(self) -> Callable[..., Mapping[str, Any]]:
        """Its definition, with switches for the corners and jumps of its right-hand side or its forces."""
        if not self.mechanical:
            return self._guarded(lambda: with_switches(self.define, self.parameters))
        sizes = state_sizes(self.define(**self.parameters))
        return self._guarded(lambda: forces_with_switches(self.define, self.parameters, sizes))

    def _check_period(self, parameters: Mapping[str, float]) -> None:
        """Hold the equations against themselves a period later, at random states and times."""
        definition = self.define(**parameters)
        if "period" not in definition or tuple(parameters.values()) in self._periodic:
            return
        period, sizes = (
            float(definition["period"]),
            state_sizes(definition) if self.mechanical else (len(self.coordinates),),
        )
        if fault := period_fault(functions_of(definition), sizes, period, self._guarded):
            vector = fault.name in _OF_COMPONENTS or fault.name.endswith(".then")
            what = f"number {fault.number + 1} of {fault.name}" if vector else fault.name
            message = (
                f"{period:.9g} is no period of {fault.name}: at one state {what} is {fault.first:.9g} at t = "
                f"{fault.t:.9g} and {fault.second:.9g} a period later; give the period of what depends on t"
            )
            raise self._fault(self._line_of(fault.name), message)
        self._periodic.add(tuple(parameters.values()))

    def _function(self) -> Callable[..., Any]:
        scope: dict[str, Any] = {"__name__": self.path.stem, "__file__": str(self.path)}
        try:
            code = compile(self.text, str(self.path), "exec")
        except (SyntaxError, ValueError) as error:
            raise self._fault(
                getattr(error, "lineno", 1) or 1, f"not valid Python: {getattr(error, 'msg', error)}"
            ) from None
        self._guarded(lambda: exec(code, scope))
        if not inspect.isfunction(scope.get("system")):
            raise self._fault(
                1, "there is no function system(...) that returns rhs, a map, or T, Q and f, with their coordinates"
            )
        return scope["system"]

    def _defaults(self) -> dict[str, float]:
        line = self._define.__code__.co_firstlineno
        defaults: dict[str, float] = {}
        for name, parameter in inspect.signature(self._define).parameters.items():
            value = parameter.default
            if isinstance(value, bool) or not isinstance(value, int | float):
                message = f"parameter {name} of system needs a number as its default: {name}=1.0"
                raise self._fault(line, f"{message}; the state and time are arguments of the rhs(y, t) that it returns")
            if name in _KEYS:
                raise self._fault(line, f"a parameter cannot be called {name}: that is a key of the config")
            defaults[name] = float(value)
        return defaults

    def _try_mechanics(self, definition: Mapping[str, Any]) -> bool:
        """Trace T, Q and f with parameters that lanes decide, and look at what comes out; whether they use time."""
        sizes, uses_time = state_sizes(definition), False
        for name in ("rates", "T", "Q", "f") if "rates" in definition else ("T", "Q", "f"):

            def evaluate(p: Mapping[str, Any], t: Any, q: Any, v: Any, name: str = name) -> Any:
                function = functions_of(self.define(**p)).get(name)
                result = () if function is None else function(q, v, t)
                return self._numbers(name, (result,) if name == "T" else result)

            leaves, timed = self._traced(evaluate, sizes)
            uses_time |= timed
            if any(leaf.shape for leaf in leaves):
                raise self._fault(self._line_of(name), f"{name} must return {_RETURNED[name]}")
            if fault := fault_of_count(definition, name, len(leaves)):
                raise self._fault(self._line_of(name), fault)
        return self._try_events(sizes) or uses_time

    def _try_point(self, name: str) -> bool:
        """Trace a right-hand side, or a map, likewise."""
        line, d = self._line_of(name), len(self.coordinates)

        def evaluate(p: Mapping[str, Any], t: Any, y: Any) -> Any:
            function = functions_of(self.define(**p))[name]
            return self._numbers(name, function(y) if self.discrete else function(y, t))

        leaves, uses_time = self._traced(evaluate, (d,))
        if any(leaf.shape for leaf in leaves):
            raise self._fault(line, f"{name} must return {_RETURNED[name]}")
        if len(leaves) != d:
            raise self._fault(line, f"{name} must return {d} numbers, one a coordinate, not {len(leaves)}")
        return self._try_events((d,)) or uses_time

    def _try_events(self, sizes: Sequence[int]) -> bool:
        """Trace the functions of jumps, switches and constraints that come and go likewise."""
        uses_time, functions = False, functions_of(self.define(**self.parameters))
        for name in [name for name in functions if "." in name]:
            wanted = self._returned(name)

            def evaluate(p: Mapping[str, Any], t: Any, *at: Any, name: str = name, wanted: str = wanted) -> Any:
                result = functions_of(self.define(**p))[name](*at, t)
                if self.mechanical and name.endswith(".then"):
                    if not isinstance(result, tuple | list) or list(map(count_of, result)) != [*sizes]:
                        raise self._fault(self._line_of(name), f"{name} must return {wanted}")
                    result = [x for side in result for x in side]
                return self._numbers(name, result if isinstance(result, tuple | list) else (result,))

            leaves, timed = self._traced(evaluate, sizes)
            uses_time |= timed
            many, count = name.endswith(".constraint"), sum(sizes) if name.endswith(".then") else 1
            if any(leaf.shape for leaf in leaves) or not (leaves if many else len(leaves) == count):
                raise self._fault(self._line_of(name), f"{name} must return {wanted}")
        return uses_time

    def _returned(self, name: str) -> str:
        """Describe what a function of a definition must return."""
        if name.endswith(".then"):
            return "(q, v), the coordinates and the velocities after" if self.mechanical else "a number a coordinate"
        return _RETURNED.get(name, "a number")

    def _traced(self, evaluate: Callable[..., Any], sizes: Sequence[int]) -> tuple[list[Any], bool]:
        """Shapes of what a function of (parameters, t, vectors of sizes) returns, and whether t has a part in it."""
        at, parameters = [(0.0,) * size for size in sizes], dict.fromkeys(self.parameters, 0.0)
        traced = self._guarded(lambda: Program(lambda t, p, *vectors: evaluate(p, t, *vectors), 0.0, parameters, *at))
        self._equations.append(traced.sha256)
        return traced.shapes, traced.output_depends([1, *[0] * (len(traced.inputs) - 1)])

    def _numbers(self, name: str, values: Sequence[Any]) -> tuple[Any, ...]:
        """Convert a function's result to arrays."""
        if any(value is None or isinstance(value, str | Mapping | tuple | list) for value in values):
            nothing = ", and returns nothing" if values[0] is None else ""
            raise self._fault(self._line_of(name), f"{name} must return {self._returned(name)}{nothing}")
        numbers = tuple(jnp.asarray(value) for value in values)
        if any(jnp.iscomplexobj(number) for number in numbers):
            real = "real numbers: a complex one is two, its real and its imaginary part"
            raise self._fault(self._line_of(name), f"{name} must return {real}")
        if name.endswith((".when", ".on")) and any(number.dtype == jnp.bool_ for number in numbers):
            height = "a number that passes zero, as x - 1.0, and returns a truth value, as x > 1.0"
            raise self._fault(self._line_of(name), f"{name} must return {height}")
        return numbers

    def _line_of(self, name: str) -> int:
        definition = self.define(**self.parameters)
        function = definition.get(name) or functions_of(definition).get(name) or definition.get("T")
        return line_of_code(function, self._define.__code__.co_firstlineno)

    def _guarded(self, body: Callable[[], Any]) -> Any:
        try:
            return body()
        except UserFileError:
            raise
        except Exception as error:
            line, what = explain_error(error, self.text, str(self.path))
            raise self._fault(line or self._define.__code__.co_firstlineno, what) from None

    def _fault(self, line: int, message: str) -> UserFileError:
        return UserFileError(f"{self.path}:{line}: {message}")
