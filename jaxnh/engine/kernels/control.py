"""Loops, branches and calls."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxnh.engine.kernels.arrays import rearranged
from jaxnh.engine.kernels.emitter import Emitter, Rule, filled
from jaxnh.engine.kernels.values import (
    Memory,
    Scalars,
    UnsupportedError,
    Value,
    in_registers,
    is_known,
    kind_of,
    size_of,
    text_of,
)

_WRITTEN_OUT = 2000  # equations of a loop of known length that is written out


def called(emitter: Emitter, equation: Any, inputs: Sequence[Value]) -> list[Value]:
    """Write a call where it stands."""
    p = equation.params
    inner = p["jaxpr"] if "jaxpr" in p else p["call"] if "call" in p else p["call_jaxpr"]
    return emitter.evaluate(*_opened(inner), inputs)


def _opened(closed: Any) -> tuple[Any, Sequence[Any]]:
    return (closed.jaxpr, closed.consts) if hasattr(closed, "consts") else (closed, ())


def _carries(emitter: Emitter, values: Sequence[Value]) -> list[Value]:
    """Return variables of a loop, with what they begin with."""
    carries: list[Value] = []
    for value in values:
        if isinstance(value, Scalars):
            names = [emitter.variable(value.kind, text_of(element, value.kind)) for element in value.flat]
            carries.append(filled(value.shape, value.kind, names))
        elif value.free and value.name not in emitter.viewed:
            carries.append(value)
        else:
            memory = emitter.memory(value.shape, value.kind)
            emitter.copied(value, memory)
            carries.append(memory)
    return carries


def _update(emitter: Emitter, carries: Sequence[Value], values: Sequence[Value]) -> None:
    """Write what the variables of a loop become, all at once."""
    assignments, memories = [], {carry.name for carry in carries if isinstance(carry, Memory)}
    for carry, value in zip(carries, values, strict=True):
        if isinstance(carry, Scalars):
            for name, element in zip(carry.flat, emitter.scalars(value).flat, strict=True):
                if name != element:
                    text = text_of(element, carry.kind)
                    new = text if is_known(element) else emitter.let(carry.kind, text)
                    assignments.append(f"{name} = {new};")
        elif isinstance(value, Memory) and value.name != carry.name and value.name in memories:
            raise UnsupportedError("large arrays that change places in a loop")
        else:
            emitter.copied(value, carry)
    for assignment in assignments:
        emitter.line(assignment)


def while_loop(emitter: Emitter, equation: Any, inputs: Sequence[Value]) -> list[Value]:
    """Write a loop that ends when its condition is false."""
    p = equation.params
    head, first = p["cond_nconsts"], p["cond_nconsts"] + p["body_nconsts"]
    fixed = [v._replace(free=False) if isinstance(v, Memory) else v for v in inputs[:first]]
    carries = _carries(emitter, inputs[first:])
    with emitter.block("for (;;)"):
        shown = [c._replace(free=False) if isinstance(c, Memory) else c for c in carries]
        (holds,) = emitter.evaluate(*_opened(p["cond_jaxpr"]), [*fixed[:head], *shown])
        emitter.line(f"if (!({text_of(emitter.scalars(holds).flat[0], 'bool')})) break;")
        _update(emitter, carries, emitter.evaluate(*_opened(p["body_jaxpr"]), [*fixed[head:], *carries]))
    return carries


def scan(emitter: Emitter, equation: Any, inputs: Sequence[Value]) -> list[Value]:
    """Write a loop of known length over entries of arrays; a short one is written out."""
    p = equation.params
    count = p["length"]
    fixed, carried = _counts(p)
    consts = [v._replace(free=False) if isinstance(v, Memory) else v for v in inputs[:fixed]]
    inits, entries = inputs[fixed : fixed + carried], inputs[fixed + carried :]
    if count * _equations(p["jaxpr"].jaxpr) <= _WRITTEN_OUT:
        return _written_out(emitter, p, consts, inits, entries)
    carries, sources = _carries(emitter, inits), [emitter.stored(value) for value in entries]
    avals = [v.aval for v in equation.outvars[carried:]]
    results = [emitter.memory(tuple(aval.shape), kind_of(aval.dtype)) for aval in avals]
    with emitter.each(count) as i:
        place = f"({count - 1} - {i})" if p["reverse"] else i
        rows = [_row(emitter, source, place) for source in sources]
        (*values,) = emitter.evaluate(*_opened(p["jaxpr"]), [*consts, *carries, *rows])
        for result, value in zip(results, values[carried:], strict=True):
            size = size_of(result.shape[1:])
            emitter.copied(value, Memory(f"({result.name} + {place} * {size})", result.shape[1:], result.kind))
        _update(emitter, carries, values[:carried])
    return [*carries, *results]


def _counts(p: Any) -> tuple[int, int]:
    """Return how many of a loop's operands are fixed, and how many are carried."""
    if "ft_in" in p:  # since JAX 0.11
        fixed, carried, _ = map(len, p["ft_in"].unpack())
        return fixed, carried
    return p["num_consts"], p["num_carry"]


def _equations(jaxpr: Any) -> int:
    """Return the number of equations of a program, those of programs inside counted."""
    total = 0
    for equation in jaxpr.eqns:
        parts = [part for p in equation.params.values() for part in (p if isinstance(p, tuple | list) else (p,))]
        inner = [getattr(part, "jaxpr", part) for part in parts]
        total += 1 + sum(_equations(part) for part in inner if hasattr(part, "eqns"))
    return total


def _row(emitter: Emitter, source: Memory, place: str) -> Value:
    shape, size = source.shape[1:], size_of(source.shape[1:])
    if in_registers(shape):
        elements = [emitter.let(source.kind, f"{source.name}[{place} * {size} + {k}]") for k in range(size)]
        return filled(shape, source.kind, elements)
    emitter.viewed.add(source.name)
    return Memory(f"({source.name} + {place} * {size})", shape, source.kind)


def _written_out(
    emitter: Emitter, p: Any, consts: Sequence[Value], inits: Sequence[Value], entries: Sequence[Value]
) -> list[Value]:
    count, carried = p["length"], _counts(p)[1]
    carries, rows = [*inits], [list[Value]() for _ in p["jaxpr"].jaxpr.outvars[carried:]]
    for k in reversed(range(count)) if p["reverse"] else range(count):
        entry = [rearranged(emitter, lambda x, k=k: x[k], [value]) for value in entries]
        (*values,) = emitter.evaluate(*_opened(p["jaxpr"]), [*consts, *carries, *entry])
        carries = values[:carried]
        for row, value in zip(rows, values[carried:], strict=True):
            row.append(value)
    if p["reverse"]:
        rows = [row[::-1] for row in rows]
    return [*carries, *(rearranged(emitter, lambda *x: np.stack(x), row) for row in rows)]


def cond(emitter: Emitter, equation: Any, inputs: Sequence[Value]) -> list[Value]:
    """Write the branch that an index chooses."""
    index, *operands = inputs
    (which,), branches = emitter.scalars(index).flat, equation.params["branches"]
    operands = [v._replace(free=False) if isinstance(v, Memory) else v for v in operands]
    if is_known(which):
        return emitter.evaluate(*_opened(branches[min(max(int(which), 0), len(branches) - 1)]), operands)
    results: list[Value] = []
    for v in equation.outvars:
        shape, kind = tuple(v.aval.shape), kind_of(v.aval.dtype)
        if in_registers(shape):
            results.append(filled(shape, kind, [emitter.variable(kind) for _ in range(size_of(shape))]))
        else:
            results.append(emitter.memory(shape, kind))
    for k, branch in enumerate(branches):
        head = "if" if k == 0 else "else if"
        test = f"({which} <= 0)" if k == 0 else f"({which} == {k})"
        with emitter.block("else" if k == len(branches) - 1 else f"{head} {test}"):
            _update(emitter, results, emitter.evaluate(*_opened(branch), operands))
    return results


def rules() -> dict[str, Rule]:
    """The rules of loops, branches and calls, by the name of the primitive."""
    calls = (
        "jit",
        "pjit",
        "closed_call",
        "custom_jvp_call",
        "custom_vjp_call",
        "custom_vmap_call",
        "remat",
        "checkpoint",
    )
    table: dict[str, Rule] = dict.fromkeys(calls, called)
    return table | {"while": while_loop, "scan": scan, "cond": cond}
