"""Floating-point operations of a compiled program, a lane: counted in its optimised HLO, loop by loop.

Equal operations within a loop's body count once, as LLVM merges them: the copies that `strobe` makes, so that all
components share one loop over the lanes, are seen through. What is done once for all lanes counts nothing.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

_COUNTED = frozenset(
    (
        *("add", "subtract", "multiply", "divide", "negate", "abs", "maximum", "minimum", "remainder", "sign"),
        *("sqrt", "rsqrt", "cbrt", "exponential", "exponential-minus-one", "log", "log-plus-one", "power"),
        *("sine", "cosine", "tan", "tanh", "atan2", "floor", "ceil", "round-nearest-even", "compare", "select"),
    )
)
_SAME = frozenset(("reduce-precision", "copy", "bitcast", "broadcast", "convert", "reshape"))
_COMMUTE = frozenset(("add", "multiply", "maximum", "minimum"))
_HEAD = re.compile(r"^(?P<entry>ENTRY )?%(?P<name>[\w.\-]+) .*\{$")
_LINE = re.compile(
    r"^\s+(?P<root>ROOT )?%(?P<name>[\w.\-]+) = (?P<type>\(.*?\)|\S+) (?P<op>[\w\-]+)\((?P<args>[^)]*)\)(?P<rest>.*)$"
)
_TURNS = re.compile(r'"known_trip_count":\{"n":"(\d+)"\}')
_TOLD = re.compile(r", metadata=\{[^}]*\}|, backend_config=.*$|, frontend_attributes=\{[^}]*\}")


@dataclass
class Loop:
    """Operations of one turn of a loop, those of the loops within it left out; or of a whole program.

    Attributes:
        operations: floating-point operations a lane.
        inner: the loops within it.
        trip_count: of the loop, where the program says; None where a number decides that it is given.
    """

    operations: float = 0.0
    inner: list[Loop] = field(default_factory=list)
    trip_count: int | None = None

    def total(self, trip_counts: Sequence[float]) -> float:
        """Operations of one iteration; trip counts of the costliest loops within it, outermost first."""
        if not trip_counts or not self.inner:
            return self.operations
        return self.operations + trip_counts[0] * max(loop.total(trip_counts[1:]) for loop in self.inner)

    def whole(self, trip_counts: Sequence[float]) -> float:
        """Operations with all loops within it, each with the trip count that the program says, else that of its depth.

        Raises:
            IndexError: a loop lies deeper than there are trip counts, and the program does not say its own.
        """
        inner = [(trip_counts[0] if loop.trip_count is None else loop.trip_count, loop) for loop in self.inner]
        return self.operations + sum(number * loop.whole(trip_counts[1:]) for number, loop in inner)


def count(program: str, lanes: int) -> Loop:
    """The loops of a program, from its HLO as text, with so many lanes a tile."""
    computations: dict[str, list[re.Match[str]]] = {}
    entry, lines = "", []
    for line in program.splitlines():
        if head := _HEAD.match(line):
            lines = computations.setdefault(head["name"], [])
            entry = head["name"] if head["entry"] else entry
        elif match := _LINE.match(line):
            lines.append(match)
    return _Counter(computations, lanes).body(entry)


class _Counter:
    """Numbers for values: equal ones have the same."""

    def __init__(self, computations: dict[str, list[re.Match[str]]], lanes: int) -> None:
        self._computations, self._lanes = computations, lanes
        self._numbers: dict[Any, int] = {}

    def body(self, name: str) -> Loop:
        """A computation by itself: its parameters are known to be nothing else."""
        loop, seen = Loop(), set()
        arguments = [self._number(("parameter", name, i)) for i in range(len(self._computations[name]))]
        self._values(name, arguments, loop, seen)
        return loop

    def _values(self, name: str, arguments: list[Any], loop: Loop, seen: set[int]) -> Any:
        """Count a computation; its operations go to a loop, where they have not been seen."""
        values: dict[str, Any] = {}
        types = {line["name"]: line["type"] for line in self._computations[name]}
        root = None
        for line in self._computations[name]:
            operands = [values[a] for a in re.findall(r"%([\w.\-]+)", line["args"])]
            value = self._value(line, operands, arguments, loop, seen, types)
            values[line["name"]] = value
            root = value if line["root"] else root
        return root

    def _value(
        self,
        line: re.Match[str],
        operands: list[Any],
        arguments: list[Any],
        loop: Loop,
        seen: set[int],
        types: dict[str, str],
    ) -> Any:
        op, rest = line["op"], line["rest"]
        if op == "parameter":
            return arguments[int(line["args"])]
        if op in _SAME:
            return operands[0]
        if op == "tuple":
            return tuple(operands)
        if op == "get-tuple-element" and isinstance(operands[0], tuple):
            return operands[0][int(re.findall(r"index=(\d+)", rest)[0])]
        if op in ("fusion", "call"):
            return self._values(_named("calls" if op == "fusion" else "to_apply", rest), operands, loop, seen)
        if op == "while":
            loop.inner.append(self.body(_named("body", rest)))
            told = _TURNS.search(rest)
            loop.inner[-1].trip_count = int(told[1]) if told else None
            return self._number(("while", line["name"], *operands))
        if op in _COMMUTE:
            operands = sorted(operands, key=str)
        literal = line["args"] if op == "constant" else ""
        number = self._number((op, literal, line["type"], _TOLD.sub("", rest), *operands))
        if number not in seen:
            seen.add(number)
            loop.operations += self._cost(line, types)
        return number

    def _cost(self, line: re.Match[str], types: dict[str, str]) -> int:
        """Operations of a line: of a reduction about one for each number that goes into a result."""
        op, shape = line["op"], line["type"]
        if op in _COUNTED:
            return self._lanewise(shape, op)
        if op == "reduce" and not shape.startswith("("):
            return self._lanewise(types[re.findall(r"%([\w.\-]+)", line["args"])[0]], op)
        if op == "reduce-window" and not shape.startswith("("):
            size = re.findall(r"size=([\dx]+)", line["rest"])[0]
            return self._lanewise(shape, op) * (math.prod(int(n) for n in size.split("x")) - 1)
        return 0

    def _number(self, key: Any) -> int:
        return self._numbers.setdefault(key, len(self._numbers))

    def _lanewise(self, shape: str, op: str) -> int:
        """Numbers a lane of a shape; none where it is not one of floats, or all lanes share it."""
        kind, sizes = re.findall(r"(\w+)\[([\d,]*)\]", shape)[0]
        if not (kind.startswith(("f", "bf")) or (op == "compare" and kind == "pred")):
            return 0
        return math.prod(int(size) for size in sizes.split(",") if size) // self._lanes


def _named(what: str, rest: str) -> str:
    return re.findall(rf"{what}=%([\w.\-]+)", rest)[0]
