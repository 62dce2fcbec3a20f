"""A system of the user's own: a Python file with one function `system`, read, tried out and turned into equations.

    def system(mass=1.0, drive=0.5):     # parameters, each with its default
        def T(q, v, t): ...              # kinetic energy: a number
        def Q(q, v, t): ...              # generalised forces: a number a coordinate
        def f(q, v, t): ...              # constraints: numbers that are zero; without any, leave it out
        return dict(T=T, Q=Q, f=f, coordinates=("x", "y"), period=2 * jnp.pi)

`q` and `v` are tuples, a number a coordinate, and functions are those of `jax.numpy`. Whatever is wrong with the file
is said in one line with its place in it.
"""

from __future__ import annotations

import difflib
import hashlib
import inspect
import math
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import Tracer
from jax.typing import ArrayLike

from jaxnh.exceptions import UserFileError
from jaxnh.systems.lagrangian import Lagrangian, lagrangian

_NEEDED = ("T", "Q", "coordinates", "period")
_KNOWN = (*_NEEDED, "f", "angles", "ignorable")
_KEYS = ("file", "constraint")  # of a config, beside the parameters
_BESIDE_STATES = ("t", "lane", "strobe", "time", "start", "drift", "failure")  # in results, beside the coordinates

DIMENSIONS = ("lane", "strobe", "time", "start", "exponent", "level")
"""Dimensions of results, which no axis of a sweep can be called."""


class UserFile:
    """What a user's file says.

    Attributes:
        path: the file, as the config names it from where the command runs.
        text: its text.
        parameters: names of the parameters with their defaults.
        coordinates: names of the coordinates.
    """

    def __init__(self, path: Path, text: str | None = None) -> None:
        """Read the file and try its function out.

        Args:
            path: the file.
            text: what it says, where it has been read before; the file is then not looked at.

        Raises:
            UserFileError: anything that keeps it from being a system.
        """
        self.path = path
        try:
            self.text = path.read_text(encoding="utf-8") if text is None else text
        except (OSError, UnicodeDecodeError) as error:
            raise UserFileError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
        self._define = self._function()
        self.parameters = self._defaults()
        definition = self.define(**self.parameters)
        self.coordinates: tuple[str, ...] = tuple(definition["coordinates"])
        self._try()

    @property
    def sha256(self) -> str:
        """Hash, in hex, of the text."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    def define(self, **parameters: Any) -> Mapping[str, Any]:
        """What the function returns, checked.

        Raises:
            UserFileError: it fails, or says what is no definition.
        """
        definition = self._guarded(lambda: self._define(**parameters))
        line = self._define.__code__.co_firstlineno
        if not isinstance(definition, Mapping):
            raise self._fault(line, "system must return dict(T=..., Q=..., f=..., coordinates=..., period=...)")
        for name in definition:
            if name not in _KNOWN:
                close = difflib.get_close_matches(str(name), _KNOWN, n=1)
                meant = f" (did you mean {close[0]}?)" if close else ""
                raise self._fault(
                    line, f"system returns {name!r}, which is unknown{meant}; known are {', '.join(_KNOWN)}"
                )
        for name in _NEEDED:
            if name not in definition:
                raise self._fault(line, f"system must also return {name}")
        for name in ("T", "Q", "f"):
            if definition.get(name) is not None and not callable(definition[name]):
                raise self._fault(line, f"{name} must be a function of (q, v, t)")
        self._check_names(definition, line)
        period = definition["period"]
        if not isinstance(period, Tracer) and not (math.isfinite(float(period)) and float(period) > 0):
            raise self._fault(line, f"period must be a positive number, not {period}")
        return definition

    def period(self, parameters: Mapping[str, ArrayLike]) -> float:
        """Strobe period with these parameters."""
        return float(self.define(**parameters)["period"])

    def flow(self, parameters: Mapping[str, float]) -> Lagrangian:
        """The system with these parameters."""
        return lagrangian(self.define, parameters)

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
            raise self._fault(1, "there is no function system(...) that returns T, Q, f, coordinates and period")
        return scope["system"]

    def _defaults(self) -> dict[str, float]:
        line = self._define.__code__.co_firstlineno
        defaults: dict[str, float] = {}
        for name, parameter in inspect.signature(self._define).parameters.items():
            value = parameter.default
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise self._fault(line, f"parameter {name} of system needs a number as its default: {name}=1.0")
            if name in _KEYS:
                raise self._fault(line, f"a parameter cannot be called {name}: that is a key of the config")
            defaults[name] = float(value)
        return defaults

    def _check_names(self, definition: Mapping[str, Any], line: int) -> None:
        names = definition["coordinates"]
        if isinstance(names, str) or not names or not all(isinstance(n, str) and n.isidentifier() for n in names):
            raise self._fault(line, 'coordinates must be names, as in coordinates=("x", "y")')
        every = [*names, *(f"{name}_dot" for name in names)]
        if len(set(every)) < len(every) or set(every) & set(_BESIDE_STATES):
            raise self._fault(line, f"coordinates must differ, and not be one of {', '.join(_BESIDE_STATES)}")
        for name in every:
            if name in inspect.signature(self._define).parameters:
                raise self._fault(line, f"{name} names a parameter and a coordinate or velocity; rename one of them")
        for kind in ("angles", "ignorable"):
            for name in definition.get(kind, ()):
                if name not in names:
                    raise self._fault(line, f"{kind} names {name!r}, which is no coordinate")
        if len(set(definition.get("ignorable", ()))) == len(names):
            raise self._fault(line, "one coordinate at least must not be ignorable")

    def _try(self) -> None:
        """Trace T, Q and f with parameters that lanes decide, and look at what comes out."""
        number = jax.ShapeDtypeStruct((), jnp.float64)
        parameters = dict.fromkeys(self.parameters, number)
        k = len(self.coordinates)
        for name, count in (("T", None), ("Q", k), ("f", 0)):

            def evaluate(p: Mapping[str, Any], q: Any, v: Any, t: Any, name: str = name) -> Any:
                function = self.define(**p).get(name)
                found = () if function is None else function(q, v, t)
                if name != "T" and not isinstance(found, tuple | list) and jnp.ndim(found) != 1:
                    raise self._fault(self._line_of(name), f"{name} must return a tuple of numbers")
                return found if name == "T" else tuple(jnp.asarray(x) for x in found)

            shape = self._guarded(
                lambda e=evaluate: jax.eval_shape(e, parameters, (number,) * k, (number,) * k, number)
            )
            leaves = jax.tree.leaves(shape)
            line = self._line_of(name)
            if any(leaf.shape for leaf in leaves) or (count is None and len(leaves) != 1):
                raise self._fault(line, f"{name} must return {'a number' if count is None else 'a tuple of numbers'}")
            if count and len(leaves) != count:
                raise self._fault(line, f"Q must return {k} numbers, one a coordinate, not {len(leaves)}")
            if name == "f" and len(leaves) >= k:
                raise self._fault(line, f"f returns {len(leaves)} numbers; {k} coordinates can have {k - 1} at most")

    def _line_of(self, name: str) -> int:
        code = getattr(self.define(**self.parameters).get(name), "__code__", None)
        return code.co_firstlineno if code else self._define.__code__.co_firstlineno

    def _guarded(self, body: Callable[[], Any]) -> Any:
        try:
            return body()
        except UserFileError:
            raise
        except Exception as error:
            frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename == str(self.path)]
            said = " ".join(str(error).split("\n\n")[0].split())[:300]
            line = (frames[-1].lineno if frames else None) or self._define.__code__.co_firstlineno
            raise self._fault(line, f"{type(error).__name__}: {said}") from None

    def _fault(self, line: int, message: str) -> UserFileError:
        return UserFileError(f"{self.path}:{line}: {message}")
